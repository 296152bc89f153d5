//! Answers of the default pipeline in free space, for motion of one end or both, compared with their truth and the Cramer-Rao bound;
//! `arrays` are those of one log, in rooms, too:
//! `cargo run --release --bin geometries [helix | near | shapes | both | wide | random | arrays]`.

use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Array, Options, one_log};
use csi5300_lab::Failure;
use csi5300_lab::compare::figures::true_path;
use csi5300_sim::Room;
use csi5300_sim::motion::{Arc, Circle, Helix, Line, RandomWalk, RobotMotion, Square, Waypoints};
use csi5300_sim::radio::{Noise, Radio};
use csi5300_sim::random::Stream;
use csi5300_sim::scene::{Robot, Scene, Sounding, Wall};
use driver_iface::bfee::Antenna;
use ends::{Ends, Seen};
use nalgebra::Vector3;
use rayon::prelude::*;

#[path = "../../../crates/lab/tests/lab/ends.rs"]
mod ends;

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let all: [(&str, fn()); 7] = [
        ("helix", helix),
        ("near", near),
        ("shapes", shapes),
        ("both", both),
        ("wide", wide),
        ("random", random),
        ("arrays", arrays),
    ];
    all.iter().filter(|(name, _)| wanted.is_empty() || wanted.iter().any(|w| w == name)).for_each(|(_, run)| run());
}

fn spiral(radius_m: f64, rise_m: f64, turns: f64) -> RobotMotion {
    RobotMotion::Helix(Helix { radius_m, rise_m, duration_s: 6.0, turns, start_s: 0.0 })
}

