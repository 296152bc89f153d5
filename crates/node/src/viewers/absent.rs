//! Nobody looks: a configuration that asks for viewers was refused.

use crate::config::Config;
use crate::machine::Machine;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::Error;

pub struct Viewers;

impl Viewers {
    pub fn open(_: &Config, _: &str) -> Result<Self, Error> {
        Ok(Self)
    }

    pub fn attach(&self, _: &mut Machine) {}

    pub fn report(&self, _: &Machine, _: usize, _: &PeerReport) {}

    pub fn look(&self, _: &Machine) {}

    pub fn stop(self) {}
}
