//! The robots' network, through zenoh: this robot's records and poses published, its peers' taken.
//!
//! Keys are `csi5300/<group>/<mac>/records` and `.../poses`. Discovery, reconnection, routing, encryption and access are
//! zenoh's, by its own configuration file.

mod access;
mod topics;

use super::{Adapter, Made, Robot, Start};
use crate::config::{Config, Network as Asked, Odometry, Peer, Records};
use crate::health::{Alarm, Health};
use crate::machine::{Machine, Tap};
use crate::refused;
use crate::threads::spawn;
use access::{Doors, LOCAL, Owner, Verdict, access_control, key_of};
use csi5300::motion::pose::Pose;
use csi5300::source::remote::{Batch, Mailbox};
use csi5300::source::{Error, Next};
use csi5300::time::Instant;
use csi5300_ros2::rmw_zenoh::{Graph, Relay};
use driver_iface::Mac;
use driver_iface::record::Record;
use serde_json::{Value, json};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::Notify;
use topics::{Topics, keys_read};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};

/// Limit of items that wait for the network; further ones are lost and counted.
const BACKLOG: usize = 4_096;
/// A message is sent when it has this length.
const MESSAGE_BYTES: usize = 32 * 1024;
/// A message is sent at the latest this long after its first item, so that threads wake for messages, not for records.
const HAND_OVER: Duration = Duration::from_millis(4);
/// Interval of checks for the end while nothing comes.
const STOP_LOOK: Duration = Duration::from_millis(50);
/// Zenoh's queue for each neighbour, batches of 64 KiB, at its maximum: with the default, items that waited for a first
/// reader would be dropped. Unused memory is not allocated.
const QUEUE: &str = "16";
const ZENOH_QUEUE: &str = "2";
/// Checks for a first reader, and the time between them.
const FIRST_LOOKS: u32 = 200;
const FIRST_LOOK: Duration = Duration::from_millis(5);
/// Limit of messages after a request to stop: more than can wait.
const LAST_MESSAGES: usize = 256;
/// Bytes of the file of users that are read: enough to see whether it has any.
const USERS_BYTES: u64 = 1 << 16;
/// Items between two checks for the end.
const ITEMS_AT_ONCE: usize = 1_024;

/// The network, once joined.
struct Zenoh {
    config: Config,
    wake: Arc<Notify>,
    /// The topics of ROS 2, if they go over the network too.
    topics: Option<Relay>,
    network: Option<Network>,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let (config, wake) = (start.config, Arc::clone(&start.wake));
    let Some(network) = &config.network else { return Ok(None) };
    let topics = start.topics.get().filter(|_| network.ros2).cloned();
    Ok(Some(Box::new(Zenoh { config: config.clone(), wake, topics, network: None })))
}

/// Why the network cannot be joined.
pub(crate) fn refusal(config: &Config) -> Option<String> {
    let network = config.network.as_ref().filter(|network| network.zenoh.as_ref().is_none_or(|file| file.is_file()))?;
    let peers = config.peer.iter().map(|peer| peer.get_ref());
    let owners: Vec<Owner> = peers.filter_map(|peer| Some(owner(peer, peer.mac?))).collect();
    configured(network, &owners, None).err().map(|error| error.to_string())
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
        for (number, (peer, (_, mac))) in peers().enumerate() {
            let records = matches!(peer.records, Records::Network(_)).then_some("records");
            let poses = matches!(peer.poses, Odometry::Network(_)).then_some("poses");
            for what in records.into_iter().chain(poses) {
                let wake = Arc::clone(&self.wake);
                network.subscribe((number, *mac), what, move || wake.notify_one())?;
            }
        }
        Ok(())
    }

    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        let Some(network) = &self.network else { return Ok(()) };
        for Subscription { peer, what, mailbox, .. } in &network.subscriptions {
            match *what {
                "records" => machine.set_records(*peer, Box::new(mailbox.card())),
                _ => machine.set_poses(*peer, Box::new(mailbox.poses())),
            }
        }
        if let Some(tap) = network.tap() {
            machine.add_tap(tap);
        }
        Ok(())
    }

    fn look(&mut self, health: &mut Health) {
        let Some(network) = &mut self.network else { return };
        let now = Instant::from_us((health.uptime_s * 1e6) as i64);
        let mut counted = Vec::new();
        for own in &mut network.subscriptions {
            let (mac, counts) = (&own.mac, own.mailbox.counts());
            if own.contested.is_on(counts.contested, now) {
                let count = counts.contested;
                health
                    .trouble
                    .push(format!("network: {count} messages of a second sender under the address {mac} were refused"));
            }
            counted.push((mac.clone(), own.what, counts));
        }
        // Records, poses and messages of ROS 2 that were not sent because too many waited.
        let unsent = network.unsent.load(Ordering::Relaxed);
        health.network = Some(json!({ "unsent": unsent, "subscriptions": counted }));
    }
}

