//! A participant of DDS, as much of it as nodes of ROS 2 need: discovery of participants and endpoints, best effort and
//! reliable topics without keys, what is latched, fragments (read only), quality of service said in words. Without sockets
//! and clocks: datagrams and times are handed in, datagrams come out.
//!
//! | module | what it is |
//! |---|---|
//! | `wire` | datagrams: submessages from bytes and to bytes |
//! | `discovery` | what participants say of themselves and their endpoints |
//! | `qos` | quality of service |
//! | `writer`, `reader` | the two ends of a topic |
//! | `participant` | who is there, and who goes with whom |
//!
//! Everything that others send is bounded: participants, endpoints, samples that wait, fragments.

mod discovery;
mod participant;
mod qos;
mod reader;
mod wire;
mod writer;

#[cfg(feature = "fuzzed")]
pub(crate) use participant::fuzzed;
pub(crate) use participant::{Counts, Event, Participant, Settings};
pub use qos::Qos;
pub(crate) use reader::LARGEST as LARGEST_READ;
pub(crate) use wire::{Guid, Prefix, VENDOR};
pub(crate) use writer::{LARGEST, Outgoing};

use std::net::{Ipv4Addr, SocketAddrV4};

/// Where participants of a domain announce themselves.
pub(crate) const MULTICAST: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// Participants of one machine that static peers are asked for.
pub(crate) const PARTICIPANTS: u16 = 32;

/// Ports of a domain (\[rtps\] 9.6.1): multicast discovery.
pub(crate) fn multicast_address(domain: u16) -> SocketAddrV4 {
    SocketAddrV4::new(MULTICAST, 7400 + 250 * domain)
}

/// Discovery and samples of participant number `index` of a machine.
pub(crate) fn unicast_ports(domain: u16, index: u16) -> (u16, u16) {
    let first = 7400 + 250 * domain + 10 + 2 * index;
    (first, first + 1)
}
