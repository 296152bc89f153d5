//! A log over time, binned for pictures and pages: CSI of each antenna over time and subcarrier, RSSI and gain, rate, and where
//! something is missing.
//!
//! [`LogIndex`] is a log whose columns were read once ([`table`](crate::table)), from which any stretch is binned at once; its CSI is read
//! again from the file. [`Course`] is what one picture shows.

use crate::table::{Columns, Decoder, Filter, Form, LogReader, NO_TIME, Order, Reading, Rows};
use csi5300::internal::PAUSE_US;
use csi5300::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ, SUBCARRIERS};
use csi5300::source::survey::{NumberStep, Numbering, Sender, Survey, TimeBase};
use csi5300::source::{Error, replay::Replay};
use csi5300::time::{Instant, Step16};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, rate::HT40};
use num_complex::Complex32;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Columns of a heat map at most.
const COLUMNS: usize = 600;
/// Bins of the rate.
pub const RATE_BINS: usize = 200;
/// A gap in records is marked where it is longer than this many usual intervals, and this long, seconds.
const GAP_INTERVALS: f64 = 10.0;
const GAP_LEAST_S: f64 = 0.05;
/// Points kept of a line.
const POINTS: usize = 2_000;
/// Columns of the CSI that is kept of the whole log.
const KEPT: usize = 4_096;
/// Records whose CSI is read again for one stretch, at most: of more every n-th.
const READ: usize = 40_000;
/// Columns of a stretch at most.
const MOST_COLUMNS: usize = 4_000;
/// Records of a bin of the rate at least: fewer do not tell a rate from chance.
const RECORDS_A_BIN: usize = 20;
/// Senders told apart; further ones are one.
const SENDERS: usize = u16::MAX as usize;

/// What of a log is wanted.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Wanted {
    /// Only frames of these senders; of all where empty.
    pub macs: Vec<Mac>,
    /// Only these antennas; all where empty.
    pub antennas: Vec<Antenna>,
    /// From here on, seconds after the first record.
    pub from_s: Option<f64>,
    /// Up to here, seconds after the first record.
    pub to_s: Option<f64>,
}

impl Wanted {
    /// With these senders only.
    #[must_use]
    pub fn with_macs(mut self, macs: Vec<Mac>) -> Self {
        self.macs = macs;
        self
    }

    /// With these antennas only.
    #[must_use]
    pub fn with_antennas(mut self, antennas: Vec<Antenna>) -> Self {
        self.antennas = antennas;
        self
    }

    /// Between two times only, seconds after the first record.
    #[must_use]
    pub fn with_cut(mut self, from_s: Option<f64>, to_s: Option<f64>) -> Self {
        (self.from_s, self.to_s) = (from_s, to_s);
        self
    }

    fn takes(&self, mac: Mac, t_s: f64) -> bool {
        (self.macs.is_empty() || self.macs.contains(&mac))
            && self.from_s.is_none_or(|from| t_s >= from)
            && self.to_s.is_none_or(|to| t_s <= to)
    }
}

/// CSI of one antenna over time and subcarrier.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AntennaCourse {
    /// The antenna.
    pub antenna: Antenna,
    /// Mean amplitude of each cell, dB relative to the card's step, `[subcarrier][column]` row by row; not a number where
    /// nothing fell into it.
    pub amplitude_db: Vec<f64>,
    /// Mean phase of each cell relative to the middle subcarrier of its own record, radians, in the same order: the
    /// phase of a record by itself is that of two crystals.
    pub phase_rad: Vec<f64>,
    /// Mean amplitude over the subcarriers over time, dB: (seconds, dB), a point for each column that holds something.
    pub line_db: Vec<(f64, f64)>,
}

