//! Records what a node reads and publishes: a folder as `ros2 bag` makes it, with one MCAP file, written on its own thread.
//! A message that the thread cannot take in time is dropped and counted; the caller never waits.

use crate::lock;
use csi5300_bag::mcap::{McapWriter, Written};
use csi5300_bag::messages::Message;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Messages that may wait to be written.
const QUEUE: usize = 4_096;
/// A chunk is written after this time at the latest.
const FLUSH: Duration = Duration::from_secs(1);

/// A message to be written.
struct Row {
    topic: String,
    kind: &'static str,
    definition: fn() -> String,
    time_ns: u64,
    payload: Vec<u8>,
}

#[derive(Debug, Default)]
struct Counts {
    written: AtomicU64,
    lost: AtomicU64,
    failed: Mutex<Option<String>>,
}

struct Running {
    folder: PathBuf,
    /// Messages in earlier recordings.
    before: u64,
    rows: SyncSender<Row>,
    thread: JoinHandle<()>,
}

/// A recording that can be started and stopped.
pub(crate) struct Bag {
    /// Folder of the first recording; later ones append a number.
    folder: PathBuf,
    running: Mutex<Option<Running>>,
    counts: Arc<Counts>,
}

impl Bag {
    /// A recording that is not started.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder, running: Mutex::default(), counts: Arc::default() }
    }

    /// Starts a recording and returns its folder. A running recording continues; after one that failed, another starts.
    ///
    /// # Errors
    /// If its folder or file cannot be created.
    pub fn start(&self) -> io::Result<PathBuf> {
        let mut running = lock(&self.running);
        if let Some(running) = running.as_ref().filter(|running| !running.thread.is_finished()) {
            return Ok(running.folder.clone());
        }
        *lock(&self.counts.failed) = None;
        let folder = free_name(&self.folder);
        std::fs::create_dir_all(&folder)?;
        let name = file_name(&folder);
        let writer = McapWriter::new(BufWriter::new(File::create_new(folder.join(&name))?))?;
        std::fs::write(folder.join("metadata.yaml"), metadata(&name, None, &[]))?;
        let (rows, waiting) = sync_channel(QUEUE);
        let (counts, into) = (Arc::clone(&self.counts), folder.clone());
        let work = move || {
            if let Err(error) = write(writer, &waiting, &counts, (&into, &name)) {
                // At least the one that failed, and all that wait.
                counts.lost.fetch_add(1 + waiting.try_iter().count() as u64, Ordering::Relaxed);
                *lock(&counts.failed) = Some(error.to_string());
            }
        };
        let thread = std::thread::Builder::new().name("csi5300 bag".into()).spawn(work)?;
        *running =
            Some(Running { folder: folder.clone(), before: self.counts.written.load(Ordering::Relaxed), rows, thread });
        Ok(folder)
    }

    /// Ends the recording and returns its folder, if there was one.
    ///
    /// # Errors
    /// Why it is incomplete.
    pub fn stop(&self) -> Option<Result<PathBuf, String>> {
        let running = lock(&self.running).take()?;
        drop(running.rows);
        let _ = running.thread.join();
        Some(self.trouble().map_or(Ok(running.folder), Err))
    }

    /// Ends the recording for good, and removes one without messages, so that a node that repeatedly fails to start leaves no
    /// folders.
    pub fn end(&self) {
        let before = lock(&self.running).as_ref().map(|running| running.before);
        let Some(Ok(folder)) = self.stop() else { return };
        if before == Some(self.counts.written.load(Ordering::Relaxed)) {
            let files = [file_name(&folder), "metadata.yaml".into()];
            files.iter().for_each(|name| drop(std::fs::remove_file(folder.join(name))));
            // Files that others put there stay.
            let _ = std::fs::remove_dir(&folder);
        }
    }

    /// Records a message of time `wall_us`; never waits.
    pub fn put<T: Message>(&self, topic: &str, payload: &[u8], wall_us: i64) {
        let running = lock(&self.running);
        let Some(running) = &*running else { return };
        let time_ns = u64::try_from(wall_us).unwrap_or(0) * 1_000;
        let (topic, kind) = (topic.to_owned(), T::TYPE);
        let row = Row { topic, kind, definition: T::definition, time_ns, payload: payload.to_vec() };
        if running.rows.try_send(row).is_err() {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The current problem as text.
    pub fn trouble(&self) -> Option<String> {
        let failed = lock(&self.counts.failed);
        failed.as_ref().map(|why| format!("the recording of ROS 2 ended: {why}"))
    }

    /// The counters.
    pub fn counted(&self) -> serde_json::Value {
        let folder = lock(&self.running).as_ref().map(|running| running.folder.clone());
        let number = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        serde_json::json!({ "folder": folder, "written": number(&self.counts.written), "lost": number(&self.counts.lost) })
    }
}

impl Drop for Bag {
    fn drop(&mut self) {
        self.end();
    }
}

/// The name of a recording's file.
fn file_name(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned() + "_0.mcap"
}

/// The first of `bag`, `bag-r1`, `bag-r2` ... that does not exist: no recording overwrites another.
fn free_name(folder: &Path) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = |k: u32| folder.with_file_name(format!("{name}-r{k}"));
    let mut all = std::iter::once(folder.to_owned()).chain((1..).map(numbered));
    all.find(|folder| !folder.exists()).unwrap_or_else(|| folder.to_owned())
}

