//! Bearings from this robot's records alone, by two or three antennas that turn with it (see [`crate::pipeline::OneLog`]).

use super::peer::{Context, LastAnswer, Why};
use super::{PeerCounts, PeerReport, PeerState};
use crate::maths::wrap_rad;
use crate::motion::pose::Trajectory;
use crate::pipeline::{Answer, Array, Bearing, LinkError, OneLog, Options};
use crate::source::Next;
use crate::time::{Instant, Span};
use driver_iface::Mac;
use std::collections::BTreeSet;

/// Limit of reported senders that are not peers.
const OTHERS: usize = 16;
/// Limit of records kept of a sender.
const ROWS: usize = 2_048;
/// A bearing needs at least this many records.
const LEAST_RECORDS: usize = 24;
/// Least turn for a bearing, radians.
const LEAST_TURN_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// Least turn since the last answer for a new one, radians.
const WORTH_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// All senders heard.
pub(super) struct Heard {
    log: OneLog,
    array: Reach,
    /// Peers by number, then others in the order in which they were first heard.
    links: Vec<HeardLink>,
    named: usize,
    /// Peers of any kind: others are numbered on from them.
    peers: usize,
    own: Mac,
    /// Peers with paired links: they have no bearing here. Their records of the last `window_us` are kept.
    paired: BTreeSet<Mac>,
    window_us: i64,
}

/// Properties of the array.
#[derive(Clone, Copy)]
struct Reach {
    /// Length of the first baseline, metres.
    length_m: f64,
    /// If true, a standing robot has a bearing too.
    constants_known: bool,
}

impl Reach {
    /// Distance that an end of the baseline moves in a turn, metres.
    fn chord_m(self, turned_rad: f64) -> f64 {
        2.0 * self.length_m * (0.5 * turned_rad.min(std::f64::consts::PI)).sin()
    }

    /// Required motion of the baseline's end, metres.
    fn needed_m(self) -> f64 {
        if self.constants_known { 0.0 } else { self.chord_m(LEAST_TURN_RAD) }
    }

    /// Why there is no bearing yet.
    fn not_yet(self, turned_rad: f64) -> Option<String> {
        let enough = self.constants_known || turned_rad >= LEAST_TURN_RAD;
        let degrees = [turned_rad, LEAST_TURN_RAD].map(f64::to_degrees);
        (!enough).then(|| format!("not yet: turned {:.0} of {:.0} degrees", degrees[0], degrees[1]))
    }
}

/// A sender and its last answer.
struct HeardLink {
    number: usize,
    name: String,
    mac: Mac,
    due: Instant,
    counts: PeerCounts,
    /// Records heard at the last estimate.
    searched: Option<u64>,
    /// Arrival of the last record, and its host time, seconds.
    heard_at: Option<Instant>,
    seen_s: Option<f64>,
    /// The last answer, and the heading at it, radians.
    last: Option<LastAnswer<Option<f64>>>,
    bearing: Option<Bearing>,
}

impl Heard {
    /// `named` are those of the `peers`: number, name, MAC address. This robot (`own`) and the `paired` peers have no bearing here.
    pub(super) fn new(
        array: Array,
        named: Vec<(usize, String, Mac)>,
        (own, paired, peers): (Mac, BTreeSet<Mac>, usize),
        (options, window_s): (Options, f64),
        now: Instant,
    ) -> Self {
        let (length_m, constants_known) = array.reach();
        let link = |(k, name, mac)| HeardLink::new(k, name, mac, now);
        let links: Vec<HeardLink> = named.into_iter().map(link).collect();
        let named = links.len();
        // One more place for frames without a sender, which have no bearing.
        let log = OneLog::new(array, options).keeping(named + paired.len() + OTHERS + 1, ROWS);
        let window_us = (window_s * 1e6) as i64;
        Self { log, array: Reach { length_m, constants_known }, links, named, peers, own, paired, window_us }
    }

