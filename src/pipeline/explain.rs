//! What was computed for a link, and what was left out and why: a value that prints.

use super::bearing::Bearing;
use super::effort::Sufficient;
use super::options::Options;
use crate::bartlett::{self, ElevationSearch, Explanation, Grid, Planner, ProfileOptions, SearchPlan};
use crate::place::near_field::cost::Cost;
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
#[non_exhaustive]
pub struct StepPlan {
    /// Its name.
    pub step: &'static str,
    /// Whether it was taken.
    pub taken: bool,
    /// What it was about, or why it was not taken.
    pub why: String,
    /// What it takes, or would have taken, by the cost model, microseconds of one core.
    pub cost_us: Option<f64>,
    /// Where it was left out: how far it might have moved the azimuth, degrees.
    pub risk_deg: Option<f64>,
}

impl LinkPlan {
    /// The plan behind `bearing`, and that of its profile over `grid`.
    ///
    /// # Errors
    /// As [`Planner::explain`].
    pub fn of(bearing: &Bearing, options: &Options, grid: &Grid) -> Result<Self, bartlett::Error> {
        let profile = Planner::default().explain(&bearing.samples, grid, &ProfileOptions::default())?;
        let decoded = format!(
            "antenna {}, first stream, {SUBCARRIERS} subcarriers (the channel centre is a line fitted through all of them); \
             other antennas and streams stay packed",
            options.antenna
        );
        Ok(Self {
            decoded,
            steps: Steps { bearing, options, cost: Cost::of(&bearing.samples, &bearing.limits, bearing.pairs.formed) }
                .all(),
            search: bearing.plane_wave.plan,
            profile,
        })
    }
}

/// The steps of one link in words.
struct Steps<'a> {
    bearing: &'a Bearing,
    options: &'a Options,
    cost: Cost,
}

