//! Where a receiver is, from bearings and ranges to transmitters whose places are known.
//!
//! Least squares over the position with a robust loss (Cauchy): a bearing that came off a wall loses its weight once it
//! is several deviations out. Started from every crossing of two bearings, so that one wrong bearing cannot choose the
//! minimum. The covariance is that of the linearised problem at the answer, with the weights of the loss.
//!
//! A sighting may have several bearings: its mirror, and the other candidates of its link with their evidence. Its likelihood is then
//! the sum of theirs, each times its evidence, and every step weighs each bearing by its part of that sum (expectation and
//! maximisation): three links that agree choose the candidate of the one that does not.
//!
//! Places are on the floor: azimuths and horizontal ranges do not depend on heights. Where the motion showed the elevation
//! of a transmitter whose height is known, the receiver's height follows from it: that of the transmitter less the distance
//! times the tangent.

use crate::maths::wrap_rad;
use nalgebra::{Matrix2, Vector2};

/// Power to which the evidence of another candidate over that of the answer is taken (chosen by a program in 29 of 30
/// folds of places (sensitivity -- refit place), motion capture and tracking camera).
const CANDIDATE_POWER: f64 = 0.5;

/// Another place is named where the best is at most this many times as likely (a link and its mirror are as likely,
/// three links of a capture leave one place).
const AS_LIKELY: f64 = 2.0;

/// And is further away than this many deviations of the best (chosen).
const APART_SD: f64 = 3.0;

/// And further than this many metres (chosen).
const APART_M: f64 = 0.3;

/// Least error of any bearing, radians (the median error in line of sight is about one degree).
const AZIMUTH_FLOOR_RAD: f64 = 0.02;

/// The same for range, relative (one range in six is off by more).
pub(crate) const RANGE_FLOOR: f64 = 0.3;

/// Residual, in deviations, at which a sighting has lost half of its weight.
const CAUCHY: f64 = 2.0;

/// Steps at most.
const STEPS: usize = 60;

/// The bearing of one link, and its range where known.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Sighting {
    /// Where the transmitter is, metres.
    pub transmitter_m: Vector2<f64>,
    /// Bearing to it from the receiver, radians, from +x towards +y.
    pub azimuth_rad: f64,
    /// The other bearing that the motion cannot tell from it, radians, if there is one.
    pub mirror_rad: Option<f64>,
    /// Further bearings that it may be, radians, each with its evidence in units of that of `azimuth_rad`: the other candidates.
    pub others: Vec<(f64, f64)>,
    /// Standard deviation of each of these bearings, radians.
    pub azimuth_sd_rad: f64,
    /// Horizontal range and its standard deviation, metres, where known.
    pub range_m: Option<(f64, f64)>,
    /// Elevation of a transmitter whose height is known, where the motion showed it.
    pub elevation: Option<Elevation>,
}

struct Direction {
    azimuth_rad: f64,
    evidence: f64,
    has_range: bool,
}

/// How high a transmitter is, and seems from the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elevation {
    /// Height of the transmitter, metres, in the frame of its place.
    pub transmitter_z_m: f64,
    /// Elevation of the transmitter as seen from the receiver, radians, positive above it.
    pub elevation_rad: f64,
    /// Its standard deviation, radians.
    pub sd_rad: f64,
}

impl Sighting {
    /// A bearing without a range: the transmitter's place in metres, the azimuth to it and its deviation in radians.
    #[must_use]
    pub fn new(transmitter_m: Vector2<f64>, azimuth_rad: f64, azimuth_sd_rad: f64) -> Self {
        Self {
            transmitter_m,
            azimuth_rad,
            mirror_rad: None,
            others: Vec::new(),
            azimuth_sd_rad,
            range_m: None,
            elevation: None,
        }
    }

