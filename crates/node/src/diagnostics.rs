//! The acceptance claims of a running robot, judged by the last seconds of its and its peers' cards, and the state of the robot for
//! `rqt_robot_monitor` and Foxglove: card, odometry, each peer, the program, and the claims.

use crate::adapters::Robot;
use crate::config::{Capture, Config};
use crate::health::Health;
use crate::lock;
use crate::machine::{Machine, Tap};
use crate::threads::Item;
use csi5300::pipeline::live::PeerState;
use csi5300::signal::channel::Channel;
use csi5300::source::Next;
use csi5300::time::{Instant, Span};
use csi5300_accept::{Claim, Evidence, Finding, Of, Plan, Side, Verdict};
use csi5300_bag::messages::{Byte, DiagnosticArray, DiagnosticStatus, Header, KeyValue, SelfTestResponse};
use csi5300_live::doctor::{self, module_counters, module_growth};
use csi5300_ros2::name_part;
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The window of the claims, and the interval of a node's own checks.
const WINDOW: Span = Span::from_ms(20_000);
/// Limit of kept records of one card.
const RECORDS: usize = 20_000;
const WELL: Byte = Byte(0);
const WARNING: Byte = Byte(1);
const ERROR: Byte = Byte(2);
const STALE: Byte = Byte(3);
/// Most claims in an answer: more do not fit into a datagram, so only failed ones are sent.
const CLAIMS: usize = 250;

/// The items of one card within the window.
#[derive(Default)]
struct Card(VecDeque<(Instant, Item)>);

impl Card {
    fn note(&mut self, now: Instant, next: &Next<'_>) {
        let Some(item @ (Item::Record(..) | Item::Lost(_))) = Item::of(next) else { return };
        while self.0.len() >= RECORDS || self.0.front().is_some_and(|(at, _)| now - *at > WINDOW) {
            self.0.pop_front();
        }
        self.0.push_back((now, item));
    }

    fn tell(&self, side: Side, since: Instant, to: &mut Evidence) {
        for (_, item) in self.0.iter().filter(|(at, _)| *at >= since) {
            to.heard(side, &item.next());
        }
    }

    fn last(&self) -> Option<Instant> {
        self.0.back().map(|(at, _)| *at)
    }
}

/// A finding, and the peer that it is about: none for this robot's own card and host.
pub type Found = (Option<String>, Finding);

/// The acceptance claims of this robot, by the last seconds of all cards.
pub struct Claims {
    channel: Channel,
    robot: Robot,
    /// What names in `/diagnostics` begin with: tools take equal ones of two robots for one.
    node: String,
    /// This robot's card, then the peers'.
    cards: Mutex<Vec<Card>>,
    /// The kernel module's counters at the start; none without a card.
    counters: BTreeMap<String, u64>,
    /// The last findings that were published.
    last: Mutex<Vec<Found>>,
}

impl Claims {
    /// Of a robot and its peers, in the order of the machine.
    #[must_use]
    pub fn new(config: &Config, robot: &Robot) -> Arc<Self> {
        // The claims about the kernel module are judged too, by its counts from now on.
        let has_card = matches!(config.capture.get_ref(), Capture::Card(_) | Capture::Stock(_));
        let counters = if has_card { module_counters(&doctor::Machine) } else { BTreeMap::new() };
        let cards = std::iter::repeat_with(Card::default).take(robot.peers.len() + 1).collect();
        Arc::new(Self {
            channel: config.channel,
            robot: robot.clone(),
            node: name_part(&format!("csi5300_{}", config.robot())),
            cards: Mutex::new(cards),
            counters,
            last: Mutex::default(),
        })
    }

    fn note(&self, card: usize, now: Instant, next: &Next<'_>) {
        if let Some(card) = lock(&self.cards).get_mut(card) {
            card.note(now, next);
        }
    }

