//! A log over time, binned for pictures and pages: CSI of each antenna over time and subcarrier, RSSI and gain, rate, and
//! losses.
//!
//! [`LogIndex`] holds the columns of a log ([`table`](crate::table), [`cards`]), read once, from which any stretch is binned
//! quickly; its CSI is read again from the file. [`Course`] has the data of one picture.
mod card;

use crate::cards::{self, CardSurvey, most_frequent};
use crate::export::indices;
use crate::table::{Columns, Decoder, Filter, Form, LogReader, NO_TIME, Order, Reading, Rows};
use card::CardLog;
use csi_formats::Format;
use csi5300::internal::PAUSE_US;
use csi5300::source::survey::{NumberStep, Numbering, Sender, Survey, TimeBase};
use csi5300::source::{Error, replay::Replay};
use csi5300::time::{Instant, Step16};
use csi5300_say::count;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, SUBCARRIERS, rate::HT40};
use num_complex::Complex32;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Columns of a heat map at most.
const COLUMNS: usize = 600;
/// Cells of all heat maps of a picture at most: a third more than three antennas of a 5300 need.
const CELLS: usize = 144_000;
/// Rows of a heat map at most, in a picture and on a page, each a pixel or two high: with more subcarriers, neighbours share a
/// row.
const PICTURE_ROWS: usize = 128;
const PAGE_ROWS: usize = 256;
/// Bins of the rate.
pub const RATE_BINS: usize = 200;
/// A gap in records is marked if it is longer than both this many usual intervals and this many seconds.
const GAP_INTERVALS: f64 = 10.0;
const GAP_LEAST_S: f64 = 0.05;
/// Points of a line.
const POINTS: usize = 2_000;
/// Columns of CSI kept for the whole log; fewer, of the same total size, for a card with more values than a 5300.
const KEPT: usize = 4_096;
const KEPT_CELLS: usize = KEPT * 3 * SUBCARRIERS;
/// An unknown RSSI.
const NO_RSSI: i16 = i16::MIN;
/// Records of a stretch whose CSI is read again, at most: beyond it, every n-th.
const READ: usize = 40_000;
/// Columns of a stretch at most.
const MOST_COLUMNS: usize = 4_000;
/// Fewest records per bin of the rate: with fewer the rate is mostly chance.
const RECORDS_A_BIN: usize = 20;
/// Limit of separate senders; further ones count as one.
const SENDERS: usize = u16::MAX as usize;

/// Which part of a log is wanted.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Only frames of these senders; empty: of all.
    pub macs: Vec<Mac>,
    /// Only these antennas; empty: all.
    pub antennas: Vec<Antenna>,
    /// Start, seconds after the first record.
    pub from_s: Option<f64>,
    /// End, seconds after the first record.
    pub to_s: Option<f64>,
}

impl Wanted {
    fn takes(&self, mac: Mac, t_s: f64) -> bool {
        (self.macs.is_empty() || self.macs.contains(&mac))
            && self.from_s.is_none_or(|from| t_s >= from)
            && self.to_s.is_none_or(|to| t_s <= to)
    }
}

/// The letter of an antenna: A for the first RF port of a 5300, elsewhere for the first receive chain.
#[must_use]
pub fn letter(antenna: usize) -> char {
    char::from(b'A' + (antenna % 26) as u8)
}

/// The meaning of a heat map's rows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HeatRows {
    /// Index of each subcarrier relative to the channel's centre, lowest first, in units of the spacing; `None` if a 5300's log
    /// has frames of both widths.
    pub indices: Option<Vec<i16>>,
    /// Number of subcarriers.
    pub subcarriers: usize,
    /// Neighbouring subcarriers per row; the last row may have fewer.
    pub each: usize,
    /// Kind and width of the frames; `None` for a 5300.
    pub frames: Option<String>,
}

impl HeatRows {
    pub(crate) fn new(indices: Option<Vec<i16>>, subcarriers: usize, most: usize) -> Self {
        Self { indices, subcarriers, each: subcarriers.div_ceil(most).max(1), frames: None }
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.subcarriers.div_ceil(self.each.max(1))
    }

    /// True if there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.subcarriers == 0
    }

    /// The index of a subcarrier, or its position if the index is unknown.
    #[must_use]
    pub fn index(&self, place: usize) -> i64 {
        let index = self.indices.as_ref().and_then(|indices| indices.get(place));
        index.map_or(place as i64, |index| i64::from(*index))
    }
}

/// CSI of one antenna over time and subcarrier.
#[derive(Clone, Debug, PartialEq)]
pub struct AntennaCourse {
    /// The antenna, from 0 on ([`letter`]).
    pub antenna: usize,
    /// Mean amplitude of each cell, dB relative to the card's step, `[row][column]` ([`HeatRows`]); NaN for an empty cell.
    pub amplitude_db: Vec<f64>,
    /// Mean phase of each cell relative to the middle subcarrier of its own record, radians, in the same order: the absolute
    /// phase of a record depends on two crystals.
    pub phase_rad: Vec<f64>,
    /// Mean amplitude over the subcarriers over time, dB: (seconds, dB), a point for each column that is not empty.
    pub line_db: Vec<(f64, f64)>,
}

/// A log over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Number of records.
    pub records: u64,
    /// The source of its times.
    pub base: TimeBase,
    /// First and last time, seconds after the log's first record, by `base` (record numbers if there is no clock); backward steps
    /// of the clock count as zero.
    pub span_s: (f64, f64),
    /// The kind of log, of cards other than the 5300.
    pub format: Option<&'static str>,
    /// The meaning of the heat maps' rows.
    pub rows: HeatRows,
    /// Columns of the heat maps: at most one per record.
    pub columns: usize,
    /// Antennas with CSI, all from one sender and from frames of one kind and width.
    pub antennas: Vec<AntennaCourse>,
    /// The sender of the CSI; `None` if unknown.
    pub sender: Option<Mac>,
    /// Records of other senders, whose CSI is not shown.
    pub other_senders: u64,
    /// Records of the sender with frames of another kind or width, whose CSI is not shown.
    pub other_frames: u64,
    /// RSSI of each antenna as the card reports it: (seconds, dB), thinned out evenly, without unconnected and unknown ones.
    pub rssi: Vec<Vec<(f64, f64)>>,
    /// True if RSSI is in dBm, false if in dB above an unknown reference.
    pub rssi_in_dbm: bool,
    /// Gain, dB, in the same form; empty if the format does not contain it.
    pub agc: Vec<(f64, f64)>,
    /// Records per second in [`RATE_BINS`] bins: (middle in seconds, Hz).
    pub rate_hz: Vec<(f64, f64)>,
    /// Start and end of stretches without a record, seconds.
    pub gaps_s: Vec<(f64, f64)>,
    /// Numbers missing from `bfee_count`: time (seconds) and count.
    pub missing: Vec<(f64, u64)>,
    /// Damaged stretches and impossible records: time, seconds, each 1.
    pub damaged: Vec<(f64, u64)>,
    /// Increases of senders' frame numbers by more than one: time (seconds) and count.
    pub skipped: Vec<(f64, u64)>,
    /// Frames with the number of the previous one: time, seconds, each 1.
    pub repeated: Vec<(f64, u64)>,
    /// Backward steps of the card's clock: time (seconds) and size (seconds).
    pub steps_back: Vec<(f64, f64)>,
}

