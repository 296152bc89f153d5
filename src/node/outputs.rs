//! Where bearings and states go: lines of JSON, a Unix socket, one line on a terminal.

use super::config::{Output, StatusLine};
use crate::backend::Error;
use std::fs::File;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::io::AsyncWriteExt;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::watch;

/// Lines of JSON.
pub(super) struct Lines {
    to: Option<Box<dyn Write>>,
    /// Lines that could not be written.
    pub lost: u64,
}

impl Lines {
    pub fn open(output: &Output) -> Result<Self, Error> {
        let to: Option<Box<dyn Write>> = match output.bearings.as_str() {
            "" => None,
            "-" => Some(Box::new(std::io::stdout())),
            path => {
                let what = format!("cannot write bearings to {path}");
                let file = File::options().append(true).create(true).open(path);
                Some(Box::new(file.map_err(|source| Error::Io { what, source })?))
            }
        };
        Ok(Self { to, lost: 0 })
    }

    /// Writes one value as one line, at once: a reader waits for it, and a kill must not take it.
    pub fn write(&mut self, value: &impl serde::Serialize) {
        let Some(to) = &mut self.to else { return };
        let line = serde_json::to_string(value).map(|line| line + "\n");
        let written = line.is_ok_and(|line| to.write_all(line.as_bytes()).and_then(|()| to.flush()).is_ok());
        self.lost += u64::from(!written);
    }
}

/// The status socket: everybody who connects is told the state, once a look, as lines of JSON.
pub(super) struct StatusSocket {
    path: PathBuf,
    told: watch::Sender<Arc<str>>,
}

impl StatusSocket {
    /// Listens, inside a runtime. A socket that a dead process left is taken over; a living one's is not.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io { what: format!("cannot listen on {}", path.display()), source };
        if std::os::unix::net::UnixStream::connect(path).is_ok() {
            return Err(Error::Input(format!("another node answers on {}: stop it first", path.display())));
        }
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(io(error)),
            _ => {}
        }
        let listener = UnixListener::bind(path).map_err(io)?;
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

impl Drop for StatusSocket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

async fn accept(listener: UnixListener, states: watch::Receiver<Arc<str>>) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => drop(tokio::spawn(serve(stream, states.clone()))),
            // Out of descriptors: others go first.
            Err(_) => tokio::task::yield_now().await,
        }
    }
}

async fn serve(mut stream: UnixStream, mut states: watch::Receiver<Arc<str>>) {
    loop {
        let text = Arc::clone(&states.borrow_and_update());
        if stream.write_all(text.as_bytes()).await.is_err() || states.changed().await.is_err() {
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
