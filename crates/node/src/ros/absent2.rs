//! No node of ROS 2: a configuration that asks for one was refused.

use crate::config::Config;
use crate::health::Health;
use crate::machine::Machine;
use crate::sources::{Ros2Node, Sources};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;

pub struct Ros2;

impl Ros2 {
    pub fn open(_: &Config, sources: &mut Sources) -> Self {
        let Ros2Node = sources.ros2;
        Self
    }

    pub fn attach(&self, _: &mut Machine) {}

    pub fn report(&mut self, _: usize, _: &PeerReport, _: Option<&Pose>) {}

    pub fn look(&mut self, _: &Health, _: Option<i64>) {}

    pub fn counts(&self) -> Option<serde_json::Value> {
        None
    }

    pub fn trouble(&self) -> Vec<String> {
        Vec::new()
    }
}
