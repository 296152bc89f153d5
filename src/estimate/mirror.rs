//! Directions that a motion hardly distinguishes: a direction and its reflection in the motion's line or plane.
//!
//! Over the positions `p` the phases of the two differ by `4 pi g (u.n) (n.p) / lambda`, by the motion's depth along the normal
//! `n` and nothing else. An error of the odometry of the size of that depth, with its course, makes one into the other. So of
//! the posterior of each direction the share `1 / (1 + e^D)` belongs to its reflection, with `1 / D = 1 / L + s^2 / (2 h^2)`
//! for an odometry error of `s`, a depth of `h` beyond it (root mean squares) and the logarithm `L` of the likelihood ratio of the
//! two. The posterior of windows holds `L` by itself. A heading that drifts bends a straight path to both sides, so `s` holds the
//! bend, too.

use super::farthest_m;
use super::likelihood::{Place, Ways};
use super::posterior::{Atom, Mode, Steps, add, settle};
use super::prior::Prior;
use crate::maths::wrap_rad;
use crate::signal::samples::Samples;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// A reflection with less than this share is not given.
const LEAST: f64 = 0.01;
/// Values are two if they differ by this many standard deviations.
const APART: f64 = 3.0;

/// What became of reflections.
pub(super) struct Mirrored {
    /// The reflection of the first mode, among the others.
    pub of_first: Option<usize>,
    /// Whether the motion does not tell up from down after all.
    pub level: bool,
}

/// What odometry gets wrong of a path.
#[derive(Clone, Copy)]
pub(super) struct Odometry {
    /// Positions from moment to moment, metres.
    pub sd_m: f64,
    /// The bend of the path, radians ([`super::heading::bend_rad`]).
    pub bend_rad: f64,
}

impl Odometry {
    /// Mean square of the errors along a normal, metres squared, on a path of this radius. A curve of `2 d / radius` leaves the chord
    /// of a straight path by `4 d radius / sqrt(180)` (root mean square).
    fn error2(self, normal: &Vector3<f64>, radius_m: f64) -> f64 {
        let bent_m = 4.0 / 180f64.sqrt() * self.bend_rad * radius_m;
        self.sd_m * self.sd_m + bent_m * bent_m * normal.xy().norm_squared()
    }
}

/// A plane through the motion that it hardly leaves.
struct Plane {
    normal: Vector3<f64>,
    /// Mean squares of the distances from it, and of what odometry gets wrong of them, metres squared.
    depth2: f64,
    error2: f64,
}

impl Plane {
    fn across(normal: Vector3<f64>, points: &[Vector3<f64>], odometry: Odometry) -> Self {
        let depth2 = points.iter().map(|p| normal.dot(p).powi(2)).sum::<f64>() / points.len().max(1) as f64;
        Self { normal, depth2, error2: odometry.error2(&normal, farthest_m(points)) }
    }
}

/// The directions in which a motion extends most, less and least.
fn axes(points: &[Vector3<f64>]) -> [Vector3<f64>; 3] {
    let scatter: Matrix3<f64> =
        points.iter().map(|p| p * p.transpose()).sum::<Matrix3<f64>>() / points.len().max(1) as f64;
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    order.map(|k| eigen.eigenvectors.column(k).into_owned())
}

/// Whether a motion may be along a line: then azimuth and elevation of a wave are one unknown.
pub(super) fn is_line(points: &[Vector3<f64>], odometry: Odometry) -> bool {
    let [_, across, _] = axes(points);
    share(f64::INFINITY, &Plane::across(across, points, odometry)) >= LEAST
}

/// The plane that a motion lies nearest to, or of a line the upright one along it.
fn planes(points: &[Vector3<f64>], prior: &Prior, odometry: Odometry) -> Vec<Plane> {
    let [along, _, normal] = axes(points);
    // Upright and along the motion: what a level motion, or a line in space, has on either side of it. What lies about a line
    // beyond that, the elevations say.
    let on_its_sides = Vector3::new(-along.y, along.x, 0.0).try_normalize(1e-6);
    let normal = if prior.is_signed() && !is_line(points, odometry) { Some(normal) } else { on_its_sides };
    normal.map(|normal| Plane::across(normal, points, odometry)).into_iter().collect()
}

/// A place reflected in a plane.
fn reflected(place: &Place, normal: &Vector3<f64>, signed: bool) -> Place {
    let towards = place.towards();
    let image = towards - normal * (2.0 * towards.dot(normal));
    let elevation = image.z.clamp(-1.0, 1.0).asin();
    Place {
        azimuth: image.y.atan2(image.x),
        elevation: if signed { elevation } else { elevation.abs() },
        curve: place.curve,
    }
}

