//! The sockets of a participant: discovery and samples on two ports of one address, and the domain's multicast group.

use super::rtps::{MULTICAST, PARTICIPANTS, Prefix, Settings, multicast_address, unicast_ports};
use super::settings::{Reach, is_own};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socket2::{Domain, Protocol, Socket, Type};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

/// Datagrams that are read from one socket before the others have their turn.
const BURST: usize = 64;
/// Participants of one machine whose ports are tried.
const PLACES: u16 = 100;
/// Size of the receive buffer, bytes.
const BUFFER: usize = 1 << 20;

/// The sockets of a participant.
pub(crate) struct Sockets {
    /// The domain.
    pub domain: u16,
    /// Where it receives discovery.
    pub meta_address: SocketAddrV4,
    user_address: SocketAddrV4,
    /// Which nodes it looks for, and which setting decided that.
    pub reach: Reach,
    meta: UdpSocket,
    user: UdpSocket,
    group: Option<UdpSocket>,
    /// Why there is no group although one was requested.
    no_group: Option<String>,
    is_local: bool,
    foreign: AtomicU64,
    /// The last stranger's address; 0 for none.
    stranger: AtomicU32,
}

impl Sockets {
    /// Binds the first two free ports of the domain at the interface and, with multicast, joins its group. Without multicast, or
    /// on loopback, queries the ports of this machine's other participants and of the peers.
    ///
    /// # Errors
    /// If this machine has no such address, or no port is free.
    pub fn open(domain: u16, mut reach: Reach) -> io::Result<Self> {
        let Reach { interface, multicast, is_off, .. } = reach;
        let both = |index| {
            let (meta, user) = unicast_ports(domain, index);
            let at = |port| bind(interface, port).map(|socket| (socket, SocketAddrV4::new(interface, port)));
            Ok((at(meta)?, at(user)?))
        };
        let is_taken = |error: &io::Error| error.kind() == io::ErrorKind::AddrInUse;
        let free = (0..PLACES).map(both).find(|bound| !bound.as_ref().is_err_and(is_taken));
        let ((meta, meta_address), (user, user_address)) = free.unwrap_or(Err(io::ErrorKind::AddrInUse.into()))?;
        let is_local = interface.is_loopback();
        if !is_off && (is_local || !multicast) {
            reach.peers.push(interface);
        }
        reach.peers.sort_unstable();
        reach.peers.dedup();
        let group = if multicast { join(&meta, domain, interface).map(Some) } else { Ok(None) };
        let (group, no_group) = match group {
            Ok(group) => (group, None),
            // On loopback all ports are queried anyway.
            Err(_) if is_local => (None, None),
            Err(error) => (None, Some(format!("ROS 2: no multicast at {interface} ({error}): only `peers` are found"))),
        };
        Ok(Self {
            domain,
            meta_address,
            user_address,
            reach,
            meta,
            user,
            group,
            no_group,
            is_local,
            foreign: AtomicU64::new(0),
            stranger: AtomicU32::new(0),
        })
    }

    /// What the participant on these sockets needs to know.
    pub fn settings(&self, name: String) -> Settings {
        let (meta, user) = (self.meta_address, self.user_address);
        let at = |ip: &Ipv4Addr| {
            (0..PARTICIPANTS)
                .map(|index| SocketAddrV4::new(*ip, unicast_ports(self.domain, index).0))
                .collect::<Vec<_>>()
        };
        let group = self.group.iter().map(|_| multicast_address(self.domain));
        let asked = self.reach.peers.iter().flat_map(at).filter(|to| *to != meta);
        Settings { prefix: prefix(), name, meta, user, announce: group.chain(asked).collect() }
    }

    /// Datagrams that came from other machines although only this one is allowed.
    pub fn foreign(&self) -> u64 {
        self.foreign.load(Ordering::Relaxed)
    }

    /// Continues the counters of the sockets that these replace.
    pub fn follow(self, other: &Self) -> Self {
        self.foreign.store(other.foreign(), Ordering::Relaxed);
        self
    }

    /// The current problem as text, given the number of participants met.
    pub fn trouble(&self, participants: u64) -> Option<String> {
        let stranger = Ipv4Addr::from(self.stranger.load(Ordering::Relaxed));
        if let Some(why) = &self.reach.waits {
            return Some(format!("ROS 2: {why}"));
        }
        if stranger.is_unspecified() || participants > 0 {
            return self.no_group.clone();
        }
        let next = if is_own(stranger) {
            "they are nodes of this machine that use its network: start them with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
             (ROS_LOCALHOST_ONLY=1 for Humble)"
        } else {
            "to meet other machines give `[ros2]` `interface`, this machine's address in their network, and `insecure = true`"
        };
        let (foreign, own) = (self.foreign(), self.meta_address.ip());
        Some(format!(
            "ROS 2: no other node met at {own}; {foreign} datagrams from other addresses ignored, the last from {stranger}: {next}"
        ))
    }