/// Writes messages until the channel closes.
fn write(
    mut writer: McapWriter<BufWriter<File>>,
    waiting: &Receiver<Row>,
    counts: &Counts,
    (folder, name): (&Path, &str),
) -> io::Result<()> {
    let mut flushed = Instant::now();
    loop {
        match waiting.recv_timeout(FLUSH) {
            Ok(row) => {
                writer.put((&row.topic, row.kind, row.definition), row.time_ns, &row.payload)?;
                counts.written.fetch_add(1, Ordering::Relaxed);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        if flushed.elapsed() >= FLUSH {
            writer.flush()?;
            flushed = Instant::now();
        }
    }
    writer.finish()?;
    std::fs::write(folder.join("metadata.yaml"), metadata(name, writer.times, &writer.channels))
}

/// `metadata.yaml` in Humble's version, which all later releases read.
fn metadata(file: &str, times: Option<(u64, u64)>, channels: &[Written]) -> String {
    let (first, last) = times.unwrap_or_default();
    let messages: u64 = channels.iter().map(|channel| channel.messages).sum();
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {}\n  \
         starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {messages}\n",
        last - first
    );
    text.push_str(if channels.is_empty() {
        "  topics_with_message_count: []\n"
    } else {
        "  topics_with_message_count:\n"
    });
    for Written { topic, kind, messages } in channels {
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {topic}\n        type: {kind}\n        serialization_format: cdr\n        \
             offered_qos_profiles: \"\"\n      message_count: {messages}\n"
        );
    }
    let _ = write!(
        text,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  files:\n    - path: \
         {file}\n      starting_time:\n        nanoseconds_since_epoch: {first}\n      duration:\n        nanoseconds: {}\n      \
         message_count: {messages}\n",
        last - first
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_bag::cdr::Cdr;
    use csi5300_bag::messages::Clock;

    #[test]
    fn an_empty_recording_is_removed() {
        let folder = std::env::temp_dir().join(format!("csi5300-bag-none-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("run")).unwrap();
        let bag = Bag::new(folder.join("run"));
        assert_eq!(bag.start().unwrap(), folder.join("run-r1"));
        assert!(folder.join("run-r1").join("run-r1_0.mcap").exists());
        drop(bag);
        let left: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["run"]);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_recording_that_failed_is_said_and_another_one_can_start() {
        let folder = std::env::temp_dir().join(format!("csi5300-bag-full-{}", std::process::id()));
        let bag = Bag::new(folder.join("run"));
        bag.start().unwrap();
        // As after a disk that was full.
        let (rows, _) = sync_channel(1);
        let thread = std::thread::spawn(|| ());
        while !thread.is_finished() {
            std::thread::yield_now();
        }
        let running = Running { folder: folder.join("run"), before: 0, rows, thread };
        drop(lock(&bag.running).replace(running));
        *lock(&bag.counts.failed) = Some("No space left on device".into());
        bag.put::<Clock>("/clock", &Clock::default().payload(), 1);
        assert_eq!(bag.counted()["lost"], 1);
        let stopped = bag.stop().unwrap();
        assert!(stopped.unwrap_err().contains("No space left"), "a call to stop it fails");
        assert_eq!(bag.start().unwrap(), folder.join("run-r1"));
        assert_eq!(bag.trouble(), None);
        drop(bag);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_stopped_recording_is_complete_and_overwrites_none() {
        let folder = std::env::temp_dir().join(format!("csi5300-bag-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let bag = Bag::new(folder.join("run"));
        bag.put::<Clock>("/clock", &Clock::default().payload(), 1);
        for expected in ["run", "run-r1"] {
            assert_eq!(bag.start().unwrap(), folder.join(expected));
            assert_eq!(bag.start().unwrap(), folder.join(expected), "it goes on");
            bag.put::<Clock>("/clock", &Clock::default().payload(), 5_000_000);
            assert_eq!(bag.stop(), Some(Ok(folder.join(expected))));
            let text = std::fs::read_to_string(folder.join(expected).join("metadata.yaml")).unwrap();
            assert!(text.contains("message_count: 1\n  topics_with"), "{text}");
            assert!(text.contains("name: /clock\n        type: rosgraph_msgs/msg/Clock"), "{text}");
            let bytes = std::fs::read(folder.join(expected).join(format!("{expected}_0.mcap"))).unwrap();
            assert!(bytes.ends_with(b"\x89MCAP0\r\n") && bytes.len() > 100);
        }
        assert_eq!((bag.stop(), bag.counted()["written"].as_u64()), (None, Some(2)));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
