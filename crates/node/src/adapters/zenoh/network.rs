//! The robots' network: this robot's records and poses published, its peers' taken, through zenoh.
//!
//! Keys are `csi5300/<group>/<mac>/records` and `.../poses`. Discovery, reconnection, routing, encryption and access are
//! zenoh's, by its own configuration file.

use super::exposure::{Doors, LOCAL, Verdict};
use super::owners::{Owner, access_control, key_of};
use super::topics::{Topics, keys_read};
use crate::NodeError;
use crate::config::Network as Asked;
use crate::machine::Tap;
use csi5300::motion::pose::Pose;
use csi5300::source::Error;
use csi5300::source::remote::{Batch, Mailbox, QueueCounts};
use csi5300_ros2::rmw_zenoh::Graph;
use driver_iface::Mac;
use driver_iface::record::Record;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use zenoh::Wait;
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

/// An item to publish, with its number. Dropped items have numbers too.
enum Item {
    Record(u64, Option<i64>, u8, Vec<u8>),
    /// With the number of its frame.
    Pose(u64, u64, Pose),
}

/// The network. Dropping it leaves the network, which must happen outside of an async runtime: zenoh waits for its own.
pub struct Network {
    session: zenoh::Session,
    prefix: String,
    backlog: usize,
    subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
    mailboxes: Vec<(String, &'static str, Mailbox)>,
    publisher: Option<(SyncSender<Item>, JoinHandle<()>)>,
    topics: Option<Topics>,
    unsent: Arc<AtomicU64>,
    /// The publisher sends the waiting items, and ends.
    stop: Arc<AtomicBool>,
    publishes: (bool, bool),
}

fn wrong(what: &str) -> impl Fn(zenoh::Error) -> Error + '_ {
    move |error| Error::Backend(format!("{what}: {error}").into())
}

/// The prefix of a group's keys.
fn prefix_of(asked: &Asked) -> String {
    format!("csi5300/{}", if asked.group.is_empty() { "robots" } else { &asked.group })
}

/// Whether a name is a plain key of zenoh, not a pattern.
fn is_plain(group: &str) -> bool {
    group.chars().all(|letter| letter.is_alphanumeric() || ['-', '_', '.'].contains(&letter))
}

/// Zenoh's configuration with our endpoints and owners, and the keys read for ROS 2, without unauthenticated access.
fn configured(asked: &Asked, owners: &[Owner], ros2: Option<&[String]>) -> Result<zenoh::Config, Error> {
    if !is_plain(&asked.group) {
        return Err(NodeError::GroupName { group: asked.group.clone() }.into());
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
            return Err(NodeError::NoCertificates.into());
        }
        if doors.has_rules {
            return Err(NodeError::TwoAccessControls.into());
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
        Verdict::Open(endpoint) => return Err(NodeError::OpenNetwork { endpoint }.into()),
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
        config
            .get_json(key)
            .ok()
            .and_then(|text| serde_json::from_str::<serde_json::Value>(&text).ok())
            .unwrap_or_default()
    };
    let (listen, usual) = (value(config, "listen/endpoints"), value(&zenoh::Config::default(), "listen/endpoints"));
    let connect = endpoints(&value(config, "connect/endpoints"));
    let users = value(config, "transport/auth/usrpwd/dictionary_file");
    let is_on = |key: &str| value(config, key) == serde_json::Value::Bool(true);
    Doors {
        listen: (listen != usual).then(|| endpoints(&listen)),
        connect,
        users: users.as_str().filter(|file| !file.is_empty()).map(PathBuf::from),
        has_certificates: is_on("transport/link/tls/enable_mtls"),
        has_rules: is_on("access_control/enabled"),
    }
}

/// Refuses a file without users: zenoh would then ask for no password.
fn has_users(path: &Path) -> Result<(), NodeError> {
    let none = |source| NodeError::NoUsers { path: path.to_owned(), source };
    let file = std::fs::File::open(path).map_err(|error| none(Some(error)))?;
    let mut text = String::new();
    file.take(USERS_BYTES).read_to_string(&mut text).map_err(|error| none(Some(error)))?;
    if text.trim().is_empty() { Err(none(None)) } else { Ok(()) }
}

