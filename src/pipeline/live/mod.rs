//! Live bearings: records and poses in, bearings out, with the time as an argument.
//!
//! A node hands over the records of its own and its peers' cards and the poses of both, and gets a bearing of each peer
//! several times a second over the last metres of relative motion. A robot that sounds alone hands over its card's
//! records and the measurements in its peers' answers, and requests bearings.
//!
//! `report` has the values, `track` poses and the stretch of relative motion, `peer` one peer, `heard` bearings of one
//! card with two or three antennas, `estimator` the machine, `links` copies for bearings on request.

mod estimator;
mod heard;
mod links;
mod peer;
mod report;
mod track;

pub use crate::exchange::admission::AdmissionCounts;
pub use crate::place::TrackCounts;
pub use estimator::LiveEstimator;
pub use links::Links;
pub use report::{LivePeer, LiveSettings, PeerCounts, PeerReport, PeerState};
#[doc(hidden)]
pub use track::Track;

#[cfg(test)]
mod one_log;
#[cfg(test)]
mod strangers;
