//! Poses from a topic of ROS, `nav_msgs/Odometry` or `geometry_msgs/PoseStamped`: what a message means, and the bounded
//! queue that its source reads. The connections themselves are in `csi5300-node` (features `ros1` and `ros2`).

use super::{NextPose, OdometrySource};
use crate::motion::pose::{Pose, heading_of};
use crate::source::Error;
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
/// A publisher that is silent for this time loses its topic to another one, microseconds.
const OWNED_US: u64 = 1_000_000;
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
    /// Its publisher; after a restart it is another one.
    pub publisher: u128,
    /// Seconds and nanoseconds of its stamp.
    pub stamp: (u32, u32),
    /// The host's clock minus that of the stamp, microseconds: 0 without simulated time.
    pub ahead_us: i64,
    /// `frame_id` of its header.
    pub frame: &'a str,
    /// Metres.
    pub position_m: [f64; 3],
    /// x, y, z, w.
    pub orientation: [f64; 4],
}

/// Counts of a topic.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct TopicCounts {
    /// Frame of the poses; empty before the first.
    pub frame: String,
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
    /// Poses of a second publisher beside the one that is read.
    pub contested: u64,
    /// Poses dropped because too many waited.
    pub dropped: u64,
    /// Times that the frame or the publisher changed, or that stamps went back.
    pub new_frames: u64,
    /// Receipt of the last message after its stamp, seconds.
    pub age_s: f64,
}

/// Makes poses of messages.
#[derive(Clone, Debug, Default)]
pub struct Reader {
    wanted: Wanted,
    /// The publisher that is read, and when its last pose came, microseconds.
    publisher: Option<(u128, i64)>,
    /// When a pose of another one last came, microseconds.
    contested_us: i64,
    /// The newest time on the publisher's clock, seconds.
    last_s: Option<f64>,
    /// The frame of a message that was refused after the last pose.
    refused: Option<String>,
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
        let frame = plain(message.frame);
        if self.is_elsewhere(frame) {
            self.counts.other_frame += 1;
            self.refused = Some(frame.to_owned());
            return None;
        }
        let received_s = received_us as f64 * 1e-6;
        let host_s = stamp_s(message) + message.ahead_us as f64 * 1e-6;
        self.counts.age_s = received_s - host_s;
        let t_s = match self.wanted.stamp {
            Stamp::Receipt => received_s,
            Stamp::Header if message.stamp == (0, 0) => {
                self.counts.unstamped += 1;
                return None;
            }
            Stamp::Header => host_s,
        };
        let [x, y, z, w] = message.orientation;
        let rotation = Quaternion::new(w, x, y, z);
        let norm = rotation.norm();
        if !message.position_m.iter().all(|x| x.is_finite()) || !norm.is_finite() || norm <= 1e-6 {
            self.counts.not_finite += 1;
            return None;
        }
        if self.is_contested(message, received_us) {
            (self.counts.contested, self.contested_us) = (self.counts.contested + 1, received_us);
            return None;
        }
        let heading_rad = heading_of(&UnitQuaternion::from_quaternion(rotation));
        let begins = self.begins(message, received_us);
        self.counts.new_frames += u64::from(begins);
        if self.counts.frame != frame {
            frame.clone_into(&mut self.counts.frame);
        }
        // A late one does not move the newest time.
        let now_s = own_s(message, received_us);
        self.last_s = Some(self.last_s.filter(|_| !begins).map_or(now_s, |last_s| last_s.max(now_s)));
        (self.publisher, self.refused) = (Some((message.publisher, received_us)), None);
        Some((begins, Pose { t_s, position_m: Vector3::from(message.position_m), heading_rad: Some(heading_rad) }))
    }

    fn is_elsewhere(&self, frame: &str) -> bool {
        self.wanted.frame.as_deref().is_some_and(|wanted| plain(wanted) != frame)
    }

    fn is_contested(&self, message: &Message<'_>, received_us: i64) -> bool {
        let is_other = |(known, at_us)| known != message.publisher && received_us.abs_diff(at_us) < OWNED_US;
        self.publisher.is_some_and(is_other)
    }

    /// True if a pose in this message is used and in another frame than the last one: by the frame's name, by a restart of its
    /// publisher, or of the publisher's clock.
    fn begins(&self, message: &Message<'_>, received_us: i64) -> bool {
        let (Some((publisher, _)), Some(last_s), frame) = (self.publisher, self.last_s, plain(message.frame)) else {
            return false;
        };
        let is_used = !self.is_elsewhere(frame) && !self.is_contested(message, received_us);
        let is_back = own_s(message, received_us) < last_s - BACK_S;
        is_used && (publisher != message.publisher || self.counts.frame != frame || is_back)
    }

    /// What is wrong with the messages, if anything is.
    fn trouble(&self) -> Option<String> {
        if let Some((frame, wanted)) = self.refused.as_ref().zip(self.wanted.frame.as_ref()) {
            return Some(format!("its poses are in frame `{frame}`, not in `{wanted}` (`frame`)"));
        }
        let last_us = self.publisher.map_or(0, |(_, at_us)| at_us);
        if self.counts.contested > 0 && last_us.abs_diff(self.contested_us) < OWNED_US {
            return Some("it has two publishers: only the poses of one are used".into());
        }
        let hint = "`stamp = \"receipt\"` takes the time at which poses come";
        if self.wanted.stamp == Stamp::Receipt || self.counts.messages == 0 {
            None
        } else if self.counts.unstamped > 0 && self.last_s.is_none() {
            Some(format!("its messages have no stamps: {hint}"))
        } else if self.counts.age_s.abs() > OTHER_CLOCK_S && self.last_s.is_some() {
            let (age_s, side) = (self.counts.age_s, if self.counts.age_s > 0.0 { "behind" } else { "ahead of" });
            Some(format!("its stamps are {:.1} s {side} this host's clock: set the clocks (NTP); {hint}", age_s.abs()))
        } else {
            None
        }
    }
}

