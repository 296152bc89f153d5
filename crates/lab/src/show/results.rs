//! The pictures of a link, of an evaluation, of a recording beside a simulation, and of stationary robots.

use super::{Chart, Ellipse, Look, MapPlot, PhasePlot, PhaseTrack, ProfilePlot, Ray, RayClass, Series, file_safe};
use crate::Failure;
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
    pub fn write(&self, folder: &Path, name: &str) -> Result<Vec<PathBuf>, Failure> {
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

    fn trajectory(&self, name: &str) -> MapPlot {
        let answer = &self.bearing.answer;
        let drawn = |places: &[Vector3<f64>]| places.iter().map(|p| [p.x, p.y]).collect::<Vec<_>>();
        let (path_m, used_m) = (drawn(&self.bearing.path_m), drawn(&self.bearing.used_m()));
        let mean = |k: usize| used_m.iter().map(|place| place[k]).sum::<f64>() / used_m.len().max(1) as f64;
        let origin_m = [mean(0), mean(1)];
        let away = |place: &[f64; 2]| (place[0] - origin_m[0]).hypot(place[1] - origin_m[1]);
        let furthest_m = path_m.iter().map(away).fold(0.0, f64::max);
        let rays = [
            (self.truth_rad, None, RayClass::Truth),
            (answer.mirror_rad, None, RayClass::Mirror),
            (Some(answer.azimuth_rad), Some(answer.azimuth_sd_rad), RayClass::Measured),
        ];
        let ray = |(azimuth_rad, sd_rad, class): (Option<f64>, Option<f64>, RayClass)| {
            azimuth_rad.map(|azimuth_rad| Ray { origin_m, azimuth_rad, sd_rad, label: String::new(), class })
        };
        // One that is far away would shrink the path to a point.
        let transmitter = self.transmitter_m.filter(|place| away(place) <= FAR * furthest_m);
        MapPlot {
            title: format!("{name}: trajectory and bearing"),
            truth: transmitter.map(|place| ("transmitter".to_owned(), place)).into_iter().collect(),
            rays: rays.into_iter().filter_map(ray).collect(),
            path_m,
            used_m,
            ellipses: Vec::new(),
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

/// A transmitter further away than this many lengths of the path from its middle is not on the path's map.
const FAR: f64 = 16.0;

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

/// Writes into a folder: `errors` if a link has a truth, beside another program's `others` on the same links, `refusals` and `reliability` if such a link has a confidence, and a
/// `map-PLACE` for each capture.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn write_set(rows: &[Judged], others: &[Table], folder: &Path) -> Result<Vec<PathBuf>, Failure> {
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
pub fn write_maps(rows: &[Judged], located: &Located, folder: &Path) -> Result<Vec<PathBuf>, Failure> {
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

/// A reliability diagram: points on the diagonal are correct probabilities. Bars are the 68 % interval of the share for as many
/// independent bearings (Wilson); bearings of one place are not independent, so the bars are rather short.
fn reliable(rows: &[Judged]) -> Chart {
    let bins = reliability(&sure(rows));
    let links: usize = bins.iter().map(|bin| bin.links).sum();
    let bars = bins.iter().map(|bin| Series {
        points: wilson(bin.right, bin.links).map(|share| (bin.said, share)).to_vec(),
        look: Look::Line,
        ..Series::default()
    });
    let shares = Series {
        name: format!("links ({links})"),
        points: bins.iter().map(|bin| (bin.said, bin.right)).collect(),
        look: Look::Joined,
        colour: 0,
    };
    let diagonal = Series {
        name: "correct probabilities".into(),
        points: (0..=4).map(|k| 0.25 * f64::from(k)).map(|share| (share, share)).collect(),
        look: Look::Dashed,
        colour: 1,
    };
    Chart {
        title: "How often bearings of each confidence were right".into(),
        x_label: "mean probability given".into(),
        y_label: "share that was within 5 degrees".into(),
        series: bars.chain([shares, diagonal]).collect(),
        x: Some((0.0, 1.0)),
        y: Some((0.0, 1.0)),
        ..Chart::default()
    }
}

/// Wilson's interval of one deviation for `right` of `count` tries.
fn wilson(right: f64, count: usize) -> [f64; 2] {
    let n = count.max(1) as f64;
    let middle = (right + 0.5 / n) / (1.0 + 1.0 / n);
    let half = (right * (1.0 - right) / n + 0.25 / (n * n)).sqrt() / (1.0 + 1.0 / n);
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// Distributions of errors over a logarithmic axis.
fn distributions(title: &str, x_label: &str, series: Vec<Series>) -> Chart {
    let (title, x_label, y_label) = (title.into(), x_label.into(), "cumulative share".into());
    Chart { title, x_label, y_label, series, log_x: true, y: Some((0.0, 1.02)), ..Chart::default() }
}

/// The distribution of the sizes of errors.
fn distribution(name: &str, errors: &[f64], look: Look, colour: usize) -> Series {
    Series { name: format!("{name} (median {:.2})", median_size(errors)), points: steps(errors), look, colour }
}

fn errors(rows: &[Judged], others: &[Table]) -> Chart {
    let mut sets: BTreeMap<&str, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for row in rows {
        let Some(error) = row.error_from_mean_pose_deg else { continue };
        let (own, other) = sets.entry(row.set()).or_default();
        own.push(error);
        other.extend(others.iter().find_map(|table| table.of(&row.answer.link)).map(|beside| beside.error_deg));
    }
    // Each set has the same colour as the other program's.
    let both = sets.iter().enumerate().flat_map(|(colour, (set, (own, other)))| {
        let beside = match other.len() {
            0 => published(set, colour),
            all if all == own.len() => Some(distribution("toolbox, the same links", other, Look::Dashed, colour)),
            some => Some(distribution(&format!("toolbox, {some} of the links"), other, Look::Dashed, colour)),
        };
        std::iter::once(distribution(set, own, Look::Steps, colour)).chain(beside)
    });
    distributions("Bearing error against the mean pose", "error (degrees)", both.collect())
}

/// The toolbox's results on a published set: two points.
fn published(set: &str, colour: usize) -> Option<Series> {
    let (name, median, p90) = TOOLBOX.iter().find(|own| own.0 == set)?;
    let name = format!("toolbox on all links of {name} by motion capture: median, 90 %");
    Some(Series { name, points: vec![(*median, 0.5), (*p90, 0.9)], look: Look::Dashed, colour })
}

fn median_size(errors: &[f64]) -> f64 {
    csi5300::maths::median(&mut errors.iter().map(|error| error.abs()).collect::<Vec<_>>()).unwrap_or_default()
}

/// The distribution of errors: the share within each error, as steps.
fn steps(errors: &[f64]) -> Vec<(f64, f64)> {
    let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let n = sizes.len() as f64;
    let stair = |(k, size): (usize, f64)| [k, k + 1].map(|k| (size, k as f64 / n));
    sizes.into_iter().enumerate().flat_map(stair).collect()
}

fn refused(rows: &[Judged]) -> Chart {
    let curve = refusals(rows);
    let series = |name: &str, colour, pick: fn(&Kept) -> f64| Series {
        name: name.into(),
        points: curve.iter().map(|kept| (100.0 * kept.share, pick(kept))).collect(),
        look: Look::Joined,
        colour,
    };
    Chart {
        title: "Error of the links that are kept when the least confident are refused".into(),
        x_label: "links kept (%)".into(),
        y_label: "error (degrees)".into(),
        series: vec![
            series("mean", 0, |kept| kept.errors.mean_deg),
            series("median", 1, |kept| kept.errors.median_deg),
            series("90th percentile", 2, |kept| kept.errors.p90_deg),
        ],
        ..Chart::default()
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
pub fn write_compared(recorded: &Figures, simulated: &Figures, folder: &Path) -> Result<Vec<PathBuf>, Failure> {
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
    let late = |name, figures: &Figures, colour| distribution(name, &figures.link.late_us, Look::Steps, colour);
    let both = vec![late("recorded", recorded, 0), late("simulated", simulated, 1)];
    let turn_around = distributions("Turn-around: distance from the usual", "microseconds", both);
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
    fn intervals_of_shares_are_wilsons() {
        // Half of 100: 0.5 +- 0.5 / sqrt(101). None of 4: up to 1 / (4 + 1).
        let [low, high] = wilson(0.5, 100);
        assert!((high - 0.5 - 0.5 / 101f64.sqrt()).abs() < 1e-12 && (low + high - 1.0).abs() < 1e-12);
        let [low, high] = wilson(0.0, 4);
        assert!(low.abs() < 1e-12 && (high - 0.2).abs() < 1e-12, "{low} {high}");
    }

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
