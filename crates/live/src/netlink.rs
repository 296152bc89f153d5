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

use crate::doctor::{Machine, grant};
use crate::refused;
use crate::sys::{Instruction, attach_filter, operation::*, step};
use csi5300::source::{CsiSource, Error, Loss, Next, Origin, Refused, Stamps};
use csi5300::time::{HostTimes, Instant, Step16};
use driver_iface::bfee::Bfee;
use driver_iface::connector::{
    CN_IDX, CN_IDX_10_USERS, CN_VAL, MAX_DATAGRAM, Messages, NETLINK_CONNECTOR, NLMSGHDR, Repr, registered_idx,
};
use driver_iface::record::{MAX_LENGTH, Record, Tail, code};
use netlink_sys::{Socket, SocketAddr};
use nix::sys::socket::{MsgFlags, getsockopt, recv, setsockopt, sockopt};
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};

/// Requested receive buffer, bytes: the kernel doubles it, and counts 832 bytes for a 3x1 record and 1,280 for a WSR
/// one (measured on 6.18), so this holds about two and a half seconds at 20,000 records a second.
pub const RECEIVE_BUFFER: usize = 32 * 1024 * 1024;

/// How to listen.
#[derive(Clone, Copy, Debug)]
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

/// A listener. Never blocks; wait on its file descriptor for [`Next::Pending`] to end.
#[derive(Debug)]
pub struct Netlink {
    wire: Wire,
    /// Where it listens, in words: the connector indices, and how they were found.
    pub at: String,
    /// Granted receive buffer, bytes (the kernel's count, twice the request).
    pub receive_buffer: usize,
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
    fn receive(&self, mut buffer: &mut [u8]) -> io::Result<Option<(usize, u32)>> {
        match self {
            Self::Kernel(socket, _) => {
                let (sent, sender): (usize, SocketAddr) = socket.recv_from(&mut buffer, libc::MSG_TRUNC)?;
                Ok(Some((sent, sender.port_number())))
            }
            Self::Room(room) => Ok(Some((receive_message(room, buffer)?, 0)).filter(|(len, _)| *len > 0)),
        }
    }
}

impl Netlink {
    /// Opens, widens, filters and joins.
    ///
    /// # Errors
    /// Missing privilege, the wrong network namespace, no connector in the kernel: each with what to do about it.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let listed = std::fs::read_to_string(PROC_CONNECTOR);
        // The file exists only in the first network namespace, where the kernel's messages arrive.
        if listed.is_err() && !options.allow_user_sender {
            return Err(refused(
                "the kernel's connector is not in this network namespace (/proc/net/connector is absent): run outside of \
                 the container or `ip netns`, on a kernel with CONFIG_CONNECTOR=y",
            ));
        }
        let registered = listed.ok().and_then(|text| registered_idx(&text));
        let (indices, at) = match (options.connector_index, registered) {
            (Some(index), _) => (vec![index], format!("on connector index {index} (as given)")),
            (None, Some(index)) => {
                (vec![index], format!("on connector index {index} (where the driver is registered)"))
            }
            (None, None) => {
                let both = [CN_IDX, CN_IDX_10_USERS];
                let at = both.map(|index| index.to_string()).join(" and ");
                let why = "no CSI driver is registered in /proc/net/connector";
                (both.to_vec(), format!("on connector index {at} ({why})"))
            }
        };
        let (socket, port) = bound()
            .map_err(Error::io("cannot open a connector socket; is this a Linux kernel with CONFIG_CONNECTOR=y?"))?;
        let receive_buffer = widen(&socket, options.receive_buffer);
        attach_filter(socket.as_fd(), &filter(&indices)).map_err(Error::io("cannot filter the connector socket"))?;
        join(&socket, &indices)?;
        Ok(Self {
            intake: Intake::new(indices, options.allow_user_sender),
            wire: Wire::Kernel(socket, port),
            at,
            receive_buffer,
            wall_us: options.wall_us,
            host_times: HostTimes::default(),
        })
    }

    /// Listens to a message socket (SOCK_SEQPACKET) that sends the kernel's datagrams: the card of a robot in a
    /// simulated room.
    #[must_use]
    pub fn over(room: OwnedFd, wall_us: fn() -> Option<i64>) -> Self {
        let receive_buffer = widen(&room, RECEIVE_BUFFER);
        let intake = Intake::new(vec![CN_IDX], true);
        let (wire, at, host_times) = (Wire::Room(room), "to a card in a simulated room".into(), HostTimes::default());
        Self { wire, at, receive_buffer, wall_us, host_times, intake }
    }

    /// Everything counted so far.
    #[must_use]
    pub fn counters(&self) -> SocketCounts {
        self.intake.counters
    }

    /// Receives a relevant datagram (`None`), or returns why there is none.
    fn step(&mut self) -> Result<Option<Next<'static>>, Error> {
        loop {
            match self.wire.receive(&mut self.intake.buffer) {
                Ok(None) => return Ok(Some(Next::End(Tail::Clean))),
                Ok(Some((sent, port))) => return Ok(self.intake.datagram(sent, port).map(Next::Lost)),
                Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => self.intake.overrun(),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    // The queue is empty.
                    let is_untold = self.intake.overrun_untold;
                    return Ok(Some(if is_untold { Next::Lost(self.overrun()) } else { Next::Pending }));
                }
                Err(error) => return Err(Error::io("receiving from the kernel's connector")(error)),
            }
        }
    }

    fn overrun(&mut self) -> Loss {
        let drops = if let Wire::Kernel(_, port) = self.wire { kernel_drops(port) } else { None };
        self.intake.report_overrun(drops)
    }
}

