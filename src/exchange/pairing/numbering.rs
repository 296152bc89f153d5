//! The first frame number of each initiator.

/// The number before an initiator's first: robots count from places as far from each other as 31 bits allow, by their
/// `rank` among the `robots` of the exchange, so that the counts of two initiators in one log never meet.
///
/// The first robot starts with 1, like WSR's sender. Two robots are 2^30 numbers apart, 12 days at 1,000 a second.
#[must_use]
pub fn before_first_number(rank: u16, robots: usize) -> u32 {
    let apart = (1u32 << 31) / u32::try_from(robots.max(1)).unwrap_or(u32::MAX);
    u32::from(rank).wrapping_mul(apart)
}
