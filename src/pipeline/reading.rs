//! All logs of a capture, read into its links.

use super::intake::{FrameHeard, LogReader};
use super::link::Link;
use super::matching::READ_AHEAD;
use super::options::Options;
use crate::exchange::pairing::LinkSide;
use crate::source::Error;
use driver_iface::Mac;
use rayon::prelude::*;
use std::collections::VecDeque;

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
