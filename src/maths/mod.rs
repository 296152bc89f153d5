//! Mathematics that all other modules use: angles, order statistics, wrapping counters, SIMD tiers.

/// Standard deviation of an azimuth about which nothing is known, radians: `pi / sqrt 3`.
pub const UNIFORM_RAD: f64 = 1.813_799_364_234_217_8;

mod angle;
mod counter;
mod order;

pub use angle::{unwrap_rad, wrap_rad};
pub(crate) use counter::unwrap_near;
pub(crate) use order::{lower_rank, upper_median, upper_median_ord};
pub use order::{median, nearest_rank, percentile};
