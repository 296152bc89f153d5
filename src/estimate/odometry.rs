//! What a robot's odometry gets wrong, by the phases of one drive.
//!
//! With positions `x` and headings `a` by odometry, the antenna's path is
//!
//! `p = (1 + scale) sum R(turn a) dx + R((1 + turn) a) offset`.
//!
//! The phases to all transmitters have this path in common. In each stretch of each link a spherical wave from an unknown place
//! goes with it, which [`super::likelihood`] judges:
//!
//! 1. **Start.** Every offset on a grid, with every azimuth, coarsely. The best ones that are apart are starts.
//! 2. **Top.** From each, Newton's method for the errors and for every stretch's azimuth, curvature and elevation together. An
//!    elevation shortens level motion as a wrong scale does, so only its prior keeps them apart.
//! 3. **Deviations** from the curvature at the highest top, with a normal prior. All links have the odometry's drift in common: an error that
//!    changes the shape of the path by less than this is not known, however many phases there are. A direction of the four errors that the phases hardly
//!    narrow is left at no error, and followed to one deviation on either side: an offset on a circle about the point that the robot
//!    turned about.
//! 4. **Criterion.** The fit counts only if it is decisively likelier than no error at all, with the share of the prior that the phases
//!    leave (Laplace's approximation).

use super::likelihood::{Field, Place};
use super::signal::{Aperture, Bins};
use super::{Task, channels, heading, tuning};
use crate::maths::unwrap_rad;
use crate::motion::pose::{Pose, Trajectory};
use crate::signal::planes::Planes;
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, SymmetricEigen, Vector3, Vector4};
use num_complex::Complex64;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt;

/// Deviations before anything was heard: scale, turn, and the offset forward and left, metres.
const PRIOR_SD: [f64; 4] = [0.05, 0.05, 0.1, 0.1];
/// Offsets that are tried: so far in every direction, this far apart, metres.
const REACH_M: f64 = 0.3;
const GRID_M: f64 = 0.025;
/// Starts: so many at most, so far apart, metres.
const STARTS: usize = 6;
const APART_M: f64 = 0.06;
/// Azimuths of a coarse search, and its curvatures, 1/m. Bins that are averaged for it.
const AZIMUTHS: usize = 72;
const CURVES: [f64; 2] = [0.07, 0.33];
const THIN: usize = 3;
/// A stretch of the drive, metres, and its fewest bins.
const STRETCH_M: f64 = 1.5;
const LEAST_BINS: usize = 24;
/// Where the motion is judged that cuts stretches and averages phases: this far in front, metres, every turn and every drive moves.
pub(crate) const PROBE_M: f64 = 0.3;
/// `1 - cos` of the elevation and 1 / range, 1/m: means and deviations of the prior ([`super::prior`]).
const FLAT: [f64; 2] = [0.02, 0.0184];
const CURVE: [f64; 2] = [0.18, 0.14];
/// The unit of azimuths, radians.
const AZIMUTH_RAD: f64 = 0.1;
/// Displacements by which derivatives are taken, metres: a tenth of a turn of the phase.
const STEP_M: f64 = 0.0015;
/// Newton's steps: their number, and the longest, in deviations of the prior.
const ITERATIONS: usize = 15;
const LONGEST: f64 = 0.3;
/// What else odometry gets wrong in the shape of a stretch, metres: wheels and cameras drift.
const DRIFT_M: f64 = 0.005;
/// Steps to a deviation that is followed.
const FOLLOWED: u32 = 4;
/// `ln` of how much likelier than no error the errors have to be.
const DECISIVE: f64 = 7.0;
/// An error is known if its deviation is below this share of the prior's.
const NARROWED: f64 = 0.5;
/// Heights of a motion that is not level, as a share of its extent.
const TALL: f64 = 0.2;

/// An error of odometry: the value to correct, and its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OdometryError {
    /// The most probable value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Whether this drive shows it: the deviation is less than half of what it was before anything was heard.
    pub known: bool,
}

/// Errors of a robot's odometry, estimated from the phases of one drive.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OdometryFit {
    /// Metres driven for each metre reported, less 1.
    pub scale: OdometryError,
    /// Radians turned for each radian reported, less 1.
    pub turn: OdometryError,
    /// The antenna seen from the trajectory's point, metres forward.
    pub forward_m: OdometryError,
    /// The same to the left.
    pub left_m: OdometryError,
    /// Standard deviation of the rotation of the whole path that the errors leave, radians: the phases do not show it.
    pub rotation_sd_rad: f64,
    /// `ln` of how much likelier these errors are than none.
    pub log_odds: f64,
    /// Links that it was made of.
    pub links: usize,
    /// Why the bearings use the trajectory as it is; none if they use the corrected one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

