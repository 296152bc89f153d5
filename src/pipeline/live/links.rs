//! Every peer's pairs at one moment, and bearings of them.

use crate::motion::pose::Trajectory;
use crate::pipeline::{Bearing, Link, LinkError, LinkJoin, Options, estimate};
use driver_iface::Mac;

/// The links of a [`LiveEstimator`](super::LiveEstimator) as they were at one moment: a copy, for bearings in another
/// thread while records arrive.
#[derive(Clone, Debug)]
pub struct Links {
    pub(super) links: Vec<Link>,
    pub(super) options: Options,
}

impl Links {
    /// For every peer with pairs: its MAC, the number of pairs, and the bearing from all kept pairs and `trajectory` in
    /// place of the received poses, like a bearing from logs. Peers stand still. There is no window and no schedule.
    ///
    /// Each is an error by itself: see [`LinkError`].
    #[must_use]
    pub fn bearings(&self, trajectory: &Trajectory) -> Vec<(Mac, usize, Result<Bearing, LinkError>)> {
        let join = |link| LinkJoin { link, receiver: trajectory, transmitter: None };
        let made = estimate(&self.links.iter().map(join).collect::<Vec<_>>(), &self.options);
        let made = self.links.iter().zip(made).filter(|(link, _)| link.pairs() > 0);
        made.map(|(link, bearing)| (link.mac, link.pairs(), bearing)).collect()
    }
}