/// A frame's name without the leading slash of early releases.
#[must_use]
pub fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The stamp, seconds.
fn stamp_s(message: &Message<'_>) -> f64 {
    f64::from(message.stamp.0) + f64::from(message.stamp.1) * 1e-9
}

/// The time on the publisher's clock, seconds; on the host's without a stamp.
fn own_s(message: &Message<'_>, received_us: i64) -> f64 {
    if message.stamp == (0, 0) { received_us as f64 * 1e-6 } else { stamp_s(message) }
}

#[derive(Debug, Default)]
struct State {
    reader: Reader,
    queue: VecDeque<NextPose>,
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

    /// Takes a message that came at `received_us`, host time.
    pub fn put(&self, message: &Message<'_>, received_us: i64) {
        let mut state = self.lock();
        let Some((begins, pose)) = state.reader.handle(message, received_us) else { return };
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
    }

    /// True if a pose in this message would be in another frame than the last one.
    #[must_use]
    pub fn begins(&self, message: &Message<'_>, received_us: i64) -> bool {
        self.lock().reader.begins(message, received_us)
    }

    /// A message could not be read.
    pub fn unreadable(&self) {
        self.lock().reader.counts.unreadable += 1;
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
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
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
        Some(super::SourceCounts::Topic(self.inbox.lock().reader.counts.clone()))
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
        let (position_m, orientation) = ([1.0, 2.0, 0.5], [0.0, 0.0, half * 1.01, half * 1.01]);
        Message { publisher: 1, stamp, ahead_us: 0, frame, position_m, orientation }
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
            inbox.put(&message(1.0 + k as f64 * 1e-3, "odom"), 0);
        }
        inbox.unreadable();
        let counted = |source: &Topic| match source.counted() {
            Some(SourceCounts::Topic(counts)) => (counts.dropped, counts.unreadable),
            other => panic!("{other:?}"),
        };
        assert_eq!(counted(&source), (10, 1));
        assert_eq!(drained(&mut source, Instant::ZERO), (QUEUE, 0));
        // What waits in a frame that is over is of no use.
        inbox.put(&message(6.0, "odom"), 0);
        inbox.put(&message(6.1, "map"), 0);
        assert_eq!(drained(&mut source, Instant::ZERO), (1, 1));
        assert_eq!(counted(&source), (11, 1));
    }

    #[test]
    fn a_restarted_publisher_begins_a_frame_and_a_second_one_is_refused() {
        for stamp in [Stamp::Header, Stamp::Receipt] {
            let mut reader = reader(stamp, None);
            let mut put = |publisher, t_s: f64| {
                let message = Message { publisher, ..message(t_s, "odom") };
                reader.handle(&message, (t_s * 1e6) as i64).map(|(begins, _)| begins)
            };
            assert_eq!([put(1, 1.0), put(2, 1.1), put(1, 1.2)], [Some(false), None, Some(false)]);
            // The first one ended at 1.2 s.
            assert_eq!([put(2, 2.1), put(2, 2.3), put(2, 2.4)], [None, Some(true), Some(false)]);
            assert_eq!((reader.counts.contested, reader.counts.new_frames), (2, 1));
            assert!(reader.trouble().unwrap().contains("two publishers"));
        }
    }

    #[test]
    fn a_simulation_that_begins_again_begins_a_frame() {
        for stamp in [Stamp::Header, Stamp::Receipt] {
            let mut reader = reader(stamp, None);
            // Simulated time starts again at 60 s of the host.
            let mut put = |now_s: f64, began_s: f64| {
                let ahead_us = (began_s * 1e6) as i64;
                let message = Message { ahead_us, ..message(now_s - began_s, "odom") };
                reader.handle(&message, (now_s * 1e6) as i64).map(|(begins, pose)| (begins, pose.t_s))
            };
            assert_eq!([put(50.0, 10.0), put(60.5, 60.0)], [Some((false, 50.0)), Some((true, 60.5))]);
        }
    }

    #[test]
    fn poses_in_another_frame_than_the_requested_one_are_said() {
        let mut reader = reader(Stamp::Header, Some("odom"));
        reader.handle(&message(1.0, "world"), 1_000_000);
        assert_eq!(reader.trouble().unwrap(), "its poses are in frame `world`, not in `odom` (`frame`)");
        reader.handle(&message(1.1, "odom"), 1_100_000);
        assert_eq!((reader.trouble(), reader.counts.frame.as_str()), (None, "odom"));
        let late = reader.handle(&message(1.2, "odom"), -2_000_000);
        assert!(late.is_some() && reader.trouble().unwrap().contains("3.2 s ahead of this host's clock"));
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
        inbox.put(&message(1.0, "odom"), 1_000_000);
        assert_eq!(look(2_100), None);
        assert!(look(5_000).unwrap().contains("any more"));
        inbox.say(Some("the master does not answer".into()));
        assert_eq!(look(5_000).as_deref(), Some("/odom: the master does not answer"));
    }
}
