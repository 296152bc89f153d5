//! The logs of a capture: the transmitter of each, and all of them read into links.

use super::intake::{FrameHeard, LogReader};
use super::link::Link;
use super::options::Options;
use super::unnumbered::by_sender;
use crate::exchange::assign::{self, MIN_COMMON, Mark, Match, Reciprocity, Spread, Unmatched};
use crate::exchange::pairing::LinkSide;
use crate::source::Error;
use driver_iface::Mac;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Frames of each log that are read ahead to find its transmitter.
pub(super) const READ_AHEAD: usize = 32_768;
/// Senders in the receiver's log that are tried for each transmitter's log.
const MAX_TRANSMITTERS: usize = 64;

/// Reads the first frames of all logs, side by side where threads are free.
pub(super) fn read_ahead(rx: &mut LogReader<'_>, txs: &mut [LogReader<'_>], options: &Options) -> Result<(), Error> {
    let mut own = || rx.read_ahead(READ_AHEAD).map(|_| ());
    let ahead = |tx: &mut LogReader<'_>| tx.read_ahead(READ_AHEAD).map(|_| ());
    if !options.parallel {
        own()?;
        return txs.iter_mut().try_for_each(ahead);
    }
    let (own, others) = rayon::join(own, || txs.par_iter_mut().map(ahead).collect::<Vec<Result<(), Error>>>());
    own?;
    others.into_iter().collect()
}

/// The receiver in each transmitter's log, unless it is named: the sender of most waiting frames. The log may contain
/// overheard frames of others, but the receiver sounds the transmitter in every round.
pub(super) fn receivers(txs: &[LogReader<'_>], options: &Options) -> Vec<Option<Mac>> {
    let most_frequent = |log: &LogReader<'_>| {
        let sent = by_sender(log.ahead()).into_iter();
        sent.max_by_key(|(_, frames)| frames.len()).map(|(mac, _)| mac)
    };
    txs.iter().map(|log| options.rx_mac.or_else(|| most_frequent(log))).collect()
}

/// The frames of one sender that wait in a log.
struct Waiting {
    frames: Vec<FrameHeard>,
    marks: Vec<Mark>,
}

impl Waiting {
    fn of(frames: Vec<FrameHeard>) -> Self {
        Self { marks: frames.iter().map(|heard| (heard.number, heard.timestamp_low)).collect(), frames }
    }
}

/// The MAC of a log's transmitter and how it was found, or why it was not.
pub(super) type MacFound = Result<(Mac, Option<Match>), Unmatched>;

