//! The air: frames in true time, which robots hear them, and each driver's reaction.
//!
//! Everything is an event in a queue ordered by time, so an idle room costs nothing. Coefficients are computed when a
//! record is read, and only for robots that are read.

use super::faults::Injected;
use super::motion::Follower;
use super::radio::{Away, Radio};
use super::random::{Purpose, Stream};
use super::sounder::{FrameRole, hear, sounder};
use super::world::{Path, World};
use csi5300::exchange::tdma::Tdma;
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::mpdu::{self, Repr};
use driver_iface::sounding::{self, MAGIC_MAC};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Time of the clear channel assessment: senders that start closer together do not hear each other (802.11 aCCATime).
const SENSE_NS: i64 = 4_000;
/// DIFS in the 5 GHz band, the slot of the back-off after it, and the number of slots (aCWmin + 1).
const DIFS_NS: i64 = 34_000;
const BACK_OFF_NS: i64 = 9_000;
const BACK_OFF_SLOTS: f64 = 16.0;
/// No answer begins sooner after a frame's end (SIFS).
const SIFS_NS: i64 = 16_000;
/// A frame that repeats a number within this time is its answer.
const ANSWER_WITHIN_NS: i64 = 5_000_000;

/// A frame on air now.
#[derive(Debug)]
struct Active {
    id: u64,
    flight: Arc<Flight>,
    collided: bool,
}

/// All frames of a room.
pub struct Air {
    world: Arc<World>,
    nodes: Vec<Node>,
    /// By true time; at equal times the one pushed earlier is first.
    events: BTreeMap<(i64, u64), What>,
    order: u64,
    active: Vec<Active>,
    now_ns: i64,
    end_ns: i64,
    paths: Vec<Path>,
    /// Whether robots sound each other.
    sounds: bool,
    scratch: Vec<u8>,
    followers: Vec<Follower>,
}

impl std::fmt::Debug for Air {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Air").field("now_ns", &self.now_ns).field("nodes", &self.nodes).finish_non_exhaustive()
    }
}

impl Air {
    /// The air of a world, at time 0. Its robots sound each other as the scene states if it `sounds`.
    pub fn new(world: Arc<World>, sounds: bool) -> Self {
        let scene = world.scene();
        let nodes = (0..scene.robot.len()).map(|robot| Node::new(scene.seed, robot)).collect();
        let end_ns = (scene.duration_s * 1e9).round() as i64;
        let mut air = Self {
            nodes,
            events: BTreeMap::new(),
            order: 0,
            active: Vec::new(),
            now_ns: 0,
            end_ns,
            paths: Vec::new(),
            sounds,
            scratch: Vec::new(),
            followers: Vec::new(),
            world,
        };
        for robot in 0..air.nodes.len() {
            let faults = air.world.scene().robot[robot].faults.clone();
            for at_s in faults.restart_at_s {
                let (off, on) = ((at_s * 1e9) as i64, ((at_s + faults.restart_s) * 1e9) as i64);
                air.push(off, What::Off { robot });
                air.push(on, What::On { robot });
            }
            air.start_sender(robot, Instant::ZERO);
        }
        air
    }

    /// The world.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// A robot's card, driver and counts.
    pub fn node(&mut self, robot: usize) -> &mut Node {
        &mut self.nodes[robot]
    }

