//! Sentences written into the declaration of the numbers.

use std::collections::BTreeMap;

/// What stands before a remark that is not measured by this program, and that it leaves as it is.
const REMARK: &str = "; also: ";

/// The source with the last text of each field replaced by its sentence. A field is a line
/// `name: type = value, "origin", "sensitivity";` of a group, which begins with `group: Type, "command" {`.
pub fn with_sentences(source: &str, sentences: &BTreeMap<String, String>) -> String {
    let mut group = "";
    let mut lines = Vec::new();
    for line in source.lines() {
        let (name, rest) = line.trim().split_once(": ").unwrap_or_default();
        if rest.ends_with("\" {") {
            group = name;
        }
        let replaced = sentences.get(&format!("{group}.{name}")).and_then(|sentence| with_sentence(line, sentence));
        lines.push(replaced.unwrap_or_else(|| line.to_owned()));
    }
    lines.join("\n") + "\n"
}

fn with_sentence(line: &str, sentence: &str) -> Option<String> {
    let (before, last) = line.strip_suffix("\";")?.rsplit_once(", \"")?;
    let remark = last.split_once(REMARK).map_or_else(String::new, |(_, remark)| format!("{REMARK}{remark}"));
    Some(format!("{before}, \"{sentence}{remark}\";"))
}