/// Which MAC in the receiver's log each transmitter's log belongs to; `receivers` as [`receivers`] gives them.
pub(super) fn find_macs(
    rx: &LogReader<'_>,
    txs: &[LogReader<'_>],
    receivers: &[Option<Mac>],
    options: &Options,
) -> Vec<MacFound> {
    // Foreign frames have other MACs; only those with enough frames can be a transmitter, the busiest first.
    let mut busiest: Vec<(Mac, Vec<FrameHeard>)> = by_sender(rx.ahead()).into_iter().collect();
    busiest.retain(|(_, frames)| frames.len() >= MIN_COMMON);
    busiest.sort_by_key(|(_, frames)| std::cmp::Reverse(frames.len()));
    busiest.truncate(MAX_TRANSMITTERS);
    let (macs, frames): (Vec<Mac>, Vec<Vec<FrameHeard>>) = busiest.into_iter().unzip();
    let senders: Vec<Waiting> = frames.into_iter().map(Waiting::of).collect();
    let taken: Vec<bool> = macs.iter().map(|mac| options.tx_macs.contains(mac)).collect();
    let of_receiver = |(tx, receiver): (&LogReader<'_>, &Option<Mac>)| {
        let own = tx.ahead().iter().filter(|(mac, _)| *receiver == Some(*mac));
        Waiting::of(own.map(|(_, heard)| *heard).collect())
    };
    let logs: Vec<Waiting> = txs.iter().zip(receivers).map(of_receiver).collect();
    let spreads = spreads(&senders, &logs, options);
    let mut found = assign::assign(&spreads, &taken);
    if found.iter().any(assign::is_open) {
        let correlations = correlations(&senders, &logs, &spreads, &found);
        assign::settle(&mut found, &spreads, &correlations, &taken);
    }
    let settle = |(k, found): (usize, Result<Match, Unmatched>)| match options.tx_macs.get(k) {
        Some(mac) => Ok((*mac, None)),
        None => found.map(|found| (macs[found.mac], Some(found))),
    };
    let mut settled: Vec<MacFound> = found.into_iter().enumerate().map(settle).collect();
    for (tx, found) in txs.iter().zip(&mut settled) {
        if let Some(why) = tx.refused {
            *found = Err(Unmatched::Clocks(why));
        }
    }
    for (receiver, found) in receivers.iter().zip(&mut settled) {
        // Stock records carry no address: all zeros mean unknown.
        if let Ok((mac, _)) = found
            && *mac != Mac([0; 6])
            && *receiver == Some(*mac)
        {
            *found = Err(Unmatched::SameSender { mac: *mac });
        }
    }
    settled
}

/// How well each of `logs` matches each sender, unless the log's sender is named.
fn spreads(senders: &[Waiting], logs: &[Waiting], options: &Options) -> Vec<Vec<Option<Spread>>> {
    let each: Vec<(usize, usize)> = (0..logs.len()).flat_map(|k| (0..senders.len()).map(move |s| (k, s))).collect();
    let own = |&(k, s): &(usize, usize)| {
        let is_open = options.tx_macs.get(k).is_none();
        is_open.then(|| assign::spread(&senders[s].marks, &logs[k].marks)).flatten()
    };
    let all: Vec<Option<Spread>> = match options.parallel {
        true => each.par_iter().map(own).collect(),
        false => each.iter().map(own).collect(),
    };
    (0..logs.len()).map(|k| all[k * senders.len()..][..senders.len()].to_vec()).collect()
}

/// Correlation of the channel's changes in the two directions, for each unclear log and each sender.
fn correlations(
    senders: &[Waiting],
    logs: &[Waiting],
    spreads: &[Vec<Option<Spread>>],
    found: &[Result<Match, Unmatched>],
) -> Vec<Vec<Option<f64>>> {
    let of = |own: &Waiting, (sent, spread): (&Waiting, &Option<Spread>)| {
        let mut sums = Reciprocity::default();
        let pairs = if spread.is_some() { assign::common(&sent.marks, &own.marks) } else { Vec::new() };
        for pair in pairs {
            sums.add(&own.frames[pair.transmitter].csi(), &sent.frames[pair.receiver].csi());
        }
        sums.get().map(|both| both.correlation)
    };
    let row = |(k, own): (usize, &Waiting)| match assign::is_open(&found[k]) {
        true => senders.iter().zip(&spreads[k]).map(|sender| of(own, sender)).collect(),
        false => Vec::new(),
    };
    logs.iter().enumerate().map(row).collect()
}

/// Frames of the receiver's log with their senders.
type Piece = VecDeque<(Mac, FrameHeard)>;

/// A link with its sources.
struct Feed<'a, 's> {
    link: &'a mut Option<Link>,
    /// The sender of the link's frames in the receiver's log; none if another link has it.
    mac: Option<Mac>,
    tx: &'a mut LogReader<'s>,
    /// The sender of the link's frames in the transmitter's log; none for all of them.
    receiver: Option<Mac>,
}

/// Reads all logs to their ends, for each link always the one that is behind in frame number, so that clock offsets
/// between the robots do not make frames wait longer. The receiver's log is read in pieces; links take their frames of
/// each piece in parallel.
pub(super) fn read(
    rx: &mut LogReader<'_>,
    txs: &mut [LogReader<'_>],
    receivers: &[Option<Mac>],
    links: &mut [Option<Link>],
    options: &Options,
) -> Result<(), Error> {
    let macs: Vec<Option<Mac>> = links.iter().map(|link| link.as_ref().map(|link| link.mac)).collect();
    // Of two links with one sender the first gets its frames.
    let mac = |k: usize| macs[k].filter(|mac| !macs[..k].contains(&Some(*mac)));
    let feed = |(k, ((link, tx), receiver))| Feed { link, mac: mac(k), tx, receiver };
    let each = links.iter_mut().zip(txs).zip(receivers.iter().copied()).enumerate();
    let mut feeds: Vec<Feed<'_, '_>> = each.map(feed).collect();
    loop {
        let piece = rx.take_ahead(READ_AHEAD)?;
        let is_last = rx.is_done();
        let of_others = piece.iter().filter(|(mac, _)| !macs.contains(&Some(*mac))).count();
        rx.front.log.unused.other_sender += of_others as u64;
        let take = |feed: &mut Feed<'_, '_>| feed.take(&piece, is_last, options);
        let taken: Vec<Result<(), Error>> = match options.parallel {
            true => feeds.par_iter_mut().map(take).collect(),
            false => feeds.iter_mut().map(take).collect(),
        };
        taken.into_iter().collect::<Result<(), Error>>()?;
        if is_last {
            return Ok(());
        }
    }
}

impl Feed<'_, '_> {
    /// Takes the link's frames of a piece, and earlier frames of the transmitter's log; after the last piece all of it.
    fn take(&mut self, piece: &Piece, is_last: bool, options: &Options) -> Result<(), Error> {
        let own_mac = self.mac;
        let mut own = piece.iter().filter(|(mac, _)| own_mac == Some(*mac)).map(|(_, heard)| *heard).peekable();
        loop {
            let rest = is_last && own.peek().is_none();
            let from_tx = |link: &Link| rest || link.behind() == LinkSide::Transmitter;
            if !self.tx.is_done() && self.link.as_ref().is_none_or(from_tx) {
                if let (Some(heard), Some(link)) = (self.next_from_tx()?, self.link.as_mut()) {
                    link.handle(LinkSide::Transmitter, heard, options);
                }
            } else if let (Some(heard), Some(link)) = (own.next(), self.link.as_mut()) {
                link.handle(LinkSide::Receiver, heard, options);
            } else {
                break;
            }
        }
        if let Some(link) = self.link.as_mut().filter(|_| is_last) {
            link.finish(options);
        }
        Ok(())
    }

    /// The next frame of the transmitter's log that is from the receiver.
    fn next_from_tx(&mut self) -> Result<Option<FrameHeard>, Error> {
        while let Some((mac, heard)) = self.tx.next_frame()? {
            if self.receiver.is_none_or(|wanted| wanted == mac) {
                return Ok(Some(heard));
            }
            self.tx.front.log.unused.other_sender += 1;
        }
        Ok(None)
    }
}
