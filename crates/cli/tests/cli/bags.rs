//! Recordings of ROS 2 as input: the same answers as from the files.

use crate::commands::Folder;
use crate::common::root;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_bag::cdr::Cdr;
use csi5300_bag::mcap::McapWriter;
use csi5300_bag::messages::{Csi, Header, Message, Pose as Placed, PoseStamped, Quaternion, Time};
use std::path::{Path, PathBuf};

/// The payload of a message for each record of a log.
fn csi(log: &Path) -> Vec<Vec<u8>> {
    let (mut log, mut survey, mut all) = (Replay::open(log).unwrap(), Survey::default(), Vec::new());
    loop {
        let next = log.receive(Instant::ZERO).unwrap();
        if let Some((bfee, identity)) = survey.note(&next) {
            all.push(Csi::of(Time::from_us(identity.host_us.unwrap()), &bfee, identity).payload());
        }
        if matches!(next, Next::End(_)) {
            return all;
        }
    }
}

/// The same for each pose of a trajectory.
fn poses(path: &Path) -> Vec<Vec<u8>> {
    let (trajectory, _) = csv::read(path, None).unwrap();
    let message = |pose: &Pose| {
        let header = Header { stamp: Time::from_us((pose.t_s * 1e6).round() as i64), frame_id: "odom".into() };
        let (z, w) = (0.5 * pose.heading_rad.unwrap_or(0.0)).sin_cos();
        let orientation = Quaternion { z, w, ..Quaternion::default() };
        let position = <[f64; 3]>::from(pose.position_m).into();
        PoseStamped { header, pose: Placed { position, orientation } }.payload()
    };
    trajectory.poses().iter().map(message).collect()
}

/// The same trajectory with a heading, which messages always have.
fn headed(folder: &Folder, path: &Path) -> PathBuf {
    let (trajectory, _) = csv::read(path, None).unwrap();
    let line = |pose: &Pose| csv::line(&Pose { heading_rad: Some(0.0), ..*pose });
    folder.write("t.csv", trajectory.poses().iter().map(line).collect::<String>().as_bytes())
}

