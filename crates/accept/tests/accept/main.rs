//! Tests of the suite: every fault is caught by its own claims, and healthy cards fail none.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod faults;
mod healthy;
mod room;
mod sending;
