//! Range changes compared with motion capture (README.md): from motion capture itself, the tracking camera, the wheels, and
//! deliberately degraded motion capture.

use csi5300::motion::odometry::csv;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Bearing, Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use csi5300_lab::evaluate::{Capture, TRUTH_FILE, TrajectorySource, channel_in, find};
use csi5300_sim::random::Stream;
use nalgebra::{Matrix3, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

type Fallible<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Exchanges that the naive method averages.
const NAIVE: usize = 5;
/// Degradations of motion capture: relative scale, and metres of a random walk after a metre.
const WORSE: [(f64, f64); 2] = [(0.05, 0.0), (-0.05, 0.02)];

/// Position of the antenna on WSR's robots, relative to the middle between the wheels: metres forward, left, up.
const ANTENNA_M: [f64; 3] = [0.05, 0.16, 0.0];

/// The source of a path.
#[derive(Clone, Copy)]
enum Odometry {
    Recorded(TrajectorySource),
    Worse(f64, f64),
}

impl Odometry {
    fn name(self) -> String {
        match self {
            Self::Recorded(source) => source.to_string(),
            Self::Worse(scale, walk) => {
                format!("motion capture, scale {:+.0} %, walk {:.0} mm", 100.0 * scale, 1e3 * walk)
            }
        }
    }

    fn source(self) -> TrajectorySource {
        match self {
            Self::Recorded(source) => source,
            Self::Worse(..) => TrajectorySource::GroundTruth,
        }
    }

    fn file(self, capture: &Capture) -> PathBuf {
        let prefix = match self.source() {
            TrajectorySource::GroundTruth => "",
            TrajectorySource::T265 | TrajectorySource::RollingT265 => "t265_",
            TrajectorySource::Odometry => "odom_",
        };
        capture.folder.join(format!("{prefix}rx_trajectory_{}_.csv", capture.stamp))
    }

    fn path(self, capture: &Capture) -> Fallible<Trajectory> {
        let recorded = csv::read(&self.file(capture), None)?.0;
        Ok(match self {
            Self::Recorded(TrajectorySource::Odometry) if !is_simulated(capture) => {
                recorded.with_antenna_offset(ANTENNA_M.into())?
            }
            Self::Recorded(_) => recorded,
            Self::Worse(scale, walk) => worse(&recorded, scale, walk)?,
        })
    }
}

fn main() -> Fallible<()> {
    let folders: Vec<String> = std::env::args().skip(1).collect();
    if folders.is_empty() {
        return Err("usage: range_change DIR..".into());
    }
    let captures: Vec<Capture> = folders.iter().flat_map(|folder| find(Path::new(folder)).0).collect();
    if captures.is_empty() {
        return Err("no capture with a truth there".into());
    }
    let recorded = [TrajectorySource::GroundTruth, TrajectorySource::T265, TrajectorySource::Odometry];
    let all =
        recorded.map(Odometry::Recorded).into_iter().chain(WORSE.map(|(scale, walk)| Odometry::Worse(scale, walk)));
    let mut tables = Vec::new();
    for odometry in all {
        let mut rows = Vec::new();
        for capture in captures.iter().filter(|capture| odometry.file(capture).is_file()) {
            rows.extend(judge(capture, odometry)?);
        }
        rows.iter().for_each(|row| println!("{}: {row}", odometry.name()));
        tables.push((odometry.name(), rows));
    }
    println!("{HEAD}");
    tables.iter().for_each(|(name, rows)| summarise(name, rows));
    Ok(())
}

/// Whether the simulator made it: then its odometry is the antenna's.
fn is_simulated(capture: &Capture) -> bool {
    ["rooms_", "drives_"].iter().any(|set| capture.place.starts_with(set))
}

/// A path with another scale, and a random walk along it.
fn worse(path: &Trajectory, scale: f64, walk: f64) -> Fallible<Trajectory> {
    let mut random = Stream::of_seed(path.poses().len() as u64);
    let (mut before, mut off) = (path.poses()[0].position_m, Vector3::zeros());
    let mut poses = Vec::new();
    for pose in path.poses() {
        let way_m = (pose.position_m - before).norm();
        before = pose.position_m;
        off += Vector3::new(random.normal(), random.normal(), 0.0) * (walk * way_m.sqrt());
        poses.push(Pose { position_m: pose.position_m * (1.0 + scale) + off, ..*pose });
    }
    Ok(Trajectory::new(poses)?)
}

/// The errors of one link, metres.
struct Row {
    link: String,
    /// Errors of the method, or why it has no result.
    own: Result<Own, String>,
    /// Odometry alone, along the bearing.
    predicted: Errors,
    /// Phases smoothed and unwrapped.
    naive: Errors,
}

struct Own {
    errors: Errors,
    /// Error at the last exchange over its deviation.
    over_deviation: f64,
    held: f64,
    slips: usize,
}

#[derive(Clone, Copy)]
struct Errors {
    /// Median of the absolute error.
    median_m: f64,
    /// Error at the last exchange.
    end_m: f64,
    /// Root mean square of the error that no other place of the transmitter explains.
    shape_m: f64,
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let words = |errors: &Errors| {
            format!("{:5.1} {:6.1} {:5.1}", 1e3 * errors.median_m, 1e3 * errors.end_m, 1e3 * errors.shape_m)
        };
        write!(f, "{} odometry {} naive {} ", self.link, words(&self.predicted), words(&self.naive))?;
        match &self.own {
            Ok(own) => write!(
                f,
                "own {} mm, end {:.1} deviations off, held {:.2}, {} slips",
                words(&own.errors),
                own.over_deviation,
                own.held,
                own.slips
            ),
            Err(why) => write!(f, "none: {why}"),
        }
    }
}

