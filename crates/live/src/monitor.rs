//! A monitor interface: frames injected into the air, and sounding frames heard from it.
//!
//! A packet socket carries whole buffers of radiotap header and 802.11 frame, both ways. What the kernel does with them
//! was measured on mac80211 (firmware-notes/injection.md):
//!
//! * a frame that it must not send (no-IR, DFS) or cannot parse is accepted and dropped silently. Only a sent frame
//!   comes back, as a **tx-status copy** with TX flags in its radiotap header; these are counted
//!   ([`AirCounts::tx_status`]);
//! * every frame sent is also looped back to the socket as PACKET_OUTGOING; the socket's filter keeps those out;
//! * the interface's MTU counts radiotap header and frame.
//!
//! A simulated room in another process gives its robots such an interface too: [`Monitor::over`].
//!
//! A frame that the kernel refuses is an [`Error::NotSent`] and counted by cause; the next one may succeed.

use crate::doctor::{Machine, grant};
use crate::refused;
use crate::sys::{self, ARPHRD_IEEE80211_RADIOTAP, Instruction, operation::*, step};
use csi5300::internal::{FrameReceiver, HeardFrame};
use csi5300::source::{Error, Injector, NotSent};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::radiotap::{self, Bandwidth, Repr};
use driver_iface::sounding::MAGIC_MAC;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, ControlMessageOwned, LinkAddr, MsgFlags, SockFlag, SockType, SockaddrLike, getsockopt, recvmsg,
    setsockopt, socket, sockopt,
};
use nix::sys::time::TimeSpec;
use std::io::{self, ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};

/// Bytes read of a received buffer: a sounding frame and its radiotap header are far shorter.
const RECEIVE_LEN: usize = 1_024;
/// A frame with an older receive stamp is useless: nobody waits for its answer.
const OLDEST: Span = Span::from_ms(1_000);

/// The interface to open, and the format of frames.
#[derive(Clone, Debug)]
pub struct Options {
    /// The interface, such as `mon0`.
    pub interface: String,
    /// MCS index of every frame. The CSI driver takes its `monitor_tx_rate` instead.
    pub mcs: u8,
    /// Channel width of every frame.
    pub bandwidth: Bandwidth,
    /// Length of the longest frame to be sent, bytes, without radiotap header and FCS.
    pub longest: usize,
    /// Reads the host's wall clock, microseconds since the Unix epoch, by which the kernel stamps received frames.
    pub wall_us: fn() -> Option<i64>,
}

impl Options {
    /// Frames of MCS 0 in 20 MHz, at most `longest` bytes without radiotap header and FCS; ages by the host's clock.
    #[must_use]
    pub fn new(interface: impl Into<String>, longest: usize) -> Self {
        let (interface, wall_us) = (interface.into(), crate::wait::wall_us);
        Self { interface, mcs: 0, bandwidth: Bandwidth::Ht20, longest, wall_us }
    }
}

/// Everything counted on an interface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AirCounts {
    /// Frames that the kernel took.
    pub taken: u64,
    /// Frames of which it took only a part.
    pub cut: u64,
    /// Frames not taken because its queue was full (ENOBUFS, EAGAIN).
    pub no_room: u64,
    /// Frames not taken because the interface was down.
    pub down: u64,
    /// Frames not taken because they are longer than the MTU.
    pub too_long: u64,
    /// Tx-status copies: frames that the driver was given, and reported on.
    pub tx_status: u64,
    /// Of these, marked as failed (no acknowledgement, or given up).
    pub tx_failed: u64,
    /// Of these, sent more than once.
    pub tx_retried: u64,
    /// Frames handed out as heard.
    pub heard: u64,
    /// Frames that waited too long in the queue to be useful; the host was busy.
    pub stale: u64,
    /// Copies of own frames on their way out, beyond those that the filter kept out.
    pub outgoing: u64,
    /// Frames with a wrong FCS.
    pub bad_fcs: u64,
    /// Buffers with an invalid radiotap header, or longer than any sounding frame.
    pub damaged: u64,
    /// Frames that the kernel dropped because they were not fetched in time.
    pub dropped: u64,
}

