//! The commands as their users meet them: answers, exit statuses, how much they say and in which colours, and what they say of the wrong
//! file.

use crate::cards::simulated;
use crate::common::{Link, TRANSMITTER, emitted, link};
use crate::private::inside;
use driver_iface::bfee::{Bfee, Iq, Repr};
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

    /// The same for this test in namespaces of its own, by these options of unshare(1).
    pub fn inside<T>(_: T, options: &str, name: &str) -> Option<Self> {
        inside(std::any::type_name::<T>(), options).then(|| Self::new(name))
    }

    /// Mounts a disk of so many bytes over one of its folders; `None`, said, where that cannot be done.
    pub fn mount(&self, below: &str, size: &str) -> Option<PathBuf> {
        let disk = self.0.join(below);
        let size = format!("size={size}");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "none"]).arg(&disk).status();
        if mounted.is_ok_and(|status| status.success()) {
            return Some(disk);
        }
        crate::common::skipped("a tmpfs cannot be mounted here");
        None
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
        self.run(&[&of("rx.dat", "tx.dat", "t.csv")[..], more].concat())
    }

    /// Runs a command that has to end with this status and to say all these words on standard error; gives its output and
    /// what it said.
    pub fn says(&self, args: &[&str], expected: i32, words: &[&str]) -> (String, String) {
        checked(self.run(args), args, expected, words)
    }

    /// The lines of JSON of a command that has to end with this status.
    pub fn rows(&self, args: &[&str], expected: i32) -> Vec<serde_json::Value> {
        self.says(args, expected, &[]).0.lines().map(json).collect()
    }

    /// The azimuth of a bearing that has to be made, degrees.
    pub fn azimuth_deg(&self, more: &[&str]) -> f64 {
        azimuth_deg(&self.bearing_says(&[&["--json"], more].concat(), 0, &[]).0)
    }

    /// The same of a bearing.
    pub fn bearing_says(&self, more: &[&str], expected: i32, words: &[&str]) -> (String, String) {
        checked(self.bearing(more), more, expected, words)
    }
}

/// The azimuth of the first link in lines of JSON.
fn azimuth_deg(out: &str) -> f64 {
    json(out.lines().next().expect("a line"))["azimuth_deg"].as_f64().expect("an azimuth")
}

/// The words of a bearing of these files.
pub fn of<'a>(rx: &'a str, tx: &'a str, trajectory: &'a str) -> [&'a str; 9] {
    ["bearing", "--rx", rx, "--tx", tx, "--trajectory", trajectory, "--channel", "108"]
}

fn checked(
    (status, out, err): (i32, String, String),
    args: &[&str],
    expected: i32,
    words: &[&str],
) -> (String, String) {
    assert_eq!(status, expected, "{args:?}: {out}{err}");
    words.iter().for_each(|words| assert!(err.contains(words), "{args:?} does not say `{words}`: {err}"));
    (out, err)
}

pub fn json(line: &str) -> serde_json::Value {
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
}

#[test]
fn files_are_told_apart_by_their_content() {
    let folder = Folder::new("roles");
    folder.link(&link(600, 2.0));
    let by_option = folder.azimuth_deg(&[]);
    for files in [&["t.csv", "tx.dat", "rx.dat"][..], &["."]] {
        let (status, out, err) = folder.run(&[&["bearing"], files, &["--channel", "108", "--json"]].concat());
        assert_eq!((status, azimuth_deg(&out)), (0, by_option), "{err}");
        assert!(err.contains("rx.dat is the receiver's log"), "{err}");
    }
    // What a shell makes of `*` has side files and the truth.
    std::fs::create_dir(folder.0.join("all")).unwrap();
    for log in ["rx.dat", "tx.dat"] {
        folder.says(&["export", "--dat", log, &format!("all/{log}"), "--layout", "stock"], 0, &[]);
    }
    std::fs::copy(folder.0.join("t.csv"), folder.0.join("all/t.csv")).unwrap();
    folder.write("all/groundtruth_positions.json", b"{}");
    let all = ["groundtruth_positions.json", "rx.dat", "rx.datstp", "t.csv", "tx.dat", "tx.datstp"];
    let all = all.map(|name| format!("all/{name}"));
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    folder.says(&[&["bearing", "--channel", "108"], &all[..]].concat(), 0, &["rx.dat is the receiver's log"]);
    let beside_none = "all/rx.datstp is another kind of file, host times";
    folder.says(&[&["bearing", "--channel", "108", "rx.dat"], &all[2..]].concat(), 1, &[beside_none]);
    folder.says(&["info", "all/rx.dat", "all/rx.datstp"], 3, &[beside_none]);
    // The page of the same folder has its link.
    folder.says(&["evaluate", ".", "--channel", "108", "--html", "page.html"], 0, &["page.html: 1 link,"]);
    folder.says(&["view", "rx.dat", "tx.dat"], 2, &["into one folder"]);
    folder.says(&["evaluate", ".", "--channel", "108"], 1, &["1 capture without one"]);
    // Names that say nothing: only the receiver's host times lie within the trajectory.
    std::fs::rename(folder.0.join("rx.dat"), folder.0.join("a.dat")).unwrap();
    std::fs::rename(folder.0.join("tx.dat"), folder.0.join("b.dat")).unwrap();
    let (status, out, err) = folder.run(&["bearing", "b.dat", "a.dat", "t.csv", "--channel", "108", "--json"]);
    assert_eq!((status, azimuth_deg(&out)), (0, by_option), "{err}");
    // Of two trajectories one is named, and the other one left.
    std::fs::copy(folder.0.join("t.csv"), folder.0.join("u.csv")).unwrap();
    let both = ["bearing", "a.dat", "b.dat", "t.csv", "u.csv", "--channel", "108", "--json"];
    assert!(folder.run(&both).2.contains("add --trajectory t.csv"));
    let (status, out, err) = folder.run(&[&both[..], &["--trajectory", "u.csv"]].concat());
    assert_eq!((status, azimuth_deg(&out)), (0, by_option), "{err}");
    std::fs::copy(folder.0.join("a.dat"), folder.0.join("c.dat")).unwrap();
    // Named by options and by their content together. The last one is as a shell expands --tx tx*.dat: the third log is a link, too.
    let mixed = ["bearing", "--rx", "a.dat", "--channel", "108", "--json", "--tx", "b.dat", "t.csv"];
    let (status, out, err) = folder.run(&mixed);
    assert_eq!((status, azimuth_deg(&out)), (0, by_option), "{err}");
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
    let (out, _) = folder.bearing_says(&["--explain"], 0, &[]);
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
    let (out, _) = folder.bearing_says(&["--json"], 0, &[]);
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
    let (out, err) = folder.bearing_says(&["--json"], 3, &[]);
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
    let (out, _) = folder.says(&["info", "cut.dat"], 0, &[]);
    assert!(out.contains("the logger was killed before it flushed"), "{out}");
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
    folder.says(&["export", "--dat", "in.dat", "out.dat"], 3, &[]);
    let expected: Vec<u8> = whole.iter().enumerate().filter(|(k, _)| *k != 20).flat_map(|(_, r)| r.clone()).collect();
    assert_eq!(std::fs::read(folder.0.join("out.dat")).unwrap(), expected);
    folder.says(&["export", "--dat", "in.dat", "out.dat"], 1, &["--force"]);
    folder.says(&["export", "--dat", "in.dat", "in.dat", "--force"], 1, &["is an input"]);
    assert_eq!(std::fs::read(folder.0.join("in.dat")).unwrap(), log.concat());
}