impl CsiSource for Netlink {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            match self.intake.turn() {
                Turn::Receive => {
                    if let Some(next) = self.step()? {
                        return Ok(next);
                    }
                }
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

/// Everything that a listener counted since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SocketCounts {
    /// Datagrams taken from the socket.
    pub datagrams: u64,
    /// Records handed on.
    pub records: u64,
    /// Refused datagrams of other senders than the kernel.
    pub user_senders: u64,
    /// Messages with another index or value than the driver's.
    pub foreign: u64,
    /// Datagrams longer than the buffer.
    pub truncated: u64,
    /// Datagrams that contradict themselves, and records too long for a log.
    pub malformed: u64,
    /// Overruns of the socket's queue reported by the kernel (ENOBUFS).
    pub overruns: u64,
    /// Messages that the kernel dropped at this socket, if it reports them.
    pub kernel_drops: u64,
    /// Numbers missing from `bfee_count` at the first bfee after each overrun.
    pub overrun_bfee_gap: u64,
    /// Numbers missing from `bfee_count` anywhere else: lost before this socket, in the driver's own queue.
    pub other_bfee_gap: u64,
}

/// The next step of the intake.
#[derive(Debug, PartialEq, Eq)]
enum Turn {
    /// A record, and its `timestamp_low` if it is a bfee: call [`Intake::take`].
    Record(Option<u32>),
    /// Something was lost here.
    Lost(Loss),
    /// The place of an overrun: ask the kernel how much it dropped, then call [`Intake::report_overrun`].
    AskDrops,
    /// The datagram is used up: receive the next one.
    Receive,
}

/// The decisions on one socket's datagrams.
#[derive(Debug, Default)]
struct Intake {
    buffer: Box<[u8]>,
    filled: usize,
    next_message: usize,
    indices: Vec<u32>,
    allow_user_sender: bool,
    step: Step16,
    overrun_untold: bool,
    gap_unmeasured: bool,
    drops_seen: u64,
    counters: SocketCounts,
}

impl Intake {
    fn new(indices: Vec<u32>, allow_user_sender: bool) -> Self {
        let buffer = vec![0; MAX_DATAGRAM].into_boxed_slice();
        Self { buffer, indices, allow_user_sender, ..Self::default() }
    }

    /// A datagram of `sent` bytes from `port` (0 is the kernel) is in the buffer, as far as it fits.
    fn datagram(&mut self, sent: usize, port: u32) -> Option<Loss> {
        self.counters.datagrams += 1;
        (self.filled, self.next_message) = (0, 0);
        if port != 0 && !self.allow_user_sender {
            self.counters.user_senders += 1;
            return None;
        }
        if sent > self.buffer.len() {
            self.counters.truncated += 1;
            return Some(self.lost(Refused::Truncated { sent, kept: self.buffer.len() }, sent));
        }
        self.filled = sent;
        None
    }

    /// The kernel reported an overrun. Queued messages are older than the gap.
    fn overrun(&mut self) {
        self.counters.overruns += 1;
        (self.overrun_untold, self.gap_unmeasured) = (true, true);
    }

