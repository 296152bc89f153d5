//! ROS 2: poses of topics in; bearings, markers, diagnostics and CSI out; parameters; the self-test.

use super::diagnostics::Claims;
use super::team::Topics;
use super::{Adapter, Made, Robot, Said, Start};
use crate::config::{Config, Odometry, ros2::is_used};
use crate::health::Health;
use crate::machine::{Machine, Tap};
use crate::ranges::{Ranged, Ranges};
use crate::sources::Poses;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::motion::pose::Pose;
use csi5300::source::Error;
use csi5300_bag::messages::services::{ParameterValue, SelfTestRequest};
use csi5300_bag::messages::shown::DiagnosticArray;
use csi5300_ros2::link::{Publisher, usual};
use csi5300_ros2::{Node, Records};
use driver_iface::record::Record;

/// Least deviation of a range, metres, whatever its variance says.
const LEAST_SD_M: f64 = 0.01;

struct Ros2 {
    node: Node,
    wall_us: fn() -> Option<i64>,
    /// The outputs; none without a table `[ros2]`.
    parameters: Option<Vec<(&'static str, ParameterValue)>>,
    publishes_diagnostics: bool,
    diagnostics: Option<Publisher<DiagnosticArray>>,
    /// What the claims are made of.
    config: Config,
    /// Nothing without a table `[ros2]`.
    claims: Option<Claims>,
    records: Option<Records>,
    /// None without a table `[ros2]` or `[team]`.
    team: Option<Topics>,
    ranges: Ranges,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let config = start.config;
    if !is_used(config) {
        return Ok(None);
    }
    let asked = config.ros2.clone().unwrap_or_default();
    let node = Node::start(&asked, &config.robot(), start.wall_us);
    let node = node.map_err(|error| Error::Backend(Box::new(error)))?;
    let _ = start.topics.set(node.link().relay());
    let is_asked = config.ros2.is_some();
    Ok(Some(Box::new(Ros2 {
        node,
        wall_us: start.wall_us,
        parameters: is_asked.then(|| parameters(config)),
        publishes_diagnostics: is_asked && asked.publish_diagnostics,
        diagnostics: None,
        config: config.clone(),
        claims: None,
        records: None,
        team: None,
        ranges: start.ranges.clone(),
    })))
}

impl Adapter for Ros2 {
    fn poses(&mut self, odometry: &Odometry, usual: Stamp) -> Option<Poses> {
        let Odometry::Ros2(topic) = odometry else { return None };
        Some(Box::new(self.node.poses(topic, usual)))
    }

    fn meet(&mut self, robot: &Robot) -> Result<(), Error> {
        if let Some(parameters) = self.parameters.take() {
            let peers: Vec<_> = robot.peers.iter().map(|(name, mac)| (name.clone(), mac.to_string())).collect();
            self.node.announce(&peers);
            self.node.serve_parameters(parameters);
            let claims = Claims::new(&self.config, robot);
            let asked = claims.clone();
            self.node.link().serve("~/self_test", move |_: &_, _: SelfTestRequest| asked.answer());
            self.claims = Some(claims);
            let names = || robot.peers.iter().map(|(name, _)| name.clone()).collect();
            let frame = self.config.ros2.as_ref().map(|ros| ros.frame.clone()).unwrap_or_default();
            self.team =
                self.config.team.as_ref().map(|team| Topics::new(&self.node, names(), frame, !team.places.is_empty()));
        }
        self.subscribe_to_ranges();
        let publish = || self.node.link().publish("/diagnostics", usual());
        self.diagnostics = self.publishes_diagnostics.then(publish);
        self.records = self.node.records();
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        if let Some(records) = self.records.take() {
            machine.add_tap(Box::new(Card(records)));
        }
        if let Some(claims) = &self.claims {
            claims.attach(machine, self.publishes_diagnostics);
        }
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        self.node.report(said.peer, said.report);
    }

    fn look(&mut self, health: &mut Health) {
        self.node.look();
        health.ros2 = Some(self.node.counted());
        health.trouble.extend(self.node.trouble());
    }

    fn tell(&mut self, health: &Health, _: &Machine) {
        if let (Some(topics), Some(team)) = (&mut self.team, &health.team) {
            topics.tell(&self.node, team, (self.wall_us)().unwrap_or(0));
        }
        if let (Some(publisher), Some(claims)) = (&self.diagnostics, &self.claims) {
            let header = self.node.header((self.wall_us)().unwrap_or(0), String::new());
            publisher.put(&claims.diagnostics(header, health));
        }
    }
}

impl Ros2 {
    fn subscribe_to_ranges(&self) {
        for (peer, asked) in self.config.team.iter().flat_map(|team| &team.ranges) {
            let (peer, usual_m, ranges) = (peer.clone(), asked.sd_m, self.ranges.clone());
            self.node.ranges(&asked.topic, move |told| {
                let ranged = |(us, [range_m, sd_m]): (i64, [f64; 2])| {
                    let range_m = [range_m, if sd_m > 0.0 { sd_m.max(LEAST_SD_M) } else { usual_m }];
                    Ranged { peer: peer.clone(), t_s: us as f64 * 1e-6, range_m }
                };
                ranges.put(&peer, told.map(ranged));
            });
        }
    }
}

struct Card(Records);

impl Tap for Card {
    fn record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        self.0.put(host_us, record);
    }

    fn pose(&mut self, _: Option<Pose>) {}
}

/// The parameters for `ros2 param get`.
fn parameters(config: &Config) -> Vec<(&'static str, ParameterValue)> {
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
    all.into_iter().chain(sounding).collect()
}
