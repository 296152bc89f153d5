//! Exports logs for other programs: CSV, NPZ (NumPy), MAT (MATLAB, Octave, SciPy) and, with the feature `parquet`, Parquet (DuckDB,
//! Polars, pandas, Spark). The log is read once into a [`table`](crate::table); or only its columns are, and the CSI is read
//! during writing.

mod arrays;
mod csv;
mod other_cards;
#[cfg(feature = "parquet")]
mod parquet;

use crate::Failure;
use crate::table::{Arena, Columns, Decoder, Form, LogReader, NO_ANTENNA, NO_TIME, Order, Rows, decode_in};
pub use arrays::Npz;
use arrays::{Mat, Number};
use csi5300::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ};
use csi5300::signal::csi::{scale_factor, total_rss_dbm};
use driver_iface::bfee::{Antenna, Bfee, SUBCARRIERS, rate};
use num_complex::Complex32;
pub use other_cards::CardFrames;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// The formats, for errors and help.
pub const KNOWN: &str = if cfg!(feature = "parquet") { ".csv, .npz, .mat or .parquet" } else { ".csv, .npz or .mat" };

/// True for a file whose extension is one of [`KNOWN`].
#[must_use]
pub fn is_known(path: &Path) -> bool {
    let known = |extension: String| match extension.as_str() {
        "parquet" => cfg!(feature = "parquet"),
        other => ["csv", "npz", "mat"].contains(&other),
    };
    extension(path).is_some_and(known)
}

/// The refusal of a file that is none of the `known` ones.
fn unknown(known: &str) -> Failure {
    format!("unknown extension, CSI is exported as {known}").into()
}

/// The extension in lower case.
fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

/// Where the records of an export are.
#[derive(Clone, Debug)]
enum Source<'a> {
    /// In memory, at these places.
    Arena { arena: &'a Arena, records: Vec<usize> },
    /// In a log, at the offsets in the column.
    Log(&'a Path),
}

/// Records of a table to be exported.
#[derive(Clone, Debug)]
pub struct Export<'a> {
    source: Source<'a>,
    columns: &'a Columns,
    /// Only these antennas' rows are written.
    pub antennas: Vec<Antenna>,
    /// Further streams of a record are dropped, missing ones are NaN.
    pub streams: usize,
    form: Form,
    /// Stops the writing, an error, once it is set.
    pub stop: Option<&'a AtomicBool>,
}

impl<'a> Export<'a> {
    /// The `records` of a table, by their places in the arena; `columns` has a value for each, in the same order. Rows of CSI are
    /// antennas A, B and C; columns are as many streams as any record has.
    #[must_use]
    pub fn new(arena: &'a Arena, records: Vec<usize>, columns: &'a Columns, form: Form) -> Self {
        Self::with_source(Source::Arena { arena, records }, columns, form)
    }

    /// The records of a log, a regular file, of which only the `columns` are in memory
    /// ([`Reading::without_bodies`](crate::table::Reading::without_bodies)). Their CSI is read during writing, on one thread.
    /// Otherwise as [`Export::new`].
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

    fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// Writes a file in the format of its extension ([`KNOWN`]); replaces an existing one. Returns the number of records without
    /// the requested scale: their CSI is NaN.
    ///
    /// # Errors
    /// If the format is unknown, the file cannot be written, the log cannot be read again or has changed, or writing was stopped:
    /// then the file is incomplete.
    pub fn write(&self, path: &Path) -> Result<u64, Failure> {
        let written = match extension(path).as_deref() {
            Some("csv") => csv::write(self, path),
            Some("npz") => self.npz(path),
            Some("mat") => self.mat(path),
            #[cfg(feature = "parquet")]
            Some("parquet") => parquet::write(self, path),
            _ => Err(unknown(KNOWN)),
        };
        if self.is_stopped() {
            return Err("writing was stopped".into());
        }
        written.map(|figures| if self.form.scaled { figures.unscaled() } else { 0 })
    }

    /// Records with unknown antennas: their rows are in the order of chains.
    #[must_use]
    pub fn without_antennas(&self) -> u64 {
        self.antennas_known().filter(|known| !known).count() as u64
    }

    /// The subcarriers of the records' CSI; `None` if 20 and 40 MHz are mixed.
    fn subcarriers(&self) -> Option<[i8; SUBCARRIERS]> {
        let wide = self.columns.rate.iter().filter(|word| **word & rate::HT40 != 0).count();
        indices(wide, self.columns.len())
    }