    /// The records heard.
    pub(super) fn log(&self) -> &OneLog {
        &self.log
    }

    /// Takes an item from this robot's card.
    pub(super) fn note(&mut self, next: &Next<'_>) {
        let Some((mac, host_us)) = self.log.note(next) else { return };
        let Next::Record(stamps, _) = next else { return };
        let others = self.links.len() - self.named;
        let known = self.links.iter().position(|link| link.mac == mac);
        if self.paired.contains(&mac) {
            let from_us = host_us.map_or(i64::MIN, |now_us| now_us.saturating_sub(self.window_us));
            if self.log.first_us(mac).is_some_and(|first_us| first_us < from_us) {
                self.log.forget_before(mac, from_us, true);
            }
            return;
        }
        if known.is_none() && (mac.is_zero() || mac == self.own || others >= OTHERS) {
            self.log.forget_before(mac, i64::MAX, false);
            return;
        }
        let at = known.unwrap_or_else(|| {
            self.links.push(HeardLink::new(self.peers + others, mac.to_string(), mac, stamps.at));
            self.links.len() - 1
        });
        if let Some(link) = self.links.get_mut(at) {
            link.counts.heard += 1;
            link.heard_at = Some(stamps.at);
            link.seen_s = host_us.map(|us| us as f64 * 1e-6).or(link.seen_s);
        }
    }

    /// When the next report is due.
    pub(super) fn next_due(&self) -> Option<Instant> {
        self.links.iter().map(|link| link.due).min()
    }

    /// True if a report is due, and not later than `other`, that of another kind of link.
    pub(super) fn is_before(&self, other: Option<Instant>, now: Instant) -> bool {
        self.next_due().is_some_and(|due| due <= now && other.is_none_or(|other| due <= other))
    }

    /// The next due report.
    pub(super) fn poll_report(&mut self, context: Context<'_>) -> Option<(usize, PeerReport)> {
        let period = Span::from_s(1.0 / context.settings.rate_hz);
        let link = self.links.iter_mut().min_by_key(|link| link.due)?;
        link.due = if context.now - link.due > period { context.now + period } else { link.due + period };
        Some((link.number, link.report(&mut self.log, self.array, context)))
    }

    /// The last report of each sender.
    pub(super) fn finish(&mut self, context: Context<'_>) -> Vec<(usize, PeerReport)> {
        let (log, array) = (&mut self.log, self.array);
        self.links.iter_mut().map(|link| (link.number, link.report(log, array, context))).collect()
    }

    /// Forgets all records and answers, because the odometry has a new frame.
    pub(super) fn begin_anew(&mut self) {
        self.paired.iter().for_each(|mac| self.log.forget_before(*mac, i64::MAX, true));
        for link in &mut self.links {
            self.log.forget_before(link.mac, i64::MAX, true);
            (link.last, link.bearing, link.searched) = (None, None, None);
        }
    }

    pub(super) fn bearing(&self, number: usize) -> Option<&Bearing> {
        self.links.iter().find(|link| link.number == number)?.bearing.as_ref()
    }

    /// Counts of a peer that is heard but not paired.
    pub(super) fn counts(&self, peer: usize) -> Option<PeerCounts> {
        self.links.iter().find(|link| link.number == peer).map(HeardLink::counts)
    }

    pub(super) fn others(&self) -> impl Iterator<Item = (&str, Mac, PeerCounts)> {
        self.links.iter().skip(self.named).map(|link| (link.name.as_str(), link.mac, link.counts()))
    }
}

impl HeardLink {
    fn new(number: usize, name: String, mac: Mac, due: Instant) -> Self {
        let counts = PeerCounts::default();
        Self { number, name, mac, due, counts, searched: None, heard_at: None, seen_s: None, last: None, bearing: None }
    }

    /// The counts, with records as pairs.
    fn counts(&self) -> PeerCounts {
        PeerCounts { pairs: self.counts.heard, ..self.counts }
    }

