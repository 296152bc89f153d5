//! Files that may let a reader wait indefinitely: FIFOs, terminals, standard input. Ctrl-C ends the wait.

use crate::error::Stop;
use csi5300::time::Span;
use csi5300_live::wait::Monotonic;
use pyo3::prelude::*;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Longest delay of a signal.
const PATIENCE: Span = Span::from_ms(40);

/// A file that is read when it is readable.
pub struct Patient {
    file: File,
    stop: Stop,
    clock: Monotonic,
}

/// Opens a file for reading; does not wait for a FIFO's writer.
pub fn open_at_once(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)
}

impl Patient {
    /// Opens `path` (`-`: standard input) if reading it may have to wait; `None` for regular files, directories, and missing ones. Reading
    /// ends with an error once `stop` is requested.
    pub fn open(path: &Path, stop: &Stop) -> io::Result<Option<Self>> {
        let file = if path.as_os_str() == "-" {
            File::from(io::stdin().as_fd().try_clone_to_owned()?)
        } else if path.metadata().is_ok_and(|of| !of.is_file() && !of.is_dir()) {
            open_at_once(path)?
        } else {
            return Ok(None);
        };
        Ok(Some(Self { file, stop: stop.clone(), clock: Monotonic::new() }))
    }
}

impl Read for Patient {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            if self.stop.is_asked() {
                // Not `Interrupted`, which means "try again".
                return Err(io::Error::other("the work was stopped"));
            }
            // Only on the thread that receives signals; work on others has its `stop`.
            Python::attach(|py| py.check_signals()).map_err(io::Error::other)?;
            let until = self.clock.now() + PATIENCE;
            let [ready] = self.clock.wait([self.file.as_fd()], Some(until)).map_err(io::Error::other)?;
            if !ready {
                continue;
            }
            match self.file.read(buffer) {
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                done => return done,
            }
        }
    }
}
