//! Which directions a motion tells apart, over random motions.

use super::*;
use nalgebra::{Rotation3, Unit};

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
    SearchOptions::default().with_elevation_max_rad(PI / 2.0)
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
