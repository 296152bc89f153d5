//! Opens, filters and binds the packet socket; all errors in words.

use super::{MonitorError, filter};
use crate::sys::{self, ARPHRD_IEEE80211_RADIOTAP};
use csi5300::source::Error;
use driver_iface::Mac;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, ControlMessageOwned, LinkAddr, MsgFlags, SockFlag, SockType, SockaddrLike, getsockopt, recvmsg,
    setsockopt, socket, sockopt,
};
use nix::sys::time::TimeSpec;
use std::io::{self, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

/// PACKET_OUTGOING (`linux/if_packet.h`).
const OUTGOING: u8 = 4;

/// An interface, opened.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) socket: OwnedFd,
    pub(super) mac: Option<Mac>,
    pub(super) mtu: usize,
}

/// A fatal error, with the operation.
pub(super) fn failed(doing: &str, interface: &str, source: io::Error) -> Error {
    let gone = matches!(source.raw_os_error(), Some(libc::ENXIO | libc::ENODEV));
    let hint = if gone { ": the interface is gone; was its driver reloaded?" } else { "" };
    Error::Io { what: format!("{doing} {interface}{hint}"), source }
}

/// Opens the interface; `longest` is the longest buffer that will be sent, radiotap header included.
pub(super) fn open(interface: &str, longest: usize) -> Result<Opened, Error> {
    // Without a protocol nothing is received before the filter is set; binding then names all protocols.
    let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
    let socket = socket(AddressFamily::Packet, SockType::Raw, flags, None).map_err(|errno| match errno {
        Errno::EPERM | Errno::EACCES => Error::Io {
            what: format!(
                "not allowed to inject frames: give the program the capabilities once, \
                 `sudo setcap cap_net_raw,cap_net_admin,cap_sys_nice,cap_ipc_lock+ep $(command -v {})`, or run it as root",
                crate::sys::program()
            ),
            source: errno.into(),
        },
        Errno::EAFNOSUPPORT => Error::Io {
            what: "packet sockets are not allowed to this service (RestrictAddressFamilies): install \
                   csi5300-node-sounding.conf beside its unit"
                .into(),
            source: errno.into(),
        },
        _ => Error::Io { what: "cannot open a packet socket".into(), source: errno.into() },
    })?;
    let index = nix::net::if_::if_nametoindex(interface).map_err(|errno| Error::Io {
        what: format!("there is no interface {interface} here (`ip link` lists them; `csi5300 setup` makes a monitor)"),
        source: errno.into(),
    })?;
    let io = |what: &str| {
        let what = format!("{what} {interface}");
        move |source: io::Error| Error::Io { what, source }
    };
    sys::attach_filter(socket.as_fd(), &filter::sounding()).map_err(io("cannot filter the socket of"))?;
    // Stamps give the time of reception, however late a frame is fetched.
    setsockopt(&socket, sockopt::ReceiveTimestampns, &true)
        .map_err(|errno| io("cannot stamp frames of")(errno.into()))?;
    sys::bind_packet(socket.as_fd(), index).map_err(io("cannot bind to"))?;
    let mac = link(&socket, interface)?;
    // Binding to an interface that is down leaves its error on the socket.
    if getsockopt(&socket, sockopt::SocketError) == Ok(libc::ENETDOWN) {
        return Err(MonitorError::Down { interface: interface.into() }.into());
    }
    let mtu = sys::mtu(socket.as_fd(), interface).map_err(io("cannot ask for the MTU of"))?;
    if mtu < longest {
        return Err(MonitorError::Mtu { interface: interface.into(), mtu, longest }.into());
    }
    Ok(Opened { socket, mac, mtu })
}

/// Checks the link type; gives the MAC.
fn link(socket: &OwnedFd, interface: &str) -> Result<Option<Mac>, Error> {
    let (link_type, mac) = sys::packet_link(socket.as_fd())
        .map_err(|source| Error::Io { what: format!("cannot ask for the link of {interface}"), source })?;
    if link_type != ARPHRD_IEEE80211_RADIOTAP {
        return Err(MonitorError::LinkType { interface: interface.into(), link_type }.into());
    }
    Ok(mac)
}

/// Room for the kernel's stamp of a frame.
pub(super) fn control_buffer() -> Vec<u8> {
    nix::cmsg_space!(TimeSpec)
}

/// Sends one buffer.
pub(super) fn send(socket: &OwnedFd, buffer: &[u8]) -> io::Result<usize> {
    let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL;
    Ok(nix::sys::socket::send(socket.as_raw_fd(), buffer, flags)?)
}

/// What was received.
#[derive(Clone, Copy, Debug)]
pub(super) struct Received {
    /// True length, which may exceed the buffer.
    pub(super) len: usize,
    pub(super) is_outgoing: bool,
    /// Microseconds since the Unix epoch.
    pub(super) stamp_us: Option<i64>,
}

/// Receives one buffer.
pub(super) fn receive(socket: &OwnedFd, buffer: &mut [u8], control: &mut [u8]) -> io::Result<Received> {
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

/// Frames dropped since the last call.
pub(super) fn drops(socket: &OwnedFd) -> u64 {
    sys::packet_drops(socket.as_fd()).map_or(0, u64::from)
}
