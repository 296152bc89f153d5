//! Lines of values in a TOML text, for refusals.
//!
//! A place is the way to a value from the document's root, by keys and by numbers from 0: `["robot", "1", "mac"]` is `mac` of
//! the second `[[robot]]`, whether it is written below a header, dotted, or in an inline table.
//!
//! ```
//! use csi5300_sim::toml_lines::TomlLines;
//!
//! let lines = TomlLines::new("duration_s = 1.0\n[[robot]]\nname = \"rx\"\n[[robot]]\nfaults.loss = 2.0\n");
//! assert_eq!(lines.line(["robot", "1", "faults", "loss"]), Some(5));
//! assert_eq!(lines.line(["robot", "1", "mac"]), Some(4), "not there: the line of what holds it");
//! assert_eq!(lines.line(["wall"]), None);
//! ```

use toml::de::{DeTable, DeValue};

/// A TOML text with the places of its values.
#[derive(Debug)]
pub struct TomlLines<'t> {
    text: &'t str,
    /// None if the text is no TOML.
    root: Option<DeValue<'t>>,
}

impl<'t> TomlLines<'t> {
    /// Reads a text. One that is no TOML has no places.
    #[must_use]
    pub fn new(text: &'t str) -> Self {
        let root = DeTable::parse(text).ok().map(|document| DeValue::Table(document.into_inner()));
        Self { text, root }
    }

    /// A text without places.
    #[must_use]
    pub fn of_table(text: &'t str, table: DeTable<'t>) -> Self {
        Self { text, root: Some(DeValue::Table(table)) }
    }

    /// The line, from 1, of the innermost part of `place` that the text has; `None` if it has not even the first step, or
    /// `place` is empty.
    ///
    /// A key's line is that of its name; of a table or array, that of its header, or of its opening brace.
    #[must_use]
    pub fn line<'p>(&self, place: impl IntoIterator<Item = &'p str>) -> Option<usize> {
        let mut value = self.root.as_ref()?;
        let mut found = None;
        for step in place {
            let Some((next, start)) = descend(value, step) else { break };
            (value, found) = (next, Some(start));
        }
        found.map(|start| line_of(self.text, start))
    }
}

/// The value one step further in, and the byte offset where it (or its key) begins.
fn descend<'v, 't>(value: &'v DeValue<'t>, step: &str) -> Option<(&'v DeValue<'t>, usize)> {
    match value {
        DeValue::Table(table) => {
            let (name, value) = table.iter().find(|(name, _)| name.get_ref() == step)?;
            let start = match value.get_ref() {
                // A table's span is its header or braces, an array of tables has that of its first.
                DeValue::Table(_) | DeValue::Array(_) => value.span().start,
                _ => name.span().start,
            };
            Some((value.get_ref(), start))
        }
        DeValue::Array(array) => {
            array.get(step.parse::<usize>().ok()?).map(|value| (value.get_ref(), value.span().start))
        }
        _ => None,
    }
}

/// The line, from 1, of a byte offset: of the span in an error of the TOML reader.
#[must_use]
pub fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "a = 1\nb = { c = 2, d = [\n  3,\n  4] }\n[e]\nf.g = 5\n[[h]]\ni = 6\n[[h]]\nj = 7\n";

    #[test]
    fn values_are_found_however_they_are_written() {
        let lines = TomlLines::new(TEXT);
        let cases: [(&[&str], usize); 9] = [
            (&["a"], 1),
            (&["b"], 2),
            (&["b", "c"], 2),
            (&["b", "d", "1"], 4),
            (&["e"], 5),
            (&["e", "f", "g"], 6),
            (&["h", "0"], 7),
            (&["h", "1"], 9),
            (&["h", "1", "j"], 10),
        ];
        for (place, line) in cases {
            assert_eq!(lines.line(place.iter().copied()), Some(line), "{place:?}");
        }
    }

    #[test]
    fn a_missing_key_has_the_line_of_its_table() {
        let lines = TomlLines::new(TEXT);
        assert_eq!(lines.line(["e", "none"]), Some(5));
        assert_eq!(lines.line(["h", "1", "i"]), Some(9));
        assert_eq!(lines.line(["a", "below a number"]), Some(1));
        assert_eq!(lines.line(["none"]), None);
        assert_eq!(lines.line([]), None);
        assert_eq!(TomlLines::new("no TOML = = ").line(["no"]), None);
        assert_eq!((line_of("a\nb\n", 0), line_of("a\nb\n", 2), line_of("a\nb\n", 99)), (1, 2, 3));
    }
}
