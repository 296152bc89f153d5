//! Bearings as lines of JSON, to a file, a pipe or standard output.

use super::{Adapter, Made, Robot, Said, Start};
use crate::config::Output;
use crate::health::Health;
use crate::lock;
use crate::threads::spawn;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::Error;
use std::fs::{File, TryLockError};
use std::io::{IsTerminal, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Limit of lines that wait for a slow reader; further ones are lost and counted.
const LINES: usize = 1_024;
/// Time to wait for them at the end.
const LAST_LINES: Duration = Duration::from_secs(5);

/// A published line.
#[derive(serde::Serialize)]
struct Line<'a> {
    /// How long the estimate took, milliseconds.
    took_ms: Option<f64>,
    /// Age of the last record in it, milliseconds.
    latency_ms: Option<f64>,
    #[serde(flatten)]
    report: &'a PeerReport,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    Ok(Some(Box::new(Bearings { output: start.config.output.clone(), lines: None })))
}

struct Bearings {
    output: Output,
    lines: Option<Lines>,
}

impl Adapter for Bearings {
    /// Not before: a robot whose sources cannot be opened leaves no file.
    fn meet(&mut self, _: &Robot) -> Result<(), Error> {
        self.lines = Lines::open(&self.output)?;
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        let line = Line { took_ms: said.took_ms, latency_ms: said.latency_ms, report: said.report };
        self.lines.iter_mut().for_each(|lines| lines.write(&line));
    }

    fn look(&mut self, health: &mut Health) {
        let Some(lines) = &self.lines else { return };
        health.load.lines_lost = lines.lost();
        health.trouble.extend(lines.trouble());
    }

    fn finish(&mut self, health: &mut Health) {
        let Some(lines) = &mut self.lines else { return };
        health.load.lines_lost = lines.end(LAST_LINES);
    }
}

/// Lines of JSON, written on a separate thread, so that a reader cannot delay the robot.
struct Lines {
    /// Until the end.
    lines: Option<SyncSender<String>>,
    /// Closed when the last line is written.
    done: Receiver<()>,
    counts: Arc<LineCounts>,
}

#[derive(Default)]
struct LineCounts {
    lost: AtomicU64,
    waiting: AtomicU64,
    /// Why the last line could not be written.
    refused: Mutex<Option<String>>,
}

impl Lines {
    /// Opens the output, if there is one.
    fn open(output: &Output) -> Result<Option<Self>, Error> {
        let to: Box<dyn Write + Send> = match output.bearings.as_str() {
            "" => return Ok(None),
            // A person reads there: the line of state has the bearings.
            "-" if output.shows_line() && std::io::stdout().is_terminal() => return Ok(None),
            "-" => Box::new(std::io::stdout()),
            path => {
                let file = append_to(path).map_err(Error::io(format!("cannot write bearings to {path}")))?;
                Box::new(Appended(file))
            }
        };
        Self::to(to).map(Some)
    }

    fn to(mut to: Box<dyn Write + Send>) -> Result<Self, Error> {
        let counts = Arc::new(LineCounts::default());
        let (lines, waiting) = sync_channel::<String>(LINES);
        let (written, done) = sync_channel(0);
        let shared = Arc::clone(&counts);
        let write = move || {
            // Written at once: a reader waits for it, and a kill must not lose it.
            for line in waiting {
                let error = to.write_all(line.as_bytes()).and_then(|()| to.flush()).err();
                shared.lost.fetch_add(u64::from(error.is_some()), Ordering::Relaxed);
                *lock(&shared.refused) = error.map(|error| error.to_string());
                shared.waiting.fetch_sub(1, Ordering::Relaxed);
            }
            // The waiting side may open the file again.
            drop(to);
            drop(written);
        };
        spawn("csi5300 bearings", "cannot start the thread that writes bearings", write)?;
        Ok(Self { lines: Some(lines), done, counts })
    }

    /// Hands over one value as one line, without waiting.
    pub fn write(&mut self, value: &impl serde::Serialize) {
        let Some(lines) = &self.lines else { return };
        self.counts.waiting.fetch_add(1, Ordering::Relaxed);
        let line = serde_json::to_string(value).map(|line| line + "\n");
        if !line.is_ok_and(|line| lines.try_send(line).is_ok()) {
            self.counts.waiting.fetch_sub(1, Ordering::Relaxed);
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Lines that could not be written so far.
    pub fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// The error of writing, in words.
    fn trouble(&self) -> Option<String> {
        let refused = lock(&self.counts.refused);
        let words = |why| format!("bearings are not written ({why}): see `output.bearings`; `lines_lost` counts them");
        refused.as_ref().map(words)
    }

    /// Waits at most `limit` for the remaining lines. Returns the number that was not written.
    pub fn end(&mut self, limit: Duration) -> u64 {
        drop(self.lines.take());
        let is_late = self.done.recv_timeout(limit) == Err(RecvTimeoutError::Timeout);
        self.lost() + if is_late { self.counts.waiting.load(Ordering::Relaxed) } else { 0 }
    }
}

/// A file under a lock. The lock ends with this value, even if a starting process holds a copy of the descriptor.
struct Appended(File);

impl Write for Appended {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes)
    }