    fn npz(&self, path: &Path) -> Result<Figures, Failure> {
        let (n, ports, streams) = (self.len() as u64, self.antennas.len(), self.streams);
        let shape = [n, SUBCARRIERS as u64, ports as u64, streams as u64];
        let mut walk = Walk::new(self, Order::SubcarriersFirst)?;
        let bytes = shape.iter().product::<u64>() * size_of::<Complex32>() as u64 + n * BYTES;
        let mut npz = Npz::create_for(path, bytes)?;
        let written = npz.blocks("csi", &shape, |piece| _ = walk.next(piece));
        // An error here explains why there were too few values.
        let figures = walk.finish()?;
        written?;
        write_fields(self, &figures, &mut npz)?;
        npz.finish()?;
        Ok(figures)
    }

    /// `csi` is (subcarrier, stream, antenna, record), in MATLAB's order of indices.
    fn mat(&self, path: &Path) -> Result<Figures, Failure> {
        let mut mat = Mat::create(path)?;
        let (n, ports) = (self.len() as u64, self.antennas.len() as u64);
        let dims = [SUBCARRIERS as u64, self.streams as u64, ports, n];
        let order = Order::SubcarriersLast;
        let (mut first, mut second) = (Walk::new(self, order)?, Walk::new(self, order)?);
        let re = vectors(&mut first).flatten().map(|h| h.re);
        let im = vectors(&mut second).flatten().map(|h| h.im);
        let written = mat.complex("csi", &dims, re, im);
        let figures = first.finish()?;
        second.finish()?;
        written?;
        write_fields(self, &figures, &mut mat)?;
        mat.finish()?;
        Ok(figures)
    }

    /// Why a log cannot be read again.
    fn gone(&self, path: &Path, source: &io::Error) -> Failure {
        format!("cannot read {} again: {source}", path.display()).into()
    }

    /// True if the antenna of each chain of a record is known.
    fn antennas_known(&self) -> impl Iterator<Item = bool> {
        self.columns.antenna_order.chunks(3).map(|order| order.first().is_some_and(|first| *first != NO_ANTENNA))
    }
}

/// Splits a walk into separate vectors.
fn vectors(walk: &mut Walk<'_>) -> impl Iterator<Item = Vec<Complex32>> {
    std::iter::from_fn(move || {
        let mut piece = Vec::new();
        walk.next(&mut piece).map(|_| piece)
    })
}

/// The subcarriers of `all` records of which `wide` are 40 MHz wide; `None` if they are mixed.
pub(crate) fn indices(wide: usize, all: usize) -> Option<[i8; SUBCARRIERS]> {
    match wide {
        0 => Some(INDICES_20_MHZ),
        _ if wide == all => Some(INDICES_40_MHZ),
        _ => None,
    }
}

// The pass through the records of an export: once, piece by piece, each decoded into the caller's memory.

/// Records decoded at a time on all cores.
const PIECE: usize = 4_096;
/// Bytes of a log's CSI decoded at a time: few enough to stay in the second-level cache until they are written, many enough for
/// one system call.
const LOG_PIECE: usize = 512 * 1024;

/// Figures computed for each record, in order; NaN where a record has none.
#[derive(Clone, Debug, Default)]
struct Figures {
    /// Received power, dBm.
    pub rss_dbm: Vec<f64>,
    /// Factor from the card's integers to sqrt(SNR).
    pub scale: Vec<f64>,
}

impl Figures {
    /// Adds a record's figures; `scale` is its factor, if it has one.
    fn push(&mut self, bfee: Option<&Bfee<'_>>, scale: Option<f64>) {
        self.rss_dbm.push(bfee.and_then(|bfee| total_rss_dbm(bfee).ok()).unwrap_or(f64::NAN));
        self.scale.push(scale.unwrap_or(f64::NAN));
    }

    /// Records without a scale.
    pub fn unscaled(&self) -> u64 {
        self.scale.iter().filter(|scale| scale.is_nan()).count() as u64
    }
}

/// A pass through all records of an export.
struct Walk<'a> {
    export: &'a Export<'a>,
    order: Order,
    rows: Rows,
    log: Option<(LogReader, Decoder)>,
    done: usize,
    figures: Figures,
    failure: Option<Failure>,
}