impl OdometryFit {
    /// Nothing was fitted.
    pub(crate) fn refused(why: &str) -> Self {
        Self { refused: Some(why.to_owned()), ..Self::default() }
    }

    /// The antenna's trajectory by these errors; none without headings.
    pub(crate) fn corrected(&self, trajectory: &Trajectory) -> Option<Trajectory> {
        let offset_m = Vector3::new(self.forward_m.value, self.left_m.value, 0.0);
        trajectory.with_errors(self.scale.value, self.turn.value, offset_m).ok()
    }

    /// Deviation of the heading of the corrected path, of a `given` one. A deviation that stands for an unknown place of the antenna is
    /// replaced by what the fit leaves open.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn heading_sd_rad(&self, given: f64) -> f64 {
        let own = if given < heading::UNMOUNTED_RAD { given } else { heading::WHEELS_RAD };
        own.hypot(self.rotation_sd_rad)
    }
}

impl fmt::Display for OdometryFit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(why) = &self.refused {
            return writeln!(f, "odometry: not corrected: {why}");
        }
        writeln!(
            f,
            "odometry: corrected by the phases of {} link{}; natural logarithm of the odds against no correction: {:.0}",
            self.links,
            if self.links == 1 { "" } else { "s" },
            self.log_odds
        )?;
        let mut line = |name: &str, error: &OdometryError, unit: &str, by: f64, digits: usize, why: &str| {
            let (value, sd) = (by * error.value, by * error.sd);
            if error.known {
                writeln!(f, "  {name:<8} {value:+.digits$} +- {sd:.digits$} {unit}")
            } else {
                writeln!(f, "  {name:<8} {value:+.digits$} +- {sd:.digits$} {unit}: not shown by this drive; {why}")
            }
        };
        let straight = "drive curves: the robot hardly turned";
        let (turn, place) = if self.rotation_sd_rad > ON_A_CIRCLE_RAD {
            (
                "drive straight and in curves to both sides: the robot turned on one circle",
                "drive straight, too: the robot turned on one circle, and the antenna may be anywhere on a circle about its centre",
            )
        } else {
            (straight, straight)
        };
        line("scale", &self.scale, "%", 100.0, 1, "the offset, or the transmitters' elevations, look the same")?;
        line("turn", &self.turn, "%", 100.0, 1, turn)?;
        line("forward", &self.forward_m, "m", 1.0, 3, place)?;
        line("left", &self.left_m, "m", 1.0, 3, place)
    }
}

/// A path that may be rotated by more than this, radians, was driven on one circle.
const ON_A_CIRCLE_RAD: f64 = 0.05;

/// One link along a stretch of the drive.
pub(crate) struct Stretch {
    link: usize,
    /// By odometry at each bin: position and direction of the nose in the plane, heading, and the transmitter's displacement.
    at_m: Vec<Complex64>,
    nose: Vec<Complex64>,
    heading_rad: Vec<f64>,
    partner_m: Vec<Complex64>,
    /// The probe's path about its middle.
    probe_m: Vec<Complex64>,
    /// Of all bins, and of the average of every few.
    field: Field,
    coarse: Field,
    /// Largest distance of the probe from its middle, metres.
    radius_m: f64,
    /// Deviation of `1 - cos` of the elevation: all stretches of a link have one elevation, each its share of the prior.
    flat_sd: f64,
}