    /// Judges every claim: once for this robot's card and host, and for each peer's card and link where possible.
    #[must_use]
    pub fn judge(&self) -> Vec<Found> {
        let mut theirs: Vec<Found> = Vec::new();
        for (peer, (name, _)) in self.robot.peers.iter().enumerate() {
            let mut both = self.collected(Some(peer));
            let report = both.far.is_some().then(|| both.judge());
            let tried =
                |finding: &Finding| matches!(finding.of, Of::Far | Of::Link) && finding.verdict != Verdict::NotTried;
            let findings = report.into_iter().flat_map(|report| report.findings).filter(tried);
            theirs.extend(findings.map(|finding| (Some(name.clone()), finding)));
        }
        let own = self.collected(None).judge().findings.into_iter();
        // A claim about links that no peer allowed gives the reason.
        let own = own.filter(|own| own.of != Of::Link || theirs.iter().all(|(_, finding)| finding.id != own.id));
        let mut found: Vec<Found> = own.map(|finding| (None, finding)).collect();
        found.append(&mut theirs);
        found
    }

    /// What this robot's card gave, and that of a peer.
    fn collected(&self, peer: Option<usize>) -> Evidence {
        let mut plan = Plan::new(self.channel);
        plan.macs = peer.and_then(|peer| self.robot.peers.get(peer)).map(|(_, mac)| [self.robot.own, *mac]);
        let mut evidence = Evidence::new(plan);
        if !self.counters.is_empty() {
            evidence.counters = module_growth(&doctor::Machine, &self.counters);
        }
        let cards = lock(&self.cards);
        // A silent card keeps its records; the others' window shows whether they are old.
        let last = cards.iter().filter_map(Card::last).max().unwrap_or(Instant::ZERO);
        let since = last - WINDOW;
        let sides = [(Side::Near, Some(0)), (Side::Far, peer.map(|peer| peer + 1))];
        for (side, card) in sides {
            if let Some(card) = card.and_then(|card| cards.get(card)) {
                card.tell(side, since, &mut evidence);
            }
        }
        evidence
    }

    /// Judges every claim now.
    pub(crate) fn answer(&self) -> SelfTestResponse {
        self_test(&self.robot.name, &self.judge())
    }

    /// Collects the machine's records. With `is_published`, judges them in each window, on a separate thread.
    pub(crate) fn attach(self: &Arc<Self>, machine: &mut Machine, is_published: bool) {
        machine.add_tap(Box::new(Arc::clone(self)));
        if is_published {
            tokio::spawn(Arc::clone(self).judge_again_and_again());
        }
    }

    async fn judge_again_and_again(self: Arc<Self>) {
        loop {
            tokio::time::sleep(Duration::from_secs_f64(WINDOW.as_s())).await;
            let own = Arc::clone(&self);
            if let Ok(found) = tokio::task::spawn_blocking(move || own.judge()).await {
                *lock(&self.last) = found;
            }
        }
    }

    /// All parts of the state, and the last findings.
    pub(crate) fn diagnostics(&self, header: Header, health: &Health) -> DiagnosticArray {
        let mut told = of(header, (&self.node, health));
        told.status.push(claims((&self.node, &self.robot.name), &lock(&self.last)));
        told
    }
}

impl Tap for Arc<Claims> {
    fn own(&mut self, now: Instant, next: &Next<'_>) {
        self.note(0, now, next);
    }

    fn peer(&mut self, peer: usize, now: Instant, next: &Next<'_>) {
        self.note(peer + 1, now, next);
    }
}

/// A part of the state `of` a robot, with the values at `places` in it.
fn status(
    (node, robot): (&str, &str),
    part: &str,
    (level, message): (Byte, String),
    (of, places): (&Value, &[&str]),
) -> DiagnosticStatus {
    let value = |place: &&str| {
        let value = match of.pointer(place)? {
            Value::String(text) => text.clone(),
            Value::Number(number) if number.is_f64() => format!("{:.1}", number.as_f64()?),
            other => other.to_string(),
        };
        Some(KeyValue { key: place.rsplit('/').next()?.to_owned(), value })
    };
    let (name, values) = (format!("{node}: {part}"), places.iter().filter_map(value).collect());
    DiagnosticStatus { level, name, message, hardware_id: robot.to_owned(), values }
}