/// An item to publish, with its number. Dropped items have numbers too.
enum Item {
    Record(u64, Option<i64>, u8, Vec<u8>),
    /// With the number of its frame.
    Pose(u64, u64, Pose),
}

/// The network. Dropping it leaves the network, which must happen outside of an async runtime: zenoh waits for its own.
struct Network {
    session: zenoh::Session,
    prefix: String,
    backlog: usize,
    subscriptions: Vec<Subscription>,
    publisher: Option<(SyncSender<Item>, JoinHandle<()>)>,
    topics: Option<Topics>,
    unsent: Arc<AtomicU64>,
    /// The publisher sends the waiting items, and ends.
    stop: Arc<AtomicBool>,
    publishes: (bool, bool),
}

/// A queue of a peer's `records` or `poses`.
struct Subscription {
    /// The peer's number.
    peer: usize,
    mac: String,
    what: &'static str,
    mailbox: Mailbox,
    /// Of a second sender: a robot that restarts at once is one for a second.
    contested: Alarm,
    _subscriber: Subscriber<()>,
}

fn wrong(what: &str) -> impl Fn(zenoh::Error) -> Error + '_ {
    move |error| refused(format!("{what}: {error}"))
}

/// The prefix of a group's keys.
fn prefix_of(asked: &Asked) -> String {
    format!("csi5300/{}", asked.group())
}

/// Whether a name is a plain key of zenoh, not a pattern.
fn is_plain(group: &str) -> bool {
    group.chars().all(|letter| letter.is_alphanumeric() || ['-', '_', '.'].contains(&letter))
}

/// Zenoh's configuration with our endpoints and owners, and the keys read for ROS 2, without unauthenticated access.
fn configured(asked: &Asked, owners: &[Owner], ros2: Option<&[String]>) -> Result<zenoh::Config, Error> {
    if !is_plain(&asked.group) {
        return Err(refused(format!("[network] group {:?}: letters, digits, `-`, `_` and `.` only", asked.group)));
    }
    let mut config = match &asked.zenoh {
        Some(file) => zenoh::Config::from_file(file).map_err(wrong("zenoh's configuration"))?,
        None => zenoh::Config::default(),
    };
    for (key, endpoints) in [("connect/endpoints", &asked.connect), ("listen/endpoints", &asked.listen)] {
        if !endpoints.is_empty() {
            let list = serde_json::to_string(endpoints).unwrap_or_default();
            config.insert_json5(key, &list).map_err(wrong("an endpoint of [network]"))?;
        }
    }
    let doors = doors(&config);
    if let Some(rules) = access_control(&prefix_of(asked), owners, ros2) {
        if !doors.has_certificates {
            return Err(refused(
                "a peer's `certificate` needs a network where both ends show one: TLS with `enable_mtls` in zenoh's file \
                 (`network.zenoh`), as in packaging/zenoh-tls.json5",
            ));
        }
        if doors.has_rules {
            return Err(refused(
                "zenoh's file (`network.zenoh`) has an `access_control` of its own: leave out that, or the peers' \
                 `certificate`, of which one is made",
            ));
        }
        config.insert_json5("access_control", &rules.to_string()).map_err(wrong("`certificate` of a peer"))?;
    }
    if asked.insecure {
        return Ok(config);
    }
    if let Some(path) = &doors.users {
        has_users(path)?;
    }
    match doors.judge() {
        Verdict::Good => {}
        Verdict::Open(endpoint) => {
            return Err(refused(format!(
                "anybody who reaches {endpoint} could publish as any robot: ask for a password or a certificate in zenoh's \
                 file (`network.zenoh`), listen on 127.0.0.1, or say `insecure = true` in [network]"
            )));
        }
        Verdict::KeepLocal => {
            if doors.listen.is_none() {
                let local = serde_json::to_string(&[LOCAL]).unwrap_or_default();
                config.insert_json5("listen/endpoints", &local).map_err(wrong("an endpoint of this machine"))?;
            }
            // Discovered programs are not authenticated.
            config.insert_json5("scouting/multicast/enabled", "false").map_err(wrong("zenoh's discovery"))?;
        }
    }
    Ok(config)
}

