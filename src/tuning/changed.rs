//! [`TUNING`](super::TUNING) with changes from the environment (feature `tunable`), to measure what each number does.

use super::values::{CHOSEN, Tuning};

/// The environment variable with the changes: JSON of the groups and fields that differ from what was chosen,
/// `{"views": {"inner_windows": 3}}`.
pub const VARIABLE: &str = "CSI5300_TUNING";

/// The numbers as chosen, as JSON: an object of groups, each an object of fields.
///
/// # Errors
/// None of these numbers is one that JSON cannot hold.
pub fn chosen_json() -> Result<String, serde_json::Error> {
    serde_json::to_string(&CHOSEN)
}

/// The numbers with the changes of [`VARIABLE`]. Changes that are none end the process with exit code 2: a measurement
/// of other numbers than those that were asked for would be worth nothing.
pub(super) fn read() -> Tuning {
    let Some(text) = std::env::var_os(VARIABLE) else { return CHOSEN };
    parse(&text.to_string_lossy()).unwrap_or_else(|error| {
        eprintln!("{VARIABLE}: {error}");
        std::process::exit(2)
    })
}

/// The chosen numbers with these changes.
fn parse(text: &str) -> Result<Tuning, serde_json::Error> {
    serde_json::from_str(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_named_changes_and_nothing_else() {
        let changed = parse(r#"{"views": {"inner_windows": 3}, "focus": {"scales": [0.9, 0.95, 1.05, 1.1]}}"#).unwrap();
        let mut expected = CHOSEN;
        expected.views.inner_windows = 3;
        expected.focus.scales = [0.9, 0.95, 1.05, 1.1];
        assert_eq!(changed, expected);
        assert_eq!(parse("{}").unwrap(), CHOSEN);
        assert_eq!(parse(&chosen_json().unwrap()).unwrap(), CHOSEN);
    }

    #[test]
    fn changes_that_are_none_say_which() {
        let refused = |text: &str, part: &str| {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        };
        refused(r#"{"view": {}}"#, "unknown field `view`");
        refused(r#"{"views": {"windows": 3}}"#, "unknown field `windows`");
        refused(r#"{"views": {"inner_windows": -1}}"#, "invalid value: integer `-1`, expected usize");
        refused(r#"{"views": {"inner_windows": "3"}}"#, "invalid type: string");
        refused(r#"{"focus": {"scales": [1.0]}}"#, "invalid length 1");
    }
}
