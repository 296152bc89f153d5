//! csi5300-hiroz-check PROGRAM FOLDER: checks the node's topics over zenoh, with DDS off. The other end is a node made with hiroz, which
//! has its own keys, tokens, attachments, type hashes and CDR. hiroz also configures the router. FOLDER has the files of examples/ros2.

use hiroz::msg::{ZDeserializer, ZMessage};
use hiroz::{attachment::Attachment, config::RouterConfigBuilder, entity::EndpointKind, prelude::*};
use hiroz_msgs::geometry_msgs::{Point, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion};
use hiroz_msgs::std_msgs::{Header, String as Text};
use hiroz_msgs::visualization_msgs::MarkerArray;
use hiroz_msgs::{builtin_interfaces::Time, diagnostic_msgs::DiagnosticArray, nav_msgs::Odometry, tf2_msgs::TFMessage};
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use zenoh::{Wait, sample::Sample};

/// A robot that drives a circle: its name, the middle, the radius, and radians a second.
type Circle = (&'static str, [f64; 2], f64, f64);
const CIRCLES: [Circle; 2] = [("tb3_0", [0.0, 0.0], 0.3, 0.7), ("tb3_1", [24.0, 10.0], 0.25, -0.4)];
/// A busy machine needs long.
const PATIENCE: Duration = Duration::from_secs(600);

/// The node, which ends with this.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The pose depends on the time only.
fn odometry((name, [x, y], radius, rate): Circle) -> Odometry {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let stamp = Time { sec: now.as_secs() as i32, nanosec: now.subsec_nanos() };
    let angle = (rate * now.as_secs_f64()) % TAU;
    let (z, w) = (0.5 * (angle + FRAC_PI_2.copysign(rate))).sin_cos();
    let position = Point { x: x + radius * angle.cos(), y: y + radius * angle.sin(), z: 0.0 };
    let pose = Pose { position, orientation: Quaternion { z, w, ..Default::default() } };
    Odometry {
        header: Header { stamp, frame_id: "odom".into() },
        child_frame_id: format!("{name}/base_footprint"),
        pose: PoseWithCovariance { pose, ..Default::default() },
        ..Default::default()
    }
}

/// The next message, of the same publisher as the last one, and later.
fn next<T>(reader: &ZSub<T, Sample, T::Serdes>, last: &mut Option<Attachment>) -> Result<T>
where
    T: ZMessage<Serdes: for<'a> ZDeserializer<Input<'a> = &'a [u8], Output = T>>,
{
    let sample = reader.recv_serialized_timeout(PATIENCE)?;
    let beside = Attachment::try_from(sample.attachment().ok_or("a message without attachment")?)?;
    let old_s =
        SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs() as i64 - beside.source_timestamp / 1_000_000_000;
    let before = last.take().map_or((0, beside.source_gid), |last| (last.sequence_number, last.source_gid));
    if before.0 >= beside.sequence_number || before.1 != beside.source_gid || old_s.abs() > 60 {
        return Err(format!("after {before:?}: {}, {:?}, {old_s} s", beside.sequence_number, beside.source_gid).into());
    }
    *last = Some(beside);
    Ok(T::deserialize(&sample.payload().to_bytes())?)
}

/// Receives one message of a topic.
fn one<T>(node: &ZNode, topic: &str, is_right: impl Fn(&T) -> bool) -> Result<()>
where
    T: WithTypeInfo + std::fmt::Debug + ZMessage<Serdes: for<'a> ZDeserializer<Input<'a> = &'a [u8], Output = T>>,
{
    let told = next(&node.create_sub::<T>(topic).build()?, &mut None)?;
    if is_right(&told) { Ok(()) } else { Err(format!("{topic}: {told:?}").into()) }
}

/// A subscriber that comes late gets the last factors at once: the topic is transient local.
fn kept(node: &ZNode) -> Result<()> {
    let (reader, mut last) = (node.create_sub::<Text>("/csi5300_tb3_0/factors").build()?, None);
    let told = next(&reader, &mut last)?;
    let latched = QosProfile { durability: QosDurability::TransientLocal, ..Default::default() };
    let (reader, mut late) = (node.create_sub::<Text>("/csi5300_tb3_0/factors").with_qos(latched).build()?, None);
    let same = next(&reader, &mut late)?;
    let numbers = [last, late].map(|beside| beside.map(|beside| beside.sequence_number));
    if numbers[0] != numbers[1] || told.data != same.data || !told.data.starts_with(r#"{"format":"csi5300-team""#) {
        return Err(format!("factors {numbers:?}: {} {}", told.data, same.data).into());
    }
    println!("hiroz: a late subscriber gets the last factors");
    Ok(())
}

/// Waits until the graph shows these topics of the node, besides those of its own types: name, type, hash and quality of service.
fn shows(node: &ZNode, kind: EndpointKind, wanted: &[(&str, TypeInfo, &str)]) -> Result<()> {
    let text = |topic: &str, kind: &TypeInfo, qos: &str| format!("{topic} {} {} {qos}", kind.name, kind.hash);
    let wanted: BTreeSet<_> = wanted.iter().map(|(topic, kind, qos)| text(topic, kind, qos)).collect();
    let start = Instant::now();
    loop {
        let ends = node.graph().get_entities_by_node(kind, (String::new(), "csi5300_tb3_0".into()));
        let told = ends.iter().filter_map(|end| Some(text(&end.topic, end.type_info.as_ref()?, &end.qos.encode())));
        let shown: BTreeSet<_> = told.filter(|end| !end.contains(" csi5300_msgs::")).collect();
        if shown == wanted {
            println!("hiroz: {} {kind:?}s of the node in the graph", shown.len());
            return Ok(());
        }
        if start.elapsed() > PATIENCE {
            return Err(format!("{kind:?}s: {shown:?} instead of {wanted:?}").into());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn check(node: &ZNode) -> Result<()> {
    let (reader, mut last) = (node.create_sub::<PoseStamped>("/csi5300_tb3_0/tb3_1/direction").build()?, None);
    let ((_, [x, y], ..), mut good, mut worst) = (CIRCLES[1], 0, 0.0_f64);
    while good < 3 {
        let Quaternion { x: qx, y: qy, z: qz, w: qw } = next(&reader, &mut last)?.pose.orientation;
        let azimuth = (2.0 * (qw * qz + qx * qy)).atan2(1.0 - 2.0 * (qy * qy + qz * qz));
        let off = (azimuth - y.atan2(x)).to_degrees().abs();
        (good, worst) = if off < 1.0 { (good + 1, worst.max(off)) } else { (0, 0.0) };
    }
    println!("hiroz: three directions, at most {worst:.2} degrees off");
    kept(node)?;
    one(node, "/csi5300_tb3_0/markers", |told: &MarkerArray| told.markers.iter().any(|one| one.ns == "tb3_1"))?;
    one(node, "/diagnostics", |told: &DiagnosticArray| told.status.iter().any(|one| one.name == "csi5300_tb3_0: card"))?;
    one(node, "/tf", |told: &TFMessage| told.transforms.iter().any(|one| one.child_frame_id == "tb3_1"))?;
    one(node, "/csi5300_tb3_0/tb3_1/pose", |told: &PoseWithCovarianceStamped| told.pose.covariance[0] > 0.0)?;
    println!("hiroz: factors, markers, diagnostics, transform and pose");
    let published = [
        ("/csi5300_tb3_0/tb3_1/direction", PoseStamped::type_info(), "::,32:,:,:,,"),
        ("/csi5300_tb3_0/tb3_1/pose", PoseWithCovarianceStamped::type_info(), "::,32:,:,:,,"),
        ("/csi5300_tb3_0/markers", MarkerArray::type_info(), "::,32:,:,:,,"),
        ("/csi5300_tb3_0/factors", Text::type_info(), ":1:,1:,:,:,,"),
        ("/diagnostics", DiagnosticArray::type_info(), "::,32:,:,:,,"),
        ("/tf", TFMessage::type_info(), "::,32:,:,:,,"),
    ];
    let read = ["/tb3_0/odom", "/tb3_1/odom"].map(|topic| (topic, Odometry::type_info(), "2::,64:,:,:,,"));
    shows(node, EndpointKind::Publisher, &published)?;
    shows(node, EndpointKind::Subscription, &read)
}

fn main() -> Result<()> {
    let mut words = std::env::args().skip(1);
    let (program, folder) = words.next().zip(words.next()).ok_or("PROGRAM FOLDER")?;
    let port = std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let (endpoint, domain) = (format!("tcp/127.0.0.1:{port}"), 10 + std::process::id() as usize % 90);
    let config = format!("{folder}/robot.toml");
    let text = std::fs::read_to_string(&config)? + "[team]\n[network]\nros2 = true\n";
    std::fs::write(&config, format!("{text}connect = [\"{endpoint}\"]\n"))?;
    let _router = zenoh::open(RouterConfigBuilder::new().with_listen_endpoint(&endpoint).build_config()?).wait()?;
    let context = ZContextBuilder::default().with_mode("client").with_connect_endpoints([endpoint]);
    let node = context.with_domain_id(domain).build()?.create_node("hiroz").build()?;
    for circle in CIRCLES {
        let publisher = node.create_pub::<Odometry>(&format!("/{}/odom", circle.0)).build()?;
        std::thread::spawn(move || {
            while publisher.publish(&odometry(circle)).is_ok() {
                std::thread::sleep(Duration::from_millis(20));
            }
        });
    }
    let mut asked = Command::new(program);
    asked.args(["node", "--config", &config]).stdin(Stdio::null()).stdout(Stdio::null());
    asked.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF");
    let running = Running(asked.spawn()?);
    check(&node)?;
    drop(running);
    shows(&node, EndpointKind::Publisher, &[])
}
