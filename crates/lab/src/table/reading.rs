//! Reads a log into memory: filters, columns, packed records. Whole logs are read on two threads: one reads bytes and finds
//! records, the other sorts them. Records stay where they were read.

use super::memory::{Arena, BLOCK, Block, Span};
use super::{Columns, antennas};
use csi5300::source::replay::{Bytes, Framing, Front, Replay};
use csi5300::source::survey::{Fields, Identity, Survey, Tally};
use csi5300::source::{CsiSource, Error, Loss, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Antennas, Bfee};
use driver_iface::record::{LENGTH_FIELD, LOOKAHEAD, Record, Tail, code};
use fearless_simd::{Level, dispatch};
use std::collections::BTreeSet;
use std::io::Read;
use std::sync::mpsc::{channel, sync_channel};

/// Records that [`Reading::burst`] reads at most.
const BURST: usize = 32_768;

/// Which records are kept.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    macs: Option<BTreeSet<Mac>>,
    from_us: Option<i64>,
    to_us: Option<i64>,
    /// The requested antennas.
    pub antennas: Option<Vec<Antenna>>,
}

impl Filter {
    /// With only the senders named.
    ///
    /// # Errors
    /// Which text is no address, and why.
    pub fn with_macs<T: AsRef<str>>(mut self, macs: impl IntoIterator<Item = T>) -> Result<Self, String> {
        let parse = |text: T| {
            let text = text.as_ref();
            text.parse::<Mac>().map_err(|error| format!("{text:?} is not a sender address: {error}"))
        };
        self.macs = Some(macs.into_iter().map(parse).collect::<Result<_, _>>()?);
        Ok(self)
    }

    /// With only records from `from_s` on and before `to_s`, seconds after the first bfee record of the log.
    ///
    /// # Errors
    /// If the stretch is empty or not a number, in words.
    pub fn with_time(mut self, from_s: Option<f64>, to_s: Option<f64>) -> Result<Self, String> {
        let (from, to) = (from_s.unwrap_or(f64::NEG_INFINITY), to_s.unwrap_or(f64::INFINITY));
        if from.is_nan() || to.is_nan() || from >= to {
            return Err(format!("from {from} to {to} seconds after the first record is not a stretch of time"));
        }
        let us = |s: f64| (s * 1e6).round() as i64;
        (self.from_us, self.to_us) = (from_s.map(us), to_s.map(us));
        Ok(self)
    }

    /// With only records that used one of the named antennas (`A`, `BC`).
    ///
    /// # Errors
    /// If the text does not name antennas, in words.
    pub fn with_antennas(mut self, letters: &str) -> Result<Self, String> {
        let none = || format!("{letters:?} names no antennas: letters of A, B and C, such as A or AC");
        self.antennas = Some(antennas(letters).ok_or_else(none)?);
        Ok(self)
    }

    /// Whether a record with these antennas, if known, is kept; `since_us` is its time after the log's first bfee record by the card's
    /// clock, microseconds.
    #[inline]
    fn keeps(&self, used: Option<Antennas>, identity: Identity, since_us: i64) -> bool {
        let is_used = |antenna: &Antenna| used.is_some_and(|used| used.chain_of(*antenna).is_some());
        self.macs.as_ref().is_none_or(|macs| macs.contains(&identity.mac))
            && self.from_us.is_none_or(|from| since_us >= from)
            && self.to_us.is_none_or(|to| since_us < to)
            && self.antennas.as_ref().is_none_or(|wanted| wanted.iter().any(is_used))
    }
}

/// A log that is being read into memory.
pub struct Reading<S> {
    /// The source.
    pub source: S,
    /// What was read.
    pub table: Table,
    ended: bool,
}

/// Where records are stored.
#[derive(Default)]
pub struct Table {
    filter: Filter,
    /// Counters so far.
    pub survey: Survey,
    /// Records kept since the last [`Reading::take`].
    pub arena: Arena,
    /// Their columns.
    pub columns: Columns,
    /// Intact records that the filter skipped.
    pub left_out: u64,
    /// For each loss and each impossible record, the number of intact bfee records before it.
    pub damaged_after: Vec<u64>,
    /// The card's clock at the log's first bfee record, kept or not, microseconds from the origin of [`Columns::time_us`].
    pub first_us: Option<i64>,
    bodies: bool,
}

