//! The scheduler on a virtual air.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod air;
mod faults;
mod golden;
mod hostile;
mod rounds;
mod wsr;
