//! This machine's side from outside: the connector of the running kernel, a serial port, what runs in the guest of tests/checks/kernel.sh.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;
#[path = "../../../../tests/common/private.rs"]
mod private;

mod connector;
mod kernel;
mod live_bearings;
#[cfg(feature = "serial")]
mod opencr;
mod stock;
