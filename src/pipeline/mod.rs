//! The whole machine: logs and a trajectory in, bearings out. The one place where sources, state machines and the
//! estimator meet.

pub mod accurate;
pub mod answer;
pub mod explain;
pub mod intake;
pub mod link;

use crate::bartlett::SearchOptions;
use crate::exchange::assign::{self, Mark, Match, Spread, Unmatched};
use crate::exchange::pairing::Side;
use crate::motion::pose::Trajectory;
use crate::signal::channel::Channel;
use crate::source::survey::Survey;
use crate::source::{CsiSource, Error};
use driver_iface::{Mac, bfee::Antenna};
use intake::{Log, Unused};
use link::{Bearing, Link, LinkError};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Frames of each log that are read ahead to find out which transmitter wrote which log.
const READ_AHEAD: usize = 32_768;
/// Pairs this long before and after the trajectory are kept, seconds; others are counted and forgotten, so that a log
/// of hours costs no memory.
const SETTLE_S: f64 = 30.0;
/// Senders in the receiver's log that are tried for each transmitter's log.
const MAX_TRANSMITTERS: usize = 64;

/// How pairs find their place on the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JoinBy {
    /// By the receiver's host time.
    #[default]
    Time,
    /// The n-th frame of the link in the receiver's log belongs to the n-th pose.
    Row,
}

/// How bearings are to be made.
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
    /// Added to the receiver's host time to get the trajectory's, seconds.
    pub clock_offset_s: f64,
    /// How pairs are joined with the trajectory.
    pub join: JoinBy,
    /// Only pairs from here on, seconds after the link's first pair.
    pub from_s: Option<f64>,
    /// Only pairs up to here, seconds after the link's first pair.
    pub to_s: Option<f64>,
    /// Whether turn-around compensation may be applied.
    pub compensate: bool,
    /// Whether links are estimated on all cores of the current rayon pool, or one after the other.
    pub parallel: bool,
    /// Whether the course of the phase is kept for pictures.
    pub keep_course: bool,
    /// What is done beyond a plane wave.
    pub accuracy: accurate::Accuracy,
    /// How the bearing is searched for.
    pub search: SearchOptions,
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
            clock_offset_s: 0.0,
            join: JoinBy::Time,
            from_s: None,
            to_s: None,
            compensate: true,
            accuracy: accurate::Accuracy::default(),
            parallel: false,
            keep_course: false,
            search: SearchOptions::default(),
        }
    }

    /// The receiver's host time, microseconds, in which pairs are of use: the trajectory's and some seconds about it, in
    /// which the robot stands and the phase settles.
    fn span_us(&self, trajectory: &Trajectory) -> Option<(i64, i64)> {
        let (start_s, end_s) = trajectory.span_s();
        let us = |t_s: f64| ((t_s - self.clock_offset_s) * 1e6) as i64;
        let margin_us = (SETTLE_S * 1e6) as i64;
        let span = (us(start_s).saturating_sub(margin_us), us(end_s).saturating_add(margin_us));
        (self.join == JoinBy::Time).then_some(span)
    }

    fn keeps(&self, since_first_s: f64) -> bool {
        self.from_s.is_none_or(|from| since_first_s >= from) && self.to_s.is_none_or(|to| since_first_s <= to)
    }
}

/// One transmitter: its log and, if it moved too, its trajectory on the receiver's clock.
pub struct Transmitter<'a> {
    /// Its log.
    pub log: &'a mut dyn CsiSource,
    /// Its displacement, if it moved.
    pub trajectory: Option<&'a Trajectory>,
}

/// What was counted in one log.
#[derive(Debug)]
pub struct LogReport {
    /// What is in it.
    pub survey: Survey,
    /// What the pipeline could not use.
    pub unused: Unused,
}

/// What became of one transmitter's log.
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

impl LinkReport {
    fn new(link: Option<Link>, found: Found, own: &Trajectory, path: Option<&Trajectory>, options: &Options) -> Self {
        let (mac, matched) = found.as_ref().map_or((None, None), |(mac, matched)| (Some(*mac), *matched));
        let bearing = match (&link, found) {
            (Some(link), Ok(_)) => link.bearing(own, path, options),
            (_, Err(error)) => Err(error.into()),
            (None, Ok(_)) => Err(Unmatched::NothingInCommon.into()),
        };
        Self { mac, matched, link, bearing }
    }
}

/// What a run gave.
pub struct Report {
    /// The receiver's log.
    pub receiver: LogReport,
    /// The transmitters' logs.
    pub transmitters: Vec<LogReport>,
    /// One link for each of them.
    pub links: Vec<LinkReport>,
}

/// Makes the bearings of one receiver to its transmitters.
///
/// # Errors
/// If a log cannot be read. A link that fails is reported in its place and does not stop the others.
pub fn bearings(
    receiver: &mut dyn CsiSource,
    transmitters: Vec<Transmitter<'_>>,
    trajectory: &Trajectory,
    options: &Options,
) -> Result<Report, Error> {
    let mut rx = Log::new(receiver, options.antenna);
    let (logs, paths): (Vec<_>, Vec<_>) = transmitters.into_iter().map(|t| (t.log, t.trajectory)).unzip();
    let mut txs: Vec<Log<'_>> = logs.into_iter().map(|log| Log::new(log, options.antenna)).collect();
    let matches = find_macs(&mut rx, &mut txs, options)?;
    let mac = |m: &Found| m.as_ref().ok().map(|found| found.0);
    let span_us = options.span_us(trajectory);
    let mut links: Vec<Option<Link>> = matches.iter().map(|m| mac(m).map(|mac| Link::new(mac, span_us))).collect();
    read(&mut rx, &mut txs, &mut links, options)?;
    let report = |log: Log<'_>| LogReport { survey: log.front.survey, unused: log.front.unused };
    let finish = |((link, found), path)| LinkReport::new(link, found, trajectory, path, options);
    let jobs: Vec<_> = links.into_iter().zip(matches).zip(paths).collect();
    let mut links: Vec<LinkReport> = match options.parallel {
        true => jobs.into_par_iter().map(finish).collect(),
        false => jobs.into_iter().map(finish).collect(),
    };
    let mut made: Vec<_> = links.iter_mut().filter_map(|link| link.bearing.as_mut().ok()).collect();
    accurate::finish(&mut made, options);
    Ok(Report { receiver: report(rx), transmitters: txs.into_iter().map(report).collect(), links })
}