    /// The account of each robot.
    pub fn injected(&self) -> impl Iterator<Item = Injected> + '_ {
        self.nodes.iter().map(|node| Injected { under_way: node.arrivals.len() as u64, ..node.injected })
    }

    /// The current true time.
    pub fn now_ns(&self) -> i64 {
        self.now_ns
    }

    /// The end of the scene, true time.
    pub fn end_ns(&self) -> i64 {
        self.end_ns
    }

    /// The time of the next event before the end.
    pub fn next_ns(&self) -> Option<i64> {
        self.events.first_key_value().map(|((t_ns, _), _)| *t_ns).filter(|&t_ns| t_ns <= self.end_ns)
    }

    /// Lets a robot follow a source. False if it follows one already.
    pub fn follow(&mut self, follower: Follower) -> bool {
        let free = self.follower(follower.robot).is_none();
        if free {
            self.followers.push(follower);
        }
        free
    }

    /// The source that a robot follows.
    pub fn follower(&self, robot: usize) -> Option<&Follower> {
        self.followers.iter().find(|follower| follower.robot == robot)
    }

    /// Lets time pass up to `until_ns`, but not beyond the end of the scene.
    pub fn advance(&mut self, until_ns: i64) {
        // Later poses do not change earlier times.
        let now = Instant::from_us(until_ns.max(self.now_ns) / 1_000);
        self.followers.iter_mut().for_each(|follower| follower.take(now));
        let until_ns = until_ns.min(self.end_ns);
        while let Some(event) = self.events.first_entry().filter(|event| event.key().0 <= until_ns) {
            let ((t_ns, _), what) = event.remove_entry();
            self.now_ns = self.now_ns.max(t_ns);
            self.handle(t_ns, what);
        }
        self.now_ns = self.now_ns.max(until_ns);
    }

    /// A robot's host hands a frame (no FCS) to its card at `now_ns`, to be sent with the robot's own `mcs` if none is
    /// given. It goes on air at once, or after the turn-around for an answer, or when the air becomes free.
    pub fn transmit(&mut self, robot: usize, now_ns: i64, frame: &[u8], mcs: Option<u8>) {
        let now_ns = now_ns.max(self.now_ns);
        if !self.nodes[robot].on {
            return;
        }
        let bytes = FrameBytes::new(frame);
        let node = &mut self.nodes[robot];
        let scene = self.world.scene();
        let radio = scene.radio_of(&scene.robot[robot]);
        let answered = node.heard.filter(|heard| {
            heard.number.is_some() && heard.number == bytes.number() && now_ns - heard.start_ns < ANSWER_WITHIN_NS
        });
        let (start_ns, instant_ns) = match answered {
            Some(heard) => {
                node.heard = None;
                let after_ns = heard.start_ns + radio.turn_around.draw_ns(heard.away_ns, &mut node.timing);
                (after_ns.max(heard.end_ns + SIFS_NS).max(now_ns), Some(heard.instant_ns))
            }
            None => (now_ns + radio.send_jitter_ns(&mut node.timing), None),
        };
        let mcs = mcs.unwrap_or(radio.mcs);
        node.outgoing.push_back(Outgoing { not_before_ns: start_ns, instant_ns, mcs, retries: 0, bytes });
        if node.outgoing.len() == 1 {
            self.attempt(robot, start_ns);
        }
    }

    /// A card will try to send at `t_ns`.
    fn attempt(&mut self, robot: usize, t_ns: i64) {
        self.nodes[robot].tried_ns = Some(t_ns);
        self.push(t_ns, What::Start { from: robot });
    }

    fn push(&mut self, t_ns: i64, what: What) {
        self.order += 1;
        self.events.insert((t_ns, self.order), what);
    }

    fn handle(&mut self, t_ns: i64, what: What) {
        match what {
            What::Start { from } => {
                if self.nodes[from].tried_ns == Some(t_ns) {
                    self.start(t_ns, from);
                }
            }
            What::End { flight } => self.end(flight),
            What::Again { robot, flight, role } => {
                let again = self.received(robot, &flight, t_ns, role, 0);
                self.nodes[robot].injected.duplicated += u64::from(again);
            }
            What::Ask { robot } => {
                if self.nodes[robot].armed_ns == Some(t_ns) {
                    self.nodes[robot].armed_ns = None;
                    self.ask(robot, t_ns);
                }
            }
            What::Off { robot } => {
                let node = &mut self.nodes[robot];
                (node.on, node.sender, node.armed_ns, node.heard) = (false, None, None, None);
                (node.outgoing, node.tried_ns) = (VecDeque::new(), None);
                node.injected.restarts += 1;
            }
            What::On { robot } => self.switch_on(robot, t_ns),
        }
    }

    /// The driver is reloaded: the counter restarts at 1, the card's clock at 0, and the host's sender restarts.
    fn switch_on(&mut self, robot: usize, t_ns: i64) {
        let node = &mut self.nodes[robot];
        (node.on, node.bfee_count, node.dropped_since) = (true, 0, None);
        node.clock_base_us = self.world.scene().robot[robot].crystal.clock_us(t_ns);
        self.start_sender(robot, local(&self.world, robot, t_ns));
    }

    /// Starts a robot's sender at `now` on its own clock.
    fn start_sender(&mut self, robot: usize, now: Instant) {
        let restarts = self.nodes[robot].injected.restarts;
        let sender = self.sounds.then(|| sounder(&self.world, robot, restarts, now).ok().flatten());
        self.nodes[robot].sender = sender.flatten();
        self.arm(robot);
    }

    /// A card's first frame starts, unless the card hears a busy air.
    fn start(&mut self, t_ns: i64, from: usize) {
        let busy = self.active.iter().filter(|a| a.flight.from == from || a.flight.start_ns + SENSE_NS <= t_ns);
        if let Some(busy_ns) = busy.map(|a| a.flight.end_ns).max() {
            let slots = (self.nodes[from].timing.uniform() * BACK_OFF_SLOTS) as i64;
            self.attempt(from, busy_ns + DIFS_NS + slots * BACK_OFF_NS);
            return;
        }
        let node = &mut self.nodes[from];
        node.tried_ns = None;
        let Some(Outgoing { bytes, instant_ns, mcs, retries, .. }) = node.outgoing.pop_front() else { return };
        let scene = self.world.scene();
        let retry = scene.robot[from].faults.retry;
        let again = retries == 0 && retry > 0.0 && node.loss.happens(retry);
        if again {
            let once_more = Outgoing { not_before_ns: t_ns, instant_ns, mcs, retries: 1, bytes: bytes.clone() };
            node.outgoing.push_front(once_more);
        }
        node.injected.sent += u64::from(retries == 0);
        let waiting_ns = node.outgoing.front().map(|next| next.not_before_ns);
        let radio = Radio { mcs, ..*scene.radio_of(&scene.robot[from]) };
        let end_ns = t_ns + radio.airtime_ns(bytes.with_fcs().len(), scene.bandwidth_mhz == 40);
        let instant_ns = instant_ns.unwrap_or(t_ns);
        let flight = Arc::new(Flight { from, start_ns: t_ns, end_ns, instant_ns, mcs, retries, again, bytes });
        let collided = !self.active.is_empty();
        self.active.iter_mut().for_each(|active| active.collided = true);
        let id = self.order;
        self.active.push(Active { id, flight, collided });
        self.push(end_ns, What::End { flight: id });
        if let Some(waiting_ns) = waiting_ns {
            self.attempt(from, waiting_ns.max(end_ns + DIFS_NS));
        }
    }

    /// A frame ends: every other robot hears it, or not.
    fn end(&mut self, id: u64) {
        let Some(at) = self.active.iter().position(|a| a.id == id) else { return };
        let Active { flight, collided, .. } = self.active.swap_remove(at);
        if !flight.again {
            self.nodes[flight.from].pass(&flight, true);
        }
        for robot in 0..self.nodes.len() {
            if robot != flight.from && self.hears(robot, &flight, collided) {
                self.hear(robot, &flight);
            }
        }
    }

    /// Whether a robot's card decodes a frame; counted if not.
    fn hears(&mut self, robot: usize, flight: &Flight, collided: bool) -> bool {
        let scene = self.world.scene();
        let node = &mut self.nodes[robot];
        if !node.on {
            node.injected.missed_while_off += 1;
        } else if collided {
            node.injected.collided += 1;
        } else if !self.world.is_open()
            && !self.world.paths(flight.from, robot, 0, flight.start_ns as f64 * 1e-9, &mut self.paths)
        {
            node.injected.out_of_reach += 1;
        } else if node.loss.happens(scene.robot[robot].faults.loss) {
            node.injected.lost += 1;
        } else {
            return true;
        }
        false
    }

    /// A robot hears a frame: its scheduler gets it, its driver makes a record and may answer by itself.
    fn hear(&mut self, robot: usize, flight: &Arc<Flight>) {
        let world = Arc::clone(&self.world);
        let scene = world.scene();
        let radio = scene.radio_of(&scene.robot[robot]);
        let node = &mut self.nodes[robot];
        node.pass(flight, false);
        let away_ns = radio.turn_around.draw_away_ns(&mut node.away, &mut node.timing);
        node.heard = Some(FrameHeard {
            away_ns,
            start_ns: flight.start_ns,
            end_ns: flight.end_ns,
            instant_ns: flight.instant_ns,
            number: flight.bytes.number(),
        });
        let now = local(&self.world, robot, flight.end_ns);
        let role = node.sender.as_mut().map_or(FrameRole::Unknown, |tdma| hear(tdma, now, flight.bytes.without_fcs()));
        let role = node.role_of_copy(flight, role);
        let duplicated = node.loss.happens(scene.robot[robot].faults.duplicate);
        self.received(robot, flight, flight.start_ns, role, away_ns);
        if duplicated {
            let again_ns = flight.start_ns + radio.turn_around.draw_ns(away_ns, &mut self.nodes[robot].timing);
            self.push(again_ns.max(flight.end_ns), What::Again { robot, flight: Arc::clone(flight), role });
        }
        if scene.robot[robot].ack_len == Some(flight.bytes.with_fcs().len()) {
            let answer = driver_answer(&flight.bytes, world.mac(robot));
            answer.into_iter().for_each(|answer| self.transmit(robot, flight.end_ns, &answer, None));
        }
        if self.nodes[robot].sender.is_some() {
            self.ask(robot, flight.end_ns);
        }
    }

    /// The driver counts a frame with CSI and passes its record on, or loses it. False if there was nothing to count:
    /// no CSI was requested, or the robot is off.
    fn received(&mut self, robot: usize, flight: &Arc<Flight>, t_ns: i64, role: FrameRole, away_ns: i64) -> bool {
        let node = &mut self.nodes[robot];
        if !flight.bytes.is_measured() || !node.on {
            return false;
        }
        node.bfee_count = node.bfee_count.wrapping_add(1);
        node.injected.received += 1;
        let scene = self.world.scene();
        if node.loss.happens(scene.robot[robot].faults.driver_drop) {
            node.injected.driver_dropped += 1;
            // Until another record comes.
            node.injected.driver_dropped_unseen += 1;
            node.dropped_since = node.dropped_since.map(|dropped| dropped + 1);
            return true;
        }
        let overheard = node.listening == Listening::Own && role == FrameRole::Overheard;
        node.injected.overheard += u64::from(overheard);
        node.injected.unheard += u64::from(node.listening == Listening::Nobody);
        if node.listening != Listening::Nobody && !overheard {
            let radio = scene.radio_of(&scene.robot[robot]);
            let end_ns = t_ns + flight.end_ns - flight.start_ns;
            // The driver's queue keeps the order.
            let arrival_ns = (end_ns + radio.host_latency_ns(away_ns, &mut node.timing)).max(node.last_arrival_ns);
            node.last_arrival_ns = arrival_ns;
            let clock_us = scene.robot[robot].crystal.clock_us(t_ns).wrapping_sub(node.clock_base_us);
            let bfee_count = node.bfee_count;
            node.injected.driver_dropped_unseen -= node.dropped_since.replace(0).unwrap_or(0);
            node.arrivals.push_back(Reception {
                flight: Arc::clone(flight),
                t_ns,
                arrival_ns,
                bfee_count,
                clock_us,
                role,
            });
        }
        true
    }

    /// Takes frames from a robot's sender, and its next time.
    fn ask(&mut self, robot: usize, t_ns: i64) {
        let now = local(&self.world, robot, t_ns);
        let mut bytes = std::mem::take(&mut self.scratch);
        while let Some(next) = self.nodes[robot].sender.as_mut().and_then(|tdma| tdma.poll_transmit(now)) {
            bytes.clear();
            bytes.extend_from_slice(next.frame);
            self.transmit(robot, t_ns, &bytes, None);
        }
        self.scratch = bytes;
        self.arm(robot);
    }

    /// Schedules a sender's next time.
    fn arm(&mut self, robot: usize) {
        let node = &mut self.nodes[robot];
        let Some(at) = node.sender.as_ref().and_then(Tdma::poll_timeout) else { return };
        let t_ns = true_ns(&self.world, robot, at).max(self.now_ns + 1);
        if node.armed_ns.is_none_or(|armed_ns| t_ns < armed_ns) {
            node.armed_ns = Some(t_ns);
            self.push(t_ns, What::Ask { robot });
        }
    }
}

