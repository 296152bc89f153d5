//! Sounding, live: the scheduler's state machine ([`csi5300::exchange::tdma`]) on a monitor interface, in a thread of its own.
//!
//! * [`Exchange`] is one robot's side: frames from the air into the machine, frames from the machine into the air, and
//!   figures of what that took. It has no clock of its own.
//! * [`Setup`] opens one: interface, plan, key, session.
//! * [`Running`] is its thread, under SCHED_FIFO and in locked memory if allowed. It waits for frames and absolute
//!   deadlines; estimates cannot delay a slot.
//! * [`Session`] is a complete run with the driver's messages; an [`Observer`] gets records and news, and [`Finished`]
//!   has the result.
//! * [`Products`] takes the card's records and the measurements in the answers, for live bearings computed [`Beside`]
//!   the session.
//! * [`set_rate`] sets the rate of the CSI driver, which ignores radiotap's.

mod beside;
mod error;
mod exchange;
mod figures;
mod mailbox;
mod messages;
mod peer_sessions;
mod products;
mod rate;
mod run;
mod session;
mod setup;
mod thread;
mod watch;

pub use beside::Beside;
pub use error::SoundingError;
pub use exchange::{Exchange, News};
pub use figures::{Figures, KERNEL_TURN_AROUND_US, spread_of};
pub use messages::{DriverMessages, LogTotals};
pub use products::{Products, measurement};
pub use rate::{Rate, rate_n_flags, set_rate};
pub use run::{Finished, Observer, Session};
pub use setup::{Opened, Setup, read_key};
pub use thread::{Granted, NotGranted, Order, Running, Settings};
pub use watch::Notice;

#[cfg(test)]
mod tests;