impl<'a> Walk<'a> {
    /// Starts before the first record, with CSI in this order.
    ///
    /// # Errors
    /// If the records are in a log that cannot be opened.
    pub fn new(export: &'a Export<'a>, order: Order) -> Result<Self, Failure> {
        let rows = Rows::new(&export.antennas, export.streams);
        let log = match &export.source {
            Source::Arena { .. } => None,
            Source::Log(path) => Some((
                LogReader::open(path).map_err(|source| export.gone(path, &source))?,
                Decoder::new(order, rows.clone(), export.form),
            )),
        };
        Ok(Self { export, order, rows, log, done: 0, figures: Figures::default(), failure: None })
    }

    /// Replaces the vector's content with the CSI of the next records, and returns the number of the first one. `None`, and no
    /// CSI, after the last record, once the export was stopped, or if the log cannot be read further ([`Walk::finish`] reports
    /// it).
    pub fn next(&mut self, csi: &mut Vec<Complex32>) -> Option<usize> {
        let log_piece = (LOG_PIECE / (size_of::<Complex32>() * self.rows.len().max(1))).max(1);
        let size = if self.log.is_some() { log_piece } else { PIECE };
        let from = self.done;
        let wanted = if self.failure.is_some() || self.export.is_stopped() { 0 } else { size };
        self.done = (from + wanted).min(self.export.len());
        csi.resize((self.done - from) * self.rows.len(), Complex32::default());
        match &self.export.source {
            Source::Arena { arena, records } => {
                let records = records.get(from..self.done).unwrap_or_default();
                decode_in(self.order, arena, records, &self.rows, self.export.form, csi);
                for bfee in records.iter().map(|record| arena.bfee(*record)) {
                    self.figures.push(bfee.as_ref(), bfee.and_then(|bfee| scale_factor(&bfee).ok()));
                }
            }
            Source::Log(path) => {
                if let Err(failure) = self.read(path, from, csi) {
                    self.failure = Some(failure);
                    csi.clear();
                }
            }
        }
        (!csi.is_empty()).then_some(from)
    }

    /// Reads and decodes the records after the decoded ones, starting with number `from`.
    fn read(&mut self, path: &Path, from: usize, csi: &mut [Complex32]) -> Result<(), Failure> {
        let Some((log, decoder)) = &mut self.log else { return Ok(()) };
        let offsets = self.export.columns.offset.get(from..self.done).unwrap_or_default();
        for (offset, out) in offsets.iter().zip(csi.chunks_exact_mut(self.rows.len().max(1))) {
            let bfee = log.bfee(*offset).map_err(|source| self.export.gone(path, &source))?;
            let changed = || {
                let path = path.display();
                format!(
                    "{path} was changed while it was exported: the record at byte {offset} is gone; export a copy of it"
                )
            };
            let bfee = bfee.ok_or_else(changed)?;
            let scale = decoder.decode(&bfee, out);
            self.figures.push(Some(&bfee), scale);
        }
        Ok(())
    }

    /// The figures of all records.
    ///
    /// # Errors
    /// If the log could not be read to its end, or changed after its columns were read.
    pub fn finish(self) -> Result<Figures, Failure> {
        self.failure.map_or(Ok(self.figures), Err)
    }
}

// The fields of records besides their CSI, as arrays of their own types.

/// A file for arrays of `count` times `width` values, where each record's values are adjacent.
trait Target {
    /// Adds an array.
    ///
    /// # Errors
    /// If it cannot be written.
    fn put<T: Number>(&mut self, name: &str, size: [u64; 2], values: impl Iterator<Item = T>) -> io::Result<()>;
}

impl Target for Npz {
    fn put<T: Number>(&mut self, name: &str, size: [u64; 2], values: impl Iterator<Item = T>) -> io::Result<()> {
        let [count, width] = size;
        let shape = if width == 1 { vec![count] } else { vec![count, width] };
        self.array(name, &shape, values)
    }
}

impl Target for Mat {
    /// With the records last, as MATLAB orders indices.
    fn put<T: Number>(&mut self, name: &str, size: [u64; 2], values: impl Iterator<Item = T>) -> io::Result<()> {
        self.array(name, &[size[1], size[0]], values)
    }
}

/// Bytes that [`write`] writes for each record.
const BYTES: u64 = 79;

