//! One peer: its link, its schedule, its last answer, its reports.

use super::track::{Track, Window, aligned, window};
use super::{LivePeer, LiveSettings, PeerCounts, PeerReport, PeerState};
use crate::estimate::{COARSE_RAD, Effort};
use crate::exchange::admission::{Admission, HOLD};
use crate::exchange::pairing::LinkSide;
use crate::exchange::pairing::by_clock;
use crate::motion::pose::{Pose, Trajectory};
use crate::pipeline::{
    Answer, Bearing, CarriedAnswer, FrameHeard, Front, Link, LinkJoin, OneLog, Options, estimate_one,
};
use crate::place::{Evidence, PeerTrack, TrackCounts};
use crate::source::Next;
use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;

/// Relative motion since an answer that makes a new one worth while, metres.
const WORTH_M: f64 = 0.01;
/// Fewest pairs for a bearing.
const LEAST_PAIRS: usize = 24;

/// A due report waits for the next pair, to be up to date, but no longer than this.
pub(super) const WAIT: Span = Span::from_ms(25);
/// Exchanges at rest before and after a motion that are kept, seconds: they settle slopes and signs.
pub(super) const SETTLE_S: f64 = 30.0;

pub(super) struct PeerLink {
    pub(super) peer: LivePeer,
    pub(super) front: Front,
    pub(super) link: Link,
    /// When its next report is due.
    pub(super) due: Instant,
    pub(super) counts: PeerCounts,
    /// If the scheduler shares a key: records that wait for its confirmation.
    pub(super) admission: Option<Admission<FrameHeard>>,
    by_clock: ByClock,
    /// Only what this robot hears of it is of use: it has no pairs.
    pub(super) is_heard_only: bool,
    /// Measurements that came in its answers.
    measured: u32,
    last: Option<LastAnswer<NewestPoses>>,
    /// Pairs at the last search.
    searched: Option<u64>,
    /// Arrival of the record that made the newest pair.
    paired_at: Option<Instant>,
    /// When the last whole estimate was made, and whether the next one is whole.
    accurate_at: Option<Instant>,
    pub(super) unrefined: bool,
    /// The last complete estimate.
    pub(super) bearing: Option<Bearing>,
    /// The peer's place by all windows that do not overlap, and the end of the last of them, seconds.
    carried: PeerTrack,
    carried_to_s: Option<f64>,
}

/// How the frames of a link without numbers are paired.
enum ByClock {
    /// None of them has come.
    None,
    Running(Box<by_clock::Live<FrameHeard>>),
    /// A frame of the link has a number, or must have one.
    Off,
}

/// The last answer, and where the robots were at it.
#[derive(Clone, Debug)]
pub(super) struct LastAnswer<M> {
    pub(super) answer: Answer,
    /// When it was made.
    pub(super) at: Instant,
    pub(super) motion: M,
    pub(super) moved_m: f64,
    pub(super) accurate: bool,
}

/// The newest poses, each in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct NewestPoses {
    receiver: Option<Pose>,
    transmitter: Option<Pose>,
}

/// Data shared by all peers' reports.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) track: &'a Track,
    pub(super) settings: &'a LiveSettings,
    pub(super) options: &'a Options,
    /// The same for a plane wave alone.
    pub(super) plain: &'a Options,
    /// What this robot's antennas hear alone, if it has an array.
    pub(super) one_log: Option<&'a OneLog>,
    pub(super) now: Instant,
    pub(super) why: Why,
}

impl Context<'_> {
    /// By how much poses are extrapolated, seconds: at the end none is missing.
    pub(super) fn extrapolate_s(&self) -> f64 {
        if self.why == Why::End { 0.0 } else { self.settings.extrapolate_s }
    }
}

/// The reason for a report.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Why {
    /// Its time has come.
    Due,
    /// The last report was of a plane wave, and a whole estimate is due.
    Refine,
    /// Nothing more comes.
    End,
}

