//! What was computed for a link, and what was left out and why: a value that prints.

use super::bearing::Bearing;
use super::options::Options;
use crate::bartlett::{self, Explanation, Grid, Planner, ProfileOptions, SearchPlan};
use crate::signal::channel::SUBCARRIERS;
use serde::Serialize;
use std::fmt;

/// The plan of one link.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkPlan {
    /// What of each record was unpacked.
    pub decoded: String,
    /// The steps before and after the search.
    pub steps: Vec<StepPlan>,
    /// The search for a plane wave.
    pub search: SearchPlan,
    /// The profile over the grid that was asked for.
    pub profile: Explanation,
}

/// One step, taken or not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepPlan {
    /// Its name.
    pub step: &'static str,
    /// Whether it was taken.
    pub taken: bool,
    /// What it was about, or why it was not taken.
    pub why: String,
}

impl LinkPlan {
    /// The plan behind `bearing`, and that of its profile over `grid`.
    ///
    /// # Errors
    /// As [`Planner::plan`].
    pub fn of(bearing: &Bearing, options: &Options, grid: &Grid) -> Result<Self, bartlett::Error> {
        let plan = Planner::default().plan(&bearing.samples, grid, &ProfileOptions::default())?;
        let decoded = format!(
            "antenna {:?}, first stream, {SUBCARRIERS} subcarriers (the channel centre is a line fitted through all of them); \
             other antennas and streams stay packed",
            options.antenna
        );
        Ok(Self {
            decoded,
            steps: steps(bearing, options),
            search: bearing.plane_wave.plan,
            profile: plan.explain().clone(),
        })
    }
}

fn steps(bearing: &Bearing, options: &Options) -> Vec<StepPlan> {
    let step = |step, taken, why: String| StepPlan { step, taken, why };
    let accuracy = &options.accuracy;
    let turn_around = match (&bearing.turn_around, options.compensate) {
        (_, false) => "left out as asked".into(),
        (None, _) => "too few pairs, or clocks that no two cards have".into(),
        (Some(found), _) if bearing.compensated => format!("{:.0} Hz times the jitter of the turn-around", found.df_hz),
        (Some(_), _) => "the phase gets no steadier by it".into(),
    };
    let pairs = &bearing.pairs;
    let standing = format!("{} of {} pairs; one at rest adds nothing to a bearing", pairs.standing, pairs.formed);
    let placed = bearing.placed.as_ref();
    let beyond = |asked: bool, taken: &str| match (accuracy.near_field, asked, placed.is_some()) {
        (false, ..) => String::from("belongs to spherical waves, which were left out as asked"),
        (_, false, _) => "left out as asked".into(),
        (_, _, false) => "there was no peak to place".into(),
        _ => taken.into(),
    };
    let near_field = match (accuracy.near_field, placed) {
        (false, _) => String::from("left out as asked: a plane wave at the channel centre is the answer"),
        (true, None) => "there was no peak to place".into(),
        (true, Some(_)) => "range and bearing from all subcarriers".into(),
    };
    let alignment = placed.is_some_and(|placed| placed.alignment.is_some());
    let one_way = placed.is_some_and(|placed| placed.slips.is_some());
    let focus = placed.is_some_and(|placed| placed.focus.is_some());
    let no_focus = if accuracy.near_field && accuracy.focus && !focus {
        String::from("the links of this capture are too few to tell errors of the trajectory")
    } else {
        beyond(accuracy.focus, "errors of the trajectory found from all transmitters")
    };
    let paths = placed.is_some_and(|placed| !placed.paths.is_empty());
    vec![
        step("turn-around compensation", bearing.compensated, turn_around),
        step("pairs at rest", false, standing),
        step("spherical waves", placed.is_some(), near_field),
        step("sampling-time alignment", alignment, beyond(accuracy.align, "slopes from packet to packet taken out")),
        step("one-way channel", one_way, beyond(accuracy.one_way, "the root of the round trip, beside it")),
        step("autofocus", focus, no_focus),
        step("paths beside the answer", paths, beyond(accuracy.paths, "told apart by all subcarriers")),
    ]
}

impl fmt::Display for LinkPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  decoded: {}", self.decoded)?;
        for StepPlan { step, taken, why } in &self.steps {
            writeln!(f, "  {step}: {}, {why}", if *taken { "taken" } else { "skipped" })?;
        }
        let indented = format!("{}profile, where one is written: {}", self.search, self.profile);
        indented.lines().try_for_each(|line| writeln!(f, "  {line}"))
    }
}
