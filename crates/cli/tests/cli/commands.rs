//! The command as its users meet it: answers, exit statuses, and what it says of bad input.

use crate::common::{Link, TRANSMITTER, link};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A folder of its own for one test, gone with it.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Writes a link's logs and trajectory.
    pub fn link(&self, link: &Link) {
        self.write("rx.dat", &link.rx.concat());
        self.write("tx.dat", &link.tx.concat());
        self.write("t.csv", link.trajectory.as_bytes());
    }

    pub fn run(&self, args: &[&str]) -> (i32, String, String) {
        let output =
            Command::new(env!("CARGO_BIN_EXE_csi5300")).current_dir(&self.0).args(args).stdin(Stdio::null()).output();
        let Output { status, stdout, stderr } = output.unwrap();
        let words = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        let stderr = words(stderr);
        assert!(!stderr.contains("panicked"), "{stderr}");
        (status.code().expect("no signal"), words(stdout), stderr)
    }

    pub fn bearing(&self, more: &[&str]) -> (i32, String, String) {
        let mut args = vec!["bearing", "--rx", "rx.dat", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108"];
        args.extend(more);
        self.run(&args)
    }
}

pub fn json(line: &str) -> serde_json::Value {
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
}

#[test]
fn files_are_told_apart_by_their_content() {
    let folder = Folder::new("roles");
    folder.link(&link(600, 2.0));
    let (_, by_option, _) = folder.bearing(&["--json"]);
    let azimuth = |out: &str| json(out.lines().next().expect("a line"))["azimuth_deg"].as_f64().expect("an azimuth");
    for files in [&["t.csv", "tx.dat", "rx.dat"][..], &["."]] {
        let (status, out, err) = folder.run(&[&["bearing"], files, &["--channel", "108", "--json"]].concat());
        assert_eq!((status, azimuth(&out)), (0, azimuth(&by_option)), "{err}");
        assert!(err.contains("rx.dat is the receiver's log"), "{err}");
    }
    // The page of the same folder has its link.
    let (status, _, err) = folder.run(&["evaluate", ".", "--channel", "108", "--html", "page.html"]);
    assert!(status == 0 && err.contains("page.html: 1 link,"), "{status} {err}");
    let (status, _, err) = folder.run(&["view", "rx.dat", "tx.dat"]);
    assert!(status == 2 && err.contains("into one folder"), "{status} {err}");
    let (status, _, err) = folder.run(&["evaluate", ".", "--channel", "108"]);
    assert!(status == 1 && err.contains("1 capture without one"), "{status} {err}");
    // Names that say nothing: only the receiver's host times lie within the trajectory.
    std::fs::rename(folder.0.join("rx.dat"), folder.0.join("a.dat")).unwrap();
    std::fs::rename(folder.0.join("tx.dat"), folder.0.join("b.dat")).unwrap();
    let (status, out, err) = folder.run(&["bearing", "b.dat", "a.dat", "t.csv", "--channel", "108", "--json"]);
    assert_eq!((status, azimuth(&out)), (0, azimuth(&by_option)), "{err}");
    // Of two trajectories one is named, and the other one left.
    std::fs::copy(folder.0.join("t.csv"), folder.0.join("u.csv")).unwrap();
    let both = ["bearing", "a.dat", "b.dat", "t.csv", "u.csv", "--channel", "108", "--json"];
    assert!(folder.run(&both).2.contains("add --trajectory t.csv"));
    let (status, out, err) = folder.run(&[&both[..], &["--trajectory", "u.csv"]].concat());
    assert_eq!((status, azimuth(&out)), (0, azimuth(&by_option)), "{err}");
    std::fs::copy(folder.0.join("a.dat"), folder.0.join("c.dat")).unwrap();
    // Named by options and by their content together. The last one is as a shell expands --tx tx*.dat: the third log is a link, too.
    let mixed = ["bearing", "--rx", "a.dat", "--channel", "108", "--json", "--tx", "b.dat", "t.csv"];
    let (status, out, err) = folder.run(&mixed);
    assert_eq!((status, azimuth(&out)), (0, azimuth(&by_option)), "{err}");
    let (_, out, err) = folder.run(&[&mixed[..], &["c.dat"]].concat());
    assert_eq!(out.lines().map(|line| json(line)["link"].clone()).collect::<Vec<_>>(), ["b", "c"], "{err}");
    for (words, said) in [
        (&["bearing", "a.dat", "c.dat", "t.csv", "--channel", "108"][..], "--rx a.dat --tx c.dat --trajectory t.csv"),
        (&["bearing", "a.dat", "t.csv", "--channel", "108"], "is the only log"),
        (&["bearing", "a.dat", "b.dat", "--channel", "108"], "is a trajectory"),
        (&["bearing", "a.dat", "b.dat", "t.csv"], "--channel is needed"),
        (&["bearing", ".", "--rx", "a.dat", "--channel", "108"], "one by one, or their folder"),
    ] {
        let (status, _, err) = folder.run(words);
        assert!(status != 0 && err.contains(said), "{words:?}: {status} {err}");
    }
}

