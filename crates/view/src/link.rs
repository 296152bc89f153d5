//! One link for the page: its profiles, the robot's path, and its phases.

use csi5300::pipeline::Bearing;
use csi5300_lab::curves::{Curve, evidence, plane_wave, without_motion};
use serde::Serialize;

/// Poses of the path, and positions of samples, at most.
const PLACES: usize = 1_000;
/// Phases at most.
const PHASES: usize = 1_500;
/// Points of a profile at most.
const POINTS: usize = 720;

/// A curve over azimuth, relative to its own highest value.
#[derive(Serialize)]
struct Relative {
    name: String,
    azimuths_deg: Vec<f64>,
    values: Vec<f64>,
}

/// Phases of the pairs, radians in (-pi, pi], beside their times.
#[derive(Serialize)]
struct Phases {
    t_s: Vec<f64>,
    one_way_rad: Vec<f64>,
    round_trip_rad: Vec<f64>,
    compensated_rad: Vec<f64>,
    /// The residual without the motion: times from the first sample in motion, and phases.
    left_t_s: Vec<f64>,
    left_rad: Vec<f64>,
}

/// A link that has a bearing.
#[derive(Serialize)]
pub(crate) struct Detail {
    /// What the answer was chosen from first, then others.
    curves: Vec<Relative>,
    path_m: Vec<[f64; 2]>,
    used_m: Vec<[f64; 2]>,
    phases: Phases,
}

impl Detail {
    /// Of a bearing whose course was kept.
    pub fn new(bearing: &Bearing) -> Self {
        let curves = [evidence(bearing), plane_wave(bearing).ok()].into_iter().flatten().map(relative);
        let xy = |points: &[nalgebra::Vector3<f64>]| thin(points, PLACES, |p| [round(p.x, 1e4), round(p.y, 1e4)]);
        let course =
            |value: fn(&csi5300::pipeline::Phase) -> f64| thin(&bearing.course, PHASES, |p| round(value(p), 1e4));
        let left = without_motion(bearing);
        Self {
            curves: curves.collect(),
            path_m: xy(&bearing.path_m),
            used_m: xy(bearing.samples.receiver_m()),
            phases: Phases {
                t_s: course(|phase| phase.t_s),
                one_way_rad: course(|phase| phase.one_way_rad),
                round_trip_rad: course(|phase| phase.round_trip_rad),
                compensated_rad: course(|phase| phase.compensated_rad),
                left_t_s: thin(&left, PHASES, |point| round(point.0, 1e4)),
                left_rad: thin(&left, PHASES, |point| round(point.1, 1e4)),
            },
        }
    }
}

/// A curve relative to its highest value; of more points than are shown the highest of each few.
fn relative(curve: Curve) -> Relative {
    let top = curve.values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
    let scale = if top > 0.0 { 1.0 / top } else { 1.0 };
    let few = curve.values.len().div_ceil(POINTS).max(1);
    let points: Vec<(f64, f64)> = curve.azimuths_deg.into_iter().zip(curve.values).collect();
    let highest = |few: &[(f64, f64)]| few.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
    let kept = points.chunks(few).filter_map(highest);
    let (azimuths_deg, values) = kept.map(|(azimuth, value)| (round(azimuth, 1e3), round(value * scale, 1e5))).unzip();
    Relative { name: curve.name, azimuths_deg, values }
}

/// Every n-th value.
fn thin<T, U>(values: &[T], most: usize, show: impl Fn(&T) -> U) -> Vec<U> {
    values.iter().step_by(values.len().div_ceil(most).max(1)).map(show).collect()
}

/// A value to a fraction of `per`: what a pixel cannot show is not sent.
fn round(value: f64, per: f64) -> f64 {
    (value * per).round() / per
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_value_is_kept_and_is_one() {
        let azimuths_deg: Vec<f64> = (0..5000).map(|k| f64::from(k) * 0.072 - 180.0).collect();
        let mut values = vec![0.5; 5000];
        values[1234] = 4.0;
        let top = azimuths_deg[1234];
        let shown = relative(Curve { name: "c".into(), azimuths_deg, values });
        assert!(shown.values.len() <= POINTS);
        let best = shown.values.iter().position(|value| *value == 1.0).unwrap();
        assert!((shown.azimuths_deg[best] - top).abs() < 1e-3);
        assert_eq!(shown.values.iter().filter(|value| **value == 0.125).count(), shown.values.len() - 1);
    }

    #[test]
    fn thinning_is_even_and_keeps_short_rows_whole() {
        assert_eq!(thin(&[1, 2, 3], 5, |v| *v), [1, 2, 3]);
        assert_eq!(thin(&(0..10).collect::<Vec<_>>(), 5, |v| *v), [0, 2, 4, 6, 8]);
        assert_eq!(thin(&[0; 0], 5, |v: &i32| *v), [0; 0]);
    }
}