/// The share of a reflection.
fn share(log_ratio: f64, plane: &Plane) -> f64 {
    // Noise of the odometry looks like depth.
    let true_depth2 = (plane.depth2 - plane.error2).max(1e-18);
    let by_shape = plane.error2 / (2.0 * true_depth2);
    let against = 1.0 / (1.0 / log_ratio.max(1e-9) + by_shape);
    1.0 / (1.0 + against.exp())
}

/// Gives each mode's reflections their shares.
pub(super) fn mix(
    modes: &mut Vec<Mode>,
    points: &[Vector3<f64>],
    steps: &Steps,
    prior: &Prior,
    odometry: Odometry,
) -> Mirrored {
    let shares = |_: &Place, plane: &Plane| share(f64::INFINITY, plane);
    mixed(modes, planes(points, prior, odometry), steps.azimuth(), prior, &shares)
}

/// The same of one wave: `L` is that of independent samples.
pub(super) fn of_one_wave(
    modes: &mut Vec<Mode>,
    (samples, ways): (&Samples, Ways<'_>),
    points: &[Vector3<f64>],
    prior: &Prior,
    steps: &Steps,
    odometry: Odometry,
) -> Mirrored {
    let unexplained = |place: &Place| (1.0 - ways.explained(samples, place)).max(1e-9);
    let shares = |place: &Place, plane: &Plane| {
        let image = reflected(place, &plane.normal, prior.is_signed());
        let ratio = samples.len() as f64 * (unexplained(&image) / unexplained(place)).ln();
        share(ratio.max(0.0), plane)
    };
    mixed(modes, planes(points, prior, odometry), apart_rad(modes, steps), prior, &shares)
}

/// The difference from which two azimuths of one wave are two directions.
pub(super) fn apart_rad(modes: &[Mode], steps: &Steps) -> f64 {
    let sd_rad = modes.first().map_or(0.0, |mode| mode.covariance[(0, 0)].max(0.0).sqrt());
    steps.azimuth().min(APART * sd_rad)
}

/// `apart_rad` is the difference from which two azimuths are two directions.
fn mixed(
    modes: &mut Vec<Mode>,
    planes: Vec<Plane>,
    apart_rad: f64,
    prior: &Prior,
    shares: &dyn Fn(&Place, &Plane) -> f64,
) -> Mirrored {
    let (mut plane_of_mirror, mut level) = (None, false);
    let first = modes.first().map(|mode| mode.place);
    for plane in planes {
        let Some(first) = first else { break };
        let own = shares(&first, &plane);
        if own < LEAST {
            continue;
        }
        let image = reflected(&first, &plane.normal, prior.is_signed());
        if wrap_rad(image.azimuth - first.azimuth).abs() < apart_rad {
            let within_rad = APART * modes[0].covariance[(1, 1)].max(0.0).sqrt();
            let flips = plane.normal.z.abs() > 0.9 && (image.elevation + first.elevation).abs() < within_rad;
            level |= flips;
            // Nothing but the sign of the elevation, or a wave along the plane or line itself.
            if flips || (image.elevation - first.elevation).abs() < within_rad {
                continue;
            }
        }
        let images: Vec<Mode> = modes.iter().map(|mode| image_of(mode, &plane, own, prior.is_signed())).collect();
        modes.iter_mut().for_each(|mode| mode.scale(1.0 - own));
        add(modes, images, apart_rad);
        settle(modes);
        plane_of_mirror = Some(plane);
    }
    let of_first = plane_of_mirror.and_then(|plane| {
        let (first, others) = modes.split_first()?;
        let image = reflected(&first.place, &plane.normal, prior.is_signed());
        let near = |mode: &Mode| wrap_rad(mode.place.azimuth - image.azimuth).abs() < 2.0 * apart_rad;
        others.iter().position(near).map(|k| k + 1)
    });
    Mirrored { of_first, level }
}

/// A mode as its reflection has it, with a share of its probability.
fn image_of(mode: &Mode, plane: &Plane, share: f64, signed: bool) -> Mode {
    let place = reflected(&mode.place, &plane.normal, signed);
    let atom = |atom: &Atom| {
        let at = Place { azimuth: atom.azimuth, ..mode.place };
        Atom { azimuth: reflected(&at, &plane.normal, signed).azimuth, mass: share * atom.mass, ..*atom }
    };
    // What the azimuth has in common with elevation and range changes its sign.
    let turn = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    Mode {
        place,
        covariance: turn * mode.covariance * turn,
        mass: share * mode.mass,
        atoms: mode.atoms.iter().map(atom).collect(),
    }
}