/// Places of the transmitters, metres: heights matter, because half a metre shortens the change by a percent at 3 m.
fn places(capture: &Capture) -> Fallible<BTreeMap<String, Vector3<f64>>> {
    let text = std::fs::read_to_string(capture.folder.join(TRUTH_FILE))?;
    let json: serde_json::Value = serde_json::from_str(&text)?;
    let at = |name: &str, axis: &str| json["true_tx_positions"]["value"][name]["position"][axis].as_f64();
    let place = |name: &String| Some((name.clone(), Vector3::new(at(name, "x")?, at(name, "y")?, at(name, "z")?)));
    Ok(capture.transmitters.iter().filter_map(|(name, _)| place(name)).collect())
}

/// The links of a capture, with a path of the receiver, compared with motion capture and the transmitters' places.
fn judge(capture: &Capture, odometry: Odometry) -> Fallible<Vec<Row>> {
    let channel = channel_in(&capture.folder)?.ok_or("the file with the truth names no channel")?;
    let options = Options {
        heading_sd_rad: Some(capture.heading_sd_rad(odometry.source())),
        range_change: true,
        ..Options::new(channel)
    };
    let path = odometry.path(capture)?;
    let truth = Odometry::Recorded(TrajectorySource::GroundTruth).path(capture)?;
    let places = places(capture)?;
    let mut receiver = Replay::open(&capture.folder.join(format!("csi_rx_{}.dat", capture.stamp)))?;
    let mut logs = capture
        .transmitters
        .iter()
        .map(|(_, log)| Replay::open(log))
        .collect::<Result<Vec<_>, csi5300::source::Error>>()?;
    let transmitters = logs.iter_mut().map(|log| Transmitter { log, trajectory: None }).collect();
    let report = bearings(&mut receiver, transmitters, &path, &options)?;
    let mut rows = Vec::new();
    for ((name, _), link) in capture.transmitters.iter().zip(&report.links) {
        let name_of_link = capture.link_name(name);
        match (&link.bearing, places.get(name)) {
            (Ok(bearing), Some(place)) => rows.extend(row(name_of_link, bearing, &truth, *place)),
            _ => println!("{name_of_link}: no bearing, or no truth"),
        }
    }
    Ok(rows)
}

/// Exchanges in a gap of motion capture are not judged; `None` if no range change was requested.
fn row(link: String, bearing: &Bearing, truth: &Trajectory, place: Vector3<f64>) -> Option<Row> {
    let at = |t_s: &f64| truth.at(*t_s).map(|pose| pose.position_m);
    let points: Vec<Option<Vector3<f64>>> = bearing.samples.t_s().iter().map(at).collect();
    let errors = |range_m: &[f64]| {
        let known = range_m.iter().zip(&points).filter_map(|(range_m, point)| Some((*range_m, (*point)?)));
        let (range_m, points): (Vec<f64>, Vec<Vector3<f64>>) = known.unzip();
        Errors::of(&range_m, &points, place)
    };
    let own = match bearing.range_change.as_ref()? {
        Ok(found) => {
            let errors = errors(&found.range_change_m);
            let deviation_m = found.deviation_m.last().copied().unwrap_or_default();
            Ok(Own {
                errors,
                over_deviation: errors.end_m / deviation_m,
                held: found.held_share(),
                slips: found.slips.len(),
            })
        }
        Err(why) => Err(why.to_string()),
    };
    Some(Row { link, own, predicted: errors(&predicted(bearing)), naive: errors(&naive(bearing)) })
}

/// The distance by odometry, to the place of the bearing.
fn predicted(bearing: &Bearing) -> Vec<f64> {
    let samples = &bearing.samples;
    let towards = csi5300::bartlett::direction(bearing.answer.azimuth_rad, bearing.answer.elevation_rad());
    let curve = bearing.answer.candidates.first().map_or(0.0, |first| first.inverse_range_per_m);
    let points = samples.receiver_m();
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let range = |point: &Vector3<f64>| match curve > 1e-6 {
        true => (towards / curve - (point - middle)).norm(),
        false => -towards.dot(&(point - middle)),
    };
    points.iter().map(range).collect()
}