/// All parts of the state.
fn of(header: Header, (node, health): (&str, &Health)) -> DiagnosticArray {
    let (whose, all) = ((node, health.name.as_str()), json!(health));
    let rate = |what: &str, hz: f64| (if hz > 0.0 { WELL } else { STALE }, format!("{hz:.0} {what} a second"));
    let values = ["/records", "/records_hz", "/losses", "/missing", "/strangers"];
    let card = status(whose, "card", rate("records", health.records_hz), (&all, &values));
    let refused = |count: u64| if count > 0 { format!("; {count} poses refused") } else { String::new() };
    let values = ["/poses/poses", "/poses_hz", "/poses/new_frames", "/poses/refused"];
    let stands = health.pose.is_some() && health.poses.poses == 0;
    let (level, words) = if stands { (WELL, "this robot stands".into()) } else { rate("poses", health.poses_hz) };
    let words = words + &refused(health.poses.refused);
    let odometry = status(whose, "odometry", (level, words), (&all, &values));
    let peers = health.peers.iter().map(|peer| {
        let good = |state| matches!(state, PeerState::Bearing | PeerState::Held | PeerState::NotYet);
        let (level, words) = match &peer.report {
            Some(report) => (if good(report.state) { WELL } else { WARNING }, report.words.clone()),
            None => (STALE, "no report yet".into()),
        };
        let words = if words.is_empty() { format!("{:.0} exchanges a second", peer.pairs_hz) } else { words };
        let words = words + &refused(peer.counts.poses_refused);
        let values = ["/mac", "/pairs_hz", "/counts/pairs", "/counts/losses", "/counts/poses_refused"];
        status(whose, &format!("peer {}", peer.name), (level, words), (&json!(peer), &values))
    });
    let trouble = match health.trouble.as_slice() {
        [] => (WELL, "well".to_owned()),
        all => (WARNING, all.join("; ")),
    };
    let values = ["/load/cpu_percent", "/load/memory_mib", "/load/estimate_ms", "/uptime_s"];
    let node = status(whose, "node", trouble, (&all, &values));
    DiagnosticArray { header, status: [card, odometry].into_iter().chain(peers).chain([node]).collect() }
}

/// `exchange.pairs` of the peer `burger`: `exchange.pairs, burger`.
fn name_of((peer, finding): &Found) -> String {
    peer.as_ref().map_or_else(|| finding.id.to_owned(), |peer| format!("{}, {peer}", finding.id))
}

fn with(found: &[Found], verdict: Verdict) -> Vec<&Found> {
    found.iter().filter(|(_, finding)| finding.verdict == verdict).collect()
}

/// One claim; stale if it was not tried.
fn claim(robot: &str, found: &Found) -> DiagnosticStatus {
    let Finding { verdict, found: words, .. } = &found.1;
    let (level, message) = match verdict {
        Verdict::Holds | Verdict::Measured => (WELL, words.clone()),
        Verdict::Fails => (ERROR, format!("{words}. {}", found.1.claim().map(Claim::advice).unwrap_or_default())),
        Verdict::NotTried => (STALE, format!("not tried: {words}")),
    };
    let name = format!("csi5300: {}", name_of(found));
    DiagnosticStatus { level, name, message, hardware_id: robot.to_owned(), values: Vec::new() }
}

/// The answer of the service `self_test`: passed if some claim holds and none fails.
fn self_test(robot: &str, found: &[Found]) -> SelfTestResponse {
    let size = found.len();
    let passed = with(found, Verdict::Fails).is_empty() && !with(found, Verdict::Holds).is_empty();
    let told = |found: &&Found| size <= CLAIMS || found.1.verdict == Verdict::Fails;
    let status = found.iter().filter(told).map(|found| claim(robot, found)).collect();
    SelfTestResponse { id: robot.to_owned(), passed: Byte(passed.into()), status }
}

