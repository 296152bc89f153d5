//! Two logs of one run, played together: finds the start of the peer's, if one robot was started long before the other.

use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span, Unwrap32};
use driver_iface::Mac;
use driver_iface::bfee::Bfee;
use driver_iface::record::code;
use std::collections::HashMap;

/// Frames at the start of a log that are searched for a common one.
const FRAMES: usize = 4_096;
/// Records and time by which logs may be apart without being moved, because records wait for their partners.
const RECORDS: usize = 1_024;
const APART: Span = Span::from_ms(5_000);

/// The start of the peer's log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Begin {
    /// Its skipped records, from before this robot's log.
    pub skip: usize,
    /// Its start after this robot's log.
    pub after: Span,
}

/// A frame of one sender in a log.
struct Frame {
    number: u32,
    /// Records and losses before it, ...
    before: usize,
    /// ... and the card's time since the first.
    since: Span,
}

/// The frames of `sender` in a log, one by one.
fn frames(mut log: impl CsiSource, sender: Mac) -> impl Iterator<Item = Result<Frame, Error>> {
    let (mut survey, mut clock, mut first, mut before, mut ended) =
        (Survey::default(), Unwrap32::default(), None, 0, false);
    std::iter::from_fn(move || {
        while !ended {
            let next = match log.receive(Instant::ZERO) {
                Ok(next) => next,
                Err(error) => {
                    ended = true;
                    return Some(Err(error));
                }
            };
            ended = matches!(next, Next::End(_));
            before += 1;
            if let Next::Record(_, record) = &next
                && record.code == code::BFEE
                && let Ok(bfee) = Bfee::new_checked(record.body)
            {
                let now_us = clock.next(bfee.timestamp_low());
                let since = Span::from_us(now_us - *first.get_or_insert(now_us));
                let identity = survey.note(&next).map(|(_, identity)| identity);
                let of_sender = identity.filter(|identity| identity.mac == sender);
                if let Some(number) = of_sender.and_then(|identity| identity.frame_count) {
                    return Some(Ok(Frame { number, before: before - 1, since }));
                }
            } else {
                survey.note(&next);
            }
        }
        None
    })
}

/// The start of the peer's log at which the two meet, by their first common frame number. `own` and `peer` open the
/// logs; the sender in each is the other robot.
///
/// # Errors
/// If a log cannot be read.
pub fn begin<S: CsiSource>(
    own: impl Fn() -> Result<S, Error>,
    peer: impl Fn() -> Result<S, Error>,
    (own_mac, peer_mac): (Mac, Mac),
) -> Result<Begin, Error> {
    let common = match first_common(frames(own()?, peer_mac), frames(peer()?, own_mac))? {
        Some((own, peer)) => Some((own, peer)),
        None => first_common(frames(peer()?, own_mac), frames(own()?, peer_mac))?.map(|(peer, own)| (own, peer)),
    };
    let Some((own, peer)) = common else { return Ok(Begin::default()) };
    if peer.since > own.since + APART && peer.before > RECORDS {
        // A stock record comes after its MPDU.
        return Ok(Begin { skip: peer.before - 1, after: own.since });
    }
    let after = own.since - peer.since;
    Ok(Begin { skip: 0, after: if after > APART { after } else { Span::default() } })
}

/// The first common frame number, in both logs.
fn first_common(
    one: impl Iterator<Item = Result<Frame, Error>>,
    other: impl Iterator<Item = Result<Frame, Error>>,
) -> Result<Option<(Frame, Frame)>, Error> {
    let mut first = HashMap::new();
    for frame in one.take(FRAMES) {
        let frame = frame?;
        first.entry(frame.number).or_insert(frame);
    }
    for frame in other {
        let frame = frame?;
        if let Some(partner) = first.remove(&frame.number) {
            return Ok(Some((partner, frame)));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::source::replay::Replay;
    use driver_iface::bfee::{Iq, Repr, Wsr};
    use driver_iface::record::Record;

    #[test]
    fn logs_meet_at_their_first_common_frame() {
        let (own_mac, peer_mac) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
        let begin = |own: std::ops::Range<u32>, peer: std::ops::Range<u32>| {
            let (own, peer) = (log(own, peer_mac, 5), log(peer, own_mac, 4_000_000_000));
            let open = |bytes: &'static [u8]| move || Ok(Replay::new(bytes, "test".into()));
            super::begin(open(own.leak()), open(peer.leak()), (own_mac, peer_mac)).unwrap()
        };
        // At 100 frames a second: the peer was started a hundred seconds before, about together, or after.
        let early = begin(10_000..11_000, 0..11_000);
        assert_eq!(early, Begin { skip: 9_999, after: Span::default() });
        assert_eq!(begin(100..1_000, 0..1_000), Begin::default());
        assert_eq!(begin(0..11_000, 10_000..11_000), Begin { skip: 0, after: Span::from_ms(100_000) });
        assert_eq!(begin(0..100, 200..300), Begin::default());
    }

    /// WSR records of `sender`, 10 ms apart.
    fn log(numbers: std::ops::Range<u32>, sender: Mac, from_us: u32) -> Vec<u8> {
        let mut log = Vec::new();
        for number in numbers {
            let wsr = Some(Wsr { tv_sec: 0, tv_usec: 0, mac: sender, frame_count: Some(number) });
            let timestamp_low = from_us.wrapping_add(number * 10_000);
            let repr = Repr { timestamp_low, n_rx: 1, antenna_sel: 0, wsr, ..Repr::default() };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&[Iq { i: 1, q: 1 }; 30], &mut body).unwrap();
            let record = Record { code: code::BFEE, body: &body };
            let from = log.len();
            log.resize(from + record.emit_len(), 0);
            record.emit(&mut log[from..]).unwrap();
        }
        log
    }
}