    /// The overrun as a loss; `drops` is the kernel's counter for this socket.
    fn report_overrun(&mut self, drops: Option<u64>) -> Loss {
        self.overrun_untold = false;
        let dropped = drops.map(|drops| drops.saturating_sub(self.drops_seen));
        self.drops_seen = drops.unwrap_or(self.drops_seen);
        self.counters.kernel_drops += dropped.unwrap_or(0);
        Loss::Overrun { dropped }
    }

    fn lost(&self, reason: Refused, len: usize) -> Loss {
        Loss::Datagram { number: self.counters.datagrams.saturating_sub(1), len: len as u64, reason }
    }

    /// The next message of the datagram in the buffer.
    fn turn(&mut self) -> Turn {
        loop {
            let received = self.buffer.get(..self.filled).unwrap_or_default();
            if received.is_empty() {
                return Turn::Receive;
            }
            let message =
                Messages::new_checked(received).and_then(|mut messages| messages.nth(self.next_message).transpose());
            let reason = match message {
                Err(error) => Refused::Connector(error),
                Ok(None) => return Turn::Receive,
                Ok(Some(message)) => match message.record(&self.indices) {
                    None => {
                        self.counters.foreign += 1;
                        self.next_message += 1;
                        continue;
                    }
                    Some(record) if record.length() <= MAX_LENGTH => {
                        let bfee = Bfee::new_checked(record.body).ok().filter(|_| record.code == code::BFEE);
                        let stamps = bfee.map(|bfee| (bfee.bfee_count(), bfee.timestamp_low()));
                        return self.announce(stamps);
                    }
                    Some(record) => Refused::Oversized { got: record.length(), max: MAX_LENGTH },
                },
            };
            self.counters.malformed += 1;
            self.next_message += 1;
            let loss = self.lost(reason, self.filled);
            if matches!(reason, Refused::Connector(_)) {
                self.filled = 0;
            }
            return Turn::Lost(loss);
        }
    }

    /// A record, with `bfee_count` and `timestamp_low` if it is a bfee. A jump in `bfee_count` is where the kernel dropped: the
    /// overrun is reported before this record.
    fn announce(&mut self, bfee: Option<(u16, u32)>) -> Turn {
        if let Some((count, _)) = bfee {
            if self.overrun_untold && self.step.clone().missing(count) > 0 {
                return Turn::AskDrops;
            }
            let missing = u64::from(self.step.missing(count));
            if self.gap_unmeasured && missing > 0 {
                self.counters.overrun_bfee_gap += missing;
                self.gap_unmeasured = false;
            } else {
                self.counters.other_bfee_gap += missing;
            }
        }
        Turn::Record(bfee.map(|(_, timestamp_low)| timestamp_low))
    }

    /// The record that [`Intake::turn`] announced.
    fn take(&mut self) -> Option<Record<'_>> {
        self.counters.records += 1;
        let message = self.next_message;
        self.next_message += 1;
        let mut messages = Messages::new_checked(self.buffer.get(..self.filled)?).ok()?;
        Record::from_message(messages.nth(message)?.ok()?.data)
    }
}

/// The list of the kernel's connector users, in the network namespace of this thread.
const PROC_CONNECTOR: &str = "/proc/thread-self/net/connector";
/// The table of netlink sockets, with their drops.
const PROC_NETLINK: &str = "/proc/thread-self/net/netlink";
/// Largest multicast group of the connector: what fits a netlink group mask rounded up to 32 (`af_netlink.c`).
const MAX_GROUP: u32 = 32;

/// A connector socket that never blocks, and its netlink port.
fn bound() -> io::Result<(Socket, u32)> {
    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed()))?;
    let port = socket.bind_auto()?.port_number();
    socket.set_non_blocking(true)?;
    Ok((socket, port))
}

fn join(socket: &Socket, indices: &[u32]) -> Result<(), Error> {
    let mut refused = None;
    let mut joined = 0;
    for &index in indices {
        match socket.add_membership(index) {
            Ok(()) => joined += 1,
            Err(error) => refused = Some((index, error)),
        }
    }
    match refused {
        // An unprivileged process may join odd groups only, by an accident of newer kernels.
        Some((_, error)) if error.kind() == io::ErrorKind::PermissionDenied => Err(Error::io(format!(
            "not allowed to listen to the driver: give the program the capability once, `{}`, or run it as root",
            grant(&Machine, &["cap_net_admin"])
        ))(error)),
        Some((index, error)) if joined == 0 => {
            Err(Error::io(format!("cannot join connector index {index}; the kernel takes 1 to {MAX_GROUP}"))(error))
        }
        _ => Ok(()),
    }
}