/// The stretches of a link, number `link`. `task` has the samples along the path of a probe [`PROBE_M`] before the trajectory's
/// point, `poses` are those of the trajectory.
pub(crate) fn stretches(
    task: &Task<'_>,
    mut rows: Vec<Planes>,
    used: &[usize],
    poses: &[Pose],
    link: usize,
) -> Result<Vec<Stretch>, &'static str> {
    let headings: Option<Vec<f64>> = poses.iter().map(|pose| pose.heading_rad).collect();
    let headings = unwrap_rad(&headings.ok_or(NO_HEADINGS)?);
    let samples = task.samples;
    let probe: Vec<Vector3<f64>> = samples.receiver_m().to_vec();
    let (low, high) = probe.iter().fold((probe[0], probe[0]), |(low, high), p| (low.inf(p), high.sup(p)));
    if (high - low).z > TALL * (high - low).xy().norm() {
        return Err("the motion is not level");
    }
    let bins = Bins::along(&probe, task.samples.wavelength_m());
    let (_, apertures) = channels(task, &bins, &mut rows, used);
    let means = |of: Vec<Vector3<f64>>| bins.points_m(&of);
    let plane = |of: Vec<Vector3<f64>>| means(of).iter().map(|p| Complex64::new(p.x, p.y)).collect::<Vec<_>>();
    let at_m = plane(poses.iter().map(|pose| pose.position_m).collect());
    let nose = plane(headings.iter().map(|heading| Vector3::new(heading.cos(), heading.sin(), 0.0)).collect());
    let heading_rad: Vec<f64> =
        means(headings.iter().map(|own| Vector3::x() * *own).collect()).iter().map(|own| own.x).collect();
    let partner_m = plane(samples.transmitter_m().to_vec());
    let probe = means(probe);
    let way_m = |points: &[Vector3<f64>]| points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>();
    let count = (way_m(&probe) / STRETCH_M).ceil().max(1.0) as usize;
    let cut = |part: usize| part * probe.len() / count;
    let one = |part: usize| {
        let own = cut(part)..cut(part + 1);
        let points = &probe[own.clone()];
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let gain = f64::from(samples.path_gain());
        let independent = (2.0 * way_m(points) * gain / samples.wavelength_m()).min(points.len() as f64);
        let field = |points: &[Vector3<f64>], apertures| {
            Field::new(points, apertures, samples.wavelength_m(), independent, tuning::WINDOW_LENGTHS, task.tier)
        };
        let of = |aperture: &Aperture| Aperture {
            path_gain: aperture.path_gain,
            rows: aperture.rows[own.clone()].to_vec(),
            energy: aperture.energy[own.clone()].to_vec(),
        };
        let apertures: Vec<Aperture> = apertures.iter().map(of).collect();
        Stretch {
            link,
            at_m: at_m[own.clone()].to_vec(),
            nose: nose[own.clone()].to_vec(),
            heading_rad: heading_rad[own.clone()].to_vec(),
            partner_m: partner_m[own.clone()].to_vec(),
            probe_m: points.iter().map(|p| p - middle).map(|p| Complex64::new(p.x, p.y)).collect(),
            coarse: field(&thinned(points), apertures.iter().map(Aperture::thinned).collect()),
            field: field(points, apertures),
            radius_m: points.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max),
            flat_sd: FLAT[1] * (count as f64).sqrt(),
        }
    };
    Ok((0..count).filter(|part| cut(part + 1) - cut(*part) >= LEAST_BINS).map(one).collect())
}

/// The mean of every few points.
fn thinned(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    points.chunks(THIN).map(|few| few.iter().sum::<Vector3<f64>>() / few.len() as f64).collect()
}

impl Aperture {
    /// The mean of every few rows.
    fn thinned(&self) -> Self {
        let mean = |few: &[_]| -> [f32; 2 * super::signal::COLUMNS] {
            std::array::from_fn(|k| {
                few.iter().map(|row: &[f32; 2 * super::signal::COLUMNS]| row[k]).sum::<f32>() / few.len() as f32
            })
        };
        Self {
            path_gain: self.path_gain,
            rows: self.rows.chunks(THIN).map(mean).collect(),
            energy: self.energy.chunks(THIN).map(|few| few.iter().sum::<f64>() / few.len() as f64).collect(),
        }
    }
}

/// Errors in deviations of the prior.
type Errors = Vector4<f64>;
/// What is unknown of a stretch: azimuth from the direction of the path, `1 - cos` of the elevation, 1 / range, each in its unit.
type Unknown = Vector3<f64>;

impl Stretch {
    /// The antenna's path about its middle, metres, shortened by `flat`.
    fn path(&self, errors: &Errors, flat: f64) -> Vec<Vector3<f64>> {
        let [scale, turn, forward, left] = std::array::from_fn(|k| PRIOR_SD[k] * errors[k]);
        let offset = Complex64::new(forward, left);
        let first = self.heading_rad[0];
        let turned = |heading: f64| if turn == 0.0 { Complex64::ONE } else { Complex64::cis(turn * (heading - first)) };
        let (mut at, mut sum) = (Complex64::ZERO, Complex64::ZERO);
        let mut path = Vec::with_capacity(self.at_m.len());
        for k in 0..self.at_m.len() {
            if k > 0 {
                let middle = 0.5 * (self.heading_rad[k - 1] + self.heading_rad[k]);
                at += (self.at_m[k] - self.at_m[k - 1]) * turned(middle) * (1.0 + scale);
            }
            path.push(at + self.nose[k] * turned(self.heading_rad[k]) * offset - self.partner_m[k]);
            sum += path[k];
        }
        let middle = sum / path.len() as f64;
        path.iter().map(|p| (p - middle) * (1.0 - flat)).map(|p| Vector3::new(p.re, p.im, 0.0)).collect()
    }

    /// By how much a path is turned against the probe's, radians.
    fn turned_rad(&self, path: &[Vector3<f64>]) -> f64 {
        let both = path.iter().zip(&self.probe_m).map(|(p, probe)| Complex64::new(p.x, p.y) * probe.conj());
        both.sum::<Complex64>().arg()
    }

