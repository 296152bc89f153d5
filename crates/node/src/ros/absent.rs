//! No node of ROS: a configuration that asks for one was refused.

use crate::config::Config;
use crate::machine::Machine;
use crate::sources::{RosNode, Sources};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;

pub struct Ros;

impl Ros {
    pub fn open(_: &Config, sources: &mut Sources) -> Self {
        let RosNode = sources.ros;
        Self
    }

    pub fn attach(&self, _: &mut Machine) {}

    pub fn report(&mut self, _: usize, _: &PeerReport, _: Option<&Pose>) {}

    pub fn counts(&self) -> Option<serde_json::Value> {
        None
    }

    pub fn trouble(&self) -> Option<String> {
        None
    }
}
