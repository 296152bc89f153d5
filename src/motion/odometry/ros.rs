//! Poses from a topic of ROS, `nav_msgs/Odometry` or `geometry_msgs/PoseStamped`: what a message means, and the bounded
//! queue that its source reads. The connections themselves are in `csi5300-node` (features `ros1` and `ros2`).

use super::{NextPose, OdometryError, OdometrySource};
use crate::motion::pose::{Pose, heading_of};
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
mod tests {
    use super::*;
    use crate::motion::odometry::SourceCounts;
    use std::f64::consts::FRAC_PI_2;

    const NOW_US: i64 = 1_700_000_000_000_000;

    fn message(t_s: f64, frame: &str) -> Message<'_> {
        let stamp = (t_s as u32, ((t_s - t_s.floor()) * 1e9) as u32);
        // Turned by 90 degrees to the left, and not quite of length 1, as single precision leaves it.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        Message { stamp, frame, position_m: [1.0, 2.0, 0.5], orientation: [0.0, 0.0, half * 1.01, half * 1.01] }
    }

    fn reader(stamp: Stamp, frame: Option<&str>) -> Reader {
        Reader::new(Wanted { stamp, frame: frame.map(str::to_owned) })
    }

    #[test]
    fn a_pose_has_the_time_of_its_stamp_or_of_its_receipt() {
        let told = message(1_700_000_000.25, "odom");
        let (begins, pose) = reader(Stamp::Header, None).handle(&told, NOW_US + 300_000).unwrap();
        assert!(!begins && (pose.t_s - 1_700_000_000.25).abs() < 1e-6);
        assert!((pose.heading_rad.unwrap() - FRAC_PI_2).abs() < 1e-9 && pose.position_m == Vector3::new(1.0, 2.0, 0.5));
        let mut receipt = reader(Stamp::Receipt, None);
        let (_, pose) = receipt.handle(&told, NOW_US + 300_000).unwrap();
        assert!((pose.t_s - 1_700_000_000.3).abs() < 1e-6 && (receipt.counts.age_s - 0.05).abs() < 1e-6);
    }

    #[test]
    fn what_cannot_be_a_pose_is_refused_and_counted() {
        let mut reader = reader(Stamp::Header, None);
        let good = message(1_700_000_000.0, "odom");
        for wrong in [
            Message { position_m: [f64::NAN, 0.0, 0.0], ..good },
            Message { position_m: [0.0, f64::NEG_INFINITY, 0.0], ..good },
            Message { orientation: [0.0; 4], ..good },
            Message { orientation: [f64::NAN, 0.0, 0.0, 1.0], ..good },
            Message { orientation: [f64::MAX; 4], ..good },
            Message { stamp: (0, 0), ..good },
        ] {
            assert_eq!(reader.handle(&wrong, NOW_US), None, "{wrong:?}");
        }
        assert!(reader.handle(&good, NOW_US).is_some());
        let counts = reader.counts;
        assert_eq!((counts.messages, counts.not_finite, counts.unstamped), (7, 5, 1));
    }

    #[test]
    fn another_frame_is_refused_if_one_was_asked_for_and_begins_anew_if_not() {
        let mut asked = reader(Stamp::Header, Some("odom"));
        assert!(asked.handle(&message(1.0, "/odom"), 1_000_000).is_some(), "the slash of old means nothing");
        assert!(asked.handle(&message(1.1, "map"), 1_100_000).is_none());
        assert_eq!(asked.counts.other_frame, 1);
        let mut any = reader(Stamp::Header, None);
        let begins = |(frame, t_s)| any.handle(&message(t_s, frame), 0).unwrap().0;
        let told = [("odom", 1.0), ("odom", 1.1), ("map", 1.2), ("map", 1.15), ("map", 0.1), ("map", 0.2)];
        // A late one is late; stamps that go back by more than a second are of another run.
        assert_eq!(told.map(begins), [false, false, true, false, true, false]);
        assert_eq!(any.counts.new_frames, 2);
    }

    #[test]
    fn stamps_of_another_clock_are_said() {
        let mut simulated = reader(Stamp::Header, None);
        simulated.handle(&message(12.5, "odom"), NOW_US).unwrap();
        let why = simulated.trouble().unwrap();
        assert!(why.contains("1699999987.5 s behind") && why.contains("receipt"), "{why}");
        let mut unstamped = reader(Stamp::Header, None);
        unstamped.handle(&message(0.0, "odom"), NOW_US);
        assert!(unstamped.trouble().unwrap().contains("no stamps"));
        let mut receipt = reader(Stamp::Receipt, None);
        receipt.handle(&message(0.0, "odom"), NOW_US).unwrap();
        assert_eq!(receipt.trouble(), None);
    }

    fn drained(source: &mut Topic, now: Instant) -> (usize, usize) {
        let (mut poses, mut frames) = (0, 0);
        loop {
            match source.receive(now).unwrap() {
                NextPose::Pose(_) => poses += 1,
                NextPose::NewFrame => frames += 1,
                _ => return (poses, frames),
            }
        }
    }

    #[test]
    fn a_reader_that_stands_still_costs_poses_and_they_are_counted() {
        let inbox = Inbox::new("/odom", Wanted::default());
        let mut source = inbox.source();
        for k in 0..QUEUE + 10 {
            assert!(inbox.put(1, &message(1.0 + k as f64 * 1e-3, "odom"), 0));
        }
        inbox.dropped(5);
        inbox.unreadable();
        let counted = |source: &Topic| match source.counted() {
            Some(SourceCounts::Topic(counts)) => (counts.dropped, counts.unreadable),
            other => panic!("{other:?}"),
        };
        assert_eq!(counted(&source), (15, 1));
        assert_eq!(drained(&mut source, Instant::ZERO), (QUEUE, 0));
        // What waits in a frame that is over is of no use.
        inbox.put(1, &message(6.0, "odom"), 0);
        inbox.put(1, &message(6.1, "map"), 0);
        assert_eq!(drained(&mut source, Instant::ZERO), (1, 1));
        assert_eq!(counted(&source), (16, 1));
    }

    #[test]
    fn a_new_connection_takes_over_with_its_first_message() {
        let inbox = Inbox::new("/odom", Wanted::default());
        let put = |connection, t_s| inbox.put(connection, &message(t_s, "odom"), 0);
        assert!(put(1, 1.0) && put(1, 1.1), "the old one goes on while the new one is silent");
        assert!(put(3, 1.2));
        assert!(!put(1, 1.3) && !put(2, 1.3), "and ends with it");
        assert_eq!((inbox.connection(), drained(&mut inbox.source(), Instant::ZERO)), (3, (3, 0)));
    }

    #[test]
    fn silence_is_said_and_ends_with_the_next_message() {
        let inbox = Inbox::new("/odom", Wanted { stamp: Stamp::Receipt, frame: None });
        let mut source = inbox.source();
        let mut look = |ms: i64| {
            source.receive(Instant::from_us(ms * 1_000)).unwrap();
            source.trouble()
        };
        assert_eq!(look(0), None);
        assert_eq!(look(1_999), None);
        assert!(look(2_000).unwrap().starts_with("/odom: nothing comes: "));
        inbox.put(1, &message(1.0, "odom"), 1_000_000);
        assert_eq!(look(2_100), None);
        assert!(look(5_000).unwrap().contains("any more"));
        inbox.say(Some("the master does not answer".into()));
        assert_eq!(look(5_000).as_deref(), Some("/odom: the master does not answer"));
    }
}
