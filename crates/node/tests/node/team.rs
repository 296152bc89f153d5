//! A robot and its peers as one graph, in simulated rooms and virtual time.

use crate::folder;
use crate::robots::machine;
use csi5300::motion::pose::Pose;
use csi5300::time::{Instant, Span};
use csi5300_node::config::Config;
use csi5300_node::machine::Tap;
use csi5300_node::team::{Graph, Member, Ranged, Ranges, Solver, TeamState};
use serde_json::Value;
use std::fmt::Write;

/// Places of the robots in the room, metres.
const PLACES: [[f64; 2]; 4] = [[0.0, 0.0], [4.0, 3.0], [-5.0, 2.0], [1.0, -5.0]];

/// A room in which robot number `walker` walks and the others stand.
fn scene(walker: usize) -> String {
    let mut text = String::from(
        "name = \"team\"\nseed = 3\nduration_s = 60.0\nchannel = 108\ncfo = \"physical\"\n[sounding]\nrate_hz = 50.0\n\
         [radio]\nphase_noise_rad = 0.1\nsend_jitter_us = 60.0\nturn_around = { spread_us = 6.0 }\n",
    );
    for (k, [x, y]) in PLACES.iter().enumerate() {
        let _ = write!(
            text,
            "[[robot]]\nname = \"r{k}\"\nposition_m = [{x}, {y}, 0.2]\nodometry = {{ rate_hz = 50.0, noise_m = 0.0003 }}\n"
        );
        if k == walker {
            text += "motion.random_walk = { speed_m_s = 0.3, duration_s = 58.0, start_s = 1.0, within_m = 2.5 }\n";
        }
    }
    text
}

/// Another sensor of the robot that walks: ranges to `r1` five times a second, with an error of 0.1 m; one in seven is 3 m too long.
struct Uwb(Ranges, usize);

impl Tap for Uwb {
    fn pose(&mut self, pose: Option<Pose>) {
        let Some(pose) = pose else { return };
        self.1 += 1;
        if self.1.is_multiple_of(10) {
            let [x, y] = PLACES[1];
            let late_m = if self.1.is_multiple_of(70) { 3.0 } else { 0.14 * (self.1 as f64).sin() };
            let range_m = (pose.position_m.x - x).hypot(pose.position_m.y - y) + late_m;
            self.0.put("r1", Some(Ranged { t_s: pose.t_s, range_m: [range_m, 0.1] }));
        }
    }
}

