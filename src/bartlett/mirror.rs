//! Directions that a motion cannot tell apart: a direction and its reflection in the motion's line or plane.
//!
//! The reflection of `u` in the plane through the motion with the unit normal `n` is `u - 2 (u.n) n`. Over the positions `p` the
//! phases of the two differ by `4 pi g (u.n) (n.p) / lambda`: by the motion's depth along `n` and nothing else. Let `c` be the
//! share of that difference which is found in the samples: 0 if `u` is right, 1 if its reflection is. Two errors blur `c`:
//!
//! * the noise of the samples, with variance `1 / (2 L)`, `L` the logarithm of the likelihood ratio of the two directions,
//!   `looks * ln((E - F') / (E - F))` with the energy `E` and what each direction explains of it (the amplitude and the noise's
//!   variance fitted), `looks` the number of samples whose residuals are independent: other paths leave residuals that are
//!   alike over many samples;
//! * the error of the odometry, with variance `(s / 2 h)^2` for an error of `s` and a depth of `h` (root mean squares), since in
//!   the worst case the error has the course of the depth.
//!
//! Both together leave `D = 1 / (1 / L + s^2 / (2 h^2))` of the logarithm, and the reflection has the share `1 / (1 + e^D)` of
//! the evidence. A reflection with less than one percent is not given.

use super::direction;
use super::scene::{Geometry, Scene, Shape};
use super::search::{Hill, Point, Second, Top};
use crate::maths::wrap_rad;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A trajectory at most this wide for its length may have a mirror.
const ELONGATED: f64 = 0.15;

/// A reflection is excluded by this natural logarithm of the likelihood ratio (ln 99, a share of one percent).
const MIRROR_EXCLUDED: f64 = 4.6;

/// A mirror that the odometry would exclude is reported from this height on.
const MIRROR_RATIO: f64 = 0.8;

/// A plane tilted by less is level, radians (floors and drifting tracking cameras (measured 0.12) tilt by less).
const LEVEL_RAD: f64 = 0.2;

/// A reflection in a level plane whose azimuth differs by less is the elevation's sign, radians (five degrees, as
/// confidence counts).
const SAME_AZIMUTH_RAD: f64 = 0.087;

/// Fewest blocks in which the independence of residuals is judged.
const LEAST_BLOCKS: usize = 8;
/// Share of the energy that is never explained: noise-free samples.
const FLOOR: f64 = 1e-9;

/// A direction that the samples cannot tell from the highest peak.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mirror {
    /// Azimuth and signed elevation, radians.
    pub azimuth: f64,
    pub elevation: f64,
    /// Its share of the evidence of the two, 0 to 1/2.
    pub share: f64,
    /// Unit normal of the plane that it is reflected in.
    pub normal: Vector3<f64>,
}

/// Adds the ambiguities of the motion to a search's result.
pub(super) struct Reflections<'a> {
    pub scene: &'a Scene,
    pub shape: &'a Shape,
    pub hill: &'a Hill<'a>,
    pub best: Top,
    /// Whether the elevation was searched.
    pub elevation: bool,
    /// Assumed error of the positions, turns.
    pub odometry: f64,
    /// Directions closer than this are one, radians.
    pub resolution: f64,
    looks: f64,
}

/// Azimuth of the horizontal part of the longest axis of a motion, if it has one.
pub(super) fn axis(shape: &Shape) -> Option<f64> {
    let axis = shape.axes[0];
    (axis.x.hypot(axis.y) > 0.5).then(|| axis.y.atan2(axis.x))
}

/// True if a side of the motion is thin for the next longer one.
pub(super) fn is_thin(shape: &Shape, side: usize) -> bool {
    shape.half_extent_m[side] <= ELONGATED * shape.half_extent_m[side - 1]
}

impl<'a> Reflections<'a> {
    pub fn new(
        scene: &'a Scene,
        shape: &'a Shape,
        hill: &'a Hill<'a>,
        best: Top,
        [odometry, resolution]: [f64; 2],
        elevation: bool,
    ) -> Self {
        let looks = looks(scene, unit(hill.kind, best.at));
        Self { scene, shape, hill, best, elevation, odometry, resolution, looks }
    }