/// A true time on a host's monotonic clock, which runs like its wall clock and starts with the scene.
fn local(world: &World, robot: usize, t_ns: i64) -> Instant {
    let fast_ns = (t_ns as f64 * world.scene().robot[robot].host_clock.drift_ppm * 1e-6).round() as i64;
    Instant::from_us((t_ns + fast_ns).div_euclid(1_000))
}

/// The first true time at which a host's monotonic clock shows `at`.
fn true_ns(world: &World, robot: usize, at: Instant) -> i64 {
    let local_ns = at.as_us().saturating_mul(1_000);
    let rate = 1.0 + world.scene().robot[robot].host_clock.drift_ppm * 1e-6;
    let mut t_ns = local_ns - (local_ns as f64 * (1.0 - 1.0 / rate)).round() as i64;
    while local(world, robot, t_ns) < at {
        t_ns += 1;
    }
    t_ns
}

/// The WSR driver's answer to a sounding frame: the frame with its FCS and one more byte, addr3 replaced by its own
/// MAC.
fn driver_answer(frame: &FrameBytes, own: Mac) -> Option<Vec<u8>> {
    let forward = sounding::Frame::new_checked(frame.without_fcs())?;
    let fcs = *frame.with_fcs().last_chunk()?;
    let mut answer = vec![0; frame.without_fcs().len() + sounding::wsr::REPLY_GROWTH];
    sounding::wsr::emit_reply(&forward, fcs, own, &mut answer)?;
    Some(answer)
}

