//! Why a link gives no bearing.

use crate::bartlett;
use crate::exchange::assign::Unmatched;
use crate::signal::samples::SamplesError;

/// Why a link gives no bearing.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// A number of [`super::Options`] is out of its range.
    #[error("{option} is {value}: it must be from {least} to {most}")]
    OutOfRange {
        /// The option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// The smallest valid value.
        least: f64,
        /// The largest valid value.
        most: f64,
    },
    /// No frame of this transmitter is in both logs.
    #[error(
        "no frame number of this link is in both logs ({receiver} records in the receiver's, {transmitter} in the transmitter's): are they of the same run?"
    )]
    NoPairs {
        /// Frames in the receiver's log.
        receiver: u64,
        /// Frames in the transmitter's log.
        transmitter: u64,
    },
    /// The antenna heard nothing: all CSI of the pairs is zero.
    #[error(
        "the antenna heard nothing: the CSI of all {pairs} pairs is zero in one of the directions; try another --antenna"
    )]
    Silent {
        /// Pairs.
        pairs: usize,
    },
    /// The receiver's records hold no host time, so they cannot be joined with a trajectory by time.
    #[error("the receiver's records hold no host times: join with the trajectory row by row")]
    NoHostTime,
    /// No pair is left in the requested stretch ([`super::Options::from_s`] and `to_s`).
    #[error("all {pairs} pairs are outside the stretch asked for (the link lasts {length_s:.3} s)")]
    AllCut {
        /// Pairs.
        pairs: usize,
        /// Time from the first to the last pair, s.
        length_s: f64,
    },
    /// The clocks of the pairs are unrelated.
    #[error(
        "the two logs do not belong together: their clocks' difference spreads by {spread_us:.0} us from pair to pair; in one run it spreads by some tens"
    )]
    NotOfOneRun {
        /// Median of the deviation from a straight line, microseconds.
        spread_us: f64,
    },
    /// Neither the clocks nor the channels of the two logs match.
    #[error(
        "the frames of the two sides are not of one exchange, or answers come too irregularly to tell: the pauses between them correlate by {clocks:.2} and the channel's changes by {channel:.2}, where those of one exchange have 0.8 and 0.9 or more"
    )]
    OfTwoRuns {
        /// Correlation of the pauses between frames on both clocks.
        clocks: f64,
        /// Correlation of the changes of the channel's shape in the two directions.
        channel: f64,
    },
    /// The trajectory has a row for each frame, and its times do not fit.
    #[error(
        "{outside} of {pairs} pairs lie outside the trajectory's times although it has a row for each frame ({rows}): its clock is another one; join row by row, or give the clocks' difference"
    )]
    RowsNotTimes {
        /// Rows of the trajectory.
        rows: usize,
        /// Pairs outside its times.
        outside: usize,
        /// Pairs.
        pairs: usize,
    },
    /// The two logs hold the same frames.
    #[error("one log was given for both sides: all its frames are the same: name the other robot's log")]
    OneLogTwice,
    /// The trajectory is larger than any usable array.
    #[error(
        "the robots moved {extent_m:.0} m relative to each other: are the trajectories in metres? At most {limit_m:.0} m are used at once"
    )]
    TooLarge {
        /// Extent of the motion, metres.
        extent_m: f64,
        /// The largest that is searched, metres.
        limit_m: f64,
    },
    /// All pairs lie outside the trajectory, or many and the other log's times fit it.
    #[error(
        "the {pairs} pairs (from about {from_s:.3} s) lie outside the trajectory ({start_s:.3} s to {end_s:.3} s): {}",
        why_outside(*.other_fits, *.from_s, *.start_s)
    )]
    OutsideTrajectory {
        /// Pairs.
        pairs: usize,
        /// Time of the first pair on the trajectory's clock, s.
        from_s: f64,
        /// First pose, s.
        start_s: f64,
        /// Last pose, s.
        end_s: f64,
        /// By the host time of the transmitter's log nearly all pairs are inside.
        other_fits: bool,
    },
    /// The robots did not move relative to each other.
    #[error(
        "no motion: none of the {pairs} pairs was taken while a robot moved, and without motion there is no bearing"
    )]
    NoMotion {
        /// Pairs.
        pairs: usize,
    },
    /// One log: it lacks a requested sender.
    #[error("no record of this sender has the CSI of all named antennas")]
    Unheard,
    /// One log: the robot did not turn.
    #[error(
        "no turn: none of the {records} records was taken while the baseline turned, and two antennas that do not turn show no bearing, unless the constant between their chains is known from a turn before (--baseline X,Y,Z,DEG,SD)"
    )]
    NotTurned {
        /// Records of the sender.
        records: usize,
    },
    /// One log: the trajectory has no heading.
    #[error(
        "the trajectory has no heading (5 columns), and a bearing from one log needs it: use one with yaw or quaternion"
    )]
    NoAttitude,
    /// One log: the phases do not follow the turn.
    #[error(
        "the phase between the antennas does not follow the robot's turn: one wave explains {coherence:.2} of {records} records, \
         no more than chance; are these antennas connected, is the baseline theirs, and are there enough records?"
    )]
    Unsteady {
        /// Records used.
        records: usize,
        /// Share of them that one wave explains.
        coherence: f64,
    },
    /// Of a bearing from one log: the turn in it contradicts the constant of the chains that was given.
    #[error(
        "the constant between the chains is given as {given_deg:.1} deg, and the turn in this log gives {turn_deg:.1} +- {sd_deg:.1} deg: \
         was the firmware loaded since, or is the baseline another one? Leave the constant out, or take that of the turn"
    )]
    WrongConstant {
        /// As given, degrees.
        given_deg: f64,
        /// As the turn has it, degrees.
        turn_deg: f64,
        /// Its standard deviation, degrees.
        sd_deg: f64,
    },
    /// The transmitter's log could not be matched.
    #[error(transparent)]
    Unmatched(#[from] Unmatched),
    /// A sample is impossible.
    #[error(transparent)]
    Samples(#[from] SamplesError),
    /// The estimator refused.
    #[error(transparent)]
    Bartlett(#[from] bartlett::Error),
}

/// A unit in which a trajectory's times would fit, if they are not seconds.
fn unit(from_s: f64, start_s: f64) -> Option<&'static str> {
    let units = [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")];
    // Hosts have Unix time: of a run of the same year, the first digits agree.
    units.into_iter().find(|(factor, _)| (start_s / from_s / factor - 1.0).abs() < 0.02).map(|(_, unit)| unit)
}

fn why_outside(other_fits: bool, from_s: f64, start_s: f64) -> String {
    match unit(from_s, start_s) {
        _ if other_fits => "the other log's times fit it: were the two logs exchanged?".into(),
        Some(unit) => format!("its times look like {unit}, and are read as seconds"),
        None => "is it of this run?".into(),
    }
}

impl LinkError {
    /// The unit in which a trajectory's times would fit its pairs, if they are not seconds.
    #[must_use]
    pub fn unit_of_times(&self) -> Option<&'static str> {
        match self {
            Self::OutsideTrajectory { from_s, start_s, other_fits: false, .. } => unit(*from_s, *start_s),
            _ => None,
        }
    }
}
