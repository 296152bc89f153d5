//! Odometry corrected by the phases (README.md): bearings before and after, against motion capture, and the errors that were found
//! against those that are known.

use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Bearing, OdometryError, OdometryFit, Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use csi5300_lab::evaluate::{Capture, TRUTH_FILE, TrajectorySource, channel_in, find};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Position of the antenna on WSR's robots, relative to the middle between the wheels: metres forward, left, up.
const ANTENNA_M: [f64; 3] = [0.05, 0.16, 0.0];
/// Errors that simulated wheels are given: scale, metres forward and left.
const WHEELS: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.03, 0.08, 0.12], [-0.02, -0.1, 0.05]];

/// A path of the receiver, and what is wrong with it, if that is known.
#[derive(Clone, Copy)]
enum Given {
    WheelsUnmounted,
    Wheels,
    Simulated([f64; 3]),
}

impl Given {
    fn name(self) -> String {
        match self {
            Self::WheelsUnmounted => "wheels, antenna's place unknown".into(),
            Self::Wheels => "wheels, antenna's place known".into(),
            Self::Simulated([scale, forward, left]) => {
                format!("wheels, scale {:+.0} %, antenna {forward}, {left}", 100.0 * scale)
            }
        }
    }

    /// The trajectory, and the deviation of its heading, radians.
    fn of(self, capture: &Capture) -> Fallible<(Trajectory, f64)> {
        let mut capture = capture.clone();
        capture.antenna_offset_m = matches!(self, Self::Wheels).then_some(ANTENNA_M);
        let recorded = capture.path(TrajectorySource::Odometry)?;
        match self {
            Self::Simulated([scale, forward, left]) => {
                let wheels = recorded.with_antenna_offset(-Vector3::new(forward, left, 0.0))?;
                let scaled = |pose: &Pose| Pose { position_m: pose.position_m / (1.0 + scale), ..*pose };
                let path = Trajectory::new(wheels.poses().iter().map(scaled).collect())?;
                Ok((path, TrajectorySource::Odometry.heading_sd_rad()))
            }
            _ => Ok((recorded, capture.heading_sd_rad(TrajectorySource::Odometry))),
        }
    }
}

/// One link before and after.
struct Row {
    set: String,
    /// Errors of the azimuth, degrees, and bars of 68 and 95 %.
    before: Judged,
    after: Judged,
    fit: OdometryFit,
    /// Errors of the fitted scale and offset over their deviations, where they are known and the drive shows them.
    off: Vec<f64>,
    seconds: f64,
}

#[derive(Clone, Copy)]
struct Judged {
    error_deg: f64,
    bars_deg: [f64; 2],
    /// Length of the path over the true one.
    length: f64,
}

fn main() -> Fallible<()> {
    let folders: Vec<String> = std::env::args().skip(1).collect();
    if folders.is_empty() {
        return Err("usage: odometry DIR..".into());
    }
    let captures: Vec<Capture> = folders.iter().flat_map(|folder| find(Path::new(folder)).0).collect();
    if captures.is_empty() {
        return Err("no capture with a truth there".into());
    }
    let (simulated, real): (Vec<&Capture>, Vec<&Capture>) = captures.iter().partition(|capture| is_simulated(capture));
    println!("{HEAD}");
    for path in [Given::WheelsUnmounted, Given::Wheels] {
        table(path, &real)?;
    }
    for wrong in WHEELS {
        table(Given::Simulated(wrong), &simulated)?;
    }
    Ok(())
}

/// Whether the simulator made it: then its odometry is the antenna's.
fn is_simulated(capture: &Capture) -> bool {
    ["rooms_", "drives_"].iter().any(|set| capture.place.starts_with(set))
}

