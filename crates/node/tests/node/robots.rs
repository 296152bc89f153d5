//! A robot as one value, in virtual time: bearings while it drives, in a simulated room and from replayed captures, with AX210s and with
//! two antennas.

use crate::folder;
use csi5300::maths::wrap_rad;
use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300::source::{CsiSource, Next};
use csi5300::time::{Instant, Span};
use csi5300_accept::Verdict;
use csi5300_node::adapters::Robot;
use csi5300_node::config::{CameraMount, Config};
use csi5300_node::diagnostics::{Claims, Found};
use csi5300_node::machine::Machine;
use csi5300_node::sources::{Card, Sources};
use csi5300_sim::{Room, Scene};
use driver_iface::bfee::Antenna;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a configuration names, opened.
fn sources(config: &Config) -> Sources {
    Sources::open(config, &mut [], &Arc::default()).unwrap()
}

/// A robot of these sources, ready to run in virtual time.
fn machine_of(config: &Config, sources: Sources) -> Machine {
    Machine::new(sources, None, config.estimator_settings(), config.options(), Instant::ZERO).unwrap()
}

/// A robot that was configured, ready to run in virtual time.
pub(crate) fn machine(config: &Config) -> Machine {
    machine_of(config, sources(config))
}

/// Runs until the records end or `until`: every report with its time, and the last ones.
pub(crate) fn run(mut machine: Machine, until: Instant) -> (Vec<(Instant, usize, PeerReport)>, Vec<PeerReport>) {
    let mut now = Instant::ZERO;
    let mut reports = Vec::new();
    loop {
        while machine.take(now).unwrap() {}
        while let Some((peer, report)) = machine.poll_report(now) {
            reports.push((now, peer, report));
        }
        if machine.is_done(now) || now >= until {
            break;
        }
        // A service that wakes for every millisecond of work.
        let next = machine.next_at().unwrap_or(now);
        now = next.max(now + Span::from_ms(1));
    }
    (reports, machine.finish(now).0)
}

/// A room in which the first of `robots` drives a circle of 30 cm and the others stand about it, or drive too.
fn scene(robots: usize, peers_move: bool) -> String {
    let mut text = String::from(
        "name = \"ring\"\nseed = 7\nduration_s = 24.0\nchannel = 108\ncfo = \"physical\"\n[sounding]\nrate_hz = 100.0\n\
         [radio]\nphase_noise_rad = 0.1\nsend_jitter_us = 60.0\nturn_around = { spread_us = 6.0 }\n",
    );
    for k in 0..robots {
        let angle = 0.4 + std::f64::consts::TAU * k as f64 / robots as f64;
        let away = if k == 0 { 0.0 } else { 9.0 + 0.3 * k as f64 };
        let (x, y) = (away * angle.cos(), away * angle.sin());
        let _ = write!(
            text,
            "[[robot]]\nname = \"r{k}\"\nposition_m = [{x:.4}, {y:.4}, 0.2]\n\
             host_clock = {{ offset_s = {}, drift_ppm = {} }}\ncrystal = {{ offset_ppm = {} }}\n\
             odometry = {{ rate_hz = 50.0, noise_m = 0.0003 }}\n",
            3.0 * k as f64,
            k,
            1.5 * k as f64 - 3.0
        );
        let circle = (k == 0) != peers_move;
        if circle {
            let _ = writeln!(text, "motion.circle = {{ radius_m = 0.3, duration_s = 20.0, start_s = 1.5 }}");
        }
    }
    text
}

