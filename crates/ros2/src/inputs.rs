//! Poses from ROS 2 topics (odometry, motion capture, transforms), the antenna's place from `/tf_static`, orientation from an
//! inertial unit, ranges, and simulated time.

use super::link::{Came, Link};
use super::lock;
use super::rtps::Qos;
use crate::settings::{Kind, Topic};
use csi5300::internal::heading_of;
use csi5300::motion::odometry::ros::{self, Inbox, Message, Stamp, Wanted, plain};
use csi5300_bag::messages::{Clock, Header, Imu, Odometry, PoseStamped, TfMessage, TransformStamped};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};

/// Messages that a reader of poses or ranges keeps.
pub(crate) const DEPTH: u32 = 64;
/// An orientation of the inertial unit older than this is not used, microseconds.
const IMU_US: i64 = 200_000;
/// Frames that are kept at most.
const FRAMES: usize = 1_024;
/// Steps from one frame to another at most.
const STEPS: usize = 64;
/// No `/clock` was received.
const UNKNOWN: i64 = i64::MIN;

/// Host clock minus simulated clock, by the newest `/clock`.
#[derive(Clone, Debug)]
pub(crate) struct SimClock(Option<Arc<AtomicI64>>);

impl SimClock {
    /// The host's own time.
    pub fn real() -> Self {
        Self(None)
    }

    /// The time of `/clock`.
    pub fn follow(link: &Link) -> Self {
        let ahead = Arc::new(AtomicI64::new(UNKNOWN));
        let told = Arc::clone(&ahead);
        let used =
            move |clock: Clock, came: Came| told.store(came.at_us.saturating_sub(clock.clock.us()), Ordering::Relaxed);
        link.subscribe("/clock", Qos::best_effort(1), used, || ());
        Self(Some(ahead))
    }

    fn ahead_us(&self) -> Option<i64> {
        match &self.0 {
            None => Some(0),
            Some(ahead) => Some(ahead.load(Ordering::Relaxed)).filter(|ahead| *ahead != UNKNOWN),
        }
    }

    /// True before the first `/clock`.
    pub fn is_unknown(&self) -> bool {
        self.ahead_us().is_none()
    }

    /// Converts a stamp to host time, microseconds.
    pub fn to_host(&self, stamp_us: i64) -> Option<i64> {
        stamp_us.checked_add(self.ahead_us()?)
    }

    /// Converts host time to a stamp; 0 before the first `/clock`, and for an unknown time (0): no stamp may be negative.
    pub fn to_stamp(&self, host_us: i64) -> i64 {
        self.ahead_us().map_or(0, |ahead| host_us.saturating_sub(ahead).max(0))
    }
}

/// Replaces odometry's heading by the inertial unit's; the two differ by a constant angle.
#[derive(Clone, Copy, Debug, Default)]
struct Turns {
    /// The newest orientation and its time of receipt.
    newest: Option<(f64, i64)>,
    /// Odometry's heading minus the unit's, when both were first known.
    offset_rad: Option<f64>,
}

impl Turns {
    fn handle(&mut self, imu: &Imu, received_us: i64) {
        // The unit provides no orientation.
        let unknown = imu.orientation_covariance.first() == Some(&-1.0);
        if let Some(turned) = imu.orientation.rotation().filter(|_| !unknown) {
            self.newest = Some((heading_of(&turned), received_us));
        }
    }

    /// The pose with the unit's heading, if that is recent.
    fn apply(&mut self, pose: Isometry3<f64>, received_us: i64) -> Isometry3<f64> {
        let Some((newest, at)) = self.newest else { return pose };
        if received_us.saturating_sub(at) > IMU_US {
            // It may have restarted when it comes back.
            self.offset_rad = None;
            return pose;
        }
        let own = heading_of(&pose.rotation);
        let offset = *self.offset_rad.get_or_insert(own - newest);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), newest + offset - own);
        Isometry3::from_parts(pose.translation, turn * pose.rotation)
    }
}

