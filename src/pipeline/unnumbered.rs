//! Numbers the frames of logs without numbers (WSR's of 2021, csitool's without injected frames) by the cards' clocks.

use super::intake::{FrameHeard, LogReader};
use super::options::Options;
use crate::exchange::pairing::LinkSide;
use crate::exchange::pairing::by_clock::{ByClock, Refusal};
use driver_iface::Mac;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Senders in the receiver's log that are tried for each transmitter's log, the busiest first: a third robot and some strangers.
const MAX_SENDERS: usize = 8;

/// Frames of one log with their senders, in its order.
type Frames = Vec<(Mac, FrameHeard)>;

/// A transmitter's log that matches a sender, by the clocks.
struct Fitting {
    log: usize,
    sender: Mac,
    sharpness: f64,
    /// Places of partners among the frames of the sender and among those of the receiver.
    pairs: Vec<(usize, usize)>,
}

/// Numbers the frames of logs without numbers; frames of one exchange get the same number. A log that matches no sender
/// keeps the reason.
pub(super) fn number(rx: &mut LogReader<'_>, txs: &mut [LogReader<'_>], options: &Options) {
    let heard = rx.take_unnumbered();
    if heard.is_empty() {
        return;
    }
    let sent = by_sender(&heard);
    let logs: Vec<Frames> = txs.iter_mut().map(LogReader::take_unnumbered).collect();
    let logs: Vec<Answered> = logs.iter().map(|frames| Answered::of(frames, options)).collect();
    let tried: Vec<Result<Fitting, (usize, Refusal)>> = try_all(&sent, &logs, options);
    let mut fitting: Vec<Fitting> = Vec::new();
    for tried in tried {
        match tried {
            Ok(one) => fitting.push(one),
            Err((log, why)) => txs[log].refused = Some(why),
        }
    }
    // Frames of a third robot are of the same rounds and match a log too, but less sharply.
    fitting.sort_by(|x, y| y.sharpness.total_cmp(&x.sharpness));
    let (mut taken, mut numbered) = (BTreeSet::new(), BTreeMap::new());
    for Fitting { log, sender, pairs, .. } in fitting {
        if numbered.contains_key(&sender) || !taken.insert(log) {
            continue;
        }
        let (receiver, answered) = (&logs[log].receiver, &logs[log].frames);
        let (of_sender, of_receiver) = numbers((sent[&sender].len(), answered.len()), &pairs);
        let frames =
            answered.iter().zip(of_receiver).map(|(frame, number)| (*receiver, frame.with_number(number, frame.row)));
        txs[log].refused = None;
        txs[log].put_numbered(frames.collect());
        numbered.insert(sender, of_sender);
    }
    rx.put_numbered(
        heard
            .into_iter()
            .scan(BTreeMap::new(), |rows: &mut BTreeMap<Mac, usize>, (mac, frame)| {
                let row = rows.entry(mac).or_default();
                let number = numbered.get(&mac).and_then(|numbers| numbers.get(*row)).copied();
                let row = std::mem::replace(row, *row + 1) as u32;
                Some(number.map(|number| (mac, frame.with_number(number, row))))
            })
            .flatten()
            .collect(),
    );
}

/// Frames by their senders.
pub(super) fn by_sender<'a>(frames: impl IntoIterator<Item = &'a (Mac, FrameHeard)>) -> BTreeMap<Mac, Vec<FrameHeard>> {
    let mut by_sender: BTreeMap<Mac, Vec<FrameHeard>> = BTreeMap::new();
    for (mac, frame) in frames {
        by_sender.entry(*mac).or_default().push(*frame);
    }
    by_sender
}

/// The receiver's frames in a transmitter's log.
struct Answered {
    receiver: Mac,
    frames: Vec<FrameHeard>,
    /// All senders in the log; its own card is not among them.
    senders: BTreeSet<Mac>,
}