impl PeerLink {
    /// A peer that was not heard yet.
    pub(super) fn new(peer: LivePeer, own: Mac, due: Instant, options: &Options) -> Self {
        let antenna = options.antenna;
        Self {
            front: Front::new(antenna).with_known([own]),
            link: Link::new(peer.mac, None),
            peer,
            due,
            counts: PeerCounts::default(),
            admission: None,
            by_clock: ByClock::None,
            is_heard_only: false,
            measured: 0,
            last: None,
            searched: None,
            paired_at: None,
            accurate_at: None,
            unrefined: false,
            bearing: None,
            carried: PeerTrack::default(),
            carried_to_s: None,
        }
    }

    /// Drops measurements of another frame.
    pub(super) fn begin_anew(&mut self) {
        self.link.forget_before(i64::MAX);
        (self.last, self.searched, self.bearing) = (None, None, None);
        (self.accurate_at, self.unrefined) = (None, false);
        self.carried.reset();
        self.carried_to_s = None;
    }

    /// Outcomes of the windows that its place was carried through.
    pub(super) fn carried_counts(&self) -> TrackCounts {
        self.carried.counts()
    }

    /// Takes what one of the two cards heard of the other. False if it is of no use, since it has no number and others have.
    pub(super) fn handle(
        &mut self,
        side: LinkSide,
        (heard, is_numbered): (FrameHeard, bool),
        next: &Next<'_>,
        options: &Options,
    ) -> bool {
        let Next::Record(stamps, _) = next else { return true };
        if !is_numbered {
            return self.handle_unnumbered(side, heard, stamps.at, options);
        }
        self.by_clock = ByClock::Off;
        match &mut self.admission {
            None => self.pair(side, heard, stamps.at, options),
            Some(admission) => {
                admission.handle(side, (heard.number, heard.timestamp_low), stamps.at, heard);
                self.admit(stamps.at, HOLD, options);
            }
        }
        true
    }

    /// Takes a frame without a number. Without one there is nothing that the scheduler could confirm.
    fn handle_unnumbered(&mut self, side: LinkSide, heard: FrameHeard, at: Instant, options: &Options) -> bool {
        if self.admission.is_some() {
            return false;
        }
        if matches!(self.by_clock, ByClock::None) {
            // Other cards' records come with the clock of a 5300.
            self.by_clock = ByClock::Running(Box::new(by_clock::Live::new()));
        }
        let ByClock::Running(by_clock) = &mut self.by_clock else { return false };
        let restarts = by_clock.restarts();
        by_clock.handle(side, heard.timestamp_low.into(), heard);
        if by_clock.restarts() != restarts {
            // Turn-arounds before and after it cannot be compared.
            self.link.forget_before(i64::MAX);
        }
        self.take_by_clock(at, options);
        true
    }

    /// Numbers what the clocks have paired.
    fn take_by_clock(&mut self, at: Instant, options: &Options) {
        while let ByClock::Running(by_clock) = &mut self.by_clock
            && let Some(pair) = by_clock.poll_pair()
        {
            for (side, heard) in [(LinkSide::Receiver, pair.receiver), (LinkSide::Transmitter, pair.transmitter)] {
                self.pair(side, heard.with_number(pair.number, heard.row), at, options);
            }
        }
    }

    /// Ends both sides.
    pub(super) fn finish(&mut self, now: Instant, options: &Options) {
        self.admit(now, Span::default(), options);
        if let ByClock::Running(by_clock) = &mut self.by_clock {
            by_clock.finish();
        }
        self.take_by_clock(now, options);
        self.link.finish(options);
    }

    /// Why there is no exchange.
    fn why_none(&self) -> String {
        let refused = match &self.by_clock {
            ByClock::Running(by_clock) => by_clock.refusal(),
            ByClock::None | ByClock::Off => None,
        };
        refused.map_or_else(|| "no exchange yet".to_owned(), |why| format!("no exchange yet: {why}"))
    }

