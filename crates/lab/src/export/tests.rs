//! Exports that are stopped; what whole ones hold is compared by their readers (python/tests/test_export.py).

use super::{Export, ExportError};
use crate::table::{Arena, Columns, Filter, Form, Reading};
use csi5300::source::replay::Replay;
use csi5300::time::Instant;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

fn table() -> (Arena, Columns) {
    let log = "../../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat";
    let source = Replay::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join(log)).unwrap();
    let mut reading = Reading::new(source, Filter::default());
    reading.read_all(Instant::ZERO, || true).unwrap();
    reading.take()
}

#[test]
fn an_export_that_is_stopped_says_so() {
    let (arena, columns) = table();
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
