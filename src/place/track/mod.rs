//! Where a peer is, from one stretch of motion after another: a filter over its place.
//!
//! A bearing knows one stretch of motion. Where several directions explain it, the next stretch, driven elsewhere, often
//! decides between them: [`PeerTrack`] holds the probability of every place of the peer on a grid over azimuth and the
//! logarithm of the range about the robot, and each stretch does two things to it:
//!
//! * motion: the grid is moved to where the robot is, blurred by what odometry gets wrong over the way driven and by how
//!   far a peer may have gone without odometry of its own; a little of the prior comes back ([`TrackSettings`]);
//! * evidence ([`Evidence`]): the probability of each place is multiplied by `1 - known + known x sum share x N(azimuth)`,
//!   the likelihood of a bearing that is one of its candidates or, with `1 - known`, none of them; with the range where the
//!   wave front's curvature showed one.
//!
//! What this decides: the mirror image of a line, side lobes and products of paths lie elsewhere for every motion. What it
//! decides only in part: a reflection in a flat wall has an image that stands as still as the transmitter. It loses where
//! the robot goes so far that the wall ends, that the straight path is free, or that ranges tell the two apart.
//!
//! [`places`] has no order of time: it takes motions that are all seen in one frame, such as several captures of a room.
//!
//! No clocks and no sockets: times and positions are arguments, and the same evidence gives the same answer. `grid` has
//! the probabilities, `posterior` what is read from them, `evidence` and `settings` the values that go in.

mod evidence;
mod grid;
mod peer_track;
mod places;
mod posterior;
mod settings;
mod spot;
#[cfg(test)]
mod tests;

pub use evidence::{Evidence, EvidenceMode};
pub use peer_track::{PeerTrack, TrackCounts, TrackError};
pub use places::{PeerPlace, PeerPlaces, places};
pub use posterior::{TrackAnswer, TrackMode};
pub use settings::TrackSettings;
