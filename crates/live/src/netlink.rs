//! The driver's records, live: a listener on the kernel's connector.
//!
//! It differs from csitool's `log_to_file` in five points, each a cause of lost captures: the multicast group is joined
//! by number (bind's `nl_groups` is a bit mask, and 26 means groups 2, 4 and 5 there); the index is found instead of
//! compiled in; only messages of the kernel are accepted; a message ends where `cn_msg.len` says; and an overrun is
//! counted and reported, but does not end the capture.
//!
//! **Overruns.** When the socket's queue is full, the kernel drops the newest messages, returns ENOBUFS once, ahead of
//! the queued messages, and then drops everything until the queue is empty (`af_netlink.c`, NETLINK_S_CONGESTED). So
//! the listener continues to read at once, and reports [`Loss::Overrun`] at the gap: before the first record whose
//! `bfee_count` jumps, or when the queue is empty.
//!
//! CAP_NET_ADMIN is enough to listen; root is not needed. The same code listens to the card of a robot in a simulated
//! room: [`Netlink::over`].

mod error;
mod intake;
mod send;
mod socket;

pub use error::NetlinkError;
pub use intake::SocketCounts;
pub use send::Sender;
pub use socket::Found;

use csi5300::source::{CsiSource, Error, Loss, Next, Origin, Stamps};
use csi5300::time::{HostTimes, Instant};
use driver_iface::connector::CN_IDX;
use driver_iface::record::Tail;
use intake::{Intake, Turn};
use netlink_sys::Socket;
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};

/// Requested receive buffer, bytes: the kernel doubles it, and counts 832 bytes for a 3x1 record and 1,280 for a WSR
/// one (measured on 6.18), so this holds about two and a half seconds at 20,000 records a second.
pub const RECEIVE_BUFFER: usize = 32 * 1024 * 1024;

/// How to listen.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Options {
    /// The connector index; by default it is searched.
    pub connector_index: Option<u32>,
    /// Accept messages of other processes too: for emulators and tests, never for a card.
    pub allow_user_sender: bool,
    /// Requested receive buffer, bytes.
    pub receive_buffer: usize,
    /// Reads the host's wall clock, microseconds since the Unix epoch: the receive time of each record, which
    /// [`HostTimes`] makes even.
    pub wall_us: fn() -> Option<i64>,
}

impl Default for Options {
    /// Searches the driver's index, accepts only the kernel's messages, and stamps records with the host's time.
    fn default() -> Self {
        Self {
            connector_index: None,
            allow_user_sender: false,
            receive_buffer: RECEIVE_BUFFER,
            wall_us: crate::wait::wall_us,
        }
    }
}

impl Options {
    /// Sets [`connector_index`](Self::connector_index).
    #[must_use]
    pub fn with_connector_index(self, connector_index: Option<u32>) -> Self {
        Self { connector_index, ..self }
    }

    /// Sets [`allow_user_sender`](Self::allow_user_sender).
    #[must_use]
    pub fn with_allow_user_sender(self, allow_user_sender: bool) -> Self {
        Self { allow_user_sender, ..self }
    }

    /// Sets [`receive_buffer`](Self::receive_buffer), bytes.
    #[must_use]
    pub fn with_receive_buffer(self, receive_buffer: usize) -> Self {
        Self { receive_buffer, ..self }
    }

    /// Sets [`wall_us`](Self::wall_us).
    #[must_use]
    pub fn with_wall_us(self, wall_us: fn() -> Option<i64>) -> Self {
        Self { wall_us, ..self }
    }
}

/// A listener. Never blocks; wait on its file descriptor for [`Next::Pending`] to end.
#[derive(Debug)]
pub struct Netlink {
    wire: Wire,
    indices: Vec<u32>,
    found: Found,
    receive_buffer: usize,
    wall_us: fn() -> Option<i64>,
    host_times: HostTimes,
    intake: Intake,
}

/// The source of datagrams.
#[derive(Debug)]
enum Wire {
    /// The kernel's connector, and the socket's netlink port.
    Kernel(Socket, u32),
    /// A served room, which sends what the kernel would.
    Room(OwnedFd),
}

impl Wire {
    /// One datagram: its true length and the sender's port; `None` when the room has ended.
    fn receive(&self, buffer: &mut [u8]) -> io::Result<Option<(usize, u32)>> {
        match self {
            Self::Kernel(socket, _) => socket::receive(socket, buffer).map(Some),
            Self::Room(room) => Ok(Some((socket::receive_message(room, buffer)?, 0)).filter(|(len, _)| *len > 0)),
        }
    }
}

