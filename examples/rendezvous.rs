//! Four robots that know nothing of each other but bearings meet: each in turn drives a small circle, sounds the others
//! and learns their directions; then all go a step along the mean of theirs, and it begins again. Prints a line a round, with
//! a distance that falls from 10 m to less than 2.5 m.
//!
//! `cargo run --release --example rendezvous`

use csi5300::motion::odometry::{NextPose, OdometrySource, csv};
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Error};
use csi5300::time::Instant;
use csi5300_sim::motion::{Circle, RobotMotion};
use csi5300_sim::{Room, Scene, write_dataset};

type Anything<T> = Result<T, Box<dyn std::error::Error>>;

/// What a robot has after a turn: its own log, the others', and where its odometry says it was.
struct Turn {
    own: Box<dyn CsiSource + Send>,
    others: Vec<Box<dyn CsiSource + Send>>,
    path: Trajectory,
}

/// Radius of the circle, and time for it.
const RADIUS_M: f64 = 0.15;
const TURN_S: f64 = 4.0;
/// Robots stop this far from each other.
const NEAR_M: f64 = 2.5;

fn main() -> Anything<()> {
    // One line decides where records come from: the cards of a room as they are, or files that were recorded.
    let turn = simulated;
    // let turn = replayed;
    let mut places = [[0.0, 0.0], [9.0, 1.0], [8.0, 8.0], [-1.0, 6.0]];
    let options = Options::new(Channel::new(108, Width::Ht20)?);
    for round in 1..=12 {
        let widest = spread_m(&places);
        println!("round {round}: the two farthest apart are {widest:.2} m from each other");
        if widest < NEAR_M {
            return Ok(());
        }
        let mut steps = [[0.0; 2]; 4];
        for (robot, step) in steps.iter_mut().enumerate() {
            let scene = scene(&places, robot, round)?;
            let Turn { mut own, mut others, path } = turn(&scene)?;
            let logs = others.iter_mut().map(|log| Transmitter { log: log.as_mut(), trajectory: None }).collect();
            // Who is who: each log's robot has an address of its own.
            let tx_macs = (1..4).filter_map(|k| scene.robot[k].mac_address(k)).collect();
            let report = bearings(own.as_mut(), logs, &path, &Options { rx_mac: None, tx_macs, ..options.clone() })?;
            for link in report.links {
                let (sin, cos) = link.bearing?.answer.azimuth_rad.sin_cos();
                *step = [step[0] + cos / 3.0, step[1] + sin / 3.0];
            }
        }
        for (place, step) in places.iter_mut().zip(steps) {
            *place = [place[0] + step[0], place[1] + step[1]];
        }
    }
    Err("they did not meet".into())
}

/// The room in which `robot` drives its circle and sounds the others. The robot is always the first of the scene.
fn scene(places: &[[f64; 2]; 4], robot: usize, seed: u64) -> Anything<Scene> {
    let mut text =
        format!("seed = {seed}\nduration_s = {TURN_S:?}\nradio.noise.snr_db = 15.0\nsounding.rate_hz = 100\n");
    for k in 0..4 {
        let number = (robot + k) % 4;
        let [x, y] = places[number];
        text += &format!("[[robot]]\nname = \"r{number}\"\nposition_m = [{x:?}, {y:?}, 0.2]\n");
        text += "odometry = { noise_m = 0.0005 }\n";
    }
    let mut scene = Scene::from_toml(&text)?;
    scene.robot[0].motion =
        RobotMotion::Circle(Circle { radius_m: RADIUS_M, duration_s: TURN_S, turns: 1.0, start_s: 0.0 });
    Ok(scene)
}

/// A turn straight from the room: each robot's backend is a source of records, an injector and an odometry.
fn simulated(scene: &Scene) -> Anything<Turn> {
    let mut room = Room::new(scene)?;
    let mut own = room.backend(0).ok_or("no robot")?;
    let others = (1..4).filter_map(|robot| room.backend(robot));
    let others = others.map(|other| Box::new(other.card) as Box<dyn CsiSource + Send>).collect();
    let path = drive(&mut own.odometry)?;
    Ok(Turn { own: Box::new(own.card), others, path })
}

/// The same turn as recorded files.
#[allow(dead_code)]
fn replayed(scene: &Scene) -> Anything<Turn> {
    let folder = std::env::temp_dir().join(format!("csi5300-rendezvous-{}", std::process::id()));
    let captures = write_dataset(&mut Room::new(scene)?, &folder, &mut |_| {})?;
    let capture = captures.first().ok_or("no capture")?;
    let (path, _) = csv::read(&folder.join(format!("odom_rx_trajectory_{}_.csv", capture.stamp)), None)?;
    let logs: Result<Vec<_>, Error> = capture.logs.iter().map(|log| Replay::open(&log.path)).collect();
    let mut logs = logs?.into_iter().map(|log| Box::new(log) as Box<dyn CsiSource + Send>);
    Ok(Turn { own: logs.next().ok_or("no log")?, others: logs.collect(), path })
}

/// All poses of an odometry.
fn drive(odometry: &mut dyn OdometrySource) -> Anything<Trajectory> {
    let (mut poses, mut now) = (Vec::new(), Instant::ZERO);
    loop {
        match odometry.receive(now)? {
            NextPose::Pose(pose) => poses.push(pose),
            NextPose::NewFrame => {}
            NextPose::Pending => now = odometry.next_at().unwrap_or(now),
            NextPose::End => return Ok(Trajectory::new(poses)?),
        }
    }
}

fn spread_m(places: &[[f64; 2]; 4]) -> f64 {
    let apart = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    places.iter().flat_map(|a| places.iter().map(move |b| apart(a, b))).fold(0.0, f64::max)
}
