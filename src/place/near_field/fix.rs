//! What a search finds.

use crate::bartlett::direction;
use crate::maths::wrap_rad;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// A place from which the samples can be explained: a local maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Source {
    /// Azimuth from the middle of the motion, radians in (-pi, pi].
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, where the motion distinguishes the two.
    pub signed_elevation_rad: Option<f64>,
    /// 1 / range, 1/m; 0 is a plane wave.
    pub inverse_range_per_m: f64,
    /// Geometric mean of the views' normalised powers, 0..1.
    pub power: f64,
    /// The same averaged over the elevations and ranges that this azimuth may have: what sources are ordered by.
    pub evidence: f64,
}

impl Source {
    /// The elevation with its sign where that is known, else its magnitude, radians.
    #[must_use]
    pub(crate) fn elevation_rad(&self) -> f64 {
        self.signed_elevation_rad.unwrap_or(self.abs_elevation_rad)
    }
}

/// A limit of what was searched at which an answer lies: the samples may be explained better beyond it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Edge {
    /// The largest |elevation|.
    Elevation,
    /// The shortest range.
    Range,
    /// Both.
    ElevationAndRange,
}

impl Edge {
    /// From whether an answer is at the shortest range, and at the largest elevation.
    pub(crate) fn of(near: bool, high: bool) -> Option<Self> {
        match (near, high) {
            (false, false) => None,
            (false, true) => Some(Self::Elevation),
            (true, false) => Some(Self::Range),
            (true, true) => Some(Self::ElevationAndRange),
        }
    }
}

/// Standard deviations of a place's coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Deviations {
    /// Azimuth, radians.
    pub azimuth_rad: f64,
    /// Elevation, radians.
    pub elevation_rad: f64,
    /// 1 / range, 1/m.
    pub inverse_range_per_m: f64,
    /// Covariance of (azimuth, elevation, 1 / range).
    pub covariance: Matrix3<f64>,
    /// Variance of the residual phase of one row, radians squared.
    pub phase_variance: f64,
    /// Rows that share one independent error, as slow errors count: 1 for white noise.
    pub correlated_rows: f64,
}

/// What the search found.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Fix {
    /// All sources found, falling in evidence; the first is the answer's top.
    pub sources: Vec<Source>,
    /// The azimuth of the answer, radians in (-pi, pi]: that of its top where noise is all that one wave leaves, else the
    /// one that is right on average over the elevations and ranges about it.
    pub azimuth_rad: f64,
    /// Where azimuth, elevation and range are measured from, metres.
    pub middle_m: Vector3<f64>,
    /// Azimuth of the highest peak of each view by itself, radians, in the order of the views.
    pub view_azimuths_rad: Vec<f64>,
    /// Power of the answer in each view, 0..1.
    pub view_powers: Vec<f64>,
    /// Predicted standard deviations.
    pub deviations: Deviations,
    /// True if range was searched: the aperture is large enough for the curvature to matter.
    pub range_searched: bool,
    /// True if elevation was searched.
    pub elevation_searched: bool,
    /// The shortest range that was searched, metres: an answer there is not one.
    pub range_min_m: f64,
    /// The largest |elevation| that was searched, radians; pi / 2 is no limit.
    pub elevation_max_rad: f64,
    /// Places in which the field was evaluated.
    pub evaluations: usize,
}

impl Fix {
    /// The top of the answer.
    #[must_use]
    pub(crate) fn best(&self) -> Source {
        self.sources[0]
    }

    /// How far the view furthest off would have put the azimuth, radians.
    #[must_use]
    pub(crate) fn view_spread_rad(&self) -> f64 {
        let azimuth = self.azimuth_rad;
        self.view_azimuths_rad.iter().map(|a| wrap_rad(a - azimuth).abs()).fold(0.0, f64::max)
    }

    /// Which limits of the search the answer lies at.
    #[must_use]
    pub(crate) fn edge(&self) -> Option<Edge> {
        let best = self.best();
        let near = self.range_searched && best.inverse_range_per_m * self.range_min_m > 0.98;
        let limited = self.elevation_searched && self.elevation_max_rad < FRAC_PI_2;
        Edge::of(near, limited && best.abs_elevation_rad > 0.995 * self.elevation_max_rad)
    }

    /// Range to the answer and its standard deviation, metres, where the curvature fixes it to better than `share` of
    /// itself.
    #[must_use]
    pub(crate) fn range_m(&self, share: f64) -> Option<(f64, f64)> {
        let c = self.best().inverse_range_per_m;
        let relative = self.deviations.inverse_range_per_m / c;
        let inside = c > 0.0 && c * self.range_min_m < 0.98;
        (self.range_searched && inside && relative < share).then(|| (1.0 / c, relative / c))
    }

    /// Position of the answer in the frame of the displacements, and its covariance, metres; where the sign of its height
    /// above the motion is not observed it is taken as upwards.
    #[must_use]
    pub(crate) fn position(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let best = self.best();
        let c = best.inverse_range_per_m;
        if !self.range_searched || c <= 0.0 {
            return None;
        }
        let (a, e, r) = (self.azimuth_rad, best.elevation_rad(), 1.0 / c);
        let u = direction(a, e);
        let by_azimuth = Vector3::new(-a.sin(), a.cos(), 0.0) * (r * e.cos());
        let by_elevation = Vector3::new(-a.cos() * e.sin(), -a.sin() * e.sin(), e.cos()) * r;
        let jacobian = Matrix3::from_columns(&[by_azimuth, by_elevation, u * (-r * r)]);
        Some((self.middle_m + u * r, jacobian * self.deviations.covariance * jacobian.transpose()))
    }
}
