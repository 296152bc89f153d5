//! A ROS 2 node: a DDS participant with the names, types and qualities of service of ROS 2. It has its own RTPS because
//! `rustdds` can neither bind to one address nor query static peers (<https://github.com/Atostek/RustDDS/issues/225>).
//!
//! | module | what it is |
//! |---|---|
//! | `node` | the whole node: [`Node`] |
//! | [`settings`] | the configuration and its checks; which nodes it looks for |
//! | `inputs` | poses from topics |
//! | [`said`] | a peer's report as messages and as markers |
//! | `bag` | recording of what is read and published |
//! | `names` | names of topics, services and types |
//! | [`link`], `sockets` | the protocol on sockets, with a receiving thread; requests and answers |
//! | [`rmw_zenoh`] | the topics for a session of zenoh, beside DDS |
//! | `rtps` | the protocol, without sockets and clocks |
//!
//! [`csi5300_bag`] has the messages and their serialisation.
//!
//! ```no_run
//! use csi5300_bag::messages::PoseStamped;
//! use csi5300_ros2::{Node, Qos, settings::Settings};
//!
//! let node = Node::start(&Settings::default(), "burger", || Some(0))?;
//! let poses = node.link.publish::<PoseStamped>("~/pose", Qos::reliable(10));
//! poses.put(&PoseStamped::default());
//! # Ok::<(), csi5300::source::Error>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

mod bag;
mod inputs;
pub mod link;
mod names;
mod node;
pub mod rmw_zenoh;
mod rtps;
pub mod said;
pub mod settings;
mod sockets;

pub use names::name_part;
pub use node::{Node, Records};
pub use rtps::Qos;
pub use said::colour;

use csi5300::internal::lock;

/// The RTPS fuzz target: other participants take arbitrary steps.
#[cfg(feature = "fuzzed")]
#[doc(hidden)]
pub fn fuzz_rtps(bytes: &[u8]) {
    rtps::fuzzed::run(bytes);
}
