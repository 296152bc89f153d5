//! What is known about odometry and peers beforehand.

/// Contribution of each motion after the first to the exponent of the combined evidence; the first adds 1 (least Brier
/// score of carried bearings, 30 places, four trajectories, halves to eighths).
pub(crate) const OWN_SHARE: f64 = 0.3;

/// Peers are as likely per area up to here, and per logarithm of the range beyond, metres (half of a room).
pub(crate) const ROOM_M: f64 = 4.0;

/// A range is reported where its predicted deviation is below this share of it.
pub(crate) const RANGE_SHARE: f64 = 0.35;

/// Relative error that no range is better than (one range in six is off by more).
pub(crate) const RANGE_FLOOR: f64 = 0.3;

/// Share of ranges that are wrong whatever their deviation (ranges behind walls and by bent trajectories are wrong by
/// metres).
pub(crate) const RANGE_MISSED: f64 = 0.5;

/// Least wander of a heading, degrees after one metre (motion capture).
const TURN_DEG_PER_RT_M: f64 = 0.2;

/// Error of positions as a share of the way driven (as deviations.scale_sd).
const SLIP: f64 = 0.01;

/// A peer that is silent for longer counts as lost, seconds (longer than a window of a live estimator).
const GONE_S: f64 = 300.0;
/// The power that the evidence of `known` motions together is taken to (each counts as the probability that one of its
/// directions is right): motions are deceived together, and each after the first counts as a share of one that is
/// deceived by itself (`own_share`).
pub(super) fn temper(known: f64, own_share: f64) -> f64 {
    let known = known.max(1.0);
    (1.0 + (known - 1.0) * own_share.clamp(0.0, 1.0)) / known
}

/// What may happen to places between two stretches of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackSettings {
    /// Standard deviation of the heading of the whole trajectory, radians, as for single bearings. Common to all stretches,
    /// it decides between no places; error bars and probabilities of answers hold it.
    pub heading_sd_rad: f64,
    /// How the heading wanders: standard deviation after one metre, radians; it grows with the root of the way driven.
    pub turn_rad_per_rt_m: f64,
    /// Error of the position as a share of the way driven.
    pub slip: f64,
    /// How a peer without odometry wanders: standard deviation after one second, metres, in x and in y; it grows with the
    /// root of the time. 0: it stands still, or its odometry is known.
    pub wander_m_per_rt_s: f64,
    /// A peer that is silent for longer counts as lost, and its place is dropped, seconds.
    pub gone_s: f64,
    /// What each stretch after the first adds to the power that all evidence together is taken to when an answer is read from
    /// it; the first adds 1. 1: stretches are deceived independently; 0: all alike.
    pub own_share: f64,
}

impl TrackSettings {
    /// A peer that stands still or has odometry of its own, and odometry whose heading has this standard deviation over one
    /// motion of about a metre, radians ([`crate::pipeline::Options::heading_sd_rad`]).
    #[must_use]
    pub fn new(heading_sd_rad: f64) -> Self {
        let heading_sd_rad = if heading_sd_rad.is_finite() { heading_sd_rad.abs() } else { 0.0 };
        Self {
            heading_sd_rad,
            turn_rad_per_rt_m: heading_sd_rad.max(TURN_DEG_PER_RT_M.to_radians()),
            slip: SLIP,
            wander_m_per_rt_s: 0.0,
            gone_s: GONE_S,
            own_share: OWN_SHARE,
        }
    }

    /// For a peer that wanders so far without odometry: standard deviation after one second, metres.
    #[must_use]
    pub fn with_wander_m_per_rt_s(self, wander_m_per_rt_s: f64) -> Self {
        Self { wander_m_per_rt_s, ..self }
    }

    /// For odometry whose heading wanders so far: standard deviation after one metre, radians.
    #[must_use]
    pub fn with_turn_rad_per_rt_m(self, turn_rad_per_rt_m: f64) -> Self {
        Self { turn_rad_per_rt_m, ..self }
    }

    /// For odometry whose positions are off by this share of the way driven.
    #[must_use]
    pub fn with_slip(self, slip: f64) -> Self {
        Self { slip, ..self }
    }

    /// With another time after which a silent peer counts as lost, seconds.
    #[must_use]
    pub fn with_gone_s(self, gone_s: f64) -> Self {
        Self { gone_s, ..self }
    }

    /// For stretches of which each after the first adds this to the power of all, 0..1.
    #[must_use]
    pub fn with_own_share(self, own_share: f64) -> Self {
        Self { own_share, ..self }
    }

    /// Standard deviations after `driven_m` metres and `passed_s` seconds: of the heading, radians, and of the place of the
    /// peer relative to the robot, metres. Settings that are no numbers, or negative, count as 0.
    pub(super) fn blur(&self, driven_m: f64, passed_s: f64) -> (f64, f64) {
        let of = |value: f64| if value.is_finite() { value.max(0.0) } else { 0.0 };
        let turn_rad = of(self.turn_rad_per_rt_m) * driven_m.sqrt();
        let moved_m = (of(self.slip) * driven_m).hypot(of(self.wander_m_per_rt_s) * passed_s.sqrt());
        (turn_rad, moved_m)
    }
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self::new(0.0)
    }
}