fn away(azimuth_deg: f64, elevation_deg: f64, range_m: f64) -> [f64; 3] {
    let ((sin, cos), (up, flat)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    [range_m * flat * cos, range_m * flat * sin + 0.3, range_m * up + 0.15]
}

fn options() -> Options {
    match "108".parse() {
        Ok(channel) => Options::new(channel),
        Err(error) => panic!("channel 108: {error}"),
    }
}

fn run(ends: &[Ends]) -> Vec<Seen> {
    let one = |ends: &Ends| ends.see(&options()).map_err(|error| println!("    {error}: {ends:?}")).ok();
    ends.par_iter().filter_map(one).collect()
}

/// A line of worst errors, and of errors in units of the bound.
fn print(name: &str, seen: &[Seen]) {
    let worst = |of: &dyn Fn(&Seen) -> f64| seen.iter().map(|s| of(s).abs()).fold(0.0, f64::max);
    let over =
        |of: &dyn Fn(&Seen) -> f64| (seen.iter().map(|s| of(s).powi(2)).sum::<f64>() / seen.len().max(1) as f64).sqrt();
    let elevation = |s: &Seen| s.elevation_error_deg.unwrap_or(0.0);
    let positions: Vec<f64> = seen.iter().filter_map(|s| s.position_error_m.map(|e| e.xy().norm())).collect();
    // -2 ln(1 - share) of the shares of one and two deviations.
    let [inside_68, inside_95] =
        [2.297, 6.158].map(|most| seen.iter().filter(|s| s.position_level.is_some_and(|level| level < most)).count());
    println!(
        "{name:34} {:4} runs; azimuth mean {:7.4}, worst {:7.3} ({:5.2} x bound, {} beyond the bar), elevation {:7.3} ({:5.2}); {} signed; position {} reported, worst {:.2} m, {inside_68} within 68 %, {inside_95} within 95 %",
        seen.len(),
        seen.iter().map(|s| s.azimuth_error_deg).sum::<f64>() / seen.len().max(1) as f64,
        worst(&|s| s.azimuth_error_deg),
        over(&|s| s.azimuth_error_deg / s.bound_deg[0]),
        seen.iter().filter(|s| s.azimuth_error_deg.abs() > s.azimuth_sd_deg).count(),
        worst(&elevation),
        over(&|s| elevation(s) / s.bound_deg[1]),
        seen.iter().filter(|s| s.signed).count(),
        positions.len(),
        positions.iter().copied().fold(0.0, f64::max),
    );
}

/// Elevations from -75 to 75 degrees, 24 azimuths, 15 dB, 20 m away.
fn helix() {
    let mut all = Vec::new();
    for elevation in (-75..=75).step_by(15) {
        let one = |k: u32| Ends {
            receiver: spiral(0.3, 0.3, 1.0),
            transmitter_m: away(15.0 * f64::from(k) + 3.0, f64::from(elevation), 20.0),
            duration_s: 6.0,
            snr_db: 15.0,
            seed: u64::from(k + 1),
            ..Ends::default()
        };
        let seen = run(&(0..24).map(one).collect::<Vec<_>>());
        print(&format!("helix, elevation {elevation}"), &seen);
        all.extend(seen);
    }
    print("helix, all", &all);
}

/// The helix with a transmitter 0.5 to 3 m away, with exact and with inexact odometry.
fn near() {
    for range_m in [0.5, 0.8, 1.2, 2.0, 3.0] {
        for (noise, scale) in [(0.0, 0.0), (0.001, 0.01)] {
            let one = |k: i32| Ends {
                receiver: spiral(0.3, 0.3, 1.0),
                transmitter_m: away(
                    f64::from(45 * k),
                    [-60.0, -30.0, -10.0, 10.0, 30.0, 60.0][k as usize % 6],
                    range_m,
                ),
                duration_s: 6.0,
                snr_db: 15.0,
                odometry_noise_m: noise,
                odometry_scale: scale,
                seed: k as u64 + 1,
                ..Ends::default()
            };
            let seen = run(&(0..12).map(one).collect::<Vec<_>>());
            print(&format!("helix, {range_m} m, odometry {noise} m, {scale}"), &seen);
        }
    }
}

/// Drives too wide for one search, at up to 0.6 m/s: packets up to a quarter of a wavelength apart.
fn wide() {
    for size_m in [1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0] {
        let corner = vec![[size_m, 0.0, 0.0], [size_m, size_m, 0.0]];
        let bend = |k: i32| (0.12 * f64::from(k)).sin_cos();
        let bend = (1..=12).map(bend).map(|(sin, cos)| [size_m * sin, size_m * (1.0 - cos), 0.0]).collect();
        let (duration_s, turns, start_s, speed_m_s) = (50.0, 1.0, 0.0, 0.2);
        let motions: [(&str, RobotMotion); 4] = [
            ("circle", RobotMotion::Circle(Circle { radius_m: size_m, duration_s, turns, start_s })),
            ("eight", RobotMotion::FigureEight(Circle { radius_m: size_m, duration_s, turns, start_s })),
            ("corner", RobotMotion::Waypoints(Waypoints { points_m: corner, speed_m_s, start_s })),
            ("bend", RobotMotion::Waypoints(Waypoints { points_m: bend, speed_m_s, start_s })),
        ];
        for (name, receiver) in motions {
            let one = |k: u32| Ends {
                receiver: receiver.clone(),
                transmitter_m: {
                    let (sin, cos) = (137.5 * f64::from(k)).to_radians().sin_cos();
                    let range_m = size_m + 2.0 + 1.7 * f64::from(k % 6);
                    [range_m * cos, range_m * sin, 0.1 * f64::from(k % 8)]
                },
                duration_s,
                snr_db: 15.0,
                seed: u64::from(k),
                ..Ends::default()
            };
            print(&format!("{name} of {size_m} m"), &run(&(0..24).map(one).collect::<Vec<_>>()));
        }
    }
}

fn walk(seed: u64) -> RobotMotion {
    let mut random = csi5300_sim::random::Stream::of_seed(seed);
    let mut at = [0.0; 3];
    let points_m = (0..9)
        .map(|_| {
            at = at.map(|v: f64| (v + 0.25 * random.normal()).clamp(-0.5, 0.5));
            at
        })
        .collect();
    RobotMotion::Waypoints(Waypoints { points_m, speed_m_s: 0.4, start_s: 0.0 })
}

fn tilted(radius_m: f64, tilt_deg: f64) -> RobotMotion {
    let (up, flat) = tilt_deg.to_radians().sin_cos();
    let point = |k: i32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 60.0).sin_cos();
        [radius_m * (cos - 1.0) * flat, radius_m * sin, radius_m * (cos - 1.0) * up]
    };
    let speed_m_s = std::f64::consts::TAU * radius_m / 6.0;
    RobotMotion::Waypoints(Waypoints { points_m: (1..=60).map(point).collect(), speed_m_s, start_s: 0.0 })
}

