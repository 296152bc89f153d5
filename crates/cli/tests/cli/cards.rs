//! Cards other than the 5300: FeitCSI's logs of two simulated robots, and the constants between the chains of one.

use crate::air::Program;
use crate::commands::{Folder, json, of};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// Simulates a scene into `name`; the receiver's log, the transmitter's, and the trajectory that begins so.
pub fn simulated(folder: &Folder, name: &str, scene: &str, trajectory: &str) -> [String; 3] {
    folder.write("scene.toml", scene.as_bytes());
    folder.says(&["simulate", "scene.toml", "--out", name], 0, &[]);
    let find = |start: &str| {
        let files = std::fs::read_dir(folder.0.join(name)).unwrap().map(|entry| entry.unwrap().path());
        let is_it = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with(start);
        files.into_iter().find(is_it).unwrap().to_str().unwrap().to_owned()
    };
    ["csi_rx_", "csi_tx1_", trajectory].map(find)
}

pub const PAIR: &str = "duration_s = 12.0\ncard = \"ax210\"\ncfo = \"physical\"\nsounding.rate_hz = 50\n\
     [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\nturn_around.spread_us = 8\n\
     [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.25, duration_s = 12.0 }\n\
     [[robot]]\nname = \"tx\"\nposition_m = [-4.0, 9.0, 0.0]\ncrystal.offset_ppm = -6.0\n";

#[test]
fn two_logs_of_feitcsi_give_the_rooms_bearing() {
    let folder = Folder::new("feitcsi");
    let [rx, tx, path] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (out, _) = folder.says(&["info", &rx], 0, &[]);
    assert!(out.contains("FeitCSI, 600 frames") && out.contains("of two robots"), "{out}");
    let answer = &folder.rows(&["bearing", &rx, &tx, &path, "--channel", "108", "--json"], 0)[0];
    // From the circle's middle, 25 cm to the left of where it began.
    let truth_deg = (9.0_f64 - 0.25).atan2(-4.0).to_degrees();
    assert!((answer["azimuth_deg"].as_f64().unwrap() - truth_deg).abs() < 0.2, "{answer}");
    assert!(answer["compensated"].as_bool().unwrap() && answer["pairs"].as_u64().unwrap() >= 595, "{answer}");
    // What a log of another card says of its clock is no record of its own.
    let mut replay = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    let played = replay.args(["replay", &rx, "--speed", "max"]).current_dir(&folder.0).output().unwrap();
    assert!(String::from_utf8_lossy(&played.stderr).contains("600 records played"), "{played:?}");
    // The same of the folder, whose files are named as those of a capture.
    assert_eq!(folder.rows(&["bearing", "room", "--json"], 0)[0]["azimuth_deg"], answer["azimuth_deg"]);

    // Damage costs only the records it hits, and is reported; a cut log is read up to the cut.
    let mut log = std::fs::read(&rx).unwrap();
    let len = log.len() / 600;
    log.truncate(log.len() - 100);
    log.drain(200 * len + 300..200 * len + 400);
    let damaged = folder.write("damaged.csi", &log);
    let damaged = damaged.to_str().unwrap();
    let (out, _) = folder.says(&of(damaged, &tx, &path), 3, &["598 bfee records"]);
    assert!(out.contains("114."), "{out}");
    // Frames of 80 and 160 MHz are taken about their centres.
    for (width, number, centre) in [("80", "106", "5530MHz"), ("160", "114", "5570MHz")] {
        let wide = PAIR.replace("card =", &format!("bandwidth_mhz = {width}\nchannel = {number}\ncard ="));
        let [rx, tx, path] = simulated(&folder, width, &wide, "rx_trajectory_");
        let (status, out, err) = folder.run(&["bearing", &rx, &tx, &path, "--channel", centre, "--json"]);
        let answer = json(out.lines().next().unwrap());
        assert!(status == 0 && !err.contains("by that"), "{err}");
        assert!((answer["azimuth_deg"].as_f64().unwrap() - truth_deg).abs() < 0.2, "{width}: {answer}");
        let (_, _, err) = folder.run(&["bearing", &rx, &tx, &path, "--channel", "108"]);
        assert!(err.contains("name the channel by that, for example --channel 5530MHz"), "{err}");
    }
}

