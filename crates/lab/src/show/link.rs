//! The pictures of a link: phase, trajectory with the bearing on it, polar profile, maps of places.

use super::{Error, Format, PhasePlot, PhaseTrack, ProfilePlot, TrajectoryPlot, file_safe};
use crate::curves::{Curve, evidence, plane_wave, without_motion};
use crate::evaluate::{Judged, TrajectorySource};
use csi5300::bartlett;
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::{Bearing, Phase};
use std::path::{Path, PathBuf};

/// What is drawn of a link.
pub struct LinkPictures<'a> {
    /// The link; its phase is drawn if its course was kept.
    pub bearing: &'a Bearing,
    /// True azimuth, where known, radians.
    pub truth_rad: Option<f64>,
    /// True place of the transmitter in the trajectory's frame, where known, metres.
    pub transmitter_m: Option<[f64; 2]>,
    /// A recorded link whose phase is drawn beside.
    pub recorded: Option<&'a Bearing>,
    /// Every how manieth pair's phase is drawn.
    pub every: usize,
    /// Points of the path, and places at which CSI was used, that are drawn at most; 0 is all.
    pub places: usize,
}

impl<'a> LinkPictures<'a> {
    /// A link with the truth that its row knows. Places are those of motion capture: they are on the picture of a
    /// trajectory of that frame only.
    #[must_use]
    pub fn of(row: &Judged, bearing: &'a Bearing, source: TrajectorySource) -> Self {
        let transmitter_m = row.true_transmitter_m.filter(|_| source == TrajectorySource::GroundTruth);
        let truth_rad = row.true_from_mean_pose_deg.map(f64::to_radians);
        Self { bearing, truth_rad, transmitter_m, recorded: None, every: 1, places: 0 }
    }

    /// What the pictures of [`Self::write`] are called, without their endings.
    #[must_use]
    pub fn stems(folder: &Path, name: &str) -> [PathBuf; 3] {
        ["phase", "trajectory", "profile"].map(|what| stem(folder, name, what))
    }

    /// Writes `NAME-phase`, `NAME-trajectory` and `NAME-profile` into a folder; none of them if one may not be replaced.
    ///
    /// # Errors
    /// If a picture cannot be drawn or written.
    pub fn write(&self, folder: &Path, name: &str, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let named = |source| Error::Folder { folder: folder.display().to_string(), source };
        std::fs::create_dir_all(folder).map_err(named)?;
        let [phase, trajectory, profile] = Self::stems(folder, name);
        format.check(&[phase.clone(), trajectory.clone(), profile.clone()])?;
        let mut written = Vec::new();
        if !self.bearing.course.is_empty() {
            written.extend(self.phase(name).write(&phase, format)?);
        }
        written.extend(self.trajectory(name).write(&trajectory, format)?);
        written.extend(self.profile(name)?.write(&profile, format)?);
        Ok(written)
    }

    /// Writes `NAME-phase` alone.
    ///
    /// # Errors
    /// If it cannot be drawn or written.
    pub fn write_phase(&self, folder: &Path, name: &str, format: &Format) -> Result<Vec<PathBuf>, Error> {
        self.phase(name).write(&stem(folder, name, "phase"), format)
    }

    fn phase(&self, name: &str) -> PhasePlot {
        let title = format!("{name}: phase at the channel centre");
        let label = if self.recorded.is_some() { "this capture" } else { "" };
        let other = self.recorded.map(|recorded| whole_track("recorded", recorded));
        PhasePlot {
            title,
            before: "one direction".into(),
            capture: whole_track(label, self.bearing),
            other,
            every: self.every,
            averaged: 0,
        }
    }

    fn trajectory(&self, name: &str) -> TrajectoryPlot {
        let answer = &self.bearing.answer;
        let drawn = |places: &[Vector3<f64>]| spread(places.iter().map(|p| [p.x, p.y]).collect(), self.places);
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

    /// What the answer was chosen from: the evidence over azimuth of the spherical waves, with the plane wave's profile thin
    /// beside it, or the plane wave's alone where no other was searched.
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

/// Of a path's points so many at most, equally far from each other along it, with both ends; all of them where `most` is 0.
fn spread(points: Vec<[f64; 2]>, most: usize) -> Vec<[f64; 2]> {
    if most == 0 || points.len() <= most {
        return points;
    }
    let from = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let length: f64 = points.windows(2).map(|pair| from(&pair[0], &pair[1])).sum();
    let step = length / (most.max(3) - 2) as f64;
    let (mut gone, mut last, mut kept) = (0.0, None::<[f64; 2]>, Vec::with_capacity(most));
    for point in &points {
        gone += last.map_or(step, |last| from(&last, point));
        last = Some(*point);
        if gone >= step {
            kept.push(*point);
            gone = if step > 0.0 { gone % step } else { f64::NEG_INFINITY };
        }
    }
    kept.extend(last.filter(|last| kept.last() != Some(last)));
    kept
}

/// What a picture of a link is called, without its ending.
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

/// The track of a link with the product of both directions, and with what is left without the motion.
fn whole_track(label: &str, bearing: &Bearing) -> PhaseTrack {
    PhaseTrack {
        product_rad: bearing.course.iter().map(|phase| phase.round_trip_rad).collect(),
        is_used: bearing.course.iter().map(|phase| phase.is_used).collect(),
        left: without_motion(bearing),
        ..track(label, &bearing.course)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_keeps_its_ends_and_its_shape_with_few_points() {
        let turns = |n: usize| (0..n).map(|k| std::f64::consts::TAU * k as f64 / 1_000.0);
        let path: Vec<[f64; 2]> = turns(60_000).map(|turn| [turn.cos(), turn.sin()]).collect();
        // It stands for as long as it drove.
        let whole = [path.clone(), vec![path[59_999]; 60_000]].concat();
        let few = spread(whole.clone(), 3_000);
        assert!((2_900..=3_000).contains(&few.len()), "{}", few.len());
        assert_eq!((few.first(), few.last()), (whole.first(), whole.last()));
        let longest = few.windows(2).map(|pair| (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1]));
        assert!(longest.fold(0.0, f64::max) < 0.14);
        assert_eq!(spread(path.clone(), 0), path);
        assert_eq!(spread(path[..3_000].to_vec(), 3_000), path[..3_000]);
        // One that stands is its place.
        assert_eq!(spread(vec![[1.0, 2.0]; 9], 4).last(), Some(&[1.0, 2.0]));
    }
}