/// Shapes other than the helix, level and not level.
fn shapes() {
    let straight = |to: [f64; 3]| {
        let length = to.iter().map(|v| v * v).sum::<f64>().sqrt();
        RobotMotion::Waypoints(Waypoints { points_m: vec![to], speed_m_s: length / 6.0, start_s: 0.0 })
    };
    let shapes: Vec<(&str, RobotMotion)> = vec![
        ("vertical line", straight([0.0, 0.0, 1.0])),
        ("climbing line", straight([1.0, 0.0, 1.0])),
        ("circle tilted 10", tilted(0.3, 10.0)),
        ("circle tilted 30", tilted(0.3, 30.0)),
        ("circle tilted 60", tilted(0.3, 60.0)),
        ("half a helix", spiral(0.3, 0.6, 0.5)),
        ("three low turns", spiral(0.3, 0.05, 3.0)),
        ("level circle", RobotMotion::Circle(Circle { radius_m: 0.3, duration_s: 6.0, turns: 1.0, start_s: 0.0 })),
        ("level arc", RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: 200.0, duration_s: 6.0, start_s: 0.0 })),
        ("walk in space", walk(5)),
        ("another walk", walk(6)),
    ];
    for (name, receiver) in &shapes {
        for elevation in [-60.0, -35.0, -10.0, 0.0, 10.0, 35.0, 60.0] {
            let one = |k: u32| Ends {
                receiver: receiver.clone(),
                transmitter_m: away(60.0 * f64::from(k) + 10.0, elevation, 8.0),
                duration_s: 8.0,
                snr_db: 15.0,
                seed: u64::from(k + 1),
                ..Ends::default()
            };
            let seen = run(&(0..6).map(one).collect::<Vec<_>>());
            print(&format!("{name}, elevation {elevation}"), &seen);
            let hidden =
                seen.iter().filter(|s| s.azimuth_error_deg.abs() > 1.0 && s.nearest_candidate_deg < 2.0).count();
            let lost =
                seen.iter().filter(|s| s.azimuth_error_deg.abs() > 1.0 && s.nearest_candidate_deg >= 2.0).count();
            if hidden + lost > 0 {
                println!("    {hidden} wrong with the right one among the candidates, {lost} without");
            }
        }
    }
}

/// Both robots moving, in five shapes.
fn both() {
    let circle = |radius_m, turns| RobotMotion::Circle(Circle { radius_m, duration_s: 6.0, turns, start_s: 0.0 });
    let pairs: [(&str, RobotMotion, RobotMotion); 5] = [
        ("circle and line", circle(0.3, 1.0), RobotMotion::Line(Line { length_m: 0.8, duration_s: 6.0, start_s: 0.0 })),
        ("circle and circle", circle(0.3, 1.0), circle(0.25, -2.0)),
        (
            "arc and walk",
            RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: 240.0, duration_s: 6.0, start_s: 0.0 }),
            RobotMotion::RandomWalk(RandomWalk {
                speed_m_s: 0.2,
                turning_deg_s: 90.0,
                within_m: 0.6,
                duration_s: 6.0,
                start_s: 0.0,
            }),
        ),
        (
            "square and eight",
            RobotMotion::Square(Square { side_m: 0.4, duration_s: 6.0, turns: 1.0, start_s: 0.0 }),
            RobotMotion::FigureEight(Circle { radius_m: 0.15, duration_s: 6.0, turns: 1.0, start_s: 0.0 }),
        ),
        ("helix and helix", spiral(0.3, 0.4, 1.0), spiral(0.2, 0.5, -1.0)),
    ];
    for (name, receiver, transmitter) in &pairs {
        let one = |k: u32| Ends {
            receiver: receiver.clone(),
            transmitter: transmitter.clone(),
            transmitter_m: away(18.0 * f64::from(k) + 7.0, 4.0, 2.5 + 0.2 * f64::from(k)),
            duration_s: 6.0,
            snr_db: 15.0,
            seed: u64::from(k + 1),
            ..Ends::default()
        };
        print(name, &run(&(0..20).map(one).collect::<Vec<_>>()));
    }
}

