//! Live bearings: records and poses in, bearings out, with the time as an argument.
//!
//! A node hands over the records of its own and its peers' cards and the poses of both, and gets a bearing of each peer
//! several times a second over the last metres of relative motion. A robot that sounds alone hands over its card's
//! records and the measurements in its peers' answers, and requests bearings.
//!
//! `track` has poses and the stretch of relative motion, `peer` one peer, `heard` bearings of one card with two or three
//! antennas.

pub use crate::exchange::admission::AdmissionCounts;
pub use crate::place::TrackCounts;
pub use track::Track;

mod heard;
mod peer;
mod track;

use super::{Answer, Array, Bearing, Effort, Front, Link, LinkError, LinkJoin, LogReport, Options, estimate};
use crate::estimate::COARSE_RAD;
use crate::exchange::admission::{Admission, HOLD};
use crate::exchange::pairing::LinkSide;
use crate::exchange::tdma::Key;
use crate::motion::pose::{Pose, Trajectory};
use crate::source::{Loss, Next};
use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;
use heard::Heard;
use peer::{Context, PeerLink, SETTLE_S, WAIT, Why};
use serde::Serialize;

/// Estimates bearings of one robot to its peers, repeatedly.
///
/// Hand over the sources' items with [`handle_own`](Self::handle_own), [`handle_peer`](Self::handle_peer),
/// [`handle_pose`](Self::handle_pose) and [`handle_peer_pose`](Self::handle_peer_pose), in any order; then
/// [`poll_report`](Self::poll_report) until `None`, then wait until [`poll_timeout`](Self::poll_timeout). One call
/// makes at most one estimate, so that a driver can read its sources in between.
pub struct LiveEstimator {
    own: Mac,
    settings: LiveSettings,
    options: Options,
    plain: Options,
    front: Front,
    track: Track,
    peers: Vec<PeerLink>,
    /// Bearings of this robot's own records alone.
    heard: Option<Heard>,
    /// Records lost on the way from this robot's card, if its source counts them.
    losses: u64,
    strangers: u64,
    other_antenna: u64,
}

impl LiveEstimator {
    /// An estimator for the robot `own`, whose poses arrive, or are `track` for ever. `now` is its start.
    #[must_use]
    pub fn new(
        own: Mac,
        track: Track,
        peers: Vec<LivePeer>,
        settings: LiveSettings,
        options: Options,
        now: Instant,
    ) -> Self {
        // A negative rate would make every report due.
        let settings = LiveSettings { rate_hz: settings.rate_hz.max(0.0), ..settings };
        let front = Front::new(options.antenna).with_known(peers.iter().map(|peer| peer.mac));
        let count = peers.len().max(1) as f64;
        // One peer after the other, for an even load.
        let due = |k: usize| now + Span::from_s((1.0 + k as f64 / count) / settings.rate_hz);
        let state = |(k, peer): (usize, LivePeer)| PeerLink::new(peer, own, due(k), &options);
        let peers = peers.into_iter().enumerate().map(state).collect();
        // In between, only the grid.
        let mut plain = options.clone();
        plain.accuracy.effort = Effort::Within(COARSE_RAD);
        let heard = None;
        Self { own, settings, front, track, peers, heard, losses: 0, strangers: 0, other_antenna: 0, options, plain }
    }