/// Writes all fields.
fn write_fields(export: &Export<'_>, figures: &Figures, file: &mut impl Target) -> io::Result<()> {
    let (n, columns) = (export.len() as u64, export.columns);
    let host = columns.host_us.iter().map(|us| if *us == NO_TIME { -1 } else { *us });
    let rssi = |port: usize| columns.rssi.iter().skip(port).step_by(3).copied();
    file.put("record", [n, 1], 0..n as i64)?;
    file.put("time_us", [n, 1], columns.time_us.iter().copied())?;
    file.put("timestamp_low", [n, 1], columns.timestamp_low.iter().copied())?;
    file.put("bfee_count", [n, 1], columns.bfee_count.iter().copied())?;
    file.put("host_us", [n, 1], host)?;
    file.put("frame_count", [n, 1], columns.frame.iter().copied())?;
    file.put("n_rx", [n, 1], columns.n_rx.iter().copied())?;
    file.put("n_tx", [n, 1], columns.n_tx.iter().copied())?;
    for (port, name) in ["rssi_a", "rssi_b", "rssi_c"].into_iter().enumerate() {
        file.put(name, [n, 1], rssi(port))?;
    }
    file.put("noise_dbm", [n, 1], columns.noise_dbm.iter().copied())?;
    file.put("agc", [n, 1], columns.agc.iter().copied())?;
    file.put("antenna_sel", [n, 1], columns.antenna_sel.iter().copied())?;
    file.put("rate_n_flags", [n, 1], columns.rate.iter().copied())?;
    file.put("antennas_known", [n, 1], export.antennas_known().map(u8::from))?;
    file.put("total_rss_dbm", [n, 1], figures.rss_dbm.iter().copied())?;
    file.put("scale", [n, 1], figures.scale.iter().copied())?;
    file.put("offset", [n, 1], columns.offset.iter().copied())?;
    file.put("mac", [n, 6], columns.mac.iter().copied())?;
    if let Some(subcarriers) = export.subcarriers() {
        file.put("subcarriers", [subcarriers.len() as u64, 1], subcarriers.into_iter())?;
    }
    let ports = export.antennas.iter().map(|antenna| antenna.index() as u8);
    file.put("antennas", [export.antennas.len() as u64, 1], ports)?;
    file.put("scaled", [1, 1], [u8::from(export.form.scaled)].into_iter())
}

#[cfg(test)]
mod tests {
    use super::Export;
    use crate::table::{Arena, Columns, Filter, Form, Reading};
    use crate::temporary::{Temporary, fixture};
    use csi5300::source::replay::Replay;
    use csi5300::time::Instant;
    use driver_iface::bfee::Antenna;
    use std::path::Path;
    use std::sync::atomic::{AtomicBool, Ordering};

    fn table(log: &Path, filter: Filter) -> (Arena, Columns) {
        let mut reading = Reading::new(Replay::open(log).unwrap(), filter);
        reading.read_all(Instant::ZERO, || true).unwrap();
        reading.take()
    }

    fn columns(log: &Path, filter: Filter) -> Columns {
        let mut reading = Reading::new(Replay::open(log).unwrap(), filter).without_bodies();
        while reading.burst(Instant::ZERO, usize::MAX).unwrap() {}
        let (arena, columns) = reading.take();
        assert!(arena.is_empty() && !columns.is_empty());
        columns
    }

    /// The fixture repeated many times, longer than one read, with noise in between and other records' frames before some.
    fn long_log() -> Temporary {
        let once = std::fs::read(fixture()).unwrap();
        let mut log = Vec::new();
        for copy in 0..40_u8 {
            log.extend([0xff; 500]);
            log.extend([0, 41, 0xc1].into_iter().chain([copy; 40]));
            log.extend(&once);
        }
        Temporary::file("long.dat", &log)
    }

    #[test]
    fn an_export_that_is_stopped_says_so() {
        let (arena, columns) = table(&fixture(), Filter::default());
        let stop = AtomicBool::new(false);
        let mut export = Export::new(&arena, (0..arena.len()).collect(), &columns, Form::default());
        export.stop = Some(&stop);
        let endings: &[&str] = if cfg!(feature = "parquet") { &["npz", "mat", "parquet"] } else { &["npz", "mat"] };
        for ending in endings {
            let path = &Temporary::path(&format!("stopped.{ending}")).0;
            stop.store(false, Ordering::Relaxed);
            export.write(path).unwrap();
            let whole = std::fs::metadata(path).unwrap().len();
            stop.store(true, Ordering::Relaxed);
            assert_eq!(export.write(path).unwrap_err().to_string(), "writing was stopped", "{ending}");
            assert!(std::fs::metadata(path).unwrap().len() < whole, "{ending}: it was written all the same");
        }
    }

