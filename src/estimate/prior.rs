//! What is known about a transmitter's place before anything was heard.
//!
//! Azimuth: uniform. |elevation|: uniform up to [`tuning::ELEVATION_DEG`]; where the motion is not level, and so distinguishes
//! elevations, [`tuning::ELEVATION_BEYOND`] of the probability lies uniformly between there and the zenith. Range: uniform in its logarithm from
//! [`tuning::NEAREST_M`] to [`tuning::FARTHEST`] times that, and beyond in 1 / range. A limit that the caller gives holds
//! everywhere and leaves nothing beyond it. A known height ties the elevation to the range.

use super::likelihood::Place;
use super::tuning;
use std::f64::consts::FRAC_PI_2;

/// Probability of a transmitter nearer than [`tuning::NEAREST_M`], where no shortest range is given.
pub(super) const NEARER: f64 = 0.05;

/// Requested limits of the prior.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Limits {
    /// Largest |elevation|, radians; 0 is the horizon alone.
    pub elevation_max_rad: Option<f64>,
    /// Shortest range, metres.
    pub range_min_m: Option<f64>,
    /// The transmitter's height above the receiver's antenna, metres.
    pub height_m: Option<f64>,
    /// Whether wave fronts may be curved.
    pub near_field: bool,
}

/// The prior of elevation and 1 / range for one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prior {
    /// Lowest and highest elevation, radians. At least 0 where the motion is level: it does not tell up from down.
    pub elevation_rad: [f64; 2],
    /// Largest 1 / range, 1/m.
    pub curve_max: f64,
    expected_rad: f64,
    beyond: f64,
    height_m: Option<f64>,
}

/// A stretch of elevations or of 1 / range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub low: f64,
    pub at: f64,
    pub high: f64,
    /// Its prior probability.
    pub mass: f64,
}

impl Cell {
    fn only(low: f64, high: f64) -> Vec<Self> {
        vec![Self { low, at: 0.5 * (low + high), high, mass: 1.0 }]
    }
}

impl Prior {
    /// `signed` says that the motion distinguishes up from down.
    pub fn new(limits: &Limits, signed: bool) -> Self {
        let expected_rad = limits.elevation_max_rad.unwrap_or(tuning::ELEVATION_DEG.to_radians()).clamp(0.0, FRAC_PI_2);
        let is_open = signed && limits.elevation_max_rad.is_none();
        let highest = if is_open { FRAC_PI_2 } else { expected_rad };
        Self {
            elevation_rad: [if signed { -highest } else { 0.0 }, highest],
            curve_max: if limits.near_field { 1.0 / limits.range_min_m.unwrap_or(tuning::NEAREST_M) } else { 0.0 },
            expected_rad,
            beyond: if is_open { tuning::ELEVATION_BEYOND } else { 0.0 },
            height_m: limits.height_m,
        }
    }

    /// The same with places as near as 1 / `curve_max`, metres.
    pub fn with_curve_max(self, curve_max: f64) -> Self {
        Self { curve_max, ..self }
    }

    /// The same with every elevation.
    pub fn with_any_elevation(self) -> Self {
        let lowest = if self.is_signed() { -FRAC_PI_2 } else { 0.0 };
        Self { elevation_rad: [lowest, FRAC_PI_2], beyond: tuning::ELEVATION_BEYOND, ..self }
    }

    /// The same with expected places alone: 1 / range up to `curve_max`, no elevation beyond the expected ones.
    pub fn expected(self, curve_max: f64) -> Self {
        let prior = self.with_curve_max(curve_max);
        if prior.elevation_is_open() { prior.with_expected_elevations() } else { prior }
    }

    /// `ln` of a place's prior odds against an expected one, which these limits contain: at most 0.
    pub fn log_odds(&self, place: &Place) -> f64 {
        let nearer = if place.curve > self.curve_max { NEARER.ln() } else { 0.0 };
        let steeper = self.elevation_is_open() && place.elevation.abs() > self.expected_rad + 1e-9;
        let density = |share: f64, width_rad: f64| share / width_rad;
        let odds = density(tuning::ELEVATION_BEYOND, FRAC_PI_2 - self.expected_rad)
            / density(1.0 - tuning::ELEVATION_BEYOND, self.expected_rad);
        nearer + if steeper { odds.ln() } else { 0.0 }
    }

