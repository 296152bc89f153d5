//! Where a peer is, from several motions that are seen in one frame: all evidence at once, on a grid of the plane.
//!
//! The logarithms of what each motion says of a place are summed over the motions, and the sum is weighed by
//! [`temper`]: motions are deceived together. The grid begins coarse and wide; cells that hold nearly all of the
//! probability are cut in four until they are small. A cell's likelihood is that of directions and ranges blurred by the
//! cell, so that no peak falls between the centres of coarse cells.

use super::evidence::Evidence;
use super::peer_track::TrackError;
use super::settings::temper;
use super::spot::Spot;
use crate::place::track::settings::{OWN_SHARE, ROOM_M};
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Side of the first cells and of the last, metres.
const FIRST_M: f64 = 1.0;
const LAST_M: f64 = 0.05;
/// Farthest place from the middle of all motions, beside how far they are from it, metres.
const FARTHEST_M: f64 = 40.0;
/// Probability that the cells that are cut hold together.
const KEPT: f64 = 0.999;
/// Cells at most.
const MOST_CELLS: usize = 60_000;
/// Places of an answer at most, and the least share of one.
const MOST_PLACES: usize = 5;
const LEAST_SHARE: f64 = 0.02;
/// Squared distance, in standard deviations, within which 68 % of a plane's normal distribution is.
const ELLIPSE: f64 = 2.278_868_566_376_729_5;
/// A place ends where its probability is this share of the highest: three standard deviations.
const ENDS: f64 = 0.011_108_996_538_242_306;

/// A place where the peer may be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PeerPlace {
    /// Its middle, metres in the frame of the evidence.
    pub position_m: Vector2<f64>,
    /// Its covariance, metres squared: that of the normal distribution of whose probability as much as of this place's,
    /// 68 %, is within 1.51 standard deviations.
    pub covariance_m2: Matrix2<f64>,
    /// Probability that the peer is there.
    pub share: f64,
}

/// What several motions say together.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PeerPlaces {
    /// The places where the peer may be, the likeliest first; one at least.
    pub places: Vec<PeerPlace>,
    /// Motions that were used.
    pub used: usize,
    /// Refused motions: a number that is not finite, or no usable direction.
    pub refused: usize,
}

/// Where a peer that stands still is, from motions whose positions and azimuths are in one frame, in any order.
///
/// # Errors
/// [`TrackError`] of the first motion where none can be used, or [`TrackError::NoDirection`] without any.
pub fn places(evidence: &[Evidence]) -> Result<PeerPlaces, TrackError> {
    let usable: Vec<&Evidence> = evidence.iter().filter(|own| own.check().is_ok()).collect();
    if usable.is_empty() {
        return Err(evidence.iter().find_map(|own| own.check().err()).unwrap_or(TrackError::NoDirection { modes: 0 }));
    }
    let sum_m = usable.iter().fold(Vector2::zeros(), |sum, own| sum + own.position_m);
    let middle_m = sum_m / usable.len() as f64;
    let plane = Plane { spots: usable.iter().map(|own| Spot::of(own)).collect(), middle_m };
    let (cells, side_m) = plane.refined(&usable);
    Ok(PeerPlaces {
        places: clusters(cells, middle_m, side_m),
        used: usable.len(),
        refused: evidence.len() - usable.len(),
    })
}

/// A cell of the grid: how many sides its centre is from the middle along x and y, in halves.
type Cell = (i32, i32);

/// The evidence, and where the grid has its middle.
struct Plane {
    spots: Vec<Spot>,
    middle_m: Vector2<f64>,
}

