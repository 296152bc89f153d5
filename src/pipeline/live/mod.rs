//! Live bearings: records and poses as they come in, bearings out, with the time as an argument.
//!
//! A robot's node hands over what its own card, its peers' cards and both odometries give, and gets a bearing of each
//! peer several times a second over the last metres of relative motion. A robot that sounds alone hands over its own card's
//! records and the measurements in its peers' answers, and asks for bearings when it wants them.
//!
//! `report` has the values, `track` poses as they come and the stretch of relative motion, `peer` one peer, `heard` bearings of
//! one card with two or three antennas, `estimator` the machine, `links` what bearings are made of when they are asked for.

mod estimator;
mod heard;
mod links;
mod peer;
mod report;
mod track;

pub use crate::exchange::admission::AdmissionCounts;
pub use crate::place::track::TrackCounts;
pub use estimator::LiveEstimator;
pub use links::Links;
pub use report::{LivePeer, LiveSettings, PeerCounts, PeerReport, PeerState};
#[doc(hidden)]
pub use track::Track;

#[cfg(test)]
mod one_log;
#[cfg(test)]
mod strangers;
