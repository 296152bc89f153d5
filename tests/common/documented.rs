//! The fields of JSON that programs print, against what documents them.

/// Names of fields within a value, of objects in it too; `senders` and codes have names of their own making.
fn names(value: &serde_json::Value, found: &mut std::collections::BTreeSet<String>) {
    match value {
        serde_json::Value::Array(values) => values.iter().for_each(|value| names(value, found)),
        serde_json::Value::Object(fields) => {
            for (name, value) in fields {
                found.insert(name.clone());
                match name.as_str() {
                    // Keyed by what they are of.
                    "senders" | "summary" if value.is_object() => {
                        value.as_object().unwrap().values().for_each(|sender| names(sender, found))
                    }
                    // Keyed by what was found; and what is described in place.
                    "by_code" | "cards" | "shapes" | "rates" | "antenna_sel" | "focus" | "plan" | "losses" | "rssi"
                    | "agc" | "noise_dbm" => {}
                    _ => names(value, found),
                }
            }
        }
        _ => {}
    }
}

/// Fails where lines of JSON have a field that docs/reference/formats.md does not name; gives how many fields they have.
pub fn are_documented(lines: &str) -> usize {
    let page = std::fs::read_to_string(crate::common::root().join("docs/reference/formats.md")).unwrap();
    let mut found = std::collections::BTreeSet::new();
    lines.lines().for_each(|line| {
        names(&serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")), &mut found)
    });
    let missing: Vec<&String> = found.iter().filter(|name| !page.contains(&format!("`{name}`"))).collect();
    assert!(missing.is_empty(), "docs/reference/formats.md does not name {missing:?}");
    found.len()
}
