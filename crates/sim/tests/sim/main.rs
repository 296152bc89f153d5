//! The simulated room from outside.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;

mod ax210;
mod bytes;
