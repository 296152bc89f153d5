//! The live estimator: records and poses of this robot and its peers in, bearings out. Sans-IO.

use super::motion::{Track, Window, aligned, window};
use csi5300::exchange::pairing::Side;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Answer, Bearing, FrameHeard, Front, Link, LinkError, LinkJoin, LinkReport, Options, estimate};
use csi5300::source::{Loss, Next};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use serde::Serialize;

/// What an estimate is made of, and how often.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Relative motion in the window, metres of path.
    pub window_m: f64,
    /// The window reaches back no further than this, seconds.
    pub window_s: f64,
    /// Relative motion needed before there is a bearing: the diagonal of the box that holds it, metres.
    pub least_m: f64,
    /// Estimates of each peer a second.
    pub rate_hz: f64,
    /// Poses are carried on beyond the last one by at most this, seconds.
    pub extrapolate_s: f64,
    /// The accuracy layer is asked this often for each peer, seconds: in between, bearings are of a plane wave at the
    /// channel centre. 0: every time. When the robots stand still, and at the end, it has the last word.
    pub accurate_every_s: f64,
}

impl Settings {
    /// Three metres within three minutes, twice a second, from two wavelengths on.
    #[must_use]
    pub fn new(wavelength_m: f64) -> Self {
        Self {
            window_m: 3.0,
            window_s: 180.0,
            least_m: 2.0 * wavelength_m,
            rate_hz: 2.0,
            extrapolate_s: 0.05,
            accurate_every_s: 5.0,
        }
    }
}

/// A robot whose bearing is wanted.
#[derive(Clone, Debug)]
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Its MAC.
    pub mac: Mac,
    /// Its poses so far: usually [`Track::still`], or empty for one that publishes them.
    pub track: Track,
    /// How far its frame is turned against this robot's, radians.
    pub yaw_rad: f64,
}

/// What is known of a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// A new bearing.
    Bearing,
    /// The last bearing: nothing moved since.
    Held,
    /// The robots have not yet moved enough relative to each other.
    NotYet,
    /// Too few exchanges, none with a pose, or none since the last bearing, which is said again.
    NoPairs,
    /// The estimator refused; see the error.
    Failed,
}

/// What is said of a peer at one time.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Host time of the last exchange in it, seconds since the Unix epoch.
    pub t_s: Option<f64>,
    /// What it is.
    pub state: State,
    /// The same in words.
    pub words: String,
    /// Relative motion in the window: the diagonal of its box, metres.
    pub moved_m: f64,
    /// Relative motion that is needed, metres.
    pub needed_m: f64,
    /// Seconds since the bearing was made, for one that is said again.
    pub age_s: f64,
    /// The bearing is the accuracy layer's.
    pub accurate: bool,
    /// When the last record in it came, on the driver's clock.
    #[serde(skip)]
    pub heard_at: Option<Instant>,
    /// The bearing and all that goes with it.
    #[serde(flatten)]
    pub answer: Answer,
}

/// What was counted of a peer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PeerCounts {
    /// Records of this robot's card from the peer.
    pub heard: u64,
    /// Records of the peer's card from this robot.
    pub heard_by_peer: u64,
    /// Pairs formed so far.
    pub pairs: u64,
    /// Searches made.
    pub estimates: u64,
    /// Those of them with the accuracy layer.
    pub accurate: u64,
    /// Searches left out because nothing moved.
    pub skipped: u64,
    /// Losses that the peer's source reported.
    pub losses: u64,
}

struct PeerState {
    peer: Peer,
    front: Front,
    link: Option<Link>,
    due: Instant,
    counts: PeerCounts,
    last: Option<Last>,
    /// Pairs there were at the last search.
    searched: Option<u64>,
    /// When the record came that made the newest pair.
    paired_at: Option<Instant>,
    /// When the accuracy layer was last asked, and whether it is to be asked next.
    accurate_at: Option<Instant>,
    unrefined: bool,
    /// The last estimate with everything in it.
    bearing: Option<Bearing>,
}

/// The last answer.
#[derive(Clone, Debug)]
struct Last {
    answer: Answer,
    /// When it was made.
    at: Instant,
    motion: Motion,
    moved_m: f64,
    accurate: bool,
}

/// The newest poses, each in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Motion {
    receiver: Option<Pose>,
    transmitter: Option<Pose>,
}

/// What all peers' reports share.
#[derive(Clone, Copy)]
struct Context<'a> {
    track: &'a Track,
    settings: &'a Settings,
    options: &'a Options,
    /// The same without the accuracy layer.
    plain: &'a Options,
    now: Instant,
    why: Why,
}

