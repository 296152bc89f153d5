//! The live estimator: records and poses of this robot and its peers in, bearings out.

use super::heard::Heard;
use super::links::Links;
use super::peer::{Context, PeerLink, SETTLE_S, WAIT, Why};
use super::report::{LivePeer, LiveSettings, PeerCounts, PeerReport};
use super::track::Track;
use crate::estimate::COARSE_RAD;
use crate::exchange::admission::Admission;
use crate::exchange::pairing::LinkSide;
use crate::exchange::tdma::Key;
use crate::motion::pose::Pose;
use crate::pipeline::{Array, Bearing, Effort, Front, LogReport, Options};
use crate::source::{Loss, Next};
use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;

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
        let front = Front::new(options.antenna).with_known(peers.iter().map(|peer| peer.mac));
        let count = peers.len().max(1) as f64;
        // One peer after the other, for an even load.
        let due = |k: usize| now + Span::from_s((1.0 + k as f64 / count) / settings.rate_hz);
        let state = |(k, peer): (usize, LivePeer)| PeerLink::new(peer, own, due(k), &options);
        let peers = peers.into_iter().enumerate().map(state).collect();
        // In between, only the grid.
        let plain = options.clone().with_accuracy(options.accuracy.with_effort(Effort::Within(COARSE_RAD)));
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
        self.heard =
            Some(Heard::new(array, named, (self.own, paired), (self.options.clone(), self.settings.window_s), now));
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
            state.admit(now, &self.options);
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
    /// After its time a report waits for another pair, at most a moment; once more, from the accuracy layer, when
    /// nothing else is due.
    pub fn poll_report(&mut self, now: Instant) -> Option<(usize, PeerReport)> {
        self.peers.iter_mut().for_each(|state| state.admit(now, &self.options));
        let due = self.peers.iter().enumerate().filter(|(_, state)| !state.is_heard_only && state.is_ripe(now));
        let due = due.min_by_key(|(_, state)| state.due).map(|(index, _)| (index, Why::Due));
        let paired_at = due.and_then(|(index, _)| self.peers.get(index)).map(|state| state.due);
        if let Some(heard) = self.heard.as_mut().filter(|heard| heard.is_before(paired_at, now)) {
            let (track, settings, options, plain) = (&self.track, &self.settings, &self.options, &self.plain);
            let context = Context { track, settings, options, plain, one_log: None, now, why: Why::Due };
            let report = heard.poll_report(context);
            self.forget();
            return report.map(|(number, report)| (self.number_of(number), report));
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

    /// The number of a report of a sender that is heard: that of its peer, or one beyond them.
    fn number_of(&self, number: Result<usize, usize>) -> usize {
        number.unwrap_or_else(|other| self.peers.len() + other)
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
            match number.ok().and_then(|peer| reports.get_mut(peer)) {
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
        let number = if peer < self.peers.len() { Ok(peer) } else { Err(peer - self.peers.len()) };
        of_peer.or_else(|| self.heard.as_ref()?.bearing(number))
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
        PeerCounts { pairs: state.pairs(), refused, carried: state.carried_counts(), ..state.counts }
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

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
}
