//! See the parent.

use crate::config::Config;
use crate::config::ros::name_part;
use crate::machine::{Machine, Tap};
use crate::ros::said::{bearing_message, csi_message, has_bearing, looking_along};
use crate::ros1::messages::{self, Bearing, Csi, Header, PoseStamped, Quaternion, Time, Vector};
use crate::ros1::{Outbox, RosLink};
use crate::sources::Sources;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{Next, Stamps};
use driver_iface::bfee::Bfee;
use driver_iface::record::Record;

/// What is published of one peer.
struct Peer {
    name: String,
    mac: String,
    bearings: Outbox<Bearing>,
    poses: Outbox<PoseStamped>,
    seq: u32,
}

/// This program as a node of ROS, if it is one.
pub struct Ros {
    link: Option<RosLink>,
    frame: String,
    peers: Vec<Peer>,
    csi: Option<String>,
}

impl Ros {
    /// Takes the node of `sources`, and announces what it publishes.
    pub fn open(config: &Config, sources: &mut Sources) -> Self {
        let asked = config.ros.clone().unwrap_or_default();
        let mut ros = Self { link: sources.ros.0.take(), frame: asked.frame.clone(), peers: Vec::new(), csi: None };
        let (Some(link), true) = (&ros.link, config.ros.is_some()) else { return ros };
        let node = asked.node(config);
        if asked.publish_bearings {
            let peer = |told: &csi5300::pipeline::live::LivePeer| {
                let topic = format!("{node}/{}", name_part(&told.name));
                let (bearings, poses) = (format!("{topic}/bearing"), format!("{topic}/pose"));
                let (bearings, poses) = (link.publish(&bearings), link.publish(&poses));
                Peer { name: told.name.clone(), mac: told.mac.to_string(), bearings, poses, seq: 0 }
            };
            ros.peers = sources.peers.iter().map(|opened| peer(&opened.peer)).collect();
        }
        ros.csi = asked.publish_csi.then(|| format!("{node}/csi"));
        ros
    }

    /// From now on the machine's records are published, if that was asked for.
    pub fn attach(&self, machine: &mut Machine) {
        if let (Some(link), Some(topic)) = (&self.link, &self.csi) {
            machine.add_tap(Box::new(Records { csi: link.publish(topic), survey: Survey::default(), seq: 0 }));
        }
    }

    /// Publishes what is said of peer number `peer`; `own` is where this robot's antenna is.
    pub fn report(&mut self, peer: usize, report: &PeerReport, own: Option<&Pose>) {
        let Some(peer) = self.peers.get_mut(peer) else { return };
        peer.seq = peer.seq.wrapping_add(1);
        let stamp = Time::from_s(report.t_s.unwrap_or(0.0));
        let header = Header { seq: peer.seq, stamp, frame_id: self.frame.clone() };
        if let (true, Some(azimuth_deg), Some(own)) = (has_bearing(report), report.answer.azimuth_deg, own) {
            let elevation_deg = report.answer.elevation_deg.unwrap_or(0.0);
            peer.poses.put(pointing(header.clone(), own, azimuth_deg.to_radians(), elevation_deg.to_radians()));
        }
        peer.bearings.put(bearing(header, &peer.name, &peer.mac, report));
    }

    /// What was counted.
    pub fn counts(&self) -> Option<serde_json::Value> {
        self.link.as_ref().map(RosLink::counted)
    }

    /// What is wrong with the connection to the master.
    pub fn trouble(&self) -> Option<String> {
        self.link.as_ref()?.trouble()
    }
}

fn bearing(header: Header, peer: &str, mac: &str, report: &PeerReport) -> Bearing {
    bearing_message!(Bearing, header, peer, mac, report)
}

/// A pose that stands where the antenna is and looks along the bearing: up or down too where the sign of the elevation is
/// known.
fn pointing(header: Header, own: &Pose, azimuth_rad: f64, elevation_rad: f64) -> PoseStamped {
    let [x, y, z] = own.position_m.into();
    let [turn_x, turn_y, turn_z, turn_w] = looking_along(azimuth_rad, elevation_rad);
    let orientation = Quaternion { x: turn_x, y: turn_y, z: turn_z, w: turn_w };
    PoseStamped { header, pose: messages::Pose { position: Vector { x, y, z }, orientation } }
}

/// Every record of the card, as a message.
struct Records {
    csi: Outbox<Csi>,
    survey: Survey,
    seq: u32,
}

impl Tap for Records {
    fn record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        let stamps = Stamps { host_us, ..Stamps::default() };
        let next = Next::Record(stamps, record);
        let Some((bfee, identity)) = self.survey.note(&next) else { return };
        self.seq = self.seq.wrapping_add(1);
        self.csi.put(csi(self.seq, &bfee, identity));
    }

    fn pose(&mut self, _: Option<Pose>) {}
}

fn csi(seq: u32, bfee: &Bfee<'_>, identity: Identity) -> Csi {
    let stamp = Time::from_us(identity.host_us.unwrap_or(0));
    csi_message!(Csi, Header { seq, stamp, frame_id: String::new() }, bfee, identity)
}

#[cfg(test)]
mod tests;