    fn report(&mut self, log: &mut OneLog, array: Reach, context: Context<'_>) -> PeerReport {
        let Context { track, settings, why, .. } = context;
        let held = |own: &Self, state, words: String, moved_m| {
            let (sender, moved) = ((&*own.name, own.mac), [moved_m, array.needed_m()]);
            PeerReport::without(own.last.as_ref(), sender, (state, words), moved, (own.seen_s, context.now))
        };
        let without = |own: &Self, state, words, turned_rad| held(own, state, words, array.chord_m(turned_rad));
        let Some(seen_s) = self.seen_s else {
            return without(self, PeerState::NoPairs, "no record with all antennas yet".into(), 0.0);
        };
        let nothing_new = self.searched == Some(self.counts.heard);
        if why == Why::Due && nothing_new {
            return without(self, PeerState::NoPairs, "no record since the last search".into(), 0.0);
        }
        log.forget_before(self.mac, ((seen_s - settings.window_s) * 1e6) as i64, true);
        let from_s = log.first_us(self.mac).map_or(seen_s, |us| us as f64 * 1e-6);
        let Some(trajectory) = track.trajectory(context.extrapolate_s(), (from_s, seen_s)) else {
            return without(self, PeerState::NotYet, "no poses yet".into(), 0.0);
        };
        let heading_rad = track.last().and_then(|pose| pose.heading_rad);
        let turned_rad = turned_rad(&trajectory, (from_s, seen_s));
        let has_turned = self.last.as_ref().is_none_or(|last| {
            heading_rad.zip(last.motion).is_none_or(|(now, then)| wrap_rad(now - then).abs() >= WORTH_RAD)
        });
        if why == Why::Due && !has_turned && !array.constants_known {
            self.counts.skipped += 1;
            let moved_m = self.last.as_ref().map_or(0.0, |last| last.moved_m);
            return held(self, PeerState::Held, "held: not turned since the last bearing".into(), moved_m);
        }
        if let Some(words) = array.not_yet(turned_rad).filter(|_| heading_rad.is_some()) {
            return without(self, PeerState::NotYet, words, turned_rad);
        }
        self.searched = Some(self.counts.heard);
        self.counts.estimates += 1;
        let made = log.bearing(self.mac, &trajectory, context.options);
        let mut answer = Answer::of(self.name.clone(), None, made.as_ref());
        answer.mac = Some(self.mac.to_string());
        self.bearing = made.ok();
        if let Some(error) = answer.error.clone() {
            let state = match answer.cause {
                Some(LinkError::NotTurned { .. } | LinkError::OutsideTrajectory { .. }) => PeerState::NotYet,
                _ => PeerState::Failed,
            };
            let mut report = without(self, state, error, turned_rad);
            report.answer.cause = answer.cause;
            return report;
        }
        if answer.pairs_in_motion < LEAST_RECORDS {
            let words = format!("{} usable records, {LEAST_RECORDS} are needed", answer.pairs_in_motion);
            return without(self, PeerState::NoPairs, words, turned_rad);
        }
        let moved_m = array.chord_m(turned_rad);
        let (at, motion, accurate) = (context.now, heading_rad, true);
        self.last = Some(LastAnswer { answer: answer.clone(), at, motion, moved_m, accurate });
        PeerReport::new(Some(seen_s), answer, [moved_m, array.needed_m()], accurate, self.heard_at)
    }
}

/// Range of the headings within a time span, radians.
fn turned_rad(trajectory: &Trajectory, (from_s, to_s): (f64, f64)) -> f64 {
    let inside = trajectory.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
    let (mut before, mut at, mut low, mut high) = (None, 0.0, 0.0_f64, 0.0_f64);
    for heading_rad in inside.filter_map(|pose| pose.heading_rad) {
        at += before.map_or(0.0, |before| wrap_rad(heading_rad - before));
        before = Some(heading_rad);
        (low, high) = (low.min(at), high.max(at));
    }
    high - low
}