    /// Sends a datagram, and never waits. False if the system did not accept it.
    pub fn send(&self, to: SocketAddrV4, bytes: &[u8]) -> bool {
        match self.meta.send_to(bytes, to) {
            Ok(_) => true,
            // An earlier datagram's error: nobody at that port, which is usual while peers are searched.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => self.meta.send_to(bytes, to).is_ok(),
            Err(_) => false,
        }
    }

    /// Waits until something arrives, at most this long.
    pub fn wait(&self, limit: Duration) {
        let sockets = [Some(&self.meta), Some(&self.user), self.group.as_ref()];
        let mut waiting: Vec<PollFd<'_>> =
            sockets.into_iter().flatten().map(|socket| PollFd::new(socket.as_fd(), PollFlags::POLLIN)).collect();
        let limit = PollTimeout::try_from(limit).unwrap_or(PollTimeout::ZERO);
        // An error here appears again on reading.
        let _ = poll(&mut waiting, limit);
    }

    /// Passes on what arrived, a burst from each socket.
    pub fn receive(&self, buffer: &mut [u8], mut used: impl FnMut(&[u8], Ipv4Addr)) {
        for socket in [Some(&self.meta), Some(&self.user), self.group.as_ref()].into_iter().flatten() {
            for _ in 0..BURST {
                match socket.recv_from(buffer) {
                    Ok((length, SocketAddr::V4(from))) => {
                        if self.is_local && !from.ip().is_loopback() {
                            self.foreign.fetch_add(1, Ordering::Relaxed);
                            self.stranger.store(u32::from(*from.ip()), Ordering::Relaxed);
                        } else if length > 0 && !self.reach.is_off {
                            used(buffer.get(..length).unwrap_or_default(), *from.ip());
                        }
                    }
                    Ok(_) => {}
                    // The error of a datagram sent earlier.
                    Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                    Err(_) => break,
                }
            }
        }
    }

    /// Ends a wait.
    pub fn wake(&self) {
        let _ = self.user.send_to(&[], self.user_address);
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
    // Bound to the group's address, it receives nothing that was sent to this machine's own.
    socket.bind(&SocketAddr::V4(multicast_address(domain)).into())?;
    socket.join_multicast_v4(&MULTICAST, &interface)?;
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}

/// A name that no other participant has: from this process and its start time.
fn prefix() -> Prefix {
    use std::hash::{BuildHasher, Hasher};
    // The standard library's keys are random.
    let random = std::collections::hash_map::RandomState::new().build_hasher().finish().to_le_bytes();
    let mut prefix = [0; 12];
    let all = super::rtps::VENDOR.into_iter().chain(random).chain(std::process::id().to_le_bytes());
    prefix.iter_mut().zip(all).for_each(|(to, from)| *to = from);
    prefix
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(change: impl FnOnce(&mut Reach)) -> Sockets {
        let interface = Ipv4Addr::LOCALHOST;
        let mut reach =
            Reach { interface, multicast: false, peers: Vec::new(), is_off: false, words: String::new(), waits: None };
        change(&mut reach);
        Sockets::open(140, reach).unwrap()
    }

    #[test]
    fn ignored_participants_are_reported_with_a_next_step() {
        let sockets = open(|_| ());
        assert_eq!(sockets.trouble(0), None);
        sockets.foreign.store(2, Ordering::Relaxed);
        sockets.stranger.store(u32::from(Ipv4Addr::new(198, 51, 100, 9)), Ordering::Relaxed);
        let said = sockets.trouble(0).unwrap();
        assert!(
            said.contains("2 datagrams from other addresses ignored, the last from 198.51.100.9")
                && said.contains("`interface`"),
            "{said}"
        );
        assert_eq!(sockets.trouble(1), None, "somebody was met");
        // Datagrams from an address of this machine: its other nodes use the network.
        sockets.stranger.store(u32::from(Ipv4Addr::new(127, 0, 0, 1)), Ordering::Relaxed);
        let said = sockets.trouble(0).unwrap();
        assert!(said.contains("ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"), "{said}");
    }

    #[test]
    fn a_node_with_discovery_off_sends_and_receives_nothing() {
        let off = open(|reach| reach.is_off = true);
        assert!(
            off.settings("off".into()).announce.is_empty() && !open(|_| ()).settings("on".into()).announce.is_empty()
        );
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(b"RTPS", off.meta_address).unwrap();
        let mut came = 0;
        off.wait(Duration::from_secs(5));
        off.receive(&mut [0; 64], |_, _| came += 1);
        assert_eq!(came, 0);
    }
}