impl<S: CsiSource> Reading<S> {
    /// Nothing read yet.
    #[must_use]
    pub fn new(source: S, filter: Filter) -> Self {
        let table = Table { filter, bodies: true, ..Table::default() };
        Self { source, table, ended: false }
    }

    /// Columns only: the arena stays empty. For a log that is read again.
    #[must_use]
    pub fn without_bodies(mut self) -> Self {
        self.table.bodies = false;
        self
    }

    /// True once all was read.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// The records kept since the last call.
    pub fn take(&mut self) -> (Arena, Columns) {
        (std::mem::take(&mut self.table.arena), std::mem::take(&mut self.table.columns))
    }

    /// Reads up to `BURST` records, until `limit` are kept, none is available, or the log ends; returns whether more may be
    /// available at once.
    ///
    /// # Errors
    /// If the source cannot be read further.
    pub fn burst(&mut self, now: Instant, limit: usize) -> Result<bool, Error> {
        let mut tally = Tally::default();
        let more = self.burst_in(&mut tally, now, limit);
        self.table.survey.settle(&mut tally);
        more
    }

    fn burst_in(&mut self, tally: &mut Tally, now: Instant, limit: usize) -> Result<bool, Error> {
        for _ in 0..BURST {
            if self.ended || self.table.columns.len() >= limit {
                return Ok(false);
            }
            let next = self.source.receive(now)?;
            if matches!(next, Next::Pending) {
                return Ok(false);
            }
            self.ended = matches!(next, Next::End(_));
            self.table.take(tally, &next);
        }
        Ok(true)
    }
}

impl Table {
    /// Counts an item; returns whether it is a bfee record and whether that is kept. Adds the columns of a kept one.
    fn note(&mut self, tally: &mut Tally, next: &Next<'_>) -> Option<bool> {
        let bad = self.survey.bad_bfee;
        let noted = self.survey.note_in(tally, next);
        if matches!(next, Next::Lost(_)) || self.survey.bad_bfee > bad {
            self.damaged_after.push(self.survey.bfees());
        }
        let (bfee, identity) = noted?;
        let offset = match next {
            Next::Record(stamps, _) => place(*stamps),
            _ => 0,
        };
        Some(self.choose(&Fields::of(&bfee), identity, offset))
    }

    /// Whether a counted bfee record is kept; its columns are then added.
    #[inline(always)]
    fn choose(&mut self, fields: &Fields, identity: Identity, offset: u64) -> bool {
        let time_us = self.survey.clock_us.map_or(0, |(_, last)| last);
        let since_us = time_us - *self.first_us.get_or_insert(time_us);
        let is_kept = self.filter.keeps(fields.antennas, identity, since_us);
        if is_kept {
            self.columns.push(fields, identity, time_us, offset);
        } else {
            self.left_out += 1;
        }
        is_kept
    }

    /// Takes an item of a source; copies the record if it is kept.
    fn take(&mut self, tally: &mut Tally, next: &Next<'_>) {
        let is_kept = self.note(tally, next);
        if !self.bodies {
            return;
        }
        match (next, is_kept) {
            (Next::Record(_, record), Some(true)) => self.arena.push(record.body),
            (Next::Record(_, record), None) if is_of_next(record.code) => self.arena.note_mpdu(record.body),
            (Next::Lost(_), _) | (_, Some(false)) => self.arena.drop_mpdu(),
            _ => {}
        }
    }

    /// Counts a bfee record whose bytes are in a block, by its fields and place.
    #[inline(always)]
    fn sort_bfee(&mut self, sorted: &mut Sorted, stamps: Stamps, fields: &Fields, span: Span) {
        let identity = self.survey.note_fields(&mut sorted.tally, stamps, fields);
        if self.choose(fields, identity, place(stamps)) {
            sorted.keep(span);
            return;
        }
        sorted.mpdu = None;
        if sorted.kept.is_empty() {
            // An MPDU noted before this block belongs to no later record.
            self.arena.drop_mpdu();
        }
    }

