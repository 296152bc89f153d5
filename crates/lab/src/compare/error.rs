//! Why captures cannot be compared.

use csi5300_sim::{RoomError, SceneError};

/// Why a capture cannot be measured, or a scene cannot be fitted to it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
    /// There is no transmitter's log.
    #[error("no transmitter's log")]
    NoTransmitter,
    /// The two logs have no common frames.
    #[error("{reason}")]
    NoLink {
        /// Why.
        reason: String,
    },
    /// Too few pairs for the figures of a link.
    #[error("{pairs} pairs are too few to measure a link")]
    FewPairs {
        /// Number of pairs.
        pairs: usize,
    },
    /// A scene cannot be simulated.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// A scene is too short for a trajectory.
    #[error("a scene of {duration_s} s is too short for two poses")]
    Short {
        /// Its length, seconds.
        duration_s: f64,
    },
    /// A scene has no second robot.
    #[error("a scene of one robot has no link to measure")]
    OneRobot,
    /// The records have another bandwidth than the channel.
    #[error(
        "the records are {recorded_mhz} MHz wide, channel {channel} is not: add + or - to the number of a 40 MHz channel"
    )]
    Width {
        /// Bandwidth of the records, MHz.
        recorded_mhz: u16,
        /// The expected channel.
        channel: csi5300::signal::channel::Channel,
    },
    /// A recording without motion does not show where the transmitter is.
    #[error("the transmitter's place is not known, and without motion it cannot be found")]
    NoPlace,
    /// The fitted text is not a valid scene.
    #[error("the fitted scene: {source}\n{toml}")]
    Fitted {
        /// Its text.
        toml: String,
        /// Its error.
        source: SceneError,
    },
}