    /// Each bearing that it may be, radians, with its evidence, tempered: the model of the wave is surer of its candidates than
    /// it is right. The range is that of the first and of the mirror.
    fn bearings(&self) -> impl Iterator<Item = Direction> {
        let own = std::iter::once(self.azimuth_rad).chain(self.mirror_rad);
        let own = own.map(|azimuth_rad| Direction { azimuth_rad, evidence: 1.0, has_range: true });
        let other = |(azimuth_rad, evidence): &(f64, f64)| Direction {
            azimuth_rad: *azimuth_rad,
            evidence: evidence.powf(CANDIDATE_POWER),
            has_range: false,
        };
        own.chain(self.others.iter().map(other))
    }

    fn is_usable(&self) -> bool {
        self.bearings().all(|bearing| bearing.azimuth_rad.is_finite() && (0.0..1e9).contains(&bearing.evidence))
            && self.azimuth_sd_rad >= 0.0
            && self.transmitter_m.iter().all(|v| v.is_finite())
    }
}

/// A position.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Located {
    /// The receiver, metres, in the frame of the transmitters.
    pub position_m: Vector2<f64>,
    /// Its covariance, metres squared: about this place, however many `others_m` there are.
    pub covariance_m2: Matrix2<f64>,
    /// Other places that the sightings fit nearly as well (at least half of the likelihood), the likeliest first, metres: as
    /// where the only link has a mirror.
    pub others_m: Vec<Vector2<f64>>,
    /// Share of its weight that each usable sighting kept, 0..1: small for one that fits nothing else.
    pub weights: Vec<f64>,
    /// For each usable sighting, the bearing that fits this place best, radians: the answer, its mirror or another candidate.
    pub azimuths_rad: Vec<f64>,
    /// Height of the receiver and its standard deviation, metres, where a sighting has an elevation.
    pub height_m: Option<(f64, f64)>,
}

/// Why there is no position.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LocateError {
    /// Two bearings cross in a point; one is a line, unless it has a range.
    #[error("{sightings} usable bearing{} and no range: a position needs two bearings, or one with a range", if *sightings == 1 { "" } else { "s" })]
    TooFew {
        /// Usable sightings.
        sightings: usize,
    },
    /// All bearings are parallel, or nearly.
    #[error("the bearings are parallel: they cross nowhere")]
    Parallel,
}

/// A residual in deviations, its gradient by the position, and what weight it has.
struct Equation {
    residual: f64,
    gradient: Vector2<f64>,
    weight: f64,
}

/// A sighting as seen from a place.
struct Seen {
    equations: Vec<Equation>,
    /// Likelihood, with the robust loss in place of a normal density.
    likelihood: f64,
    /// Share of its weight that it keeps.
    weight: f64,
    /// Index of the bearing with the largest part of the likelihood.
    likeliest: usize,
}

/// Locates a receiver.
///
/// # Errors
/// [`LocateError`] where the sightings do not fix a position. Sightings that are not finite are skipped.
pub fn locate(sightings: &[Sighting]) -> Result<Located, LocateError> {
    let usable: Vec<Sighting> = sightings.iter().filter(|sighting| sighting.is_usable()).cloned().collect();
    let starts = starts(&usable);
    if usable.len() < 2 && usable.iter().all(|s| s.range_m.is_none()) {
        return Err(LocateError::TooFew { sightings: usable.len() });
    }
    let mut solved: Vec<(Vector2<f64>, f64)> = starts.into_iter().filter_map(|start| descend(start, &usable)).collect();
    solved.sort_by(|a, b| a.1.total_cmp(&b.1));
    let best = *solved.first().ok_or(LocateError::Parallel)?;
    let mut found = finish(best.0, &usable).ok_or(LocateError::Parallel)?;
    let (as_likely, apart_sd, apart_m) = (AS_LIKELY, APART_SD, APART_M);
    let inverse = found.covariance_m2.try_inverse().unwrap_or_default();
    for (at, cost) in solved {
        let is_new = |known: &Vector2<f64>| {
            let by = known - at;
            by.dot(&(inverse * by)) > apart_sd * apart_sd && by.norm() > apart_m
        };
        if cost - best.1 < as_likely.ln() && is_new(&best.0) && found.others_m.iter().all(is_new) {
            found.others_m.push(at);
        }
    }
    Ok(found)
}

