//! What the thread that reads found in a block, for the one that sorts: eight bytes a record, as what one thread wrote costs another
//! more to look at than to use.

use super::piece::Span;
use csi5300::source::replay::{Framing, Front};
use csi5300::source::{Loss, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::record::{LENGTH_FIELD, Record, Tail};

/// Bytes of a record before its body.
const HEAD: u64 = LENGTH_FIELD as u64 + 1;

/// A thing that was found.
#[derive(Clone, Copy, Debug)]
struct Place {
    from: u32,
    len: u16,
    code: u8,
    /// A record without a host time; the next of the others, if it is not.
    is_plain: bool,
}

#[derive(Clone, Debug)]
enum Other {
    Record { host_us: Option<i64>, offset: u64, code: u8, span: Span },
    Lost(Loss),
    End(Tail),
}

/// What was found in a block, in its order.
#[derive(Debug)]
pub(super) struct Found {
    places: Vec<Place>,
    others: Vec<Other>,
    /// Where the block's first byte is in the log; wraps.
    start: u64,
}

impl Found {
    /// What is in `bytes` from byte `from` on; `is_last` says that the log ends there. With room for `most` at once; and the first
    /// byte that was not used, where a record begins.
    pub fn new(bytes: &[u8], from: usize, framing: &mut Framing, is_last: bool, most: usize) -> (Self, usize) {
        let mut found = Self { places: Vec::with_capacity(most), others: Vec::new(), start: 0 };
        let mut at = from;
        loop {
            match framing.step(bytes.get(at..).unwrap_or_default(), is_last) {
                Front::Record { used, body, code, offset, host_us } => {
                    if found.places.is_empty() {
                        found.start = offset.wrapping_sub(at as u64);
                    }
                    at += used;
                    let span = Span { from: (at - body) as u32, len: body as u32 };
                    found.record(span, code, offset, host_us);
                }
                Front::Lost { used, loss } => {
                    at += used;
                    found.other(Other::Lost(loss));
                }
                Front::Short => return (found, at),
                Front::End(tail) => {
                    found.other(Other::End(tail));
                    return (found, at);
                }
            }
        }
    }

    fn record(&mut self, span: Span, code: u8, offset: u64, host_us: Option<i64>) {
        match u16::try_from(span.len) {
            Ok(len) if host_us.is_none() && self.offset(span.from) == offset => {
                self.places.push(Place { from: span.from, len, code, is_plain: true });
            }
            _ => self.other(Other::Record { host_us, offset, code, span }),
        }
    }

    fn other(&mut self, other: Other) {
        self.places.push(Place { from: 0, len: 0, code: 0, is_plain: false });
        self.others.push(other);
    }

    /// Where the record is in the log whose body begins at byte `from` of the block.
    fn offset(&self, from: u32) -> u64 {
        self.start.wrapping_add(u64::from(from)).wrapping_sub(HEAD)
    }

    /// How many things.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Gives all, received at `now`, with their places in the block's `bytes`; whether the log ends there.
    pub fn each(self, bytes: &[u8], now: Instant, mut take: impl FnMut(&Next<'_>, Span)) -> bool {
        let mut ended = false;
        let record = |host_us, offset, code, span: Span| {
            let stamps = Stamps { at: now, host_us, origin: Origin::File { offset } };
            Next::Record(stamps, Record { code, body: span.of(bytes) })
        };
        let mut others = self.others.iter();
        for place in &self.places {
            if place.is_plain {
                let span = Span { from: place.from, len: place.len.into() };
                take(&record(None, self.offset(place.from), place.code, span), span);
                continue;
            }
            match others.next() {
                Some(Other::Record { host_us, offset, code, span }) => {
                    take(&record(*host_us, *offset, *code, *span), *span);
                }
                Some(Other::Lost(loss)) => take(&Next::Lost(loss.clone()), Span::default()),
                Some(Other::End(tail)) => {
                    ended = true;
                    take(&Next::End(*tail), Span::default());
                }
                None => {}
            }
        }
        ended
    }
}
