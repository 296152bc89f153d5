//! Carries ROS 2 topics over a zenoh session, for nodes with `rmw_zenoh_cpp` ([`csi5300_ros2::rmw_zenoh`]).

use crate::lock;
use csi5300_ros2::rmw_zenoh::{End, Graph, Taker, attachment, gid};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query, Queryable, Reply, ReplyKeyExpr};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Session, Wait};

/// Limit of queued messages; further ones are dropped and counted.
const BACKLOG: usize = 1_024;

/// The publisher's index, the payload and the attachment.
type Message = (usize, Vec<u8>, Vec<u8>);

/// The keys of all subscriptions.
pub(super) fn keys_read(graph: &Graph) -> Vec<String> {
    let read = graph.topics.iter().filter(|topic| matches!(topic.end, End::Subscription(_)));
    read.map(|topic| graph.key(topic)).collect()
}

/// Carried topics. Dropping this sends the queued messages and ends the topics.
pub(super) struct Topics {
    /// The queue of the sending thread; closing it ends the thread.
    queue: Option<Arc<SyncSender<Message>>>,
    thread: Option<JoinHandle<()>>,
    _tokens: Vec<LivelinessToken>,
    _subscribers: Vec<Subscriber<()>>,
    _queryables: Vec<Queryable<()>>,
}

/// A payload and its attachment.
type Sent = (Vec<u8>, Vec<u8>);

/// The last samples of a publisher, for subscribers that come later.
#[derive(Clone, Default)]
struct Kept {
    samples: Arc<Mutex<VecDeque<Sent>>>,
    /// The number of samples; 0 keeps none.
    depth: usize,
}

impl Kept {
    fn push(&self, payload: &[u8], attachment: &[u8]) {
        if self.depth > 0 {
            let mut samples = lock(&self.samples);
            samples.push_back((payload.to_vec(), attachment.to_vec()));
            if samples.len() > self.depth {
                samples.pop_front();
            }
        }
    }

    /// Answers queries with samples of the topic `key`.
    fn answer(&self, key: &str, query: &Query) {
        let samples = lock(&self.samples).clone();
        for (payload, attachment) in samples {
            // An asker that is gone takes no answer.
            let _ = query.reply(key, payload).attachment(attachment).wait();
        }
    }
}

