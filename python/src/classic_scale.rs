//! csiread's scaling of CSI, in csiread's arrays: one pass over their memory, on all cores.

use crate::error::{Failure, Kind, detached};
use crate::pool::pool;
use num_complex::Complex64;
use numpy::{PyArray4, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Records between two checks for signals.
const BURST: usize = 65_536;
/// Number of subcarriers, by which a record's power is divided.
const SUBCARRIERS: f64 = 30.0;
/// Offset of RSSI, dB (csitool's `get_total_rss.m`).
const RSSI_OFFSET_DB: f64 = 44.0;
/// Noise floor of a record with [`NOISE_UNKNOWN_DBM`], dBm (csitool's `get_scaled_csi.m`).
const DEFAULT_NOISE_DBM: i64 = -92;
const NOISE_UNKNOWN_DBM: i64 = -127;
/// Power shared by three streams, dB (csitool's `get_scaled_csi.m`).
const THREE_STREAMS_DB: f64 = 4.5;
/// `rate_n_flags` of a frame 40 MHz wide.
const HT40: i64 = 0x800;

/// Fields of a record, in the order of [`classic_scaled`]'s.
#[derive(Clone, Copy)]
struct Fields {
    rssi: [i64; 3],
    agc: i64,
    noise_dbm: i64,
    n_rx: i64,
    n_tx: i64,
}

/// The power ratio of a number of decibels.
fn ratio(db: f64) -> f64 {
    10_f64.powf(db / 10.0)
}

impl Fields {
    fn new(columns: &[&[i64]], record: usize) -> Option<Self> {
        let &[a, b, c, agc, noise_dbm, n_rx, n_tx] = columns else { return None };
        let of = |column: &[i64]| column.get(record).copied();
        let rssi = [of(a)?, of(b)?, of(c)?];
        Some(Self { rssi, agc: of(agc)?, noise_dbm: of(noise_dbm)?, n_rx: of(n_rx)?, n_tx: of(n_tx)? })
    }

    /// The factor for the integers of a record with this power, summed over all its entries. As in csiread, a record whose RSSI are all
    /// 0 has 0 dBm.
    fn factor(&self, power: f64) -> f64 {
        let heard: f64 = self.rssi.iter().filter(|rssi| **rssi > 0).map(|rssi| ratio(*rssi as f64)).sum();
        let milliwatt = if heard > 0.0 { heard * ratio(-RSSI_OFFSET_DB - self.agc as f64) } else { 1.0 };
        let per_unit = milliwatt / (power / SUBCARRIERS);
        let floor = if self.noise_dbm == NOISE_UNKNOWN_DBM { DEFAULT_NOISE_DBM } else { self.noise_dbm };
        let noise = ratio(floor as f64) + per_unit * (self.n_rx * self.n_tx) as f64;
        let shared = match self.n_tx {
            2 => 2.0,
            3 => ratio(THREE_STREAMS_DB),
            _ => 1.0,
        };
        (per_unit / (noise / shared)).sqrt()
    }
}

fn wrong(why: impl ToString) -> PyErr {
    Failure::new(Kind::Option, why).into()
}

/// The sum of the squares of the values.
fn power(values: &[Complex64]) -> f64 {
    let (fours, rest) = bytemuck::cast_slice::<Complex64, f64>(values).as_chunks::<4>();
    let mut sums = [0.0; 4];
    for four in fours {
        sums.iter_mut().zip(four).for_each(|(sum, value)| *sum += value * value);
    }
    sums.iter().sum::<f64>() + rest.iter().map(|value| value * value).sum::<f64>()
}

/// Writes `csi` (n, 30, rows, streams), or the content of `out` if it is None, to `out` in sqrt(SNR). `fields` (n,) are each record's
/// RSSI at A, B and C, gain, noise, Nrx and Ntx.
#[pyfunction]
pub fn classic_scaled<'py>(
    py: Python<'py>,
    csi: Option<PyReadonlyArray4<'py, Complex64>>,
    fields: Vec<PyReadonlyArray1<'py, i64>>,
    out: &Bound<'py, PyArray4<Complex64>>,
) -> PyResult<()> {
    let n = out.shape().first().copied().unwrap_or(0);
    let same = csi.as_ref().is_none_or(|csi| csi.shape() == out.shape());
    if !same || fields.len() != 7 || fields.iter().any(|column| column.len() != n) {
        return Err(wrong("CSI and fields are of different numbers of records"));
    }
    let size = out.len().checked_div(n).unwrap_or(0).max(1);
    let from = csi.as_ref().map(|csi| csi.as_slice()).transpose().map_err(wrong)?;
    let columns: Vec<&[i64]> =
        fields.iter().map(|column| column.as_slice()).collect::<Result<_, _>>().map_err(wrong)?;
    let mut writer = out.try_readwrite().map_err(wrong)?;
    let to: &mut [Complex64] = writer.as_slice_mut().map_err(wrong)?;
    let pool = pool()?;
    for (burst, to) in to.chunks_mut(size * BURST).enumerate() {
        let one = |(index, to): (usize, &mut [Complex64])| {
            let record = burst * BURST + index;
            let Some(fields) = Fields::new(&columns, record) else { return };
            if let Some(from) = from.and_then(|from| from.get(record * size..(record + 1) * size)) {
                to.copy_from_slice(from);
            }
            let factor = fields.factor(power(to));
            to.iter_mut().for_each(|to| *to *= factor);
        };
        let records = to.par_chunks_exact_mut(size).enumerate().with_min_len(256);
        detached(py, || pool.install(|| records.for_each(one)))?;
        py.check_signals()?;
    }
    Ok(())
}

