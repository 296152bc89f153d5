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
use crate::threads::spawn;
use crate::{lock, refused};
use access::{Doors, LOCAL, Owner, Verdict, access_control, key_of};
use csi5300::motion::pose::Pose;
use csi5300::source::remote::{Batch, Mailbox};
use csi5300::source::{Error, Next};
use csi5300::time::Instant;
use csi5300_ros2::rmw_zenoh::{Graph, Relay};
use driver_iface::Mac;
use serde_json::{Value, json};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, Thread};
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
/// Zenoh's queue for each neighbour, batches of 64 KiB, at its maximum: with the default, items that waited for a first
/// reader would be dropped. Unused memory is not allocated.
const QUEUE: &str = "16";
const ZENOH_QUEUE: &str = "2";
/// Checks for a first reader, and the time between them.
const FIRST_LOOKS: u32 = 200;
const FIRST_LOOK: Duration = Duration::from_millis(5);
/// Bytes of the file of users that are read: enough to see whether it has any.
const USERS_BYTES: u64 = 1 << 16;

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
        if let Some((out, thread)) = &network.publisher {
            let (out, thread, unsent) = (Arc::clone(out), thread.thread().clone(), Arc::clone(&network.unsent));
            machine.add_tap(Box::new(Published { out, thread, unsent, publishes: network.publishes, frame: 0 }));
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

/// What waits for the network's thread: records, then poses.
struct Outgoing {
    lanes: [Lane; 2],
    /// Messages of a lane that are full, or before a gap.
    full: Vec<(usize, Vec<u8>)>,
    /// Items in all of these, and how many may wait.
    waiting: usize,
    limit: usize,
}

/// A message being filled, and the number of the next item. Dropped items have numbers too.
struct Lane {
    batch: Batch,
    next: u64,
}

impl Outgoing {
    fn new(session: u32, limit: usize) -> Self {
        let lanes = [Batch::records(session), Batch::poses(session)].map(|batch| Lane { batch, next: 0 });
        Self { lanes, full: Vec::new(), waiting: 0, limit }
    }

    /// Adds an item to a lane; false without room, and the peers miss its number.
    fn add(&mut self, lane: usize, push: impl FnOnce(&mut Batch)) -> bool {
        let Lane { batch, next } = &mut self.lanes[lane];
        let number = *next;
        *next += 1;
        if self.waiting >= self.limit {
            return false;
        }
        let before_gap = batch.number(number);
        push(batch);
        let full = (batch.len() >= MESSAGE_BYTES).then(|| batch.take());
        self.full.extend(before_gap.into_iter().chain(full).map(|message| (lane, message)));
        self.waiting += 1;
        true
    }

    /// All messages.
    fn take(&mut self) -> Vec<(usize, Vec<u8>)> {
        self.waiting = 0;
        let begun = self.lanes.iter_mut().enumerate().filter(|(_, lane)| !lane.batch.is_empty());
        self.full.extend(begun.map(|(number, lane)| (number, lane.batch.take())));
        std::mem::take(&mut self.full)
    }
}

/// The network. Dropping it leaves the network, which must happen outside of an async runtime: zenoh waits for its own.
struct Network {
    session: zenoh::Session,
    prefix: String,
    backlog: usize,
    subscriptions: Vec<Subscription>,
    publisher: Option<(Arc<Mutex<Outgoing>>, JoinHandle<()>)>,
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
        // Does not wait for a slow peer: items that do not fit are dropped, and the peer misses their numbers.
        let publisher = |what: &str| {
            let key = format!("{}/{}/{what}", self.prefix, key_of(own));
            let declared = self.session.declare_publisher(key).congestion_control(CongestionControl::Drop);
            declared.priority(Priority::RealTime).express(true).wait().map_err(wrong("declaring a publisher"))
        };
        let (records, poses) = (publisher("records")?, publisher("poses")?);
        // Changes at each start, so that peers notice restarted numbers.
        let session = csi5300_live::wait::wall_us().unwrap_or(0) as u32 ^ std::process::id();
        let out = Arc::new(Mutex::new(Outgoing::new(session, self.backlog)));
        let (waiting, stop, publishes) = (Arc::clone(&out), Arc::clone(&self.stop), self.publishes);
        let send = move || {
            let lanes = [records, poses];
            let is_read = |lane: usize| lanes[lane].matching_status().wait().is_ok_and(|status| status.matching());
            wait_for_reader(&stop, || (publishes.0 && is_read(0)) || (publishes.1 && is_read(1)));
            work(&waiting, &stop, |lane, message| drop(lanes[lane].put::<Vec<u8>>(message).wait()));
        };
        let thread = spawn("csi5300 network", "cannot start the thread of the network", send)?;
        self.publisher = Some((out, thread));
        Ok(())
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
        if let Some((_, thread)) = self.publisher.take() {
            thread.thread().unpark();
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

/// Sends what waits, each time that it is woken, and ends after a request to stop: a running tap does not keep it alive.
fn work(out: &Mutex<Outgoing>, stop: &AtomicBool, mut send: impl FnMut(usize, Vec<u8>)) {
    loop {
        // What wakes it may be taken by a wait inside of `send`, and is not repeated.
        while lock(out).waiting == 0 && !stop.load(Ordering::Relaxed) {
            std::thread::park();
        }
        let stopping = stop.load(Ordering::Relaxed);
        if !stopping {
            std::thread::sleep(HAND_OVER);
        }
        let messages = lock(out).take();
        messages.into_iter().for_each(|(lane, message)| send(lane, message));
        if stopping {
            return;
        }
    }
}

/// Hands items to the network's thread without waiting.
struct Published {
    out: Arc<Mutex<Outgoing>>,
    thread: Thread,
    unsent: Arc<AtomicU64>,
    /// Records and poses are published.
    publishes: (bool, bool),
    /// The number of the frame.
    frame: u64,
}

impl Published {
    fn send(&self, lane: usize, push: impl FnOnce(&mut Batch)) {
        let mut out = lock(&self.out);
        if !out.add(lane, push) {
            self.unsent.fetch_add(1, Ordering::Relaxed);
        } else if out.waiting == 1 {
            self.thread.unpark();
        }
    }
}

impl Tap for Published {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        if self.publishes.0
            && let Next::Record(stamps, record) = next
        {
            self.send(0, |batch| batch.push_record(stamps.host_us, *record));
        }
    }

    fn pose(&mut self, pose: Option<Pose>) {
        match pose {
            Some(pose) if self.publishes.1 => self.send(1, |batch| batch.push_pose(self.frame, pose)),
            Some(_) => {}
            None => self.frame += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::source::Stamps;
    use driver_iface::record::Record;

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
        let out = Mutex::new(Outgoing::new(7, 10));
        let put = || lock(&out).add(0, |batch| batch.push_record(None, Record { code: 0xBB, body: &[1] }));
        assert!(put());
        let mut sent = 0;
        for _ in 0..2 {
            std::thread::current().unpark();
            work(&out, &AtomicBool::new(true), |_, _| {
                sent += 1;
                put();
            });
        }
        assert_eq!((sent, lock(&out).waiting), (2, 1), "what waited was sent");
    }

    #[test]
    fn what_comes_while_a_message_is_sent_goes_out() {
        let (out, stop) = (Arc::new(Mutex::new(Outgoing::new(7, 10))), Arc::new(AtomicBool::new(false)));
        let (waiting, over) = (Arc::clone(&out), Arc::clone(&stop));
        let put = |out: &Mutex<Outgoing>| {
            lock(out).add(0, |batch| batch.push_record(None, Record { code: 0xBB, body: &[1] }))
        };
        assert!(put(&out));
        let (tell, told) = std::sync::mpsc::channel();
        let mut sent = 0;
        let send = move || {
            work(&waiting, &over, |_, _| {
                sent += 1;
                tell.send(sent).unwrap();
                if sent == 1 {
                    put(&waiting);
                    // A wait of zenoh's own.
                    std::thread::current().unpark();
                    std::thread::park();
                }
            });
        };
        let thread = std::thread::spawn(send);
        thread.thread().unpark();
        let next = || told.recv_timeout(Duration::from_secs(5));
        assert_eq!([next(), next()], [Ok(1), Ok(2)]);
        stop.store(true, Ordering::Relaxed);
        thread.thread().unpark();
        thread.join().unwrap();
    }

    #[test]
    fn dropped_items_are_missed_by_the_peers() {
        let (out, unsent) = (Arc::new(Mutex::new(Outgoing::new(7, 2))), Arc::new(AtomicU64::new(0)));
        let (thread, publishes) = (std::thread::current(), (true, false));
        let mut tap = Published { out: Arc::clone(&out), thread, unsent: Arc::clone(&unsent), publishes, frame: 0 };
        let mut offer = || tap.own(Instant::ZERO, &Next::Record(Stamps::default(), Record { code: 0xBB, body: &[1] }));
        let mailbox = Mailbox::new(100);
        for offers in [5, 1] {
            (0..offers).for_each(|_| offer());
            work(&out, &AtomicBool::new(true), |_, message| mailbox.put_at(Instant::ZERO, &message));
        }
        let counts = mailbox.counts();
        assert_eq!((counts.received, counts.missing, unsent.load(Ordering::Relaxed)), (3, 3, 3));
    }
}