    /// Counts an item of a source whose bytes are in a block.
    fn sort(&mut self, sorted: &mut Sorted, next: &Next<'_>, span: Span) {
        let is_kept = self.note(&mut sorted.tally, next);
        match (next, is_kept) {
            (_, Some(true)) => return sorted.keep(span),
            (Next::Record(_, record), None) if is_of_next(record.code) => sorted.mpdu = Some(span),
            (Next::Lost(_), _) | (_, Some(false)) => sorted.mpdu = None,
            (Next::End(_), _) => {}
            _ => return,
        }
        if sorted.kept.is_empty() {
            // An MPDU noted before this block belongs to no later record.
            self.arena.drop_mpdu();
        }
    }

    /// Keeps a block's sorted records: the arena takes over the memory if most of it is kept; otherwise returns the block.
    fn keep(&mut self, sorted: &mut Sorted, block: Block) -> Option<Block> {
        let Sorted { kept, bytes, mpdu, tally } = sorted;
        self.survey.settle(tally);
        let (bytes, mpdu) = (std::mem::take(bytes), mpdu.take());
        if !self.bodies {
            kept.clear();
            return Some(block);
        }
        if 2 * bytes as usize >= block.bytes().len() {
            let rest = mpdu.map(|span| span.of(block.bytes()).to_vec());
            if !kept.is_empty() {
                self.arena.adopt(block, kept.drain(..));
            }
            rest.iter().for_each(|body| self.arena.note_mpdu(body));
            return None;
        }
        let body = |span: Span| span.of(block.bytes());
        for (span, before) in kept.drain(..) {
            before.iter().for_each(|mpdu| self.arena.note_mpdu(body(*mpdu)));
            self.arena.push(body(span));
        }
        mpdu.iter().for_each(|mpdu| self.arena.note_mpdu(body(*mpdu)));
        Some(block)
    }
}

/// True for a record that belongs to the bfee after it: the frame, or the rest of a translated log's clock.
fn is_of_next(code: u8) -> bool {
    matches!(code, code::MPDU | code::CARD_CLOCK)
}

/// Place of a record in its source.
fn place(stamps: Stamps) -> u64 {
    let (Origin::File { offset: place } | Origin::Live { number: place }) = stamps.origin;
    place
}

/// The kept part of a block.
#[derive(Default)]
struct Sorted {
    /// bfee records, each with its MPDU if that is in the block too.
    kept: Vec<(Span, Option<Span>)>,
    /// Bytes of all of them.
    bytes: u32,
    /// The newest MPDU, until a bfee takes it.
    mpdu: Option<Span>,
    /// Counts that are not yet in the survey's maps.
    tally: Tally,
}

impl Sorted {
    /// Keeps a bfee record with the MPDU before it.
    #[inline(always)]
    fn keep(&mut self, span: Span) {
        let mpdu = self.mpdu.take();
        self.bytes += span.len + mpdu.map_or(0, |mpdu| mpdu.len);
        self.kept.push((span, mpdu));
    }
}

/// Pieces that may wait between the reading and the sorting thread.
const AHEAD: usize = 4;

/// Bytes of a read: few enough to stay in the second-level cache while records are found in them.
const STRETCH: usize = 256 << 10;

/// How a log is cut into blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Bytes of the first block: a log that fits into it is read before a thread would start.
    pub first: usize,
    /// Bytes of later blocks on the heap, or `None` for [large](Block::large) ones.
    pub block: Option<usize>,
    /// Room at the start of a block for the incomplete record at the end of the block before, bytes.
    pub head: usize,
}

impl Default for Cut {
    fn default() -> Self {
        const { assert!(LOOKAHEAD < BLOCK) };
        Self { first: 128 << 10, block: None, head: LOOKAHEAD }
    }
}

impl Cut {
    /// A block, in the memory of one that is not needed any more, if there is one.
    fn next(self, spare: Option<Block>) -> Block {
        let new = || self.block.map_or_else(Block::large, Block::fixed);
        let mut block = spare.and_then(Block::emptied).unwrap_or_else(new);
        block.skip(self.head);
        block
    }
}