    /// The same between two elevations alone.
    pub fn between(self, elevation_rad: [f64; 2]) -> Self {
        Self { elevation_rad, ..self }
    }

    /// The same at the horizon alone, unless a height is known.
    pub fn level(self) -> Self {
        if self.height_m.is_some() { self } else { Self { elevation_rad: [0.0; 2], ..self } }
    }

    /// The same without elevations beyond the expected ones.
    pub fn with_expected_elevations(self) -> Self {
        let lowest = if self.is_signed() { -self.expected_rad } else { 0.0 };
        Self { elevation_rad: [lowest, self.expected_rad], beyond: 0.0, ..self }
    }

    pub fn is_signed(&self) -> bool {
        self.elevation_rad[0] < 0.0
    }

    /// Whether the elevation is open at all.
    pub fn elevation_is_open(&self) -> bool {
        self.height_m.is_none() && self.elevation_rad[1] > 0.0
    }

    pub fn contains(&self, place: &Place) -> bool {
        let [low, high] = self.elevation_rad;
        let slack = 1e-9;
        (low - slack..=high + slack).contains(&place.elevation) && (0.0..=self.curve_max + slack).contains(&place.curve)
    }

    /// The place within these limits that is nearest to another.
    pub fn nearest(&self, place: Place) -> Place {
        let [low, high] = self.elevation_rad;
        Place { elevation: place.elevation.clamp(low, high), curve: place.curve.clamp(0.0, self.curve_max), ..place }
    }

    /// A place with the elevation that a known height gives it.
    pub fn at_height(&self, place: Place) -> Place {
        let elevation = self.height_m.map_or(place.elevation, |height| (height * place.curve).clamp(-1.0, 1.0).asin());
        let elevation = if self.is_signed() { elevation } else { elevation.abs() };
        Place { elevation, ..place }
    }

    /// Probability of an elevation between two, radians.
    pub fn elevation_mass(&self, from: f64, to: f64) -> f64 {
        let below = |elevation: f64| {
            let inside = if self.expected_rad > 0.0 { (elevation.abs() / self.expected_rad).min(1.0) } else { 1.0 };
            let rest = FRAC_PI_2 - self.expected_rad;
            let above = if rest > 0.0 { ((elevation.abs() - self.expected_rad) / rest).clamp(0.0, 1.0) } else { 0.0 };
            let share = (1.0 - self.beyond) * inside + self.beyond * above;
            if self.is_signed() { 0.5 * share.copysign(elevation) } else { share }
        };
        below(to) - below(from)
    }

    /// Probability of a 1 / range between two, 1/m.
    pub fn curve_mass(&self, from: f64, to: f64) -> f64 {
        if self.curve_max <= 0.0 {
            return 1.0;
        }
        let far = self.curve_max / tuning::FARTHEST;
        let below = |curve: f64| if curve <= far { curve / far } else { 1.0 + (curve / far).ln() };
        (below(to) - below(from)) / below(self.curve_max)
    }

    /// `ln` of the density of elevation and 1 / range.
    pub fn log_density(&self, place: &Place) -> f64 {
        let far = self.curve_max / tuning::FARTHEST;
        let by_curve = if self.curve_max > 0.0 { -(place.curve.max(far) / far).ln() } else { 0.0 };
        let inside = self.expected_rad <= 0.0 || place.elevation.abs() <= self.expected_rad;
        let share = if inside { 1.0 - self.beyond } else { self.beyond };
        let width = if inside { self.expected_rad } else { FRAC_PI_2 - self.expected_rad };
        by_curve + if self.elevation_is_open() { (share / width.max(1e-9)).ln() } else { 0.0 }
    }

    /// Standard deviations of elevation, radians, and of ln range, before anything was heard.
    pub fn deviations(&self) -> [f64; 2] {
        let [low, high] = self.elevation_rad;
        let elevation = if self.is_signed() { self.expected_rad } else { 0.5 * (high - low) };
        [elevation / 3f64.sqrt(), tuning::FARTHEST.ln() / 12f64.sqrt()]
    }