impl Course {
    /// Describes wanted records whose CSI is not shown.
    #[must_use]
    pub fn left_out(&self) -> Option<String> {
        let why = [(self.other_senders, "of other senders"), (self.other_frames, "of another kind or width")];
        let parts = why.into_iter().filter(|(left, _)| *left > 0);
        let parts = parts.map(|(left, why)| format!("{} {why}", count(left, "record", "records")));
        let parts: Vec<String> = parts.collect();
        (!parts.is_empty()).then(|| format!("without {}", parts.join(" and ")))
    }

    /// Reads a log, twice: once for its columns, once for its CSI.
    ///
    /// # Errors
    /// If the log cannot be read. A log without a wanted record gives an empty course.
    pub fn read(path: &Path, wanted: &Wanted) -> Result<Self, Error> {
        let log = LogIndex::open(path)?;
        let rows: Vec<usize> =
            (0..log.t_us.len()).filter(|row| wanted.takes(log.sender_of(*row), log.t_s(*row))).collect();
        let times_s: Vec<f64> = rows.iter().map(|row| log.t_s(*row)).collect();
        let Some(span_s) = span_s(&times_s) else { return Ok(Self::default()) };
        // A map that mixes several senders' CSI would be meaningless.
        let sent_by = most_frequent(rows.iter().filter_map(|row| log.sent_by.get(*row).copied())).unwrap_or(0);
        let of_sender: Vec<usize> =
            rows.iter().copied().filter(|row| log.sent_by.get(*row) == Some(&sent_by)).collect();
        let usual = log.usual(of_sender.iter().copied());
        let drawn: Vec<usize> = of_sender.iter().copied().filter(|row| log.is_of_layout(*row, usual)).collect();
        let asked = |antenna: usize| {
            wanted.antennas.is_empty() || wanted.antennas.iter().any(|wanted| wanted.index() == antenna)
        };
        let heat = log.heat_rows(usual, PICTURE_ROWS);
        let maps = (0..log.ports).filter(|antenna| asked(*antenna)).count().max(1) * 2;
        let columns = drawn.len().clamp(1, COLUMNS).min(CELLS / (maps * heat.len().max(1))).max(1);
        let cells = log.cells(drawn.iter().copied(), (usual, &heat), span_s, columns)?;
        let antennas = cells.into_iter().enumerate().filter(|(antenna, _)| asked(*antenna));
        let inside = |row: usize| (span_s.0..=span_s.1).contains(&log.t_s(row));
        let own = |row: usize| inside(row) && (wanted.macs.is_empty() || wanted.macs.contains(&log.sender_of(row)));
        let marked = |marks: &[(usize, u64)], is_shown: &dyn Fn(usize) -> bool| -> Vec<(f64, u64)> {
            marks.iter().filter(|mark| is_shown(mark.0)).map(|mark| (log.t_s(mark.0), mark.1)).collect()
        };
        let thin = |value: &dyn Fn(usize) -> Option<i16>| -> Vec<(f64, f64)> {
            let every = rows.len().div_ceil(POINTS).max(1);
            let points = rows.iter().step_by(every).map(|row| (log.t_s(*row), value(*row)));
            points.filter_map(|(t_s, value)| Some((t_s, f64::from(value?)))).collect()
        };
        let marks = &log.marks;
        Ok(Self {
            records: rows.len() as u64,
            base: log.base,
            span_s,
            format: log.card().map(|(format, _)| format.name()),
            rows: heat,
            columns,
            antennas: antennas.filter_map(|(antenna, cells)| cells.course(antenna, span_s)).collect(),
            sender: log.senders.get(usize::from(sent_by)).copied().filter(|mac| *mac != Mac::default()),
            other_senders: (rows.len() - of_sender.len()) as u64,
            other_frames: (of_sender.len() - drawn.len()) as u64,
            rssi: (0..log.ports).map(|port| thin(&|row| log.rssi_of(row, port))).collect(),
            rssi_in_dbm: log.rssi_in_dbm,
            agc: thin(&|row| log.agc_of(row)),
            rate_hz: rate(&times_s, span_s),
            gaps_s: gaps(&times_s),
            missing: marked(&marks.missing, &inside),
            damaged: marked(&marks.damaged, &inside),
            skipped: marked(&marks.skipped, &own),
            repeated: marked(&marks.repeated, &own),
            steps_back: marks.steps_back.iter().filter(|m| inside(m.0)).map(|m| (log.t_s(m.0), m.1)).collect(),
        })
    }
}

/// The kind of a log, and its counters.
enum Source {
    Csitool(Box<Survey>),
    Card(Box<CardLog>),
}

/// An index of a log: 25 bytes a record and the CSI of 4,096 columns; CSI of shorter stretches is read again from the file.
pub struct LogIndex {
    path: PathBuf,
    /// The source of its times: with [`TimeBase::Number`] they are record numbers.
    pub base: TimeBase,
    source: Source,
    /// Its size, bytes.
    pub bytes: u64,
    /// Of each record: time since the log's first record, microseconds.
    t_us: Vec<i64>,
    /// Its offset in the file, bytes.
    offset: Vec<i64>,
    /// Number of antennas or receive chains in its CSI.
    pub ports: usize,
    /// A value per antenna and record.
    rssi: Vec<i16>,
    /// True if RSSI is in dBm, false if in dB above an unknown reference.
    pub rssi_in_dbm: bool,
    /// Empty if the format does not contain it.
    agc: Vec<u8>,
    /// The layout of its CSI; empty for a 5300, which has only one.
    layout_of: Vec<u16>,
    /// Its sender, an index into `senders`.
    sent_by: Vec<u16>,
    /// Its senders, in the order in which they were first heard; all zero stands for an unknown one.
    pub senders: Vec<Mac>,
    marks: Marks,
    /// First and last time, seconds after the first record.
    pub span_s: (f64, f64),
    gaps_s: Vec<(f64, f64)>,
    /// CSI of the whole log by antenna, in [`KEPT`] columns or fewer.
    kept: Option<Vec<Cells>>,
}

/// Losses and counter events, by the record at which they show.
#[derive(Default)]
struct Marks {
    /// Numbers of `bfee_count` missing before a record.
    missing: Vec<(usize, u64)>,
    /// The record before damaged bytes or an impossible record, each 1.
    damaged: Vec<(usize, u64)>,
    /// Frame numbers that the sender skipped.
    skipped: Vec<(usize, u64)>,
    repeated: Vec<(usize, u64)>,
    /// Backward steps of the card's clock, seconds.
    steps_back: Vec<(usize, f64)>,
}

impl Marks {
    fn of(columns: &Columns, survey: &Survey, damaged_after: &[u64]) -> Self {
        let mut marks = Self::default();
        let last = columns.len().saturating_sub(1);
        let before = |intact: &u64| ((*intact as usize).saturating_sub(1).min(last), 1);
        marks.damaged = damaged_after.iter().map(before).collect();
        let steps = columns.time_us.windows(2).enumerate();
        let back = steps.filter_map(|(k, pair)| Some((k + 1, pair.first()?.saturating_sub(*pair.get(1)?))));
        marks.steps_back = back.filter(|(_, us)| *us > 0).map(|(k, us)| (k, us as f64 * 1e-6)).collect();
        let mut count = Step16::default();
        for (k, number) in columns.bfee_count.iter().enumerate() {
            if let Some(step @ 2..) = count.step(*number).filter(|step| *step <= u16::MAX / 2) {
                marks.missing.push((k, u64::from(step - 1)));
            }
        }
        // Other programs' frames have no number in that place.
        let counting = survey.senders.iter().filter(|(_, sender)| Sender::counts_up(sender));
        let mut numbers: BTreeMap<Mac, Numbering> = counting.map(|(mac, _)| (*mac, Numbering::default())).collect();
        for (k, (mac, frame)) in macs(columns).zip(&columns.frame).enumerate() {
            let (Some(numbering), Ok(frame)) = (numbers.get_mut(&mac), u32::try_from(*frame)) else { continue };
            match numbering.note(frame) {
                NumberStep::Repeated => marks.repeated.push((k, 1)),
                NumberStep::Forward(step @ 2..) => marks.skipped.push((k, u64::from(step - 1))),
                NumberStep::Forward(_) | NumberStep::New | NumberStep::Back => {}
            }
        }
        marks
    }
}

