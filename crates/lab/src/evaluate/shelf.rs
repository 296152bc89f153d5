//! The files of a capture, read once for any number of evaluations.

use super::find::{Capture, TrajectorySource};
use crate::table::Held;
use csi5300::motion::odometry::csv::{self, CsvCounts, CsvError};
use csi5300::motion::pose::Trajectory;
use csi5300::source::{CsiSource, Error, replay::Replay};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Logs and trajectories in memory. Other files are read from disk each time; an empty shelf reads all of them from disk.
#[derive(Debug, Default)]
pub struct Shelf {
    logs: BTreeMap<PathBuf, Held>,
    trajectories: BTreeMap<PathBuf, (Trajectory, CsvCounts)>,
}

impl Shelf {
    pub(super) fn log(&self, path: &Path) -> Result<Box<dyn CsiSource + Send + '_>, Error> {
        Ok(match self.logs.get(path) {
            Some(held) => Box::new(held.source()),
            None => Box::new(Replay::open(path)?),
        })
    }

    pub(super) fn trajectory(&self, path: &Path) -> Result<(Trajectory, CsvCounts), CsvError> {
        self.trajectories.get(path).map_or_else(|| csv::read(path), |read| Ok(read.clone()))
    }
}

impl Capture {
    /// Reads the capture's logs and existing trajectories into memory. [`Capture::evaluate_from`] reports unreadable
    /// ones. `None` once `go_on`, called every few megabytes, returns false.
    #[must_use]
    pub fn shelf(&self, go_on: &dyn Fn() -> bool) -> Option<Shelf> {
        let mut shelf = Shelf::default();
        let receiver = self.receiver_log();
        for path in std::iter::once(&receiver).chain(self.transmitters.iter().map(|(_, path)| path)) {
            let Ok(mut source) = Replay::open(path) else { continue };
            match Held::read(&mut source, go_on) {
                Ok(Some(held)) => drop(shelf.logs.insert(path.clone(), held)),
                Ok(None) => return None,
                Err(_) => {}
            }
        }
        let robots = std::iter::once("rx").chain(self.transmitters.iter().map(|(name, _)| name.as_str()));
        for robot in robots {
            for source in [TrajectorySource::GroundTruth, TrajectorySource::T265, TrajectorySource::Odometry] {
                let path = self.trajectory_of(source, robot);
                if let Some(read) = path.is_file().then(|| csv::read(&path).ok()).flatten() {
                    shelf.trajectories.insert(path, read);
                }
            }
        }
        go_on().then_some(shelf)
    }
}
