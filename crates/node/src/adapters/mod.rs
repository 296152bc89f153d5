//! The protocols of a node, behind one trait: poses in; records, bearings and the state out; services.
//!
//! | module | what it is |
//! |---|---|
//! | `json` | bearings as lines of JSON |
//! | `status` | the state on a Unix socket, and as one line on a terminal |
//! | `ros2` | ROS 2, with the team's topics |
//! | `ros1` | ROS 1, through a bridge in Python |
//! | `zenoh` | the robots' network (feature `zenoh`) |
//! | `foxglove` | Foxglove's viewers over a websocket (feature `foxglove`) |

#[cfg(feature = "foxglove")]
mod foxglove;
mod json;
mod ros1;
mod ros2;
mod status;
#[cfg(feature = "zenoh")]
pub(crate) mod zenoh;

use crate::config::{Config, Odometry};
use crate::health::Health;
use crate::machine::Machine;
use crate::sources::Poses;
use crate::team::Ranges;
use csi5300::motion::odometry::SourceCounts;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::pipeline::Bearing;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::Error;
use csi5300_ros2::rmw_zenoh::Relay;
use driver_iface::Mac;
use std::cell::OnceCell;
use std::sync::Arc;
use tokio::sync::Notify;

/// Descriptors that stay free for the log, its next file and what the service opens.
const RESERVED: u64 = 32;

/// A protocol of a node. It is made before any source is opened and dropped after the machine has ended, both outside
/// of tokio; it waits on its own threads, or in a task that [`Adapter::attach`] spawns. No method may wait: data that
/// cannot be handed over at once are lost and counted.
///
/// The methods are called in this order.
pub trait Adapter {
    /// The poses that `odometry` names, if they are this adapter's; `usual` is their default time stamp.
    fn poses(&mut self, _odometry: &Odometry, _usual: Stamp) -> Option<Poses> {
        None
    }

    /// This robot and its peers are known, so outputs can be announced. No log has been started.
    ///
    /// # Errors
    /// If it cannot go on.
    fn meet(&mut self, _robot: &Robot) -> Result<(), Error> {
        Ok(())
    }

    /// Connects peers' data to the machine, and receivers of its records and poses. Called inside tokio.
    ///
    /// # Errors
    /// If it cannot go on.
    fn attach(&mut self, _machine: &mut Machine) -> Result<(), Error> {
        Ok(())
    }

    /// Publishes a report about a peer.
    fn report(&mut self, _said: &Said<'_>) {}

    /// Adds counts and problems to the state.
    fn look(&mut self, _health: &mut Health) {}

    /// Publishes the complete state.
    fn tell(&mut self, _health: &Health, _machine: &Machine) {}

    /// Ends after the last report of each peer, and adds losses to the state.
    fn finish(&mut self, _health: &mut Health) {}
}

/// What an adapter is made of.
pub struct Start<'a> {
    /// The configuration.
    pub config: &'a Config,
    /// This robot's name.
    pub name: &'a str,
    /// Notified when a thread has input for the machine.
    pub wake: Arc<Notify>,
    /// Ranges of another sensor go here.
    pub ranges: Ranges,
    /// The topics of ROS 2, for other adapters: they are complete after `meet` of `ros2`.
    pub topics: OnceCell<Relay>,
}

/// This robot and its peers, in the order of the configuration.
#[derive(Clone)]
pub struct Robot {
    /// Its name.
    pub name: String,
    /// Its MAC.
    pub own: Mac,
    /// Name and MAC of each peer.
    pub peers: Vec<(String, Mac)>,
}

/// A report about a peer.
pub struct Said<'a> {
    /// Its number.
    pub peer: usize,
    /// The report.
    pub report: &'a PeerReport,
    /// The bearing in it, in full.
    pub bearing: Option<&'a Bearing>,
    /// How long the estimate took, milliseconds; none of the last report.
    pub took_ms: Option<f64>,
    /// How long ago the last record in it was taken, milliseconds.
    pub latency_ms: Option<f64>,
}

type Made = Result<Option<Box<dyn Adapter>>, Error>;
type Make = fn(&Start<'_>) -> Made;

/// The adapters of this program: their names, and how each is made if the configuration requests it. `zenoh` carries the topics of
/// `ros2`, which is before it.
const BUILT: &[(&str, Make)] = &[
    ("ros2", ros2::make),
    ("ros1", ros1::make),
    #[cfg(feature = "zenoh")]
    ("zenoh", zenoh::make),
    #[cfg(feature = "foxglove")]
    ("foxglove", foxglove::make),
    ("json", json::make),
    ("status", status::make),
];

/// Makes all adapters that the configuration requests.
///
/// # Errors
/// Those of each.
pub fn make(start: &Start<'_>) -> Result<Vec<Box<dyn Adapter>>, Error> {
    BUILT.iter().filter_map(|(_, make)| make(start).transpose()).collect()
}

/// The feature that the adapter `name` needs, if this program lacks it.
pub(crate) fn missing(name: &str) -> Option<String> {
    let is_here = BUILT.iter().any(|(built, _)| *built == name);
    (!is_here).then(|| format!("needs a program built with `--features {name}`"))
}

/// What is wrong where this robot's poses are in another frame than the one that a table of ROS names.
fn mislabelled(health: &Health, table: Option<(&str, &String)>) -> Option<String> {
    let (Some((table, said)), Some(SourceCounts::Topic(counts))) = (table, &health.odometry) else { return None };
    let frame = Some(counts.frame.as_str()).filter(|frame| !frame.is_empty() && frame != said)?;
    Some(format!(
        "[{table}]: what is published is labelled `{said}`, but the poses are in `{frame}`: frame = \"{frame}\""
    ))
}

/// False if viewers would take descriptors that the log needs.
fn are_descriptors_to_spare() -> bool {
    let limit =
        nix::sys::resource::getrlimit(nix::sys::resource::Resource::RLIMIT_NOFILE).map_or(u64::MAX, |(soft, _)| soft);
    // The listing itself uses a descriptor.
    let used = std::fs::read_dir("/proc/self/fd").map_or(u64::MAX, |listing| listing.count() as u64);
    used.saturating_add(RESERVED) < limit
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::odometry::ros::TopicCounts;

    #[test]
    fn bearings_labelled_with_another_frame_than_the_poses_are_said() {
        let health = |frame: &str| {
            let counts = TopicCounts { frame: frame.into(), ..TopicCounts::default() };
            Health { odometry: Some(SourceCounts::Topic(counts)), ..Health::default() }
        };
        let said = |frame| mislabelled(&health(frame), Some(("ros2", &"odom".to_owned())));
        assert_eq!([said(""), said("odom"), mislabelled(&health("world"), None)], [None, None, None]);
        assert!(said("world").unwrap().ends_with("labelled `odom`, but the poses are in `world`: frame = \"world\""));
    }
}
