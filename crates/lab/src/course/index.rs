//! A log read once, and any stretch of it binned at once.

use super::cells::{Cells, row_of};
use super::scan::{Seen, scan};
use super::{AntennaCourse, Wanted, bin, gaps, span_s, subcarriers};
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::signal::csi::Csi;
use csi5300::source::survey::{Survey, TimeBase};
use csi5300::source::{CsiSource, Error, Next, replay::Replay};
use csi5300::time::Instant;
use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::{Mac, record::code};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Columns of the CSI that is kept of the whole log: each at least half of it is in use.
const KEPT: usize = 4_096;
/// Width of its columns at the start, microseconds; it doubles whenever the log is longer than they are.
const FIRST_WIDTH_US: i64 = 1_000;
/// Records whose CSI is read again for one stretch, at most: of more every n-th.
const READ: usize = 40_000;
/// Columns of a stretch at most.
const MOST_COLUMNS: usize = 4_000;
/// Records of a bin of the rate at least: fewer do not tell a rate from chance.
const RECORDS_A_BIN: usize = 20;
/// Senders told apart; further ones are one.
const SENDERS: usize = u16::MAX as usize;

/// A log read once. It keeps 26 bytes a record and the CSI of 4,096 columns, whatever the log's length; CSI of shorter
/// stretches is read again from the file.
pub struct LogIndex {
    path: PathBuf,
    /// What its times are of.
    base: TimeBase,
    seen: Seen,
    /// The sender of each row, a place in `senders`.
    sent_by: Vec<u16>,
    senders: Vec<Mac>,
    span_s: (f64, f64),
    gaps_s: Vec<(f64, f64)>,
    kept: Kept,
}

/// Lowest, mean and highest value of each column; none where nothing fell into it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Band {
    /// Lowest value.
    pub min: Vec<Option<u8>>,
    /// Mean, rounded to a hundredth.
    pub mean: Vec<Option<f64>>,
    /// Highest value.
    pub max: Vec<Option<u8>>,
}

/// A stretch of a log in columns of equal width.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Stretch {
    /// Its beginning, seconds after the log's first record ([`LogIndex::base`]); steps back of the clock count as none.
    pub from_s: f64,
    /// Its end, seconds.
    pub to_s: f64,
    /// Columns of `rssi` and `agc`, and those that losses are in.
    pub columns: usize,
    /// Records in it.
    pub records: usize,
    /// Records per second, in bins of equal width: as many as `columns`, or fewer where there are few records.
    pub rate_hz: Vec<f64>,
    /// RSSI of antennas A, B, C as the card reports it, dB; 0 (not connected) left out.
    pub rssi: [Band; 3],
    /// Gain, dB.
    pub agc: Band,
    /// Columns with losses, and how many numbers of `bfee_count` are missing there.
    pub missing: Vec<(usize, u64)>,
    /// Columns with damaged bytes or impossible records, and how many stretches of them.
    pub damaged: Vec<(usize, u64)>,
    /// Columns in which the senders asked for skipped frame numbers, and how many.
    pub skipped: Vec<(usize, u64)>,
    /// Columns with their frames that have the number of the one before, and how many.
    pub repeated: Vec<(usize, u64)>,
    /// From and to of parts without a record, seconds.
    pub gaps_s: Vec<(f64, f64)>,
    /// Where the card's clock stepped back: when, by how much, seconds.
    pub steps_back: Vec<(f64, f64)>,
}

/// CSI of a stretch of a log.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct StretchCsi {
    /// Its beginning, seconds.
    pub from_s: f64,
    /// Its end, seconds.
    pub to_s: f64,
    /// Columns of equal width.
    pub columns: usize,
    /// Records in it.
    pub records: usize,
    /// Every how manieth record is in the means.
    pub every: usize,
    /// The antennas that have CSI in it.
    pub antennas: Vec<AntennaCourse>,
}

/// CSI of the whole log, in columns whose width doubles as it grows.
struct Kept {
    width_us: i64,
    antennas: BTreeMap<usize, Cells>,
}

