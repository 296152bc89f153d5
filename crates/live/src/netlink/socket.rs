//! Opens, joins, widens and filters the socket; all errors in words.

use super::{NetlinkError, Options};
use crate::sys::{Instruction, attach_filter};
use csi5300::source::Error;
use driver_iface::connector::{CN_IDX, CN_IDX_10_USERS, NETLINK_CONNECTOR, offset, registered_idx};
use netlink_sys::{Socket, SocketAddr};
use nix::sys::socket::{MsgFlags, getsockopt, recv, setsockopt, sockopt};
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

/// The list of the kernel's connector users, in the network namespace of this thread.
const PROC_CONNECTOR: &str = "/proc/thread-self/net/connector";
/// The table of netlink sockets, with their drops.
const PROC_NETLINK: &str = "/proc/thread-self/net/netlink";
/// Largest multicast group of the connector: what fits a netlink group mask rounded up to 32 (`af_netlink.c`).
pub(super) const MAX_GROUP: u32 = 32;

/// How the connector index was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// It was given.
    Given,
    /// The driver is registered under it in `/proc/net/connector`.
    Registered,
    /// No driver is registered: both usual indices are joined, and the one that delivers is right.
    Guessed,
    /// Each robot of a served room has one.
    Served,
}

/// A joined socket.
#[derive(Debug)]
pub(super) struct Joined {
    pub(super) socket: Socket,
    pub(super) port: u32,
    pub(super) indices: Vec<u32>,
    pub(super) found: Found,
    pub(super) receive_buffer: usize,
}

pub(super) fn open(options: &Options) -> Result<Joined, Error> {
    let listed = std::fs::read_to_string(PROC_CONNECTOR);
    // The file exists only in the first network namespace, where the kernel's messages arrive.
    if listed.is_err() && !options.allow_user_sender {
        return Err(NetlinkError::OtherNamespace.into());
    }
    let registered = listed.ok().and_then(|text| registered_idx(&text));
    let (indices, found) = match (options.connector_index, registered) {
        (Some(index), _) => (vec![index], Found::Given),
        (None, Some(index)) => (vec![index], Found::Registered),
        (None, None) => (vec![CN_IDX, CN_IDX_10_USERS], Found::Guessed),
    };
    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).map_err(|source| {
        let what = "cannot open a connector socket; is this a Linux kernel with CONFIG_CONNECTOR=y?".into();
        Error::Io { what, source }
    })?;
    let io = |what: &str| {
        let what = what.to_string();
        move |source: io::Error| Error::Io { what, source }
    };
    let port = socket.bind_auto().map_err(io("cannot bind the connector socket"))?.port_number();
    socket.set_non_blocking(true).map_err(io("cannot make the connector socket non-blocking"))?;
    let receive_buffer = widen(&socket, options.receive_buffer);
    attach_filter(socket.as_fd(), &filter(&indices)).map_err(io("cannot filter the connector socket"))?;
    join(&socket, &indices)?;
    Ok(Joined { socket, port, indices, found, receive_buffer })
}

fn join(socket: &Socket, indices: &[u32]) -> Result<(), Error> {
    let mut refused = None;
    let mut joined = 0;
    for &index in indices {
        match socket.add_membership(index) {
            Ok(()) => joined += 1,
            Err(source) => refused = Some((index, source)),
        }
    }
    match refused {
        // An unprivileged process may join odd groups only, by an accident of newer kernels.
        Some((_, source)) if source.kind() == io::ErrorKind::PermissionDenied => Err(Error::Io {
            what: format!(
                "not allowed to listen to the driver: give the program the capability once, \
                 `sudo setcap cap_net_admin+ep $(command -v {})`, or run it as root",
                crate::sys::program()
            ),
            source,
        }),
        Some((index, source)) if joined == 0 => Err(Error::Io {
            what: format!("cannot join connector index {index}; the kernel takes 1 to {MAX_GROUP}"),
            source,
        }),
        _ => Ok(()),
    }
}

/// Requests a receive buffer, beyond `net.core.rmem_max` if allowed. Returns the granted bytes.
pub(super) fn widen(socket: &impl AsFd, bytes: usize) -> usize {
    let granted = || getsockopt(socket, sockopt::RcvBuf).unwrap_or(0);
    if setsockopt(socket, sockopt::RcvBufForce, &bytes).is_err() {
        // Refused without CAP_NET_ADMIN in the first user namespace; the ordinary option is capped, never refused.
        let _ = setsockopt(socket, sockopt::RcvBuf, &bytes);
    }
    granted()
}

/// A classic filter that passes messages with one of `indices`, so that foreign traffic does not fill the queue.
///
/// The loads are big-endian, the messages little-endian (hence the swapped constants). It checks only the first
/// `cn_msg` of a datagram: the driver puts one in each.
pub(super) fn filter(indices: &[u32]) -> Vec<Instruction> {
    const LOAD_WORD: u16 = 0x20; // BPF_LD | BPF_W | BPF_ABS
    const JUMP_IF_EQUAL: u16 = 0x15; // BPF_JMP | BPF_JEQ | BPF_K
    const RETURN: u16 = 0x06; // BPF_RET | BPF_K
    let step = |code, if_true, if_false, k| Instruction { code, if_true, if_false, k };
    let mut program = vec![step(LOAD_WORD, 0, 0, offset::CN_IDX as u32)];
    let count = indices.len().min(MAX_GROUP as usize);
    for (k, index) in indices.iter().take(count).enumerate() {
        program.push(step(JUMP_IF_EQUAL, (count - k) as u8, 0, index.swap_bytes()));
    }
    program.push(step(RETURN, 0, 0, 0));
    program.push(step(RETURN, 0, 0, u32::MAX));
    program
}

/// Messages that the kernel dropped at the connector socket with this port, if it reports them.
pub(super) fn kernel_drops(port: u32) -> Option<u64> {
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

/// Takes one datagram. Gives its true length, which may exceed the buffer, and the sender's port.
pub(super) fn receive(socket: &Socket, mut buffer: &mut [u8]) -> io::Result<(usize, u32)> {
    let (sent, sender): (usize, SocketAddr) = socket.recv_from(&mut buffer, libc::MSG_TRUNC)?;
    Ok((sent, sender.port_number()))
}

/// Takes one datagram from a message socket: its true length, 0 once the partner has ended.
///
/// # Errors
/// The kernel's, WouldBlock where there is none.
pub(super) fn receive_message(socket: &OwnedFd, buffer: &mut [u8]) -> io::Result<usize> {
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

    /// Runs a filter as `linux/filter.h` defines it, as far as ours goes.
    fn passes(program: &[Instruction], packet: &[u8]) -> bool {
        let (mut at, mut word) = (0, 0);
        loop {
            let step = program[at];
            at += 1;
            match step.code {
                0x20 => {
                    let k = step.k as usize;
                    let Some(bytes) = packet.get(k..k + 4) else { return false };
                    word = u32::from_be_bytes(bytes.try_into().unwrap());
                }
                0x15 => at += usize::from(if word == step.k { step.if_true } else { step.if_false }),
                _ => return step.k != 0,
            }
        }
    }

    #[test]
    fn the_filter_keeps_its_indices_only() {
        for indices in [&[26][..], &[26, 25], &[25, 26, 23]] {
            let program = filter(indices);
            for index in [1_u32, 23, 25, 26, 27, 0x1a00_0000] {
                let mut packet = [0; 36];
                packet[16..20].copy_from_slice(&index.to_le_bytes());
                assert_eq!(passes(&program, &packet), indices.contains(&index), "{index} of {indices:?}");
            }
            assert!(!passes(&program, &[26; 10]));
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
}