/// Every endpoint in a list, or in the lists of each mode.
fn endpoints(value: &serde_json::Value) -> Vec<String> {
    match value {
        serde_json::Value::String(endpoint) => vec![endpoint.clone()],
        serde_json::Value::Array(list) => list.iter().flat_map(endpoints).collect(),
        serde_json::Value::Object(modes) => modes.values().flat_map(endpoints).collect(),
        _ => Vec::new(),
    }
}

/// Why this network cannot be joined, for `--check`.
pub(crate) fn refusal(asked: &Asked, owners: &[Owner]) -> Option<String> {
    configured(asked, owners, None).err().map(|error| error.to_string())
}

impl Network {
    /// Joins, and carries the topics of `ros2`. Call it outside of an async runtime: zenoh has its own.
    ///
    /// # Errors
    /// If zenoh refuses its configuration or cannot listen, or `owners` have certificates that nobody is asked for.
    pub fn join(asked: &Asked, own: Mac, owners: &[Owner], ros2: Option<Graph>) -> Result<Self, Error> {
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
            subscribers: Vec::new(),
            mailboxes: Vec::new(),
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
        let thread = std::thread::Builder::new().name("csi5300 network".into()).spawn(send);
        let what = "cannot start the thread of the network".into();
        self.publisher = Some((items, thread.map_err(|source| Error::Io { what, source })?));
        Ok(())
    }

    /// The receiver of every record and pose of this robot, if anything is published.
    #[must_use]
    pub fn tap(&self) -> Option<Box<dyn Tap>> {
        let (items, _) = self.publisher.as_ref()?;
        Some(Box::new(Published::new(items.clone(), Arc::clone(&self.unsent), self.publishes)))
    }

    /// A queue of a peer's `records` or `poses`; `wake` is called for each arrival.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe(
        &mut self,
        peer: Mac,
        what: &'static str,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Mailbox, Error> {
        let mailbox = Mailbox::new(self.backlog);
        let (inside, clock) = (mailbox.clone(), csi5300_live::wait::Monotonic::new());
        let key = format!("{}/{}/{what}", self.prefix, key_of(peer));
        let take = move |sample: zenoh::sample::Sample| {
            inside.put_at(clock.now(), &sample.payload().to_bytes());
            wake();
        };
        let subscriber = self.session.declare_subscriber(key).callback(take).wait();
        self.subscribers.push(subscriber.map_err(wrong("subscribing to a peer"))?);
        self.mailboxes.push((peer.to_string(), what, mailbox.clone()));
        Ok(mailbox)
    }

    /// Messages of second senders under the address of a peer, by peer.
    pub fn contested(&self) -> impl Iterator<Item = (&str, u64)> {
        self.mailboxes.iter().map(|(mac, _, mailbox)| (mac.as_str(), mailbox.counts().contested))
    }

    /// The counts so far.
    #[must_use]
    pub fn counts(&self) -> NetworkCounts {
        let counted = self.mailboxes.iter().map(|(mac, what, mailbox)| (mac.clone(), *what, mailbox.counts()));
        NetworkCounts { unsent: self.unsent.load(Ordering::Relaxed), subscriptions: counted.collect() }
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

/// Items between two checks for the end.
const ITEMS_AT_ONCE: usize = 1_024;

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
    fn record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        if self.records {
            self.send(Item::Record(self.next.0, host_us, record.code, record.body.to_vec()));
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

/// Counts of the network by peer.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct NetworkCounts {
    /// Records, poses and messages of ROS 2 that were not sent because too many waited.
    pub unsent: u64,
    /// Peers' MACs, their outputs, and the counts.
    pub subscriptions: Vec<(String, &'static str, QueueCounts)>,
}

#[cfg(test)]
mod tests;