    /// Passes on confirmed records, once they were held for that long.
    pub(super) fn admit(&mut self, now: Instant, hold: Span, options: &Options) {
        while let Some((side, at, heard)) = self.admission.as_mut().and_then(|admission| admission.poll(now, hold)) {
            self.pair(side, heard, at, options);
        }
    }

    fn pair(&mut self, side: LinkSide, heard: FrameHeard, at: Instant, options: &Options) {
        let before = self.pairs();
        self.link.handle(side, heard, options);
        if self.pairs() > before {
            self.paired_at = Some(at);
        }
    }

    /// Takes what the peer's card measured of a frame of this robot's, from its answer.
    pub(super) fn handle_measurement(&mut self, measurement: &Measurement, options: &Options) {
        self.link.handle(LinkSide::Transmitter, FrameHeard::measured(measurement, self.measured), options);
        self.measured = self.measured.saturating_add(1);
        self.counts.heard_by_peer += 1;
    }

    /// When its last answer was made, if no whole estimate has refined it yet.
    pub(super) fn unrefined_since(&self) -> Option<Instant> {
        self.last.as_ref().filter(|_| self.unrefined).map(|last| last.at)
    }

    /// A report is due, and a pair has come since, or the time for one has passed.
    pub(super) fn is_ripe(&self, now: Instant) -> bool {
        self.due <= now && (now - self.due >= WAIT || self.paired_at.is_some_and(|at| at >= self.due))
    }

    /// Pairs formed so far.
    pub(super) fn pairs(&self) -> u64 {
        self.link.counts(LinkSide::Receiver).paired
    }

    fn forget_before(&mut self, t_s: f64) {
        self.link.forget_before((t_s * 1e6) as i64);
    }

    /// The report that is due.
    ///
    /// The pairs in the window decide whether both sides are one log or of different runs: a wrong feed is refused once
    /// it fills the window, and accepted again after it.
    pub(super) fn report(&mut self, context: Context<'_>) -> PeerReport {
        let Context { track, settings, now, why, .. } = context;
        self.unrefined = false;
        let seen = self.link.last_us().map(|us| us as f64 * 1e-6);
        let nothing_new = self.searched == Some(self.pairs());
        if why == Why::Due && nothing_new {
            return self.without(PeerState::NoPairs, "no exchange since the last search".into(), 0.0, context, seen);
        }
        let Some(end_s) = seen else {
            return self.without(PeerState::NoPairs, self.why_none(), 0.0, context, None);
        };
        self.forget_before(end_s - settings.window_s - SETTLE_S);
        let motion = NewestPoses { receiver: track.last().copied(), transmitter: self.peer.track.last().copied() };
        if why == Why::Due
            && let Some(last) = self.last.as_ref().filter(|last| !motion.is_beyond(&last.motion))
        {
            self.counts.skipped += 1;
            let moved_m = last.moved_m;
            self.unrefined = context.wants_whole() && !last.accurate;
            return self.without(PeerState::Held, "held: nothing moved since".into(), moved_m, context, seen);
        }
        let span_s = (end_s - settings.window_s - SETTLE_S, end_s + settings.window_s);
        let Some((receiver, transmitter)) = self.trajectories(track, context.extrapolate_s(), span_s) else {
            return self.without(PeerState::NotYet, "no poses yet".into(), 0.0, context, seen);
        };
        let found = window(&receiver, transmitter.as_ref(), settings.window_m, settings.window_s);
        let Some(found) = found else {
            return self.without(
                PeerState::NotYet,
                "the robots' poses are of different times".into(),
                0.0,
                context,
                seen,
            );
        };
        if found.path_m == 0.0 {
            // At rest only pairs that settle slopes and signs are useful.
            self.forget_before(end_s - SETTLE_S);
        }
        if found.extent_m < settings.least_m {
            let words = format!("not yet: moved {:.2} m of {:.2} m", found.extent_m, settings.least_m);
            return self.without(PeerState::NotYet, words, found.extent_m, context, seen);
        }
        self.searched = Some(self.pairs());
        let mut report = self.estimate(&receiver, transmitter.as_ref(), &found, context);
        if let Some(last) = self.last.as_ref().filter(|_| nothing_new && why == Why::End) {
            report.age_s = (now - last.at).as_s();
        }
        if report.state == PeerState::Bearing {
            let (answer, moved_m, accurate) = (report.answer.clone(), found.extent_m, report.accurate);
            self.last = Some(LastAnswer { answer, at: now, motion, moved_m, accurate });
            self.unrefined = context.wants_whole() && !accurate && self.is_whole_due(context);
        }
        report
    }

