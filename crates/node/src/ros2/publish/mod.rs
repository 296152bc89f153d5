//! What is published over ROS 2: bearings, places of peers, markers, diagnostics, transforms, CSI.
//!
//! | module | what it is |
//! |---|---|
//! | `said` | a report as messages |
//! | `markers` | a report as things to be drawn |
//! | `diagnostics` | the state of the robot |
//! | `csi` | the card's records |

pub(super) mod csi;
mod diagnostics;
mod markers;
mod said;

use super::inputs::SimClock;
use super::link::{Link, Publisher, usual};
use super::messages::own::Bearing;
use super::messages::services::{
    GetParametersRequest, GetParametersResponse, ListParametersRequest, ListParametersResponse, ListParametersResult,
    ParameterValue, TriggerRequest, TriggerResponse,
};
use super::messages::shown::{DiagnosticArray, MarkerArray};
use super::messages::standard::{Header, PoseStamped, PoseWithCovarianceStamped, TfMessage, Time};
use super::names::name_part;
use super::node::Node;
use super::rtps::Qos;
use crate::config::Config;
use crate::health::Health;
use crate::machine::Machine;
use crate::sources::{PeerSources, Sources};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::survey::Survey;
use std::sync::Arc;

/// What is published of one peer.
struct Peer {
    name: String,
    mac: String,
    number: usize,
    bearings: Publisher<Bearing>,
    directions: Publisher<PoseStamped>,
    places: Publisher<PoseWithCovarianceStamped>,
}

/// This program as a node of ROS 2, if it is one.
#[derive(Default)]
pub(crate) struct Ros2 {
    node: Option<Node>,
    frame: String,
    peers: Vec<Peer>,
    markers: Option<Publisher<MarkerArray>>,
    tf: Option<Publisher<TfMessage>>,
    diagnostics: Option<Publisher<DiagnosticArray>>,
    csi: bool,
}

impl Ros2 {
    /// Takes the node of `sources`, and announces what it publishes.
    pub fn open(config: &Config, sources: &mut Sources) -> Self {
        let Some(node) = sources.ros2.0.take() else { return Self::default() };
        let Some(asked) = &config.ros2 else { return Self { node: Some(node), ..Self::default() } };
        let link = &node.link;
        let peer = |(number, opened): (usize, &PeerSources)| {
            let part = name_part(&opened.peer.name);
            Peer {
                name: opened.peer.name.clone(),
                mac: opened.peer.mac.to_string(),
                number,
                bearings: link.publish(&format!("~/{part}/bearing"), usual()),
                directions: link.publish(&format!("~/{part}/direction"), usual()),
                places: link.publish(&format!("~/{part}/pose"), usual()),
            }
        };
        let peers =
            if asked.publish_bearings { sources.peers.iter().enumerate().map(peer).collect() } else { Vec::new() };
        let markers = asked.publish_markers.then(|| link.publish("~/markers", usual()));
        let tf = asked.publish_tf.then(|| link.publish("/tf", usual()));
        let diagnostics = asked.publish_diagnostics.then(|| link.publish("/diagnostics", usual()));
        serve_parameters(link, config);
        if asked.bag.is_some() {
            serve_recording(link);
        }
        Self { frame: asked.frame.clone(), peers, markers, tf, diagnostics, csi: asked.publish_csi, node: Some(node) }
    }

    /// From now on the machine's records are published, if that was asked for.
    pub fn attach(&self, machine: &mut Machine) {
        if let (Some(node), true) = (&self.node, self.csi) {
            let csi = node.link.publish("~/csi", Qos::best_effort(5));
            let clock = node.clock.clone();
            machine.add_tap(Box::new(csi::Records { csi, clock, survey: Survey::default() }));
        }
    }

    fn clock(&self) -> SimClock {
        self.node.as_ref().map_or_else(SimClock::real, |node| node.clock.clone())
    }

