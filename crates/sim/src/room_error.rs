//! Why there is no room, and why a card of one fails.

use super::refusal::SceneError;
use csi5300::exchange::tdma::PlanError;
use driver_iface::EmitError;

/// Why a room could not be built or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RoomError {
    /// The scene was refused.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene's sounding does not fit.
    #[error(transparent)]
    Sounding(#[from] PlanError),
    /// A robot cannot follow poses.
    #[error("robot `{robot}` follows no poses: its motion in the scene is not `followed`")]
    NotFollowed {
        /// Its name.
        robot: String,
    },
    /// A robot of a data set follows poses that only a running node has.
    #[error(
        "robot `{robot}` goes where an odometry source says while a node runs: `csi5300 node`, with `follow` in `capture.room`"
    )]
    Followed {
        /// Its name.
        robot: String,
    },
    /// A robot follows a source already.
    #[error("robot `{robot}` follows a source already")]
    FollowsAlready {
        /// Its name.
        robot: String,
    },
    /// A card of a room that is to be run as a whole is taken.
    #[error("a card of this room was taken before; all are needed")]
    CardTaken,
    /// A run was stopped before the room's end.
    #[error("the run was stopped {at_s:.3} s into the scene")]
    Stopped {
        /// Time of the scene, seconds.
        at_s: f64,
    },
    /// A card or an odometry of the room failed, or a file could not be written.
    #[error(transparent)]
    Source(#[from] csi5300::source::Error),
}

/// Why a card of a room gave no record or took no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CardError {
    /// The body of a simulated record cannot be written.
    #[error("cannot write a simulated record: {0}")]
    Body(#[source] EmitError),
    /// A simulated record fits no frame of a log.
    #[error("cannot frame a simulated record: {0}")]
    Frame(#[source] EmitError),
    /// A frame is longer or shorter than cards send.
    #[error("a frame of {len} bytes was not sent: {least} to {most} are possible")]
    FrameLength {
        /// Its bytes.
        len: usize,
        /// Bytes of the shortest, a MAC header.
        least: usize,
        /// Bytes of the longest.
        most: usize,
    },
    /// A modulation and coding scheme of more than one stream.
    #[error("MCS {mcs}: cards in a room send one stream, MCS 0 to 7")]
    Mcs {
        /// The scheme.
        mcs: u8,
    },
}

impl From<CardError> for csi5300::source::Error {
    fn from(error: CardError) -> Self {
        Self::Backend(Box::new(error))
    }
}

impl From<RoomError> for csi5300::source::Error {
    fn from(error: RoomError) -> Self {
        match error {
            RoomError::Source(error) => error,
            other => Self::Backend(Box::new(other)),
        }
    }
}