#[test]
fn explain_says_what_was_computed_and_what_was_not() {
    let folder = Folder::new("explain");
    folder.link(&link(600, 2.0));
    let (status, out, _) = folder.bearing(&["--explain"]);
    assert_eq!(status, 0);
    for words in [
        "decoded: antenna A",
        "windows along the motion: taken",
        "search in single precision",
        "skipped: ",
        "directions evaluated",
    ] {
        assert!(out.contains(words), "{words}: {out}");
    }
    let (_, out, _) = folder.bearing(&["--explain", "--json", "--grid", "360x181"]);
    let plan = &json(&out)["plan"];
    let step = |name: &str| plan["steps"].as_array().unwrap().iter().find(|s| s["step"] == name).unwrap().clone();
    assert_eq!(step("windows along the motion")["taken"], true);
    assert_eq!(plan["profile"]["directions"], 65_160);
    assert!(plan["search"]["estimate_us"].as_f64().unwrap() > 0.0);
    assert!(json(&folder.bearing(&["--json"]).1)["plan"].is_null());
}

#[test]
fn a_bearing_with_everything_that_was_counted() {
    let folder = Folder::new("bearing");
    folder.link(&link(600, 2.0));
    let (status, out, err) = folder.bearing(&["--json"]);
    assert_eq!(status, 0, "{err}");
    let answer = json(&out);
    assert!((answer["azimuth_deg"].as_f64().unwrap() - 2f64.to_degrees()).abs() < 0.1, "{out}");
    assert_eq!(answer["mac"], TRANSMITTER.to_string());
    assert_eq!((answer["pairs"].as_u64(), answer["mirror_deg"].is_null()), (Some(600), true));
    let in_motion = answer["pairs_in_motion"].as_u64().unwrap();
    assert!((520..=560).contains(&in_motion), "{in_motion}");
    assert!((answer["cfo_hz"].as_f64().unwrap() - 5_000.0).abs() < 200.0, "{out}");
    assert!(answer["coherence"].as_f64().unwrap() > 0.98, "{out}");
    for key in ["azimuth_body_deg", "abs_elevation_deg", "azimuth_sd_deg", "confidence", "wsr_profile_variance"] {
        assert!(answer.get(key).is_some(), "no {key} in {out}");
    }
    let (_, text, _) = folder.bearing(&[]);
    assert!(text.contains("114.") && text.contains("GOOD") && text.lines().count() <= 4, "{text}");
    assert!(folder.bearing(&["-v"]).1.contains("600 pairs"));
}

#[test]
fn losses_before_the_tail_are_counted_and_change_the_status() {
    let folder = Folder::new("losses");
    let mut damaged = link(600, -1.0);
    damaged.rx[100].remove(7);
    damaged.rx[300] = vec![0x55; 100];
    folder.link(&damaged);
    let (status, out, err) = folder.bearing(&["--json"]);
    assert_eq!(status, 3, "{err}");
    assert_eq!(json(&out)["pairs"].as_u64(), Some(598), "{err}");
    assert!(err.contains("lost:") && err.contains("offset"), "{err}");
    // A cut last record is the normal end of a log.
    let mut cut = link(600, -1.0);
    cut.rx[599].truncate(100);
    folder.link(&cut);
    let (status, out, err) = folder.bearing(&["--json"]);
    assert_eq!((status, json(&out)["pairs"].as_u64()), (0, Some(599)), "{err}");
    assert!(err.contains("is cut"), "{err}");
}