/// Requests a receive buffer, beyond `net.core.rmem_max` if allowed. Returns the granted bytes.
pub(crate) fn widen(socket: &impl AsFd, bytes: usize) -> usize {
    if setsockopt(socket, sockopt::RcvBufForce, &bytes).is_err() {
        // Refused without CAP_NET_ADMIN in the first user namespace; the ordinary option is capped, never refused.
        let _ = setsockopt(socket, sockopt::RcvBuf, &bytes);
    }
    getsockopt(socket, sockopt::RcvBuf).unwrap_or(0)
}

/// A classic filter that passes messages with one of `indices`, so that foreign traffic does not fill the queue.
///
/// The loads are big-endian, the messages little-endian (hence the swapped constants). It checks only the first
/// `cn_msg` of a datagram, which begins with its index: the driver puts one in each.
fn filter(indices: &[u32]) -> Vec<Instruction> {
    let mut program = vec![step(LOAD_WORD, 0, 0, NLMSGHDR as u32)];
    let count = indices.len().min(MAX_GROUP as usize);
    for (k, index) in indices.iter().take(count).enumerate() {
        program.push(step(JUMP_IF_EQUAL, (count - k) as u8, 0, index.swap_bytes()));
    }
    program.push(step(RETURN, 0, 0, 0));
    program.push(step(RETURN, 0, 0, u32::MAX));
    program
}

/// Messages that the kernel dropped at the connector socket with this port, if it reports them.
fn kernel_drops(port: u32) -> Option<u64> {
    drops_in(&std::fs::read_to_string(PROC_NETLINK).ok()?, port)
}

/// The `Drops` column of the socket's row in `/proc/net/netlink`.
fn drops_in(table: &str, port: u32) -> Option<u64> {
    let mut lines = table.lines();
    let columns: Vec<_> = lines.next()?.split_whitespace().collect();
    let at = |name: &str| columns.iter().position(|column| *column == name);
    let (protocol, pid, drops) = (at("Eth")?, at("Pid")?, at("Drops")?);
    lines.find_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        let is = |column: usize, value: u32| words.get(column).is_some_and(|word| word.parse() == Ok(value));
        let ours = is(protocol, u32::from(NETLINK_CONNECTOR)) && is(pid, port);
        if ours { words.get(drops)?.parse().ok() } else { None }
    })
}

/// Takes one datagram from a message socket: its true length, 0 once the partner has ended.
///
/// # Errors
/// The kernel's, WouldBlock where there is none.
fn receive_message(socket: &OwnedFd, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match recv(socket.as_raw_fd(), buffer, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC) {
            // The partner closed with unread data; its earlier messages are still readable.
            Err(nix::errno::Errno::ECONNRESET) => {}
            taken => return Ok(taken?),
        }
    }
}

/// Sends to one connector group. Needs CAP_NET_ADMIN in the user namespace of the network namespace.
#[derive(Debug)]
pub struct Sender {
    socket: Socket,
    group: SocketAddr,
    index: u32,
    padded: bool,
    buffer: Box<[u8]>,
}

impl Sender {
    /// A sender on connector index `index`, 1 to 32; `padded` as the kernel does it, or not, as programs do.
    ///
    /// # Errors
    /// If the index or the connector socket cannot be used.
    pub fn open(index: u32, padded: bool) -> Result<Self, Error> {
        let mask = index.checked_sub(1).and_then(|bit| 1_u32.checked_shl(bit));
        let mask = mask.ok_or_else(|| refused(format!("connector index {index}: 1 to {MAX_GROUP} can be sent to")))?;
        let (socket, _) = bound().map_err(Error::io("cannot open a connector socket to send"))?;
        let buffer = vec![0; MAX_DATAGRAM].into_boxed_slice();
        Ok(Self { socket, group: SocketAddr::new(0, mask), index, padded, buffer })
    }

    /// The connector index sent to.
    #[must_use]
    pub fn index(&self) -> u32 {
        self.index
    }

    /// Sends one record to all listeners; none is no error.
    ///
    /// # Errors
    /// A record that does not fit a message, or the kernel's refusal.
    pub fn send(&mut self, record: Record<'_>) -> Result<(), Error> {
        let repr = Repr { idx: self.index, val: CN_VAL, record, padded: self.padded };
        let len = repr.emit(&mut self.buffer).map_err(|error| refused(error.to_string()))?;
        self.send_bytes(self.buffer.get(..len).unwrap_or_default())
    }

