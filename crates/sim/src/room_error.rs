//! Why there is no room.

use super::refusal::SceneError;
use csi5300::exchange::tdma::PlanError;

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
    /// A robot has somebody to follow.
    #[error("robot `{robot}` follows a source already")]
    FollowsAlready {
        /// Its name.
        robot: String,
    },
    /// Somebody has a card of a room that is to be run whole.
    #[error("a card of this room was taken before; all are needed")]
    CardTaken,
    /// A card or an odometry of the room failed, or a file could not be written.
    #[error(transparent)]
    Source(#[from] csi5300::source::Error),
}

impl From<RoomError> for csi5300::source::Error {
    fn from(error: RoomError) -> Self {
        match error {
            RoomError::Source(error) => error,
            other => Self::Input(other.to_string()),
        }
    }
}