#[test]
fn info_says_where_a_log_was_cut_and_why() {
    let folder = Folder::new("info");
    let bytes = link(100, 0.0).rx.concat();
    folder.write("cut.dat", &bytes[..2 * 4096]);
    let (status, out, _) = folder.run(&["info", "cut.dat"]);
    assert!(status == 0 && out.contains("the logger was killed before it flushed"), "{out}");
    assert!(out.contains("WSR layout, 35 bfee records") && out.contains("100.0 Hz"), "{out}");
    let (_, out, _) = folder.run(&["info", "--json", "cut.dat"]);
    assert_eq!(json(&out)["wsr"].as_u64(), Some(35));
}

#[test]
fn recover_keeps_every_intact_record_and_nothing_else() {
    let folder = Folder::new("recover");
    let mut log = link(50, 0.0).rx;
    let whole = log.clone();
    log[20].remove(30);
    folder.write("in.dat", &log.concat());
    let (status, _, err) = folder.run(&["export", "--dat", "in.dat", "out.dat"]);
    assert_eq!(status, 3, "{err}");
    let expected: Vec<u8> = whole.iter().enumerate().filter(|(k, _)| *k != 20).flat_map(|(_, r)| r.clone()).collect();
    assert_eq!(std::fs::read(folder.0.join("out.dat")).unwrap(), expected);
    let (status, _, err) = folder.run(&["export", "--dat", "in.dat", "out.dat"]);
    assert!(status == 1 && err.contains("--force"), "{err}");
    let (status, _, err) = folder.run(&["export", "--dat", "in.dat", "in.dat", "--force"]);
    assert!(status == 1 && err.contains("is an input"), "{err}");
    assert_eq!(std::fs::read(folder.0.join("in.dat")).unwrap(), log.concat());
}

#[test]
fn exports_hold_what_the_log_holds() {
    let folder = Folder::new("export");
    folder.write("log.dat", &link(20, 0.0).rx.concat());
    let (status, _, err) = folder.run(&["export", "log.dat", "log.csv"]);
    assert_eq!(status, 0, "{err}");
    let mut reader = csv::Reader::from_path(folder.0.join("log.csv")).unwrap();
    let header = reader.headers().unwrap().clone();
    let rows: Vec<_> = reader.records().map(Result::unwrap).collect();
    let column = |name: &str| header.iter().position(|column| column == name).unwrap_or_else(|| panic!("no {name}"));
    assert_eq!(rows.len(), 20);
    assert_eq!((&rows[7][column("frame_count")], &rows[7][column("antenna_sel")]), ("8", "36"));
    assert_eq!(&rows[7][column("mac")], TRANSMITTER.to_string());
    let power = |k: usize| {
        (0..2).map(|p| rows[k][column(["re_0_a_1", "im_0_a_1"][p])].parse::<f64>().unwrap().powi(2)).sum::<f64>()
    };
    assert!((0..20).all(|k| (power(k).sqrt() - 40.0).abs() < 1.0));
    let (status, _, err) = folder.run(&["export", "log.dat", "log.npz", "--scaled"]);
    assert_eq!(status, 0, "{err}");
    assert!(std::fs::read(folder.0.join("log.npz")).unwrap().starts_with(b"PK"));
    let (status, _, err) = folder.run(&["export", "log.dat", "log.xls"]);
    assert!(status == 2 && err.contains("exported as .csv, .npz"), "{err}");
}

