//! Bearings over the time driven: each stretch of a motion by itself, what `PeerTrack`
//! carries from stretch to stretch, and the whole motion so far at once.
//!
//! [`gather`] cuts motions into stretches and estimates each, [`Drive::carried`] replays a drive through a filter,
//! [`report`] has the errors by group and by how much was driven.

mod gather;
mod report;
#[cfg(test)]
mod tests;

pub use gather::{Carried, Drive, Seen, StretchRow, gather};
pub use report::{Column, Point, Report, report};
