//! Settings, inputs and reports of the live estimator.

use super::track::Track;
use crate::exchange::admission::AdmissionCounts;
use crate::pipeline::Answer;
use crate::place::TrackCounts;
use crate::time::Instant;
use driver_iface::Mac;
use serde::Serialize;

/// Data and rate of estimates.
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
    /// Poses are extrapolated by at most this, seconds.
    pub extrapolate_s: f64,
    /// Interval of the accuracy layer for each peer, seconds: in between, bearings assume a plane wave at the channel
    /// centre. 0: every time. It also runs when the robots stop, and at the end.
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
    /// Its poses so far: usually [`Track::still`], or empty if it publishes them.
    pub track: Track,
    /// Rotation of its frame against this robot's, radians.
    pub yaw_rad: f64,
}

/// The state of a peer.
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
    /// Age of a repeated bearing, seconds.
    pub age_s: f64,
    /// The bearing is of the accuracy layer.
    pub accurate: bool,
    /// When the last record in it came, on the driver's clock.
    #[serde(skip)]
    pub heard_at: Option<Instant>,
    /// The bearing with all its fields.
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
    /// If the scheduler shares a key: refused records.
    pub refused: AdmissionCounts,
    /// Windows through which the peer's place was carried, and how often that restarted.
    pub carried: TrackCounts,
}