/// A frame on air.
#[derive(Debug)]
pub struct Flight {
    /// The sender.
    pub from: usize,
    /// True time of its rise.
    pub start_ns: i64,
    /// True time of its end.
    pub end_ns: i64,
    /// True time of the rise of its exchange's forward frame.
    pub instant_ns: i64,
    /// Modulation and coding scheme.
    pub mcs: u8,
    /// Times that the card has sent it before.
    pub retries: u8,
    /// The card will send it once more.
    pub again: bool,
    /// The frame with its FCS.
    pub bytes: FrameBytes,
}

/// A frame as it is on air, its FCS at the end.
#[derive(Clone, Debug)]
pub struct FrameBytes(Arc<[u8]>);

impl FrameBytes {
    /// A frame to which the card appends the FCS.
    pub fn new(frame: &[u8]) -> Self {
        let mut bytes = Vec::with_capacity(frame.len() + mpdu::FCS);
        bytes.extend_from_slice(frame);
        bytes.extend_from_slice(&mpdu::crc32(frame).to_le_bytes());
        Self(bytes.into())
    }

    /// All bytes.
    pub fn with_fcs(&self) -> &[u8] {
        &self.0
    }

    /// The bytes between host and card.
    pub fn without_fcs(&self) -> &[u8] {
        self.0.split_last_chunk::<{ mpdu::FCS }>().map_or(&[], |(frame, _)| frame)
    }