    /// True if a whole estimate is due.
    fn is_whole_due(&self, context: Context<'_>) -> bool {
        let every = Span::from_s(context.settings.accurate_every_s);
        self.accurate_at.is_none_or(|at| context.now - at >= every)
    }

    /// Both trajectories on this robot's clock and in the directions of its frame.
    fn trajectories(
        &self,
        track: &Track,
        extrapolate_s: f64,
        span_s: (f64, f64),
    ) -> Option<(Trajectory, Option<Trajectory>)> {
        let receiver = track.trajectory(extrapolate_s, span_s)?;
        if self.peer.track.is_still() {
            return Some((receiver, None));
        }
        let ahead_s = self.link.partner_ahead_s()?;
        let transmitter = self.peer.track.trajectory(extrapolate_s, span_s)?;
        Some((receiver, Some(aligned(&transmitter, ahead_s, self.peer.yaw_rad)?)))
    }

    fn estimate(
        &mut self,
        receiver: &Trajectory,
        transmitter: Option<&Trajectory>,
        found: &Window,
        context: Context<'_>,
    ) -> PeerReport {
        self.forget_before(if found.cut { found.from_s } else { found.from_s - SETTLE_S });
        let seen = self.link.last_us().map(|us| us as f64 * 1e-6);
        let receiver = cut(receiver, found);
        let accurate = context.wants_whole() && (context.why != Why::Due || context.settings.accurate_every_s <= 0.0);
        let join = LinkJoin { link: &self.link, receiver: &receiver, transmitter };
        let options = if accurate { context.options } else { context.plain };
        let two = estimate_one(&join, options);
        // A peer that moves is not where it was when it was heard first.
        let one_log = context.one_log.filter(|_| accurate && transmitter.is_none());
        let one = one_log.and_then(|log| log.bearing(self.peer.mac, &receiver, options).ok());
        let made = match (two, one) {
            (Ok(two), Some(one)) => Ok(two.with_one_log(&one)),
            (two, _) => two,
        };
        let mut answer = Answer::of(self.peer.name.clone(), Some(&self.link), made.as_ref());
        self.bearing = made.ok();
        self.counts.estimates += 1;
        if accurate {
            self.counts.accurate += 1;
            self.accurate_at = Some(context.now);
        }
        if answer.pairs_in_motion < LEAST_PAIRS && answer.error.is_none() {
            let words = format!("{} exchanges in motion, {LEAST_PAIRS} are needed", answer.pairs_in_motion);
            return self.without(PeerState::NoPairs, words, found.extent_m, context, seen);
        }
        if let Some(error) = answer.error.clone() {
            let mut report = self.without(PeerState::Failed, error, found.extent_m, context, seen);
            report.answer.cause = answer.cause;
            return report;
        }
        self.carried.heading_sd_rad = options.heading_sd_of(&receiver);
        answer.carried = self.carry(found.path_m, accurate || !context.wants_whole());
        let moved = [found.extent_m, context.settings.least_m];
        PeerReport::new(seen, answer, moved, accurate, self.paired_at)
    }

