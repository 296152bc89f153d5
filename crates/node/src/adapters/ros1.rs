//! ROS 1 through rospy: a bridge in Python (`packaging/ros1/bridge.py`, embedded in this program) that is a node of the
//! master and exchanges lines of JSON. A library for ROS 1 would need three hundred crates and OpenSSL; machines with a
//! master have rospy.

use super::{Adapter, Made, Robot, Said, Start, mislabelled};
use crate::config::{Config, Odometry, Ros};
use crate::diagnostics::Claims;
use crate::health::Health;
use crate::lock;
use crate::machine::{Machine, Tap};
use crate::sources::Poses;
use csi5300::motion::odometry::ros::{Inbox, Kind, Message, Stamp, Wanted};
use csi5300::source::survey::Survey;
use csi5300::source::{Error, Next};
use csi5300::time::Instant;
use csi5300_bag::messages::{Csi, Header, SelfTestResponse, Time};
use csi5300_live::wait::wall_us;
use csi5300_ros2::{name_part, said};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// The bridge.
const BRIDGE: &str = include_str!("../../../../packaging/ros1/bridge.py");
/// Its messages with their definitions.
const BEARING: &str = include_str!("../../../../packaging/ros/csi5300_msgs/msg/Bearing.msg");
const CSI: &str = include_str!("../../../../packaging/ros/csi5300_msgs/msg/Csi.msg");
const HEADER: &str = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
/// Those of `diagnostic_msgs`, which a bare rospy lacks.
const DIAGNOSTICS: &str = "Header header\nDiagnosticStatus[] status\n";
const SELF_TEST: &str = "string id\nbyte passed\nDiagnosticStatus[] status\n";
const STATUS: &str = "MSG: diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n\
    byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values\n";
const KEY_VALUE: &str = "MSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n";
/// Pythons that may have rospy: Noetic's and Debian's, then Melodic's.
const PYTHONS: [&str; 3] = ["python3", "python2", "python"];

/// Limit of lines that wait for the bridge; further ones are lost and counted.
const QUEUE: usize = 1_024;
/// Limit of waiting service calls; further ones get no answer.
const CALLS: usize = 4;
/// Bytes of a line of the bridge at most.
const LINE: u64 = 1 << 16;
/// Pause before a bridge is restarted, and checks for the end within it.
const RETRY: Duration = Duration::from_millis(50);
const RETRIES: u32 = 20;
/// Checks for the end of a bridge, and the time between them.
const FAREWELLS: u32 = 100;
const FAREWELL: Duration = Duration::from_millis(20);

pub(super) fn make(start: &Start<'_>) -> Made {
    let config = start.config;
    if !config.uses_ros() {
        return Ok(None);
    }
    let settings = config.ros.clone().unwrap_or_default();
    Ok(Some(Box::new(Ros1 {
        node: settings.node(config),
        settings,
        publishes: config.ros.is_some(),
        config: config.clone(),
        claims: None,
        reads: Vec::new(),
        writes: Vec::new(),
        csi: 0,
        diagnostics: 0,
        peers: 0,
        commands: PYTHONS.map(|python| [python, "-c", BRIDGE].map(str::to_owned).to_vec()).to_vec(),
        bridge: None,
    })))
}

/// This program as a node of ROS 1.
struct Ros1 {
    settings: Ros,
    publishes: bool,
    /// The input of the claims.
    config: Config,
    /// Nothing without a table `[ros]`.
    claims: Option<Arc<Claims>>,
    /// Its name.
    node: String,
    reads: Vec<(Inbox, Kind)>,
    /// Topics that are written, and their types.
    writes: Vec<(String, &'static str)>,
    /// The places of CSI and of the diagnostics in `writes`.
    csi: usize,
    diagnostics: usize,
    /// How many have topics of their own: the first ones of `writes`.
    peers: usize,
    /// Bridges that are tried, one after the other.
    commands: Vec<Vec<String>>,
    bridge: Option<Bridge>,
}

fn type_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Odometry => "nav_msgs/Odometry",
        Kind::Pose => "geometry_msgs/PoseStamped",
    }
}

