//! Decodes CSI from packed records into an existing array, in either order of its indices.

use super::antenna_order;
use super::memory::Arena;
use csi5300::signal::csi::{Csi, scale_factor_of};
use driver_iface::bfee::{Antenna, Bfee, MAX_SAMPLES, SUBCARRIERS};
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
    planes: [[i8; 2]; MAX_SAMPLES],
    sorted: [[i8; 2]; MAX_SAMPLES],
}

impl Decoder {
    /// Writes CSI in this order and form into these rows.
    pub fn new(order: Order, rows: Rows, form: Form) -> Self {
        let [planes, sorted] = [[[0; 2]; MAX_SAMPLES]; 2];
        Self { order, rows, form, level: Level::new(), plan: Plan::default(), planes, sorted }
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
        let Self { order, form, plan, planes, sorted, .. } = self;
        let count = bfee.unpack_planes(planes).unwrap_or(0);
        let samples = planes.get(..count).unwrap_or_default();
        let factor = if with_factor { scale_factor_of(bfee, samples).ok() } else { None };
        let Some(wanted) = (if form.scaled { factor } else { Some(1.0) }) else {
            out.fill(NOTHING);
            return factor;
        };
        let csi = (form.without_spatial_mapping && bfee.n_tx() > 1).then(|| Csi::raw(bfee));
        let unmapped = csi.map(|csi| csi.without_spatial_mapping(bfee.is_40_mhz()));
        let wanted = wanted as f32;
        match (*order, unmapped.as_ref()) {
            (Order::SubcarriersFirst, None) => by_subcarrier(plan, samples, sorted, wanted, out),
            (_, unmapped) => by_column(bfee, (*order, plan), unmapped, samples, wanted, out),
        }
        factor
    }
}

/// Writes the samples of a record, or its CSI without the spatial mapping matrix of its streams, column by column.
#[inline(always)]
fn by_column(
    bfee: &Bfee<'_>,
    (order, plan): (Order, &Plan),
    unmapped: Option<&Csi>,
    samples: &[[i8; 2]],
    factor: f32,
    out: &mut [Complex32],
) {
    let (planes, n_tx, columns) = (samples.as_chunks::<SUBCARRIERS>().0, bfee.n_tx(), out.len() / SUBCARRIERS);
    // Each place is written once: new memory costs more than the writing.
    for column in 0..columns {
        let (from, step) = match order {
            Order::SubcarriersLast => (column * SUBCARRIERS, 1),
            Order::SubcarriersFirst => (column, columns),
        };
        let room = out.get_mut(from..).unwrap_or_default();
        let source = plan.sources.get(column).copied().flatten();
        match (unmapped, source, source.and_then(|source| planes.get(source))) {
            (Some(csi), Some(source), _) => {
                for (subcarrier, h) in room.iter_mut().step_by(step).take(SUBCARRIERS).enumerate() {
                    *h = csi.get(subcarrier, source / n_tx, source % n_tx).map_or(NOTHING, |h| h * factor);
                }
            }
            (None, _, Some(plane)) => widen(plane, factor, room),
            _ => room.iter_mut().step_by(step).take(SUBCARRIERS).for_each(|h| *h = NOTHING),
        }
    }
}

/// Writes the samples of a record with the subcarriers first.
#[inline(always)]
fn by_subcarrier(
    plan: &Plan,
    samples: &[[i8; 2]],
    sorted: &mut [[i8; 2]; MAX_SAMPLES],
    factor: f32,
    out: &mut [Complex32],
) {
    let (planes, columns) = (samples.as_chunks::<SUBCARRIERS>().0, out.len() / SUBCARRIERS);
    let plane = |column: usize| planes.get(plan.sources.get(column).copied().flatten()?);
    let present = (0..columns).filter_map(|column| Some((column, plane(column)?)));
    for (column, plane) in present {
        let places = sorted.get_mut(column..).unwrap_or_default().iter_mut().step_by(columns);
        places.zip(plane).for_each(|(to, from)| *to = *from);
    }
    widen(sorted.get(..out.len()).unwrap_or_default(), factor, out);
    for column in (0..columns).filter(|column| plane(*column).is_none()) {
        out.iter_mut().skip(column).step_by(columns).for_each(|h| *h = NOTHING);
    }
}

/// Samples times a factor: a loop that compilers vectorise.
#[inline(always)]
fn widen(samples: &[[i8; 2]], factor: f32, out: &mut [Complex32]) {
    let values = bytemuck::cast_slice_mut::<Complex32, f32>(out).get_mut(..2 * samples.len());
    for (value, sample) in values.unwrap_or_default().iter_mut().zip(samples.as_flattened()) {
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

/// Where the samples of a record go.
#[derive(Clone, Debug, Default)]
struct Plan {
    kind: Kind,
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
        Self { kind, sources }
    }
}
