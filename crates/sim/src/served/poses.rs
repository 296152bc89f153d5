//! A robot's odometry in a served room.

use super::{Address, Role, join, take};
use csi5300::motion::odometry::{NextPose, OdometryError, OdometrySource, csv};
use csi5300::source::Error;
use csi5300::time::Instant;
use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// Longest line of a pose, bytes.
const LINE: usize = 512;

/// Poses of a robot in a served room. Never blocks; wait on its file descriptor.
#[derive(Debug)]
pub struct Poses {
    socket: OwnedFd,
    ended: bool,
}

impl Poses {
    /// Joins the room.
    ///
    /// # Errors
    /// No room there, or no such robot in it.
    pub fn join(address: &Address) -> Result<Self, Error> {
        Ok(Self { socket: join(address, Role::Poses)?.0, ended: false })
    }
}

impl OdometrySource for Poses {
    fn receive(&mut self, _: Instant) -> Result<NextPose, OdometryError> {
        let mut line = [0; LINE];
        while !self.ended {
            match take(&self.socket, &mut line) {
                Ok(0) => self.ended = true,
                Ok(len) => {
                    let line = line.get(..len).unwrap_or_default();
                    let what = "a pose of a room";
                    let pose = csv::parse_line(line).map_err(|source| OdometryError::Row { what, source })?;
                    return Ok(NextPose::Pose(pose));
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(NextPose::Pending),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(source) => return Err(OdometryError::Io { what: "receiving poses from a room", source }),
            }
        }
        Ok(NextPose::End)
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl AsFd for Poses {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}
