//! The robots' network: this robot's records and poses out, its peers' in.

mod exposure;
mod network;
mod owners;
mod topics;

use super::{Adapter, Made, Robot, Start};
use crate::config::{Config, Odometry, Peer, Records};
use crate::health::Health;
use crate::machine::Machine;
use csi5300::source::Error;
use csi5300::source::remote::Mailbox;
use csi5300_ros2::rmw_zenoh::Relay;
use driver_iface::Mac;
use network::Network;
use owners::Owner;
use std::sync::Arc;
use tokio::sync::Notify;

/// The network, once joined, and each peer's queues by its number.
struct Zenoh {
    config: Config,
    wake: Arc<Notify>,
    /// The topics of ROS 2, if they go over the network too.
    topics: Option<Relay>,
    network: Option<Network>,
    records: Vec<(usize, Mailbox)>,
    poses: Vec<(usize, Mailbox)>,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let (config, wake) = (start.config, Arc::clone(&start.wake));
    let Some(network) = &config.network else { return Ok(None) };
    let topics = start.topics.get().filter(|_| network.ros2).cloned();
    let config = config.clone();
    Ok(Some(Box::new(Zenoh { config, wake, topics, network: None, records: Vec::new(), poses: Vec::new() })))
}

/// Why the network cannot be joined.
pub(super) fn refusal(config: &Config) -> Option<String> {
    let network = config.network.as_ref().filter(|network| network.zenoh.as_ref().is_none_or(|file| file.is_file()))?;
    let peers = config.peer.iter().map(|peer| peer.get_ref());
    let owners: Vec<Owner> = peers.filter_map(|peer| Some(owner(peer, peer.mac?))).collect();
    network::refusal(network, &owners)
}

fn owner(peer: &Peer, mac: Mac) -> Owner {
    Owner { mac, certificate: peer.certificate.clone() }
}

impl Adapter for Zenoh {
    fn meet(&mut self, robot: &Robot) -> Result<(), Error> {
        let Some(asked) = &self.config.network else { return Ok(()) };
        let peers = || self.config.peer.iter().map(|peer| peer.get_ref()).zip(&robot.peers);
        let owners: Vec<Owner> = peers().map(|(peer, (_, mac))| owner(peer, *mac)).collect();
        let graph = self.topics.as_ref().map(Relay::take);
        let network = self.network.insert(Network::join(asked, robot.own, &owners, graph)?);
        for (k, (peer, (_, mac))) in peers().enumerate() {
            let waker = || {
                let wake = Arc::clone(&self.wake);
                move || wake.notify_one()
            };
            if matches!(peer.records, Records::Network(_)) {
                self.records.push((k, network.subscribe(*mac, "records", waker())?));
            }
            if matches!(peer.poses, Odometry::Network(_)) {
                self.poses.push((k, network.subscribe(*mac, "poses", waker())?));
            }
        }
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        self.records.iter().for_each(|(peer, mailbox)| machine.set_records(*peer, Box::new(mailbox.card())));
        self.poses.iter().for_each(|(peer, mailbox)| machine.set_poses(*peer, Box::new(mailbox.poses())));
        if let Some(tap) = self.network.as_ref().and_then(Network::tap) {
            machine.add_tap(tap);
        }
        Ok(())
    }

    fn look(&mut self, health: &mut Health) {
        let Some(network) = &self.network else { return };
        health.network = serde_json::to_value(network.counts()).ok();
        let contested = network.contested().filter(|(_, count)| *count > 0);
        health.trouble.extend(contested.map(|(mac, count)| {
            format!("network: {count} messages of a second sender under the address {mac} were refused")
        }));
    }
}