/// What a random motion is, its points or shape, and how long it takes, seconds.
fn random_motion(random: &mut Stream) -> (&'static str, RobotMotion, f64) {
    let size_m = 10f64.powf(random.between(-0.9, 0.25));
    let speed_m_s = random.between(0.1, 0.3);
    let (start_s, kind) = (0.0, random.between(0.0, 8.0) as u32);
    let lasts = |length_m: f64| (length_m / speed_m_s).clamp(2.0, 40.0);
    let through = |points_m: Vec<[f64; 3]>| {
        let starts = std::iter::once(&[0.0; 3]).chain(&points_m);
        let length = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|k| (b[k] - a[k]).powi(2)).sum::<f64>().sqrt();
        let duration_s = starts.zip(&points_m).map(length).sum::<f64>() / speed_m_s;
        (RobotMotion::Waypoints(Waypoints { points_m, speed_m_s, start_s }), duration_s)
    };
    match kind {
        0 => {
            let duration_s = lasts(size_m);
            ("line", RobotMotion::Line(Line { length_m: size_m, duration_s, start_s }), duration_s)
        }
        1 => {
            let (radius_m, turns) = (size_m / 2.0, random.between(0.4, 1.6));
            let duration_s = lasts(std::f64::consts::TAU * radius_m * turns);
            ("level", RobotMotion::Circle(Circle { radius_m, duration_s, turns, start_s }), duration_s)
        }
        2 | 3 => {
            let angle_deg = random.between(10.0, 300.0);
            let duration_s = lasts(size_m);
            let radius_m = size_m / angle_deg.to_radians();
            ("level", RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s, start_s }), duration_s)
        }
        4 => {
            let duration_s = lasts(2.0 * size_m);
            let turning_deg_s = random.between(20.0, 90.0);
            let walk = RandomWalk { speed_m_s, turning_deg_s, within_m: size_m, duration_s, start_s };
            ("level", RobotMotion::RandomWalk(walk), duration_s)
        }
        5 => {
            let (radius_m, turns) = (size_m / 3.0, random.between(0.5, 2.0));
            let (rise_m, duration_s) =
                (random.between(0.0, 0.5) * size_m, lasts(std::f64::consts::TAU * radius_m * turns));
            ("in space", RobotMotion::Helix(Helix { radius_m, rise_m, duration_s, turns, start_s }), duration_s)
        }
        6 => {
            let mut at = [0.0; 3];
            let mut next = |_| {
                at = at.map(|v: f64| (v + 0.4 * size_m * random.normal()).clamp(-size_m, size_m));
                at
            };
            let (motion, duration_s) = through((0..8).map(&mut next).collect());
            ("in space", motion, duration_s)
        }
        _ => {
            let (up, flat) = random.between(5.0, 85.0).to_radians().sin_cos();
            let point = |k: i32| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 60.0).sin_cos();
                [0.5 * size_m * (cos - 1.0) * flat, 0.5 * size_m * sin, 0.5 * size_m * (cos - 1.0) * up]
            };
            let (motion, duration_s) = through((1..=60).map(point).collect());
            ("tilted", motion, duration_s)
        }
    }
}

/// Scenes as the prior expects them, one in five with a transmitter that moves, at 0 to 25 dB; a third with exact odometry, one with
/// noise of 1 mm and a scale deviation of 0.5 %, one with 3 mm and 1 %.
fn random_scene(seed: u64) -> (&'static str, Ends) {
    let mut random = Stream::of_seed(seed);
    let (kind, receiver, duration_s) = random_motion(&mut random);
    let range_m = 10f64.powf(random.between(1.8f64.log10(), 36f64.log10()));
    let steep = !matches!(kind, "line" | "level") && random.between(0.0, 1.0) < 0.1;
    let elevation = if steep { random.between(20.0, 70.0) } else { random.between(0.0, 20.0) };
    let elevation = elevation * if random.between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let transmitter_m = away(random.between(-180.0, 180.0), elevation, range_m);
    let [odometry_noise_m, scale_sd] = [[0.0, 0.0], [0.001, 0.005], [0.003, 0.01]][random.between(0.0, 3.0) as usize];
    let line = Line { length_m: random.between(0.1, 1.0), duration_s, start_s: 0.0 };
    let moves = random.between(0.0, 1.0) < 0.2;
    let ends = Ends {
        receiver,
        transmitter_m,
        transmitter: if moves { RobotMotion::Line(line) } else { RobotMotion::Static },
        duration_s: duration_s + 1.0,
        snr_db: random.between(0.0, 25.0),
        odometry_noise_m,
        odometry_scale: scale_sd * random.normal().clamp(-2.0, 2.0),
        seed,
        ..Ends::default()
    };
    (kind, ends)
}

/// Random scenes of two logs.
fn random() {
    let one = |seed| {
        let (kind, ends) = random_scene(seed);
        ends.see(&options()).ok().map(|seen| (kind, seen))
    };
    print_shares((0..4000).into_par_iter().filter_map(one).collect(), &["line", "level", "tilted", "in space"]);
}

