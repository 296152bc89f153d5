//! Which transmitter wrote which log.

use super::intake::LogReader;
use super::options::Options;
use crate::exchange::assign::{self, Mark, Match, Spread, Unmatched};
use crate::source::Error;
use driver_iface::Mac;
use std::collections::BTreeMap;

/// Frames of each log that are read ahead to find out which transmitter wrote which log.
const READ_AHEAD: usize = 32_768;
/// Senders in the receiver's log that are tried for each transmitter's log.
const MAX_TRANSMITTERS: usize = 64;

/// The sender of most of the frames that wait: a transmitter's log may hold overheard frames of others, but the
/// receiver sounds it in every round.
pub(super) fn most_frequent(log: &mut LogReader<'_>) -> Result<Option<Mac>, Error> {
    let mut counts: BTreeMap<Mac, usize> = BTreeMap::new();
    for (mac, _) in log.read_ahead(READ_AHEAD)? {
        *counts.entry(*mac).or_default() += 1;
    }
    Ok(counts.into_iter().max_by_key(|(_, count)| *count).map(|(mac, _)| mac))
}

/// The MAC of a log's transmitter and how it was found, or why it was not.
pub(super) type MacFound = Result<(Mac, Option<Match>), Unmatched>;

/// Which MAC in the receiver's log each transmitter's log belongs to.
pub(super) fn find_macs(
    rx: &mut LogReader<'_>,
    txs: &mut [LogReader<'_>],
    options: &Options,
) -> Result<Vec<MacFound>, Error> {
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
