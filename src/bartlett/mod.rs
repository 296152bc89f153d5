//! Bartlett profiles and the bearings that they hold.
//!
//! # Frame and signs
//! Positions are metres in the trajectory's frame. `u(azimuth, elevation) = (cos el cos az, cos el sin az, sin el)` is
//! the unit vector **from the receiver to the transmitter**, azimuth from +x towards +y, elevation from the xy plane
//! upwards ([`direction`]). A sample is `z ~ exp(-j 2 pi g |tx - rx| / lambda)` with the path gain `g` (2 for a round
//! trip), so with the displacement `p = rx - tx` a plane wave from `u` has `z ~ exp(+j 2 pi g u.p / lambda)`: moving
//! towards the transmitter turns the phase forward. The profile is
//!
//! `F(u) = |f(u)|^2,  f(u) = sum_t w_t z_t exp(-j 2 pi g u.p_t / lambda)`
//!
//! (Bartlett's spectrum \[bartlett1948\] over directions \[stoica-moses2005\]; keys in brackets are those of `docs/reference/references.md`).
//!
//! In polar coordinates of the displacement (length `rho`, azimuth `phi_p`, angle from the zenith `xi`) and of the
//! direction (azimuth `phi`, angle from the zenith `theta`) the exponent is
//! `2 pi g rho / lambda * (sin(theta) sin(xi) cos(phi - phi_p) + cos(xi) cos(theta))`, `4 pi rho / lambda * (...)` for
//! `g = 2`. As printed, the steering vector of \[paper\] lacks the parentheses around the two terms, and
//! theta is called the azimuth where the formula needs the zenith angle (phi being the azimuth).
//!
//! # Modules
//! * **Input**: `scene` centres and scales samples, and knows the shape of the motion.
//! * **Profiles**: [`Grid`] has the directions. `planner` chooses the cheapest method for a grid, a tolerance and a motion,
//!   keeps its tables for the next call, and has the oracle; sums, FFTs, rings and NUFFTs are those of `csi5300_kernels`.
//! * **Bearings**: `search` samples rings, takes the maxima that the bound does not rule out and climbs them;
//!   `mirror` judges which directions the motion cannot tell apart.

mod mirror;
pub(crate) mod planner;
mod scene;
pub(crate) mod search;

use crate::estimate::tuning::sensor;
use crate::signal::samples::{Samples, SamplesError};
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

pub use csi5300_kernels::simd::Tier;
pub use planner::Explanation;
pub(crate) use planner::{Method, Planner, ProfileOptions};
pub use scene::{Geometry, Shape};
pub(crate) use search::{ElevationSearch, Means, Searcher};
pub use search::{SearchPlan, search};

/// The Bartlett profile of `samples` over `grid` with the guarantee `|f~ - f| <= 1e-4 sum w |z|`. A receiver that did not move has a
/// constant profile: that is a profile, though not a bearing.
///
/// # Errors
/// [`Error`] for input that is empty or without energy, for positions not finite in wavelengths, and for directions that are not
/// finite.
pub fn profile(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    Planner::default().profile(samples, grid, &ProfileOptions::default())
}

/// Why there is no profile or no bearing. Every variant is found before any computation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is no sample at all.
    #[error("no samples: check that both logs cover the motion")]
    Empty,
    /// Samples that cannot be made, or added to.
    #[error(transparent)]
    Samples(#[from] SamplesError),
    /// Positions that are not finite as soon as they are subtracted or expressed in wavelengths.
    #[error("{what} of sample {index} is not finite")]
    NonFinite {
        /// The quantity.
        what: &'static str,
        /// Index of the first such sample.
        index: usize,
    },
    /// Every sample is zero, or every weight is.
    #[error("no energy: all {count} samples are zero or weigh nothing")]
    ZeroEnergy {
        /// Number of samples.
        count: usize,
    },
    /// An elevation limit outside 0 to 90 degrees.
    #[error("largest elevation {elevation_max_rad} rad, expected 0 to pi/2")]
    ElevationMax {
        /// The given value.
        elevation_max_rad: f64,
    },
    /// A tolerance that is negative or not a number.
    #[error("tolerance {eps}, expected 0 (exact) or a positive number")]
    Tolerance {
        /// The given value.
        eps: f64,
    },
    /// A direction of a list that is not finite.
    #[error("direction {index} is not finite")]
    Direction {
        /// Index in the list.
        index: usize,
    },
    /// The receiver did not move (or only vertically): there is no bearing.
    #[error(
        "no motion in the plane: no azimuth (the trajectory spans {extent_m:.6} m horizontally, needed are {needed_m:.6} m; up and down shows elevations only)"
    )]
    NoMotion {
        /// Largest horizontal distance from the middle, metres.
        extent_m: f64,
        /// What it takes, metres.
        needed_m: f64,
    },
    /// A trajectory so large that the search would never end (or phases lose their meaning).
    #[error("trajectory of {extent_m:.0} m around its middle, limit {limit_m:.0} m: check the units of the positions")]
    Aperture {
        /// Largest distance from the middle, metres.
        extent_m: f64,
        /// The limit, metres.
        limit_m: f64,
    },
}