/// Phases at the channel centre, averaged over five exchanges and unwrapped.
fn naive(bearing: &Bearing) -> Vec<f64> {
    let samples = &bearing.samples;
    let wavenumber = 2.0 * TAU / samples.wavelength_m();
    let means: Vec<_> = samples.z().windows(NAIVE).map(|z| z.iter().sum::<csi5300::num_complex::Complex64>()).collect();
    let mut phase = 0.0;
    let mut range_m = vec![0.0; NAIVE / 2 + 1];
    for pair in means.windows(2) {
        phase += (pair[1] * pair[0].conj()).arg();
        range_m.push(-phase / wavenumber);
    }
    range_m.resize(samples.len(), range_m.last().copied().unwrap_or_default());
    range_m
}

impl Errors {
    fn of(range_m: &[f64], points: &[Vector3<f64>], place: Vector3<f64>) -> Self {
        let distance = |place: Vector3<f64>| points.iter().map(move |point| (point - place).norm());
        let first = points.first().map_or(0.0, |point| (point - place).norm());
        let own_first = range_m.first().copied().unwrap_or_default();
        let off: Vec<f64> =
            range_m.iter().zip(distance(place)).map(|(own, truth)| own - own_first - (truth - first)).collect();
        let mut sizes: Vec<f64> = off.iter().map(|off| off.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let fitted = fitted(range_m, points, place);
        let left: Vec<f64> = range_m.iter().zip(distance(fitted)).map(|(own, truth)| own - truth).collect();
        let mean = left.iter().sum::<f64>() / left.len().max(1) as f64;
        let square = left.iter().map(|left| (left - mean).powi(2)).sum::<f64>() / left.len().max(1) as f64;
        Self {
            median_m: sizes.get(sizes.len() / 2).copied().unwrap_or_default(),
            end_m: off.last().copied().unwrap_or_default(),
            shape_m: square.sqrt(),
        }
    }
}

/// The place that explains ranges best, up to a constant; by least-squares steps of at most 0.3 m, from the given one.
fn fitted(range_m: &[f64], points: &[Vector3<f64>], mut place: Vector3<f64>) -> Vector3<f64> {
    for _ in 0..8 {
        let (mut normal, mut right) = (Matrix3::from_diagonal_element(1e-6), Vector3::zeros());
        let offset = range_m.first().copied().unwrap_or_default();
        for (own, point) in range_m.iter().zip(points) {
            let way = point - place;
            let row = Vector3::new(-way.x / way.norm(), -way.y / way.norm(), 1.0);
            normal += row * row.transpose();
            right += row * (own - offset - way.norm());
        }
        let step = normal.try_inverse().map_or(Vector3::zeros(), |inverse| inverse * right);
        let step = Vector3::new(step.x, step.y, 0.0);
        place += step * (0.3 / step.norm().max(0.3));
    }
    place
}

const HEAD: &str = "| path | links | answered | median error: own / odometry alone / naive, mm | at the end | shape: own / odometry alone, mm | held | slips in a link | within 2 deviations at the end |\n|---|---|---|---|---|---|---|---|---|";

fn summarise(name: &str, rows: &[Row]) {
    let set = |row: &Row| row.link.split('/').next().unwrap_or_default().to_owned();
    for words in rows.iter().map(set).collect::<BTreeSet<String>>() {
        let all: Vec<&Row> = rows.iter().filter(|row| set(row) == words).collect();
        let answered: Vec<(&Row, &Own)> =
            all.iter().filter_map(|row| row.own.as_ref().ok().map(|own| (*row, own))).collect();
        let median = |of: &dyn Fn(&Row, &Own) -> f64| {
            let mut values: Vec<f64> = answered.iter().map(|(row, own)| of(row, own).abs()).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let count = answered.len().max(1) as f64;
        let within = answered.iter().filter(|(_, own)| own.over_deviation.abs() < 2.0).count() as f64 / count;
        println!(
            "| {name}, {words} | {} | {} | {:.1} / {:.1} / {:.0} | {:.1} / {:.1} / {:.0} | {:.1} / {:.1} | {:.0} % | {:.0} | {:.0} % |",
            all.len(),
            answered.len(),
            1e3 * median(&|_, own| own.errors.median_m),
            1e3 * median(&|row, _| row.predicted.median_m),
            1e3 * median(&|row, _| row.naive.median_m),
            1e3 * median(&|_, own| own.errors.end_m),
            1e3 * median(&|row, _| row.predicted.end_m),
            1e3 * median(&|row, _| row.naive.end_m),
            1e3 * median(&|_, own| own.errors.shape_m),
            1e3 * median(&|row, _| row.predicted.shape_m),
            100.0 * answered.iter().map(|(_, own)| own.held).sum::<f64>() / count,
            median(&|_, own| own.slips as f64),
            100.0 * within,
        );
    }
}
