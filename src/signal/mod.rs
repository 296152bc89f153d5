//! From CSI to one complex number a packet: the channel's numbers, carrier frequency offset, alignment of sampling times.

pub(crate) mod alignment;
pub mod cfo;
pub mod channel;
pub mod csi;
pub(crate) mod one_way;
pub(crate) mod reciprocity;
pub mod samples;