/// What to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    /// Largest |elevation| of the search, radians, 0 to pi/2. Default 20 degrees. 0 fixes the horizon.
    pub elevation_max_rad: f64,
    /// Assumed standard deviation of the positions, metres: with the noise it decides whether the motion's depth
    /// distinguishes a direction from its reflection. Default 3 mm.
    pub odometry_sd_m: f64,
    /// The SIMD tier to run on. Default: the widest of this machine.
    pub tier: Tier,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self { elevation_max_rad: 20f64.to_radians(), odometry_sd_m: sensor::POSITION_M, tier: Tier::detect() }
    }
}

/// A local maximum of the profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Azimuth, radians in (-pi, pi], from +x towards +y.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// `F / (sum w |z|)^2`, 0 to 1.
    pub value: f64,
}

/// A bearing with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// Azimuth of the highest peak, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation| of the peak, radians; 0 where it was not searched or cannot be observed.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, where the motion distinguishes the two; in a tilted plane the sign that goes with this
    /// azimuth, the [mirror](Self::mirror_rad) having its own.
    pub signed_elevation_rad: Option<f64>,
    /// Predicted standard deviation of the azimuth (Cramer-Rao), radians; with the elevation as a nuisance where that
    /// was searched. At most that of a uniform guess, pi / sqrt 3.
    pub azimuth_sd_rad: f64,
    /// Predicted standard deviation of |elevation|, radians; pi/2 where it was not searched or cannot be observed.
    pub elevation_sd_rad: f64,
    /// True if the elevation was searched: it was asked for, and this motion can observe it.
    pub elevation_searched: bool,
    /// Azimuth of the mirror, radians: the bearing reflected in the line or in the tilted plane of the motion, where noise and
    /// the odometry's error explain the difference between the two. Neither is preferred for a reason. None where the
    /// reflection differs by the sign of the elevation alone (a horizontal plane).
    pub mirror_rad: Option<f64>,
    /// Elevation of the mirror, radians, with its sign; none where the elevation was not searched.
    pub mirror_elevation_rad: Option<f64>,
    /// Share of the evidence that the mirror has of the two, 0.01 to 0.5.
    pub mirror_share: Option<f64>,
    /// Unit normal of the plane that the mirror is reflected in.
    pub(crate) mirror_normal: Option<Vector3<f64>>,
    /// `|sum w z a| / sum w |z|` at the peak, 0 to 1.
    pub coherence: f64,
    /// Estimated signal-to-noise ratio of one sample (a power ratio); other paths count as noise.
    pub snr: f64,
    /// Second highest peak of a different azimuth over the highest, 0 to 1; none if there is no other. The mirror of a
    /// line does not count.
    pub peak_ratio: Option<f64>,
    /// The highest peaks, falling; the first is the estimate.
    pub peaks: Vec<Peak>,
    /// Shape of the motion.
    pub shape: Shape,
    /// Geometry class of the motion.
    pub geometry: Geometry,
    /// `F / (sum w |z|)^2` at the peak.
    pub value: f64,
    /// Directions in which the profile was evaluated.
    pub evaluations: usize,
    /// Computed and skipped parts of the search.
    pub plan: SearchPlan,
}

/// The unit vector from the receiver to a transmitter at an azimuth (from +x towards +y) and an elevation (from the
/// xy plane upwards), radians.
#[must_use]
pub fn direction(azimuth_rad: f64, elevation_rad: f64) -> Vector3<f64> {
    let (sin_az, cos_az) = azimuth_rad.sin_cos();
    let (sin_el, cos_el) = elevation_rad.sin_cos();
    Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
}

/// A set of directions: rows of elevations by columns of azimuths, or a plain list.
#[derive(Clone, Debug)]
pub struct Grid {
    pub(crate) layout: Arc<Layout>,
    /// The largest `|sin(elevation)|`.
    pub(crate) steepest: f64,
}

impl PartialEq for Grid {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.layout, &other.layout) || self.layout == other.layout
    }
}

/// How the directions of a grid are arranged.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Layout {
    /// `azimuths` evenly spaced around the circle from -180 degrees, without 180, for each of the elevations.
    Rings { azimuths: usize, elevations_rad: Vec<f64> },
    /// Any (azimuth, elevation) pairs, `width` of them to a row.
    List { directions: Vec<(f64, f64)>, width: usize },
}

