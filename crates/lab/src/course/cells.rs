//! CSI of one antenna summed in cells over time and subcarrier.

use super::AntennaCourse;
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::signal::csi::Csi;
use driver_iface::bfee::Antenna;
use num_complex::Complex32;

/// CSI of one antenna, first stream; `None` where the record has none of it.
pub(super) fn row_of(csi: &Csi, antenna: Antenna) -> Option<[Complex32; SUBCARRIERS]> {
    let row = csi.row(antenna)?;
    Some(std::array::from_fn(|k| csi.get(k, row, 0).unwrap_or_default()))
}

/// Sums of the cells of one antenna, `[column][subcarrier]`: a record touches neighbours only.
#[derive(Clone)]
pub(super) struct Cells {
    amplitude: Vec<f64>,
    phase: Vec<Complex32>,
    counts: Vec<u32>,
}

impl Cells {
    pub fn new(columns: usize) -> Self {
        let cells = SUBCARRIERS * columns;
        Self { amplitude: vec![0.0; cells], phase: vec![Complex32::default(); cells], counts: vec![0; columns] }
    }

    pub fn columns(&self) -> usize {
        self.counts.len()
    }

    pub fn add(&mut self, column: usize, h: &[Complex32; SUBCARRIERS]) {
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

    /// Adds a column of other cells to a column of these.
    pub fn add_column(&mut self, column: usize, other: &Self, from: usize) {
        if column >= self.columns() || from >= other.columns() {
            return;
        }
        self.counts[column] += other.counts[from];
        for k in 0..SUBCARRIERS {
            let (to, from) = (column * SUBCARRIERS + k, from * SUBCARRIERS + k);
            self.amplitude[to] += other.amplitude[from];
            self.phase[to] += other.phase[from];
        }
    }

    /// Half as many columns of twice the width, in the lower half; the upper half is empty.
    pub fn halve(&mut self) {
        let mut half = Self::new(self.columns());
        for column in 0..self.columns() {
            half.add_column(column / 2, self, column);
        }
        *self = half;
    }

    /// The means over a span; columns into which nothing fell hold no number. `None` where all is silent.
    pub fn course(self, antenna: Antenna, span_s: (f64, f64)) -> Option<AntennaCourse> {
        let columns = self.columns();
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