/// A robot with two or three antennas that turns, drives an arc or walks about, and the room around it.
struct ArrayScene {
    kind: &'static str,
    scene: Scene,
    antennas_m: Vec<[f64; 3]>,
    heading_noise_rad: f64,
    /// Whether the trajectory is that of the first antenna, or of the robot's middle.
    is_placed: bool,
}

impl ArrayScene {
    fn random(seed: u64, in_room: bool) -> Self {
        let mut random = Stream::of_seed(seed);
        let (duration_s, start_s) = (random.between(4.0, 20.0), 0.0);
        let turn_deg = 10f64.powf(random.between(15f64.log10(), 800f64.log10()));
        let (kind, motion) = match random.between(0.0, 4.0) as u32 {
            0 | 1 => {
                let turns = turn_deg / 360.0;
                ("turn in place", RobotMotion::Circle(Circle { radius_m: 0.0, duration_s, turns, start_s }))
            }
            2 => {
                let (radius_m, angle_deg) = (random.between(0.1, 1.0), turn_deg.min(340.0));
                ("arc", RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s, start_s }))
            }
            _ => {
                let (speed_m_s, turning_deg_s) = (0.2, random.between(20.0, 90.0));
                let walk = RandomWalk { speed_m_s, turning_deg_s, within_m: 1.0, duration_s, start_s };
                ("walk", RobotMotion::RandomWalk(walk))
            }
        };
        let range_m = 10f64.powf(random.between(1.8f64.log10(), 20f64.log10()));
        let position_m = away(random.between(-180.0, 180.0), random.between(-20.0, 20.0), range_m);
        let first_m = [0.05 * random.normal(), 0.05 * random.normal(), 0.0];
        let (length_m, about) =
            (10f64.powf(random.between(0.02f64.log10(), 0.2f64.log10())), random.between(0.0, std::f64::consts::TAU));
        let beside = |turn: f64| {
            let (sin, cos) = (about + turn).sin_cos();
            [first_m[0] + length_m * cos, first_m[1] + length_m * sin, 0.0]
        };
        let mut antennas_m = vec![first_m, beside(0.0)];
        antennas_m.extend((random.between(0.0, 1.0) < 0.4).then(|| beside(1.5)));
        let heading_noise_rad = [0.0, 0.005, 0.0175][random.between(0.0, 3.0) as usize];
        let radio = Radio {
            noise: Noise::SnrDb(random.between(0.0, 25.0)),
            chain_deg: [random.between(-180.0, 180.0), random.between(-180.0, 180.0)],
            host_latency_us: 0.0,
            ..Radio::default()
        };
        let receiver = Robot {
            name: "rx".into(),
            motion,
            antenna_m: antennas_m[0],
            antenna_b_m: Some(antennas_m[1]),
            antenna_c_m: antennas_m.get(2).copied(),
            ..Robot::default()
        };
        let loss_db = random.between(8.0, 16.0);
        let mut beyond_m = || range_m + random.between(3.0, 8.0);
        let (west, east, south, north) = (-beyond_m(), beyond_m(), -beyond_m(), beyond_m());
        let corners = [[west, south], [east, south], [east, north], [west, north], [west, south]];
        let walls = corners.windows(2).map(|ends| Wall { loss_db, ..Wall::between(ends[0], ends[1]) });
        let scene = Scene {
            name: "array".into(),
            seed,
            duration_s: duration_s + 0.5,
            sounding: Some(Sounding { rate_hz: 50.0, ..Sounding::default() }),
            radio,
            reflections: if in_room { 2 } else { 0 },
            wall: walls.filter(|_| in_room).collect(),
            robot: vec![receiver, Robot { name: "tx".into(), position_m, ..Robot::default() }],
            ..Scene::default()
        };
        Self { kind, scene, antennas_m, heading_noise_rad, is_placed: seed.is_multiple_of(2) }
    }

    fn see(&self) -> Result<Seen, Failure> {
        let room = Room::new(&self.scene)?;
        let of_antenna = true_path(&room, 0)?;
        let [first_m, others @ ..] = &self.antennas_m[..] else { return Err("no antenna".into()) };
        let first_m = Vector3::from(*first_m);
        let path = if self.is_placed { of_antenna } else { of_antenna.with_antenna_offset(-first_m)? };
        let mut random = Stream::of_seed(self.scene.seed ^ 0x5eed);
        let noisy = |pose: &Pose| Pose {
            heading_rad: pose.heading_rad.map(|heading| heading + self.heading_noise_rad * random.normal()),
            ..*pose
        };
        let path = Trajectory::new(path.poses().iter().map(noisy).collect())?;
        let baselines_m: Vec<Vector3<f64>> = others.iter().map(|other| first_m - Vector3::from(*other)).collect();
        let array = Array::new(&[Antenna::A, Antenna::B, Antenna::C][..self.antennas_m.len()], &baselines_m)?;
        let array = if self.is_placed { array.on_trajectory() } else { array };
        let simulation = room.run()?;
        let mut report = one_log(&mut simulation.robots[0].replay(), &path, &array, &options())?;
        let bearing = report.links.pop().ok_or("no sender")?.bearing?;
        let sender_m = Vector3::from(self.scene.robot[1].position_m);
        let way = sender_m - bearing.mean_position_m;
        let answer = &bearing.answer;
        let off = |azimuth: f64| csi5300::maths::wrap_rad(azimuth - way.y.atan2(way.x)).to_degrees();
        let level = |range: &csi5300::pipeline::Range| {
            let error = (range.position_m - sender_m).xy();
            let covariance = range.covariance_m2.fixed_view::<2, 2>(0, 0).into_owned();
            covariance.try_inverse().map(|inverse| error.dot(&(inverse * error)))
        };
        let azimuth_error_deg = off(answer.azimuth_rad);
        Ok(Seen {
            azimuth_error_deg,
            folded_error_deg: answer
                .mirror_rad
                .map_or(f64::MAX, |mirror| off(mirror).abs())
                .min(azimuth_error_deg.abs()),
            azimuth_sd_deg: answer.azimuth_sd_rad.to_degrees(),
            position_level: answer.range.filter(|_| answer.has_place()).as_ref().and_then(level),
            confidence: answer.probability,
            ..Seen::default()
        })
    }
}

