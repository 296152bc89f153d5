//! How bearings are to be made.

use crate::bartlett::SearchOptions;
use crate::exchange::tdma::Key;
use crate::motion::pose::Trajectory;
use crate::signal::channel::Channel;
use crate::tuning::TUNING;
use driver_iface::{Mac, bfee::Antenna};
use std::num::NonZeroUsize;

/// Pairs this long before and after the trajectory are kept, seconds; others are counted and forgotten, so that a log
/// of hours costs no memory.
const SETTLE_S: f64 = 30.0;

/// How pairs find their place on the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JoinBy {
    /// By the receiver's host time.
    #[default]
    Time,
    /// The n-th frame of the link in the receiver's log belongs to the n-th pose.
    Row,
}

/// How much is computed beyond a plane wave, of the steps that [`Accuracy`] allows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Effort {
    /// Every step that may move the azimuth by more than a tenth of its error bar: where one wave leaves nothing but noise,
    /// none does.
    #[default]
    Needed,
    /// Every step that may move the azimuth by more than this, radians; none where the plane wave's error bar is below it.
    Within(f64),
    /// Every step.
    Everything,
}

/// Which steps beyond a plane wave at the channel centre may be taken. Every one can be left out, to see what it brings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Accuracy {
    /// Spherical waves: range and position beside the bearing. Without them none of the other steps is taken.
    pub near_field: bool,
    /// Alignment of the sampling time from packet to packet.
    pub align: bool,
    /// The one-way channel beside the round trip.
    pub one_way: bool,
    /// Autofocus of the trajectory over all transmitters of a capture.
    pub focus: bool,
    /// The paths beside the answer.
    pub paths: bool,
    /// How much of them is computed.
    pub effort: Effort,
    /// Shortest distance of a transmitter, metres.
    pub range_min_m: f64,
    /// The transmitter's height above the receiver's antenna, metres, where known.
    pub height_m: Option<f64>,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self {
            near_field: true,
            align: true,
            one_way: true,
            focus: true,
            paths: true,
            effort: Effort::default(),
            range_min_m: TUNING.deviations.range_min_m,
            height_m: None,
        }
    }
}

impl Accuracy {
    /// Without any step: a plane wave at the channel centre.
    #[must_use]
    pub fn without_layers(self) -> Self {
        Self { near_field: false, align: false, one_way: false, ..self }
    }

    /// With or without spherical waves.
    #[must_use]
    pub fn with_near_field(mut self, near_field: bool) -> Self {
        self.near_field = near_field;
        self
    }

    /// With or without the paths beside the answer.
    #[must_use]
    pub fn with_paths(mut self, paths: bool) -> Self {
        self.paths = paths;
        self
    }

    /// With so much of the steps computed.
    #[must_use]
    pub fn with_effort(mut self, effort: Effort) -> Self {
        self.effort = effort;
        self
    }

    /// With another shortest distance of a transmitter, metres.
    #[must_use]
    pub fn with_range_min_m(mut self, range_min_m: f64) -> Self {
        self.range_min_m = range_min_m;
        self
    }

    /// With the transmitter's height above the receiver's antenna, metres.
    #[must_use]
    pub fn with_height_m(mut self, height_m: Option<f64>) -> Self {
        self.height_m = height_m;
        self
    }
}

/// How bearings are to be made.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Options {
    /// The WiFi channel.
    pub channel: Channel,
    /// The antenna used on both robots.
    pub antenna: Antenna,
    /// MACs of the transmitters, in the order of their logs; found where absent.
    pub tx_macs: Vec<Mac>,
    /// MAC of the receiver in the transmitters' logs; the most frequent one where absent.
    pub rx_mac: Option<Mac>,
    /// The key of the exchange, where it had one: records whose frame has no valid tag are left out.
    pub key: Option<Key>,
    /// Added to the receiver's host time to get the trajectory's, seconds.
    pub clock_offset_s: f64,
    /// Standard deviation of the heading of the whole trajectory, radians: a figure of the sensor, which error bars and
    /// probabilities take into account. `None`: as exact as motion capture, unless the caller of the pipeline knows the
    /// sensor.
    pub heading_sd_rad: Option<f64>,
    /// How pairs are joined with the trajectory.
    pub join: JoinBy,
    /// Only pairs from here on, seconds after the link's first pair.
    pub from_s: Option<f64>,
    /// Only pairs up to here, seconds after the link's first pair.
    pub to_s: Option<f64>,
    /// Only every so manieth pair, as if frames had been sent more slowly.
    pub decimate: NonZeroUsize,
    /// Whether turn-around compensation may be applied.
    pub compensate: bool,
    /// Whether links are estimated on all cores of the current rayon pool, or one after the other.
    pub parallel: bool,
    /// Whether the course of the phase, and the evidence over azimuth, are kept for pictures.
    pub keep_course: bool,
    /// Whether maps of the joint power over all elevations and ranges are made for pictures; they cost more than the bearing.
    #[doc(hidden)] // for the crates of this workspace
    pub keep_maps: bool,
    /// What is done beyond a plane wave.
    pub accuracy: Accuracy,
    /// How the bearing is searched for.
    pub search: SearchOptions,
}