    /// The same with bearings of what these antennas of this robot's card hear alone, while the robot turns or where the
    /// constants of their chains are known: of the peers with these numbers, which need not answer, and of every other sender
    /// that is heard, the first 16. The reports of the others are numbered on from the peers'. If a peer answers and stands, both kinds of
    /// evidence make its bearing.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn with_array(mut self, array: Array, heard_only: &[usize], now: Instant) -> Self {
        let named = heard_only.iter().filter_map(|k| {
            let state = self.peers.get_mut(*k)?;
            state.is_heard_only = true;
            Some((*k, state.peer.name.clone(), state.peer.mac))
        });
        let named = named.collect();
        let paired = self.paired().map(|state| state.peer.mac).collect();
        let settings = (self.options.clone(), self.settings.window_s);
        self.heard = Some(Heard::new(array, named, (self.own, paired, self.peers.len()), settings, now));
        self
    }

    /// From now on uses only exchanges that the scheduler, which shares this key, has
    /// [confirmed](Self::handle_confirmed), and, if frames come with the records, only those with a valid tag. A number
    /// with two records is an alarm ([`PeerCounts::refused`]), and neither is used.
    pub fn require_key(&mut self, key: &Key) {
        let fronts = self.peers.iter_mut().map(|state| &mut state.front);
        for front in fronts.chain([&mut self.front]) {
            *front = std::mem::replace(front, Front::new(self.options.antenna)).with_key(Some(key.clone()));
        }
        self.peers.iter_mut().for_each(|state| state.admission = Some(Admission::default()));
    }

    /// The scheduler has seen a frame of the peer `mac` with this number, its tag valid: an answer to this robot, or a frame
    /// that this robot answers.
    pub fn handle_confirmed(&mut self, mac: Mac, number: u32, now: Instant) {
        let Some(state) = self.peers.iter_mut().find(|state| state.peer.mac == mac) else { return };
        if let Some(admission) = &mut state.admission {
            admission.confirm(number, now);
            state.admit(now, HOLD, &self.options);
        }
    }

    /// Takes an item of this robot's card.
    pub fn handle_own(&mut self, next: &Next<'_>) {
        self.losses = self.losses.saturating_add(lost(next));
        if let Some(heard) = &mut self.heard {
            heard.note(next);
        }
        let Some((mac, heard, is_numbered)) = self.front.note_any(next) else { return };
        let Some(state) = self.peers.iter_mut().find(|state| state.peer.mac == mac) else {
            self.strangers += 1;
            return;
        };
        state.counts.heard += 1;
        let is_used =
            state.is_heard_only || state.handle(LinkSide::Receiver, (heard, is_numbered), next, &self.options);
        self.front.log.unused.no_number += u64::from(!is_used);
    }

    /// Takes an item of the card of peer number `peer`.
    pub fn handle_peer(&mut self, peer: usize, next: &Next<'_>) {
        let Some(state) = self.peers.get_mut(peer) else { return };
        state.counts.losses = state.counts.losses.saturating_add(lost(next));
        let Some((mac, heard, is_numbered)) = state.front.note_any(next) else { return };
        if mac != self.own {
            return;
        }
        state.counts.heard_by_peer += 1;
        let is_used = state.handle(LinkSide::Transmitter, (heard, is_numbered), next, &self.options);
        state.front.log.unused.no_number += u64::from(!is_used);
    }

    /// Takes the measurement in an answer of the peer `mac`: its card's report on a frame of this robot. One of another
    /// antenna is only counted.
    pub fn handle_measurement(&mut self, mac: Mac, measurement: &Measurement) {
        if measurement.rx_antenna != self.options.antenna as u8 {
            self.other_antenna += 1;
            return;
        }
        if let Some(state) = self.peers.iter_mut().find(|state| state.peer.mac == mac) {
            state.handle_measurement(measurement, &self.options);
        }
    }

    /// Takes a pose of this robot's antenna, on its own host's clock. `None`: later poses are in another frame, which
    /// makes earlier measurements useless.
    pub fn handle_pose(&mut self, pose: Option<Pose>) {
        if let Some(pose) = pose {
            return self.track.push(pose);
        }
        self.track.clear();
        self.peers.iter_mut().for_each(PeerLink::begin_anew);
        self.heard.iter_mut().for_each(Heard::begin_anew);
    }

    /// Takes a pose of a peer's antenna, on the peer's clock and in its frame. `None`: later poses are in another
    /// frame.
    pub fn handle_peer_pose(&mut self, peer: usize, pose: Option<Pose>) {
        let Some(state) = self.peers.get_mut(peer) else { return };
        if let Some(pose) = pose {
            return state.peer.track.push(pose);
        }
        state.peer.track.clear();
        state.begin_anew();
    }

    /// When the next report is due: from then on the next pair is waited for.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        let due = |state: &PeerLink| state.unrefined_since().unwrap_or(state.due);
        self.paired().map(due).chain(self.heard.as_ref().and_then(Heard::next_due)).min()
    }

    /// When [`poll_report`](Self::poll_report) has a report even if nothing comes until then.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let at = |state: &PeerLink| state.unrefined_since().unwrap_or(state.due + WAIT);
        self.paired().map(at).chain(self.heard.as_ref().and_then(Heard::next_due)).min()
    }

    /// The peers whose records are paired with this robot's.
    fn paired(&self) -> impl Iterator<Item = &PeerLink> {
        self.peers.iter().filter(|state| !state.is_heard_only)
    }

    /// The next report, if one is due, with the peer's number.
    ///
    /// After its time a report waits for another pair, at most a moment; once more, as a whole estimate, when
    /// nothing else is due.
    pub fn poll_report(&mut self, now: Instant) -> Option<(usize, PeerReport)> {
        self.peers.iter_mut().for_each(|state| state.admit(now, HOLD, &self.options));
        let due = self.peers.iter().enumerate().filter(|(_, state)| !state.is_heard_only && state.is_ripe(now));
        let due = due.min_by_key(|(_, state)| state.due).map(|(index, _)| (index, Why::Due));
        let paired_at = due.and_then(|(index, _)| self.peers.get(index)).map(|state| state.due);
        if let Some(heard) = self.heard.as_mut().filter(|heard| heard.is_before(paired_at, now)) {
            let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
            let context = Context { track, settings, options, plain, one_log: None, now, why: Why::Due };
            let report = heard.poll_report(context);
            self.forget();
            return report;
        }
        let unrefined = || self.peers.iter().position(|state| state.unrefined).map(|index| (index, Why::Refine));
        let (index, why) = due.or_else(unrefined)?;
        let period = Span::from_s(1.0 / self.settings.rate_hz);
        let state = self.peers.get_mut(index)?;
        if why == Why::Due {
            // A late driver skips missed reports.
            state.due = if now - state.due > period { now + period } else { state.due + period };
        }
        let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
        let one_log = self.heard.as_ref().map(Heard::log);
        let report = state.report(Context { track, settings, options, plain, one_log, now, why });
        self.forget();
        Some((index, report))
    }

    /// Each peer's link with all pairs that are kept, copied (at most 2 MB a peer), to make [bearings](Links::bearings)
    /// of. It changes neither data nor reports.
    #[must_use]
    pub fn links(&self) -> Links {
        Links { links: self.peers.iter().map(|state| state.link.clone()).collect(), options: self.options.clone() }
    }

    /// Ends all sources, and returns every peer's last report.
    pub fn finish(&mut self, now: Instant) -> Vec<PeerReport> {
        let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
        let one_log = self.heard.as_ref().map(Heard::log);
        let context = Context { track, settings, options, plain, one_log, now, why: Why::End };
        let last = |state: &mut PeerLink| {
            state.finish(now, context.options);
            state.report(context)
        };
        let mut reports: Vec<PeerReport> = self.peers.iter_mut().map(last).collect();
        let context = Context { track, settings, options, plain, one_log: None, now, why: Why::End };
        for (number, report) in self.heard.iter_mut().flat_map(|heard| heard.finish(context)) {
            match reports.get_mut(number) {
                Some(own) => *own = report,
                None => reports.push(report),
            }
        }
        reports
    }

    /// The last complete estimate of a peer's bearing.
    #[must_use]
    pub fn bearing(&self, peer: usize) -> Option<&Bearing> {
        let of_peer = self.peers.get(peer).and_then(|state| state.bearing.as_ref());
        of_peer.or_else(|| self.heard.as_ref()?.bearing(peer))
    }

    /// The senders beyond the peers whose bearings are reported, by their numbers: name, MAC, and what was counted.
    #[doc(hidden)] // for the crates of this workspace
    pub fn others(&self) -> impl Iterator<Item = (&str, Mac, PeerCounts)> {
        self.heard.iter().flat_map(Heard::others)
    }

    /// Peers and their counts.
    pub fn peers(&self) -> impl Iterator<Item = (&LivePeer, PeerCounts)> {
        let both = self.peers.iter().enumerate();
        both.map(|(k, state)| (&state.peer, self.counts(k, state)))
    }

    fn counts(&self, peer: usize, state: &PeerLink) -> PeerCounts {
        if let Some(heard) = self.heard.as_ref().and_then(|heard| heard.counts(peer)) {
            return heard;
        }
        let refused = state.admission.as_ref().map_or_else(Default::default, |gate| gate.counts);
        let poses_refused = state.peer.track.refused();
        PeerCounts { pairs: state.pairs(), refused, carried: state.carried_counts(), poses_refused, ..state.counts }
    }

    /// Counts of this robot's own card.
    #[must_use]
    pub fn own_log(&self) -> &LogReport {
        &self.front.log
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

    /// Measurements of another antenna than the one in use: not used.
    #[must_use]
    pub fn other_antenna(&self) -> u64 {
        self.other_antenna
    }

    /// Drops data that no window needs any more.
    fn forget(&mut self) {
        let keep_s = self.settings.window_s + SETTLE_S;
        forget(&mut self.track, keep_s);
        // Their clocks, and how late they come, are their own.
        self.peers.iter_mut().for_each(|state| forget(&mut state.peer.track, keep_s + SETTLE_S + 60.0));
    }
}