/// Random scenes of one log: turns of 15 to 800 degrees, baselines of 2 to 20 cm, senders at 1.8 to 20 m, 0 to 25 dB, headings exact or
/// with noise of 0.3 or 1 degree; in half of them only the path of the robot's middle is known, and the antennas are 5 cm off.
fn arrays() {
    for (place, in_room) in [("free space", false), ("rooms", true)] {
        println!("{place}");
        let one = |seed| {
            let scene = ArrayScene::random(seed, in_room);
            scene.see().ok().map(|seen| (scene.kind, seen))
        };
        print_shares((0..4000).into_par_iter().filter_map(one).collect(), &["turn in place", "arc", "walk"]);
    }
}

/// How often errors are within their bars, places within their ellipses, and probabilities right.
fn print_shares(all: Vec<(&str, Seen)>, kinds: &[&str]) {
    for kind in kinds {
        let seen: Vec<&Seen> = all.iter().filter(|(own, _)| own == kind).map(|(_, seen)| seen).collect();
        let share = |is: &dyn Fn(&Seen) -> bool| {
            100.0 * seen.iter().filter(|seen| is(seen)).count() as f64 / seen.len().max(1) as f64
        };
        let said = 100.0 * seen.iter().map(|seen| seen.confidence).sum::<f64>() / seen.len().max(1) as f64;
        let levels: Vec<f64> = seen.iter().filter_map(|seen| seen.position_level).collect();
        let inside = |most: f64| {
            100.0 * levels.iter().filter(|level| **level < most).count() as f64 / levels.len().max(1) as f64
        };
        println!(
            "{kind:13} {:4} runs: within the bar {:3.0} %, twice the bar {:3.0} %, over three bars and a degree off {:4.1} %; within 5 degrees {said:3.0} % said, {:3.0} % true; {:4} places, within 68 % {:3.0} %, within 95 % {:3.0} %",
            seen.len(),
            share(&|s| s.folded_error_deg < s.azimuth_sd_deg),
            share(&|s| s.folded_error_deg < 2.0 * s.azimuth_sd_deg),
            share(&|s| s.folded_error_deg > 1f64.max(3.0 * s.azimuth_sd_deg)),
            share(&|s| s.azimuth_error_deg.abs() < 5.0),
            levels.len(),
            inside(2.297),
            inside(6.158),
        );
    }
}