/// What a report is made for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Why {
    /// It is time.
    Due,
    /// The accuracy layer has not yet had its word on what was just said.
    Refine,
    /// Nothing more comes.
    End,
}

/// Relative motion since an answer that makes a new one worth while, metres.
const WORTH_M: f64 = 0.01;
/// Pairs with fewer than this make no bearing.
const LEAST_PAIRS: usize = 24;
/// A report that is due waits for the next pair, so that the news in it are new, but no longer than this.
const WAIT: Span = Span::from_ms(25);
/// Exchanges at rest before and after a motion that are kept, seconds: they settle slopes and signs.
const SETTLE_S: f64 = 30.0;

/// Makes bearings of one robot to its peers, over and over.
///
/// Hand over what sources give with [`handle_own`](Self::handle_own), [`handle_peer`](Self::handle_peer),
/// [`handle_pose`](Self::handle_pose) and [`handle_peer_pose`](Self::handle_peer_pose), in any order; then
/// [`poll_report`](Self::poll_report) until `None`, then wait until [`poll_timeout`](Self::poll_timeout). One call makes
/// at most one estimate, so that a driver can look after its sources in between.
pub struct Estimator {
    own: Mac,
    settings: Settings,
    options: Options,
    plain: Options,
    front: Front,
    track: Track,
    peers: Vec<PeerState>,
    /// Records lost on the way from the own card, as far as its source knows how many.
    losses: u64,
    strangers: u64,
}

impl Estimator {
    /// An estimator for the robot `own`, whose poses come, or are `track` for ever. `now` is when it begins.
    #[must_use]
    pub fn new(own: Mac, track: Track, peers: Vec<Peer>, settings: Settings, options: Options, now: Instant) -> Self {
        let front = Front::new(options.antenna);
        let count = peers.len().max(1) as f64;
        let state = |(k, peer): (usize, Peer)| PeerState {
            front: Front::new(options.antenna),
            link: Some(Link::new(peer.mac, None)),
            // One after the other, so that the load is even.
            due: now + Span::from_s((1.0 + k as f64 / count) / settings.rate_hz),
            counts: PeerCounts::default(),
            last: None,
            searched: None,
            paired_at: None,
            accurate_at: None,
            unrefined: false,
            bearing: None,
            peer,
        };
        let peers = peers.into_iter().enumerate().map(state).collect();
        let plain = options.clone().with_accuracy(options.accuracy.without_layers());
        Self { own, settings, front, track, peers, losses: 0, strangers: 0, options, plain }
    }

    /// Takes what this robot's card gave.
    pub fn handle_own(&mut self, next: &Next<'_>) {
        self.losses = self.losses.saturating_add(lost(next));
        let Some((mac, heard)) = self.front.note(next) else { return };
        let Some(state) = self.peers.iter_mut().find(|state| state.peer.mac == mac) else {
            self.strangers += 1;
            return;
        };
        state.counts.heard += 1;
        state.handle(Side::Receiver, heard, next, &self.options);
    }

    /// Takes what the card of peer number `peer` gave.
    pub fn handle_peer(&mut self, peer: usize, next: &Next<'_>) {
        let Some(state) = self.peers.get_mut(peer) else { return };
        state.counts.losses = state.counts.losses.saturating_add(lost(next));
        let Some((mac, heard)) = state.front.note(next) else { return };
        if mac != self.own {
            return;
        }
        state.counts.heard_by_peer += 1;
        state.handle(Side::Transmitter, heard, next, &self.options);
    }

    /// Takes a pose of this robot's antenna, on its own host's clock.
    pub fn handle_pose(&mut self, pose: Pose) {
        self.track.push(pose);
    }

    /// This robot's poses from here on are in another frame: what was measured in the last one is of no use.
    pub fn handle_new_frame(&mut self) {
        self.track.clear();
        self.peers.iter_mut().for_each(PeerState::begin_anew);
    }

    /// Takes a pose of a peer's antenna, on the peer's clock and in its frame.
    pub fn handle_peer_pose(&mut self, peer: usize, pose: Pose) {
        if let Some(state) = self.peers.get_mut(peer) {
            state.peer.track.push(pose);
        }
    }

    /// A peer's poses from here on are in another frame.
    pub fn handle_peer_new_frame(&mut self, peer: usize) {
        if let Some(state) = self.peers.get_mut(peer) {
            state.peer.track.clear();
            state.begin_anew();
        }
    }

