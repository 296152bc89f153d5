//! The native half of a log: packed records, decoded on demand.

use crate::columns::{arrays, from_arrays};
use crate::error::{Failure, Kind, Stop, detached, interruptible};
use crate::intake::{filter, info, is_read_here, open, read_all, read_on};
use crate::pool::pool;
use csi5300::signal::csi::{scale_factor, total_rss_dbm};
use csi5300_lab::export::Export;
use csi5300_lab::table::{Arena, Columns, Form, Reading, Rows, Widest, antennas, decode};
use driver_iface::bfee::{Antenna, Bfee, SUBCARRIERS};
use num_complex::Complex32;
use numpy::{IntoPyArray, PyArray1, PyArray4, PyArrayMethods, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rayon::prelude::*;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Records decoded between two checks for signals.
const PIECE: usize = 1 << 17;

/// bfee records in memory, packed as the card sent them.
#[pyclass(frozen, module = "csi5300._native")]
pub struct Records {
    /// The records.
    pub arena: Arc<Arena>,
}

/// Numbers of records, in the caller's order; all if none are named.
pub fn selected(arena: &Arena, rows: Option<&PyReadonlyArray1<'_, i64>>) -> PyResult<Vec<usize>> {
    let Some(rows) = rows else { return Ok((0..arena.len()).collect()) };
    let known = |row: &i64| usize::try_from(*row).ok().filter(|row| *row < arena.len());
    let rows: Option<Vec<usize>> = rows.as_array().iter().map(known).collect();
    rows.ok_or_else(|| Failure::new(Kind::Option, format!("a row outside of 0 to {}", arena.len())).into())
}

/// The temporary name of a file: beside it, with the same extension.
fn draft(path: &Path) -> PathBuf {
    let mut name = OsString::from(format!(".{}-", std::process::id()));
    name.push(path.file_name().unwrap_or_default());
    path.with_file_name(name)
}

#[pymethods]
impl Records {
    fn __len__(&self) -> usize {
        self.arena.len()
    }

    /// Bytes in memory.
    #[getter]
    fn nbytes(&self) -> usize {
        self.arena.size()
    }

    /// The CSI of `rows`, complex64 (n, antennas, `n_tx`, 30); NaN where a record has none. Written to `out` if that is given.
    #[pyo3(signature = (rows, letters, n_tx, scaled, without_spatial_mapping, out=None))]
    #[allow(clippy::too_many_arguments)]
    fn csi<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
        letters: &str,
        n_tx: usize,
        scaled: bool,
        without_spatial_mapping: bool,
        out: Option<Bound<'py, PyArray4<Complex32>>>,
    ) -> PyResult<Bound<'py, PyArray4<Complex32>>> {
        let records = selected(&self.arena, rows.as_ref())?;
        let ports = antennas(letters).unwrap_or_default();
        if n_tx > 3 {
            return Err(Failure::new(Kind::Option, format!("{n_tx} streams: at most 3")).into());
        }
        let shape = Rows::new(&ports, n_tx);
        let form = Form { scaled, without_spatial_mapping };
        let dims = [records.len(), ports.len(), n_tx, SUBCARRIERS];
        let wrong = |why: String| Failure::new(Kind::Option, format!("out: {why}"));
        let array = out.unwrap_or_else(|| PyArray4::zeros(py, dims, false));
        if array.shape() != dims {
            return Err(wrong(format!("its shape is {:?}, and {dims:?} is needed", array.shape())).into());
        }
        if !array.is_c_contiguous() {
            return Err(wrong("its memory is not in C's order".to_owned()).into());
        }
        let mut writer = array.try_readwrite().map_err(|error| wrong(error.to_string()))?;
        let out: &mut [Complex32] = writer.as_slice_mut().map_err(|error| wrong(error.to_string()))?;
        let pool = pool()?;
        for (records, out) in records.chunks(PIECE).zip(out.chunks_mut(PIECE * shape.len().max(1))) {
            detached(py, || pool.install(|| decode(&self.arena, records, &shape, form, out)))?;
            py.check_signals()?;
        }
        drop(writer);
        Ok(array)
    }

    /// Factor from the card's integers to sqrt(SNR) for each record; NaN if there is none.
    fn scale<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.figure(py, rows, |bfee| scale_factor(bfee).ok())
    }

    /// Received power over all antennas, dBm; NaN if all RSSI are 0.
    fn total_rss_dbm<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.figure(py, rows, |bfee| total_rss_dbm(bfee).ok())
    }

    /// Writes `rows`, with their columns, to a file: .npz, .mat or .parquet; CSI of the antennas `letters` and this many streams. Returns
    /// the number of records without the requested scale.
    #[pyo3(signature = (path, rows, columns, letters, n_tx, scaled, without_spatial_mapping))]
    #[allow(clippy::too_many_arguments)]
    fn write(
        &self,
        py: Python<'_>,
        path: PathBuf,
        rows: Option<PyReadonlyArray1<'_, i64>>,
        columns: &Bound<'_, PyDict>,
        letters: &str,
        n_tx: usize,
        scaled: bool,
        without_spatial_mapping: bool,
    ) -> PyResult<u64> {
        let records = selected(&self.arena, rows.as_ref())?;
        let columns = from_arrays(columns)?;
        if columns.len() != records.len() {
            return Err(Failure::new(Kind::Internal, "columns and records differ in number").into());
        }
        let (arena, pool) = (Arc::clone(&self.arena), pool()?);
        let (ports, form) = (antennas(letters).unwrap_or_default(), Form { scaled, without_spatial_mapping });
        let stop = Stop::default();
        let asked = stop.clone();
        interruptible(py, &stop, move || {
            let mut export = Export::new(&arena, records, &columns, form);
            (export.antennas, export.streams, export.stop) = (ports, n_tx, Some(asked.flag()));
            // Replaces the target of a link, not the link.
            let target = path.canonicalize().unwrap_or_else(|_| path.clone());
            let half = draft(&target);
            let written = pool.install(|| export.write(&half)).map_err(|error| error.to_string());
            let renamed =
                |unscaled| std::fs::rename(&half, &target).map(|()| unscaled).map_err(|error| error.to_string());
            written.and_then(renamed).map_err(|error| {
                // It does not exist if it could not be created.
                let _ = std::fs::remove_file(&half);
                let path = path.display().to_string();
                Failure::new(Kind::Export, format!("cannot write {path}: {error}")).of(path)
            })
        })
    }

    /// Lengths (MPDU and bfee of each record) and bytes: the argument of [`Records::restore`].
    fn dump<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<(Bound<'py, PyArray1<u32>>, Bound<'py, PyBytes>)> {
        let records = selected(&self.arena, rows.as_ref())?;
        let (lengths, bytes) = detached(py, || {
            let (mut lengths, mut bytes) = (Vec::with_capacity(2 * records.len()), Vec::new());
            for &record in &records {
                for body in [self.arena.mpdu(record), self.arena.body(record)] {
                    lengths.push(body.len() as u32);
                    bytes.extend_from_slice(body);
                }
            }
            (lengths, bytes)
        })?;
        Ok((lengths.into_pyarray(py), PyBytes::new(py, &bytes)))
    }

    /// Records from the result of [`Records::dump`].
    #[staticmethod]
    fn restore(lengths: PyReadonlyArray1<'_, u32>, bytes: &Bound<'_, PyBytes>) -> PyResult<Self> {
        let wrong = || PyErr::from(Failure::new(Kind::Log, "a pickled log whose records do not fit its lengths"));
        let mut arena = Arena::default();
        let mut rest = bytes.as_bytes();
        let lengths = lengths.as_slice().map_err(|_| wrong())?;
        for pair in lengths.chunks(2) {
            let [mpdu, bfee] = pair else { return Err(wrong()) };
            let (head, tail) = rest.split_at_checked(*mpdu as usize).ok_or_else(wrong)?;
            let (body, tail) = tail.split_at_checked(*bfee as usize).ok_or_else(wrong)?;
            Bfee::new_checked(body).map_err(|_| wrong())?;
            if !head.is_empty() {
                arena.note_mpdu(head);
            }
            arena.push(body);
            rest = tail;
        }
        if rest.is_empty() { Ok(Self { arena: Arc::new(arena) }) } else { Err(wrong()) }
    }
}