impl Kept {
    fn new() -> Self {
        Self { width_us: FIRST_WIDTH_US, antennas: BTreeMap::new() }
    }

    fn add(&mut self, t_us: i64, csi: &Csi) {
        while t_us / self.width_us >= KEPT as i64 {
            self.antennas.values_mut().for_each(Cells::halve);
            self.width_us *= 2;
        }
        let column = (t_us / self.width_us) as usize;
        for antenna in Antenna::ALL {
            if let Some(h) = row_of(csi, antenna) {
                self.antennas.entry(antenna as usize).or_insert_with(|| Cells::new(KEPT)).add(column, &h);
            }
        }
    }

    /// The kept columns that a span touches, as columns of it.
    fn stretch(&self, cut: (f64, f64), columns: usize) -> BTreeMap<usize, Cells> {
        let width_s = self.width_us as f64 * 1e-6;
        let middle_s = |kept: usize| (kept as f64 + 0.5) * width_s;
        let touched = (cut.0 - 0.5 * width_s)..=(cut.1 + 0.5 * width_s);
        let of = |own: &Cells| {
            let mut cells = Cells::new(columns);
            for kept in (0..KEPT).filter(|kept| touched.contains(&middle_s(*kept))) {
                cells.add_column(bin(middle_s(kept), cut, columns), own, kept);
            }
            cells
        };
        self.antennas.iter().map(|(antenna, own)| (*antenna, of(own))).collect()
    }
}

