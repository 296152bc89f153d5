//! ROS 2: poses of topics in; bearings, markers, diagnostics and CSI out; parameters; the self-test. The team as topics: its graph as
//! JSON, this robot's pose among known places, ellipses of all robots.

use super::{Adapter, Made, Robot, Said, Start, mislabelled};
use crate::config::{Config, Odometry};
use crate::diagnostics::Claims;
use crate::health::Health;
use crate::machine::{Machine, Tap};
use crate::sources::Poses;
use crate::team::{Member, Ranged, Ranges, TeamState};
use csi5300::motion::odometry::ros::Stamp;
use csi5300::source::{Error, Next};
use csi5300::time::Instant;
use csi5300_bag::messages::{
    Covariance, DiagnosticArray, Header, Marker, MarkerArray, ParameterValue, Pose, PoseWithCovariance,
    PoseWithCovarianceStamped, Quaternion, SelfTestRequest, Text, TfMessage, Transform, TransformStamped, Vector3,
};
use csi5300_live::wait::wall_us;
use csi5300_ros2::link::{Publisher, usual};
use csi5300_ros2::said::Pen;
use csi5300_ros2::{Node, Qos, Records, colour};
use std::f64::consts::PI;
use std::sync::Arc;

/// Least deviation of a range, metres, whatever its variance says.
const LEAST_SD_M: f64 = 0.01;
/// Deviations in which 95 % of the errors in a plane are: `sqrt(-2 ln 0.05)`.
const HOLDS_95: f64 = 2.447_75;
/// Largest half axis of an ellipse, metres.
const LARGEST_M: f64 = 10.0;
/// Height of an ellipse, metres.
const FLAT_M: f64 = 0.02;
/// Other places of a robot that are drawn.
const OTHERS: usize = 3;
/// Colour of this robot.
const OWN: [f32; 3] = [0.5, 0.5, 0.5];

struct Ros2 {
    node: Node,
    diagnostics: Option<Publisher<DiagnosticArray>>,
    /// What the claims are made of.
    config: Config,
    /// Nothing without a table `[ros2]`.
    claims: Option<Arc<Claims>>,
    records: Option<Records>,
    /// None without a table `[ros2]` or `[team]`.
    team: Option<Topics>,
    ranges: Ranges,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let config = start.config;
    if !config.uses_ros2() {
        return Ok(None);
    }
    let node = Node::start(&config.ros2.clone().unwrap_or_default(), &config.robot(), wall_us)?;
    let _ = start.topics.set(node.link.relay());
    Ok(Some(Box::new(Ros2 {
        node,
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
        if let Some(ros) = &self.config.ros2 {
            let names: Vec<String> = robot.peers.iter().map(|(name, _)| name.clone()).collect();
            self.node.announce(&names);
            self.node.serve_parameters(parameters(&self.config));
            let claims = Claims::new(&self.config, robot);
            let asked = Arc::clone(&claims);
            self.node.link.serve("~/self_test", move |_: &_, _: SelfTestRequest| asked.answer());
            self.claims = Some(claims);
            if let Some(team) = &self.config.team {
                self.team = Some(Topics::new(&self.node, names, ros.frame.clone(), !team.places.is_empty()));
            }
        }
        self.subscribe_to_ranges();
        let publish = || self.node.link.publish("/diagnostics", usual());
        self.diagnostics = self.config.ros2.as_ref().filter(|ros| ros.publish_diagnostics).map(|_| publish());
        self.records = self.node.records();
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        if let Some(records) = self.records.take() {
            machine.add_tap(Box::new(records));
        }
        if let Some(claims) = &self.claims {
            claims.attach(machine, self.diagnostics.is_some());
        }
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        self.node.report(said.peer, said.report);
    }

    fn look(&mut self, health: &mut Health) {
        health.ros2 = Some(self.node.link.counted());
        health.trouble.extend(self.node.trouble());
        health.trouble.extend(mislabelled(health, self.config.ros2.as_ref().map(|ros| ("ros2", &ros.frame))));
    }

    fn finish(&mut self, health: &mut Health) {
        self.node.link.end_recording();
        health.ros2 = Some(self.node.link.counted());
        let trouble = self.node.trouble().into_iter().filter(|why| !health.trouble.contains(why));
        health.trouble.extend(trouble.collect::<Vec<_>>());
    }

    fn tell(&mut self, health: &Health, _: &Machine) {
        if let (Some(topics), Some(team)) = (&mut self.team, &health.team) {
            topics.tell(&self.node, team, wall_us().unwrap_or(0));
        }
        if let (Some(publisher), Some(claims)) = (&self.diagnostics, &self.claims) {
            let header = self.node.header(wall_us().unwrap_or(0), String::new());
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
                    Ranged { t_s: us as f64 * 1e-6, range_m }
                };
                ranges.put(&peer, told.map(ranged));
            });
        }
    }
}

