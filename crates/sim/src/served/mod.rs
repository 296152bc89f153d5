//! A simulated room in another process, as if it were the card: frames into the air of a robot, the frames that it
//! hears, its card's records and its odometry's poses, over a Unix socket.
//!
//! `csi5300 simulate SCENE.toml --serve --socket PATH` runs a [`Server`]; `sound`, `respond`, `record` (with
//! `--room PATH#ROBOT`) and `node` (with `capture.served`) work with it by the code that works with a card: what goes over the socket
//! is what goes over the kernel's, byte for byte, and so everything behind the live crate's `Monitor` and
//! `Netlink` is theirs.
//!
//! The socket is of type SOCK_SEQPACKET: messages keep their bounds, and a partner that went away is noticed. The first
//! message says who is asked for, in words, and is answered:
//!
//! | to the room | from the room |
//! |---|---|
//! | `csi5300-room 1 air ROBOT` | `ok MAC`, then radiotap header and 802.11 frame, one a message, both ways. A frame that went out comes back as a tx-status copy (TX flags), as mac80211's do |
//! | `csi5300-room 1 card ROBOT` | `ok MAC`, then connector datagrams: `nlmsghdr`, `cn_msg`, record |
//! | `csi5300-room 1 poses ROBOT` | `ok MAC`, then lines `time,0,x,y,z,heading,` on the robot's host clock |
//! | anything else | `no`, and why |
//!
//! A frame is on air from the moment at which its sender handed it over, by the kernel's stamp of the message; what
//! overlaps collides. Several may listen to one card; one at a time has a robot's air.

mod poses;
mod server;

pub use poses::Poses;
pub use server::{ServedCounts, Server};

use csi5300::source::Error;
use driver_iface::Mac;
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, connect, recv, send, setsockopt, socket, sockopt,
};
use nix::sys::time::TimeVal;
use std::fmt;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::PathBuf;
use std::str::FromStr;

/// First word of the first message, and the version of what follows.
const GREETING: &str = "csi5300-room 1";
/// Longest message but for frames and records, bytes.
const WORDS: usize = 512;
/// How long the room is waited for, seconds.
const PATIENCE_S: i64 = 10;

/// A robot of a served room: `PATH#ROBOT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot's name in the scene.
    pub robot: String,
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.rsplit_once('#') {
            Some((path, robot)) if !path.is_empty() && !robot.is_empty() => {
                Ok(Self { socket: path.into(), robot: robot.into() })
            }
            _ => Err("a robot of a served room is PATH#ROBOT, such as /tmp/room#rx".into()),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of the room at {}", self.robot, self.socket.display())
    }
}

/// What of a robot is asked for.
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

/// Connects to a robot of a room; gives the socket, which does not block and stamps what it receives, and the robot's MAC.
///
/// # Errors
/// No room there, or its refusal.
pub fn join(address: &Address, role: Role) -> Result<(OwnedFd, Mac), Error> {
    let words =
        |what: &str| format!("{what} {address}; does `csi5300 simulate SCENE --serve --socket PATH` run there?");
    let io = |what: &str| {
        let what = words(what);
        move |errno: nix::errno::Errno| Error::Io { what, source: errno.into() }
    };
    let socket = seqpacket(SockFlag::empty()).map_err(io("cannot open a socket to"))?;
    let patience = TimeVal::new(PATIENCE_S, 0);
    setsockopt(&socket, sockopt::ReceiveTimeout, &patience).map_err(io("cannot set a time limit for"))?;
    let path = UnixAddr::new(&address.socket).map_err(io("cannot reach"))?;
    connect(socket.as_raw_fd(), &path).map_err(io("cannot reach"))?;
    let hello = format!("{GREETING} {} {}", role.word(), address.robot);
    send(socket.as_raw_fd(), hello.as_bytes(), MsgFlags::MSG_NOSIGNAL).map_err(io("cannot ask for"))?;
    let mut answer = [0; WORDS];
    let len = recv(socket.as_raw_fd(), &mut answer, MsgFlags::empty()).map_err(io("no answer from"))?;
    let answer = String::from_utf8_lossy(answer.get(..len).unwrap_or_default());
    let mac = match answer.split_once(' ') {
        Some(("ok", mac)) => mac.parse().map_err(|_| Error::Input(words("no MAC address from")))?,
        Some(("no", why)) => return Err(Error::Input(format!("{address}: {why}"))),
        _ => return Err(Error::Input(words("no sense in what comes from"))),
    };
    Ok((socket, mac))
}

/// A socket that stamps what it receives.
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
            // The partner left something unread; what it had said before is still to be had.
            Err(nix::errno::Errno::ECONNRESET) => {}
            taken => return Ok(taken?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_of_a_room_is_its_socket_and_its_name() {
        let address: Address = "/tmp/a#b/room#rx".parse().unwrap();
        assert_eq!(address, Address { socket: "/tmp/a#b/room".into(), robot: "rx".into() });
        assert_eq!(address.to_string(), "rx of the room at /tmp/a#b/room");
        for wrong in ["", "#", "/tmp/room", "/tmp/room#", "#rx"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn where_no_room_is_the_error_says_what_would_make_one() {
        let address = Address { socket: "/nowhere/room".into(), robot: "rx".into() };
        let error = join(&address, Role::Air).unwrap_err().to_string();
        assert!(error.contains("rx of the room at /nowhere/room") && error.contains("--serve --socket"), "{error}");
    }
}
