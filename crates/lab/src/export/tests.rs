//! Stopped exports, and exports that read the log again; python/tests/test_export.py compares the content of complete ones with
//! what other readers find.

use super::{Export, ExportError};
use crate::table::{Arena, Columns, Filter, Form, Reading};
use csi5300::source::replay::Replay;
use csi5300::time::Instant;
use driver_iface::bfee::Antenna;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat")
}

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

/// A file of one test; removed at the end.
struct Temporary(PathBuf);

static TEMPORARIES: AtomicU32 = AtomicU32::new(0);

impl Temporary {
    fn new(name: &str) -> Self {
        let number = TEMPORARIES.fetch_add(1, Ordering::Relaxed);
        Self(std::env::temp_dir().join(format!("csi5300-{}-{number}-{name}", std::process::id())))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
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
    let file = Temporary::new("long.dat");
    std::fs::write(&file.0, log).unwrap();
    file
}

#[test]
fn an_export_that_is_stopped_says_so() {
    let (arena, columns) = table(&fixture(), Filter::default());
    let stop = AtomicBool::new(false);
    let export = Export::new(&arena, (0..arena.len()).collect(), &columns, Form::default()).with_stop(&stop);
    let endings: &[&str] = if cfg!(feature = "parquet") { &["npz", "mat", "parquet"] } else { &["npz", "mat"] };
    for ending in endings {
        let path = std::env::temp_dir().join(format!("csi5300-stopped-{}.{ending}", std::process::id()));
        stop.store(false, Ordering::Relaxed);
        export.write(&path).unwrap();
        let whole = std::fs::metadata(&path).unwrap().len();
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(export.write(&path), Err(ExportError::Stopped { .. })), "{ending}");
        assert!(std::fs::metadata(&path).unwrap().len() < whole, "{ending}: it was written all the same");
        std::fs::remove_file(&path).unwrap();
    }
}

#[test]
fn an_extension_may_be_upper_case_and_streams_may_exceed_the_logs() {
    let (arena, columns) = table(&fixture(), Filter::default());
    let export = Export::new(&arena, (0..arena.len()).collect(), &columns, Form::default());
    let (small, large, wide) = (Temporary::new("log.npz"), Temporary::new("LOG.NPZ"), Temporary::new("wide.npz"));
    export.write(&small.0).unwrap();
    export.write(&large.0).unwrap();
    export.with_streams(3).write(&wide.0).unwrap();
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
            let memory = Export::new(&arena, (0..arena.len()).collect(), &all, form);
            let file = Export::of_log(&log.0, &again, form);
            for antennas in [&Antenna::ALL[..], &[Antenna::C, Antenna::A]] {
                let (memory, file) = (memory.clone().with_antennas(antennas), file.clone().with_antennas(antennas));
                for ending in ["npz", "mat"] {
                    let out = Temporary::new(&format!("again.{ending}"));
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
    let out = Temporary::new("whole.npz");
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
    let out = Temporary::new("changed.npz");
    let export = Export::of_log(&log.0, &columns, Form::default());
    let bytes = std::fs::read(&log.0).unwrap();
    // Cut inside the last record; then a record in the middle is overwritten.
    let last = u64::try_from(*columns.offset.last().unwrap()).unwrap();
    std::fs::write(&log.0, &bytes[..last as usize + 9]).unwrap();
    assert!(matches!(export.write(&out.0), Err(ExportError::Changed { offset, .. }) if offset == last));
    let middle = usize::try_from(columns.offset[6_000]).unwrap();
    let mut other = bytes.clone();
    other[middle + 2..middle + 30].fill(0);
    std::fs::write(&log.0, other).unwrap();
    assert!(matches!(export.write(&out.0), Err(ExportError::Changed { offset, .. }) if offset == middle as u64));
    std::fs::write(&log.0, bytes).unwrap();
    export.write(&out.0).unwrap();
    std::fs::remove_file(&log.0).unwrap();
    assert!(matches!(export.write(&out.0), Err(ExportError::Log { .. })));
}
