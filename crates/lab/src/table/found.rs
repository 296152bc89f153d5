//! What the thread that reads found in a block, for the one that sorts: eight bytes a record and a bfee's fields, one after the other.
//! What is spread over the records themselves costs another thread more to look at than to use.

use super::piece::Span;
use csi5300::source::replay::{Framing, Front};
use csi5300::source::survey::Fields;
use csi5300::source::{Loss, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::bfee::Bfee;
use driver_iface::record::{LENGTH_FIELD, Record, Tail, code};
use fearless_simd::{Level, dispatch};

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

/// One of the things that were found.
pub(super) enum Thing<'a> {
    /// An intact bfee record.
    Bfee(Stamps, &'a Fields),
    /// Anything else.
    Other(&'a Next<'a>),
}

/// What was found in a block, in its order.
#[derive(Debug, Default)]
pub(super) struct Found {
    places: Vec<Place>,
    /// Of the intact bfee records among those that are plain.
    fields: Vec<Fields>,
    others: Vec<Other>,
    /// Where the block's first byte is in the log; wraps.
    start: u64,
}

impl Found {
    /// Forgets all that was found and makes room for `most` things; memory that there is stays.
    pub fn emptied(mut self, most: usize) -> Self {
        self.places.clear();
        self.fields.clear();
        self.others.clear();
        self.places.reserve(most);
        self.fields.reserve(most);
        Self { start: 0, ..self }
    }

    /// Adds what is in `bytes`, the block's, from byte `at` on; `is_last` says that the log ends there. Gives the first byte that was
    /// not used, where a record begins.
    pub fn find(&mut self, bytes: &[u8], at: usize, framing: &mut Framing, is_last: bool) -> usize {
        dispatch!(Level::new(), _ => self.find_in(bytes, at, framing, is_last))
    }

    /// [`Self::find`], in whatever vectors it is compiled for.
    #[inline(always)]
    fn find_in(&mut self, bytes: &[u8], mut at: usize, framing: &mut Framing, is_last: bool) -> usize {
        loop {
            match framing.step(bytes.get(at..).unwrap_or_default(), is_last) {
                Front::Record { used, body, code, offset, host_us } => {
                    if self.places.is_empty() {
                        self.start = offset.wrapping_sub(at as u64);
                    }
                    at += used;
                    let span = Span { from: (at - body) as u32, len: body as u32 };
                    self.record(bytes, span, code, offset, host_us);
                }
                Front::Lost { used, loss } => {
                    at += used;
                    self.other(Other::Lost(loss));
                }
                Front::Short => return at,
                Front::End(tail) => {
                    self.other(Other::End(tail));
                    return at;
                }
            }
        }
    }

    #[inline(always)]
    fn record(&mut self, bytes: &[u8], span: Span, code: u8, offset: u64, host_us: Option<i64>) {
        if let Ok(len) = u16::try_from(span.len)
            && host_us.is_none()
            && self.offset(span.from) == offset
            && (code != code::BFEE || self.bfee(span.of(bytes)))
        {
            self.places.push(Place { from: span.from, len, code, is_plain: true });
            return;
        }
        self.other(Other::Record { host_us, offset, code, span });
    }

    /// Adds the fields of a bfee record, if it is intact.
    #[inline(always)]
    fn bfee(&mut self, body: &[u8]) -> bool {
        let Ok(bfee) = Bfee::new_checked(body) else { return false };
        self.fields.push(Fields::of(&bfee));
        true
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
    pub fn each(&self, bytes: &[u8], now: Instant, mut take: impl FnMut(Thing<'_>, Span)) -> bool {
        let mut ended = false;
        let stamps = |host_us, offset| Stamps { at: now, host_us, origin: Origin::File { offset } };
        let record = |stamps, code, span: Span| Next::Record(stamps, Record { code, body: span.of(bytes) });
        let (mut fields, mut others) = (self.fields.iter(), self.others.iter());
        for place in &self.places {
            if place.is_plain {
                let span = Span { from: place.from, len: place.len.into() };
                let stamps = stamps(None, self.offset(place.from));
                let fields = if place.code == code::BFEE { fields.next() } else { None };
                match fields {
                    Some(fields) => take(Thing::Bfee(stamps, fields), span),
                    None => take(Thing::Other(&record(stamps, place.code, span)), span),
                }
                continue;
            }
            match others.next() {
                Some(Other::Record { host_us, offset, code, span }) => {
                    take(Thing::Other(&record(stamps(*host_us, *offset), *code, *span)), *span);
                }
                Some(Other::Lost(loss)) => take(Thing::Other(&Next::Lost(loss.clone())), Span::default()),
                Some(Other::End(tail)) => {
                    ended = true;
                    take(Thing::Other(&Next::End(*tail)), Span::default());
                }
                None => {}
            }
        }
        ended
    }
}
