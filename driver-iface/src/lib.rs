//! The contract with the kernel driver: every byte that crosses the kernel or file boundary, and nothing else.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

#[cfg(test)]
extern crate std;

pub mod bfee;
pub mod connector;
pub mod mpdu;
pub mod radiotap;
pub mod record;
pub mod sounding;
