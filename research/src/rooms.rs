//! Random simulated rooms with known truth, for judging bearings without captures.
//!
//! Each room has four walls, a receiver that drives an arc of about a metre, and three transmitters two to five metres away and up to
//! 0.8 m higher; cards, clocks and radios are those of the built-in `lab-circle`. In half of the rooms a wall stands before every
//! transmitter and attenuates the straight path by 8 to 30 dB. Odometry (not the true trajectory) has a scale error and a drifting
//! heading.

use csi5300_sim::crystal::Crystal;
use csi5300_sim::motion::{Arc, RandomWalk, RobotMotion};
use csi5300_sim::radio::Radio;
use csi5300_sim::random::Stream;
use csi5300_sim::scene::{Cfo, Odometry, Robot, Sounding, Wall};
use csi5300_sim::{Room, RoomError, Scene, SceneError, write_dataset};
use rayon::prelude::*;
use std::path::Path;

/// Folder of rooms with nothing between receiver and transmitters.
const IN_SIGHT: &str = "rooms_LOS";
/// Folder of rooms with walls between them.
const BEHIND_WALLS: &str = "rooms_NLOS";

/// Error of writing a room.
#[derive(Debug, thiserror::Error)]
#[error("room {number}: {source}")]
pub struct RoomsError {
    /// Its number.
    pub number: u64,
    /// Why.
    pub source: RoomError,
}

/// Writes `count` rooms of either kind as captures below `folder`; `seed` chooses them.
///
/// # Errors
/// If a file cannot be written, or a room cannot be built.
pub fn write(folder: &Path, count: u64, seed: u64) -> Result<(), RoomsError> {
    write_each(folder, [IN_SIGHT, BEHIND_WALLS], count, seed, &scene)
}

/// The same for drives of a minute, about 15 m in all, in a random walk about the middle of the room.
///
/// # Errors
/// As [`write()`].
pub fn write_drives(folder: &Path, count: u64, seed: u64) -> Result<(), RoomsError> {
    write_each(folder, ["drives_LOS", "drives_NLOS"], count, seed, &drive)
}

/// Makes a scene from a seed, in line of sight or behind walls.
type MakeScene = dyn Fn(u64, bool) -> Result<Scene, SceneError> + Sync;

fn write_each(folder: &Path, sets: [&str; 2], count: u64, seed: u64, make: &MakeScene) -> Result<(), RoomsError> {
    let jobs: Vec<(u64, bool)> = (0..count).flat_map(|number| [(number, true), (number, false)]).collect();
    jobs.into_par_iter().try_for_each(|(number, in_sight)| {
        let refused = |source| RoomsError { number, source };
        let scene =
            make(seed.wrapping_add(2 * number + u64::from(in_sight)), in_sight).map_err(|e| refused(e.into()))?;
        let mut room = Room::new(&scene).map_err(refused)?;
        let set = sets[usize::from(!in_sight)];
        let written = write_dataset(&mut room, &folder.join(set).join(format!("{number:03}")), &mut |_| {});
        written.map(|_| ()).map_err(|error| refused(error.into()))
    })
}

/// The scene of a room.
fn scene(seed: u64, in_sight: bool) -> Result<Scene, SceneError> {
    scene_with(seed, in_sight, [2.2, 5.0])
}

/// The scene of a drive: distant transmitters, and odometry whose heading wanders.
fn drive(seed: u64, in_sight: bool) -> Result<Scene, SceneError> {
    let mut scene = scene_with(seed, in_sight, [3.5, 5.5])?;
    scene.duration_s = 65.0;
    if let Some(robot) = scene.robot.first_mut() {
        robot.motion = RobotMotion::RandomWalk(RandomWalk {
            speed_m_s: 0.25,
            turning_deg_s: 40.0,
            within_m: 2.0,
            duration_s: 60.0,
            start_s: 4.0,
        });
        robot.odometry = Odometry { heading_drift_deg_s: 0.0, heading_walk_deg: 0.5, ..robot.odometry };
    }
    Ok(scene)
}

/// The scene of a room whose transmitters are between these ranges, metres.
fn scene_with(seed: u64, in_sight: bool, [nearest_m, farthest_m]: [f64; 2]) -> Result<Scene, SceneError> {
    let mut random = Stream::of_seed(seed);
    let mut robot = vec![receiver(&mut random)];
    let mut wall = Vec::new();
    let turned_deg = random.between(-180.0, 180.0);
    for number in 0..3 {
        let azimuth_deg = turned_deg + 120.0 * f64::from(number) + random.between(-45.0, 45.0);
        let range_m = random.between(nearest_m, farthest_m);
        let (sin, cos) = azimuth_deg.to_radians().sin_cos();
        robot.push(transmitter(number, [range_m * cos, range_m * sin], &mut random));
        if !in_sight {
            wall.push(screen(range_m, sin, cos, &mut random));
        }
    }
    wall.extend(outer_walls(in_sight, &mut random));
    Ok(Scene {
        name: "room".into(),
        seed,
        duration_s: 13.0,
        channel: 108,
        cfo: Cfo::Physical,
        reflections: 1,
        sounding: Some(Sounding { rate_hz: 100.0, ..Sounding::default() }),
        radio: radio()?,
        robot,
        wall,
        ..Scene::default()
    })
}