impl AirCounts {
    /// Frames that were to be sent and were not taken.
    #[must_use]
    pub fn not_taken(&self) -> u64 {
        self.cut + self.no_room + self.down + self.too_long
    }

    /// Counts the result of a send of `len` bytes, and returns why the frame was refused, if it was. A fatal error is
    /// returned.
    fn note_sent(&mut self, sent: std::io::Result<usize>, len: usize, mtu: usize) -> std::io::Result<Option<NotSent>> {
        let (count, why) = match sent {
            Ok(taken) if taken == len => (&mut self.taken, None),
            Ok(taken) => (&mut self.cut, Some(NotSent::Cut { taken, len })),
            Err(error) => match error.raw_os_error() {
                Some(libc::ENOBUFS | libc::EAGAIN | libc::ENOMEM) => (&mut self.no_room, Some(NotSent::NoRoom)),
                Some(libc::ENETDOWN) => (&mut self.down, Some(NotSent::Down)),
                Some(libc::EMSGSIZE) => (&mut self.too_long, Some(NotSent::TooLong { len, mtu })),
                _ => return Err(error),
            },
        };
        *count += 1;
        Ok(why)
    }
}

/// A monitor interface, opened. Never blocks; wait on its file descriptor.
#[derive(Debug)]
pub struct Monitor {
    socket: OwnedFd,
    interface: String,
    /// The interface's own MAC, if it has one.
    pub mac: Option<Mac>,
    mtu: usize,
    header_len: usize,
    /// Radiotap header, written once, and room for the longest frame.
    out: Box<[u8]>,
    input: Box<[u8]>,
    /// Room for the kernel's stamp of a frame.
    control: Vec<u8>,
    wall_us: fn() -> Option<i64>,
    counters: AirCounts,
}

impl Monitor {
    /// Opens the interface. The filter is in place before the first frame can arrive.
    ///
    /// # Errors
    /// No such interface, CAP_NET_RAW missing, another link type than radiotap, the interface down, or an MTU too small
    /// for `longest`: each with what to do about it.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let interface = &options.interface;
        let (socket, mac) = bound(interface)?;
        let mut monitor = Self::new(socket, mac, options)?;
        let what = format!("cannot ask for the MTU of {interface}");
        monitor.mtu = sys::mtu(monitor.socket.as_fd(), interface).map_err(Error::io(what))?;
        if monitor.mtu < monitor.out.len() {
            return Err(refused(format!(
                "{interface} takes {} bytes at most, frames here have up to {} with their radiotap header: \
                 `sudo ip link set {interface} mtu 2304`",
                monitor.mtu,
                monitor.out.len()
            )));
        }
        Ok(monitor)
    }

    /// A message socket (SOCK_SEQPACKET) that acts as a monitor interface: one radiotap header and frame a message,
    /// both ways. The interface's name in `options` is for messages only.
    ///
    /// # Errors
    /// Never at present; the frames of `options` cannot be longer than their header allows.
    pub fn over(socket: OwnedFd, mac: Mac, options: &Options) -> Result<Self, Error> {
        Self::new(socket, Some(mac), options)
    }

    fn new(socket: OwnedFd, mac: Option<Mac>, options: &Options) -> Result<Self, Error> {
        let header = Repr::injected(options.mcs, options.bandwidth);
        let header_len = header.header_len();
        let mut out = vec![0; header_len + options.longest].into_boxed_slice();
        header.emit(&mut out).map_err(|error| refused(error.to_string()))?;
        Ok(Self {
            socket,
            interface: options.interface.clone(),
            mac,
            mtu: out.len(),
            header_len,
            out,
            input: vec![0; RECEIVE_LEN].into_boxed_slice(),
            control: nix::cmsg_space!(TimeSpec),
            wall_us: options.wall_us,
            counters: AirCounts::default(),
        })
    }

    /// Everything counted so far.
    #[must_use]
    pub fn counters(&mut self) -> AirCounts {
        self.counters.dropped += sys::packet_drops(self.socket.as_fd()).map_or(0, u64::from);
        self.counters
    }

    /// The range of the frame in a received buffer of `len` bytes, if it is to be handed out.
    fn frame_in(&mut self, len: usize) -> Option<std::ops::Range<usize>> {
        let counters = &mut self.counters;
        let Some((repr, range)) = self.input.get(..len).and_then(|buffer| Repr::parse(buffer).ok()) else {
            counters.damaged += 1;
            return None;
        };
        if repr.is_own_echo() {
            counters.tx_status += 1;
            counters.tx_failed += u64::from(repr.tx_flags.is_some_and(|flags| flags & radiotap::TX_FLAGS_FAIL != 0));
            counters.tx_retried += u64::from(repr.data_retries.is_some_and(|retries| retries > 0));
            return None;
        }
        if repr.is_bad_fcs() {
            counters.bad_fcs += 1;
            return None;
        }
        Some(range)
    }
}

