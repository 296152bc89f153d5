//! The pictures of a link, of an evaluation, of a recording beside a simulation, and of stationary robots.

use super::{
    CdfPlot, Ellipse, Error, MapPlot, PhasePlot, PhaseTrack, ProfilePlot, Ray, RayClass, ReliabilityPlot, ScatterLines,
    TrajectoryPlot, file_safe,
};
use crate::compare::Figures;
use crate::curves::{evidence, plane_wave, without_motion};
use crate::evaluate::quality::{Table, refusals, sure};
use crate::evaluate::receivers::{Located, Receiver, receivers_with};
use crate::evaluate::{Judged, Kept, TrajectorySource, reliability};
use crate::suite::Standing;
use csi5300::bartlett;
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::{Bearing, Phase};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The input of a link's pictures.
pub struct LinkPictures<'a> {
    /// The link; its phase is drawn if its course was kept.
    pub bearing: &'a Bearing,
    /// True azimuth, where known, radians.
    pub truth_rad: Option<f64>,
    /// True place of the transmitter in the trajectory's frame, where known, metres.
    pub transmitter_m: Option<[f64; 2]>,
}

impl<'a> LinkPictures<'a> {
    /// A link with the truth from its row. Places are in motion capture's frame: only a picture of a trajectory in that frame shows
    /// them.
    #[must_use]
    pub fn of(row: &Judged, bearing: &'a Bearing, source: TrajectorySource) -> Self {
        let transmitter_m = row.true_transmitter_m.filter(|_| source == TrajectorySource::GroundTruth);
        let truth_rad = row.true_from_mean_pose_deg.map(f64::to_radians);
        Self { bearing, truth_rad, transmitter_m }
    }

    /// Writes `NAME-trajectory`, `NAME-profile` and, if the course was kept, `NAME-phase` into a folder.
    ///
    /// # Errors
    /// If a picture cannot be drawn or written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<Vec<PathBuf>, Error> {
        let stem = |what: &str| folder.join(format!("{}-{what}", file_safe(name)));
        let mut written = Vec::new();
        if !self.bearing.course.is_empty() {
            written.extend(self.phase(name).write(&stem("phase"))?);
        }
        written.extend(self.trajectory(name).write(&stem("trajectory"))?);
        written.extend(self.profile(name)?.write(&stem("profile"))?);
        Ok(written)
    }

    fn phase(&self, name: &str) -> PhasePlot {
        let title = format!("{name}: phase at the channel centre");
        PhasePlot { title, before: "one direction".into(), capture: whole_track(self.bearing), ..PhasePlot::default() }
    }

    fn trajectory(&self, name: &str) -> TrajectoryPlot {
        let answer = &self.bearing.answer;
        let drawn = |places: &[Vector3<f64>]| places.iter().map(|p| [p.x, p.y]).collect();
        TrajectoryPlot {
            title: format!("{name}: trajectory and bearing"),
            path_m: drawn(&self.bearing.path_m),
            used_m: drawn(self.bearing.samples.receiver_m()),
            azimuth_rad: answer.azimuth_rad,
            mirror_rad: answer.mirror_rad,
            sd_rad: Some(answer.azimuth_sd_rad),
            truth_rad: self.truth_rad,
            transmitter_m: self.transmitter_m,
        }
    }

    /// The evidence over azimuth from which the answer was chosen: the spherical waves', with the plane wave's profile drawn thin
    /// beside it; or only the plane wave's if no spherical wave was searched.
    fn profile(&self, name: &str) -> Result<ProfilePlot, bartlett::Error> {
        let answer = &self.bearing.answer;
        let plane_wave = plane_wave(self.bearing)?;
        let (chosen_from, others) = match evidence(self.bearing) {
            Some(evidence) => (evidence, vec![plane_wave]),
            None => (plane_wave, Vec::new()),
        };
        let degrees = answer.azimuth_rad.to_degrees();
        Ok(ProfilePlot {
            title: format!("{name}: where the signal comes from"),
            chosen_from,
            others,
            candidates_deg: answer.candidates.iter().map(|other| other.azimuth_rad.to_degrees()).collect(),
            answer_deg: Some(degrees),
            answer_sd_deg: Some(answer.azimuth_sd_rad.to_degrees()),
            truth_deg: self.truth_rad.map(f64::to_degrees),
            mirror_deg: answer.mirror_rad.map(f64::to_degrees),
        })
    }
}

