//! Words that pictures, pages and commands have in common.

/// A count and its noun: `1 number`, `2 numbers`.
#[must_use]
pub fn count(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// What of many is looked at: `one pair in 2`.
#[must_use]
pub fn one_in(every: usize, one: &str) -> String {
    format!("one {one} in {every}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        let said = [0, 1, 2].map(|n| count(n, "stretch", "stretches"));
        assert_eq!(said, ["0 stretches", "1 stretch", "2 stretches"]);
    }
}