/// Age of a frame by the wall clock: zero without a stamp, or if the clock was set back since; `None` if it is too old.
/// If the clock was set ahead, waiting frames are lost.
fn age(stamp_us: Option<i64>, wall_us: Option<i64>) -> Option<Span> {
    let age = stamp_us.zip(wall_us).map_or(0, |(stamp, now)| now.saturating_sub(stamp));
    Some(Span::from_us(age.max(0))).filter(|age| *age < OLDEST)
}

impl AsFd for Monitor {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Injector for Monitor {
    fn inject(&mut self, _now: Instant, frame: &[u8]) -> Result<(), Error> {
        let len = self.header_len + frame.len();
        let Some(place) = self.out.get_mut(self.header_len..len) else {
            self.counters.too_long += 1;
            return Err(Error::NotSent(NotSent::TooLong { len, mtu: self.out.len() }));
        };
        place.copy_from_slice(frame);
        let (buffer, flags) =
            (self.out.get(..len).unwrap_or_default(), MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL);
        let sent = nix::sys::socket::send(self.socket.as_raw_fd(), buffer, flags).map_err(io::Error::from);
        let why = self.counters.note_sent(sent, len, self.mtu);
        let why = why.map_err(|error| failed("sending on", &self.interface, error))?;
        why.map_or(Ok(()), |why| Err(Error::NotSent(why)))
    }
}

impl FrameReceiver for Monitor {
    fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error> {
        loop {
            let received = match receive(&self.socket, &mut self.input, &mut self.control) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                // Reported once when the interface goes down; later frames are only counted.
                Err(error) if error.raw_os_error() == Some(libc::ENETDOWN) => continue,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(failed("receiving from", &self.interface, error)),
            };
            if received.len == 0 {
                let what = format!("receiving from {}: the room has ended", self.interface);
                return Err(Error::Io { what, source: ErrorKind::UnexpectedEof.into() });
            }
            if received.is_outgoing {
                self.counters.outgoing += 1;
            } else if let Some(range) = self.frame_in(received.len) {
                let Some(age) = age(received.stamp_us, (self.wall_us)()) else {
                    self.counters.stale += 1;
                    continue;
                };
                self.counters.heard += 1;
                return Ok(self.input.get(range).map(|frame| HeardFrame { frame, age }));
            }
        }
    }

    fn sent_for_certain(&self) -> Option<u64> {
        Some(self.counters.tx_status.saturating_sub(self.counters.tx_failed))
    }

    fn failed_for_certain(&self) -> u64 {
        self.counters.tx_failed
    }
}

/// PACKET_OUTGOING (`linux/if_packet.h`): a copy of what this host sends.
const OUTGOING: u8 = 4;

/// A fatal error, with the operation.
fn failed(doing: &str, interface: &str, source: io::Error) -> Error {
    let gone = matches!(source.raw_os_error(), Some(libc::ENXIO | libc::ENODEV));
    let hint = if gone { ": the interface is gone; was its driver reloaded?" } else { "" };
    Error::Io { what: format!("{doing} {interface}{hint}"), source }
}

