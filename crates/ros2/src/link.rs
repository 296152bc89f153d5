//! A participant on sockets, with a receiving thread. Publishing sends at once and never waits; datagrams that the system
//! does not accept are counted. Requests and answers of services.

use super::bag::Bag;
use super::lock;
use super::names::{Names, kind, service, topic};
use super::rmw_zenoh::{End, Relay, Sender, Topic as Relayed};
use super::rtps::{Counts, Event, Guid, LARGEST, LARGEST_READ, Outgoing, Participant, Qos};
use super::settings::{Distribution, Reach};
use super::sockets::Sockets;
use csi5300::time::{Instant, Span};
use csi5300_bag::cdr::{CDR_LE, Cdr, CdrReader, CdrWriter};
use csi5300_bag::messages::{self, Message};
use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often this machine's address is checked for a change.
const LOOK: Span = Span::from_ms(1_000);
/// Samples that a topic keeps for readers that lack them.
const DEPTH: u32 = 32;

/// The vendor number of Eclipse Cyclone DDS.
const CYCLONE: [u8; 2] = [1, 0x10];

/// Receives a sample: its topic, its sender, its time of receipt.
type Handler = Box<dyn FnMut(&Shared, &Event, i64) + Send>;

/// How a message came.
#[derive(Clone, Copy, Debug)]
pub struct Came {
    /// Time of receipt, microseconds since the Unix epoch.
    pub at_us: i64,
    /// Its publisher, another one after a restart; 0 by another way than DDS.
    pub publisher: u128,
}

/// A topic of this node.
struct Topic {
    /// Its full name.
    name: String,
    guid: Guid,
    /// Messages published, or read.
    good: Arc<AtomicU64>,
    /// Messages too large to publish, or not of the topic's type.
    bad: Arc<AtomicU64>,
}

/// State that publishers and the thread share.
pub struct Shared {
    names: Names,
    distribution: Distribution,
    participant: Mutex<Participant>,
    sockets: Mutex<Arc<Sockets>>,
    began: std::time::Instant,
    wall_us: fn() -> Option<i64>,
    handlers: Mutex<Vec<Handler>>,
    /// By number.
    writers: Mutex<Vec<Topic>>,
    readers: Mutex<Vec<Topic>>,
    pub(crate) bag: Bag,
    relay: Relay,
    unsent: AtomicU64,
    over: AtomicBool,
}

impl Shared {
    fn wall_us(&self) -> i64 {
        (self.wall_us)().unwrap_or(0)
    }

    fn now(&self) -> Instant {
        Instant::from_us(i64::try_from(self.began.elapsed().as_micros()).unwrap_or(i64::MAX))
    }

    fn sockets(&self) -> Arc<Sockets> {
        Arc::clone(&lock(&self.sockets))
    }

    fn send(&self, out: Vec<Outgoing>) {
        let sockets = self.sockets();
        let unsent = out.iter().filter(|(to, bytes)| !sockets.send(*to, bytes)).count();
        self.unsent.fetch_add(unsent as u64, Ordering::Relaxed);
    }

    /// Changes the participant, then sends what it has to send.
    fn with(&self, change: impl FnOnce(&mut Participant)) {
        let out = {
            let mut participant = lock(&self.participant);
            change(&mut participant);
            participant.poll_transmit()
        };
        self.send(out);
    }

    fn write(&self, writer: usize, payload: Vec<u8>) {
        self.with(|participant| participant.write(writer, payload.into(), self.wall_us()));
    }

    fn add_writer(&self, name: &str, topic: &str, kind: &str, qos: Qos) -> (usize, Arc<AtomicU64>, Arc<AtomicU64>) {
        let mut writers = lock(&self.writers);
        let (number, guid) = lock(&self.participant).add_writer(topic, kind, qos, self.wall_us());
        let (good, bad) = (Arc::default(), Arc::default());
        writers.push(Topic { name: name.to_owned(), guid, good: Arc::clone(&good), bad: Arc::clone(&bad) });
        (number, good, bad)
    }