impl LogIndex {
    /// Reads a log.
    ///
    /// # Errors
    /// If the log cannot be read. A log without an intact record has no span.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let index = Self::read_by(path, TimeBase::Card)?;
        match index.seen.survey.time_base() {
            TimeBase::Card => Ok(index),
            base => Self::read_by(path, base),
        }
    }

    fn read_by(path: &Path, base: TimeBase) -> Result<Self, Error> {
        let (mut senders, mut numbers) = (Vec::new(), BTreeMap::new());
        let (mut sent_by, mut kept) = (Vec::new(), Kept::new());
        let seen = scan(path, base, &Wanted::default(), |row, identity, bfee| {
            let number = *numbers.entry(identity.mac).or_insert_with(|| {
                if senders.len() < SENDERS {
                    senders.push(identity.mac);
                }
                senders.len() - 1
            });
            sent_by.push(number as u16);
            if let Ok(csi) = Csi::from_bfee(bfee) {
                kept.add(row.t_us, &csi);
            }
        })?;
        let (span_s, gaps_s) = (span_s(&seen.rows).unwrap_or_default(), gaps(&seen.rows));
        Ok(Self { path: path.into(), base, seen, sent_by, senders, span_s, gaps_s, kept })
    }

    /// The log.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its size, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.seen.bytes
    }

    /// Everything counted in it.
    #[must_use]
    pub fn survey(&self) -> &Survey {
        &self.seen.survey
    }

    /// What its times are of: with [`TimeBase::Number`] they are numbers of records.
    #[must_use]
    pub fn base(&self) -> TimeBase {
        self.base
    }

    /// Indices of the reported subcarriers about the centre; none where frames of both widths are in the log.
    #[must_use]
    pub fn subcarriers(&self) -> Option<[i8; SUBCARRIERS]> {
        subcarriers(&self.seen.survey)
    }

    /// First and last time, seconds after the first record.
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        self.span_s
    }

    /// Its senders, in the order in which they were first heard; all zero is one that is unknown.
    #[must_use]
    pub fn senders(&self) -> &[Mac] {
        &self.senders
    }

    /// The part of a stretch that lies in the log, and the places of its rows.
    fn cut(&self, from_s: f64, to_s: f64) -> ((f64, f64), std::ops::Range<usize>) {
        let cut = (from_s.max(self.span_s.0), to_s.min(self.span_s.1));
        if cut.0 >= cut.1 || self.seen.rows.is_empty() {
            return (self.span_s, 0..self.seen.rows.len());
        }
        let before = |t_s: f64, inclusive: bool| {
            self.seen.rows.partition_point(|row| if inclusive { row.t_s() <= t_s } else { row.t_s() < t_s })
        };
        (cut, before(cut.0, false)..before(cut.1, true))
    }

    /// True if the row was sent by `sender`, or none is asked for.
    fn is_of(&self, row: usize, sender: Option<Mac>) -> bool {
        sender.is_none_or(|mac| self.sent_by.get(row).and_then(|k| self.senders.get(usize::from(*k))) == Some(&mac))
    }

    /// Levels and losses between two times in about `columns` columns, of one sender or of all; a column for two
    /// records at most. What is missing from `bfee_count`, and damage, are of no sender: they are in it whoever is asked
    /// for. A stretch outside of the log is all of it.
    #[must_use]
    pub fn stretch(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Stretch {
        let (cut, rows) = self.cut(from_s, to_s);
        let own = || rows.clone().filter(|row| self.is_of(*row, sender)).filter_map(|k| self.seen.rows.get(k));
        let records = own().count();
        let columns = fitting(columns, records);
        let (mut rssi, mut agc) = ([Sums::new(columns), Sums::new(columns), Sums::new(columns)], Sums::new(columns));
        let mut rates = vec![0_u32; (records / RECORDS_A_BIN).clamp(1, columns)];
        let bins = rates.len();
        for row in own() {
            let column = bin(row.t_s(), cut, columns);
            agc.add(column, row.agc);
            for (sums, value) in rssi.iter_mut().zip(row.rssi).filter(|(_, value)| *value > 0) {
                sums.add(column, value);
            }
            rates[bin(row.t_s(), cut, bins)] += 1;
        }
        let width_s = (cut.1 - cut.0).max(1e-6) / bins as f64;
        let inside = |t_s: &f64| (cut.0..=cut.1).contains(t_s);
        let counted = |marks: &mut dyn Iterator<Item = (f64, u64)>| {
            let mut found = BTreeMap::new();
            for (t_s, count) in marks.filter(|(t_s, _)| inside(t_s)) {
                *found.entry(bin(t_s, cut, columns)).or_default() += count;
            }
            found.into_iter().collect()
        };
        let seen = &self.seen;
        let is_own = |mac: &Mac| sender.is_none_or(|sender| sender == *mac);
        let skipped = seen.skipped.iter().filter(|mark| is_own(&mark.0));
        let repeated = seen.repeated.iter().filter(|mark| is_own(&mark.0));
        Stretch {
            from_s: cut.0,
            to_s: cut.1,
            columns,
            records,
            rate_hz: rates.iter().map(|count| hundredths(f64::from(*count) / width_s)).collect(),
            rssi: rssi.map(Sums::band),
            agc: agc.band(),
            missing: counted(&mut seen.missing.iter().copied()),
            damaged: counted(&mut seen.damaged.iter().map(|t_s| (*t_s, 1))),
            skipped: counted(&mut skipped.map(|mark| (mark.1, mark.2))),
            repeated: counted(&mut repeated.map(|mark| (mark.1, 1))),
            gaps_s: self.gaps_s.iter().filter(|(from, to)| *to >= cut.0 && *from <= cut.1).copied().collect(),
            steps_back: seen.steps_back.iter().filter(|(t_s, _)| inside(t_s)).copied().collect(),
        }
    }

    /// CSI between two times in about `columns` columns, of one sender or of all; a column for two
    /// records at most. A stretch outside of the log is all of it.
    ///
    /// # Errors
    /// If the file cannot be read again.
    pub fn csi(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Result<StretchCsi, Error> {
        let (cut, rows) = self.cut(from_s, to_s);
        let records = rows.clone().filter(|row| self.is_of(*row, sender)).count();
        let columns = fitting(columns, records);
        let wide_s = (cut.1 - cut.0) / columns as f64;
        let (cells, every) = if sender.is_none() && wide_s * 1e6 >= self.kept.width_us as f64 {
            (self.kept.stretch(cut, columns), 1)
        } else {
            let every = records.div_ceil(READ).max(1);
            (self.read_again(cut, rows, columns, (sender, every))?, every)
        };
        let course = |(antenna, cells): (usize, Cells)| {
            Antenna::ALL.into_iter().find(|own| *own as usize == antenna).and_then(|own| cells.course(own, cut))
        };
        let antennas = cells.into_iter().filter_map(course).collect();
        Ok(StretchCsi { from_s: cut.0, to_s: cut.1, columns, records, every, antennas })
    }

    /// CSI of rows from the file, of every n-th of a sender's.
    fn read_again(
        &self,
        cut: (f64, f64),
        rows: std::ops::Range<usize>,
        columns: usize,
        (sender, every): (Option<Mac>, usize),
    ) -> Result<BTreeMap<usize, Cells>, Error> {
        let mut found: BTreeMap<usize, Cells> = BTreeMap::new();
        let Some(first) = self.seen.rows.get(rows.start).filter(|_| !rows.is_empty()) else { return Ok(found) };
        let name = self.path.display().to_string();
        let io = |source| Error::Io { what: format!("cannot read the log {name} again"), source };
        let mut file = std::fs::File::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(first.offset)).map_err(io)?;
        let until = self.seen.rows.get(rows.end).map_or(self.seen.bytes, |row| row.offset);
        let mut source = Replay::new(file.take(until.saturating_sub(first.offset)), name.clone());
        // The rows are the intact records in their order: what is no row is skipped by its offset.
        let (mut row, mut own) = (rows.start, 0_usize);
        loop {
            let (stamps, record) = match source.receive(Instant::ZERO)? {
                Next::End(_) => return Ok(found),
                Next::Record(stamps, record) if record.code == code::BFEE => (stamps, record),
                _ => continue,
            };
            let csi5300::source::Origin::File { offset } = stamps.origin else { continue };
            while self.seen.rows.get(row).is_some_and(|known| known.offset < offset + first.offset) {
                row += 1;
            }
            let Some(known) = self.seen.rows.get(row).filter(|known| known.offset == offset + first.offset) else {
                continue;
            };
            if !self.is_of(row, sender) {
                continue;
            }
            own += 1;
            if (own - 1) % every != 0 {
                continue;
            }
            let Ok(bfee) = Bfee::new_checked(record.body) else { continue };
            let Ok(csi) = Csi::from_bfee(&bfee) else { continue };
            for antenna in Antenna::ALL {
                if let Some(h) = row_of(&csi, antenna) {
                    let cells = found.entry(antenna as usize).or_insert_with(|| Cells::new(columns));
                    cells.add(bin(known.t_s(), cut, columns), &h);
                }
            }
        }
    }
}

