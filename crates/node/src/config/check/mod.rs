//! Finds contradictions in a configuration, or with this machine.
//!
//! One function for each group of rules. A refusal names the place of the wrong key, or of the table that lacks one;
//! the spans of the TOML reader give its line.

mod files;
mod numbers;
mod own;
mod peers;
mod surroundings;

use super::{Capture, Config, Odometry, Place, Problem, ros};
use csi5300_ros2::settings::wrong_topic;
use csi5300_sim::Scene;
use csi5300_sim::toml_lines::Step::{Index, Key};
use csi5300_sim::toml_lines::{Step, TomlLines};
use std::collections::BTreeSet;
use std::path::Path;

/// A configuration that is being checked.
struct Check<'a> {
    config: &'a Config,
    /// The file that it was read from, if it was one.
    own_file: Option<&'a Path>,
    lines: TomlLines<'a>,
    /// Top-level keys with parts that were refused already.
    gone: &'a BTreeSet<String>,
    /// The simulated room's scene, if there is one.
    scene: Option<Scene>,
    problems: Vec<Problem>,
}

/// All contradictions, except those that follow from `gone` keys.
pub(super) fn problems(
    config: &Config,
    own_file: Option<&Path>,
    lines: TomlLines<'_>,
    gone: &BTreeSet<String>,
) -> Vec<Problem> {
    let mut check = Check { config, own_file, lines, gone, scene: None, problems: Vec::new() };
    check.own_card();
    check.array();
    check.own_room();
    check.estimator();
    check.macs_of_the_room();
    check.speed();
    check.finite();
    check.motion();
    check.own_poses();
    check.camera();
    check.ros();
    check.something_to_do();
    check.peers();
    check.team();
    check.sounding();
    check.output();
    check.files_to_write();
    check.network();
    check.problems
}

impl Check<'_> {
    /// Refuses the value at `place`.
    fn refuse(&mut self, place: &[Step<'_>], reason: impl Into<String>) {
        self.problems.push(Problem { line: self.lines.line(place), reason: reason.into() });
    }

    /// True if all of these were readable, so a missing value is missing in the file.
    fn knows(&self, keys: &[&str]) -> bool {
        !keys.iter().any(|key| self.gone.contains(*key))
    }

    fn capture(&self) -> &Capture {
        self.config.capture.get_ref()
    }

    /// Records of a simulated room.
    fn is_room(&self) -> bool {
        matches!(self.capture(), Capture::Room(_) | Capture::Served(_))
    }

    fn is_replay(&self) -> bool {
        matches!(self.capture(), Capture::Replay(_))
    }

    /// Why a robot cannot be in the room, if the scene does not have it.
    fn absent(&self, name: &str) -> Option<String> {
        let scene = self.scene.as_ref().filter(|scene| scene.robot.iter().all(|robot| robot.name != name))?;
        let names: Vec<&str> = scene.robot.iter().map(|robot| robot.name.as_str()).collect();
        Some(format!("the scene has no robot `{name}`: it has {}", names.join(", ")))
    }

    /// A problem of a robot's poses: the key below theirs, and the reason. `own` are this robot's.
    fn wrong_poses(&self, poses: &Odometry, own: bool) -> Option<(Vec<Step<'static>>, String)> {
        let of_now = self.is_room() || self.is_replay();
        let has_network = self.config.network.is_some();
        let (place, why): (&[Step<'static>], String) = match poses {
            Odometry::Csv(csv) if !csv.file.is_file() => {
                (&[Key("csv"), Key("file")], format!("there is no trajectory {}", csv.file.display()))
            }
            Odometry::Csv(_) if !self.is_replay() => {
                (&[Key("csv")], "`csv` poses need a replayed capture, whose pace they follow".into())
            }
            Odometry::Opencr(_) if of_now => (&[Key("opencr")], OPENCR_NOW.into()),
            Odometry::Ros(_) if of_now => (&[Key("ros")], ROS_NOW.into()),
            Odometry::Ros(topic) => {
                let (key, why) = ros::wrong_topic(topic, !own)?;
                return Some(([Key("ros")].into_iter().chain(key.map(Key)).collect(), why));
            }
            Odometry::Ros2(_) if of_now => (&[Key("ros2")], ROS_NOW.into()),
            Odometry::Ros2(topic) => {
                let (key, why) = wrong_topic(topic, !own)?;
                return Some(([Key("ros2")].into_iter().chain(key.map(Key)).collect(), why));
            }
            Odometry::Room(_) if !self.is_room() => {
                (&[Key("room")], "`room` poses need `capture.room` or `capture.served`".into())
            }
            Odometry::Opencr(_) if !own => {
                (&[Key("opencr")], "a peer's port is not on this machine: use `network`".into())
            }
            Odometry::Network(_) if own => {
                (&[Key("network")], "this robot's own poses do not come over the network".into())
            }
            Odometry::Network(_) if !has_network => {
                (&[Key("network")], "`network` poses need a [network] table".into())
            }
            _ => return None,
        };
        Some((place.to_vec(), why))
    }
}

const OPENCR_NOW: &str = "`opencr` poses are live and need a card (`capture.card` or `capture.stock`): with a replayed log use `csv`, in a room `room`";
const ROS_NOW: &str = "`ros` poses are live and need a card (`capture.card` or `capture.stock`): with a replayed log use `csv`; in a room that \
                       follows the topic (`follow`) use `room`";

/// The first of `numbers` that is not finite.
fn not_finite(numbers: &[f64]) -> Option<usize> {
    numbers.iter().position(|number| !number.is_finite())
}

/// Largest distance of a part from the middle of a robot, metres.
const ON_ROBOT_M: f64 = 10.0;

/// A number of a place on a robot that is not finite or too large, and the reason.
fn too_far(place_m: &[f64]) -> Option<(usize, String)> {
    let reason = |m: f64| match m.is_finite() {
        false => Some("every number must be finite".to_owned()),
        true => (m.abs() > ON_ROBOT_M).then(|| format!("{m:e} m is not on a robot: {ON_ROBOT_M} m at most")),
    };
    place_m.iter().enumerate().find_map(|(number, m)| Some((number, reason(*m)?)))
}

/// Where below its `static` a place has a number that is none.
fn wrong_place(odometry: &Odometry) -> Option<Vec<Step<'static>>> {
    let Odometry::Static(Place { position_m, heading_deg }) = odometry else { return None };
    match not_finite(position_m) {
        Some(number) => Some(vec![Key("static"), Key("position_m"), Index(number)]),
        None => (!heading_deg.is_finite()).then(|| vec![Key("static"), Key("heading_deg")]),
    }
}

#[cfg(test)]
mod tests;
