//! Mathematics that all other modules use: angles, order statistics, wrapping counters, SIMD tiers.

mod angle;
mod counter;
mod order;

pub use angle::{unwrap_rad, wrap_rad};
pub(crate) use counter::unwrap_near;
pub(crate) use order::{lower_rank, upper_median, upper_median_ord};
pub use order::{median, nearest_rank, percentile};