/// Records lost, if a source counts them.
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

/// The links of a [`LiveEstimator`] as they were at one moment: a copy, for bearings in another
/// thread while records arrive.
#[derive(Clone, Debug)]
pub struct Links {
    links: Vec<Link>,
    options: Options,
}

impl Links {
    /// For every peer with pairs: its MAC, the number of pairs, and the bearing from all kept pairs and `trajectory` in
    /// place of the received poses, like a bearing from logs. Peers stand still. There is no window and no schedule.
    ///
    /// Each is an error by itself: see [`LinkError`].
    #[must_use]
    pub fn bearings(&self, trajectory: &Trajectory) -> Vec<(Mac, usize, Result<Bearing, LinkError>)> {
        let join = |link| LinkJoin { link, receiver: trajectory, transmitter: None };
        let made = estimate(&self.links.iter().map(join).collect::<Vec<_>>(), &self.options);
        let made = self.links.iter().zip(made).filter(|(link, _)| link.pairs() > 0);
        made.map(|(link, bearing)| (link.mac, link.pairs(), bearing)).collect()
    }
}

/// Data and rate of estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LiveSettings {
    /// Relative motion in the window, metres of path.
    pub window_m: f64,
    /// The window reaches back no further than this, seconds.
    pub window_s: f64,
    /// Relative motion needed before there is a bearing: the diagonal of the box that holds it, metres.
    pub least_m: f64,
    /// Estimates of each peer a second. Not above 0: only at the end.
    pub rate_hz: f64,
    /// Poses are extrapolated by at most this, seconds.
    pub extrapolate_s: f64,
    /// Interval between whole estimates of a peer, seconds: in between, bearings assume a plane wave at the channel
    /// centre. 0: every time. It also runs when the robots stop, and at the end.
    pub accurate_every_s: f64,
}

