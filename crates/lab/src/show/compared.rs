//! A recording and a simulation side by side.

use super::link::track;
use super::{CdfPlot, Error, Format, PhasePlot, PhaseTrack};
use crate::compare::Figures;
use std::path::{Path, PathBuf};

/// Writes the pictures of two captures side by side into a folder: `compare-phase` (the round trip's phase before and after
/// turn-around compensation) and `compare-turn-around` (deviation of answers from their usual time).
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write(recorded: &Figures, simulated: &Figures, folder: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
    let round_trip = |label: &str, figures: &Figures| PhaseTrack {
        before_rad: figures.link.course.iter().map(|phase| phase.round_trip_rad).collect(),
        ..track(label, &figures.link.course)
    };
    let phase = PhasePlot {
        title: "Phase of the round trip at the channel centre".into(),
        before: "both directions multiplied".into(),
        capture: round_trip("recorded", recorded),
        other: Some(round_trip("simulated", simulated)),
        ..PhasePlot::default()
    };
    let late = |label: &str, figures: &Figures| (label.to_owned(), figures.link.late_us.clone());
    let turn_around = CdfPlot {
        title: "Turn-around: distance from the usual".into(),
        x_label: "microseconds".into(),
        series: vec![late("recorded", recorded), late("simulated", simulated)],
        ..CdfPlot::default()
    };
    let [phase_stem, turn_around_stem] = stems(folder);
    let mut written = phase.write(&phase_stem, format)?;
    written.extend(turn_around.write(&turn_around_stem, format)?);
    Ok(written)
}

/// Names of the two pictures, without extensions.
#[must_use]
pub fn stems(folder: &Path) -> [PathBuf; 2] {
    ["compare-phase", "compare-turn-around"].map(|name| folder.join(name))
}
