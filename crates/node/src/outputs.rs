//! Where bearings and states go: lines of JSON, a Unix socket, one line on a terminal.

use super::config::{Output, StatusLine};
use crate::{NodeError, descriptors};
use csi5300::source::Error;
use std::fs::{File, Permissions};
use std::io::{ErrorKind, IsTerminal, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// Lines that wait at most for a reader that is slow or stands still; further ones are lost and counted.
const LINES: usize = 1_024;
/// At the end so long is waited for them.
const LAST_LINES: Duration = Duration::from_secs(1);
/// Readers of the state at a time.
const READERS: usize = 16;
/// A reader that takes nothing for so long is let go.
const STUCK: Duration = Duration::from_secs(10);
/// Pause when no more connections can be accepted.
const NO_DESCRIPTORS: Duration = Duration::from_millis(500);

/// Lines of JSON, written on a thread of their own: whoever reads them cannot hold up the robot.
pub(super) struct Lines {
    writer: Option<Writer>,
    counts: Arc<LineCounts>,
}

struct Writer {
    lines: SyncSender<String>,
    /// Closed when the last line is written.
    done: Receiver<()>,
}

#[derive(Default)]
struct LineCounts {
    lost: AtomicU64,
    waiting: AtomicU64,
}

impl Lines {
    pub fn open(output: &Output) -> Result<Self, Error> {
        let to: Box<dyn Write + Send> = match output.bearings.as_str() {
            "" => return Ok(Self { writer: None, counts: Arc::default() }),
            "-" => Box::new(std::io::stdout()),
            path => Box::new(
                append_to(path)
                    .map_err(|source| Error::Io { what: format!("cannot write bearings to {path}"), source })?,
            ),
        };
        Self::to(to)
    }

    fn to(mut to: Box<dyn Write + Send>) -> Result<Self, Error> {
        let counts = Arc::new(LineCounts::default());
        let (lines, waiting) = sync_channel::<String>(LINES);
        let (written, done) = sync_channel(0);
        let shared = Arc::clone(&counts);
        let write = move || {
            // Each at once: a reader waits for it, and a kill must not take it.
            for line in waiting {
                let failed = to.write_all(line.as_bytes()).and_then(|()| to.flush()).is_err();
                shared.lost.fetch_add(u64::from(failed), Ordering::Relaxed);
                shared.waiting.fetch_sub(1, Ordering::Relaxed);
            }
            drop(written);
        };
        let what = "cannot start the thread that writes bearings".into();
        let thread = std::thread::Builder::new().name("csi5300 bearings".into()).spawn(write);
        thread.map_err(|source| Error::Io { what, source })?;
        Ok(Self { writer: Some(Writer { lines, done }), counts })
    }

    /// Hands over one value as one line, and never waits.
    pub fn write(&mut self, value: &impl serde::Serialize) {
        let Some(writer) = &self.writer else { return };
        self.counts.waiting.fetch_add(1, Ordering::Relaxed);
        let line = serde_json::to_string(value).map(|line| line + "\n");
        if !line.is_ok_and(|line| writer.lines.try_send(line).is_ok()) {
            self.counts.waiting.fetch_sub(1, Ordering::Relaxed);
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Lines that could not be written so far.
    pub fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// Waits for what is still to be written, but not for ever. Gives the lines that were not.
    pub fn finish(mut self) -> u64 {
        if let Some(Writer { lines, done }) = self.writer.take() {
            drop(lines);
            if done.recv_timeout(LAST_LINES) == Err(RecvTimeoutError::Timeout) {
                return self.lost() + self.counts.waiting.load(Ordering::Relaxed);
            }
        }
        self.lost()
    }
}

/// Opens what lines are added to. A pipe without a reader is refused: it would be waited for, and signals with it.
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
    // A reader that is slow is waited for, by the thread that writes.
    nix::fcntl::fcntl(&file, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_APPEND))?;
    Ok(file)
}

/// The status socket: every connection gets the state as one line of JSON a look.
pub(super) struct StatusSocket {
    path: PathBuf,
    told: watch::Sender<Arc<str>>,
}

impl StatusSocket {
    /// Listens, inside a runtime. A socket that a dead process left is taken over; a living one's is not.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io { what: format!("cannot listen on {}", path.display()), source };
        make_way(path)?;
        let listener = UnixListener::bind(path).map_err(io)?;
        // This user and its group may look; nothing is ever read from it.
        std::fs::set_permissions(path, Permissions::from_mode(0o660)).map_err(io)?;
        let (told, states) = watch::channel(Arc::from(""));
        tokio::spawn(accept(listener, states));
        Ok(Self { path: path.to_owned(), told })
    }

    pub fn tell(&self, value: &impl serde::Serialize) {
        if let Ok(text) = serde_json::to_string(value) {
            self.told.send_replace(Arc::from(text + "\n"));
        }
    }
}