    /// When the next report is due: from then on the next pair is waited for.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        let due = |state: &PeerState| {
            if state.unrefined { state.last.as_ref().map_or(state.due, |last| last.at) } else { state.due }
        };
        self.peers.iter().map(due).min()
    }

    /// When [`poll_report`](Self::poll_report) has something to say whatever comes until then.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let at = |state: &PeerState| {
            let unrefined = state.last.as_ref().filter(|_| state.unrefined).map(|last| last.at);
            unrefined.unwrap_or(state.due + WAIT)
        };
        self.peers.iter().map(at).min()
    }

    /// The next report, if one is due: the peer's number and what is said of it.
    ///
    /// One is due at its time as soon as another pair comes, or a moment later; and once more, from the accuracy layer, when
    /// nothing else is due.
    pub fn poll_report(&mut self, now: Instant) -> Option<(usize, Report)> {
        let due = self.peers.iter().enumerate().filter(|(_, state)| state.is_ripe(now));
        let due = due.min_by_key(|(_, state)| state.due).map(|(index, _)| (index, Why::Due));
        let unrefined = || self.peers.iter().position(|state| state.unrefined).map(|index| (index, Why::Refine));
        let (index, why) = due.or_else(unrefined)?;
        let period = Span::from_s(1.0 / self.settings.rate_hz);
        let state = self.peers.get_mut(index)?;
        if why == Why::Due {
            // A driver that was away does not make up for what it missed.
            state.due = if now - state.due > period { now + period } else { state.due + period };
        }
        let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
        let report = state.report(Context { track, settings, options, plain, now, why });
        self.forget();
        Some((index, report))
    }

    /// Ends all sources: every peer's last report, from everything that came.
    pub fn finish(&mut self, now: Instant) -> Vec<Report> {
        let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
        let context = Context { track, settings, options, plain, now, why: Why::End };
        let last = |state: &mut PeerState| {
            if let Some(link) = &mut state.link {
                link.finish(context.options);
            }
            state.report(context)
        };
        self.peers.iter_mut().map(last).collect()
    }

    /// The last estimate of a peer's bearing, with everything in it.
    #[must_use]
    pub fn bearing(&self, peer: usize) -> Option<&Bearing> {
        self.peers.get(peer)?.bearing.as_ref()
    }

    /// Peers and what was counted of them.
    pub fn peers(&self) -> impl Iterator<Item = (&Peer, PeerCounts)> {
        let counts = |state: &PeerState| {
            let pairs = state.link.as_ref().map_or(0, |link| link.counts(Side::Receiver).paired);
            PeerCounts { pairs, ..state.counts }
        };
        self.peers.iter().map(move |state| (&state.peer, counts(state)))
    }

    /// What was counted of this robot's own card.
    #[must_use]
    pub fn front(&self) -> &Front {
        &self.front
    }

    /// Poses of this robot that are kept, and the newest.
    #[must_use]
    pub fn track(&self) -> &Track {
        &self.track
    }

    /// Losses that the own card's source reported, and frames of senders that are no peers.
    #[must_use]
    pub fn losses(&self) -> (u64, u64) {
        (self.losses, self.strangers)
    }

    /// Forgets what no window needs any more.
    fn forget(&mut self) {
        let keep_s = self.settings.window_s + SETTLE_S;
        forget(&mut self.track, keep_s);
        // Their clocks, and how late they come, are their own.
        self.peers.iter_mut().for_each(|state| forget(&mut state.peer.track, keep_s + SETTLE_S + 60.0));
    }
}

impl PeerState {
    fn begin_anew(&mut self) {
        if let Some(link) = &mut self.link {
            link.forget_before(i64::MAX);
        }
        (self.last, self.searched, self.bearing) = (None, None, None);
        (self.accurate_at, self.unrefined) = (None, false);
    }

    /// Takes what one of the two cards heard of the other.
    fn handle(&mut self, side: Side, heard: FrameHeard, next: &Next<'_>, options: &Options) {
        let Some(link) = &mut self.link else { return };
        let before = link.counts(Side::Receiver).paired;
        link.handle(side, heard, options);
        if let Next::Record(stamps, _) = next
            && link.counts(Side::Receiver).paired > before
        {
            self.paired_at = Some(stamps.at);
        }
    }

    /// A report is due, and a pair has come since, or the time for one has passed.
    fn is_ripe(&self, now: Instant) -> bool {
        self.due <= now && (now - self.due >= WAIT || self.paired_at.is_some_and(|at| at >= self.due))
    }

    fn pairs(&self) -> u64 {
        self.link.as_ref().map_or(0, |link| link.counts(Side::Receiver).paired)
    }

    fn forget_before(&mut self, t_s: f64) {
        if let Some(link) = &mut self.link {
            link.forget_before((t_s * 1e6) as i64);
        }
    }

