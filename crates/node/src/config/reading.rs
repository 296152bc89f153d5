//! A configuration read with everything that is wrong in it: what cannot be read is taken out, and the rest is read again.

use super::{Config, Problem};
use csi5300_sim::toml_lines::line_of;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Problems said at most: a file with more is another kind of file.
const MOST: usize = 64;
/// What stands for a needed key that is missing or wrong, so that the rest can be read. A configuration with it is refused.
const STAND_INS: &str = "channel = \"108\"\ncapture.card = {}\n";

/// A configuration as far as it can be read.
pub(super) struct Reading<'t> {
    /// None where nothing is left to be checked further.
    pub config: Option<Config>,
    /// What of the text was read.
    pub table: DeTable<'t>,
    pub problems: Vec<Problem>,
    /// Keys of the file's own table of which something could not be read.
    pub gone: BTreeSet<String>,
    /// Those of them in whose place something stands that the file does not have.
    pub stand_ins: BTreeSet<String>,
}

/// Something that was taken out.
struct Cut {
    /// The span of the table that it was in, and its key there.
    within: Range<usize>,
    key: String,
}

impl<'t> Reading<'t> {
    pub fn of(text: &'t str) -> Self {
        let problem = |span: Option<Range<usize>>, reason: &str| Problem {
            line: span.map(|span| line_of(text, span.start)),
            reason: match meant(reason) {
                Some(meant) => format!("{reason}; did you mean `{meant}`?"),
                None => reason.to_owned(),
            },
        };
        let (document, wrong) = DeTable::parse_recoverable(text);
        let (whole, table) = (document.span(), document.into_inner());
        let mut problems: Vec<Problem> = wrong.iter().map(|error| problem(error.span(), error.message())).collect();
        let (gone, stand_ins) = (BTreeSet::new(), BTreeSet::new());
        let mut reading = Self { config: None, table, problems: Vec::new(), gone, stand_ins };
        let mut cuts: Vec<Cut> = Vec::new();
        while problems.is_empty() || (wrong.is_empty() && problems.len() < MOST) {
            let error =
                match Config::deserialize(toml::Deserializer::from(Spanned::new(whole.clone(), reading.table.clone())))
                {
                    Ok(config) => {
                        reading.config = Some(config);
                        break;
                    }
                    Err(error) => error,
                };
            let missing = missing_key(error.message()).map(str::to_owned);
            let span = error.span().unwrap_or(whole.clone());
            // What is missing because it was taken out, or because all of a choice was.
            let is_empty = error.message().starts_with("wanted exactly 1 element");
            let was_cut = |cut: &Cut| cut.within == span && (is_empty || missing.as_ref() == Some(&cut.key));
            if !cuts.iter().any(was_cut) {
                problems.push(problem(error.span(), error.message()));
            }
            match take_out(&mut reading.table, &whole, &span) {
                Some((top, cut)) => {
                    reading.gone.insert(top);
                    cuts.push(cut);
                }
                None if missing.as_deref().is_some_and(|key| reading.stand_in(key)) => {}
                None => break,
            }
        }
        reading.problems = problems;
        reading
    }

    /// Puts a stand-in where a needed key is missing; false if there is none for it.
    fn stand_in(&mut self, key: &str) -> bool {
        let found = DeTable::parse(STAND_INS).ok().and_then(|mut table| table.get_mut().remove_entry(key));
        found.is_some_and(|(name, value)| {
            self.gone.insert(key.to_owned());
            self.stand_ins.insert(key.to_owned());
            self.table.insert(name, value).is_none()
        })
    }
}

/// The known key that an unknown one is nearest to, where one is near: fewer than a third of its letters have to change.
fn meant(message: &str) -> Option<&str> {
    let (field, known) =
        ["unknown field `", "unknown variant `"].iter().find_map(|kind| message.strip_prefix(kind))?.split_once('`')?;
    let known = known.split('`').skip(1).step_by(2);
    let (off, meant) = known.map(|key| (strsim::damerau_levenshtein(field, key), key)).min()?;
    (3 * off <= field.len()).then_some(meant)
}

/// The key that is missing, where that is what an error says.
fn missing_key(message: &str) -> Option<&str> {
    message.strip_prefix("missing field `")?.strip_suffix('`')
}

/// Takes out what an error is of: the value, or the key, of just that span. Gives the key of the outermost table that it is
/// below, too. What is inside goes first: an array of tables has the span of its first one.
fn take_out(table: &mut DeTable<'_>, own: &Range<usize>, span: &Range<usize>) -> Option<(String, Cut)> {
    for (name, value) in table.iter_mut() {
        if let Some((_, cut)) = take_out_below(value, span) {
            return Some((name.get_ref().to_string(), cut));
        }
    }
    let is_it = |name: &Spanned<_>, value: &Spanned<DeValue<'_>>| name.span() == *span || value.span() == *span;
    let found = table.iter().find(|(name, value)| is_it(name, value)).map(|(name, _)| name.get_ref().to_string());
    found.filter(|key| table.remove(key.as_str()).is_some()).map(|key| {
        let cut = Cut { within: own.clone(), key: key.clone() };
        (key, cut)
    })
}

fn take_out_below(value: &mut Spanned<DeValue<'_>>, span: &Range<usize>) -> Option<(String, Cut)> {
    let own = value.span();
    match value.get_mut() {
        DeValue::Table(table) => take_out(table, &own, span),
        DeValue::Array(array) => {
            if let Some(at) = array.iter().position(|item| item.span() == *span) {
                *array = array.iter().enumerate().filter(|(k, _)| *k != at).map(|(_, item)| item.clone()).collect();
                return Some((String::new(), Cut { within: own, key: String::new() }));
            }
            array.iter_mut().find_map(|item| take_out_below(item, span))
        }
        _ => None,
    }
}