    /// Writes all or nothing to a file: behind a part of a line, the next one could not be read either.
    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let before = self.0.metadata()?.len();
        self.0.write_all(bytes).inspect_err(|_| {
            // A pipe has no length.
            let _ = self.0.set_len(before);
        })
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

impl Drop for Appended {
    fn drop(&mut self) {
        // Without a lock there is nothing to end.
        let _ = self.0.unlock();
    }
}

/// Opens the output. Refuses a pipe without a reader, which would block the program and its signals, and a file that
/// another node writes.
fn append_to(path: &str) -> std::io::Result<File> {
    let file = File::options().append(true).create(true).custom_flags(nix::libc::O_NONBLOCK).open(path);
    let is_socket = || std::fs::metadata(path).is_ok_and(|there| there.file_type().is_socket());
    let file = file.map_err(|error| match error.raw_os_error() {
        Some(nix::libc::ENXIO) if is_socket() => {
            std::io::Error::other("it is a socket: bearings go to a file or a pipe")
        }
        Some(nix::libc::ENXIO) => std::io::Error::other("it is a pipe that nobody reads: start its reader first"),
        _ => error,
    })?;
    let is_file = file.metadata()?.is_file();
    // A file system without locks knows no other writer.
    if is_file && matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
        return Err(std::io::Error::other("another node writes it: stop that one, or give `bearings` another name"));
    }
    // Behind a line that a power cut left, the first one could not be read either.
    if is_file && ends_within_a_line(path) {
        (&file).write_all(b"\n")?;
    }
    // The writing thread waits for a slow reader.
    nix::fcntl::fcntl(&file, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_APPEND))?;
    Ok(file)
}

/// True for a file that can be read and whose last byte is no end of a line.
fn ends_within_a_line(path: &str) -> bool {
    let mut last = [b'\n'];
    let read = File::open(path).and_then(|mut file| {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)
    });
    read.is_ok() && last != *b"\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reader that reads nothing until it is released.
    struct Stuck(Receiver<()>);

    impl Write for Stuck {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let _ = self.0.recv();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_reader_that_stands_still_costs_lines_and_no_time() {
        let (go, stuck) = std::sync::mpsc::channel();
        let mut lines = Lines::to(Box::new(Stuck(stuck))).unwrap();
        // One is being written, or still waits.
        (0..LINES as u64 + 11).for_each(|k| lines.write(&k));
        assert!((10..=11).contains(&lines.lost()), "{}", lines.lost());
        let before = lines.lost();
        drop(go);
        assert_eq!(lines.end(Duration::MAX), before, "the others were written");
    }

    #[test]
    fn lines_that_the_disk_refuses_are_counted_and_explained() {
        let mut lines = Lines::open(&Output { bearings: "/dev/full".into(), ..Output::default() }).unwrap().unwrap();
        assert_eq!(lines.trouble(), None);
        (0..3).for_each(|k| lines.write(&k));
        assert_eq!(lines.end(Duration::MAX), 3);
        let said = lines.trouble().unwrap();
        assert!(
            said.contains("No space left") && said.contains("lines_lost") && said.contains("output.bearings"),
            "{said}"
        );
    }

    #[test]
    fn two_nodes_do_not_write_one_file() {
        let path = std::env::temp_dir().join(format!("csi5300-bearings-twice-{}", std::process::id()));
        let output = Output { bearings: path.display().to_string(), ..Output::default() };
        let first = Lines::open(&output).unwrap().unwrap();
        let refused = Lines::open(&output).err().unwrap().to_string();
        assert!(refused.contains("another node writes it: stop that one"), "{refused}");
        let Lines { lines, done, .. } = first;
        drop(lines);
        // The thread that writes is done with it.
        assert!(done.recv().is_err());
        assert!(Lines::open(&output).is_ok());
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn behind_half_a_line_whole_ones_follow() {
        let path = std::env::temp_dir().join(format!("csi5300-bearings-half-{}", std::process::id()));
        let output = Output { bearings: path.display().to_string(), ..Output::default() };
        for (before, after) in [("", "7\n"), ("1\n", "1\n7\n"), ("1\n{\"half", "1\n{\"half\n7\n")] {
            std::fs::write(&path, before).unwrap();
            let mut lines = Lines::open(&output).unwrap().unwrap();
            lines.write(&7);
            assert_eq!(lines.end(Duration::MAX), 0);
            assert_eq!(std::fs::read_to_string(&path).unwrap(), after);
        }
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_pipe_that_nobody_reads_is_not_waited_for() {
        let path = std::env::temp_dir().join(format!("csi5300-bearings-{}", std::process::id()));
        let output = Output { bearings: path.display().to_string(), ..Output::default() };
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let refused = Lines::open(&output).err().unwrap().to_string();
        assert!(refused.contains("nobody reads"), "{refused}");
        let mut reader = File::options().read(true).custom_flags(nix::libc::O_NONBLOCK).open(&path).unwrap();
        let mut lines = Lines::open(&output).unwrap().unwrap();
        lines.write(&7);
        assert_eq!(lines.end(Duration::MAX), 0);
        let mut said = [0; 2];
        std::io::Read::read_exact(&mut reader, &mut said).unwrap();
        assert_eq!(&said, b"7\n");
        std::fs::remove_file(&path).unwrap();
    }
}
