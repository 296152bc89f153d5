use super::*;

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("csi5300-files-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn a_log_that_another_recorder_writes_is_left_alone_and_a_deleted_one_is_noticed() {
    let folder = std::env::temp_dir().join(format!("csi5300-locked-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let log = folder.join("out.dat");
    let mut first = LogFiles::create(&log, Rotation::default(), false).unwrap();
    assert!(matches!(LogFiles::create(&log, Rotation::default(), true), Err(Error::InUse { .. })));
    assert_eq!(first.sync(), None);
    std::fs::remove_file(&log).unwrap();
    assert!(first.sync().unwrap().contains("was deleted"));
    drop(first);
    let again = LogFiles::create(&log, Rotation::default(), true).unwrap();
    assert_eq!(again.data.file.metadata().unwrap().len(), 0);
    std::fs::remove_dir_all(folder).unwrap();
}

/// A pipe takes bytes and cannot be synced: both files are asked to.
#[test]
fn what_cannot_be_synced_is_said() {
    let folder = std::env::temp_dir().join(format!("csi5300-sync-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (_reader, writer) = io::pipe().unwrap();
    let pipe = || File::from(std::os::fd::OwnedFd::from(writer.try_clone().unwrap()));
    for side in [false, true] {
        let mut files = LogFiles::create(&folder.join("out.dat"), Rotation::default(), true).unwrap();
        *(if side { &mut files.side.as_mut().unwrap().file } else { &mut files.data.file }) = pipe();
        assert!(files.sync().unwrap().contains("syncing"), "side file: {side}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_is_no_file_is_not_cut() {
    assert!(Grown::create("/dev/null".into(), true).is_ok(), "a device has no length");
}

#[test]
fn names_in_a_row() {
    assert_eq!(numbered(Path::new("a/out.dat"), 0), Path::new("a/out.dat"));
    assert_eq!(numbered(Path::new("a/out.dat"), 12), Path::new("a/out-0012.dat"));
    assert_eq!(numbered(Path::new("out"), 1), Path::new("out-0001"));
}

/// Opening a pipe would wait for a reader, and no signal would end it.
#[test]
fn a_log_is_not_written_into_a_pipe() {
    let folder = folder("pipe");
    let log = folder.join("out.dat");
    for name in [log.clone(), side_path(&log)] {
        let made = std::process::Command::new("mkfifo").arg(&name).status();
        assert!(made.is_ok_and(|status| status.success()), "mkfifo");
        for force in [false, true] {
            let refused = LogFiles::create(&log, Rotation::default(), force);
            assert!(matches!(refused, Err(Error::IntoPipe { path }) if path == name), "{}", name.display());
        }
        std::fs::remove_file(&name).unwrap();
        assert!(!log.exists() && !side_path(&log).exists());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// A record as the log has it.
fn record(number: u8) -> Vec<u8> {
    vec![0, 4, 0xBB, number, 7, 7]
}

fn chunk(numbers: std::ops::Range<u8>) -> Chunk {
    let host_us = numbers.clone().map(|number| Some(1_700_000_000_000_000 + i64::from(number))).collect();
    Chunk { bytes: numbers.flat_map(record).collect(), host_us, at: Instant::ZERO }
}

#[test]
fn a_log_without_a_record_is_taken_back_and_nothing_else_is() {
    let folder = folder("empty");
    let log = folder.join("out.dat");
    let create = |rotation| LogFiles::create(&log, rotation, false).unwrap();
    let there = || [log.exists(), side_path(&log).exists()];
    drop(create(Rotation::default()));
    assert_eq!(there(), [false, false]);
    // Another's of the same name, made after this one was deleted.
    let files = create(Rotation::default());
    std::fs::remove_file(&log).unwrap();
    std::fs::write(&log, "").unwrap();
    drop(files);
    assert_eq!(there(), [true, false]);
    std::fs::remove_file(&log).unwrap();
    // One with a record, and the first of a row.
    let mut files = create(Rotation::default());
    assert_eq!(files.write(&chunk(0..1)).records, 1);
    drop(files);
    assert_eq!(there(), [true, true]);
    drop(create(Rotation { bytes: Some(1 << 20), every: None }));
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn side_files_of_every_layout_keep_step_with_the_log() {
    let folder = folder("layouts");
    for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
        let log = folder.join("out.dat");
        let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap().with_side_layout(layout);
        assert_eq!(files.write(&chunk(0..3)), Written { records: 3, ..Written::default() });
        // The side file's disk refuses a chunk: its records get entries of zeros with the next one.
        let side = std::mem::replace(&mut files.side.as_mut().unwrap().file, File::open("/dev/null").unwrap());
        let refused = files.write(&chunk(3..5));
        assert!(refused.records == 2 && refused.error.is_some_and(|error| error.contains("datstp")));
        files.side.as_mut().unwrap().file = side;
        assert_eq!(files.write(&chunk(5..6)), Written { records: 1, ..Written::default() });
        drop(files);
        let bytes = std::fs::read(side_path(&log)).unwrap();
        assert_eq!(Layout::of(&bytes), layout);
        let entries = bytes[layout.head().len()..].chunks(layout.bytes()).map(|entry| Entry::parse(entry, layout));
        let expected = (0..6).map(|number| {
            let known = !(3..5).contains(&number);
            Entry {
                host_us: known.then_some(1_700_000_000_000_000 + i64::from(number)),
                check: (known && layout == Layout::Checked).then(|| Check::of(&record(number))),
            }
        });
        assert_eq!(entries.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{layout:?}");
        assert_eq!(std::fs::read(&log).unwrap(), (0..6).flat_map(record).collect::<Vec<_>>());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn either_rotation_makes_a_row_of_files() {
    let first = |bytes, every| LogFiles::first(Path::new("out.dat"), Rotation { bytes, every });
    assert_eq!(first(None, None), Path::new("out.dat"));
    for (bytes, every) in [(Some(1), None), (None, Some(Span::from_ms(1))), (Some(1), Some(Span::from_ms(1)))] {
        assert_eq!(first(bytes, every), Path::new("out-0001.dat"), "{bytes:?} {every:?}");
    }
}

#[test]
fn a_file_is_left_for_the_next_once_it_holds_something() {
    let folder = folder("due");
    let log = folder.join("out.dat");
    let ms = |ms| Instant::ZERO + Span::from_ms(ms);
    let rotation = Rotation { bytes: Some(18), every: Some(Span::from_ms(10)) };
    let mut files = LogFiles::create(&log, rotation, false).unwrap();
    let mut made = Vec::new();
    // Four records, of which the first file takes three; the next is filled to its last byte; in the third 6 more would fit and
    // come too late.
    for (at, numbers) in [(0, 0..4), (1, 4..5), (2, 5..6), (3, 6..7), (4, 7..8), (13, 8..9), (14, 9..10)] {
        assert_eq!(files.write(&Chunk { at: ms(at), ..chunk(numbers) }).error, None);
        made.push(files.paths().len());
    }
    assert_eq!(made, [2, 2, 2, 3, 3, 4, 4]);
    let lengths = files.paths().iter().map(|path| std::fs::metadata(path).unwrap().len()).collect::<Vec<_>>();
    assert_eq!(lengths, [18, 18, 12, 12]);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn no_file_is_larger_than_was_asked_for_however_much_comes_at_once() {
    let folder = folder("size");
    // 6 bytes a record: as many as fit, and one where none does.
    for (limit, lengths) in [(13, vec![12, 12, 12, 12, 12]), (24, vec![24, 24, 12]), (5, vec![6; 10]), (99, vec![60])] {
        let log = folder.join(format!("{limit}.dat"));
        let rotation = Rotation { bytes: Some(limit), every: None };
        let mut files = LogFiles::create(&log, rotation, false).unwrap().with_side_layout(Layout::Checked);
        assert_eq!(files.write(&chunk(0..10)), Written { records: 10, ..Written::default() });
        let paths = files.paths();
        let logs: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
        assert_eq!(logs.iter().map(Vec::len).collect::<Vec<_>>(), lengths, "{limit}");
        assert_eq!(logs.concat(), chunk(0..10).bytes, "{limit}");
        let mut number = 0;
        for (path, log) in paths.iter().zip(&logs) {
            let side = std::fs::read(side_path(path)).unwrap();
            let entries = side[Layout::Checked.head().len()..].chunks(Layout::Checked.bytes());
            assert_eq!(entries.len(), log.len() / 6);
            for entry in entries {
                let expected = Check::of(&record(number));
                assert_eq!(Entry::parse(entry, Layout::Checked).check, Some(expected), "{limit}: {number}");
                number += 1;
            }
        }
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn where_there_is_no_next_file_the_old_one_takes_all_that_came() {
    let folder = folder("no-next");
    std::fs::write(folder.join("out-0002.dat"), "another's").unwrap();
    let rotation = Rotation { bytes: Some(12), every: None };
    let mut files = LogFiles::create(&folder.join("out.dat"), rotation, false).unwrap();
    for (numbers, bytes) in [(0..5, 30), (5..6, 36)] {
        let written = files.write(&chunk(numbers.clone()));
        assert_eq!((written.records, written.lost), (numbers.len() as u64, 0));
        assert!(written.error.unwrap().contains("so the old one grows"));
        assert_eq!(std::fs::metadata(folder.join("out-0001.dat")).unwrap().len(), bytes);
    }
    assert_eq!(std::fs::read(folder.join("out-0002.dat")).unwrap(), b"another's");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_a_full_disk_left_out_of_a_chunk_is_counted_over_all_its_files() {
    let folder = folder("part");
    let rotation = Rotation { bytes: Some(12), every: None };
    let mut files = LogFiles::create(&folder.join("out.dat"), rotation, false).unwrap();
    files.data.file = File::open("/dev/null").unwrap();
    let written = files.write(&chunk(0..5));
    assert_eq!((written.records, written.lost), (0, 5));
    assert!(written.error.unwrap().contains("out-0001.dat"));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_write_that_failed_leaves_whole_units_and_the_next_goes_behind_them() {
    let folder = folder("taken-back");
    let path = folder.join("out.dat");
    let mut grown = Grown::create(path.clone(), false).unwrap();
    assert!(matches!(grown.append(b"0123456789", |done| done), (10, Ok(()))));
    grown.file.write_all(b"abcdefg").unwrap();
    let (whole, outcome) = grown.take_back(4, io::ErrorKind::WriteZero.into());
    assert_eq!((whole, outcome.unwrap_err().kind(), grown.len), (4, io::ErrorKind::WriteZero, 14));
    assert!(grown.append(b"XY", |done| done).1.is_ok());
    assert_eq!(std::fs::read(&path).unwrap(), b"0123456789abcdXY");
    std::fs::remove_dir_all(folder).unwrap();
}

/// A disk that takes three bytes at a time, each time after an interruption, and `room` at most.
struct Small {
    taken: Vec<u8>,
    room: usize,
    interrupted: bool,
}

impl Write for Small {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.interrupted = !self.interrupted;
        if self.interrupted {
            return Err(io::ErrorKind::Interrupted.into());
        }
        let count = bytes.len().min(3).min(self.room - self.taken.len());
        self.taken.extend_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_write_goes_on_where_it_was_interrupted_until_the_disk_is_full() {
    for (room, failed) in
        [(20, None), (10, None), (7, Some(io::ErrorKind::WriteZero)), (0, Some(io::ErrorKind::WriteZero))]
    {
        let mut disk = Small { taken: Vec::new(), room, interrupted: false };
        let (done, outcome) = write_on(&mut disk, b"0123456789");
        assert_eq!((done, outcome.err().map(|error| error.kind())), (room.min(10), failed), "room for {room}");
        assert_eq!(disk.taken, b"0123456789"[..done]);
    }
    let mut nothing = File::open("/dev/null").unwrap();
    assert!(matches!(write_on(&mut nothing, b"0"), (0, Err(_))), "it is not open for writing");
}

#[test]
fn what_is_kept_of_a_side_file_is_whole_entries() {
    for (layout, bytes) in [(Layout::Narrow, 8), (Layout::Wide, 16), (Layout::Checked, 16)] {
        let kept = [0, bytes - 1, bytes, bytes + 1, 5 * bytes - 1].map(|done| whole_entries(layout, done));
        assert_eq!(kept, [0, 0, bytes, bytes, 4 * bytes], "{layout:?}");
    }
}

#[test]
fn a_log_that_somebody_cuts_goes_on_in_another_file() {
    let folder = folder("cut");
    let log = folder.join("out.dat");
    let side = side_path(&log);
    for (cut, left, gone) in [(&log, 0, 4), (&log, 12, 2), (&side, 0, 0)] {
        let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap();
        assert_eq!(files.write(&chunk(0..4)).records, 4);
        OpenOptions::new().write(true).open(cut).unwrap().set_len(left).unwrap();
        // Also where nothing is recorded after that.
        assert!(files.sync().unwrap().contains(&format!("was cut to {left} bytes")));
        let written = files.write(&chunk(4..6));
        assert_eq!((written.records, written.lost), (2, gone), "{} to {left}", cut.display());
        assert!(written.error.unwrap().contains("was cut by another program"));
        assert_eq!(files.write(&chunk(6..7)), Written { records: 1, ..Written::default() });
        let next = folder.join("out-0001.dat");
        assert_eq!(files.paths(), [log.clone(), next.clone()]);
        drop(files);
        assert_eq!(std::fs::metadata(cut).unwrap().len(), left);
        assert_eq!(std::fs::read(&next).unwrap(), (4..7).flat_map(record).collect::<Vec<_>>());
        std::fs::remove_file(&next).unwrap();
        std::fs::remove_file(side_path(&next)).unwrap();
    }
    // The next name is somebody's: it goes on behind what is left.
    let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap();
    files.write(&chunk(0..4));
    std::fs::write(folder.join("out-0001.dat"), "precious").unwrap();
    files.force = false;
    OpenOptions::new().write(true).open(&log).unwrap().set_len(6).unwrap();
    assert!(files.write(&chunk(4..5)).error.unwrap().contains("cannot continue in a new file"));
    drop(files);
    assert_eq!(std::fs::read(&log).unwrap(), [record(0), record(4)].concat());
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_log_of_bodies_has_no_side_file_and_is_cut_between_bodies() {
    let folder = std::env::temp_dir().join(format!("csi5300-bodies-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let bodies: Vec<Vec<u8>> = (1..=9_u8).map(|k| vec![k; 10 * usize::from(k)]).collect();
    let mut chunk = Chunk::default();
    for body in &bodies {
        let record = driver_iface::record::Record { code: 0xBB, body };
        let from = chunk.bytes.len();
        chunk.bytes.resize(from + record.emit_len(), 0);
        record.emit(&mut chunk.bytes[from..]).unwrap();
        chunk.host_us.push(Some(7));
    }
    let mut files = LogFiles::create_bodies(&folder.join("a.csi"), Rotation::default(), false).unwrap();
    assert_eq!(files.write(&chunk), Written { records: 9, ..Written::default() });
    drop(files);
    assert_eq!(std::fs::read(folder.join("a.csi")).unwrap(), bodies.concat());
    let hundred = Rotation { bytes: Some(100), every: None };
    let mut files = LogFiles::create_bodies(&folder.join("b.csi"), hundred, false).unwrap();
    assert_eq!(files.write(&chunk).records, 9);
    let parts: Vec<usize> = files.paths().iter().map(|path| std::fs::read(path).unwrap().len()).collect();
    assert_eq!(parts, [100, 50, 60, 70, 80, 90]);
    drop(files);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 7, "no side files");
    std::fs::remove_dir_all(&folder).unwrap();
}
