//! What is published over ROS 1: bearings, poses that point to peers, and CSI.

#[cfg(feature = "ros1")]
pub(super) use publish::Ros;
#[cfg(not(feature = "ros1"))]
pub(super) use without::Ros;

#[cfg(feature = "ros1")]
mod publish;

#[cfg(not(feature = "ros1"))]
mod without {
    use crate::node::config::Config;
    use crate::node::estimator::Report;
    use crate::node::machine::Machine;
    use crate::node::sources::Sources;
    use crate::pose::Pose;

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
