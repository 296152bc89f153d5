//! The pictures of an evaluation: error distributions, refusals, reliability of the confidence, a map of each place.

use super::{
    CdfPlot, Ellipse, Error, Format, MapPlot, Ray, RayClass, ReliabilityPlot, ReliabilityPoint, ScatterLines, file_safe,
};
use crate::evaluate::beside::Table;
use crate::evaluate::quality::{refusals, sure};
use crate::evaluate::receivers::{Located, Receiver, receivers_with};
use crate::evaluate::{Judged, Kept, Reliability, TrajectorySource, reliability};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Results of the released WSR toolbox on each set of its data, with motion capture, against the mean pose, over all links of
/// the published set (measured): name, median, 90th percentile, degrees. Drawn if no table has its answers on these links.
const TOOLBOX: [(&str, f64, f64); 5] = [
    ("LOS_Set_A", 2.46, 5.97),
    ("LOS_Set_B", 3.65, 14.80),
    ("NLOS_Set_A", 8.72, 27.29),
    ("NLOS_Set_B", 11.24, 88.30),
    ("NLOS_Set_C", 2.15, 7.03),
];

/// Another program's answers on the same links, from the tables beside the captures.
#[derive(Clone, Debug, Default)]
pub struct Others(Vec<Table>);

impl Others {
    /// Adds the table of a folder, if any. Returns what was skipped and why: a loss.
    pub fn add(&mut self, folder: &Path, source: TrajectorySource) -> Option<String> {
        let (table, note) = Table::noted(folder, source);
        self.0.extend(table);
        note
    }

    fn error_deg(&self, row: &Judged) -> Option<f64> {
        self.0.iter().find_map(|table| table.of(&row.answer.link)).map(|beside| beside.error_deg)
    }
}

/// Writes into a folder: `errors` if a link has a truth, `refusals` and `reliability` if such a link has a confidence, and a
/// `map-PLACE` for each capture.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write(rows: &[Judged], others: &Others, folder: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
    let [errors_stem, refusals_stem, reliability_stem] = stems(folder);
    let judged = |row: &&Judged| row.error_from_mean_pose_deg.is_some();
    let mut written = Vec::new();
    if rows.iter().any(|row| judged(&row)) {
        written.extend(errors(rows, others).write(&errors_stem, format)?);
    }
    if !sure(rows).is_empty() {
        written.extend(refused(rows).write(&refusals_stem, format)?);
        written.extend(reliable(rows).write(&reliability_stem, format)?);
    }
    written.extend(write_maps(rows, &receivers_with(rows, &BTreeMap::new(), false), folder, format)?);
    Ok(written)
}

/// Writes a `map-PLACE` into a folder for each capture with a known receiver path, with the receiver as located, and a `map-team`
/// if several captures were located as one graph; none of them if one may not be replaced.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write_maps(rows: &[Judged], located: &Located, folder: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
    let mut captures: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        if let Some((capture, _)) = row.answer.link.rsplit_once('/') {
            captures.entry(capture).or_default().push(row);
        }
    }
    captures.retain(|_, own| own.iter().any(|row| row.true_receiver_m.is_some()));
    let stem = |capture: &str| map_stem(folder, capture);
    let team = (!located.transmitters.is_empty()).then(|| stem(TEAM));
    format.check(&captures.keys().map(|capture| stem(capture)).chain(team.clone()).collect::<Vec<_>>())?;
    let mut written = Vec::new();
    for (capture, own) in captures {
        let receiver = located.receivers.iter().find(|receiver| receiver.capture == capture);
        written.extend(map(capture, &own, receiver).write(&stem(capture), format)?);
    }
    if let Some(stem) = team {
        written.extend(team_map(rows, located).write(&stem, format)?);
    }
    Ok(written)
}

/// The map of captures that are one graph, in place of a capture's name.
pub const TEAM: &str = "team";

/// Name of a capture's map ([`Capture::link_name`](crate::evaluate::Capture::link_name)), without extension.
#[must_use]
pub fn map_stem(folder: &Path, capture: &str) -> PathBuf {
    folder.join(format!("map-{}", file_safe(capture)))
}

/// Names of the pictures of all links together, without extensions.
#[must_use]
pub fn stems(folder: &Path) -> [PathBuf; 3] {
    ["errors", "refusals", "reliability"].map(|name| folder.join(name))
}

fn points(bins: &[Reliability]) -> Vec<ReliabilityPoint> {
    bins.iter().map(|bin| ReliabilityPoint { said: bin.said, right: bin.right, count: bin.links }).collect()
}

fn reliable(rows: &[Judged]) -> ReliabilityPlot {
    let series = vec![("links".to_owned(), points(&reliability(&sure(rows))))];
    ReliabilityPlot { title: "How often bearings of each confidence were right".into(), series }
}

fn errors(rows: &[Judged], others: &Others) -> CdfPlot {
    let mut sets: BTreeMap<String, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for row in rows {
        let Some(error) = row.error_from_mean_pose_deg else { continue };
        let (own, other) = sets.entry(row.set().into()).or_default();
        own.push(error);
        other.extend(others.error_deg(row));
    }
    // In the order of the sets, so that each has the same colour as the other program's.
    let known = sets.iter().map(|(set, (own, other))| match other.as_slice() {
        [] => published(set).unwrap_or_default(),
        other => {
            let of = if other.len() == own.len() { "the same".into() } else { format!("{} of the", other.len()) };
            (format!("toolbox, {of} links (median {:.2})", median_size(other)), steps(other))
        }
    });
    CdfPlot {
        title: "Bearing error against the mean pose".into(),
        x_label: "error (degrees)".into(),
        known: known.collect(),
        series: sets.iter().map(|(set, (own, _))| (set.clone(), own.clone())).collect(),
    }
}

