//! From CSI to one complex number a packet: the channel's numbers, carrier frequency offset, rows of subcarriers.

pub mod cfo;
pub mod channel;
pub mod csi;
pub(crate) mod planes;
pub mod samples;