impl Topics {
    /// Carries all topics of a node; `unsent` counts messages dropped because the queue was full.
    pub fn carry(session: &Session, mut graph: Graph, unsent: &Arc<AtomicU64>) -> zenoh::Result<Self> {
        let own = session.zid().to_string();
        let declare = |token: String| session.liveliness().declare_token(token).wait();
        let mut tokens = vec![declare(graph.node_token(&own))?];
        let (mut subscribers, mut publishers, mut queryables) = (Vec::new(), Vec::new(), Vec::new());
        let (queue, waiting) = sync_channel::<Message>(BACKLOG);
        let queue = Arc::new(queue);
        for (number, topic) in (1..).zip(std::mem::take(&mut graph.topics)) {
            let (key, token) = (graph.key(&topic), graph.token(&own, number, &topic));
            let (wants_earlier, depth) = (topic.wants_earlier(), topic.kept());
            match topic.end {
                End::Publisher(outlet) => {
                    let (writer, gid, next) = (publishers.len(), gid(&token), AtomicI64::new(1));
                    let kept = Kept { depth, ..Kept::default() };
                    if depth > 0 {
                        // As an advanced publisher of `zenoh-ext`: a token, and answers to queries of the same key.
                        let own_key = format!("{key}/@adv/pub/{own}/{number}/_");
                        let (answering, topic_key) = (kept.clone(), key.clone());
                        let answer = move |query: Query| answering.answer(&topic_key, &query);
                        queryables.push(session.declare_queryable(own_key.clone()).callback(answer).wait()?);
                        tokens.push(declare(own_key)?);
                    }
                    let declared = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
                    publishers.push((declared.wait()?, kept));
                    let (queue, unsent) = (Arc::downgrade(&queue), Arc::clone(unsent));
                    let send = move |payload: &[u8], wall_us: i64| {
                        // A dropped message leaves a gap in the sequence numbers.
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        let message =
                            (writer, payload.to_vec(), attachment(number, wall_us.saturating_mul(1_000), gid));
                        if queue.upgrade().is_none_or(|queue| queue.try_send(message).is_err()) {
                            unsent.fetch_add(1, Ordering::Relaxed);
                        }
                    };
                    let _ = outlet.set(Box::new(send));
                }
                End::Subscription(take) => {
                    let take: Arc<Taker> = Arc::new(take);
                    if wants_earlier {
                        subscribers.push(earlier(session, &key, Arc::clone(&take))?);
                    }
                    let used = move |sample: Sample| take(sample.payload().to_bytes().into_owned());
                    // As with DDS, the node does not receive its own messages (`/tf`).
                    let declared = session.declare_subscriber(key).allowed_origin(Locality::Remote);
                    subscribers.push(declared.callback(used).wait()?);
                }
            }
            tokens.push(declare(token)?);
        }
        let work = move || {
            for (writer, payload, attachment) in waiting {
                let publisher: Option<&(zenoh::pubsub::Publisher<'_>, Kept)> = publishers.get(writer);
                if let Some((publisher, kept)) = publisher {
                    kept.push(&payload, &attachment);
                    let _ = publisher.put(payload).attachment(attachment).wait();
                }
            }
        };
        let thread = std::thread::Builder::new().name("csi5300 topics".into()).spawn(work)?;
        let (queue, thread) = (Some(queue), Some(thread));
        Ok(Self { queue, thread, _tokens: tokens, _subscribers: subscribers, _queryables: queryables })
    }
}

impl Drop for Topics {
    fn drop(&mut self) {
        drop(self.queue.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Queries every discovered publisher for the samples that it kept. `rmw_zenoh_cpp` uses zenoh's advanced publishers for
/// transient local topics: each declares a token below the topic's key and answers queries there (`zenoh-ext`).
fn earlier(session: &Session, key: &str, take: Arc<Taker>) -> zenoh::Result<Subscriber<()>> {
    let asker = session.clone();
    let found = move |token: Sample| {
        if token.kind() != SampleKind::Put {
            return;
        }
        let take = Arc::clone(&take);
        let used = move |reply: Reply| {
            if let Ok(sample) = reply.result() {
                take(sample.payload().to_bytes().into_owned());
            }
        };
        let asked = asker.get(token.key_expr()).consolidation(ConsolidationMode::None);
        // A publisher that is gone does not answer.
        let _ = asked.accept_replies(ReplyKeyExpr::Any).callback(used).wait();
    };
    session.liveliness().declare_subscriber(format!("{key}/@adv/pub/**")).history(true).callback(found).wait()
}

#[cfg(test)]
mod tests {
    use super::super::access::{Owner, access_control};
    use super::*;
    use csi5300_bag::cdr::Cdr;
    use csi5300_bag::messages::{Message as _, Time};
    use csi5300_ros2::link::Came;
    use csi5300_ros2::settings::Settings;
    use csi5300_ros2::{Node, Qos};
    use std::sync::mpsc::channel;

    fn session(key: &str, port: u16, access_control: &serde_json::Value) -> zenoh::Result<Session> {
        let mut config = zenoh::Config::default();
        config.insert_json5("access_control", &access_control.to_string()).unwrap();
        let endpoint = format!("[\"tcp/127.0.0.1:{port}\"]");
        for (key, value) in
            [("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]"), (key, endpoint.as_str())]
        {
            config.insert_json5(key, value).unwrap();
        }
        zenoh::open(config).wait()
    }

    #[test]
    fn topics_are_carried_in_both_directions_until_dropped() {
        let domain = 150 + (std::process::id() % 80) as u16;
        let alone = Settings { domain: Some(domain), multicast: Some(false), ..Settings::default() };
        let node = Node::start(&alone, "burger", || Some(20_000_000)).unwrap();
        let publisher = node.link.publish::<Time>("~/time", Qos::reliable(32));
        let latched = node.link.publish::<Time>("~/last", Qos::latched(1));
        let (give, came) = channel();
        let used = move |time: Time, came: Came| _ = give.send((time.sec, came.at_us));
        node.link.subscribe("/asked", Qos::best_effort(5), used, || panic!("unreadable"));
        let graph = node.link.relay().take();
        // The access control admits only the needed keys.
        let owned = [Owner { mac: driver_iface::Mac([2; 6]), certificate: Some("burger-2".into()) }];
        let strict = access_control("csi5300/robots", &owned, Some(&keys_read(&graph))).unwrap();
        // A port that was free a moment ago may be taken since.
        let (port, own) = loop {
            let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
            if let Ok(own) = session("listen/endpoints", port, &strict) {
                break (port, own);
            }
        };
        let other = session("connect/endpoints", port, &serde_json::json!({})).unwrap();
        let key = |name: &str| format!("{domain}/{name}/builtin_interfaces::msg::dds_::Time_/{}", Time::type_hash());
        assert_eq!(keys_read(&graph), [key("asked")]);
        let carried = Topics::carry(&own, graph, &Arc::default()).unwrap();

        let (give, samples) = channel();
        let heard = move |sample: Sample| _ = give.send(sample);
        let _heard = other.declare_subscriber(key("csi5300_burger/time")).callback(heard).wait().unwrap();
        let time = |sec| Time { sec, nanosec: 0 };
        let sample = loop {
            publisher.put(&time(7));
            match samples.try_recv() {
                Ok(sample) => break sample,
                Err(_) => std::thread::yield_now(),
            }
        };
        assert_eq!(*sample.payload().to_bytes(), time(7).payload());
        // Of a busy machine the answer may come too late: then it is asked again.
        let tokens = || loop {
            let replies = other.liveliness().get("@ros2_lv/**").wait().unwrap();
            let key = |reply: Reply| reply.into_result().ok().map(|token| token.key_expr().to_string());
            if let Some(keys) = replies.into_iter().map(key).collect::<Option<Vec<String>>>() {
                break keys;
            }
        };
        let all = tokens();
        let published = all.iter().find(|token| token.contains("/MP/") && token.contains("%time")).unwrap();
        let beside = sample.attachment().unwrap().to_bytes();
        assert_eq!(beside[8..], attachment(0, 20_000_000_000, gid(published))[8..]);
        assert_eq!(all.len(), 4, "{all:?}");

        // A late subscriber asks for what was published before it.
        [3, 4].into_iter().for_each(|sec| latched.put(&time(sec)));
        let (give, earlier_ones) = channel();
        let take: Taker = Box::new(move |payload| _ = give.send(payload));
        let take = Arc::new(take);
        let last = loop {
            // The last sample may still be on its way to the sending thread.
            let asking = earlier(&other, &key("csi5300_burger/last"), Arc::clone(&take)).unwrap();
            let came = earlier_ones.recv_timeout(std::time::Duration::from_secs(2));
            drop(asking);
            if let Ok(payload) = came
                && payload != time(3).payload()
            {
                break payload;
            }
        };
        assert_eq!(last, time(4).payload());

        let received = loop {
            other.put(key("asked"), time(9).payload()).wait().unwrap();
            match came.try_recv() {
                Ok(received) => break received,
                Err(_) => std::thread::yield_now(),
            }
        };
        assert_eq!(received, (9, 20_000_000));
        drop(carried);
        while !tokens().is_empty() {
            std::thread::yield_now();
        }
    }
}