impl<R: Read + Send> Reading<Replay<R>> {
    /// Reads all of a log, on two threads; records are received at `now`. Stops early once `go_on`, called every
    /// few megabytes, returns false.
    ///
    /// # Errors
    /// If the log cannot be read further. What was read before is kept.
    pub fn read_all(&mut self, now: Instant, go_on: impl FnMut() -> bool) -> Result<(), Error> {
        self.read_cut(now, Cut::default(), go_on)
    }

    /// The same with other block sizes.
    pub(super) fn read_cut(&mut self, now: Instant, cut: Cut, mut go_on: impl FnMut() -> bool) -> Result<(), Error> {
        if self.ended {
            return Ok(());
        }
        let table = &mut self.table;
        let bodies = table.bodies;
        let (bytes, framing) = self.source.halves();
        let mut cutter = Cutter { bytes, framing, left: Vec::new(), most: 0 };
        let mut sorter = Sorter { table, now, sorted: Sorted::default(), ended: false };
        let (first, more) = cutter.next(Block::fixed(cut.first), Found::default(), 0);
        sorter.take(first);
        if more? && go_on() {
            // Blocks that are not kept are small: they are used again and again.
            let block = cut.block.or((!bodies).then_some(STRETCH));
            in_pieces(cutter, Cut { block, ..cut }, |piece| (sorter.take(piece), go_on()))?;
        }
        self.ended = sorter.ended;
        Ok(())
    }
}

/// A block and what was found in it.
struct Piece {
    block: Block,
    found: Found,
}

/// What remains of a piece for reuse: the memory of its finds, and its block if that is not kept.
#[derive(Default)]
struct Spare {
    block: Option<Block>,
    found: Found,
}

/// Cuts a log into pieces on its own thread and passes them on in order; `take` returns the memory for reuse, and whether to
/// continue.
fn in_pieces<R: Read + Send>(
    mut cutter: Cutter<'_, R>,
    cut: Cut,
    mut take: impl FnMut(Piece) -> (Spare, bool),
) -> Result<(), Error> {
    let (sender, pieces) = sync_channel(AHEAD);
    let (back, used) = channel();
    std::thread::scope(|scope| {
        let read = move || {
            loop {
                let Spare { block, found } = used.try_recv().unwrap_or_default();
                let (piece, more) = cutter.next(cut.next(block), found, cut.head);
                let is_last = !matches!(more, Ok(true));
                // The receiver is gone once it has enough.
                if sender.send((piece, more)).is_err() || is_last {
                    return;
                }
            }
        };
        let started = std::thread::Builder::new().name("csi5300-read".into()).spawn_scoped(scope, read);
        started.map_err(|source| Error::Io { what: "cannot start a thread to read the log".into(), source })?;
        for (piece, more) in pieces {
            let (spare, go_on) = take(piece);
            if !more? || !go_on {
                break;
            }
            // After the last piece nobody needs the memory.
            let _ = back.send(spare);
        }
        Ok(())
    })
}

/// Reads a log and finds its records, a block at a time.
struct Cutter<'a, R> {
    bytes: &'a mut Bytes<R>,
    framing: &'a mut Framing,
    /// Unused bytes at the end of the last block.
    left: Vec<u8>,
    /// Most finds in a block so far.
    most: usize,
}

