//! A broadcast medium in virtual time: propagation, loss, collisions, late drivers, clocks that run apart.
//!
//! Its own time is whole microseconds; robots only see their own clocks. Frames that overlap on air are lost for
//! everybody and counted. Two properties are checked at every step of every test: no frame starts after its `latest`,
//! and no pair is reported that was not sounded and answered.

use csi5300::exchange::tdma::{Config, Event, Plan, Request, Tdma};
use csi5300::time::Instant;
use csi5300_sim::random::Stream;
use driver_iface::Mac;
use driver_iface::sounding::native::Role;
use std::cell::Cell;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::rc::Rc;

/// 300 m at most: one microsecond.
const PROPAGATION_US: i64 = 1;
/// A receiver's way from antenna to user space at best; with the jitter it stays within the turn-around.
const PROCESS_US: i64 = 120;

/// A robot's clock: `local = true + offset + true * ppm / 10^6`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Skew {
    pub offset_us: i64,
    pub ppm: i64,
}

impl Skew {
    pub fn local(&self, true_us: i64) -> Instant {
        Instant::from_us(true_us + self.offset_us + (true_us * self.ppm).div_euclid(1_000_000))
    }

    /// The first true microsecond at which the clock shows `local` or later.
    pub fn true_us(&self, local: Instant) -> i64 {
        let mut guess = (local.as_us() - self.offset_us) * 1_000_000 / (1_000_000 + self.ppm) - 2;
        while self.local(guess) < local {
            guess += 1;
        }
        guess
    }
}

pub struct Station {
    pub tdma: Tdma,
    pub skew: Skew,
    pub on: bool,
    wake_us: i64,
    pub mac: Mac,
    session: u32,
    /// Events other than the everyday ones, with their time.
    pub events: Vec<(i64, Event)>,
    /// (initiator, its session, number) of forward frames that this robot's card has measured.
    measured: HashSet<(usize, u32, u32)>,
    /// Answers per responder.
    pub answered: Vec<u64>,
    pub last_answer_us: i64,
    /// Numbers of answers, newest last.
    pub numbers: Vec<u32>,
}

struct OnAir {
    sender: usize,
    start_us: i64,
    end_us: i64,
    collided: Cell<bool>,
    role: Role,
    number: u32,
    to: Mac,
    session: u32,
    bytes: Vec<u8>,
}

type Delivery = Reverse<(i64, u64, usize)>;

pub struct Air {
    pub stations: Vec<Station>,
    pub loss: f64,
    pub jitter_us: u64,
    pub now_us: i64,
    pub collisions: u64,
    pub frames: u64,
    pub last_collision_us: i64,
    /// Robots of different cells do not hear each other.
    pub cell: Vec<u8>,
    pub dice: Stream,
    /// Called with the time and every frame sent, to let an adversary listen. What it returns, with delays in
    /// microseconds, is heard by everybody; it costs no airtime, only what it makes others send does.
    pub adversary: Option<Adversary>,
    plan: Plan,
    on_air: Vec<Rc<OnAir>>,
    frames_kept: Vec<(Rc<OnAir>, i64)>,
    free: Vec<usize>,
    deliveries: BinaryHeap<Delivery>,
    forged: BinaryHeap<Reverse<(i64, Vec<u8>)>>,
    sequence: u64,
}

pub type Adversary = Box<dyn FnMut(i64, &[u8], &mut Stream) -> Vec<(i64, Vec<u8>)>>;

pub fn mac(k: usize) -> Mac {
    Mac([2, 0x53, 0, 0, (k >> 8) as u8, k as u8])
}

/// Configurations of `n` robots that all sound all others and all want the turn.
pub fn everybody(n: usize, request: Request) -> Vec<Config> {
    let macs: Vec<Mac> = (0..n).map(mac).collect();
    let config = |k: usize| {
        let peers: Vec<Mac> = macs.iter().copied().filter(|other| *other != macs[k]).collect();
        let mut config = Config::new(macs[k], k as u16, &peers, request, 1);
        config.peers.iter_mut().for_each(|peer| peer.index = u16::from(peer.mac.0[5]));
        config.epoch = csi5300::exchange::tdma::Epoch::Common(Instant::ZERO);
        config.initiate = true;
        config
    };
    (0..n).map(config).collect()
}