/// State that the subscriptions of one source of poses share.
struct Shared {
    inbox: Inbox,
    clock: SimClock,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    tree: Tree,
    turns: Turns,
}

impl Shared {
    /// Passes on a pose of the robot in the frame of `header`, moved to a place `mounted` on the robot.
    fn put(&self, state: &mut State, header: &Header, pose: Isometry3<f64>, mounted: Isometry3<f64>, came: Came) {
        let Some(ahead_us) = self.clock.ahead_us() else {
            return self.inbox.say(Some("no message on /clock, which `use_sim_time` needs".into()));
        };
        self.inbox.say(None);
        let mut message = Message {
            publisher: came.publisher,
            stamp: (u32::try_from(header.stamp.sec).unwrap_or(0), header.stamp.nanosec),
            ahead_us,
            frame: &header.frame_id,
            position_m: [0.0; 3],
            orientation: [0.0; 4],
        };
        if self.inbox.begins(&message, came.at_us) {
            state.turns.offset_rad = None;
        }
        // The heading is the robot's; the antenna's offset is rotated by it.
        let pose = state.turns.apply(pose, came.at_us);
        let turned = pose.rotation.coords;
        message.position_m = (pose * mounted).translation.vector.into();
        message.orientation = [turned.x, turned.y, turned.z, turned.w];
        self.inbox.put(&message, came.at_us);
    }

    fn odometry(&self, odometry: &Odometry, antenna: Option<&str>, came: Came) {
        let mut state = lock(&self.state);
        let Some(pose) = odometry.pose.pose.isometry() else { return self.inbox.unreadable() };
        let mounted = match antenna {
            None => Isometry3::identity(),
            Some(antenna) => match state.tree.find(&odometry.child_frame_id, antenna) {
                Some((mounted, _)) => mounted,
                None => {
                    let robot = &odometry.child_frame_id;
                    let why = format!("/tf_static has no transform from {robot} to {antenna}");
                    return self.inbox.say(Some(why));
                }
            },
        };
        self.put(&mut state, &odometry.header, pose, mounted, came);
    }

    fn transforms(&self, told: &TfMessage, is_fixed: bool, wanted: Option<(&str, &str)>, came: Came) {
        let mut state = lock(&self.state);
        for one in &told.transforms {
            if !state.tree.handle(one, is_fixed) {
                self.inbox.unreadable();
            }
        }
        let Some((from, to)) = wanted.filter(|_| !is_fixed) else { return };
        let Some((pose, moving)) = state.tree.find(from, to) else {
            return self.inbox.say(Some(format!("no transforms lead from {from} to {to}")));
        };
        // The stamp of the lowest moving frame counts: those above it may be stamped ahead, as AMCL does.
        let newest = told.transforms.iter().filter(|one| Some(one.child_frame_id.trim_start_matches('/')) == moving);
        if let Some(newest) = newest.max_by_key(|one| one.header.stamp.us()) {
            let header = Header { stamp: newest.header.stamp.clone(), frame_id: from.to_owned() };
            self.put(&mut state, &header, pose, Isometry3::identity(), came);
        }
    }
}

/// The poses of `topic`; `usual` is the time source unless the topic names one.
pub(crate) fn poses(link: &Link, topic: &Topic, usual: Stamp, clock: &SimClock) -> ros::Topic {
    let frame = if topic.kind == Kind::Tf { None } else { topic.frame.clone() };
    let wanted = Wanted { stamp: topic.stamp.unwrap_or(usual), frame };
    let name = link.names().whole(topic.name());
    // With times of receipt, stamps do not matter.
    let clock = if wanted.stamp == Stamp::Receipt { SimClock::real() } else { clock.clone() };
    let shared = Arc::new(Shared { inbox: Inbox::new(&name, wanted), clock, state: Mutex::default() });
    subscribe(link, topic, &shared);
    if topic.kind == Kind::Tf || topic.antenna_frame.is_some() {
        let fixed = Arc::clone(&shared);
        let used = move |told: TfMessage, came| fixed.transforms(&told, true, None, came);
        link.subscribe("/tf_static", Qos::latched(DEPTH), used, || ());
    }
    if let Some(imu) = &topic.imu {
        let turned = Arc::clone(&shared);
        let used = move |imu: Imu, came: Came| lock(&turned.state).turns.handle(&imu, came.at_us);
        link.subscribe(imu, Qos::best_effort(DEPTH), used, || ());
    }
    shared.inbox.source()
}