    /// Publishes what is said of peer number `peer`; `own` is where this robot's antenna is.
    pub fn report(&mut self, peer: usize, report: &PeerReport, own: Option<&Pose>) {
        let stamp_us = self.clock().to_stamp((report.t_s.unwrap_or(0.0) * 1e6) as i64);
        let header = Header { stamp: Time::from_us(stamp_us), frame_id: self.frame.clone() };
        let place = said::place(&header, report);
        if let Some(peer) = self.peers.get(peer) {
            peer.bearings.put(&said::bearing(header.clone(), (&peer.name, &peer.mac), report));
            said::direction(&header, report, own).iter().for_each(|pose| peer.directions.put(pose));
            place.iter().for_each(|place| peer.places.put(place));
        }
        if let (Some(markers), Some(own)) = (&self.markers, own) {
            let name = self.peers.get(peer).map_or(report.answer.link.as_str(), |peer| &peer.name);
            let number = self.peers.get(peer).map_or(peer, |peer| peer.number);
            markers.put(&markers::of(&header, (name, number), report, own));
        }
        if let (Some(tf), Some(place)) = (&self.tf, &place) {
            tf.put(&said::transform(place, &name_part(&report.answer.link)));
        }
    }

    /// Publishes the state of the robot, and looks at what comes.
    pub fn look(&mut self, health: &Health, wall_us: Option<i64>) {
        let Some(node) = &self.node else { return };
        node.look();
        if let Some(publisher) = &self.diagnostics {
            let stamp = Time::from_us(node.clock.to_stamp(wall_us.unwrap_or(0)));
            publisher.put(&diagnostics::of(Header { stamp, frame_id: String::new() }, health));
        }
    }

    /// What was counted.
    pub fn counts(&self) -> Option<serde_json::Value> {
        self.node.as_ref().map(|node| node.link.counted())
    }

    /// What is wrong, in words.
    pub fn trouble(&self) -> Vec<String> {
        self.node.as_ref().map(Node::trouble).unwrap_or_default()
    }
}

/// Starting and stopping the recording, while the node runs.
fn serve_recording(link: &Link) {
    link.serve("~/start_recording", |shared, _: TriggerRequest| match shared.bag.start() {
        Ok(folder) => TriggerResponse { success: true, message: folder.display().to_string() },
        Err(error) => TriggerResponse { success: false, message: error.to_string() },
    });
    link.serve("~/stop_recording", |shared, _: TriggerRequest| match shared.bag.stop() {
        Some(folder) => TriggerResponse { success: true, message: folder.display().to_string() },
        None => TriggerResponse { success: false, message: "there is no recording".into() },
    });
}

/// What of the configuration `ros2 param get` gives.
fn serve_parameters(link: &Link, config: &Config) {
    let words = |text: String| ParameterValue { r#type: 4, string_value: text, ..ParameterValue::default() };
    let number = |value: f64| ParameterValue { r#type: 3, double_value: value, ..ParameterValue::default() };
    let truth = |value: bool| ParameterValue { r#type: 1, bool_value: value, ..ParameterValue::default() };
    let sounding = config.sounding.as_ref().map(|sounding| ("sounding_rate_hz", number(sounding.rate_hz)));
    let sim = config.ros2.as_ref().is_some_and(|ros| ros.use_sim_time);
    let all = [
        ("channel", words(config.channel.to_string())),
        ("frequency_hz", number(config.channel.centre_hz())),
        ("rate_hz", number(config.estimator.rate_hz)),
        ("use_sim_time", truth(sim)),
    ];
    let all: Arc<[(&'static str, ParameterValue)]> = all.into_iter().chain(sounding).collect();
    let told = Arc::clone(&all);
    link.serve("~/get_parameters", move |_, asked: GetParametersRequest| {
        // One that is not there is not set: type 0.
        let value = |name: &String| told.iter().find(|(known, _)| known == name).map(|(_, value)| value.clone());
        GetParametersResponse { values: asked.names.iter().map(|name| value(name).unwrap_or_default()).collect() }
    });
    link.serve("~/list_parameters", move |_, asked: ListParametersRequest| {
        let is_asked = |name: &&str| asked.prefixes.is_empty() || asked.prefixes.iter().any(|prefix| prefix == name);
        let names = all.iter().map(|(name, _)| *name).filter(is_asked).map(str::to_owned).collect();
        ListParametersResponse { result: ListParametersResult { names, prefixes: Vec::new() } }
    });
}
