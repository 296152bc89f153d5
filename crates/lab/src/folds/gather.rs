//! Every link by each trajectory, over the whole motion and parts of it.

use super::robot::mounted;
use crate::evaluate::{Capture, Judged, Part, PathError, TrajectorySource};
use csi5300::internal::{full_features, quick_features};
use csi5300::maths::wrap_rad;
use csi5300::motion::rolling::Mount;
use csi5300::pipeline::{Bearing, Options};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Trajectories that captures are judged by.
pub(super) const SOURCES: [TrajectorySource; 4] =
    [TrajectorySource::GroundTruth, TrajectorySource::T265, TrajectorySource::RollingT265, TrajectorySource::Odometry];
/// Numbers of parts that motions are cut into.
pub(super) const PARTS: [u32; 3] = [1, 2, 4];
/// Candidates of which the best is the oracle's.
const CANDIDATES: usize = 5;

/// Which answer of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Of everything that is on.
    Full,
    /// Of a plane wave at the channel centre.
    Quick,
}

/// An answer beside the truth, and what models see of it.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Answered {
    /// Azimuth less the bearing from the mean pose, wrapped, degrees.
    pub error_deg: f64,
    /// The least absolute error of the answer and the first five directions that it was chosen from, degrees.
    pub oracle_deg: f64,
    /// Features of the models of certainty; none where the answer is of another kind.
    pub features: Option<Vec<f64>>,
    /// True if a mirror is as likely: there is no probability then.
    pub mirrored: bool,
    /// Cramer-Rao bound, degrees: no error bar is below it.
    pub bound_deg: f64,
}

/// A link, by one trajectory, over one part of the motion.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FoldRow {
    /// Set and folder: the unit that is left out.
    pub place: String,
    /// The set: the first part of the place.
    pub set: String,
    /// The link's name.
    pub link: String,
    /// Trajectory by which it was estimated.
    pub source: TrajectorySource,
    /// Where the antenna was taken to be on the robot, metres forward and left: of wheel odometry and of a rolling camera, by
    /// motion capture of the other places.
    pub antenna_offset_m: Option<[f64; 2]>,
    /// How the robot was taken to carry its camera: of a rolling camera, as above.
    pub camera: Option<Mount>,
    /// Deviation of the trajectory's heading that models of certainty are given, radians.
    pub heading_sd_rad: f64,
    /// The path of the antenna over this part against motion capture's; none of motion capture itself.
    pub path: Option<PathError>,
    /// Part of the motion.
    pub part: Part,
    /// The answer of everything that is on; none where the link failed.
    pub full: Option<Answered>,
    /// The answer of a plane wave at the channel centre.
    pub quick: Option<Answered>,
}

impl FoldRow {
    /// The answer of a kind.
    #[must_use]
    pub fn answered(&self, kind: Kind) -> Option<&Answered> {
        match kind {
            Kind::Full => self.full.as_ref(),
            Kind::Quick => self.quick.as_ref(),
        }
    }
}

/// All links of `captures` by each trajectory that they have, whole and in parts. The places of antenna and camera on the robot,
/// which wheel odometry and a rolling camera have to know, are those which motion capture shows at the other places.
#[must_use]
pub fn gather(captures: &[Capture], options: &Options) -> Vec<FoldRow> {
    let parts: Vec<Part> = PARTS.into_iter().flat_map(Part::each).collect();
    let mounted = mounted(captures);
    let jobs = captures.iter().zip(&mounted).flat_map(|(capture, mounted)| {
        SOURCES.map(|source| (if on_wheels(source) { mounted } else { capture }, source))
    });
    let is_known = |(capture, source): &(&Capture, TrajectorySource)| {
        capture.has(*source) && (*source != TrajectorySource::RollingT265 || capture.camera.is_some())
    };
    let jobs: Vec<(&Capture, TrajectorySource)> = jobs.filter(is_known).collect();
    let of_run = |&(capture, source): &(&Capture, TrajectorySource)| -> Vec<FoldRow> {
        parts.iter().flat_map(|part| rows(capture, source, *part, options)).collect()
    };
    jobs.par_iter().map(of_run).collect::<Vec<_>>().into_iter().flatten().collect()
}

