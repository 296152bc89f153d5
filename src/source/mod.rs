//! The edge: where records come from and where frames go. A card, a recorded file, a simulated room and a remote
//! robot are values of one type, [`CsiSource`].

pub mod paced;
pub mod recorder;
pub mod remote;
pub mod replay;
mod side_file;
pub mod survey;

pub use side_file::side_path;

use crate::time::Instant;
use driver_iface::connector;
use driver_iface::record::{Reason, Record, Tail};

/// Why a source or an injector failed. Loss is not a failure: see [`Loss`].
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system said no. `what` says what was tried, and what to check.
    #[error("{what}: {source}")]
    Io {
        /// What was tried, on what, and what to check next.
        what: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// The input is not what this source reads.
    #[error("{0}")]
    Input(String),
    /// A frame was not sent; the next one may be.
    #[error(transparent)]
    NotSent(#[from] NotSent),
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
    /// It is longer than the buffer: the rest of it is gone (MSG_TRUNC).
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
    /// A record, with what is known about when it was received.
    Record(Stamps, Record<'a>),
    /// Something was lost here.
    Lost(Loss),
    /// Nothing yet: wait for [`CsiSource::next_at`], or for the file descriptor.
    Pending,
    /// The source is exhausted, and how it ended.
    End(Tail),
}

/// When a record was received, on the clocks that say so. The card's own clock is inside the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    /// The driver's own time at which the record was handed over. For waiting, not for measuring.
    pub at: Instant,
    /// Host wall clock at receipt, microseconds since the Unix epoch, where a side file or the listener has one.
    pub host_us: Option<i64>,
    /// Offset of the record in its file, or its running number.
    pub offset: u64,
}

/// A source of records. It never blocks and never parses; it lends its own buffer.
pub trait CsiSource {
    /// The next record, loss, or nothing yet. `now` is the driver's time and never runs backwards.
    ///
    /// # Errors
    /// Only for what cannot be gone on from; loss is [`Next::Lost`].
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error>;

    /// When the next record is due, if the source knows: replay and simulation do, a live socket does not.
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

/// A frame heard: the 802.11 frame without radiotap header and FCS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heard<'a> {
    /// The frame.
    pub frame: &'a [u8],
    /// How long ago its reception ended, as far as is known.
    pub age: crate::time::Span,
}

/// Something that hears frames from the air. It never blocks.
pub trait FrameReceiver {
    /// The next frame, or `None` if there is none yet.
    ///
    /// # Errors
    /// Only for what cannot be gone on from; what is damaged is counted and left out.
    fn hear(&mut self) -> Result<Option<Heard<'_>>, Error>;

    /// Frames of which is known that they went out, if that can be known at all.
    fn sent_for_certain(&self) -> Option<u64>;

    /// Frames of which is known that sending failed.
    fn failed_for_certain(&self) -> u64;
}