#[test]
fn exports_hold_what_the_log_holds() {
    let folder = Folder::new("export");
    folder.write("log.dat", &link(20, 0.0).rx.concat());
    folder.says(&["export", "log.dat", "log.csv"], 0, &[]);
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
    folder.says(&["export", "log.dat", "log.npz", "--scaled"], 0, &[]);
    assert!(std::fs::read(folder.0.join("log.npz")).unwrap().starts_with(b"PK"));
    folder.says(&["export", "log.dat", "log.xls"], 2, &["exported as .csv, .npz"]);
    // Records of the stock layout name no sender.
    folder.write("stock.dat", &changed(&link(20, 0.0).rx[0], |repr| repr.wsr = None));
    folder.says(&["export", "stock.dat", "stock.csv"], 0, &[]);
    let text = std::fs::read_to_string(folder.0.join("stock.csv")).unwrap();
    let row: Vec<&str> = text.lines().nth(1).unwrap().split(',').collect();
    assert_eq!(["host_us", "frame_count", "mac"].map(|name| row[column(name)]), [""; 3]);
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
        ("/dev/full", "/dev/full has no end"),
    ] {
        let (out, err) = folder.says(&["info", file], 1, &[]);
        assert!((out + &err).contains(word));
        let (_, err) = folder.says(&of(file, "tx.dat", "t.csv"), 1, &[]);
        assert!(err.len() > 20, "{err}");
    }
    // Of a folder the logs are read, and the other files are named.
    let (out, _) = folder.says(&["info", "."], 3, &["text.dat is another kind of file"]);
    assert!(out.contains("rx.dat"), "{out}");
    folder.says(&of(".", "tx.dat", "t.csv"), 1, &["directory"]);
}

#[test]
fn trajectories_that_do_not_fit_say_why() {
    let folder = Folder::new("trajectories");
    let made = link(100, 0.0);
    folder.link(&made);
    folder.bearing_says(&["--clock-offset", "1000"], 1, &["outside the trajectory", "--clock-offset"]);
    folder.write("t.csv", b"a,b,c\n");
    folder.bearing_says(&[], 1, &["no row of numbers", "t.csv"]);
    let still: String = (0..400).map(|k| format!("{},0,1,2,3\n", 1_700_000_000.0 + f64::from(k) * 0.01)).collect();
    folder.write("t.csv", still.as_bytes());
    folder.bearing_says(&[], 1, &["no motion"]);
    folder.write("t.csv", made.trajectory.as_bytes());
    folder.bearing_says(&["--antenna-offset", "0.1,0,0"], 1, &["heading"]);
    folder.bearing_says(&["--antenna-offset", "0,0,0", "--camera-mount", "0.1,0,-2"], 1, &["heading"]);
    // A path that rolls is that of the middle between the wheels: where the antenna is seen from there has to be said.
    folder.bearing_says(&["--camera-mount", "0.1,0,-2"], 2, &["--antenna-offset"]);
    folder.says(&["evaluate", "--antenna-offset", "0.1,0,0", "."], 2, &["motion capture tracks the antenna"]);
    let of_wheels = ["evaluate", "--trajectory", "odom", "--antenna-offset", "0,0,0", "--camera-mount", "0,0,0", "."];
    folder.says(&of_wheels, 2, &["--trajectory t265"]);
}

