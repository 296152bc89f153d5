//! Reads a log into memory: filters, columns, packed records.

use super::columns::{Advise, Columns, antennas};
use super::memory::{Arena, Block, Span};
use csi5300::source::survey::{Fields, Identity, Survey, Tally};
use csi5300::source::{CsiSource, Error, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::ParseMacError;
use driver_iface::bfee::{Antenna, Antennas, Bfee};
use driver_iface::record::code;
use std::collections::BTreeSet;

/// Records that [`Reading::burst`] reads at most.
const BURST: usize = 32_768;

/// Why a filter is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FilterError {
    /// A text is not an address.
    #[error("{text:?} is not a sender address: {source}")]
    Mac {
        /// The text.
        text: String,
        /// Why.
        source: ParseMacError,
    },
    /// A text does not name antennas.
    #[error("{text:?} names no antennas: letters of A, B and C, such as A or AC")]
    Antennas {
        /// The text.
        text: String,
    },
    /// The stretch of time is empty or not a number.
    #[error("from {from_s} to {to_s} seconds after the first record is not a stretch of time")]
    Time {
        /// Its beginning, seconds.
        from_s: f64,
        /// Its end, seconds.
        to_s: f64,
    },
}

/// Which records are kept.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    macs: Option<BTreeSet<Mac>>,
    from_us: Option<i64>,
    to_us: Option<i64>,
    antennas: Option<Vec<Antenna>>,
}

impl Filter {
    /// With only the senders named.
    ///
    /// # Errors
    /// [`FilterError::Mac`].
    pub fn with_macs<T: AsRef<str>>(mut self, macs: impl IntoIterator<Item = T>) -> Result<Self, FilterError> {
        let parse = |text: T| {
            let text = text.as_ref();
            text.parse::<Mac>().map_err(|source| FilterError::Mac { text: text.to_owned(), source })
        };
        self.macs = Some(macs.into_iter().map(parse).collect::<Result<_, _>>()?);
        Ok(self)
    }

    /// With only records from `from_s` on and before `to_s`, seconds after the first bfee record of the log.
    ///
    /// # Errors
    /// [`FilterError::Time`].
    pub fn with_time(mut self, from_s: Option<f64>, to_s: Option<f64>) -> Result<Self, FilterError> {
        let (from, to) = (from_s.unwrap_or(f64::NEG_INFINITY), to_s.unwrap_or(f64::INFINITY));
        if from.is_nan() || to.is_nan() || from >= to {
            return Err(FilterError::Time { from_s: from, to_s: to });
        }
        let us = |s: f64| (s * 1e6).round() as i64;
        (self.from_us, self.to_us) = (from_s.map(us), to_s.map(us));
        Ok(self)
    }

    /// With only records that used one of the named antennas (`A`, `BC`).
    ///
    /// # Errors
    /// [`FilterError::Antennas`].
    pub fn with_antennas(mut self, letters: &str) -> Result<Self, FilterError> {
        let named = antennas(letters).ok_or_else(|| FilterError::Antennas { text: letters.to_owned() })?;
        self.antennas = Some(named);
        Ok(self)
    }

    /// The requested antennas.
    #[must_use]
    pub fn antennas(&self) -> Option<&[Antenna]> {
        self.antennas.as_deref()
    }

    /// Whether a record is kept; `since_us` is its time after the log's first bfee record by the card's clock, microseconds.
    #[must_use]
    pub fn keeps(&self, bfee: &Bfee<'_>, identity: Identity, since_us: i64) -> bool {
        self.keeps_by(bfee.antennas().ok(), identity, since_us)
    }

    /// The same by the used antennas, if known.
    #[inline]
    fn keeps_by(&self, used: Option<Antennas>, identity: Identity, since_us: i64) -> bool {
        let is_used = |antenna: &Antenna| used.is_some_and(|used| used.chain_of(*antenna).is_some());
        self.macs.as_ref().is_none_or(|macs| macs.contains(&identity.mac))
            && self.from_us.is_none_or(|from| since_us >= from)
            && self.to_us.is_none_or(|to| since_us < to)
            && self.antennas.as_ref().is_none_or(|wanted| wanted.iter().any(is_used))
    }
}

/// A log that is being read into memory.
pub struct Reading<S> {
    source: S,
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
    first_us: Option<i64>,
    pub(super) ended: bool,
    pub(super) bodies: bool,
}

