//! Accuracy on places that nothing was fitted to: leave one place out.
//!
//! A place is a set and a folder of it (`LOS_Set_A/L1`); captures of one place are near copies of each other, so it is
//! the unit of everything here. Every link is estimated by motion capture, by the tracking camera as recorded and held to what
//! wheels can roll, and by wheel odometry, over the whole motion, its halves and its quarters ([`gather`]). For each place, whatever is fitted is fitted to all others
//! and then judged on this one; errors come with intervals from a bootstrap over places (\[efron-tibshirani1993\] in
//! docs/references.md). The same captures give the same digits.
//!
//! [`report`] has one [`ErrorColumn`] for each trajectory, length of motion, kind of answer and group of links (in line
//! of sight, without, each set), one [`ConfidenceColumn`] for each trajectory, length and kind, and one
//! [`ErrorBarColumn`] and [`RefusalColumn`] for each of them in line of sight, without, and together.

mod bootstrap;
mod confidence;
mod error_bar;
mod gather;
mod paths;
mod report;
mod robot;

pub use bootstrap::Interval;
pub use confidence::{ConfidenceColumn, RefusalColumn, labelled};
pub use error_bar::{ErrorBarColumn, error_rows};
pub use gather::{Answered, FoldRow, Kind, gather, set_and_place};
pub use paths::PathColumn;
pub use report::{CameraMount, ErrorColumn, Report, Which, report};

#[cfg(test)]
mod tests;