#[test]
fn what_would_be_ignored_is_usage() {
    let folder = Folder::new("ignored");
    folder.link(&link(300, 2.0));
    folder.write("desk.toml", b"near = \"rx.dat\"\nchannel = \"108\"\ntrajectory = \"t.csv\"\nazimuth_deg = 1690\n");
    std::fs::create_dir(folder.0.join("set")).unwrap();
    for (from, to) in [("rx.dat", "csi_rx_1.dat"), ("tx.dat", "csi_tx1_1.dat"), ("t.csv", "rx_trajectory_1_.csv")] {
        std::fs::copy(folder.0.join(from), folder.0.join("set").join(to)).unwrap();
    }
    for (args, words) in [
        ("bearing", "Usage"),
        ("info", "Usage"),
        ("nonsense", "'nonsense'"),
        ("bearing --channel 17", "`17` is no channel"),
        ("bearing rx.dat tx.dat t.csv --channel 108 --place tx=1,2", "--place needs a capture"),
        ("bearing rx.dat tx.dat t.csv --channel 108 --transmitters", "--transmitters needs a capture"),
        ("bearing rx.dat tx.dat t.csv --channel 108 --factors f.json", "--ranges and --factors need a capture"),
        ("bearing set --channel 108 --bag b.mcap", "--bag applies to single logs"),
        ("bearing set --channel 108 --transmitters --plot p", "'--transmitters' cannot be used with '--plot"),
        ("bearing set --channel 108 --transmitters --min-confidence 0.5", "cannot be used with '--min-confidence"),
        ("doctor --accept desk.toml", "from -360 to 360 degrees"),
        ("mcap rx.dat --out o.mcap --antenna A,B", "the CSI of one antenna"),
        ("mcap rx.dat --out o.mcap --from 1", "all records are written"),
        ("mcap rx.dat --out o.mcap --channel 108", "--trajectory"),
        ("mcap rx.dat --out o.mcap --trajectory t.csv --channel 108", "a transmitter's log"),
        ("info rx.dat --plot p --from nan", "is not a stretch of time"),
        ("info rx.dat --plot p --from 2 --to 1", "from 2 to 1 seconds"),
        ("info - -", "standard input can be one log only"),
        ("bearing set --channel 108 --tx tx.dat", "instead of its folder"),
        ("view x.dat --listen 8080", "127.0.0.1:8080"),
        ("view x.dat --listen :9000", "127.0.0.1:9000"),
        ("view x.dat --listen localhost:1", "an IP address and a port"),
        ("bearing --tx-mac 00:21:6a:53:89 a.dat b.dat t.csv", "six hexadecimal octets like 00:21:6a:53:89:d2"),
        ("doctor . --listen 1s", "not of a copy"),
        ("simulate lab-circle --out room --channel 36", "--rx, --tx and --trajectory"),
        ("simulate lab-circle --serve --socket s --speed 2", "do not go together"),
        ("sound --interface lo --peers 00:21:6a:53:89:d2 --rate 0", "is no rate"),
        ("sound --interface lo --peers 00:21:6a:53:89:d2 --mcs 24", "24 is not in 0..=23"),
    ] {
        folder.says(&args.split(' ').collect::<Vec<_>>(), 2, &[words]);
    }
    for (args, words) in [
        ("--answer --interface mon0 --dialect wsr", "--ack-len"),
        ("--answer --interface mon0 --ack-len 57", "--dialect wsr"),
        ("--answer --interface mon0 --dialect wsr --ack-len 58", "two bytes more"),
        ("--interface mon0 --trajectory t.csv", "--channel"),
        ("--interface m --trajectory t --channel 64 --heading-sd 181", "0 to 180 degrees"),
        ("--interface m --dialect wsr --trajectory t --channel 64", "measurements"),
        ("--interface m --bearing-every=1s", "--trajectory"),
        ("--interface m --stock", "--trajectory"),
        ("--interface m --connector-index=26", "--trajectory"),
    ] {
        let args: Vec<&str> = ["sound", "--peers", "02:00:00:00:01:00"].into_iter().chain(args.split(' ')).collect();
        folder.says(&args, 2, &[words]);
    }
    let peers: Vec<String> = (0..32).map(|k| format!("02:00:00:00:01:{k:02x}")).collect();
    let peers = peers.join(",");
    let args = ["sound", "--interface", "mon0", "--peers", &peers, "--rate", "100"];
    folder.says(&args, 2, &["do not fit", "try --rate 4"]);
    for driver in ["wsr", "stock"] {
        let args = ["setup", "--interface", "x0", "--channel", "64", "--role", "initiator", "--driver", driver];
        folder.says(&[&args[..], &["--ack-len", "57"]].concat(), 1, &["leave out --ack-len"]);
    }
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
    let (_, err) = folder.bearing_says(&["--tx-mac", "02:00:00:00:00:77"], 1, &[]);
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
    folder.bearing_says(&["--profile", "p.csv", "--grid", "wsr"], 0, &[]);
    let text = std::fs::read_to_string(folder.0.join("p.csv")).unwrap();
    assert_eq!(text.lines().count(), 1 + 360 * 90);
    let best = text.lines().skip(1).map(|l| l.split(',').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>());
    let best = best.max_by(|a, b| a[2].total_cmp(&b[2])).unwrap();
    assert!((best[0] - 0.5f64.to_degrees()).abs() < 1.1, "{best:?}");
    assert_eq!(folder.bearing(&["--profile", "p.npz", "--grid", "72x19"]).0, 0);
    assert_eq!(folder.bearing(&["--profile", "p.npz", "--grid", "7y"]).0, 2);
    folder.bearing_says(&["--grid", "72"], 2, &["--profile"]);
    for file in ["none/p.npz", "none/p.csv"] {
        folder.bearing_says(&["--profile", file], 1, &[&format!("cannot write {file}: No such file")]);
    }
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
    let rows = folder.rows(&["evaluate", "tree", "--json"], 0);
    assert_eq!((rows.len(), rows[0]["link"].as_str()), (2, Some("A/good/1/tx2")));
    // Units stand below the heads.
    let (_, text, _) = folder.run(&["evaluate", "tree"]);
    let units: Vec<&str> = text.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(units, ["deg", "deg", "deg", "deg", "deg", "%"], "{text}");
    assert!(rows[0]["error_from_mean_pose_deg"].as_f64().unwrap().abs() < 0.3, "{rows:?}");
    assert_eq!(rows[1]["summary"]["A"]["links"], 1);
    // A truth with the places of others.
    capture(&folder, "named/A", &made);
    folder.write("named/A/groundtruth_positions.json", br#"{"channel": {"value": 108}}"#);
    let (_, text, _) = folder.run(&["evaluate", "named"]);
    assert!(text.contains("\nall: 1 link, 0 failed, 1 without a truth; from the mean pose -;"), "{text}");
    // A damaged record, a missing receiver's log, no truth to read.
    let mut damaged = link(400, 2.0);
    damaged.rx[50].remove(9);
    capture(&folder, "tree/A/damaged", &damaged);
    capture(&folder, "tree/B/without_rx", &made);
    std::fs::remove_file(folder.0.join("tree/B/without_rx/csi_rx_1.dat")).unwrap();
    capture(&folder, "tree/B/no_truth", &made);
    folder.write("tree/B/no_truth/groundtruth_positions.json", b"{");
    let (out, _) = folder.says(&["evaluate", "tree", "--json"], 3, &["damaged/csi_rx_1.dat: 1 damaged stretches"]);
    let rows: Vec<_> = out.lines().map(json).collect();
    assert_eq!(rows.len(), 5, "{out}");
    let failed = rows.iter().filter(|row| row["azimuth_deg"].is_null() && row["error"].is_string());
    assert_eq!(failed.count(), 2, "{out}");
    assert!(rows[4]["summary"]["B"]["from_mean_pose"]["mean_deg"].is_null(), "{out}");
}

#[test]
fn nothing_of_an_earlier_room_is_taken_for_a_part_of_the_new_one() {
    let folder = Folder::new("earlier");
    let scene = |more: &str| {
        format!(
            "duration_s = 4.0\n[sounding]\nrate_hz = 100\n[radio]\nnoise.snr_db = 20.0\n[[robot]]\nname = \"rx\"\n\
             motion.circle = {{ radius_m = 0.3, duration_s = 4.0 }}\n[[robot]]\nname = \"tx\"\nposition_m = [3.0, 5.0, 0.0]\n{more}"
        )
    };
    // A transmitter that drives, another robot, and side files with host times.
    let third =
        "motion.line = { length_m = 1.0, duration_s = 4.0 }\n[[robot]]\nname = \"b\"\nposition_m = [-3.0, 5.0, 0.0]\n";
    folder.write("moved.toml", scene(third).as_bytes());
    folder.write("stands.toml", scene("").as_bytes());
    folder.says(&["simulate", "moved.toml", "--layout", "stock", "--out", "room"], 0, &[]);
    folder.write("room/t265_rx_trajectory_2023-11-14_221320_.csv", b"1,2,3\n");
    folder.says(&["simulate", "stands.toml", "--out", "room", "--force"], 0, &[]);
    folder.says(&["simulate", "stands.toml", "--out", "fresh"], 0, &[]);
    let names = |of: &str| {
        let entries = std::fs::read_dir(folder.0.join(of)).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let (mut room, fresh) = (names("room"), names("fresh"));
    room.retain(|name| !name.starts_with("t265_"));
    assert_eq!((room, names("room").len()), (fresh, names("fresh").len() + 1), "other programs' files stay");
    let azimuth = |of: &str| folder.rows(&["bearing", of, "--json"], 0)[0]["azimuth_deg"].as_f64().unwrap();
    assert!((azimuth("room") - azimuth("fresh")).abs() < 1e-9);
}

#[test]
fn a_simulated_capture_is_compared_with_the_scene_it_came_from() {
    let folder = Folder::new("compare");
    let text = "duration_s = 4.0\nchannel = 36\n[sounding]\nrate_hz = 100\n[radio]\nnoise.snr_db = 20.0\n[[robot]]\nname = \"rx\"\n\
                motion.circle = { radius_m = 0.2, duration_s = 4.0 }\n[[robot]]\nname = \"tx\"\nposition_m = [4.0, 1.0, 0.0]\n";
    folder.write("scene.toml", text.as_bytes());
    folder.says(&["simulate", "scene.toml", "--out", "capture"], 0, &[]);
    let stamp = "2023-11-14_221320";
    let [rx, tx, path] =
        [format!("csi_rx_{stamp}.dat"), format!("csi_tx1_{stamp}.dat"), format!("rx_trajectory_{stamp}_.csv")]
            .map(|name| format!("capture/{name}"));
    let recorded = ["simulate", "--rx", &rx, "--tx", &tx, "--trajectory", &path, "--out", "out", "--force"];
    // With the scene itself, and with the folder that it wrote: nothing differs.
    for with in ["scene.toml", "capture"] {
        let (said, _) = folder.says(&[&recorded[..], &[with]].concat(), 0, &[]);
        assert!(said.contains(" figures agree, 0 differ"), "{said}");
    }
    // The channel is theirs; without them it has to be given.
    for with in ["scene.toml", "capture"] {
        assert_eq!(folder.run(&[&recorded[..], &[with, "--channel", "36"]].concat()).0, 0, "{with}");
        folder.says(&[&recorded[..], &[with, "--channel", "36+"]].concat(), 1, &[]);
        folder.says(
            &[&recorded[..], &[with, "--channel", "108"]].concat(),
            1,
            &["is of channel 36", "not of --channel 108"],
        );
    }
    folder.says(&recorded, 2, &["--channel"]);
    let [unforced @ .., _] = &recorded;
    folder.says(&[unforced, &["scene.toml"][..]].concat(), 1, &["already exists"]);
    let rows = folder.rows(&[&recorded[..], &["capture", "--json"]].concat(), 0);
    assert!(rows.len() > 80 && rows.iter().all(|row| row["recorded"] == row["simulated"]), "{rows:?}");
    folder.says(&[&recorded[..], &["nowhere.toml"]].concat(), 1, &["nowhere.toml"]);
}

#[test]
fn the_suite_writes_a_row_for_each_repetition() {
    let folder = Folder::new("suite");
    folder.says(&["simulate", "suite", "--only", "circle 10", "--repetitions", "3", "--out", "rows.csv"], 0, &[]);
    let rows = std::fs::read_to_string(folder.0.join("rows.csv")).unwrap();
    assert_eq!(rows.lines().count(), 4, "{rows}");
    let page = std::fs::read_to_string(crate::common::root().join("docs/reference/formats.md")).unwrap();
    let table = page.split("## Tables: `simulate suite --out`").nth(1).unwrap().split("Fields without").next().unwrap();
    let described = table.split('`').skip(1).step_by(2);
    let columns: Vec<&str> = rows.lines().next().unwrap().split(',').collect();
    assert_eq!(described.collect::<Vec<_>>(), columns);
    assert!(rows.lines().skip(1).all(|row| row.starts_with("circle 10 cm,")), "{rows}");
    folder.says(&["simulate", "suite", "--only", "triangle"], 2, &["line 30 cm"]);
}

#[test]
fn several_links_to_known_places_locate_the_receiver_and_help_is_short_or_whole() {
    let folder = Folder::new("located");
    folder.says(&["simulate", "lab-circle", "--out", "room"], 0, &[]);
    let (out, _) = folder.says(&["bearing", "room"], 0, &[]);
    assert!(out.contains("truth ") && !out.contains("located from"), "one link is no place: {out}");
    let other = "records are 20 MHz wide, channel 108+ is not, and has another centre: name it 108";
    folder.says(&["bearing", "room", "--channel", "108+"], 3, &[other]);
    folder.says(&["evaluate", "room", "--channel", "36"], 3, &["groundtruth_positions.json names channel 108, not 36"]);
    // Named again, by any path or link, it is still one measurement.
    let again = ["bearing", "room", "./room/tx1", "room/../room", "--json"];
    assert_eq!(folder.rows(&again, 0).len(), 1);
    // The last row is the summary.
    assert_eq!(folder.rows(&["evaluate", "room", ".", "--json"], 0).len(), 2);
    let (_, all, _) = folder.run(&["help", "--all"]);
    for words in ["  bearing ", "Seldom needed:\n", "  key ", "  completions "] {
        assert!(all.contains(words), "{words}: {all}");
    }
    let (_, short, _) = folder.run(&["bearing", "-h"]);
    assert!(short.lines().count() <= 28, "{short}");
    for words in ["--channel", "--antenna-offset", "--json", "--verbose"] {
        assert!(short.contains(words), "{words}: {short}");
    }
}

#[test]
fn two_runs_of_one_name_are_two_captures() {
    let folder = Folder::new("namesakes");
    capture(&folder, "a/run", &link(400, 2.0));
    capture(&folder, "b/run", &link(400, 1.0));
    let names = ["a/run/1/tx2", "b/run/1/tx2"];
    for command in ["bearing", "evaluate"] {
        // Both named, or with a link or a repetition.
        for more in [&[][..], &["./a/run"]] {
            let rows = folder.rows(&[&[command, "a/run", "b/run", "--json"], more].concat(), 0);
            let links: Vec<&str> = rows.iter().filter_map(|row| row["link"].as_str()).collect();
            assert_eq!(links, names, "{command}: {rows:?}");
            // No receiver was in both.
            assert!(rows.iter().all(|row| row["capture"].is_null()), "{command}: {rows:?}");
        }
    }
    let (_, err) = folder.says(&["evaluate", "a/run", "b/run", "--plot", "p"], 0, &[]);
    assert!(err.contains("p: 5 pictures"), "{err}");
    for name in ["map-a_run_1.png", "map-b_run_1.png"] {
        assert!(folder.0.join("p").join(name).is_file(), "{name}");
    }
}

#[test]
fn odometry_of_a_tracking_camera_is_not_fitted() {
    let folder = Folder::new("fit-camera");
    let made = link(600, 2.0);
    capture(&folder, "place", &made);
    folder.write("place/t265_rx_trajectory_1_.csv", made.trajectory.as_bytes());
    let (out, _) = folder.says(&["bearing", "place", "--trajectory", "t265", "--fit", "odometry"], 0, &[]);
    assert!(out.starts_with("odometry: not corrected: a tracking camera drifts"), "{out}");
}

#[test]
fn quiet_says_results_and_errors_and_verbose_what_was_read() {
    let folder = Folder::new("quiet");
    let mut damaged = link(300, 2.0);
    damaged.rx[100].remove(7);
    folder.link(&damaged);
    let (usual_out, _) = folder.bearing_says(&[], 3, &["lost:"]);
    let (status, out, err) = folder.bearing(&["--quiet"]);
    assert_eq!((status, out, err.as_str()), (3, usual_out.clone(), ""));
    let (_, out, err) = folder.bearing(&["-v"]);
    assert!(out.starts_with(&usual_out) && out.contains("coherence, 0 to 1") && out.contains("CFO"), "{out}");
    for words in ["lost:", "reading rx.dat", "reading tx.dat", "reading t.csv: ", " s, ", " MB of memory"] {
        assert!(err.contains(words), "no `{words}` in {err}");
    }
    // Errors are printed even so.
    folder.says(&["-q", "info", "none.dat"], 1, &["none.dat"]);
    assert_eq!(folder.run(&["info", "rx.dat", "-q", "-v"]).0, 2);
}

#[test]
fn colours_are_for_terminals_and_for_who_asks() {
    let folder = Folder::new("colours");
    std::fs::create_dir_all(folder.0.join("machine")).unwrap();
    let doctor = |more: &[&str]| folder.run(&[&["doctor", "machine"][..], more].concat()).1;
    assert!(!doctor(&[]).contains('\x1b'));
    assert!(!doctor(&["--color", "never"]).contains('\x1b'));
    let coloured = doctor(&["--color", "always"]);
    assert!(coloured.contains("\x1b[1;31mBAD \x1b[0m"), "{coloured}");
    assert!(!folder.run(&["info", "none.dat"]).2.contains('\x1b'));
    let (_, _, err) = folder.run(&["--color", "always", "info", "none.dat"]);
    assert!(err.starts_with("\x1b[1;31mcsi5300:\x1b[0m "), "{err}");
}

#[test]
fn a_name_is_shown_and_commands_no_terminal() {
    let folder = Folder::new("terminal");
    let name = "here\x1b[2J\n\u{202e}tad\x1b]0;mine\x07\u{9b}7m";
    capture(&folder, &format!("tree/{name}"), &link(300, 2.0));
    folder.write(&format!("{name}.dat"), b"none");
    let shown = r"here\u001b[2J\n\u202etad\u001b]0;mine\u0007\u009b7m";
    let log = format!("{name}.dat");
    let bearing = vec!["-v", "bearing", "--channel", "108", "--rx", &log, "--tx", &log, "--trajectory", &log];
    let no_option = format!("--{name}");
    for arguments in
        [vec!["bearing", "tree"], vec!["info", &no_option], vec!["info", &log], vec!["info", "--json", &log], bearing]
    {
        let (_, out, err) = folder.run(&arguments);
        let said = out + &err;
        let commands = |sign: char| sign.is_control() && sign != '\n';
        assert!(said.contains(shown) && !said.contains(commands) && !said.contains("[2J\n"), "{said:?}");
    }
    assert_eq!(json(&folder.run(&["bearing", "tree", "--json"]).1)["link"].as_str().unwrap().find(name), Some(0));
}

#[test]
fn a_file_of_another_kind_is_named_for_what_it_is() {
    let folder = Folder::new("kinds");
    folder.link(&link(300, 2.0));
    let args = |rx: &str, tx: &str, t: &str| folder.run(&of(rx, tx, t));
    for (rx, tx) in [("t.csv", "tx.dat"), ("rx.dat", "t.csv")] {
        let (status, _, err) = args(rx, tx, "t.csv");
        assert!(status == 1 && err.contains("t.csv is another kind of file, a table of numbers"), "{err}");
        assert!(!err.contains("one run"), "{err}");
    }
    let (status, _, err) = args("rx.dat", "tx.dat", "tx.dat");
    assert!(
        status == 1 && err.contains("tx.dat is a log of CSI: a trajectory is a table of times and places"),
        "{err}"
    );
    assert_eq!(folder.run(&["export", "rx.dat", "rx.npz"]).0, 0);
    for command in [&["info", "rx.npz"][..], &["export", "rx.npz", "x.csv"], &["export", "--dat", "rx.npz", "x.dat"]] {
        folder.says(command, 1, &["rx.npz is another kind of file, a ZIP archive"]);
    }
    for (magic, kind) in [(&[0x28, 0xb5, 0x2f, 0xfd][..], "zstd"), (b"BZh9", "bzip2"), (b"\xfd7zXZ", "xz")] {
        folder.write("rx.dat.packed", &[magic, &[0xff; 300]].concat());
        folder.says(&["info", "rx.dat.packed"], 1, &[&format!("another kind of file, compressed by {kind}")]);
    }
    assert!(folder.run(&["info", "t.csv", "--plot", "."]).2.contains("another kind of file"));
    assert!(folder.run(&["view", "t.csv"]).2.contains("another kind of file"));
    // What can be read only once cannot be looked at first.
    for once in ["-", "/dev/null"] {
        folder.says(&["bearing", once, "tx.dat", "t.csv"], 2, &["only once", "--rx, --tx and --trajectory"]);
        folder.says(&["info", once, "--plot", "."], 2, &["only once: name a file"]);
    }
    folder.says(&["export", "--dat", "rx.dat", "x.npz"], 2, &["x.npz: --dat writes a log, not a table"]);
    folder.says(&["evaluate", "nowhere"], 1, &["nowhere: no such folder"]);
}

#[test]
fn every_command_ends_with_2_where_it_is_used_wrongly_and_has_the_same_help() {
    let folder = Folder::new("usages");
    let (_, help, _) = folder.run(&["--help"]);
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // What goes on in a further line stands further to the right.
    let first = |line: &'_ str| line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')).is_some();
    let commands: Vec<&str> =
        commands.filter(|line| first(line)).filter_map(|line| line.split_whitespace().next()).collect();
    assert!(commands.len() > 5 && commands.contains(&"bearing") && commands.contains(&"simulate"), "{commands:?}");
    for command in commands.into_iter().filter(|command| *command != "help") {
        folder.says(&[command, "--no-such-option"], 2, &["--no-such-option"]);
        let (status, help, _) = folder.run(&[command, "--help"]);
        assert!(status == 0 && help.contains("--quiet") && help.contains("--color"), "{command}: {help}");
    }
    // The table of the page is the one of the program.
    let page = std::fs::read_to_string(crate::common::root().join("docs/reference/troubleshooting.md")).unwrap();
    let table: Vec<&str> = page.split("## Exit status").nth(1).unwrap().lines().collect();
    for status in ["0", "1", "2", "3"] {
        assert!(help.contains(&format!("\n  {status}  ")), "{help}");
        assert!(table.iter().any(|line| line.starts_with(&format!("| {status} |"))), "{table:?}");
    }
}

