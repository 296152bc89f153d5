//! Robots of a simulated room that another program runs.

use super::{Card, Opened, Poses};
use crate::config::Served;
use crate::threads::CardThread;
use csi5300::source::Error;
use csi5300_live::netlink::Netlink;
use csi5300_sim::served::{self, Address, Role};
use driver_iface::Mac;
use std::path::Path;

/// This robot's card.
pub(super) fn open(asked: &Served, wall_us: fn() -> Option<i64>) -> Result<Opened, Error> {
    let (card, mac) = join(&asked.socket, &asked.robot, wall_us)?;
    Ok(Opened { wake: Some(card.wake()?), card: Box::new(card), mac: Some(mac), speed: 1.0 })
}

/// A peer's card, and its MAC.
pub(super) fn peer(socket: &Path, robot: &str, wall_us: fn() -> Option<i64>) -> Result<(Card, Mac), Error> {
    let (card, mac) = join(socket, robot, wall_us)?;
    Ok((Box::new(card), mac))
}

/// A robot's odometry.
pub(super) fn poses(socket: &Path, robot: &str) -> Result<Poses, Error> {
    Ok(Box::new(served::Poses::join(&address(socket, robot))?))
}

fn join(socket: &Path, robot: &str, wall_us: fn() -> Option<i64>) -> Result<(CardThread, Mac), Error> {
    let (room, mac) = served::join(&address(socket, robot), Role::Card)?;
    Ok((CardThread::start(Netlink::over(room, wall_us))?, mac))
}

fn address(socket: &Path, robot: &str) -> Address {
    Address { socket: socket.to_owned(), robot: robot.to_owned() }
}
