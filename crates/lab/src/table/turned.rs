//! CSI with the subcarriers first, the order of the card's payload: bytes become numbers in one run.

use super::decode::{Form, NOTHING, Rows};
use super::plan::{Plan, Way};
use bytemuck::{cast_slice, cast_slice_mut};
use csi5300::signal::csi::{Csi, scale_factor_of};
use driver_iface::bfee::{Bfee, MAX_SAMPLE_BYTES, MAX_SAMPLES, SUBCARRIERS};
use num_complex::Complex32;

/// Room to work in.
#[derive(Clone, Debug)]
pub(super) struct Room {
    samples: [[i8; 2]; MAX_SAMPLES],
    bytes: [u8; MAX_SAMPLE_BYTES],
}

impl Default for Room {
    fn default() -> Self {
        Self { samples: [[0; 2]; MAX_SAMPLES], bytes: [0; MAX_SAMPLE_BYTES] }
    }
}

impl Room {
    /// For samples by chain pair.
    pub fn planes(&mut self) -> &mut [[i8; 2]; MAX_SAMPLES] {
        &mut self.samples
    }
}

/// One record; its factor to sqrt(SNR) where that was asked for.
#[inline(always)]
pub(super) fn one(
    bfee: &Bfee<'_>,
    plan: &Plan,
    rows: &Rows,
    form: Form,
    with_factor: bool,
    room: &mut Room,
    out: &mut [Complex32],
) -> Option<f64> {
    let Room { samples: sorted, bytes } = room;
    let samples = unpack(bfee, bytes);
    let factor = if with_factor { scale_factor_of(bfee, samples).ok() } else { None };
    let Some(wanted) = (if form.scaled { factor } else { Some(1.0) }) else {
        out.fill(NOTHING);
        return factor;
    };
    let wanted = wanted as f32;
    match plan.way {
        _ if form.without_spatial_mapping && bfee.n_tx() > 1 => unmapped(bfee, plan, rows, wanted, out),
        Way::Straight => widen(samples, wanted, out),
        Way::Sorted => widen(sort(bfee, plan, rows, samples, sorted), wanted, out),
        Way::Partly => partly(bfee, plan, rows, samples, wanted, out),
    }
    factor
}

/// The samples of a record in the order of its payload.
#[inline(always)]
fn unpack<'a>(bfee: &Bfee<'_>, bytes: &'a mut [u8; MAX_SAMPLE_BYTES]) -> &'a [[i8; 2]] {
    let count = bfee.unpack_bytes(bytes).unwrap_or(0);
    cast_slice(bytes.get(..2 * count).unwrap_or_default())
}

/// The samples of the columns of an array, all of which the record has.
#[inline(always)]
fn sort<'a>(
    bfee: &Bfee<'_>,
    plan: &Plan,
    rows: &Rows,
    samples: &[[i8; 2]],
    sorted: &'a mut [[i8; 2]; MAX_SAMPLES],
) -> &'a [[i8; 2]] {
    let columns = (rows.n_rx * rows.n_tx).max(1);
    let sorted = sorted.get_mut(..columns * SUBCARRIERS).unwrap_or_default();
    let sources = plan.sources.map(|source| source.unwrap_or(0));
    for (to, from) in sorted.chunks_exact_mut(columns).zip(samples.chunks_exact(bfee.n_rx() * bfee.n_tx())) {
        for (to, source) in to.iter_mut().zip(&sources) {
            *to = from.get(*source).copied().unwrap_or_default();
        }
    }
    sorted
}

/// Writes the samples of a record that has not all columns.
#[inline(always)]
fn partly(bfee: &Bfee<'_>, plan: &Plan, rows: &Rows, samples: &[[i8; 2]], factor: f32, out: &mut [Complex32]) {
    let pairs = bfee.n_rx() * bfee.n_tx();
    each(rows, out, |subcarrier, column| {
        let [i, q] = *samples.get(subcarrier * pairs + (*plan.sources.get(column)?)?)?;
        Some(Complex32::new(f32::from(i) * factor, f32::from(q) * factor))
    });
}

/// Writes the CSI of a record without the matrix by which its streams were spread.
#[inline(never)]
fn unmapped(bfee: &Bfee<'_>, plan: &Plan, rows: &Rows, factor: f32, out: &mut [Complex32]) {
    let (csi, n_tx) = (Csi::raw(bfee).without_spatial_mapping(bfee.is_40_mhz()), bfee.n_tx());
    each(rows, out, |subcarrier, column| {
        let source = (*plan.sources.get(column)?)?;
        Some(csi.get(subcarrier, source / n_tx, source % n_tx)? * factor)
    });
}

/// Writes every number by itself: that of a subcarrier and column, or none.
#[inline(always)]
fn each(rows: &Rows, out: &mut [Complex32], number: impl Fn(usize, usize) -> Option<Complex32>) {
    for (subcarrier, columns) in out.chunks_exact_mut((rows.n_rx * rows.n_tx).max(1)).enumerate() {
        for (column, h) in columns.iter_mut().enumerate() {
            *h = number(subcarrier, column).unwrap_or(NOTHING);
        }
    }
}

/// Samples times a factor, in a loop that compilers vectorise.
#[inline(always)]
fn widen(samples: &[[i8; 2]], factor: f32, out: &mut [Complex32]) {
    let values: &mut [f32] = cast_slice_mut(out);
    for (value, sample) in values.iter_mut().zip(samples.as_flattened()) {
        *value = f32::from(*sample) * factor;
    }
}