    /// Passes samples of `topic` to the handler that `make` builds from the two counters. Gives the reader's number.
    fn add_reader(
        &self,
        name: &str,
        (topic, kind): (&str, &str),
        qos: Qos,
        make: impl FnOnce(Arc<AtomicU64>, Arc<AtomicU64>) -> Handler,
    ) -> usize {
        // Registered before the reader is announced.
        let mut handlers = lock(&self.handlers);
        let mut readers = lock(&self.readers);
        let guid = lock(&self.participant).add_reader(topic, kind, qos, self.wall_us());
        let (good, bad) = (Arc::default(), Arc::default());
        readers.push(Topic { name: name.to_owned(), guid, good: Arc::clone(&good), bad: Arc::clone(&bad) });
        handlers.push(make(good, bad));
        handlers.len() - 1
    }

    /// Takes the payload of a sample that came by another way than DDS.
    fn take(&self, reader: usize, payload: Vec<u8>) {
        // One that is larger than any is as unreadable as none.
        let payload = if payload.len() > LARGEST_READ { Vec::new() } else { payload };
        let event = Event { reader, from: (Guid::default(), 0), vendor: [0; 2], payload };
        if let Some(handler) = lock(&self.handlers).get_mut(reader) {
            handler(self, &event, self.wall_us());
        }
    }

    /// The quality of service of a topic of this type: with its type hash, for releases that compare hashes.
    fn of_type<T: Message>(&self, qos: Qos) -> Qos {
        let type_hash = (self.distribution != Distribution::Humble).then(T::type_hash);
        Qos { type_hash, ..qos }
    }

    /// Announces this node's endpoints.
    fn tell_graph(&self, writer: usize) {
        let all = |topics: &Mutex<Vec<Topic>>| lock(topics).iter().map(|topic| topic.guid).collect::<Vec<_>>();
        let ends = [all(&self.readers), all(&self.writers)];
        let own = lock(&self.participant).guid();
        self.write(writer, entities(self.distribution, own, &self.names, &ends));
    }

    /// If the address of the chosen network appeared, disappeared or changed, moves the participant to the new one. Failures
    /// are retried at the next check.
    fn follow(&self, reach: Reach) {
        let old = self.sockets();
        if reach.interface == *old.meta_address.ip() {
            return;
        }
        let Ok(new) = Sockets::open(old.domain, reach) else { return };
        let new = Arc::new(new.follow(&old));
        let out = {
            let mut participant = lock(&self.participant);
            participant.move_to(new.settings(self.names.node()), self.wall_us());
            participant.poll_transmit()
        };
        *lock(&self.sockets) = new;
        self.send(out);
    }

    /// Handles received datagrams and due timers, then waits.
    fn turn(&self, buffer: &mut [u8]) {
        let next_at = lock(&self.participant).next_at();
        let wait = (next_at - self.now()).as_s().clamp(0.0, 0.2);
        let sockets = self.sockets();
        sockets.wait(Duration::from_secs_f64(wait));
        let mut events = Vec::new();
        sockets.receive(buffer, |bytes, ip| {
            lock(&self.participant).handle_datagram(bytes, ip, (self.now(), self.wall_us()), &mut events);
        });
        if !events.is_empty() {
            let mut handlers = lock(&self.handlers);
            let wall_us = self.wall_us();
            for event in &events {
                if let Some(handler) = handlers.get_mut(event.reader) {
                    handler(self, event, wall_us);
                }
            }
        }
        self.with(|participant| participant.handle_timeout(self.now()));
    }
}

/// Publishes messages on one topic.
pub struct Publisher<T> {
    shared: Arc<Shared>,
    writer: usize,
    name: String,
    /// What sends by another way than DDS.
    also: Arc<OnceLock<Sender>>,
    sent: Arc<AtomicU64>,
    too_large: Arc<AtomicU64>,
    kind: PhantomData<fn(T)>,
}

