//! The suite is tested: every fault of a card is caught by its own claims, and healthy cards are left alone.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod faults;
mod healthy;
mod room;
mod sending;
