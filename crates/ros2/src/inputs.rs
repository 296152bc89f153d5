//! Poses from ROS 2 topics (odometry, motion capture, transforms), the antenna's place from `/tf_static`, orientation from an
//! inertial unit, ranges, and simulated time.

use super::link::Link;
use super::rtps::Qos;
use super::tf::Tree;
use crate::settings::{Kind, Topic};
use csi5300::motion::odometry::ros::{Inbox, Message, Stamp, Wanted};
use csi5300_bag::messages::standard::{Clock, Header, Imu, Odometry, PoseStamped, Range, TfMessage};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Messages that a reader of poses keeps.
const DEPTH: u32 = 64;
/// An orientation of the inertial unit older than this is not used, microseconds.
const IMU_US: i64 = 200_000;
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
            move |clock: Clock, wall_us: i64| told.store(wall_us.saturating_sub(clock.clock.us()), Ordering::Relaxed);
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

    /// Converts host time to a stamp; 0 before the first `/clock`.
    pub fn to_stamp(&self, host_us: i64) -> i64 {
        self.ahead_us().map_or(0, |ahead| host_us.saturating_sub(ahead))
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
            self.newest = Some((heading(&turned), received_us));
        }
    }

    /// The pose with the unit's heading, if that is recent.
    fn apply(&mut self, pose: Isometry3<f64>, received_us: i64) -> Isometry3<f64> {
        let Some((newest, at)) = self.newest else { return pose };
        if received_us.saturating_sub(at) > IMU_US {
            return pose;
        }
        let own = heading(&pose.rotation);
        let offset = *self.offset_rad.get_or_insert(own - newest);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), newest + offset - own);
        Isometry3::from_parts(pose.translation, turn * pose.rotation)
    }
}

fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let forward = rotation * Vector3::x();
    forward.y.atan2(forward.x)
}

/// Passes the ranges of `topic` to `used`: host time in microseconds, range and its deviation in metres (0: unknown); `None` for a
/// range that cannot be used. A range without a stamp has its time of receipt.
pub(crate) fn ranges(
    link: &Link,
    topic: &str,
    clock: &SimClock,
    used: impl Fn(Option<(i64, [f64; 2])>) + Clone + Send + 'static,
) {
    let (clock, unreadable) = (clock.clone(), used.clone());
    let read = move |told: Range, received_us| {
        let stamp_us = told.header.stamp.us();
        let at_us = if stamp_us == 0 { Some(received_us) } else { clock.to_host(stamp_us) };
        used(at_us.zip(told.metres()));
    };
    link.subscribe(topic, Qos::best_effort(DEPTH), read, move || unreadable(None));
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
    /// Why poses are not used at present.
    waits: Option<String>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes on a pose in the frame of `header`.
    fn put(&self, state: &mut State, header: &Header, pose: Isometry3<f64>, received_us: i64) {
        let Some(us) = self.clock.to_host(header.stamp.us()) else {
            state.waits = Some("no message on /clock, which `use_sim_time` needs".into());
            return;
        };
        state.waits = None;
        let pose = state.turns.apply(pose, received_us);
        // A zero stamp stays zero.
        let us = if header.stamp == csi5300_bag::messages::standard::Time::default() { 0 } else { us };
        let s = u32::try_from(us.div_euclid(1_000_000)).unwrap_or(0);
        let turned = pose.rotation.coords;
        let message = Message {
            stamp: (s, us.rem_euclid(1_000_000) as u32 * 1_000),
            frame: &header.frame_id,
            position_m: pose.translation.vector.into(),
            orientation: [turned.x, turned.y, turned.z, turned.w],
        };
        self.inbox.put(0, &message, received_us);
    }

    fn odometry(&self, odometry: &Odometry, antenna: Option<&str>, received_us: i64) {
        let mut state = self.lock();
        let Some(pose) = odometry.pose.pose.isometry() else { return self.inbox.unreadable() };
        let mounted = match antenna {
            None => Isometry3::identity(),
            Some(antenna) => match state.tree.find(&odometry.child_frame_id, antenna) {
                Some((mounted, _)) => mounted,
                None => {
                    let robot = &odometry.child_frame_id;
                    state.waits = Some(format!("/tf_static has no transform from {robot} to {antenna}"));
                    return;
                }
            },
        };
        // The heading is the robot's; the antenna's offset is rotated by it.
        let turned = state.turns.apply(pose, received_us);
        self.put(
            &mut state,
            &odometry.header,
            Isometry3::from_parts((turned * mounted).translation, pose.rotation),
            received_us,
        );
    }

    fn transforms(&self, told: &TfMessage, is_fixed: bool, wanted: Option<(&str, &str)>, received_us: i64) {
        let mut state = self.lock();
        for one in &told.transforms {
            if !state.tree.handle(one, is_fixed) {
                self.inbox.unreadable();
            }
        }
        let Some((from, to)) = wanted.filter(|_| !is_fixed) else { return };
        let Some((pose, moving)) = state.tree.find(from, to) else {
            state.waits = Some(format!("no transforms lead from {from} to {to}"));
            return;
        };
        // The stamp of the lowest moving frame counts: those above it may be stamped ahead, as AMCL does.
        let newest = told.transforms.iter().filter(|one| Some(one.child_frame_id.trim_start_matches('/')) == moving);
        if let Some(newest) = newest.max_by_key(|one| one.header.stamp.us()) {
            let header = Header { stamp: newest.header.stamp.clone(), frame_id: from.to_owned() };
            self.put(&mut state, &header, pose, received_us);
        }
    }
}

