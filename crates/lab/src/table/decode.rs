//! Decodes CSI from packed records into an existing array, in either order of its indices.

use super::antenna_order;
use super::memory::Arena;
use bytemuck::{cast_slice, cast_slice_mut};
use csi5300::signal::csi::{Csi, scale_factor_of};
use driver_iface::bfee::{Antenna, Bfee, MAX_SAMPLE_BYTES, MAX_SAMPLES, SUBCARRIERS};
use fearless_simd::{Level, dispatch};
use num_complex::Complex32;
use rayon::prelude::*;

/// Stands for missing CSI.
const NOTHING: Complex32 = Complex32::new(f32::NAN, f32::NAN);

/// The units of CSI, and the meaning of its columns.
#[derive(Clone, Copy, Debug, Default)]
pub struct Form {
    /// In sqrt(SNR) instead of the card's integers.
    pub scaled: bool,
    /// Columns are transmit antennas instead of streams.
    pub without_spatial_mapping: bool,
}

/// The order of a record's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// `[n_rx][n_tx][subcarrier]`.
    SubcarriersLast,
    /// `[subcarrier][n_rx][n_tx]`.
    SubcarriersFirst,
}

/// The rows of an array: which antenna is in which row.
#[derive(Clone, Debug)]
pub struct Rows {
    row_of: [Option<usize>; 3],
    n_rx: usize,
    n_tx: usize,
}

impl Rows {
    /// `antennas` in this order, `n_tx` columns.
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

    /// The chain of each row: that of its antenna or, if a record does not name the antennas, the chain with the row's number.
    fn chains(&self, n_rx: usize, order: [u8; 3]) -> [Option<usize>; 3] {
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

/// Writes the CSI of records `[n_rx][n_tx][subcarrier]`, subcarrier fastest, on all cores of the current pool. `out` has room
/// for [`Rows::len`] values per record; missing ones are NaN.
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

/// Decodes records on one thread.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    order: Order,
    rows: Rows,
    form: Form,
    level: Level,
    plan: Plan,
    /// Working memory.
    room: Room,
}

impl Decoder {
    /// Writes CSI in this order and form into these rows.
    pub fn new(order: Order, rows: Rows, form: Form) -> Self {
        Self { order, rows, form, level: Level::new(), plan: Plan::default(), room: Room::default() }
    }

    /// Writes the CSI of a record, as [`decode`] does; `out` has room for [`Rows::len`]. Returns the factor to
    /// sqrt(SNR), if the record has one.
    pub fn decode(&mut self, bfee: &Bfee<'_>, out: &mut [Complex32]) -> Option<f64> {
        self.write(bfee, true, out)
    }

    /// The same, with the factor only on request.
    fn write(&mut self, bfee: &Bfee<'_>, with_factor: bool, out: &mut [Complex32]) -> Option<f64> {
        self.plan.fit(bfee, &self.rows);
        // Compiled for each SIMD tier, because compilers vectorise it.
        let level = self.level;
        dispatch!(level, _ => self.one(bfee, with_factor, out))
    }

    /// One record, for the vectors for which it is compiled.
    #[inline(always)]
    fn one(&mut self, bfee: &Bfee<'_>, with_factor: bool, out: &mut [Complex32]) -> Option<f64> {
        let Self { order, rows, form, plan, room: Room { planes, bytes, sorted }, .. } = self;
        let samples: &[[i8; 2]] = match order {
            Order::SubcarriersLast => {
                let count = bfee.unpack_planes(planes).unwrap_or(0);
                planes.get(..count).unwrap_or_default()
            }
            Order::SubcarriersFirst => {
                let count = bfee.unpack_bytes(bytes).unwrap_or(0);
                cast_slice(bytes.get(..2 * count).unwrap_or_default())
            }
        };
        let factor = if with_factor { scale_factor_of(bfee, samples).ok() } else { None };
        let Some(wanted) = (if form.scaled { factor } else { Some(1.0) }) else {
            out.fill(NOTHING);
            return factor;
        };
        let wanted = wanted as f32;
        let csi = (form.without_spatial_mapping && bfee.n_tx() > 1).then(|| Csi::raw(bfee));
        let unmapped = csi.map(|csi| csi.without_spatial_mapping(bfee.is_40_mhz()));
        match (order, unmapped.as_ref(), plan.way) {
            (Order::SubcarriersLast, unmapped, _) => by_column(bfee, plan, unmapped, samples, wanted, out),
            (_, Some(csi), _) => one_by_one(bfee, plan, rows, csi, wanted, out),
            (_, None, Way::Straight) => widen_all(samples, wanted, out),
            (_, None, Way::Sorted) => widen_all(sort(bfee, plan, rows, samples, sorted), wanted, out),
            (_, None, Way::Partly) => partly(bfee, plan, rows, samples, wanted, out),
        }
        factor
    }
}

/// Writes the samples of a record, or its CSI without the spatial mapping matrix of its streams, column by column.
#[inline(always)]
fn by_column(
    bfee: &Bfee<'_>,
    plan: &Plan,
    unmapped: Option<&Csi>,
    samples: &[[i8; 2]],
    factor: f32,
    out: &mut [Complex32],
) {
    let (planes, n_tx) = (samples.as_chunks::<SUBCARRIERS>().0, bfee.n_tx());
    // Each place is written once: new memory costs more than the writing.
    for (k, column) in out.chunks_exact_mut(SUBCARRIERS).enumerate() {
        let source = plan.sources.get(k).copied().flatten();
        match (unmapped, source, source.and_then(|source| planes.get(source))) {
            (Some(csi), Some(source), _) => {
                for (subcarrier, h) in column.iter_mut().enumerate() {
                    *h = csi.get(subcarrier, source / n_tx, source % n_tx).map_or(NOTHING, |h| h * factor);
                }
            }
            (None, _, Some(plane)) => widen(plane, factor, column),
            _ => column.fill(NOTHING),
        }
    }
}

/// The samples of a column times a factor: a loop of constant length, which compilers vectorise.
#[inline(always)]
fn widen(plane: &[[i8; 2]; SUBCARRIERS], factor: f32, column: &mut [Complex32]) {
    let values = bytemuck::cast_slice_mut::<Complex32, f32>(column).first_chunk_mut::<{ 2 * SUBCARRIERS }>();
    let Some(values) = values else { return };
    for (value, sample) in values.iter_mut().zip(plane.as_flattened()) {
        *value = f32::from(*sample) * factor;
    }
}

// Where a record's samples go: equal for most records in a row, and recomputed on changes.

/// Columns of the largest record.
const MOST: usize = MAX_SAMPLES / SUBCARRIERS;

/// The fields that determine a record's plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Kind {
    antenna_sel: u8,
    /// 0 before the first record.
    n_rx: usize,
    n_tx: usize,
    /// For a record of one chain, whose RSSI may show the antenna.
    rssi: [u8; 3],
}

