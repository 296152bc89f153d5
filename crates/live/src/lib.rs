//! The operating system's side: the Intel 5300 on this machine, live.
//!
//! | module | what it is |
//! |---|---|
//! | [`netlink`] | the driver's records from the kernel's connector: a [`CsiSource`](csi5300::source::CsiSource) |
//! | [`monitor`] | frames injected into and heard from a monitor interface |
//! | [`sounding`] | the scheduler on that interface, in a thread of its own |
//! | [`doctor`] | what stands between this machine and a first record |
//! | `serial` | the TurtleBot3's controller on its serial port (feature `serial`) |
//! | [`status`] | a running capture in words |
//! | [`wait`] | the clocks of this machine, and waiting on them |
//! | [`sys`] | calls that no crate offers: all `unsafe` of the project |
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod doctor;
pub mod monitor;
pub mod netlink;
#[cfg(feature = "serial")]
pub mod serial;
pub mod sounding;
pub mod status;
pub mod sys;
pub mod wait;
