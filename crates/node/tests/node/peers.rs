//! Robots in processes of their own that exchange records through zenoh: each replays its own log.

use crate::robots::{Offline, offline};
use crate::{Running, folder};
use csi5300_sim::{Room, Scene, write_dataset};
use std::fmt::Write as _;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Times real time at which logs are played.
const SPEEDS: [f64; 3] = [8.0, 2.0, 0.5];

/// A robot's records wait ten seconds of its log for their partners, and its port may have been taken since it was chosen. Where a
/// busy machine starts the others later than that, `run` says why it found too little, and all begin again at a lower speed.
fn in_time(speeds: &[f64], run: impl Fn(f64) -> Result<(), String>) {
    let mut late = Vec::new();
    for speed in speeds {
        match run(*speed) {
            Ok(()) => return,
            Err(why) => late.push(format!("at {speed} times: {why}")),
        }
    }
    panic!("{late:?}");
}

/// A capture of `robots` robots: the first drives a circle. Gives the logs and MACs in the robots' order, and the path.
fn capture(folder: &Path, robots: usize) -> (Vec<(PathBuf, String)>, PathBuf, Scene) {
    let mut text =
        "name = \"peers\"\nduration_s = 22.0\nchannel = 108\ncfo = \"physical\"\n[sounding]\nrate_hz = 100.0\n"
            .to_owned();
    for k in 0..robots {
        let (x, y) = if k == 0 { (0.0, 0.0) } else { (6.0 + k as f64, 4.0 * k as f64 - 7.0) };
        let _ = write!(
            text,
            "[[robot]]\nname = \"r{k}\"\nposition_m = [{x}, {y}, 0.2]\nhost_clock = {{ offset_s = {k} }}\ncrystal = {{ offset_ppm = {k} }}\n"
        );
        if k == 0 {
            text += "motion.circle = { radius_m = 0.3, duration_s = 19.0, start_s = 1.5 }\n";
        }
    }
    let scene = Scene::from_toml(&text).unwrap();
    let mut room = Room::new(&scene).unwrap();
    let written = write_dataset(&mut room, folder, &mut |_| {}).unwrap();
    let logs =
        written[0].logs.iter().map(|log| (log.path.clone(), room.mac(log.robot).unwrap().to_string(), log.robot));
    let mut logs: Vec<_> = logs.collect();
    logs.sort_by_key(|(.., robot)| *robot);
    let files: Vec<PathBuf> = std::fs::read_dir(&written[0].dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    let path = files
        .into_iter()
        .find(|file| file.file_name().unwrap().to_str().unwrap().starts_with("rx_trajectory_"))
        .unwrap();
    (logs.into_iter().map(|(path, mac, _)| (path, mac)).collect(), path, scene)
}

/// A port that was free a moment ago.
fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

struct Node(Running);

impl Node {
    fn start(folder: &Path, name: &str, text: &str) -> Self {
        let file = folder.join(format!("{name}.toml"));
        std::fs::write(&file, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300-node"));
        command
            .args(["node", "--config"])
            .arg(&file)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit());
        Self(Running(command.spawn().unwrap()))
    }

    /// How it ended, after a signal if it goes on by itself: in order, if perhaps with losses.
    fn end(mut self) {
        let running = i32::try_from(self.0.0.id()).unwrap();
        let _ = nix::sys::signal::kill(nix::unistd::Pid::from_raw(running), nix::sys::signal::Signal::SIGTERM);
        let status = self.0.0.wait().unwrap();
        assert!(matches!(status.code(), Some(0 | 3)), "{status}");
    }

    /// Every report until it ends.
    fn reports(&mut self) -> impl Iterator<Item = serde_json::Value> + use<> {
        let lines = BufReader::new(self.0.0.stdout.take().unwrap()).lines();
        lines.map(|line| serde_json::from_str(&line.unwrap()).unwrap())
    }

    /// The same, once it listens: it has joined the network when it says something.
    fn reports_when_it_listens(&mut self) -> impl Iterator<Item = serde_json::Value> + use<> {
        let mut reports = self.reports();
        let first = reports.next();
        first.into_iter().chain(reports)
    }
}

/// No discovery: tests that run side by side must not meet. And no strangers: a user and a password.
fn network(folder: &Path, more: &str) -> String {
    let users = folder.join("users");
    std::fs::write(&users, "robot:secret\n").unwrap();
    let auth = format!("usrpwd: {{ user: 'robot', password: 'secret', dictionary_file: '{}' }}", users.display());
    let zenoh = format!("{{ scouting: {{ multicast: {{ enabled: false }} }}, transport: {{ auth: {{ {auth} }} }} }}");
    std::fs::write(folder.join("zenoh.json5"), zenoh).unwrap();
    format!("[network]\nzenoh = '{}'\n{more}\n", folder.join("zenoh.json5").display())
}

/// The robot that drives, with the others as its peers over the network.
fn driver(folder: &Path, logs: &[(PathBuf, String)], path: &Path, (port, speed): (u16, f64)) -> String {
    let mut text = format!(
        "mac = \"{}\"\nchannel = \"108\"\ncapture.replay = {{ file = '{}', speed = {speed} }}\nodometry.csv.file = '{}'\n\
         [estimator]\nwindow_m = 100\nrate_hz = 1.0\n",
        logs[0].1,
        logs[0].0.display(),
        path.display()
    );
    for (k, (_, mac)) in logs.iter().enumerate().skip(1) {
        let _ = write!(text, "[[peer]]\nname = \"r{k}\"\nmac = \"{mac}\"\nrecords.network = {{}}\n");
    }
    text + &network(folder, &format!("listen = [\"tcp/127.0.0.1:{port}\"]"))
}

/// A robot that only publishes what its card reports.
fn publisher(folder: &Path, (log, mac): &(PathBuf, String), (port, speed): (u16, f64)) -> String {
    let text = format!(
        "mac = \"{mac}\"\nchannel = \"108\"\ncapture.replay = {{ file = '{}', speed = {speed} }}\n",
        log.display()
    );
    text + &network(folder, &format!("connect = [\"tcp/127.0.0.1:{port}\"]\npublish_records = true"))
}

fn truth_deg(scene: &Scene, peer: usize) -> f64 {
    let [x, y, _] = scene.robot[peer].position_m;
    // The circle lies to the left of where the robot begins, facing +x.
    (y - 0.3).atan2(x).to_degrees()
}

/// Of most of the log, a bearing is right; of less there may be none.
fn is_close(report: &serde_json::Value, truth: f64) -> Result<(), String> {
    if report["pairs"].as_u64() < Some(1_500) {
        return Err(format!("too few pairs: {report}"));
    }
    let azimuth = report["azimuth_deg"].as_f64().unwrap_or_else(|| panic!("no bearing: {report}"));
    assert!((azimuth - truth).abs() < 1.5, "{azimuth} for {truth}: {report}");
    Ok(())
}

/// The last report on each peer.
fn last(reports: impl Iterator<Item = serde_json::Value>, peers: usize) -> Vec<serde_json::Value> {
    let mut last = vec![serde_json::Value::Null; peers];
    for report in reports {
        let k: usize = report["link"].as_str().unwrap()[1..].parse().unwrap();
        last[k - 1] = report;
    }
    last
}

/// Certificates of the authority in `folder` for one robot on this machine, as the packaged script makes them. False
/// (said on standard error) without openssl.
fn certificates(folder: &Path, name: &str) -> bool {
    let script = crate::common::root().join("packaging/certificates.sh");
    let made = Command::new(script).arg(folder).args([name, "127.0.0.1"]).stdout(Stdio::null()).status();
    let made = made.is_ok_and(|status| status.success());
    if !made {
        crate::common::skipped("openssl makes no certificates here");
    }
    made
}

#[test]
fn certificates_that_cannot_be_made_replace_none() {
    let folder = folder("certificates");
    if !certificates(&folder, "r0") {
        return;
    }
    let all = || {
        let paths = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
        let mut all: Vec<_> = paths.map(|path| (std::fs::read(&path).unwrap(), path)).collect();
        all.sort();
        all
    };
    let before = all();
    let script = crate::common::root().join("packaging/certificates.sh");
    // The authority's own name, and an address that is none.
    for arguments in [&["ca"][..], &["r0", "robot.local"]] {
        let made = Command::new(&script).arg(&folder).args(arguments).output().unwrap();
        assert!(!made.status.success() && all() == before, "{arguments:?}");
    }
}

/// The packaged example for TLS with this test's files in it, for the robot `name` of the authority in `authority`.
fn tls(folder: &Path, authority: &Path, name: &str, more: &str) -> String {
    let example = crate::common::root().join("packaging/zenoh-tls.json5");
    let users = folder.join("users-tls");
    std::fs::write(&users, "burger-1:change me\n").unwrap();
    let place = |file: &str| authority.join(file).display().to_string();
    let text = std::fs::read_to_string(example)
        .unwrap()
        .replace("/etc/csi5300/tls/ca.pem", &place("ca.pem"))
        .replace("/etc/csi5300/tls/robot", &place(name))
        .replace("/etc/csi5300/users", &users.display().to_string())
        .replace("endpoints: [\"tls/0.0.0.0:7447\"]", "endpoints: []")
        .replace("multicast: { enabled: true }", "multicast: { enabled: false }");
    assert!(!text.contains("/etc/"), "{text}");
    let file = folder.join(format!("{name}.json5"));
    std::fs::write(&file, text).unwrap();
    format!("[network]\nzenoh = '{}'\n{more}\n", file.display())
}

/// Robot 1 shows its certificate, robot 2 one of another authority, and what says it is robot 3 that of robot 1.
#[test]
fn under_tls_only_robots_of_the_same_authority_are_heard_and_each_as_itself() {
    let folder = folder("peers-tls");
    let (logs, path, scene) = capture(&folder, 4);
    let (ours, theirs) = (folder.join("ours"), folder.join("theirs"));
    if !["r0", "r1"].iter().all(|name| certificates(&ours, name)) || !certificates(&theirs, "r2") {
        return;
    }
    let cut = |text: String| text.split("[network]").next().unwrap().to_owned();
    let owned = |text: String| {
        let own = |text: String, k| {
            text.replace(&format!("name = \"r{k}\"\n"), &format!("name = \"r{k}\"\ncertificate = \"r{k}\"\n"))
        };
        own(own(text, 1), 3)
    };
    in_time(&SPEEDS, |speed| {
        let port = free_port();
        let listen = format!("listen = [\"tls/127.0.0.1:{port}\"]");
        let connect = format!("connect = [\"tls/127.0.0.1:{port}\"]\npublish_records = true");
        let driver = owned(cut(driver(&folder, &logs, &path, (port, speed)))) + &tls(&folder, &ours, "r0", &listen);
        let publisher = |k: usize, authority: &Path, certificate: &str| {
            cut(publisher(&folder, &logs[k], (port, speed))) + &tls(&folder, authority, certificate, &connect)
        };
        // Their files are all written before anybody reads one.
        let [other, pretender, stranger] =
            [publisher(1, &ours, "r1"), publisher(3, &ours, "r1"), publisher(2, &theirs, "r2")];
        let mut own = Node::start(&folder, "r0", &driver);
        let reports = own.reports_when_it_listens();
        let other = Node::start(&folder, "r1", &other);
        let pretender = Node::start(&folder, "r3", &pretender);
        // It has a certificate, of somebody else: it goes on asking, and is killed in the end.
        let _stranger = Node::start(&folder, "r2", &stranger);
        let last = last(reports, 3);
        is_close(&last[0], truth_deg(&scene, 1))?;
        assert_eq!([&last[1]["pairs"], &last[2]["pairs"]], [0, 0], "{last:?}");
        own.end();
        other.end();
        pretender.end();
        Ok(())
    });
}

#[test]
fn four_processes_of_which_one_is_killed_and_started_again() {
    let folder = folder("peers-4");
    let (logs, path, scene) = capture(&folder, 4);
    in_time(&SPEEDS, |speed| {
        let at = (free_port(), speed);
        let mut own = Node::start(&folder, "r0", &driver(&folder, &logs, &path, at));
        let mut reports = own.reports_when_it_listens();
        let publishers: Vec<String> = logs.iter().skip(1).map(|log| publisher(&folder, log, at)).collect();
        let mut others: Vec<Node> =
            publishers.iter().enumerate().map(|(k, text)| Node::start(&folder, &format!("r{}", k + 1), text)).collect();
        // Once the others have bearings one of them dies, and comes back from the beginning of its log.
        let first = reports.find(|report| report["link"] == "r3" && report["azimuth_deg"].is_f64());
        let first = first.ok_or("no bearing of r3")?;
        others[1].0.0.kill().unwrap();
        // What was under way is in by the second report from here.
        let had = reports.by_ref().filter(|report| report["link"] == "r2").nth(1).ok_or("r2 died too late")?;
        others[1] = Node::start(&folder, "r2", &publishers[1]);
        let last = last(reports, 3);
        for peer in [1, 3] {
            is_close(&last[peer - 1], truth_deg(&scene, peer))?;
            assert!(last[peer - 1]["pairs"].as_u64() > first["pairs"].as_u64(), "the others went on: {last:?}");
        }
        let pairs = |report: &serde_json::Value| report["pairs"].as_u64().unwrap();
        if pairs(&last[1]) <= pairs(&had) + 100 {
            return Err(format!("nothing came after it was started again: {had} {}", last[1]));
        }
        own.end();
        others.into_iter().for_each(Node::end);
        Ok(())
    });
}

/// Times its own pace at which a real capture is played.
const REAL_SPEEDS: [f64; 3] = [16.0, 4.0, 1.0];

#[test]
fn real_captures_through_two_nodes_give_what_is_made_offline() {
    let Some(captures) = crate::common::captures() else { return };
    let mut compared = 0;
    for set in ["LOS_Set_A/L1", "NLOS_Set_A/L1"] {
        let capture = captures.join("wsr").join(set);
        if !capture.is_dir() {
            continue;
        }
        let Offline { rx, trajectory, txs, own, links } = offline(&capture, None);
        // One link at a time: two nodes.
        for (tx, (mac, azimuth, pairs)) in txs.iter().zip(&links) {
            let folder = folder(&format!("peers-real-{compared}"));
            in_time(&REAL_SPEEDS, |speed| {
                let port = free_port();
                let driver = format!(
                    "mac = \"{own}\"\nchannel = \"108\"\ncapture.replay = {{ file = '{}', speed = {speed} }}\n\
                 odometry.csv.file = '{}'\n[estimator]\nwindow_m = 1000\nwindow_s = 100000\nrate_hz = 0.02\n\
                 [[peer]]\nname = \"r1\"\nmac = \"{mac}\"\nrecords.network = {{}}\n",
                    rx.display(),
                    trajectory.display()
                );
                let driver =
                    driver + &network(&folder, &format!("listen = [\"tcp/127.0.0.1:{port}\"]\nbacklog = 100000"));
                let publisher = format!(
                    "mac = \"{mac}\"\nchannel = \"108\"\ncapture.replay = {{ file = '{}', speed = {speed} }}\n",
                    tx.display()
                );
                let connect = format!("connect = [\"tcp/127.0.0.1:{port}\"]\npublish_records = true\nbacklog = 100000");
                let publisher = publisher + &network(&folder, &connect);
                let mut own = Node::start(&folder, "r0", &driver);
                let reports = own.reports();
                let other = Node::start(&folder, "r1", &publisher);
                let last = last(reports, 1).remove(0);
                // Some were too late for the others.
                if last["pairs"].as_u64() < Some(*pairs) {
                    return Err(format!("{pairs} pairs offline: {last}"));
                }
                let off = last["azimuth_deg"].as_f64().unwrap_or_else(|| panic!("no bearing: {last}")) - azimuth;
                println!(
                    "{set} {mac}: {azimuth:.3} deg offline, {off:+.4} deg through two nodes, {} pairs",
                    last["pairs"]
                );
                assert!(off.abs() <= 0.01, "{off} {last}");
                own.end();
                other.end();
                Ok(())
            });
            compared += 1;
        }
    }
    assert!(compared >= 3, "{compared} links");
}

#[test]
fn a_signal_ends_a_robot_that_publishes() {
    let folder = folder("peers-signal");
    let (logs, path, _) = capture(&folder, 2);
    in_time(&SPEEDS, |speed| {
        let at = (free_port(), speed);
        let text = driver(&folder, &logs, &path, at) + "publish_records = true\npublish_poses = true\n";
        let mut own = Node::start(&folder, "r0", &text);
        let mut reports = own.reports();
        reports.next().ok_or("the port was taken")?;
        own.end();
        Ok(())
    });
}