impl Kind {
    fn of(bfee: &Bfee<'_>) -> Self {
        let (n_rx, rssi) = (bfee.n_rx(), bfee.rssi());
        Self { antenna_sel: bfee.antenna_sel(), n_rx, n_tx: bfee.n_tx(), rssi: if n_rx == 1 { rssi } else { [0; 3] } }
    }
}

/// How the columns of an array, row by row, are made from a record's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Way {
    /// Unchanged.
    Straight,
    /// Permuted by [`Plan::sources`].
    Sorted,
    /// Some are missing.
    #[default]
    Partly,
}

/// Where the samples of a record go.
#[derive(Clone, Debug, Default)]
struct Plan {
    kind: Kind,
    /// How columns are made.
    way: Way,
    /// For each column the record's `chain n_tx + stream`, if it has one.
    sources: [Option<usize>; MOST],
}

impl Plan {
    /// Sets it for a record.
    #[inline(always)]
    fn fit(&mut self, bfee: &Bfee<'_>, rows: &Rows) {
        let kind = Kind::of(bfee);
        if self.kind != kind {
            *self = Self::new(kind, bfee, rows);
        }
    }

    #[inline(never)]
    fn new(kind: Kind, bfee: &Bfee<'_>, rows: &Rows) -> Self {
        let chains = rows.chains(kind.n_rx, antenna_order(bfee));
        let columns = rows.n_rx * rows.n_tx;
        let source = |column: usize| {
            let stream = column % rows.n_tx;
            let chain = chains.get(column / rows.n_tx).copied().flatten();
            chain.filter(|_| stream < kind.n_tx).map(|chain| chain * kind.n_tx + stream)
        };
        let sources: [_; MOST] = std::array::from_fn(|column| if column < columns { source(column) } else { None });
        let of_columns = sources.get(..columns).unwrap_or_default();
        let way = if of_columns.iter().any(Option::is_none) {
            Way::Partly
        } else if columns == kind.n_rx * kind.n_tx && of_columns.is_sorted() {
            Way::Straight
        } else {
            Way::Sorted
        };
        Self { kind, way, sources }
    }
}

// CSI with the subcarriers first, the order of the card's payload: a single pass turns bytes into numbers.

/// Working memory.
#[derive(Clone, Debug)]
struct Room {
    planes: [[i8; 2]; MAX_SAMPLES],
    bytes: [u8; MAX_SAMPLE_BYTES],
    sorted: [[i8; 2]; MAX_SAMPLES],
}

impl Default for Room {
    fn default() -> Self {
        Self { planes: [[0; 2]; MAX_SAMPLES], bytes: [0; MAX_SAMPLE_BYTES], sorted: [[0; 2]; MAX_SAMPLES] }
    }
}

/// The samples of an array's columns, if the record has all of them.
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

/// Writes the samples of a record that lacks columns.
#[inline(always)]
fn partly(bfee: &Bfee<'_>, plan: &Plan, rows: &Rows, samples: &[[i8; 2]], factor: f32, out: &mut [Complex32]) {
    let pairs = bfee.n_rx() * bfee.n_tx();
    each(rows, out, |subcarrier, column| {
        let [i, q] = *samples.get(subcarrier * pairs + (*plan.sources.get(column)?)?)?;
        Some(Complex32::new(f32::from(i) * factor, f32::from(q) * factor))
    });
}

/// Writes the CSI of a record without the spatial mapping matrix of its streams.
#[inline(never)]
fn one_by_one(bfee: &Bfee<'_>, plan: &Plan, rows: &Rows, csi: &Csi, factor: f32, out: &mut [Complex32]) {
    let n_tx = bfee.n_tx();
    each(rows, out, |subcarrier, column| {
        let source = (*plan.sources.get(column)?)?;
        Some(csi.get(subcarrier, source / n_tx, source % n_tx)? * factor)
    });
}

/// Writes every number separately: that of a subcarrier and column, or NaN.
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
fn widen_all(samples: &[[i8; 2]], factor: f32, out: &mut [Complex32]) {
    let values: &mut [f32] = cast_slice_mut(out);
    for (value, sample) in values.iter_mut().zip(samples.as_flattened()) {
        *value = f32::from(*sample) * factor;
    }
}
