//! Counters of 32 bits that wrap.

/// The value nearest to `expected` whose low 32 bits are `raw`: exact while the truth is within 2^31 counts of `expected`.
#[must_use]
pub fn unwrap_near(expected: i64, raw: u32) -> i64 {
    expected.saturating_add(i64::from(raw.wrapping_sub(expected as u32).cast_signed()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_value_is_taken_on_either_side() {
        let wrap = 1_i64 << 32;
        assert_eq!(unwrap_near(wrap - 5, 3), wrap + 3);
        assert_eq!(unwrap_near(wrap + 3, u32::MAX), wrap - 1);
        assert_eq!(unwrap_near(-2, 1), 1);
    }
}
