//! All of a robot's sources and its estimator as one value, driven with the time as an argument: the service drives it
//! with a real clock, tests with a virtual one.

use super::sources::{Card, PeerSources, Poses, Sources};
use csi5300::motion::odometry::{NextPose, SourceCounts};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::{LiveEstimator, PeerReport, PeerState};
use csi5300::pipeline::{LinkError, Options};
use csi5300::source::recorder::{LogFiles, Totals};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use csi5300_live::logged::Logged;

/// Records or poses taken from one source before the others have their turn.
const BURST: usize = 512;
/// Bursts that are still taken at the end.
const LAST_BURSTS: usize = 64;
/// A network peer that is silent for this time has ended, once this robot's own records have.
const QUIET: Span = Span::from_ms(5_000);
/// Silence of this robot's card after which something is wrong.
const SILENT: Span = Span::from_ms(10_000);

/// A receiver of every record and pose of this robot: its peers, over a network, or viewers.
pub trait Tap: Send {
    /// Every item of this robot's card, losses too.
    fn own(&mut self, _now: Instant, _next: &Next<'_>) {}
    /// A pose of this robot's antenna; `None`: those that follow are in another frame.
    fn pose(&mut self, _pose: Option<Pose>) {}
    /// Every item of the card of peer number `peer`.
    fn peer(&mut self, _peer: usize, _now: Instant, _next: &Next<'_>) {}
}

/// What a burst of a source's items was.
#[derive(Clone, Copy, Debug, Default)]
struct Burst {
    /// Records, or the news of lost ones.
    came: bool,
    /// There may be more at once.
    more: bool,
    ended: bool,
}

/// Hands over available items, up to a burst.
fn receive(source: &mut impl CsiSource, now: Instant, mut each: impl FnMut(&Next<'_>)) -> Result<Burst, Error> {
    let mut burst = Burst::default();
    for _ in 0..BURST {
        let next = source.receive(now)?;
        each(&next);
        match next {
            Next::Pending => return Ok(burst),
            Next::End(_) => return Ok(Burst { ended: true, ..burst }),
            Next::Record(..) | Next::Lost(_) => burst.came = true,
        }
    }
    Ok(Burst { more: true, ..burst })
}

/// Hands over available poses, up to a burst; `None` where a new frame starts. A source that ends or fails moves to `ended`. True if
/// there may be more at once.
fn receive_poses(
    source: &mut Option<Poses>,
    ended: &mut Option<Poses>,
    now: Instant,
    mut each: impl FnMut(Option<Pose>),
) -> Result<bool, Error> {
    for _ in 0..BURST {
        let Some(running) = source else { return Ok(false) };
        let last = match running.receive(now) {
            Ok(NextPose::Pose(pose)) => {
                each(Some(pose));
                continue;
            }
            Ok(NextPose::NewFrame) => {
                each(None);
                continue;
            }
            Ok(NextPose::Pending) => return Ok(false),
            Ok(NextPose::End) => Ok(false),
            Err(error) => Err(error),
        };
        *ended = source.take();
        return last;
    }
    Ok(true)
}

/// What was counted of this robot's odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PoseCounts {
    /// Poses that came.
    pub poses: u64,
    /// Times that the sensor restarted.
    pub new_frames: u64,
    /// Times that the host's wall clock was set; measurements restart then.
    pub clock_set: u64,
    /// Trajectory files, also those of peers, of which rows were skipped.
    pub incomplete: u64,
    /// Poses that were not used: with the time of another, not finite, or alone far off in time.
    pub refused: u64,
}

/// A running robot.
pub struct Machine {
    capture: Logged<Card>,
    /// This robot's records have ended.
    has_ended: bool,
    poses: Option<Poses>,
    /// The same after their end: their counts stay.
    ended_poses: Option<Poses>,
    /// Peers' sources that end are removed.
    peers: Vec<PeerSources>,
    /// The estimator.
    pub estimator: LiveEstimator,
    taps: Vec<Box<dyn Tap>>,
    /// What was counted of this robot's odometry.
    pub pose_counts: PoseCounts,
    trouble: Vec<String>,
    /// When a record last came from anybody.
    heard_at: Instant,
    /// When one last came from this robot's card, or the robot was started.
    own_heard_at: Instant,
}

impl Machine {
    /// A robot with these sources, whose own records go to the files of `log`, if there are any.
    ///
    /// # Errors
    /// If the log's thread cannot be started.
    pub fn new(
        sources: Sources,
        log: Option<LogFiles>,
        settings: csi5300::pipeline::live::LiveSettings,
        options: Options,
        now: Instant,
    ) -> Result<Self, Error> {
        let told = sources.peers.iter().map(|peer| peer.peer.clone()).collect();
        let heard_only = sources.peers.iter().enumerate().filter(|(_, peer)| peer.is_heard_only);
        let heard_only: Vec<usize> = heard_only.map(|(number, _)| number).collect();
        let mut estimator = LiveEstimator::new(sources.own, sources.track, told, settings, options, now);
        if let Some(array) = sources.array {
            estimator = estimator.with_array(array, &heard_only, now);
        }
        Ok(Self {
            capture: Logged::new(sources.capture, log)?,
            has_ended: false,
            poses: sources.poses,
            ended_poses: None,
            peers: sources.peers,
            estimator,
            taps: Vec::new(),
            pose_counts: PoseCounts { incomplete: sources.trajectories.incomplete, ..PoseCounts::default() },
            trouble: sources.trajectories.notes,
            heard_at: now,
            own_heard_at: now,
        })
    }

    /// Adds a receiver of every record and pose that follows.
    pub fn add_tap(&mut self, tap: Box<dyn Tap>) {
        self.taps.push(tap);
    }

    /// The peer's records come from here, over a network.
    pub fn set_records(&mut self, peer: usize, source: Card) {
        if let Some(peer) = self.peers.get_mut(peer) {
            (peer.open_ended, peer.records) = (true, Some(source));
        }
    }

    /// The peer's poses come from here.
    pub fn set_poses(&mut self, peer: usize, source: Poses) {
        if let Some(peer) = self.peers.get_mut(peer) {
            peer.poses = Some(source);
        }
    }

    /// Takes available items, up to a burst from every source. True if there is more.
    ///
    /// # Errors
    /// If this robot's card fails. A peer that fails is ignored from then on, and reported by [`Machine::trouble`].
    pub fn take(&mut self, now: Instant) -> Result<bool, Error> {
        // Poses first: measurements need a place.
        let counts = &mut self.pose_counts;
        let received = receive_poses(&mut self.poses, &mut self.ended_poses, now, |pose| {
            self.estimator.handle_pose(pose);
            *(if pose.is_some() { &mut counts.poses } else { &mut counts.new_frames }) += 1;
            self.taps.iter_mut().for_each(|tap| tap.pose(pose));
        });
        counts.refused = self.estimator.track().refused();
        self.trouble.extend(received.as_ref().err().map(|error| format!("odometry: {error}")));
        let mut more = received.unwrap_or_default() | self.take_records(now)?;
        for peer in 0..self.peers.len() {
            more |= self.take_peer(peer, now);
        }
        Ok(more)
    }

    fn take_records(&mut self, now: Instant) -> Result<bool, Error> {
        if self.has_ended {
            return Ok(false);
        }
        let Burst { came, more, ended } = receive(&mut self.capture, now, |next| {
            self.taps.iter_mut().for_each(|tap| tap.own(now, next));
            self.estimator.handle_own(next);
        })?;
        self.has_ended = ended;
        if came {
            (self.heard_at, self.own_heard_at) = (now, now);
        }
        Ok(more)
    }

    fn take_peer(&mut self, peer: usize, now: Instant) -> bool {
        let Some(running) = self.peers.get_mut(peer) else { return false };
        let received = receive_poses(&mut running.poses, &mut None, now, |pose| {
            running.new_frames += u64::from(pose.is_none());
            self.estimator.handle_peer_pose(peer, pose);
        });
        self.trouble.extend(received.as_ref().err().map(|error| format!("poses of {}: {error}", running.peer.name)));
        let more_poses = received.unwrap_or_default();
        let Some(records) = &mut running.records else { return more_poses };
        let received = receive(records, now, |next| {
            self.taps.iter_mut().for_each(|tap| tap.peer(peer, now, next));
            self.estimator.handle_peer(peer, next);
        });
        let Burst { came, more, ended } = received.unwrap_or_else(|error| {
            self.trouble.push(format!("records of {}: {error}", running.peer.name));
            Burst { ended: true, ..Burst::default() }
        });
        if ended {
            running.records = None;
        }
        if came {
            self.heard_at = now;
        }
        more || more_poses
    }

    /// The next due report, with the peer's number.
    pub fn poll_report(&mut self, now: Instant) -> Option<(usize, PeerReport)> {
        let (peer, mut report) = self.estimator.poll_report(now)?;
        if let Some((_, counts)) = self.estimator.peers().nth(peer) {
            say_silence(&mut report, counts.pairs);
        }
        Some((peer, report))
    }

    /// The next timeout, beside events.
    #[must_use]
    pub fn next_at(&self) -> Option<Instant> {
        let own = (!self.has_ended).then(|| self.capture.next_at()).flatten();
        let poses = |poses: &Poses| poses.next_at();
        let records = |records: &Card| records.next_at();
        let peers = self
            .peers
            .iter()
            .flat_map(|peer| [peer.records.as_ref().and_then(records), peer.poses.as_ref().and_then(poses)]);
        let mine = [own, self.poses.as_ref().and_then(poses), self.estimator.poll_timeout()];
        mine.into_iter().chain(peers).flatten().min()
    }

    /// True once this robot's own records and those of all peers have ended; those that come over a network, once nothing
    /// came for some seconds.
    #[must_use]
    pub fn is_done(&self, now: Instant) -> bool {
        let quiet = now - self.heard_at >= QUIET;
        let over = |peer: &PeerSources| peer.records.is_none() || (peer.open_ended && quiet);
        self.has_ended && self.peers.iter().all(over)
    }

    /// Silence of this robot's card, if long: no driver, no peer, or another channel.
    pub(crate) fn silent_for(&self, now: Instant) -> Option<Span> {
        let silent = now - self.own_heard_at;
        (!self.has_ended && silent >= SILENT).then_some(silent)
    }

    /// Times that a peer's poses changed to another frame.
    pub(crate) fn peer_frames(&self, peer: usize) -> u64 {
        self.peers.get(peer).map_or(0, |peer| peer.new_frames)
    }

    /// Counts of the source of this robot's poses.
    pub(crate) fn odometry_counts(&self) -> Option<SourceCounts> {
        self.poses.as_ref().or(self.ended_poses.as_ref()).and_then(|poses| poses.counted())
    }

    /// This host's wall clock was set: earlier times are useless, here and for the peers.
    pub fn handle_clock_set(&mut self) {
        self.pose_counts.clock_set += 1;
        self.estimator.handle_pose(None);
        self.taps.iter_mut().for_each(|tap| tap.pose(None));
    }

    /// What is in the log.
    pub(crate) fn totals(&self) -> Option<Totals> {
        self.capture.totals()
    }

    /// What is wrong at the moment, in words.
    #[must_use]
    pub fn trouble(&self) -> Vec<String> {
        let odometry = self.poses.as_ref().or(self.ended_poses.as_ref()).and_then(|poses| poses.trouble());
        let peers = self.peers.iter().filter_map(|peer| peer.poses.as_ref()?.trouble());
        let disk = self.totals().filter(|totals| totals.failing).and_then(|totals| totals.error);
        self.trouble.iter().cloned().chain(odometry).chain(peers).chain(disk).collect()
    }

    /// Takes what has arrived before the end, up to a limit.
    pub(crate) fn drain(&mut self, now: Instant) {
        for _ in 0..LAST_BURSTS {
            if !self.take(now).unwrap_or(false) {
                break;
            }
        }
    }

    /// Ends everything; returns the last reports, the estimator that made them, and the log's counts, or that its writer died.
    pub fn finish(mut self, now: Instant) -> (Vec<PeerReport>, LiveEstimator, Result<Option<Totals>, Error>) {
        // The log first: it must be complete however long the last estimates take.
        let log = self.capture.finish(now).map(|(_, totals)| totals);
        let pairs: Vec<u64> = self.estimator.peers().map(|(_, counts)| counts.pairs).collect();
        let mut reports = self.estimator.finish(now);
        reports.iter_mut().zip(pairs).for_each(|(report, pairs)| say_silence(report, pairs));
        (reports, self.estimator, log)
    }
}

/// For a peer whose pairs were all unusable, reports as `csi5300 bearing` does that the antenna heard nothing. Every
/// pair has a host time here, so there is no other reason.
fn say_silence(report: &mut PeerReport, pairs: u64) {
    if report.state == PeerState::NoPairs && report.t_s.is_none() && pairs > 0 {
        report.words = LinkError::Silent { pairs: usize::try_from(pairs).unwrap_or(usize::MAX) }.to_string();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sources::Trajectories;
    use csi5300::motion::odometry::{FollowedCounts, OdometrySource, Replayed};
    use csi5300::motion::pose::Trajectory;
    use csi5300::pipeline::live::{LivePeer, LiveSettings, Track};
    use csi5300::signal::channel::Channel;
    use driver_iface::Mac;
    use driver_iface::record::Tail;
    use nalgebra::Vector3;

    struct Ended;

    impl OdometrySource for Ended {
        fn receive(&mut self, _now: Instant) -> Result<NextPose, Error> {
            Ok(NextPose::End)
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }

        fn counted(&self) -> Option<SourceCounts> {
            Some(SourceCounts::Followed {
                followed: FollowedCounts { late: 3, ..FollowedCounts::default() },
                source: None,
            })
        }
    }

    /// A card that is silent, then gone.
    struct Gone;

    impl CsiSource for Gone {
        fn receive(&mut self, _: Instant) -> Result<Next<'_>, Error> {
            Ok(Next::End(Tail::Clean))
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    /// A source that gives one pose so many times.
    struct Repeated(u32);

    impl OdometrySource for Repeated {
        fn receive(&mut self, _now: Instant) -> Result<NextPose, Error> {
            let Some(left) = self.0.checked_sub(1) else { return Ok(NextPose::Pending) };
            self.0 = left;
            Ok(NextPose::Pose(Pose { t_s: 1.0, position_m: Vector3::zeros(), heading_rad: None }))
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    /// A robot without a card, and a peer, with poses of this source.
    fn machine(poses: &dyn Fn() -> Poses) -> Machine {
        let channel: Channel = "108".parse().unwrap();
        let peer = LivePeer { name: "b".into(), mac: Mac([2; 6]), track: Track::default(), yaw_rad: 0.0 };
        let (records, is_heard_only, open_ended) = (None, false, false);
        let peer = PeerSources { peer, records, poses: Some(poses()), is_heard_only, open_ended, new_frames: 0 };
        let sources = Sources {
            own: Mac([1; 6]),
            capture: Box::new(Gone),
            is_live: false,
            poses: Some(poses()),
            track: Track::default(),
            peers: vec![peer],
            array: None,
            trajectories: Trajectories::default(),
            speed: 1_000.0,
        };
        let settings = LiveSettings::new(channel.wavelength_m());
        Machine::new(sources, None, settings, Options::new(channel), Instant::ZERO).unwrap()
    }

    #[test]
    fn poses_that_are_not_used_are_counted() {
        let mut machine = machine(&|| Box::new(Repeated(3)));
        machine.drain(Instant::ZERO);
        let of_peer = machine.estimator.peers().next().unwrap().1.poses_refused;
        assert_eq!((machine.pose_counts.poses, machine.pose_counts.refused, of_peer), (3, 2, 2));
    }

    #[test]
    fn poses_that_wait_at_the_end_are_taken() {
        let pose = |k: u32| Pose { t_s: f64::from(k) * 1e-3, position_m: Vector3::zeros(), heading_rad: None };
        let poses = Trajectory::new((0..5_000).map(pose).collect()).unwrap();
        let mut machine = machine(&|| Box::new(Replayed::new(&poses, 0.0, Instant::ZERO, 1.0)));
        machine.drain(Instant::from_us(5_000_000));
        let of_peer = |machine: &Machine| machine.estimator.peers().next().unwrap().0.track.len();
        assert_eq!((machine.pose_counts.poses, of_peer(&machine)), (5_000, 5_000));
    }

    #[test]
    fn what_a_source_of_poses_counted_outlives_it() {
        let (mut source, mut ended): (Option<Poses>, Option<Poses>) = (Some(Box::new(Ended)), None);
        assert!(!receive_poses(&mut source, &mut ended, Instant::ZERO, |_| ()).unwrap() && source.is_none());
        assert_eq!(ended.unwrap().counted(), Ended.counted());
    }
}
