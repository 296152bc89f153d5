//! No network: a configuration that asks for one was refused.

use crate::config::Config;
use crate::machine::Machine;
use crate::sources::Sources;
use csi5300::source::Error;
use tokio::sync::Notify;

#[derive(Default)]
pub struct Joined {
    wake: Notify,
}

impl Joined {
    pub fn join(_: &Config, _: &Sources) -> Result<Self, Error> {
        Ok(Self::default())
    }

    pub fn attach(&self, _: &mut Machine) {}

    /// Never notified.
    pub fn wake(&self) -> &Notify {
        &self.wake
    }

    /// Nothing is.
    pub fn trouble(&self) -> Vec<String> {
        Vec::new()
    }

    pub fn counts(&self) -> Option<serde_json::Value> {
        None
    }
}