/// A capture without a truth, with the names of Dijkstra et al.
fn truthless(folder: &Folder) {
    let made = link(600, 2.0);
    std::fs::create_dir_all(folder.0.join("runs/circle")).unwrap();
    folder.write("runs/circle/csi_rx_real_1.dat", &made.rx.concat());
    folder.write("runs/circle/csi_tx_real_1.dat", &made.tx.concat());
    folder.write("runs/circle/rx_movement_real_1.csv", made.trajectory.as_bytes());
}

#[test]
fn captures_without_a_truth_are_explained_located_and_shown() {
    let folder = Folder::new("truthless");
    truthless(&folder);
    let (out, _) = folder.says(&["bearing", "runs", "--channel", "108", "--explain"], 0, &[]);
    assert!(out.starts_with("circle/real_1/tx ") && !out.contains("truth"), "{out}");
    // Links as they are named there, wholly or by their end.
    for name in ["runs/circle/real_1/tx", "runs/circle/tx"] {
        let row = &folder.rows(&["bearing", name, "--channel", "108", "--json"], 0)[0];
        assert!((row["azimuth_deg"].as_f64().unwrap() - 2f64.to_degrees()).abs() < 0.2, "{row}");
        assert!(row["error_from_mean_pose_deg"].is_null() && row["residual_phase_rad"].is_f64(), "{row}");
    }
    folder.says(&["bearing", "runs/circle/real_2/tx", "--channel", "108"], 1, &["real_2/tx is no link of runs/circle"]);
    folder.says(&["bearing", "runs"], 2, &["--channel"]);
    folder.says(&["evaluate", "runs", "--channel", "108"], 1, &["1 capture without one"]);
    // The transmitter is 1 km away, so the bearing alone says little of where the receiver is; the output says that it is used.
    let unplaced = "not located: the place of tx is not known (--place tx=X,Y)";
    // A range or a graph asks for the receiver, so the output says why it is not located.
    let trajectory = std::fs::read_to_string(folder.0.join("runs/circle/rx_movement_real_1.csv")).unwrap();
    let t_s = trajectory.lines().nth(9).and_then(|row| row.split(',').next()).unwrap();
    folder.write("r.csv", format!("time_s,from,to,range_m,sd_m\n{t_s},rx,tx,3,0.1\n").as_bytes());
    let asked = |more: &[&str], status: i32| {
        folder.says(&[&["bearing", "runs", "--channel", "108"], more].concat(), status, &[])
    };
    let (out, err) = asked(&["--ranges", "r.csv"], 0);
    assert!(out.contains(unplaced) && !err.contains("not used"), "{out} {err}");
    assert!(asked(&["--place", "tx=1,2", "--factors", "f.json"], 1).0.contains("1 usable bearing and no range"));
    let place = |place: &str| folder.run(&["bearing", "runs", "--channel", "108", "--place", place, "--json"]);
    let receiver = |out: &str| json(out.lines().nth(1).unwrap_or_else(|| panic!("{out}")));
    let (status, _, err) = place("tx7=1,2");
    assert!(status == 2 && err.contains("--place tx7=...: no transmitter has this name; there are tx"), "{err}");
    let told = place("tx=-416,909").1;
    assert_eq!(receiver(&told)["links"], 1);
    // The place is the link's truth, too.
    let error = json(told.lines().next().unwrap())["error_from_mean_pose_deg"].as_f64();
    assert!(error.is_some_and(|deg| deg.abs() < 0.3), "{told}");
    assert_eq!(place("tx=1e7,2").0, 2);
    let twice = ["bearing", "runs", "--channel", "108", "--place", "tx=1,2", "--place", "tx=3,4"];
    folder.says(&twice, 2, &["--place tx=... is given twice"]);
    // Another capture has a transmitter of that name.
    std::fs::create_dir(folder.0.join("runs/square")).unwrap();
    for (from, to) in [("csi_rx", "csi_rx"), ("csi_tx", "csi_tx7"), ("rx_movement", "rx_movement")] {
        let end = if from == "rx_movement" { "csv" } else { "dat" };
        let name = |folder: &str, start: &str| format!("runs/{folder}/{start}_real_1.{end}");
        std::fs::copy(folder.0.join(name("circle", from)), folder.0.join(name("square", to))).unwrap();
    }
    assert_eq!(json(place("tx7=1,2").1.lines().nth(2).unwrap())["error"], unplaced);
    folder.write("r.csv", format!("time_s,from,to,range_m,sd_m\n{t_s},rx,tx9,3,0.1\n").as_bytes());
    assert!(asked(&["--ranges", "r.csv"], 1).1.contains("the robots are rx, tx, tx7, and"));
    std::fs::remove_dir_all(folder.0.join("runs/square")).unwrap();
    assert_eq!(place("tx=1").0, 2);
    // One motion has a direction and no range. Another, beside the first, looks past it at a right angle.
    let locate = |more: &[&str]| folder.run(&[&["bearing", "--transmitters", "--channel", "108"], more].concat());
    let place = |out: &str| {
        let found = json(out);
        let number = |name: &str, k: usize| found[name][k].as_f64().unwrap_or_else(|| panic!("{found}"));
        assert_eq!(found["transmitter"], "tx");
        ([number("position_m", 0), number("position_m", 1)], [number("ellipse_m", 0), number("ellipse_m", 1)], found)
    };
    let (status, out, _) = locate(&["runs", "--json"]);
    let error = json(&out)["error"].clone();
    assert!(status == 1 && error.as_str().is_some_and(|error| error.contains("range open")), "{out}");
    let beside = ["runs", "other", "--frame", "other/circle=-7.04,3.38,-90", "--place", "tx=-2.50,5.46", "--json"];
    std::fs::rename(folder.0.join("runs"), folder.0.join("other")).unwrap();
    truthless(&folder);
    let (status, out, err) = locate(&beside);
    let ([x, y], [longer, _], found) = place(&out);
    // 114.6 degrees from about the origin, and 24.6 from about (-7.04, 3.38), cross six metres from here.
    let off_m = (x + 2.5).hypot(y - 5.46);
    assert!(status == 0 && found["motions"] == 2 && off_m < 0.8 && longer < 4.0, "{found} {err}");
    assert!((found["off_m"].as_f64().unwrap() - off_m).abs() < 1e-3, "{found}");
    let (status, _, err) = locate(&["runs", "--frame", "kitchen=0,0,0"]);
    assert!(status == 2 && err.contains("no capture has this name"), "{err}");
    let (status, _, err) = locate(&["runs", "--frame", "circle=0,0,0", "--frame", "circle=1,0,0"]);
    assert!(status == 2 && err.contains("--frame circle=... is given twice"), "{err}");
    std::fs::remove_dir_all(folder.0.join("other")).unwrap();
    folder.says(&["evaluate", "runs", "--channel", "108", "--html", "r.html"], 0, &[]);
}

