//! What contradicts itself, or this machine, in a configuration: where, and why.

use super::{Capture, Config, Odometry, Problem, Records, ros};
use toml::Spanned;

/// Bearings of each peer a second that can be asked for: one in a thousand seconds to what no processor keeps up with.
const RATES_HZ: std::ops::RangeInclusive<f64> = 1e-3..=100.0;
/// Records that can be let wait for or from the network: no fewer than come while a message is collected, no more than
/// some hundred megabytes.
const BACKLOGS: std::ops::RangeInclusive<usize> = 256..=1_000_000;

impl Config {
    /// MACs that are not those of the simulated room: where, and why.
    fn foreign_macs(&self, own_at: usize) -> Vec<(usize, String)> {
        let Capture::Room(asked) = self.capture.get_ref() else { return Vec::new() };
        let peers = self.peer.iter().map(|peer| (peer.span().start, peer.get_ref().name.as_str(), peer.get_ref().mac));
        let all = std::iter::once((own_at, asked.robot.as_str(), self.mac)).chain(peers);
        let given: Vec<_> = all.filter_map(|(at, name, mac)| Some((at, name, mac?))).collect();
        if given.is_empty() {
            return Vec::new();
        }
        let made = crate::sources::scene(&asked.scene).ok();
        let Some(room) = made.and_then(|scene| csi5300_sim::Room::new(&scene).ok()) else { return Vec::new() };
        let wrong = |(at, name, mac)| {
            let is = room.number(name).and_then(|number| room.mac(number)).filter(|is| *is != mac)?;
            Some((at, format!("`{name}` has the MAC {is} in this room, not {mac}: leave `mac` out")))
        };
        given.into_iter().filter_map(wrong).collect()
    }

