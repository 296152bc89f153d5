//! `simulate --serve`: a room on the kernel's connector, heard by `record`, is the room that the library simulates.
#![cfg(feature = "live")]
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "common/private.rs"]
mod private;

use csi5300::backend::sim::{Room, Scene};
use csi5300::backend::{CsiSource, Next, replay::Replay};
use csi5300::odometry::csv;
use csi5300::time::Instant;
use csi5300::wait::{Monotonic, wall_us};
use driver_iface::bfee::{Bfee, offset};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use private::inside;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

const SCENE: &str = r#"
duration_s = 3.0
[sounding]
rate_hz = 100
[radio]
noise.snr_db = 20.0
host_latency_us = 300.0
[[robot]]
name = "rx"
motion.circle = { radius_m = 0.3, duration_s = 3.0 }
odometry = { rate_hz = 50.0, noise_m = 0.001 }
faults = { loss = 0.1, stall_every_s = 1.0, stall_s = 0.9, queue_records = 5 }
[[robot]]
name = "tx"
position_m = [4.0, 0.0, 0.0]
"#;

/// The bodies of a source's records, without the host's time, which is that of the run.
fn bodies(source: &mut dyn CsiSource) -> Vec<Vec<u8>> {
    let (mut bodies, mut now) = (Vec::new(), Instant::ZERO);
    loop {
        match source.receive(now).unwrap() {
            Next::Record(_, record) => {
                let mut body = record.body.to_vec();
                body[offset::TV_SEC..offset::TV_SEC + 8].fill(0);
                bodies.push(body);
            }
            Next::Pending => now = source.next_at().unwrap(),
            Next::End(_) => return bodies,
            Next::Lost(loss) => panic!("{loss:?}"),
        }
    }
}

/// The driver's time in the first record, microseconds since the Unix epoch.
fn first_host_us(log: &Path) -> i64 {
    let mut log = Replay::open(log).unwrap();
    let Next::Record(_, record) = log.receive(Instant::ZERO).unwrap() else { panic!("no record") };
    let wsr = Bfee::new_checked(record.body).unwrap().wsr().unwrap();
    i64::from(wsr.tv_sec) * 1_000_000 + i64::from(wsr.tv_usec)
}

/// Runs `record` on the connector while `serve` runs; gives what the server said.
fn serve(scene: &Path, logs: &[(&Path, &str)], more: &[&str]) -> String {
    let own = env!("CARGO_BIN_EXE_csi5300");
    let recorders: Vec<_> = logs
        .iter()
        .map(|(log, index)| {
            let mut command = Command::new(own);
            command.arg("record").arg(log).args(["--allow-user-sender", "--connector-index", index]);
            let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
            let mut stderr = BufReader::new(child.stderr.take().unwrap());
            let mut line = String::new();
            stderr.read_line(&mut line).unwrap();
            assert!(line.starts_with("listening"), "{line}");
            (child, stderr)
        })
        .collect();
    let out = Command::new(own).arg("simulate").arg(scene).arg("--serve").args(more).output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{said}");
    for (mut child, mut stderr) in recorders {
        kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
        let mut rest = String::new();
        stderr.read_to_string(&mut rest).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(0), "{rest}");
    }
    said
}

#[test]
fn a_served_room_is_heard_through_the_kernel() {
    if !inside("a_served_room_is_heard_through_the_kernel", "-Urn") {
        return;
    }
    let folder = std::env::temp_dir().join(format!("csi5300-serve-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [scene, rx, tx, poses] = ["scene.toml", "rx.dat", "tx.dat", "poses.csv"].map(|name| folder.join(name));
    std::fs::write(&scene, SCENE).unwrap();
    let options = ["--speed", "20", "--robot", "rx=26", "--robot", "tx=12", "--poses", poses.to_str().unwrap()];
    let (before_us, clock) = (wall_us().unwrap(), Monotonic::new());
    let said = serve(&scene, &[(&rx, "26"), (&tx, "12")], &options);
    let (after_us, took_s) = (wall_us().unwrap(), clock.now().as_s());
    // Three seconds at twenty times real time, and the first frames are of the first milliseconds.
    assert!(took_s >= 3.0 / 20.0, "{took_s} s: not paced");
    let first_us = first_host_us(&rx);
    assert!((before_us..after_us).contains(&first_us), "{first_us} is not within {before_us} and {after_us}");
    assert!(said.contains("ms behind real time"), "{said}");

    // Stalls and queues of the scene are left to the real listener; losses on air are not.
    let mut expected = Scene::from_toml(SCENE).unwrap();
    let faults = &mut expected.robot[0].faults;
    (faults.stall_every_s, faults.queue_records) = (0.0, usize::MAX);
    let mut room = Room::new(&expected).unwrap();
    let cards = [room.card(0).unwrap(), room.card(1).unwrap()];
    for (robot, (mut card, log)) in cards.into_iter().zip([&rx, &tx]).enumerate() {
        let (heard, simulated) = (bodies(&mut Replay::open(log).unwrap()), bodies(&mut card));
        assert!(heard.len() > 250, "{} records", heard.len());
        assert!(heard == simulated, "robot {robot}: {} heard, {} simulated", heard.len(), simulated.len());
        assert!(said.contains(&format!("{} records sent", heard.len())), "{said}");
    }
    let (trajectory, counts) = csv::read(&poses).unwrap();
    assert_eq!((counts.rows, counts.bad_rows), (151, 0));
    let reach = trajectory.poses().iter().map(|pose| pose.position_m.norm()).fold(0.0, f64::max);
    assert!((reach - 0.6).abs() < 0.01, "{reach}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn two_robots_on_one_connector_index_are_refused() {
    let scene = std::env::temp_dir().join(format!("csi5300-serve-index-{}.toml", std::process::id()));
    std::fs::write(&scene, SCENE).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    command.arg("simulate").arg(&scene).args(["--serve", "--robot", "rx=9", "--robot", "tx=9"]);
    let out = command.output().unwrap();
    std::fs::remove_file(&scene).unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("rx and tx would both be served on connector index 9"), "{said}");
}