impl Grid {
    fn new(layout: Layout) -> Self {
        let steep = |e: f64| if e.abs() >= FRAC_PI_2 { 1.0 } else { e.sin().abs() };
        let steepest = match &layout {
            Layout::Rings { elevations_rad, .. } => elevations_rad.iter().map(|e| steep(*e)).fold(0.0, f64::max),
            Layout::List { directions, .. } => directions.iter().map(|d| steep(d.1)).fold(0.0, f64::max),
        };
        Self { layout: Arc::new(layout), steepest }
    }

    /// `n` azimuths around the horizon, from -180 degrees in steps of 360/n (180 itself is -180). At least one.
    #[must_use]
    pub fn azimuth(n: usize) -> Self {
        Self::new(Layout::Rings { azimuths: n.max(1), elevations_rad: vec![0.0] })
    }

    /// `n_azimuth` azimuths as in [`Grid::azimuth`] for each of `n_elevation` elevations from -90 to 90 degrees, both
    /// included (one elevation: the horizon).
    #[must_use]
    pub fn azimuth_elevation(n_azimuth: usize, n_elevation: usize) -> Self {
        let elevations_rad = if n_elevation < 2 {
            vec![0.0]
        } else {
            (0..n_elevation).map(|i| PI * (i as f64 / (n_elevation - 1) as f64 - 0.5)).collect()
        };
        Self::new(Layout::Rings { azimuths: n_azimuth.max(1), elevations_rad })
    }

    /// The WSR toolbox's grid: `linspace(-180, 180, 360)` azimuths (both ends, the same direction twice; steps of
    /// 360/359 degrees) for each of `linspace(0, 90, 90)` polar angles from the zenith.
    #[must_use]
    pub fn wsr() -> Self {
        let elevation = |row: usize| PI / 2.0 * (1.0 - row as f64 / (WSR_ROWS - 1) as f64);
        let directions = (0..WSR_ROWS).flat_map(|row| wsr_azimuths().map(move |a| (a, elevation(row)))).collect();
        Self::new(Layout::List { directions, width: 360 })
    }

    /// The azimuths of [`Grid::wsr`] on the horizon: the toolbox's planar mode.
    #[must_use]
    pub(crate) fn wsr_azimuths() -> Self {
        Self::directions(wsr_azimuths().map(|azimuth| (azimuth, 0.0)).collect())
    }

    /// Any list of (azimuth, elevation) in radians, in one row.
    #[must_use]
    pub fn directions(list: Vec<(f64, f64)>) -> Self {
        let width = list.len();
        Self::new(Layout::List { directions: list, width })
    }

    /// Number of directions.
    pub(crate) fn len(&self) -> usize {
        match &*self.layout {
            Layout::Rings { azimuths, elevations_rad } => azimuths * elevations_rad.len(),
            Layout::List { directions, .. } => directions.len(),
        }
    }

    /// Rows (elevations) and columns (azimuths); a list is one row.
    #[must_use]
    pub fn shape(&self) -> (usize, usize) {
        match &*self.layout {
            Layout::Rings { azimuths, elevations_rad } => (elevations_rad.len(), *azimuths),
            Layout::List { directions, width } => (directions.len() / (*width).max(1), *width),
        }
    }

    /// Azimuth and elevation of direction `index`, radians; row by row, azimuth fastest.
    ///
    /// # Panics
    /// If `index` is not below rows times columns ([`Grid::shape`]).
    #[must_use]
    pub fn at(&self, index: usize) -> (f64, f64) {
        match &*self.layout {
            Layout::Rings { azimuths, elevations_rad } => {
                (ring_azimuth(index % azimuths, *azimuths), elevations_rad[index / azimuths])
            }
            Layout::List { directions, .. } => directions[index],
        }
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        let Layout::List { directions, .. } = &*self.layout else { return Ok(()) };
        let bad = directions.iter().position(|(a, e)| !(a.is_finite() && e.is_finite()));
        bad.map_or(Ok(()), |index| Err(Error::Direction { index }))
    }
}

/// Polar angles of the toolbox's grid.
const WSR_ROWS: usize = 90;

/// `linspace(-180, 180, 360)` degrees, radians.
fn wsr_azimuths() -> impl Iterator<Item = f64> {
    (0..360).map(|column| TAU * f64::from(column) / 359.0 - PI)
}

/// Azimuth `index` of `count` around the circle from -180 degrees, radians.
pub(crate) fn ring_azimuth(index: usize, count: usize) -> f64 {
    TAU * index as f64 / count as f64 - PI
}

