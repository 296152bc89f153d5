//! Why a source of poses failed.

use super::csv::RowError;
use crate::motion::pose::TrajectoryError;

/// Why a source of poses cannot continue.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OdometryError {
    /// The operating system refused.
    #[error("{what}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// A pose came that cannot be read.
    #[error("{what}: {source}")]
    Row {
        /// Whose pose.
        what: &'static str,
        /// What is wrong with it.
        source: RowError,
    },
    /// A pose came that cannot be moved to the antenna.
    #[error(transparent)]
    Mounting(#[from] TrajectoryError),
    /// A source in another program failed.
    #[error(transparent)]
    Other(Box<dyn std::error::Error + Send + Sync>),
    /// The thread that reads the sensor has ended.
    #[error("the thread of the odometry has ended")]
    ThreadEnded,
}