impl<S: CsiSource> Reading<S> {
    /// Nothing read yet.
    #[must_use]
    pub fn new(source: S, filter: Filter) -> Self {
        Self {
            source,
            filter,
            survey: Survey::default(),
            arena: Arena::default(),
            columns: Columns::default(),
            left_out: 0,
            damaged_after: Vec::new(),
            first_us: None,
            ended: false,
            bodies: true,
        }
    }

    /// Columns only: the arena stays empty. For a log that is read again.
    #[must_use]
    pub fn without_bodies(mut self) -> Self {
        self.bodies = false;
        self
    }

    /// The source.
    #[must_use]
    pub fn source(&self) -> &S {
        &self.source
    }

    /// The card's clock at the log's first bfee record, kept or not, microseconds from the origin of [`Columns::time_us`].
    #[must_use]
    pub fn first_us(&self) -> Option<i64> {
        self.first_us
    }

    /// True once all was read.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// The records kept since the last call.
    pub fn take(&mut self) -> (Arena, Columns) {
        (std::mem::take(&mut self.arena), std::mem::take(&mut self.columns))
    }

    /// Reads up to `BURST` records, until `limit` are kept, none is available, or the log ends; returns whether more may be
    /// available at once.
    ///
    /// # Errors
    /// If the source cannot be read further.
    pub fn burst(&mut self, now: Instant, limit: usize) -> Result<bool, Error> {
        let mut tally = Tally::default();
        let more = self.burst_in(&mut tally, now, limit);
        self.survey.settle(&mut tally);
        more
    }

    fn burst_in(&mut self, tally: &mut Tally, now: Instant, limit: usize) -> Result<bool, Error> {
        for _ in 0..BURST {
            if self.ended || self.columns.len() >= limit {
                return Ok(false);
            }
            let (source, mut table) = self.parts();
            let next = source.receive(now)?;
            let ended = matches!(next, Next::End(_));
            if matches!(next, Next::Pending) {
                return Ok(false);
            }
            table.take(tally, &next);
            self.ended |= ended;
        }
        Ok(true)
    }

    pub(super) fn parts(&mut self) -> (&mut S, Table<'_>) {
        let Self { source, filter, survey, arena, columns, left_out, damaged_after, first_us, bodies, .. } = self;
        (source, Table { filter, survey, arena, columns, left_out, damaged_after, first_us, bodies: *bodies })
    }
}

/// Where records are stored.
pub(super) struct Table<'a> {
    filter: &'a Filter,
    survey: &'a mut Survey,
    arena: &'a mut Arena,
    columns: &'a mut Columns,
    left_out: &'a mut u64,
    damaged_after: &'a mut Vec<u64>,
    first_us: &'a mut Option<i64>,
    bodies: bool,
}

impl Table<'_> {
    /// Records kept.
    pub(super) fn kept(&self) -> usize {
        self.columns.len()
    }

    /// Reserves room for this many more records, as far as memory allows; `advise` gets the memory.
    pub(super) fn reserve(&mut self, records: usize, advise: &mut impl Advise) {
        self.arena.reserve(records, advise);
        self.columns.reserve(records, advise);
    }

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
        let is_kept = self.filter.keeps_by(fields.antennas, identity, since_us);
        if is_kept {
            self.columns.push(fields, identity, time_us, offset);
        } else {
            *self.left_out += 1;
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
            (Next::Record(_, record), None) if record.code == code::MPDU => self.arena.note_mpdu(record.body),
            (Next::Lost(_), _) | (_, Some(false)) => self.arena.drop_mpdu(),
            _ => {}
        }
    }

    /// Counts a bfee record whose bytes are in a block, by its fields and place.
    #[inline(always)]
    pub(super) fn sort_bfee(&mut self, sorted: &mut Sorted, stamps: Stamps, fields: &Fields, span: Span) {
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
    pub(super) fn sort(&mut self, sorted: &mut Sorted, next: &Next<'_>, span: Span) {
        let is_kept = self.note(&mut sorted.tally, next);
        match (next, is_kept) {
            (_, Some(true)) => return sorted.keep(span),
            (Next::Record(_, record), None) if record.code == code::MPDU => sorted.mpdu = Some(span),
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
    pub(super) fn keep(&mut self, sorted: &mut Sorted, block: Block) -> Option<Block> {
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

/// Place of a record in its source.
fn place(stamps: Stamps) -> u64 {
    let (Origin::File { offset: place } | Origin::Live { number: place }) = stamps.origin;
    place
}

/// The kept part of a block.
#[derive(Default)]
pub(super) struct Sorted {
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
