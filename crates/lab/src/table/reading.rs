//! A log read into memory: filters, columns, packed records.

use super::arena::Arena;
use super::columns::{Columns, antennas};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Error, Next, Origin};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::ParseMacError;
use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::record::code;
use std::collections::BTreeSet;

/// Records that [`Reading::burst`] reads at most.
const BURST: usize = 32_768;

/// Why there is no such filter.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FilterError {
    /// A text is no address.
    #[error("{text:?} is no sender: {source}")]
    Mac {
        /// The text.
        text: String,
        /// Why.
        source: ParseMacError,
    },
    /// A text names no antennas.
    #[error("{text:?} names no antennas: letters of A, B and C, such as A or AC")]
    Antennas {
        /// The text.
        text: String,
    },
    /// The stretch of time is empty or not a number.
    #[error("from {from_s} to {to_s} seconds after the first record is no stretch of time")]
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

    /// With only records of which one of the antennas named (`A`, `BC`) was used.
    ///
    /// # Errors
    /// [`FilterError::Antennas`].
    pub fn with_antennas(mut self, letters: &str) -> Result<Self, FilterError> {
        let named = antennas(letters).ok_or_else(|| FilterError::Antennas { text: letters.to_owned() })?;
        self.antennas = Some(named);
        Ok(self)
    }

    /// The antennas that were asked for.
    #[must_use]
    pub fn antennas(&self) -> Option<&[Antenna]> {
        self.antennas.as_deref()
    }

    /// Whether a record is kept; `since_us` is its time after the log's first bfee record by the card's clock, microseconds.
    #[must_use]
    pub fn keeps(&self, bfee: &Bfee<'_>, identity: Identity, since_us: i64) -> bool {
        self.macs.as_ref().is_none_or(|macs| macs.contains(&identity.mac))
            && self.from_us.is_none_or(|from| since_us >= from)
            && self.to_us.is_none_or(|to| since_us < to)
            && self
                .antennas
                .as_ref()
                .is_none_or(|wanted| wanted.iter().any(|antenna| bfee.chain_of(*antenna).is_some()))
    }
}

/// A log on its way into memory.
pub struct Reading<S> {
    source: S,
    filter: Filter,
    /// What was met so far.
    pub survey: Survey,
    /// Records kept since the last [`Reading::take`].
    pub arena: Arena,
    /// Their columns.
    pub columns: Columns,
    /// Intact records that the filter left out.
    pub left_out: u64,
    first_us: Option<i64>,
    ended: bool,
}

impl<S: CsiSource> Reading<S> {
    /// Nothing read yet.
    #[must_use]
    pub fn new(source: S, filter: Filter) -> Self {
        let (arena, columns) = Default::default();
        Self { source, filter, survey: Survey::default(), arena, columns, left_out: 0, first_us: None, ended: false }
    }

    /// The source.
    #[must_use]
    pub fn source(&self) -> &S {
        &self.source
    }

    /// True once all was read.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// What was kept since the last call.
    pub fn take(&mut self) -> (Arena, Columns) {
        (std::mem::take(&mut self.arena), std::mem::take(&mut self.columns))
    }

    /// Reads on for `BURST` records, until `limit` are kept, until nothing is there, or to the end; whether more may be
    /// there at once.
    ///
    /// # Errors
    /// If the source cannot be read further.
    pub fn burst(&mut self, now: Instant, limit: usize) -> Result<bool, Error> {
        for _ in 0..BURST {
            if self.ended || self.arena.len() >= limit {
                return Ok(false);
            }
            let next = self.source.receive(now)?;
            let (offset, body) = match &next {
                Next::Record(stamps, record) => {
                    if record.code == code::MPDU {
                        self.arena.note_mpdu(record.body);
                    }
                    let (Origin::File { offset: place } | Origin::Live { number: place }) = stamps.origin;
                    (place, record.body)
                }
                Next::Pending => return Ok(false),
                Next::Lost(_) => (0, &[][..]),
                Next::End(_) => {
                    self.ended = true;
                    (0, &[][..])
                }
            };
            let Some((bfee, identity)) = self.survey.note(&next) else { continue };
            let time_us = self.survey.clock_us.map_or(0, |(_, last)| last);
            let since_us = time_us - *self.first_us.get_or_insert(time_us);
            if self.filter.keeps(&bfee, identity, since_us) {
                self.arena.push(body);
                self.columns.push(&bfee, identity, time_us, offset);
            } else {
                self.arena.drop_mpdu();
                self.left_out += 1;
            }
        }
        Ok(true)
    }
}
