//! Logs as files for other programs: NPZ (NumPy), MAT (MATLAB, Octave, SciPy) and, with the feature `parquet`, Parquet (DuckDB,
//! Polars, pandas, Spark). The log was read once, into a [`table`](crate::table), whatever is written.

mod blocks;
mod error;
mod fields;
mod mat;
pub mod npz;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(test)]
mod tests;

pub use error::ExportError;

use crate::table::{Arena, Columns, Form, NO_ANTENNA, Rows, decode};
use csi5300::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ, SUBCARRIERS};
use driver_iface::bfee::{Antenna, rate};
use num_complex::Complex32;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Records decoded at a time.
const PIECE: usize = 4_096;

/// What is written, for errors and help.
#[cfg(feature = "parquet")]
pub const KNOWN: &str = ".npz, .mat or .parquet";
/// What is written, for errors and help.
#[cfg(not(feature = "parquet"))]
pub const KNOWN: &str = ".npz or .mat";

/// True for a file whose extension names a format of [`KNOWN`].
#[must_use]
pub fn is_known(path: &Path) -> bool {
    let known: &[&str] = if cfg!(feature = "parquet") { &["npz", "mat", "parquet"] } else { &["npz", "mat"] };
    path.extension().and_then(|extension| extension.to_str()).is_some_and(|extension| known.contains(&extension))
}

/// Records of a table on their way to a file.
#[derive(Clone, Debug)]
pub struct Export<'a> {
    arena: &'a Arena,
    records: Vec<usize>,
    columns: &'a Columns,
    antennas: Vec<Antenna>,
    streams: usize,
    form: Form,
    stop: Option<&'a AtomicBool>,
}

impl<'a> Export<'a> {
    /// The `records` of a table, by their places in the arena; `columns` has a value for each of them, in the same order. Rows
    /// of CSI are antennas A, B and C, columns as many streams as a record has at most.
    #[must_use]
    pub fn new(arena: &'a Arena, records: Vec<usize>, columns: &'a Columns, form: Form) -> Self {
        let streams = columns.n_tx.iter().copied().max().unwrap_or(1);
        Self {
            arena,
            records,
            columns,
            antennas: Antenna::ALL.to_vec(),
            streams: usize::from(streams),
            form,
            stop: None,
        }
    }

    /// With a flag that ends the writing early, once somebody sets it: [`ExportError::Stopped`].
    #[must_use]
    pub fn with_stop(mut self, stop: &'a AtomicBool) -> Self {
        self.stop = Some(stop);
        self
    }

    fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// With only these antennas' rows.
    #[must_use]
    pub fn with_antennas(mut self, antennas: &[Antenna]) -> Self {
        self.antennas = antennas.to_vec();
        self
    }

    /// Writes a file whose extension says its format ([`KNOWN`]); one that is there is replaced.
    ///
    /// # Errors
    /// If there is no such format, the file cannot be written, or that was stopped: then it is not whole.
    pub fn write(&self, path: &Path) -> Result<(), ExportError> {
        let written = match path.extension().and_then(|extension| extension.to_str()) {
            Some("npz") => self.npz(path),
            Some("mat") => self.mat(path),
            #[cfg(feature = "parquet")]
            Some("parquet") => parquet::write(self, path),
            _ => Err(ExportError::Extension { file: path.display().to_string(), known: KNOWN }),
        };
        if self.is_stopped() { Err(ExportError::Stopped { file: path.display().to_string() }) } else { written }
    }

    /// Records without a scale, where one was asked for: their CSI is not a number.
    #[must_use]
    pub fn unscaled(&self) -> u64 {
        let missing = |record: &&usize| {
            self.arena.bfee(**record).is_none_or(|bfee| csi5300::signal::csi::scale_factor(&bfee).is_err())
        };
        if self.form.scaled { self.records.iter().filter(missing).count() as u64 } else { 0 }
    }

    /// Records whose antennas are not known: their rows are in the order of chains.
    #[must_use]
    pub fn without_antennas(&self) -> u64 {
        self.antennas_known().filter(|known| !known).count() as u64
    }

    /// The subcarriers of the records' CSI; none where 20 and 40 MHz are mixed.
    fn subcarriers(&self) -> Option<[i8; SUBCARRIERS]> {
        let wide = self.columns.rate.iter().filter(|word| **word & rate::HT40 != 0).count();
        match wide {
            0 => Some(INDICES_20_MHZ),
            all if all == self.columns.len() => Some(INDICES_40_MHZ),
            _ => None,
        }
    }

    /// The CSI of all records, `[record][antenna][stream][subcarrier]`, decoded piece by piece, until it is stopped: each call
    /// puts the next piece in the place of what is in the vector, and nothing behind the last.
    fn pieces(&self) -> impl FnMut(&mut Vec<Complex32>) {
        let rows = Rows::new(&self.antennas, self.streams);
        let mut records = self.records.chunks(PIECE);
        move |piece| {
            let records = records.next().filter(|_| !self.is_stopped()).unwrap_or_default();
            piece.resize(records.len() * rows.len(), Complex32::default());
            decode(self.arena, records, &rows, self.form, piece);
        }
    }

    /// The same as vectors of their own.
    fn csi(&self) -> impl Iterator<Item = Vec<Complex32>> {
        let mut next = self.pieces();
        std::iter::from_fn(move || {
            let mut piece = Vec::new();
            next(&mut piece);
            (!piece.is_empty()).then_some(piece)
        })
    }

    fn npz(&self, path: &Path) -> Result<(), ExportError> {
        let mut npz = npz::Npz::create(path)?;
        let (n, ports, streams) = (self.records.len() as u64, self.antennas.len(), self.streams);
        let shape = [n, SUBCARRIERS as u64, ports as u64, streams as u64];
        let (mut next, mut piece) = (self.pieces(), Vec::new());
        npz.blocks("csi", &shape, |turned| {
            next(&mut piece);
            turned.resize(piece.len(), Complex32::default());
            subcarriers_first(&piece, ports * streams, turned);
        })?;
        fields::write(self, &mut npz)?;
        npz.finish()
    }

    /// `csi` is (subcarrier, stream, antenna, record), in MATLAB's order of indices.
    fn mat(&self, path: &Path) -> Result<(), ExportError> {
        let mut mat = mat::Mat::create(path)?;
        let (n, ports) = (self.records.len() as u64, self.antennas.len() as u64);
        let dims = [SUBCARRIERS as u64, self.streams as u64, ports, n];
        mat.complex("csi", &dims, self.csi().flatten().map(|h| h.re), self.csi().flatten().map(|h| h.im))?;
        fields::write(self, &mut mat)?;
        mat.finish()
    }

    /// The antenna of each chain of a record is known.
    fn antennas_known(&self) -> impl Iterator<Item = bool> {
        self.columns.antenna_order.chunks(3).map(|order| order.first().is_some_and(|first| *first != NO_ANTENNA))
    }
}

/// Turns records of `columns` columns from `[column][subcarrier]` to `[subcarrier][column]`, on all cores of the current pool.
fn subcarriers_first(records: &[Complex32], columns: usize, out: &mut [Complex32]) {
    let size = columns * SUBCARRIERS;
    if columns <= 1 {
        return out.copy_from_slice(records);
    }
    let pairs = records.par_chunks_exact(size).zip(out.par_chunks_exact_mut(size)).with_min_len(256);
    pairs.for_each(|(record, out)| {
        for (column, values) in record.as_chunks::<SUBCARRIERS>().0.iter().enumerate() {
            for (place, h) in out.iter_mut().skip(column).step_by(columns).zip(values) {
                *place = *h;
            }
        }
    });
}