/// The set of a capture and the half of its places that it belongs to.
fn set(capture: &Capture) -> String {
    let mut folders = capture.place.split('/');
    let set = folders.next().unwrap_or_default().to_owned();
    let place = folders.next().unwrap_or_default().trim_start_matches('L').parse().unwrap_or(0);
    if is_simulated(capture) { set } else { format!("{set} {}", if place <= 5 { "L1-5" } else { "L6-10" }) }
}

fn table(path: Given, captures: &[&Capture]) -> Fallible<()> {
    let rows: Vec<Vec<Row>> = captures.iter().map(|capture| judge(capture, path)).collect::<Fallible<_>>()?;
    let mut sets: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    for row in rows.into_iter().flatten() {
        sets.entry(row.set.clone()).or_default().push(row);
    }
    sets.iter().for_each(|(set, rows)| summarise(&format!("{}, {set}", path.name()), rows));
    Ok(())
}

fn judge(capture: &Capture, path: Given) -> Fallible<Vec<Row>> {
    let channel = channel_in(&capture.folder)?.ok_or("the file with the truth names no channel")?;
    let (own, heading_sd_rad) = path.of(capture)?;
    let options = Options { heading_sd_rad: Some(heading_sd_rad), ..Options::new(channel) };
    let truth = capture.path(TrajectorySource::GroundTruth)?;
    let places = places(capture)?;
    let run = |options: &Options| -> Fallible<Vec<Option<Bearing>>> {
        let mut receiver = Replay::open(&capture.receiver_log())?;
        let mut logs = capture.transmitters.iter().map(|(_, log)| Replay::open(log)).collect::<Result<Vec<_>, _>>()?;
        let transmitters = logs.iter_mut().map(|log| Transmitter { log, trajectory: None }).collect();
        let report = bearings(&mut receiver, transmitters, &own, options)?;
        Ok(report.links.into_iter().map(|link| link.bearing.ok()).collect())
    };
    let before = run(&options)?;
    let began = Instant::now();
    let after = run(&Options { fit_odometry: true, ..options })?;
    let seconds = began.elapsed().as_secs_f64();
    let mut rows = Vec::new();
    for ((name, _), (before, after)) in capture.transmitters.iter().zip(before.iter().zip(&after)) {
        let (Some(before), Some(after), Some(place)) = (before, after, places.get(name)) else {
            println!("{}: no bearing, or no truth", capture.link_name(name));
            continue;
        };
        let fit = after.odometry_fit.clone().ok_or("no fit")?;
        let (b, a) = (judged(before, &truth, *place), judged(after, &truth, *place));
        println!(
            "{}: {}: {:.1} -> {:.1} deg, bar {:.1} -> {:.1}, length {:.3} -> {:.3}; {}",
            path.name(),
            capture.link_name(name),
            b.error_deg,
            a.error_deg,
            b.bars_deg[0],
            a.bars_deg[0],
            b.length,
            a.length,
            words(&fit)
        );
        let known = match path {
            Given::Simulated([scale, forward, left]) => Some([scale, forward, left]),
            _ => None,
        };
        let off = |(own, truth): (&OdometryError, f64)| own.known.then(|| (own.value - truth) / own.sd);
        let off = known.filter(|_| fit.refused.is_none()).map_or_else(Vec::new, |known| {
            [&fit.scale, &fit.forward_m, &fit.left_m].into_iter().zip(known).filter_map(off).collect()
        });
        rows.push(Row { set: set(capture), before: b, after: a, fit, off, seconds });
    }
    Ok(rows)
}

fn words(fit: &OdometryFit) -> String {
    let one = |error: &OdometryError, by: f64| {
        format!("{:+.1} +- {:.1}{}", by * error.value, by * error.sd, if error.known { "" } else { "?" })
    };
    format!(
        "scale {} %, turn {} %, forward {} mm, left {} mm, log odds {:.1}, rotation {:.1} deg{}",
        one(&fit.scale, 100.0),
        one(&fit.turn, 100.0),
        one(&fit.forward_m, 1e3),
        one(&fit.left_m, 1e3),
        fit.log_odds,
        fit.rotation_sd_rad.to_degrees(),
        if fit.refused.is_some() { ", refused" } else { "" }
    )
}