fn subscribe(link: &Link, topic: &Topic, shared: &Arc<Shared>) {
    let (into, bad) = (Arc::clone(shared), Arc::clone(shared));
    let unreadable = move || bad.inbox.unreadable();
    // A best-effort, volatile reader matches every publisher.
    let qos = Qos::best_effort(DEPTH);
    match topic.kind {
        Kind::Odometry => {
            let antenna = topic.antenna_frame.clone();
            let used = move |told: Odometry, came| into.odometry(&told, antenna.as_deref(), came);
            link.subscribe(topic.name(), qos, used, unreadable)
        }
        Kind::Pose => {
            let used = move |told: PoseStamped, came| match told.pose.isometry() {
                Some(pose) => into.put(&mut lock(&into.state), &told.header, pose, Isometry3::identity(), came),
                None => into.inbox.unreadable(),
            };
            link.subscribe(topic.name(), qos, used, unreadable)
        }
        Kind::Tf => {
            let (from, to) = (topic.frame.clone().unwrap_or_default(), topic.child.clone().unwrap_or_default());
            let used = move |told: TfMessage, came| into.transforms(&told, false, Some((&from, &to)), came);
            link.subscribe(topic.name(), qos, used, unreadable)
        }
    }
}

/// What is known of a frame.
#[derive(Clone, Debug)]
struct Frame {
    parent: String,
    transform: Isometry3<f64>,
    is_fixed: bool,
}

/// Frames by their names, each with its parent.
#[derive(Clone, Debug, Default)]
struct Tree {
    frames: BTreeMap<String, Frame>,
}

impl Tree {
    /// Takes a transform. False if it is invalid, or one frame too many.
    pub fn handle(&mut self, told: &TransformStamped, is_fixed: bool) -> bool {
        let child = plain(&told.child_frame_id);
        let Some(transform) = told.transform.isometry() else { return false };
        if self.frames.len() >= FRAMES && !self.frames.contains_key(child) {
            return false;
        }
        let parent = plain(&told.header.frame_id).to_owned();
        self.frames.insert(child.to_owned(), Frame { parent, transform, is_fixed });
        true
    }

