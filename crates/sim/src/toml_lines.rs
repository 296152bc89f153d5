//! Lines of values in a TOML text, for refusals.
//!
//! A place is the way to a value from the document's root: `[Key("robot"), Index(1), Key("mac")]` is `mac` of the second
//! `[[robot]]`, whether it is written below a header, dotted, or in an inline table.
//!
//! ```
//! use csi5300_sim::toml_lines::{Step::{Index, Key}, TomlLines};
//!
//! let lines = TomlLines::new("duration_s = 1.0\n[[robot]]\nname = \"rx\"\n[[robot]]\nfaults.loss = 2.0\n");
//! assert_eq!(lines.line(&[Key("robot"), Index(1), Key("faults"), Key("loss")]), Some(5));
//! assert_eq!(lines.line(&[Key("robot"), Index(1), Key("mac")]), Some(4), "not there: the line of what holds it");
//! assert_eq!(lines.line(&[Key("wall")]), None);
//! ```

use toml::de::{DeTable, DeValue};

/// One step of the way to a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// Into a table, by key.
    Key(&'a str),
    /// Into an array, from 0.
    Index(usize),
}

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
    pub fn line(&self, place: &[Step<'_>]) -> Option<usize> {
        let mut value = self.root.as_ref()?;
        let mut found = None;
        for step in place {
            let Some((next, start)) = descend(value, *step) else { break };
            (value, found) = (next, Some(start));
        }
        found.map(|start| line_of(self.text, start))
    }
}

/// The value one step further in, and the byte offset where it (or its key) begins.
fn descend<'v, 't>(value: &'v DeValue<'t>, step: Step<'_>) -> Option<(&'v DeValue<'t>, usize)> {
    match (value, step) {
        (DeValue::Table(table), Step::Key(key)) => {
            let (name, value) = table.iter().find(|(name, _)| name.get_ref() == key)?;
            let start = match value.get_ref() {
                // A table's span is its header or braces, an array of tables has that of its first.
                DeValue::Table(_) | DeValue::Array(_) => value.span().start,
                _ => name.span().start,
            };
            Some((value.get_ref(), start))
        }
        (DeValue::Array(array), Step::Index(index)) => {
            array.get(index).map(|value| (value.get_ref(), value.span().start))
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
    use super::Step::{Index, Key};
    use super::*;

    const TEXT: &str = "a = 1\nb = { c = 2, d = [\n  3,\n  4] }\n[e]\nf.g = 5\n[[h]]\ni = 6\n[[h]]\nj = 7\n";

    #[test]
    fn values_are_found_however_they_are_written() {
        let lines = TomlLines::new(TEXT);
        let cases: [(&[Step<'_>], usize); 9] = [
            (&[Key("a")], 1),
            (&[Key("b")], 2),
            (&[Key("b"), Key("c")], 2),
            (&[Key("b"), Key("d"), Index(1)], 4),
            (&[Key("e")], 5),
            (&[Key("e"), Key("f"), Key("g")], 6),
            (&[Key("h"), Index(0)], 7),
            (&[Key("h"), Index(1)], 9),
            (&[Key("h"), Index(1), Key("j")], 10),
        ];
        for (place, line) in cases {
            assert_eq!(lines.line(place), Some(line), "{place:?}");
        }
    }

    #[test]
    fn a_missing_key_has_the_line_of_its_table() {
        let lines = TomlLines::new(TEXT);
        assert_eq!(lines.line(&[Key("e"), Key("none")]), Some(5));
        assert_eq!(lines.line(&[Key("h"), Index(1), Key("i")]), Some(9));
        assert_eq!(lines.line(&[Key("a"), Key("below a number")]), Some(1));
        assert_eq!(lines.line(&[Key("none")]), None);
        assert_eq!(lines.line(&[]), None);
        assert_eq!(TomlLines::new("no TOML = = ").line(&[Key("no")]), None);
        assert_eq!((line_of("a\nb\n", 0), line_of("a\nb\n", 2), line_of("a\nb\n", 99)), (1, 2, 3));
    }
}
