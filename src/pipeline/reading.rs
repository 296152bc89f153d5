//! All logs of a capture, read into its links.

use super::intake::{FrameHeard, LogReader};
use super::link::Link;
use super::options::Options;
use crate::exchange::pairing::LinkSide;
use crate::source::Error;
use driver_iface::Mac;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Frames of the receiver's log that are handed out to the links at a time.
const HANDED: usize = 8_192;

/// A link with what it is fed from.
struct Feed<'a, 's> {
    link: &'a mut Option<Link>,
    /// What the receiver heard of the link's transmitter and the link has not taken yet.
    inbox: VecDeque<FrameHeard>,
    tx: &'a mut LogReader<'s>,
    /// The sender of the frames in the transmitter's log that are of use; none for all of them.
    receiver: Option<Mac>,
}

/// Reads all logs to their ends, for each link always the one that is behind in frame number, so that no clock offset between
/// the robots, however large, makes frames wait longer than their own order asks for. The receiver's log is handed out piece by
/// piece; of each piece links take their frames side by side.
pub(super) fn read(
    rx: &mut LogReader<'_>,
    txs: &mut [LogReader<'_>],
    receivers: &[Option<Mac>],
    links: &mut [Option<Link>],
    options: &Options,
) -> Result<(), Error> {
    let feed = |((link, tx), receiver)| Feed { link, inbox: VecDeque::new(), tx, receiver };
    let mut feeds: Vec<Feed<'_, '_>> = links.iter_mut().zip(txs).zip(receivers.iter().copied()).map(feed).collect();
    loop {
        let is_last = hand_out(rx, &mut feeds)?;
        let take = |feed: &mut Feed<'_, '_>| feed.take(is_last, options);
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

/// Hands out the next piece of the receiver's log; true if that was the last.
fn hand_out(rx: &mut LogReader<'_>, feeds: &mut [Feed<'_, '_>]) -> Result<bool, Error> {
    for _ in 0..HANDED {
        let Some((mac, heard)) = rx.next_frame()? else { return Ok(true) };
        match feeds.iter_mut().find(|feed| feed.link.as_ref().is_some_and(|link| link.mac == mac)) {
            Some(feed) => feed.inbox.push_back(heard),
            None => rx.front.log.unused.other_sender += 1,
        }
    }
    Ok(false)
}

impl Feed<'_, '_> {
    /// Takes what was handed out, and of the transmitter's log what goes before it; after the last piece all of it.
    fn take(&mut self, is_last: bool, options: &Options) -> Result<(), Error> {
        loop {
            let from_tx = |link: &Link| link.behind() == LinkSide::Transmitter || self.inbox.is_empty() && is_last;
            if !self.tx.is_done() && self.link.as_ref().is_none_or(from_tx) {
                if let (Some(heard), Some(link)) = (self.next_from_tx()?, self.link.as_mut()) {
                    link.handle(LinkSide::Transmitter, heard, options);
                }
            } else if let (Some(heard), Some(link)) = (self.inbox.pop_front(), self.link.as_mut()) {
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
