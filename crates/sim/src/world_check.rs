//! Refuses impossible places of robots and soundings that do not fit; the only way in for scenes from files.

use super::motion::RobotMotion;
use super::refusal::{Checked, Problem, SceneError};
use super::scene::Scene;
use super::sounder::request;
use super::world::{World, surfaces};
use std::io::Read;
use std::path::Path;

/// Interval and limit of checked places of a path, seconds.
const STEP_S: f64 = 0.05;
const STEPS: f64 = 20_000.0;

/// Checks a scene as a whole: the sounding fits, and robots stay outside walls.
///
/// # Errors
/// [`SceneError::Value`] with the place in the scene.
pub(crate) fn check(world: &World) -> Result<(), SceneError> {
    check_rate(world.scene())?;
    check_ways(world)?;
    Ok(check_places(world)?)
}

/// The rounds asked for fit into the time there is.
fn check_rate(scene: &Scene) -> Checked {
    let Some(sounding) = &scene.sounding else { return Ok(()) };
    request(scene, sounding).map(|_| ()).map_err(|error| Problem::new(error.to_string()).key("rate_hz").key("sounding"))
}

/// Robots neither begin inside walls nor drive into or through them.
fn check_ways(world: &World) -> Checked {
    let scene = world.scene();
    let walls = surfaces(scene).unwrap_or_default();
    let all_steps = (scene.duration_s / STEP_S).ceil().min(STEPS) as usize;
    for (index, robot) in scene.robot.iter().enumerate() {
        let steps = if world.is_still(index) || walls.is_empty() { 0 } else { all_steps };
        let mut before = world.pose(index, 0.0).position_m;
        for step in 0..=steps {
            let t_s = if steps == 0 { 0.0 } else { scene.duration_s * step as f64 / steps as f64 };
            let here = world.pose(index, t_s).position_m;
            for (wall, surface) in scene.wall.iter().zip(&walls) {
                let inside = surface.distance_m(here) <= 0.5 * wall.thickness_m;
                if inside || surface.separates(before, here) {
                    let when = if step == 0 { "is".to_owned() } else { format!("drives, after {t_s:.1} s,") };
                    let ([x0, y0], [x1, y1]) = (wall.from_m, wall.to_m);
                    let reason = format!("{} {when} inside the wall from ({x0}, {y0}) to ({x1}, {y1})", robot.name);
                    let key = if step == 0 { "position_m" } else { "motion" };
                    return Err(Problem::new(reason).key(key).item("robot", index));
                }
            }
            before = here;
        }
    }
    Ok(())
}

/// Two things closer than this, metres, are at the same place.
const SAME_PLACE_M: f64 = 0.01;

/// Refuses robots that start at one place, and antennas at one place on robots that stay: nothing could be measured.
/// Robots that meet later are counted.
fn check_places(world: &World) -> Checked {
    let robots = &world.scene().robot;
    for (index, robot) in robots.iter().enumerate() {
        for (other, state) in robots.iter().enumerate().take(index) {
            let apart = world.pose(index, 0.0).position_m - world.pose(other, 0.0).position_m;
            if apart.norm() < SAME_PLACE_M {
                let reason = format!("{} is where {} is", robot.name, state.name);
                return Err(Problem::new(reason).key("position_m").item("robot", index));
            }
            let stay = world.is_still(index) && world.is_still(other);
            if stay && (antennas_meet(world, index, other) || antennas_meet(world, other, index)) {
                let reason =
                    format!("an antenna of {} is where one of {} is, and both stay there", robot.name, state.name);
                return Err(Problem::new(reason).key("antenna_m").item("robot", index));
            }
        }
    }
    Ok(())
}

/// True if one robot's sending antenna is at the place of another's receiving antenna.
fn antennas_meet(world: &World, from: usize, to: usize) -> bool {
    let scene = world.scene();
    let chains = scene.robot.get(to).map_or(0, |robot| usize::from(scene.radio_of(robot).chains));
    let sends = world.antenna(from, 0, 0.0);
    let receive = (0..chains).filter_map(|antenna| world.antenna(to, antenna, 0.0));
    sends.is_some_and(|sends| receive.into_iter().any(|receives| (sends - receives).norm() < SAME_PLACE_M))
}

/// Bytes of a scene's file at most.
const LONGEST: u64 = 16 << 20;

impl Scene {
    /// Reads and checks a scene's text, with the lines of what is refused. Trajectory files are relative to the current
    /// folder.
    ///
    /// # Errors
    /// [`SceneError`] with the line and the reason: unknown keys, values out of range, robots inside walls, ...
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        Self::read(text, Path::new(""))
    }

    /// As [`Scene::from_toml`]; trajectory files are relative to `folder`, and the scene contains that path.
    ///
    /// # Errors
    /// As [`Scene::from_toml`].
    pub fn read(text: &str, folder: &Path) -> Result<Self, SceneError> {
        let mut scene = Self::parse(text)?;
        for robot in &mut scene.robot {
            if let RobotMotion::Recorded(motion) = &mut robot.motion {
                motion.file = folder.join(&motion.file);
            }
        }
        let checked = World::new(&scene).and_then(|world| check(&world));
        checked.map_err(|error| error.locate(text))?;
        Ok(scene)
    }

    /// Reads and checks a scene file.
    ///
    /// # Errors
    /// As [`Scene::from_toml`], and when the file cannot be read.
    pub fn load(file: &Path) -> Result<Self, SceneError> {
        let io = |source| SceneError::Io { file: file.to_owned(), source };
        let mut text = String::new();
        std::fs::File::open(file).map_err(io)?.take(LONGEST + 1).read_to_string(&mut text).map_err(io)?;
        if text.len() as u64 > LONGEST {
            return Err(io(std::io::Error::other(format!(
                "it is longer than {} MiB, which no scene is",
                LONGEST >> 20
            ))));
        }
        Self::read(&text, file.parent().unwrap_or(Path::new("")))
    }
}

#[cfg(test)]
#[path = "scene_tests.rs"]
mod tests;
