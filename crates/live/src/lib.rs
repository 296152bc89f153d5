//! The operating system's side: the Intel 5300 on this machine, live.
//!
//! | module | what it is |
//! |---|---|
//! | [`listener`] | where records come from: `netlink` or `stock`, as one type |
//! | [`logged`] | a source with a log, or without |
//! | [`netlink`] | the driver's records from the kernel's connector: a [`CsiSource`](csi5300::source::CsiSource) |
//! | [`feitcsi`] | an AX200's or AX210's records, from FeitCSI's UDP socket or its standard output |
//! | [`monitor`] | frames injected into and heard from a monitor interface |
//! | [`sounding`] | the scheduler on that interface, in a thread of its own |
//! | [`doctor`] | checks of everything that a first record needs, and the card's set-up |
//! | `serial` | the TurtleBot3's controller on its serial port (feature `serial`) |
//! | `stock` | the same records under the kernel's own driver, by an eBPF program (feature `stock`) |
//! | [`status`] | a running capture in words |
//! | [`wait`] | the clocks of this machine, and waiting on them |
//! | [`sys`] | calls that no crate offers: all `unsafe` of the project |
//!
//! # Listen
//!
//! Prints every record of this machine's card with its host time; needs CAP_NET_ADMIN.
//!
//! ```no_run
//! use csi5300::source::{CsiSource, Next};
//! use csi5300_live::{netlink::{Netlink, Options}, wait::Monotonic};
//! use std::os::fd::AsFd;
//!
//! let (mut card, clock) = (Netlink::open(&Options::default())?, Monotonic::new());
//! loop {
//!     match card.receive(clock.now())? {
//!         Next::Record(stamps, record) => println!("{:?} us: {} bytes", stamps.host_us, record.body.len()),
//!         Next::Lost(loss) => eprintln!("{loss:?}"),
//!         Next::Pending => drop(clock.wait([card.as_fd()], None)?),
//!         Next::End(_) => break,
//!     }
//! }
//! # Ok::<(), csi5300::source::Error>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod doctor;
pub mod feitcsi;
pub mod listener;
pub mod logged;
pub mod monitor;
pub mod netlink;
#[cfg(feature = "serial")]
pub mod serial;
pub mod sounding;
pub mod status;
pub mod stock;
pub mod sys;
pub mod wait;

use csi5300::internal::refused;
