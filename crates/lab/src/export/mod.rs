//! Logs as files for other programs: NPZ (NumPy), MAT (MATLAB, Octave, SciPy) and, with the feature `parquet`, Parquet (DuckDB,
//! Polars, pandas, Spark). The log was read once, into a [`table`](crate::table), whatever is written; or only its columns were,
//! and the CSI is read while it is written.

mod blocks;
mod error;
mod fields;
mod log_reader;
mod mat;
pub mod npz;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(test)]
mod tests;
mod walk;

pub use error::ExportError;

use crate::table::{Arena, Columns, Form, NO_ANTENNA, Order};
use csi5300::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ, SUBCARRIERS};
use driver_iface::bfee::{Antenna, rate};
use num_complex::Complex32;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use walk::{Figures, Walk};

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
    extension(path).is_some_and(|extension| known.contains(&extension.as_str()))
}

/// The extension in small letters.
fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

/// Where the records of an export are.
#[derive(Clone, Debug)]
enum Source<'a> {
    /// In memory, at these places.
    Arena { arena: &'a Arena, records: Vec<usize> },
    /// In a log, where the column of offsets says.
    Log(&'a Path),
}

/// Records of a table on their way to a file.
#[derive(Clone, Debug)]
pub struct Export<'a> {
    source: Source<'a>,
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
        Self::with_source(Source::Arena { arena, records }, columns, form)
    }

    /// The records of a log, a regular file, of which only the `columns` are in memory
    /// ([`Reading::without_bodies`](crate::table::Reading::without_bodies)): their CSI is read from the log, on one thread, while it is
    /// written. Otherwise as [`Export::new`].
    #[must_use]
    pub fn of_log(log: &'a Path, columns: &'a Columns, form: Form) -> Self {
        Self::with_source(Source::Log(log), columns, form)
    }

    fn with_source(source: Source<'a>, columns: &'a Columns, form: Form) -> Self {
        let streams = columns.widest().streams();
        Self { source, columns, antennas: Antenna::ALL.to_vec(), streams, form, stop: None }
    }

    /// Number of records.
    fn len(&self) -> usize {
        match &self.source {
            Source::Arena { records, .. } => records.len(),
            Source::Log(_) => self.columns.len(),
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

    /// With so many streams: what a record has beyond is left out, what it has not is not a number.
    #[must_use]
    pub fn with_streams(mut self, streams: usize) -> Self {
        self.streams = streams;
        self
    }

    /// Writes a file whose extension says its format ([`KNOWN`]); one that is there is replaced. Gives the number of records without
    /// a scale where one was asked for: their CSI is not a number.
    ///
    /// # Errors
    /// If there is no such format, the file cannot be written, the log cannot be read again or was changed, or that was stopped:
    /// then it is not whole.
    pub fn write(&self, path: &Path) -> Result<u64, ExportError> {
        let written = match extension(path).as_deref() {
            Some("npz") => self.npz(path),
            Some("mat") => self.mat(path),
            #[cfg(feature = "parquet")]
            Some("parquet") => parquet::write(self, path),
            _ => Err(ExportError::Extension { file: path.display().to_string(), known: KNOWN }),
        };
        if self.is_stopped() {
            return Err(ExportError::Stopped { file: path.display().to_string() });
        }
        written.map(|figures| if self.form.scaled { figures.unscaled() } else { 0 })
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

    fn npz(&self, path: &Path) -> Result<Figures, ExportError> {
        let (n, ports, streams) = (self.len() as u64, self.antennas.len(), self.streams);
        let shape = [n, SUBCARRIERS as u64, ports as u64, streams as u64];
        let mut walk = Walk::new(self, Order::SubcarriersFirst)?;
        let bytes = shape.iter().product::<u64>() * size_of::<Complex32>() as u64 + n * fields::BYTES;
        let mut npz = npz::Npz::create_for(path, bytes)?;
        let written = npz.blocks("csi", &shape, |piece| walk.next(piece));
        // Why there were too few values, if there were.
        let figures = walk.finish()?;
        written?;
        fields::write(self, &figures, &mut npz)?;
        npz.finish()?;
        Ok(figures)
    }

    /// `csi` is (subcarrier, stream, antenna, record), in MATLAB's order of indices.
    fn mat(&self, path: &Path) -> Result<Figures, ExportError> {
        let mut mat = mat::Mat::create(path)?;
        let (n, ports) = (self.len() as u64, self.antennas.len() as u64);
        let dims = [SUBCARRIERS as u64, self.streams as u64, ports, n];
        let order = Order::SubcarriersLast;
        let (mut first, mut second) = (Walk::new(self, order)?, Walk::new(self, order)?);
        let written = mat.complex(
            "csi",
            &dims,
            vectors(&mut first).flatten().map(|h| h.re),
            vectors(&mut second).flatten().map(|h| h.im),
        );
        let figures = first.finish()?;
        second.finish()?;
        written?;
        fields::write(self, &figures, &mut mat)?;
        mat.finish()?;
        Ok(figures)
    }

    /// The antenna of each chain of a record is known.
    fn antennas_known(&self) -> impl Iterator<Item = bool> {
        self.columns.antenna_order.chunks(3).map(|order| order.first().is_some_and(|first| *first != NO_ANTENNA))
    }
}

/// The pieces of a walk as vectors of their own.
fn vectors(walk: &mut Walk<'_>) -> impl Iterator<Item = Vec<Complex32>> {
    std::iter::from_fn(move || {
        let mut piece = Vec::new();
        walk.next(&mut piece);
        (!piece.is_empty()).then_some(piece)
    })
}