/// The configuration of robot `own` in that room, with everybody else as its peer.
fn config(folder: &Path, scene: &str, robots: usize, peers_move: bool) -> Config {
    std::fs::write(folder.join("ring.toml"), scene).unwrap();
    let mut text = "channel = \"108\"\ncapture.room = { scene = \"ring.toml\", robot = \"r0\" }\n".to_owned();
    text += if peers_move { "odometry.static = {}\n" } else { "odometry.room = {}\n" };
    for k in 1..robots {
        let _ = write!(text, "[[peer]]\nname = \"r{k}\"\nrecords.room = {{}}\n");
        if peers_move {
            text += "poses.room = {}\n";
        }
    }
    Config::read(&text, folder).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// The true bearing from the middle of the circle, or of a peer's circle, degrees.
fn truth_deg(room: &Room, peer: usize) -> f64 {
    let middle = |robot: usize| {
        let places = (0..200).map(|k| room.antenna(robot, 1.5 + 20.0 * f64::from(k) / 200.0).unwrap());
        places.sum::<nalgebra::Vector3<f64>>() / 200.0
    };
    let towards = middle(peer) - middle(0);
    towards.y.atan2(towards.x).to_degrees()
}

pub(crate) fn off_deg(report: &PeerReport, truth: f64) -> f64 {
    let azimuth = report.answer.azimuth_deg.unwrap_or_else(|| panic!("{report:?}"));
    wrap_rad((azimuth - truth).to_radians()).to_degrees().abs()
}

#[test]
fn a_room_that_follows_poses_gives_the_bearing_of_where_they_lead() {
    let folder = folder("followed");
    let text = scene(2, false)
        .replace("motion.circle = { radius_m = 0.3, duration_s = 20.0, start_s = 1.5 }", "motion.followed = {}");
    std::fs::write(folder.join("ring.toml"), &text).unwrap();
    // Somewhere else than where the robot waits, with a clock of its own.
    let mut way = String::new();
    for k in 0..1_200 {
        let t_s = f64::from(k) * 0.02;
        let angle = std::f64::consts::TAU * ((t_s - 1.0) / 20.0).clamp(0.0, 1.0);
        let (x, y) = (1.0 + 0.3 * angle.cos(), -2.0 + 0.3 * angle.sin());
        let _ = writeln!(way, "{:.3},0,{x:.6},{y:.6},0.2,{:.6},", 5_000.0 + t_s, angle + std::f64::consts::FRAC_PI_2);
    }
    std::fs::write(folder.join("way.csv"), way).unwrap();
    let config = "channel = \"108\"\nodometry.room = {}\n[capture.room]\nscene = \"ring.toml\"\nrobot = \"r0\"\n\
                  follow.r0.csv.file = \"way.csv\"\n[[peer]]\nname = \"r1\"\nrecords.room = {}\n";
    let config = Config::read(config, &folder).unwrap_or_else(|error| panic!("{error}"));
    let (_, last) = run(machine(&config), Instant::from_us(23_000_000));
    let peer = Room::new(&Scene::from_toml(&text).unwrap()).unwrap().antenna(1, 0.0).unwrap();
    let truth = (peer.y + 2.0).atan2(peer.x - 1.0).to_degrees();
    let off = off_deg(&last[0], truth);
    assert!(off < 1.0 && last[0].state == PeerState::Bearing, "{off} {:?}", last[0]);
}

#[test]
fn bearings_are_right_after_one_circle_with_two_four_and_eight_robots() {
    for robots in [2, 4, 8] {
        let folder = folder(&format!("ring-{robots}"));
        let text = scene(robots, false);
        let room = Room::new(&Scene::from_toml(&text).unwrap()).unwrap();
        let config = config(&folder, &text, robots, false);
        let (reports, last) = run(machine(&config), Instant::from_us(23_000_000));
        assert_eq!(last.len(), robots - 1);
        for (peer, report) in last.iter().enumerate() {
            let off = off_deg(report, truth_deg(&room, peer + 1));
            println!("{robots} robots, r{}: {off:.3} deg off", peer + 1);
            assert!(off < 1.0 && report.state == PeerState::Bearing, "{off} {report:?}");
            let carried = report.answer.carried.as_ref().unwrap();
            let off = wrap_rad((carried.azimuth_deg - truth_deg(&room, peer + 1)).to_radians()).to_degrees().abs();
            assert!(off < 3.0 && carried.candidates[0].share > 0.5 && carried.stretches > 1, "{off} {carried:?}");
        }
        // At rest nothing is guessed; while it drives there is a bearing twice a second.
        let words: Vec<&str> = reports.iter().map(|(.., report)| report.words.as_str()).collect();
        assert!(words.iter().any(|words| words.starts_with("not yet: moved 0.0")), "{words:?}");
        let early = reports.iter().find(|(.., report)| report.state == PeerState::Bearing).unwrap();
        assert!(early.2.moved_m >= early.2.needed_m && early.0.as_s() > 2.0, "{early:?}");
        let made = reports.iter().filter(|(.., report)| report.state == PeerState::Bearing).count();
        assert!(made >= 30 * (robots - 1), "{made} bearings of {robots} robots");
    }
}

#[test]
fn a_robot_at_rest_finds_those_that_move_and_publish_their_poses() {
    let folder = folder("ring-passive");
    let text = scene(3, true);
    let room = Room::new(&Scene::from_toml(&text).unwrap()).unwrap();
    let config = config(&folder, &text, 3, true);
    let (_, last) = run(machine(&config), Instant::from_us(23_000_000));
    for (peer, report) in last.iter().enumerate() {
        let off = off_deg(report, truth_deg(&room, peer + 1));
        println!("passive, r{}: {off:.3} deg off", peer + 1);
        assert!(off < 1.0, "{off} {report:?}");
    }
}

/// A card of which nothing comes from some time on.
struct Vanishes(Card, Instant);

impl CsiSource for Vanishes {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, csi5300::source::Error> {
        if now >= self.1 { Ok(Next::Pending) } else { self.0.receive(now) }
    }

    fn next_at(&self) -> Option<Instant> {
        self.0.next_at().filter(|at| *at < self.1)
    }
}

#[test]
fn the_bearing_of_a_peer_that_vanished_grows_old() {
    let folder = folder("ring-vanish");
    let config = config(&folder, &scene(2, false), 2, false);
    let mut sources = sources(&config);
    let records = sources.peers[0].records.take().unwrap();
    sources.peers[0].records = Some(Box::new(Vanishes(records, Instant::from_us(12_000_000))));
    // This robot drives on until 21.5 s.
    let (reports, _) = run(machine_of(&config, sources), Instant::from_us(20_000_000));
    assert!(reports.iter().any(|(at, _, report)| at.as_s() < 12.0 && report.state == PeerState::Bearing));
    let late: Vec<_> = reports.iter().filter(|(at, ..)| at.as_s() > 13.0).collect();
    assert!(late.len() > 10);
    for (at, _, report) in late {
        let age = at.as_s() - report.age_s;
        assert!(report.state == PeerState::NoPairs && (11.0..13.0).contains(&age), "{at:?} {report:?}");
        assert!(report.answer.azimuth_deg.is_some(), "the last bearing is repeated");
    }
}

#[test]
fn a_deaf_antenna_is_reported_without_waiting() {
    let folder = folder("ring-silent");
    let text = scene(2, false);
    let mut config = config(&folder, &text, 2, false);
    config.antenna = Antenna::B;
    let (reports, last) = run(machine(&config), Instant::from_us(4_000_000));
    let (first, then) = reports.split_first().unwrap();
    // The first report, before any pair, says that there was none.
    assert!(first.0.as_s() < 1.0 && !then.is_empty(), "{first:?}");
    for report in then.iter().map(|(.., report)| report).chain(&last) {
        assert_eq!(report.state, PeerState::NoPairs);
        assert!(report.words.starts_with("the antenna heard nothing: the CSI of all "), "{}", report.words);
    }
    config.antenna = Antenna::A;
    let (heard, _) = run(machine(&config), Instant::from_us(1_000_000));
    assert!(heard.iter().all(|(.., report)| !report.words.contains("heard nothing")), "{heard:?}");
}

/// The same room, in which all robots initiate in turns.
fn in_turns(robots: usize) -> String {
    let names: Vec<String> = (0..robots).map(|k| format!("\"r{k}\"")).collect();
    let turns = format!("rate_hz = 100.0\ninitiators = [{}]\ndialect = \"native\"\n", names.join(", "));
    scene(robots, false).replace("rate_hz = 100.0\n", &turns)
}

#[test]
fn robots_that_all_initiate_lose_no_pair_and_no_degree() {
    for robots in [2, 3] {
        let folder = folder(&format!("turns-{robots}"));
        let text = in_turns(robots);
        let room = Room::new(&Scene::from_toml(&text).unwrap()).unwrap();
        let config = config(&folder, &text, robots, false);
        let mut machine = machine(&config);
        let mut now = Instant::ZERO;
        while now < Instant::from_us(23_000_000) {
            while machine.take(now).unwrap() {}
            now += Span::from_ms(5);
        }
        let pairs: Vec<u64> = machine.estimator.peers().map(|(_, counts)| counts.pairs).collect();
        // A link is sounded in the turns of its two robots: a round of a turn has one exchange with each peer.
        let sounded = 2.0 / robots as f64 * 100.0 * 23.0;
        let last = machine.finish(now).0;
        for (peer, report) in last.iter().enumerate() {
            let off = off_deg(report, truth_deg(&room, peer + 1));
            println!(
                "{robots} robots in turns, r{}: {} pairs of {sounded:.0}, {off:.3} deg off",
                peer + 1,
                pairs[peer]
            );
            let (own, other) = (report.answer.receiver_records, report.answer.transmitter_records);
            // The first turn begins after a listen.
            assert!(pairs[peer] as f64 > 0.9 * sounded, "{own:?} {other:?}");
            assert_eq!((own.duplicates, own.mispaired, other.duplicates, other.mispaired), (0, 0, 0, 0));
            // Of two robots every frame is for the other.
            assert!(robots > 2 || own.paired == own.handed, "{own:?}");
            assert!(off < 1.0 && report.state == PeerState::Bearing, "{off} {report:?}");
        }
    }
}

#[test]
fn the_accuracy_layer_runs_at_intervals_and_last() {
    let folder = folder("ring-refined");
    let text = scene(2, false);
    let room = Room::new(&Scene::from_toml(&text).unwrap()).unwrap();
    let mut config = config(&folder, &text, 2, false);
    config.estimator.accurate_every_s = 2.0;
    // Until two seconds after the circle's end.
    let (reports, last) = run(machine(&config), Instant::from_us(23_500_000));
    let made: Vec<_> = reports.iter().filter(|(.., report)| report.state == PeerState::Bearing).collect();
    let accurate: Vec<_> = made.iter().filter(|(.., report)| report.accurate).collect();
    assert!((8..=13).contains(&accurate.len()) && made.len() > 3 * accurate.len(), "{} {}", accurate.len(), made.len());
    for (at, _, report) in &made {
        let off = off_deg(report, truth_deg(&room, 1));
        assert!(at.as_s() < 12.0 || off < 1.0, "{off} {report:?}");
        // Each is made of what came at that moment.
        let heard = report.heard_at.unwrap();
        assert!(report.accurate || (*at - heard) < Span::from_ms(2), "{at:?} {heard:?}");
    }
    // Nothing is computed for robots that stand.
    let late: Vec<_> = reports.iter().filter(|(at, ..)| at.as_s() > 22.2).map(|(.., report)| report).collect();
    let is_held = |report: &&PeerReport| report.state == PeerState::Held && report.accurate;
    assert!(!late.is_empty() && late.iter().all(is_held) && last[0].accurate, "{late:?}");
}

#[test]
fn forty_minutes_of_driving_need_no_more_memory_than_its_first_minutes() {
    let folder = folder("ring-hour");
    let circle = "motion.circle = { radius_m = 0.3, duration_s = 20.0, start_s = 1.5 }";
    let walk = "motion.random_walk = { speed_m_s = 0.2, duration_s = 2400.0, within_m = 1.5 }";
    let text = scene(2, false)
        .replace(circle, walk)
        .replace("duration_s = 24.0", "duration_s = 2400.0")
        .replace("rate_hz = 100.0", "rate_hz = 20.0")
        .replace("odometry = { rate_hz = 50.0", "odometry = { rate_hz = 20.0");
    let mut config = config(&folder, &text, 2, false);
    (config.estimator.window_s, config.estimator.rate_hz, config.estimator.accurate_every_s) = (60.0, 0.1, 100.0);
    let mut machine = machine(&config);
    let mut now = Instant::ZERO;
    let mut grown = Vec::new();
    for _ in 0..8 {
        let until = now + Span::from_ms(300_000);
        let minutes = allocation_counter::measure(|| {
            while now < until {
                while machine.take(now).unwrap() {}
                while machine.poll_report(now).is_some() {}
                now += Span::from_ms(200);
            }
        });
        grown.push(minutes.bytes_current);
    }
    let counts = machine.estimator.peers().next().unwrap().1;
    println!("bytes kept of each five minutes: {grown:?}; {counts:?}");
    assert!(counts.pairs > 40_000 && counts.accurate > 20, "{counts:?}");
    let later: i64 = grown[2..].iter().sum();
    assert!(later.abs() < 256 * 1024, "{later} bytes more after forty minutes than after ten minutes");
}

#[test]
fn the_claims_of_a_running_robot_name_the_peer_whose_card_is_broken() {
    let folder = folder("ring-claims");
    for (fault, fails) in [("", &[][..]), ("faults.card = [\"phase_jumps\"]\n", &[("phase.cancels", "r1")])] {
        let text = scene(3, false).replace("name = \"r1\"\n", &format!("name = \"r1\"\n{fault}"));
        let room = Room::new(&Scene::from_toml(&text).unwrap()).unwrap();
        let config = config(&folder, &text, 3, false);
        let mut machine = machine(&config);
        let peers: Vec<_> = (1..3).map(|k| (format!("r{k}"), room.mac(k).unwrap())).collect();
        let robot = Robot { name: "r0".into(), own: room.mac(0).unwrap(), peers };
        let test = Claims::new(&config, &robot);
        machine.add_tap(Box::new(Arc::clone(&test)));
        let with = |found: &[Found], verdict| {
            let found = found.iter().filter(|(_, finding)| finding.verdict == verdict);
            found.map(|(peer, finding)| (finding.id, peer.clone().unwrap_or_default())).collect::<Vec<_>>()
        };
        assert!(with(&test.judge(), Verdict::Holds).is_empty(), "nothing was heard");
        let mut now = Instant::ZERO;
        while now < Instant::from_us(22_000_000) {
            while machine.take(now).unwrap() {}
            now += Span::from_ms(10);
        }
        let found = test.judge();
        let failed = with(&found, Verdict::Fails);
        assert_eq!(failed.iter().map(|(id, peer)| (*id, peer.as_str())).collect::<Vec<_>>(), fails, "{fault}");
        let holds = with(&found, Verdict::Holds);
        for peer in ["r1", "r2"] {
            for id in ["exchange.pairs", "exchange.drift", "log.whole", "reception.gaps"] {
                assert!(holds.contains(&(id, peer.to_owned())), "{id} {peer}: {holds:?}");
            }
        }
        assert!(holds.contains(&("reception.once", String::new())), "{holds:?}");
    }
}

#[test]
fn a_replayed_capture_gives_the_bearings_that_are_made_offline() {
    let Some(captures) = crate::common::captures() else { return };
    let mut compared = 0;
    for set in ["LOS_Set_A/L1", "NLOS_Set_A/L1"] {
        let folder = captures.join("wsr").join(set);
        if folder.is_dir() {
            compared += compare(&folder, None);
        }
    }
    assert!(compared >= 3, "{compared} links");
}

#[test]
fn a_rolling_camera_gives_the_offline_bearings() {
    let Some(captures) = crate::common::captures() else { return };
    let mount = CameraMount { forward_m: 0.04, left_m: 0.17, yaw_deg: -1.5 };
    let compared = compare(&captures.join("wsr/LOS_Set_A/L1"), Some(mount));
    assert!(compared >= 3, "{compared} links");
}

/// A real capture, and what is made of it at once, as `csi5300 bearing` does.
pub(crate) struct Offline {
    pub rx: PathBuf,
    pub trajectory: PathBuf,
    pub txs: Vec<PathBuf>,
    /// The receiver's MAC.
    pub own: String,
    /// Of each log of a transmitter: its MAC, its bearing in degrees, and pairs.
    pub links: Vec<(String, f64, u64)>,
}

/// The bearings of a capture; of the tracking camera's poses where `camera` says how it is mounted.
pub(crate) fn offline(capture: &Path, camera: Option<CameraMount>) -> Offline {
    use csi5300::pipeline::{LinkReport, Transmitter, bearings};
    use csi5300::source::replay::Replay;
    let mut files: Vec<PathBuf> = std::fs::read_dir(capture).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let named = |begin: &str| -> Vec<PathBuf> {
        let is = |file: &&PathBuf| file.file_name().unwrap().to_str().unwrap().starts_with(begin);
        files.iter().filter(is).cloned().collect()
    };
    let poses = if camera.is_some() { "t265_rx_trajectory_" } else { "rx_trajectory_" };
    let (rx, trajectory, txs) = (named("csi_rx_").remove(0), named(poses).remove(0), named("csi_tx"));
    let (mut path, _) = csi5300::motion::odometry::csv::read(&trajectory, None).unwrap();
    if let Some(camera) = camera {
        path = path.of_antenna(Some(camera.mount()), Some([0.05, 0.16, 0.0].into())).unwrap();
    }
    let mut logs: Vec<_> = txs.iter().map(|tx| Replay::open(tx).unwrap()).collect();
    let transmitters =
        logs.iter_mut().map(|log| Transmitter { log: log as &mut (dyn CsiSource + Send), trajectory: None }).collect();
    let options = csi5300::pipeline::Options::new("108".parse().unwrap());
    let report = bearings(&mut Replay::open(&rx).unwrap(), transmitters, &path, &options).unwrap();
    // The receiver's own MAC is the sender of most frames in a transmitter's log.
    let senders = &report.transmitters[0].survey.senders;
    let own = senders.iter().max_by_key(|(_, sender)| sender.records).unwrap().0.to_string();
    let answer = |link: &LinkReport| {
        let bearing = link.bearing.as_ref().unwrap();
        (link.mac.unwrap().to_string(), bearing.answer.azimuth_rad.to_degrees(), bearing.pairs.formed as u64)
    };
    Offline { rx, trajectory, txs, own, links: report.links.iter().map(answer).collect() }
}

/// Compares what a node says of a replayed capture with what is made of it at once, link by link.
fn compare(capture: &Path, camera: Option<CameraMount>) -> usize {
    let Offline { rx, trajectory, txs, own, links } = offline(capture, camera);
    let mounting = camera.map(|CameraMount { forward_m, left_m, yaw_deg }| {
        format!(
            "antenna_offset_m = [0.05, 0.16, 0.0]\n\
             camera_mount = {{ forward_m = {forward_m}, left_m = {left_m}, yaw_deg = {yaw_deg} }}\n"
        )
    });
    let mut text = mounting.unwrap_or_default();
    let _ = write!(
        text,
        "mac = \"{own}\"\nchannel = \"108\"\ncapture.replay.file = '{}'\nodometry.csv.file = '{}'\n\
         [estimator]\nwindow_m = 1000\nwindow_s = 100000\nrate_hz = 0.02\n",
        rx.display(),
        trajectory.display()
    );
    for (tx, (mac, ..)) in txs.iter().zip(&links) {
        let _ = write!(text, "[[peer]]\nname = \"{mac}\"\nmac = \"{mac}\"\nrecords.replay.file = '{}'\n", tx.display());
    }
    let config = Config::read(&text, Path::new("")).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let (_, last) = run(machine(&config), Instant::from_us(i64::MAX));
    for ((_, azimuth_deg, pairs), report) in links.iter().zip(&last) {
        let off = off_deg(report, *azimuth_deg);
        println!("{}: {off:.4} deg, {} and {pairs} pairs", report.answer.link, report.answer.pairs);
        assert!(off <= 0.01, "{off} {report:?}");
    }
    last.len()
}

const AX210: &str = "duration_s = 26.0\nseed = 5\nchannel = 108\ncard = \"ax210\"\npreamble = \"he\"\ncfo = \"physical\"\n\
    sounding.rate_hz = 60\n\
    [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\ndelay_ns = 100\ndelay_std_ns = 20\nturn_around.spread_us = 8\n\
    [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.25, duration_s = 20.0, start_s = 1.0 }\n\
    crystal.clock_start_us = 4294960000\nodometry = { rate_hz = 50.0 }\n\
    [[robot]]\nname = \"tx\"\nposition_m = [7.0, -4.0, 0.0]\ncrystal.offset_ppm = 4.0\nhost_clock = { offset_s = 11.0 }\n";

#[test]
fn two_ax210s_give_the_true_bearing_despite_losses_and_a_restart() {
    let folder = folder("ax210");
    let text = "channel = \"108\"\ncapture.room = { scene = \"room.toml\", robot = \"rx\" }\nodometry.room = {}\n\
                [[peer]]\nname = \"tx\"\nrecords.room = {}\n[estimator]\nrate_hz = 0.5\n";
    // From the centre of the circle, 25 cm to the left of the start.
    let truth_deg = (-4.25_f64).atan2(7.0).to_degrees();
    let (lossy, restarts) = ("faults.loss = 0.3\n", "faults = { loss = 0.3, restart_at_s = [8.0], restart_s = 0.1 }\n");
    for (rx, tx, least) in [("", "", 1_300), (lossy, lossy, 600), (lossy, restarts, 350)] {
        let scene = AX210.replace("[[robot]]\nname = \"tx\"", &format!("{rx}[[robot]]\nname = \"tx\"")) + tx;
        std::fs::write(folder.join("room.toml"), scene).unwrap();
        let config = Config::read(text, &folder).unwrap_or_else(|error| panic!("{error}"));
        let (reports, last) = run(machine(&config), Instant::from_us(25_000_000));
        let (off, report) = (off_deg(&last[0], truth_deg), &last[0]);
        println!("{rx}{tx}{off:.3} deg off, {} pairs", report.answer.pairs);
        assert!(report.state == PeerState::Bearing && off < 0.2, "{off} {report:?}");
        assert!(report.answer.pairs >= least && report.answer.compensated, "{report:?}");
        assert!(reports.iter().any(|(at, _, report)| at.as_s() < 12.0 && report.state == PeerState::Bearing));
    }
}

fn two_antennas(more: &str) -> String {
    format!(
        "channel = \"108\"\ncapture.room = {{ scene = \"two-antennas\", robot = \"rx\" }}\nodometry.room = {{}}\n\
         [array]\nantennas = [\"A\", \"B\"]\nbaselines_m = [[0.10, 0.0, 0.0]]\n{more}"
    )
}

#[test]
fn a_turning_robot_has_a_bearing_of_each_sender() {
    let folder = folder("two-antennas");
    let room = Room::new(&Scene::find("two-antennas".as_ref()).unwrap()).unwrap();
    let truth_deg = 5.0_f64.atan2(3.0).to_degrees();
    for (more, name) in [("", "02:53:00:00:00:02"), ("[[peer]]\nname = \"tx\"\nrecords.heard = {}\n", "tx")] {
        let config = Config::read(&two_antennas(more), &folder).unwrap_or_else(|error| panic!("{error}"));
        let (reports, last) = run(machine(&config), Instant::from_us(12_000_000));
        let [report] = &last[..] else { panic!("{last:?}") };
        let off = off_deg(report, truth_deg);
        println!("{name}: {off:.3} deg off, +- {:?}, {} records", report.answer.azimuth_sd_deg, report.answer.pairs);
        assert_eq!((report.answer.link.as_str(), report.state), (name, PeerState::Bearing));
        assert_eq!(report.answer.mac.as_deref(), Some(room.mac(1).unwrap().to_string().as_str()));
        assert!(off < 0.5 && off < 3.0 * report.answer.azimuth_sd_deg.unwrap(), "{off} {report:?}");
        assert_eq!(report.answer.chain_constants_deg.len(), 1);
        let words: Vec<&str> = reports.iter().map(|(.., report)| report.words.as_str()).collect();
        assert!(words.iter().any(|words| words.starts_with("not yet: turned")), "{words:?}");
        let made = reports.iter().filter(|(.., report)| report.state == PeerState::Bearing).count();
        assert!(made >= 12, "{made} {words:?}");
    }
}

#[test]
fn a_standing_robot_has_a_bearing_with_the_chain_constant_of_an_earlier_turn() {
    let folder = folder("two-antennas-stand");
    let config = Config::read(&two_antennas(""), &folder).unwrap();
    let (_, last) = run(machine(&config), Instant::from_us(12_000_000));
    let [deg, sd_deg] = last[0].answer.chain_constants_deg[0];
    let known = two_antennas(&format!("chain_constants_deg = [[{deg:?}, {sd_deg:?}]]\n"));
    let config = Config::read(&known, &folder).unwrap_or_else(|error| panic!("{error}"));
    // Before the turn.
    let (_, last) = run(machine(&config), Instant::from_us(900_000));
    let truth_deg = 5.0_f64.atan2(3.0).to_degrees();
    // The mirror, and the grating lobes of a baseline longer than half a wavelength, are candidates too.
    let off = |azimuth_deg: f64| csi5300::maths::wrap_rad((azimuth_deg - truth_deg).to_radians()).to_degrees().abs();
    let nearest = last[0].answer.candidates.iter().map(|own| off(own.azimuth_deg)).fold(f64::MAX, f64::min);
    println!("standing: nearest candidate {nearest:.2} deg off of {}", last[0].answer.candidates.len());
    assert!(last[0].state == PeerState::Bearing && nearest < 3.0, "{:?}", last[0]);
}

#[test]
fn antennas_and_answers_of_a_peer_are_combined() {
    let folder = folder("two-antennas-both");
    let text = two_antennas("[[peer]]\nname = \"tx\"\nrecords.room = {}\n[estimator]\nleast_motion_m = 0.02\n");
    let scene = std::fs::read_to_string(crate::common::root().join("scenes/two-antennas.toml")).unwrap();
    std::fs::write(folder.join("room.toml"), scene.replace("radius_m = 0.0", "radius_m = 0.05")).unwrap();
    let text = text.replace("scene = \"two-antennas\"", "scene = \"room.toml\"");
    let config = Config::read(&text, &folder).unwrap_or_else(|error| panic!("{error}"));
    let (_, last) = run(machine(&config), Instant::from_us(12_000_000));
    let [report] = &last[..] else { panic!("{last:?}") };
    let [two, one] = report.answer.kinds_deg[..] else { panic!("{report:?}") };
    let off = off_deg(report, 5.0_f64.atan2(3.0).to_degrees());
    println!("{two:?} from answers, {one:?} from antennas, combined {off:.2} deg off");
    assert!(report.state == PeerState::Bearing && off < 1.0, "{off} {report:?}");
    assert!(report.answer.azimuth_sd_deg.unwrap() < 1.1 * two[1].min(one[1]) + 0.02, "{report:?}");
}