impl Steps<'_> {
    fn all(&self) -> Vec<StepPlan> {
        let (bearing, placed, cost) = (self.bearing, self.bearing.placed.as_ref(), &self.cost);
        let accuracy = &self.options.accuracy;
        let pairs = &bearing.pairs;
        let standing = format!("{} of {} pairs; one at rest adds nothing to a bearing", pairs.standing, pairs.formed);
        let step = |step, taken, why| StepPlan { step, taken, why, cost_us: None, risk_deg: None };
        let alignment = placed.is_some_and(|placed| placed.alignment.is_some());
        let one_way = placed.is_some_and(|placed| placed.slips.is_some());
        let focus = placed.is_some_and(|placed| placed.focus.is_some());
        let paths = placed.is_some_and(|placed| !placed.paths.is_empty()) && !bearing.sufficient.explains_all();
        let left_out = |asked: bool, taken: &str| self.left_out(asked, taken);
        let no_focus = match accuracy.focus && !focus && self.takes_all() && placed.is_some() {
            true => {
                "the links of this capture are too few to tell errors of the trajectory, or one shows that it is right"
                    .into()
            }
            false => left_out(accuracy.focus, "errors of the trajectory found from all transmitters"),
        };
        let roots = match accuracy.one_way && !one_way && self.takes_all() && placed.is_some() {
            true => format!(
                "packets are {:.2} wavelengths of motion apart: from 0.25 on nothing tells the signs of roots",
                bearing.samples.spacing_m() / self.options.channel.wavelength_m()
            ),
            false => left_out(accuracy.one_way, "the root of the round trip, beside it"),
        };
        vec![
            step("turn-around compensation", bearing.compensated, self.turn_around()),
            step("pairs at rest", false, standing),
            step("elevation", bearing.plane_wave.elevation_searched, self.elevation()),
            StepPlan { cost_us: Some(cost.one_wave_us), ..self.one_wave() },
            self.step("spherical waves", placed.is_some(), self.spherical(), cost.search_us),
            self.step(
                "sampling-time alignment",
                alignment,
                left_out(accuracy.align, "slopes from packet to packet taken out"),
                cost.align_us,
            ),
            self.step("one-way channel", one_way, roots, cost.one_way_us),
            self.step(
                "windows along the motion",
                self.takes_all() && placed.is_some(),
                left_out(true, "powers of parts of the motion, summed"),
                0.0,
            ),
            self.step("autofocus", focus, no_focus, cost.focus_us),
            self.step(
                "paths beside the answer",
                paths,
                left_out(accuracy.paths, "told apart by all subcarriers"),
                cost.paths_us,
            ),
        ]
    }

    /// A step beyond the plane wave, with what leaving it out risked.
    fn step(&self, step: &'static str, taken: bool, why: String, cost_us: f64) -> StepPlan {
        let risk_rad = match self.bearing.sufficient {
            Sufficient::PlaneWave(risk) | Sufficient::OneWave(risk) => Some(risk.risk_rad),
            Sufficient::ErrorBar { error_bar_rad, .. } => Some(error_bar_rad),
            Sufficient::AllAsked | Sufficient::Everything(_) => None,
        };
        let risk_deg = risk_rad.filter(|_| !taken).map(f64::to_degrees);
        StepPlan { step, taken, why, cost_us: (cost_us > 0.0).then_some(cost_us), risk_deg }
    }

    fn takes_all(&self) -> bool {
        matches!(self.bearing.sufficient, Sufficient::Everything(_))
    }

    /// What a step beyond the plane wave is about, or why it was not taken; `asked` says whether it was asked for.
    fn left_out(&self, asked: bool, taken: &str) -> String {
        match (self.options.accuracy.near_field, asked, self.bearing.sufficient) {
            (false, ..) => "belongs to spherical waves, which were left out as asked".into(),
            (_, false, _) => "left out as asked".into(),
            (.., Sufficient::Everything(_) | Sufficient::AllAsked) if self.bearing.placed.is_none() => {
                "there was no peak to place".into()
            }
            (.., Sufficient::Everything(_) | Sufficient::AllAsked) => taken.into(),
            (.., Sufficient::ErrorBar { .. }) => "the plane wave is as accurate as was asked".into(),
            (.., Sufficient::PlaneWave(_) | Sufficient::OneWave(_)) => "one wave leaves nothing but noise".into(),
        }
    }

    fn turn_around(&self) -> String {
        match (&self.bearing.turn_around, self.options.compensate) {
            (_, false) => "left out as asked".into(),
            (None, _) => "too few pairs, or clocks that no two cards have".into(),
            (Some(found), _) if self.bearing.compensated => {
                format!("{:.0} Hz times the jitter of the turn-around", found.df_hz)
            }
            (Some(_), _) => "the phase gets no steadier by it".into(),
        }
    }

    fn elevation(&self) -> String {
        let plane_wave = &self.bearing.plane_wave;
        match plane_wave.plan.elevation {
            ElevationSearch::Searched => format!("{} rings", plane_wave.plan.rings),
            ElevationSearch::NotObservable => "the samples say less of it than its limits do".into(),
            ElevationSearch::NotAsked => "left out as asked".into(),
        }
    }

    /// The decision that the others follow from.
    fn one_wave(&self) -> StepPlan {
        let deg = f64::to_degrees;
        let (taken, why) = match self.bearing.sufficient {
            Sufficient::AllAsked => {
                (false, String::from("left out as asked: a plane wave at the channel centre is the answer"))
            }
            Sufficient::ErrorBar { error_bar_rad, asked_rad } => (
                false,
                format!(
                    "the plane wave's error bar is {:.2} degrees, {:.2} were asked for",
                    deg(error_bar_rad),
                    deg(asked_rad)
                ),
            ),
            Sufficient::PlaneWave(risk) | Sufficient::OneWave(risk) => (
                true,
                format!(
                    "it leaves nothing but noise, which hides no wave that moves the azimuth by more than {:.3} degrees ({:.3} allowed)",
                    deg(risk.risk_rad),
                    deg(risk.tolerance_rad)
                ),
            ),
            Sufficient::Everything(reason) => (false, reason.to_string()),
        };
        StepPlan { step: "one wave at the channel centre", taken, why, cost_us: None, risk_deg: None }
    }

    fn spherical(&self) -> String {
        match self.bearing.sufficient {
            Sufficient::AllAsked => "left out as asked: a plane wave at the channel centre is the answer".into(),
            Sufficient::OneWave(_) => "range and bearing from the phase at the channel centre".into(),
            Sufficient::PlaneWave(_) => {
                "the motion is too small for a wave front to be curved, and one wave leaves nothing but noise".into()
            }
            Sufficient::ErrorBar { .. } | Sufficient::Everything(_) => {
                self.left_out(true, "range and bearing from all subcarriers")
            }
        }
    }
}

impl fmt::Display for LinkPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  decoded: {}", self.decoded)?;
        for StepPlan { step, taken, why, cost_us, risk_deg } in &self.steps {
            write!(f, "  {step}: {}, {why}", if *taken { "taken" } else { "skipped" })?;
            match cost_us {
                Some(us) if *taken => write!(f, "; about {us:.0} us")?,
                Some(us) => write!(f, "; saves about {us:.0} us")?,
                None => {}
            }
            writeln!(f, "{}", risk_deg.map_or(String::new(), |deg| format!(", risks {deg:.3} degrees")))?;
        }
        let indented = format!("{}profile, where one is written: {}", self.search, self.profile);
        indented.lines().try_for_each(|line| writeln!(f, "  {line}"))
    }
}
