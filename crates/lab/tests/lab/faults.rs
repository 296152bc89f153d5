//! The pipeline finds exactly the faults that the room injects: counts are equal.

use csi5300::exchange::pairing::{LinkSide, SideCounts};
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{CaptureReport, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_lab::compare::figures::true_path;
use csi5300_sim::{Injected, Room, Scene};

fn options() -> Options {
    Options::new(Channel::new(108, Width::Ht20).unwrap())
}

/// Two robots for 10 s at 100 rounds a second; the last exchange is over before the end.
fn scene(seed: u64, rx: &str, tx: &str) -> Scene {
    let text = format!(
        "seed = {seed}\nduration_s = 9.995\nradio.host_latency_us = 50.0\n[sounding]\nrate_hz = 100\n\
         [[robot]]\nname = \"rx\"\nmotion.circle = {{ radius_m = 0.3, duration_s = 9.0 }}\n{rx}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [-3.858, 0.929, 0.0]\n{tx}\n"
    );
    Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

struct Ran {
    report: CaptureReport,
    rx: Injected,
    tx: Injected,
}

impl Ran {
    /// Runs a room through the pipeline, from the cards' own bytes.
    fn new(scene: &Scene) -> Self {
        let mut room = Room::new(scene).unwrap();
        let path = true_path(&room, 0).unwrap();
        let (mut rx, mut tx) = (room.card(0).unwrap(), room.card(1).unwrap());
        let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
        let report = bearings(&mut rx, transmitters, &path, &options()).unwrap();
        let injected = room.injected();
        let ran = Self { report, rx: injected[0], tx: injected[1] };
        for (log, injected) in [(&ran.report.receiver, ran.rx), (&ran.report.transmitters[0], ran.tx)] {
            assert_eq!(log.survey.bfees(), injected.delivered);
            assert_eq!(log.survey.overruns, injected.overrun_records);
            assert_eq!((log.survey.bad_bfee, log.survey.damages), (0, 0));
        }
        for side in [LinkSide::Receiver, LinkSide::Transmitter] {
            let c = ran.counts(side);
            let fates = c.paired + c.unpaired + c.duplicates + c.implausible + c.mispaired;
            assert_eq!(c.handed, fates, "{side:?}: {c:?}");
        }
        ran
    }

    fn counts(&self, side: LinkSide) -> SideCounts {
        self.report.links[0].link.as_ref().unwrap().counts(side)
    }

    fn pairs(&self) -> u64 {
        self.report.links[0].link.as_ref().unwrap().pairs() as u64
    }

    /// Records of both sides that are neither duplicate nor suspect.
    fn clean(&self) -> (SideCounts, SideCounts) {
        let sides = (self.counts(LinkSide::Receiver), self.counts(LinkSide::Transmitter));
        for c in [sides.0, sides.1] {
            assert_eq!((c.implausible, c.mispaired), (0, 0), "{c:?}");
        }
        sides
    }
}

#[test]
fn lost_frames_are_unpaired_or_missing() {
    for (seed, percent) in [(1, 0), (2, 2), (3, 10), (4, 25), (5, 50), (6, 50)] {
        let faults = format!("faults.loss = {}", f64::from(percent) / 100.0);
        let ran = Ran::new(&scene(seed, &faults, &faults));
        let (rx, tx) = ran.clean();
        assert_eq!(ran.tx.lost + tx.handed, ran.rx.sent, "{percent} %: each forward frame is heard or lost");
        assert_eq!(tx.unpaired, ran.rx.lost, "{percent} %: heard by the one, its answer lost");
        assert_eq!((rx.unpaired, ran.pairs()), (0, rx.handed), "{percent} %");
        assert!(percent < 25 || (ran.rx.lost > 80 && ran.tx.lost > 200), "{:?}", ran.rx);
        assert!(ran.report.links[0].bearing.is_ok());
    }
}

#[test]
fn overruns_and_drops_are_gaps() {
    let stalls = "faults = { queue_records = 20, stall_every_s = 2.0, stall_s = 0.5 }";
    let ran = Ran::new(&scene(1, stalls, "faults.driver_drop = 0.1"));
    let (rx, tx) = ran.clean();
    assert_eq!(rx.handed + ran.rx.overrun_records, ran.rx.received);
    assert_eq!(tx.handed + ran.tx.driver_dropped, ran.tx.received);
    assert!(ran.rx.overrun_records > 90 && ran.tx.driver_dropped > 60, "{:?} {:?}", ran.rx, ran.tx);
    // The driver's counter shows those between records; the receiver's last stall ends before the scene does.
    assert_eq!(ran.report.receiver.survey.bfee_missing, ran.rx.overrun_records);
    let missing = ran.report.transmitters[0].survey.bfee_missing;
    assert_eq!(missing, ran.tx.driver_dropped - ran.tx.driver_dropped_unseen, "{:?}", ran.tx);
    assert_eq!(ran.pairs(), rx.paired);
}

/// The driver's counter shows what it dropped between two records, and nothing at the ends of a log or around a restart.
#[test]
fn drops_at_the_ends_and_around_a_restart_are_not_visible() {
    for seed in 1..=12 {
        let faults = "faults = { driver_drop = 0.5, restart_at_s = [3.0, 6.0], restart_s = 0.5 }";
        let mut room = Room::new(&scene(seed, "", faults)).unwrap();
        let mut card = room.card(1).unwrap();
        let (mut survey, mut now) = (Survey::default(), Instant::ZERO);
        loop {
            let next = card.receive(now).unwrap();
            survey.note(&next);
            match next {
                Next::Record(..) => (),
                Next::Pending => now = card.next_at().unwrap(),
                Next::Lost(loss) => panic!("{loss:?}"),
                Next::End(_) => break,
            }
        }
        let injected = room.injected()[1];
        assert_eq!(survey.bfee_missing, injected.driver_dropped - injected.driver_dropped_unseen, "seed {seed}");
        assert_eq!((survey.bfee_restarted, injected.restarts), (2, 2), "seed {seed}");
    }
}

#[test]
fn both_see_an_initiators_restart_and_nobody_a_responders() {
    let ran = Ran::new(&scene(1, "faults = { restart_at_s = [4.0, 7.0], restart_s = 0.5 }", ""));
    let (rx, tx) = ran.clean();
    assert_eq!((rx.restarts, tx.restarts), (ran.rx.restarts, ran.rx.restarts));
    assert_eq!(ran.rx.restarts, 2);
    assert_eq!(ran.pairs() + rx.unpaired, ran.rx.delivered);
    assert_eq!((rx.unpaired, tx.handed - tx.paired), (0, ran.tx.delivered - ran.rx.delivered));
    let ran = Ran::new(&scene(2, "", "faults = { restart_at_s = [4.0], restart_s = 0.5 }"));
    let (rx, tx) = (ran.counts(LinkSide::Receiver), ran.counts(LinkSide::Transmitter));
    assert_eq!((rx.restarts, tx.restarts, ran.tx.restarts), (0, 0, 1), "its frames have the initiator's numbers");
    assert_eq!(tx.missing, ran.tx.missed_while_off, "as long as it was off");
    assert_eq!(ran.pairs(), ran.tx.delivered, "its card's clock began anew, and every pair is found");
}

#[test]
fn all_faults_at_once_add_up() {
    for seed in 1..=8 {
        let faults = "faults = { loss = 0.15, duplicate = 0.05, driver_drop = 0.02, queue_records = 15, \
                      stall_every_s = 3.0, stall_s = 0.4, restart_at_s = [5.2], restart_s = 0.3 }\n\
                      crystal.offset_ppm = 9.0\nhost_clock.drift_ppm = 40.0";
        // Ran::new asserts that every record is accounted for, on both sides.
        let ran = Ran::new(&scene(seed, faults, faults));
        assert_eq!(ran.counts(LinkSide::Receiver).handed, ran.rx.delivered);
        assert_eq!(ran.counts(LinkSide::Transmitter).handed, ran.tx.delivered);
        assert_eq!(ran.counts(LinkSide::Receiver).paired, ran.pairs());
        assert!(ran.pairs() > 300, "seed {seed}: {} pairs", ran.pairs());
    }
}

#[test]
fn lost_poses_are_gaps_in_the_trajectory() {
    let odometry = "odometry = { rate_hz = 50.0, drop = 0.3, late = 0.1, late_s = 0.1 }";
    let room = Room::new(&scene(1, odometry, "")).unwrap();
    let (mut source, mut now, mut poses) = (room.odometry(0).unwrap(), Instant::ZERO, Vec::new());
    loop {
        match source.receive(now).unwrap() {
            NextPose::Pose(pose) => poses.push(pose),
            NextPose::NewFrame => panic!("the frame is the scene's"),
            NextPose::Pending => now = source.next_at().unwrap(),
            NextPose::End => break,
        }
    }
    let injected = room.injected()[0];
    assert_eq!(poses.len() as u64, injected.poses);
    assert_eq!(injected.poses + injected.poses_dropped, 500, "50 a second for 9.995 s");
    assert!(injected.poses_dropped > 100 && injected.poses_late > 20, "{injected:?}");
    let trajectory = Trajectory::new(poses).unwrap();
    let places = trajectory.poses().windows(2).map(|w| ((w[1].t_s - w[0].t_s) * 50.0).round() as u64 - 1);
    let (first_s, last_s) = trajectory.span_s();
    let edges = (50.0 * (first_s - 1.7e9)).round() as u64 + (499.0 - 50.0 * (last_s - 1.7e9)).round() as u64;
    assert_eq!(places.sum::<u64>() + edges, injected.poses_dropped);
}

#[test]
fn a_gap_of_the_trajectory_is_no_sign_of_exchanged_logs() {
    let mut room = Room::new(&scene(1, "", "")).unwrap();
    let path = true_path(&room, 0).unwrap();
    let is_told = |pose: &&Pose| !(1.7e9 + 3.0..1.7e9 + 5.0).contains(&pose.t_s);
    let path = Trajectory::new(path.poses().iter().filter(is_told).copied().collect()).unwrap();
    let (mut rx, mut tx) = (room.card(0).unwrap(), room.card(1).unwrap());
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let mut report = bearings(&mut rx, transmitters, &path, &options()).unwrap();
    let pairs = report.links.remove(0).bearing.unwrap().pairs;
    assert!(pairs.no_pose > pairs.formed / 10 && !pairs.may_be_exchanged(), "{pairs:?}");
}
