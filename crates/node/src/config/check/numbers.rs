//! Numbers that must be in a range, or finite.

use super::super::{Capture, Estimation};
use super::{Check, too_far, wrong_place};
use csi5300_sim::toml_lines::Step::{Index, Key};

/// Allowed bearings of each peer a second: from one in a thousand seconds to more than any processor manages.
const RATES_HZ: std::ops::RangeInclusive<f64> = 1e-3..=100.0;

/// Allowed speeds of a log or a room, relative to its own pace.
const SPEEDS: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Refused values of `[estimator]`: the key, and the reason.
fn wrong_estimation(asked: &Estimation, least_m: f64) -> Vec<(&'static str, String)> {
    let mut wrong = Vec::new();
    if !(0.0..=90.0).contains(&asked.elevation_max_deg.unwrap_or(20.0)) {
        wrong.push(("elevation_max_deg", "elevation_max_deg: 0 to 90 degrees".into()));
    }
    if !(0.0..=3_600.0).contains(&asked.accurate_every_s) {
        wrong.push(("accurate_every_s", "accurate_every_s: 0 to 3600 seconds".into()));
    }
    if !(0.0..=1.0).contains(&asked.extrapolate_s) {
        let why = "extrapolate_s: 0 to 1 second; a robot is somewhere else after a longer time";
        wrong.push(("extrapolate_s", why.into()));
    }
    if asked.heading_sd_deg.is_some_and(|sd_deg| !(0.0..=180.0).contains(&sd_deg)) {
        wrong.push(("heading_sd_deg", "heading_sd_deg: 0 to 180 degrees".into()));
    }
    if least_m > asked.window_m {
        let key = if asked.least_motion_m.is_some() { "least_motion_m" } else { "window_m" };
        let why = format!(
            "window_m ({:.3} m) is less than the motion needed, {least_m:.3} m: there would never be a bearing",
            asked.window_m
        );
        wrong.push((key, why));
    }
    if !RATES_HZ.contains(&asked.rate_hz) {
        let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
        wrong.push(("rate_hz", format!("rate_hz in [estimator]: {least} to {most} bearings of each peer a second")));
    }
    wrong
}

impl Check<'_> {
    /// How bearings are made.
    pub(super) fn estimator(&mut self) {
        let asked = &self.config.estimator;
        let least_m = asked.motion_needed_m(self.config.channel.wavelength_m());
        for (key, why) in wrong_estimation(asked, least_m) {
            self.refuse(&[Key("estimator"), Key(key)], why);
        }
    }

    /// Speeds of replayed and simulated sources.
    pub(super) fn speed(&mut self) {
        let (kind, speed) = match self.capture() {
            Capture::Replay(replay) => ("replay", replay.speed),
            Capture::Room(room) => ("room", room.speed),
            Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(_) | Capture::Served(_) => return,
        };
        if !SPEEDS.contains(&speed) {
            let why = format!("speed: {} to {} times its own pace, not {speed:e}", SPEEDS.start(), SPEEDS.end());
            self.refuse(&[Key("capture"), Key(kind), Key("speed")], why);
        }
    }

    /// Places and angles of this robot and its peers.
    pub(super) fn finite(&mut self) {
        let config = self.config;
        if let Some((number, why)) = too_far(&config.antenna_offset_m) {
            self.refuse(&[Key("antenna_offset_m"), Index(number)], format!("antenna_offset_m: {why}"));
        } else if let Some(place) = wrong_place(&config.odometry) {
            let place: Vec<_> = std::iter::once(Key("odometry")).chain(place).collect();
            self.refuse(&place, "odometry: every number must be finite");
        }
        for (k, peer) in config.peer.iter().map(|peer| peer.get_ref()).enumerate() {
            if let Some((number, why)) = too_far(&peer.antenna_offset_m) {
                let why = format!("peer `{}`: antenna_offset_m: {why}", peer.name);
                self.refuse(&[Key("peer"), Index(k), Key("antenna_offset_m"), Index(number)], why);
                continue;
            }
            let yaw = (!peer.yaw_deg.is_finite()).then(|| vec![Key("yaw_deg")]);
            let poses = || wrong_place(&peer.poses).map(|place| [vec![Key("poses")], place].concat());
            if let Some(key) = yaw.or_else(poses) {
                let why = format!("peer `{}`: yaw_deg and poses must be finite numbers", peer.name);
                self.refuse(&[vec![Key("peer"), Index(k)], key].concat(), why);
            }
        }
    }
}