/// The configuration of robot `r0`.
fn config(name: &str, walker: usize, peers: &[usize], rest: &str) -> Config {
    let folder = folder(name);
    std::fs::write(folder.join("team.toml"), scene(walker)).unwrap();
    let mut text = "channel = \"108\"\ncapture.room = { scene = \"team.toml\", robot = \"r0\" }\n".to_owned();
    text += if walker == 0 { "odometry.room = {}\n" } else { "odometry.static = {}\n" };
    text += "[estimator]\nwindow_m = 1.0\naccurate_every_s = 2.0\n";
    for k in peers {
        let _ = write!(text, "[[peer]]\nname = \"r{k}\"\nrecords.room = {{}}\n");
        if walker == *k {
            text += "poses.room = {}\n";
        }
    }
    text += rest;
    Config::read(&text, &folder).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// The state of the team when the records have ended, as robot `r0` sees it.
fn team(name: &str, walker: usize, peers: &[usize], rest: &str) -> Result<TeamState, String> {
    solved(&config(name, walker, peers, rest))
}

fn solved(config: &Config) -> Result<TeamState, String> {
    let (mut machine, ranges, mut now) = (machine(config), Ranges::default(), Instant::ZERO);
    let mut graph = Graph::new(config, "r0", ranges.clone()).unwrap();
    if config.team.as_ref().is_some_and(|team| !team.ranges.is_empty()) {
        machine.add_tap(Box::new(Uwb(ranges, 0)));
    }
    while !machine.is_done(now) {
        while machine.take(now).unwrap() {}
        while let Some((peer, report)) = machine.poll_report(now) {
            graph.note(peer, &report, &machine);
        }
        now = machine.next_at().unwrap_or(now).max(now + Span::from_ms(1));
    }
    graph.solve().map_err(|error| error.to_string())
}

/// Asserts that a robot is where it is said to be, by the covariance: 99.9 % of errors are within these deviations.
fn is_at(own: &Member, truth: [f64; 2]) {
    let off = nalgebra::Vector2::from(own.position_m) - nalgebra::Vector2::from(truth);
    let covariance = nalgebra::Matrix3::from(own.covariance).fixed_view::<2, 2>(0, 0).into_owned();
    let deviations = (off.transpose() * covariance.try_inverse().unwrap() * off)[0].sqrt();
    println!(
        "{}: {:.3} m off, {deviations:.2} deviations, variances {:?}",
        own.name,
        off.norm(),
        covariance.diagonal()
    );
    assert!(deviations < 3.72 && off.norm() < 0.5 && covariance.trace() < 0.5, "{own:?} {truth:?}");
}

#[test]
fn a_robot_that_walks_finds_the_places_of_those_that_stand() {
    let found = team("team-walk", 0, &[1, 2, 3], "[team]\n").unwrap();
    let names: Vec<&str> = found.robots.iter().map(|own| own.name.as_str()).collect();
    assert_eq!((names, &found.notes, found.frame.as_ref()), (vec!["r0", "r1", "r2", "r3"], &Vec::new(), None));
    (1..4).for_each(|k| is_at(&found.robots[k], PLACES[k]));
    assert!(found.odometry.iter().all(|x| x.abs() < 1e-2), "the frame is that of the odometry: {found:?}");
    let factors: Value = serde_json::from_str(&found.factors).unwrap();
    assert_eq!(factors["format"], "csi5300-team");
    let links = factors["graph"]["links"].as_array().unwrap().len();
    println!("{links} bearings, {} bytes", found.factors.len());
    assert!(links >= 12 && links == factors["solution"]["chosen"].as_array().unwrap().len());
}

#[test]
fn known_places_give_the_pose_of_the_robot_in_their_frame() {
    // The room turned by 2 rad, then moved.
    let (sin, cos) = 2f64.sin_cos();
    let hall = |[x, y]: [f64; 2]| [10.0 + cos * x - sin * y, -4.0 + sin * x + cos * y];
    let place = |k: usize| format!("r{k} = {:?}", hall(PLACES[k]));
    let rest = format!("[team]\nplaces = {{ {}, {} }}\n", place(1), place(2));
    let found = team("team-places", 0, &[1, 2, 3], &rest).unwrap();
    assert_eq!(found.frame.as_deref(), Some("map"));
    is_at(&found.robots[3], hall(PLACES[3]));
    let [x, y, yaw] = found.odometry;
    assert!((x - 10.0).hypot(y + 4.0) < 0.3 && (yaw - 2.0).abs() < 0.1, "{:?}", found.odometry);
    // This robot's covariance is that of its errors too.
    assert!(found.robots[0].covariance[0][0] < 0.1 && found.robots[0].covariance[2][2] < 0.01, "{:?}", found.robots[0]);
    // Without a bearing to a known place there is no frame.
    let mut config = config("team-unseen", 0, &[1], "[team]\n");
    config.team.as_mut().unwrap().places.insert("r2".into(), [1.0, 2.0]);
    let unseen = solved(&config);
    assert!(unseen.as_ref().is_err_and(|why| why.contains("r0 has no link")), "{unseen:?}");
}

#[test]
fn a_frame_that_is_over_has_no_place_among_known_ones() {
    let place = |k: usize| format!("r{k} = {:?}", PLACES[k]);
    let rest = format!("[team]\nplaces = {{ {}, {} }}\n", place(1), place(2));
    let config = config("team-restart", 0, &[1, 2], &rest);
    let (mut machine, mut now) = (machine(&config), Instant::ZERO);
    let mut solver = Solver::start(&config, "r0", Ranges::default()).unwrap().unwrap();
    let mut restarted = false;
    loop {
        while machine.take(now).unwrap() {}
        while let Some((peer, report)) = machine.poll_report(now) {
            solver.note(peer, &report, &machine);
            if restarted {
                let state = solver.look();
                assert!(state.robots.is_empty() && state.frame.is_none(), "{state:?}");
                assert!(state.notes[0].contains("another frame"), "{:?}", state.notes);
                return;
            } else if now.as_s() > 30.0 {
                while solver.look().solved == 0 {
                    std::thread::yield_now();
                }
                let state = solver.look();
                assert_eq!((state.frame.as_deref(), state.robots.is_empty()), (Some("map"), false));
                machine.handle_clock_set();
                restarted = true;
            }
        }
        assert!(!machine.is_done(now));
        now = machine.next_at().unwrap_or(now).max(now + Span::from_ms(1));
    }
}

#[test]
fn a_peer_that_walks_has_the_frame_of_its_own_poses() {
    let found = team("team-peer", 1, &[1], "[team]\n").unwrap();
    let factors: Value = serde_json::from_str(&found.factors).unwrap();
    let keyframes = factors["graph"]["keyframes"].as_array().unwrap();
    // In the room, all poses are in one frame: the solution must find that.
    let mut worst: f64 = 0.0;
    for (k, keyframe) in keyframes.iter().enumerate().filter(|(_, keyframe)| keyframe["robot"] == 1) {
        let number = |value: &Value, part: usize| value[part].as_f64().unwrap();
        let (told, solved) = (&keyframe["odometry"], &factors["solution"]["poses"][k]);
        let off_m = (number(told, 0) - number(solved, 0)).hypot(number(told, 1) - number(solved, 1));
        worst = worst.max(off_m);
    }
    println!("{} keyframes, at most {worst:.3} m off", keyframes.len());
    assert!(worst > 0.0 && worst < 0.5, "{worst}");
}

#[test]
fn ranges_of_another_sensor_narrow_a_place() {
    let bearings = team("team-bearings", 0, &[1], "[team]\n").unwrap();
    let both = team("team-ranges", 0, &[1], "[team]\nranges.r1 = { topic = \"/uwb\" }\n").unwrap();
    let [without, with] = [&bearings, &both].map(|found| found.robots.iter().find(|own| own.name == "r1").unwrap());
    is_at(with, PLACES[1]);
    let trace = |own: &Member| own.covariance[0][0] + own.covariance[1][1];
    assert!(trace(with) < 0.5 * trace(without), "{without:?} {with:?}");
    let factors: Value = serde_json::from_str(&both.factors).unwrap();
    let (links, chosen) = (&factors["graph"]["links"], factors["solution"]["chosen"].as_array().unwrap());
    let is_range = |link: &Value| link["modes"][0]["azimuth_rad"].is_null();
    let ranges: Vec<usize> = (0..chosen.len()).filter(|k| is_range(&links[*k])).collect();
    let wrong = ranges.iter().filter(|k| chosen[**k].is_null()).count();
    println!("{} of {} links are ranges, {wrong} of them outliers", ranges.len(), chosen.len());
    assert!(ranges.len() >= 8 && wrong >= 1 && wrong <= ranges.len() / 3, "{wrong} of {}", ranges.len());
}