    /// Sends a raw datagram.
    ///
    /// # Errors
    /// The kernel's refusal.
    pub fn send_bytes(&self, datagram: &[u8]) -> Result<(), Error> {
        match self.socket.send_to(datagram, &self.group, 0) {
            // The kernel's own copy is refused outside the first namespace, where it has no connector socket; the
            // multicast was delivered before.
            Err(error) if error.kind() != ErrorKind::ConnectionRefused => Err(Error::io(
                "cannot send to the connector group (CAP_NET_ADMIN is needed; `unshare -Urn` gives it in a namespace of its own)",
            )(error)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sys::passes;
    use driver_iface::bfee;

    #[test]
    fn the_filter_keeps_its_indices_only() {
        for indices in [&[26][..], &[26, 25], &[25, 26, 23]] {
            let program = filter(indices);
            for index in [1_u32, 23, 25, 26, 27, 0x1a00_0000] {
                let mut packet = [0; 36];
                packet[16..20].copy_from_slice(&index.to_le_bytes());
                assert_eq!(passes(&program, &packet, 0), indices.contains(&index), "{index} of {indices:?}");
            }
            assert!(!passes(&program, &[26; 10], 0));
        }
    }

    #[test]
    fn drops_are_read_by_column_name() {
        let table = "sk               Eth Pid        Groups   Rmem     Wmem     Dump  Locks    Drops    Inode\n\
                     000 0   4242 00000000 0        0        0     2        7        4\n\
                     000 11  17   00000000 0        0        0     2        8        4\n\
                     000 11  4242 02000000 0        0        0     2        59744    4\n";
        assert_eq!(drops_in(table, 4242), Some(59_744));
        assert_eq!(drops_in(table, 5), None);
        assert_eq!(drops_in("", 4242), None);
    }

    /// A 3x1 bfee body of the stock layout.
    fn body(count: u16) -> Vec<u8> {
        let mut body = vec![0; bfee::STOCK_HEADER + bfee::csi_len(3, 1)];
        body[bfee::offset::BFEE_COUNT..][..2].copy_from_slice(&count.to_le_bytes());
        body[bfee::offset::N_RX] = 3;
        body[bfee::offset::N_TX] = 1;
        let len = bfee::csi_len(3, 1) as u16;
        body[bfee::offset::LEN..][..2].copy_from_slice(&len.to_le_bytes());
        body
    }

    fn datagram(idx: u32, code: u8, body: &[u8]) -> Vec<u8> {
        let repr = Repr { idx, val: CN_VAL, record: Record { code, body }, padded: true };
        let mut out = vec![0; repr.emit_len()];
        repr.emit(&mut out).unwrap();
        out
    }

    fn put(intake: &mut Intake, bytes: &[u8], port: u32) -> Option<Loss> {
        let kept = bytes.len().min(intake.buffer.len());
        intake.buffer[..kept].copy_from_slice(&bytes[..kept]);
        intake.datagram(bytes.len(), port)
    }

    fn intake() -> Intake {
        Intake::new(vec![CN_IDX, CN_IDX_10_USERS], false)
    }

    /// Puts a bfee in and takes it out again.
    fn hand(intake: &mut Intake, count: u16) {
        assert_eq!(put(intake, &datagram(CN_IDX_10_USERS, code::BFEE, &body(count)), 0), None);
        assert!(matches!(intake.turn(), Turn::Record(_)));
        assert_eq!(intake.take().unwrap().body, body(count));
        assert_eq!(intake.turn(), Turn::Receive);
    }

    #[test]
    fn a_record_comes_out_as_it_went_in() {
        let mut intake = intake();
        assert_eq!(intake.turn(), Turn::Receive);
        hand(&mut intake, 7);
        hand(&mut intake, 8);
        assert_eq!(intake.counters, SocketCounts { datagrams: 2, records: 2, ..SocketCounts::default() });
    }

    #[test]
    fn only_the_kernels_messages_are_accepted() {
        let mut intake = intake();
        let bytes = datagram(CN_IDX, code::BFEE, &body(1));
        assert_eq!(put(&mut intake, &bytes, 4242), None);
        assert_eq!(intake.turn(), Turn::Receive);
        assert_eq!((intake.counters.user_senders, intake.counters.records), (1, 0));
        intake.allow_user_sender = true;
        put(&mut intake, &bytes, 4242);
        assert!(matches!(intake.turn(), Turn::Record(_)));
    }

    #[test]
    fn foreign_messages_around_ours_are_skipped() {
        let mut intake = intake();
        let (foreign, ours) = (datagram(1, 0, &[9; 6]), datagram(CN_IDX, code::BFEE, &body(3)));
        // Several cn_msg in one netlink message: the first header stays, the others are dropped, no padding between.
        let mut bytes = foreign[..16 + 20 + 7].to_vec();
        bytes.extend_from_slice(&ours[16..249]);
        bytes.extend_from_slice(&foreign[16..16 + 20 + 7]);
        let len = bytes.len() as u32;
        bytes[..4].copy_from_slice(&len.to_le_bytes());
        assert_eq!(put(&mut intake, &bytes, 0), None);
        assert!(matches!(intake.turn(), Turn::Record(_)));
        assert_eq!(intake.take().unwrap().body, body(3));
        assert_eq!(intake.turn(), Turn::Receive);
        assert_eq!(intake.counters.foreign, 2);
    }

    #[test]
    fn cut_lying_and_oversized_datagrams_are_losses() {
        let mut intake = intake();
        let too_long = vec![0; MAX_DATAGRAM + 1];
        let reason = Refused::Truncated { sent: MAX_DATAGRAM + 1, kept: MAX_DATAGRAM };
        let number_0 = Loss::Datagram { number: 0, len: too_long.len() as u64, reason };
        assert_eq!(put(&mut intake, &too_long, 0), Some(number_0));
        assert_eq!(intake.turn(), Turn::Receive);

        let good = datagram(CN_IDX, code::BFEE, &body(3));
        for cut in 1..249 {
            put(&mut intake, &good[..cut], 0);
            let turn = intake.turn();
            assert!(
                matches!(turn, Turn::Lost(Loss::Datagram { reason: Refused::Connector(_), .. })),
                "{cut}: {turn:?}"
            );
            assert_eq!(intake.turn(), Turn::Receive);
        }
        put(&mut intake, &datagram(CN_IDX, code::MPDU, &[0; MAX_LENGTH]), 0);
        let reason = Refused::Oversized { got: MAX_LENGTH + 1, max: MAX_LENGTH };
        assert!(matches!(intake.turn(), Turn::Lost(Loss::Datagram { number: 249, reason: r, .. }) if r == reason));
        assert_eq!(intake.turn(), Turn::Receive);
        assert_eq!((intake.counters.truncated, intake.counters.malformed, intake.counters.records), (1, 249, 0));
    }

    #[test]
    fn an_overrun_is_told_where_the_numbers_jump() {
        let mut intake = intake();
        hand(&mut intake, 10);
        intake.overrun();
        // Still queued from before the gap.
        hand(&mut intake, 11);
        put(&mut intake, &datagram(CN_IDX, code::BFEE, &body(20)), 0);
        assert_eq!(intake.turn(), Turn::AskDrops);
        assert_eq!(intake.report_overrun(Some(8)), Loss::Overrun { dropped: Some(8) });
        assert!(matches!(intake.turn(), Turn::Record(_)));
        assert_eq!(intake.take().unwrap().body, body(20));
        assert!(!intake.overrun_untold);
        let counters = intake.counters;
        assert_eq!((counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap), (1, 8, 8));
        assert_eq!(counters.other_bfee_gap, 0);
    }

    #[test]
    fn an_overrun_with_nothing_after_it_is_told_when_the_queue_is_empty() {
        let mut intake = intake();
        hand(&mut intake, 10);
        intake.overrun();
        hand(&mut intake, 11);
        assert!(intake.overrun_untold);
        assert_eq!(intake.report_overrun(Some(3)), Loss::Overrun { dropped: Some(3) });
        assert!(!intake.overrun_untold);
        // The gap itself is measured later; a later jump is not the overrun's.
        hand(&mut intake, 15);
        hand(&mut intake, 17);
        let counters = intake.counters;
        assert_eq!((counters.kernel_drops, counters.overrun_bfee_gap, counters.other_bfee_gap), (3, 3, 1));
        // The kernel's counter goes on from where it was.
        intake.overrun();
        assert_eq!(intake.report_overrun(Some(5)), Loss::Overrun { dropped: Some(2) });
        assert_eq!(intake.report_overrun(None), Loss::Overrun { dropped: None });
    }
}