/// Senders in the order in which they are first heard, and the sender of each record.
fn numbered(macs: impl Iterator<Item = Mac>) -> (Vec<Mac>, Vec<u16>) {
    let (mut senders, mut numbers) = (Vec::new(), BTreeMap::new());
    let sent_by = macs.map(|mac| {
        *numbers.entry(mac).or_insert_with(|| {
            if senders.len() < SENDERS {
                senders.push(mac);
            }
            senders.len().saturating_sub(1) as u16
        })
    });
    let sent_by = sent_by.collect();
    (senders, sent_by)
}

/// The sender of each record.
fn macs(columns: &Columns) -> impl Iterator<Item = Mac> {
    columns.mac.as_chunks::<6>().0.iter().map(|octets| Mac(*octets))
}

/// Time of each record since the first, microseconds, as in the survey (`csi5300 info`): backward steps of a clock count as
/// zero.
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

/// Lowest, mean and highest value of each column; `None` for an empty column.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Band {
    /// Lowest value.
    pub min: Vec<Option<i16>>,
    /// Mean, rounded to a hundredth.
    pub mean: Vec<Option<f64>>,
    /// Highest value.
    pub max: Vec<Option<i16>>,
}

/// A stretch of a log in columns of equal width.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Stretch {
    /// Its start, seconds after the log's first record ([`LogIndex::base`]); backward steps of the clock count as zero.
    pub from_s: f64,
    /// Its end, seconds.
    pub to_s: f64,
    /// Number of columns of `rssi`, `agc` and the losses.
    pub columns: usize,
    /// Records in it.
    pub records: usize,
    /// Records per second, in bins of equal width: `columns` of them, or fewer if there are few records.
    pub rate_hz: Vec<f64>,
    /// RSSI of each antenna as the card reports it, dB, without unconnected and unknown ones.
    pub rssi: Vec<Band>,
    /// Gain, dB.
    pub agc: Band,
    /// Columns with losses, and the count of numbers missing from `bfee_count`.
    pub missing: Vec<(usize, u64)>,
    /// Columns with damaged stretches or impossible records, and their count.
    pub damaged: Vec<(usize, u64)>,
    /// Columns in which the requested senders skipped frame numbers, and the count of numbers.
    pub skipped: Vec<(usize, u64)>,
    /// Columns with frames of theirs that repeat the previous number, and the count of frames.
    pub repeated: Vec<(usize, u64)>,
    /// Start and end of parts without a record, seconds.
    pub gaps_s: Vec<(f64, f64)>,
    /// Backward steps of the card's clock: time and size, seconds.
    pub steps_back: Vec<(f64, f64)>,
}

/// CSI of a stretch of a log.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StretchCsi {
    /// Its start, seconds.
    pub from_s: f64,
    /// Its end, seconds.
    pub to_s: f64,
    /// Columns of equal width.
    pub columns: usize,
    /// Records in it.
    pub records: usize,
    /// Every n-th record is in the means.
    pub every: usize,
    /// The meaning of the rows.
    #[serde(skip)]
    pub rows: HeatRows,
    /// Records with frames of another kind or width, whose CSI is not shown.
    pub other_frames: usize,
    /// The antennas with CSI.
    #[serde(skip)]
    pub antennas: Vec<AntennaCourse>,
}