/// Whether a trajectory is that of the middle between the wheels before it is the antenna's.
fn on_wheels(source: TrajectorySource) -> bool {
    matches!(source, TrajectorySource::Odometry | TrajectorySource::RollingT265)
}

fn rows(capture: &Capture, source: TrajectorySource, part: Part, options: &Options) -> Vec<FoldRow> {
    let mut seen: BTreeMap<String, Seen> = BTreeMap::new();
    let mut look = |name: &str, bearing: &Bearing, options: &Options| {
        seen.insert(name.to_owned(), Seen::of(bearing, options));
    };
    let judged = capture.evaluate_part(source, None, options, part, &mut look).rows;
    let (set, place) = set_and_place(&capture.place);
    let antenna_offset_m =
        capture.antenna_offset_m.filter(|_| on_wheels(source)).map(|[forward, left, _]| [forward, left]);
    let camera = capture.camera.filter(|_| source == TrajectorySource::RollingT265);
    let heading_sd_rad = capture.heading_sd_rad(source);
    let path = (source != TrajectorySource::GroundTruth).then(|| capture.path_error(source, part)).flatten();
    let row = |judged: Judged| {
        let own = seen.remove(&judged.answer.link).zip(judged.true_from_mean_pose_deg);
        let (full, quick) = own.map_or((None, None), |(own, truth_deg)| own.answered(truth_deg));
        let (place, set, link) = (place.clone(), set.clone(), judged.answer.link);
        FoldRow { place, set, link, source, antenna_offset_m, camera, heading_sd_rad, path, part, full, quick }
    };
    judged.into_iter().map(row).collect()
}

/// The last two folders of a capture's path: a set, and a place of it.
#[must_use]
pub fn set_and_place(path: &str) -> (String, String) {
    let mut folders = path.rsplit('/');
    let last = folders.next().unwrap_or_default();
    match folders.next() {
        Some(set) => (set.to_owned(), format!("{set}/{last}")),
        None => (last.to_owned(), last.to_owned()),
    }
}

/// What is kept of a bearing.
struct Seen {
    full: Option<SeenKind>,
    quick: SeenKind,
}

/// What is kept of one kind of answer.
struct SeenKind {
    azimuth_rad: f64,
    candidates_rad: Vec<f64>,
    features: Vec<f64>,
    mirrored: bool,
    bound_rad: f64,
}

impl Seen {
    fn of(bearing: &Bearing, options: &Options) -> Self {
        let plane = &bearing.plane_wave;
        let quick = SeenKind {
            azimuth_rad: plane.azimuth_rad,
            candidates_rad: plane.peaks.iter().map(|peak| peak.azimuth_rad).collect(),
            features: quick_features(plane, bearing.compensated, options.channel.wavelength_m()).to_vec(),
            mirrored: plane.mirror_rad.is_some(),
            bound_rad: plane.azimuth_sd_rad,
        };
        let full = bearing.placed.as_ref().map(|placed| SeenKind {
            azimuth_rad: bearing.answer.azimuth_rad,
            candidates_rad: placed.fix.sources.iter().map(|source| source.azimuth_rad).collect(),
            features: full_features(&placed.fix, bearing.answer.mirror_rad).to_vec(),
            mirrored: false,
            bound_rad: bearing.answer.azimuth_bound_rad,
        });
        Self { full, quick }
    }

    fn answered(self, truth_deg: f64) -> (Option<Answered>, Option<Answered>) {
        let quick = self.quick.answered(truth_deg);
        // Without a search over places the plane wave is the whole answer, and the models of that are not for it.
        let plane = || Answered { features: None, ..quick.clone() };
        let full = self.full.map_or_else(plane, |full| full.answered(truth_deg));
        (Some(full), Some(quick))
    }
}

impl SeenKind {
    fn answered(self, truth_deg: f64) -> Answered {
        let off_deg = |azimuth_rad: &f64| wrap_rad(azimuth_rad - truth_deg.to_radians()).to_degrees();
        let error_deg = off_deg(&self.azimuth_rad);
        let others = self.candidates_rad.iter().take(CANDIDATES).map(|other| off_deg(other).abs());
        Answered {
            error_deg,
            oracle_deg: others.fold(error_deg.abs(), f64::min),
            features: Some(self.features),
            mirrored: self.mirrored,
            bound_deg: self.bound_rad.to_degrees(),
        }
    }
}
