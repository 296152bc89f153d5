//! The steps computed and skipped for a link, and why: a value that prints.

use super::bearing::Bearing;
use super::options::Options;
use crate::bartlett::{self, ElevationSearch, Explanation, Grid, Planner, ProfileOptions, SearchPlan};
use crate::estimate::signal::is_dense_enough;
use crate::estimate::{Risk, Sufficient};
use crate::signal::channel::SUBCARRIERS;
use serde::Serialize;
use std::fmt;

/// The plan of one link.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkPlan {
    /// The part of each record that was unpacked.
    pub decoded: String,
    /// The steps before and after the search.
    pub steps: Vec<StepPlan>,
    /// The search for a plane wave.
    pub search: SearchPlan,
    /// The profile over the requested grid.
    pub profile: Explanation,
}

/// One step, taken or not.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StepPlan {
    /// Its name.
    pub step: &'static str,
    /// Whether it was taken.
    pub taken: bool,
    /// Its subject, or why it was skipped.
    pub why: String,
    /// For a skipped step: by how much it might have moved the azimuth, degrees.
    pub risk_deg: Option<f64>,
}

impl LinkPlan {
    /// The plan behind `bearing`, and that of its profile over `grid`.
    ///
    /// # Errors
    /// As [`bartlett::profile`].
    pub fn of(bearing: &Bearing, options: &Options, grid: &Grid) -> Result<Self, bartlett::Error> {
        let profile = Planner::default().explain(&bearing.samples, grid, &ProfileOptions::default())?;
        let decoded = format!(
            "antenna {}, first stream, {SUBCARRIERS} subcarriers (the channel centre is a line fitted through all of them); \
             other antennas and streams stay packed",
            options.antenna
        );
        Ok(Self { decoded, steps: steps(bearing, options), search: bearing.plane_wave.plan, profile })
    }
}

/// The steps of one link in words.
fn steps(bearing: &Bearing, options: &Options) -> Vec<StepPlan> {
    let pairs = &bearing.pairs;
    let step = |step, taken, why: String| StepPlan { step, taken, why, risk_deg: None };
    let standing = format!("{} of {} pairs; a pair at rest adds nothing to a bearing", pairs.standing, pairs.formed);
    let mut steps = vec![
        step("turn-around compensation", bearing.compensated, turn_around(bearing, options)),
        step("pairs at rest", false, standing),
        step("elevation of the plane wave", bearing.plane_wave.elevation_searched, elevation(bearing)),
    ];
    let spacing = bearing.samples.spacing_m() / options.channel.wavelength_m();
    let windowed = |name, asked: bool, taken: bool, words: &str, not: String| match bearing.sufficient {
        Sufficient::OneWave(Risk { risk_rad }) => StepPlan {
            step: name,
            taken: false,
            why: "one wave leaves nothing but noise".into(),
            risk_deg: Some(risk_rad.to_degrees()),
        },
        Sufficient::Posterior(_) if !asked => step(name, false, "skipped as asked".into()),
        Sufficient::Posterior(_) => step(name, taken, if taken { words.into() } else { not }),
    };
    let accuracy = &options.accuracy;
    let aligned = bearing.slope_sd_rad.is_some();
    let (taken, why) = match bearing.sufficient {
        Sufficient::OneWave(Risk { risk_rad }) => (
            true,
            format!(
                "it leaves nothing but noise, which hides no wave that moves the azimuth by more than {:.3} degrees",
                risk_rad.to_degrees()
            ),
        ),
        Sufficient::Posterior(reason) => (false, reason.to_string()),
    };
    steps.push(step("one wave at the channel centre", taken, why));
    steps.push(windowed(
        "sampling-time alignment",
        accuracy.align,
        aligned,
        "slopes between packets removed",
        "there is one subcarrier".into(),
    ));
    let far = format!("packets are {spacing:.2} wavelengths apart: from 0.25 on the signs of the roots are ambiguous");
    let dense = is_dense_enough(spacing);
    steps.push(windowed("one-way channel", accuracy.one_way, dense, "the root of the round trip, beside it", far));
    steps.push(windowed(
        "windows along the motion",
        true,
        true,
        "the likelihood averaged over the whole motion, halves, quarters and eighths",
        String::new(),
    ));
    steps
}

fn turn_around(bearing: &Bearing, options: &Options) -> String {
    match (&bearing.turn_around, options.compensate) {
        (_, false) => "skipped as asked".into(),
        (None, _) => "too few pairs, or clocks that no two cards have".into(),
        (Some(found), _) if bearing.compensated => format!("{:.0} Hz times the jitter of the turn-around", found.df_hz),
        (Some(_), _) => "the phase would not be steadier".into(),
    }
}

fn elevation(bearing: &Bearing) -> String {
    let plan = &bearing.plane_wave.plan;
    match plan.elevation {
        ElevationSearch::Searched => format!("{} rings", plan.rings),
        ElevationSearch::NotObservable => "the samples constrain it less than its limits".into(),
        ElevationSearch::NotAsked => "skipped as asked".into(),
    }
}

impl fmt::Display for LinkPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  decoded: {}", self.decoded)?;
        for StepPlan { step, taken, why, risk_deg } in &self.steps {
            write!(f, "  {step}: {}, {why}", if *taken { "taken" } else { "skipped" })?;
            writeln!(f, "{}", risk_deg.map_or(String::new(), |deg| format!(", risks {deg:.3} degrees")))?;
        }
        let indented = format!("{}profile, where one is written: {}", self.search, self.profile);
        indented.lines().try_for_each(|line| writeln!(f, "  {line}"))
    }
}
