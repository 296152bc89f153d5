//! A robot of a served room: its address, and why it cannot be joined.

use csi5300::source::Error;
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::str::FromStr;

/// A robot of a served room: `PATH#ROBOT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot's name in the scene.
    pub robot: String,
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        match text.rsplit_once('#') {
            Some((path, robot)) if !path.is_empty() && !robot.is_empty() => {
                Ok(Self { socket: path.into(), robot: robot.into() })
            }
            _ => Err(AddressError),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of the room at {}", self.robot, self.socket.display())
    }
}

/// A text that is no [`Address`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a robot of a served room is PATH#ROBOT, such as /tmp/room#rx")]
pub struct AddressError;

/// Why a robot of a room cannot be joined; inside [`csi5300::source::Error::Backend`] where a source is asked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JoinError {
    /// Nothing listens there, or it left.
    #[error("cannot reach {address}: {source}")]
    NoRoom {
        /// Who was asked for.
        address: Address,
        /// The operating system's reason.
        source: io::Error,
    },
    /// The room has no such robot, or another program has its air.
    #[error("{address}: {why}")]
    Refused {
        /// Who was asked for.
        address: Address,
        /// The room's words.
        why: String,
    },
    /// Another protocol.
    #[error("{address}: the answer of {len} bytes is not that of a room")]
    Answer {
        /// Who was asked for.
        address: Address,
        /// Length of the answer.
        len: usize,
    },
}

impl From<JoinError> for Error {
    fn from(error: JoinError) -> Self {
        Self::Backend(Box::new(error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_of_a_room_is_its_socket_and_its_name() {
        let address: Address = "/tmp/a#b/room#rx".parse().unwrap();
        assert_eq!(address, Address { socket: "/tmp/a#b/room".into(), robot: "rx".into() });
        assert_eq!(address.to_string(), "rx of the room at /tmp/a#b/room");
        for wrong in ["", "#", "/tmp/room", "/tmp/room#", "#rx"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }
}