/// Crossings of all pairs of bearings that lie ahead, and the ends of ranges; mirrors and other candidates are bearings too.
fn starts(sightings: &[Sighting]) -> Vec<Vector2<f64>> {
    let back = |azimuth: f64| -Vector2::new(azimuth.cos(), azimuth.sin());
    let bearings = |s: &Sighting| s.bearings().map(|one| (back(one.azimuth_rad), one.has_range)).collect::<Vec<_>>();
    let mut starts = Vec::new();
    for (i, a) in sightings.iter().enumerate() {
        for (u, has_range) in bearings(a) {
            starts.extend(a.range_m.filter(|_| has_range).map(|(range, _)| a.transmitter_m + u * range));
            for b in &sightings[i + 1..] {
                for (v, _) in bearings(b) {
                    let cross = u.perp(&v);
                    if cross.abs() > 1e-3 {
                        let along = (b.transmitter_m - a.transmitter_m).perp(&v) / cross;
                        starts.push(a.transmitter_m + u * along);
                    }
                }
            }
        }
    }
    starts
}

fn seen(at: &Vector2<f64>, s: &Sighting) -> Seen {
    let to = s.transmitter_m - at;
    let distance = to.norm().max(1e-3);
    let sd = s.azimuth_sd_rad.hypot(AZIMUTH_FLOOR_RAD);
    let across = Vector2::new(to.y, -to.x) / (distance * distance);
    let known = s.range_m.filter(|(range, own)| range.is_finite() && *own >= 0.0);
    let range = known.map(|(range, own)| {
        let sd = own.hypot(RANGE_FLOOR * range).max(1e-3);
        Equation { residual: (distance - range) / sd, gradient: -to / (distance * sd), weight: 0.0 }
    });
    let fits = range.as_ref().map(|range| weight(range.residual));
    let (mut parts, mut equations) = (Vec::new(), Vec::new());
    for bearing in s.bearings() {
        let residual = wrap_rad(to.y.atan2(to.x) - bearing.azimuth_rad) / sd;
        // Where another bearing is the right one its range is not known: as good as one that has lost half of its weight.
        let by_range = fits.map_or(1.0, |fits| if bearing.has_range { fits } else { 0.5 });
        parts.push((bearing.evidence * weight(residual) * by_range, bearing.has_range));
        equations.push(Equation { residual, gradient: across / sd, weight: weight(residual) });
    }
    let likelihood: f64 = parts.iter().map(|(part, _)| part).sum::<f64>().max(f64::MIN_POSITIVE);
    let own: f64 = parts.iter().filter(|(_, has_range)| *has_range).map(|(part, _)| part / likelihood).sum();
    let kept = |sum: f64, (equation, (part, _)): (&Equation, &(f64, bool))| sum + equation.weight * part / likelihood;
    let by_bearing = equations.iter().zip(&parts).fold(0.0, kept);
    let by_range = fits.map_or(1.0, |fits| 1.0 - own + own * fits);
    equations.iter_mut().zip(&parts).for_each(|(equation, (part, _))| equation.weight *= part / likelihood);
    equations.extend(range.map(|range| Equation { weight: own * weight(range.residual), ..range }));
    let likeliest = parts.iter().enumerate().max_by(|a, b| a.1.0.total_cmp(&b.1.0)).map_or(0, |(k, _)| k);
    Seen { equations, likelihood, weight: by_bearing.min(by_range), likeliest }
}

fn weight(residual: f64) -> f64 {
    1.0 / (1.0 + (residual / CAUCHY).powi(2))
}

