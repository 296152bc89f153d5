//! A capture named file by file, and the bearings from it.

use super::{Bearing, CaptureReport, LinkError, Options, Transmitter, bearings};
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
    /// No log of the receiver was named.
    #[error("no log of the receiver: name one")]
    NoReceiver,
    /// No log of a transmitter was named.
    #[error("no log of a transmitter: name at least one")]
    NoTransmitter,
    /// No trajectory of the receiver was named.
    #[error("no trajectory of the receiver: name one")]
    NoTrajectory,
}

type Log = Replay<Box<dyn Read + Send>>;

/// The logs and trajectories of one run, from files; [`bearings`] takes any [`CsiSource`](crate::source::CsiSource) that ends,
/// and trajectories as values.
///
/// The crate's first page has an example, "Bearing from logs".
pub struct Capture {
    options: Options,
    receiver: Option<Log>,
    transmitters: Vec<(Log, Option<Trajectory>)>,
    trajectory: Option<Trajectory>,
}

impl Capture {
    /// A capture on `channel`, with the defaults of [`Options::new`].
    #[must_use]
    pub fn new(channel: Channel) -> Self {
        Self::with_options(Options::new(channel))
    }

    /// A capture whose bearings are made by `options`.
    #[must_use]
    pub fn with_options(options: Options) -> Self {
        Self { options, receiver: None, transmitters: Vec::new(), trajectory: None }
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
        self.transmitters.push((Replay::open(log.as_ref())?, None));
        Ok(self)
    }

    /// The log of a transmitter that moved, and its trajectory as CSV on the receiver's clock.
    ///
    /// # Errors
    /// If either cannot be read.
    pub fn moving_transmitter(
        mut self,
        log: impl AsRef<Path>,
        trajectory: impl AsRef<Path>,
    ) -> Result<Self, CaptureError> {
        let trajectory = read(trajectory.as_ref())?;
        self.transmitters.push((Replay::open(log.as_ref())?, Some(trajectory)));
        Ok(self)
    }

    /// The receiver's trajectory: CSV as [`csv`] reads it. Rows that cannot be read are skipped.
    ///
    /// # Errors
    /// If it cannot be read or has too few rows.
    pub fn trajectory(self, file: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let trajectory = Some(read(file.as_ref())?);
        Ok(Self { trajectory, ..self })
    }

    /// The bearings, in the order of the transmitters.
    ///
    /// # Errors
    /// If a piece is missing or a log cannot be read to its end.
    pub fn bearings(self) -> Result<Vec<Result<Bearing, LinkError>>, CaptureError> {
        Ok(self.report()?.links.into_iter().map(|link| link.bearing).collect())
    }

    /// The bearings with all that was counted on the way.
    ///
    /// # Errors
    /// As [`Self::bearings`].
    pub fn report(self) -> Result<CaptureReport, CaptureError> {
        let Self { options, receiver, mut transmitters, trajectory } = self;
        let mut receiver = receiver.ok_or(CaptureError::NoReceiver)?;
        let trajectory = trajectory.ok_or(CaptureError::NoTrajectory)?;
        if transmitters.is_empty() {
            return Err(CaptureError::NoTransmitter);
        }
        let logs = transmitters.iter_mut().map(|(log, path)| Transmitter { log, trajectory: path.as_ref() });
        Ok(bearings(&mut receiver, logs.collect(), &trajectory, &options)?)
    }
}

fn read(path: &Path) -> Result<Trajectory, CaptureError> {
    let read = csv::read(path).map_err(|source| CaptureError::Trajectory { path: path.to_owned(), source });
    read.map(|(trajectory, _)| trajectory)
}
