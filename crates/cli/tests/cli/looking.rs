//! What people look at first: the demonstration, `info`, `export`, pictures; and how commands end.

use super::commands::{Folder, json};
use crate::common::link;
use driver_iface::bfee::{Bfee, Iq, Repr};
use driver_iface::record::{Record, code};
use std::path::Path;

/// The records of a log, each with its length field.
fn records(log: &[u8]) -> Vec<Vec<u8>> {
    let (mut rest, mut found) = (log, Vec::new());
    while let [high, low, ..] = rest {
        let (record, after) = rest.split_at(2 + usize::from(u16::from_be_bytes([*high, *low])));
        found.push(record.to_vec());
        rest = after;
    }
    found
}

/// A record with other header fields.
fn changed(record: &[u8], change: impl FnOnce(&mut Repr)) -> Vec<u8> {
    let bfee = Bfee::new_checked(&record[3..]).unwrap();
    let mut repr = Repr::parse(&bfee);
    change(&mut repr);
    let all = (0..30).flat_map(|k| (0..bfee.n_rx()).flat_map(move |rx| (0..bfee.n_tx()).map(move |tx| (k, rx, tx))));
    let csi: Vec<Iq> = all.map(|(k, rx, tx)| bfee.iq(k, rx, tx).unwrap()).collect();
    let mut body = vec![0; repr.body_len()];
    repr.emit(&csi, &mut body).unwrap();
    let record = Record { code: code::BFEE, body: &body };
    let mut bytes = vec![0; record.emit_len()];
    record.emit(&mut bytes).unwrap();
    bytes
}

#[test]
fn the_demonstration_prints_spreads_and_bearings_and_overwrites_only_its_own_files() {
    let folder = Folder::new("demo");
    let (status, out, err) = folder.run(&["demo", "--out", "d"]);
    assert_eq!(status, 0, "{err}");
    for stem in ["standing-phase", "circle-profile", "line-trajectory"] {
        assert!(out.contains(&format!("  picture d/{stem}.png\n")), "{out}");
        assert!(folder.0.join(format!("d/{stem}.svg")).is_file(), "{stem}");
    }
    assert!(!out.contains(".svg"), "{out}");
    let spread = |name: &str| -> f64 {
        let line = out.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("no {name}: {out}"));
        line.split(name).nth(1).unwrap().split_whitespace().next().unwrap().parse().unwrap()
    };
    let (one, product, taken_out) =
        (spread("one direction"), spread("both directions multiplied"), spread("the turn-around removed"));
    assert!(one > 0.9 && product < 0.75 * one && taken_out < 0.5 * product, "{out}");
    for name in ["circle", "line"] {
        let row = out.lines().find(|line| line.trim_start().starts_with(name)).unwrap();
        let number = |column: usize| -> f64 { row.split_whitespace().nth(column).unwrap().parse().unwrap() };
        // The line's error bar is that of its own side: the mirror, 22 degrees away, stands beside it.
        assert!(number(6).abs() < 0.5 && number(3) < 5.0, "{row}");
    }
    let (status, again, err) = folder.run(&["demo", "--out", "d"]);
    assert!(status == 0 && again == out, "{err}");
    // Robots at rest are no link that failed.
    let (status, out, err) = folder.run(&["evaluate", "d"]);
    assert!(status == 0 && out.contains("all: 2 links, 0 failed"), "{out}{err}");
    folder.write("d/mine.txt", b"");
    let (status, _, err) = folder.run(&["demo", "--out", "d"]);
    assert!(status == 1 && err.contains("--force"), "{err}");
}

#[test]
fn info_says_what_the_clock_did_and_nothing_of_what_was_not_measured() {
    let folder = Folder::new("info-clock");
    let log = link(300, 1.0).rx.concat();
    // After 150 records the card's clock falls back by 4 s, 50 later it is 6 s further.
    let jump = |k: usize, record: &Vec<u8>| match k {
        150..200 => changed(record, |repr| repr.timestamp_low = repr.timestamp_low.wrapping_sub(4_000_000)),
        200.. => changed(record, |repr| repr.timestamp_low = repr.timestamp_low.wrapping_add(2_000_000)),
        _ => record.clone(),
    };
    let all: Vec<u8> = records(&log).iter().enumerate().flat_map(|(k, record)| jump(k, record)).collect();
    folder.write("jump.dat", &all);
    let (_, out, _) = folder.run(&["info", "jump.dat"]);
    assert!(
        out.contains("1 step back, the furthest by 3.9") || out.contains("1 step back, the furthest by 4.0"),
        "{out}"
    );
    assert!(out.contains("1 pause of a second and more, the longest 6.0 s"), "{out}");
    assert!(out.contains("is the median between frames"), "{out}");
    let (_, out, _) = folder.run(&["info", "--json", "jump.dat"]);
    let row = json(&out);
    assert!(row["noise_dbm"].is_null() || row["noise_unknown"].as_u64() == Some(0), "{out}");
    let sender = row["senders"].as_object().unwrap().values().next().unwrap().clone();
    assert!(sender["rate_hz"].as_f64().unwrap() < 0.6 * sender["median_rate_hz"].as_f64().unwrap(), "{out}");
}