impl Air {
    pub fn new(configs: &[Config], seed: u64) -> Self {
        let plan = Plan::new(&configs[0].request).unwrap();
        let mut air = Self {
            stations: Vec::new(),
            loss: 0.0,
            jitter_us: 0,
            now_us: 0,
            collisions: 0,
            frames: 0,
            last_collision_us: i64::MIN,
            cell: vec![0; configs.len()],
            dice: Stream::of_seed(seed),
            adversary: None,
            plan,
            on_air: Vec::new(),
            frames_kept: Vec::new(),
            free: Vec::new(),
            deliveries: BinaryHeap::new(),
            forged: BinaryHeap::new(),
            sequence: 0,
        };
        configs.iter().for_each(|config| air.add(config, Skew::default()));
        air
    }

    fn add(&mut self, config: &Config, skew: Skew) {
        let mac = config.own.mac;
        self.stations.push(Station {
            tdma: Tdma::new(config).unwrap(),
            skew,
            on: true,
            wake_us: self.now_us,
            mac,
            session: config.session,
            events: Vec::new(),
            measured: HashSet::new(),
            answered: vec![0; self.cell.len()],
            last_answer_us: i64::MIN,
            numbers: Vec::new(),
        });
    }

    /// Turns a robot off without a word.
    pub fn crash(&mut self, k: usize) {
        self.stations[k].on = false;
    }

    /// Turns a robot on with an empty memory.
    pub fn start(&mut self, k: usize, config: &Config) {
        let skew = self.stations[k].skew;
        let mut config = config.clone();
        config.start = skew.local(self.now_us);
        let station = &mut self.stations[k];
        (station.tdma, station.session) = (Tdma::new(&config).unwrap(), config.session);
        (station.on, station.wake_us) = (true, self.now_us);
    }

    /// Tells a robot whether to initiate; its driver wakes up for it.
    pub fn set_initiate(&mut self, k: usize, initiate: bool) {
        self.stations[k].tdma.set_initiate(initiate);
        self.stations[k].wake_us = self.now_us;
    }

    /// Gives every robot its own clock; the configuration's epochs and starts are on it.
    pub fn restart_with_skew(&mut self, configs: &[Config], skews: &[Skew]) {
        self.stations.clear();
        for (config, skew) in configs.iter().zip(skews) {
            let mut config = config.clone();
            config.start = skew.local(self.now_us);
            self.add(&config, *skew);
        }
    }

    /// Lets `span_us` of true time pass.
    pub fn run_us(&mut self, span_us: i64) {
        let end_us = self.now_us + span_us;
        loop {
            let wakes = self.stations.iter().enumerate().filter(|(_, station)| station.on);
            let wake = wakes.map(|(k, station)| (station.wake_us, k)).min();
            let delivery = self.deliveries.peek().map_or(i64::MAX, |Reverse((at, _, _))| *at);
            let (wake_us, k) = wake.unwrap_or((i64::MAX, 0));
            let forged = self.forged.peek().map_or(i64::MAX, |Reverse((at, _))| *at);
            let next_us = wake_us.min(delivery).min(forged);
            if next_us > end_us {
                break;
            }
            self.now_us = self.now_us.max(next_us);
            if forged == next_us {
                self.hear_forged();
            } else if delivery == next_us {
                self.deliver();
            } else {
                self.serve(k);
            }
        }
        self.now_us = end_us;
    }

    pub fn run_s(&mut self, span_s: i64) {
        self.run_us(span_s * 1_000_000);
    }

    /// What a driver does when it is awake.
    fn serve(&mut self, k: usize) {
        let now = self.stations[k].skew.local(self.now_us);
        while let Some(transmit) = self.stations[k].tdma.poll_transmit(now) {
            assert!(transmit.at <= now && now <= transmit.latest, "a frame out of its time: {transmit:?} at {now:?}");
            let (role, number, to) = (transmit.role, transmit.number, transmit.peer);
            let bytes = transmit.frame.to_vec();
            self.send(k, role, number, to, bytes);
        }
        self.drain_events(k);
        let station = &mut self.stations[k];
        let timeout = station.tdma.poll_timeout();
        assert!(timeout.is_none_or(|at| at > now), "the scheduler wants to be called again at once");
        let late_us = self.dice.below(self.jitter_us + 1) as i64;
        station.wake_us = timeout.map_or(i64::MAX, |at| station.skew.true_us(at) + late_us);
    }

    fn drain_events(&mut self, k: usize) {
        while let Some(event) = self.stations[k].tdma.poll_event() {
            match event {
                Event::Answered { peer, number, .. } => {
                    let responder = self.stations.iter().position(|station| station.mac == peer).unwrap();
                    let key = (k, self.stations[k].session, number);
                    assert!(self.stations[responder].measured.remove(&key), "a pair that was not sounded: {event:?}");
                    let station = &mut self.stations[k];
                    station.answered[responder] += 1;
                    station.last_answer_us = self.now_us;
                    station.numbers.push(number);
                }
                Event::Unanswered { .. } | Event::Asked { .. } | Event::Missed { .. } => {}
                other => self.stations[k].events.push((self.now_us, other)),
            }
        }
    }

