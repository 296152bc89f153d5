use super::*;
use crate::source::Stamps;
use crate::source::replay::Replay;
use crate::source::side_file::side_path;
use driver_iface::bfee;
use driver_iface::record::{Record, Tail, code};
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};

/// A source of numbered records, as many as it is made with.
struct Numbered {
    left: VecDeque<Option<u32>>,
    body: Vec<u8>,
}

/// Bytes of a record in the log: length, code, and a 1x1 bfee.
const RECORD: usize = 3 + bfee::STOCK_HEADER + bfee::csi_len(1, 1);

impl Numbered {
    fn new(records: impl IntoIterator<Item = Option<u32>>) -> Self {
        let mut body = vec![0; RECORD - 3];
        (body[bfee::offset::N_RX], body[bfee::offset::N_TX]) = (1, 1);
        body[bfee::offset::LEN] = bfee::csi_len(1, 1) as u8;
        Self { left: records.into_iter().collect(), body }
    }
}

impl CsiSource for Numbered {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self.left.pop_front() {
            None => Ok(Next::End(Tail::Clean)),
            Some(None) => Ok(Next::Pending),
            Some(Some(number)) => {
                self.body[..4].copy_from_slice(&number.to_le_bytes());
                let stamps = Stamps { at: now, host_us: Some(i64::from(number) + 5_000_000), ..Stamps::default() };
                Ok(Next::Record(stamps, Record { code: code::BFEE, body: &self.body }))
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

/// A disk that waits for permission before each write, and remembers.
struct Gate {
    open: Receiver<()>,
    kept: Vec<u8>,
    syncs: usize,
}

impl Sink for Gate {
    fn write(&mut self, chunk: &Chunk) -> Written {
        let _ = self.open.recv();
        self.kept.extend_from_slice(&chunk.bytes);
        Written { records: chunk.host_us.len() as u64, ..Written::default() }
    }
    fn sync(&mut self) -> Option<String> {
        self.syncs += 1;
        None
    }
}

fn numbers(log: &[u8]) -> Vec<u32> {
    log.chunks(RECORD).map(|record| u32::from_le_bytes(record[3..7].try_into().unwrap())).collect()
}

fn drain<W: Sink>(recorder: &mut Recorder<Numbered, W>, now: Instant) -> u64 {
    let mut records = 0;
    loop {
        match recorder.receive(now).unwrap() {
            Next::Record(..) => records += 1,
            Next::End(_) => return records,
            _ => {}
        }
    }
}

#[test]
fn a_stopped_disk_makes_counted_loss_and_never_holds_the_source() {
    let (open, gate) = channel();
    let sink = Gate { open: gate, kept: Vec::new(), syncs: 0 };
    // Chunks that hold the largest record and one small one; three of them.
    let options = Options { chunk_bytes: 8_200, chunks: 3, ..Options::default() };
    let source = Numbered::new((0..10_000).map(Some));
    let mut recorder = Recorder::new(source, sink, options).unwrap();
    // Every record arrives although nothing is written.
    assert_eq!(drain(&mut recorder, Instant::ZERO), 10_000);
    let dropped = recorder.totals().dropped;
    assert!(dropped > 0, "the queue never filled");
    assert_eq!(recorder.totals().written, 0);
    drop(open);
    let (_, sink, totals) = recorder.finish(Instant::ZERO).unwrap();
    assert_eq!((totals.received, totals.dropped), (10_000, dropped));
    assert_eq!(totals.written, 10_000 - dropped);
    // Two chunks that were handed over with a record each, as the largest would not have fitted behind it, and all of a third.
    assert_eq!(totals.written, 2 + (8_200 / RECORD) as u64);
    let kept = numbers(&sink.kept);
    assert_eq!(kept.len() as u64, totals.written);
    assert!(kept.is_sorted_by(|a, b| a < b));
}

#[test]
fn chunks_and_syncs_keep_time() {
    let (open, gate) = channel();
    drop(open);
    let sink = Gate { open: gate, kept: Vec::new(), syncs: 0 };
    let source = Numbered::new([Some(1), None, None, None, None]);
    let options = Options { sync_every: Some(Span::from_ms(25)), hand_over: Span::from_ms(10), ..Options::default() };
    let mut recorder = Recorder::new(source, sink, options).unwrap();
    assert_eq!(recorder.next_at(), None);
    let _ = recorder.receive(Instant::ZERO).unwrap();
    assert_eq!(recorder.next_at(), Some(Instant::from_us(10_000)));
    let _ = recorder.receive(Instant::from_us(10_000)).unwrap();
    assert_eq!(recorder.next_at(), Some(Instant::from_us(25_000)));
    let _ = recorder.receive(Instant::from_us(25_000)).unwrap();
    assert_eq!(recorder.next_at(), None, "nothing is left to write");
    let (_, sink, totals) = recorder.finish(Instant::from_us(26_000)).unwrap();
    assert_eq!((sink.syncs, numbers(&sink.kept)), (2, vec![1]));
    assert_eq!(totals.written, 1);
}

#[test]
fn a_record_longer_than_a_chunk_has_one_of_its_own() {
    let (open, gate) = channel();
    drop(open);
    let sink = Gate { open: gate, kept: Vec::new(), syncs: 0 };
    let options = Options { chunk_bytes: RECORD / 2, chunks: 100, ..Options::default() };
    let mut recorder = Recorder::new(Numbered::new((0..50).map(Some)), sink, options).unwrap();
    assert_eq!(drain(&mut recorder, Instant::ZERO), 50);
    let (_, sink, totals) = recorder.finish(Instant::ZERO).unwrap();
    assert_eq!((totals.written, totals.dropped), (50, 0));
    assert_eq!(numbers(&sink.kept), (0..50).collect::<Vec<_>>());
}

#[test]
fn while_the_disk_stands_still_it_is_asked_again_after_a_while_and_not_at_once() {
    let (open, gate) = channel();
    let sink = Gate { open: gate, kept: Vec::new(), syncs: 0 };
    let source = Numbered::new([Some(1), None, Some(2), None, None, None]);
    let options = Options { chunks: 2, hand_over: Span::from_ms(10), ..Options::default() };
    let mut recorder = Recorder::new(source, sink, options).unwrap();
    let mut at = |ms: i64| {
        let _ = recorder.receive(Instant::from_us(1_000 * ms)).unwrap();
        recorder.next_at().map(|at| at.as_us() / 1_000)
    };
    // The first chunk is with the disk, which does not take it; there is one other.
    assert_eq!([at(0), at(10), at(11), at(21)], [Some(10), Some(1_000), Some(21), Some(31)]);
    // It is due and cannot be handed over: it is tried again, and a sync waits for it.
    assert_eq!([at(31), at(1_010)], [Some(41), Some(1_020)]);
    drop(open);
    let (_, sink, totals) = recorder.finish(Instant::from_us(2_000_000)).unwrap();
    assert_eq!((numbers(&sink.kept), totals.written, totals.dropped), (vec![1, 2], 2, 0));
}

fn folder(name: &str) -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!("csi5300-recorder-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn what_is_recorded_replays_with_its_host_times() {
    let folder = folder("replay");
    let path = folder.join("out.dat");
    let files = LogFiles::create(&path, Rotation::default(), false).unwrap();
    let mut recorder = Recorder::new(Numbered::new((0..500).map(Some)), files, Options::default()).unwrap();
    drain(&mut recorder, Instant::ZERO);
    let (_, _, totals) = recorder.finish(Instant::ZERO).unwrap();
    assert_eq!((totals.written, totals.error), (500, None));
    let mut replay = Replay::open(&path).unwrap();
    for number in 0..500_u32 {
        let Next::Record(stamps, record) = replay.receive(Instant::ZERO).unwrap() else { panic!("record {number}") };
        assert_eq!(record.body[..4], number.to_le_bytes());
        assert_eq!(stamps.host_us, Some(i64::from(number) + 5_000_000));
    }
    assert!(matches!(replay.receive(Instant::ZERO).unwrap(), Next::End(Tail::Clean)));
    // Nothing is overwritten unless asked for, not even half of the pair.
    let again = LogFiles::create(&path, Rotation::default(), false).unwrap_err();
    assert!(matches!(&again, Error::Exists { path: there } if *there == path), "{again}");
    std::fs::remove_file(&path).unwrap();
    let side_only = LogFiles::create(&path, Rotation::default(), false).unwrap_err();
    assert!(side_only.to_string().contains("out.datstp"), "{side_only}");
    assert!(!path.exists());
    LogFiles::create(&path, Rotation::default(), true).unwrap();
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn rotation_by_size_and_by_time_loses_nothing() {
    for (name, rotation) in [
        ("size", Rotation { bytes: Some(250_000), every: None }),
        ("time", Rotation { bytes: None, every: Some(Span::from_ms(1_000)) }),
    ] {
        let folder = folder(name);
        let files = LogFiles::create(&folder.join("out.dat"), rotation, false).unwrap();
        let options = Options { chunk_bytes: 10_000, ..Options::default() };
        let mut recorder = Recorder::new(Numbered::new((0..5_000).map(Some)), files, options).unwrap();
        let mut now = Instant::ZERO;
        while !matches!(recorder.receive(now).unwrap(), Next::End(_)) {
            now += Span::from_ms(1);
        }
        let (_, files, totals) = recorder.finish(now).unwrap();
        assert_eq!((totals.written, totals.error), (5_000, None));
        let paths = files.paths();
        assert_eq!(paths.len(), if name == "size" { 2 } else { 5 }, "{paths:?}");
        let mut all = Vec::new();
        for path in &paths {
            let log = std::fs::read(path).unwrap();
            assert!(name != "size" || log.len() <= 250_000);
            let stamps = std::fs::metadata(side_path(path)).unwrap().len();
            assert_eq!(stamps as usize / 8, log.len() / RECORD);
            all.extend(numbers(&log));
        }
        assert_eq!(all, (0..5_000).collect::<Vec<_>>());
        std::fs::remove_dir_all(folder).unwrap();
    }
}

/// A disk that remembers in a place that outlives it; it dies at its `dies_at`th chunk.
struct Kept {
    log: Arc<Mutex<Vec<u8>>>,
    syncs: Arc<Mutex<u32>>,
    dies_at: Option<u32>,
}

impl Sink for Kept {
    fn write(&mut self, chunk: &Chunk) -> Written {
        self.dies_at = self.dies_at.map(|left| left.checked_sub(1).expect("a disk that dies"));
        self.log.lock().unwrap().extend_from_slice(&chunk.bytes);
        Written { records: chunk.host_us.len() as u64, ..Written::default() }
    }
    fn sync(&mut self) -> Option<String> {
        *self.syncs.lock().unwrap() += 1;
        None
    }
}

#[test]
fn a_dropped_recorder_writes_what_it_was_handed() {
    let (log, syncs) = (Arc::<Mutex<Vec<u8>>>::default(), Arc::<Mutex<u32>>::default());
    let sink = Kept { log: Arc::clone(&log), syncs: Arc::clone(&syncs), dies_at: None };
    let options = Options { chunk_bytes: 10_000, chunks: 1_000, ..Options::default() };
    let mut recorder = Recorder::new(Numbered::new((0..1_000).map(Some)), sink, options).unwrap();
    let tally = recorder.tally();
    drain(&mut recorder, Instant::ZERO);
    drop(recorder);
    let totals = tally.totals();
    assert_eq!((totals.received, totals.written, totals.dropped, totals.lost_on_disk), (1_000, 1_000, 0, 0));
    assert_eq!(numbers(&log.lock().unwrap()), (0..1_000).collect::<Vec<_>>());
    assert_eq!(*syncs.lock().unwrap(), 1);
}

#[test]
fn what_a_dead_writer_took_with_it_is_counted() {
    for finish in [false, true] {
        let log = Arc::<Mutex<Vec<u8>>>::default();
        let sink = Kept { log: Arc::clone(&log), syncs: Arc::default(), dies_at: Some(1) };
        let options = Options { chunk_bytes: 10_000, chunks: 1_000, ..Options::default() };
        let mut recorder = Recorder::new(Numbered::new((0..1_000).map(Some)), sink, options).unwrap();
        let tally = recorder.tally();
        drain(&mut recorder, Instant::ZERO);
        if finish {
            assert!(matches!(recorder.finish(Instant::ZERO), Err(Error::WriterDied)));
        } else {
            drop(recorder);
        }
        let totals = tally.totals();
        assert!(totals.written > 0 && totals.lost_on_disk + totals.dropped > 0, "{totals:?}");
        assert_eq!(totals.received, totals.written + totals.dropped + totals.lost_on_disk);
        assert_eq!(totals.written, numbers(&log.lock().unwrap()).len() as u64);
        assert!(totals.error.is_some_and(|error| error.contains("died")));
    }
}

#[test]
fn after_a_failure_only_a_record_that_is_written_ends_it() {
    let shared = Shared::default();
    let note = |records, error: Option<&str>| {
        shared.note(Written { records, lost: 0, error: error.map(str::to_owned) });
        (shared.totals().failing, shared.totals().error)
    };
    let full = Some("full".to_owned());
    assert_eq!(note(0, None), (false, None));
    assert_eq!(note(2, Some("full")), (true, full.clone()));
    assert_eq!(note(0, None), (true, full.clone()), "a sync without an error writes nothing");
    assert_eq!(note(1, None), (false, full), "what went wrong is remembered");
}

#[test]
fn what_a_dead_writer_had_taken_is_what_is_in_no_other_count() {
    let shared = Shared::of(10, 3);
    shared.note(Written { records: 4, lost: 2, error: None });
    shared.note_death();
    let totals = shared.totals();
    assert_eq!((totals.received, totals.written, totals.dropped, totals.lost_on_disk), (10, 4, 3, 3));
}

#[test]
fn a_sync_that_went_with_a_chunk_is_not_asked_for_again() {
    let (open, gate) = channel();
    drop(open);
    let sink = Gate { open: gate, kept: Vec::new(), syncs: 0 };
    let source = Numbered::new([Some(1), None, Some(2), None]);
    let options = Options { sync_every: Some(Span::from_ms(25)), hand_over: Span::from_ms(10), ..Options::default() };
    let mut recorder = Recorder::new(source, sink, options).unwrap();
    let mut at = |ms: i64| {
        let _ = recorder.receive(Instant::from_us(1_000 * ms)).unwrap();
        recorder.next_at().map(|at| at.as_us() / 1_000)
    };
    // The second chunk is handed over when a sync is due, and takes it along: the next one is 25 ms later.
    assert_eq!([at(0), at(10), at(20), at(30)], [Some(10), Some(25), Some(30), Some(55)]);
}