/// What of a configuration decides who takes part.
fn doors(config: &zenoh::Config) -> Doors {
    let value = |config: &zenoh::Config, key: &str| {
        config.get_json(key).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok()).unwrap_or_default()
    };
    let (listen, usual) = (value(config, "listen/endpoints"), value(&zenoh::Config::default(), "listen/endpoints"));
    let connect = endpoints(&value(config, "connect/endpoints"));
    let users = value(config, "transport/auth/usrpwd/dictionary_file");
    let is_on = |key: &str| value(config, key) == Value::Bool(true);
    Doors {
        listen: (listen != usual).then(|| endpoints(&listen)),
        connect,
        users: users.as_str().filter(|file| !file.is_empty()).map(PathBuf::from),
        has_certificates: is_on("transport/link/tls/enable_mtls"),
        has_rules: is_on("access_control/enabled"),
    }
}

/// Refuses a file without users: zenoh would then ask for no password.
fn has_users(path: &Path) -> Result<(), Error> {
    let none = |why: String| {
        let path = path.display();
        refused(format!(
            "{path} names no user: a line `user:password` for each, or leave out `dictionary_file` in zenoh's file \
             (`network.zenoh`){why}"
        ))
    };
    let mut text = String::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(USERS_BYTES).read_to_string(&mut text));
    read.map_err(|error| none(format!(": {error}")))?;
    if text.trim().is_empty() { Err(none(String::new())) } else { Ok(()) }
}

/// Every endpoint in a list, or in the lists of each mode.
fn endpoints(value: &Value) -> Vec<String> {
    match value {
        Value::String(endpoint) => vec![endpoint.clone()],
        Value::Array(list) => list.iter().flat_map(endpoints).collect(),
        Value::Object(modes) => modes.values().flat_map(endpoints).collect(),
        _ => Vec::new(),
    }
}

impl Network {
    /// Joins, and carries the topics of `ros2`. Call it outside of an async runtime: zenoh has its own.
    fn join(asked: &Asked, own: Mac, owners: &[Owner], ros2: Option<Graph>) -> Result<Self, Error> {
        let keys = ros2.as_ref().map(keys_read);
        let mut config = configured(asked, owners, keys.as_deref())?;
        // Records and poses; messages of ROS 2.
        for queue in ["transport/link/tx/queue/size/real_time", "transport/link/tx/queue/size/data"] {
            if config.get_json(queue).is_ok_and(|size| size == ZENOH_QUEUE) {
                config.insert_json5(queue, QUEUE).map_err(wrong("zenoh's queue"))?;
            }
        }
        let session = zenoh::open(config).wait().map_err(wrong("joining the network"))?;
        let mut network = Self {
            session,
            prefix: prefix_of(asked),
            backlog: asked.backlog.unwrap_or(BACKLOG),
            subscriptions: Vec::new(),
            publisher: None,
            topics: None,
            unsent: Arc::default(),
            stop: Arc::default(),
            publishes: (asked.publish_records, asked.publish_poses),
        };
        if asked.publish_records || asked.publish_poses {
            network.publish(own)?;
        }
        if let Some(graph) = ros2 {
            let topics = Topics::carry(&network.session, graph, &network.unsent);
            network.topics = Some(topics.map_err(wrong("the topics of ROS 2"))?);
        }
        Ok(network)
    }