    /// Elevations between two limits, in cells `step` apart; of level motion, whose phases go by the cosine, in cells whose
    /// cosines are at most `step` apart.
    pub fn elevations(&self, [low, high]: [f64; 2], step: f64) -> Vec<Cell> {
        if !self.elevation_is_open() || high <= low {
            return Cell::only(low, high);
        }
        let span = if self.is_signed() { high - low } else { (high - low) * high.sin() };
        cells(span, step, &|share| low + share * (high - low), &|from, to| self.elevation_mass(from, to))
    }

    /// Values of 1 / range between two limits in cells `step` apart.
    pub fn curves(&self, [low, high]: [f64; 2], step: f64) -> Vec<Cell> {
        if high <= low {
            return Cell::only(low, high);
        }
        let mut all =
            cells(high - low, step, &|share| low + share * (high - low), &|from, to| self.curve_mass(from, to));
        // The prior falls over a cell: where it is expected there.
        all.iter_mut().for_each(|cell| cell.at = self.mean_curve(cell.low, cell.high));
        all
    }

    /// The mean 1 / range between two, 1/m.
    fn mean_curve(&self, from: f64, to: f64) -> f64 {
        let far = self.curve_max / tuning::FARTHEST;
        let moment = |curve: f64| if curve <= far { 0.5 * curve * curve / far } else { curve - 0.5 * far };
        let mass = self.curve_mass(from, to) * (1.0 + tuning::FARTHEST.ln());
        if mass > 1e-9 { ((moment(to) - moment(from)) / mass).clamp(from, to) } else { 0.5 * (from + to) }
    }
}

/// Cells of equal length between the edges that shares of the whole have.
fn cells(span: f64, step: f64, edge: &dyn Fn(f64) -> f64, mass: &dyn Fn(f64, f64) -> f64) -> Vec<Cell> {
    let count = (span / step).ceil().max(1.0);
    let cell = |k: usize| {
        let at = |half: f64| edge((k as f64 + half) / count);
        Cell { low: at(0.0), at: at(0.5), high: at(1.0), mass: mass(at(0.0), at(1.0)).max(f64::MIN_POSITIVE) }
    };
    (0..count as usize).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_prior_is_one_whatever_the_cells() {
        for (signed, given) in [(false, None), (true, None), (true, Some(0.3)), (false, Some(0.3))] {
            let limits = Limits { elevation_max_rad: given, near_field: true, ..Limits::default() };
            let prior = Prior::new(&limits, signed);
            for step in [0.01, 0.2, 9.0] {
                let sum = |cells: Vec<Cell>| cells.iter().map(|cell| cell.mass).sum::<f64>();
                assert!((sum(prior.elevations(prior.elevation_rad, step)) - 1.0).abs() < 1e-6, "{prior:?} {step}");
                assert!((sum(prior.curves([0.0, prior.curve_max], step)) - 1.0).abs() < 1e-6, "{prior:?} {step}");
            }
        }
    }

    #[test]
    fn limits_that_are_given_leave_nothing_beyond_them() {
        let limits =
            Limits { elevation_max_rad: Some(0.1), range_min_m: Some(3.0), near_field: true, ..Limits::default() };
        let prior = Prior::new(&limits, true);
        let place = |elevation, curve| Place { azimuth: 0.0, elevation, curve };
        assert!(prior.contains(&place(-0.1, 1.0 / 3.0)) && !prior.contains(&place(0.11, 0.1)));
        assert!(!prior.contains(&place(0.0, 0.34)));
        assert_eq!(prior.elevation_mass(-0.1, 0.1), 1.0);
        let open = Prior::new(&Limits { near_field: true, ..Limits::default() }, true);
        assert!(open.contains(&place(1.5, 0.5)) && open.elevation_mass(0.35, 1.6) > 0.01);
    }

    #[test]
    fn a_known_height_ties_elevation_to_range() {
        let prior = Prior::new(&Limits { height_m: Some(1.0), near_field: true, ..Limits::default() }, false);
        assert!(!prior.elevation_is_open());
        let at = prior.at_height(Place { azimuth: 0.3, elevation: 0.0, curve: 0.5 });
        assert!((at.elevation - 30f64.to_radians()).abs() < 1e-12);
    }
}
