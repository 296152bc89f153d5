//! Where records come from and where frames go. A card, a recorded file, a simulated room and a remote
//! robot are values of one type, [`CsiSource`]. Who only wants to read a log takes [`Log`](crate::Log).

pub(crate) mod key_file;
pub(crate) mod log;
pub mod replay;
mod side_file;
pub mod survey;

// What the programs and the robot's service are made of: public for the crates of this workspace, no part of the library's
// interface.
#[doc(hidden)]
pub mod other_card;
#[doc(hidden)]
pub mod recorder;
#[doc(hidden)]
pub mod remote;

pub use key_file::read_key;
pub use side_file::{Checks, side_path};

use crate::motion::pose::TrajectoryError;
use crate::time::{Instant, Span};
use driver_iface::connector;
use driver_iface::record::{Reason, Record, Tail};
use std::path::PathBuf;

/// Something that did not arrive, or arrived damaged. Counted and reported, never an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Bytes of a log or datagram that are no intact record.
    Bytes {
        /// Offset of the first lost byte in the file (or 0-based datagram number).
        offset: u64,
        /// Number of bytes skipped.
        len: u64,
        /// Why.
        reason: Reason,
    },
    /// A datagram from the driver that cannot be read, or the rest of it.
    Datagram {
        /// Running number of the datagram, from 0.
        number: u64,
        /// Bytes received.
        len: u64,
        /// Why.
        reason: Refused,
    },
    /// A kernel or peer queue ran over; `dropped` where the number is known.
    Overrun {
        /// Messages dropped, if the kernel says.
        dropped: Option<u64>,
    },
}

/// Why a datagram is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// Its headers contradict each other or its length.
    #[error("{0}")]
    Connector(connector::Error),
    /// It is longer than the buffer: the rest is lost (MSG_TRUNC).
    #[error("a datagram of {sent} bytes was cut to {kept}")]
    Truncated {
        /// Bytes that were sent.
        sent: usize,
        /// Bytes that arrived.
        kept: usize,
    },
    /// A record longer than any that the card can make: no log could hold it.
    #[error("a record of length {got}, at most {max} is possible")]
    Oversized {
        /// Code and body.
        got: usize,
        /// The largest possible, [`driver_iface::record::MAX_LENGTH`].
        max: usize,
    },
}

/// What [`CsiSource::receive`] gives.
#[derive(Debug)]
pub enum Next<'a> {
    /// A record with its time of reception, as far as known.
    Record(Stamps, Record<'a>),
    /// Something was lost here.
    Lost(Loss),
    /// Nothing yet: wait for [`CsiSource::next_at`], or for the file descriptor.
    Pending,
    /// The source is exhausted, and how it ended.
    End(Tail),
}

/// When a record was received, on the clocks that were read. The card's own clock is inside the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    /// The driver's own time at which the record was handed over. For waiting, not for measuring.
    pub at: Instant,
    /// Host wall clock at receipt, microseconds since the Unix epoch, where a side file or the listener has one.
    pub host_us: Option<i64>,
    /// Where the record is among the others of its source.
    pub origin: Origin,
}

/// The place of a record in its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// In a file or another stream of bytes.
    File {
        /// Bytes before its length field.
        offset: u64,
    },
    /// From a card or a network, or made here.
    Live {
        /// Running number of the record, from 0.
        number: u64,
    },
}

impl Default for Origin {
    fn default() -> Self {
        Self::Live { number: 0 }
    }
}

impl Origin {
    /// The offset or the number, for reports that state elsewhere which of the two it is.
    #[must_use]
    pub(crate) fn position(self) -> u64 {
        match self {
            Self::File { offset } => offset,
            Self::Live { number } => number,
        }
    }
}

/// A source of records. It never blocks and never parses; it lends its own buffer.
pub trait CsiSource {
    /// The next record, loss, or nothing yet. `now` is the driver's time and never runs backwards.
    ///
    /// # Errors
    /// Only for fatal errors; loss is [`Next::Lost`].
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error>;

    /// When to call [`receive`](Self::receive) again, on the driver's clock; at once where that is not after its time.
    ///
    /// `None` where time alone brings nothing: a live socket is waited for by its file descriptor, and a source that has
    /// ended gives nothing more.
    fn next_at(&self) -> Option<Instant>;
}

impl<S: CsiSource + ?Sized> CsiSource for Box<S> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        (**self).receive(now)
    }

    fn next_at(&self) -> Option<Instant> {
        (**self).next_at()
    }
}

/// Something that can put a frame on the air. Separate from [`CsiSource`]: a recorded file has no transmitter.
pub trait Injector {
    /// Hands over one 802.11 frame (no radiotap header, no FCS) to be sent at once.
    ///
    /// # Errors
    /// When the frame was not taken; [`Error::NotSent`] where the next one may be.
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error>;
}

/// Why a source or an injector failed. Loss is not a failure: see [`Loss`].
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
    /// A key's path is a device, a pipe or a folder.
    #[error("the key {} is no regular file", .path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
    },
    /// Others may read or change a key's file, it holds something else, or it was not made at random.
    #[error("{0}")]
    Key(String),
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
    /// MACs of more transmitters than there are logs.
    #[error("{macs} MACs of transmitters for {logs} of their logs: give at most one for each log")]
    MoreMacs {
        /// The MACs.
        macs: usize,
        /// The logs.
        logs: usize,
    },
    /// A failure of a source or an injector that another crate implements, in that crate's own type.
    #[error(transparent)]
    Backend(#[from] Box<dyn std::error::Error + Send + Sync>),
    /// A pose came that cannot be moved to the antenna.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// A frame was not sent; the next one may be.
    #[error(transparent)]
    NotSent(#[from] NotSent),
}

impl Error {
    /// What the operating system said no to, for `map_err`: what was tried, on what, and what to check next.
    #[doc(hidden)] // for the crates of this workspace
    pub fn io<E: Into<std::io::Error>>(what: impl Into<String>) -> impl FnOnce(E) -> Self {
        |source| Self::Io { what: what.into(), source: source.into() }
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

/// A frame heard: the 802.11 frame without radiotap header and FCS.
#[doc(hidden)] // for the crates of this workspace
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeardFrame<'a> {
    /// The frame.
    pub frame: &'a [u8],
    /// How long ago its reception ended, if known.
    pub age: Span,
}

/// Something that hears frames from the air. It never blocks.
#[doc(hidden)] // for the crates of this workspace
pub trait FrameReceiver {
    /// The next frame, or `None` if there is none yet.
    ///
    /// # Errors
    /// Only for fatal failures; damage is counted and skipped.
    fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error>;

    /// Frames confirmed as sent, if the source can tell.
    fn sent_for_certain(&self) -> Option<u64>;

    /// Frames that failed to be sent.
    fn failed_for_certain(&self) -> u64;
}

/// Appends a record to the bytes of a log as loggers write it; false, and nothing of it, if it is longer than any record.
#[doc(hidden)] // for the crates of this workspace
pub fn append(record: Record<'_>, log: &mut Vec<u8>) -> bool {
    let from = log.len();
    log.resize(from + record.emit_len(), 0);
    let is_written = log.get_mut(from..).is_some_and(|room| record.emit(room).is_ok());
    if !is_written {
        log.truncate(from);
    }
    is_written
}