/// Removes the spatial mapping of `csi` (n, 30, rows, streams) in place, for records of `n_tx` 2 or 3 streams, by `rate` at 20 or 40
/// MHz. `maps` (4, 9) are the transmitter's matrices, streams by antennas, row by row: for 2 and 3 streams at 20 MHz, then at 40 MHz.
#[pyfunction]
pub fn classic_unmapped<'py>(
    py: Python<'py>,
    csi: &Bound<'py, PyArray4<Complex64>>,
    n_tx: PyReadonlyArray1<'py, i64>,
    rate: PyReadonlyArray1<'py, i64>,
    maps: PyReadonlyArray2<'py, Complex64>,
) -> PyResult<()> {
    let &[n, _, _, columns] = csi.shape() else { return Ok(()) };
    if n_tx.len() != n || rate.len() != n || maps.shape() != [4, 9] {
        return Err(wrong("CSI and fields are of different numbers of records"));
    }
    let size = csi.len().checked_div(n).unwrap_or(0).max(1);
    let (n_tx, rate) = (n_tx.as_slice().map_err(wrong)?, rate.as_slice().map_err(wrong)?);
    let (maps, _) = maps.as_slice().map_err(wrong)?.as_chunks::<9>();
    let mut writer = csi.try_readwrite().map_err(wrong)?;
    let values: &mut [Complex64] = writer.as_slice_mut().map_err(wrong)?;
    let one = |((csi, n_tx), rate): ((&mut [Complex64], &i64), &i64)| {
        let streams @ (2 | 3) = *n_tx as usize else { return };
        let wide = usize::from(rate & HT40 != 0);
        if let (Some(map), true) = (maps.get(2 * wide + streams - 2), streams <= columns) {
            csi.chunks_exact_mut(columns).for_each(|row| unmap(map, streams, row));
        }
    };
    let pool = pool()?;
    let records = values.par_chunks_exact_mut(size).zip(n_tx.par_iter()).zip(rate.par_iter()).with_min_len(256);
    detached(py, || pool.install(|| records.for_each(one)))
}

/// One antenna's streams times the conjugate transpose of the matrix.
fn unmap(map: &[Complex64; 9], streams: usize, row: &mut [Complex64]) {
    let mut out = [Complex64::default(); 3];
    for (out, map) in out.iter_mut().zip(map.chunks_exact(streams)).take(streams) {
        *out = row.iter().zip(map).map(|(h, q)| h * q.conj()).sum();
    }
    row.iter_mut().zip(out).take(streams).for_each(|(place, h)| *place = h);
}