/// A Bartlett profile: `F = |f|^2` over a grid, relative to what perfectly aligned samples would give.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The directions.
    pub grid: Grid,
    /// `F(u) / (sum_t w_t |z_t|)^2`, 0 to 1, one per direction in the order of [`Grid::at`].
    pub values: Vec<f64>,
    /// `sum_t w_t |z_t|` in the units of the samples: `F` itself is `value * sum_abs^2`.
    pub sum_abs: f64,
}

impl Profile {
    /// Index and value of the largest entry; none for an empty grid.
    #[must_use]
    pub fn max(&self) -> Option<(usize, f64)> {
        self.values.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The likelihood of the highest entry (\[paper\] in docs/reference/references.md): its share of the profile's sum, `F / sum F`.
    #[must_use]
    pub(crate) fn likelihood_share(&self) -> Option<f64> {
        let sum: f64 = self.values.iter().sum();
        self.max().map(|(_, top)| top / sum)
    }
}

/// The profile variance \[wsr-ijrr\] about the highest peak: lower is sharper, 1 is a uniform profile.
///
/// `[sum d^2 F / sum F] / [sum d^2 / n]` with `d` the distance to the peak in grid steps, azimuth steps wrapped around the
/// circle, as in the planar mode of the WSR toolbox \[wsr\] (WSR_Module.cpp:1352; there in single precision): one row of
/// azimuths, repeated for each of its 90 polar angles; the highest of equal entries is the last, so the peak is in the last row.
/// None for an empty grid.
pub(crate) fn wsr_planar_profile_variance(azimuths: &Profile) -> Option<f64> {
    let (peak, _) = azimuths.max()?;
    let columns = azimuths.values.len();
    let up2 = (0..WSR_ROWS).map(|up| (up * up) as f64).sum::<f64>() / WSR_ROWS as f64;
    let (mut weighted, mut plain, mut sum) = (0.0, 0.0, 0.0);
    for (column, value) in azimuths.values.iter().enumerate() {
        let across = column.abs_diff(peak);
        let across = across.min(columns - across) as f64;
        let d2 = across * across + up2;
        (weighted, plain, sum) = (weighted + d2 * value, plain + d2, sum + value);
    }
    (plain > 0.0 && sum > 0.0).then(|| (weighted / sum) / (plain / columns as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_have_the_directions_they_promise() {
        let degrees = |(a, e): (f64, f64)| (a.to_degrees(), e.to_degrees());
        let close = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9;
        let plain = Grid::azimuth_elevation(360, 181);
        assert_eq!((plain.len(), plain.shape()), (65_160, (181, 360)));
        assert!(close(degrees(plain.at(0)), (-180.0, -90.0)));
        assert!(close(degrees(plain.at(90 * 360 + 190)), (10.0, 0.0)));
        let wsr = Grid::wsr();
        assert_eq!((wsr.len(), wsr.shape()), (32_400, (90, 360)));
        assert!(close(degrees(wsr.at(359)), (180.0, 90.0)));
        assert!(close(degrees(wsr.at(89 * 360)), (-180.0, 0.0)));
        assert!(close(degrees(wsr.at(360 + 1)), (-180.0 + 360.0 / 359.0, 90.0 - 90.0 / 89.0)));
    }

    #[test]
    fn profile_variance_is_that_of_the_row_repeated_for_each_polar_angle() {
        // By its definition; steps across the wrap are single ones.
        let tiled = |row: &[f64]| {
            let peak = row.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0 as i32;
            let (mut weighted, mut plain) = (0.0, 0.0);
            for up in 0..90 {
                for (column, value) in row.iter().enumerate() {
                    let across = (column as i32 - peak).rem_euclid(360).min((peak - column as i32).rem_euclid(360));
                    let d2 = f64::from(across * across + up * up);
                    (weighted, plain) = (weighted + d2 * value, plain + d2);
                }
            }
            weighted / (90.0 * row.iter().sum::<f64>()) / (plain / (90.0 * 360.0))
        };
        let profile = |values: Vec<f64>| Profile { grid: Grid::wsr_azimuths(), values, sum_abs: 1.0 };
        let mut sharp = vec![0.0; 360];
        (sharp[359], sharp[0]) = (1.0, 0.5);
        for row in [vec![0.5; 360], (0..360).map(|i| f64::from(i * 37 % 101)).collect(), sharp.clone()] {
            let found = wsr_planar_profile_variance(&profile(row.clone())).unwrap();
            assert!((found / tiled(&row) - 1.0).abs() < 1e-12, "{found}");
        }
        assert!((wsr_planar_profile_variance(&profile(vec![0.5; 360])).unwrap() - 1.0).abs() < 1e-12);
        assert!((profile(vec![0.5; 360]).likelihood_share().unwrap() - 1.0 / 360.0).abs() < 1e-15);
        assert!((profile(sharp).likelihood_share().unwrap() - 2.0 / 3.0).abs() < 1e-15);
    }
}