    /// The fields of the header; `None` of a frame shorter than one.
    pub fn mpdu(&self) -> Option<Repr<'_>> {
        Repr::parse(&self.0)
    }

    /// The number of a sounding frame, in both dialects.
    pub fn number(&self) -> Option<u32> {
        self.mpdu()?.sounding_counter()
    }

    /// Whether a card in monitor mode reports CSI of it: addresses 1 and 2 are the magic ones (iwlwifi dvm/sta.c,
    /// csitool FAQ).
    pub fn is_measured(&self) -> bool {
        self.mpdu().is_some_and(|mpdu| [mpdu.addr1, mpdu.addr2] == [MAGIC_MAC; 2])
    }
}

/// A frame that passed a robot's monitor interface.
#[derive(Clone, Debug)]
pub struct Passed {
    /// The frame.
    pub flight: Arc<Flight>,
    /// The robot's own frame: the card's report that it was sent.
    pub own: bool,
}

/// A frame that a card received and its driver handed on.
#[derive(Clone, Debug)]
pub struct Reception {
    /// The frame.
    pub flight: Arc<Flight>,
    /// True time of its rise at the receiver.
    pub t_ns: i64,
    /// True time at which the record reaches the host.
    pub arrival_ns: i64,
    /// The driver's counter.
    pub bfee_count: u16,
    /// The card's clock, not wrapped.
    pub clock_us: u64,
    /// The frame's role for this robot.
    pub role: FrameRole,
}