impl Plane {
    /// The cells of the last grid with their probabilities, and their side, metres.
    fn refined(&self, evidence: &[&Evidence]) -> (BTreeMap<Cell, f64>, f64) {
        let spread_m = evidence.iter().map(|own| (own.position_m - self.middle_m).norm()).fold(0.0, f64::max);
        let mut side_m = FIRST_M.max((FARTHEST_M + spread_m) / 120.0);
        let half = ((FARTHEST_M + spread_m) / side_m).ceil() as i32;
        let along = || (-half..half).map(|k| 2 * k + 1);
        let mut cells = self.weighed(along().flat_map(|x| along().map(move |y| (x, y))), side_m);
        // A cell's number stays far below what an integer holds, however far apart motions are.
        for _ in 0..20 {
            let kept = likeliest(&cells);
            if side_m <= LAST_M || 4 * kept.len() > MOST_CELLS {
                break;
            }
            side_m *= 0.5;
            let quarters = kept.into_iter().flat_map(|(x, y)| {
                [(2 * x - 1, 2 * y - 1), (2 * x - 1, 2 * y + 1), (2 * x + 1, 2 * y - 1), (2 * x + 1, 2 * y + 1)]
            });
            cells = self.weighed(quarters, side_m);
        }
        (cells, side_m)
    }

    /// The probability of each cell; their sum is 1.
    fn weighed(&self, cells: impl Iterator<Item = Cell>, side_m: f64) -> BTreeMap<Cell, f64> {
        let exponent = temper(self.spots.iter().map(Spot::known).sum(), OWN_SHARE);
        let room = ROOM_M * ROOM_M;
        let ln = |cell: Cell| {
            let offset_m = offset_m(cell, side_m);
            let prior = -(room + offset_m.norm_squared()).ln();
            let said = |spot: &Spot| spot.ln_likelihood(self.middle_m + offset_m, 0.5 * side_m);
            prior + exponent * self.spots.iter().map(said).sum::<f64>()
        };
        let found: Vec<(Cell, f64)> = cells.map(|cell| (cell, ln(cell))).collect();
        let most = found.iter().map(|(_, ln)| *ln).fold(f64::MIN, f64::max);
        let total: f64 = found.iter().map(|(_, ln)| (ln - most).exp()).sum();
        found.into_iter().map(|(cell, ln)| (cell, (ln - most).exp() / total)).collect()
    }
}

/// From the grid's middle to a cell's centre, metres.
fn offset_m((x, y): Cell, side_m: f64) -> Vector2<f64> {
    Vector2::new(f64::from(x), f64::from(y)) * (0.5 * side_m)
}

/// The fewest cells that hold [`KEPT`] of the probability.
fn likeliest(cells: &BTreeMap<Cell, f64>) -> Vec<Cell> {
    let mut falling: Vec<(Cell, f64)> = cells.iter().map(|(cell, p)| (*cell, *p)).collect();
    falling.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut sum = 0.0;
    let needed = falling.iter().take_while(|(_, p)| {
        let goes_on = sum < KEPT;
        sum += p;
        goes_on
    });
    needed.map(|(cell, _)| *cell).collect()
}

/// The probability of a cell before any evidence, in a plane as wide as [`FARTHEST_M`].
fn prior(cell: Cell, side_m: f64) -> f64 {
    let room = ROOM_M * ROOM_M;
    let whole = PI * (1.0 + FARTHEST_M * FARTHEST_M / room).ln();
    side_m * side_m / (whole * (room + offset_m(cell, side_m).norm_squared()))
}

/// The connected places about the likeliest cells, each with its mean and covariance. Cells no likelier than before any
/// evidence are no place: they remain if no direction is right.
fn clusters(mut cells: BTreeMap<Cell, f64>, middle_m: Vector2<f64>, side_m: f64) -> Vec<PeerPlace> {
    let mut places: Vec<PeerPlace> = Vec::new();
    let mut falling: Vec<(Cell, f64)> = cells.iter().map(|(cell, p)| (*cell, *p)).collect();
    falling.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (highest, p) in falling {
        if !cells.contains_key(&highest) || p <= prior(highest, side_m) {
            continue;
        }
        let place = place(&connected(&mut cells, highest, ENDS * p), middle_m, side_m);
        if places.is_empty() || place.share >= LEAST_SHARE {
            places.push(place);
        }
        // No place that begins so low holds enough.
        if p * (cells.len() as f64) < LEAST_SHARE {
            break;
        }
    }
    if places.is_empty() {
        places.push(place(&cells.into_iter().collect::<Vec<_>>(), middle_m, side_m));
    }
    places.sort_by(|a, b| b.share.total_cmp(&a.share));
    places.truncate(MOST_PLACES);
    places
}