impl Records {
    /// Records and their columns in their Python form.
    pub fn new(py: Python<'_>, arena: Arena, columns: Columns) -> PyResult<(Self, Bound<'_, PyDict>)> {
        Ok((Self { arena: Arc::new(arena) }, arrays(py, columns)?))
    }

    fn figure<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
        of: impl Fn(&Bfee<'_>) -> Option<f64> + Sync + Send,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let records = selected(&self.arena, rows.as_ref())?;
        let pool = pool()?;
        let value = |record: &usize| self.arena.bfee(*record).and_then(|bfee| of(&bfee)).unwrap_or(f64::NAN);
        let values: Vec<f64> = detached(py, || pool.install(|| records.par_iter().map(value).collect()))?;
        Ok(values.into_pyarray(py))
    }
}

/// The result of `read`: records, columns, facts about the log as JSON, and the letters of its antennas with its streams.
type Read4<'py> = (Records, Bound<'py, PyDict>, String, (String, usize));

/// The antenna letters of CSI's rows, and its streams.
pub fn shape(widest: &Widest) -> (String, usize) {
    (widest.antennas().iter().map(Antenna::to_string).collect(), widest.streams())
}

/// Reads a log into memory.
#[pyfunction]
#[pyo3(signature = (file, macs=None, t=None, letters=None))]
pub fn read<'py>(
    py: Python<'py>,
    file: &Bound<'py, PyAny>,
    macs: Option<Vec<String>>,
    t: Option<(Option<f64>, Option<f64>)>,
    letters: Option<&str>,
) -> PyResult<Read4<'py>> {
    let mut intake = Reading::new(open(file, &Stop::default())?, filter(macs, t, letters)?);
    if is_read_here(file)? {
        read_on(py, &mut intake, usize::MAX)?;
    } else {
        read_all(py, &mut intake)?;
    }
    let (arena, columns) = intake.take();
    let info = info(&intake, intake.source.name(), Some(intake.source.bytes()))?;
    let shape = shape(&columns.widest());
    let (records, columns) = Records::new(py, arena, columns)?;
    Ok((records, columns, info, shape))
}