/// One kind of phase of pairs, over time.
fn over_time(course: &[Phase], kind: fn(&Phase) -> f64) -> Vec<(f64, f64)> {
    course.iter().map(|phase| (phase.t_s, kind(phase))).collect()
}

fn track(label: &str, course: &[Phase]) -> PhaseTrack {
    PhaseTrack {
        label: label.into(),
        before: over_time(course, |phase| phase.one_way_rad),
        after: over_time(course, |phase| phase.compensated_rad),
        ..PhaseTrack::default()
    }
}

/// The phases of a link: the product of both directions, and the residual without the motion's phase.
fn whole_track(bearing: &Bearing) -> PhaseTrack {
    PhaseTrack {
        product: over_time(&bearing.course, |phase| phase.round_trip_rad),
        is_used: bearing.course.iter().map(|phase| phase.is_used).collect(),
        left: without_motion(bearing),
        ..track("", &bearing.course)
    }
}

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
pub fn write_set(rows: &[Judged], others: &Others, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let judged = |row: &&Judged| row.error_from_mean_pose_deg.is_some();
    let mut written = Vec::new();
    if rows.iter().any(|row| judged(&row)) {
        written.extend(errors(rows, others).write(&folder.join("errors"))?);
    }
    if !sure(rows).is_empty() {
        written.extend(refused(rows).write(&folder.join("refusals"))?);
        written.extend(reliable(rows).write(&folder.join("reliability"))?);
    }
    written.extend(write_maps(rows, &receivers_with(rows, &BTreeMap::new(), false), folder)?);
    Ok(written)
}

/// Writes a `map-PLACE` into a folder for each capture with a known receiver path, with the receiver as located, and a `map-team`
/// if several captures were located as one graph.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write_maps(rows: &[Judged], located: &Located, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut captures: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        if let Some((capture, _)) = row.answer.link.rsplit_once('/') {
            captures.entry(capture).or_default().push(row);
        }
    }
    captures.retain(|_, own| own.iter().any(|row| row.true_receiver_m.is_some()));
    let stem = |capture: &str| folder.join(format!("map-{}", file_safe(capture)));
    let mut written = Vec::new();
    for (capture, own) in captures {
        let receiver = located.receivers.iter().find(|receiver| receiver.capture == capture);
        written.extend(map(capture, &own, receiver).write(&stem(capture))?);
    }
    if !located.transmitters.is_empty() {
        written.extend(team_map(rows, located).write(&stem("team"))?);
    }
    Ok(written)
}

