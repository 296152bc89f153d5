//! A simulated room in another process that acts as the card: injected and received frames of a robot, its card's
//! records and its odometry's poses, over a Unix socket.
//!
//! `csi5300 simulate SCENE.toml --serve --socket PATH` runs a [`Server`]; `sound`, `record` (with `--room PATH#ROBOT`)
//! and `node` (with `capture.served`) use it with the code for cards: the socket carries the same bytes as the
//! kernel's, so everything behind the live crate's `Monitor` and `Netlink` is shared.
//!
//! The socket is of type SOCK_SEQPACKET: messages keep their bounds, and a closed partner is noticed. The first message
//! is a request in words:
//!
//! | to the room | from the room |
//! |---|---|
//! | `csi5300-room 1 air ROBOT` | `ok MAC`, then radiotap header and 802.11 frame, one a message, both ways. A frame that went out comes back as a tx-status copy (TX flags), as mac80211's do |
//! | `csi5300-room 1 card ROBOT` | `ok MAC`, then connector datagrams: `nlmsghdr`, `cn_msg`, record |
//! | `csi5300-room 1 poses ROBOT` | `ok MAC`, then lines `time,0,x,y,z,heading,` on the robot's host clock |
//! | anything else | `no`, and why |
//!
//! A frame is on air from the moment of its hand-over, by the kernel's stamp of the message; overlapping frames
//! collide. Several programs may listen to one card; one at a time may use a robot's air.

mod address;
mod place;
mod poses;
mod server;

pub use address::{Address, AddressError, JoinError};
pub use place::PlaceError;
pub use poses::Poses;
pub use server::{ServedCounts, Server};

use driver_iface::Mac;
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, connect, recv, send, setsockopt, socket, sockopt,
};
use nix::sys::time::TimeVal;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};

/// First word of the first message, and the version of what follows.
const GREETING: &str = "csi5300-room 1";
/// Longest message other than frames and records, bytes.
const WORDS: usize = 512;
/// How long to wait for the room, seconds.
const PATIENCE_S: i64 = 60;

/// The requested stream of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Its monitor interface.
    Air,
    /// Its card's records.
    Card,
    /// Its odometry.
    Poses,
}

impl Role {
    const ALL: [(Self, &str); 3] = [(Self::Air, "air"), (Self::Card, "card"), (Self::Poses, "poses")];

    fn word(self) -> &'static str {
        Self::ALL.iter().find(|(role, _)| *role == self).map_or("", |(_, word)| word)
    }
}

/// Connects to a robot of a room; returns the socket, which does not block and stamps messages, and the robot's MAC.
///
/// # Errors
/// [`JoinError::NoRoom`] where no room is served, [`JoinError::Refused`] with the room's reason, [`JoinError::Answer`] from
/// something else that listens there.
pub fn join(address: &Address, role: Role) -> Result<(OwnedFd, Mac), JoinError> {
    let no_room = |source: nix::errno::Errno| JoinError::NoRoom { address: address.clone(), source: source.into() };
    let socket = seqpacket(SockFlag::empty()).map_err(no_room)?;
    setsockopt(&socket, sockopt::ReceiveTimeout, &TimeVal::new(PATIENCE_S, 0)).map_err(no_room)?;
    let path = UnixAddr::new(&address.socket).map_err(no_room)?;
    connect(socket.as_raw_fd(), &path).map_err(no_room)?;
    let hello = format!("{GREETING} {} {}", role.word(), address.robot);
    send(socket.as_raw_fd(), hello.as_bytes(), MsgFlags::MSG_NOSIGNAL).map_err(no_room)?;
    let mut answer = [0; WORDS];
    let len = recv(socket.as_raw_fd(), &mut answer, MsgFlags::empty()).map_err(no_room)?;
    let answer = String::from_utf8_lossy(answer.get(..len).unwrap_or_default());
    let strange = || JoinError::Answer { address: address.clone(), len };
    match answer.split_once(' ') {
        Some(("ok", mac)) => Ok((socket, mac.parse().map_err(|_| strange())?)),
        Some(("no", why)) => Err(JoinError::Refused { address: address.clone(), why: why.into() }),
        _ => Err(strange()),
    }
}

/// A socket that stamps received messages.
fn seqpacket(flags: SockFlag) -> nix::Result<OwnedFd> {
    let socket = socket(AddressFamily::Unix, SockType::SeqPacket, flags | SockFlag::SOCK_CLOEXEC, None)?;
    setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
    Ok(socket)
}

/// Takes one message of a robot's card or odometry: its true length, 0 once the room has ended.
///
/// # Errors
/// The kernel's, WouldBlock where there is none.
fn take(socket: &OwnedFd, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match recv(socket.as_raw_fd(), buffer, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC) {
            // The partner closed with unread data; its earlier messages are still readable.
            Err(nix::errno::Errno::ECONNRESET) => {}
            taken => return Ok(taken?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_room_the_error_names_robot_and_socket() {
        let address = Address { socket: "/nowhere/room".into(), robot: "rx".into() };
        let error = join(&address, Role::Air).unwrap_err();
        assert!(error.to_string().contains("rx of the room at /nowhere/room"), "{error}");
        assert!(matches!(error, JoinError::NoRoom { source, .. } if source.kind() == io::ErrorKind::NotFound));
    }
}