impl LogIndex {
    /// Reads a log, twice: once for its columns, once for its CSI.
    ///
    /// # Errors
    /// If the log cannot be read. The span of a log without an intact record is empty.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let mut log = Self::open(path)?;
        let usual = log.usual(0..log.t_us.len());
        let heat = log.heat_rows(usual, PAGE_ROWS);
        let columns = (KEPT_CELLS / (log.ports * heat.len()).max(1)).clamp(1, KEPT);
        let own = (0..log.t_us.len()).filter(|row| log.is_of_layout(*row, usual));
        log.kept = Some(log.cells(own, (usual, &heat), log.span_s, columns)?);
        Ok(log)
    }

    /// Reads its columns.
    fn open(path: &Path) -> Result<Self, Error> {
        match cards::read(path) {
            Some((format, bytes)) => Ok(card::open(path, format, &bytes)),
            None => Self::open_csitool(path),
        }
    }

    fn open_csitool(path: &Path) -> Result<Self, Error> {
        let mut reading = Reading::new(Replay::open(path)?, Filter::default()).without_bodies();
        reading.read_all(Instant::ZERO, || true)?;
        let (_, columns) = reading.take();
        let base = reading.table.survey.time_base();
        let (senders, sent_by) = numbered(macs(&columns));
        let t_us = times_us(&columns, base);
        let times_s: Vec<f64> = t_us.iter().map(|us| *us as f64 * 1e-6).collect();
        Ok(Self {
            path: path.into(),
            base,
            bytes: reading.source.bytes(),
            marks: Marks::of(&columns, &reading.table.survey, &reading.table.damaged_after),
            source: Source::Csitool(Box::new(reading.table.survey)),
            span_s: span_s(&times_s).unwrap_or_default(),
            gaps_s: gaps(&times_s),
            t_us,
            offset: columns.offset,
            ports: Antenna::ALL.len(),
            // 0 means "not connected".
            rssi: columns.rssi.into_iter().map(|rssi| if rssi > 0 { i16::from(rssi) } else { NO_RSSI }).collect(),
            rssi_in_dbm: false,
            agc: columns.agc,
            layout_of: Vec::new(),
            sent_by,
            senders,
            kept: None,
        })
    }

    /// Everything counted in a 5300's log; `None` for another card's.
    #[must_use]
    pub fn survey(&self) -> Option<&Survey> {
        match &self.source {
            Source::Csitool(survey) => Some(survey),
            Source::Card(_) => None,
        }
    }

    /// The kind of another card's log, and everything counted in it.
    #[must_use]
    pub fn card(&self) -> Option<(Format, &CardSurvey)> {
        match &self.source {
            Source::Csitool(_) => None,
            Source::Card(card) => Some((card.format, &card.survey)),
        }
    }

    /// Records or frames with CSI.
    #[must_use]
    pub fn records(&self) -> usize {
        self.t_us.len()
    }

    /// The meaning of heat maps' rows, at most `most` of them, for frames of a layout.
    fn heat_rows(&self, layout: u16, most: usize) -> HeatRows {
        let survey = match &self.source {
            Source::Csitool(survey) => survey,
            Source::Card(card) => return card.heat_rows(layout, most),
        };
        let wide = survey.rates.keys().filter(|rate| *rate & HT40 != 0).count();
        HeatRows::new(
            indices(wide, survey.rates.len()).map(|indices| indices.map(i16::from).to_vec()),
            SUBCARRIERS,
            most,
        )
    }

    /// The most frequent layout of some rows.
    fn usual(&self, rows: impl Iterator<Item = usize>) -> u16 {
        most_frequent(rows.filter_map(|row| self.layout_of.get(row).copied())).unwrap_or(0)
    }

    /// True if a row's CSI has this layout.
    fn is_of_layout(&self, row: usize, layout: u16) -> bool {
        self.layout_of.get(row).is_none_or(|own| *own == layout)
    }

    /// Indices of the reported subcarriers relative to the centre, for most frames; `None` if a 5300's log has frames of both
    /// widths.
    #[must_use]
    pub fn subcarriers(&self) -> Option<Vec<i16>> {
        self.heat_rows(self.usual(0..self.t_us.len()), usize::MAX).indices
    }

    fn t_s(&self, row: usize) -> f64 {
        self.t_us.get(row).copied().unwrap_or(0) as f64 * 1e-6
    }

    fn rssi_of(&self, row: usize, port: usize) -> Option<i16> {
        self.rssi.get(row * self.ports + port).copied().filter(|rssi| *rssi != NO_RSSI)
    }

    fn agc_of(&self, row: usize) -> Option<i16> {
        self.agc.get(row).copied().map(i16::from)
    }

    /// Number and rate of each sender's records, in the order of [`Self::senders`], between its first and its last; no rate without
    /// a clock, or for a single record.
    #[must_use]
    pub fn sent(&self) -> Vec<(u64, Option<f64>)> {
        let mut sent = vec![(0_u64, i64::MAX, i64::MIN); self.senders.len()];
        for (number, t_us) in self.sent_by.iter().zip(&self.t_us) {
            if let Some((count, first, last)) = sent.get_mut(usize::from(*number)) {
                (*count, *first, *last) = (*count + 1, *t_us.min(first), *t_us.max(last));
            }
        }
        let rate = |(count, first, last): (u64, i64, i64)| {
            let long_s = last.saturating_sub(first) as f64 * 1e-6;
            (count, (long_s > 0.0 && self.base != TimeBase::Number).then(|| count.saturating_sub(1) as f64 / long_s))
        };
        sent.into_iter().map(rate).collect()
    }

    fn sender_of(&self, row: usize) -> Mac {
        let number = self.sent_by.get(row).copied().unwrap_or(0);
        self.senders.get(usize::from(number)).copied().unwrap_or_default()
    }

    /// The part of a stretch that lies in the log, and its rows.
    fn cut(&self, from_s: f64, to_s: f64) -> ((f64, f64), Range<usize>) {
        let cut = (from_s.max(self.span_s.0), to_s.min(self.span_s.1));
        if cut.0 >= cut.1 || self.t_us.is_empty() {
            return (self.span_s, 0..self.t_us.len());
        }
        let first = self.t_us.partition_point(|us| (*us as f64 * 1e-6) < cut.0);
        let end = self.t_us.partition_point(|us| *us as f64 * 1e-6 <= cut.1);
        (cut, first..end)
    }

    /// True if `sender` sent the row, or no sender is requested.
    fn is_of(&self, row: usize, sender: Option<Mac>) -> bool {
        sender.is_none_or(|mac| self.sender_of(row) == mac)
    }

    /// Levels and losses between two times in about `columns` columns, each with at least two records, for one sender or all.
    /// Numbers missing from `bfee_count` and damage belong to no sender and are always included. A stretch outside the log means
    /// the whole log.
    #[must_use]
    pub fn stretch(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Stretch {
        let (cut, rows) = self.cut(from_s, to_s);
        let own = || rows.clone().filter(|row| self.is_of(*row, sender));
        let records = own().count();
        let columns = fitting(columns, records);
        let mut agc = Sums::new(columns);
        let mut rssi: Vec<Sums> = (0..self.ports).map(|_| Sums::new(columns)).collect();
        let mut rates = vec![0_u32; (records / RECORDS_A_BIN).clamp(1, columns)];
        let bins = rates.len();
        for row in own() {
            let column = bin(self.t_s(row), cut, columns);
            self.agc_of(row).into_iter().for_each(|value| agc.add(column, value));
            for (port, sums) in rssi.iter_mut().enumerate() {
                self.rssi_of(row, port).into_iter().for_each(|value| sums.add(column, value));
            }
            rates[bin(self.t_s(row), cut, bins)] += 1;
        }
        let width_s = (cut.1 - cut.0).max(1e-6) / bins as f64;
        let inside = |t_s: &f64| (cut.0..=cut.1).contains(t_s);
        let counted = |marks: &[(usize, u64)], sender: Option<Mac>| {
            let mut found = BTreeMap::new();
            for (row, count) in marks.iter().filter(|mark| inside(&self.t_s(mark.0)) && self.is_of(mark.0, sender)) {
                *found.entry(bin(self.t_s(*row), cut, columns)).or_default() += count;
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
            rssi: rssi.into_iter().map(Sums::band).collect(),
            agc: agc.band(),
            missing: counted(&marks.missing, None),
            damaged: counted(&marks.damaged, None),
            skipped: counted(&marks.skipped, sender),
            repeated: counted(&marks.repeated, sender),
            gaps_s: self.gaps_s.iter().filter(|(from, to)| *to >= cut.0 && *from <= cut.1).copied().collect(),
            steps_back: marks.steps_back.iter().map(|m| (self.t_s(m.0), m.1)).filter(|m| inside(&m.0)).collect(),
        }
    }

    /// CSI between two times in about `columns` columns, each with at least two records, for one sender or all. A stretch outside
    /// the log means the whole log.
    ///
    /// # Errors
    /// If the file cannot be read again.
    pub fn csi(&self, from_s: f64, to_s: f64, columns: usize, sender: Option<Mac>) -> Result<StretchCsi, Error> {
        let (cut, rows) = self.cut(from_s, to_s);
        // From the whole log, so that it is the same in every stretch.
        let usual = self.usual((0..self.t_us.len()).filter(|row| self.is_of(*row, sender)));
        let heat = self.heat_rows(usual, PAGE_ROWS);
        let records = rows.clone().filter(|row| self.is_of(*row, sender)).count();
        let own = || rows.clone().filter(|row| self.is_of(*row, sender) && self.is_of_layout(*row, usual));
        let drawn = own().count();
        let columns = fitting(columns, drawn);
        let kept_s = self
            .kept
            .as_ref()
            .and_then(|kept| kept.first())
            .map_or(f64::INFINITY, |kept| (self.span_s.1 - self.span_s.0) / kept.counts.len() as f64);
        let (cells, every) = match &self.kept {
            Some(kept) if sender.is_none() && (cut.1 - cut.0) / columns as f64 >= kept_s => {
                (kept.iter().map(|own| own.stretch(self.span_s, cut, columns)).collect(), 1)
            }
            _ => {
                let every = drawn.div_ceil(READ).max(1);
                (self.cells(own().step_by(every), (usual, &heat), cut, columns)?, every)
            }
        };
        let antennas =
            cells.into_iter().enumerate().filter_map(|(antenna, cells)| cells.course(antenna, cut)).collect();
        let (from_s, to_s) = cut;
        Ok(StretchCsi { from_s, to_s, columns, records, every, rows: heat, other_frames: records - drawn, antennas })
    }

    /// CSI of rows of one layout, read from the file, by antenna. A row whose record is gone has none.
    fn cells(
        &self,
        rows: impl Iterator<Item = usize>,
        (layout, heat): (u16, &HeatRows),
        span_s: (f64, f64),
        columns: usize,
    ) -> Result<Vec<Cells>, Error> {
        let again = |source| Error::Io { what: format!("cannot read the log {} again", self.path.display()), source };
        let column = |row: usize| bin(self.t_s(row), span_s, columns);
        if let Source::Card(card) = &self.source {
            let bytes = std::fs::read(&self.path).map_err(again)?;
            let places = rows.map(|row| (self.offset.get(row).copied().unwrap_or(-1), column(row)));
            return Ok(card.cells(&bytes, places, (layout, heat), self.ports, columns));
        }
        let mut log = LogReader::open(&self.path).map_err(again)?;
        let mut decoder = Decoder::new(Order::SubcarriersLast, Rows::new(&Antenna::ALL, 1), Form::default());
        let each = vec![1.0; SUBCARRIERS];
        let mut cells = vec![Cells::new(columns, each); Antenna::ALL.len()];
        let mut h = [[Complex32::default(); SUBCARRIERS]; 3];
        for row in rows {
            let Some(bfee) = log.bfee(self.offset.get(row).copied().unwrap_or(-1)).map_err(again)? else { continue };
            let Ok(used) = bfee.antennas() else { continue };
            decoder.decode(&bfee, h.as_flattened_mut());
            for ((antenna, cells), h) in Antenna::ALL.into_iter().zip(&mut cells).zip(&h) {
                if used.chain_of(antenna).is_some() {
                    cells.add(column(row), h[SUBCARRIERS / 2], h.iter().copied().enumerate());
                }
            }
        }
        Ok(cells)
    }
}

/// Sums one antenna's CSI in cells over time and subcarrier, `[column][row]`, so that a record touches neighbouring cells only.
#[derive(Clone)]
struct Cells {
    amplitude: Vec<f64>,
    phase: Vec<Complex32>,
    counts: Vec<u32>,
    /// Number of a record's subcarriers in each row.
    each: Vec<f64>,
}

impl Cells {
    fn new(columns: usize, each: Vec<f64>) -> Self {
        let cells = each.len() * columns;
        Self { amplitude: vec![0.0; cells], phase: vec![Complex32::default(); cells], counts: vec![0; columns], each }
    }

    /// Adds a record, from its middle subcarrier and its values by row.
    fn add(&mut self, column: usize, middle: Complex32, h: impl Iterator<Item = (usize, Complex32)>) {
        let rows = self.each.len();
        let (Some(count), Some(amplitudes), Some(phases)) = (
            self.counts.get_mut(column),
            self.amplitude.chunks_exact_mut(rows).nth(column),
            self.phase.chunks_exact_mut(rows).nth(column),
        ) else {
            return;
        };
        *count += 1;
        for (row, value) in h {
            let (Some(amplitude), Some(phase)) = (amplitudes.get_mut(row), phases.get_mut(row)) else { continue };
            *amplitude += f64::from(value.norm_sqr().sqrt());
            let turned = value * middle.conj();
            let size = turned.norm_sqr().sqrt();
            if size > 0.0 {
                *phase += turned / size;
            }
        }
    }

    /// The columns over `span_s` that overlap a part of it, out of `columns`.
    fn stretch(&self, span_s: (f64, f64), cut: (f64, f64), columns: usize) -> Self {
        let (own, rows) = (self.counts.len(), self.each.len());
        let width_s = (span_s.1 - span_s.0) / own as f64;
        let mut cells = Self::new(columns, self.each.clone());
        for from in 0..own {
            let middle_s = span_s.0 + (from as f64 + 0.5) * width_s;
            if middle_s < cut.0 - 0.5 * width_s || middle_s > cut.1 + 0.5 * width_s {
                continue;
            }
            let to = bin(middle_s, cut, columns);
            cells.counts[to] += self.counts[from];
            for k in 0..rows {
                let (to, from) = (to * rows + k, from * rows + k);
                cells.amplitude[to] += self.amplitude[from];
                cells.phase[to] += self.phase[from];
            }
        }
        cells
    }

    /// The means over a span; NaN in empty columns. `None` if everything is silent.
    fn course(self, antenna: usize, span_s: (f64, f64)) -> Option<AntennaCourse> {
        let (columns, rows) = (self.counts.len(), self.each.len());
        let at = |cell: usize| (cell % columns) * rows + cell / columns;
        let count = |cell: usize| f64::from(self.counts[cell % columns]) * self.each[cell / columns];
        let mean = |cell: usize| if count(cell) > 0.0 { self.amplitude[at(cell)] / count(cell) } else { f64::NAN };
        let db = |value: f64| if value > 0.0 { 20.0 * value.log10() } else { f64::NAN };
        let cells = rows * columns;
        let middle = |column: usize| span_s.0 + (column as f64 + 0.5) * (span_s.1 - span_s.0) / columns as f64;
        let values: f64 = self.each.iter().sum();
        let over = |column: usize| {
            let sum = self.amplitude.chunks_exact(rows).nth(column).map_or(0.0, |own| own.iter().sum::<f64>());
            sum / (f64::from(self.counts[column]) * values)
        };
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

/// Lowest, highest and sum of some values.
#[derive(Clone, Copy)]
struct Level {
    min: i16,
    max: i16,
    sum: i64,
    count: u32,
}

/// The values of each column; `None` for an empty one.
struct Sums(Vec<Option<Level>>);

impl Sums {
    fn new(columns: usize) -> Self {
        Self(vec![None; columns])
    }

    fn add(&mut self, column: usize, value: i16) {
        let level = self.0[column].get_or_insert(Level { min: value, max: value, sum: 0, count: 0 });
        level.min = level.min.min(value);
        level.max = level.max.max(value);
        level.sum += i64::from(value);
        level.count += 1;
    }

    /// The columns; none at all if all are empty.
    fn band(self) -> Band {
        let mut columns = self.0;
        if columns.iter().all(Option::is_none) {
            columns.clear();
        }
        let mean = |level: &Level| hundredths(level.sum as f64 / f64::from(level.count));
        Band {
            min: columns.iter().map(|column| column.map(|level| level.min)).collect(),
            max: columns.iter().map(|column| column.map(|level| level.max)).collect(),
            mean: columns.iter().map(|column| column.as_ref().map(mean)).collect(),
        }
    }
}

/// As many columns as requested, but at least two records each: with fewer, columns are empty by chance.
fn fitting(columns: usize, records: usize) -> usize {
    columns.clamp(1, MOST_COLUMNS).min(records.div_ceil(2).max(1))
}

fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// First and last time, seconds; never equal.
fn span_s(times_s: &[f64]) -> Option<(f64, f64)> {
    let (first, last) = times_s.first().zip(times_s.last())?;
    Some((*first, last.max(first + 1e-6)))
}

fn bin(t_s: f64, span_s: (f64, f64), bins: usize) -> usize {
    (((t_s - span_s.0) / (span_s.1 - span_s.0) * bins as f64) as usize).min(bins - 1)
}

fn rate(times_s: &[f64], span_s: (f64, f64)) -> Vec<(f64, f64)> {
    // No more bins than the number of records supports.
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
mod tests {
    use super::*;
    use crate::temporary::{Temporary, fixture};
    use csi_formats::{Kind, Tones, feitcsi};
    use csi5300::source::{CsiSource, Next, replay::Replay};
    use csi5300::time::Instant;
    use driver_iface::bfee::{Iq, Repr, Wsr};
    use driver_iface::record::{Record, code};

    /// A record: card's clock, host time (whole microseconds; 0 for none), frame number.
    type Told = (u32, u64, u32);

    /// A sender.
    const fn sender(number: u8) -> Mac {
        Mac([2, 0, 0, 0, 0, number])
    }

    /// A log of one sender's records, in a file of its own.
    fn log(records: impl Iterator<Item = Told>) -> Temporary {
        log_of(records.map(|told| (sender(1), told)))
    }

    /// A log of several senders' records.
    fn log_of(records: impl Iterator<Item = (Mac, Told)>) -> Temporary {
        let mut bytes = Vec::new();
        for (k, (mac, (timestamp_low, host_us, frame_count))) in records.enumerate() {
            let (tv_sec, tv_usec) = ((host_us / 1_000_000) as u32, (host_us % 1_000_000) as u32);
            let wsr = Some(Wsr { tv_sec, tv_usec, mac, frame_count: Some(frame_count) });
            let repr = Repr { timestamp_low, bfee_count: k as u16, rssi: [38, 30, 31], wsr, ..Repr::default() };
            let csi = vec![Iq { i: 40, q: 9 }; repr.samples()];
            let mut body = vec![0; repr.body_len()];
            repr.emit(&csi, &mut body).unwrap();
            let record = Record { code: code::BFEE, body: &body };
            let at = bytes.len();
            bytes.resize(at + record.emit_len(), 0);
            record.emit(&mut bytes[at..]).unwrap();
        }
        Temporary::file("course.dat", &bytes)
    }

    /// What `csi5300 info` reports of a log.
    fn survey(path: &Path) -> Survey {
        let (mut source, mut survey) = (Replay::open(path).unwrap(), Survey::default());
        loop {
            let next = source.receive(Instant::ZERO).unwrap();
            survey.note(&next);
            if matches!(next, Next::End(_)) {
                return survey;
            }
        }
    }

    /// Records between two times, seconds.
    fn cut(from_s: Option<f64>, to_s: Option<f64>) -> Wanted {
        Wanted { from_s, to_s, ..Wanted::default() }
    }

    const START_US: u64 = 1_700_000_000_000_000;

    /// Checks that `info`, its pictures and `view` agree on a log's times; returns the picture's data.
    fn agreed(log: Temporary) -> Course {
        let path = &log.0;
        let (survey, index) = (survey(path), LogIndex::read(path).unwrap());
        let course = Course::read(path, &Wanted::default()).unwrap();
        let stretch = index.stretch(0.0, f64::INFINITY, 100, None);
        let long_s = survey.elapsed_us(survey.time_base()) as f64 * 1e-6;
        assert!((course.span_s.1 - course.span_s.0 - long_s).abs() < 1e-9, "{:?} {long_s}", course.span_s);
        assert_eq!((course.span_s, course.base), (index.span_s, index.base));
        assert_eq!(course.base, survey.time_base());
        let back = [course.steps_back.len(), stretch.steps_back.len()];
        assert_eq!(back, [survey.clock_steps.steps_back as usize; 2]);
        let sender = survey.senders.values().next().unwrap();
        let sum = |marks: &[(usize, u64)]| marks.iter().map(|mark| mark.1).sum::<u64>();
        let counted = |count: u64| if sender.counts_up() { count } else { 0 };
        assert_eq!(
            [course.skipped.iter().map(|mark| mark.1).sum(), sum(&stretch.skipped)],
            [counted(sender.frames_skipped); 2]
        );
        assert_eq!([course.repeated.len() as u64, sum(&stretch.repeated)], [counted(sender.frames_repeated); 2]);
        assert_eq!((&course.gaps_s, &course.steps_back), (&stretch.gaps_s, &stretch.steps_back));
        course
    }

    #[test]
    fn every_view_shows_the_same_pause_of_an_hour() {
        // The card's clock advances by more than half its range in the pause: only the host's clock shows that it went forward.
        let told = |k: u32| {
            let pause = if k < 50 { 0 } else { 3_553_500_000_u64 };
            let clock = u64::from(4_000_000_000 + 4_000 * k) + pause;
            (clock as u32, START_US + 4_000 * u64::from(k) + pause, k)
        };
        let course = agreed(log((0..100).map(told)));
        assert!(course.steps_back.is_empty() && course.gaps_s.len() == 1, "{:?}", course.gaps_s);
        assert!((course.gaps_s[0].1 - course.gaps_s[0].0 - 3_553.504).abs() < 1e-6, "{:?}", course.gaps_s);
    }

    #[test]
    fn a_clock_that_steps_back_is_seen_once_and_takes_no_time() {
        let told = |k: u32| (1_000_000 + 4_000 * k - if k < 50 { 0 } else { 900_000 }, 0, k);
        let course = agreed(log((0..100).map(told)));
        assert_eq!(course.steps_back.len(), 1);
        assert!((course.steps_back[0].1 - 0.896).abs() < 1e-9, "{:?}", course.steps_back);
    }

    #[test]
    fn without_a_card_clock_times_are_the_hosts_or_record_numbers() {
        // Some programs write 0, others add 1 now and then.
        let host = agreed(log((0..100).map(|k| (k / 10, START_US + 10_000 * u64::from(k), k))));
        assert_eq!((host.base, host.columns), (TimeBase::Host, 100));
        assert!((host.span_s.1 - 0.99).abs() < 1e-9, "{:?}", host.span_s);
        let number = agreed(log((0..29).map(|k| (0, 0, k))));
        assert_eq!((number.base, number.span_s, number.columns), (TimeBase::Number, (0.0, 28.0), 29));
        assert!(number.gaps_s.is_empty());
        // One column for each record, no empty column between them.
        assert!(number.antennas[0].amplitude_db.iter().all(|db| db.is_finite()), "{:?}", number.antennas[0].line_db);
    }

    #[test]
    fn skipped_and_repeated_frame_numbers_are_marked_in_place() {
        let number = |k: u32| if k < 20 { k } else { k + 3 } - u32::from(k >= 40);
        let course = agreed(log((0..60).map(|k| (1_000 * k, 0, number(k)))));
        assert_eq!((&course.skipped, &course.repeated), (&vec![(0.02, 3)], &vec![(0.04, 1)]));
        // Values that do not count up are not frame numbers.
        let random = |k: u32| (1_000 * k, 0, k.wrapping_mul(2_654_435_761) ^ 0x5bd1_e995);
        let course = agreed(log((0..60).map(random)));
        assert!(course.skipped.is_empty() && course.repeated.is_empty());
    }

    #[test]
    fn a_stretch_has_its_csi_with_any_clock() {
        // By the card's clock, no record lies after 0.5 s, or at 20 s and later.
        let host = |k: u32| (k / 10, START_US + 10_000 * u64::from(k), k);
        let path = &log((0..100).map(host)).0;
        let course = Course::read(path, &cut(Some(0.5), None)).unwrap();
        assert_eq!((course.base, course.records, course.antennas.len()), (TimeBase::Host, 50, 3));
        let path = &log((0..29).map(|k| (0, 0, k))).0;
        let course = Course::read(path, &cut(Some(20.0), Some(24.0))).unwrap();
        assert_eq!((course.base, course.records, course.antennas.len()), (TimeBase::Number, 5, 3));
        assert_eq!(course.antennas[0].line_db.len(), 5);
    }

    #[test]
    fn numbers_skipped_outside_the_selection_are_not_counted() {
        // Two senders alternate, a record a millisecond. The first skips 3 at 20 ms and 5 at 60 ms and repeats one at 30 ms; the other
        // skips 7 at 41 ms.
        let told = |k: u32| {
            let own = k / 2;
            let number = match k % 2 {
                0 => own + if own >= 10 { 3 } else { 0 } + if own >= 30 { 5 } else { 0 } - u32::from(own >= 15),
                _ => own + if own >= 20 { 7 } else { 0 },
            };
            (sender(1 + (k % 2) as u8), (1_000_000 + 1_000 * k, 0, number))
        };
        let path = &log_of((0..100).map(told)).0;
        let ms = |t_s: f64| (1_000.0 * t_s).round() as u32;
        let read = |wanted: Wanted| {
            let course = Course::read(path, &wanted).unwrap();
            let skipped: Vec<_> = course.skipped.iter().map(|(t_s, count)| (ms(*t_s), *count)).collect();
            (skipped, course.repeated.iter().map(|(t_s, _)| ms(*t_s)).collect::<Vec<_>>())
        };
        assert_eq!(read(Wanted::default()), (vec![(20, 3), (41, 7), (60, 5)], vec![30]));
        assert_eq!(read(cut(Some(0.05), None)), (vec![(60, 5)], vec![]));
        assert_eq!(read(cut(Some(0.025), Some(0.05))), (vec![(41, 7)], vec![30]));
        assert_eq!(read(Wanted { macs: vec![sender(2)], ..Wanted::default() }), (vec![(41, 7)], vec![]));
        let own = Wanted { macs: vec![sender(1)], ..cut(Some(0.045), None) };
        assert_eq!(read(own), (vec![(60, 5)], vec![]));

        // The same for a stretch of one chosen sender.
        let index = LogIndex::read(path).unwrap();
        let counts = |sender: Option<Mac>| {
            let stretch = index.stretch(0.0, f64::INFINITY, 50, sender);
            [stretch.skipped, stretch.repeated].map(|marks| marks.iter().map(|mark| mark.1).sum::<u64>())
        };
        assert_eq!([None, Some(sender(1)), Some(sender(2))].map(counts), [[15, 1], [8, 1], [7, 0]]);
    }

    /// The fixture without some of its bytes, in a file of its own.
    fn without(bytes: std::ops::Range<usize>) -> Temporary {
        let mut log = std::fs::read(fixture()).unwrap();
        log.drain(bytes);
        Temporary::file("index.dat", &log)
    }

    #[test]
    fn every_record_is_in_one_column_of_one_stretch() {
        let index = LogIndex::read(&fixture()).unwrap();
        let (from_s, to_s) = index.span_s;
        let whole = index.stretch(from_s, to_s, 50, None);
        assert_eq!(whole.records as u64, index.survey().unwrap().bfees());
        let width_s = (to_s - from_s) / whole.rate_hz.len() as f64;
        let counted: f64 = whole.rate_hz.iter().map(|rate| rate * width_s).sum();
        assert!((counted - whole.records as f64).abs() < 0.1, "{counted}");
        let middle_s = 0.5 * (from_s + to_s) + 1e-7;
        let parts = [(from_s, middle_s), (middle_s, to_s)].map(|(a, b)| index.stretch(a, b, 50, None).records);
        assert_eq!(parts[0] + parts[1], whole.records);
        let band = &whole.rssi[0];
        let survey = index.survey().unwrap().rssi[0].unwrap();
        assert_eq!(band.min.iter().flatten().min().map(|rssi| i32::from(*rssi)), Some(survey.min));
        assert_eq!(band.max.iter().flatten().max().map(|rssi| i32::from(*rssi)), Some(survey.max));
        for ((low, mean), high) in band.min.iter().zip(&band.mean).zip(&band.max) {
            let (Some(low), Some(mean), Some(high)) = (low, mean, high) else { continue };
            assert!(f64::from(*low) <= *mean && *mean <= f64::from(*high));
        }
    }

    #[test]
    fn kept_csi_equals_csi_read_again() {
        let index = LogIndex::read(&fixture()).unwrap();
        let (from_s, to_s) = index.span_s;
        let [sender] = index.senders.as_slice() else { panic!("{:?}", index.senders.as_slice()) };
        let kept = index.csi(from_s, to_s, 1, None).unwrap();
        let again = index.csi(from_s, to_s, 1, Some(*sender)).unwrap();
        assert_eq!((kept.records, kept.every, kept.antennas.len()), (again.records, again.every, again.antennas.len()));
        for (a, b) in kept.antennas.iter().zip(&again.antennas) {
            let amplitudes = a.amplitude_db.iter().zip(&b.amplitude_db);
            assert!(amplitudes.clone().count() == 30 && amplitudes.clone().all(|(a, b)| (a - b).abs() < 1e-9));
            assert!(a.phase_rad.iter().zip(&b.phase_rad).all(|(a, b)| (a - b).abs() < 1e-4));
        }
        // A short stretch is read again for any sender, at least two records a column.
        let near = index.csi(from_s, from_s + 0.05, 500, None).unwrap();
        assert!(near.records > 2 && near.columns == near.records.div_ceil(2) && near.every == 1, "{near:?}");
        let own = &near.antennas[0].line_db;
        assert!(own.len() > near.columns / 2, "{own:?}");
    }

    #[test]
    fn losses_are_marked_in_place() {
        let whole = LogIndex::read(&fixture()).unwrap();
        let at = |k: usize| whole.offset[k] as usize;
        // Three records, and later part of one.
        let gone = without(at(100)..at(103));
        let index = LogIndex::read(&gone.0).unwrap();
        let (from_s, to_s) = index.span_s;
        let stretch = index.stretch(from_s, to_s, 1_000, None);
        assert_eq!(stretch.columns, stretch.records.div_ceil(2));
        let column = |row: usize| bin(whole.t_s(row), (from_s, to_s), stretch.columns);
        assert_eq!(stretch.missing, [(column(103), 3)]);
        assert!(stretch.damaged.is_empty());

        let torn = without(at(200) + 40..at(200) + 90);
        let index = LogIndex::read(&torn.0).unwrap();
        let stretch = index.stretch(0.0, f64::INFINITY, 100, None);
        assert_eq!(stretch.damaged.iter().map(|(_, count)| count).sum::<u64>(), index.survey().unwrap().damages);
        assert!(!stretch.damaged.is_empty());
        // After the damage each row still finds its record.
        let (later_s, end_s) = (index.t_s(210), index.span_s.1);
        let sender = index.senders[0];
        let behind = index.csi(later_s, end_s, 10, Some(sender)).unwrap();
        assert!(behind.antennas[0].amplitude_db.iter().all(|db| db.is_finite()), "{behind:?}");
    }

    /// A frame of an AX2xx: kind, width in MHz, receive chains, sender; frames are 1 ms apart by the card's clock.
    type Heard = (Kind, u16, u8, u8);

    /// A FeitCSI log: chain k has an amplitude of `100 * (k + 1)` and a delay of `SLOPE_RAD` per subcarrier index. Subcarriers that
    /// are not measured have noise of ten times that amplitude.
    fn card_log(frames: &[Heard]) -> Temporary {
        let mut bytes = Vec::new();
        for (k, (kind, width_mhz, n_rx, sender)) in frames.iter().enumerate() {
            let tones = Tones::of(*kind, *width_mhz).unwrap();
            let repr = feitcsi::Repr {
                ftm: k as u32 * 320_000,
                host_us: START_US + 1_000 * k as u64,
                n_rx: *n_rx,
                n_tx: 1,
                kind: *kind,
                width_mhz: *width_mhz,
                mcs: 0,
                rssi_dbm: [-40 - i16::from(*sender), -50],
                sender: [2, 0, 0, 0, 0, *sender],
                clock_us: 1_000 * k as u32,
            };
            let value = |chain: u8, index: i16, is_data: bool| {
                let size = if is_data { 100.0 * (f64::from(chain) + 1.0) } else { 1_000.0 };
                let (sin, cos) = (0.5 - SLOPE_RAD * f64::from(index)).sin_cos();
                [cos, sin].map(|part| (size * part).round() as i16)
            };
            let csi: Vec<[i16; 2]> = (0..*n_rx)
                .flat_map(|chain| {
                    tones
                        .subcarriers
                        .iter()
                        .zip(&tones.data)
                        .map(move |(index, is_data)| value(chain, *index, *is_data))
                })
                .collect();
            repr.emit(&csi, &mut bytes);
        }
        Temporary::file("course.csi", &bytes)
    }

    const SLOPE_RAD: f64 = 0.05;

    #[test]
    fn other_cards_subcarriers_are_at_their_indices_and_unmeasured_ones_empty() {
        let path = &card_log(&[(Kind::Ht, 20, 2, 1); 40]).0;
        let course = Course::read(path, &Wanted::default()).unwrap();
        assert_eq!((course.records, course.base, course.format), (40, TimeBase::Card, Some("FeitCSI")));
        assert!((course.span_s.1 - 0.039).abs() < 1e-9, "{:?}", course.span_s);
        let indices = course.rows.indices.clone().unwrap();
        assert_eq!((indices.len(), indices[0], indices[28], course.rows.each), (56, -28, 1, 1));
        assert_eq!((course.sender, course.rows.frames.as_deref()), (Some(sender(1)), Some("HT 20 MHz")));
        assert_eq!((course.antennas.len(), course.left_out()), (2, None));
        for (antenna, own) in course.antennas.iter().enumerate() {
            let db = 20.0 * (100.0 * (antenna as f64 + 1.0)).log10();
            for (row, index) in indices.iter().enumerate() {
                let cells = row * course.columns..(row + 1) * course.columns;
                if [7, 21].contains(&index.abs()) {
                    assert!(own.amplitude_db[cells].iter().all(|value| value.is_nan()), "a pilot at {index}");
                    continue;
                }
                assert!(
                    own.amplitude_db[cells.clone()].iter().all(|value| (value - db).abs() < 0.1),
                    "{antenna} {index}"
                );
                let expected = -SLOPE_RAD * f64::from(index - 1);
                assert!(own.phase_rad[cells].iter().all(|value| (value - expected).abs() < 0.02), "{antenna} {index}");
            }
            assert!(own.line_db.iter().all(|point| (point.1 - db).abs() < 0.1), "{:?}", own.line_db);
        }
        assert!(course.rssi_in_dbm && course.agc.is_empty());
        let levels: Vec<f64> = course.rssi.iter().map(|line| line[0].1).collect();
        assert_eq!((levels, course.rssi[1].len()), (vec![-41.0, -50.0], 40));
        // The page gets the same, from the kept CSI and from the file.
        let index = LogIndex::read(path).unwrap();
        assert!(index.survey().is_none() && index.card().is_some_and(|(_, survey)| survey.frames == 40));
        assert_eq!((index.ports, index.sent()[0].0, index.subcarriers().unwrap().len()), (2, 40, 56));
        assert!((index.sent()[0].1.unwrap() - 1_000.0).abs() < 1e-6);
        let [kept, again] = [None, Some(sender(1))].map(|sender| index.csi(0.0, 1.0, 20, sender).unwrap());
        assert_eq!((kept.antennas.len(), &kept.rows), (2, &course.rows));
        for (a, b) in kept.antennas.iter().zip(&again.antennas) {
            let same = |(a, b): (&f64, &f64)| a.is_nan() && b.is_nan() || (a - b).abs() < 1e-4;
            assert!(
                a.amplitude_db.iter().zip(&b.amplitude_db).all(same) && a.phase_rad.iter().zip(&b.phase_rad).all(same)
            );
        }
        let band = &index.stretch(0.0, 1.0, 20, None).rssi;
        assert_eq!((band.len(), band[0].min[0], band[1].max[0]), (2, Some(-41), Some(-50)));
    }

    #[test]
    fn heat_maps_show_one_sender_and_its_most_frequent_frames() {
        let ht = (Kind::Ht, 20, 2, 1);
        let frames: Vec<Heard> = (0..60)
            .map(|k| match k % 6 {
                // Of the most frequent sender's frames, one in five is wider, and one in five has one chain.
                0 => (Kind::Ht, 40, 2, 1),
                1 => (Kind::Ht, 20, 1, 1),
                2 => (Kind::Vht, 80, 2, 2),
                _ => ht,
            })
            .collect();
        let path = &card_log(&frames).0;
        let course = Course::read(path, &Wanted::default()).unwrap();
        assert_eq!((course.records, course.other_senders, course.other_frames), (60, 10, 10));
        assert_eq!((course.sender, course.rows.subcarriers, course.antennas.len()), (Some(sender(1)), 56, 2));
        let words = course.left_out().unwrap();
        assert_eq!(words, "without 10 records of other senders and 10 records of another kind or width");
        // The levels include all of them.
        assert_eq!((course.rssi[0].len(), course.rssi[1].len()), (60, 50));
        let other = Course::read(path, &Wanted { macs: vec![sender(2)], ..Wanted::default() }).unwrap();
        assert_eq!((other.records, other.other_senders, other.left_out()), (10, 0, None));
        // 242 subcarriers, two a row.
        assert_eq!((other.rows.subcarriers, other.rows.each, other.rows.len()), (242, 2, 121));
        assert_eq!(other.antennas[0].amplitude_db.len(), 121 * other.columns);
        assert!(
            other.antennas[0].amplitude_db.iter().all(|db| (db - 40.0).abs() < 0.1),
            "pilots are no part of the means"
        );
        let index = LogIndex::read(path).unwrap();
        let all = index.csi(0.0, 1.0, 10, None).unwrap();
        assert_eq!((all.records, all.other_frames, all.rows.subcarriers), (60, 20, 56));
        let own = index.csi(0.0, 1.0, 10, Some(sender(2))).unwrap();
        assert_eq!((own.records, own.other_frames, own.rows.subcarriers), (10, 0, 242));
    }

    #[test]
    fn damage_in_another_cards_log_is_marked_in_place() {
        let path = &card_log(&[(Kind::Ht, 20, 1, 1); 20]).0;
        let mut bytes = std::fs::read(path).unwrap();
        let len = bytes.len() / 20;
        bytes.drain(10 * len + 300..10 * len + 350);
        std::fs::write(path, bytes).unwrap();
        let course = Course::read(path, &Wanted::default()).unwrap();
        assert_eq!(course.records, 19);
        // The tenth frame takes its missing bytes from the next; the rest of that is damage.
        let [(damaged_s, 1)] = course.damaged[..] else { panic!("{:?}", course.damaged) };
        assert!((damaged_s - 0.010).abs() < 1e-9, "{damaged_s}");
    }
}
