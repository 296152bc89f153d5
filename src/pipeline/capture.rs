//! A capture named file by file, and the bearings from it.

use super::{Bearing, LinkError, Options, Transmitter, bearings};
use crate::motion::odometry::csv::{self, CsvError};
use crate::motion::pose::Trajectory;
use crate::signal::channel::Channel;
use crate::source::{self, replay::Replay};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Why a capture gives no bearings at all. A link that fails has its own error, [`LinkError`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// A log cannot be opened or read.
    #[error(transparent)]
    Log(#[from] source::Error),
    /// A trajectory cannot be read.
    #[error("{path}: {source}", path = path.display())]
    Trajectory {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: CsvError,
    },
    /// What was not named: a log, or the receiver's trajectory.
    #[error("no {0}: name one")]
    Missing(&'static str),
}

type Log = Replay<Box<dyn Read + Send>>;

/// The logs and trajectories of one run, from files; [`bearings`] takes any [`CsiSource`](crate::source::CsiSource) that ends,
/// and trajectories as values.
///
/// The crate's first page has an example, "Bearing from logs".
pub struct Capture {
    options: Options,
    receiver: Option<Log>,
    transmitters: Vec<Log>,
    trajectory: Option<Trajectory>,
}

impl Capture {
    /// A capture on `channel`, with the defaults of [`Options::new`].
    #[must_use]
    pub fn new(channel: Channel) -> Self {
        Self { options: Options::new(channel), receiver: None, transmitters: Vec::new(), trajectory: None }
    }

    /// The receiver's log: the robot whose trajectory is given.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn receiver(self, log: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let receiver = Some(Replay::open(log.as_ref())?);
        Ok(Self { receiver, ..self })
    }

    /// The log of a transmitter that stood still; each makes one link.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn transmitter(mut self, log: impl AsRef<Path>) -> Result<Self, CaptureError> {
        self.transmitters.push(Replay::open(log.as_ref())?);
        Ok(self)
    }

    /// The receiver's trajectory: CSV as [`csv`] reads it. Rows that cannot be read are skipped.
    ///
    /// # Errors
    /// If it cannot be read or has too few rows.
    pub fn trajectory(self, file: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let path = file.as_ref();
        let read = csv::read(path, None).map_err(|source| CaptureError::Trajectory { path: path.to_owned(), source });
        Ok(Self { trajectory: Some(read?.0), ..self })
    }

    /// The bearings, in the order of the transmitters.
    ///
    /// # Errors
    /// If a piece is missing or a log cannot be read to its end.
    pub fn bearings(self) -> Result<Vec<Result<Bearing, LinkError>>, CaptureError> {
        let Self { options, receiver, mut transmitters, trajectory } = self;
        let mut receiver = receiver.ok_or(CaptureError::Missing("log of the receiver"))?;
        let trajectory = trajectory.ok_or(CaptureError::Missing("trajectory of the receiver"))?;
        if transmitters.is_empty() {
            return Err(CaptureError::Missing("log of a transmitter"));
        }
        let logs = transmitters.iter_mut().map(|log| Transmitter { log, trajectory: None });
        let report = bearings(&mut receiver, logs.collect(), &trajectory, &options)?;
        Ok(report.links.into_iter().map(|link| link.bearing).collect())
    }
}