    /// What contradicts itself or this machine.
    pub(super) fn problems(&self, text: &str) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut say = |at: usize, reason: String| problems.push(Problem { line: Some(line_of(text, at)), reason });
        let capture_at = self.capture.span().start;
        let is_room = matches!(self.capture.get_ref(), Capture::Room(_) | Capture::Served(_));
        let is_replay = matches!(self.capture.get_ref(), Capture::Replay(_));
        if self.mac.is_none() && !is_room {
            let why = "`mac`, the address of this robot's card, is missing: `ip link` shows it, and `csi5300 info` shows the \
                       senders in a log";
            say(capture_at, why.into());
        }
        if let Capture::Replay(replay) = self.capture.get_ref()
            && !replay.file.is_file()
        {
            say(capture_at, format!("there is no log {}", replay.file.display()));
        }
        let mut room = None;
        if let Capture::Room(asked) = self.capture.get_ref() {
            match crate::sources::scene(&asked.scene) {
                Ok(scene) => room = Some(scene),
                Err(error) => say(capture_at, error.to_string()),
            }
        }
        let absent = |name: &str| {
            let scene = room.as_ref().filter(|scene| scene.robot.iter().all(|robot| robot.name != name))?;
            let names: Vec<&str> = scene.robot.iter().map(|robot| robot.name.as_str()).collect();
            Some(format!("the scene has no robot `{name}`: it has {}", names.join(", ")))
        };
        if let Capture::Room(asked) = self.capture.get_ref()
            && let Some(why) = absent(&asked.robot)
        {
            say(capture_at, why);
        }
        ros::wrong_followed(self, room.as_ref()).into_iter().for_each(|why| say(capture_at, why));
        let estimator = &self.estimator;
        if !(0.0..=90.0).contains(&estimator.elevation_max_deg) {
            say(place(text, "elevation_max_deg"), "elevation_max_deg: 0 to 90 degrees".into());
        }
        if !(0.0..=3_600.0).contains(&estimator.accurate_every_s) {
            say(place(text, "accurate_every_s"), "accurate_every_s: 0 to 3600 seconds".into());
        }
        if !(0.0..=1.0).contains(&estimator.extrapolate_s) {
            let why = "extrapolate_s: 0 to 1 second; a robot is somewhere else after a longer time";
            say(place(text, "extrapolate_s"), why.into());
        }
        self.foreign_macs(place(text, "mac")).into_iter().for_each(|(at, why)| say(at, why));
        let usual_m = crate::estimator::Settings::new(self.channel.wavelength_m()).least_m;
        let least_m = estimator.least_motion_m.unwrap_or(usual_m);
        if least_m > estimator.window_m {
            let key = if estimator.least_motion_m.is_some() { "least_motion_m" } else { "window_m" };
            let why = format!(
                "window_m ({:.3} m) is less than the motion needed, {least_m:.3} m: there would never be a bearing",
                estimator.window_m
            );
            say(place(text, key), why);
        }
        if !RATES_HZ.contains(&estimator.rate_hz) {
            let why = format!(
                "rate_hz in [estimator]: {} to {} bearings of each peer a second",
                RATES_HZ.start(),
                RATES_HZ.end()
            );
            say(place(text, "rate_hz"), why);
        }
        let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        let place_of = |odometry: &Odometry| match odometry {
            Odometry::Static(place) => finite(&place.position_m) && place.heading_deg.is_finite(),
            _ => true,
        };
        if !finite(&self.antenna_offset_m) || !place_of(&self.odometry) {
            let key = if finite(&self.antenna_offset_m) { "odometry" } else { "antenna_offset_m" };
            say(place(text, key), format!("{key}: every number must be finite"));
        }
        for peer in &self.peer {
            let (at, peer) = (peer.span().start, peer.get_ref());
            if !finite(&peer.antenna_offset_m) || !peer.yaw_deg.is_finite() || !place_of(&peer.poses) {
                say(at, format!("peer `{}`: antenna_offset_m, yaw_deg and poses must be finite numbers", peer.name));
            }
        }
        let stands = |odometry: &Odometry| matches!(odometry, Odometry::Static(_));
        if stands(&self.odometry) && !self.peer.is_empty() && self.peer.iter().all(|peer| stands(&peer.get_ref().poses))
        {
            let why = "no robot here ever moves (`static` poses, also where none are given), and without motion there is no \
                       bearing: give this robot `odometry` or a peer `poses`";
            let at = self.peer.first().map_or(capture_at, |peer| peer.span().start);
            say(at, why.into());
        }
        let odometry = |poses: &Odometry, at: usize, own: bool| {
            match poses {
            Odometry::Csv(csv) if !csv.file.is_file() => {
                Some((at, format!("there is no trajectory {}", csv.file.display())))
            }
            Odometry::Csv(_) if !is_replay => {
                Some((at, "`csv` poses need a replayed capture, whose pace they follow".into()))
            }
            Odometry::Opencr(_) if is_room || is_replay => Some((
                at,
                "`opencr` poses are of now and need `capture.card`: with a replayed log use `csv`, in a room `room`"
                    .into(),
            )),
            Odometry::Ros(_) if is_room || is_replay => Some((
                at,
                "`ros` poses are of now and need `capture.card`: with a replayed log use `csv`; in a room that follows the \
                 topic (`follow`) use `room`"
                    .into(),
            )),
            Odometry::Ros(topic) => ros::wrong_topic(topic, !own).map(|why| (at, why)),
            Odometry::Room(_) if !is_room => Some((at, "`room` poses need `capture.room` or `capture.served`".into())),
            Odometry::Opencr(_) if !own => Some((at, "a peer's port is not on this machine: use `network`".into())),
            Odometry::Network(_) if own => Some((at, "this robot's own poses do not come over the network".into())),
            Odometry::Network(_) if self.network.is_none() => {
                Some((at, "`network` poses need a [network] table".into()))
            }
            _ => None,
        }
        };
        if let Some((at, why)) = odometry(&self.odometry, place(text, "odometry"), true) {
            say(at, why);
        }
        let wrong = self.ros.as_ref().and_then(ros::wrong_ros);
        wrong.into_iter().for_each(|(key, why)| say(place(text, key), why));
        if self.peer.is_empty() && self.log.is_none() && self.network.is_none() && self.ros.is_none() {
            say(capture_at, "no [[peer]], no [log], no [network] and no [ros]: there is nothing to do".into());
        }
        for (k, peer) in self.peer.iter().enumerate() {
            let (at, peer) = (peer.span().start, peer.get_ref());
            let others = || self.peer.iter().take(k).map(Spanned::get_ref);
            if others().any(|other| other.name == peer.name || (other.mac.is_some() && other.mac == peer.mac)) {
                say(at, format!("peer `{}`: another peer has its name or MAC", peer.name));
            }
            if peer.mac.is_none() && !matches!(peer.records, Records::Room(_)) {
                say(at, format!("peer `{}`: `mac` is missing", peer.name));
            }
            if peer.mac.is_some() && peer.mac == self.mac {
                say(at, format!("peer `{}` has this robot's own MAC", peer.name));
            }
            match &peer.records {
                Records::Replay(replay) if !replay.file.is_file() => {
                    say(at, format!("peer `{}`: there is no log {}", peer.name, replay.file.display()));
                }
                Records::Replay(_) if !is_replay => {
                    say(
                        at,
                        format!("peer `{}`: a replayed log needs `capture.replay`, whose pace it follows", peer.name),
                    );
                }
                Records::Room(_) if !is_room => {
                    say(at, format!("peer `{}`: `room` records need `capture.room` or `capture.served`", peer.name))
                }
                Records::Network(_) if self.network.is_none() => {
                    say(at, format!("peer `{}`: `network` records need a [network] table", peer.name));
                }
                Records::Room(_) => absent(&peer.name).into_iter().for_each(|why| say(at, why)),
                _ => {}
            }
            if let Some((at, why)) = odometry(&peer.poses, at, false) {
                say(at, format!("peer `{}`: {why}", peer.name));
            }
        }
        self.sounding_problem().into_iter().for_each(|why| say(place(text, "sounding"), why));
        if self.output.foxglove.is_some() && !cfg!(feature = "foxglove") {
            let why = "foxglove in [output] needs a program built with `--features foxglove`";
            say(place(text, "foxglove"), why.into());
        }
        if let Some(network) = &self.network {
            if !cfg!(feature = "zenoh") {
                say(place(text, "network"), "[network] needs a program built with `--features zenoh`".into());
            }
            if network.backlog.is_some_and(|backlog| !BACKLOGS.contains(&backlog)) {
                let why = format!("backlog: {} to {} records", BACKLOGS.start(), BACKLOGS.end());
                say(place(text, "backlog"), why);
            }
            if network.zenoh.as_ref().is_some_and(|file| !file.is_file()) {
                say(place(text, "zenoh"), "there is no such file of zenoh's".into());
            }
        }
        problems
    }
}

/// Line of a place, from 1.
pub(super) fn line_of(text: &str, at: usize) -> usize {
    text.bytes().take(at).filter(|byte| *byte == b'\n').count() + 1
}

/// Where a key first stands at the beginning of a line.
fn place(text: &str, key: &str) -> usize {
    let mut at = 0;
    for line in text.split_inclusive('\n') {
        let begins = line.trim_start_matches([' ', '\t', '[']);
        if begins.starts_with(key) || begins.contains(&format!(".{key}")) {
            return at;
        }
        at += line.len();
    }
    0
}