/// Takes the cells out that are connected to one through cells of at least this probability.
fn connected(cells: &mut BTreeMap<Cell, f64>, from: Cell, least: f64) -> Vec<(Cell, f64)> {
    let (mut taken, mut open) = (Vec::new(), vec![from]);
    while let Some(cell) = open.pop() {
        let Some(p) = cells.get(&cell).copied().filter(|p| *p >= least) else { continue };
        cells.remove(&cell);
        taken.push((cell, p));
        let (x, y) = cell;
        let about = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + 2 * dx, y + 2 * dy)));
        open.extend(about.filter(|other| cells.contains_key(other)));
    }
    taken
}

fn place(cells: &[(Cell, f64)], middle_m: Vector2<f64>, side_m: f64) -> PeerPlace {
    let share: f64 = cells.iter().map(|(_, p)| p).sum();
    let mean = cells.iter().map(|(cell, p)| offset_m(*cell, side_m) * *p).sum::<Vector2<f64>>() / share;
    let square = |(cell, p): &(Cell, f64)| {
        let off = offset_m(*cell, side_m) - mean;
        off * off.transpose() * *p
    };
    let within = Matrix2::identity() * (side_m * side_m / 12.0);
    let spread_m2 = cells.iter().map(square).sum::<Matrix2<f64>>() / share + within;
    let covariance_m2 = spread_m2 * (held(cells, mean, &spread_m2, side_m) / ELLIPSE);
    PeerPlace { position_m: middle_m + mean, covariance_m2, share: share.min(1.0) }
}

/// The square of the distance from the mean, in deviations, within which 68 % of a place is.
fn held(cells: &[(Cell, f64)], mean_m: Vector2<f64>, spread_m2: &Matrix2<f64>, side_m: f64) -> f64 {
    let Some(inverse) = spread_m2.try_inverse() else { return ELLIPSE };
    let away = |(cell, p): &(Cell, f64)| {
        let off_m = offset_m(*cell, side_m) - mean_m;
        (off_m.dot(&(inverse * off_m)), *p)
    };
    let mut rising: Vec<(f64, f64)> = cells.iter().map(away).collect();
    rising.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (total, mut sum) = (rising.iter().map(|(_, p)| p).sum::<f64>(), 0.0);
    let reached = rising.iter().find(|(_, p)| {
        sum += p;
        sum >= 0.68 * total
    });
    // A place of a few cells is known to a cell, not better.
    reached.map_or(ELLIPSE, |(square, _)| square.max(0.25 * ELLIPSE))
}

#[cfg(test)]
mod tests {
    use super::super::evidence::EvidenceMode;
    use super::*;
    use std::f64::consts::TAU;

    const SD_RAD: f64 = 0.04;

    /// The fractional parts of multiples of irrational numbers: even draws without a generator.
    struct Even(u32);

    impl Even {
        fn between(&mut self, low: f64, high: f64) -> f64 {
            self.0 += 1;
            let turned = f64::from(self.0) * 0.618_033_988_749_895 + f64::from(self.0 / 7) * 0.414_213_562_373_095;
            low + (high - low) * turned.fract()
        }

        fn normal(&mut self) -> f64 {
            let (a, b) = (self.between(1e-9, 1.0), self.between(0.0, TAU));
            (-2.0 * a.ln()).sqrt() * b.cos()
        }
    }

    fn motion(from_m: Vector2<f64>, at_m: Vector2<f64>, error_rad: f64, mirror_rad: Option<f64>) -> Evidence {
        let to = at_m - from_m;
        let mut modes = vec![EvidenceMode::new(to.y.atan2(to.x) + error_rad, SD_RAD, 0.5)];
        modes.extend(mirror_rad.map(|azimuth_rad| EvidenceMode::new(azimuth_rad, SD_RAD, 0.5)));
        Evidence::new(0.0, from_m, modes, 0.95)
    }

