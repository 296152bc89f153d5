//! ROS 2: poses of topics in; bearings, markers, diagnostics and CSI out; parameters; the self-test.

use super::{Adapter, Made, Robot, Said, Start, diagnostics};
use crate::config::{Capture, Config, Odometry, ros2::is_used};
use crate::health::Health;
use crate::machine::{Machine, Tap};
use crate::self_test::{Found, SelfTest, WINDOW};
use crate::sources::Poses;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::motion::pose::Pose;
use csi5300::signal::channel::Channel;
use csi5300::source::Error;
use csi5300_bag::messages::services::{ParameterValue, SelfTestRequest};
use csi5300_bag::messages::shown::DiagnosticArray;
use csi5300_ros2::link::{Publisher, usual};
use csi5300_ros2::{Node, Records};
use driver_iface::record::Record;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

struct Ros2 {
    node: Node,
    wall_us: fn() -> Option<i64>,
    /// What is published beside the poses that are read: nothing without a table `[ros2]`.
    parameters: Option<Vec<(&'static str, ParameterValue)>>,
    publishes_diagnostics: bool,
    diagnostics: Option<Publisher<DiagnosticArray>>,
    channel: Channel,
    /// The records come from a card of this machine.
    has_card: bool,
    /// Nothing without a table `[ros2]`.
    self_test: Option<SelfTest>,
    /// What the claims said last.
    claims: Arc<Mutex<Vec<Found>>>,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let config = start.config;
    if !is_used(config) {
        return Ok(None);
    }
    let asked = config.ros2.clone().unwrap_or_default();
    let node = Node::start(&asked, &config.robot(), start.wall_us);
    let node = node.map_err(|error| Error::Backend(Box::new(error)))?;
    let is_asked = config.ros2.is_some();
    Ok(Some(Box::new(Ros2 {
        node,
        wall_us: start.wall_us,
        parameters: is_asked.then(|| parameters(config)),
        publishes_diagnostics: is_asked && asked.publish_diagnostics,
        diagnostics: None,
        channel: config.channel,
        has_card: matches!(config.capture.get_ref(), Capture::Card(_) | Capture::Stock(_)),
        self_test: None,
        claims: Arc::default(),
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
            let test = SelfTest::new(self.channel, robot.own, &robot.peers);
            let test = if self.has_card { test.with_module() } else { test };
            let (asked, name) = (test.clone(), robot.name.clone());
            let answer = move |_: &_, _: SelfTestRequest| diagnostics::self_test(&name, &asked.judge());
            self.node.link().serve("~/self_test", answer);
            self.self_test = Some(test);
        }
        let publish = || self.node.link().publish("/diagnostics", usual());
        self.diagnostics = self.publishes_diagnostics.then(publish);
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        if let Some(records) = self.node.records() {
            machine.add_tap(Box::new(Card(records)));
        }
        if let Some(test) = &self.self_test {
            machine.add_tap(test.tap());
        }
        if let Some(test) = self.self_test.clone().filter(|_| self.publishes_diagnostics) {
            tokio::spawn(ask(test, Arc::clone(&self.claims)));
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
        if let Some(publisher) = &self.diagnostics {
            let header = self.node.header((self.wall_us)().unwrap_or(0), String::new());
            let mut told = diagnostics::of(header, health);
            let claims = self.claims.lock().unwrap_or_else(PoisonError::into_inner);
            told.status.push(diagnostics::claims(&health.name, &claims));
            publisher.put(&told);
        }
    }
}

/// Asks the claims again and again, on a thread of its own.
async fn ask(test: SelfTest, claims: Arc<Mutex<Vec<Found>>>) {
    loop {
        tokio::time::sleep(Duration::from_secs_f64(WINDOW.as_s())).await;
        let test = test.clone();
        if let Ok(found) = tokio::task::spawn_blocking(move || test.judge()).await {
            *claims.lock().unwrap_or_else(PoisonError::into_inner) = found;
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

/// What of the configuration `ros2 param get` gives.
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