/// Removes a socket on which nobody listens any more, and nothing else.
fn make_way(path: &Path) -> Result<(), Error> {
    let name = path.display();
    let Ok(there) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !there.file_type().is_socket() {
        return Err(NodeError::NoSocket { path: path.to_owned() }.into());
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => Err(NodeError::AnotherNode { path: path.to_owned() }.into()),
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            let io =
                |source| Error::Io { what: format!("cannot remove the socket {name} that nobody listens on"), source };
            std::fs::remove_file(path).map_err(io)
        }
        Err(source) => Err(Error::Io { what: format!("{name} is there: does another node use it?"), source }),
    }
}

impl Drop for StatusSocket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

async fn accept(listener: UnixListener, states: watch::Receiver<Arc<str>>) {
    let places = Arc::new(Semaphore::new(READERS));
    loop {
        match listener.accept().await {
            // Whoever finds no place is let go at once.
            Ok((stream, _)) => {
                if let Ok(place) = Arc::clone(&places).try_acquire_owned()
                    && descriptors::are_to_spare()
                {
                    drop(tokio::spawn(serve(stream, states.clone(), place)));
                }
            }
            // Out of descriptors: it would fail again at once.
            Err(_) => tokio::time::sleep(NO_DESCRIPTORS).await,
        }
    }
}

async fn serve(mut stream: UnixStream, mut states: watch::Receiver<Arc<str>>, _place: OwnedSemaphorePermit) {
    loop {
        let text = Arc::clone(&states.borrow_and_update());
        let written = tokio::time::timeout(STUCK, stream.write_all(text.as_bytes())).await;
        if !matches!(written, Ok(Ok(()))) || states.changed().await.is_err() {
            return;
        }
    }
}

/// One line of state on standard error.
pub(super) struct StatusText {
    shown: bool,
    terminal: bool,
}

impl StatusText {
    pub fn new(asked: StatusLine) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let shown = match asked {
            StatusLine::Auto => terminal,
            StatusLine::Always => true,
            StatusLine::Never => false,
        };
        Self { shown, terminal }
    }

    pub fn show(&self, line: &str) {
        if self.shown {
            let text = if self.terminal { format!("\r\x1b[K{line}") } else { format!("{line}\n") };
            let _ = std::io::stderr().write_all(text.as_bytes());
        }
    }

    /// Takes the line away, before other words.
    pub fn clear(&self) {
        if self.shown && self.terminal {
            let _ = std::io::stderr().write_all(b"\r\x1b[K");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reader that takes nothing until it is let go.
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
        assert_eq!(lines.finish(), before, "the others were written");
    }

    #[test]
    fn a_pipe_that_nobody_reads_is_not_waited_for() {
        let path = std::env::temp_dir().join(format!("csi5300-bearings-{}", std::process::id()));
        let output = Output { bearings: path.display().to_string(), ..Output::default() };
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let refused = Lines::open(&output).err().unwrap().to_string();
        assert!(refused.contains("nobody reads"), "{refused}");
        let mut reader = File::options().read(true).custom_flags(nix::libc::O_NONBLOCK).open(&path).unwrap();
        let mut lines = Lines::open(&output).unwrap();
        lines.write(&7);
        assert_eq!(lines.finish(), 0);
        let mut said = [0; 2];
        std::io::Read::read_exact(&mut reader, &mut said).unwrap();
        assert_eq!(&said, b"7\n");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn only_a_dead_socket_makes_way() {
        let folder = std::env::temp_dir().join(format!("csi5300-outputs-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, socket) = (folder.join("file"), folder.join("socket"));
        std::fs::write(&file, "precious").unwrap();
        assert!(make_way(&file).unwrap_err().to_string().contains("no socket"));
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "precious");
        let living = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert!(make_way(&socket).unwrap_err().to_string().contains("another node"));
        drop(living);
        make_way(&socket).unwrap();
        assert!(!socket.exists());
        make_way(&socket).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn readers_of_the_state_are_of_the_group_and_not_without_number() {
        let folder = std::env::temp_dir().join(format!("csi5300-readers-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("status.sock");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let socket = StatusSocket::open(&path).unwrap();
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
            socket.tell(&7);
            let mut readers = Vec::new();
            for _ in 0..READERS {
                readers.push(UnixStream::connect(&path).await.unwrap());
                assert_eq!(read(readers.last_mut().unwrap()).await, 2);
            }
            assert_eq!(read(&mut UnixStream::connect(&path).await.unwrap()).await, 0, "no place is left");
            // One that goes makes room: that it went is seen when it is next written to.
            drop(readers.pop());
            while read(&mut UnixStream::connect(&path).await.unwrap()).await == 0 {
                socket.tell(&7);
            }
        });
        std::fs::remove_dir_all(&folder).unwrap();
    }

    async fn read(reader: &mut UnixStream) -> usize {
        tokio::io::AsyncReadExt::read(reader, &mut [0; 2]).await.unwrap_or(0)
    }
}
