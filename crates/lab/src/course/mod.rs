//! A log over time, binned for pictures: CSI of each antenna over time and subcarrier, RSSI and gain, rate, and where
//! something is missing. A log of any length takes the memory of its bins and of one short row a record.
//!
//! [`Course`] is what one picture shows. [`LogIndex`] is a log read once, from which any stretch is binned again at once.

mod cells;
mod index;
mod scan;

pub use index::{Band, LogIndex, Stretch, StretchCsi};

use cells::{Cells, row_of};
use csi5300::internal::PAUSE_US;
use csi5300::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ, SUBCARRIERS};
use csi5300::signal::csi::Csi;
use csi5300::source::Error;
use csi5300::source::survey::{Survey, TimeBase};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, rate::HT40};
use scan::{Row, Seen, scan};
use std::path::Path;

/// Columns of a heat map at most.
const COLUMNS: usize = 600;
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

/// Points kept of a line.
const POINTS: usize = 2_000;

impl Course {
    /// Reads a log, twice: once for its times, once for its CSI; once more where its card's clock stands.
    ///
    /// # Errors
    /// If the log cannot be read. A log without a record that is wanted gives an empty course.
    pub fn read(path: &Path, wanted: &Wanted) -> Result<Self, Error> {
        let (mut seen, mut antennas) = scan_antennas(path, TimeBase::Card, wanted)?;
        let base = seen.survey.time_base();
        if base != TimeBase::Card {
            // What lies in the cut is known by these times only.
            (seen, antennas) = scan_antennas(path, base, wanted)?;
        }
        let lost_something = seen.survey.lost_something();
        let Some(span_s) = span_s(&seen.rows) else { return Ok(Self { lost_something, ..Self::default() }) };
        let columns = seen.rows.len().clamp(1, COLUMNS);
        let asked = |antenna: &Antenna| wanted.antennas.is_empty() || wanted.antennas.contains(antenna);
        let known = Antenna::ALL.into_iter().zip(antennas).filter(|(antenna, known)| *known && asked(antenna));
        let mut cells: Vec<(Antenna, Cells)> = known.map(|(antenna, _)| (antenna, Cells::new(columns))).collect();
        scan(path, base, wanted, |row, _, bfee| {
            let Ok(csi) = Csi::from_bfee(bfee) else { return };
            for (antenna, cells) in &mut cells {
                if let Some(h) = row_of(&csi, *antenna) {
                    cells.add(bin(row.t_s(), span_s, columns), &h);
                }
            }
        })?;
        let inside = |t_s: f64| (span_s.0..=span_s.1).contains(&t_s);
        let counted = |marks: Vec<(f64, u64)>| marks.into_iter().filter(|mark| inside(mark.0)).collect();
        let times = |marks: Vec<f64>| marks.into_iter().filter(|t_s| inside(*t_s)).collect();
        Ok(Self {
            records: seen.rows.len() as u64,
            base,
            span_s,
            subcarriers: subcarriers(&seen.survey),
            columns,
            antennas: cells.into_iter().filter_map(|(antenna, cells)| cells.course(antenna, span_s)).collect(),
            rssi: std::array::from_fn(|k| {
                thin(&seen.rows, |row| row.rssi[k]).into_iter().filter(|p| p.1 > 0.0).collect()
            }),
            agc: thin(&seen.rows, |row| row.agc),
            rate_hz: rate(&seen.rows, span_s),
            gaps_s: gaps(&seen.rows),
            missing: counted(seen.missing),
            damaged: times(seen.damaged),
            skipped: counted(seen.skipped.into_iter().map(|(_, t_s, count)| (t_s, count)).collect()),
            repeated: times(seen.repeated.into_iter().map(|(_, t_s)| t_s).collect()),
            steps_back: seen.steps_back.into_iter().filter(|(t_s, _)| inside(*t_s)).collect(),
            lost_something,
        })
    }
}

/// Reads a log once by a clock; which antennas have CSI in what is wanted of it.
fn scan_antennas(path: &Path, base: TimeBase, wanted: &Wanted) -> Result<(Seen, [bool; 3]), Error> {
    let mut antennas = [false; 3];
    let seen = scan(path, base, wanted, |_, _, bfee| {
        let Ok(csi) = Csi::from_bfee(bfee) else { return };
        for (known, antenna) in antennas.iter_mut().zip(Antenna::ALL) {
            *known |= csi.row(antenna).is_some();
        }
    })?;
    Ok((seen, antennas))
}

/// Indices of the subcarriers, where all frames are of one width.
fn subcarriers(survey: &Survey) -> Option<[i8; SUBCARRIERS]> {
    let wide = survey.rates.keys().filter(|rate| *rate & HT40 != 0).count();
    match wide {
        0 => Some(INDICES_20_MHZ),
        all if all == survey.rates.len() => Some(INDICES_40_MHZ),
        _ => None,
    }
}

/// First and last time, seconds; never of no length.
fn span_s(rows: &[Row]) -> Option<(f64, f64)> {
    let (first, last) = rows.first().zip(rows.last())?;
    Some((first.t_s(), last.t_s().max(first.t_s() + 1e-6)))
}

/// Every n-th value.
fn thin(rows: &[Row], value: impl Fn(&Row) -> u8) -> Vec<(f64, f64)> {
    rows.iter().step_by(rows.len().div_ceil(POINTS).max(1)).map(|row| (row.t_s(), f64::from(value(row)))).collect()
}

fn bin(t_s: f64, span_s: (f64, f64), bins: usize) -> usize {
    (((t_s - span_s.0) / (span_s.1 - span_s.0) * bins as f64) as usize).min(bins - 1)
}

fn rate(rows: &[Row], span_s: (f64, f64)) -> Vec<(f64, f64)> {
    // No more bins than tell a rate from chance.
    let bins = (rows.len() / 5).clamp(1, RATE_BINS);
    let width_s = (span_s.1 - span_s.0) / bins as f64;
    let mut counts = vec![0_u32; bins];
    rows.iter().for_each(|row| counts[bin(row.t_s(), span_s, bins)] += 1);
    let middle = |k: usize| span_s.0 + (k as f64 + 0.5) * width_s;
    counts.iter().enumerate().map(|(k, count)| (middle(k), f64::from(*count) / width_s)).collect()
}

fn gaps(rows: &[Row]) -> Vec<(f64, f64)> {
    let mut steps: Vec<f64> = rows.windows(2).map(|pair| pair[1].t_s() - pair[0].t_s()).collect();
    let usual_s = csi5300::maths::median(&mut steps).unwrap_or_default();
    let limit_s = (GAP_INTERVALS * usual_s).max(GAP_LEAST_S).min(PAUSE_US as f64 * 1e-6);
    let pairs = rows.windows(2).map(|pair| (pair[0].t_s(), pair[1].t_s()));
    pairs.filter(|(from, to)| to - from >= limit_s && to - from > 2.0 * usual_s).collect()
}

#[cfg(test)]
mod tests;