/// Rounded to the digits of a scene's text.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.digits$}").parse().unwrap_or(value)
}

/// The robot that drives an arc of about a metre.
fn receiver(random: &mut Stream) -> Robot {
    let angle_deg = random.between(150.0, 300.0);
    let radius_m = 1.0 / angle_deg.to_radians() * random.between(0.9, 1.6);
    let (scale, drift_deg_s) = (random.between(0.96, 1.03), random.between(-0.8, 0.8));
    let (radius_m, angle_deg) = (rounded(radius_m, 3), rounded(angle_deg, 1));
    Robot {
        name: "rx".into(),
        position_m: [0.0, 0.0, 0.3],
        yaw_deg: rounded(random.between(-180.0, 180.0), 1),
        motion: RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s: 7.0, start_s: 5.0 }),
        odometry: Odometry {
            rate_hz: 200.0,
            noise_m: 0.0003,
            scale: rounded(scale, 4),
            heading_drift_deg_s: rounded(drift_deg_s, 3),
            ..Odometry::default()
        },
        crystal: Crystal {
            offset_ppm: rounded(random.between(-1.5, 1.5), 2),
            clock_start_us: 3_420_000_000,
            ..Crystal::default()
        },
        ..Robot::default()
    }
}

fn transmitter(number: i32, [x, y]: [f64; 2], random: &mut Stream) -> Robot {
    Robot {
        name: format!("tx{number}"),
        position_m: [rounded(x, 3), rounded(y, 3), rounded(random.between(0.3, 1.1), 3)],
        crystal: Crystal {
            offset_ppm: rounded(random.between(-2.5, 2.5), 2),
            wander_ppm: 0.02,
            wander_period_s: 40.0,
            clock_start_us: 1_200_000_000,
            ..Crystal::default()
        },
        ..Robot::default()
    }
}

/// A wall across the straight path to a transmitter `range_m` away, close to it.
fn screen(range_m: f64, sin: f64, cos: f64, random: &mut Stream) -> Wall {
    let at_m = range_m - random.between(0.4, 0.8);
    let (half_m, through_db) = (random.between(0.6, 1.4), random.between(8.0, 30.0));
    let end = |side: f64| [at_m * cos - side * half_m * sin, at_m * sin + side * half_m * cos].map(|v| rounded(v, 3));
    Wall { loss_db: 8.0, through_db: Some(rounded(through_db, 1)), ..Wall::between(end(1.0), end(-1.0)) }
}

fn outer_walls(in_sight: bool, random: &mut Stream) -> Vec<Wall> {
    let loss_db = if in_sight { random.between(10.0, 16.0) } else { random.between(2.0, 8.0) };
    let mut away_m = || rounded(random.between(6.0, 8.0), 2);
    let (west, east, south, north) = (-away_m(), away_m(), -away_m(), away_m());
    let corners = [[west, south], [east, south], [east, north], [west, north], [west, south]];
    let wall = |ends: &[[f64; 2]]| Wall { loss_db: rounded(loss_db, 1), ..Wall::between(ends[0], ends[1]) };
    corners.windows(2).map(wall).collect()
}

/// The radio of `lab-circle`, which is fitted to real cards.
fn radio() -> Result<Radio, SceneError> {
    Scene::parse(RADIO).map(|scene| scene.radio)
}

const RADIO: &str = "[radio]
mcs = 0
noise.floor_dbm = -88.0
phase_noise_rad = 0.16
delay_ns = 200.0
delay_std_ns = 30.0
send_jitter_us = 85.0
host_latency_us = 120.0
host_latency_std_us = 55.0
gain.agc = { target_lsb = 31.3, lsb_std_db = 0.41, rssi_db = 38.4, agc_std_db = 0.7 }
turn_around = { median_us = 322.0, spread_us = 4.5, tail = 0.08, tail_us = -110.0, tail_spread_us = 45.0, min_us = 80.0, max_us = 400.0 }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_room_can_be_built_and_differs_from_the_others() {
        for seed in 0..40 {
            for in_sight in [true, false] {
                let scene = scene(seed, in_sight).unwrap();
                Room::new(&scene).unwrap_or_else(|error| panic!("{error}\n{}", scene.to_toml().unwrap()));
                assert_eq!(scene.robot.len(), 4);
                assert_eq!(scene.wall.len(), if in_sight { 4 } else { 7 });
            }
            let far = drive(seed, seed.is_multiple_of(2)).unwrap();
            Room::new(&far).unwrap_or_else(|error| panic!("{error}\n{}", far.to_toml().unwrap()));
            assert_ne!(scene(seed, true).unwrap().robot, scene(seed + 1, true).unwrap().robot);
        }
    }
}
