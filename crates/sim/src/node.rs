//! One robot's card, driver and sender, as the air knows them.

use super::faults::Injected;
use super::radio::Away;
use super::random::{Purpose, Stream};
use super::station::{Role, Station};
use std::collections::VecDeque;
use std::sync::Arc;

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
    /// The frame, without FCS.
    pub bytes: Box<[u8]>,
}

/// A frame that passed a robot's monitor interface.
#[derive(Clone, Debug)]
pub struct Passed {
    /// The frame.
    pub flight: Arc<Flight>,
    /// The robot sent it itself, and this is the card's report that it went out.
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
    /// What the card's clock shows, not wrapped.
    pub clock_us: u64,
    /// What the frame was to this robot.
    pub role: Role,
}

/// Which records of a robot somebody reads; nobody computes the others.
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
    pub(super) station: Option<Box<dyn Station>>,
    /// The next time the station is asked.
    pub(super) armed_ns: Option<i64>,
    /// The frame heard last, while it is not answered.
    pub(super) heard: Option<Heard>,
    /// Frames that the card is to send, in order.
    pub(super) outgoing: VecDeque<Outgoing>,
    /// When the first of them is tried.
    pub(super) tried_ns: Option<i64>,
    pub(super) on: bool,
    /// The card's clock at the last switching on, taken off what it shows.
    pub(super) clock_base_us: u64,
    pub(super) bfee_count: u16,
    /// Records lost in the driver since the last that it handed on; `None` before the first.
    pub(super) dropped_since: Option<u64>,
    pub(super) last_arrival_ns: i64,
    pub(super) timing: Stream,
    pub(super) loss: Stream,
    /// How the last frame heard was answered.
    pub(super) away: Away,
}

/// A frame heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heard {
    pub(super) start_ns: i64,
    pub(super) end_ns: i64,
    pub(super) instant_ns: i64,
    /// How much the host's interrupt is away from the usual.
    pub(super) away_ns: i64,
    pub(super) number: Option<[u8; 4]>,
}

/// A frame in a card's queue.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) not_before_ns: i64,
    pub(super) instant_ns: Option<i64>,
    pub(super) mcs: u8,
    pub(super) bytes: Box<[u8]>,
}

/// Frames that a monitor interface holds until they are fetched; the kernel's default holds about as many.
const PASSED: usize = 256;

impl Node {
    /// A frame passes the robot's monitor interface, if somebody has it.
    pub(super) fn pass(&mut self, flight: &Arc<Flight>, own: bool) {
        match &mut self.passed {
            Some(passed) if passed.len() < PASSED => passed.push_back(Passed { flight: Arc::clone(flight), own }),
            Some(_) => self.passed_lost += 1,
            None => {}
        }
    }

    pub(super) fn new(seed: u64, robot: usize) -> Self {
        Self {
            arrivals: VecDeque::new(),
            injected: Injected::default(),
            listening: Listening::Nobody,
            passed: None,
            passed_lost: 0,
            station: None,
            armed_ns: None,
            heard: None,
            outgoing: VecDeque::new(),
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
