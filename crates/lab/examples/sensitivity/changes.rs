//! Every tuned number at half and at double.

use crate::Fallible;
use csi5300::internal::chosen_tuning_json;
use serde_json::{Value, json};

/// One number changed.
pub struct Change {
    /// `group.field half`, or `unchanged 0`.
    pub name: String,
    /// `group.field`.
    pub field: String,
    /// What the environment says of it.
    pub json: String,
}

impl Change {
    /// No change, for the `k`-th time.
    pub fn none(k: usize) -> Self {
        Self { name: format!("unchanged {k}"), field: String::new(), json: "{}".into() }
    }
}

/// All changes of all numbers, in the order of the source.
pub fn changes() -> Fallible<Vec<Change>> {
    let chosen: Value = serde_json::from_str(&chosen_tuning_json()?)?;
    let mut changes = Vec::new();
    for (group, fields) in chosen.as_object().ok_or("the numbers are no object")? {
        for (field, value) in fields.as_object().ok_or("a group is no object")? {
            for (by, factor) in [("half", 0.5), ("double", 2.0)] {
                let name = format!("{group}.{field}");
                let value = changed(&name, value, factor);
                let json = json!({ group: { field: value } }).to_string();
                changes.push(Change { name: format!("{name} {by}"), field: name, json });
            }
        }
    }
    Ok(changes)
}

/// A value times `factor`: counts rounded and at least 1, of an array every element. Scales of a trajectory move towards
/// or away from 1, and limits of a probability towards or away from 0 and 1.
fn changed(name: &str, value: &Value, factor: f64) -> Value {
    let times = |value: &Value, from: f64| match value.as_i64() {
        Some(count) => json!(((count as f64 * factor).round() as i64).max(1)),
        None => json!(from + (value.as_f64().unwrap_or(f64::NAN) - from) * factor),
    };
    match (name, value) {
        ("focus.scales", Value::Array(all)) => all.iter().map(|value| times(value, 1.0)).collect(),
        ("certainty.limits", Value::Array(all)) => {
            all.iter().zip([0.0, 1.0]).map(|(value, end)| times(value, end)).collect()
        }
        (_, Value::Array(all)) => all.iter().map(|value| times(value, 0.0)).collect(),
        _ => times(value, 0.0),
    }
}