    fn publish(&mut self, own: Mac) -> Result<(), Error> {
        let (items, waiting) = sync_channel(self.backlog);
        // Does not wait for a slow peer: items that do not fit are dropped, and the peer misses their numbers.
        let publisher = |what: &str| {
            let key = format!("{}/{}/{what}", self.prefix, key_of(own));
            let declared = self.session.declare_publisher(key).congestion_control(CongestionControl::Drop);
            declared.priority(Priority::RealTime).express(true).wait().map_err(wrong("declaring a publisher"))
        };
        let (records, poses) = (publisher("records")?, publisher("poses")?);
        // Changes at each start, so that peers notice restarted numbers.
        let session = csi5300_live::wait::wall_us().unwrap_or(0) as u32 ^ std::process::id();
        let stop = Arc::clone(&self.stop);
        let (publishes_records, publishes_poses) = self.publishes;
        let send = move || {
            let is_read = |publisher: &zenoh::pubsub::Publisher<'_>| {
                publisher.matching_status().wait().is_ok_and(|status| status.matching())
            };
            wait_for_reader(&stop, || (publishes_records && is_read(&records)) || (publishes_poses && is_read(&poses)));
            let send_records = |message| drop(records.put::<Vec<u8>>(message).wait());
            let send_poses = |message| drop(poses.put::<Vec<u8>>(message).wait());
            work(&waiting, session, &stop, send_records, send_poses);
        };
        let thread = spawn("csi5300 network", "cannot start the thread of the network", send)?;
        self.publisher = Some((items, thread));
        Ok(())
    }

    /// The receiver of every record and pose of this robot, if anything is published.
    fn tap(&self) -> Option<Box<dyn Tap>> {
        let (items, _) = self.publisher.as_ref()?;
        Some(Box::new(Published::new(items.clone(), Arc::clone(&self.unsent), self.publishes)))
    }

    /// Takes a peer's `records` or `poses`; `wake` is called for each arrival.
    fn subscribe(
        &mut self,
        (peer, mac): (usize, Mac),
        what: &'static str,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<(), Error> {
        let mailbox = Mailbox::new(self.backlog);
        let (inside, clock) = (mailbox.clone(), csi5300_live::wait::Monotonic::new());
        let key = format!("{}/{}/{what}", self.prefix, key_of(mac));
        let take = move |sample: zenoh::sample::Sample| {
            inside.put_at(clock.now(), &sample.payload().to_bytes());
            wake();
        };
        let subscriber = self.session.declare_subscriber(key).callback(take).wait();
        let subscriber = subscriber.map_err(wrong("subscribing to a peer"))?;
        let (mac, contested) = (mac.to_string(), Alarm::default());
        self.subscriptions.push(Subscription { peer, mac, what, mailbox, contested, _subscriber: subscriber });
        Ok(())
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some((items, thread)) = self.publisher.take() {
            drop(items);
            let _ = thread.join();
        }
        drop(self.topics.take());
        let _ = self.session.close().wait();
    }
}

/// Waits at most a second for the first reader: earlier items would reach nobody, although the robots' programs find
/// each other in some milliseconds.
fn wait_for_reader(stop: &AtomicBool, is_read: impl Fn() -> bool) {
    for _ in 0..FIRST_LOOKS {
        if is_read() || stop.load(Ordering::Relaxed) {
            break;
        }
        std::thread::sleep(FIRST_LOOK);
    }
}

/// Collects items into messages, and sends them.
fn work(
    waiting: &Receiver<Item>,
    session: u32,
    stop: &AtomicBool,
    send_records: impl Fn(Vec<u8>),
    send_poses: impl Fn(Vec<u8>),
) {
    let (mut records, mut poses) = (Batch::records(session), Batch::poses(session));
    // Adds to its message; sends the message first if the number does not continue it.
    let collect = |item, records: &mut Batch, poses: &mut Batch| match item {
        Item::Record(number, host_us, code, body) => {
            records.number(number).into_iter().for_each(&send_records);
            records.push_record(host_us, Record { code, body: &body });
        }
        Item::Pose(number, frame, pose) => {
            poses.number(number).into_iter().for_each(&send_poses);
            poses.push_pose(frame, pose);
        }
    };
    let (mut left, mut behind) = (LAST_MESSAGES, false);
    while left > 0 {
        // After a request to stop it sends only waiting items: a running tap does not keep it alive.
        let stopping = stop.load(Ordering::Relaxed);
        left -= usize::from(stopping);
        match waiting.recv_timeout(if stopping { Duration::ZERO } else { STOP_LOOK }) {
            Ok(item) => collect(item, &mut records, &mut poses),
            Err(RecvTimeoutError::Timeout) if !stopping => continue,
            Err(_) => break,
        }
        if !stopping && !behind {
            std::thread::sleep(HAND_OVER);
        }
        // Sends waiting items, up to a limit: new ones may come as fast.
        behind = true;
        for _ in 0..ITEMS_AT_ONCE {
            if records.len() >= MESSAGE_BYTES || poses.len() >= MESSAGE_BYTES {
                break;
            }
            let Ok(item) = waiting.try_recv() else {
                behind = false;
                break;
            };
            collect(item, &mut records, &mut poses);
        }
        for (batch, send) in [(&mut records, &send_records as &dyn Fn(Vec<u8>)), (&mut poses, &send_poses)] {
            if !batch.is_empty() {
                send(batch.take());
            }
        }
    }
}

/// Hands items to the network's thread without waiting.
struct Published {
    items: SyncSender<Item>,
    unsent: Arc<AtomicU64>,
    records: bool,
    poses: bool,
    /// Numbers of the next record, the next pose, and the frame.
    next: (u64, u64, u64),
}

