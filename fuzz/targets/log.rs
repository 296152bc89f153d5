//! Any bytes as a log with a side file: every byte of the log is accounted for, and every record of the side file's checksums.
//!
//! The input is `length of the log (2 bytes), log, side file`.

use csi5300::source::{CsiSource, Loss, Next, Origin, replay::Replay, side_path};
use csi5300::time::Instant;
use driver_iface::record::{Reason, Tail};

/// What was read from a log: offset, code and body of each record, and skipped bytes.
type Read = Vec<(u64, Option<(u8, Vec<u8>)>)>;

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let Some((len, rest)) = bytes.split_first_chunk() else { return };
    let (log, side) = rest.split_at(rest.len().min(usize::from(u16::from_le_bytes(*len))));
    let thread = std::thread::current().id();
    let file = std::env::temp_dir().join(format!("csi5300-fuzz-{}-{thread:?}.dat", std::process::id()));
    std::fs::write(&file, log).expect("a place for files");
    std::fs::write(side_path(&file), side).expect("a place for files");
    let mut replay = Replay::open(&file).expect("it is there");
    std::fs::remove_file(&file).expect("it is there");
    std::fs::remove_file(side_path(&file)).expect("it is there");
    let (found, wrong) = read(&mut replay, log.len() as u64);
    let alone = read(&mut Replay::new(log, String::new()), log.len() as u64).0;
    let records = found.iter().filter(|(_, record)| record.is_some()).count() as u64;
    let Some(checks) = replay.checks() else {
        assert_eq!((found, wrong), (alone, 0), "times change no record");
        return;
    };
    assert_eq!(wrong, checks.wrong);
    assert!(checks.good + checks.unknown <= records);
    assert!(checks.out_of_step || checks.good + checks.unknown == records, "{checks:?} of {records}");
    // A checksum removes records but adds none.
    assert!(found.iter().filter(|(_, record)| record.is_some()).all(|one| alone.contains(one)));
}

/// Reads a log to its end; also counts the records refused because of their checksum.
fn read<R: std::io::Read>(replay: &mut Replay<R>, len: u64) -> (Read, u64) {
    let (mut found, mut wrong, mut at) = (Vec::new(), 0, 0);
    loop {
        match replay.receive(Instant::ZERO).expect("bytes in memory") {
            Next::Record(stamps, record) => {
                assert_eq!(stamps.origin, Origin::File { offset: at });
                found.push((at, Some((record.code, record.body.to_vec()))));
                at += record.emit_len() as u64;
            }
            Next::Lost(Loss::Bytes { offset, len, reason }) => {
                assert!(offset == at && len > 0);
                found.push((at, None));
                at += len;
                wrong += u64::from(reason == Reason::Checksum);
            }
            Next::End(Tail::Cut { offset, bytes, .. }) => {
                assert!(offset == at && at + bytes == len);
                return (found, wrong);
            }
            Next::End(Tail::Clean) => {
                assert_eq!(at, len);
                return (found, wrong);
            }
            other => panic!("{other:?}"),
        }
    }
}
