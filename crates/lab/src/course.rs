//! A log over time, binned for pictures: CSI of each antenna over time and subcarrier, RSSI and gain, rate, and where
//! something is missing. A log of any length takes the memory of its bins and of one short row a record.

use csi5300::signal::channel::SUBCARRIERS;
use csi5300::signal::csi::Csi;
use csi5300::source::survey::{PAUSE_US, Survey};
use csi5300::source::{CsiSource, Error, Next, replay::Replay};
use csi5300::time::{Instant, Step16, Unwrap32};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};
use num_complex::Complex32;
use std::path::Path;

/// Columns of a heat map.
pub const COLUMNS: usize = 600;
/// Bins of the rate.
pub const RATE_BINS: usize = 200;
/// A gap in records is marked where it is longer than this many usual intervals, and this long, seconds.
const GAP_INTERVALS: f64 = 10.0;
const GAP_LEAST_S: f64 = 0.05;

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
    /// First and last time, seconds after the log's first record, on the card's clock; steps back of it count as none.
    pub span_s: (f64, f64),
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
    /// Records lost: when (seconds) and how many numbers of `bfee_count` are missing; 0 for damaged bytes.
    pub losses: Vec<(f64, u64)>,
    /// Where the card's clock stepped back: when (seconds), by how much (seconds).
    pub steps_back: Vec<(f64, f64)>,
}

/// Points kept of a line.
const POINTS: usize = 2_000;

/// One record of the log, short.
struct Row {
    t_s: f64,
    rssi: [u8; 3],
    agc: u8,
}

/// What was seen on the way through a log: what does not depend on the time that it takes.
#[derive(Default)]
struct Seen {
    rows: Vec<Row>,
    losses: Vec<(f64, u64)>,
    steps_back: Vec<(f64, f64)>,
    antennas: [bool; 3],
}