#[test]
fn only_named_links_locate_transmitters() {
    let folder = Folder::new("named-links");
    truthless(&folder);
    let file = |tx: &str| folder.0.join(format!("runs/circle/csi_{tx}_real_1.dat"));
    std::fs::copy(file("tx"), file("tx7")).unwrap();
    let named = ["tx", "tx7"].map(|tx| {
        let (_, out, err) =
            folder.run(&["bearing", &format!("runs/circle/{tx}"), "--transmitters", "--channel", "108", "--json"]);
        (out.contains("\"tx\"") || err.contains("/tx:"), out.contains("\"tx7\"") || err.contains("/tx7:"))
    });
    assert_eq!(named, [(true, false), (false, true)]);
}

#[test]
fn logs_of_a_capture_give_their_link_the_name_of_captures() {
    let folder = Folder::new("link-names");
    truthless(&folder);
    let file = |name: &str| format!("runs/circle/{name}");
    let (rx, tx, t) = (file("csi_rx_real_1.dat"), file("csi_tx_real_1.dat"), file("rx_movement_real_1.csv"));
    let args = ["bearing", "--rx", &rx, "--tx", &tx, "--trajectory", &t, "--channel", "108", "--json"];
    assert_eq!(json(&folder.run(&args).1)["link"], "real_1/tx");
    folder.says(&[&args[..], &["--tx", "gone.dat", "--profile", "p.csv"]].concat(), 3, &[]);
    folder.write("csi_tx2.dat", &std::fs::read(folder.0.join(&tx)).unwrap());
    let (_, out, _) =
        folder.run(&["bearing", "--rx", &rx, "--tx", "csi_tx2.dat", "--trajectory", &t, "--channel", "108", "--json"]);
    assert_eq!(json(&out)["link"], "csi_tx2");
}