#[test]
fn claims_about_fields_of_a_5300_are_not_tried_on_logs_of_another_card() {
    let folder = Folder::new("accept-cards");
    let [rx, tx, _] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (out, _) = folder.says(&["doctor", "--accept", &rx, &tx, "--channel", "108", "--json"], 0, &[]);
    let report = json(&out);
    let verdict = |id: &str| {
        let all = report["findings"].as_array().unwrap();
        all.iter()
            .filter(|one| one["id"] == id)
            .map(|one| one["verdict"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    assert_eq!(verdict("reception.saturation"), ["not_tried"; 2], "{report}");
    for id in ["card.clock", "card.rate", "log.whole", "reception.snr", "reception.subcarriers"] {
        assert_eq!(verdict(id), ["holds"; 2], "{id}");
    }
}

/// `record --feitcsi` with the log of one simulated robot on its way.
fn recorded(folder: &Folder, from: &str, more: &[&str], feed: impl FnOnce(&mut Child)) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    command.args(["record", "out.csi", "--force", "--feitcsi", from]).args(more).current_dir(&folder.0);
    let mut child = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    feed(&mut child);
    drop(child.stdin.take());
    let output = child.wait_with_output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn a_recording_that_an_error_ended_is_not_done() {
    let folder = Folder::new("record-broken");
    let [rx, ..] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let log = std::fs::read(&rx).unwrap();
    let frame = &log[..log.len() / 600];
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let mut far = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let (mut near, _) = listener.accept().unwrap();
    far.write_all(frame).unwrap();
    // One that is closed before it has read everything is reset.
    near.write_all(b"unread").unwrap();
    far.peek(&mut [0]).unwrap();
    drop(far);
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    command.args(["record", "out.csi", "--feitcsi", "-"]).current_dir(&folder.0);
    let output = command.stdin(std::os::fd::OwnedFd::from(near)).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(3) && said.contains("1 record written"), "{:?} {said}", output.status);
    assert!(said.contains("reading FeitCSI's output: "), "{said}");
    assert_eq!(std::fs::read(folder.0.join("out.csi")).unwrap(), frame);
}

#[test]
fn what_feitcsi_writes_is_recorded_byte_by_byte() {
    use std::net::UdpSocket;
    let folder = Folder::new("record-feitcsi");
    let [rx, tx, path] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let log = std::fs::read(&rx).unwrap();
    let out = || std::fs::read(folder.0.join("out.csi")).unwrap();
    // Damage too.
    let [before, after] = [&log[..3_000], &log[5_000..]];
    let damaged = [before, after].concat();
    for whole in [&log, &damaged] {
        let (status, err) =
            recorded(&folder, "-", &[], |child| child.stdin.as_mut().unwrap().write_all(whole).unwrap());
        assert!(out() == *whole && status == if whole == &log { 0 } else { 3 }, "{status} {err}");
    }
    assert!(!folder.0.join("out.datstp").exists());

    // A stand-in for FeitCSI: it is asked to measure, and answers whoever asked.
    let feitcsi = UdpSocket::bind("127.0.0.1:0").unwrap();
    let asked = || {
        let mut text = [0; 100];
        let (len, from) = feitcsi.recv_from(&mut text).unwrap();
        (String::from_utf8(text[..len].to_vec()).unwrap(), from)
    };
    let command = format!("{} --frequency 5540", feitcsi.local_addr().unwrap());
    let len = log.len() / 600;
    // No earlier recording's bytes are taken for this one's.
    std::fs::remove_file(folder.0.join("out.csi")).unwrap();
    let (status, err) = recorded(&folder, &command, &["--stop-after", "600records"], |_| {
        assert_eq!(asked().0, "stop");
        let (line, asker) = asked();
        assert_eq!(line, "feitcsi --frequency 5540");
        // As many as a small receive buffer holds.
        for (sent, frames) in (0..).zip(log.chunks(20 * len)) {
            while std::fs::read(folder.0.join("out.csi")).unwrap_or_default().len() < sent * 20 * len {
                std::thread::yield_now();
            }
            frames.chunks(len).for_each(|frame| assert_eq!(feitcsi.send_to(frame, asker).unwrap(), len));
        }
        assert_eq!(asked().0, "stop");
    });
    assert!(status == 0 && err.contains("600 records written to out.csi") && out() == log, "{status} {err}");
    let (said, _) = folder.says(&["info", "out.csi"], 0, &[]);
    assert!(said.contains("FeitCSI, 600 frames"), "{said}");
    let [own, recorded_one] =
        [&rx, "out.csi"].map(|rx| folder.rows(&[&of(rx, &tx, &path)[..], &["--json"]].concat(), 0).remove(0));
    assert_eq!(own["azimuth_deg"], recorded_one["azimuth_deg"]);

    // In files of a size: whole frames in each.
    let size = (100 * len + 500).to_string();
    let (status, err) = recorded(&folder, "-", &["--rotate-size", &size], |child| {
        child.stdin.as_mut().unwrap().write_all(&log).unwrap();
    });
    let parts: Vec<Vec<u8>> =
        (1..=6).map(|k| std::fs::read(folder.0.join(format!("out-{k:04}.csi"))).unwrap()).collect();
    assert!(status == 0 && parts.iter().all(|part| part.len() == 100 * len) && parts.concat() == log, "{err}");
    let (status, err) = recorded(&folder, "-", &[], |_| ());
    assert!(status == 1 && err.contains("nothing came: `csi5300 doctor` reports"), "{status} {err}");
    let (status, err) = recorded(&folder, "nowhere", &[], |_| ());
    assert!(status == 2 && err.contains("127.0.0.1:8008"), "{status} {err}");
}

#[test]
fn all_subcarriers_of_another_card_are_exported() {
    let folder = Folder::new("export-cards");
    let [rx, _, path] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (out, _) = folder.says(&["export", &rx, "a.csv", "--from", "1", "--to", "2", "--json"], 0, &[]);
    let text = std::fs::read_to_string(folder.0.join("a.csv")).unwrap();
    let records = text.lines().count() as u64 - 1;
    assert!((48..=52).contains(&records) && json(out.trim())["records"] == records, "{out}");
    assert_eq!(json(out.trim())["left_out"], 600 - records);
    // 242 subcarriers of HE at 20 MHz, two chains.
    assert_eq!(text.lines().next().unwrap().matches(",re_").count(), 2 * 242);
    for args in [&["--scaled"][..], &["--antennas", "A"], &["--remove-spatial-mapping"]] {
        folder.says(&[&["export", &rx, "b.npz"], args].concat(), 2, &["a FeitCSI log"]);
    }
    folder.says(&["export", &rx, "c.npz", "--mac", "02:00:00:00:00:09"], 1, &["600 frames skipped"]);
    assert!(!folder.0.join("c.npz").exists());
    // In the stock layout a sender without numbers stays known.
    folder.says(&["export", "--dat", &rx, "stock.dat", "--layout", "stock"], 0, &[]);
    let (out, _) = folder.says(&["info", "stock.dat"], 0, &[]);
    assert!(out.contains("stock layout, 600") && out.contains("from 02:53:00:00:00:01: 600 records"), "{out}");
    // Damage and a cut end are told, and an extension may be upper-case.
    let mut bytes = std::fs::read(&rx).unwrap();
    let third = 3 * bytes.len() / 600;
    bytes.truncate(bytes.len() - 100);
    bytes.splice(third..third, [0xff; 50]);
    folder.write("damaged.csi", &bytes);
    folder.says(&["export", "damaged.csi", "E.NPZ"], 3, &["a damaged one", "the log ends inside", "written to E.NPZ"]);
    let Some(cases) = crate::common::cases("other-cards") else { return };
    for name in
        ["atheros/ath_csi_1.dat", "picoscenes/rx_by_iwl5300.csi", "nexmon/example_4358.pcap", "esp32/example_csi.csv"]
    {
        let log = cases.join(name);
        let (status, _, err) = folder.run(&["export", log.to_str().unwrap(), "d.npz", "--force"]);
        assert!(matches!(status, 0 | 3) && err.contains("written to d.npz"), "{name}: {status} {err}");
        // It is no log of records; `bearing` knows it by its content, as `info` does.
        let log = log.to_str().unwrap();
        folder.says(&["export", "--dat", log, "d.dat"], 1, &["another kind of file, a log of another card"]);
        folder.says(&["bearing", log, &path, "--channel", "64"], 1, &["a log of another card", "--baseline"]);
        let one = ["--antennas", "A,B", "--baseline", "0.05,0,0", "--clock-offset", "rows"];
        let (_, _, err) = folder.run(&[&["bearing", log, &path, "--channel", "64"], &one[..]].concat());
        assert!(err.contains("is the receiver's log") && err.contains(" lack an antenna"), "{name}: {err}");
        // The frames say which channel they came on.
        assert!(err.contains(" MHz, not of --channel 64: the bearing has a wrong wavelength"), "{name}: {err}");
    }
}

#[test]
fn the_constant_of_a_turn_gives_a_robot_that_stands_a_bearing() {
    let folder = Folder::new("chains");
    let scene = |motion: &str| {
        format!(
            "duration_s = 5.0\nsounding.rate_hz = 40\n[radio]\nnoise.snr_db = 20\nchain_deg = [-50.0, 0.0]\n\
             chain_noise_rad = 0.1\n[[robot]]\nname = \"rx\"\nyaw_deg = 20.0\nantenna_b_m = [-0.025, 0.0, 0.0]\n{motion}\n\
             [[robot]]\nname = \"tx\"\nposition_m = [30.0, 40.0, 0.0]\n"
        )
    };
    let run = |name: &str, motion: &str, baseline: &str| {
        let [rx, _, path] = simulated(&folder, name, &scene(motion), "odom_rx_trajectory_");
        let baseline = ["--antennas", "A,B", "--baseline", baseline, "--elevation-max", "0", "--json"];
        let logs = ["bearing", "--rx", &rx, "--trajectory", &path, "--channel", "108"];
        let (status, out, err) = folder.run(&[&logs[..], &baseline].concat());
        (status, out.lines().next().map(json).unwrap_or_default(), err)
    };
    let (status, turned, err) = run("turn", "motion.circle = { radius_m = 0.0, duration_s = 5.0 }", "0.025,0,0");
    assert_eq!(status, 0, "{err}");
    // Of A against B the constant is that of B against A with the other sign.
    let [deg, sd_deg] = [0, 1].map(|k| turned["chain_constants_deg"][0][k].as_f64().unwrap());
    assert!((deg - 50.0).abs() < 4.0 * sd_deg && sd_deg < 2.0, "{deg} +- {sd_deg}");
    let alone = ["bearing", "--rx", "room.dat", "--trajectory", "t.csv", "--channel", "108", "--antennas", "A,B"];
    folder.says(&[&alone[..], &["--baseline", "0.1,0,0", "--range-min", "2"]].concat(), 2, &["--range-min need --tx"]);
    let (status, still, _) = run("still", "", "0.025,0,0");
    assert!(status != 0 && still["error"].as_str().unwrap().contains("constant between their chains"), "{still}");
    let (status, still, err) = run("still2", "", &format!("0.025,0,0,{deg},{sd_deg}"));
    assert_eq!(status, 0, "{err}");
    let truth_deg = 4.0_f64.atan2(3.0).to_degrees();
    let sides = ["azimuth_deg", "mirror_deg"].map(|key| still[key].as_f64().unwrap());
    let mirror_deg = 40.0 - truth_deg;
    assert!(sides.iter().any(|deg| (deg - truth_deg).abs() < 2.0), "{still}");
    assert!(sides.iter().any(|deg| (deg - mirror_deg).abs() < 2.0), "{still}");
    assert!(still["chain_constants_deg"].is_null() && still["azimuth_sd_deg"].as_f64().unwrap() < 3.0, "{still}");
    let (status, _, err) = run("wrong", "", "0.025,0,0,x");
    assert!(status == 2 && err.contains("degrees"), "{status} {err}");
}

/// The same with a second antenna on the robot that drives.
fn two_antennas() -> String {
    PAIR.replace("name = \"rx\"\n", "name = \"rx\"\nantenna_b_m = [0.03, 0.0, 0.0]\n")
}

/// Logs of every format, with what the pictures of each have to say: subcarriers at the edges, letters of its antennas.
const LOGS: [(&str, &str, [i64; 2], &str); 10] = [
    ("atheros/ath_csi_1.dat", "Atheros CSI tool", [-28, 28], "ABC"),
    ("esp32/example_csi.csv", "ESP32 CSV", [0, 0], "A"),
    ("esp32/example_data.csv", "ESP32 CSV", [0, 0], "A"),
    ("feitcsi/HESU20_5500.csi", "FeitCSI", [-122, 122], "AB"),
    ("feitcsi/HT20_2452.csi", "FeitCSI", [-28, 28], "AB"),
    ("feitcsi/VHT80_5500.csi", "FeitCSI", [-122, 122], "AB"),
    ("nexmon/example_43455c0.pcap", "nexmon pcap", [-122, 122], "A"),
    ("nexmon/example_4358.pcap", "nexmon pcap", [-122, 122], "AB"),
    ("picoscenes/picoscenes_ax200_example.csi", "PicoScenes", [0, 0], "AB"),
    ("picoscenes/rx_by_iwl5300.csi", "PicoScenes", [0, 0], "ABC"),
];

#[test]
fn logs_of_other_cards_are_drawn_with_what_their_formats_tell() {
    let folder = Folder::new("plot-cards");
    let [rx, ..] = simulated(&folder, "room", &two_antennas(), "rx_trajectory_");
    std::fs::rename(rx, folder.0.join("rx.csi")).unwrap();
    let row = &folder.rows(&["info", "rx.csi", "--plot", "p", "--json"], 0)[0];
    assert_eq!(row["pictures"].as_array().map(Vec::len), Some(4));
    let drawn = |what: &str| std::fs::read_to_string(folder.0.join(format!("p/{what}.svg"))).unwrap();
    let (csi, levels) = (drawn("rx-csi"), drawn("rx-levels"));
    // 242 subcarriers of HE at 20 MHz, of the only sender.
    for words in [">-122<", ">122<", "FeitCSI, from 02:", "HE 20 MHz", "antenna A:", "antenna B:"] {
        assert!(csi.contains(words), "no {words} in {csi}");
    }
    assert!(!csi.contains("antenna C") && !csi.contains("without") && !csi.contains("NaN"));
    assert!(levels.contains("RSSI of each antenna (dBm)") && !levels.contains("gain") && !levels.contains("NaN"));
    // The next run replaces them.
    folder.says(&["info", "rx.csi", "--plot", "p"], 0, &[]);
    folder.says(&["info", "rx.csi", "--plot", "b", "--antenna", "B", "--from", "1", "--to", "2"], 0, &[]);
    let only = std::fs::read_to_string(folder.0.join("b/rx-csi.svg")).unwrap();
    assert!(only.contains("antenna B:") && !only.contains("antenna A:"));
    folder.says(&["info", "rx.csi", "--plot", "d", "--antenna", "C"], 0, &["no CSI of these antennas"]);
    folder.says(&["info", "rx.csi", "--plot", "c", "--mac", "02:00:00:00:00:99"], 3, &["no matching record"]);

    let Some(cases) = crate::common::cases("other-cards") else { return };
    // One of each format: drawing takes its time.
    for (k, (name, format, [low, high], antennas)) in LOGS.into_iter().step_by(2).enumerate() {
        let log = cases.join(name);
        let into = format!("case-{k}");
        let (status, out, err) = folder.run(&["info", log.to_str().unwrap(), "--plot", &into, "--json"]);
        assert!(matches!(status, 0 | 3), "{name}: {status} {err}");
        let row = json(&out);
        assert_eq!(row["pictures"].as_array().map(Vec::len), Some(4), "{name}: {err}");
        let svg = |what: &str| {
            let path = row["pictures"].as_array().unwrap().iter().find(|path| path.as_str().unwrap().ends_with(what));
            std::fs::read_to_string(folder.0.join(path.unwrap().as_str().unwrap())).unwrap()
        };
        let (csi, levels) = (svg("-csi.svg"), svg("-levels.svg"));
        assert!(csi.contains(format) && !csi.contains("NaN") && !levels.contains("NaN"), "{name}");
        assert!(csi.len() < 12_000_000, "{name}: {} bytes", csi.len());
        if low < 0 {
            assert!(csi.contains(&format!(">{low}<")) && csi.contains(&format!(">{high}<")), "{name}");
        }
        for letter in "ABCD".chars() {
            assert_eq!(csi.contains(&format!("antenna {letter}:")), antennas.contains(letter), "{name}: {letter}");
        }
        assert!(!levels.contains("gain (AGC)"), "{name}");
    }
}

/// Where a page of `view` is served, once it is.
pub fn place(page: &mut Program) -> String {
    let mut address = String::new();
    BufReader::new(page.child.stdout.take().unwrap()).read_line(&mut address).unwrap();
    address.trim().trim_start_matches("http://").trim_end_matches('/').to_owned()
}

/// What it answers.
pub fn get(place: &str, path: &str) -> serde_json::Value {
    let mut stream = std::net::TcpStream::connect(place).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {place}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{path}: {answer}");
    json(answer.split_once("\r\n\r\n").unwrap().1)
}

/// What the page of a log is told.
fn asked(log: &str, paths: &[&str]) -> Vec<serde_json::Value> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    let mut page = Program::of(command.args(["view", log]).stdout(Stdio::piped()));
    let place = place(&mut page);
    paths.iter().map(|path| get(&place, path)).collect()
}

#[test]
fn the_page_shows_logs_of_other_cards() {
    let folder = Folder::new("view-cards");
    let [rx, ..] = simulated(&folder, "room", &two_antennas(), "rx_trajectory_");
    let paths = ["/data/log/0", "/data/log/0/levels?columns=50", "/data/log/0/csi?columns=50"];
    let answers = asked(&rx, &paths);
    let [facts, levels, csi] = answers.as_slice() else { panic!("{answers:?}") };
    assert_eq!(
        (&facts["format"], &facts["frames"], &facts["time_base"]),
        (&"FeitCSI".into(), &600.into(), &"card".into())
    );
    assert_eq!(facts["antennas"], serde_json::json!(["A", "B"]));
    assert!(facts["rssi_in_dbm"] == true && facts["senders"][0]["records"] == 600, "{facts}");
    assert!((facts["senders"][0]["rate_hz"].as_f64().unwrap() - 50.0).abs() < 1.0, "{facts}");
    assert_eq!(levels["rssi"].as_array().map(Vec::len), Some(2));
    assert!(levels["rssi"][0]["mean"][0].as_f64().unwrap() < 0.0 && levels["agc"]["mean"] == serde_json::json!([]));
    assert_eq!(
        (&csi["rows"], &csi["subcarriers"][0], &csi["frames"]),
        (&242.into(), &(-122).into(), &"HE 20 MHz".into())
    );
    assert_eq!(csi["antennas"].as_array().map(Vec::len), Some(2));
    let told: String = answers.iter().map(|answer| format!("{answer}\n")).collect();
    assert!(crate::documented::are_documented(&told) > 20);
    folder.write("words.csv", b"It was a dark and stormy night.\n");
    folder.says(&["view", "words.csv"], 1, &["is another kind of file, text"]);

    let Some(cases) = crate::common::cases("other-cards") else { return };
    for (name, format, _, antennas) in LOGS {
        let answers = asked(cases.join(name).to_str().unwrap(), &paths);
        let letters: String =
            answers[0]["antennas"].as_array().unwrap().iter().filter_map(|one| one.as_str()).collect();
        assert!(answers[0]["format"] == format && letters == antennas, "{name}: {}", answers[0]);
        let maps = answers[2]["antennas"].as_array().unwrap();
        assert_eq!(maps.len(), antennas.len(), "{name}");
    }
}

#[test]
fn info_takes_the_logs_of_a_folder() {
    let folder = Folder::new("info-folder");
    let scene = std::fs::read_to_string(crate::common::root().join("scenes/two-antennas.toml")).unwrap();
    simulated(&folder, "room", &scene, "odom_rx_");
    assert_eq!(folder.rows(&["info", "room", "--json"], 0).len(), 2);
    std::fs::create_dir(folder.0.join("empty")).unwrap();
    folder.says(&["info", "empty"], 1, &["no log in this folder"]);
}

#[test]
fn two_logs_and_two_antennas_give_one_answer() {
    let folder = Folder::new("both-kinds");
    let scene = std::fs::read_to_string(crate::common::root().join("scenes/two-antennas.toml")).unwrap();
    let scene = scene.replace("radius_m = 0.0", "radius_m = 0.05");
    let [rx, tx, path] = simulated(&folder, "room", &scene, "odom_rx_");
    let named = ["bearing", "--rx", &rx, "--trajectory", &path, "--channel", "108", "--json"];
    let antennas = ["--antennas", "A,B", "--baseline", "0.1,0,0"];
    let answer = &folder.rows(&[&named[..], &antennas, &["--tx", &tx]].concat(), 0)[0];
    // From the circle's middle.
    let off = answer["azimuth_deg"].as_f64().unwrap() - (5.0_f64 - 0.05).atan2(3.0).to_degrees();
    let kinds = answer["kinds_deg"].as_array().unwrap();
    assert!(off.abs() < 0.5 && kinds.len() == 2, "{off} {answer}");
    folder.says(&[&named[..], &antennas, &["--rx-mac", "02:53:00:00:00:01"]].concat(), 2, &["need --tx"]);
}