    /// `ln` of likelihood and prior of what is unknown of the stretch.
    fn log(&mut self, errors: &Errors, unknown: &Unknown) -> f64 {
        let path = self.path(errors, FLAT[0] + self.flat_sd * unknown[1]);
        self.field.set_points(&path);
        let azimuth = AZIMUTH_RAD * unknown[0] + self.turned_rad(&path);
        let place = Place { azimuth, elevation: 0.0, curve: CURVE[0] + CURVE[1] * unknown[2] };
        let log: f64 = self.field.log_likelihoods(&[place]).iter().sum();
        log - 0.5 * (unknown[1] * unknown[1] + unknown[2] * unknown[2])
    }

    /// For each of these errors the best place of a coarse search.
    fn coarse(&mut self, errors: &[Errors]) -> Vec<(f64, Unknown)> {
        let azimuth = |k: usize| TAU * k as f64 / AZIMUTHS as f64;
        let at = |k: usize| CURVES.map(|curve| Place { azimuth: azimuth(k), elevation: 0.0, curve });
        let places: Vec<Place> = (0..AZIMUTHS).flat_map(at).collect();
        let best = |errors: &Errors| {
            let path = self.path(errors, FLAT[0]);
            self.coarse.set_points(&thinned(&path));
            let logs = self.coarse.log_likelihoods(&places);
            let best = logs.iter().zip(&places).max_by(|a, b| a.0.total_cmp(b.0));
            best.map_or((0.0, Unknown::zeros()), |(log, place)| {
                (
                    *log,
                    Unknown::new(
                        (place.azimuth - self.turned_rad(&path)) / AZIMUTH_RAD,
                        0.0,
                        (place.curve - CURVE[0]) / CURVE[1],
                    ),
                )
            })
        };
        errors.iter().map(best).collect()
    }

    /// Steps of errors and unknowns that displace the path by about [`STEP_M`].
    fn steps(&self) -> [f64; 7] {
        let (radius, [scale, turn, forward, left]) = (self.radius_m, PRIOR_SD);
        let moves = [
            scale * radius,
            turn * radius,
            forward,
            left,
            AZIMUTH_RAD * radius,
            self.flat_sd * radius,
            0.5 * CURVE[1] * radius * radius,
        ];
        moves.map(|moved| (STEP_M / moved).min(0.5))
    }

    /// By how much errors change the shape of the path, but for its direction: mean products, square metres.
    fn shapes(&self, errors: &Errors) -> Matrix4<f64> {
        const BY: f64 = 0.02;
        let path = self.path(errors, 0.0);
        let size: f64 = path.iter().map(|p| p.norm_squared()).sum::<f64>().max(f64::MIN_POSITIVE);
        let change = |k: usize| {
            let [up, down] = [BY, -BY].map(|by| {
                let mut moved = *errors;
                moved[k] += by;
                self.path(&moved, 0.0)
            });
            let own: Vec<Vector3<f64>> = up.iter().zip(&down).map(|(up, down)| (up - down) / (2.0 * BY)).collect();
            let aside = |p: &Vector3<f64>| Vector3::new(-p.y, p.x, 0.0);
            let turn = own.iter().zip(&path).map(|(own, p)| own.dot(&aside(p))).sum::<f64>() / size;
            own.iter().zip(&path).map(|(own, p)| own - aside(p) * turn).collect::<Vec<_>>()
        };
        let changes: [Vec<Vector3<f64>>; 4] = std::array::from_fn(change);
        let product = |j: usize, k: usize| changes[j].iter().zip(&changes[k]).map(|(a, b)| a.dot(b)).sum::<f64>();
        Matrix4::from_fn(|j, k| product(j, k) / path.len() as f64)
    }

    /// Gradient and negative second derivatives of [`Self::log`].
    fn slopes(&mut self, errors: &Errors, unknown: &Unknown) -> (SVector<f64, 7>, SMatrix<f64, 7, 7>) {
        let steps = self.steps();
        let mut log = |moved: &[(usize, f64)]| {
            let (mut errors, mut unknown) = (*errors, *unknown);
            for (k, by) in moved {
                *(if *k < 4 { &mut errors[*k] } else { &mut unknown[k - 4] }) += by * steps[*k];
            }
            self.log(&errors, &unknown)
        };
        let here = log(&[]);
        let beside: [[f64; 2]; 7] = std::array::from_fn(|k| [log(&[(k, 1.0)]), log(&[(k, -1.0)])]);
        let (mut gradient, mut bend) = (SVector::zeros(), SMatrix::zeros());
        for k in 0..7 {
            let [up, down] = beside[k];
            gradient[k] = 0.5 * (up - down) / steps[k];
            bend[(k, k)] = (2.0 * here - up - down) / (steps[k] * steps[k]);
            for j in 0..k {
                let both = log(&[(k, 1.0), (j, 1.0)]) + log(&[(k, -1.0), (j, -1.0)]);
                let alone: f64 = beside[k].iter().chain(&beside[j]).sum();
                bend[(k, j)] = -0.5 * (both - alone + 2.0 * here) / (steps[k] * steps[j]);
                bend[(j, k)] = bend[(k, j)];
            }
        }
        (gradient, bend)
    }
}

