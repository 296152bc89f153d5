//! The file with the truth of a capture, and why a capture could not be evaluated.

use super::find::TRUTH_FILE;
use csi5300::motion::odometry::csv::CsvError;
use csi5300::signal::channel::ChannelError;
use nalgebra::Vector2;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a capture could not be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// A file could not be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// The file with the truth is not what it should be.
    #[error("{}: {source}", path.display())]
    Truth {
        /// The file.
        path: PathBuf,
        /// Where it is wrong, and how.
        source: serde_json::Error,
    },
    /// The file with the truth names a channel that is none.
    #[error("{TRUTH_FILE}: {0}")]
    Channel(#[from] ChannelError),
    /// Neither the file with the truth nor the caller names a channel.
    #[error("the WiFi channel is not known: no {TRUTH_FILE} names it (--channel does)")]
    NoChannel,
    /// A receiver's log stands alone.
    #[error("no csi_txK_{stamp}.dat beside csi_rx_{stamp}.dat")]
    NoTransmitter {
        /// Time stamp in the file names.
        stamp: String,
    },
    /// The trajectory cannot be read.
    #[error("{}", trajectory_text(path, source))]
    Trajectory {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CsvError,
    },
    /// A part of the motion has too few poses, or the place of the antenna is given and the trajectory has no heading.
    #[error(transparent)]
    Part(#[from] csi5300::motion::pose::TrajectoryError),
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
}

/// The file's name once: an operating system's error has it already.
fn trajectory_text(path: &Path, source: &CsvError) -> String {
    match source {
        CsvError::Io { .. } => source.to_string(),
        _ => format!("{}: {source}", path.display()),
    }
}

#[derive(Default, Deserialize)]
pub(super) struct Truth {
    channel: Option<Value<u32>>,
    true_tx_positions: Option<Value<BTreeMap<String, TruePose>>>,
}

#[derive(Deserialize)]
struct Value<T> {
    value: T,
}

#[derive(Deserialize)]
struct TruePose {
    position: Xy,
}

#[derive(Clone, Copy, Deserialize)]
struct Xy {
    x: f64,
    y: f64,
}

impl Truth {
    /// Reads the file of the capture in `folder`.
    pub(super) fn read(folder: &Path) -> Result<Self, EvaluateError> {
        let path = folder.join(TRUTH_FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) => return Err(EvaluateError::Io { path, source }),
        };
        serde_json::from_str(&text).map_err(|source| EvaluateError::Truth { path, source })
    }

    /// The channel's number, if the file names one.
    pub(super) fn channel(&self) -> Option<u32> {
        self.channel.as_ref().map(|channel| channel.value)
    }

    /// Where a transmitter (`tx2`) is, metres.
    pub(super) fn place(&self, transmitter: &str) -> Option<Vector2<f64>> {
        let pose = self.true_tx_positions.as_ref()?.value.get(transmitter)?;
        Some(Vector2::new(pose.position.x, pose.position.y))
    }
}
