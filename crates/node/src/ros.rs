//! What is published over ROS 1: bearings, poses that point to peers, and CSI.

#[cfg(feature = "ros1")]
pub(super) use publish::Ros;
#[cfg(not(feature = "ros1"))]
pub(super) use without::Ros;

#[cfg(feature = "ros1")]
mod publish;

#[cfg(not(feature = "ros1"))]
mod without {
    use crate::config::Config;
    use crate::estimator::Report;
    use crate::machine::Machine;
    use crate::sources::Sources;
    use csi5300::motion::pose::Pose;

    /// No node of ROS: a configuration that asks for one was refused.
    pub struct Ros;

    impl Ros {
        pub fn open(_: &Config, _: &mut Sources) -> Self {
            Self
        }

        #[allow(clippy::unused_self)]
        pub fn attach(&self, _: &mut Machine) {}

        pub fn report(&mut self, _: usize, _: &Report, _: Option<&Pose>) {}

        pub fn counts(&self) -> Option<serde_json::Value> {
            None
        }

        pub fn trouble(&self) -> Option<String> {
            None
        }
    }
}
