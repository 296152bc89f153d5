//! CSI from packed records into an array that is already there.

use super::arena::Arena;
use super::plan::Plan;
use super::turned;
use csi5300::signal::csi::{Csi, scale_factor_of};
use driver_iface::bfee::{Antenna, Bfee, SUBCARRIERS};
use fearless_simd::{Level, dispatch};
use num_complex::Complex32;
use rayon::prelude::*;

/// What stands where a record has no CSI.
pub(super) const NOTHING: Complex32 = Complex32::new(f32::NAN, f32::NAN);

/// The units of CSI, and in which columns it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Form {
    /// In sqrt(SNR) instead of the card's integers.
    pub scaled: bool,
    /// Columns are transmit antennas instead of streams.
    pub without_spatial_mapping: bool,
}

/// In which order the numbers of a record are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// `[n_rx][n_tx][subcarrier]`.
    SubcarriersLast,
    /// `[subcarrier][n_rx][n_tx]`.
    SubcarriersFirst,
}

/// The rows of an array: which antenna is in which.
#[derive(Clone, Debug)]
pub struct Rows {
    row_of: [Option<usize>; 3],
    pub(super) n_rx: usize,
    pub(super) n_tx: usize,
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

    /// The chain of each row: that of its antenna, or, where a record does not say which antenna a chain is of, the chain of the
    /// row's number.
    pub(super) fn chains(&self, n_rx: usize, order: [u8; 3]) -> [Option<usize>; 3] {
        let mut chain_of = [None; 3];
        for (chain, antenna) in order.into_iter().enumerate().take(n_rx) {
            let row = match self.row_of.get(usize::from(antenna)) {
                Some(row) => *row,
                None => Some(chain),
            };
            if let Some(place) = row.and_then(|row| chain_of.get_mut(row)) {
                *place = Some(chain);
            }
        }
        chain_of
    }
}

/// Writes the CSI of records `[n_rx][n_tx][subcarrier]`, subcarrier fastest, on all cores of the current pool. `out` has
/// room for one of [`Rows::len`] a record; what a record does not have is not a number.
pub fn decode(arena: &Arena, records: &[usize], rows: &Rows, form: Form, out: &mut [Complex32]) {
    decode_in(Order::SubcarriersLast, arena, records, rows, form, out);
}

/// [`decode`] in either order.
pub(crate) fn decode_in(
    order: Order,
    arena: &Arena,
    records: &[usize],
    rows: &Rows,
    form: Form,
    out: &mut [Complex32],
) {
    if rows.is_empty() {
        return;
    }
    let jobs = out.par_chunks_exact_mut(rows.len()).zip(records.par_iter()).with_min_len(1024);
    jobs.for_each_init(
        || Decoder::new(order, rows.clone(), form),
        |decoder, (out, &record)| match arena.bfee(record) {
            Some(bfee) => {
                decoder.write(&bfee, form.scaled, out);
            }
            None => out.fill(NOTHING),
        },
    );
}

/// Decodes records of one thread.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    order: Order,
    rows: Rows,
    form: Form,
    level: Level,
    plan: Plan,
    /// Room to work in.
    room: turned::Room,
}

impl Decoder {
    /// Writes CSI in this order and form into these rows.
    pub fn new(order: Order, rows: Rows, form: Form) -> Self {
        Self { order, rows, form, level: Level::new(), plan: Plan::default(), room: turned::Room::default() }
    }

    /// Writes the CSI of a record, as [`decode`] does; `out` has room for [`Rows::len`]. Gives the factor to sqrt(SNR), in whatever
    /// units the CSI is, where the record has one.
    pub fn decode(&mut self, bfee: &Bfee<'_>, out: &mut [Complex32]) -> Option<f64> {
        self.write(bfee, true, out)
    }

    /// The same, with the factor only where that is asked for.
    fn write(&mut self, bfee: &Bfee<'_>, with_factor: bool, out: &mut [Complex32]) -> Option<f64> {
        let Self { order, rows, form, level, plan, room } = self;
        plan.fit(bfee, rows);
        // Compiled for each SIMD tier, as compilers vectorise it.
        match order {
            Order::SubcarriersLast => dispatch!(*level, _ => one(bfee, plan, rows, *form, with_factor, room, out)),
            Order::SubcarriersFirst => {
                dispatch!(*level, _ => turned::one(bfee, plan, rows, *form, with_factor, room, out))
            }
        }
    }
}

/// One record; its factor to sqrt(SNR) where that was asked for.
#[inline(always)]
fn one(
    bfee: &Bfee<'_>,
    plan: &Plan,
    rows: &Rows,
    form: Form,
    with_factor: bool,
    room: &mut turned::Room,
    out: &mut [Complex32],
) -> Option<f64> {
    let samples = room.planes();
    let count = bfee.unpack_planes(samples).unwrap_or(0);
    let samples = samples.get(..count).unwrap_or_default();
    let factor = if with_factor { scale_factor_of(bfee, samples).ok() } else { None };
    write(bfee, plan, rows, form, samples, if form.scaled { factor } else { Some(1.0) }, out);
    factor
}

/// Writes the samples of a record times a factor; without one nothing is a number.
#[inline(always)]
fn write(
    bfee: &Bfee<'_>,
    plan: &Plan,
    rows: &Rows,
    form: Form,
    samples: &[[i8; 2]],
    factor: Option<f64>,
    out: &mut [Complex32],
) {
    let Some(factor) = factor.map(|factor| factor as f32) else {
        out.fill(NOTHING);
        return;
    };
    let n_tx = bfee.n_tx();
    let unmapped =
        (form.without_spatial_mapping && n_tx > 1).then(|| Csi::raw(bfee).without_spatial_mapping(bfee.is_40_mhz()));
    let (planes, _) = samples.as_chunks::<SUBCARRIERS>();
    // Each place is written once: memory that is new costs more than what is written to it.
    for (columns, chain) in out.chunks_exact_mut(rows.n_tx * SUBCARRIERS).zip(plan.chains) {
        for (stream, column) in columns.chunks_exact_mut(SUBCARRIERS).enumerate() {
            let chain = chain.filter(|_| stream < n_tx);
            match (&unmapped, chain, chain.and_then(|chain| planes.get(chain * n_tx + stream))) {
                (Some(csi), Some(chain), _) => {
                    for (subcarrier, h) in column.iter_mut().enumerate() {
                        *h = csi.get(subcarrier, chain, stream).map_or(NOTHING, |h| h * factor);
                    }
                }
                (None, _, Some(plane)) => widen(plane, factor, column),
                _ => column.fill(NOTHING),
            }
        }
    }
}

/// The samples of a column times a factor: one loop over as many numbers as there always are, which compilers vectorise.
#[inline(always)]
fn widen(plane: &[[i8; 2]; SUBCARRIERS], factor: f32, column: &mut [Complex32]) {
    let values = bytemuck::cast_slice_mut::<Complex32, f32>(column).first_chunk_mut::<{ 2 * SUBCARRIERS }>();
    let Some(values) = values else { return };
    for (value, sample) in values.iter_mut().zip(plane.as_flattened()) {
        *value = f32::from(*sample) * factor;
    }
}
