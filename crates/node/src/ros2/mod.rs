//! This program as a node of ROS 2: a participant of DDS with the names, types and qualities of service of ROS 2, made
//! here because no library of its kind keeps to loopback and to named peers (docs/ros2.md).
//!
//! | module | what it is |
//! |---|---|
//! | `cdr` | values in the payload of a message |
//! | `messages` | the messages themselves |
//! | `names` | names of topics, services and types |
//! | `rtps` | the protocol, without sockets and clocks |
//! | `sockets`, `link` | the protocol on sockets, with a thread that listens |
//! | `inputs`, `tf` | poses from topics |
//! | `publish` | what is published, and services |
//! | `services` | requests and answers |
//! | `mcap`, `bag` | recordings |
//! | [`unbag`] | logs and trajectories from recordings |
//! | `node` | all of it |

mod bag;
mod cdr;
mod inputs;
mod link;
mod mcap;
mod messages;
pub(crate) mod names;
mod node;
mod publish;
mod rtps;
mod services;
mod sockets;
mod tf;
pub mod unbag;

/// The fuzz target of `rtps`: any steps of others at a participant.
#[cfg(feature = "fuzzed")]
#[doc(hidden)]
pub fn fuzz_rtps(bytes: &[u8]) {
    rtps::fuzzed::run(bytes);
}

pub(crate) use node::Node;
pub(crate) use publish::Ros2;
