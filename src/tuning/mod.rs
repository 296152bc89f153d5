//! Every number that was chosen, fitted or measured rather than derived or standardised: [`TUNING`].
//!
//! Each field states its value, where it comes from, what happens at half and at double where that was measured, and each
//! group the command that shows what a change does. Physical constants, protocol constants, sizes of buffers and
//! tolerances of numerics (which tests hold to the plain sum) are not here. `docs/tuning.md` has the same table; a test
//! compares the two.
//!
//! A value is changed by editing it and running the group's command. Only with the feature `tunable`, which is for measuring
//! what they do, can values change without a build: `changed`.

#[cfg(feature = "tunable")]
mod changed;
#[macro_use]
mod declare;
mod values;

pub(crate) use values::DeviationTuning;

#[cfg(feature = "tunable")]
pub use changed::{VARIABLE, chosen_json};

/// The values in use.
#[cfg(not(feature = "tunable"))]
pub(crate) const TUNING: values::Tuning = values::CHOSEN;

/// The values in use.
#[cfg(feature = "tunable")]
pub(crate) static TUNING: std::sync::LazyLock<values::Tuning> = std::sync::LazyLock::new(changed::read);

/// One number of [`TUNING`], as text.
#[cfg(test)]
struct TuningEntry {
    /// `group.field`.
    pub name: String,
    /// Its value.
    pub value: String,
    /// Where it comes from.
    pub origin: &'static str,
    /// What happens at half and at double.
    pub sensitivity: &'static str,
    /// The command that shows what a change does.
    pub command: &'static str,
}

/// The table of `docs/tuning.md`: a heading and the command of each group, and a row for each of its numbers.
#[cfg(test)]
fn markdown() -> String {
    let mut text = String::new();
    let mut group = "";
    let entries = values::entries();
    for entry in &entries {
        let (own, field) = entry.name.split_once('.').unwrap_or(("", &entry.name));
        if own != group {
            group = own;
            text += &format!("\n### {own}\n\n`{}`\n\n", entry.command);
            text += "| field | value | origin | at half and at double |\n|---|---|---|---|\n";
        }
        text += &format!("| `{field}` | {} | {} | {} |\n", entry.value, entry.origin, entry.sensitivity);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_the_same_table() {
        let document = include_str!("../../docs/tuning.md");
        let table = markdown();
        assert!(document.contains(&table), "docs/tuning.md should contain\n{table}");
    }

    #[test]
    fn round_trip_and_one_way_channel_weigh_the_same() {
        let views = TUNING.views;
        let difference = views.round_trip_weight + views.centre_weight - 3.0 * views.one_way_weight;
        assert!(difference.abs() < 1e-12, "{difference}");
    }
}
