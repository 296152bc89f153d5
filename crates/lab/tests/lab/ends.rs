//! One simulated link whose ends may both move, compared with its truth and the Cramer-Rao bound: for these tests and `research`.
#![allow(dead_code)] // each uses a part

use csi5300::maths::wrap_rad;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Bearing, Options, Transmitter, bearings};
use csi5300_lab::Failure;
use csi5300_lab::compare::figures::true_path;
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::radio::{Noise, Radio};
use csi5300_sim::scene::{Robot, Scene, Sounding, Wall};
use csi5300_sim::{Room, Simulation};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;

/// The host stamps the end of an answer; the phase belongs to the middle between the two frames. It is earlier by half of the
/// turn-around and the length of the answer, seconds.
const LATE_S: f64 = 0.000_236;
/// Rounds of the exchange per second.
const RATE_HZ: f64 = 50.0;

/// A link in free space: 20 MHz on channel 108, equal carriers, a constant signal to noise ratio.
#[derive(Clone, Debug, Default)]
pub struct Ends {
    /// Motion of the receiver, which starts at the origin and faces +x.
    pub receiver: RobotMotion,
    /// Where the transmitter starts, metres.
    pub transmitter_m: [f64; 3],
    /// Its motion; it faces +y.
    pub transmitter: RobotMotion,
    /// Length of the scene, seconds.
    pub duration_s: f64,
    /// Signal to noise ratio in one direction on one subcarrier, dB.
    pub snr_db: f64,
    /// Noise of the receiver's odometry, metres; 0 gives the true path.
    pub odometry_noise_m: f64,
    /// Scale error of the receiver's odometry: reported metres per metre driven, minus 1.
    pub odometry_scale: f64,
    /// Walls of the room; free space without any.
    pub walls: Vec<Wall>,
    /// Highest number of reflections of a path.
    pub reflections: u8,
    /// Random seed.
    pub seed: u64,
}

/// The logs of a link, simulated once, and its truth, for several estimates from the same bytes.
#[derive(Clone, Debug)]
pub struct Recording {
    ends: Ends,
    simulation: Simulation,
    truth: [Trajectory; 2],
    /// The receiver's path from its odometry, and the transmitter's from its own start, if it moved.
    reported: Trajectory,
    displaced: Option<Trajectory>,
}

/// An answer compared with the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Azimuth minus that from the mean of the receiver's places to the mean of the transmitter's, degrees.
    pub azimuth_error_deg: f64,
    /// The smaller magnitude of the errors of azimuth and mirror, degrees: error bars are about the nearer of the two.
    pub folded_error_deg: f64,
    /// Elevation minus the true one, degrees; of the magnitudes if the answer has no sign; `None` without an elevation.
    pub elevation_error_deg: Option<f64>,
    /// True if the answer's elevation has a sign.
    pub signed: bool,
    /// Cramer-Rao bounds of azimuth and elevation, degrees, with common phase, the other angle and range unknown.
    pub bound_deg: [f64; 2],
    /// Predicted deviation of the azimuth, degrees.
    pub azimuth_sd_deg: f64,
    /// Reported position minus the transmitter's at the reported time, metres.
    pub position_error_m: Option<Vector3<f64>>,
    /// Its horizontal part in units of the covariance: squared length, about 2 on average.
    pub position_level: Option<f64>,
    /// Probability that the azimuth is within five degrees.
    pub confidence: f64,
    /// Distance of the candidate nearest to the true direction, without the answer, degrees.
    pub nearest_candidate_deg: f64,
}

