//! The pictures of a link: phase, trajectory with the bearing on it, polar profile.

use crate::compare::Figures;
use crate::plot::{self, CdfPlot, PhasePlot, PhaseTrack, ProfilePlot, TrajectoryPlot, file_safe};
use csi5300::bartlett::{self, Grid};
use csi5300::pipeline::link::{Bearing, Phase};
use std::path::{Path, PathBuf};

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It could not be drawn or written.
    #[error(transparent)]
    Plot(#[from] plot::Error),
    /// Its profile could not be computed.
    #[error(transparent)]
    Bartlett(#[from] bartlett::Error),
    /// The folder could not be made.
    #[error("cannot make the folder {folder}: {source}")]
    Folder {
        /// The folder.
        folder: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
}

/// What is drawn of a link.
pub struct Pictures<'a> {
    /// The link; its phase is drawn if its course was kept.
    pub bearing: &'a Bearing,
    /// True azimuth, where known, radians.
    pub truth_rad: Option<f64>,
    /// A recorded link whose phase is drawn beside.
    pub recorded: Option<&'a Bearing>,
    /// Wavelength, metres.
    pub wavelength_m: f64,
}

/// Azimuths of the profile.
const AZIMUTHS: usize = 1_440;

impl Pictures<'_> {
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

    fn phase(&self, name: &str) -> PhasePlot {
        let title = format!("{name}: CSI phase at the channel centre");
        let label = if self.recorded.is_some() { "this capture" } else { "" };
        let other = self.recorded.map(|recorded| track("recorded", &recorded.course));
        PhasePlot { title, capture: track(label, &self.bearing.course), other }
    }

    fn trajectory(&self, name: &str) -> TrajectoryPlot {
        let estimate = &self.bearing.estimate;
        TrajectoryPlot {
            title: format!("{name}: {:.1} deg", estimate.azimuth_rad.to_degrees()),
            path_m: self.bearing.path_m.iter().map(|p| [p.x, p.y]).collect(),
            used_m: self.bearing.samples.receiver_m.iter().map(|p| [p.x, p.y]).collect(),
            azimuth_rad: estimate.azimuth_rad,
            mirror_rad: estimate.mirror_rad,
            sd_rad: Some(estimate.azimuth_sd_rad),
            truth_rad: self.truth_rad,
            transmitter_m: None,
        }
    }

    fn profile(&self, name: &str) -> Result<ProfilePlot, bartlett::Error> {
        let estimate = &self.bearing.estimate;
        let elevation = estimate.abs_elevation_rad;
        let azimuths: Vec<f64> = (0..AZIMUTHS).map(|k| Grid::azimuth(AZIMUTHS).at(k).0).collect();
        let ring = Grid::directions(azimuths.iter().map(|&azimuth| (azimuth, elevation)).collect());
        let profile = bartlett::profile(&self.bearing.samples, self.wavelength_m, &ring)?;
        let degrees: Vec<f64> = azimuths.iter().map(|azimuth| azimuth.to_degrees()).collect();
        Ok(ProfilePlot {
            title: format!("{name}: Bartlett profile"),
            series: vec![(format!("|elevation| {:.0} deg", elevation.to_degrees()), degrees, profile.values)],
            peaks: estimate.peaks.iter().take(3).map(|peak| (peak.azimuth_rad.to_degrees(), peak.value)).collect(),
            truth_deg: self.truth_rad.map(f64::to_degrees),
            mirror_deg: estimate.mirror_rad.map(f64::to_degrees),
        })
    }
}

fn track(label: &str, course: &[Phase]) -> PhaseTrack {
    PhaseTrack {
        label: label.into(),
        t_s: course.iter().map(|phase| phase.t_s).collect(),
        before_rad: course.iter().map(|phase| phase.one_way_rad).collect(),
        after_rad: course.iter().map(|phase| phase.compensated_rad).collect(),
    }
}

/// Writes the pictures of two captures beside each other into a folder: `compare-phase` (the round trip's phase before
/// and after turn-around compensation) and `compare-turn-around` (how far answers are from their usual time).
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn compared(recorded: &Figures, simulated: &Figures, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let round_trip = |label: &str, figures: &Figures| PhaseTrack {
        before_rad: figures.link.course.iter().map(|phase| phase.round_trip_rad).collect(),
        ..track(label, &figures.link.course)
    };
    let phase = PhasePlot {
        title: "Phase of the round trip at the channel centre".into(),
        capture: round_trip("recorded", recorded),
        other: Some(round_trip("simulated", simulated)),
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