/// A socket on the interface, which is a monitor and up, and the interface's MAC.
fn bound(interface: &str) -> Result<(OwnedFd, Option<Mac>), Error> {
    // Without a protocol nothing is received before the filter is set; binding then names all protocols.
    let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
    let socket = socket(AddressFamily::Packet, SockType::Raw, flags, None).map_err(|errno| match errno {
        Errno::EPERM | Errno::EACCES => Error::io(format!(
            "not allowed to inject frames: give the program the capabilities once, `{}`, or run it as root",
            grant(&Machine, &["cap_net_raw", "cap_net_admin", "cap_sys_nice", "cap_ipc_lock"])
        ))(errno),
        Errno::EAFNOSUPPORT => Error::io(
            "packet sockets are not allowed to this service (RestrictAddressFamilies): install csi5300-node-sounding.conf \
             beside its unit",
        )(errno),
        _ => Error::io("cannot open a packet socket")(errno),
    })?;
    let absent =
        format!("there is no interface {interface} here (`ip link` lists them; `csi5300 setup` makes a monitor)");
    let index = nix::net::if_::if_nametoindex(interface).map_err(Error::io(absent))?;
    let io = |what: &str| Error::io(format!("{what} {interface}"));
    sys::attach_filter(socket.as_fd(), &sounding_filter()).map_err(io("cannot filter the socket of"))?;
    // Stamps give the time of reception, however late a frame is fetched.
    let stamped = setsockopt(&socket, sockopt::ReceiveTimestampns, &true).map_err(io::Error::from);
    stamped.map_err(io("cannot stamp frames of"))?;
    sys::bind_packet(socket.as_fd(), index).map_err(io("cannot bind to"))?;
    let (link_type, mac) = sys::packet_link(socket.as_fd()).map_err(io("cannot ask for the link of"))?;
    if link_type != ARPHRD_IEEE80211_RADIOTAP {
        return Err(refused(format!(
            "{interface} has link type {link_type}, not that of a monitor interface ({ARPHRD_IEEE80211_RADIOTAP}, \
             radiotap): `sudo ip link set {interface} down && sudo iw dev {interface} set type monitor && \
             sudo ip link set {interface} up`"
        )));
    }
    // Binding to an interface that is down leaves its error on the socket.
    if getsockopt(&socket, sockopt::SocketError) == Ok(libc::ENETDOWN) {
        return Err(refused(format!("{interface} is down: `sudo ip link set {interface} up`")));
    }
    Ok((socket, mac))
}

/// What was received.
#[derive(Clone, Copy, Debug)]
struct Received {
    /// True length, which may exceed the buffer.
    len: usize,
    is_outgoing: bool,
    /// Microseconds since the Unix epoch.
    stamp_us: Option<i64>,
}

/// Receives one buffer.
fn receive(socket: &OwnedFd, buffer: &mut [u8], control: &mut [u8]) -> io::Result<Received> {
    let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC;
    let mut parts = [IoSliceMut::new(buffer)];
    let message = recvmsg::<LinkAddr>(socket.as_raw_fd(), &mut parts, Some(control), flags)?;
    let stamp = message.cmsgs().ok().and_then(|mut said| {
        said.find_map(|said| if let ControlMessageOwned::ScmTimestampns(stamp) = said { Some(stamp) } else { None })
    });
    Ok(Received {
        len: message.bytes,
        is_outgoing: message.address.is_some_and(|from| from.len() > 0 && from.pkttype() == OUTGOING),
        stamp_us: stamp.map(|stamp| stamp.tv_sec().saturating_mul(1_000_000) + stamp.tv_nsec() / 1_000),
    })
}

