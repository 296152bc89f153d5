//! Any bytes as a recording (MCAP, SQLite, ROS 1): refused with a reason, or written as logs and trajectories with the stated
//! number of records and rows.

use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use csi5300_bag::unbag::{BagError, Content, Recording};

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let thread = std::thread::current().id();
    let file = std::env::temp_dir().join(format!("csi5300-fuzz-{}-{thread:?}.bag", std::process::id()));
    std::fs::write(&file, bytes).expect("a place for files");
    let read = Recording::read(&file);
    std::fs::remove_file(&file).expect("it is there");
    let recording = match read {
        Ok(recording) => recording,
        Err(error) => {
            assert!(!matches!(error, BagError::Output(_)), "{error}");
            return;
        }
    };
    for topic in &recording.topics {
        let found = match topic.content {
            Content::Csi => records(&topic.bytes),
            _ => topic.bytes.iter().filter(|byte| **byte == b'\n').count() as u64,
        };
        assert_eq!(found, topic.messages, "{}", topic.topic);
    }
}

/// Records of a log without losses.
fn records(log: &[u8]) -> u64 {
    let mut replay = Replay::new(log, String::new());
    let mut records = 0;
    loop {
        match replay.receive(Instant::ZERO).expect("bytes in memory") {
            Next::Record(..) => records += 1,
            Next::End(_) => return records,
            other => panic!("{other:?}"),
        }
    }
}
