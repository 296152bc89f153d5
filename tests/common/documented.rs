//! Compares the fields of JSON that programs print with their documentation.

/// Names of all fields in a value. Keys below `senders` and codes are data, not names.
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

/// What documents fields of JSON, and the requests of the page.
pub fn pages() -> String {
    let read = |path| std::fs::read_to_string(crate::common::root().join(path)).unwrap();
    read("docs/reference/formats.md") + &read("crates/view/src/lib.rs")
}

/// Fails if lines of JSON have a field that [`pages`] do not name; returns the number of fields.
pub fn are_documented(lines: &str) -> usize {
    let page = pages();
    let mut found = std::collections::BTreeSet::new();
    lines.lines().for_each(|line| {
        names(&serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")), &mut found)
    });
    let missing: Vec<&String> = found.iter().filter(|name| !page.contains(&format!("`{name}`"))).collect();
    assert!(missing.is_empty(), "docs/reference/formats.md and crates/view/src/lib.rs do not name {missing:?}");
    found.len()
}