/// A recording of these topics.
fn mcap(topics: &[(&str, &'static str, Vec<Vec<u8>>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = McapWriter::new(&mut bytes).unwrap();
    for (topic, kind, messages) in topics {
        messages.iter().for_each(|message| writer.put((topic, kind, String::new), 0, message).unwrap());
    }
    writer.finish().unwrap();
    bytes
}

const CSI: &str = Csi::TYPE;
const POSES: &str = PoseStamped::TYPE;

/// The lines of JSON without what the link is called.
fn answers(text: &str) -> Vec<serde_json::Value> {
    let line = |line: &str| {
        let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(value.as_object_mut().unwrap().remove("link").is_some(), "{line}");
        value
    };
    text.lines().map(line).collect()
}

/// A topic of a recording: its name, its type, its messages.
type Messages = (&'static str, &'static str, Vec<Vec<u8>>);

/// The receiver's log, the transmitter's and the trajectory of a capture, and the same as topics of a recording.
fn recorded(folder: &Folder) -> ([String; 3], [Messages; 3]) {
    let capture = root().join("tests/fixtures/small-circle");
    let file = |name: &str| capture.join(name.replace("STAMP", "2023-11-14_221320"));
    let (rx, tx, path) =
        (file("csi_rx_STAMP.dat"), file("csi_tx1_STAMP.dat"), headed(folder, &file("rx_trajectory_STAMP_.csv")));
    let topics = [("/a/csi", CSI, csi(&rx)), ("/b/csi", CSI, csi(&tx)), ("/a/odom", POSES, poses(&path))];
    ([rx, tx, path].map(|path| path.to_str().unwrap().to_owned()), topics)
}

#[test]
fn a_recording_gives_the_bearings_of_its_files_and_says_what_it_could_mean() {
    let folder = Folder::new("bags");
    let ([rx, tx, path], topics) = recorded(&folder);
    std::fs::write(folder.0.join("run.mcap"), mcap(&topics)).unwrap();
    let run = |args: &[&str]| folder.run(&[&["bearing", "--channel", "108", "--json"][..], args].concat());
    let (status, expected, errors) = run(&["--rx", &rx, "--tx", &tx, "--trajectory", &path]);
    assert_eq!(status, 0, "{errors}");
    for args in [&["--rx", "/a/csi"][..], &["--tx", "/b/csi"], &["--rx", "/a/csi", "--tx", &tx, "--trajectory", &path]]
    {
        let (status, out, errors) = run(&[&["--bag", "run.mcap"][..], args].concat());
        assert_eq!((status, answers(&out)), (0, answers(&expected)), "{args:?}: {errors}");
    }
    let (_, out, _) = run(&["--bag", "run.mcap", "--rx", "/a/csi"]);
    assert!(out.contains(r#""link":"b/csi""#), "{out}");
    // Both logs could be the receiver's; a name that is none; one log for both. Without the other robot's log, without odometry.
    std::fs::write(folder.0.join("one.mcap"), mcap(&topics[..1])).unwrap();
    let (whole, one) = (["--bag", "run.mcap"], ["--bag", "one.mcap"]);
    let other = "is neither a file nor a topic of CSI in run.mcap, which has /a/csi, /b/csi";
    for (bag, more, status, words) in [
        (
            &whole[..],
            &[][..],
            1,
            "run.mcap has several topics of CSI (/a/csi, /b/csi): --rx names that of the robot that moved",
        ),
        (&whole, &["--rx", "/c/csi"], 1, &format!("/c/csi {other}")),
        (&whole, &["--rx", "/a/odom"], 1, &format!("/a/odom {other}")),
        (&whole, &["--rx", "/a/csi", "--tx", "/a/csi"], 2, "/a/csi is given twice"),
        (&[], &[], 2, "--rx"),
        (&one, &[], 1, "--tx names the log of the other robot"),
        (&one, &["--tx", &tx], 1, "one.mcap has no poses (nav_msgs/msg/Odometry"),
    ] {
        folder.says(&[&["bearing", "--channel", "108", "--json"], bag, more].concat(), status, &[words]);
    }
    // Which of several transmitters a MAC is of is not guessed.
    let three = [topics.to_vec(), vec![("/c/csi", CSI, csi(Path::new(&tx)))]].concat();
    std::fs::write(folder.0.join("three.mcap"), mcap(&three)).unwrap();
    let mac = answers(&expected)[0]["mac"].as_str().unwrap().to_owned();
    let of_three = ["--bag", "three.mcap", "--rx", "/a/csi"];
    for given in [["--tx-mac", &mac], ["--tx-trajectory", &path]] {
        let (status, out, errors) = run(&[&of_three[..], &given].concat());
        assert!(status == 2 && out.is_empty(), "{status}: {out}");
        assert!(errors.contains("it names which of /b/csi, /c/csi"), "{errors}");
    }
    let (status, out, errors) = run(&[&of_three[..], &["--tx", "/b/csi", "--tx-mac", &mac]].concat());
    assert_eq!((status, answers(&out)), (0, answers(&expected)), "{errors}");
    std::fs::remove_file(folder.0.join("three.mcap")).unwrap();
    // A message that is none is left out and said.
    let mut damaged = topics.clone();
    damaged[1].2.push(vec![0, 1, 0, 0, 7]);
    std::fs::write(folder.0.join("damaged.mcap"), mcap(&damaged)).unwrap();
    let (status, out, errors) = run(&["--bag", "damaged.mcap", "--rx", "/a/csi"]);
    assert_eq!((status, answers(&out)), (3, answers(&expected)), "{errors}");
    assert!(errors.contains("/b/csi: 1 message is unreadable and skipped"), "{errors}");
    // Nothing was written.
    let names: Vec<_> = std::fs::read_dir(&folder.0).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 4, "{names:?}");
    // A topic's name shows the sensor as its file's does.
    let mut topics = topics;
    topics[2].0 = "/t265/odom";
    std::fs::write(folder.0.join("camera.mcap"), mcap(&topics)).unwrap();
    std::fs::copy(&path, folder.0.join("t265_odom.csv")).unwrap();
    let (_, camera, _) = run(&["--rx", &rx, "--tx", &tx, "--trajectory", "t265_odom.csv"]);
    let (_, out, errors) = run(&["--bag", "camera.mcap", "--rx", "/a/csi"]);
    assert_eq!(answers(&out), answers(&camera), "{errors}");
    assert_ne!(answers(&camera), answers(&expected));
    // Poses without a stamp are none.
    let mut pose = PoseStamped::default();
    pose.pose.orientation.w = 1.0;
    topics[2].2 = vec![pose.payload(); 3];
    std::fs::write(folder.0.join("unstamped.mcap"), mcap(&topics)).unwrap();
    let unstamped = ["/t265/odom: 3 messages are unreadable and skipped (poses need a stamp)"];
    folder.says(&["unbag", "unstamped.mcap", "--out", "u"], 3, &unstamped);
}

#[test]
fn a_recording_for_viewers_says_the_mirror_and_its_bearings_are_no_odometry() {
    let folder = Folder::new("bag-mirror");
    let scene = "duration_s = 6.0\nsounding.rate_hz = 50\nradio.noise.snr_db = 20\n[[robot]]\nname = \"rx\"\n\
                 motion.line = { length_m = 0.5, duration_s = 6.0 }\n\
                 [[robot]]\nname = \"tx\"\nposition_m = [3.0, 4.0, 0.0]\n";
    let [rx, tx, path] = crate::cards::simulated(&folder, "room", scene, "rx_trajectory_");
    let made = ["mcap", &rx, &tx, "--trajectory", &path, "--channel", "108", "--out", "o.mcap", "--json"];
    let (out, _) = folder.says(&made, 0, &[" deg +- ", ", or its mirror "]);
    let bearing = &crate::commands::json(out.trim())["bearings"][0];
    assert!(bearing["mirror_deg"].is_f64() && bearing["azimuth_sd_deg"].is_f64(), "{out}");
    folder.says(&["bearing", "--bag", "o.mcap", "--rx", &rx, "--tx", &tx, "--channel", "108"], 0, &[]);
    // Error bars are those of the sensor, also from the recording.
    let bar = |poses: [&str; 2]| {
        let logs = ["bearing", "--rx", &rx, "--tx", &tx, "--channel", "108", "--json"];
        folder.rows(&[&logs[..], &poses].concat(), 0)[0]["azimuth_sd_deg"].as_f64().unwrap()
    };
    let poses = std::fs::read(folder.0.join(&path)).unwrap();
    for name in ["vicon.csv", "t265.csv", "wheels.csv", "odom.csv"] {
        folder.write(name, &poses);
        folder.says(&["mcap", &rx, "--trajectory", name, "--out", "s.mcap", "--force"], 0, &[]);
        let [file, bag] = [["--trajectory", name], ["--bag", "s.mcap"]].map(bar);
        assert!((file - bag).abs() < 0.01 * file, "{name}: {file} {bag}");
    }
    // A heading that is not known stays unknown.
    let track = csv::read(&folder.0.join(&path), None).unwrap().0;
    let rows = track.poses().iter().map(|pose| format!("{},{},{},0\n", pose.t_s, pose.position_m.x, pose.position_m.y));
    folder.write("bare.csv", format!("t,x,y,z\n{}", rows.collect::<String>()).as_bytes());
    folder.says(&["mcap", &rx, "--trajectory", "bare.csv", "--out", "s.mcap", "--force"], 0, &[]);
    let read = ["bearing", "--bag", "s.mcap", "--rx", &rx, "--tx", &tx, "--channel", "108", "--json"];
    let bare = &folder.rows(&read, 0)[0];
    assert!(bare["azimuth_deg"].is_f64() && bare["azimuth_body_deg"].is_null(), "{bare}");
    // The receiver's records are at the times of its poses, whatever its host's clock says.
    let poses = std::fs::read_to_string(folder.0.join(&path)).unwrap().replace("17000000", "17000001");
    folder.write("later.csv", poses.as_bytes());
    let made = ["mcap", &rx, "--trajectory", "later.csv", "--clock-offset", "100", "--out", "o.mcap", "--force"];
    folder.says(&made, 0, &[]);
    let times = std::fs::read(folder.0.join("o.mcap")).unwrap();
    let holds = |second: u32| times.windows(4).any(|bytes| bytes == second.to_le_bytes());
    assert!(holds(1_700_000_103) && !holds(1_700_000_003));
    folder.says(&["mcap", &rx, "--clock-offset", "100", "--out", "x.mcap"], 2, &["--clock-offset needs --trajectory"]);
}

/// A log's recording for viewers has each of its records; what has none makes no file.
#[test]
fn a_log_becomes_a_recording_also_without_frame_numbers() {
    let folder = Folder::new("bag-of-log");
    folder.link(&crate::common::link(300, 2.0));
    folder.says(&["export", "--dat", "rx.dat", "stock.dat", "--layout", "stock"], 0, &[]);
    // As the CSI tool writes it without connector_log 0x5: no copies of frames, so neither senders nor numbers.
    let all = crate::commands::records(&std::fs::read(folder.0.join("stock.dat")).unwrap());
    let csi: Vec<_> = all.into_iter().filter(|record| record[2] == 0xBB).collect();
    assert_eq!(csi.len(), 300);
    std::fs::remove_file(folder.0.join("stock.datstp")).unwrap();
    folder.write("stock.dat", &csi.concat());
    for log in ["rx.dat", "stock.dat"] {
        let rows = folder.rows(&["mcap", log, "--out", "o.mcap", "--force", "--json"], 0);
        assert_eq!(rows[0]["logs"][0]["records"], 300, "{log}");
        // One more: the counts.
        folder.says(&["unbag", "o.mcap", "--out", "u"], 1, &["301 messages of other topics", "no topic of CSI"]);
        assert!(!folder.0.join("u").exists(), "a folder for nothing");
    }
    folder.write("empty.dat", b"");
    folder.says(&["mcap", "empty.dat", "--out", "e.mcap"], 1, &["nothing to write: no e.mcap"]);
    folder.says(&["mcap", "stock.dat", "--out", "none/o.mcap"], 1, &["cannot write none/o.mcap: No such file"]);
    folder.says(&["mcap", "stock.dat", "--out", "-"], 1, &["- is no output: name a file, or /dev/stdout"]);
    folder.says(&["unbag", "gone.mcap", "--out", "u"], 1, &["gone.mcap"]);
    assert!(!folder.0.join("e.mcap").exists() && !folder.0.join("u").exists());
}

#[test]
fn compare_reads_a_recording_too() {
    let folder = Folder::new("bag-compare");
    let ([rx, tx, path], topics) = recorded(&folder);
    std::fs::write(folder.0.join("run.mcap"), mcap(&topics)).unwrap();
    let capture = root().join("tests/fixtures/small-circle");
    let with = capture.to_str().unwrap();
    let run = |args: &[&str]| folder.run(&[&["simulate", with, "--json", "--out", "pictures"][..], args].concat());
    let (status, expected, errors) = run(&["--rx", &rx, "--tx", &tx, "--trajectory", &path]);
    assert_eq!(status, 0, "{errors}");
    let (status, out, errors) = run(&["--bag", "run.mcap", "--rx", "/a/csi", "--force"]);
    assert_eq!(status, 0, "{errors}");
    // Messages have their rows in the order of antennas, not in that of the card's selection.
    let figures = |text: &str| {
        let is_kept = |line: &&str| !line.contains("antenna_sel");
        text.lines().filter(is_kept).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(figures(&out), figures(&expected));
    assert!(figures(&out).len() > 50);
    assert!(crate::documented::are_documented(&out) > 7);
    let (status, out, errors) = folder.run(&["unbag", "run.mcap", "--out", "logs", "--json"]);
    assert_eq!((status, crate::documented::are_documented(&out)), (0, 5), "{out}{errors}");
    let (status, _, errors) = run(&["--bag", "run.mcap", "--force"]);
    assert!(status == 1 && errors.contains("several topics of CSI (/a/csi, /b/csi)"), "{errors}");
}

#[test]
fn a_recording_has_more_topics_than_a_program_may_have_files_and_is_not_overwritten() {
    let folder = Folder::new("bag-many");
    let names: Vec<String> = (0..200).map(|k| format!("/robot_{k}/pose")).collect();
    let one = vec![poses(&headed(&folder, Path::new(&recorded(&folder).0[2]))).remove(0)];
    let topics: Vec<_> = names.iter().map(|name| (name.as_str(), POSES, one.clone())).collect();
    let recording = folder.write("robot_7_pose.csv", &mcap(&topics));
    let before = std::fs::read(&recording).unwrap();
    let unbag = |out: &str| {
        let mut limited = std::process::Command::new("sh");
        limited.args(["-c", "ulimit -n 64 && exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_csi5300"), "unbag"]);
        let said = limited.current_dir(&folder.0).args(["robot_7_pose.csv", "--force", "--out", out]).output().unwrap();
        (said.status.code(), String::from_utf8(said.stderr).unwrap())
    };
    let (status, errors) = unbag("logs");
    assert_eq!(status, Some(0), "{errors}");
    assert_eq!(std::fs::read_dir(folder.0.join("logs")).unwrap().count(), 200);
    let (status, errors) = unbag(".");
    assert!(status == Some(1) && errors.contains("is the input robot_7_pose.csv by another name"), "{errors}");
    assert_eq!(std::fs::read(&recording).unwrap(), before);
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 3, "nothing of what was refused is left");
}
