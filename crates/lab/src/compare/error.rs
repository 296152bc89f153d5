//! Why captures cannot be compared.

use csi5300_sim::{RoomError, SceneError};

/// Why a capture cannot be measured, or no scene fitted to it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
    /// There is no transmitter's log.
    #[error("no transmitter's log")]
    NoTransmitter,
    /// The two logs give no pairs.
    #[error("{reason}")]
    NoLink {
        /// Why.
        reason: String,
    },
    /// Too few pairs for figures of a link.
    #[error("{pairs} pairs are too few to measure a link")]
    FewPairs {
        /// Pairs there are.
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
    /// The records are of another bandwidth than the channel.
    #[error(
        "the records are of {recorded_mhz} MHz, the channel {channel} is not: 40 MHz have + or - behind the number"
    )]
    Width {
        /// Bandwidth of the records, MHz.
        recorded_mhz: u16,
        /// The channel that the records are to be of.
        channel: csi5300::signal::channel::Channel,
    },
    /// A recording without motion does not say where the transmitter is.
    #[error("the transmitter's place is not known, and without motion it cannot be found")]
    NoPlace,
    /// What was fitted is no scene.
    #[error("the fitted scene: {source}\n{toml}")]
    Fitted {
        /// Its text.
        toml: String,
        /// What is wrong with it.
        source: SceneError,
    },
}
