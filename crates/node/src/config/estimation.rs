//! How bearings are made.

use super::Config;
use super::values::{maybe_positive, positive};
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
    /// Poses are carried on beyond the last one by at most this, seconds.
    pub extrapolate_s: f64,
    /// Largest |elevation| searched, degrees.
    pub elevation_max_deg: f64,
    /// Spherical waves, all subcarriers and the one-way channel: better, and ten to a hundred times the work.
    pub accurate: bool,
    /// That work is done once in so many seconds for each peer, and when nothing moves any more; 0: for every bearing.
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
            elevation_max_deg: 20.0,
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
