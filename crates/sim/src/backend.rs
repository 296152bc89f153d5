//! All that a robot has: its card and its odometry.

use super::odometer::Odometer;
use super::port::Port;
use super::room::Room;

/// One robot's backend, as a real robot has it.
#[derive(Debug)]
pub struct Backend {
    /// Its card: [`csi5300::source::CsiSource`] and [`csi5300::source::Injector`].
    pub card: Port,
    /// Its odometry: [`csi5300::motion::odometry::OdometrySource`].
    pub odometry: Odometer,
}

impl Room {
    /// A robot's backend. Each is handed out once; `None` if its card was taken, or without such a robot.
    pub fn backend(&mut self, robot: usize) -> Option<Backend> {
        let odometry = self.odometry(robot)?;
        Some(Backend { card: self.card(robot)?, odometry })
    }
}