/// All claims as one part, with the findings of failed ones.
fn claims((node, robot): (&str, &str), found: &[Found]) -> DiagnosticStatus {
    let (failed, holds) = (with(found, Verdict::Fails), with(found, Verdict::Holds).len());
    let names: Vec<String> = failed.iter().map(|found| name_of(found)).collect();
    let (level, message) = match (failed.len(), holds) {
        (0, 0) => (STALE, "too few records to try a claim".to_owned()),
        (0, _) => (WELL, format!("{holds} claims hold")),
        _ => (ERROR, format!("claims that fail: {}", names.join("; "))),
    };
    let values = failed.iter().map(|found| KeyValue { key: name_of(found), value: found.1.found.clone() }).collect();
    DiagnosticStatus { level, name: format!("{node}: claims"), message, hardware_id: robot.to_owned(), values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::health::PeerHealth;

    #[test]
    fn trouble_is_a_warning_and_silence_is_stale() {
        let mut health = Health { name: "burger".into(), records_hz: 99.6, ..Health::default() };
        health.trouble = vec!["a".into(), "b".into()];
        let said = of(Header::default(), ("csi5300_burger", &health));
        let levels: Vec<u8> = said.status.iter().map(|status| status.level.0).collect();
        assert_eq!(levels, [0, 3, 1]);
        assert_eq!(said.status[0].message, "100 records a second");
        assert_eq!(said.status[0].name, "csi5300_burger: card");
        let values: Vec<_> =
            said.status[0].values.iter().map(|told| (told.key.as_str(), told.value.as_str())).collect();
        assert_eq!(values[..2], [("records", "0"), ("records_hz", "99.6")]);
        assert_eq!((said.status[2].message.as_str(), said.status[2].hardware_id.as_str()), ("a; b", "burger"));
    }

    #[test]
    fn a_robot_that_stands_lacks_no_poses() {
        let mut health = Health { pose: Some((0.0, [1.0, 2.0, 0.0], Some(0.0))), ..Health::default() };
        let said = |health: &Health| of(Header::default(), ("csi5300_burger", health)).status[1].clone();
        assert_eq!((said(&health).level, said(&health).message.as_str()), (WELL, "this robot stands"));
        health.poses.poses = 1;
        assert_eq!((said(&health).level, said(&health).message.as_str()), (STALE, "0 poses a second"));
    }

    #[test]
    fn poses_that_are_not_used_are_said() {
        let mut health = Health { poses_hz: 50.0, peers: vec![PeerHealth::default()], ..Health::default() };
        let said = |health: &Health| {
            let said = of(Header::default(), ("csi5300_burger", health)).status;
            [said[1].message.clone(), said[2].message.clone()]
        };
        assert_eq!(said(&health), ["50 poses a second", "no report yet"]);
        (health.poses.refused, health.peers[0].counts.poses_refused) = (3, 2);
        assert_eq!(said(&health), ["50 poses a second; 3 poses refused", "no report yet; 2 poses refused"]);
    }

    #[test]
    fn a_self_test_passes_where_something_was_tried_and_nothing_fails() {
        let finding = |id, verdict| {
            let of = csi5300_accept::Of::Link;
            (Some("tb3_1".to_owned()), Finding { id, of, verdict, found: "words".into(), figures: Vec::new() })
        };
        let none = [finding("phase.rest", Verdict::NotTried)];
        let good = [none[0].clone(), finding("phase.sign", Verdict::Holds)];
        let bad = [good[0].clone(), good[1].clone(), finding("exchange.pairs", Verdict::Fails)];
        let passed = [&none[..], &good, &bad].map(|found| self_test("burger", found).passed.0);
        assert_eq!(passed, [0, 1, 0]);
        let said = self_test("burger", &bad).status;
        assert_eq!(said.iter().map(|status| status.level.0).collect::<Vec<_>>(), [3, 0, 2]);
        assert_eq!(said[2].name, "csi5300: exchange.pairs, tb3_1");
        assert!(said[2].message.starts_with("words. Expected: "), "{said:?}");
        let many = vec![bad.clone(); 100].concat();
        assert_eq!(self_test("burger", &many).status.len(), 100, "those that fail");
        let levels = [&none[..], &good, &bad].map(|found| claims(("csi5300_burger", "burger"), found).level.0);
        assert_eq!(levels, [3, 0, 2]);
        assert_eq!(claims(("csi5300_burger", "burger"), &bad).message, "claims that fail: exchange.pairs, tb3_1");
    }
}
