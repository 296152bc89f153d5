//! What is published over ROS: over ROS 1 (feature `ros1`) bearings, poses that point to peers, and CSI; over ROS 2 (feature
//! `ros2`) these, markers, diagnostics and transforms.

#[cfg(not(feature = "ros1"))]
#[path = "ros/absent.rs"]
mod publish;
#[cfg(feature = "ros1")]
mod publish;

#[cfg(any(feature = "ros1", feature = "ros2"))]
pub(crate) mod said;

#[cfg(not(feature = "ros2"))]
#[path = "ros/absent2.rs"]
mod second;
#[cfg(feature = "ros2")]
use crate::ros2 as second;

use crate::config::Config;
use crate::health::Health;
use crate::machine::Machine;
use crate::sources::Sources;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;
use publish::Ros as Ros1;
use second::Ros2;

/// This program as a node of ROS 1 and of ROS 2, as far as it is one.
pub(super) struct Ros {
    one: Ros1,
    two: Ros2,
}

impl Ros {
    /// Takes the nodes of `sources`, and announces what they publish.
    pub fn open(config: &Config, sources: &mut Sources) -> Self {
        Self { one: Ros1::open(config, sources), two: Ros2::open(config, sources) }
    }

    /// From now on the machine's records are published, if that was asked for.
    pub fn attach(&self, machine: &mut Machine) {
        self.one.attach(machine);
        self.two.attach(machine);
    }

    /// Publishes what is said of peer number `peer`; `own` is where this robot's antenna is.
    pub fn report(&mut self, peer: usize, report: &PeerReport, own: Option<&Pose>) {
        self.one.report(peer, report, own);
        self.two.report(peer, report, own);
    }

    /// Adds to the state what was counted and what is wrong, and publishes it.
    pub fn look(&mut self, health: &mut Health, wall_us: Option<i64>) {
        health.ros = self.one.counts();
        health.trouble.extend(self.one.trouble());
        health.ros2 = self.two.counts();
        health.trouble.extend(self.two.trouble());
        self.two.look(health, wall_us);
    }
}
