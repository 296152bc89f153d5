//! The node: its link, its clock, and the topics of poses that it reads.

use super::bag::Bag;
use super::inputs::{PoseTopic, SimClock};
use super::link::Link;
use super::names::{Names, name_part};
use super::sockets::Sockets;
use crate::NodeError;
use crate::config::Config;
use crate::config::ros2::{Topic, robot};
use csi5300::motion::odometry::ros::Stamp;
use csi5300::source::Error;
use std::sync::{Mutex, PoisonError};

/// This program as a node of ROS 2.
pub(crate) struct Node {
    /// Its participant.
    pub link: Link,
    /// The time of its stamps.
    pub clock: SimClock,
    topics: Mutex<Vec<PoseTopic>>,
}

impl Node {
    /// The node that a configuration asks for.
    ///
    /// # Errors
    /// If it cannot take part at that address, or the recording cannot be started.
    pub fn start(config: &Config, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        let asked = config.ros2.clone().unwrap_or_default();
        let (domain, interface) = (asked.domain(), asked.interface);
        let failed = |source| NodeError::Ros2 { domain, interface, source };
        let sockets = Sockets::open(domain, interface, asked.multicast, asked.peers).map_err(failed)?;
        let node = asked.node.unwrap_or_else(|| format!("csi5300_{}", name_part(&robot(config))));
        let names = Names { namespace: asked.namespace, node, remap: asked.remap };
        let bag = Bag::new(asked.bag.clone().unwrap_or_default());
        if let Some(folder) = &asked.bag {
            let what = format!("cannot record to {}", folder.display());
            bag.start().map_err(|source| Error::Io { what, source })?;
        }
        let link = Link::start((names, asked.distribution), sockets, bag, wall_us).map_err(failed)?;
        let clock = if asked.use_sim_time { SimClock::follow(&link) } else { SimClock::real() };
        Ok(Self { link, clock, topics: Mutex::default() })
    }

    /// Poses of a topic, with the time that is usual unless the configuration says which.
    pub fn poses(&self, topic: &Topic, usual: Stamp) -> csi5300::motion::odometry::ros::Topic {
        let (opened, source) = PoseTopic::open(&self.link, topic, usual, &self.clock);
        self.topics.lock().unwrap_or_else(PoisonError::into_inner).push(opened);
        source
    }

    /// Looks at what is wrong with the topics.
    pub fn look(&self) {
        self.topics.lock().unwrap_or_else(PoisonError::into_inner).iter().for_each(PoseTopic::look);
    }

    /// What is wrong, in words.
    pub fn trouble(&self) -> Vec<String> {
        let clock = self.clock.is_unknown().then(|| "ROS 2: nothing comes on /clock (`use_sim_time`)".to_owned());
        self.link.trouble().into_iter().chain(clock).collect()
    }
}