impl Ends {
    /// The link as a scene.
    #[must_use]
    pub fn scene(&self) -> Scene {
        let radio = Radio { noise: Noise::SnrDb(self.snr_db), host_latency_us: 0.0, ..Radio::default() };
        let robot = |name: &str, position_m, yaw_deg, motion: &RobotMotion| Robot {
            name: name.into(),
            position_m,
            yaw_deg,
            motion: motion.clone(),
            ..Robot::default()
        };
        Scene {
            name: "ends".into(),
            seed: self.seed,
            duration_s: self.duration_s,
            sounding: Some(Sounding { rate_hz: RATE_HZ, ..Sounding::default() }),
            radio,
            wall: self.walls.clone(),
            reflections: self.reflections,
            robot: vec![
                robot("rx", [0.0; 3], 0.0, &self.receiver),
                robot("tx", self.transmitter_m, 90.0, &self.transmitter),
            ],
            ..Scene::default()
        }
    }

    /// Simulates the link.
    ///
    /// # Errors
    /// If the scene cannot be simulated.
    pub fn record(&self) -> Result<Recording, Failure> {
        let room = Room::new(&self.scene())?;
        let truth = [true_path(&room, 0)?, true_path(&room, 1)?];
        let (reported, displaced) = (self.reported(&truth[0]), displaced(&truth[1]));
        let moves = self.transmitter != RobotMotion::Static;
        let displaced = moves.then_some(displaced);
        Ok(Recording { ends: self.clone(), simulation: room.run()?, truth, reported, displaced })
    }

    /// Simulates the link and estimates its bearing; a moving transmitter's trajectory begins at zero.
    ///
    /// # Errors
    /// If the scene cannot be simulated or gives no bearing.
    pub fn see(&self, options: &Options) -> Result<Seen, Failure> {
        let recording = self.record()?;
        Ok(recording.judge(&recording.bearing(options)?))
    }

    /// The receiver's path from its odometry.
    fn reported(&self, truth: &Trajectory) -> Trajectory {
        let mut random = csi5300_sim::random::Stream::of_seed(self.seed ^ 0x5eed);
        let mut noise = || self.odometry_noise_m * random.normal();
        let pose = |pose: &Pose| Pose {
            position_m: pose.position_m * (1.0 + self.odometry_scale) + Vector3::from_fn(|_, _| noise()),
            ..*pose
        };
        Trajectory::new(truth.poses().iter().map(pose).collect()).unwrap_or_else(|_| truth.clone())
    }
}

impl Recording {
    /// The link's bearing.
    ///
    /// # Errors
    /// If it has none.
    pub fn bearing(&self, options: &Options) -> Result<Bearing, Failure> {
        let [receiver, transmitter] = self.simulation.robots.as_slice() else {
            return Err("a scene of one robot has no link to measure".into());
        };
        let (mut rx, mut tx) = (receiver.replay(), transmitter.replay());
        let transmitters = vec![Transmitter { log: &mut tx, trajectory: self.displaced.as_ref() }];
        let options = Options { clock_offset_s: -LATE_S, ..options.clone() };
        let mut report = bearings(&mut rx, transmitters, &self.reported, &options)?;
        let link = report.links.pop().ok_or("no transmitter's log")?;
        link.bearing.map_err(|error| error.to_string().into())
    }