/// The inverse of a matrix made positive.
fn inverse<const D: usize>(of: &SMatrix<f64, D, D>) -> SMatrix<f64, D, D> {
    let mut more = 0.0;
    for _ in 0..20 {
        if let Some(whole) = (of + SMatrix::<f64, D, D>::identity() * more).cholesky() {
            return whole.inverse();
        }
        more = (4.0 * more).max(1e-3 * of.amax());
    }
    SMatrix::zeros()
}

/// Errors, and what goes with them in every stretch.
#[derive(Clone)]
struct Point {
    errors: Errors,
    unknowns: Vec<Unknown>,
}

/// A maximum of the posterior.
struct Top {
    at: Point,
    /// `ln` of likelihood and prior.
    log: f64,
    /// Information on the errors, the prior's with it.
    information: Matrix4<f64>,
}

/// All links of a receiver over its drive.
struct Drive {
    stretches: Vec<Stretch>,
    parallel: bool,
}

impl Drive {
    fn each<T: Send>(&mut self, of: impl Fn(usize, &mut Stretch) -> T + Sync + Send) -> Vec<T> {
        match self.parallel {
            true => self.stretches.par_iter_mut().enumerate().map(|(k, own)| of(k, own)).collect(),
            false => self.stretches.iter_mut().enumerate().map(|(k, own)| of(k, own)).collect(),
        }
    }

    /// No error first, then the best offsets of the grid.
    fn starts(&mut self) -> Vec<Point> {
        let side = (REACH_M / GRID_M) as i32;
        let offset = |i: i32, j: i32| {
            Errors::new(0.0, 0.0, f64::from(i) * GRID_M / PRIOR_SD[2], f64::from(j) * GRID_M / PRIOR_SD[3])
        };
        let all = (-side..=side).flat_map(|i| (-side..=side).map(move |j| (i, j)));
        let grid: Vec<Errors> = std::iter::once((0, 0))
            .chain(all.filter(|(i, j)| i * i + j * j <= side * side))
            .map(|(i, j)| offset(i, j))
            .collect();
        let seen = self.each(|_, own| own.coarse(&grid));
        let log = |k: &usize| seen.iter().map(|own| own[*k].0).sum::<f64>() - 0.5 * grid[*k].norm_squared();
        let mut order: Vec<(usize, f64)> = (0..grid.len()).map(|k| (k, log(&k))).collect();
        order[1..].sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut chosen: Vec<usize> = vec![0];
        for (k, _) in &order[1..] {
            let is_apart = |other: &usize| (grid[*k] - grid[*other]).norm() * PRIOR_SD[2] > APART_M;
            if chosen.len() <= STARTS && chosen[1..].iter().all(is_apart) {
                chosen.push(*k);
            }
        }
        chosen
            .iter()
            .map(|k| Point { errors: grid[*k], unknowns: seen.iter().map(|own| own[*k].1).collect() })
            .collect()
    }

    fn log(&mut self, at: &Point) -> f64 {
        self.each(|k, own| own.log(&at.errors, &at.unknowns[k])).iter().sum::<f64>() - 0.5 * at.errors.norm_squared()
    }

    /// Newton's method, with the errors within the space that `free` projects on.
    fn climb(&mut self, mut at: Point, free: &Matrix4<f64>) -> Top {
        let (mut log, mut information) = (self.log(&at), Matrix4::identity());
        for _ in 0..ITERATIONS {
            let slopes = self.each(|k, own| own.slopes(&at.errors, &at.unknowns[k]));
            let (mut sum, mut right) = (Matrix4::identity(), -at.errors);
            let mut own = Vec::new();
            for (gradient, bend) in &slopes {
                let across = bend.fixed_view::<4, 3>(0, 4).into_owned();
                let within: Matrix3<f64> = inverse(&bend.fixed_view::<3, 3>(4, 4).into_owned());
                let up: Unknown = gradient.fixed_rows::<3>(4).into_owned();
                sum += bend.fixed_view::<4, 4>(0, 0) - across * within * across.transpose();
                right += gradient.fixed_rows::<4>(0) - across * within * up;
                own.push((across, within, up));
            }
            information = sum;
            let held = Matrix4::identity() - free;
            let step = free * inverse(&(free * sum * free + held)) * free * right;
            let step = step * (LONGEST / step.norm().max(LONGEST));
            let unknown = |(across, within, up): &(SMatrix<f64, 4, 3>, Matrix3<f64>, Unknown)| {
                let step = within * (up - across.transpose() * step);
                step * (1.0 / step.norm().max(1.0))
            };
            let unknowns: Vec<Unknown> = own.iter().map(unknown).collect();
            let moved = |size: f64| Point {
                errors: at.errors + step * size,
                unknowns: at.unknowns.iter().zip(&unknowns).map(|(own, step)| own + step * size).collect(),
            };
            let tried = [1.0, 0.4, 0.15, 0.05]
                .map(moved)
                .into_iter()
                .map(|point| (self.log(&point), point))
                .find(|next| next.0 > log);
            let Some((higher, point)) = tried else { break };
            let is_done = higher - log < 0.01;
            (log, at) = (higher, point);
            if is_done {
                break;
            }
        }
        Top { at, log, information }
    }