/// A source of poses, and the state from which its problems are reported.
pub(crate) struct PoseTopic(Arc<Shared>);

impl PoseTopic {
    /// Subscribes to `topic`. `usual` is the time source unless the topic names one. Returns the receiver of the poses, too.
    pub fn open(
        link: &Link,
        topic: &Topic,
        usual: Stamp,
        clock: &SimClock,
    ) -> (Self, csi5300::motion::odometry::ros::Topic) {
        let frame = if topic.kind == Kind::Tf { None } else { topic.frame.clone() };
        let wanted = Wanted { stamp: topic.stamp.unwrap_or(usual), frame };
        let name = link.names().whole(topic.name());
        // With times of receipt, stamps do not matter.
        let clock = if wanted.stamp == Stamp::Receipt { SimClock::real() } else { clock.clone() };
        let shared = Arc::new(Shared { inbox: Inbox::new(&name, wanted), clock, state: Mutex::default() });
        Self::subscribe(link, topic, &shared);
        if topic.kind == Kind::Tf || topic.antenna_frame.is_some() {
            let fixed = Arc::clone(&shared);
            let used = move |told: TfMessage, received_us| fixed.transforms(&told, true, None, received_us);
            link.subscribe("/tf_static", Qos::latched(DEPTH), used, || ());
        }
        if let Some(imu) = &topic.imu {
            let turned = Arc::clone(&shared);
            let used = move |imu: Imu, received_us| turned.lock().turns.handle(&imu, received_us);
            link.subscribe(imu, Qos::best_effort(DEPTH), used, || ());
        }
        let source = shared.inbox.source();
        (Self(shared), source)
    }

    fn subscribe(link: &Link, topic: &Topic, shared: &Arc<Shared>) {
        let (into, bad) = (Arc::clone(shared), Arc::clone(shared));
        let unreadable = move || bad.inbox.unreadable();
        // A best-effort, volatile reader matches every publisher.
        let qos = Qos::best_effort(DEPTH);
        match topic.kind {
            Kind::Odometry => {
                let antenna = topic.antenna_frame.clone();
                let used = move |told: Odometry, at| into.odometry(&told, antenna.as_deref(), at);
                link.subscribe(topic.name(), qos, used, unreadable)
            }
            Kind::Pose => {
                let used = move |told: PoseStamped, at| match told.pose.isometry() {
                    Some(pose) => into.put(&mut into.lock(), &told.header, pose, at),
                    None => into.inbox.unreadable(),
                };
                link.subscribe(topic.name(), qos, used, unreadable)
            }
            Kind::Tf => {
                let (from, to) = (topic.frame.clone().unwrap_or_default(), topic.child.clone().unwrap_or_default());
                let used = move |told: TfMessage, at| into.transforms(&told, false, Some((&from, &to)), at);
                link.subscribe(topic.name(), qos, used, unreadable)
            }
        }
    }

    /// Sets the source's current problem.
    pub fn look(&self) {
        let waits = self.0.lock().waits.clone();
        self.0.inbox.say(waits);
    }
}

#[cfg(test)]
#[path = "inputs_tests.rs"]
mod tests;