    /// The combined evidence of this window, `driven_m` metres long, and all earlier ones. No sample counts twice: a
    /// window is kept if it shares none with the last kept one, and if it is `whole`, made by every enabled step.
    fn carry(&mut self, driven_m: f64, whole: bool) -> Option<CarriedAnswer> {
        let bearing = self.bearing.as_ref()?;
        let times_s = bearing.samples.t_s();
        let carried_to_s = self.carried_to_s.unwrap_or(f64::NEG_INFINITY);
        let fresh = times_s.iter().filter(|t_s| **t_s > carried_to_s).count() as f64 / times_s.len().max(1) as f64;
        let evidence = Evidence { driven_m, fresh, ..bearing.evidence() };
        if fresh < 1.0 || !whole {
            return self.carried.answer_with(&evidence);
        }
        let answer = self.carried.update(&evidence)?;
        self.carried_to_s = times_s.last().copied();
        Some(answer)
    }

    /// A report without a new bearing: the last one, if there is one, is repeated with its age.
    fn without(
        &self,
        state: PeerState,
        words: String,
        moved_m: f64,
        context: Context<'_>,
        seen: Option<f64>,
    ) -> PeerReport {
        let (sender, moved) = ((&*self.peer.name, self.peer.mac), [moved_m, context.settings.least_m]);
        PeerReport::without(self.last.as_ref(), sender, (state, words), moved, (seen, context.now))
    }
}

impl PeerReport {
    /// A bearing just made, with the relative motion and how much is needed, metres.
    pub(super) fn new(
        t_s: Option<f64>,
        answer: Answer,
        [moved_m, needed_m]: [f64; 2],
        accurate: bool,
        heard_at: Option<Instant>,
    ) -> Self {
        // What rounds to zero has no sign.
        let hundredths = (answer.azimuth_deg.unwrap_or(f64::NAN) * 100.0).round() + 0.0;
        let (state, words) = (PeerState::Bearing, format!("bearing {:.2} deg", hundredths / 100.0));
        Self { t_s, state, words, moved_m, needed_m, age_s: 0.0, accurate, heard_at, answer }
    }

    /// A report without a new bearing: the last one, if there is one, is repeated with its age.
    pub(super) fn without<M>(
        last: Option<&LastAnswer<M>>,
        (name, mac): (&str, Mac),
        (state, words): (PeerState, String),
        [moved_m, needed_m]: [f64; 2],
        (t_s, now): (Option<f64>, Instant),
    ) -> Self {
        let held = last.filter(|_| state != PeerState::Failed);
        let answer = held.map_or_else(|| Answer::nothing(name.to_owned(), mac), |last| last.answer.clone());
        let age_s = held.map_or(0.0, |last| (now - last.at).as_s());
        let state = if held.is_some() && state == PeerState::NotYet { PeerState::Held } else { state };
        let accurate = held.is_some_and(|last| last.accurate);
        Self { t_s, state, words, moved_m, needed_m, age_s, accurate, heard_at: None, answer }
    }
}

impl Context<'_> {
    /// True if whole estimates are asked for.
    fn wants_whole(&self) -> bool {
        let is_coarse = matches!(self.options.accuracy.effort, Effort::Within(asked) if asked >= COARSE_RAD);
        self.options.accuracy.near_field && !is_coarse
    }
}

impl NewestPoses {
    /// True if either robot is elsewhere than before.
    fn is_beyond(&self, before: &Self) -> bool {
        let moved = |now: Option<Pose>, then: Option<Pose>| {
            now.zip(then).is_some_and(|(now, then)| (now.position_m - then.position_m).norm() >= WORTH_M)
        };
        moved(self.transmitter, before.transmitter) || moved(self.receiver, before.receiver)
    }
}

/// The trajectory from the window's beginning on, where earlier motion was skipped.
fn cut(trajectory: &Trajectory, found: &Window) -> Trajectory {
    if !found.cut {
        return trajectory.clone();
    }
    let from = trajectory.poses().partition_point(|pose| pose.t_s < found.from_s).saturating_sub(1);
    let from_s = trajectory.poses().get(from).map_or(found.from_s, |pose| pose.t_s);
    trajectory.within(from_s, f64::INFINITY).unwrap_or_else(|_| trajectory.clone())
}