    /// Information on the errors at a maximum, the prior's with it: that of the phases, limited by the drift of the odometry.
    fn known(&self, top: &Top) -> Matrix4<f64> {
        let mut phases = SymmetricEigen::new(top.information - Matrix4::identity());
        phases.eigenvalues.apply(|value| *value = value.max(0.0));
        let phases = phases.recompose();
        let links = self.stretches.last().map_or(1, |last| last.link + 1);
        let shapes: Matrix4<f64> = self.stretches.iter().map(|own| own.shapes(&top.at.errors)).sum();
        let drift = shapes / (links as f64 * DRIFT_M * DRIFT_M);
        let both = drift * inverse(&(drift + phases)) * phases;
        0.5 * (both + both.transpose()) + Matrix4::identity()
    }

    /// Goes `by`, which lies `along` a direction, with the rest at its maximum.
    fn follow(&mut self, mut at: Point, by: Errors, along: &Errors) -> Top {
        let across = Matrix4::identity() - along * along.transpose();
        for _ in 1..FOLLOWED {
            at.errors += by / f64::from(FOLLOWED);
            at = self.climb(at, &across).at;
        }
        at.errors += by / f64::from(FOLLOWED);
        self.climb(at, &across)
    }

    /// The maximum without what the phases hardly show: drift of the odometry would decide it.
    fn without_unknown(&mut self, mut top: Top) -> Top {
        for _ in 0..4 {
            let eigen = SymmetricEigen::new(self.known(&top));
            let all = eigen.eigenvalues.iter().enumerate().filter(|(_, value)| value.max(1.0).powf(-0.5) >= NARROWED);
            let along = all.map(|(k, _)| eigen.eigenvectors.column(k).into_owned());
            let by = |along: &Errors| along.dot(&top.at.errors).abs();
            let Some(along) = along.max_by(|a, b| by(a).total_cmp(&by(b))).filter(|along| by(along) > 0.1) else {
                break;
            };
            top = self.follow(top.at.clone(), -along * along.dot(&top.at.errors), &along);
        }
        top
    }

    /// By how much a path with these errors is turned against one with others, radians.
    fn turned_rad(&self, errors: &Errors, against: &Errors) -> f64 {
        let both = |own: &Stretch| {
            let paths = own.path(errors, 0.0).into_iter().zip(own.path(against, 0.0));
            paths.map(|(p, q)| Complex64::new(p.x, p.y) * Complex64::new(q.x, -q.y)).sum::<Complex64>()
        };
        self.stretches.iter().map(both).sum::<Complex64>().arg()
    }

    fn fit(mut self) -> OdometryFit {
        let mut starts = self.starts().into_iter();
        let Some(none) = starts.next() else { return OdometryFit::refused(NOTHING) };
        let none = self.climb(none, &Matrix4::zeros());
        let mut tops: Vec<Top> = Vec::new();
        for start in starts.chain([none.at.clone()]) {
            let free = self.climb(start, &Matrix4::identity());
            tops.push(self.without_unknown(free));
        }
        tops.sort_by(|a, b| b.log.total_cmp(&a.log));
        let Some((best, others)) = tops.split_first() else { return OdometryFit::refused(NOTHING) };
        let eigen = SymmetricEigen::new(self.known(best));
        let (mut covariance, mut turned) = (Matrix4::zeros(), 0.0);
        let mut spread = |errors: &Errors, share: f64, drive: &Self| {
            let off = errors - best.at.errors;
            covariance += off * off.transpose() * share;
            turned += drive.turned_rad(errors, &best.at.errors).powi(2) * share;
        };
        let mut known = Matrix4::zeros();
        for (k, value) in eigen.eigenvalues.iter().enumerate() {
            let (along, variance) = (eigen.eigenvectors.column(k).into_owned(), 1.0 / value.max(1.0));
            if variance.sqrt() < NARROWED {
                known += along * along.transpose() * variance;
                continue;
            }
            for side in [-1.0, 1.0] {
                let beside = self.follow(best.at.clone(), along * (side * variance.sqrt()), &along);
                spread(&beside.at.errors, 0.5, &self);
            }
        }
        // Tops that are nearly as high.
        let shares: Vec<f64> = others.iter().map(|top| (top.log - best.log).exp()).collect();
        let all = 1.0 + shares.iter().sum::<f64>();
        others.iter().zip(shares).for_each(|(top, share)| spread(&top.at.errors, share / all, &self));
        covariance += known;
        let error = |k: usize| OdometryError {
            value: PRIOR_SD[k] * best.at.errors[k],
            sd: PRIOR_SD[k] * covariance[(k, k)].sqrt().min(1.0),
            known: covariance[(k, k)].sqrt() < NARROWED,
        };
        let log_odds =
            best.log - none.log - 0.5 * eigen.eigenvalues.iter().map(|value| value.max(1.0).ln()).sum::<f64>();
        let refused = (log_odds.partial_cmp(&DECISIVE) != Some(std::cmp::Ordering::Greater)).then(|| {
            format!("the phases hardly prefer other errors to none (log odds {log_odds:.1}, {DECISIVE} are needed)")
        });
        let mut links: Vec<usize> = self.stretches.iter().map(|own| own.link).collect();
        links.dedup();
        OdometryFit {
            scale: error(0),
            turn: error(1),
            forward_m: error(2),
            left_m: error(3),
            rotation_sd_rad: turned.sqrt(),
            log_odds,
            links: links.len(),
            refused,
        }
    }
}