#[test]
fn what_has_no_scale_is_exported_as_no_number_and_counted() {
    let folder = Folder::new("export-scale");
    let silent = |k: usize, record: &Vec<u8>| match k {
        0..10 => changed(record, |repr| repr.rssi = [0; 3]),
        _ => record.clone(),
    };
    let log = link(40, 1.0).rx.concat();
    let all: Vec<u8> = records(&log).iter().enumerate().flat_map(|(k, record)| silent(k, record)).collect();
    folder.write("rx.dat", &all);
    let (status, _, err) = folder.run(&["export", "rx.dat", "rx.csv", "--scaled"]);
    assert!(status == 0 && err.contains("10 of 40 records have no scale"), "{err}");
    let text = std::fs::read_to_string(folder.0.join("rx.csv")).unwrap();
    let cells: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let at = cells[0].iter().position(|name| *name == "re_0_a_1").unwrap();
    assert!(cells[1..11].iter().all(|row| row[at].is_empty()) && cells[11..].iter().all(|row| !row[at].is_empty()));
    assert_eq!(folder.run(&["export", "rx.dat", "rx.npz"]).0, 0);
    let npz = std::fs::read(folder.0.join("rx.npz")).unwrap();
    let descr = |name: &str| {
        let from = npz.windows(name.len()).position(|window| window == name.as_bytes()).unwrap();
        let head = String::from_utf8_lossy(&npz[from..from + 200]).into_owned();
        head.split("'descr': '").nth(1).unwrap().split('\'').next().unwrap().to_owned()
    };
    assert_eq!(descr("timestamp_low.npy"), "<u4");
    assert_eq!(descr("noise_dbm.npy"), "|i1");
    assert_eq!(descr("host_us.npy"), "<i8");
    assert_eq!(descr("scale.npy"), "<f8");
}

#[test]
fn a_wsr_log_becomes_one_of_the_stock_layout_with_the_same_csi() {
    let folder = Folder::new("recover-stock");
    folder.link(&link(600, 2.0));
    for name in ["rx", "tx"] {
        let (log, stock) = (format!("{name}.dat"), format!("stock-{name}.dat"));
        let (status, _, err) = folder.run(&["export", "--dat", &log, &stock, "--layout", "stock"]);
        assert_eq!(status, 0, "{err}");
    }
    let (_, out, _) = folder.run(&["info", "stock-rx.dat"]);
    assert!(out.contains("stock layout, ") && out.contains("code 0xC1"), "{out}");
    let args = ["--trajectory", "t.csv", "--channel", "108", "--json"];
    let answer = |rx: &str, tx: &str| json(&folder.run(&[&["bearing", "--rx", rx, "--tx", tx][..], &args].concat()).1);
    let (wsr, stock) = (answer("rx.dat", "tx.dat"), answer("stock-rx.dat", "stock-tx.dat"));
    for key in ["azimuth_deg", "pairs", "pairs_in_motion", "mac"] {
        assert_eq!(wsr[key], stock[key], "{key}: {wsr}\n{stock}");
    }
    let side = std::fs::metadata(folder.0.join("stock-rx.datstp")).unwrap().len();
    assert_eq!(side as usize, 8 * records(&std::fs::read(folder.0.join("stock-rx.dat")).unwrap()).len());
}

