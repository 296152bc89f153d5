//! All logs of a capture, read into its links in step.

use super::intake::{FrameHeard, LogReader};
use super::link::Link;
use super::matching::most_frequent;
use super::options::Options;
use crate::exchange::pairing::LinkSide;
use crate::source::Error;
use driver_iface::Mac;
use rayon::prelude::*;

/// Reads all logs to their ends, always the one that is behind in frame number, so that no clock offset between the
/// robots, however large, makes frames wait longer than their own order asks for.
pub(super) fn read(
    rx: &mut LogReader<'_>,
    txs: &mut [LogReader<'_>],
    links: &mut [Option<Link>],
    options: &Options,
) -> Result<(), Error> {
    let receiver =
        txs.iter_mut().map(|tx| Ok(options.rx_mac.or(most_frequent(tx)?))).collect::<Result<Vec<_>, Error>>()?;
    loop {
        let behind = links.iter().zip(txs.iter()).position(|(link, tx)| {
            !tx.is_done() && link.as_ref().is_none_or(|link| rx.is_done() || link.behind() == LinkSide::Transmitter)
        });
        if let Some(k) = behind {
            if let (Some(heard), Some(link)) = (next_from(&mut txs[k], receiver[k])?, &mut links[k]) {
                link.handle(LinkSide::Transmitter, heard, options);
            }
        } else if let Some((mac, heard)) = rx.next_frame()? {
            match links.iter_mut().flatten().find(|link| link.mac == mac) {
                Some(link) => link.handle(LinkSide::Receiver, heard, options),
                None => rx.front.log.unused.other_sender += 1,
            }
        } else if txs.iter().all(LogReader::is_done) {
            break;
        }
    }
    match options.parallel {
        true => links.par_iter_mut().flatten().for_each(|link| link.finish(options)),
        false => links.iter_mut().flatten().for_each(|link| link.finish(options)),
    }
    Ok(())
}

/// The next frame of a transmitter's log that is from the receiver.
fn next_from(tx: &mut LogReader<'_>, receiver: Option<Mac>) -> Result<Option<FrameHeard>, Error> {
    while let Some((mac, heard)) = tx.next_frame()? {
        if receiver.is_none_or(|wanted| wanted == mac) {
            return Ok(Some(heard));
        }
        tx.front.log.unused.other_sender += 1;
    }
    Ok(None)
}