/// A classic filter that passes data frames (frame control 08) with the magic MAC in addr1, which both dialects have,
/// after a radiotap header of any length; it drops outgoing copies, but not tx-status frames.
fn sounding_filter() -> Vec<Instruction> {
    let [a, b, c, d, e, f] = MAGIC_MAC.0;
    let (magic_high, magic_low) = (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([0, 0, e, f]));
    let steps = [
        (LOAD_WORD, 0, 0, PACKET_TYPE),
        (JUMP_IF_EQUAL, 13, 0, OUTGOING.into()),
        // The radiotap header's length, little-endian at offset 2, becomes X.
        (LOAD_BYTE, 0, 0, 3),
        (SHIFT_LEFT, 0, 0, 8),
        (TO_X, 0, 0, 0),
        (LOAD_BYTE, 0, 0, 2),
        (ADD_X, 0, 0, 0),
        (TO_X, 0, 0, 0),
        (LOAD_BYTE_AT_X, 0, 0, 0),
        (JUMP_IF_EQUAL, 0, 5, 0x08),
        (LOAD_WORD_AT_X, 0, 0, 4),
        (JUMP_IF_EQUAL, 0, 3, magic_high),
        (LOAD_HALF_AT_X, 0, 0, 8),
        (JUMP_IF_EQUAL, 0, 1, magic_low),
        (RETURN, 0, 0, u32::MAX),
        (RETURN, 0, 0, 0),
    ];
    steps.map(|(code, if_true, if_false, k)| step(code, if_true, if_false, k)).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sys::passes;
    use driver_iface::sounding::wsr::{self, Lfsr};

    #[test]
    fn every_result_of_sending_is_counted_by_its_cause() {
        let refused = |errno| Err(io::Error::from_raw_os_error(errno));
        let (no_room, down) = (Some(NotSent::NoRoom), Some(NotSent::Down));
        let mut counters = AirCounts::default();
        for (sent, why) in [
            (Ok(57), None),
            (Ok(20), Some(NotSent::Cut { taken: 20, len: 57 })),
            (refused(libc::ENOBUFS), no_room),
            (refused(libc::EAGAIN), no_room),
            (refused(libc::ENOMEM), no_room),
            (refused(libc::ENETDOWN), down),
            (refused(libc::EMSGSIZE), Some(NotSent::TooLong { len: 57, mtu: 50 })),
        ] {
            assert_eq!(counters.note_sent(sent, 57, 50).unwrap(), why);
        }
        assert!(counters.note_sent(refused(libc::ENXIO), 57, 50).is_err());
        let count = |counters: &AirCounts| {
            [counters.taken, counters.cut, counters.no_room, counters.down, counters.too_long, counters.not_taken()]
        };
        assert_eq!(count(&counters), [1, 1, 3, 1, 1, 6]);
    }

    #[test]
    fn an_old_frame_is_not_taken_for_a_new_one() {
        let second = 1_000_000;
        assert_eq!(age(Some(5), Some(65)), Some(Span::from_us(60)));
        assert_eq!(age(Some(5), Some(second + 4)), Some(OLDEST - Span::from_us(1)));
        assert_eq!(age(Some(5), Some(second + 5)), None);
        assert_eq!(age(Some(second), Some(3)), Some(Span::default()), "the clock was set back");
        assert_eq!((age(None, Some(9)), age(Some(9), None)), (Some(Span::default()), Some(Span::default())));
    }

    #[test]
    fn sounding_frames_pass_behind_any_header_and_nothing_else_does() {
        let program = sounding_filter();
        let mut frame = [0; 60];
        let repr = wsr::Repr { sender: driver_iface::Mac([2; 6]), number: 7, len_with_fcs: 57 };
        let len = repr.emit(&mut frame, &mut Lfsr::default()).unwrap();
        let frame = &frame[..len];
        for header in [Repr::default(), Repr::injected(1, Bandwidth::Ht20)] {
            let mut buffer = vec![0; header.header_len()];
            header.emit(&mut buffer).unwrap();
            let start = buffer.len();
            buffer.extend(frame);
            assert!(passes(&program, &buffer, 3), "of others");
            assert!(!passes(&program, &buffer, OUTGOING.into()), "own, on its way out");
            for at in [0, 4, 5, 6, 7, 8, 9] {
                let mut other = buffer.clone();
                other[start + at] ^= 1;
                assert!(!passes(&program, &other, 3), "byte {at}");
            }
            for cut in 0..start + 10 {
                assert!(!passes(&program, &buffer[..cut], 3), "cut to {cut}");
            }
        }
        // A header longer than 255 bytes.
        let mut long = vec![0; 300];
        (long[2], long[3]) = (44, 1);
        long.extend(frame);
        assert!(passes(&program, &long, 3));
    }
}