    /// The class of the motion: which of its sides are deep enough, for the noise and the odometry's error, to
    /// distinguish a direction from its reflection.
    pub fn geometry(&self) -> Geometry {
        if self.shape.geometry == Geometry::Static {
            return Geometry::Static;
        }
        let [_, across, normal] = self.shape.axes;
        if !self.tells(across) {
            Geometry::Line
        } else if !self.tells(normal) {
            if self.tells(Vector3::z()) { Geometry::TiltedPlane } else { Geometry::Planar }
        } else if self.elevation && self.reflected(normal, 2).is_some() {
            Geometry::NearlyPlanar
        } else {
            Geometry::Spatial
        }
    }

    /// The reflection that the samples cannot tell from the highest peak, if it is another direction.
    pub fn mirror(&self) -> Option<Mirror> {
        let [along, across, normal] = self.shape.axes;
        if !odometry_tells(self.scene.depth_squared(along), self.odometry) {
            return None;
        }
        let upright = |azimuth: f64| Vector3::new(-azimuth.sin(), azimuth.cos(), 0.0);
        let about_line = || axis(self.shape).and_then(|azimuth| self.reflected(upright(azimuth), 1));
        let in_plane = (self.elevation && self.tells(across)).then(|| self.reflected(normal, 2)).flatten();
        let another = |mirror: &Mirror| self.is_another(mirror);
        in_plane.filter(another).or_else(|| about_line().filter(another))
    }

    /// Whether a depth as that along `normal` tells a direction at right angles to the motion from its reflection.
    fn tells(&self, normal: Vector3<f64>) -> bool {
        let depth = self.scene.depth_squared(normal);
        let snr = self.explained(self.best.value) / self.unexplained(self.best.value);
        // The loss of a wave by a phase error, as a share of its explained energy.
        let lost = 1.0 - (-(2.0 * TAU).powi(2) * depth).exp();
        evidence(self.looks * (snr * lost).ln_1p(), depth, self.odometry) >= MIRROR_EXCLUDED
    }

    fn explained(&self, value: f64) -> f64 {
        value / self.scene.weight_sum
    }

    fn unexplained(&self, value: f64) -> f64 {
        (self.scene.energy - self.explained(value)).max(FLOOR * self.scene.energy)
    }

    /// The highest peak reflected, if the samples cannot tell; `side` is the axis of the shape that `normal` belongs to.
    fn reflected(&self, normal: Vector3<f64>, side: usize) -> Option<Mirror> {
        let towards = unit(self.hill.kind, self.best.at);
        let image = towards - normal * (2.0 * towards.dot(&normal));
        let (azimuth, elevation) = (image.y.atan2(image.x), image.z.clamp(-1.0, 1.0).asin());
        let hill = self.hill_for(side);
        let start = Point { azimuth, second: hill.kind.of_elevation(elevation) };
        let top = hill.climb(start);
        let near = unit(hill.kind, top.at).dot(&image) > (2.0 * self.resolution).min(FRAC_PI_2).cos();
        let value = if near { top.value } else { hill.value(start) };
        let logarithm = self.looks * (self.unexplained(value) / self.unexplained(self.best.value)).ln();
        let depth = self.scene.depth_squared(normal);
        let against = evidence(logarithm.max(0.0), depth, self.odometry);
        let by_shape = odometry_tells(depth, self.odometry)
            && !(is_thin(self.shape, side) && value >= MIRROR_RATIO * self.best.value);
        // Of a line the peak itself, since its course bends both directions; of a plane the image, which is exact.
        let at = if near && side == 1 { top.at.azimuth } else { azimuth };
        (against < MIRROR_EXCLUDED && !by_shape).then(|| Mirror {
            azimuth: wrap_rad(at),
            elevation,
            share: 1.0 / (1.0 + against.exp()),
            normal,
        })
    }

    /// The search's own region about a line; all elevations about a plane.
    fn hill_for(&self, side: usize) -> Hill<'a> {
        if side == 1 || self.scene.is_flat() {
            return *self.hill;
        }
        Hill { kind: Second::Elevation, low: -FRAC_PI_2, high: FRAC_PI_2, ..*self.hill }
    }

    /// True unless it is the same direction, or differs by the sign of the elevation alone.
    fn is_another(&self, mirror: &Mirror) -> bool {
        let off = wrap_rad(mirror.azimuth - self.best.at.azimuth).abs();
        if is_level(&mirror.normal, off) {
            return false;
        }
        let image = direction(mirror.azimuth, mirror.elevation);
        unit(self.hill.kind, self.best.at).dot(&image) < self.resolution.min(FRAC_PI_2).cos()
    }
}