impl Tap for Records {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        self.put(next);
    }
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

/// Publishers of the team.
struct Topics {
    factors: Publisher<Text>,
    /// None without known places, because the pose is then that of the odometry.
    pose: Option<Publisher<PoseWithCovarianceStamped>>,
    /// Names of the peers, in the order of their colours.
    peers: Vec<String>,
    /// Frame of the odometry.
    odometry: String,
    /// The last solution that was published.
    solved: u64,
}

impl Topics {
    pub fn new(node: &Node, peers: Vec<String>, odometry: String, has_places: bool) -> Self {
        let factors = node.link.publish("~/factors", Qos::latched(1));
        let pose = has_places.then(|| node.link.publish("~/pose", usual()));
        Self { factors, pose, peers, odometry, solved: 0 }
    }

    /// Publishes a new solution, and the markers of the last one again.
    pub fn tell(&mut self, node: &Node, team: &TeamState, now_us: i64) {
        if team.solved == 0 {
            return;
        }
        let frame = team.frame.as_ref().unwrap_or(&self.odometry);
        if let Some(markers) = &node.markers {
            markers.put(&markers_of(&node.header(now_us, frame.clone()), team, &self.peers));
        }
        if let (Some(tf), Some(frame)) = (&node.tf, &team.frame) {
            tf.put(&transform(node.header(now_us, frame.clone()), team.odometry, &self.odometry));
        }
        if team.solved == self.solved {
            return;
        }
        self.solved = team.solved;
        self.factors.put(&Text { data: team.factors.to_string() });
        if let (Some(pose), Some(own)) = (&self.pose, team.robots.first()) {
            pose.put(&pose_of(node.header((own.t_s * 1e6).round() as i64, frame.clone()), own));
        }
    }
}

/// A robot's pose in the plane; an unknown heading has the variance of any.
fn pose_of(header: Header, own: &Member) -> PoseWithCovarianceStamped {
    // Rows of a pose in the plane among those of a pose.
    const ROWS: [usize; 3] = [0, 1, 5];
    let mut covariance = Covariance::default();
    for (row, from) in ROWS.into_iter().zip(own.covariance) {
        ROWS.into_iter().zip(from).for_each(|(column, value)| covariance.0[row][column] = value);
    }
    if own.heading_rad.is_none() {
        (0..6).for_each(|k| (covariance.0[k][5], covariance.0[5][k]) = (0.0, 0.0));
        covariance.0[5][5] = PI * PI;
    }
    let [x, y] = own.position_m;
    let pose =
        Pose { position: [x, y, 0.0].into(), orientation: Quaternion::along(own.heading_rad.unwrap_or(0.0), 0.0) };
    PoseWithCovarianceStamped { header, pose: PoseWithCovariance { pose, covariance } }
}

/// The odometry's frame in that of the places.
fn transform(header: Header, [x, y, yaw]: [f64; 3], child: &str) -> TfMessage {
    let transform = Transform { translation: Vector3 { x, y, z: 0.0 }, rotation: Quaternion::along(yaw, 0.0) };
    TfMessage { transforms: vec![TransformStamped { header, child_frame_id: child.to_owned(), transform }] }
}