    #[test]
    fn an_extension_may_be_upper_case_and_streams_may_exceed_the_logs() {
        let (arena, columns) = table(&fixture(), Filter::default());
        let mut export = Export::new(&arena, (0..arena.len()).collect(), &columns, Form::default());
        let (small, large, wide) =
            (Temporary::path("log.npz"), Temporary::path("LOG.NPZ"), Temporary::path("wide.npz"));
        export.write(&small.0).unwrap();
        export.write(&large.0).unwrap();
        export.streams = 3;
        export.write(&wide.0).unwrap();
        let bytes = |file: &Temporary| std::fs::read(&file.0).unwrap();
        assert!(super::is_known(&large.0) && bytes(&small) == bytes(&large));
        // complex64 of 30 subcarriers, 3 antennas and 2 streams that no record has.
        assert_eq!(bytes(&wide).len() - bytes(&small).len(), columns.len() * 8 * 30 * 3 * 2);
    }

    #[test]
    fn exporting_from_disk_and_from_memory_gives_the_same_file() {
        let log = long_log();
        let part = || Filter::default().with_time(Some(0.4), Some(0.9)).unwrap();
        for (number, filter) in [Filter::default(), part()].into_iter().enumerate() {
            let (arena, all) = table(&log.0, filter.clone());
            let again = columns(&log.0, filter);
            assert!(format!("{all:?}") == format!("{again:?}"), "columns differ");
            assert!(all.len() > if number == 0 { 11_000 } else { 50 });
            for form in [Form::default(), Form { scaled: true, without_spatial_mapping: false }] {
                let mut memory = Export::new(&arena, (0..arena.len()).collect(), &all, form);
                let mut file = Export::of_log(&log.0, &again, form);
                for antennas in [&Antenna::ALL[..], &[Antenna::C, Antenna::A]] {
                    (memory.antennas, file.antennas) = (antennas.to_vec(), antennas.to_vec());
                    for ending in ["npz", "mat"] {
                        let out = Temporary::path(&format!("again.{ending}"));
                        let first = (memory.write(&out.0).unwrap(), std::fs::read(&out.0).unwrap());
                        assert!(first == (file.write(&out.0).unwrap(), std::fs::read(&out.0).unwrap()), "{ending}");
                    }
                }
            }
        }
    }

    /// The size reserved for an archive is its size without headers: no reserved space is left over.
    #[test]
    fn an_archive_has_no_unused_reserved_space() {
        let log = long_log();
        let columns = columns(&log.0, Filter::default());
        let out = Temporary::path("whole.npz");
        Export::of_log(&log.0, &columns, Form::default()).write(&out.0).unwrap();
        let records = columns.len() as u64 * (3 * 30 * 8 + super::BYTES);
        let headers = std::fs::metadata(&out.0).unwrap().len() - records;
        // 22 or 23 arrays, each with an NPY header of 128 bytes and, twice in the archive, its name and sizes.
        assert!((22 * 200..23 * 500).contains(&headers), "{headers}");
    }

    #[test]
    fn a_log_that_changes_during_export_is_an_error_with_its_offset() {
        let log = long_log();
        let columns = columns(&log.0, Filter::default());
        let out = Temporary::path("changed.npz");
        let export = Export::of_log(&log.0, &columns, Form::default());
        let bytes = std::fs::read(&log.0).unwrap();
        let changed = |at: usize| {
            let words = export.write(&out.0).unwrap_err().to_string();
            assert!(words.contains(&format!("the record at byte {at} is gone")), "{words}");
        };
        // Cut inside the last record; then a record in the middle is overwritten.
        let last = usize::try_from(*columns.offset.last().unwrap()).unwrap();
        std::fs::write(&log.0, &bytes[..last + 9]).unwrap();
        changed(last);
        let middle = usize::try_from(columns.offset[6_000]).unwrap();
        let mut other = bytes.clone();
        other[middle + 2..middle + 30].fill(0);
        std::fs::write(&log.0, other).unwrap();
        changed(middle);
        std::fs::write(&log.0, bytes).unwrap();
        export.write(&out.0).unwrap();
        std::fs::remove_file(&log.0).unwrap();
        assert!(export.write(&out.0).unwrap_err().to_string().starts_with("cannot read "));
    }
}