/// The cost at a place, and the normal matrix and gradient of the reweighted problem there.
fn normal(at: &Vector2<f64>, sightings: &[Sighting]) -> (f64, Matrix2<f64>, Vector2<f64>) {
    let (mut cost, mut matrix, mut side) = (0.0, Matrix2::zeros(), Vector2::zeros());
    for seen in sightings.iter().map(|sighting| seen(at, sighting)) {
        cost -= seen.likelihood.ln();
        for e in &seen.equations {
            matrix += e.gradient * e.gradient.transpose() * e.weight;
            side += e.gradient * (e.residual * e.weight);
        }
    }
    (cost, matrix, side)
}

/// Levenberg and Marquardt (\[levenberg1944\], \[marquardt1963\] in docs/reference/references.md) from `start`, each residual
/// weighted by the loss in every step.
fn descend(start: Vector2<f64>, sightings: &[Sighting]) -> Option<(Vector2<f64>, f64)> {
    let mut at = start;
    let (mut own, mut matrix, mut side) = normal(&at, sightings);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let damped = matrix + Matrix2::from_diagonal(&matrix.diagonal()) * damping + Matrix2::identity() * 1e-9;
        let step = damped.try_inverse()? * side;
        let next = at - step;
        let (cost, next_matrix, next_side) = normal(&next, sightings);
        if cost < own {
            (at, own, matrix, side, damping) = (next, cost, next_matrix, next_side, damping * 0.3);
        } else {
            damping *= 10.0;
        }
        if step.norm() < 1e-6 || damping > 1e9 {
            break;
        }
    }
    own.is_finite().then_some((at, own))
}

fn finish(at: Vector2<f64>, sightings: &[Sighting]) -> Option<Located> {
    let (_, matrix, _) = normal(&at, sightings);
    let covariance_m2 = matrix.try_inverse().filter(|c| c.iter().all(|v| v.is_finite()))?;
    let views: Vec<Seen> = sightings.iter().map(|sighting| seen(&at, sighting)).collect();
    let bearing =
        |(s, seen): (&Sighting, &Seen)| s.bearings().nth(seen.likeliest).map_or(s.azimuth_rad, |b| b.azimuth_rad);
    let azimuths_rad = sightings.iter().zip(&views).map(bearing).collect();
    let height_m = height(&at, &covariance_m2, sightings, &views);
    let weights = views.iter().map(|seen| seen.weight).collect();
    Some(Located { position_m: at, covariance_m2, others_m: Vec::new(), weights, azimuths_rad, height_m })
}