/// Why there is no fit.
const NOTHING: &str = "no link has phases of a motion";
pub(crate) const NO_HEADINGS: &str = "the trajectory has no headings";

/// The errors of the odometry that these stretches have in common, those of a link one after the other.
pub(crate) fn fit(stretches: Vec<Stretch>, parallel: bool) -> OdometryFit {
    if stretches.is_empty() {
        return OdometryFit::refused(NOTHING);
    }
    Drive { stretches, parallel }.fit()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bartlett::Tier;
    use crate::estimate::Effort;
    use crate::estimate::prior::Limits;
    use crate::signal::channel::INDICES_20_MHZ;
    use crate::signal::samples::Samples;

    const WAVELENGTH_M: f64 = 0.054_114_162;
    /// Places of transmitters and of what reflects, metres.
    const SOURCES: [[f64; 3]; 4] = [[4.0, 0.5, 0.4], [-1.0, 3.5, 0.1], [-2.5, -3.0, 0.6], [3.0, -4.0, 0.5]];
    /// Speed, m/s, rate of turn, rad/s, and seconds.
    const CURVES: [[f64; 3]; 5] =
        [[0.15, 0.0, 4.0], [0.1, 0.5, 4.0], [0.15, 0.0, 3.0], [0.1, -0.6, 5.0], [0.15, 0.0, 3.0]];
    const CIRCLE: [[f64; 3]; 1] = [[0.08, -0.5, 7.0]];
    const LINE: [[f64; 3]; 1] = [[0.15, 0.0, 10.0]];
    /// Scale, turn, and the offset forward and left.
    const WRONG: [f64; 4] = [0.03, -0.02, 0.06, 0.11];
    const RIGHT: [f64; 4] = [0.0; 4];

    /// Fits a drive in a room, of `direct` paths with a reflection of 0.3 and noise of 20 dB below 1.
    fn fitted(course: &[[f64; 3]], wrong: [f64; 4], direct: f64, seed: u64) -> OdometryFit {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut normal = move || (-2.0 * random().max(1e-12).ln()).sqrt() * (TAU * random()).cos();
        let [scale, turn, forward, left] = wrong;
        let (mut poses, mut antenna_m) = (Vec::new(), Vec::new());
        let (mut true_m, mut true_rad, mut at_m, mut heading) = (Vector3::zeros(), 0.4f64, Vector3::zeros(), 0.4f64);
        let ahead = |heading: f64| Vector3::new(heading.cos(), heading.sin(), 0.0);
        for [speed, rate, seconds] in course {
            for _ in 0..(seconds * 100.0) as usize {
                true_m += ahead(true_rad + 0.005 * rate) * (0.01 * speed);
                true_rad += 0.01 * rate;
                at_m += ahead(heading + 0.005 * rate / (1.0 + turn)) * (0.01 * speed / (1.0 + scale));
                heading += 0.01 * rate / (1.0 + turn);
                let t_s = 0.01 * poses.len() as f64;
                poses.push(Pose { t_s, position_m: at_m, heading_rad: Some(heading) });
                antenna_m.push(true_m + ahead(true_rad) * forward + ahead(true_rad + 0.25 * TAU) * left);
            }
        }
        let mut samples = Samples::new(WAVELENGTH_M, 2).unwrap();
        for pose in &poses {
            let probe = pose.mounted(Vector3::x() * PROBE_M).unwrap();
            samples.push(pose.t_s, Complex64::ONE, probe.position_m, Vector3::zeros()).unwrap();
        }
        let task = Task {
            samples: &samples,
            indices: INDICES_20_MHZ,
            limits: Limits::default(),
            odometry_sd_m: 0.003,
            heading_sd_rad: 0.0,
            bend_rad: 0.0,
            scale_sd: heading::scale_sd(0.0),
            effort: Effort::Needed,
            align: true,
            one_way: true,
            drive: None,
            other_times: None,
            tier: Tier::detect(),
        };
        let used: Vec<usize> = (0..poses.len()).collect();
        let mut all = Vec::new();
        for link in 0..3 {
            let mut row = |p: &Vector3<f64>| {
                let mut row = Planes::ZERO;
                for (lane, index) in INDICES_20_MHZ.into_iter().enumerate() {
                    // The reflection is 20 m longer. A round trip is the square of one way.
                    let wave = |(amplitude, source, slope): (f64, [f64; 3], f64)| {
                        let range_m = (Vector3::from(source) - p).norm();
                        Complex64::from_polar(amplitude, -TAU * range_m / WAVELENGTH_M - slope * f64::from(index))
                    };
                    let one_way = wave((direct, SOURCES[link], 0.0)) + wave((0.3 * direct, SOURCES[link + 1], 0.131));
                    let both = one_way * one_way + Complex64::new(normal(), normal()) * 0.07;
                    (row.re[lane], row.im[lane]) = (both.re as f32, both.im as f32);
                }
                row
            };
            let rows: Vec<Planes> = antenna_m.iter().map(&mut row).collect();
            all.extend(stretches(&task, rows, &used, &poses, link).unwrap());
        }
        fit(all, false)
    }

    fn errors(found: &OdometryFit) -> [OdometryError; 4] {
        [found.scale, found.turn, found.forward_m, found.left_m]
    }

    #[test]
    fn errors_are_found_within_their_deviations() {
        let found = fitted(&CURVES, WRONG, 1.0, 1);
        println!("{found:?}");
        assert!(found.refused.is_none() && found.links == 3, "{found:?}");
        // Drift and elevations hide scale and turn.
        assert!(found.forward_m.known && found.left_m.known, "{found:?}");
        for (own, truth) in errors(&found).into_iter().zip(WRONG) {
            assert!(((own.value - truth) / own.sd).abs() < 3.0, "{found:?}");
        }
        assert!(found.left_m.sd < 0.02 && found.forward_m.sd < 0.02 && found.rotation_sd_rad < 0.05, "{found:?}");
    }

    #[test]
    fn a_circle_shows_its_radius_and_not_where_the_antenna_is_on_it() {
        let found = fitted(&CIRCLE, WRONG, 1.0, 1);
        println!("{found:?}\n{found}");
        let [scale, _, forward, left] = errors(&found);
        assert!(found.refused.is_none() && !forward.known && !scale.known, "{found:?}");
        // The robot turns to the right about a point 0.16 m away.
        let radius = |[scale, turn, forward, left]: [f64; 4]| {
            let reported_m = 0.16 * (1.0 + WRONG[1]) / (1.0 + WRONG[0]);
            (reported_m * (1.0 + scale) / (1.0 + turn) + left).hypot(forward)
        };
        let off_m = radius(errors(&found).map(|own| own.value)) - radius(WRONG);
        // As the elevations of the transmitters are open, to some percent.
        assert!(off_m.abs() < 0.01, "{off_m}");
        assert!(
            (forward.value - WRONG[2]).abs() < 2.0 * forward.sd && (left.value - WRONG[3]).abs() < 2.0 * left.sd,
            "{found:?}"
        );
        assert!(found.rotation_sd_rad > 0.2, "{found:?}");
        let words = found.to_string();
        assert!(words.contains("forward") && words.contains("not shown by this drive; drive straight, too"), "{words}");
        assert!(!words.contains("hardly turned"), "{words}");
    }

    #[test]
    fn a_line_shows_no_offset() {
        let found = fitted(&LINE, [0.0, 0.0, 0.06, 0.11], 1.0, 1);
        println!("{found:?}");
        assert!(found.refused.is_some() && errors(&found).iter().skip(1).all(|own| !own.known), "{found:?}");
    }

    #[test]
    fn odometry_without_errors_and_noise_are_left_alone() {
        for (course, direct) in [(&CURVES[..], 1.0), (&CIRCLE[..], 0.0)] {
            let found = fitted(course, RIGHT, direct, 1);
            println!("{found:?}");
            assert!(found.refused.is_some(), "{found:?}");
        }
    }

    #[test]
    fn nothing_is_refused_with_why() {
        assert!(fit(Vec::new(), false).refused.is_some_and(|why| why.contains("no link")));
        let found = fitted(&[[0.1, 0.0, 0.5]], RIGHT, 1.0, 1);
        assert!(found.refused.is_some(), "{found:?}");
    }
}
