//! The experiments of Dijkstra et al. (\[paper\] in docs/references.md) as it draws them: the phase of each before and after
//! the offset is cancelled, and profiles over azimuth averaged over the repetitions.

use super::link::track;
use super::{Error, Format, PhasePlot, PhaseTrack, ProfilePlot, file_safe};
use crate::suite::{Run, Standing, profile_azimuth_rad};
use std::path::{Path, PathBuf};

/// Single repetitions drawn beside the average.
const SINGLES: usize = 5;
/// Pairs of robots that stand whose phases are averaged before they are unwrapped.
const STANDING: usize = 25;

/// Writes `NAME-phase` (the first repetition) and, where the robot moved, `NAME-profile` for each experiment.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write(runs: &[Run], folder: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
    let mut written = Vec::new();
    for own in runs.chunk_by(|a, b| a.experiment == b.experiment) {
        let Some(first) = own.first() else { continue };
        let [phase_stem, profile_stem] = stems(&first.experiment, folder);
        if !first.course.is_empty() {
            written.extend(phase(first).write(&phase_stem, format)?);
        }
        if !first.profile.is_empty() {
            written.extend(averaged(own).write(&profile_stem, format)?);
        }
    }
    Ok(written)
}

/// What the pictures of an experiment are called, without their endings.
#[must_use]
pub fn stems(experiment: &str, folder: &Path) -> [PathBuf; 2] {
    ["phase", "profile"].map(|what| folder.join(format!("{}-{what}", file_safe(experiment))))
}

/// The phase of two robots that stand.
#[must_use]
pub fn standing(standing: &Standing) -> PhasePlot {
    let product_rad = standing.course.iter().map(|phase| phase.round_trip_rad).collect();
    let spread = format!(
        "from packet to packet: {:.2} rad, {:.2} rad, {:.2} rad",
        standing.spread_one_way_rad, standing.spread_rad, standing.spread_compensated_rad
    );
    PhasePlot {
        title: "Two robots that stand: phase at the channel centre".into(),
        before: "one direction".into(),
        capture: PhaseTrack { product_rad, ..track(&spread, &standing.course) },
        averaged: STANDING,
        ..PhasePlot::default()
    }
}

fn phase(run: &Run) -> PhasePlot {
    let spread = format!(
        "spread from packet to packet {:.2} rad, {:.2} rad with the turn-around taken out",
        run.residual_rad, run.residual_compensated_rad
    );
    let product_rad = run.course.iter().map(|phase| phase.round_trip_rad).collect();
    PhasePlot {
        title: format!("{}: phase at the channel centre", run.experiment),
        before: "one direction".into(),
        capture: PhaseTrack { product_rad, ..track(&spread, &run.course) },
        averaged: if run.profile.is_empty() { STANDING } else { 0 },
        ..PhasePlot::default()
    }
}

/// The mean of the repetitions' profiles, each relative to its highest.
fn averaged(runs: &[Run]) -> ProfilePlot {
    let azimuths: Vec<f64> = (0..runs[0].profile.len()).map(|k| profile_azimuth_rad(k).to_degrees()).collect();
    let with: Vec<&Run> = runs.iter().filter(|run| run.profile.len() == azimuths.len()).collect();
    let mean = |k: usize| with.iter().map(|run| run.profile[k]).sum::<f64>() / with.len() as f64;
    let name = |k: usize| if k == 0 { "single repetitions".to_owned() } else { String::new() };
    let singles = with.iter().take(SINGLES).filter(|_| with.len() > 1).enumerate();
    let (errors, truth_deg): (Vec<f64>, _) = (with.iter().filter_map(|run| run.error_deg).collect(), runs[0].truth_deg);
    let largest = errors.iter().fold(0.0_f64, |most, error| most.max(error.abs()));
    ProfilePlot {
        title: format!(
            "{}: {}, largest error {largest:.2}°",
            runs[0].experiment,
            crate::words::count(runs.len() as u64, "repetition", "repetitions")
        ),
        chosen_from: ("average of the repetitions".into(), azimuths.clone(), (0..azimuths.len()).map(mean).collect()),
        others: singles.map(|(k, run)| (name(k), azimuths.clone(), run.profile.clone())).collect(),
        truth_deg,
        mirror_deg: truth_deg.filter(|_| runs.iter().any(|run| run.mirror_deg.is_some())).and(runs[0].mirror_deg),
        ..ProfilePlot::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::pipeline::Phase;
    use csi5300::signal::cfo::TurnAround;
    use num_complex::Complex64;

    #[test]
    fn of_robots_that_stand_more_phases_are_averaged_than_of_those_that_move() {
        let phase = |k: usize| Phase {
            t_s: k as f64,
            one_way_rad: 0.0,
            round_trip_rad: 0.0,
            compensated_rad: 0.0,
            is_used: true,
        };
        let course: Vec<Phase> = (0..40).map(phase).collect();
        let clock_us: Vec<i64> = (0..40).map(|k| 10_000 * k).collect();
        let turn_around = TurnAround::estimate(&[Complex64::ONE; 40], &clock_us, &[7; 40], 5.54e9).unwrap();
        let (spread_one_way_rad, spread_rad, spread_compensated_rad) = (1.0, 0.5, 0.2);
        let stood = Standing { course, turn_around, spread_one_way_rad, spread_rad, spread_compensated_rad };
        assert_eq!(standing(&stood).averaged, STANDING);
        assert_eq!(phase_of(false).averaged, STANDING);
        assert_eq!(phase_of(true).averaged, 0);
    }

    /// The phase of an experiment in which the robot moved, or stood.
    fn phase_of(moved: bool) -> PhasePlot {
        phase(&Run { profile: if moved { vec![1.0] } else { Vec::new() }, ..Run::default() })
    }
}