/// A log over time.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Course {
    /// Records in it.
    pub records: u64,
    /// What its times are of.
    pub base: TimeBase,
    /// First and last time, seconds after the log's first record, by `base` (numbers of records where there is no clock); steps
    /// back of the clock count as none.
    pub span_s: (f64, f64),
    /// Indices of the reported subcarriers about the centre; none where frames of both widths are in the log.
    pub subcarriers: Option<[i8; SUBCARRIERS]>,
    /// Columns of the heat maps: one for a record at most.
    pub columns: usize,
    /// Antennas with CSI.
    pub antennas: Vec<AntennaCourse>,
    /// RSSI of antennas A, B, C as the card reports it, dB: (seconds, dB), thinned out evenly; 0 (not connected) left out.
    pub rssi: [Vec<(f64, f64)>; 3],
    /// Gain, dB, in the same form.
    pub agc: Vec<(f64, f64)>,
    /// Records per second in [`RATE_BINS`] bins: (middle in seconds, Hz).
    pub rate_hz: Vec<(f64, f64)>,
    /// From and to of stretches without a record, seconds.
    pub gaps_s: Vec<(f64, f64)>,
    /// Numbers missing from `bfee_count`: when (seconds), and how many.
    pub missing: Vec<(f64, u64)>,
    /// Stretches of damaged bytes, and impossible records: when, seconds.
    pub damaged: Vec<f64>,
    /// Frame numbers that senders skipped on the way up: when (seconds), and how many.
    pub skipped: Vec<(f64, u64)>,
    /// Frames with the number of the one before: when, seconds.
    pub repeated: Vec<f64>,
    /// Where the card's clock stepped back: when (seconds), by how much (seconds).
    pub steps_back: Vec<(f64, f64)>,
    /// True if records were lost before the log's end.
    pub lost_something: bool,
}

impl Course {
    /// Reads a log, twice: once for its columns, once for its CSI.
    ///
    /// # Errors
    /// If the log cannot be read. A log without a record that is wanted gives an empty course.
    pub fn read(path: &Path, wanted: &Wanted) -> Result<Self, Error> {
        let log = LogIndex::open(path)?;
        let lost_something = log.survey.lost_something();
        let rows: Vec<usize> =
            (0..log.t_us.len()).filter(|row| wanted.takes(log.sender_of(*row), log.t_s(*row))).collect();
        let times_s: Vec<f64> = rows.iter().map(|row| log.t_s(*row)).collect();
        let Some(span_s) = span_s(&times_s) else { return Ok(Self { lost_something, ..Self::default() }) };
        let columns = rows.len().clamp(1, COLUMNS);
        let cells = log.cells(rows.iter().copied(), span_s, columns)?;
        let asked = |antenna: Antenna| wanted.antennas.is_empty() || wanted.antennas.contains(&antenna);
        let antennas = Antenna::ALL.into_iter().zip(cells).filter(|(antenna, _)| asked(*antenna));
        let inside = |t_s: &f64| (span_s.0..=span_s.1).contains(t_s);
        let own =
            |row: usize| inside(&log.t_s(row)) && (wanted.macs.is_empty() || wanted.macs.contains(&log.sender_of(row)));
        let thin = |value: &dyn Fn(usize) -> u8| -> Vec<(f64, f64)> {
            let every = rows.len().div_ceil(POINTS).max(1);
            rows.iter().step_by(every).map(|row| (log.t_s(*row), f64::from(value(*row)))).collect()
        };
        let marks = &log.marks;
        Ok(Self {
            records: rows.len() as u64,
            base: log.base,
            span_s,
            subcarriers: log.subcarriers(),
            columns,
            antennas: antennas.filter_map(|(antenna, cells)| cells.course(antenna, span_s)).collect(),
            rssi: std::array::from_fn(|port| {
                thin(&|row| log.rssi_of(row)[port]).into_iter().filter(|point| point.1 > 0.0).collect()
            }),
            agc: thin(&|row| log.agc_of(row)),
            rate_hz: rate(&times_s, span_s),
            gaps_s: gaps(&times_s),
            missing: marks
                .missing
                .iter()
                .map(|mark| (log.t_s(mark.0), mark.1))
                .filter(|mark| inside(&mark.0))
                .collect(),
            damaged: marks.damaged.iter().map(|row| log.t_s(*row)).filter(inside).collect(),
            skipped: marks.skipped.iter().filter(|mark| own(mark.0)).map(|mark| (log.t_s(mark.0), mark.1)).collect(),
            repeated: marks.repeated.iter().filter(|row| own(**row)).map(|row| log.t_s(*row)).collect(),
            steps_back: marks.steps_back.iter().map(|m| (log.t_s(m.0), m.1)).filter(|m| inside(&m.0)).collect(),
            lost_something,
        })
    }
}

