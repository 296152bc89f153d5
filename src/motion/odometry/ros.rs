//! Poses from a topic of ROS, `nav_msgs/Odometry` or `geometry_msgs/PoseStamped`: what a message means, and the bounded
//! queue that its source reads. The connections themselves are in `csi5300-node` (features `ros1` and `ros2`).

use super::{NextPose, OdometryError, OdometrySource};
use crate::motion::heading::heading_of;
use crate::motion::pose::Pose;
use crate::time::{Instant, Span};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Poses that wait at most; further ones are dropped and counted.
const QUEUE: usize = 4_096;
/// Stamps that go back by more than this are of a simulation that restarted, or of a clock that was set, seconds.
const BACK_S: f64 = 1.0;
/// Stamps further than this from the host's clock are no use beside records, which it stamps, seconds.
const OTHER_CLOCK_S: f64 = 1.0;
/// A topic that is silent for this time is in trouble.
const QUIET: Span = Span::from_ms(2_000);

/// What is published on a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// `nav_msgs/Odometry`.
    #[default]
    Odometry,
    /// `geometry_msgs/PoseStamped`.
    Pose,
}

/// The source of a pose's time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stamp {
    /// The message's own stamp: the time of the measurement, on its publisher's clock.
    #[default]
    Header,
    /// The time at which it came, on this host's clock: for simulated time, and publishers that stamp nothing.
    Receipt,
}

/// What is wanted of a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// The source of the time.
    pub stamp: Stamp,
    /// Poses of other frames are refused; without it the frame of the first message is taken, and another one is a new
    /// frame.
    pub frame: Option<String>,
}

/// The part of a message that is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Message<'a> {
    /// Seconds and nanoseconds of its stamp.
    pub stamp: (u32, u32),
    /// `frame_id` of its header.
    pub frame: &'a str,
    /// Metres.
    pub position_m: [f64; 3],
    /// x, y, z, w.
    pub orientation: [f64; 4],
}

/// Counts of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct TopicCounts {
    /// Messages that came.
    pub messages: u64,
    /// Messages that are not of the topic's type.
    pub unreadable: u64,
    /// Poses that are not finite, or whose quaternion has no length.
    pub not_finite: u64,
    /// Poses of another frame than the requested one.
    pub other_frame: u64,
    /// Poses without a stamp, where stamps are used.
    pub unstamped: u64,
    /// Poses dropped because too many waited, here or in the client library.
    pub dropped: u64,
    /// Times that the frame changed, or that stamps went back.
    pub new_frames: u64,
    /// Receipt of the last message after its stamp, seconds.
    pub age_s: f64,
}

/// Makes poses of messages.
#[derive(Clone, Debug, Default)]
pub struct Reader {
    wanted: Wanted,
    frame: Option<String>,
    last_s: Option<f64>,
    /// The next pose begins a frame.
    begins: bool,
    counts: TopicCounts,
}

impl Reader {
    /// A reader.
    #[must_use]
    pub fn new(wanted: Wanted) -> Self {
        Self { wanted, ..Self::default() }
    }

    /// Takes a message that came at `received_us` on the host's wall clock. Returns whether its pose starts another
    /// frame, and the pose; `None` if it is refused, which is counted.
    pub fn handle(&mut self, message: &Message<'_>, received_us: i64) -> Option<(bool, Pose)> {
        self.counts.messages += 1;
        let frame = message.frame.trim_start_matches('/');
        if let Some(wanted) = &self.wanted.frame
            && wanted.trim_start_matches('/') != frame
        {
            self.counts.other_frame += 1;
            return None;
        }
        let received_s = received_us as f64 * 1e-6;
        let stamp_s = f64::from(message.stamp.0) + f64::from(message.stamp.1) * 1e-9;
        self.counts.age_s = received_s - stamp_s;
        let t_s = match self.wanted.stamp {
            Stamp::Receipt => received_s,
            Stamp::Header if message.stamp == (0, 0) => {
                self.counts.unstamped += 1;
                return None;
            }
            Stamp::Header => stamp_s,
        };
        let [x, y, z, w] = message.orientation;
        let rotation = Quaternion::new(w, x, y, z);
        let norm = rotation.norm();
        if !message.position_m.iter().all(|x| x.is_finite()) || !norm.is_finite() || norm <= 1e-6 {
            self.counts.not_finite += 1;
            return None;
        }
        let heading_rad = heading_of(&UnitQuaternion::from_quaternion(rotation));
        if self.frame.as_deref() != Some(frame) {
            self.begins |= self.frame.replace(frame.to_owned()).is_some();
        }
        self.begins |= self.last_s.is_some_and(|last_s| t_s < last_s - BACK_S);
        // A late one does not move the newest time.
        self.last_s = Some(if self.begins { t_s } else { self.last_s.map_or(t_s, |last_s| last_s.max(t_s)) });
        let begins = std::mem::take(&mut self.begins);
        self.counts.new_frames += u64::from(begins);
        Some((begins, Pose { t_s, position_m: Vector3::from(message.position_m), heading_rad: Some(heading_rad) }))
    }

