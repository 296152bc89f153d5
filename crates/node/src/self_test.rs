//! The acceptance claims of a running robot, judged by the last seconds of its and its peers' cards.

use crate::machine::Tap;
use csi5300::motion::pose::Pose;
use csi5300::signal::channel::Channel;
use csi5300::source::{Loss, Next, Stamps};
use csi5300::time::{Instant, Span};
use csi5300_accept::{Collector, Finding, Of, Plan, Side, Verdict};
use csi5300_live::doctor::{Machine, module_counters};
use driver_iface::Mac;
use driver_iface::record::Record;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// The window of the claims, and the interval of a node's own checks.
pub const WINDOW: Span = Span::from_ms(20_000);
/// Limit of kept records of one card.
const RECORDS: usize = 20_000;

/// The items of a card.
enum Gave {
    Record(Option<i64>, u8, Box<[u8]>),
    Lost(Loss),
}

/// The items of one card within the window.
#[derive(Default)]
struct Card(VecDeque<(Instant, Gave)>);

impl Card {
    fn note(&mut self, now: Instant, next: &Next<'_>) {
        let gave = match next {
            Next::Record(stamps, record) => Gave::Record(stamps.host_us, record.code, record.body.into()),
            Next::Lost(loss) => Gave::Lost(loss.clone()),
            Next::Pending | Next::End(_) => return,
        };
        while self.0.len() >= RECORDS || self.0.front().is_some_and(|(at, _)| now - *at > WINDOW) {
            self.0.pop_front();
        }
        self.0.push_back((now, gave));
    }

    fn tell(&self, side: Side, since: Instant, to: &mut Collector) {
        for (_, gave) in self.0.iter().filter(|(at, _)| *at >= since) {
            let next = match gave {
                Gave::Record(host_us, code, body) => {
                    Next::Record(Stamps { host_us: *host_us, ..Stamps::default() }, Record { code: *code, body })
                }
                Gave::Lost(loss) => Next::Lost(loss.clone()),
            };
            to.heard(side, &next);
        }
    }

    fn last(&self) -> Option<Instant> {
        self.0.back().map(|(at, _)| *at)
    }
}

/// A finding, and the peer that it is about: none for this robot's own card and host.
pub type Found = (Option<String>, Finding);

/// The last seconds of all cards; clones share them.
#[derive(Clone)]
pub struct SelfTest {
    channel: Channel,
    own: Mac,
    peers: Arc<[(String, Mac)]>,
    /// This robot's card, then the peers'.
    cards: Arc<Mutex<Vec<Card>>>,
    /// The kernel module's counters at the start; none without a card.
    counters: Arc<[(String, u64)]>,
}

impl SelfTest {
    /// Of the robot `own` and its peers, by name and MAC, in the order of the machine.
    #[must_use]
    pub fn new(channel: Channel, own: Mac, peers: &[(String, Mac)]) -> Self {
        let cards = std::iter::repeat_with(Card::default).take(peers.len() + 1).collect();
        Self { channel, own, peers: peers.into(), cards: Arc::new(Mutex::new(cards)), counters: Arc::default() }
    }

    /// Judges the claims about the kernel module too, by its counts from now on.
    #[must_use]
    pub fn with_module(self) -> Self {
        Self { counters: module_counters(&Machine).into(), ..self }
    }

    /// The tap to add to the machine.
    #[must_use]
    pub fn tap(&self) -> Box<dyn Tap> {
        Box::new(self.clone())
    }

    /// Judges every claim: once for this robot's card and host, and for each peer's card and link where possible.
    #[must_use]
    pub fn judge(&self) -> Vec<Found> {
        let mut theirs: Vec<Found> = Vec::new();
        for (peer, (name, _)) in self.peers.iter().enumerate() {
            let both = self.collected(Some(peer)).finish();
            let report = both.far.is_some().then(|| both.judge());
            let tried =
                |finding: &Finding| matches!(finding.of, Of::Far | Of::Link) && finding.verdict != Verdict::NotTried;
            let findings = report.into_iter().flat_map(|report| report.findings).filter(tried);
            theirs.extend(findings.map(|finding| (Some(name.clone()), finding)));
        }
        let own = self.collected(None).finish().judge().findings.into_iter();
        // A claim about links that no peer allowed gives the reason.
        let own = own.filter(|own| own.of != Of::Link || theirs.iter().all(|(_, finding)| finding.id != own.id));
        let mut found: Vec<Found> = own.map(|finding| (None, finding)).collect();
        found.append(&mut theirs);
        found
    }

    /// What this robot's card gave, and that of a peer.
    fn collected(&self, peer: Option<usize>) -> Collector {
        let mut plan = Plan::new(self.channel);
        plan.macs = peer.and_then(|peer| self.peers.get(peer)).map(|(_, mac)| [self.own, *mac]);
        let mut collector = Collector::new(plan);
        let now = if self.counters.is_empty() { Vec::new() } else { module_counters(&Machine) };
        for (name, count) in now {
            let before = self.counters.iter().find(|(known, _)| *known == name).map_or(0, |(_, count)| *count);
            collector.counted(&name, count.wrapping_sub(before));
        }
        let cards = self.cards.lock().unwrap_or_else(PoisonError::into_inner);
        // A silent card keeps its records; the others' window shows whether they are old.
        let last = cards.iter().filter_map(Card::last).max().unwrap_or(Instant::ZERO);
        let since = last - WINDOW;
        let sides = [(Side::Near, Some(0)), (Side::Far, peer.map(|peer| peer + 1))];
        for (side, card) in sides {
            if let Some(card) = card.and_then(|card| cards.get(card)) {
                card.tell(side, since, &mut collector);
            }
        }
        collector
    }
}

impl Tap for SelfTest {
    fn record(&mut self, _: Option<i64>, _: Record<'_>) {}

    fn pose(&mut self, _: Option<Pose>) {}

    fn heard(&mut self, peer: Option<usize>, now: Instant, next: &Next<'_>) {
        let mut cards = self.cards.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(card) = cards.get_mut(peer.map_or(0, |peer| peer + 1)) {
            card.note(now, next);
        }
    }
}
