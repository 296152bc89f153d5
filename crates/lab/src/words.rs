//! Words that pictures, pages and commands have in common.

/// A count and its noun: `1 number`, `2 numbers`.
#[must_use]
pub fn count(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// A number with so many digits behind its point; what rounds to zero has no sign.
#[must_use]
pub fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(size) if size.bytes().all(|byte| matches!(byte, b'0' | b'.')) => size.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        let said = [0, 1, 2].map(|n| count(n, "stretch", "stretches"));
        assert_eq!(said, ["0 stretches", "1 stretch", "2 stretches"]);
    }

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!([-1e-17, -0.0, -0.004, 0.0].map(|value| fixed(value, 2)), ["0.00"; 4]);
        assert_eq!([-0.006, -1.0, 12.345].map(|value| fixed(value, 2)), ["-0.01", "-1.00", "12.35"]);
        assert_eq!([-0.4, -0.6].map(|value| fixed(value, 0)), ["0", "-1"]);
        assert_eq!([f64::NAN, f64::NEG_INFINITY].map(|value| fixed(value, 1)), ["NaN", "-inf"]);
    }
}