    #[test]
    fn a_peer_is_in_its_ellipse_as_often_as_that_says() {
        let mut even = Even(0);
        let (mut within, mut shares, mut longer_m, rooms) = (0.0, 0.0, Vec::new(), 60.0);
        for _ in 0..60 {
            let turned = even.between(0.0, TAU);
            let at_m = Vector2::new(turned.cos(), turned.sin()) * even.between(3.0, 6.0);
            let motions: Vec<Evidence> = (0..3)
                .map(|k| {
                    let angle = TAU * f64::from(k) / 3.0 + even.between(-0.5, 0.5);
                    let from_m = Vector2::new(angle.cos(), angle.sin()) * even.between(1.0, 2.0);
                    let mirror_rad = even.between(-PI, PI);
                    motion(from_m, at_m, SD_RAD * even.normal(), (k < 2).then_some(mirror_rad))
                })
                .collect();
            let found = places(&motions).unwrap();
            let best = found.places[0];
            let off = best.position_m - at_m;
            within += f64::from(u8::from(off.dot(&(best.covariance_m2.try_inverse().unwrap() * off)) < 2.28)) / rooms;
            shares += best.share / rooms;
            longer_m.push((ELLIPSE * best.covariance_m2.symmetric_eigenvalues().max()).sqrt());
            assert_eq!((found.used, found.refused), (3, 0));
        }
        // Motions are taken as deceived together, in part; these are not, so the ellipse holds more than 68 %.
        assert!(
            within >= 0.68 && shares > 0.6 && longer_m.iter().sum::<f64>() < 2.5 * rooms,
            "{within} {shares} {longer_m:?}"
        );
    }

    #[test]
    fn turning_and_shifting_the_frame_turns_and_shifts_the_place() {
        let at_m = Vector2::new(4.0, -2.0);
        let seen = [[0.0, 0.0], [1.0, 2.0], [-1.0, 1.0]].map(|from| motion(from.into(), at_m, 0.0, None));
        let (origin_m, yaw_rad) = (Vector2::new(-3.0, 7.0), 2.5);
        let moved = seen.clone().map(|own| own.in_frame(origin_m, yaw_rad));
        let [here, there] = [places(&seen).unwrap(), places(&moved).unwrap()].map(|found| found.places[0]);
        let expected = origin_m + nalgebra::Rotation2::new(yaw_rad) * here.position_m;
        assert!(
            (there.position_m - expected).norm() < 0.12 && (here.position_m - at_m).norm() < 0.5,
            "{here:?} {there:?}"
        );
        let wide = places(&seen.map(|own| own.with_heading_sd_rad(0.1))).unwrap().places[0];
        assert!(wide.covariance_m2.trace() > 1.5 * here.covariance_m2.trace(), "{wide:?}");
    }

    #[test]
    fn one_direction_is_a_long_place_and_a_range_shortens_it() {
        let mut own = motion(Vector2::zeros(), Vector2::new(5.0, 0.0), 0.0, None);
        let long = places(std::slice::from_ref(&own)).unwrap().places[0];
        own.modes[0] = own.modes[0].with_range_m(Some((5.0, 0.3)));
        let short = places(&[own]).unwrap().places[0];
        let along = |place: &PeerPlace| place.covariance_m2[(0, 0)].sqrt();
        assert!(along(&long) > 4.0 && along(&short) < 0.8 * along(&long), "{long:?} {short:?}");
        assert!(long.covariance_m2[(1, 1)] < long.covariance_m2[(0, 0)] / 20.0, "{long:?}");
    }

    #[test]
    fn without_usable_evidence_the_reason_is_given() {
        assert_eq!(places(&[]), Err(TrackError::NoDirection { modes: 0 }));
        let broken = Evidence::new(f64::NAN, Vector2::zeros(), Vec::new(), 0.9);
        assert!(matches!(places(&[broken]), Err(TrackError::NotFinite { what: "time", .. })));
    }
}
