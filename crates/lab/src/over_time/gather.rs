//! Motions cut into stretches, each estimated by itself, and all of the motion up to some of them.

use crate::evaluate::{Capture, Judged, Part, TrajectorySource};
use csi5300::internal::track::{Evidence, PeerTrack, TrackAnswer, TrackSettings};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Bearing, Options};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// One link over one motion.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Drive {
    /// Folder of the capture.
    pub place: String,
    /// The set: the first part of the link's name.
    pub set: String,
    /// The link's name.
    pub link: String,
    /// Trajectory by which it was estimated.
    pub source: TrajectorySource,
    /// Standard deviation of its heading, radians.
    pub heading_sd_rad: f64,
    /// Stretches that the motion is cut into.
    pub stretches: Vec<StretchRow>,
}

/// One stretch of a motion.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct StretchRow {
    /// Which.
    pub part: Part,
    /// Its own bearing; none where it has none.
    pub own: Option<Seen>,
    /// Error of the bearing of the whole motion up to the stretch's end, degrees; none where it was not asked for, or has
    /// no bearing.
    pub so_far_deg: Option<f64>,
}

/// The bearing of a stretch.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Seen {
    /// What it says of the transmitter's place.
    pub evidence: Evidence,
    /// Bearing of the transmitter from the stretch's mean pose, degrees.
    pub truth_deg: f64,
    /// Azimuth less truth, wrapped, degrees.
    pub error_deg: f64,
    /// Its error bar, degrees.
    pub sd_deg: f64,
    /// Its probability of being within five degrees.
    pub confidence: Option<f64>,
}

/// What was carried to the end of a stretch.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Carried {
    /// Which of the drive's stretches.
    pub index: usize,
    /// The answer, seen from the stretch's middle.
    pub answer: TrackAnswer,
    /// Azimuth less truth, wrapped, degrees.
    pub error_deg: f64,
}

impl Drive {
    /// What a filter of these settings says after each stretch that has a bearing.
    #[must_use]
    pub fn carried(&self, settings: TrackSettings) -> Vec<Carried> {
        let mut track = PeerTrack::new(settings);
        let mut carried = Vec::new();
        for (index, stretch) in self.stretches.iter().enumerate() {
            let Some(own) = &stretch.own else { continue };
            if track.update(&own.evidence).is_err() {
                continue;
            }
            let Some(answer) = track.last_answer() else { continue };
            let error_deg = wrap_rad(answer.azimuth_rad - own.truth_deg.to_radians()).to_degrees();
            carried.push(Carried { index, answer, error_deg });
        }
        carried
    }
}

/// The links of `captures` by `source`, each motion cut into `stretches` that last equally long. Of the motion up to a
/// stretch a bearing is made after 1, 2, 4, ... stretches and after the last.
#[must_use]
pub fn gather(captures: &[Capture], source: TrajectorySource, stretches: u32, options: &Options) -> Vec<Drive> {
    let with = |capture: &&Capture| capture.has(source);
    let kept: Vec<&Capture> = captures.iter().filter(with).collect();
    kept.par_iter().flat_map_iter(|capture| drives(capture, source, stretches, options)).collect()
}

fn drives(capture: &Capture, source: TrajectorySource, stretches: u32, options: &Options) -> Vec<Drive> {
    let heading_sd_rad = options.heading_sd_rad.unwrap_or(capture.heading_sd_rad(source));
    let mut drives: BTreeMap<String, Drive> = BTreeMap::new();
    for part in Part::each(stretches) {
        let (own, mut seen) = estimated(capture, source, part, options);
        let asked = (part.index + 1).is_power_of_two() || part.index + 1 == stretches;
        let so_far = if asked { estimated(capture, source, part.and_before(), options).0 } else { Vec::new() };
        let error = |link: &str| so_far.iter().find(|row| row.answer.link == link)?.error_from_mean_pose_deg;
        for row in own {
            let link = row.answer.link.clone();
            let own = seen.remove(&link).and_then(|evidence| Seen::of(&row, evidence));
            let so_far_deg = error(&link);
            let drive = || Drive {
                place: capture.place.clone(),
                set: row.set().to_owned(),
                link: link.clone(),
                source,
                heading_sd_rad,
                stretches: Vec::new(),
            };
            let drive = drives.entry(link.clone()).or_insert_with(drive);
            drive.stretches.push(StretchRow { part, own, so_far_deg });
        }
    }
    drives.into_values().collect()
}

/// The rows of a part, and what each link's bearing says of its transmitter's place.
fn estimated(
    capture: &Capture,
    source: TrajectorySource,
    part: Part,
    options: &Options,
) -> (Vec<Judged>, BTreeMap<String, Evidence>) {
    let mut seen = BTreeMap::new();
    let mut look = |name: &str, bearing: &Bearing, _: &Options| {
        seen.insert(name.to_owned(), bearing.evidence());
    };
    let rows = capture.evaluate_part(source, None, options, part, &mut look).rows;
    (rows, seen)
}

impl Seen {
    fn of(row: &Judged, evidence: Evidence) -> Option<Self> {
        Some(Self {
            evidence,
            truth_deg: row.true_from_mean_pose_deg?,
            error_deg: row.error_from_mean_pose_deg?,
            sd_deg: row.answer.azimuth_sd_deg?,
            confidence: row.answer.confidence,
        })
    }
}