impl Ros1 {
    /// The first line to the bridge.
    fn settings_line(&self) -> String {
        let topic = |topic: &str, kind: &str| json!({ "topic": topic, "type": kind });
        let reads: Vec<Value> = self.reads.iter().map(|(inbox, kind)| topic(inbox.topic(), type_name(*kind))).collect();
        let writes: Vec<Value> = self.writes.iter().map(|(name, kind)| topic(name, kind)).collect();
        let with = |texts: &[&str]| texts.join(&format!("\n{}\n", "=".repeat(80)));
        let definitions = json!({
            "csi5300_msgs/Bearing": with(&[BEARING, HEADER]),
            "csi5300_msgs/Csi": with(&[CSI, HEADER]),
            "diagnostic_msgs/DiagnosticArray": with(&[DIAGNOSTICS, HEADER, STATUS, KEY_VALUE]),
            "diagnostic_msgs/SelfTestResponse": with(&[SELF_TEST, STATUS, KEY_VALUE]),
        });
        let told = json!({ "master": self.settings.master(), "node": self.node, "read": reads, "write": writes,
            "serves": self.publishes, "definitions": definitions });
        format!("{told}\n")
    }
}

impl Adapter for Ros1 {
    fn poses(&mut self, odometry: &Odometry, usual: Stamp) -> Option<Poses> {
        let Odometry::Ros(topic) = odometry else { return None };
        let wanted = Wanted { stamp: topic.stamp.unwrap_or(usual), frame: topic.frame.clone() };
        let inbox = Inbox::new(&topic.topic, wanted);
        let source = inbox.source();
        self.reads.push((inbox, topic.kind));
        Some(Box::new(source))
    }

    fn meet(&mut self, robot: &Robot) -> Result<(), Error> {
        if self.publishes && self.settings.publish_bearings {
            self.peers = robot.peers.len();
            for (name, _) in &robot.peers {
                let topic = format!("{}/{}", self.node, name_part(name));
                self.writes.push((format!("{topic}/bearing"), "csi5300_msgs/Bearing"));
                self.writes.push((format!("{topic}/direction"), "geometry_msgs/PoseStamped"));
            }
        }
        if self.publishes && self.settings.publish_csi {
            self.csi = self.writes.len();
            self.writes.push((format!("{}/csi", self.node), "csi5300_msgs/Csi"));
        }
        if self.publishes {
            self.diagnostics = self.writes.len();
            self.writes.push(("/diagnostics".into(), "diagnostic_msgs/DiagnosticArray"));
            self.claims = Some(Claims::new(&self.config, robot));
        }
        let inboxes = self.reads.iter().map(|(inbox, _)| inbox.clone()).collect();
        let claims = self.claims.clone();
        let answer: Option<Answer> = claims.map(|claims| Box::new(move || claims.answer()) as Answer);
        let settings = self.settings_line();
        let bridge = Bridge::start(self.commands.clone(), settings, inboxes, self.writes.len(), answer, wall_us);
        self.bridge = Some(bridge.map_err(Error::io("cannot start the threads of ROS 1"))?);
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        if let Some(claims) = &self.claims {
            claims.attach(machine, true);
        }
        if let Some(bridge) = self.bridge.as_ref().filter(|_| self.publishes && self.settings.publish_csi) {
            let card = Card { outbox: bridge.outbox.clone(), topic: self.csi, survey: Survey::default() };
            machine.add_tap(Box::new(card));
        }
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        let Some(bridge) = self.bridge.as_ref().filter(|_| said.peer < self.peers) else { return };
        let stamp = Time::from_us((said.report.t_s.unwrap_or(0.0) * 1e6).round() as i64);
        let header = Header { stamp, frame_id: self.settings.frame.clone() };
        if let Some(pose) = said::direction(&header, said.report) {
            bridge.outbox.put(2 * said.peer + 1, &pose);
        }
        bridge.outbox.put(2 * said.peer, &said::bearing(header, said.report));
    }

    fn look(&mut self, health: &mut Health) {
        let Some(bridge) = &self.bridge else { return };
        let number = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let topic = |((name, _), [sent, lost]): (&(String, _), &[AtomicU64; 2])| {
            (name.clone(), json!({ "sent": number(sent), "lost": number(lost) }))
        };
        let published: serde_json::Map<String, Value> =
            self.writes.iter().zip(&bridge.outbox.shared.counts).map(topic).collect();
        let connections = number(&bridge.outbox.shared.connections);
        health.ros = Some(json!({ "connections": connections, "published": published }));
        health.trouble.extend(lock(&bridge.outbox.shared.trouble).clone());
        health.trouble.extend(mislabelled(health, self.publishes.then_some(("ros", &self.settings.frame))));
    }

    fn tell(&mut self, health: &Health, _: &Machine) {
        let (Some(bridge), Some(claims)) = (&self.bridge, &self.claims) else { return };
        let header = Header { stamp: Time::from_us(wall_us().unwrap_or(0)), frame_id: String::new() };
        bridge.outbox.put(self.diagnostics, &claims.diagnostics(header, health));
    }
}

/// Every record of the card, as a message.
struct Card {
    outbox: Outbox,
    topic: usize,
    survey: Survey,
}