#[test]
fn rows_of_a_trajectory_that_cannot_be_read_are_a_loss_and_a_line_of_headings_is_none() {
    let folder = Folder::new("rows");
    let made = link(600, 2.0);
    folder.link(&made);
    let expected = folder.azimuth_deg(&[]);
    let count = made.trajectory.lines().count();
    let rows = |of: &dyn Fn(usize, &str) -> String| {
        made.trajectory.lines().enumerate().map(|(k, line)| of(k, line) + "\n").collect::<String>()
    };
    // Every tenth row is damaged, by a stray quote among others.
    let damaged = rows(&|k, line| match k % 20 {
        5 => line.replacen(',', ",\"x", 1),
        15 => "x".to_owned(),
        _ => line.to_owned(),
    });
    // Times of whole seconds are too coarse for a path that turns.
    let whole = rows(&|_, line| {
        let (time, rest) = line.split_once(',').unwrap();
        format!("{},{rest}", time.split('.').next().unwrap())
    });
    for (rows, status, words, most_deg) in [
        (format!("time,ns,x,y,z\n{}", made.trajectory), 0, "", Some(0.0)),
        (damaged, 3, &*format!("{} rows skipped", count / 10), Some(1.0)),
        (whole, 1, "times are rounded to 1 s", None),
    ] {
        folder.write("t.csv", rows.as_bytes());
        let (out, _) = folder.bearing_says(&["--json"], status, &[words]);
        assert!(most_deg.is_none_or(|most| (azimuth_deg(&out) - expected).abs() <= most), "{words}: {out}");
    }
}

