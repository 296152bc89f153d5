//! The native half of a log: packed records, decoded on demand.

use crate::columns::{arrays, from_arrays};
use crate::error::{Failure, Kind, detached, interruptible};
use crate::intake::{filter, info, open, read_all};
use crate::pool::pool;
use csi5300::signal::csi::{scale_factor, total_rss_dbm};
use csi5300::source::replay::Replay;
use csi5300_lab::export::Export;
use csi5300_lab::table::{Arena, Columns, Form, Reading, Rows, antennas, decode};
use driver_iface::bfee::{Bfee, SUBCARRIERS};
use num_complex::Complex32;
use numpy::{IntoPyArray, PyArray1, PyArray4, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rayon::prelude::*;
use std::io::Read;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Records decoded between two looks at signals.
const PIECE: usize = 1 << 18;

/// bfee records in memory, packed as the card sent them.
#[pyclass(frozen, module = "csi5300._native")]
pub struct Records {
    /// The records.
    pub arena: Arc<Arena>,
}

/// Numbers of records, in the caller's order; all where none are named.
pub fn selected(arena: &Arena, rows: Option<&PyReadonlyArray1<'_, i64>>) -> PyResult<Vec<usize>> {
    let Some(rows) = rows else { return Ok((0..arena.len()).collect()) };
    let known = |row: &i64| usize::try_from(*row).ok().filter(|row| *row < arena.len());
    let rows: Option<Vec<usize>> = rows.as_array().iter().map(known).collect();
    rows.ok_or_else(|| Failure::new(Kind::Option, format!("a row outside of 0 to {}", arena.len())).into())
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

    /// The CSI of `rows`, complex64 (n, antennas, `n_tx`, 30); not a number where a record has none.
    #[pyo3(signature = (rows, letters, n_tx, scaled, without_spatial_mapping))]
    fn csi<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
        letters: &str,
        n_tx: usize,
        scaled: bool,
        without_spatial_mapping: bool,
    ) -> PyResult<Bound<'py, PyArray4<Complex32>>> {
        let records = selected(&self.arena, rows.as_ref())?;
        let ports = antennas(letters).unwrap_or_default();
        if n_tx > 3 {
            return Err(Failure::new(Kind::Option, format!("{n_tx} streams: at most 3")).into());
        }
        let shape = Rows::new(&ports, n_tx);
        let form = Form { scaled, without_spatial_mapping };
        let array = PyArray4::zeros(py, [records.len(), ports.len(), n_tx, SUBCARRIERS], false);
        let mut writer = array.readwrite();
        let out: &mut [Complex32] =
            writer.as_slice_mut().map_err(|error| Failure::new(Kind::Internal, error.to_string()))?;
        let pool = pool()?;
        let pieces = out.chunks_mut(PIECE * shape.len().max(1)).zip(records.chunks(PIECE));
        for (out, records) in pieces {
            detached(py, || pool.install(|| decode(&self.arena, records, &shape, form, out)))?;
            py.check_signals()?;
        }
        drop(writer);
        Ok(array)
    }

    /// Factor from the card's integers to sqrt(SNR) of each record; not a number where there is none.
    fn scale<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.figure(py, rows, |bfee| scale_factor(bfee).ok())
    }

    /// Received power over all antennas, dBm; not a number where all RSSI are 0.
    fn total_rss_dbm<'py>(
        &self,
        py: Python<'py>,
        rows: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.figure(py, rows, |bfee| total_rss_dbm(bfee).ok())
    }

    /// Writes `rows`, whose columns are given, to a file: .npz, .mat or .parquet. Returns how many have no scale, where one was
    /// asked for.
    #[pyo3(signature = (path, rows, columns, letters, scaled, without_spatial_mapping))]
    fn write(
        &self,
        py: Python<'_>,
        path: PathBuf,
        rows: Option<PyReadonlyArray1<'_, i64>>,
        columns: &Bound<'_, PyDict>,
        letters: &str,
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
        interruptible(py, move || {
            let export = Export::new(&arena, records, &columns, form).with_antennas(&ports);
            let written = pool.install(|| export.write(&path));
            let refused = |error| Failure::new(Kind::Export, error).of(path.display().to_string());
            written.map(|()| export.unscaled()).map_err(refused)
        })
    }

    /// Lengths (MPDU and bfee of each record) and bytes: what [`Records::restore`] takes.
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

    /// Records from what [`Records::dump`] gave.
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
    /// Records and their columns as Python has them.
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

/// What `read` gives: records, columns, and what is known of the log as JSON.
type Read3<'py> = (Records, Bound<'py, PyDict>, String);

/// Reads a log into memory.
#[pyfunction]
#[pyo3(signature = (file, macs=None, t=None, letters=None))]
pub fn read<'py>(
    py: Python<'py>,
    file: &Bound<'py, PyAny>,
    macs: Option<Vec<String>>,
    t: Option<(Option<f64>, Option<f64>)>,
    letters: Option<&str>,
) -> PyResult<Read3<'py>> {
    let mut intake = Reading::new(open(file)?, filter(macs, t, letters)?);
    read_all(py, &mut intake, usize::MAX)?;
    let (arena, columns) = intake.take();
    let info = info(&intake, intake.source().name(), Some(intake.source().bytes()))?;
    let (records, columns) = Records::new(py, arena, columns)?;
    Ok((records, columns, info))
}

/// A log read piece by piece.
#[pyclass(module = "csi5300._native")]
pub struct Scanner {
    /// Behind a lock that nobody else holds: readers may be sent between threads, not shared.
    intake: Mutex<Reading<Replay<Box<dyn Read + Send>>>>,
    chunk: usize,
}

#[pymethods]
impl Scanner {
    #[new]
    #[pyo3(signature = (file, chunk, macs=None, t=None, letters=None))]
    fn new(
        file: &Bound<'_, PyAny>,
        chunk: usize,
        macs: Option<Vec<String>>,
        t: Option<(Option<f64>, Option<f64>)>,
        letters: Option<&str>,
    ) -> PyResult<Self> {
        if chunk == 0 {
            return Err(Failure::new(Kind::Option, "chunk: at least 1 record").into());
        }
        Ok(Self { intake: Mutex::new(Reading::new(open(file)?, filter(macs, t, letters)?)), chunk })
    }

    /// The next piece, or None at the end.
    fn next<'py>(&mut self, py: Python<'py>) -> PyResult<Option<(Records, Bound<'py, PyDict>)>> {
        let intake = self.intake.get_mut().unwrap_or_else(PoisonError::into_inner);
        read_all(py, intake, self.chunk)?;
        let (arena, columns) = intake.take();
        if arena.len() == 0 {
            return Ok(None);
        }
        Records::new(py, arena, columns).map(Some)
    }

    /// What is known of the log so far, as JSON.
    fn info(&mut self) -> PyResult<String> {
        let intake = self.intake.get_mut().unwrap_or_else(PoisonError::into_inner);
        let source = intake.source();
        Ok(info(intake, source.name(), Some(source.bytes()))?)
    }
}
