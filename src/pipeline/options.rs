//! How bearings are to be made.

use super::LinkError;
use crate::bartlett::Tier;
use crate::estimate::prior::Limits;
use crate::estimate::tuning::sensor;
use crate::estimate::{Effort, Task, heading};
use crate::exchange::tdma::Key;
use crate::motion::pose::{Trajectory, TrajectoryKind};
use crate::signal::channel::Channel;
use crate::signal::samples::Samples;
use driver_iface::{Mac, bfee::Antenna};
use std::f64::consts::FRAC_PI_2;
use std::num::NonZeroUsize;

/// Pairs up to this long before and after the trajectory are kept, seconds; others are only counted, so that a log of
/// hours costs no memory.
const SETTLE_S: f64 = 30.0;

/// Least [`Accuracy::range_min_m`]: the nearer the transmitter may be, the more places are searched.
const NEAREST_M: f64 = 0.01;

/// Largest number of an option, metres or radians.
const FURTHEST: f64 = 1e6;

/// How pairs find their place on the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JoinBy {
    /// By the receiver's host time.
    #[default]
    Time,
    /// The n-th frame of the link in the receiver's log belongs to the n-th pose.
    Row,
}

/// Which steps of the estimate may be taken, and the limits of its prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Curved wave fronts: range and position beside the bearing.
    pub near_field: bool,
    /// Alignment of the sampling time from packet to packet.
    pub align: bool,
    /// The one-way channel beside the round trip.
    pub one_way: bool,
    /// How much is computed.
    pub effort: Effort,
    /// Largest |elevation| of a transmitter, radians, 0 to pi/2; 0 fixes the horizon. None: 20 degrees, and if the
    /// motion distinguishes elevations, more with a tenth of the probability.
    pub elevation_max_rad: Option<f64>,
    /// Shortest distance of a transmitter, metres, at least 0.01. None: 1.8 m, and any if one wave leaves nothing but noise.
    pub range_min_m: Option<f64>,
    /// The transmitter's height above the receiver's antenna, metres, if known.
    pub height_m: Option<f64>,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self {
            near_field: true,
            align: true,
            one_way: true,
            effort: Effort::default(),
            elevation_max_rad: None,
            range_min_m: None,
            height_m: None,
        }
    }
}

/// How bearings are to be made: [`Options::new`] with other values of some fields, `Options { antenna, ..Options::new(channel) }`.
#[derive(Clone, Debug)]
pub struct Options {
    /// The WiFi channel.
    pub channel: Channel,
    /// The antenna used on both robots.
    pub antenna: Antenna,
    /// MACs of the transmitters, in the order of their logs; found where absent.
    pub tx_macs: Vec<Mac>,
    /// MAC of the receiver in the transmitters' logs; the most frequent one where absent.
    pub rx_mac: Option<Mac>,
    /// The key of the exchange, if it had one: records whose frame has no valid tag are skipped.
    pub key: Option<Key>,
    /// Added to the receiver's host time to get the trajectory's, seconds.
    pub clock_offset_s: f64,
    /// Standard deviation of the heading of the whole trajectory, radians: a figure of the sensor, which error bars and
    /// probabilities take into account. `None`: as usual for the trajectory's kind, as of motion capture if that is not known.
    pub heading_sd_rad: Option<f64>,
    /// How pairs are joined with the trajectory.
    pub join: JoinBy,
    /// Only pairs from here on, seconds after the link's first pair.
    pub from_s: Option<f64>,
    /// Only pairs up to here, seconds after the link's first pair.
    pub to_s: Option<f64>,
    /// Only every n-th pair, as if frames had been sent more slowly.
    pub decimate: NonZeroUsize,
    /// Whether turn-around compensation may be applied.
    pub compensate: bool,
    /// Whether links are estimated on all cores of the current rayon pool, or one after the other.
    pub parallel: bool,
    /// Whether the course of the phase, and the evidence over azimuth, are kept for pictures.
    pub keep_course: bool,
    /// Whether the change of the distance from exchange to exchange is computed too.
    pub range_change: bool,
    /// Whether the receiver's odometry is corrected by the phases of all links first. Links of a live session are never.
    pub fit_odometry: bool,
    /// Whether the figures of merit of other programs are computed too.
    #[doc(hidden)] // for the crates of this workspace
    pub figures: bool,
    /// Which steps are taken, and the limits of the prior.
    pub accuracy: Accuracy,
    /// Standard deviation of the positions' short-term error, metres: it decides whether the motion's depth
    /// distinguishes a direction from its reflection. Default 3 mm.
    pub odometry_sd_m: f64,
    /// The SIMD tier to run on. Default: the widest of this machine.
    pub tier: Tier,
}

