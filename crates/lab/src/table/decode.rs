//! CSI from packed records into an array that is already there.

use super::arena::Arena;
use super::columns::antenna_order;
use csi5300::signal::csi::{Csi, scale_factor};
use driver_iface::bfee::{ALL_SUBCARRIERS, Antenna, Bfee, SUBCARRIERS};
use num_complex::Complex32;
use rayon::prelude::*;

/// What stands where a record has no CSI.
const NOTHING: Complex32 = Complex32::new(f32::NAN, f32::NAN);

/// The units of CSI, and in which columns it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Form {
    /// In sqrt(SNR) instead of the card's integers.
    pub scaled: bool,
    /// Columns are transmit antennas instead of streams.
    pub without_spatial_mapping: bool,
}

/// The rows of an array: which antenna is in which.
#[derive(Clone, Debug)]
pub struct Rows {
    row_of: [Option<usize>; 3],
    n_rx: usize,
    n_tx: usize,
}

impl Rows {
    /// `antennas` in their order, `n_tx` columns.
    #[must_use]
    pub fn new(antennas: &[Antenna], n_tx: usize) -> Self {
        let mut row_of = [None; 3];
        for (row, antenna) in antennas.iter().enumerate() {
            if let Some(place) = row_of.get_mut(antenna.index()) {
                *place = Some(row);
            }
        }
        Self { row_of, n_rx: antennas.len(), n_tx }
    }

    /// Complex numbers of a record.
    #[must_use]
    pub fn len(&self) -> usize {
        self.n_rx * self.n_tx * SUBCARRIERS
    }

    /// True without rows or columns.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The row of a chain; chains whose antenna is not known keep their order.
    fn row(&self, chain: usize, order: [u8; 3]) -> Option<usize> {
        match order.get(chain) {
            Some(&antenna) if usize::from(antenna) < self.row_of.len() => *self.row_of.get(usize::from(antenna))?,
            _ => Some(chain).filter(|row| *row < self.n_rx),
        }
    }
}

/// Writes the CSI of records `[n_rx][n_tx][subcarrier]`, subcarrier fastest, on all cores of the current pool. `out` has
/// room for one of [`Rows::len`] a record; what a record does not have is not a number.
pub fn decode(arena: &Arena, records: &[usize], rows: &Rows, form: Form, out: &mut [Complex32]) {
    if rows.is_empty() {
        return;
    }
    let jobs = out.par_chunks_exact_mut(rows.len()).zip(records.par_iter()).with_min_len(256);
    jobs.for_each(|(out, &record)| match arena.bfee(record) {
        Some(bfee) => one(&bfee, rows, form, out),
        None => out.fill(NOTHING),
    });
}

/// One record.
fn one(bfee: &Bfee<'_>, rows: &Rows, form: Form, out: &mut [Complex32]) {
    let (n_rx, n_tx) = (bfee.n_rx(), bfee.n_tx());
    let factor = if form.scaled { scale_factor(bfee).ok().map(|factor| factor as f32) } else { Some(1.0) };
    let Some(factor) = factor else {
        out.fill(NOTHING);
        return;
    };
    if n_rx != rows.n_rx || n_tx != rows.n_tx {
        out.fill(NOTHING);
    }
    let unmapped =
        (form.without_spatial_mapping && n_tx > 1).then(|| Csi::raw(bfee).without_spatial_mapping(bfee.is_40_mhz()));
    let order = antenna_order(bfee);
    let mut filled = 0;
    for chain in 0..n_rx {
        let Some(row) = rows.row(chain, order) else { continue };
        filled += 1;
        for stream in 0..n_tx.min(rows.n_tx) {
            let from = (row * rows.n_tx + stream) * SUBCARRIERS;
            let Some(column) = out.get_mut(from..from + SUBCARRIERS) else { continue };
            match &unmapped {
                Some(csi) => {
                    for (s, h) in column.iter_mut().enumerate() {
                        *h = csi.get(s, chain, stream).unwrap_or(NOTHING);
                    }
                }
                None => {
                    bfee.column_f32(chain, stream, &ALL_SUBCARRIERS, bytemuck::cast_slice_mut(column));
                }
            }
            if form.scaled {
                column.iter_mut().for_each(|h| *h *= factor);
            }
        }
    }
    if n_rx == rows.n_rx && filled < rows.n_rx {
        // As many chains as rows, but of other antennas: rows that nobody wrote hold nothing.
        for row in (0..rows.n_rx).filter(|row| !(0..n_rx).any(|chain| rows.row(chain, order) == Some(*row))) {
            let from = row * rows.n_tx * SUBCARRIERS;
            if let Some(column) = out.get_mut(from..from + rows.n_tx * SUBCARRIERS) {
                column.fill(NOTHING);
            }
        }
    }
}