impl LiveSettings {
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
pub struct LivePeer {
    /// Its name.
    pub name: String,
    /// Its MAC.
    pub mac: Mac,
    /// Its poses so far: usually [`Track::still`], or empty if it publishes them.
    pub track: Track,
    /// Rotation of its frame against this robot's, radians.
    pub yaw_rad: f64,
}

/// The state of a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PeerState {
    /// A new bearing.
    Bearing,
    /// The last bearing: nothing moved since.
    Held,
    /// The robots have not yet moved enough relative to each other.
    NotYet,
    /// Too few exchanges, none with a pose, or none since the last bearing, which is repeated.
    NoPairs,
    /// The estimator refused; see the error.
    Failed,
}

/// A report about a peer at one time.
#[derive(Clone, Debug, Serialize)]
pub struct PeerReport {
    /// Host time of the last exchange in it, seconds since the Unix epoch.
    pub t_s: Option<f64>,
    /// What it is.
    pub state: PeerState,
    /// The same in words.
    pub words: String,
    /// Relative motion in the window: the diagonal of its box, metres.
    pub moved_m: f64,
    /// Relative motion that is needed, metres.
    pub needed_m: f64,
    /// Age of a repeated bearing, seconds.
    pub age_s: f64,
    /// The bearing is a whole estimate, not that of a plane wave.
    pub accurate: bool,
    /// When the last record in it came, on the driver's clock.
    #[serde(skip)]
    pub heard_at: Option<Instant>,
    /// The bearing with all its fields.
    #[serde(flatten)]
    pub answer: Answer,
}