impl<T: Message> Publisher<T> {
    /// Publishes a message, and records it while a recording runs.
    pub fn put(&self, message: &T) {
        let payload = message.payload();
        let wall_us = self.shared.wall_us();
        self.shared.bag.put::<T>(&self.name, &payload, wall_us);
        if let Some(send) = self.also.get() {
            send(&payload, wall_us);
        }
        if payload.len() > LARGEST {
            self.too_large.fetch_add(1, Ordering::Relaxed);
        } else {
            self.sent.fetch_add(1, Ordering::Relaxed);
            self.shared.write(self.writer, payload);
        }
    }
}

/// A ROS 2 node. It announces its departure when dropped.
pub struct Link {
    shared: Arc<Shared>,
    graph: usize,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// A node on these sockets; `seek` is called repeatedly and returns where the node should be.
    pub(crate) fn start(
        (names, distribution): (Names, Distribution),
        (sockets, seek): (Sockets, impl Fn() -> Reach + Send + 'static),
        bag: Bag,
        wall_us: fn() -> Option<i64>,
    ) -> std::io::Result<Self> {
        let participant = Participant::new(sockets.settings(names.node()), Instant::ZERO);
        let relay = Relay::new(sockets.domain, &names.namespace, &names.node);
        let shared = Arc::new(Shared {
            names,
            distribution,
            participant: Mutex::new(participant),
            sockets: Mutex::new(Arc::new(sockets)),
            began: std::time::Instant::now(),
            wall_us,
            handlers: Mutex::default(),
            writers: Mutex::default(),
            readers: Mutex::default(),
            bag,
            relay,
            unsent: AtomicU64::new(0),
            over: AtomicBool::new(false),
        });
        let kind = kind("rmw_dds_common/msg/ParticipantEntitiesInfo");
        let qos = shared.of_type::<messages::ParticipantEntitiesInfo>(Qos::latched(1));
        let graph = shared.add_writer("", "ros_discovery_info", &kind, qos).0;
        let working = Arc::clone(&shared);
        let work = move || {
            let (mut buffer, mut look_at) = (vec![0; 1 << 16], Instant::ZERO);
            while !working.over.load(Ordering::Relaxed) {
                if working.now() >= look_at {
                    working.follow(seek());
                    look_at = working.now() + LOOK;
                }
                working.turn(&mut buffer);
            }
            working.with(Participant::leave);
        };
        let thread = Some(std::thread::Builder::new().name("csi5300 ros2".into()).spawn(work)?);
        let link = Self { shared, graph, thread };
        link.shared.tell_graph(graph);
        Ok(link)
    }

    /// How names are resolved.
    pub(crate) fn names(&self) -> &Names {
        &self.shared.names
    }

    /// The topics, for who carries them by another way than DDS.
    #[must_use]
    pub fn relay(&self) -> Relay {
        self.shared.relay.clone()
    }

    fn relayed<T: Message>(&self, name: &str, qos: &Qos, end: End) {
        let (name, kind, qos) = (name.to_owned(), kind(T::TYPE), qos.clone());
        self.shared.relay.add(Relayed { name, kind, type_hash: T::type_hash(), qos, end });
    }

    /// A topic to publish on, named as a ROS 2 node would name it (`~/csi`, `odom`, `/tf`).
    #[must_use]
    pub fn publish<T: Message>(&self, name: &str, qos: Qos) -> Publisher<T> {
        let name = self.shared.names.whole(name);
        let qos = self.shared.of_type::<T>(qos);
        let (writer, sent, too_large) = self.shared.add_writer(&name, &topic(&name), &kind(T::TYPE), qos.clone());
        self.shared.tell_graph(self.graph);
        let also = Arc::default();
        self.relayed::<T>(&name, &qos, End::Publisher(Arc::clone(&also)));
        Publisher { shared: Arc::clone(&self.shared), writer, name, also, sent, too_large, kind: PhantomData }
    }

    /// Passes messages of a topic to `used`. Calls `unreadable` for messages that cannot be read.
    pub fn subscribe<T: Message>(
        &self,
        name: &str,
        qos: Qos,
        mut used: impl FnMut(T, Came) + Send + 'static,
        unreadable: impl Fn() + Send + 'static,
    ) {
        let name = self.shared.names.whole(name);
        let (recorded, qos) = (name.clone(), self.shared.of_type::<T>(qos));
        let reader = self.shared.add_reader(&name, (&topic(&name), &kind(T::TYPE)), qos.clone(), |good, bad| {
            Box::new(move |shared, event, wall_us| {
                let read = T::of_payload(&event.payload);
                let counter = if read.is_ok() { &good } else { &bad };
                counter.fetch_add(1, Ordering::Relaxed);
                match read {
                    Ok(message) => {
                        // As the recording's definition says, also where another release's message lacks a field.
                        shared.bag.put::<T>(&recorded, &message.payload(), wall_us);
                        let publisher = u128::from_be_bytes(event.from.0.bytes());
                        used(message, Came { at_us: wall_us, publisher });
                    }
                    Err(_) => unreadable(),
                }
            })
        });
        self.shared.tell_graph(self.graph);
        let shared = Arc::downgrade(&self.shared);
        let take = move |payload| {
            if let Some(shared) = shared.upgrade() {
                shared.take(reader, payload);
            }
        };
        self.relayed::<T>(&name, &qos, End::Subscription(Box::new(take)));
    }

    /// Offers a service; `answer` is called on the receiving thread.
    pub fn serve<Q: Message, A: Message>(&self, name: &str, mut answer: impl FnMut(&Shared, Q) -> A + Send + 'static) {
        let name = self.shared.names.whole(name);
        let (requests, answers) = service(&name);
        let (asked, answered) = (Qos::reliable(10), Qos::reliable(10));
        let (asked, answered) = (self.shared.of_type::<Q>(asked), self.shared.of_type::<A>(answered));
        let (writer, sent, _) = self.shared.add_writer(&name, &answers, &kind(A::TYPE), answered);
        self.shared.add_reader(&name, (&requests, &kind(Q::TYPE)), asked, |good, bad| {
            Box::new(move |shared, event, _| match request::<Q>(event) {
                Some((head, question)) => {
                    good.fetch_add(1, Ordering::Relaxed);
                    sent.fetch_add(1, Ordering::Relaxed);
                    let said = answer_to(head, &answer(shared, question));
                    let (to, now) = (event.from.0.prefix, (shared.now(), shared.wall_us()));
                    shared.with(|participant| participant.answer(writer, to, said, now));
                }
                None => drop(bad.fetch_add(1, Ordering::Relaxed)),
            })
        });
        self.shared.tell_graph(self.graph);
    }

    /// Current problems as text.
    #[must_use]
    pub fn trouble(&self) -> Vec<String> {
        let (writers, readers) = (lock(&self.shared.writers), lock(&self.shared.readers));
        let participant = lock(&self.shared.participant);
        let own = writers.iter().enumerate().map(|(number, topic)| (topic, participant.writer_state(number)));
        let read = readers.iter().enumerate().map(|(number, topic)| (topic, participant.reader_state(number)));
        let wrong = own.chain(read).flat_map(|(topic, state)| {
            let name = if topic.name.is_empty() { "ros_discovery_info" } else { &topic.name };
            state.wrong.into_iter().map(move |why| format!("{name}: {why}"))
        });
        let others = participant.unreachable().map(|who| format!("ROS 2: {who}, so nothing can be sent to it"));
        wrong
            .chain(others)
            .chain(self.shared.sockets().trouble(participant.counts.participants))
            .chain(self.shared.bag.trouble())
            .collect()
    }

    /// Ends the recording.
    pub fn end_recording(&self) {
        self.shared.bag.end();
    }

    /// The counters.
    #[must_use]
    pub fn counted(&self) -> serde_json::Value {
        let (writers, readers) = (lock(&self.shared.writers), lock(&self.shared.readers));
        let participant = lock(&self.shared.participant);
        let number = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let published = writers.iter().enumerate().filter(|(_, topic)| !topic.name.is_empty()).map(|(k, topic)| {
            let counts = serde_json::json!({ "sent": number(&topic.good), "too_large": number(&topic.bad),
                "subscribers": participant.writer_state(k).matched });
            (topic.name.clone(), counts)
        });
        let published: serde_json::Map<String, serde_json::Value> = published.collect();
        let subscribed = readers.iter().enumerate().map(|(k, topic)| {
            let state = participant.reader_state(k);
            let counts = serde_json::json!({ "read": number(&topic.good), "unreadable": number(&topic.bad),
                "came": state.samples, "lost": state.lost, "publishers": state.matched });
            (topic.name.clone(), counts)
        });
        let subscribed: serde_json::Map<String, serde_json::Value> = subscribed.collect();
        let (counts, sockets): (Counts, _) = (participant.counts, self.shared.sockets());
        serde_json::json!({
            "node": self.shared.names.node(),
            "address": sockets.meta_address,
            "reach": sockets.reach.words,
            "foreign": sockets.foreign(),
            "unsent": number(&self.shared.unsent),
            "dds": counts,
            "published": published,
            "subscribed": subscribed,
            "bag": self.shared.bag.counted(),
        })
    }
}

/// The usual quality of service for publishing: reliable, nothing kept for late readers.
#[must_use]
pub fn usual() -> Qos {
    Qos::reliable(DEPTH)
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        self.shared.sockets().wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The client of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Head {
    /// Client and number, written before the request.
    Inside(u64, i64),
    /// The request's writer and number.
    Beside(Guid, i64),
}

/// The client and its request.
fn request<Q: Message>(event: &Event) -> Option<(Head, Q)> {
    let mut from = CdrReader::of_payload(&event.payload).ok()?;
    let head = if event.vendor == CYCLONE {
        Head::Inside(u64::read(&mut from).ok()?, i64::read(&mut from).ok()?)
    } else {
        Head::Beside(event.from.0, event.from.1)
    };
    Some((head, Q::read(&mut from).ok()?))
}

/// The payload of an answer, and the request that it answers if that is sent beside it.
fn answer_to<A: Message>(head: Head, answer: &A) -> (Arc<[u8]>, Option<(Guid, i64)>) {
    match head {
        Head::Beside(guid, number) => (answer.payload().into(), Some((guid, number))),
        Head::Inside(client, number) => {
            let mut to = CdrWriter::plain();
            client.write(&mut to);
            number.write(&mut to);
            answer.write(&mut to);
            (with_head(to).into(), None)
        }
    }
}

/// `rmw_dds_common/msg/ParticipantEntitiesInfo` of a node and its readers and writers; identifiers have 24 bytes in Humble.
fn entities(release: Distribution, own: Guid, names: &Names, ends: &[Vec<Guid>; 2]) -> Vec<u8> {
    let padding: &[u8] = if release == Distribution::Humble { &[0; 8] } else { &[] };
    let gid = |guid: Guid, to: &mut CdrWriter| [&guid.bytes(), padding].iter().for_each(|bytes| to.put(bytes));
    let mut to = CdrWriter::plain();
    gid(own, &mut to);
    1_u32.write(&mut to);
    [&names.namespace, &names.node].iter().for_each(|name| name.write(&mut to));
    for guids in ends {
        (guids.len() as u32).write(&mut to);
        guids.iter().for_each(|guid| gid(*guid, &mut to));
    }
    with_head(to)
}

/// A payload: its encapsulation, then what was written.
fn with_head(body: CdrWriter) -> Vec<u8> {
    [&CDR_LE[..], &body.into_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_bag::messages::{Time, TriggerRequest, TriggerResponse};
    use std::net::Ipv4Addr;
    use std::sync::mpsc::channel;

    /// On loopback, whose addresses this machine always has: `last` returns the last byte.
    fn node(name: &str, last: Arc<AtomicU64>) -> Link {
        let seek = move || {
            let interface = Ipv4Addr::new(127, 0, 0, last.load(Ordering::Relaxed) as u8);
            let peers = [1, 2].map(|last| Ipv4Addr::new(127, 0, 0, last)).to_vec();
            Reach { interface, multicast: false, peers, is_off: false, words: String::new(), waits: None }
        };
        let domain = 80 + (std::process::id() % 60) as u16;
        let names = Names { namespace: "/".into(), node: name.into(), ..Names::default() };
        let sockets = Sockets::open(domain, seek()).unwrap();
        Link::start((names, Distribution::Jazzy), (sockets, seek), Bag::new(Default::default()), || Some(0)).unwrap()
    }

    #[test]
    fn a_node_continues_at_a_new_address() {
        let last = Arc::new(AtomicU64::new(1));
        let (moving, fixed) = (node("moving", Arc::clone(&last)), node("fixed", Arc::new(AtomicU64::new(1))));
        let (give, came) = channel();
        let publisher = moving.publish::<Time>("/a", Qos::reliable(10));
        fixed.subscribe("/a", Qos::reliable(10), move |time: Time, _| _ = give.send(time.sec), || panic!("unreadable"));
        let until = |wanted: i32| {
            loop {
                publisher.put(&Time { sec: wanted, nanosec: 0 });
                std::thread::yield_now();
                if came.try_iter().any(|sec| sec == wanted) {
                    break;
                }
            }
        };
        until(1);
        last.store(2, Ordering::Relaxed);
        while moving.counted()["address"].as_str().is_some_and(|at| at.starts_with("127.0.0.1:")) {
            until(2);
        }
        until(3);
        assert!(moving.counted()["address"].as_str().unwrap().starts_with("127.0.0.2:"));
        assert_eq!(fixed.counted()["subscribed"]["/a"]["publishers"], 1);
    }

    #[test]
    fn the_node_is_described_as_its_release_has_it() {
        let guid = |last| Guid { prefix: [7; 12], entity: [0, 0, last, 3] };
        let names = Names { namespace: "/lab".into(), node: "burger".into(), ..Names::default() };
        let told = |release| entities(release, guid(1), &names, &[vec![guid(2)], vec![guid(3), guid(4)]]);
        let read = messages::ParticipantEntitiesInfo::of_payload(&told(Distribution::Jazzy)).unwrap();
        let node = &read.node_entities_info_seq[0];
        assert_eq!((&*node.node_namespace.0, &*node.node_name.0), ("/lab", "burger"));
        let told_guids = [&read.gid, &node.reader_gid_seq[0], &node.writer_gid_seq[1]].map(|gid| gid.data);
        assert_eq!(told_guids, [1, 2, 4].map(|last| guid(last).bytes()));
        assert_eq!(told(Distribution::Humble).len(), told(Distribution::Jazzy).len() + 4 * 8);
    }

    #[test]
    fn both_ways_of_identifying_a_request_are_understood() {
        let from = (Guid { prefix: [7; 12], entity: [0, 0, 1, 3] }, 5);
        let event = |vendor, payload| Event { reader: 0, from, vendor, payload };
        let inside = [&CDR_LE[..], &9_u64.to_le_bytes(), &3_i64.to_le_bytes(), &[0]].concat();
        let (head, _) = request::<TriggerRequest>(&event(CYCLONE, inside.clone())).unwrap();
        assert_eq!(head, Head::Inside(9, 3));
        let said = TriggerResponse { success: true, message: "x".into() };
        let (payload, beside) = answer_to(head, &said);
        assert_eq!((&payload[..20], beside), (&inside[..20], None));
        assert_eq!(payload[20..], said.payload()[4..]);
        let (head, _) = request::<TriggerRequest>(&event([1, 0x0f], vec![0, 1, 0, 0, 0])).unwrap();
        assert_eq!(head, Head::Beside(from.0, from.1));
        assert_eq!(answer_to(head, &said), (said.payload().into(), Some(from)));
        assert!(request::<TriggerRequest>(&event(CYCLONE, vec![0, 1, 0, 0, 0])).is_none());
    }
}