/// A log of which a short row a record was read. It keeps 22 bytes a record and the CSI of 4,096 columns, whatever the log's length; CSI
/// of shorter stretches is read again from the file.
pub struct LogIndex {
    path: PathBuf,
    /// What its times are of.
    base: TimeBase,
    survey: Survey,
    bytes: u64,
    /// Of each record: time since the log's first, microseconds.
    t_us: Vec<i64>,
    /// Where it begins in the file, bytes.
    offset: Vec<i64>,
    /// Three values a record.
    rssi: Vec<u8>,
    agc: Vec<u8>,
    /// Its sender, a place in `senders`.
    sent_by: Vec<u16>,
    senders: Vec<Mac>,
    marks: Marks,
    span_s: (f64, f64),
    gaps_s: Vec<(f64, f64)>,
    /// CSI of the whole log by antenna, in [`KEPT`] columns.
    kept: Option<[Cells; 3]>,
}

/// What is missing, and what the counters did, by the record at which it shows.
#[derive(Default)]
struct Marks {
    /// How many numbers of `bfee_count` are missing before it.
    missing: Vec<(usize, u64)>,
    /// The record before bytes that are none, or before an impossible record.
    damaged: Vec<usize>,
    /// How many frame numbers its sender skipped.
    skipped: Vec<(usize, u64)>,
    repeated: Vec<usize>,
    /// By how much the card's clock stepped back, seconds.
    steps_back: Vec<(usize, f64)>,
}

impl Marks {
    fn of(columns: &Columns, survey: &Survey, damaged_after: &[u64]) -> Self {
        let mut marks = Self::default();
        let last = columns.len().saturating_sub(1);
        marks.damaged = damaged_after.iter().map(|before| (*before as usize).saturating_sub(1).min(last)).collect();
        let steps = columns.time_us.windows(2).enumerate();
        let back = steps.filter_map(|(k, pair)| Some((k + 1, pair.first()?.saturating_sub(*pair.get(1)?))));
        marks.steps_back = back.filter(|(_, us)| *us > 0).map(|(k, us)| (k, us as f64 * 1e-6)).collect();
        let mut count = Step16::default();
        for (k, number) in columns.bfee_count.iter().enumerate() {
            if let Some(step @ 2..) = count.step(*number).filter(|step| *step <= u16::MAX / 2) {
                marks.missing.push((k, u64::from(step - 1)));
            }
        }
        // What stands where a sounding frame has its number is none in frames of other programs.
        let counting = survey.senders.iter().filter(|(_, sender)| Sender::counts_up(sender));
        let mut numbers: BTreeMap<Mac, Numbering> = counting.map(|(mac, _)| (*mac, Numbering::default())).collect();
        for (k, (mac, frame)) in macs(columns).zip(&columns.frame).enumerate() {
            let (Some(numbering), Ok(frame)) = (numbers.get_mut(&mac), u32::try_from(*frame)) else { continue };
            match numbering.note(frame) {
                NumberStep::Repeated => marks.repeated.push(k),
                NumberStep::Forward(step @ 2..) => marks.skipped.push((k, u64::from(step - 1))),
                NumberStep::Forward(_) | NumberStep::New | NumberStep::Back => {}
            }
        }
        marks
    }
}