/// Reads a log once; `each` takes the records that are wanted with their time in seconds.
fn scan(path: &Path, wanted: &Wanted, mut each: impl FnMut(f64, &Bfee<'_>)) -> Result<Seen, Error> {
    let (mut source, mut survey, mut seen) = (Replay::open(path)?, Survey::default(), Seen::default());
    let (mut clock, mut count) = (Unwrap32::default(), Step16::default());
    let (mut t_us, mut last_us) = (0_i64, None);
    loop {
        let next = source.receive(Instant::ZERO)?;
        let noted = survey.note(&next);
        let now_s = t_us as f64 * 1e-6;
        match next {
            Next::End(_) => return Ok(seen),
            Next::Lost(_) => seen.losses.push((now_s, 0)),
            _ => {}
        }
        let Some((bfee, identity)) = noted else { continue };
        let now_us = clock.next(bfee.timestamp_low());
        let step_us = last_us.map_or(0, |last| now_us - last);
        last_us = Some(now_us);
        if step_us < 0 {
            seen.steps_back.push((now_s, -step_us as f64 * 1e-6));
        }
        t_us += step_us.max(0);
        let t_s = t_us as f64 * 1e-6;
        if let Some(step @ 2..) = count.step(bfee.bfee_count()).filter(|step| *step <= u16::MAX / 2) {
            seen.losses.push((t_s, u64::from(step - 1)));
        }
        if wanted.takes(identity.mac, t_s) {
            seen.rows.push(Row { t_s, rssi: bfee.rssi(), agc: bfee.agc() });
            each(t_s, &bfee);
        }
    }
}

impl Course {
    /// Reads a log, twice: once for its times, once for its CSI.
    ///
    /// # Errors
    /// If the log cannot be read. A log without a record that is wanted gives an empty course.
    pub fn read(path: &Path, wanted: &Wanted) -> Result<Self, Error> {
        let mut antennas = [false; 3];
        let mut seen = scan(path, wanted, |_, bfee| {
            if let Ok(csi) = Csi::from_bfee(bfee) {
                for (known, antenna) in antennas.iter_mut().zip(Antenna::ALL) {
                    *known |= csi.row(antenna).is_some();
                }
            }
        })?;
        seen.antennas = antennas;
        let Some((first, last)) = seen.rows.first().zip(seen.rows.last()) else { return Ok(Self::default()) };
        let span_s = (first.t_s, last.t_s.max(first.t_s + 1e-6));
        let asked = |antenna: &Antenna| wanted.antennas.is_empty() || wanted.antennas.contains(antenna);
        let known = Antenna::ALL.into_iter().zip(seen.antennas).filter(|(antenna, known)| *known && asked(antenna));
        let mut cells: Vec<(Antenna, Cells)> = known.map(|(antenna, _)| (antenna, Cells::new(span_s))).collect();
        scan(path, wanted, |t_s, bfee| {
            let Ok(csi) = Csi::from_bfee(bfee) else { return };
            for (antenna, cells) in &mut cells {
                if let Some(row) = csi.row(*antenna) {
                    cells.add(t_s, std::array::from_fn(|k| csi.get(k, row, 0).unwrap_or_default()));
                }
            }
        })?;
        let inside = |t_s: &f64| (span_s.0..=span_s.1).contains(t_s);
        Ok(Self {
            records: seen.rows.len() as u64,
            span_s,
            antennas: cells.into_iter().filter_map(|(antenna, cells)| cells.course(antenna)).collect(),
            rssi: std::array::from_fn(|k| {
                thin(&seen.rows, |row| row.rssi[k]).into_iter().filter(|p| p.1 > 0.0).collect()
            }),
            agc: thin(&seen.rows, |row| row.agc),
            rate_hz: rate(&seen.rows, span_s),
            gaps_s: gaps(&seen.rows),
            losses: seen.losses.into_iter().filter(|(t_s, _)| inside(t_s)).collect(),
            steps_back: seen.steps_back.into_iter().filter(|(t_s, _)| inside(t_s)).collect(),
        })
    }
}

/// Every n-th value.
fn thin(rows: &[Row], value: impl Fn(&Row) -> u8) -> Vec<(f64, f64)> {
    rows.iter().step_by(rows.len().div_ceil(POINTS).max(1)).map(|row| (row.t_s, f64::from(value(row)))).collect()
}

fn bin(t_s: f64, span_s: (f64, f64), bins: usize) -> usize {
    (((t_s - span_s.0) / (span_s.1 - span_s.0) * bins as f64) as usize).min(bins - 1)
}

fn rate(rows: &[Row], span_s: (f64, f64)) -> Vec<(f64, f64)> {
    // No more bins than tell a rate from chance.
    let bins = (rows.len() / 5).clamp(1, RATE_BINS);
    let width_s = (span_s.1 - span_s.0) / bins as f64;
    let mut counts = vec![0_u32; bins];
    rows.iter().for_each(|row| counts[bin(row.t_s, span_s, bins)] += 1);
    let middle = |k: usize| span_s.0 + (k as f64 + 0.5) * width_s;
    counts.iter().enumerate().map(|(k, count)| (middle(k), f64::from(*count) / width_s)).collect()
}

fn gaps(rows: &[Row]) -> Vec<(f64, f64)> {
    let mut steps: Vec<f64> = rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
    let usual_s = csi5300::maths::median(&mut steps).unwrap_or_default();
    let limit_s = (GAP_INTERVALS * usual_s).max(GAP_LEAST_S).min(PAUSE_US as f64 * 1e-6);
    let pairs = rows.windows(2).map(|pair| (pair[0].t_s, pair[1].t_s));
    pairs.filter(|(from, to)| to - from >= limit_s && to - from > 2.0 * usual_s).collect()
}

/// Sums of the cells of one antenna.
struct Cells {
    span_s: (f64, f64),
    amplitude: Vec<f64>,
    phase: Vec<Complex32>,
    counts: Vec<u32>,
}

impl Cells {
    fn new(span_s: (f64, f64)) -> Self {
        let cells = SUBCARRIERS * COLUMNS;
        Self { span_s, amplitude: vec![0.0; cells], phase: vec![Complex32::default(); cells], counts: vec![0; COLUMNS] }
    }

    fn add(&mut self, t_s: f64, h: [Complex32; SUBCARRIERS]) {
        let column = bin(t_s, self.span_s, COLUMNS);
        self.counts[column] += 1;
        let middle = h[SUBCARRIERS / 2];
        for (k, value) in h.iter().enumerate() {
            let cell = k * COLUMNS + column;
            self.amplitude[cell] += f64::from(value.norm());
            let turned = value * middle.conj();
            if turned.norm() > 0.0 {
                self.phase[cell] += turned / turned.norm();
            }
        }
    }

    /// The means; columns into which nothing fell hold no number. `None` where all is silent.
    fn course(self, antenna: Antenna) -> Option<AntennaCourse> {
        let count = |cell: usize| f64::from(self.counts[cell % COLUMNS]);
        let mean = |cell: usize| if count(cell) > 0.0 { self.amplitude[cell] / count(cell) } else { f64::NAN };
        let db = |value: f64| if value > 0.0 { 20.0 * value.log10() } else { f64::NAN };
        let cells = SUBCARRIERS * COLUMNS;
        let middle =
            |column: usize| self.span_s.0 + (column as f64 + 0.5) * (self.span_s.1 - self.span_s.0) / COLUMNS as f64;
        let over =
            |column: usize| (0..SUBCARRIERS).map(|k| mean(k * COLUMNS + column)).sum::<f64>() / SUBCARRIERS as f64;
        let line = (0..COLUMNS).map(|column| (middle(column), db(over(column)))).filter(|point| point.1.is_finite());
        let phase = |cell: usize| match self.phase[cell] {
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