    fn send(&mut self, sender: usize, role: Role, number: u32, to: Mac, bytes: Vec<u8>) {
        let airtime_us = i64::from(self.plan.phy.airtime_us(bytes.len() + 4));
        let (start_us, end_us) = (self.now_us, self.now_us + airtime_us);
        self.frames += 1;
        self.on_air.retain(|other| other.end_us + PROPAGATION_US > start_us);
        let rivals = self.on_air.iter().filter(|other| self.cell[other.sender] == self.cell[sender]);
        let collided = Cell::new(false);
        for other in rivals {
            other.collided.set(true);
            collided.set(true);
            self.collisions += 1;
            self.last_collision_us = start_us;
        }
        let session = self.stations[sender].session;
        if let Some(adversary) = &mut self.adversary {
            let forged = adversary(start_us, &bytes, &mut self.dice);
            self.forged.extend(forged.into_iter().map(|(delay_us, bytes)| Reverse((end_us + delay_us, bytes))));
        }
        let frame = Rc::new(OnAir { sender, start_us, end_us, collided, role, number, to, session, bytes });
        self.on_air.push(frame.clone());
        for receiver in 0..self.stations.len() {
            let hears = receiver != sender && self.cell[receiver] == self.cell[sender];
            if hears && !self.dice.happens(self.loss) {
                let stamp_us = end_us + PROPAGATION_US + self.dice.below(self.jitter_us / 2 + 1) as i64;
                let at_us = stamp_us + PROCESS_US + self.dice.below(self.jitter_us + 1) as i64;
                self.post(at_us, receiver, frame.clone(), stamp_us);
            }
        }
    }

    /// Everybody hears the next forged frame.
    fn hear_forged(&mut self) {
        let Some(Reverse((_, bytes))) = self.forged.pop() else { return };
        for k in 0..self.stations.len() {
            let station = &mut self.stations[k];
            if station.on {
                let now = station.skew.local(self.now_us);
                station.tdma.handle_heard(now, now, &bytes);
                self.serve(k);
            }
        }
    }

    fn post(&mut self, at_us: i64, receiver: usize, frame: Rc<OnAir>, stamp_us: i64) {
        let place = self.free.pop().unwrap_or_else(|| {
            self.frames_kept.push((frame.clone(), 0));
            self.frames_kept.len() - 1
        });
        self.frames_kept[place] = (frame, stamp_us);
        self.sequence += 1;
        self.deliveries.push(Reverse((at_us, self.sequence << 16 | place as u64, receiver)));
    }

    fn deliver(&mut self) {
        let Some(Reverse((_, key, receiver))) = self.deliveries.pop() else { return };
        let place = (key & 0xffff) as usize;
        let (frame, stamp_us) = self.frames_kept[place].clone();
        self.free.push(place);
        let station = &mut self.stations[receiver];
        if frame.collided.get() || !station.on {
            return;
        }
        debug_assert!(frame.start_us < stamp_us);
        if frame.role == Role::Forward && frame.to == station.mac {
            station.measured.insert((frame.sender, frame.session, frame.number));
        }
        let (now, ended) = (station.skew.local(self.now_us), station.skew.local(stamp_us));
        station.tdma.handle_heard(now, ended, &frame.bytes);
        self.serve(receiver);
    }

    pub fn pairs(&self) -> u64 {
        self.stations.iter().flat_map(|station| &station.answered).sum()
    }

    /// Jain's index over the answers of all ordered pairs of robots that are on.
    pub fn jain(&self) -> f64 {
        let mut shares = Vec::new();
        for (k, station) in self.stations.iter().enumerate() {
            let others = station.answered.iter().enumerate().filter(|(other, _)| *other != k);
            shares.extend(others.map(|(_, count)| *count as f64));
        }
        jain(&shares)
    }

    pub fn initiators(&self) -> usize {
        self.stations.iter().filter(|station| station.on && station.tdma.has_turn()).count()
    }
}

/// Jain's fairness index, `(sum x)^2 / (n sum x^2)`: 1 if all are equal.
pub fn jain(shares: &[f64]) -> f64 {
    let sum: f64 = shares.iter().sum();
    let squares: f64 = shares.iter().map(|share| share * share).sum();
    sum * sum / (shares.len() as f64 * squares)
}