/// The results of intake and socket, without a borrow.
enum Step {
    Lost(Loss),
    Pending,
    End,
}

impl Netlink {
    /// Opens, widens, filters and joins.
    ///
    /// # Errors
    /// Missing privilege, the wrong network namespace, no connector in the kernel: each with what to do about it.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let joined = socket::open(options)?;
        Ok(Self {
            intake: Intake::new(joined.indices.clone(), options.allow_user_sender),
            wire: Wire::Kernel(joined.socket, joined.port),
            indices: joined.indices,
            found: joined.found,
            receive_buffer: joined.receive_buffer,
            wall_us: options.wall_us,
            host_times: HostTimes::default(),
        })
    }

    /// Listens to a message socket (SOCK_SEQPACKET) that sends the kernel's datagrams: the card of a robot in a
    /// simulated room.
    #[must_use]
    pub fn over(room: OwnedFd, wall_us: fn() -> Option<i64>) -> Self {
        let receive_buffer = socket::widen(&room, RECEIVE_BUFFER);
        let indices = vec![CN_IDX];
        let intake = Intake::new(indices.clone(), true);
        let (wire, found, host_times) = (Wire::Room(room), Found::Served, HostTimes::default());
        Self { wire, indices, found, receive_buffer, wall_us, host_times, intake }
    }

    /// The connector indices in use, and how they were found.
    #[must_use]
    pub fn indices(&self) -> (&[u32], Found) {
        (&self.indices, self.found)
    }

    /// The index that delivered the first record, once there was one.
    #[must_use]
    pub fn delivered_by(&self) -> Option<u32> {
        self.intake.delivered()
    }

    /// Granted receive buffer, bytes (the kernel's count, twice the request).
    #[must_use]
    pub fn receive_buffer(&self) -> usize {
        self.receive_buffer
    }

    /// The netlink port of the socket, by which the kernel lists it; 0 in a served room.
    #[must_use]
    pub fn port(&self) -> u32 {
        if let Wire::Kernel(_, port) = self.wire { port } else { 0 }
    }

    /// Everything counted so far.
    #[must_use]
    pub fn counters(&self) -> SocketCounts {
        self.intake.counters
    }

    /// Receives a relevant datagram (`None`), or returns why there is none.
    fn step(&mut self) -> Result<Option<Step>, Error> {
        loop {
            match self.wire.receive(self.intake.buffer()) {
                Ok(None) => return Ok(Some(Step::End)),
                Ok(Some((sent, port))) => {
                    if let Some(loss) = self.intake.datagram(sent, port) {
                        return Ok(Some(Step::Lost(loss)));
                    }
                    return Ok(None);
                }
                Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => self.intake.overrun(),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    if self.intake.drained() {
                        return Ok(Some(Step::Lost(self.overrun())));
                    }
                    return Ok(Some(Step::Pending));
                }
                Err(source) => {
                    return Err(Error::Io { what: "receiving from the kernel's connector".into(), source });
                }
            }
        }
    }

    fn overrun(&mut self) -> Loss {
        self.intake.report_overrun(socket::kernel_drops(self.port()))
    }
}

impl CsiSource for Netlink {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            match self.intake.turn() {
                Turn::Receive => match self.step()? {
                    None => {}
                    Some(Step::Lost(loss)) => return Ok(Next::Lost(loss)),
                    Some(Step::Pending) => return Ok(Next::Pending),
                    Some(Step::End) => return Ok(Next::End(Tail::Clean)),
                },
                Turn::AskDrops => return Ok(Next::Lost(self.overrun())),
                Turn::Lost(loss) => return Ok(Next::Lost(loss)),
                Turn::Record(timestamp_low) => {
                    let read_us = (self.wall_us)();
                    let came = |us| timestamp_low.map_or(us, |card| self.host_times.came_at(us, card));
                    let origin = Origin::Live { number: self.intake.counters.records };
                    let stamps = Stamps { at: now, host_us: read_us.map(came), origin };
                    return Ok(self.intake.take().map_or(Next::Pending, |record| Next::Record(stamps, record)));
                }
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl AsFd for Netlink {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match &self.wire {
            Wire::Kernel(socket, _) => socket.as_fd(),
            Wire::Room(room) => room.as_fd(),
        }
    }
}

impl AsRawFd for Netlink {
    fn as_raw_fd(&self) -> RawFd {
        self.as_fd().as_raw_fd()
    }
}