    /// Compares one of its bearings with the truth.
    #[must_use]
    pub fn judge(&self, bearing: &Bearing) -> Seen {
        let [receiver, transmitter] = &self.truth;
        let samples = &bearing.samples;
        let at = |path: &Trajectory, t_s: f64| path.at(t_s).map(|pose| pose.position_m).unwrap_or_default();
        let ways: Vec<Vector3<f64>> = samples.t_s().iter().map(|&t| at(transmitter, t) - at(receiver, t)).collect();
        let away = ways.iter().sum::<Vector3<f64>>() / ways.len().max(1) as f64;
        let points: Vec<Vector3<f64>> = ways.iter().map(|way| away - way).collect();
        let phase_rad = (2.0 / (2.0 * 30.0 * 10f64.powf(0.1 * self.ends.snr_db))).sqrt();
        let answer = &bearing.answer;
        let truth = (away.y.atan2(away.x), away.z.atan2(away.xy().norm()));
        let elevation_error = match (answer.signed_elevation_rad, answer.elevation_sd_rad) {
            (Some(elevation), _) => Some(elevation - truth.1),
            (None, Some(_)) => Some(answer.abs_elevation_rad - truth.1.abs()),
            (None, None) => None,
        };
        let position = answer
            .range
            .filter(|_| answer.has_place())
            .map(|range| (range, range.position_m - at(transmitter, range.position_t_s)));
        let level = |(range, error): (csi5300::pipeline::Range, Vector3<f64>)| {
            let covariance = range.covariance_m2.fixed_view::<2, 2>(0, 0).into_owned();
            covariance.try_inverse().map(|inverse| error.xy().dot(&(inverse * error.xy())))
        };
        let off = |candidate: &csi5300::pipeline::Candidate| {
            let elevation = candidate.signed_elevation_rad.unwrap_or(candidate.abs_elevation_rad.copysign(truth.1));
            csi5300::bartlett::direction(candidate.azimuth_rad, elevation).angle(&away).to_degrees()
        };
        let error_deg = |azimuth_rad: f64| wrap_rad(azimuth_rad - truth.0).to_degrees();
        let mirror_error_deg = answer.mirror_rad.map_or(f64::MAX, error_deg);
        Seen {
            azimuth_error_deg: error_deg(answer.azimuth_rad),
            folded_error_deg: error_deg(answer.azimuth_rad).abs().min(mirror_error_deg.abs()),
            elevation_error_deg: elevation_error.map(f64::to_degrees),
            signed: answer.signed_elevation_rad.is_some(),
            bound_deg: bound_deg(&points, &away, samples.wavelength_m(), phase_rad),
            azimuth_sd_deg: answer.azimuth_sd_rad.to_degrees(),
            position_error_m: position.map(|(_, error)| error),
            position_level: position.and_then(level),
            confidence: answer.probability,
            nearest_candidate_deg: answer.candidates.iter().map(off).fold(f64::MAX, f64::min),
        }
    }
}

/// A path relative to its first place.
fn displaced(path: &Trajectory) -> Trajectory {
    let first = path.poses().first().map(|pose| pose.position_m).unwrap_or_default();
    let pose = |pose: &Pose| Pose { position_m: pose.position_m - first, ..*pose };
    Trajectory::new(path.poses().iter().map(pose).collect()).unwrap_or_else(|_| path.clone())
}

/// The Cramer-Rao bounds of azimuth and elevation, degrees, of a place `away` from the mean of `points` (metres), for round
/// trips of phase deviation `phase_rad` with common phase and range unknown.
#[must_use]
pub fn bound_deg(points: &[Vector3<f64>], away: &Vector3<f64>, wavelength_m: f64, phase_rad: f64) -> [f64; 2] {
    let (range, ground) = (away.norm(), away.xy().norm());
    // Derivatives of the place by azimuth, elevation and the logarithm of range.
    let across = Vector3::new(-away.y, away.x, 0.0);
    let up = Vector3::new(-away.x * away.z / ground, -away.y * away.z / ground, ground);
    let moves = [across, up, *away];
    let gradient = |p: &Vector3<f64>| {
        // Large distances cancel in the differences between samples: each direction minus the mean direction.
        let towards = (away - p).normalize() - away / range;
        Vector3::from_fn(|i, _| 2.0 * TAU / wavelength_m * towards.dot(&moves[i]) / phase_rad)
    };
    let gradients: Vec<Vector3<f64>> = points.iter().map(gradient).collect();
    let mean = gradients.iter().sum::<Vector3<f64>>() / gradients.len().max(1) as f64;
    let information: Matrix3<f64> = gradients.iter().map(|g| (g - mean) * (g - mean).transpose()).sum();
    let sd = |covariance: Matrix3<f64>, i: usize| covariance[(i, i)].sqrt().to_degrees();
    information.try_inverse().map_or([f64::INFINITY; 2], |covariance| [sd(covariance, 0), sd(covariance, 1)])
}