#[test]
fn every_field_of_json_is_in_the_documentation() {
    let folder = Folder::new("formats");
    folder.link(&link(300, 2.0));
    let mut found = String::new();
    found += &folder.bearing(&["--json"]).1;
    found += &folder.run(&["info", "rx.dat", "--json"]).1;
    std::fs::create_dir_all(folder.0.join("c")).unwrap();
    for (name, file) in [("rx.dat", "csi_rx_1.dat"), ("tx.dat", "csi_tx_1.dat"), ("t.csv", "rx_movement_1.csv")] {
        std::fs::copy(folder.0.join(name), folder.0.join("c").join(file)).unwrap();
    }
    super::commands::capture(&folder, "tree/A", &link(300, 2.0));
    let commands = [
        &["bearing", "c", "--channel", "108", "--place", "tx=-416,909", "--json"][..],
        &["evaluate", "tree", "--json"],
        &["bearing", "c", "--channel", "108", "--transmitters", "--json"],
        &["simulate", "suite", "--only", "circle 10", "--repetitions", "1", "--out", "t.csv.suite", "--json"],
        &["demo", "--out", "demo", "--json"],
        &["simulate", "paper-circle", "--out", "room", "--json"],
        &["export", "--dat", "rx.dat", "again.dat", "--json"],
        &["export", "rx.dat", "rx.npz", "--json"],
        &["info", "rx.dat", "--plot", "p", "--json"],
        &["mcap", "rx.dat", "tx.dat", "--trajectory", "t.csv", "--channel", "108", "--out", "m.mcap", "--json"],
        &["doctor", "c", "--json"],
        &["setup", "--undo", "--interface", "none", "--json"],
    ];
    for command in commands {
        let (_, out, err) = folder.run(command);
        assert!(!out.is_empty(), "{command:?}: {err}");
        found += &out;
    }
    assert!(crate::documented::are_documented(&found) > 100, "{found}");
}

/// The page as one file holds an answer of every kind that `view` gives but a node's states, whose fields `node.rs` looks at.
#[test]
fn every_field_of_the_page_is_in_the_documentation() {
    let folder = Folder::new("page");
    super::commands::capture(&folder, "tree/A", &link(300, 2.0));
    let beside = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg\nA/1,tx2,gt,119.0,-1.0\n";
    folder.write("tree/links.csv", beside.as_bytes());
    let (status, _, err) = folder.run(&["evaluate", "tree", "--html", "page.html"]);
    assert_eq!(status, 0, "{err}");
    let page = std::fs::read_to_string(folder.0.join("page.html")).unwrap();
    let (_, rest) = page.split_once("id=\"answers\">").unwrap();
    let answers = json(rest.split_once("</script>").unwrap().0);
    let described = crate::documented::pages();
    let mut fields = 0;
    for (path, answer) in answers.as_object().unwrap() {
        let general: String = path.chars().map(|sign| if sign.is_ascii_digit() { 'N' } else { sign }).collect();
        let known = [format!("`{general}`"), format!("`{general}?")];
        assert!(known.iter().any(|path| described.contains(path)), "crates/view/src/lib.rs does not name {general}");
        // Sets stand by their names, as in the summary of `evaluate`.
        let by_set = serde_json::json!({ "summary": answer });
        fields +=
            crate::documented::are_documented(&if path == "/data/sets" { by_set } else { answer.clone() }.to_string());
    }
    assert!(fields > 100, "{fields} fields: {answers}");
}

#[test]
fn commands_end_alike() {
    let folder = Folder::new("ends");
    folder.link(&link(300, 2.0));
    assert_eq!(folder.bearing(&["--min-confidence", "1"]).0, 1, "the only link was refused");
    assert_eq!(folder.run(&["export", "rx.dat", "rx.xls"]).0, 2, "an extension that cannot be meant");
    assert_eq!(folder.bearing(&["--profile", "p.csv"]).0, 0);
    let (status, _, err) = folder.bearing(&["--profile", "p.csv"]);
    assert!(status == 1 && err.contains("p.csv already exists: --force overwrites it"), "{err}");
    assert_eq!(folder.bearing(&["--profile", "p.csv", "--force"]).0, 0);
    for command in
        [&["info", "none.dat"][..], &["export", "none.dat", "x.csv"], &["export", "--dat", "none.dat", "x.dat"]]
    {
        let (status, _, err) = folder.run(command);
        assert_eq!(status, 1, "{command:?}: {err}");
    }
    let built_in = ["simulate", "paper-line", "--out", "paper-line"];
    assert_eq!(folder.run(&built_in).0, 0, "a built-in scene by its name");
    let (status, _, err) = folder.run(&built_in);
    assert!(status == 1 && err.contains("--force") && !err.contains("cannot read"), "its folder is no scene: {err}");
    std::fs::create_dir(folder.0.join("room")).unwrap();
    let (status, _, err) = folder.run(&["simulate", "room", "--out", "again"]);
    assert!(status == 1 && err.contains("cannot read room: ") && err.matches("room").count() == 1, "{err}");
    let (_, help, _) = folder.run(&["--help"]);
    assert!(help.contains("Exit status of every command"), "{help}");
}