/// Lowest, sum and highest value of columns.
struct Sums {
    min: Vec<u8>,
    max: Vec<u8>,
    sum: Vec<u64>,
    count: Vec<u32>,
}

impl Sums {
    fn new(columns: usize) -> Self {
        Self { min: vec![u8::MAX; columns], max: vec![0; columns], sum: vec![0; columns], count: vec![0; columns] }
    }

    fn add(&mut self, column: usize, value: u8) {
        self.min[column] = self.min[column].min(value);
        self.max[column] = self.max[column].max(value);
        self.sum[column] += u64::from(value);
        self.count[column] += 1;
    }

    /// The columns; no column at all where nothing fell into any.
    fn band(self) -> Band {
        if self.count.iter().all(|count| *count == 0) {
            return Band::default();
        }
        let known = |values: &[u8]| {
            let pairs = values.iter().zip(&self.count);
            pairs.map(|(value, count)| (*count > 0).then_some(*value)).collect::<Vec<_>>()
        };
        let mean = |(sum, count): (&u64, &u32)| (*count > 0).then(|| hundredths(*sum as f64 / f64::from(*count)));
        Band {
            min: known(&self.min),
            max: known(&self.max),
            mean: self.sum.iter().zip(&self.count).map(mean).collect(),
        }
    }
}

/// So many columns as are asked for, and two records for each: fewer would leave columns empty by chance.
fn fitting(columns: usize, records: usize) -> usize {
    columns.clamp(1, MOST_COLUMNS).min(records.div_ceil(2).max(1))
}

fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests;
