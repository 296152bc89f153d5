//! Compares bearings with the truth, over a tree of captures laid out as the WSR data set.
//!
//! A capture is a folder with `groundtruth_positions.json` and, for each time stamp TS in it, `csi_rx_TS.dat`, one
//! `csi_txK_TS.dat` for each transmitter, and the receiver's trajectory as `rx_trajectory_TS_.csv` (motion capture),
//! `t265_rx_trajectory_TS_.csv` or `odom_rx_trajectory_TS_.csv`. Folders may be nested in any way. Without the first file, the
//! rest is a capture without a truth. It may also have the names of \[paper\] (docs/reference/references.md):
//! `csi_tx_TS.dat`, `rx_movement_TS.csv`. A folder without such names is one capture without a truth if its files' content
//! shows their roles ([`captures`]).
//!
//! [`find`] lists captures, [`find_all`] also those without a truth. [`Capture::evaluate`] makes a row for each link
//! ([`Judged`]). [`summarise`] gives the errors by set, and
//! [`quality`] figures about ranges and error bars. [`receivers`] locates receivers, [`transmitters`] locates transmitters from
//! several captures in one frame.
//! [`reliability`] and [`surest`] evaluate probabilities.

pub mod captures;
mod judge;
pub mod quality;
pub mod receivers;
pub mod transmitters;

pub use captures::{Capture, Loose, TRUTH_FILE, TrajectorySource, channel_in, find, find_all};
pub use judge::{Evaluated, Judged, Look};
pub use quality::{ALL_SETS, Errors, Kept, Reliability, SetSummary, Sure, WRONG_DEG, reliability, summarise, surest};