/// Places of the transmitters, metres.
fn places(capture: &Capture) -> Fallible<BTreeMap<String, [f64; 2]>> {
    let text = std::fs::read_to_string(capture.folder.join(TRUTH_FILE))?;
    let json: serde_json::Value = serde_json::from_str(&text)?;
    let at = |name: &str, axis: &str| json["true_tx_positions"]["value"][name]["position"][axis].as_f64();
    Ok(capture
        .transmitters
        .iter()
        .filter_map(|(name, _)| Some((name.clone(), [at(name, "x")?, at(name, "y")?])))
        .collect())
}

fn judged(bearing: &Bearing, truth: &Trajectory, place: [f64; 2]) -> Judged {
    let (times, own) = (bearing.samples.t_s(), bearing.samples.receiver_m());
    let both: Vec<(Vector3<f64>, Vector3<f64>)> =
        times.iter().zip(own).filter_map(|(t_s, own)| Some((*own, truth.at(*t_s)?.position_m))).collect();
    let mean = both.iter().map(|pair| pair.1).sum::<Vector3<f64>>() / both.len().max(1) as f64;
    let azimuth_rad = (place[1] - mean.y).atan2(place[0] - mean.x);
    let answer = &bearing.answer;
    // Every tenth: noise of motion capture is no way.
    let few: Vec<_> = both.iter().step_by(10).collect();
    let length = |of: &dyn Fn(&(Vector3<f64>, Vector3<f64>)) -> Vector3<f64>| {
        few.windows(2).map(|pair| (of(pair[1]) - of(pair[0])).xy().norm()).sum::<f64>()
    };
    Judged {
        error_deg: csi5300::maths::wrap_rad(answer.azimuth_rad - azimuth_rad).to_degrees(),
        bars_deg: [answer.azimuth_sd_rad, answer.azimuth_95_rad].map(f64::to_degrees),
        length: length(&|pair| pair.0) / length(&|pair| pair.1),
    }
}

const HEAD: &str = "| path | links | corrected | error: mean / median / over 20 degrees, before | after | after within the 68 and 95 % bars | length over the true one, median before / after | scale and offset within 2 deviations | seconds |\n|---|---|---|---|---|---|---|---|---|";

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn summarise(name: &str, rows: &[Row]) {
    let count = rows.len().max(1) as f64;
    let errors = |of: &dyn Fn(&Row) -> Judged| {
        let sizes: Vec<f64> = rows.iter().map(|row| of(row).error_deg.abs()).collect();
        let over = sizes.iter().filter(|size| **size > 20.0).count() as f64 / count;
        format!("{:.1} / {:.1} / {:.0} %", sizes.iter().sum::<f64>() / count, median(sizes), 100.0 * over)
    };
    let within = |k: usize| {
        let inside = rows.iter().filter(|row| row.after.error_deg.abs() <= row.after.bars_deg[k]);
        100.0 * inside.count() as f64 / count
    };
    let off: Vec<f64> = rows.iter().flat_map(|row| row.off.clone()).collect();
    let near = off.iter().filter(|off| off.abs() < 2.0).count();
    println!(
        "| {name} | {} | {:.0} % | {} | {} | {:.0}, {:.0} % | {:.3} / {:.3} | {near} of {} | {:.1} |",
        rows.len(),
        100.0 * rows.iter().filter(|row| row.fit.refused.is_none()).count() as f64 / count,
        errors(&|row| row.before),
        errors(&|row| row.after),
        within(0),
        within(1),
        median(rows.iter().map(|row| row.before.length).collect()),
        median(rows.iter().map(|row| row.after.length).collect()),
        off.len(),
        median(rows.iter().map(|row| row.seconds).collect()),
    );
}