impl Answered {
    /// The receiver is the sender of most frames, unless it is named.
    fn of(frames: &Frames, options: &Options) -> Self {
        let mut sent = by_sender(frames);
        let busiest = sent.iter().max_by_key(|(_, frames)| frames.len()).map(|(mac, _)| *mac);
        let receiver = options.rx_mac.or(busiest).unwrap_or_default();
        let senders = sent.keys().copied().collect();
        let frames = sent.remove(&receiver).unwrap_or_default().into_iter().zip(0..);
        Self { receiver, frames: frames.map(|(frame, row)| frame.with_number(0, row)).collect(), senders }
    }

    /// Whether this log may be of `sender`. Where records have no address, all zeros are everybody.
    fn may_be_of(&self, sender: Mac) -> bool {
        sender.is_zero() || !self.senders.contains(&sender)
    }
}

/// Each log beside each sender that it may be of.
fn try_all(
    sent: &BTreeMap<Mac, Vec<FrameHeard>>,
    logs: &[Answered],
    options: &Options,
) -> Vec<Result<Fitting, (usize, Refusal)>> {
    let mut busiest: Vec<(&Mac, &Vec<FrameHeard>)> = sent.iter().collect();
    busiest.sort_by_key(|(_, frames)| std::cmp::Reverse(frames.len()));
    let is_wanted = |log: usize, sender: Mac| match options.tx_macs.get(log) {
        Some(mac) => *mac == sender,
        None => logs[log].may_be_of(sender),
    };
    let of_log = |log: usize| {
        let wanted = busiest.iter().filter(move |(sender, _)| is_wanted(log, **sender)).take(MAX_SENDERS);
        wanted.map(move |(sender, frames)| (log, **sender, *frames))
    };
    let each: Vec<(usize, Mac, &Vec<FrameHeard>)> = (0..logs.len()).flat_map(of_log).collect();
    let one = |&(log, sender, frames): &(usize, Mac, &Vec<FrameHeard>)| match pair(frames, &logs[log].frames) {
        Ok((sharpness, pairs)) => Ok(Fitting { log, sender, sharpness, pairs }),
        Err(why) => Err((log, why)),
    };
    if options.parallel { each.par_iter().map(one).collect() } else { each.iter().map(one).collect() }
}

fn pair(receiver: &[FrameHeard], transmitter: &[FrameHeard]) -> Result<(f64, Vec<(usize, usize)>), Refusal> {
    let mut machine = ByClock::new(32);
    for (side, frames) in [(LinkSide::Receiver, receiver), (LinkSide::Transmitter, transmitter)] {
        for (place, frame) in frames.iter().enumerate() {
            machine.handle(side, frame.timestamp_low.into(), place);
        }
    }
    let sharpness = machine.finish()?;
    let mut pairs: Vec<(usize, usize)> =
        std::iter::from_fn(|| machine.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)).collect();
    pairs.sort_unstable();
    Ok((sharpness, pairs))
}

/// Rising numbers for all frames of both sides, the same for partners.
fn numbers((receiver, transmitter): (usize, usize), pairs: &[(usize, usize)]) -> (Vec<u32>, Vec<u32>) {
    let (mut rx, mut tx, mut number) = (Vec::with_capacity(receiver), Vec::with_capacity(transmitter), 0);
    let up_to = |list: &mut Vec<u32>, len: usize, number: &mut u32| {
        while list.len() < len {
            *number += 1;
            list.push(*number);
        }
    };
    for &(i, j) in pairs {
        // If both clocks were set back, the logs may split in another order: those pairs are skipped.
        if i >= rx.len() && j >= tx.len() {
            up_to(&mut rx, i, &mut number);
            up_to(&mut tx, j, &mut number);
            number += 1;
            rx.push(number);
            tx.push(number);
        }
    }
    up_to(&mut rx, receiver, &mut number);
    up_to(&mut tx, transmitter, &mut number);
    (rx, tx)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partners_have_one_number_and_all_others_one_of_their_own() {
        let (rx, tx) = numbers((4, 5), &[(1, 0), (2, 3)]);
        assert_eq!((rx, tx), (vec![1, 2, 5, 6], vec![2, 3, 4, 5, 7]));
        // A pair that goes back is skipped.
        let (rx, tx) = numbers((2, 2), &[(0, 1), (1, 0)]);
        assert_eq!((rx, tx), (vec![2, 3], vec![1, 2]));
    }
}