/// Counts of a peer.
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
    /// Those of them that were whole estimates.
    pub accurate: u64,
    /// Searches skipped because nothing moved.
    pub skipped: u64,
    /// Losses that the peer's source reported.
    pub losses: u64,
    /// If the scheduler shares a key: refused records.
    pub refused: AdmissionCounts,
    /// Windows through which the peer's place was carried, and how often that restarted.
    pub carried: TrackCounts,
    /// Its poses that were not used: with the time of another, not finite, or alone far off in time.
    pub poses_refused: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Stamps;
    use driver_iface::bfee::{Iq, Repr, Wsr};
    use driver_iface::record::{Record, code};
    use nalgebra::Vector3;

    const OWN: Mac = Mac([2, 0, 0, 0, 0, 1]);
    const PEER: Mac = Mac([2, 0, 0, 0, 0, 2]);

    /// A record of a card that heard frame `number` of `mac` at a time of its clock, microseconds, with CSI of this phase.
    fn hear(mac: Mac, number: u32, (timestamp_low, turn): (u32, f64), take: &mut dyn FnMut(&Next<'_>)) {
        let (tv_sec, tv_usec) = (timestamp_low / 1_000_000, timestamp_low % 1_000_000);
        let wsr = Wsr { mac, frame_count: Some(number), tv_sec, tv_usec };
        let repr = Repr { timestamp_low, n_rx: 1, n_tx: 1, antenna_sel: 0, wsr: Some(wsr), ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        let iq = Iq { i: (40.0 * turn.cos()) as i8, q: (40.0 * turn.sin()) as i8 };
        repr.emit(&vec![iq; repr.samples()], &mut body).unwrap();
        take(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body }));
    }

    #[test]
    fn tracks_are_trimmed_though_nothing_moves_and_nothing_is_heard() {
        let settings = LiveSettings::new(0.054);
        let peer = LivePeer { name: "b".into(), mac: Mac([2; 6]), track: Track::default(), yaw_rad: 0.0 };
        let options = Options::new("108".parse().unwrap());
        let mut estimator =
            LiveEstimator::new(Mac([1; 6]), Track::default(), vec![peer], settings, options, Instant::ZERO);
        for k in 0..6_000 {
            // The peer's clock is an hour ahead.
            let pose = |ahead_s: f64| Pose {
                t_s: ahead_s + f64::from(k) * 0.1,
                position_m: Vector3::zeros(),
                heading_rad: None,
            };
            estimator.handle_pose(Some(pose(0.0)));
            estimator.handle_peer_pose(0, Some(pose(3_600.0)));
            estimator.poll_report(Instant::from_us(i64::from(k) * 100_000));
        }
        let kept = estimator.peers().next().unwrap().0.track.len();
        assert!(kept < 3_100 && estimator.track().len() < 2_200, "{kept} {}", estimator.track().len());
    }

    fn made_up(n: u32) -> Mac {
        let [_, a, b, c] = n.to_be_bytes();
        Mac([2, 0x66, 0, a, b, c])
    }

    fn estimator() -> LiveEstimator {
        let peer = LivePeer { name: "b".into(), mac: PEER, track: Track::default(), yaw_rad: 0.0 };
        let options = Options::new("108".parse().unwrap());
        LiveEstimator::new(OWN, Track::default(), vec![peer], LiveSettings::new(0.054), options, Instant::ZERO)
    }

    #[test]
    fn a_peer_is_heard_though_strangers_came_first() {
        let mut estimator = estimator();
        (0..400).for_each(|n| hear(made_up(n), 1, (n, 0.15), &mut |next| estimator.handle_own(next)));
        (0..400).for_each(|n| hear(made_up(n), 1, (n, 0.15), &mut |next| estimator.handle_peer(0, next)));
        for number in 1..=50 {
            let at = 10_000 * number;
            hear(OWN, number, (at, 0.15), &mut |next| estimator.handle_peer(0, next));
            hear(PEER, number, (at + 300, 0.15), &mut |next| estimator.handle_own(next));
        }
        let counts = estimator.peers().next().unwrap().1;
        assert_eq!((counts.heard, counts.heard_by_peer), (50, 50));
        estimator.finish(Instant::from_us(1_000_000));
        assert_eq!(estimator.peers().next().unwrap().1.pairs, 50);
    }

    #[test]
    fn with_a_key_a_strangers_answers_replace_no_pair() {
        let mut estimator = estimator();
        estimator.require_key(&Key::new([7; 16]));
        for number in 1..=100 {
            let at = 10_000 * number;
            hear(OWN, number, (at, 0.15), &mut |next| estimator.handle_peer(0, next));
            if number % 2 == 0 {
                // Sooner than the peer, in its name.
                hear(PEER, number, (at + 200, 0.15), &mut |next| estimator.handle_own(next));
            }
            hear(PEER, number, (at + 300, 0.15), &mut |next| estimator.handle_own(next));
            if number % 5 != 0 {
                estimator.handle_confirmed(PEER, number, Instant::ZERO);
            }
        }
        estimator.finish(Instant::from_us(100_000));
        let counts = estimator.peers().next().unwrap().1;
        // Odd numbers that the scheduler has seen answered.
        assert_eq!((counts.pairs, counts.refused.contested), (40, 50));
    }

    /// Drives in circles for 4 s a feed: the peer's channel is turned by so much against this robot's own, and its card so far
    /// ahead; with neither it is this robot's own log. Gives why there was no bearing at the end of each.
    fn causes(feeds: &[(f64, u32)]) -> Vec<Option<LinkError>> {
        let still = Track::still(Vector3::zeros(), 0.0);
        let peer = LivePeer { name: "b".into(), mac: PEER, track: still, yaw_rad: 0.0 };
        let options = Options::new("108".parse().unwrap());
        let settings = LiveSettings { window_s: 3.0, window_m: 0.5, rate_hz: 1.0, ..LiveSettings::new(0.054) };
        let mut estimator = LiveEstimator::new(OWN, Track::default(), vec![peer], settings, options, Instant::ZERO);
        let (mut number, mut causes) = (0, Vec::new());
        for (turned, ahead_us) in feeds {
            let mut cause = None;
            for _ in 0..400 {
                number += 1;
                let t_s = f64::from(number) * 0.01;
                let position_m = Vector3::new(0.2 * t_s.cos(), 0.2 * t_s.sin(), 0.0);
                estimator.handle_pose(Some(Pose { t_s, position_m, heading_rad: None }));
                hear(PEER, number, (number * 10_000, t_s), &mut |next| estimator.handle_own(next));
                hear(OWN, number, (number * 10_000 + ahead_us, t_s + turned), &mut |next| {
                    estimator.handle_peer(0, next)
                });
                let now = Instant::from_us(i64::from(number) * 10_000);
                if let Some((_, report)) =
                    estimator.poll_report(now).filter(|(_, report)| report.state != PeerState::Held)
                {
                    cause = report.answer.cause;
                }
            }
            causes.push(cause);
        }
        causes
    }

    #[test]
    fn a_feed_that_is_ones_own_log_is_refused_by_the_window_alone() {
        let (other, own, alike) = ((1.0, 0), (0.0, 0), (0.0, 40));
        let causes = causes(&[other, own, other, alike]);
        let refused: Vec<bool> = causes.iter().map(|cause| *cause == Some(LinkError::OneLogTwice)).collect();
        assert_eq!(refused, [false, true, false, false], "{causes:?}");
    }

    #[test]
    fn without_a_rate_reports_come_only_at_the_end() {
        let track = || Track::still(Vector3::zeros(), 0.0);
        for rate_hz in [-1.0, 0.0, f64::NAN] {
            let peer = LivePeer { name: "peer".into(), mac: Mac([2; 6]), track: track(), yaw_rad: 0.0 };
            let settings = LiveSettings { rate_hz, ..LiveSettings::new(0.054) };
            let options = Options::new("108".parse().unwrap());
            let mut live = LiveEstimator::new(Mac([1; 6]), track(), vec![peer], settings, options, Instant::ZERO);
            assert!(live.poll_report(Instant::from_us(9_000_000)).is_none(), "{rate_hz}");
            assert_eq!(live.finish(Instant::from_us(9_000_000)).len(), 1);
        }
    }
}
