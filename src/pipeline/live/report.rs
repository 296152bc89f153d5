//! Settings, inputs and reports of the live estimator.

use super::track::Track;
use crate::exchange::admission::AdmissionCounts;
use crate::pipeline::Answer;
use crate::place::track::TrackCounts;
use crate::time::Instant;
use driver_iface::Mac;
use serde::Serialize;

/// What an estimate is made of, and how often.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LiveSettings {
    /// Relative motion in the window, metres of path.
    pub window_m: f64,
    /// The window reaches back no further than this, seconds.
    pub window_s: f64,
    /// Relative motion needed before there is a bearing: the diagonal of the box that holds it, metres.
    pub least_m: f64,
    /// Estimates of each peer a second.
    pub rate_hz: f64,
    /// Poses are carried on beyond the last one by at most this, seconds.
    pub extrapolate_s: f64,
    /// The accuracy layer is asked this often for each peer, seconds: in between, bearings are of a plane wave at the
    /// channel centre. 0: every time. When the robots stand still, and at the end, it has the last word.
    pub accurate_every_s: f64,
}

impl LiveSettings {
    /// Three metres within three minutes, twice a second, from two wavelengths on.
    #[must_use]
    pub fn new(wavelength_m: f64) -> Self {
        Self {
            window_m: 3.0,
            window_s: 180.0,
            least_m: 2.0 * wavelength_m,
            rate_hz: 2.0,
            extrapolate_s: 0.05,
            accurate_every_s: 5.0,
        }
    }
}

/// A robot whose bearing is wanted.
#[derive(Clone, Debug)]
pub struct LivePeer {
    /// Its name.
    pub name: String,
    /// Its MAC.
    pub mac: Mac,
    /// Its poses so far: usually [`Track::still`], or empty for one that publishes them.
    pub track: Track,
    /// How far its frame is turned against this robot's, radians.
    pub yaw_rad: f64,
}

/// What is known about a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PeerState {
    /// A new bearing.
    Bearing,
    /// The last bearing: nothing moved since.
    Held,
    /// The robots have not yet moved enough relative to each other.
    NotYet,
    /// Too few exchanges, none with a pose, or none since the last bearing, which is repeated.
    NoPairs,
    /// The estimator refused; see the error.
    Failed,
}

/// A report about a peer at one time.
#[derive(Clone, Debug, Serialize)]
pub struct PeerReport {
    /// Host time of the last exchange in it, seconds since the Unix epoch.
    pub t_s: Option<f64>,
    /// What it is.
    pub state: PeerState,
    /// The same in words.
    pub words: String,
    /// Relative motion in the window: the diagonal of its box, metres.
    pub moved_m: f64,
    /// Relative motion that is needed, metres.
    pub needed_m: f64,
    /// Seconds since the bearing was made, for one that is repeated.
    pub age_s: f64,
    /// The bearing is the accuracy layer's.
    pub accurate: bool,
    /// When the last record in it came, on the driver's clock.
    #[serde(skip)]
    pub heard_at: Option<Instant>,
    /// The bearing and all that goes with it.
    #[serde(flatten)]
    pub answer: Answer,
}

/// Counts of a peer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PeerCounts {
    /// Records of this robot's card from the peer.
    pub heard: u64,
    /// Records of the peer's card from this robot.
    pub heard_by_peer: u64,
    /// Pairs formed so far.
    pub pairs: u64,
    /// Searches made.
    pub estimates: u64,
    /// Those of them with the accuracy layer.
    pub accurate: u64,
    /// Searches skipped because nothing moved.
    pub skipped: u64,
    /// Losses that the peer's source reported.
    pub losses: u64,
    /// Where the scheduler shares a key: what was not admitted.
    pub refused: AdmissionCounts,
    /// Windows through which the peer's place was carried, and how often that restarted.
    pub carried: TrackCounts,
}
