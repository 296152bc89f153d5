//! What comes from the network to the machine, and the other way.

use crate::config::{Config, Odometry, Peer, Records};
use crate::machine::Machine;
use crate::network::Network;
use crate::owners::Owner;
use crate::sources::{PeerSources, Sources};
use csi5300::source::Error;
use csi5300::source::remote::Mailbox;
use std::sync::Arc;
use tokio::sync::Notify;

/// The network, if the configuration has one, and what waits of each peer by its number.
#[derive(Default)]
pub struct Joined {
    wake: Arc<Notify>,
    network: Option<Network>,
    records: Vec<(usize, Mailbox)>,
    poses: Vec<(usize, Mailbox)>,
}

impl Joined {
    pub fn join(config: &Config, sources: &Sources) -> Result<Self, Error> {
        let mut joined = Self::default();
        let Some(asked) = &config.network else { return Ok(joined) };
        let peers = || config.peer.iter().map(|peer| peer.get_ref()).zip(&sources.peers);
        let owner = |(peer, opened): (&Peer, &PeerSources)| Owner {
            mac: opened.peer.mac,
            certificate: peer.certificate.clone(),
        };
        let owners: Vec<Owner> = peers().map(owner).collect();
        let network = joined.network.insert(Network::join(asked, sources.own, &owners)?);
        for (k, (peer, opened)) in peers().enumerate() {
            let waker = || {
                let wake = Arc::clone(&joined.wake);
                move || wake.notify_one()
            };
            if matches!(peer.records, Records::Network(_)) {
                joined.records.push((k, network.subscribe(opened.peer.mac, "records", waker())?));
            }
            if matches!(peer.poses, Odometry::Network(_)) {
                joined.poses.push((k, network.subscribe(opened.peer.mac, "poses", waker())?));
            }
        }
        Ok(joined)
    }

    pub fn attach(&self, machine: &mut Machine) {
        self.records.iter().for_each(|(peer, mailbox)| machine.set_records(*peer, Box::new(mailbox.card())));
        self.poses.iter().for_each(|(peer, mailbox)| machine.set_poses(*peer, Box::new(mailbox.poses())));
        if let Some(tap) = self.network.as_ref().and_then(Network::tap) {
            machine.add_tap(tap);
        }
    }

    /// What is wrong, in words.
    pub fn trouble(&self) -> Vec<String> {
        let contested = self.network.iter().flat_map(Network::contested).filter(|(_, count)| *count > 0);
        let words = |(mac, count): (&str, u64)| {
            format!("network: {count} messages of a second sender under the address {mac} were refused")
        };
        contested.map(words).collect()
    }

    /// Notified when something came from a peer.
    pub fn wake(&self) -> &Notify {
        &self.wake
    }

    pub fn counts(&self) -> Option<serde_json::Value> {
        serde_json::to_value(self.network.as_ref()?.counts()).ok()
    }
}
