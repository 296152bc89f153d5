//! What a plane of motion hides: a wave and its mirror image in that plane have the same phases on it. How far a motion
//! leaves its plane decides whether its samples tell the two apart.

use super::climb::same_direction;
use super::fix::Source;
use super::search::Search;
use super::types::{Elevations, Place};
use crate::maths::wrap_rad;
use crate::tuning::TUNING;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// `ln` of how many times likelier a place of joint power `power` is than one of `other`: the likelihood of Gaussian
/// residuals of unknown variance, by as many looks as are independent.
pub(crate) fn log_odds(power: f64, other: f64) -> f64 {
    TUNING.prior.looks_of_odds * ((1.0 - other).max(1e-6) / (1.0 - power).max(1e-6)).ln()
}

/// Whether [`log_odds`] leave no doubt.
pub(crate) fn decisive(log_odds: f64) -> bool {
    log_odds > TUNING.prior.odds.ln()
}

impl Search {
    /// Compares the answer with its mirror image in the plane of motion. Where the samples do not tell them apart, the
    /// image joins `sources`; where they differ by nothing but the sign of the elevation, all signs are taken away.
    pub(super) fn compare_with_mirror(&mut self, sources: &mut Vec<Source>) {
        let (Elevations::Signed, Some(best)) = (self.limits.elevations, sources.first().copied()) else { return };
        let normal = self.normal();
        let towards = Vector3::from(Place::from(&best).unit()).map(f64::from);
        let image = towards - normal * (2.0 * normal.dot(&towards));
        let start = Place {
            azimuth: image.y.atan2(image.x),
            elevation: image.z.clamp(-1.0, 1.0).asin(),
            curve: best.inverse_range_per_m,
        };
        let mirror = self.judged_top(start);
        let cell_rad = std::f64::consts::TAU / self.axes.azimuths as f64;
        if same_direction(&mirror, &best, 0.5 * cell_rad) || decisive(log_odds(best.power, mirror.power)) {
            return;
        }
        let beside = wrap_rad(mirror.azimuth_rad - best.azimuth_rad).abs() < 2.0 * cell_rad;
        let opposite = mirror.elevation_rad() * best.elevation_rad() < 0.0;
        let same_size = (mirror.abs_elevation_rad - best.abs_elevation_rad).abs() < 2.0 * cell_rad;
        if beside && opposite && same_size {
            sources.iter_mut().for_each(|source| source.signed_elevation_rad = None);
        } else if !sources.iter().any(|other| same_direction(other, &mirror, 2.0 * cell_rad)) {
            let at = sources.iter().position(|other| other.evidence < mirror.evidence).unwrap_or(sources.len());
            sources.insert(at.max(1), mirror);
        }
    }

    /// Unit vector across the plane that the samples lie nearest to.
    fn normal(&self) -> Vector3<f64> {
        let at = self.offsets_m();
        let mean = at.iter().sum::<Vector3<f64>>() / at.len().max(1) as f64;
        let scatter: Matrix3<f64> = at.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
        let eigen = SymmetricEigen::new(scatter);
        eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odds_grow_with_what_is_left_unexplained() {
        assert_eq!(log_odds(0.4, 0.4), 0.0);
        assert!(!decisive(log_odds(0.44, 0.40)) && decisive(log_odds(0.97, 0.6)));
        assert!(log_odds(1.0, 1.0).is_finite() && log_odds(0.3, 0.5) < 0.0);
    }
}