/// Half axes of the 95 % ellipse of a place, metres, the longer first, and the direction of that, radians.
fn ellipse([[a, b, _], [_, d, _], _]: [[f64; 3]; 3]) -> ([f64; 2], f64) {
    let (middle, half) = (0.5 * (a + d), (0.5 * (a - d)).hypot(b));
    let axis = |variance: f64| (HOLDS_95 * variance.max(0.0).sqrt()).clamp(0.5 * FLAT_M, LARGEST_M);
    ([axis(middle + half), axis(middle - half)], 0.5 * (2.0 * b).atan2(a - d))
}

/// Each robot's ellipse, name and other places. Those that no longer apply are deleted.
fn markers_of(header: &Header, team: &TeamState, peers: &[String]) -> MarkerArray {
    let mut markers = Vec::new();
    for (number, own) in team.robots.iter().enumerate() {
        let peer = peers.iter().position(|name| *name == own.name).filter(|_| number > 0);
        let pen = Pen { header, name: &format!("team/{}", own.name), colour: peer.map_or(OWN, colour) };
        let ([long, short], direction) = ellipse(own.covariance);
        let marker = |id: usize, kind: i32, alpha: f32, [x, y]: [f64; 2]| Marker {
            pose: Pose { position: [x, y, 0.0].into(), orientation: Quaternion::along(direction, 0.0) },
            ..pen.marker(i32::try_from(id).unwrap_or(i32::MAX), kind, alpha, [2.0 * long, 2.0 * short, FLAT_M])
        };
        markers.push(marker(0, Marker::CYLINDER, 0.5, own.position_m));
        let mut name = marker(1, Marker::TEXT, 1.0, own.position_m);
        name.scale = Vector3 { x: 0.0, y: 0.0, z: 0.25 };
        name.pose.position.z = 0.3;
        name.text = format!("{}: 95 % within {long:.2} m", own.name);
        markers.push(name);
        for other in 0..OTHERS {
            markers.push(match own.others_m.get(other) {
                Some(at) => marker(2 + other, Marker::CYLINDER, 0.2, *at),
                None => Marker { action: Marker::DELETE, ..marker(2 + other, Marker::CYLINDER, 0.0, [0.0; 2]) },
            });
        }
    }
    MarkerArray { markers }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One metre of deviation along a direction, a tenth across.
    fn member(name: &str, direction: f64) -> Member {
        let (sin, cos) = direction.sin_cos();
        let [a, b, d] = [cos * cos + 0.01 * sin * sin, 0.99 * sin * cos, sin * sin + 0.01 * cos * cos];
        let covariance = [[a, b, 0.02], [b, d, 0.03], [0.02, 0.03, 0.04]];
        Member { name: name.into(), position_m: [1.0, 2.0], covariance, ..Member::default() }
    }

    #[test]
    fn an_ellipse_lies_along_its_covariance_and_holds_95_percent() {
        for direction in [0.0, 0.7, 1.5, -1.2] {
            let ([long, short], found) = ellipse(member("b", direction).covariance);
            assert!((long - HOLDS_95).abs() < 1e-9 && (short - 0.1 * HOLDS_95).abs() < 1e-9, "{long} {short}");
            assert!((found - direction).sin().abs() < 1e-9, "{found} {direction}");
        }
        assert!(((-0.5 * HOLDS_95 * HOLDS_95).exp() - 0.05).abs() < 1e-6);
        let huge = [[1e6, 0.0, 0.0], [0.0, 1e-12, 0.0], [0.0; 3]];
        assert_eq!(ellipse(huge).0, [LARGEST_M, 0.5 * FLAT_M]);
    }

    #[test]
    fn robots_have_the_colours_of_their_bearings_and_other_places_come_and_go() {
        let other = Member { others_m: vec![[-1.0, 2.0]], ..member("b", 0.7) };
        let team = TeamState { robots: vec![member("a", 0.0), other], ..TeamState::default() };
        let markers = markers_of(&Header::default(), &team, &["c".to_owned(), "b".to_owned()]).markers;
        let actions: Vec<i32> = markers.iter().map(|marker| marker.action).collect();
        assert_eq!(actions, [0, 0, 2, 2, 2, 0, 0, 0, 2, 2]);
        let red = |k: usize| markers[k].color.r;
        assert_eq!((red(0), red(5)), (OWN[0], colour(1)[0]));
        assert_eq!((markers[7].pose.position.x, markers[7].ns.as_str()), (-1.0, "team/b"));
        let along = 2.0 * markers[5].pose.orientation.z.atan2(markers[5].pose.orientation.w);
        assert!((along - 0.7).abs() < 1e-9 && (markers[5].scale.x - 2.0 * HOLDS_95).abs() < 1e-9, "{along}");
        assert_eq!(markers[6].text, "b: 95 % within 2.45 m");
    }

    #[test]
    fn a_late_subscriber_receives_the_factors() {
        let settings = csi5300_ros2::settings::Settings {
            // Nobody else on this machine is likely to use it.
            domain: Some(70 + (std::process::id() % 70) as u16),
            multicast: Some(false),
            ..Default::default()
        };
        let node = |name: &str| Node::start(&settings, name, || Some(20_000_000)).unwrap();
        let robot = node("burger");
        let mut topics = Topics::new(&robot, Vec::new(), "odom".into(), true);
        let own = Member { t_s: 12.5, ..member("a", 0.0) };
        let frame = Some("map".to_owned());
        let team = TeamState { frame, robots: vec![own], solved: 1, factors: "{}".into(), ..TeamState::default() };
        topics.tell(&robot, &TeamState::default(), 13_000_000);
        topics.tell(&robot, &team, 13_000_000);
        let late = node("bench");
        let (give, factors) = std::sync::mpsc::channel();
        let used = move |text: Text, _| drop(give.send(text.data));
        late.link.subscribe("/csi5300_burger/factors", Qos::latched(1), used, || panic!("unreadable"));
        assert_eq!(factors.recv().unwrap(), "{}");
        let (give, poses) = std::sync::mpsc::channel();
        let used = move |pose: PoseWithCovarianceStamped, _| drop(give.send(pose));
        late.link.subscribe("/csi5300_burger/pose", Qos::reliable(1), used, || panic!("unreadable"));
        let pose = loop {
            topics.tell(&robot, &TeamState { solved: topics.solved + 1, ..team.clone() }, 13_000_000);
            match poses.try_recv() {
                Ok(pose) => break pose,
                Err(_) => std::thread::yield_now(),
            }
        };
        assert_eq!((pose.header.stamp.sec, pose.header.frame_id.as_str()), (12, "map"));
    }

    #[test]
    fn a_pose_in_the_plane_has_its_numbers_in_the_rows_of_x_y_and_yaw() {
        let own = Member { heading_rad: Some(PI / 2.0), ..member("a", 0.0) };
        let said = pose_of(Header::default(), &own).pose;
        let covariance = said.covariance.0;
        assert_eq!([covariance[0][0], covariance[0][5], covariance[5][1], covariance[5][5]], [1.0, 0.02, 0.03, 0.04]);
        assert_eq!(covariance.iter().flatten().filter(|value| **value != 0.0).count(), 7);
        let [z, w] = [said.pose.orientation.z, said.pose.orientation.w];
        assert!((2.0 * z.atan2(w) - PI / 2.0).abs() < 1e-12);
        let unknown = pose_of(Header::default(), &member("a", 0.0)).pose.covariance.0;
        assert_eq!([unknown[0][5], unknown[5][0], unknown[5][5]], [0.0, 0.0, PI * PI]);
        // A point of the odometry's frame: turned, then moved.
        let told = transform(Header::default(), [1.0, 2.0, PI / 2.0], "odom").transforms.remove(0);
        let at = told.transform.isometry().unwrap() * nalgebra::Point3::new(3.0, 0.0, 0.0);
        assert!((at.x - 1.0).abs() < 1e-12 && (at.y - 5.0).abs() < 1e-12 && told.child_frame_id == "odom", "{at}");
    }
}