/// Reads all logs to their ends, always the one that is behind in frame number, so that no clock offset between the
/// robots, however large, makes frames wait longer than their own order asks for.
fn read(rx: &mut Log<'_>, txs: &mut [Log<'_>], links: &mut [Option<Link>], options: &Options) -> Result<(), Error> {
    let receiver =
        txs.iter_mut().map(|tx| Ok(options.rx_mac.or(most_frequent(tx)?))).collect::<Result<Vec<_>, Error>>()?;
    loop {
        let behind = links.iter().zip(txs.iter()).position(|(link, tx)| {
            !tx.is_done() && link.as_ref().is_none_or(|link| rx.is_done() || link.behind() == Side::Transmitter)
        });
        if let Some(k) = behind {
            if let (Some(heard), Some(link)) = (next_from(&mut txs[k], receiver[k])?, &mut links[k]) {
                link.handle(Side::Transmitter, heard, options);
            }
        } else if let Some((mac, heard)) = rx.next_frame()? {
            match links.iter_mut().flatten().find(|link| link.mac == mac) {
                Some(link) => link.handle(Side::Receiver, heard, options),
                None => rx.front.unused.other_sender += 1,
            }
        } else if txs.iter().all(Log::is_done) {
            break;
        }
    }
    links.iter_mut().flatten().for_each(|link| link.finish(options));
    Ok(())
}

/// The next frame of a transmitter's log that is from the receiver.
fn next_from(tx: &mut Log<'_>, receiver: Option<Mac>) -> Result<Option<intake::Heard>, Error> {
    while let Some((mac, heard)) = tx.next_frame()? {
        if receiver.is_none_or(|wanted| wanted == mac) {
            return Ok(Some(heard));
        }
        tx.front.unused.other_sender += 1;
    }
    Ok(None)
}

/// The sender of most of the frames that wait: a transmitter's log may hold overheard frames of others, but the
/// receiver sounds it in every round.
fn most_frequent(log: &mut Log<'_>) -> Result<Option<Mac>, Error> {
    let mut counts: BTreeMap<Mac, usize> = BTreeMap::new();
    for (mac, _) in log.read_ahead(READ_AHEAD)? {
        *counts.entry(*mac).or_default() += 1;
    }
    Ok(counts.into_iter().max_by_key(|(_, count)| *count).map(|(mac, _)| mac))
}

type Found = Result<(Mac, Option<Match>), Unmatched>;

/// Which MAC in the receiver's log each transmitter's log belongs to.
fn find_macs(rx: &mut Log<'_>, txs: &mut [Log<'_>], options: &Options) -> Result<Vec<Found>, Error> {
    let mut by_mac: BTreeMap<Mac, Vec<Mark>> = BTreeMap::new();
    for (mac, heard) in rx.read_ahead(READ_AHEAD)? {
        by_mac.entry(*mac).or_default().push((heard.number, heard.timestamp_low));
    }
    // Foreign frames bring MACs of their own; only those with enough frames can be a transmitter, the busiest first.
    let mut busiest: Vec<(Mac, Vec<Mark>)> =
        by_mac.into_iter().filter(|(_, marks)| marks.len() >= assign::MIN_COMMON).collect();
    busiest.sort_by_key(|(_, marks)| std::cmp::Reverse(marks.len()));
    busiest.truncate(MAX_TRANSMITTERS);
    let macs: Vec<Mac> = busiest.iter().map(|(mac, _)| *mac).collect();
    let taken: Vec<bool> = macs.iter().map(|mac| options.tx_macs.contains(mac)).collect();
    let mut spreads: Vec<Vec<Option<Spread>>> = Vec::new();
    for (k, tx) in txs.iter_mut().enumerate() {
        let receiver = options.rx_mac.or(most_frequent(tx)?);
        let wanted = |mac: &Mac| receiver == Some(*mac);
        let marks = tx.read_ahead(READ_AHEAD)?.iter().filter(|(mac, _)| wanted(mac));
        let marks: Vec<Mark> = marks.map(|(_, heard)| (heard.number, heard.timestamp_low)).collect();
        let named = options.tx_macs.get(k).is_some();
        let row = busiest.iter().map(|(_, receiver)| if named { None } else { assign::spread(receiver, &marks) });
        spreads.push(row.collect());
    }
    let found = assign::assign(&spreads, &taken);
    let settle = |(k, found): (usize, Result<Match, Unmatched>)| match options.tx_macs.get(k) {
        Some(mac) => Ok((*mac, None)),
        None => found.map(|found| (macs[found.mac], Some(found))),
    };
    Ok(found.into_iter().enumerate().map(settle).collect())
}