/// Which records of a robot are read; the others are not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Listening {
    /// None.
    Nobody,
    /// Those of exchanges in which this robot takes part.
    Own,
    /// All.
    All,
}

/// One robot's card, driver and sender.
#[derive(Debug)]
pub struct Node {
    /// Records under way to the host or waiting to be read.
    pub arrivals: VecDeque<Reception>,
    /// What was done to this robot.
    pub injected: Injected,
    /// Which of this robot's records somebody reads.
    pub listening: Listening,
    /// Frames that passed its monitor interface and were not fetched yet, if somebody has one.
    pub passed: Option<VecDeque<Passed>>,
    /// Frames lost because nobody fetched them.
    pub passed_lost: u64,
    sender: Option<Tdma>,
    /// The next time the sender is asked.
    armed_ns: Option<i64>,
    /// The last frame heard, until it is answered.
    heard: Option<FrameHeard>,
    /// Frames that the card is to send, in order.
    outgoing: VecDeque<Outgoing>,
    /// By sender: the last frame heard of those sent twice, until its second copy is heard.
    first_copies: BTreeMap<usize, (FrameBytes, FrameRole)>,
    /// When the first of them is tried.
    tried_ns: Option<i64>,
    on: bool,
    /// The card's clock at the last switch-on, subtracted from its reading.
    clock_base_us: u64,
    bfee_count: u16,
    /// Records lost in the driver since the last that it handed on; `None` before the first.
    dropped_since: Option<u64>,
    last_arrival_ns: i64,
    timing: Stream,
    loss: Stream,
    /// The answer to the last frame heard.
    away: Away,
}

/// A frame heard.
#[derive(Clone, Copy, Debug)]
struct FrameHeard {
    start_ns: i64,
    end_ns: i64,
    instant_ns: i64,
    /// Deviation of the host's interrupt from its usual time.
    away_ns: i64,
    number: Option<u32>,
}

/// A frame in a card's queue.
#[derive(Debug)]
struct Outgoing {
    not_before_ns: i64,
    instant_ns: Option<i64>,
    mcs: u8,
    retries: u8,
    bytes: FrameBytes,
}

/// Frames that a monitor interface holds until they are fetched; the kernel's default holds about as many.
const PASSED: usize = 256;

impl Node {
    /// Passes a frame to the robot's monitor interface, if it is taken.
    fn pass(&mut self, flight: &Arc<Flight>, own: bool) {
        match &mut self.passed {
            Some(passed) if passed.len() < PASSED => passed.push_back(Passed { flight: Arc::clone(flight), own }),
            Some(_) => self.passed_lost += 1,
            None => {}
        }
    }

    /// The role of a frame heard: of a second copy that of the first, which alone the scheduler takes for itself.
    fn role_of_copy(&mut self, flight: &Flight, role: FrameRole) -> FrameRole {
        if flight.again {
            self.first_copies.insert(flight.from, (flight.bytes.clone(), role));
        } else if flight.retries > 0 {
            let first = self.first_copies.remove(&flight.from);
            return first.filter(|(bytes, _)| Arc::ptr_eq(&bytes.0, &flight.bytes.0)).map_or(role, |(_, role)| role);
        }
        role
    }

    fn new(seed: u64, robot: usize) -> Self {
        Self {
            arrivals: VecDeque::new(),
            injected: Injected::default(),
            listening: Listening::Nobody,
            passed: None,
            passed_lost: 0,
            sender: None,
            armed_ns: None,
            heard: None,
            outgoing: VecDeque::new(),
            first_copies: BTreeMap::new(),
            tried_ns: None,
            on: true,
            clock_base_us: 0,
            bfee_count: 0,
            dropped_since: None,
            last_arrival_ns: 0,
            timing: Stream::new(seed, robot, Purpose::Timing),
            loss: Stream::new(seed, robot, Purpose::Loss),
            away: Away::default(),
        }
    }
}

/// Kinds of events.
#[derive(Debug)]
enum What {
    Start { from: usize },
    End { flight: u64 },
    Again { robot: usize, flight: Arc<Flight>, role: FrameRole },
    Ask { robot: usize },
    Off { robot: usize },
    On { robot: usize },
}
