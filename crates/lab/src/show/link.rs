//! The pictures of a link: phase, trajectory with the bearing on it, polar profile, maps of places.

use super::{Error, PhasePlot, PhaseTrack, PlaceMap, ProfilePlot, TrajectoryPlot, file_safe};
use csi5300::bartlett::{self, Grid};
use csi5300::pipeline::{Bearing, Candidate, Phase};
use std::path::{Path, PathBuf};

/// What is drawn of a link.
pub struct LinkPictures<'a> {
    /// The link; its phase is drawn if its course was kept.
    pub bearing: &'a Bearing,
    /// True azimuth, where known, radians.
    pub truth_rad: Option<f64>,
    /// A recorded link whose phase is drawn beside.
    pub recorded: Option<&'a Bearing>,
}

/// Azimuths of the profile.
const AZIMUTHS: usize = 1_440;

impl LinkPictures<'_> {
    /// Writes `NAME-phase`, `NAME-trajectory` and `NAME-profile` into a folder, each as .png and .svg.
    ///
    /// # Errors
    /// If a picture cannot be drawn or written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<Vec<PathBuf>, Error> {
        let named = |source| Error::Folder { folder: folder.display().to_string(), source };
        std::fs::create_dir_all(folder).map_err(named)?;
        let stem = |what: &str| folder.join(format!("{}-{what}", file_safe(name)));
        let mut written = Vec::new();
        if !self.bearing.course.is_empty() {
            written.extend(self.phase(name).write(&stem("phase"))?);
        }
        written.extend(self.trajectory(name).write(&stem("trajectory"))?);
        written.extend(self.profile(name)?.write(&stem("profile"))?);
        Ok(written)
    }

    /// The same, and `NAME-azimuth-elevation` and `NAME-azimuth-range` where maps were asked for.
    ///
    /// # Errors
    /// If a picture cannot be drawn or written.
    pub fn write_all(&self, folder: &Path, name: &str) -> Result<Vec<PathBuf>, Error> {
        let mut written = self.write(folder, name)?;
        let stem = |what: &str| folder.join(format!("{}-{what}", file_safe(name)));
        for (what, map) in places(self.bearing, name, self.truth_rad.map(f64::to_degrees)) {
            written.extend(map.write(&stem(what))?);
        }
        Ok(written)
    }

    fn phase(&self, name: &str) -> PhasePlot {
        let title = format!("{name}: CSI phase at the channel centre");
        let label = if self.recorded.is_some() { "this capture" } else { "" };
        let other = self.recorded.map(|recorded| track("recorded", &recorded.course));
        PhasePlot { title, capture: track(label, &self.bearing.course), other }
    }

    fn trajectory(&self, name: &str) -> TrajectoryPlot {
        let answer = &self.bearing.answer;
        TrajectoryPlot {
            title: format!("{name}: {:.1} deg", answer.azimuth_rad.to_degrees()),
            path_m: self.bearing.path_m.iter().map(|p| [p.x, p.y]).collect(),
            used_m: self.bearing.samples.receiver_m().iter().map(|p| [p.x, p.y]).collect(),
            azimuth_rad: answer.azimuth_rad,
            mirror_rad: answer.mirror_rad,
            sd_rad: Some(answer.azimuth_sd_rad),
            truth_rad: self.truth_rad,
            transmitter_m: None,
        }
    }

    /// The plane wave's profile at the answer's |elevation|, and on it the answer's candidates by their relative power.
    fn profile(&self, name: &str) -> Result<ProfilePlot, bartlett::Error> {
        let answer = &self.bearing.answer;
        let elevation = answer.abs_elevation_rad;
        let azimuths: Vec<f64> = (0..AZIMUTHS).map(|k| Grid::azimuth(AZIMUTHS).at(k).0).collect();
        let ring = Grid::directions(azimuths.iter().map(|&azimuth| (azimuth, elevation)).collect());
        let profile = bartlett::profile(&self.bearing.samples, &ring)?;
        let highest = profile.values.iter().copied().fold(0.0, f64::max);
        let best = answer.candidates.first().map_or(1.0, |best| best.power);
        let mark = |other: &Candidate| (other.azimuth_rad.to_degrees(), highest * other.power / best);
        let degrees: Vec<f64> = azimuths.iter().map(|azimuth| azimuth.to_degrees()).collect();
        Ok(ProfilePlot {
            title: format!("{name}: Bartlett profile"),
            series: vec![(format!("|elevation| {:.0} deg", elevation.to_degrees()), degrees, profile.values)],
            peaks: answer.candidates.iter().take(3).map(mark).collect(),
            truth_deg: self.truth_rad.map(f64::to_degrees),
            mirror_deg: answer.mirror_rad.map(f64::to_degrees),
        })
    }
}

pub(super) fn track(label: &str, course: &[Phase]) -> PhaseTrack {
    PhaseTrack {
        label: label.into(),
        t_s: course.iter().map(|phase| phase.t_s).collect(),
        before_rad: course.iter().map(|phase| phase.one_way_rad).collect(),
        after_rad: course.iter().map(|phase| phase.compensated_rad).collect(),
    }
}

fn places(bearing: &Bearing, name: &str, truth_deg: Option<f64>) -> Vec<(&'static str, PlaceMap)> {
    let Some(maps) = bearing.placed.as_ref().and_then(|placed| placed.maps.as_ref()) else {
        return Vec::new();
    };
    let candidates = || bearing.answer.candidates.iter();
    let last = |values: &[f64]| values.last().copied().unwrap_or(0.0);
    let mut found = Vec::new();
    if maps.elevations_rad.len() > 1 {
        let own = candidates().map(|s| (s.azimuth_rad.to_degrees(), s.abs_elevation_rad.to_degrees()));
        let map = PlaceMap {
            title: format!("{name}: joint power, best range of each"),
            y_label: "|elevation| (degrees)".into(),
            y: (0.0, last(&maps.elevations_rad).to_degrees()),
            n_az: maps.azimuths,
            value: maps.over_elevation.clone(),
            marks: own.collect(),
            truth_deg,
            ..PlaceMap::default()
        };
        found.push(("azimuth-elevation", map));
    }
    if maps.curves_per_m.len() > 1 {
        let most = last(&maps.curves_per_m);
        let ticks = [f64::INFINITY, 20.0, 10.0, 6.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0];
        let shown = ticks.into_iter().filter(|range| 1.0 / range <= most * 1.001);
        let map = PlaceMap {
            title: format!("{name}: joint power, best elevation of each"),
            y_label: "range (m), even in 1/range".into(),
            y: (0.0, most),
            y_ticks: shown.map(|r| (1.0 / r, if r.is_finite() { r.to_string() } else { "far".into() })).collect(),
            n_az: maps.azimuths,
            value: maps.over_range.clone(),
            marks: candidates().map(|s| (s.azimuth_rad.to_degrees(), s.inverse_range_per_m)).collect(),
            truth_deg,
        };
        found.push(("azimuth-range", map));
    }
    found
}
