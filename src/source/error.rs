//! Why records do not come or frames do not go.

use crate::motion::odometry::OdometryError;
use std::path::PathBuf;

/// Why a source or an injector failed. Loss is not a failure: see [`Loss`](super::Loss).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system said no. `what` says what was tried, and what to check.
    #[error("{what}: {source}")]
    Io {
        /// What was tried, on what, and what to check next.
        what: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// A log was named by its folder.
    #[error("{} is a directory: name a .dat file inside it", .path.display())]
    Directory {
        /// The folder.
        path: PathBuf,
    },
    /// A file would be overwritten.
    #[error("{} already exists", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A log was to be written into a pipe: opening one waits for a reader, and what was written cannot be taken back.
    #[error("{} is a pipe: a log is written into a file", .path.display())]
    IntoPipe {
        /// The pipe.
        path: PathBuf,
    },
    /// Another recorder writes this log.
    #[error("{} is being recorded by another program", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The thread that writes a recorder's log panicked: unwritten records are lost.
    #[error("the thread that writes the log died")]
    WriterDied,
    /// A source without an end, as a card is, where a log is read to its end.
    #[error("a live source cannot be read to its end: record it, then give the log")]
    Endless,
    /// A failure of a source or an injector that another crate implements, in that crate's own type.
    #[error(transparent)]
    Backend(#[from] Box<dyn std::error::Error + Send + Sync>),
    /// A frame was not sent; the next one may be.
    #[error(transparent)]
    NotSent(#[from] NotSent),
}

impl From<OdometryError> for Error {
    fn from(error: OdometryError) -> Self {
        match error {
            OdometryError::Io { what, source } => Self::Io { what: what.into(), source },
            other => Self::Backend(Box::new(other)),
        }
    }
}

/// Why an injector did not take a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotSent {
    /// The queue of the kernel or the driver is full.
    #[error("the kernel has no room for another frame (ENOBUFS)")]
    NoRoom,
    /// The interface is down.
    #[error("the interface is down: `sudo ip link set INTERFACE up`")]
    Down,
    /// The frame is longer than the interface takes, its radiotap header included.
    #[error("a frame of {len} bytes, at most {mtu} go out: `sudo ip link set INTERFACE mtu 2304`")]
    TooLong {
        /// Bytes with radiotap header.
        len: usize,
        /// Bytes possible.
        mtu: usize,
    },
    /// Only a part of it was taken.
    #[error("the kernel took {taken} of {len} bytes of a frame")]
    Cut {
        /// Bytes taken.
        taken: usize,
        /// Bytes there were.
        len: usize,
    },
}