impl<R: Read> Cutter<'_, R> {
    /// The next piece, in `block`, read after `head`, with the memory of `found`; returns whether there may be more.
    fn next(&mut self, mut block: Block, found: Found, head: usize) -> (Piece, Result<bool, Error>) {
        let mut found = found.emptied(self.most);
        // The unused bytes fit before the new ones, except where the room is almost zero.
        let has_room = self.left.len() <= head;
        let stretch = if has_room { STRETCH } else { usize::MAX };
        let mut at = if has_room { block.put_before(head, &self.left) } else { 0 };
        let more = loop {
            let more = self.fill(&mut block, stretch);
            if !has_room {
                at = block.put_before(head, &self.left);
            }
            at = found.find(block.bytes(), at, self.framing, matches!(more, Ok(false)));
            if !has_room || !matches!(more, Ok(true)) || block.room() == 0 {
                break more;
            }
        };
        self.left.clear();
        self.left.extend_from_slice(block.bytes().get(at..).unwrap_or_default());
        self.most = self.most.max(found.len());
        (Piece { block, found }, more)
    }

    /// Reads until a block is full or the log ends; returns whether there may be more.
    fn fill(&mut self, block: &mut Block, bytes: usize) -> Result<bool, Error> {
        let until = block.room().saturating_sub(bytes);
        while block.room() > until {
            let wanted = block.room() - until;
            let read = block.fill(|room| {
                let most = room.len().min(wanted);
                self.bytes.read_into(room.split_at_mut(most).0)
            })?;
            if read == 0 {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// Sorts the finds of a log, a block at a time.
struct Sorter<'a> {
    table: &'a mut Table,
    now: Instant,
    /// Of the current block; its memory is reused.
    sorted: Sorted,
    ended: bool,
}

impl Sorter<'_> {
    /// Takes a piece; returns what is not kept of it.
    fn take(&mut self, Piece { block, found }: Piece) -> Spare {
        let Self { table, sorted, .. } = self;
        self.ended = found.each(block.bytes(), self.now, |thing, span| match thing {
            Thing::Bfee(stamps, fields) => table.sort_bfee(sorted, stamps, fields, span),
            Thing::Other(next) => table.sort(sorted, next, span),
        });
        Spare { block: table.keep(sorted, block), found }
    }
}

// What the reading thread finds in a block for the sorting one: eight bytes per record and a bfee's fields. If these stayed in
// the records themselves, the other thread would spend more time on fetching than on using them.

/// Bytes of a record before its body.
const HEAD: u64 = LENGTH_FIELD as u64 + 1;

/// A find.
#[derive(Clone, Copy, Debug)]
struct Place {
    from: u32,
    len: u16,
    code: u8,
    /// A record without a host time; otherwise the next of the others.
    is_plain: bool,
}

#[derive(Clone, Debug)]
enum Other {
    Record { host_us: Option<i64>, offset: u64, code: u8, span: Span },
    Lost(Loss),
    End(Tail),
}

/// A find, decoded.
enum Thing<'a> {
    /// An intact bfee record.
    Bfee(Stamps, &'a Fields),
    /// Anything else.
    Other(&'a Next<'a>),
}

/// The finds in a block, in order.
#[derive(Debug, Default)]
struct Found {
    places: Vec<Place>,
    /// Fields of the intact bfee records among the plain ones.
    fields: Vec<Fields>,
    others: Vec<Other>,
    /// Offset of the block's first byte in the log; wraps.
    start: u64,
}

impl Found {
    /// Forgets all finds and makes room for `most`; keeps its memory.
    fn emptied(mut self, most: usize) -> Self {
        self.places.clear();
        self.fields.clear();
        self.others.clear();
        self.places.reserve(most);
        self.fields.reserve(most);
        Self { start: 0, ..self }
    }

    /// Adds the records in the block's `bytes` from `at` on; `is_last`: the log ends there. Returns the first unused byte, where a
    /// record starts.
    fn find(&mut self, bytes: &[u8], at: usize, framing: &mut Framing, is_last: bool) -> usize {
        dispatch!(Level::new(), _ => self.find_in(bytes, at, framing, is_last))
    }

    /// [`Self::find`], for the vectors for which it is compiled.
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

    /// Place in the log of the record whose body begins at byte `from` of the block.
    fn offset(&self, from: u32) -> u64 {
        self.start.wrapping_add(u64::from(from)).wrapping_sub(HEAD)
    }

    /// Number of finds.
    fn len(&self) -> usize {
        self.places.len()
    }

    /// Passes on all finds, received at `now`, with their places in the block's `bytes`; returns whether the log ends there.
    fn each(&self, bytes: &[u8], now: Instant, mut take: impl FnMut(Thing<'_>, Span)) -> bool {
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
