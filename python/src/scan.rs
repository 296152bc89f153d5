//! Reads logs piece by piece, in constant memory.

use crate::error::{Failure, Kind, Stop};
use crate::intake::{filter, info, open, read_on};
use crate::records::{Records, shape};
use csi5300::source::replay::Replay;
use csi5300_lab::table::{Reading, Widest};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::io::Read;
use std::sync::{Mutex, PoisonError};

/// Records whose columns are examined at a time.
const PIECE: usize = 65_536;

type Intake = Reading<Replay<Box<dyn Read + Send>>>;

/// The antenna letters and the number of streams over all records that the filter keeps: reads the whole log.
#[pyfunction]
#[pyo3(signature = (file, macs=None, t=None, letters=None))]
pub fn widest(
    py: Python<'_>,
    file: &Bound<'_, PyAny>,
    macs: Option<Vec<String>>,
    t: Option<(Option<f64>, Option<f64>)>,
    letters: Option<&str>,
) -> PyResult<(String, usize)> {
    let mut intake = Reading::new(open(file, &Stop::default())?, filter(macs, t, letters)?).without_bodies();
    let mut widest = Widest::default();
    loop {
        read_on(py, &mut intake, PIECE)?;
        let (_, columns) = intake.take();
        if columns.is_empty() {
            return Ok(shape(&widest));
        }
        widest.note(&columns);
    }
}

/// A log read piece by piece.
#[pyclass(module = "csi5300._native")]
pub struct Scanner {
    /// Behind an uncontended lock: readers may be sent between threads but not shared.
    intake: Mutex<Intake>,
    chunk: usize,
    /// A piece was returned.
    begun: bool,
    /// Why the log cannot be read beyond the returned piece.
    failed: Option<PyErr>,
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
        let source = open(file, &Stop::default())?;
        let intake = Mutex::new(Reading::new(source, filter(macs, t, letters)?));
        Ok(Self { intake, chunk, begun: false, failed: None })
    }

    /// The next piece, or None at the end; a log without kept records has one empty piece.
    fn next<'py>(&mut self, py: Python<'py>) -> PyResult<Option<(Records, Bound<'py, PyDict>)>> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        let intake = self.intake.get_mut().unwrap_or_else(PoisonError::into_inner);
        read_on(py, intake, self.chunk)?;
        let (arena, columns) = intake.take();
        if self.begun && columns.is_empty() {
            return Ok(None);
        }
        self.begun = true;
        // A piece includes the losses up to the next record or the end.
        self.failed = read_on(py, intake, 1).err();
        Records::new(py, arena, columns).map(Some)
    }

    /// Facts about the log so far, as JSON.
    fn info(&mut self) -> PyResult<String> {
        let intake = self.intake.get_mut().unwrap_or_else(PoisonError::into_inner);
        let source = &intake.source;
        Ok(info(intake, source.name(), Some(source.bytes()))?)
    }
}