    fn report(&mut self, context: Context<'_>) -> Report {
        let Context { track, settings, now, why, .. } = context;
        self.unrefined = false;
        let seen = self.link.as_ref().and_then(Link::last_us).map(|us| us as f64 * 1e-6);
        let nothing_new = self.searched == Some(self.pairs());
        if why == Why::Due && nothing_new {
            return self.without(State::NoPairs, "no exchange since the last search".into(), 0.0, context, seen);
        }
        let Some(end_s) = seen else {
            return self.without(State::NoPairs, "no exchange yet".into(), 0.0, context, None);
        };
        self.forget_before(end_s - settings.window_s - SETTLE_S);
        let motion = Motion { receiver: track.last().copied(), transmitter: self.peer.track.last().copied() };
        if why == Why::Due
            && let Some(last) = self.last.as_ref().filter(|last| !motion.is_beyond(&last.motion))
        {
            self.counts.skipped += 1;
            let moved_m = last.moved_m;
            self.unrefined = context.has_layers() && !last.accurate;
            return self.without(State::Held, "held: nothing moved since".into(), moved_m, context, seen);
        }
        let span_s = (end_s - settings.window_s - SETTLE_S, end_s + settings.window_s);
        let Some((receiver, transmitter)) = self.trajectories(track, settings, span_s) else {
            return self.without(State::NotYet, "no poses yet".into(), 0.0, context, seen);
        };
        let found = window(&receiver, transmitter.as_ref(), settings.window_m, settings.window_s);
        let Some(found) = found else {
            return self.without(State::NotYet, "the robots' poses are of different times".into(), 0.0, context, seen);
        };
        if found.path_m == 0.0 {
            // At rest only what settles slopes and signs is of use.
            self.forget_before(end_s - SETTLE_S);
        }
        if found.extent_m < settings.least_m {
            let words = format!("not yet: moved {:.2} m of {:.2} m", found.extent_m, settings.least_m);
            return self.without(State::NotYet, words, found.extent_m, context, seen);
        }
        self.searched = Some(self.pairs());
        let mut report = self.estimate(&receiver, transmitter.as_ref(), &found, context);
        if let Some(last) = self.last.as_ref().filter(|_| nothing_new && why == Why::End) {
            report.age_s = (now - last.at).as_s();
        }
        if report.state == State::Bearing {
            let (answer, moved_m, accurate) = (report.answer.clone(), found.extent_m, report.accurate);
            self.last = Some(Last { answer, at: now, motion, moved_m, accurate });
            self.unrefined = context.has_layers() && !accurate && self.is_layers_turn(context);
        }
        report
    }

    /// True if it is time for the accuracy layer.
    fn is_layers_turn(&self, context: Context<'_>) -> bool {
        let every = Span::from_s(context.settings.accurate_every_s);
        self.accurate_at.is_none_or(|at| context.now - at >= every)
    }

    /// Both trajectories on this robot's clock and in the directions of its frame.
    fn trajectories(
        &self,
        track: &Track,
        settings: &Settings,
        span_s: (f64, f64),
    ) -> Option<(Trajectory, Option<Trajectory>)> {
        let receiver = track.trajectory(settings.extrapolate_s, span_s)?;
        if self.peer.track.is_still() {
            return Some((receiver, None));
        }
        let ahead_s = self.link.as_ref()?.partner_ahead_s()?;
        let transmitter = self.peer.track.trajectory(settings.extrapolate_s, span_s)?;
        Some((receiver, Some(aligned(&transmitter, ahead_s, self.peer.yaw_rad)?)))
    }