/// The published results of a set: two points.
fn published(set: &str) -> Option<(String, Vec<(f64, f64)>)> {
    let (name, median, p90) = TOOLBOX.iter().find(|own| own.0 == set)?;
    Some((format!("toolbox on all links of {name} as published: median, 90 %"), vec![(*median, 0.5), (*p90, 0.9)]))
}

fn median_size(errors: &[f64]) -> f64 {
    csi5300::maths::median(&mut errors.iter().map(|error| error.abs()).collect::<Vec<_>>()).unwrap_or_default()
}

/// The distribution of errors: the share within each error, as steps.
fn steps(errors: &[f64]) -> Vec<(f64, f64)> {
    let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let n = sizes.len() as f64;
    let stair = |(k, size): (usize, f64)| [k, k + 1].map(|k| (size.max(0.01), k as f64 / n));
    sizes.into_iter().enumerate().flat_map(stair).collect()
}

fn refused(rows: &[Judged]) -> ScatterLines {
    let curve = refusals(rows);
    let points = |pick: fn(&Kept) -> f64| curve.iter().map(|k| (100.0 * k.share, pick(k))).collect();
    ScatterLines {
        title: "Error of the links that are kept when the least confident are refused".into(),
        x_label: "links kept (%)".into(),
        y_label: "error (degrees)".into(),
        series: vec![
            ("mean".into(), points(|kept| kept.errors.mean_deg)),
            ("median".into(), points(|kept| kept.errors.median_deg)),
            ("90th percentile".into(), points(|kept| kept.errors.p90_deg)),
        ],
        lines: true,
        ..ScatterLines::default()
    }
}

/// All receivers and transmitters of one graph, with the bearings that fit their places.
fn team_map(rows: &[Judged], located: &Located) -> MapPlot {
    let mut plot = MapPlot { title: "Receivers and transmitters, 95 % ellipses".into(), ..MapPlot::default() };
    for receiver in &located.receivers {
        let Some((centre_m, covariance_m2)) = receiver.position_m.zip(receiver.covariance_m2) else { continue };
        plot.ellipses.push(Ellipse { centre_m, covariance_m2, label: receiver.capture.clone() });
        plot.rays.extend(receiver.azimuths_deg.iter().map(|deg| Ray {
            origin_m: centre_m,
            azimuth_rad: deg.to_radians(),
            sd_rad: None,
            label: String::new(),
            class: RayClass::Measured,
        }));
    }
    for own in &located.transmitters {
        let (centre_m, covariance_m2) = (own.position_m, own.covariance_m2);
        plot.ellipses.push(Ellipse { centre_m, covariance_m2, label: own.transmitter.clone() });
    }
    let name = |row: &Judged| row.answer.link.rsplit('/').next().unwrap_or_default().to_owned();
    let mut known: Vec<(String, [f64; 2])> =
        rows.iter().filter_map(|row| Some((name(row), row.true_transmitter_m?))).collect();
    known.sort_by(|a, b| a.0.cmp(&b.0));
    known.dedup();
    plot.truth = known;
    plot
}

fn map(capture: &str, rows: &[&Judged], receiver: Option<&Receiver>) -> MapPlot {
    let title = format!("{capture}: bearings, probability within 5°");
    let mut plot = MapPlot { title, ..MapPlot::default() };
    for row in rows {
        let name = row.answer.link.rsplit('/').next().unwrap_or_default();
        plot.truth.extend(row.true_transmitter_m.map(|at| (name.to_owned(), at)));
        let Some(origin_m) = row.true_receiver_m else { continue };
        let sd_rad = row.answer.azimuth_sd_deg.map(f64::to_radians);
        let mut ray = |azimuth_deg: Option<f64>, label: String, class| {
            let sd_rad = sd_rad.filter(|_| class == RayClass::Measured);
            plot.rays.extend(azimuth_deg.map(|deg| Ray {
                origin_m,
                azimuth_rad: deg.to_radians(),
                sd_rad,
                label,
                class,
            }));
        };
        ray(row.true_from_mean_pose_deg, String::new(), RayClass::Truth);
        let sure = row.answer.confidence.map_or(String::new(), |c| format!("{name} {:.0} %", 100.0 * c));
        ray(row.answer.azimuth_deg, sure, RayClass::Measured);
        ray(row.answer.mirror_deg, String::new(), RayClass::Mirror);
        if let (Some([x, y, _]), Some(c)) = (row.answer.position_m, row.answer.position_covariance_m2) {
            let covariance_m2 = [[c[0][0], c[0][1]], [c[1][0], c[1][1]]];
            plot.ellipses.push(Ellipse { centre_m: [x, y], covariance_m2, label: name.into() });
        }
    }
    if let Some((centre_m, covariance_m2)) = receiver.and_then(|r| r.position_m.zip(r.covariance_m2)) {
        plot.ellipses.push(Ellipse { centre_m, covariance_m2, label: "receiver".into() });
    }
    plot.truth.extend(rows.iter().find_map(|row| row.true_receiver_m).map(|at| ("receiver".to_owned(), at)));
    plot
}