#[test]
fn a_file_that_is_missing_is_no_wrong_usage_and_one_that_makes_no_sense_is() {
    let folder = Folder::new("words-status");
    folder.write("scene.toml", b"colour = 3\n");
    folder.says(&["simulate", "gone.toml", "--out", "o"], 1, &["no file gone.toml, and no built-in scene"]);
    folder.link(&link(300, 1.0));
    folder.bearing_says(&["--key", "gone.key"], 1, &["gone.key"]);
    folder.says(&["simulate", "scene.toml", "--out", "o"], 2, &["scene.toml: line 1: unknown field `colour`"]);
    // What a configuration has is for the robot's service to say (crates/node/tests/node/program.rs).
    assert_eq!(folder.run(&["node", "--check", "--colour", "never", "--no-such-option"]).0, 2);
}

/// A sender repeats some of its frames; many numbers that come twice may be somebody else's answers.
#[test]
fn numbers_that_come_twice_are_said_where_they_are_many() {
    let folder = Folder::new("twice");
    let made = link(400, 1.0);
    folder.link(&made);
    let said = |every: usize| {
        let twice = |(at, record): (usize, &Vec<u8>)| record.repeat(1 + usize::from(at % every == 0));
        folder.write("rx.dat", &made.rx.iter().enumerate().flat_map(twice).collect::<Vec<u8>>());
        folder.bearing(&["-v"]).1
    };
    let words = "100 frames of the receiver's log repeat an earlier number";
    assert!(said(4).contains(words), "{}", said(4));
    assert!(folder.bearing(&[]).1.contains(words), "without -v, too");
    assert!(!said(20).contains("repeat an earlier number") && said(20).contains("20 duplicates"), "{}", said(20));
}

#[test]
fn columns_that_may_mean_two_things_are_asked_for() {
    let folder = Folder::new("columns");
    let made = link(600, 2.0);
    folder.link(&made);
    let plain = folder.azimuth_deg(&[]);
    let is_the_same = |more: &[&str]| assert!((folder.azimuth_deg(more) - plain).abs() < 1e-6, "{more:?}");
    // Time, x, y and yaw, as a robot's own logger writes them, without headings and with.
    let rows: Vec<Vec<&str>> = made.trajectory.lines().map(|line| line.split(',').collect()).collect();
    let four: String = rows.iter().map(|row| format!("{},{},{},0.5\n", row[0], row[2], row[3])).collect();
    folder.write("t.csv", four.as_bytes());
    folder.bearing_says(&[], 1, &["4 columns without headings", "--columns"]);
    is_the_same(&["--columns", "t,x,y,yaw"]);
    // A minus before the first name is no option.
    let negative = |row: &Vec<&str>| format!("{},{},{}\n", -row[2].parse::<f64>().unwrap(), row[0], row[3]);
    folder.write("t.csv", rows.iter().map(negative).collect::<String>().as_bytes());
    is_the_same(&["--columns", "-x,t,y"]);
    folder.write("t.csv", format!("time [s],pos_x,pos_y,yaw\n{four}").as_bytes());
    is_the_same(&[]);
    folder.bearing_says(&["--columns", "t,x,z"], 2, &["name no y"]);
    folder.bearing_says(&["--antenna-offset", "4.6,15.9,0"], 1, &["16.6 m is off the robot"]);
}

/// The records of a log, each with its length field.
pub fn records(log: &[u8]) -> Vec<Vec<u8>> {
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
    emitted(&repr, &csi)
}

