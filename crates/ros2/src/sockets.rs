//! The sockets of a participant: discovery and samples on two ports of one address, and the domain's group.

use super::rtps::{MULTICAST, PARTICIPANTS, Prefix, Settings, multicast_address, unicast_ports};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socket2::{Domain, Protocol, Socket, Type};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Datagrams that are taken from one socket before the others have their turn.
const BURST: usize = 64;
/// Participants of one machine whose ports are tried.
const PLACES: u16 = 100;
/// Bytes that may wait to be read.
const BUFFER: usize = 1 << 20;

/// The sockets of a participant.
pub(crate) struct Sockets {
    domain: u16,
    meta: UdpSocket,
    user: UdpSocket,
    addresses: (SocketAddrV4, SocketAddrV4),
    group: Option<UdpSocket>,
    /// Why there is no group, where it was asked for.
    no_group: Option<String>,
    peers: Vec<Ipv4Addr>,
    is_local: bool,
    foreign: AtomicU64,
}

impl Sockets {
    /// Binds the first two free ports of the domain at `interface`; joins its group with `multicast`. Without it, or on
    /// loopback, other participants of this machine are asked at their ports, and those of `peers`.
    ///
    /// # Errors
    /// If there is no such address here, or no port is free.
    pub fn open(domain: u16, interface: Ipv4Addr, multicast: bool, mut peers: Vec<Ipv4Addr>) -> io::Result<Self> {
        let mut last = io::Error::from(io::ErrorKind::AddrInUse);
        let mut bound = None;
        for index in 0..PLACES {
            let (meta, user) = unicast_ports(domain, index);
            match (bind(interface, meta), bind(interface, user)) {
                (Ok(first), Ok(second)) => {
                    bound =
                        Some((first, second, SocketAddrV4::new(interface, meta), SocketAddrV4::new(interface, user)));
                    break;
                }
                (Err(error), _) | (_, Err(error)) if error.kind() == io::ErrorKind::AddrInUse => last = error,
                (Err(error), _) | (_, Err(error)) => return Err(error),
            }
        }
        let Some((meta, user, at, samples)) = bound else { return Err(last) };
        let is_local = interface.is_loopback();
        if is_local || !multicast {
            peers.push(interface);
        }
        peers.sort_unstable();
        peers.dedup();
        let group = if multicast { join(&meta, domain, interface).map(Some) } else { Ok(None) };
        let (group, no_group) = match group {
            Ok(group) => (group, None),
            // On loopback all are asked at their ports anyhow.
            Err(_) if is_local => (None, None),
            Err(error) => (None, Some(format!("ROS 2: no multicast at {interface} ({error}): only `peers` are found"))),
        };
        let addresses = (at, samples);
        Ok(Self { domain, meta, user, addresses, group, no_group, peers, is_local, foreign: AtomicU64::new(0) })
    }

    /// What a participant on these sockets is told.
    pub fn settings(&self, name: String) -> Settings {
        let (meta, user) = self.addresses;
        let at = |ip: &Ipv4Addr| {
            (0..PARTICIPANTS)
                .map(|index| SocketAddrV4::new(*ip, unicast_ports(self.domain, index).0))
                .collect::<Vec<_>>()
        };
        let group = self.group.iter().map(|_| multicast_address(self.domain));
        let asked = self.peers.iter().flat_map(at).filter(|to| *to != meta);
        Settings { prefix: prefix(), name, meta, user, announce: group.chain(asked).collect() }
    }

    /// Where it takes discovery.
    pub fn address(&self) -> SocketAddrV4 {
        self.addresses.0
    }

    /// Datagrams that came from other machines, where only this one is spoken to.
    pub fn foreign(&self) -> u64 {
        self.foreign.load(Ordering::Relaxed)
    }

    /// What is wrong, in words.
    pub fn trouble(&self) -> Option<String> {
        self.no_group.clone()
    }

    /// Sends a datagram, and never waits. False if the system did not take it.
    pub fn send(&self, to: SocketAddrV4, bytes: &[u8]) -> bool {
        match self.meta.send_to(bytes, to) {
            Ok(_) => true,
            // What an earlier datagram met: nobody at that port, which is usual while peers are looked for.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => self.meta.send_to(bytes, to).is_ok(),
            Err(_) => false,
        }
    }

    /// Until something came, for so long at most.
    pub fn wait(&self, limit: Duration) {
        let sockets = [Some(&self.meta), Some(&self.user), self.group.as_ref()];
        let mut waiting: Vec<PollFd<'_>> =
            sockets.into_iter().flatten().map(|socket| PollFd::new(socket.as_fd(), PollFlags::POLLIN)).collect();
        let limit = PollTimeout::try_from(limit).unwrap_or(PollTimeout::ZERO);
        // What fails here fails again when it is read.
        let _ = poll(&mut waiting, limit);
    }

    /// Hands over what came, a burst of each socket.
    pub fn receive(&self, buffer: &mut [u8], mut used: impl FnMut(&[u8], Ipv4Addr)) {
        for socket in [Some(&self.meta), Some(&self.user), self.group.as_ref()].into_iter().flatten() {
            for _ in 0..BURST {
                match socket.recv_from(buffer) {
                    Ok((length, SocketAddr::V4(from))) => {
                        if self.is_local && !from.ip().is_loopback() {
                            self.foreign.fetch_add(1, Ordering::Relaxed);
                        } else if length > 0 {
                            used(buffer.get(..length).unwrap_or_default(), *from.ip());
                        }
                    }
                    Ok(_) => {}
                    // Of a datagram that was sent before.
                    Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                    Err(_) => break,
                }
            }
        }
    }

    /// Ends a wait.
    pub fn wake(&self) {
        let _ = self.user.send_to(&[], self.addresses.1);
    }
}

fn bind(ip: Ipv4Addr, port: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.bind(&SocketAddr::from((ip, port)).into())?;
    // As much as the system allows.
    let _ = socket.set_recv_buffer_size(BUFFER);
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}

/// Joins the domain's group at `interface`, and sends to it from there.
fn join(meta: &UdpSocket, domain: u16, interface: Ipv4Addr) -> io::Result<UdpSocket> {
    let sender = socket2::SockRef::from(meta);
    sender.set_multicast_if_v4(&interface)?;
    sender.set_multicast_loop_v4(true)?;
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    // Bound to the group, it takes nothing that was sent to this machine.
    socket.bind(&SocketAddr::V4(multicast_address(domain)).into())?;
    socket.join_multicast_v4(&MULTICAST, &interface)?;
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}

/// A name that no other participant has: this process, and when it began.
fn prefix() -> Prefix {
    use std::hash::{BuildHasher, Hasher};
    // The standard library's keys are random.
    let random = std::collections::hash_map::RandomState::new().build_hasher().finish().to_le_bytes();
    let mut prefix = [0; 12];
    let all = super::rtps::VENDOR.into_iter().chain(random).chain(std::process::id().to_le_bytes());
    prefix.iter_mut().zip(all).for_each(|(to, from)| *to = from);
    prefix
}
