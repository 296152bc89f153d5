//! The robots' network (feature `zenoh`), joined where the configuration has one.

#[cfg(not(feature = "zenoh"))]
#[path = "joined/absent.rs"]
mod network;
#[cfg(feature = "zenoh")]
#[path = "joined/present.rs"]
mod network;

pub(super) use network::Joined;