    /// What is wrong with the stamps, if anything is.
    fn trouble(&self) -> Option<String> {
        let hint = "`stamp = \"receipt\"` takes the time at which poses come";
        if self.wanted.stamp == Stamp::Receipt || self.counts.messages == 0 {
            None
        } else if self.counts.unstamped > 0 && self.last_s.is_none() {
            Some(format!("its messages have no stamps: {hint}"))
        } else if self.counts.age_s.abs() > OTHER_CLOCK_S && self.last_s.is_some() {
            let age_s = self.counts.age_s;
            Some(format!("its stamps are {age_s:.1} s behind this host's clock: set the clocks (NTP); {hint}"))
        } else {
            None
        }
    }
}

#[derive(Debug, Default)]
struct State {
    reader: Reader,
    queue: VecDeque<NextPose>,
    /// The newest connection from which something came.
    connection: u64,
    /// What is wrong with the connection.
    wrong: Option<String>,
}

/// Where a connection puts a topic's messages.
#[derive(Clone, Debug)]
pub struct Inbox {
    topic: Arc<str>,
    state: Arc<Mutex<State>>,
}

impl Inbox {
    /// An empty one for `topic`.
    #[must_use]
    pub fn new(topic: &str, wanted: Wanted) -> Self {
        let state = State { reader: Reader::new(wanted), ..State::default() };
        Self { topic: topic.into(), state: Arc::new(Mutex::new(state)) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Takes a message that came over connection number `connection`. False if a newer one gives them already.
    pub fn put(&self, connection: u64, message: &Message<'_>, received_us: i64) -> bool {
        let mut state = self.lock();
        if state.connection > connection {
            return false;
        }
        state.connection = connection;
        let Some((begins, pose)) = state.reader.handle(message, received_us) else { return true };
        if begins {
            // What waits is in a frame that is over.
            state.reader.counts.dropped += state.queue.len() as u64;
            state.queue.clear();
            state.queue.push_back(NextPose::NewFrame);
        }
        if state.queue.len() < QUEUE {
            state.queue.push_back(NextPose::Pose(pose));
        } else {
            state.reader.counts.dropped += 1;
        }
        true
    }

    /// Counts messages dropped on the way.
    pub fn dropped(&self, messages: u64) {
        self.lock().reader.counts.dropped += messages;
    }

    /// A message could not be read.
    pub fn unreadable(&self) {
        self.lock().reader.counts.unreadable += 1;
    }

    /// The newest connection from which something came, 0 before the first.
    #[must_use]
    pub fn connection(&self) -> u64 {
        self.lock().connection
    }

    /// What is wrong with the connection from now on.
    pub fn say(&self, wrong: Option<String>) {
        self.lock().wrong = wrong;
    }

    /// The poses. There should be one: several would share them.
    #[must_use]
    pub fn source(&self) -> Topic {
        Topic { inbox: self.clone(), messages: 0, heard_at: None, quiet: false }
    }
}

/// The poses of a topic.
#[derive(Debug)]
pub struct Topic {
    inbox: Inbox,
    /// Messages at the last look, and when their number last changed.
    messages: u64,
    heard_at: Option<Instant>,
    quiet: bool,
}

impl OdometrySource for Topic {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        let mut state = self.inbox.lock();
        let messages = state.reader.counts.messages;
        if std::mem::replace(&mut self.messages, messages) != messages || self.heard_at.is_none() {
            self.heard_at = Some(now);
        }
        self.quiet = self.heard_at.is_some_and(|heard_at| now - heard_at >= QUIET);
        Ok(state.queue.pop_front().unwrap_or(NextPose::Pending))
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }

    fn trouble(&self) -> Option<String> {
        let state = self.inbox.lock();
        let why = state.wrong.clone().or_else(|| state.reader.trouble()).or_else(|| {
            let why = if self.messages == 0 { "nothing comes" } else { "nothing comes any more" };
            self.quiet.then(|| format!("{why}: does its publisher run? (rostopic info, ros2 topic info)"))
        })?;
        Some(format!("{}: {why}", self.inbox.topic))
    }

    fn counted(&self) -> Option<super::SourceCounts> {
        Some(super::SourceCounts::Topic(self.inbox.lock().reader.counts))
    }
}

#[cfg(test)]
#[path = "ros_tests.rs"]
mod tests;