/// The sender of each record.
fn macs(columns: &Columns) -> impl Iterator<Item = Mac> {
    columns.mac.as_chunks::<6>().0.iter().map(|octets| Mac(*octets))
}

/// Time of each record since the first, microseconds, as the survey counts it (`csi5300 info`): steps back of a clock take no time.
fn times_us(columns: &Columns, base: TimeBase) -> Vec<i64> {
    let (mut last, mut sum) = (None, 0_i64);
    let mut elapsed = |now: i64| {
        let step = last.replace(now).map_or(0, |last| now.saturating_sub(last));
        sum = sum.saturating_add(step.max(0));
        sum
    };
    match base {
        TimeBase::Card => columns.time_us.iter().map(|now| elapsed(*now)).collect(),
        TimeBase::Host => {
            let mut at = 0;
            let mut next = |now: i64| {
                at = if now == NO_TIME { at } else { elapsed(now) };
                at
            };
            columns.host_us.iter().map(|now| next(*now)).collect()
        }
        _ => (0..columns.len() as i64).map(|number| number.saturating_mul(1_000_000)).collect(),
    }
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

impl LogIndex {
    /// Reads a log, twice: once for its columns, once for its CSI.
    ///
    /// # Errors
    /// If the log cannot be read. A log without an intact record has no span.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let mut log = Self::open(path)?;
        log.kept = Some(log.cells(0..log.t_us.len(), log.span_s, KEPT)?);
        Ok(log)
    }

    /// Reads its columns.
    fn open(path: &Path) -> Result<Self, Error> {
        let mut reading = Reading::new(Replay::open(path)?, Filter::default()).without_bodies();
        reading.read_all(Instant::ZERO, || true)?;
        let (_, columns) = reading.take();
        let base = reading.survey.time_base();
        let (mut senders, mut numbers) = (Vec::new(), BTreeMap::new());
        let sent_by = macs(&columns).map(|mac| {
            *numbers.entry(mac).or_insert_with(|| {
                if senders.len() < SENDERS {
                    senders.push(mac);
                }
                senders.len().saturating_sub(1) as u16
            })
        });
        let sent_by = sent_by.collect();
        let t_us = times_us(&columns, base);
        let times_s: Vec<f64> = t_us.iter().map(|us| *us as f64 * 1e-6).collect();
        Ok(Self {
            path: path.into(),
            base,
            bytes: reading.source().bytes(),
            marks: Marks::of(&columns, &reading.survey, &reading.damaged_after),
            survey: reading.survey,
            span_s: span_s(&times_s).unwrap_or_default(),
            gaps_s: gaps(&times_s),
            t_us,
            offset: columns.offset,
            rssi: columns.rssi,
            agc: columns.agc,
            sent_by,
            senders,
            kept: None,
        })
    }

    /// The log.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its size, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Everything counted in it.
    #[must_use]
    pub fn survey(&self) -> &Survey {
        &self.survey
    }

    /// What its times are of: with [`TimeBase::Number`] they are numbers of records.
    #[must_use]
    pub fn base(&self) -> TimeBase {
        self.base
    }

    /// Indices of the reported subcarriers about the centre; none where frames of both widths are in the log.
    #[must_use]
    pub fn subcarriers(&self) -> Option<[i8; SUBCARRIERS]> {
        let wide = self.survey.rates.keys().filter(|rate| *rate & HT40 != 0).count();
        match wide {
            0 => Some(INDICES_20_MHZ),
            all if all == self.survey.rates.len() => Some(INDICES_40_MHZ),
            _ => None,
        }
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

    fn t_s(&self, row: usize) -> f64 {
        self.t_us.get(row).copied().unwrap_or(0) as f64 * 1e-6
    }

    fn rssi_of(&self, row: usize) -> [u8; 3] {
        self.rssi.as_chunks::<3>().0.get(row).copied().unwrap_or_default()
    }

    fn agc_of(&self, row: usize) -> u8 {
        self.agc.get(row).copied().unwrap_or(0)
    }

    fn sender_of(&self, row: usize) -> Mac {
        let number = self.sent_by.get(row).copied().unwrap_or(0);
        self.senders.get(usize::from(number)).copied().unwrap_or_default()
    }

    /// The part of a stretch that lies in the log, and the places of its rows.
    fn cut(&self, from_s: f64, to_s: f64) -> ((f64, f64), Range<usize>) {
        let cut = (from_s.max(self.span_s.0), to_s.min(self.span_s.1));
        if cut.0 >= cut.1 || self.t_us.is_empty() {
            return (self.span_s, 0..self.t_us.len());
        }
        let first = self.t_us.partition_point(|us| (*us as f64 * 1e-6) < cut.0);
        let end = self.t_us.partition_point(|us| *us as f64 * 1e-6 <= cut.1);
        (cut, first..end)
    }

    /// True if the row was sent by `sender`, or none is asked for.
    fn is_of(&self, row: usize, sender: Option<Mac>) -> bool {
        sender.is_none_or(|mac| self.sender_of(row) == mac)
    }

    /// Levels and losses between two times in about `columns` columns, of one sender or of all; a column for two
    /// records at most. What is missing from `bfee_count`, and damage, are of no sender: they are in it whoever is asked
    /// for. A stretch outside of the log is all of it.
    #[must_use]
    pub fn stretch(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Stretch {
        let (cut, rows) = self.cut(from_s, to_s);
        let own = || rows.clone().filter(|row| self.is_of(*row, sender));
        let records = own().count();
        let columns = fitting(columns, records);
        let (mut rssi, mut agc) = ([Sums::new(columns), Sums::new(columns), Sums::new(columns)], Sums::new(columns));
        let mut rates = vec![0_u32; (records / RECORDS_A_BIN).clamp(1, columns)];
        let bins = rates.len();
        for row in own() {
            let column = bin(self.t_s(row), cut, columns);
            agc.add(column, self.agc_of(row));
            for (sums, value) in rssi.iter_mut().zip(self.rssi_of(row)).filter(|(_, value)| *value > 0) {
                sums.add(column, value);
            }
            rates[bin(self.t_s(row), cut, bins)] += 1;
        }
        let width_s = (cut.1 - cut.0).max(1e-6) / bins as f64;
        let inside = |t_s: &f64| (cut.0..=cut.1).contains(t_s);
        let counted = |marks: &mut dyn Iterator<Item = (usize, u64)>| {
            let mut found = BTreeMap::new();
            for (t_s, count) in marks.map(|(row, count)| (self.t_s(row), count)).filter(|(t_s, _)| inside(t_s)) {
                *found.entry(bin(t_s, cut, columns)).or_default() += count;
            }
            found.into_iter().collect()
        };
        let marks = &self.marks;
        Stretch {
            from_s: cut.0,
            to_s: cut.1,
            columns,
            records,
            rate_hz: rates.iter().map(|count| hundredths(f64::from(*count) / width_s)).collect(),
            rssi: rssi.map(Sums::band),
            agc: agc.band(),
            missing: counted(&mut marks.missing.iter().copied()),
            damaged: counted(&mut marks.damaged.iter().map(|row| (*row, 1))),
            skipped: counted(&mut marks.skipped.iter().filter(|mark| self.is_of(mark.0, sender)).copied()),
            repeated: counted(&mut marks.repeated.iter().filter(|row| self.is_of(**row, sender)).map(|row| (*row, 1))),
            gaps_s: self.gaps_s.iter().filter(|(from, to)| *to >= cut.0 && *from <= cut.1).copied().collect(),
            steps_back: marks.steps_back.iter().map(|m| (self.t_s(m.0), m.1)).filter(|m| inside(&m.0)).collect(),
        }
    }

    /// CSI between two times in about `columns` columns, of one sender or of all; a column for two
    /// records at most. A stretch outside of the log is all of it.
    ///
    /// # Errors
    /// If the file cannot be read again.
    pub fn csi(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Result<StretchCsi, Error> {
        let (cut, rows) = self.cut(from_s, to_s);
        let own = || rows.clone().filter(|row| self.is_of(*row, sender));
        let records = own().count();
        let columns = fitting(columns, records);
        let kept_s = (self.span_s.1 - self.span_s.0) / KEPT as f64;
        let (cells, every) = match &self.kept {
            Some(kept) if sender.is_none() && (cut.1 - cut.0) / columns as f64 >= kept_s => {
                (kept.each_ref().map(|own| own.stretch(self.span_s, cut, columns)), 1)
            }
            _ => {
                let every = records.div_ceil(READ).max(1);
                (self.cells(own().step_by(every), cut, columns)?, every)
            }
        };
        let course = |(antenna, cells): (Antenna, Cells)| cells.course(antenna, cut);
        let antennas = Antenna::ALL.into_iter().zip(cells).filter_map(course).collect();
        Ok(StretchCsi { from_s: cut.0, to_s: cut.1, columns, records, every, antennas })
    }

    /// CSI of rows, read from the file, by antenna. A row whose record is not there any more has none.
    fn cells(
        &self,
        rows: impl Iterator<Item = usize>,
        span_s: (f64, f64),
        columns: usize,
    ) -> Result<[Cells; 3], Error> {
        let again = |source| Error::Io { what: format!("cannot read the log {} again", self.path.display()), source };
        let mut log = LogReader::open(&self.path).map_err(again)?;
        let mut decoder = Decoder::new(Order::SubcarriersLast, Rows::new(&Antenna::ALL, 1), Form::default());
        let mut cells = [(); 3].map(|()| Cells::new(columns));
        let mut h = [[Complex32::default(); SUBCARRIERS]; 3];
        for row in rows {
            let Some(bfee) = log.bfee(self.offset.get(row).copied().unwrap_or(-1)).map_err(again)? else { continue };
            let Ok(used) = bfee.antennas() else { continue };
            decoder.decode(&bfee, h.as_flattened_mut());
            let column = bin(self.t_s(row), span_s, columns);
            for ((antenna, cells), h) in Antenna::ALL.into_iter().zip(&mut cells).zip(&h) {
                if used.chain_of(antenna).is_some() {
                    cells.add(column, h);
                }
            }
        }
        Ok(cells)
    }
}

/// CSI of one antenna summed in cells over time and subcarrier, `[column][subcarrier]`: a record touches neighbours only.
#[derive(Clone)]
struct Cells {
    amplitude: Vec<f64>,
    phase: Vec<Complex32>,
    counts: Vec<u32>,
}

impl Cells {
    fn new(columns: usize) -> Self {
        let cells = SUBCARRIERS * columns;
        Self { amplitude: vec![0.0; cells], phase: vec![Complex32::default(); cells], counts: vec![0; columns] }
    }

    fn add(&mut self, column: usize, h: &[Complex32; SUBCARRIERS]) {
        let (Some(count), Some(amplitude), Some(phase)) = (
            self.counts.get_mut(column),
            self.amplitude.chunks_exact_mut(SUBCARRIERS).nth(column),
            self.phase.chunks_exact_mut(SUBCARRIERS).nth(column),
        ) else {
            return;
        };
        *count += 1;
        let middle = h[SUBCARRIERS / 2].conj();
        for ((value, amplitude), phase) in h.iter().zip(amplitude).zip(phase) {
            *amplitude += f64::from(value.norm_sqr().sqrt());
            let turned = value * middle;
            let size = turned.norm_sqr().sqrt();
            if size > 0.0 {
                *phase += turned / size;
            }
        }
    }

    /// The columns over `span_s` that a part of it touches, as `columns` of that.
    fn stretch(&self, span_s: (f64, f64), cut: (f64, f64), columns: usize) -> Self {
        let own = self.counts.len();
        let width_s = (span_s.1 - span_s.0) / own as f64;
        let mut cells = Self::new(columns);
        for from in 0..own {
            let middle_s = span_s.0 + (from as f64 + 0.5) * width_s;
            if middle_s < cut.0 - 0.5 * width_s || middle_s > cut.1 + 0.5 * width_s {
                continue;
            }
            let to = bin(middle_s, cut, columns);
            cells.counts[to] += self.counts[from];
            for k in 0..SUBCARRIERS {
                let (to, from) = (to * SUBCARRIERS + k, from * SUBCARRIERS + k);
                cells.amplitude[to] += self.amplitude[from];
                cells.phase[to] += self.phase[from];
            }
        }
        cells
    }

    /// The means over a span; columns into which nothing fell hold no number. `None` where all is silent.
    fn course(self, antenna: Antenna, span_s: (f64, f64)) -> Option<AntennaCourse> {
        let columns = self.counts.len();
        let at = |cell: usize| (cell % columns) * SUBCARRIERS + cell / columns;
        let count = |cell: usize| f64::from(self.counts[cell % columns]);
        let mean = |cell: usize| if count(cell) > 0.0 { self.amplitude[at(cell)] / count(cell) } else { f64::NAN };
        let db = |value: f64| if value > 0.0 { 20.0 * value.log10() } else { f64::NAN };
        let cells = SUBCARRIERS * columns;
        let middle = |column: usize| span_s.0 + (column as f64 + 0.5) * (span_s.1 - span_s.0) / columns as f64;
        let over =
            |column: usize| (0..SUBCARRIERS).map(|k| mean(k * columns + column)).sum::<f64>() / SUBCARRIERS as f64;
        let line = (0..columns).map(|column| (middle(column), db(over(column)))).filter(|point| point.1.is_finite());
        let phase = |cell: usize| match self.phase[at(cell)] {
            sum if sum.norm() > 0.0 => f64::from(sum.arg()),
            _ => f64::NAN,
        };
        let course = AntennaCourse {
            antenna,
            amplitude_db: (0..cells).map(|cell| db(mean(cell))).collect(),
            phase_rad: (0..cells).map(phase).collect(),
            line_db: line.collect(),
        };
        (!course.line_db.is_empty()).then_some(course)
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

/// First and last time, seconds; never of no length.
fn span_s(times_s: &[f64]) -> Option<(f64, f64)> {
    let (first, last) = times_s.first().zip(times_s.last())?;
    Some((*first, last.max(first + 1e-6)))
}

fn bin(t_s: f64, span_s: (f64, f64), bins: usize) -> usize {
    (((t_s - span_s.0) / (span_s.1 - span_s.0) * bins as f64) as usize).min(bins - 1)
}

fn rate(times_s: &[f64], span_s: (f64, f64)) -> Vec<(f64, f64)> {
    // No more bins than tell a rate from chance.
    let bins = (times_s.len() / 5).clamp(1, RATE_BINS);
    let width_s = (span_s.1 - span_s.0) / bins as f64;
    let mut counts = vec![0_u32; bins];
    times_s.iter().for_each(|t_s| counts[bin(*t_s, span_s, bins)] += 1);
    let middle = |k: usize| span_s.0 + (k as f64 + 0.5) * width_s;
    counts.iter().enumerate().map(|(k, count)| (middle(k), f64::from(*count) / width_s)).collect()
}

fn gaps(times_s: &[f64]) -> Vec<(f64, f64)> {
    let mut steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let usual_s = csi5300::maths::median(&mut steps).unwrap_or_default();
    let limit_s = (GAP_INTERVALS * usual_s).max(GAP_LEAST_S).min(PAUSE_US as f64 * 1e-6);
    let pairs = times_s.windows(2).map(|pair| (pair[0], pair[1]));
    pairs.filter(|(from, to)| to - from >= limit_s && to - from > 2.0 * usual_s).collect()
}

#[cfg(test)]
mod tests;