/// The height at `at` and its deviation, by the elevations: each by its variance and by the weight of its sighting. The place
/// is what they share: its errors do not average out.
fn height(
    at: &Vector2<f64>,
    covariance_m2: &Matrix2<f64>,
    sightings: &[Sighting],
    views: &[Seen],
) -> Option<(f64, f64)> {
    let (mut sum, mut height_m, mut along) = (0.0, 0.0, Vector2::zeros());
    for (sighting, seen) in sightings.iter().zip(views) {
        let to = sighting.transmitter_m - at;
        let (distance, floor) = (to.norm().max(1e-3), AZIMUTH_FLOOR_RAD);
        // Of the mirror and of other candidates the elevation is another one.
        let elevation = sighting.elevation.filter(|_| seen.likeliest == 0);
        let Some(Elevation { transmitter_z_m, elevation_rad, sd_rad }) = elevation else { continue };
        let (tan, sd_m) = (elevation_rad.tan(), distance * sd_rad.hypot(floor) / elevation_rad.cos().powi(2));
        let share = seen.weight / (sd_m * sd_m);
        let own_m = transmitter_z_m - distance * tan;
        if share.is_finite() && own_m.is_finite() {
            sum += share;
            height_m += share * own_m;
            along += to * (share * tan / distance);
        }
    }
    let by_place = along / sum;
    let variance = 1.0 / sum + (by_place.transpose() * covariance_m2 * by_place)[0];
    (sum > 0.0).then(|| (height_m / sum, variance.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(from: (f64, f64), tx: (f64, f64), error_deg: f64) -> Sighting {
        let azimuth = (tx.1 - from.1).atan2(tx.0 - from.0) + error_deg.to_radians();
        Sighting::new(Vector2::new(tx.0, tx.1), wrap_rad(azimuth), 0.01)
    }

    const ROBOTS: [(f64, f64); 4] = [(-2.4, 2.7), (2.5, -2.7), (-3.7, -1.5), (3.0, 3.0)];

    #[test]
    fn exact_bearings_meet_in_the_receiver() {
        let own: Vec<_> = ROBOTS[..3].iter().map(|tx| sighting((0.3, -0.4), *tx, 0.0)).collect();
        let found = locate(&own).unwrap();
        assert!((found.position_m - Vector2::new(0.3, -0.4)).norm() < 1e-6);
        assert!(found.weights.iter().all(|w| *w > 0.999));
        let sd = found.covariance_m2.diagonal().map(f64::sqrt);
        assert!(sd.max() < 0.15 && sd.min() > 0.02, "{sd}");
    }

    #[test]
    fn one_bearing_off_a_wall_is_outvoted() {
        let mut own: Vec<_> = ROBOTS.iter().map(|tx| sighting((0.3, -0.4), *tx, 0.3)).collect();
        own[1] = sighting((0.3, -0.4), ROBOTS[1], 70.0);
        let found = locate(&own).unwrap();
        assert!((found.position_m - Vector2::new(0.3, -0.4)).norm() < 0.1, "{found:?}");
        assert!(found.weights[1] < 0.1);
    }

    #[test]
    fn links_that_agree_choose_the_candidate_of_the_one_that_does_not() {
        let at = (0.3, -0.4);
        let mut own: Vec<_> = ROBOTS[..3].iter().map(|tx| sighting(at, *tx, 0.3)).collect();
        let right = own[1].azimuth_rad;
        // A reflection is stronger; beside it another, and the direct path third with half of its evidence.
        own[1].azimuth_rad = wrap_rad(right + 2.0);
        own[1].others = vec![(wrap_rad(right - 1.2), 0.9), (right, 0.5)];
        let found = locate(&own).unwrap();
        assert!((found.position_m - Vector2::new(at.0, at.1)).norm() < 0.1, "{found:?}");
        assert!(wrap_rad(found.azimuths_rad[1] - right).abs() < 1e-9 && found.weights[1] > 0.9, "{found:?}");
        assert_eq!(found.azimuths_rad[0], own[0].azimuth_rad);
        // Without evidence for it the direct path is no help, and all three bearings keep little of their say or one of them does.
        own[1].others.clear();
        assert!(locate(&own).unwrap().weights.iter().copied().fold(1.0, f64::min) < 0.1);
        // The range of the answer does not apply to the other candidates.
        own[1].others = vec![(right, 0.5)];
        own[1].range_m = Some((1.0, 0.1));
        let found = locate(&own).unwrap();
        assert!((found.position_m - Vector2::new(at.0, at.1)).norm() < 0.1, "{found:?}");
    }

    #[test]
    fn of_a_bearing_and_its_mirror_the_place_decides() {
        // The motion was along x: each bearing may be its negative, and the first two are given as that.
        let at = (0.3, -0.4);
        let mut own: Vec<_> = ROBOTS[..3].iter().map(|tx| sighting(at, *tx, 0.0)).collect();
        for (k, one) in own.iter_mut().enumerate() {
            let (right, mirror) = (one.azimuth_rad, -one.azimuth_rad);
            (one.azimuth_rad, one.mirror_rad) = if k < 2 { (mirror, Some(right)) } else { (right, Some(mirror)) };
        }
        let found = locate(&own).unwrap();
        let off = |y: f64| (found.position_m - Vector2::new(at.0, y)).norm();
        assert!(off(at.1) < 1e-3, "{found:?}");
        own.iter_mut().for_each(|one| one.mirror_rad = None);
        assert!((locate(&own).unwrap().position_m - Vector2::new(at.0, at.1)).norm() > 0.5);
    }

    #[test]
    fn what_a_single_link_and_its_mirror_leave_is_two_places() {
        let mirrored = |range_sd_m: f64| {
            let mut one = sighting((0.0, 0.0), (3.0, 1.0), 0.0);
            (one.mirror_rad, one.range_m) = (Some(-one.azimuth_rad), Some((10f64.sqrt(), range_sd_m)));
            one
        };
        let found = locate(&[mirrored(0.1)]).unwrap();
        let mut places = vec![found.position_m];
        places.extend(&found.others_m);
        places.sort_by(|a, b| a.y.total_cmp(&b.y));
        let expected = [Vector2::zeros(), Vector2::new(0.0, 2.0)];
        assert!(places.len() == 2 && places.iter().zip(expected).all(|(a, b)| (a - b).norm() < 1e-3), "{found:?}");
        // A second link decides.
        let two = locate(&[mirrored(0.1), sighting((0.0, 0.0), (-5.0, 0.0), 0.0)]).unwrap();
        assert!(two.others_m.is_empty() && two.position_m.norm() < 0.01, "{two:?}");
    }

    #[test]
    fn elevations_give_the_height_and_how_well_it_is_known() {
        let (at, height_m) = ((0.3, -0.4), 1.2);
        let seen = |k: usize, error_rad: f64| {
            let (own, z) = (sighting(at, ROBOTS[k], 0.0), 0.4 * k as f64);
            let distance = (own.transmitter_m - Vector2::new(at.0, at.1)).norm();
            let elevation_rad = (z - height_m).atan2(distance) + error_rad;
            Sighting { elevation: Some(Elevation { transmitter_z_m: z, elevation_rad, sd_rad: 0.01 }), ..own }
        };
        let mut own: Vec<_> = (0..4).map(|k| seen(k, 0.0)).collect();
        let (exact_m, sd_m) = locate(&own).unwrap().height_m.unwrap();
        assert!((exact_m - height_m).abs() < 1e-6 && sd_m > 0.02 && sd_m < 0.2, "{exact_m} {sd_m}");
        own[2] = seen(2, 0.02);
        let (height, _) = locate(&own).unwrap().height_m.unwrap();
        assert!((height - height_m).abs() > 1e-3 && (height - height_m).abs() < 2.0 * sd_m, "{height}");
        // One elevation is weaker evidence than four; those of a wrong mirror are none.
        own.iter_mut().skip(1).for_each(|one| one.elevation = None);
        assert!(locate(&own).unwrap().height_m.unwrap().1 > 1.2 * sd_m);
        (own[0].mirror_rad, own[0].azimuth_rad) = (Some(own[0].azimuth_rad), own[0].azimuth_rad + 1.0);
        assert_eq!(locate(&own).unwrap().height_m, None);
    }

    #[test]
    fn one_bearing_needs_a_range() {
        let mut one = sighting((0.0, 0.0), (3.0, 0.0), 0.0);
        assert_eq!(locate(std::slice::from_ref(&one)), Err(LocateError::TooFew { sightings: 1 }));
        one.range_m = Some((3.0, 0.3));
        assert!(locate(&[one]).unwrap().position_m.norm() < 1e-3);
        assert_eq!(locate(&[]), Err(LocateError::TooFew { sightings: 0 }));
    }

    #[test]
    fn parallel_bearings_and_foreign_numbers_are_refused() {
        let a = sighting((0.0, 0.0), (3.0, 0.0), 0.0);
        let b = Sighting { transmitter_m: Vector2::new(3.0, 1.0), ..a.clone() };
        assert_eq!(locate(&[a.clone(), b]), Err(LocateError::Parallel));
        let broken = Sighting { azimuth_rad: f64::NAN, ..a.clone() };
        let no_evidence = Sighting { others: vec![(1.0, f64::INFINITY)], ..a.clone() };
        assert_eq!(locate(&[a, broken, no_evidence]), Err(LocateError::TooFew { sightings: 1 }));
    }
}
