//! The pictures of a link: phase, trajectory with bearing, polar profile, maps of places.

use super::{Error, Format, PhasePlot, PhaseTrack, ProfilePlot, TrajectoryPlot, file_safe};
use crate::curves::{Curve, evidence, plane_wave, without_motion};
use crate::evaluate::{Judged, TrajectorySource};
use csi5300::bartlett;
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::{Bearing, Phase};
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

    /// Names of a link's pictures, without extensions.
    #[must_use]
    pub fn stems(folder: &Path, name: &str) -> [PathBuf; 3] {
        ["phase", "trajectory", "profile"].map(|what| stem(folder, name, what))
    }

    /// Writes `NAME-trajectory`, `NAME-profile` and, if the course was kept, `NAME-phase` into a folder; none of them if one may
    /// not be replaced.
    ///
    /// # Errors
    /// If a picture cannot be drawn or written.
    pub fn write(&self, folder: &Path, name: &str, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let named = |source| Error::Folder { folder: folder.display().to_string(), source };
        std::fs::create_dir_all(folder).map_err(named)?;
        format.check(&Self::stems(folder, name))?;
        let mut written = Vec::new();
        if !self.bearing.course.is_empty() {
            written.extend(self.phase(name).write(&stem(folder, name, "phase"), format)?);
        }
        written.extend(self.trajectory(name).write(&stem(folder, name, "trajectory"), format)?);
        written.extend(self.profile(name)?.write(&stem(folder, name, "profile"), format)?);
        Ok(written)
    }

    fn phase(&self, name: &str) -> PhasePlot {
        let title = format!("{name}: phase at the channel centre");
        PhasePlot {
            title,
            before: "one direction".into(),
            capture: whole_track(self.bearing),
            other: None,
            averaged: 0,
        }
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
        let evidence = evidence(self.bearing);
        let drawn = |curve: Curve| (curve.name, curve.azimuths_deg, curve.values);
        let (chosen_from, others) = match evidence {
            Some(evidence) => (drawn(evidence), vec![drawn(plane_wave)]),
            None => (drawn(plane_wave), Vec::new()),
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

/// Name of a link's picture, without extension.
fn stem(folder: &Path, name: &str, what: &str) -> PathBuf {
    folder.join(format!("{}-{what}", file_safe(name)))
}

pub(super) fn track(label: &str, course: &[Phase]) -> PhaseTrack {
    PhaseTrack {
        label: label.into(),
        t_s: course.iter().map(|phase| phase.t_s).collect(),
        before_rad: course.iter().map(|phase| phase.one_way_rad).collect(),
        after_rad: course.iter().map(|phase| phase.compensated_rad).collect(),
        ..PhaseTrack::default()
    }
}

/// The phases of a link: the product of both directions, and the residual without the motion's phase.
fn whole_track(bearing: &Bearing) -> PhaseTrack {
    PhaseTrack {
        product_rad: bearing.course.iter().map(|phase| phase.round_trip_rad).collect(),
        is_used: bearing.course.iter().map(|phase| phase.is_used).collect(),
        left: without_motion(bearing),
        ..track("", &bearing.course)
    }
}
