//! The state: on a Unix socket as lines of JSON, for `csi5300 watch`, and as one line on a terminal.

use super::{Adapter, Made, Start, are_descriptors_to_spare};
use crate::health::Health;
use crate::machine::Machine;
use crate::refused;
use csi5300::source::Error;
use std::fs::Permissions;
use std::io::{ErrorKind, IsTerminal, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// Readers of the state at a time.
const READERS: usize = 16;
/// A reader that reads nothing for this time is disconnected.
const STUCK: Duration = Duration::from_secs(10);
/// Pause when no more connections can be accepted.
const NO_DESCRIPTORS: Duration = Duration::from_millis(500);

/// Clears the line of state.
const CLEAR: &str = "\r\x1b[K";

pub(super) fn make(start: &Start<'_>) -> Made {
    let socket = start.config.output.status_socket.as_deref().map(StatusSocket::open).transpose()?;
    let (shown, terminal) = (start.config.output.shows_line(), std::io::stderr().is_terminal());
    Ok(Some(Box::new(Status { socket, shown, terminal })))
}

struct Status {
    socket: Option<StatusSocket>,
    /// The line of state is shown on standard error, and that is a terminal.
    shown: bool,
    terminal: bool,
}

impl Adapter for Status {
    fn attach(&mut self, _: &mut Machine) -> Result<(), Error> {
        self.socket.as_mut().map_or(Ok(()), StatusSocket::serve)
    }

    fn tell(&mut self, health: &Health, _: &Machine) {
        if let Some(socket) = &self.socket {
            socket.tell(health);
        }
        if self.shown {
            let line = health.line();
            let text = if self.terminal { format!("{CLEAR}{line}") } else { format!("{line}\n") };
            let _ = std::io::stderr().write_all(text.as_bytes());
        }
    }

    fn finish(&mut self, _: &mut Health) {
        // Other output follows.
        if self.shown && self.terminal {
            let _ = std::io::stderr().write_all(CLEAR.as_bytes());
        }
    }
}

/// The status socket: every connection gets each state as one line of JSON.
struct StatusSocket {
    path: PathBuf,
    /// Until it is served.
    listener: Option<std::os::unix::net::UnixListener>,
    told: watch::Sender<Arc<str>>,
}

impl StatusSocket {
    /// Listens. Takes over the socket of a dead process, but not of a living one.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io { what: format!("cannot listen on {}", path.display()), source };
        make_way(path)?;
        let listener = std::os::unix::net::UnixListener::bind(path).map_err(io)?;
        listener.set_nonblocking(true).map_err(io)?;
        // This user and its group may read; nothing is read from them.
        std::fs::set_permissions(path, Permissions::from_mode(0o660)).map_err(io)?;
        let (told, _) = watch::channel(Arc::from(""));
        Ok(Self { path: path.to_owned(), listener: Some(listener), told })
    }

    /// Takes readers, inside a runtime.
    pub fn serve(&mut self) -> Result<(), Error> {
        let Some(listener) = self.listener.take() else { return Ok(()) };
        let listener = UnixListener::from_std(listener);
        let listener = listener.map_err(Error::io(format!("cannot listen on {}", self.path.display())))?;
        tokio::spawn(accept(listener, self.told.subscribe()));
        Ok(())
    }

    pub fn tell(&self, value: &impl serde::Serialize) {
        if let Ok(text) = serde_json::to_string(value) {
            self.told.send_replace(Arc::from(text + "\n"));
        }
    }
}

/// Removes an abandoned socket, but no other file.
fn make_way(path: &Path) -> Result<(), Error> {
    let name = path.display();
    let Ok(there) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !there.file_type().is_socket() {
        return Err(refused(format!("{name} is there and is no socket: give `status_socket` another name")));
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => Err(refused(format!("another node answers on {name}: stop it first"))),
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            let what = format!("cannot remove the socket {name} that nobody listens on");
            std::fs::remove_file(path).map_err(Error::io(what))
        }
        Err(error) => Err(Error::io(format!("{name} is there: does another node use it?"))(error)),
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
                    && are_descriptors_to_spare()
                {
                    drop(tokio::spawn(serve(stream, states.clone(), place)));
                }
            }
            // Out of descriptors: another try would fail at once.
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

#[cfg(test)]
mod tests {
    use super::*;

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
        // Programs that other tests start hold copies of it between their fork and their exec.
        while let Err(error) = make_way(&socket) {
            assert!(error.to_string().contains("another node"), "{error}");
            std::thread::yield_now();
        }
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
            let mut socket = StatusSocket::open(&path).unwrap();
            socket.serve().unwrap();
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
            socket.tell(&7);
            let mut readers = Vec::new();
            for _ in 0..READERS {
                readers.push(UnixStream::connect(&path).await.unwrap());
                assert_eq!(read(readers.last_mut().unwrap()).await, 2);
            }
            assert_eq!(read(&mut UnixStream::connect(&path).await.unwrap()).await, 0, "no place is left");
            // A closed connection is noticed at the next write.
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