#[test]
fn bad_logs_get_a_clear_word_and_no_bearing() {
    let folder = Folder::new("bad");
    folder.link(&link(100, 0.0));
    folder.write("empty.dat", b"");
    folder.write("text.dat", b"It was a dark and stormy night; the rain fell in torrents.\n".repeat(50).as_slice());
    folder.write("zero.dat", &[0; 5_000]);
    let mut long = vec![0x20, 0x00];
    long.extend([0xBB; 8_192]);
    folder.write("long.dat", &long);
    for (file, word) in [
        ("empty.dat", "empty"),
        ("text.dat", "another kind"),
        ("zero.dat", "lost"),
        ("long.dat", "lost"),
        ("none.dat", "No such file"),
    ] {
        let (status, out, err) = folder.run(&["info", file]);
        assert!(status == 1 && (out + &err).contains(word), "info {file}: {status} {err}");
        let (status, out, err) =
            folder.run(&["bearing", "--rx", file, "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108"]);
        assert_eq!(status, 1, "bearing {file}: {out} {err}");
        assert!(err.len() > 20, "{err}");
    }
    // Of a folder the logs are read, and the other files are named.
    let (status, out, err) = folder.run(&["info", "."]);
    assert!(
        status == 3 && out.contains("rx.dat") && err.contains("text.dat is another kind of file"),
        "{status} {out}{err}"
    );
    let (status, _, err) =
        folder.run(&["bearing", "--rx", ".", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108"]);
    assert!(status == 1 && err.contains("directory"), "{err}");
}

#[test]
fn impossible_records_are_dropped_one_by_one() {
    let folder = Folder::new("impossible");
    let bytes = link(60, 0.0).rx;
    // n_rx 0 and 4, a bad permutation, a wrong CSI length: offsets in the body are 8, 15 and 16; 3 bytes precede it.
    for (at, value, kept) in [(8 + 3, 0, 59), (8 + 3, 4, 59), (15 + 3, 0x3f, 60), (16 + 3, 7, 59)] {
        let mut log = bytes.clone();
        log[30][at] = value;
        folder.write("log.dat", &log.concat());
        let (status, out, err) = folder.run(&["info", "--json", "log.dat"]);
        assert_eq!(json(&out)["wsr"].as_u64(), Some(kept), "{at} {value}: {out} {err}");
        assert_eq!(status, if kept == 60 { 0 } else { 3 }, "{at} {value}");
        assert_eq!(json(&out)["bad_permutations"].as_u64(), Some(u64::from(kept == 60)), "{at} {value}");
        if kept == 60 {
            continue;
        }
        assert_eq!(json(&out)["losses"].as_array().map(Vec::len), Some(1), "{out}");
    }
}

#[test]
fn trajectories_that_do_not_fit_say_why() {
    let folder = Folder::new("trajectories");
    let made = link(100, 0.0);
    folder.link(&made);
    let (status, _, err) = folder.bearing(&["--clock-offset", "1000"]);
    assert!(status == 1 && err.contains("outside the trajectory") && err.contains("--clock-offset"), "{err}");
    folder.write("t.csv", b"a,b,c\n");
    let (status, _, err) = folder.bearing(&[]);
    assert!(status == 1 && err.contains("no row of numbers") && err.contains("t.csv"), "{err}");
    let still: String = (0..400).map(|k| format!("{},0,1,2,3\n", 1_700_000_000.0 + f64::from(k) * 0.01)).collect();
    folder.write("t.csv", still.as_bytes());
    let (status, _, err) = folder.bearing(&[]);
    assert!(status == 1 && err.contains("no motion"), "{err}");
    folder.write("t.csv", made.trajectory.as_bytes());
    let (status, _, err) = folder.bearing(&["--antenna-offset", "0.1,0,0"]);
    assert!(status == 1 && err.contains("heading"), "{err}");
    let (status, _, err) = folder.bearing(&["--antenna-offset", "0,0,0", "--camera-mount", "0.1,0,-2"]);
    assert!(status == 1 && err.contains("heading"), "{err}");
    // A path that rolls is that of the middle between the wheels: where the antenna is seen from there has to be said.
    let (status, _, err) = folder.bearing(&["--camera-mount", "0.1,0,-2"]);
    assert!(status == 2 && err.contains("--antenna-offset"), "{err}");
    let (status, _, err) = folder.run(&["evaluate", "--antenna-offset", "0.1,0,0", "."]);
    assert!(status == 2 && err.contains("motion capture tracks the antenna"), "{err}");
    let of_wheels = ["evaluate", "--trajectory", "odom", "--antenna-offset", "0,0,0", "--camera-mount", "0,0,0", "."];
    let (status, _, err) = folder.run(&of_wheels);
    assert!(status == 2 && err.contains("--trajectory t265"), "{err}");
}

#[test]
fn wrong_words_are_usage() {
    let folder = Folder::new("usage");
    for args in [&["bearing"][..], &["nonsense"], &["info"], &["bearing", "--channel", "17"]] {
        assert_eq!(folder.run(args).0, 2, "{args:?}");
    }
    assert_eq!(folder.run(&["--help"]).0, 0);
    assert_eq!(folder.run(&["evaluate", "."]).0, 1);
}

#[test]
fn one_log_that_cannot_be_read_costs_its_own_link_only() {
    let folder = Folder::new("unread");
    folder.link(&link(600, 2.0));
    let both = |more: &[&str]| folder.bearing(&[&["--tx", "gone.dat", "--json"], more].concat());
    let mac = TRANSMITTER.to_string();
    for more in [&[][..], &["--tx-mac", &mac, "--tx-mac", "02:00:00:00:00:77"]] {
        let (status, out, err) = both(more);
        let answers: Vec<_> = out.lines().map(json).collect();
        assert_eq!((status, answers.len(), answers[0]["error"].is_null()), (3, 2, true), "{out}{err}");
        assert!(answers[1]["link"] == "gone" && answers[1]["error"].as_str().unwrap().contains("gone.dat"), "{out}");
    }
    // A MAC that the receiver never heard: it says whom it heard.
    let (status, _, err) = folder.bearing(&["--tx-mac", "02:00:00:00:00:77"]);
    assert_eq!(status, 1, "{err}");
    assert!(err.contains(&format!("rx.dat has frames of: {mac} (600 records)")), "{err}");
}

#[test]
fn standard_input_is_a_log_too() {
    let folder = Folder::new("stdin");
    folder.link(&link(300, 0.5));
    let log = std::fs::File::open(folder.0.join("rx.dat")).unwrap();
    let args = ["bearing", "--rx", "-", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108", "--json"];
    let output =
        Command::new(env!("CARGO_BIN_EXE_csi5300")).current_dir(&folder.0).args(args).stdin(log).output().unwrap();
    assert!(output.status.success());
    let answer = json(&String::from_utf8(output.stdout).unwrap());
    assert!((answer["azimuth_deg"].as_f64().unwrap() - 0.5f64.to_degrees()).abs() < 0.2, "{answer}");
}

#[test]
fn profiles_are_written_on_the_grids_asked_for() {
    let folder = Folder::new("profile");
    folder.link(&link(300, 0.5));
    let (status, _, err) = folder.bearing(&["--profile", "p.csv", "--grid", "wsr"]);
    assert_eq!(status, 0, "{err}");
    let text = std::fs::read_to_string(folder.0.join("p.csv")).unwrap();
    assert_eq!(text.lines().count(), 1 + 360 * 90);
    let best = text.lines().skip(1).map(|l| l.split(',').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>());
    let best = best.max_by(|a, b| a[2].total_cmp(&b[2])).unwrap();
    assert!((best[0] - 0.5f64.to_degrees()).abs() < 1.1, "{best:?}");
    assert_eq!(folder.bearing(&["--profile", "p.npz", "--grid", "72x19"]).0, 0);
    assert_eq!(folder.bearing(&["--grid", "7y"]).0, 2);
}

/// Writes a link as a capture folder that `evaluate` reads.
pub fn capture(folder: &Folder, name: &str, link: &Link) {
    std::fs::create_dir_all(folder.0.join(name)).unwrap();
    let truth = r#"{"channel": {"value": 108}, "true_tx_positions": {"value": {"tx2": {"position": {"x": -500.0, "y": 866.0, "z": 0}}}}}"#;
    folder.write(&format!("{name}/groundtruth_positions.json"), truth.as_bytes());
    folder.write(&format!("{name}/csi_rx_1.dat"), &link.rx.concat());
    folder.write(&format!("{name}/csi_tx2_1.dat"), &link.tx.concat());
    folder.write(&format!("{name}/rx_trajectory_1_.csv"), link.trajectory.as_bytes());
}

#[test]
fn an_evaluation_reports_bad_captures_and_goes_on() {
    let folder = Folder::new("evaluate");
    let made = link(400, 2.0 * std::f64::consts::FRAC_PI_3);
    capture(&folder, "tree/A/good", &made);
    let (status, out, err) = folder.run(&["evaluate", "tree", "--json"]);
    let rows: Vec<_> = out.lines().map(json).collect();
    assert_eq!((status, rows.len()), (0, 2), "{err}");
    assert_eq!(rows[0]["link"], "A/good/1/tx2");
    // Units stand below the heads.
    let (_, text, _) = folder.run(&["evaluate", "tree"]);
    let units: Vec<&str> = text.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(units, ["deg", "deg", "deg", "deg", "deg", "%"], "{text}");
    assert!(rows[0]["error_from_mean_pose_deg"].as_f64().unwrap().abs() < 0.3, "{out}");
    assert_eq!(rows[1]["summary"]["A"]["links"], 1);
    // A damaged record, a missing receiver's log, no truth to read.
    let mut damaged = link(400, 2.0);
    damaged.rx[50].remove(9);
    capture(&folder, "tree/A/damaged", &damaged);
    capture(&folder, "tree/B/without_rx", &made);
    std::fs::remove_file(folder.0.join("tree/B/without_rx/csi_rx_1.dat")).unwrap();
    capture(&folder, "tree/B/no_truth", &made);
    folder.write("tree/B/no_truth/groundtruth_positions.json", b"{");
    let (status, out, err) = folder.run(&["evaluate", "tree", "--json"]);
    let rows: Vec<_> = out.lines().map(json).collect();
    assert_eq!((status, rows.len()), (3, 5), "{out}");
    assert!(err.contains("damaged/csi_rx_1.dat: 1 damaged stretches"), "{err}");
    let failed = rows.iter().filter(|row| row["azimuth_deg"].is_null() && row["error"].is_string());
    assert_eq!(failed.count(), 2, "{out}");
    assert!(rows[4]["summary"]["B"]["from_mean_pose"]["mean_deg"].is_null(), "{out}");
}

#[test]
fn a_simulated_capture_is_compared_with_the_scene_it_came_from() {
    let folder = Folder::new("compare");
    let text = "duration_s = 4.0\nchannel = 36\n[sounding]\nrate_hz = 100\n[radio]\nnoise.snr_db = 20.0\n[[robot]]\nname = \"rx\"\n\
                motion.circle = { radius_m = 0.2, duration_s = 4.0 }\n[[robot]]\nname = \"tx\"\nposition_m = [4.0, 1.0, 0.0]\n";
    folder.write("scene.toml", text.as_bytes());
    let (status, said, error) = folder.run(&["simulate", "scene.toml", "--out", "capture"]);
    assert_eq!(status, 0, "{said}{error}");
    let stamp = "2023-11-14_221320";
    let [rx, tx, path] =
        [format!("csi_rx_{stamp}.dat"), format!("csi_tx1_{stamp}.dat"), format!("rx_trajectory_{stamp}_.csv")]
            .map(|name| format!("capture/{name}"));
    let recorded = ["simulate", "--rx", &rx, "--tx", &tx, "--trajectory", &path, "--out", "out", "--force"];
    // With the scene itself, and with the folder that it wrote: nothing differs.
    for with in ["scene.toml", "capture"] {
        let (status, said, error) = folder.run(&[&recorded[..], &[with]].concat());
        assert_eq!(status, 0, "{said}{error}");
        assert!(said.contains(" figures agree, 0 differ"), "{said}");
    }
    // The channel is theirs; without them it has to be given.
    for with in ["scene.toml", "capture"] {
        assert_eq!(folder.run(&[&recorded[..], &[with, "--channel", "36"]].concat()).0, 0, "{with}");
        let (status, _, error) = folder.run(&[&recorded[..], &[with, "--channel", "34+"]].concat());
        assert_eq!(status, 1, "{with}: {error}");
        let (status, _, error) = folder.run(&[&recorded[..], &[with, "--channel", "108"]].concat());
        assert!(status == 1 && error.contains("is of channel 36") && error.contains("not of --channel 108"), "{error}");
    }
    let (status, _, error) = folder.run(&recorded);
    assert!(status == 2 && error.contains("--channel"), "{error}");
    let (_, said, _) = folder.run(&[&recorded[..], &["capture", "--json"]].concat());
    let rows: Vec<_> = said.lines().map(json).collect();
    assert!(rows.len() > 80 && rows.iter().all(|row| row["recorded"] == row["simulated"]), "{said}");
    let (status, _, error) = folder.run(&[&recorded[..], &["nowhere.toml"]].concat());
    assert!(status == 1 && error.contains("nowhere.toml"), "{error}");
}

#[test]
fn the_suite_writes_a_row_for_each_repetition() {
    let folder = Folder::new("suite");
    let (status, said, error) =
        folder.run(&["simulate", "suite", "--only", "circle 10", "--repetitions", "3", "--out", "rows.csv"]);
    assert_eq!(status, 0, "{said}{error}");
    let rows = std::fs::read_to_string(folder.0.join("rows.csv")).unwrap();
    assert_eq!(rows.lines().count(), 4, "{rows}");
    let page = std::fs::read_to_string(crate::common::root().join("docs/reference/formats.md")).unwrap();
    let table = page.split("## Tables: `simulate suite --out`").nth(1).unwrap().split("\n## ").next().unwrap();
    let described = table.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    let columns: Vec<&str> = rows.lines().next().unwrap().split(',').collect();
    assert_eq!(described.collect::<Vec<_>>(), columns);
    assert!(rows.lines().skip(1).all(|row| row.starts_with("circle 10 cm,")), "{rows}");
    let (status, _, error) = folder.run(&["simulate", "suite", "--only", "triangle"]);
    assert!(status == 2 && error.contains("line 30 cm"), "{error}");
}

#[test]
fn several_links_to_known_places_locate_the_receiver_and_old_names_say_the_new_ones() {
    let folder = Folder::new("located");
    let (status, _, err) = folder.run(&["simulate", "lab-circle", "--out", "room"]);
    assert_eq!(status, 0, "{err}");
    let (status, out, err) = folder.run(&["bearing", "room"]);
    assert!(status == 0 && out.contains("truth ") && !out.contains("located from"), "one link is no place: {out}{err}");
    let (status, moved, err) = folder.run(&["explain", "room"]);
    assert!(err.contains("`csi5300 explain` is `csi5300 bearing --explain` now"), "{err}");
    assert_eq!((status, &moved), (0, &folder.run(&["bearing", "--explain", "room"]).1));
    let (_, all, _) = folder.run(&["help", "--all"]);
    for words in
        ["  key ", "  completions ", "  locate       csi5300 bearing\n", "  respond      csi5300 sound --answer\n"]
    {
        assert!(all.contains(words), "{words}: {all}");
    }
    let (_, short, _) = folder.run(&["bearing", "-h"]);
    assert!(short.lines().count() <= 28, "{short}");
    for words in ["--channel", "--antenna-offset", "--json", "--verbose"] {
        assert!(short.contains(words), "{words}: {short}");
    }
}

#[test]
fn a_link_of_a_capture_is_explained_with_pictures() {
    let folder = Folder::new("explained");
    capture(&folder, "place", &link(600, 2.0));
    let (status, out, err) = folder.run(&["bearing", "place/tx2", "--explain", "--plot", "link"]);
    assert_eq!(status, 0, "{err}");
    for part in ["turn-around", "candidates", "answer", "truth"] {
        assert!(out.contains(part), "{part}: {out}");
    }
    let drawn: Vec<String> = std::fs::read_dir(folder.0.join("link"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    for part in ["trajectory.png", "profile.png", "phase.png", "map-1.svg"] {
        assert!(drawn.iter().any(|name| name.ends_with(part)), "{part}: {drawn:?}");
    }
    assert_eq!(folder.run(&["bearing", "place/tx9"]).0, 1);
    assert_eq!(folder.run(&["bearing", "place", "--tx", "tx.dat"]).0, 2, "a capture has its logs");
}