impl Options {
    /// With the key of the exchange.
    #[must_use]
    pub fn with_key(mut self, key: Option<Key>) -> Self {
        self.key = key;
        self
    }

    /// The defaults, on `channel`: antenna A, transmitters and receiver found, joined by time, compensated.
    #[must_use]
    pub fn new(channel: Channel) -> Self {
        Self {
            channel,
            antenna: Antenna::A,
            tx_macs: Vec::new(),
            rx_mac: None,
            key: None,
            clock_offset_s: 0.0,
            heading_sd_rad: None,
            join: JoinBy::Time,
            from_s: None,
            to_s: None,
            decimate: NonZeroUsize::MIN,
            compensate: true,
            accuracy: Accuracy::default(),
            parallel: false,
            keep_course: false,
            keep_maps: false,
            search: SearchOptions::default(),
        }
    }

    /// With another antenna, the same on both robots.
    #[must_use]
    pub fn with_antenna(mut self, antenna: Antenna) -> Self {
        self.antenna = antenna;
        self
    }

    /// With the receiver's MAC (`None`: the most frequent sender in the transmitters' logs), and the transmitters', in the
    /// order of their logs.
    #[must_use]
    pub fn with_macs(mut self, rx_mac: Option<Mac>, tx_macs: Vec<Mac>) -> Self {
        (self.rx_mac, self.tx_macs) = (rx_mac, tx_macs);
        self
    }

    /// With so much added to the receiver's host time to get the trajectory's, seconds.
    #[must_use]
    pub fn with_clock_offset_s(mut self, clock_offset_s: f64) -> Self {
        self.clock_offset_s = clock_offset_s;
        self
    }

    /// With the standard deviation of the trajectory's heading, radians, where the sensor is known.
    #[must_use]
    pub fn with_heading_sd_rad(mut self, heading_sd_rad: Option<f64>) -> Self {
        self.heading_sd_rad = heading_sd_rad;
        self
    }

    /// Joined with the trajectory by time or row by row.
    #[must_use]
    pub fn with_join(mut self, join: JoinBy) -> Self {
        self.join = join;
        self
    }

    /// With pairs from `from_s` to `to_s` only, seconds after the link's first pair.
    #[must_use]
    pub fn with_cut(mut self, from_s: Option<f64>, to_s: Option<f64>) -> Self {
        (self.from_s, self.to_s) = (from_s, to_s);
        self
    }

    /// With only every so manieth pair.
    #[must_use]
    pub fn with_decimate(mut self, decimate: NonZeroUsize) -> Self {
        self.decimate = decimate;
        self
    }

    /// With or without turn-around compensation.
    #[must_use]
    pub fn with_compensate(mut self, compensate: bool) -> Self {
        self.compensate = compensate;
        self
    }

    /// On all cores of the current rayon pool, or one link after the other.
    #[must_use]
    pub fn with_parallel(mut self, parallel: bool) -> Self {
        self.parallel = parallel;
        self
    }

    /// With or without what pictures of phase, trajectory and profile need.
    #[must_use]
    pub fn with_keep_course(mut self, keep_course: bool) -> Self {
        self.keep_course = keep_course;
        self
    }

    /// With or without maps of the joint power.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn with_keep_maps(mut self, keep_maps: bool) -> Self {
        self.keep_maps = keep_maps;
        self
    }

    /// With other steps beyond a plane wave.
    #[must_use]
    pub fn with_accuracy(mut self, accuracy: Accuracy) -> Self {
        self.accuracy = accuracy;
        self
    }

    /// With another search.
    #[must_use]
    pub fn with_search(mut self, search: SearchOptions) -> Self {
        self.search = search;
        self
    }

    /// The receiver's host time, microseconds, in which pairs are of use: the trajectory's and some seconds about it, in
    /// which the robot stands and the phase settles.
    pub(super) fn span_us(&self, trajectory: &Trajectory) -> Option<(i64, i64)> {
        let (start_s, end_s) = trajectory.span_s();
        let us = |t_s: f64| ((t_s - self.clock_offset_s) * 1e6) as i64;
        let margin_us = (SETTLE_S * 1e6) as i64;
        let span = (us(start_s).saturating_sub(margin_us), us(end_s).saturating_add(margin_us));
        (self.join == JoinBy::Time).then_some(span)
    }

    pub(super) fn keeps(&self, since_first_s: f64) -> bool {
        self.from_s.is_none_or(|from| since_first_s >= from) && self.to_s.is_none_or(|to| since_first_s <= to)
    }
}