    fn estimate(
        &mut self,
        receiver: &Trajectory,
        transmitter: Option<&Trajectory>,
        found: &Window,
        context: Context<'_>,
    ) -> Report {
        self.forget_before(if found.cut { found.from_s } else { found.from_s - SETTLE_S });
        let Some(link) = self.link.take() else {
            return self.without(State::Failed, "the link is gone".into(), found.extent_m, context, None);
        };
        let seen = link.last_us().map(|us| us as f64 * 1e-6);
        let receiver = cut(receiver, found);
        let accurate = context.has_layers() && (context.why != Why::Due || context.settings.accurate_every_s <= 0.0);
        let join = LinkJoin { link: &link, receiver: &receiver, transmitter };
        let options = if accurate { context.options } else { context.plain };
        let made = estimate(&[join], options).into_iter().next();
        let bearing = made.unwrap_or(Err(LinkError::NoPairs { receiver: 0, transmitter: 0 }));
        self.counts.estimates += 1;
        if accurate {
            self.counts.accurate += 1;
            self.accurate_at = Some(context.now);
        }
        let report = LinkReport { mac: Some(self.peer.mac), matched: None, link: Some(link), bearing };
        let answer = Answer::new(self.peer.name.clone(), &report);
        (self.link, self.bearing) = (report.link, report.bearing.ok());
        if answer.pairs_in_motion < LEAST_PAIRS && answer.error.is_none() {
            let words = format!("{} exchanges in motion, {LEAST_PAIRS} are needed", answer.pairs_in_motion);
            return self.without(State::NoPairs, words, found.extent_m, context, seen);
        }
        if let Some(error) = answer.error.clone() {
            return self.without(State::Failed, error, found.extent_m, context, seen);
        }
        let words = format!("bearing {:.2} deg", answer.azimuth_deg.unwrap_or(f64::NAN));
        let (moved_m, needed_m, heard_at) = (found.extent_m, context.settings.least_m, self.paired_at);
        Report { t_s: seen, state: State::Bearing, words, moved_m, needed_m, age_s: 0.0, accurate, heard_at, answer }
    }

    /// A report without a new bearing: the last one, if there is one, is said again with its age.
    fn without(&self, state: State, words: String, moved_m: f64, context: Context<'_>, seen: Option<f64>) -> Report {
        let held = self.last.as_ref().filter(|_| state != State::Failed);
        let answer =
            held.map_or_else(|| Answer::nothing(self.peer.name.clone(), self.peer.mac), |last| last.answer.clone());
        let age_s = held.map_or(0.0, |last| (context.now - last.at).as_s());
        let state = if held.is_some() && state == State::NotYet { State::Held } else { state };
        let (needed_m, accurate) = (context.settings.least_m, held.is_some_and(|last| last.accurate));
        Report { t_s: seen, state, words, moved_m, needed_m, age_s, accurate, heard_at: None, answer }
    }
}

impl Context<'_> {
    /// True if the accuracy layer is asked at all.
    fn has_layers(&self) -> bool {
        self.options.accuracy.near_field
    }
}

impl Motion {
    /// True if either robot is elsewhere than before.
    fn is_beyond(&self, before: &Self) -> bool {
        let moved = |now: Option<Pose>, then: Option<Pose>| {
            now.zip(then).is_some_and(|(now, then)| (now.position_m - then.position_m).norm() >= WORTH_M)
        };
        moved(self.transmitter, before.transmitter) || moved(self.receiver, before.receiver)
    }
}

/// Records lost, as far as a source knows how many.
fn lost(next: &Next<'_>) -> u64 {
    match next {
        Next::Lost(Loss::Overrun { dropped: Some(dropped) }) => (*dropped).max(1),
        Next::Lost(_) => 1,
        Next::Record(..) | Next::Pending | Next::End(_) => 0,
    }
}

/// Forgets what is older than `keep_s` by the track's own clock.
fn forget(track: &mut Track, keep_s: f64) {
    if let Some(last_s) = track.last().map(|pose| pose.t_s) {
        track.forget_before(last_s - keep_s);
    }
}

/// The trajectory from the window's beginning on, where earlier motion was left out of it.
fn cut(trajectory: &Trajectory, found: &Window) -> Trajectory {
    if !found.cut {
        return trajectory.clone();
    }
    let from = trajectory.poses().partition_point(|pose| pose.t_s < found.from_s).saturating_sub(1);
    let kept = trajectory.poses().get(from..).unwrap_or_default();
    Trajectory::new(kept.to_vec()).unwrap_or_else(|_| trajectory.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn tracks_are_trimmed_though_nothing_moves_and_nothing_is_heard() {
        let settings = Settings::new(0.054);
        let peer = Peer { name: "b".into(), mac: Mac([2; 6]), track: Track::default(), yaw_rad: 0.0 };
        let options = Options::new("108".parse().unwrap());
        let mut estimator = Estimator::new(Mac([1; 6]), Track::default(), vec![peer], settings, options, Instant::ZERO);
        for k in 0..6_000 {
            // The peer's clock is an hour ahead.
            let pose = |ahead_s: f64| Pose {
                t_s: ahead_s + f64::from(k) * 0.1,
                position_m: Vector3::zeros(),
                heading_rad: None,
            };
            estimator.handle_pose(pose(0.0));
            estimator.handle_peer_pose(0, pose(3_600.0));
            estimator.poll_report(Instant::from_us(i64::from(k) * 100_000));
        }
        let kept = estimator.peers().next().unwrap().0.track.len();
        assert!(kept < 3_100 && estimator.track().len() < 2_200, "{kept} {}", estimator.track().len());
    }
}
