//! A capture named file by file, and the bearings from it.

use super::{Bearing, CaptureReport, LinkError, Options, Transmitter, bearings};
use crate::motion::odometry::csv::{self, CsvError};
use crate::motion::pose::Trajectory;
use crate::signal::channel::Channel;
use crate::source::{self, CsiSource, replay::Replay};
use std::path::{Path, PathBuf};

/// Why a capture gives no bearings at all. A link that fails is an error of its own, [`LinkError`].
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

/// The logs and trajectories of one run, from files or from any [`CsiSource`] that ends.
///
/// The crate's first page has an example, "Bearing from logs".
pub struct Capture<'a> {
    options: Options,
    receiver: Option<Box<dyn CsiSource + 'a>>,
    transmitters: Vec<(Box<dyn CsiSource + 'a>, Option<Trajectory>)>,
    trajectory: Option<Trajectory>,
}

impl<'a> Capture<'a> {
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
        Ok(self.receiver_source(Replay::open(log.as_ref())?))
    }

    /// The log of a transmitter that stood still; each makes one link.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn transmitter(self, log: impl AsRef<Path>) -> Result<Self, CaptureError> {
        Ok(self.transmitter_source(Replay::open(log.as_ref())?, None))
    }

    /// The log of a transmitter that moved, and its trajectory as CSV on the receiver's clock.
    ///
    /// # Errors
    /// If either cannot be read.
    pub fn moving_transmitter(self, log: impl AsRef<Path>, trajectory: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let trajectory = read(trajectory.as_ref())?;
        Ok(self.transmitter_source(Replay::open(log.as_ref())?, Some(trajectory)))
    }

    /// The receiver's trajectory: CSV as [`csv`] reads it. Rows that cannot be read are left out.
    ///
    /// # Errors
    /// If it cannot be read or has too few rows.
    pub fn trajectory(self, file: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let trajectory = read(file.as_ref())?;
        Ok(self.trajectory_value(trajectory))
    }

    /// The receiver's records from any source that ends.
    #[must_use]
    pub fn receiver_source(mut self, source: impl CsiSource + 'a) -> Self {
        self.receiver = Some(Box::new(source));
        self
    }

    /// A transmitter's records from any source that ends, and its trajectory on the receiver's clock if it moved.
    #[must_use]
    pub fn transmitter_source(mut self, source: impl CsiSource + 'a, trajectory: Option<Trajectory>) -> Self {
        self.transmitters.push((Box::new(source), trajectory));
        self
    }

    /// The receiver's trajectory as a value.
    #[must_use]
    pub fn trajectory_value(mut self, trajectory: Trajectory) -> Self {
        self.trajectory = Some(trajectory);
        self
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
        let logs =
            transmitters.iter_mut().map(|(log, path)| Transmitter { log: &mut **log, trajectory: path.as_ref() });
        Ok(bearings(&mut *receiver, logs.collect(), &trajectory, &options)?)
    }
}

fn read(path: &Path) -> Result<Trajectory, CaptureError> {
    let read = csv::read(path).map_err(|source| CaptureError::Trajectory { path: path.to_owned(), source });
    read.map(|(trajectory, _)| trajectory)
}