impl Published {
    fn new(items: SyncSender<Item>, unsent: Arc<AtomicU64>, (records, poses): (bool, bool)) -> Self {
        Self { items, unsent, records, poses, next: (0, 0, 0) }
    }

    fn send(&self, item: Item) {
        if self.items.try_send(item).is_err() {
            self.unsent.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Tap for Published {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        if self.records
            && let Next::Record(stamps, record) = next
        {
            self.send(Item::Record(self.next.0, stamps.host_us, record.code, record.body.to_vec()));
            self.next.0 += 1;
        }
    }

    fn pose(&mut self, pose: Option<Pose>) {
        match pose {
            Some(pose) if self.poses => {
                self.send(Item::Pose(self.next.1, self.next.2, pose));
                self.next.1 += 1;
            }
            Some(_) => {}
            None => self.next.2 += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::source::Stamps;
    use std::cell::{Cell, RefCell};

    #[test]
    fn a_network_without_authentication_is_not_closed() {
        let folder = std::env::temp_dir().join(format!("csi5300-network-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let refused = |zenoh: &str, users: &str, group: &str| {
            std::fs::write(folder.join("users"), users).unwrap();
            let zenoh = zenoh.replace("FOLDER", &folder.display().to_string());
            std::fs::write(folder.join("zenoh.json5"), zenoh).unwrap();
            let asked = Asked { zenoh: Some(folder.join("zenoh.json5")), group: group.into(), ..Asked::default() };
            configured(&asked, &[], None).err().map(|error| error.to_string()).unwrap_or_default()
        };
        let with = |file: &str| {
            r#"{listen:{endpoints:["tcp/0.0.0.0:7447"]},transport:{auth:{usrpwd:{dictionary_file:"FOLDER/FILE"}}}}"#
                .replace("FILE", file)
        };
        assert_eq!(refused(&with("users"), "burger-1:secret\n", "lab"), "");
        assert!(refused(&with("users"), " \n\n", "lab").contains("users names no user"));
        assert!(refused(&with("none"), "burger-1:secret\n", "lab").contains("none names no user"));
        let tls = |settings: &str| {
            r#"{listen:{endpoints:["tls/0.0.0.0:7448SETTINGS"]},transport:{link:{tls:{enable_mtls:true}}}}"#
                .replace("SETTINGS", settings)
        };
        assert_eq!(refused(&tls("#iface=lo"), "", "lab"), "");
        let without = refused(&tls("#iface=lo;enable_mtls=false"), "", "lab");
        assert!(without.contains("anybody who reaches tls/0.0.0.0:7448"), "{without}");
        for group in ["**", "a/b", "a*", "a#b", "a b"] {
            assert!(refused(&with("users"), "burger-1:secret\n", group).contains("group"), "{group}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_publisher_ends_although_items_keep_coming() {
        let (items, waiting) = sync_channel(10);
        let send = || drop(items.try_send(Item::Record(0, None, 0xBB, vec![1])));
        (0..3).for_each(|_| send());
        let sent = Cell::new(0);
        let take = |message: Vec<u8>| {
            sent.set(sent.get() + usize::from(!message.is_empty()));
            send();
        };
        work(&waiting, 7, &AtomicBool::new(true), take, |_| {});
        assert!(sent.get() >= LAST_MESSAGES, "{}", sent.get());
        work(&waiting, 7, &AtomicBool::new(true), |_| {}, |_| {});
        assert!(waiting.try_recv().is_err(), "what waited was sent");
    }

    #[test]
    fn dropped_items_are_missed_by_the_peers() {
        let (items, waiting) = sync_channel(2);
        let unsent = Arc::new(AtomicU64::new(0));
        let tap = RefCell::new(Published::new(items, Arc::clone(&unsent), (true, false)));
        let offer =
            || tap.borrow_mut().own(Instant::ZERO, &Next::Record(Stamps::default(), Record { code: 0xBB, body: &[1] }));
        (0..5).for_each(|_| offer());
        let (mailbox, first) = (Mailbox::new(100), Cell::new(true));
        let send = |message: Vec<u8>| {
            mailbox.put(&message);
            if first.replace(false) {
                offer();
            }
        };
        work(&waiting, 7, &AtomicBool::new(true), send, |_| {});
        let counts = mailbox.counts();
        assert_eq!((counts.received, counts.missing, unsent.load(Ordering::Relaxed)), (3, 3, 3));
    }
}
