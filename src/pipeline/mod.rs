//! Logs and a trajectory in, bearings out: the module that connects sources, state machines and the estimator.
//!
//! [`Capture`] is the short way in; [`bearings`] takes sources that the caller keeps.
//!
//! | step | where |
//! |---|---|
//! | records of each log become frames of one antenna | `intake` |
//! | frames without numbers get them by the cards' clocks | `unnumbered` |
//! | which transmitter wrote which log; all logs read in step | `reading` |
//! | frames paired, each pair a round trip | `link` |
//! | clocks, compensation, the gate of motion, the estimate (`crate::estimate`) | `draft` |
//! | one log of a robot that turns, by two or three antennas | `one_log`, `first_delay` |
//! | the same while robots drive, over the last metres | [`live`] |
//! | whether log and trajectory tell the same times | `clocks` |
//! | the answer, as values with its evidence of the place, and as a line of JSON | `bearing`, `answer`, `explain` |

mod answer;
mod bearing;
mod capture;
mod clocks;
mod draft;
mod error;
mod explain;
mod first_delay;
pub(crate) mod intake;
mod link;
pub mod live;
pub(crate) mod one_log;
mod options;
mod reading;
mod unnumbered;

pub use crate::estimate::{
    Effort, NoRangeChange, OdometryError, OdometryFit, RangeChange, Reason, Risk, Sufficient, Unexplained,
};
pub use answer::{
    Answer, CandidateAnswer, CarriedAnswer, CarriedCandidate, RangeChangeAnswer, StretchAnswer, lost_something,
};
pub use bearing::{Bearing, BearingAnswer, Candidate, PairCounts, Phase, Range, WaveModel};
pub use capture::{Capture, CaptureError};
pub use clocks::ClockOffset;
pub(crate) use draft::{LinkJoin, bearing as estimate_one, estimate_all as estimate};
pub use error::LinkError;
pub use explain::{LinkPlan, StepPlan};
pub use intake::UnusedRecords;
pub(crate) use intake::{FrameHeard, Front};
pub use link::Link;
pub use one_log::{Array, ArrayError, ChainConstant, OneLog, one_log};
pub use options::{Accuracy, JoinBy, Options};

use crate::exchange::assign::{Match, Unmatched};
use crate::motion::pose::Trajectory;
use crate::source::survey::Survey;
use crate::source::{CsiSource, Error};
use driver_iface::Mac;
use intake::LogReader;
use reading::{MacFound, find_macs, read_ahead, receivers};

/// One transmitter: its log and, if it moved too, its trajectory on the receiver's clock.
pub struct Transmitter<'a> {
    /// Its log; with others it is read on all threads of the current rayon pool, if [`Options::parallel`] says so.
    pub log: &'a mut (dyn CsiSource + Send),
    /// Its displacement, if it moved.
    pub trajectory: Option<&'a Trajectory>,
}

/// Counts of one log.
#[derive(Debug, Default)]
#[non_exhaustive]
pub struct LogReport {
    /// What is in it.
    pub survey: Survey,
    /// What the pipeline could not use.
    pub unused: UnusedRecords,
    /// With a key: records that were used without a frame to check.
    pub unchecked: u64,
}

/// The result of one transmitter's log.
#[derive(Debug)]
pub struct LinkReport {
    /// The transmitter's MAC, once known.
    pub mac: Option<Mac>,
    /// How it was found, unless it was given.
    pub matched: Option<Match>,
    /// The link itself, for its counts.
    pub link: Option<Link>,
    /// Its bearing.
    pub bearing: Result<Bearing, LinkError>,
}

/// The result of a run.
#[derive(Debug)]
pub struct CaptureReport {
    /// The receiver's log.
    pub receiver: LogReport,
    /// The transmitters' logs; none if the receiver's is used alone.
    pub transmitters: Vec<LogReport>,
    /// One link for each of them, or for each sender in the receiver's log.
    pub links: Vec<LinkReport>,
}

impl CaptureReport {
    /// What the phases say of the receiver's clock, if that puts its bearings in doubt.
    #[must_use]
    pub fn clock_doubt(&self) -> Option<ClockOffset> {
        self.links.iter().find_map(|link| link.bearing.as_ref().ok()?.clock_offset).filter(|found| found.doubt)
    }
}

/// Makes the bearings of one receiver to its transmitters.
///
/// # Errors
/// If a log cannot be read, or there are more [`Options::tx_macs`] than logs. A link that fails is reported in its place and
/// does not stop the others.
pub fn bearings(
    receiver: &mut (dyn CsiSource + Send),
    transmitters: Vec<Transmitter<'_>>,
    trajectory: &Trajectory,
    options: &Options,
) -> Result<CaptureReport, Error> {
    let (macs, logs) = (options.tx_macs.len(), transmitters.len());
    if macs > logs {
        return Err(Error::MoreMacs { macs, logs });
    }
    let mut rx = LogReader::new(receiver, options, options.tx_macs.iter().copied());
    let (logs, paths): (Vec<_>, Vec<_>) = transmitters.into_iter().map(|t| (t.log, t.trajectory)).unzip();
    let mut txs: Vec<LogReader<'_>> =
        logs.into_iter().map(|log| LogReader::new(log, options, options.rx_mac)).collect();
    read_ahead(&mut rx, &mut txs, options)?;
    unnumbered::number(&mut rx, &mut txs, options);
    let receivers = receivers(&txs, options);
    let found = find_macs(&rx, &txs, &receivers, options);
    let span_us = options.span_us(trajectory);
    let link = |found: &MacFound| found.as_ref().ok().map(|(mac, _)| Link::new(*mac, span_us).of_logs());
    let mut links: Vec<Option<Link>> = found.iter().map(link).collect();
    reading::read(&mut rx, &mut txs, &receivers, &mut links, options)?;
    let joins: Vec<LinkJoin<'_>> = links
        .iter()
        .zip(paths)
        .filter_map(|(link, transmitter)| Some(LinkJoin { link: link.as_ref()?, receiver: trajectory, transmitter }))
        .collect();
    let fit = options.fit_odometry.then(|| draft::fit_odometry(&joins, options));
    let (fit, corrected) = fit.map_or((None, None), |(fit, corrected)| (Some(fit), corrected));
    let joins: Vec<LinkJoin<'_>> = match &corrected {
        Some((receiver, _)) => joins.iter().map(|join| LinkJoin { receiver, ..*join }).collect(),
        None => joins,
    };
    let heading_sd_rad = corrected.as_ref().map(|(_, heading_sd_rad)| *heading_sd_rad).or(options.heading_sd_rad);
    let mut made = clocks::estimate(&joins, &Options { heading_sd_rad, ..options.clone() });
    made.iter_mut().flatten().for_each(|bearing| bearing.odometry_fit.clone_from(&fit));
    let mut made = made.into_iter();
    let report = |(link, found): (Option<Link>, MacFound)| {
        let (mac, matched) = found.as_ref().map_or((None, None), |(mac, matched)| (Some(*mac), *matched));
        let missing = || Err(found.err().unwrap_or(Unmatched::NothingInCommon).into());
        let bearing = link.as_ref().and_then(|_| made.next()).unwrap_or_else(missing);
        LinkReport { mac, matched, link, bearing }
    };
    let links = links.into_iter().zip(found).map(report).collect();
    let log = |log: LogReader<'_>| log.front.log;
    Ok(CaptureReport { receiver: log(rx), transmitters: txs.into_iter().map(log).collect(), links })
}
