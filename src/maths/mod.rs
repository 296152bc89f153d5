//! Mathematics that all other modules use: angles, order statistics, wrapping counters, SIMD tiers.

mod angle;
mod counter;
mod order;

pub use angle::{unwrap_rad, wrap_rad};
pub use counter::unwrap_near;
pub use csi5300_kernels::simd::Tier;
pub use order::{lower_rank, median, nearest_rank, percentile, upper_median, upper_median_ord};
