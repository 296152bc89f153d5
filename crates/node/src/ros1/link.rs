//! A node of ROS on a thread of its own. A master that was started anew knows nothing of its nodes: this one looks after
//! it, and registers again.

mod topics;

use super::messages::{Odometry, PoseStamped};
use csi5300::motion::odometry::ros::{Inbox, Kind, Message, Topic, Wanted};
use csi5300::source::Error;
use roslibrust::RosMessageType;
use roslibrust::ros1::{MasterClient, NodeHandle};
use std::future::Future;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::mpsc::{Sender, UnboundedReceiver, UnboundedSender, channel, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::timeout;
use topics::{read, write};

/// Messages that wait at most, in either direction; further ones are lost and counted.
const QUEUE: usize = 1_024;
/// How often the master is looked after.
const WATCH: Duration = Duration::from_millis(1_000);
/// Pause before an absent master is tried again.
const RETRY: Duration = Duration::from_millis(500);
/// A master that takes longer to answer is absent.
const PATIENCE: Duration = Duration::from_secs(3);
/// Looks at which a master knew nothing of this node, before it registers again: registering takes a moment.
const UNKNOWN: u32 = 2;
/// Time limit of unregistering from the master at the end.
const FAREWELL: Duration = Duration::from_millis(500);

/// Why a task ended.
type Ended = String;
type Task = Pin<Box<dyn Future<Output = Ended> + Send>>;

/// A topic that is read or written.
struct Use {
    topic: String,
    type_name: &'static str,
    /// Where it goes, if it is read.
    inbox: Option<Inbox>,
    /// Begins on a connection, which has a number.
    begin: Box<dyn Fn(NodeHandle, u64) -> Task + Send>,
}

/// What a link says of itself.
#[derive(Debug, Default)]
struct State {
    trouble: Mutex<Option<String>>,
    connections: AtomicU64,
}

impl State {
    fn say(&self, trouble: Option<String>) {
        *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = trouble;
    }
}

/// A node of ROS. It leaves the master when dropped, which must be outside of an async runtime: it waits for its thread.
pub struct RosLink {
    uses: Option<UnboundedSender<Use>>,
    state: Arc<State>,
    counts: Mutex<Vec<(String, Arc<OutCounts>)>>,
    thread: Option<JoinHandle<()>>,
    wall_us: fn() -> Option<i64>,
}

/// What was counted of a topic that is written.
#[derive(Debug, Default)]
struct OutCounts {
    sent: AtomicU64,
    lost: AtomicU64,
}

/// Where messages are put to be published.
pub struct Outbox<T> {
    messages: Sender<T>,
    counts: Arc<OutCounts>,
}

impl<T> Outbox<T> {
    /// Hands a message over, and never waits. It is lost, and counted, while there is no master.
    pub fn put(&self, message: T) {
        if self.messages.try_send(message).is_err() {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl RosLink {
    /// A node called `name` (`/csi5300_burger_1`) of the master at `master` (`http://localhost:11311`), which need not be
    /// there yet. `wall_us` reads the host's wall clock.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(master: String, name: String, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        let io = |source| Error::Io { what: "cannot start the thread of ROS".into(), source };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(io)?;
        let state = Arc::new(State::default());
        let (uses, asked) = unbounded_channel();
        let node = Node { master, name, state: Arc::clone(&state), uses: Vec::new(), asked };
        let work = move || {
            runtime.block_on(node.work());
            runtime.shutdown_timeout(FAREWELL);
        };
        let thread = std::thread::Builder::new().name("csi5300 ros".into()).spawn(work).map_err(io)?;
        Ok(Self { uses: Some(uses), state, counts: Mutex::default(), thread: Some(thread), wall_us })
    }

    fn add(&self, what: Use) {
        // Only a thread that died does not take it.
        let taken = self.uses.as_ref().is_some_and(|uses| uses.send(what).is_ok());
        if !taken {
            self.state.say(Some("the thread of ROS has ended".into()));
        }
    }

    /// The poses of a topic.
    pub fn poses(&self, topic: &str, kind: Kind, wanted: Wanted) -> Topic {
        let inbox = Inbox::new(topic, wanted);
        match kind {
            Kind::Odometry => self.subscribe::<Odometry>(&inbox, Odometry::pose),
            Kind::Pose => self.subscribe::<PoseStamped>(&inbox, PoseStamped::pose),
        }
        inbox.source()
    }

    fn subscribe<T: RosMessageType>(&self, inbox: &Inbox, used: fn(&T) -> Message<'_>) {
        let (into, wall_us) = (inbox.clone(), self.wall_us);
        let begin = move |node: NodeHandle, connection| -> Task {
            Box::pin(read::<T>(node, connection, into.clone(), used, wall_us))
        };
        let topic = inbox.topic().to_owned();
        let (inbox, begin) = (Some(inbox.clone()), Box::new(begin));
        self.add(Use { topic, type_name: T::DESCRIPTION.ros_type_name, inbox, begin });
    }

    /// A topic to be written.
    pub fn publish<T: RosMessageType>(&self, topic: &str) -> Outbox<T> {
        let (messages, waiting) = channel(QUEUE);
        let counts = Arc::new(OutCounts::default());
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).push((topic.to_owned(), Arc::clone(&counts)));
        let (waiting, counted) = (Arc::new(tokio::sync::Mutex::new(waiting)), Arc::clone(&counts));
        let name = topic.to_owned();
        let begin = move |node: NodeHandle, _| -> Task {
            Box::pin(write(node, name.clone(), Arc::clone(&waiting), Arc::clone(&counted)))
        };
        self.add(Use {
            topic: topic.to_owned(),
            type_name: T::DESCRIPTION.ros_type_name,
            inbox: None,
            begin: Box::new(begin),
        });
        Outbox { messages, counts }
    }

    /// What is wrong at the moment, in words.
    #[must_use]
    pub fn trouble(&self) -> Option<String> {
        self.state.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Connections made so far, and messages sent and lost by topic.
    #[must_use]
    pub fn counted(&self) -> serde_json::Value {
        let counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let number = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let topics = counts.iter().map(|(topic, counts)| {
            let counted = serde_json::json!({ "sent": number(&counts.sent), "lost": number(&counts.lost) });
            (topic.clone(), counted)
        });
        let topics: serde_json::Map<String, serde_json::Value> = topics.collect();
        serde_json::json!({ "connections": number(&self.state.connections), "published": topics })
    }
}

impl Drop for RosLink {
    fn drop(&mut self) {
        self.uses.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// One registration with a master.
struct Session {
    number: u64,
    node: NodeHandle,
    reading: JoinSet<Ended>,
    writing: JoinSet<Ended>,
}

impl Session {
    fn begin(&mut self, what: &Use) {
        let task = (what.begin)(self.node.clone(), self.number);
        if what.inbox.is_some() {
            self.reading.spawn(task)
        } else {
            self.writing.spawn(task)
        };
    }

    /// Until a task ends that should not; why.
    async fn failed(&mut self) -> String {
        loop {
            let ended = tokio::select! {
                Some(ended) = self.reading.join_next() => ended,
                Some(ended) = self.writing.join_next() => ended,
                else => std::future::pending().await,
            };
            match ended {
                Ok(why) if why.is_empty() => {}
                Ok(why) => return why,
                Err(error) => return format!("a task of ROS has died: {error}"),
            }
        }
    }
}

/// What ends a session.
enum Over {
    /// This node is to leave.
    Leave,
    /// The master knows nothing of this node, or a task failed: register again, after a pause or at once.
    Again { at_once: bool },
}

/// What the thread does.
struct Node {
    master: String,
    name: String,
    state: Arc<State>,
    uses: Vec<Use>,
    asked: UnboundedReceiver<Use>,
}

impl Node {
    async fn work(mut self) {
        // Old ones are kept while their topics have nobody newer: publishers that do not register with a new master
        // still send over the connections that they have.
        let mut sessions: Vec<Session> = Vec::new();
        let mut number = 0;
        loop {
            let mut at_once = false;
            match timeout(PATIENCE, NodeHandle::new(&self.master, &self.name)).await {
                Ok(Ok(node)) => {
                    number += 1;
                    self.state.connections.store(number, Ordering::Relaxed);
                    sessions.retain(|session| self.needs(session.number));
                    sessions.iter_mut().for_each(|session| session.writing = JoinSet::new());
                    let (reading, writing) = (JoinSet::new(), JoinSet::new());
                    let mut session = Session { number, node, reading, writing };
                    self.uses.iter().for_each(|what| session.begin(what));
                    let over = self.serve(&mut session).await;
                    sessions.push(session);
                    match over {
                        Over::Leave => break,
                        Over::Again { at_once: soon } => at_once = soon,
                    }
                }
                Ok(Err(error)) => self.say(Some(format!("the ROS master at {} does not answer: {error}", self.master))),
                Err(_) => self.say(Some(format!("the ROS master at {} does not answer", self.master))),
            }
            if !at_once && !self.pause().await {
                break;
            }
        }
        // Tasks end, and dropped nodes take themselves off the master.
        for session in &mut sessions {
            session.reading.shutdown().await;
            session.writing.shutdown().await;
        }
    }

    fn needs(&self, number: u64) -> bool {
        self.uses.iter().filter_map(|what| what.inbox.as_ref()).any(|inbox| inbox.connection() == number)
    }

    /// Says what is wrong with the connection.
    fn say(&self, trouble: Option<String>) {
        self.state.say(trouble);
    }

    /// A moment before the next try. False if this node is to leave.
    async fn pause(&mut self) -> bool {
        let over = tokio::time::sleep(RETRY);
        tokio::pin!(over);
        loop {
            tokio::select! {
                () = &mut over => return true,
                asked = self.asked.recv() => match asked {
                    Some(what) => self.uses.push(what),
                    None => return false,
                },
            }
        }
    }

    async fn serve(&mut self, session: &mut Session) -> Over {
        let Ok(uri) = session.node.get_client_uri().await else { return Over::Again { at_once: false } };
        let client = match timeout(PATIENCE, MasterClient::new(&self.master, uri, &self.name)).await {
            Ok(Ok(client)) => client,
            _ => return Over::Again { at_once: false },
        };
        self.say(None);
        let mut look = tokio::time::interval(WATCH);
        look.tick().await;
        let mut unknown = 0;
        loop {
            tokio::select! {
                asked = self.asked.recv() => match asked {
                    Some(what) => {
                        session.begin(&what);
                        self.uses.push(what);
                    }
                    None => return Over::Leave,
                },
                why = session.failed() => {
                    self.say(Some(why));
                    return Over::Again { at_once: false };
                }
                _ = look.tick() => {
                    if !session.node.is_ok() {
                        let why = "this node was told to end: has another one its name?";
                        self.say(Some(why.into()));
                        return Over::Again { at_once: false };
                    }
                    unknown = if self.look_after(&client).await { 0 } else { unknown + 1 };
                    if unknown >= UNKNOWN {
                        return Over::Again { at_once: true };
                    }
                }
            }
        }
    }

    /// Asks the master whether it still knows this node. The connections that there are go on without a master: only one
    /// that answers can know nothing.
    async fn look_after(&self, client: &MasterClient) -> bool {
        let asked = async { Ok((client.get_system_state().await?, client.get_topic_types().await?)) };
        let answered: Result<Result<_, roslibrust::ros1::RosMasterError>, _> = timeout(PATIENCE, asked).await;
        let Ok(Ok((known, types))) = answered else {
            self.say(Some(format!("the ROS master at {} does not answer any more", self.master)));
            return true;
        };
        let is_known = |what: &Use| match what.inbox {
            Some(_) => known.is_subscribed(&what.topic, &self.name),
            None => known.is_publishing(&what.topic, &self.name),
        };
        if !self.uses.iter().all(is_known) {
            return false;
        }
        self.state.say(None);
        for what in &self.uses {
            let other = types.iter().find(|(topic, is)| *topic == what.topic && is != what.type_name && is != "*");
            let wrong = other.map(|(_, is)| format!("its type is {is}, not {}", what.type_name));
            match &what.inbox {
                Some(inbox) => inbox.say(wrong),
                None => self.state.say(wrong.map(|wrong| format!("{}: {wrong}", what.topic))),
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_master_messages_are_lost_and_counted_and_nothing_waits() {
        // Nobody listens on port 1.
        let link = RosLink::start("http://127.0.0.1:1".into(), "/csi5300_test".into(), || Some(0)).unwrap();
        let outbox = link.publish::<PoseStamped>("/csi5300_test/pose");
        (0..QUEUE + 9).for_each(|_| outbox.put(PoseStamped::default()));
        let counted = link.counted();
        let topic = &counted["published"]["/csi5300_test/pose"];
        assert_eq!((&topic["lost"], &topic["sent"], &counted["connections"]), (&9.into(), &0.into(), &0.into()));
        let mut poses = link.poses("/odom", Kind::Odometry, Wanted::default());
        let next =
            csi5300::motion::odometry::OdometrySource::receive(&mut poses, csi5300::time::Instant::ZERO).unwrap();
        assert_eq!(next, csi5300::motion::odometry::NextPose::Pending);
        drop(link);
        assert!(outbox.messages.is_closed(), "the thread has ended");
    }
}