impl Tap for Card {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        self.outbox.put(self.topic, &Csi::of(Time::from_us(identity.host_us.unwrap_or(0)), &bfee, identity));
    }
}

/// Answers a call of the service `self_test`.
type Answer = Box<dyn Fn() -> SelfTestResponse + Send>;

/// State shared by the threads of a bridge.
#[derive(Default)]
struct Shared {
    /// By topic: messages handed to the bridge while it had a master, and others.
    counts: Vec<[AtomicU64; 2]>,
    connections: AtomicU64,
    trouble: Mutex<Option<String>>,
    input: Mutex<Option<ChildStdin>>,
    child: Mutex<Option<Child>>,
    over: AtomicBool,
}

impl Shared {
    fn count(&self, topic: usize, is_lost: bool) {
        if let Some(counter) = self.counts.get(topic).and_then(|counts| counts.get(usize::from(is_lost))) {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn say(&self, connections: u64, trouble: Option<String>) {
        self.connections.store(connections, Ordering::Relaxed);
        *lock(&self.trouble) = trouble;
    }

    /// Ends the bridge after its input was closed, by force after a time limit.
    fn end(&self) {
        let Some(mut child) = lock(&self.child).take() else { return };
        for _ in 0..FAREWELLS {
            if !matches!(child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(FAREWELL);
        }
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// The queue of messages to publish.
#[derive(Clone)]
struct Outbox {
    lines: SyncSender<(usize, String)>,
    shared: Arc<Shared>,
}

impl Outbox {
    /// Hands over a message without waiting. It is lost and counted while there is no master.
    fn put(&self, topic: usize, message: &impl serde::Serialize) {
        let line = || Some(format!("{}\n", json!({ "to": topic, "message": serde_json::to_value(message).ok()? })));
        let taken = self.shared.connections.load(Ordering::Relaxed) > 0
            && line().is_some_and(|line| self.lines.try_send((topic, line)).is_ok());
        if !taken {
            self.shared.count(topic, true);
        }
    }
}

/// A bridge in a separate process, restarted when it ends. It leaves the master when this is dropped.
struct Bridge {
    outbox: Outbox,
    thread: Option<JoinHandle<()>>,
}

impl Bridge {
    /// Tries the `commands` one after the other; each gets `settings` first.
    fn start(
        commands: Vec<Vec<String>>,
        settings: String,
        inboxes: Vec<Inbox>,
        writes: usize,
        answer: Option<Answer>,
        wall_us: fn() -> Option<i64>,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            counts: (0..writes).map(|_| Default::default()).collect(),
            trouble: Mutex::new(Some("ROS 1: the bridge is being started".into())),
            ..Shared::default()
        });
        let (lines, waiting) = sync_channel(QUEUE);
        let (calls, called) = sync_channel(CALLS);
        let writing = Arc::clone(&shared);
        let named = |name: &str| std::thread::Builder::new().name(name.into());
        named("csi5300 ros out").spawn(move || write(&waiting, &writing))?;
        if let Some(answer) = answer {
            let lines = lines.clone();
            named("csi5300 ros answers").spawn(move || answer_calls(&called, &answer, &lines))?;
        }
        let working = Arc::clone(&shared);
        let hearing = Hearing { inboxes, calls, wall_us };
        let thread = named("csi5300 ros").spawn(move || work(&commands, &settings, &hearing, &working))?;
        Ok(Self { outbox: Outbox { lines, shared }, thread: Some(thread) })
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let shared = &self.outbox.shared;
        shared.over.store(true, Ordering::Relaxed);
        // The end of its input ends it, after what waits.
        if self.outbox.lines.try_send((usize::MAX, String::new())).is_err() {
            lock(&shared.input).take();
        }
        shared.end();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Writes the waiting lines to the current bridge; an empty one ends its input.
fn write(waiting: &Receiver<(usize, String)>, shared: &Shared) {
    for (topic, line) in waiting {
        if line.is_empty() {
            lock(&shared.input).take();
            return;
        }
        // Not held while writing: a bridge that reads nothing must not block its end.
        let input = lock(&shared.input).as_ref().and_then(|input| input.as_fd().try_clone_to_owned().ok());
        let written = input.is_some_and(|input| File::from(input).write_all(line.as_bytes()).is_ok());
        shared.count(topic, !written);
    }
}

/// Answers calls, one after the other. An answer without room is dropped.
fn answer_calls(called: &Receiver<u64>, answer: &Answer, lines: &SyncSender<(usize, String)>) {
    for call in called {
        // It is no message of a topic.
        let _ = lines.try_send((usize::MAX, format!("{}\n", json!({ "answer": call, "message": answer() }))));
    }
}

/// Where the lines of a bridge go.
struct Hearing {
    inboxes: Vec<Inbox>,
    calls: SyncSender<u64>,
    wall_us: fn() -> Option<i64>,
}

/// Starts bridges and reads from them until the end.
fn work(commands: &[Vec<String>], settings: &str, hearing: &Hearing, shared: &Shared) {
    for command in commands.iter().cycle() {
        let why = match spawn(command, settings, shared) {
            Ok((output, complaints)) => hear(output, complaints, hearing, shared),
            Err(error) => format!("{}: {error}", command.first().map_or("", String::as_str)),
        };
        shared.say(0, Some(format!("ROS 1: no bridge to the master, which needs rospy ({why})")));
        for _ in 0..RETRIES {
            if shared.over.load(Ordering::Relaxed) {
                return;
            }
            std::thread::sleep(RETRY);
        }
    }
}

/// Starts a bridge and sends its settings; returns its output, and the thread that keeps its last error.
fn spawn(command: &[String], settings: &str, shared: &Shared) -> std::io::Result<(ChildStdout, JoinHandle<String>)> {
    let (program, arguments) = command.split_first().ok_or(ErrorKind::InvalidInput)?;
    let pipe = Stdio::piped;
    let mut child = Command::new(program).args(arguments).stdin(pipe()).stdout(pipe()).stderr(pipe()).spawn()?;
    let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
    *lock(&shared.child) = Some(child);
    let (Some(mut input), Some(output), Some(complaints)) = pipes else { return Err(ErrorKind::BrokenPipe.into()) };
    let keep = move || {
        let mut last = String::new();
        each_line(complaints, |line| {
            let text = String::from_utf8_lossy(line).trim().to_owned();
            last = if text.is_empty() { std::mem::take(&mut last) } else { text };
        });
        last
    };
    let complaints = std::thread::Builder::new().name("csi5300 ros said".into()).spawn(keep)?;
    // If it ended at once, its last error is the reason.
    let _ = input.write_all(settings.as_bytes());
    if !shared.over.load(Ordering::Relaxed) {
        *lock(&shared.input) = Some(input);
    }
    Ok((output, complaints))
}

fn each_line(from: impl Read, mut used: impl FnMut(&[u8])) {
    let (mut from, mut line) = (BufReader::new(from), Vec::new());
    while from.by_ref().take(LINE).read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        used(&line);
        line.clear();
    }
}

/// Reads from the bridge until it ends; returns the reason.
fn hear(output: ChildStdout, complaints: JoinHandle<String>, hearing: &Hearing, shared: &Shared) -> String {
    each_line(output, |line| {
        if let Ok(told) = serde_json::from_slice::<Told>(line) {
            told.take(hearing, shared);
        }
    });
    lock(&shared.input).take();
    shared.end();
    let why = complaints.join().unwrap_or_default();
    if why.is_empty() { "it ended".into() } else { why }
}

/// A line of the bridge.
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Told {
    /// A pose.
    Pose { topic: usize, publisher: u32, stamp: (u32, u32), frame: String, position: [f64; 3], orientation: [f64; 4] },
    /// The state of the connection to the master.
    State { connections: u64, trouble: Option<String>, wrong: Option<Vec<Option<String>>> },
    /// A call of the service `self_test`.
    Asked { asked: u64 },
    /// A pose with a number that is not finite.
    Unreadable { topic: usize },
}

impl Told {
    fn take(self, hearing: &Hearing, shared: &Shared) {
        let inboxes = &hearing.inboxes;
        match self {
            // A call too many has no answer.
            Self::Asked { asked } => _ = hearing.calls.try_send(asked),
            Self::Pose { topic, publisher, stamp, frame, position: position_m, orientation } => {
                let (publisher, frame) = (publisher.into(), frame.as_str());
                let message = Message { publisher, stamp, ahead_us: 0, frame, position_m, orientation };
                let received_us = (hearing.wall_us)().unwrap_or(0);
                inboxes.get(topic).iter().for_each(|inbox| inbox.put(&message, received_us));
            }
            Self::State { connections, trouble, wrong } => {
                shared.say(connections, trouble);
                for (inbox, wrong) in inboxes.iter().zip(wrong.into_iter().flatten()) {
                    inbox.say(wrong);
                }
            }
            Self::Unreadable { topic } => inboxes.get(topic).iter().for_each(|inbox| inbox.unreadable()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::odometry::{NextPose, OdometrySource};
    use csi5300_bag::messages::PoseStamped;

    /// A bridge that is this shell script, with one topic that is read, one that is written, and the service.
    fn bridge(scripts: &[&str]) -> (Bridge, csi5300::motion::odometry::ros::Topic) {
        let commands = scripts.iter().map(|script| ["sh", "-c", script].map(str::to_owned).to_vec()).collect();
        let inbox = Inbox::new("/odom", Wanted { stamp: Stamp::Header, frame: None });
        let source = inbox.source();
        let answer: Answer = Box::new(|| SelfTestResponse { id: "burger".into(), ..SelfTestResponse::default() });
        let bridge = Bridge::start(commands, "settings\n".into(), vec![inbox], 1, Some(answer), || Some(12_000_000));
        (bridge.unwrap(), source)
    }

    fn comes(mut is_there: impl FnMut() -> bool) {
        while !is_there() {
            std::thread::yield_now();
        }
    }

    #[test]
    fn poses_come_and_messages_go_through_a_bridge_that_is_there() {
        let folder = std::env::temp_dir().join(format!("csi5300-ros1-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, gate) = (folder.join("went"), folder.join("gate"));
        nix::unistd::mkfifo(&gate, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let script = format!(
            r#"cat {}
            echo '{{"topic":0,"publisher":0,"stamp":[12,500000000],"frame":"odom","position":[1,2,0],"orientation":[0,0,0,1]}}'
            echo '{{"topic":0}}'
            echo '{{"asked":7}}'
            echo what is no line of a bridge
            echo '{{"connections":1,"trouble":null,"wrong":[null]}}'
            exec 3>&1 cat > {}"#,
            gate.display(),
            file.display()
        );
        // The first has no rospy. The second waits for the gate, and keeps its output open, as a bridge does: the end of it is
        // the end of a bridge.
        let ends = r#"echo '{"connections":3,"trouble":null,"wrong":[null]}'; echo ImportError: rospy >&2; exit 1"#;
        let (bridge, mut poses) = bridge(&[ends, &script]);
        let shared = Arc::clone(&bridge.outbox.shared);
        comes(|| lock(&shared.trouble).as_ref().is_some_and(|why| why.contains("ImportError: rospy")));
        assert_eq!(shared.connections.load(Ordering::Relaxed), 0, "a bridge that ended has none");
        bridge.outbox.put(0, &PoseStamped::default());
        drop(File::options().write(true).open(&gate).unwrap());
        comes(|| shared.connections.load(Ordering::Relaxed) > 0);
        let next = poses.receive(Instant::ZERO).unwrap();
        assert!(matches!(next, NextPose::Pose(pose) if pose.t_s == 12.5 && pose.position_m.y == 2.0), "{next:?}");
        assert_eq!(poses.receive(Instant::ZERO).unwrap(), NextPose::Pending);
        bridge.outbox.put(0, &PoseStamped::default());
        comes(|| shared.counts[0][0].load(Ordering::Relaxed) == 1);
        assert_eq!(shared.counts[0][1].load(Ordering::Relaxed), 1, "what was put before is lost");
        // The pipe takes lines before `cat` has opened its file.
        comes(|| std::fs::read_to_string(&file).unwrap_or_default().lines().count() == 3);
        // The last ones go out, too.
        (0..100).for_each(|_| bridge.outbox.put(0, &PoseStamped::default()));
        drop(bridge);
        let went = std::fs::read_to_string(&file).unwrap();
        let mut lines = went.lines();
        assert_eq!(lines.next(), Some("settings"));
        let line = |line: &str| -> Value { serde_json::from_str(line).unwrap() };
        let (answers, messages): (Vec<_>, Vec<_>) = lines.map(line).partition(|line| line["to"].is_null());
        assert_eq!((answers.len(), messages.len()), (1, 101));
        assert_eq!((&answers[0]["answer"], &answers[0]["message"]["id"]), (&json!(7), &json!("burger")));
        assert_eq!((&messages[0]["to"], &messages[0]["message"]["pose"]["orientation"]["w"]), (&json!(0), &json!(0.0)));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn written_fields_match_the_shipped_messages() {
        for (text, message) in [
            (BEARING, serde_json::to_value(csi5300_bag::messages::Bearing::default()).unwrap()),
            (CSI, serde_json::to_value(Csi::default()).unwrap()),
        ] {
            let plain = |line: &str| Some(line.split('#').next()?.split_whitespace().nth(1)?.to_owned());
            let mut fields: Vec<String> = text.lines().filter_map(plain).collect();
            let mut told: Vec<String> = message.as_object().unwrap().keys().cloned().collect();
            fields.sort();
            told.sort();
            assert_eq!(fields, told);
        }
    }
}