#[test]
fn the_demonstration_prints_spreads_and_bearings_and_overwrites_only_its_own_files() {
    let folder = Folder::new("demo");
    let (out, _) = folder.says(&["demo", "--out", "d"], 0, &[]);
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
    let (again, _) = folder.says(&["demo", "--out", "d"], 0, &[]);
    assert!(again == out);
    // Robots at rest are no link that failed.
    let (out, _) = folder.says(&["evaluate", "d"], 0, &[]);
    assert!(out.contains("all: 2 links, 0 failed"), "{out}");
    folder.write("d/mine.txt", b"");
    folder.says(&["demo", "--out", "d"], 1, &["--force"]);
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
    let row = &folder.rows(&["info", "--json", "jump.dat"], 0)[0];
    assert!(row["noise_dbm"].is_null() || row["noise_unknown"].as_u64() == Some(0), "{row}");
    let sender = row["senders"].as_object().unwrap().values().next().unwrap().clone();
    assert!(sender["rate_hz"].as_f64().unwrap() < 0.6 * sender["median_rate_hz"].as_f64().unwrap(), "{row}");
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
    folder.says(&["export", "rx.dat", "rx.csv", "--scaled"], 0, &["10 of 40 records have no scale"]);
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
        folder.says(&["export", "--dat", &log, &stock, "--layout", "stock"], 0, &[]);
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
fn a_group_address_loses_its_numbers_in_the_stock_layout_and_the_export_says_so() {
    let folder = Folder::new("recover-group");
    let scene = "duration_s = 2.0\nsounding.rate_hz = 20\n[[robot]]\nname = \"rx\"\n\
                 [[robot]]\nname = \"tx\"\nposition_m = [3.0, 4.0, 0.0]\nmac = \"01:23:45:67:89:ab\"\n";
    let [rx, tx, _] = simulated(&folder, "room", scene, "rx_trajectory_");
    let stock = |log: &str, status| {
        folder.says(&["export", "--dat", log, "s.dat", "--layout", "stock", "--force"], status, &[]).1
    };
    let err = stock(&rx, 3);
    assert!(err.contains("38 records lose their frame number"), "what it hears from the group address: {err}");
    assert!(!stock(&tx, 0).contains("lose"), "what the group address hears is numbered");
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
    capture(&folder, "tree/A", &link(300, 2.0));
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
        // The page says so.
        assert!(command[0] != "evaluate" || !out.contains("range_change"), "{out}");
        found += &out;
    }
    assert!(crate::documented::are_documented(&found) > 100, "{found}");
    assert!(
        found.contains("range_change") && crate::documented::pages().contains("`range_change` (not in `evaluate`)")
    );
}

/// The page as one file holds an answer of every kind that `view` gives but a node's states, whose fields `node.rs` looks at.
#[test]
fn every_field_of_the_page_is_in_the_documentation() {
    let folder = Folder::new("page");
    capture(&folder, "tree/A", &link(300, 2.0));
    let beside = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg\nA/1,tx2,gt,119.0,-1.0\n";
    folder.write("tree/links.csv", beside.as_bytes());
    folder.says(&["evaluate", "tree", "--html", "page.html"], 0, &[]);
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
    assert_eq!(folder.bearing(&["--profile", "p.csv"]).0, 0);
    folder.bearing_says(&["--profile", "p.csv"], 1, &["p.csv already exists: --force overwrites it"]);
    assert_eq!(folder.bearing(&["--profile", "p.csv", "--force"]).0, 0);
    folder.says(&["export", "--dat", "none.dat", "x.dat"], 1, &[]);
    folder.says(&["evaluate", "."], 1, &[]);
    let built_in = ["simulate", "paper-line", "--out", "paper-line"];
    assert_eq!(folder.run(&built_in).0, 0, "a built-in scene by its name");
    let (_, err) = folder.says(&built_in, 1, &["--force"]);
    assert!(!err.contains("cannot read"), "its folder is no scene: {err}");
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
    assert_eq!(folder.rows(&args, 0)[0]["pictures"].as_array().map(Vec::len), Some(4));
    for what in ["csi", "levels"] {
        assert!(folder.0.join(format!("p/rx-{what}.png")).is_file());
        let svg = std::fs::read_to_string(folder.0.join(format!("p/rx-{what}.svg"))).unwrap();
        assert!(svg.contains("width=\"1200\"") && !svg.contains("NaN"), "{what}");
    }
    assert_eq!(folder.run(&args).0, 0, "the next run replaces them");
    folder.says(&["info", "rx.dat", "--mac", "02:00:00:00:00:77", "--plot", "q"], 3, &["no matching record"]);
    assert_eq!(folder.run(&["info", "rx.dat", "--from", "1"]).0, 2, "nothing is drawn");
}

#[test]
fn logs_of_frames_only_and_of_zeros_say_why_they_are_of_no_use() {
    let folder = Folder::new("no-csi");
    folder.link(&link(60, 0.5));
    let (status, ..) = folder.run(&["export", "--dat", "rx.dat", "stock.dat", "--layout", "stock"]);
    assert_eq!(status, 0);
    // Each record: two bytes of length, then its code.
    let all = records(&std::fs::read(folder.0.join("stock.dat")).unwrap());
    let records = |keep: u8| all.iter().filter(|record| record[2] == keep).cloned().collect::<Vec<_>>();
    folder.write("only_c1.dat", &records(0xC1).concat());
    let (out, _) = folder.says(&["info", "only_c1.dat"], 1, &[]);
    assert!(out.contains("only copies of frames (0xC1)") && out.contains("HT frames"), "{out}");
    let mut silent = records(0xBB);
    // Behind length, code and the 20 bytes of the head.
    silent.iter_mut().for_each(|record| record[23..].fill(0));
    // No record: nothing could be judged.
    folder.write("empty.dat", b"");
    folder.says(&["doctor", "--accept", "empty.dat", "--channel", "108"], 1, &[]);
    folder.says(&["info", "rx.dat", "empty.dat"], 3, &[]);
    folder.write("csi0.dat", &silent.concat());
    let (out, _) = folder.says(&["info", "csi0.dat"], 1, &[]);
    assert!(out.contains("60 records have CSI of only zeros"), "{out}");
    assert_eq!(folder.rows(&["info", "csi0.dat", "--json"], 1)[0]["silent"], 60);
}

#[test]
fn a_wide_scene_has_the_channel_of_its_centre_and_steady_turn_arounds_show_no_offset() {
    let folder = Folder::new("wide");
    let scene = "duration_s = 6.0\nchannel = 108\nbandwidth_mhz = 40\ncfo = \"physical\"\nsounding.rate_hz = 100.0\n\
                 radio.noise.snr_db = 20.0\n[[robot]]\nname = \"rx\"\ncrystal.offset_ppm = -2.0\n\
                 motion.circle = { radius_m = 0.3, duration_s = 5.0 }\n[[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.3]\n";
    folder.write("wide.toml", scene.as_bytes());
    for out in ["a", "b"] {
        folder.says(&["simulate", "wide.toml", "--out", out], 0, &[]);
    }
    let file = |name: &str| format!("a/{}", name.replace("TS", "2023-11-14_221320"));
    let (rx, tx, t) = (file("csi_rx_TS.dat"), file("csi_tx1_TS.dat"), file("rx_trajectory_TS_.csv"));
    folder.says(&["simulate", "b", "--rx", &rx, "--tx", &tx, "--trajectory", &t, "--out", "c"], 0, &[]);
    let (_, out, err) = folder.run(&["doctor", "--accept", "wide.toml"]);
    assert!(out.starts_with("backend: simulated room"), "{out}{err}");
    // The crystals are 11 kHz apart, of which nothing shows without jitter.
    let row = &folder.rows(&["bearing", "a", "--json"], 0)[0];
    assert!(row["cfo_hz"].is_null() && row["compensated"] == false && row["azimuth_deg"].is_f64(), "{row}");
    let (out, _) = folder.says(&["bearing", "a", "-v"], 0, &[]);
    assert!(out.contains("  CFO not removed: the phase would not be steadier; phase coherence 1.00"), "{out}");
}
