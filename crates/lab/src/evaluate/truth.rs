//! A capture's truth file, and why a capture could not be evaluated.

use super::find::{Capture, TRUTH_FILE};
use csi5300::motion::odometry::csv::CsvError;
use csi5300::signal::channel::ChannelError;
use nalgebra::Vector2;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest truth file, bytes: a line for each of ten thousand transmitters.
const LONGEST: u64 = 1 << 20;
/// Largest distance of a transmitter from the origin, metres.
const FURTHEST_M: f64 = 1e6;

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
    /// The truth file is invalid.
    #[error("{}: {source}", path.display())]
    Truth {
        /// The file.
        path: PathBuf,
        /// Position and kind of the error.
        source: serde_json::Error,
    },
    /// The truth file is too long.
    #[error("{}: {bytes} bytes; a truth file has at most {LONGEST}", path.display())]
    Long {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The truth file has a transmitter at an impossible place.
    #[error("{}: {transmitter} is further than 1e6 m from the origin", path.display())]
    Far {
        /// The file.
        path: PathBuf,
        /// The transmitter.
        transmitter: String,
    },
    /// The truth file names an invalid channel.
    #[error("{TRUTH_FILE}: {0}")]
    Channel(#[from] ChannelError),
    /// Neither the truth file nor the caller names a channel.
    #[error("unknown WiFi channel: no {TRUTH_FILE} names it; use --channel")]
    NoChannel,
    /// A receiver's log has no transmitter's log beside it.
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
    /// A part of the motion has too few poses, or the antenna's position is given but the trajectory has no heading.
    #[error(transparent)]
    Part(#[from] csi5300::motion::pose::TrajectoryError),
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
}

/// Avoids repeating the file's name, which an operating system's error already contains.
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

/// The whole file; one longer than [`LONGEST`] is not read to its end.
fn read(path: &Path) -> Result<Vec<u8>, EvaluateError> {
    let io = |source| EvaluateError::Io { path: path.to_owned(), source };
    let file = File::open(path).map_err(io)?;
    let (size, mut text) = (file.metadata().map_err(io)?.len(), Vec::new());
    let got = file.take(LONGEST + 1).read_to_end(&mut text).map_err(io)? as u64;
    // A pipe has no size.
    match got > LONGEST {
        true => Err(EvaluateError::Long { path: path.to_owned(), bytes: size.max(got) }),
        false => Ok(text),
    }
}

impl Capture {
    /// The channel number in the truth file, if both exist.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn channel_number(&self) -> Result<Option<u32>, EvaluateError> {
        if self.has_truth() { Ok(Truth::read(&self.folder)?.channel()) } else { Ok(None) }
    }
}

/// The channel number in the truth file of a folder, if it has one that names a channel.
///
/// # Errors
/// If the file cannot be read.
pub fn channel_number_in(folder: &Path) -> Result<Option<u32>, EvaluateError> {
    if folder.join(TRUTH_FILE).is_file() { Ok(Truth::read(folder)?.channel()) } else { Ok(None) }
}

impl Truth {
    /// Reads the truth file of the capture in `folder`.
    pub(super) fn read(folder: &Path) -> Result<Self, EvaluateError> {
        let path = folder.join(TRUTH_FILE);
        let text = read(&path)?;
        let truth: Self =
            serde_json::from_slice(&text).map_err(|source| EvaluateError::Truth { path: path.clone(), source })?;
        match truth.far() {
            Some(transmitter) => Err(EvaluateError::Far { transmitter: transmitter.to_owned(), path }),
            None => Ok(truth),
        }
    }

    /// A transmitter beyond the reach of any card.
    fn far(&self) -> Option<&str> {
        let all = self.true_tx_positions.iter().flat_map(|places| &places.value);
        let is_far = |at: &Xy| !(at.x.abs() <= FURTHEST_M && at.y.abs() <= FURTHEST_M);
        all.into_iter().find(|(_, pose)| is_far(&pose.position)).map(|(name, _)| name.as_str())
    }

    /// The channel's number, if the file names one.
    pub(super) fn channel(&self) -> Option<u32> {
        self.channel.as_ref().map(|channel| channel.value)
    }

    /// The place of a transmitter (`tx2`), metres.
    pub(super) fn place(&self, transmitter: &str) -> Option<Vector2<f64>> {
        let pose = self.true_tx_positions.as_ref()?.value.get(transmitter)?;
        Some(Vector2::new(pose.position.x, pose.position.y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_truth_file_is_refused() {
        let folder = std::env::temp_dir().join(format!("csi5300-truth-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let read = |text: &str| {
            std::fs::write(folder.join(TRUTH_FILE), text).unwrap();
            Truth::read(&folder).map(|truth| truth.place("tx1")).map_err(|error| error.to_string())
        };
        let at = |x: &str| {
            read(&r#"{"true_tx_positions": {"value": {"tx1": {"position": {"x": X, "y": 2}}}}}"#.replace('X', x))
        };
        assert_eq!(at("1e6").unwrap(), Some(Vector2::new(1e6, 2.0)));
        assert!(at("-1.1e6").unwrap_err().contains("tx1 is further"));
        assert!(at("1e308").is_err() && at("1e999").is_err());
        // Its first MiB is a valid truth file by itself.
        let long = |bytes: u64| format!("{{}}{}", " ".repeat(bytes as usize - 2));
        let error = read(&long(LONGEST + 1)).unwrap_err();
        assert!(error.contains("1048577 bytes; a truth file has at most 1048576"), "{error}");
        assert!(read(&long(LONGEST)).is_ok() && read("{}").is_ok());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