impl Options {
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
            figures: true,
            range_change: false,
            fit_odometry: false,
            odometry_sd_m: sensor::POSITION_M,
            tier: Tier::detect(),
        }
    }

    /// Refuses numbers by which no estimate can be made.
    pub(super) fn check(&self) -> Result<(), LinkError> {
        let Accuracy { elevation_max_rad, range_min_m, height_m, .. } = self.accuracy;
        let numbers = [
            ("elevation_max_rad", elevation_max_rad, [0.0, FRAC_PI_2]),
            ("range_min_m", range_min_m, [NEAREST_M, FURTHEST]),
            ("height_m", height_m, [-FURTHEST, FURTHEST]),
            ("heading_sd_rad", self.heading_sd_rad, [0.0, FURTHEST]),
            ("odometry_sd_m", Some(self.odometry_sd_m), [0.0, FURTHEST]),
        ];
        let is_wrong = |(_, value, [least, most]): &(_, Option<f64>, [f64; 2])| {
            value.is_some_and(|value| !(*least..=*most).contains(&value))
        };
        match numbers.into_iter().find(is_wrong) {
            Some((option, Some(value), [least, most])) => Err(LinkError::OutOfRange { option, value, least, most }),
            _ => Ok(()),
        }
    }

    /// The limits of the prior.
    pub(super) fn limits(&self) -> Limits {
        let Accuracy { near_field, elevation_max_rad, range_min_m, height_m, .. } = self.accuracy;
        Limits { elevation_max_rad, range_min_m, height_m, near_field }
    }

    /// Standard deviation of the heading: the one given, or that of the trajectory's kind of sensor; and of the azimuths that
    /// rounded times leave.
    pub(super) fn heading_sd_of(&self, trajectory: &Trajectory) -> f64 {
        let usual_deg = match trajectory.kind() {
            TrajectoryKind::Camera => sensor::CAMERA_DEG,
            TrajectoryKind::RollingCamera => sensor::ROLLING_CAMERA_DEG,
            TrajectoryKind::MountedWheels => sensor::WHEELS_DEG,
            TrajectoryKind::Wheels => sensor::UNMOUNTED_DEG,
            TrajectoryKind::MotionCapture | TrajectoryKind::Unknown => sensor::MOTION_CAPTURE_DEG,
        };
        self.heading_sd_rad.unwrap_or(usual_deg.to_radians()).hypot(trajectory.rounding_sd_rad())
    }

    /// The estimate of these samples on this trajectory.
    pub(super) fn task<'a>(&self, samples: &'a Samples, receiver: &Trajectory) -> Task<'a> {
        let heading_sd_rad = self.heading_sd_of(receiver);
        let bend_rad = heading::bend_rad(heading_sd_rad);
        Task {
            samples,
            indices: self.channel.subcarriers(),
            limits: self.limits(),
            odometry_sd_m: self.odometry_sd_m,
            heading_sd_rad,
            bend_rad,
            scale_sd: heading::scale_sd(bend_rad),
            effort: self.accuracy.effort,
            align: self.accuracy.align,
            one_way: self.accuracy.one_way,
            drive: None,
            other_times: None,
            tier: self.tier,
        }
    }

    /// The span of the receiver's host time, microseconds, in which pairs are useful: the trajectory and some seconds
    /// around it, in which the phase settles.
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