    /// The pose of `to` in its ancestor `from`, and the lowest moving frame on the way.
    pub fn find(&self, from: &str, to: &str) -> Option<(Isometry3<f64>, Option<&str>)> {
        let (from, mut at) = (plain(from), plain(to));
        let (mut whole, mut moving) = (Isometry3::identity(), None);
        for _ in 0..STEPS {
            if at == from {
                return Some((whole, moving));
            }
            let (name, frame) = self.frames.get_key_value(at)?;
            whole = frame.transform * whole;
            if !frame.is_fixed && moving.is_none() {
                moving = Some(name.as_str());
            }
            at = &frame.parent;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::odometry::{NextPose, OdometrySource};
    use csi5300::time::Instant;
    use csi5300_bag::messages::{Quaternion, Time, Transform, Vector3 as Numbers};
    use std::f64::consts::FRAC_PI_2;

    /// A transform to a place, turned by a heading.
    fn transform(parent: &str, child: &str, t_s: f64, [x, y, z]: [f64; 3], heading: f64) -> TransformStamped {
        let header = Header { stamp: Time::from_us((t_s * 1e6) as i64), frame_id: parent.into() };
        let transform = Transform { translation: Numbers { x, y, z }, rotation: turned(heading) };
        TransformStamped { header, child_frame_id: child.into(), transform }
    }

    #[test]
    fn transforms_are_followed_down_the_tree() {
        let mut tree = Tree::default();
        assert!(tree.handle(&transform("/odom", "base_link", 0.0, [1.0, 0.0, 0.0], FRAC_PI_2), false));
        assert!(tree.handle(&transform("base_link", "antenna", 0.0, [0.5, 0.0, 0.2], 0.0), true));
        let (whole, moving) = tree.find("odom", "antenna").unwrap();
        assert!((whole.translation.vector - Vector3::new(1.0, 0.5, 0.2)).norm() < 1e-12, "{whole}");
        assert_eq!(moving, Some("base_link"));
        assert_eq!(tree.find("base_link", "antenna").unwrap().1, None);
        assert!(tree.find("map", "antenna").is_none() && tree.find("antenna", "odom").is_none());
    }

    #[test]
    fn loops_end_and_invalid_transforms_are_refused() {
        let mut tree = Tree::default();
        tree.handle(&transform("a", "b", 0.0, [0.0; 3], 0.0), false);
        tree.handle(&transform("b", "a", 0.0, [0.0; 3], 0.0), false);
        assert!(tree.find("map", "a").is_none());
        assert!(!tree.handle(&transform("a", "c", 0.0, [f64::NAN, 0.0, 0.0], 0.0), false));
        let mut no_turn = transform("a", "c", 0.0, [0.0; 3], 0.0);
        no_turn.transform.rotation = Quaternion::default();
        assert!(!tree.handle(&no_turn, false));
        for k in 0..2 * FRAMES {
            tree.handle(&transform("a", &format!("f{k}"), 0.0, [0.0; 3], 0.0), false);
        }
        assert_eq!(tree.frames.len(), FRAMES);
    }

    fn shared(stamp: Stamp) -> Shared {
        let inbox = Inbox::new("/odom", Wanted { stamp, frame: None });
        Shared { inbox, clock: SimClock::real(), state: Mutex::default() }
    }

    fn came(at_us: i64) -> Came {
        Came { at_us, publisher: 1 }
    }

    fn turned(rad: f64) -> Quaternion {
        Quaternion { x: 0.0, y: 0.0, z: (rad / 2.0).sin(), w: (rad / 2.0).cos() }
    }

    fn odometry(t_s: f64, x: f64, heading: f64) -> Odometry {
        let mut told = Odometry { child_frame_id: "base_link".into(), ..Odometry::default() };
        told.header = Header { stamp: Time::from_us((t_s * 1e6) as i64), frame_id: "odom".into() };
        told.pose.pose.position.x = x;
        told.pose.pose.orientation = turned(heading);
        told
    }

    fn poses(shared: &Shared) -> Vec<csi5300::motion::pose::Pose> {
        let mut source = shared.inbox.source();
        let mut all = Vec::new();
        while let Ok(NextPose::Pose(pose)) = source.receive(Instant::ZERO) {
            all.push(pose);
        }
        all
    }

    #[test]
    fn the_antennas_offset_from_tf_static_rotates_with_the_robot() {
        let shared = shared(Stamp::Header);
        shared.odometry(&odometry(10.0, 1.0, 0.0), Some("antenna"), came(10_000_000));
        assert_eq!(poses(&shared), []);
        assert!(shared.inbox.source().trouble().is_some_and(|why| why.contains("from base_link to antenna")));
        let fixed = TfMessage { transforms: vec![transform("base_link", "antenna", 0.0, [0.5, 0.0, 0.0], 0.0)] };
        shared.transforms(&fixed, true, None, came(0));
        shared.odometry(&odometry(10.0, 1.0, FRAC_PI_2), Some("antenna"), came(10_000_000));
        let pose = poses(&shared)[0];
        assert!((pose.position_m - Vector3::new(1.0, 0.5, 0.0)).norm() < 1e-9, "{pose:?}");
        assert_eq!((pose.t_s, shared.inbox.source().trouble()), (10.0, None));
    }

    #[test]
    fn each_transform_of_the_lowest_moving_frame_gives_a_pose() {
        let shared = shared(Stamp::Header);
        let way = Some(("map", "antenna"));
        let tell = |told: Vec<TransformStamped>, fixed| {
            shared.transforms(&TfMessage { transforms: told }, fixed, way, came(5_000_000))
        };
        tell(vec![transform("base_link", "antenna", 0.0, [0.1, 0.0, 0.0], 0.0)], true);
        tell(vec![transform("odom", "base_link", 4.0, [1.0, 0.0, 0.0], 0.0)], false);
        assert!(shared.inbox.source().trouble().is_some_and(|why| why.contains("from map to antenna")));
        // Stamped ahead, as AMCL does.
        tell(vec![transform("map", "odom", 6.0, [10.0, 0.0, 0.0], 0.0)], false);
        assert_eq!(poses(&shared), []);
        tell(
            vec![
                transform("odom", "base_link", 5.0, [2.0, 0.0, 0.0], 0.0),
                transform("other", "frame", 5.5, [0.0, 0.0, 0.0], 0.0),
            ],
            false,
        );
        let all = poses(&shared);
        assert_eq!((all.len(), all[0].t_s), (1, 5.0));
        assert!((all[0].position_m.x - 12.1).abs() < 1e-9);
    }

    #[test]
    fn an_inertial_units_heading_starts_from_odometrys() {
        let shared = shared(Stamp::Header);
        let imu = |rad, at| {
            let imu = Imu { orientation: turned(rad), ..Imu::default() };
            lock(&shared.state).turns.handle(&imu, at);
        };
        imu(2.0, 10_000_000);
        shared.odometry(&odometry(10.0, 0.0, 0.5), None, came(10_000_000));
        imu(2.3, 10_100_000);
        shared.odometry(&odometry(10.1, 0.0, 0.6), None, came(10_100_000));
        // The unit has gone silent: odometry's own heading.
        shared.odometry(&odometry(10.9, 0.0, 0.7), None, came(10_900_000));
        let headings: Vec<f64> = poses(&shared).iter().filter_map(|pose| pose.heading_rad).collect();
        for (heading, expected) in headings.iter().zip([0.5, 0.8, 0.7]) {
            assert!((heading - expected).abs() < 1e-6, "{headings:?}");
        }
        let unknown = Imu { orientation: turned(9.0), orientation_covariance: [-1.0; 9], ..Imu::default() };
        lock(&shared.state).turns.handle(&unknown, 11_000_000);
        assert_eq!(lock(&shared.state).turns.newest.map(|(_, at)| at), Some(10_100_000));
    }

    #[test]
    fn simulated_times_become_host_times() {
        let ahead = Arc::new(AtomicI64::new(UNKNOWN));
        let clock = SimClock(Some(Arc::clone(&ahead)));
        let shared = Shared { clock: clock.clone(), ..shared(Stamp::Header) };
        shared.odometry(&odometry(3.0, 0.0, 0.0), None, came(1_000_000_000));
        assert!(poses(&shared).is_empty() && clock.is_unknown() && clock.to_stamp(7) == 0);
        assert!(shared.inbox.source().trouble().is_some_and(|why| why.contains("/clock")));
        ahead.store(990_000_000, Ordering::Relaxed);
        shared.odometry(&odometry(3.0, 0.0, 0.0), None, came(993_000_000));
        assert_eq!(poses(&shared)[0].t_s, 993.0);
        assert_eq!([993_000_000, 0].map(|us| clock.to_stamp(us)), [3_000_000, 0]);
    }
}
