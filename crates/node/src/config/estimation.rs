//! How bearings are made.

use super::values::{maybe_positive, positive};
use super::{Config, Odometry};
use csi5300::internal::heading;
use csi5300::pipeline::live::LiveSettings;

/// How bearings are made.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Estimation {
    /// Relative motion in the window, metres.
    #[serde(deserialize_with = "positive")]
    pub window_m: f64,
    /// The window reaches back no further, seconds.
    #[serde(deserialize_with = "positive")]
    pub window_s: f64,
    /// Relative motion needed for a bearing, metres; two wavelengths where absent.
    #[serde(deserialize_with = "maybe_positive")]
    pub least_motion_m: Option<f64>,
    /// Bearings of each peer a second.
    #[serde(deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Poses are extrapolated by at most this, seconds.
    pub extrapolate_s: f64,
    /// Largest |elevation| of a peer, degrees; where absent 20 for level motion.
    pub elevation_max_deg: Option<f64>,
    /// Standard deviation of the heading of this robot's poses, degrees; where absent that of its kind of odometry
    /// ([`Config::heading_sd_deg`]).
    pub heading_sd_deg: Option<f64>,
    /// The posterior on a fine grid; if false, on the coarse grid only.
    pub accurate: bool,
    /// The complete estimate runs at this interval for each peer, seconds, and when nothing moves any more; 0: for
    /// every bearing.
    pub accurate_every_s: f64,
}

impl Default for Estimation {
    fn default() -> Self {
        Self {
            window_m: 3.0,
            window_s: 180.0,
            least_motion_m: None,
            rate_hz: 2.0,
            extrapolate_s: 0.05,
            elevation_max_deg: None,
            heading_sd_deg: None,
            accurate: true,
            accurate_every_s: 5.0,
        }
    }
}

impl Estimation {
    /// Relative motion needed for a bearing, metres, at this wavelength.
    #[must_use]
    pub fn motion_needed_m(&self, wavelength_m: f64) -> f64 {
        self.least_motion_m.unwrap_or_else(|| LiveSettings::new(wavelength_m).least_m)
    }
}

impl Config {
    /// Standard deviation of the heading of this robot's poses, degrees, which error bars and confidence hold. Default
    /// for `estimator.heading_sd_deg`: measured values for a camera constrained to rolling motion and for wheels with a
    /// known antenna place, 0 for everything else.
    #[must_use]
    pub fn heading_sd_deg(&self) -> f64 {
        let usual_rad = match self.odometry {
            _ if self.camera_mount.is_some() => heading::ROLLING_CAMERA_RAD,
            Odometry::Opencr(_) => heading::WHEELS_RAD,
            _ => 0.0,
        };
        self.estimator.heading_sd_deg.unwrap_or(usual_rad.to_degrees())
    }

    /// How the estimator is set.
    #[must_use]
    pub fn estimator_settings(&self) -> LiveSettings {
        let asked = &self.estimator;
        let wavelength_m = self.channel.wavelength_m();
        let mut settings = LiveSettings::new(wavelength_m);
        (settings.window_m, settings.window_s) = (asked.window_m, asked.window_s);
        settings.least_m = asked.motion_needed_m(wavelength_m);
        settings.rate_hz = asked.rate_hz;
        settings.extrapolate_s = asked.extrapolate_s;
        settings.accurate_every_s = asked.accurate_every_s;
        settings
    }
}