fn reliable(rows: &[Judged]) -> ReliabilityPlot {
    let series = vec![("links".to_owned(), reliability(&sure(rows)))];
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

/// The toolbox's results on a published set: two points.
fn published(set: &str) -> Option<(String, Vec<(f64, f64)>)> {
    let (name, median, p90) = TOOLBOX.iter().find(|own| own.0 == set)?;
    Some((format!("toolbox on all links of {name} by motion capture: median, 90 %"), vec![(*median, 0.5), (*p90, 0.9)]))
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
    let known = |row: &Judged| Some((row.transmitter().to_owned(), row.true_transmitter_m?));
    plot.truth = rows.iter().filter_map(known).collect();
    plot.truth.sort_by(|a, b| a.0.cmp(&b.0));
    plot.truth.dedup();
    plot
}

fn map(capture: &str, rows: &[&Judged], receiver: Option<&Receiver>) -> MapPlot {
    let title = format!("{capture}: bearings, probability within 5°");
    let mut plot = MapPlot { title, ..MapPlot::default() };
    for row in rows {
        let name = row.transmitter();
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
        if let (Some(at), Some(c)) = (row.answer.position_m, row.answer.position_covariance_m2) {
            // A camera's or wheels' frame may have another origin than the map.
            let here = row.answer.origin_m.map_or(origin_m, |[x, y, _]| [x, y]);
            let centre_m = [0, 1].map(|k| at[k] - here[k] + origin_m[k]);
            let covariance_m2 = [[c[0][0], c[0][1]], [c[1][0], c[1][1]]];
            plot.ellipses.push(Ellipse { centre_m, covariance_m2, label: name.into() });
        }
    }
    if let Some((centre_m, covariance_m2)) = receiver.and_then(|r| r.position_m.zip(r.covariance_m2)) {
        plot.ellipses.push(Ellipse { centre_m, covariance_m2, label: "receiver".into() });
    }
    plot.truth.extend(rows.iter().find_map(|row| row.true_receiver_m).map(|at| ("receiver".to_owned(), at)));
    plot
}

/// Writes the pictures of two captures side by side into a folder: `compare-phase` (the round trip's phase before and after
/// turn-around compensation) and `compare-turn-around` (deviation of answers from their usual time).
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write_compared(recorded: &Figures, simulated: &Figures, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let round_trip = |label: &str, figures: &Figures| PhaseTrack {
        before: over_time(&figures.link.course, |phase| phase.round_trip_rad),
        ..track(label, &figures.link.course)
    };
    let phase = PhasePlot {
        title: "Phase of the round trip at the channel centre".into(),
        before: "both directions multiplied".into(),
        capture: round_trip("recorded", recorded),
        other: Some(round_trip("simulated", simulated)),
        ..PhasePlot::default()
    };
    let late = |label: &str, figures: &Figures| (label.to_owned(), figures.link.late_us.clone());
    let turn_around = CdfPlot {
        title: "Turn-around: distance from the usual".into(),
        x_label: "microseconds".into(),
        series: vec![late("recorded", recorded), late("simulated", simulated)],
        ..CdfPlot::default()
    };
    let mut written = phase.write(&folder.join("compare-phase"))?;
    written.extend(turn_around.write(&folder.join("compare-turn-around"))?);
    Ok(written)
}

/// Pairs of stationary robots whose phases are averaged before unwrapping.
const STANDING: usize = 25;

/// The phase of two stationary robots.
#[must_use]
pub fn standing(standing: &Standing) -> PhasePlot {
    let product = over_time(&standing.course, |phase| phase.round_trip_rad);
    let spread = format!(
        "from packet to packet: {:.2} rad, {:.2} rad, {:.2} rad",
        standing.phase_one_way_rad, standing.phase_before_rad, standing.phase_after_rad
    );
    PhasePlot {
        title: "Two robots that stand: phase at the channel centre".into(),
        before: "one direction".into(),
        capture: PhaseTrack { product, ..track(&spread, &standing.course) },
        averaged: STANDING,
        ..PhasePlot::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::pipeline::Answer;

    #[test]
    fn a_place_is_drawn_from_the_receiver_of_the_map_whatever_the_origin_of_its_trajectory() {
        let mut answer = Answer::failed("set/place/tx2".into(), String::new());
        (answer.origin_m, answer.position_m) = (Some([0.2, -0.3, 0.0]), Some([2.7, -1.5, 0.4]));
        answer.position_covariance_m2 = Some([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]]);
        let row = Judged { answer, true_receiver_m: Some([-0.4, -0.8]), ..Judged::default() };
        let plot = map("place", &[&row], None);
        let [x, y] = plot.ellipses[0].centre_m;
        assert!((x - 2.1).abs() < 1e-12 && (y + 2.0).abs() < 1e-12, "{x} {y}");
    }
}
