//! Judging and showing: captures evaluated against their truth, recordings beside simulations, the experiments of the
//! paper repeated, and pictures of all of them.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod compare;
pub mod evaluate;
#[cfg(feature = "plot")]
pub mod figures;
#[cfg(feature = "plot")]
pub mod gallery;
#[cfg(feature = "plot")]
pub mod plot;
pub mod quality;
pub mod rooms;
pub mod suite;
