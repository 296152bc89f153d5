//! A DDS participant with what ROS 2 nodes need: discovery of participants and endpoints, best-effort and reliable topics
//! without keys, latched samples, fragments (read only), reasons for incompatible quality of service. It has no sockets and
//! no clock: datagrams and times are passed in, datagrams come out.
//!
//! | module | what it is |
//! |---|---|
//! | `wire` | datagrams: parsing and writing submessages |
//! | `discovery` | announcements of participants and endpoints, and their quality of service |
//! | `writer`, `reader` | the two ends of a topic |
//! | `participant` | known participants and matched endpoints |
//!
//! Everything that others send is bounded: participants, endpoints, waiting samples, fragments.

mod discovery;
mod participant;
mod reader;
mod wire;
mod writer;

pub use discovery::Qos;
#[cfg(feature = "fuzzed")]
pub(crate) use participant::fuzzed;
pub(crate) use participant::{Counts, Event, Participant, Settings};
pub(crate) use reader::LARGEST as LARGEST_READ;
pub(crate) use wire::{Guid, Prefix, VENDOR};
pub(crate) use writer::{LARGEST, Outgoing};

use std::net::{Ipv4Addr, SocketAddrV4};

/// Where participants of a domain announce themselves.
pub(crate) const MULTICAST: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// Participants of one machine that are tried for a static peer.
pub(crate) const PARTICIPANTS: u16 = 32;

/// Ports of a domain (\[rtps\] 9.6.1): multicast discovery.
pub(crate) fn multicast_address(domain: u16) -> SocketAddrV4 {
    SocketAddrV4::new(MULTICAST, 7400 + 250 * domain)
}

/// Ports for discovery and samples of participant number `index` of a machine.
pub(crate) fn unicast_ports(domain: u16, index: u16) -> (u16, u16) {
    let first = 7400 + 250 * domain + 10 + 2 * index;
    (first, first + 1)
}