#[test]
fn a_log_is_drawn_with_what_is_asked_for() {
    let folder = Folder::new("plot");
    folder.link(&link(300, 2.0));
    let args = ["info", "rx.dat", "--plot", "p", "--antenna", "A", "--json"];
    let (status, out, err) = folder.run(&args);
    assert_eq!(status, 0, "{err}");
    assert_eq!(json(&out)["pictures"].as_array().map(Vec::len), Some(4));
    for what in ["csi", "levels"] {
        assert!(folder.0.join(format!("p/rx-{what}.png")).is_file());
        let svg = std::fs::read_to_string(folder.0.join(format!("p/rx-{what}.svg"))).unwrap();
        assert!(svg.contains("width=\"1200\"") && !svg.contains("NaN"), "{what}");
    }
    assert_eq!(folder.run(&args).0, 0, "the next run replaces them");
    let (status, _, err) = folder.run(&["info", "rx.dat", "--mac", "02:00:00:00:00:77", "--plot", "q"]);
    assert!(status == 3 && err.contains("no matching record"), "{status} {err}");
    assert_eq!(folder.run(&["info", "rx.dat", "--from", "1"]).0, 2, "nothing is drawn");
}

#[test]
fn logs_of_frames_only_and_of_zeros_say_why_they_are_of_no_use() {
    let folder = Folder::new("no-csi");
    folder.link(&link(60, 0.5));
    let (status, ..) = folder.run(&["export", "--dat", "rx.dat", "stock.dat", "--layout", "stock"]);
    assert_eq!(status, 0);
    // Each record: two bytes of length, then its code.
    let records = |keep: u8| {
        let bytes = std::fs::read(folder.0.join("stock.dat")).unwrap();
        let (mut rest, mut kept) = (&bytes[..], Vec::new());
        while rest.len() > 2 {
            let (record, after) = rest.split_at(2 + usize::from(u16::from_be_bytes([rest[0], rest[1]])));
            if record[2] == keep {
                kept.push(record.to_vec());
            }
            rest = after;
        }
        kept
    };
    folder.write("only_c1.dat", &records(0xC1).concat());
    let (status, out, _) = folder.run(&["info", "only_c1.dat"]);
    assert!(
        status == 1 && out.contains("only copies of frames (0xC1)") && out.contains("HT frames"),
        "{status}: {out}"
    );
    let mut silent = records(0xBB);
    // Behind length, code and the 20 bytes of the head.
    silent.iter_mut().for_each(|record| record[23..].fill(0));
    folder.write("csi0.dat", &silent.concat());
    let (status, out, _) = folder.run(&["info", "csi0.dat"]);
    assert!(status == 1 && out.contains("60 records have CSI of only zeros"), "{status}: {out}");
    let (_, out, _) = folder.run(&["info", "csi0.dat", "--json"]);
    assert_eq!(json(out.trim())["silent"], 60);
}

#[test]
fn names_are_written_out() {
    let folder = Folder::new("names");
    let (status, _, err) = folder.run(&["info", "a\nb\u{202e}tad.log"]);
    assert_eq!(status, 1);
    assert!(err.contains("a\\nb\\u202etad.log") && err.trim_end().lines().count() == 1, "{err}");
    // Also those that are found in a folder, and in a scene.
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
    let place = folder.0.join("tree/q\nb\u{202e}tad");
    std::fs::create_dir_all(&place).unwrap();
    for file in std::fs::read_dir(fixture).unwrap().map(|entry| entry.unwrap().path()) {
        std::fs::copy(&file, place.join(file.file_name().unwrap())).unwrap();
    }
    for command in ["bearing", "evaluate"] {
        let (status, out, err) = folder.run(&[command, "tree"]);
        assert!(status == 0 && out.contains("q\\nb\\u202etad/2023-11-14_221320/tx1"), "{out} {err}");
    }
    folder.write("evil.toml", b"channel = 108\nduration_s = 1.0\n[[robot]]\nname = \"t\\nb\"\n");
    let (status, _, err) = folder.run(&["simulate", "evil.toml", "--out", "out"]);
    assert!(status != 0 && err.contains("t\\nb: name goes into file names"), "{err}");
}