/// True if a reflection in the plane with a normal, `off` radians away in azimuth, is no more than the sign of the elevation.
fn is_level(normal: &Vector3<f64>, off: f64) -> bool {
    normal.z.abs() > LEVEL_RAD.cos() && off < SAME_AZIMUTH_RAD
}

/// What is left of the logarithm of a likelihood ratio by an odometry whose error is `odometry` against a depth (squared).
fn evidence(logarithm: f64, depth_squared: f64, odometry: f64) -> f64 {
    1.0 / (1.0 / logarithm + odometry * odometry / (2.0 * depth_squared))
}

/// Whether a depth (squared) is significant for an odometry with the error `odometry`, without noise.
pub(super) fn odometry_tells(depth_squared: f64, odometry: f64) -> bool {
    evidence(f64::INFINITY, depth_squared, odometry) >= MIRROR_EXCLUDED
}

/// The unit vector of a point of a search.
fn unit(kind: Second, at: Point) -> Vector3<f64> {
    direction(at.azimuth, kind.elevation(at.second))
}

/// Number of independent residuals that a plane wave from `towards` leaves: the samples over the number of them that share
/// an error. That is the largest ratio, over block lengths of powers of two, of the blocks' variance to that of
/// independent residuals.
fn looks(scene: &Scene, towards: Vector3<f64>) -> f64 {
    let phase = |t: usize| TAU * (towards.x * scene.x[t] + towards.y * scene.y[t] + towards.z * scene.z[t]);
    let turned = |t: usize| Complex64::new(scene.re[t], scene.im[t]) * Complex64::cis(-phase(t));
    let mut rest: Vec<Complex64> = (0..scene.len()).map(turned).collect();
    let amplitude = rest.iter().sum::<Complex64>() / scene.weight_sum;
    rest.iter_mut().zip(&scene.weight).for_each(|(z, w)| *z -= amplitude * w);
    let single: f64 = rest.iter().map(Complex64::norm_sqr).sum::<f64>() / rest.len() as f64;
    let (samples, mut shared, mut length) = (rest.len() as f64, 1.0f64, 1usize);
    while rest.len() / 2 >= LEAST_BLOCKS {
        rest = rest.chunks_exact(2).map(|pair| pair[0] + pair[1]).collect();
        length *= 2;
        let mean = rest.iter().map(Complex64::norm_sqr).sum::<f64>() / rest.len() as f64;
        if single > 0.0 {
            shared = shared.max(mean / (length as f64 * single));
        }
    }
    samples / shared
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bartlett::search::tests::{Parts, noise, samples};
    use crate::bartlett::{Estimate, SearchOptions, search};
    use crate::signal::samples::Samples;
    use nalgebra::{Rotation3, Unit};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::PI;

    /// A motion in a plane, wobbling out of it, as odometry reports it.
    struct Motion {
        /// Where the receiver was.
        true_m: Vec<Vector3<f64>>,
        /// Where the odometry has it.
        reported_m: Vec<Vector3<f64>>,
        /// Normal of the plane.
        normal: Vector3<f64>,
    }

    /// An ellipse in the plane across `normal`, with a wobble of `wobble_m` (amplitude) and an odometry error of `error_m`
    /// (standard deviation, each axis).
    fn ellipse(normal: Vector3<f64>, sides_m: [f64; 2], wobble_m: f64, error_m: f64, rng: &mut ChaCha8Rng) -> Motion {
        let turn = Rotation3::rotation_between(&Vector3::z(), &normal).unwrap_or_else(Rotation3::identity);
        let (phase, waves) = (TAU * rng.random::<f64>(), 2.0 + 3.0 * rng.random::<f64>());
        let at = |t: usize| {
            let a = TAU * t as f64 / 250.0;
            turn * Vector3::new(sides_m[0] * a.cos(), sides_m[1] * a.sin(), wobble_m * (waves * a + phase).sin())
        };
        let true_m: Vec<Vector3<f64>> = (0..250).map(at).collect();
        let reported_m = true_m.iter().map(|p| p + error(error_m, rng)).collect();
        Motion { true_m, reported_m, normal }
    }

    fn error(sd: f64, rng: &mut ChaCha8Rng) -> Vector3<f64> {
        let (a, b) = (noise(rng), noise(rng));
        Vector3::new(a.re, a.im, b.re) * (sd * 2f64.sqrt())
    }

    /// The samples of a motion, at the places that the odometry reports.
    fn heard(motion: &Motion, towards: (f64, f64), snr_db: f64, rng: &mut ChaCha8Rng) -> Samples {
        let paths = [(towards.0, towards.1, Complex64::new(1.0, 0.0))];
        let mut parts = Parts::of(&samples(&motion.true_m, &paths, 10f64.powf(-snr_db / 10.0), rng));
        parts.receiver_m = motion.reported_m.clone();
        parts.samples().unwrap()
    }

    fn everywhere() -> SearchOptions {
        SearchOptions { elevation_max_rad: PI / 2.0, ..SearchOptions::default() }
    }

    /// The directions of an answer: its own and its mirror.
    fn directions(found: &Estimate) -> Vec<Vector3<f64>> {
        let own = direction(found.azimuth_rad, found.signed_elevation_rad.unwrap_or(found.abs_elevation_rad));
        let mirror = found.mirror_rad.map(|azimuth| direction(azimuth, found.mirror_elevation_rad.unwrap_or(0.0)));
        std::iter::once(own).chain(mirror).collect()
    }

    fn between_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        a.dot(b).clamp(-1.0, 1.0).acos().to_degrees()
    }

    fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
        low + (high - low) * rng.random::<f64>()
    }

    #[test]
    fn a_tilted_plane_has_both_its_directions() {
        let mut rng = ChaCha8Rng::seed_from_u64(31);
        let (mut cases, mut missed) = (0, Vec::new());
        while cases < 500 {
            let (tilt, lean) = (uniform(&mut rng, 0.25, 1.5), uniform(&mut rng, -PI, PI));
            let normal = direction(lean, PI / 2.0 - tilt);
            let towards = (uniform(&mut rng, -PI, PI), uniform(&mut rng, -75f64, 75.0).to_radians());
            let truth = direction(towards.0, towards.1);
            let image = truth - normal * (2.0 * truth.dot(&normal));
            // Nearer than that the two are one peak, whose depth is poorly known.
            if between_deg(&truth, &image) < 15.0 {
                continue;
            }
            cases += 1;
            let sides_m = [uniform(&mut rng, 0.1, 0.18), uniform(&mut rng, 0.06, 0.1)];
            let (wobble_m, error_m) = (uniform(&mut rng, 0.0, 0.003), uniform(&mut rng, 0.0, 0.002));
            let motion = ellipse(normal, sides_m, wobble_m, error_m, &mut rng);
            let snr_db = uniform(&mut rng, 10.0, 25.0);
            let found = search(&heard(&motion, towards, snr_db, &mut rng), &everywhere()).unwrap();
            let given = directions(&found);
            let has = |wanted: &Vector3<f64>| given.iter().any(|u| between_deg(u, wanted) < 2.0);
            if !(given.len() == 2 && has(&truth) && has(&image)) {
                missed.push((tilt, towards, wobble_m, found.geometry, given, truth, image));
            }
            let share = found.mirror_share.unwrap_or(0.0);
            assert!((0.0..=0.5).contains(&share) && motion.normal == normal);
        }
        assert!(missed.is_empty(), "{} of {cases}: {:?}", missed.len(), missed.first());
    }

    #[test]
    fn a_depth_well_above_noise_and_odometry_has_no_mirror() {
        let mut rng = ChaCha8Rng::seed_from_u64(32);
        let mut given = Vec::new();
        for case in 0..300 {
            let normal = direction(uniform(&mut rng, -PI, PI), uniform(&mut rng, 0.0, PI / 2.0));
            let towards = (uniform(&mut rng, -PI, PI), uniform(&mut rng, -75f64, 75.0).to_radians());
            let truth = direction(towards.0, towards.1);
            if truth.dot(&normal).abs() < 0.2 {
                continue;
            }
            // Root mean square 10 to 35 mm: three times the assumed error and more.
            let (wobble_m, error_m) = (uniform(&mut rng, 0.014, 0.05), uniform(&mut rng, 0.0, 0.002));
            let sides_m = [uniform(&mut rng, 0.12, 0.18), uniform(&mut rng, 0.08, 0.12)];
            let motion = ellipse(normal, sides_m, wobble_m, error_m, &mut rng);
            let snr_db = uniform(&mut rng, 10.0, 25.0);
            let found = search(&heard(&motion, towards, snr_db, &mut rng), &everywhere()).unwrap();
            if found.mirror_rad.is_some() || between_deg(&directions(&found)[0], &truth) > 2.0 {
                given.push((case, wobble_m, towards, found.geometry, found.mirror_share));
            }
        }
        assert!(given.is_empty(), "{}: {:?}", given.len(), given.first());
    }

    #[test]
    fn a_line_that_wobbles_by_less_than_odometry_errs_has_a_mirror() {
        let mut rng = ChaCha8Rng::seed_from_u64(33);
        for case in 0..100 {
            let axis = uniform(&mut rng, -PI, PI);
            let off = uniform(&mut rng, 0.4, PI - 0.4);
            let wobble_m = uniform(&mut rng, 0.0, 0.003);
            let half_m = uniform(&mut rng, 0.25, 0.9);
            let side = Vector3::new(-axis.sin(), axis.cos(), 0.0);
            let bow = uniform(&mut rng, 1.0, 9.0);
            let at = |t: usize| {
                let s = 2.0 * t as f64 / 599.0 - 1.0;
                direction(axis, 0.0) * (half_m * s)
                    + side * (wobble_m * (bow * s).cos())
                    + Vector3::z() * (wobble_m * (2.0 * bow * s).sin())
            };
            let true_m: Vec<Vector3<f64>> = (0..600).map(at).collect();
            let reported_m: Vec<Vector3<f64>> = true_m.iter().map(|p| p + error(0.001, &mut rng)).collect();
            let motion = Motion { true_m, reported_m, normal: side };
            let samples = heard(&motion, (axis + off, 0.0), uniform(&mut rng, 10.0, 25.0), &mut rng);
            let found = search(&samples, &SearchOptions::default()).unwrap();
            assert_eq!(found.geometry, Geometry::Line, "case {case}: {wobble_m}");
            let pair = [Some(found.azimuth_rad), found.mirror_rad];
            for expected in [axis + off, axis - off] {
                let near = |a: &f64| wrap_rad(a - expected).abs() < 0.03;
                assert!(
                    pair.iter().flatten().any(near),
                    "case {case}: {pair:?} without {expected} ({wobble_m} m) {axis} {off} {half_m} {bow} {:?}",
                    found.shape
                );
            }
            assert!(found.mirror_share.unwrap() > 0.05, "case {case}: {:?}", found.mirror_share);
        }
    }

    #[test]
    fn level_motion_hides_the_sign_of_the_elevation_and_no_more() {
        let mut rng = ChaCha8Rng::seed_from_u64(34);
        for case in 0..60 {
            // Up to three degrees off level, as a floor and a tracking camera are.
            let tilt = Unit::new_normalize(Vector3::new(uniform(&mut rng, -0.05, 0.05), 0.0, 1.0)).into_inner();
            let motion = ellipse(tilt, [0.3, 0.25], 0.002, 0.001, &mut rng);
            let towards = (uniform(&mut rng, -PI, PI), uniform(&mut rng, 0.0, 0.3));
            let found = search(&heard(&motion, towards, 15.0, &mut rng), &SearchOptions::default()).unwrap();
            assert_eq!((found.mirror_rad, found.signed_elevation_rad), (None, None), "case {case}: {found:?}");
            assert!(
                matches!(found.geometry, Geometry::Planar | Geometry::TiltedPlane),
                "case {case}: {:?}",
                found.geometry
            );
        }
    }

    #[test]
    fn a_better_odometry_tells_what_a_worse_one_cannot() {
        let mut rng = ChaCha8Rng::seed_from_u64(35);
        let normal = direction(0.4, 0.7);
        let motion = ellipse(normal, [0.3, 0.2], 0.006, 0.0, &mut rng);
        let samples = heard(&motion, (2.0, 0.2), 20.0, &mut rng);
        let with = |sd_m: f64| search(&samples, &SearchOptions { odometry_sd_m: sd_m, ..everywhere() }).unwrap();
        let (poor, good) = (with(0.01), with(0.0005));
        assert!(poor.mirror_rad.is_some() && poor.geometry == Geometry::TiltedPlane, "{poor:?}");
        assert!(good.mirror_rad.is_none() && good.geometry == Geometry::Spatial, "{good:?}");
        assert!((good.signed_elevation_rad.unwrap() - 0.2).abs() < 0.02);
    }
}
