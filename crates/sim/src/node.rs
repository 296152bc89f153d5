//! One robot's card, driver and sender, as seen by the air.

use super::faults::Injected;
use super::radio::Away;
use super::random::{Purpose, Stream};
use super::station::{FrameRole, Station};
use driver_iface::mpdu::{self, Mpdu};
use driver_iface::sounding::MAGIC_MAC;
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
    pub fn mpdu(&self) -> Option<Mpdu<'_>> {
        Mpdu::new_checked(&self.0).ok()
    }

    /// The number of a sounding frame, in both dialects.
    pub fn number(&self) -> Option<u32> {
        self.mpdu()?.sounding_counter()
    }

    /// Whether a card in monitor mode reports CSI of it: addresses 1 and 2 are the magic ones (iwlwifi dvm/sta.c,
    /// csitool FAQ).
    pub fn is_measured(&self) -> bool {
        self.mpdu().is_some_and(|mpdu| [mpdu.addr1(), mpdu.addr2()] == [MAGIC_MAC; 2])
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
    pub(super) station: Option<Box<dyn Station>>,
    /// The next time the station is asked.
    pub(super) armed_ns: Option<i64>,
    /// The last frame heard, until it is answered.
    pub(super) heard: Option<FrameHeard>,
    /// Frames that the card is to send, in order.
    pub(super) outgoing: VecDeque<Outgoing>,
    /// When the first of them is tried.
    pub(super) tried_ns: Option<i64>,
    pub(super) on: bool,
    /// The card's clock at the last switch-on, subtracted from its reading.
    pub(super) clock_base_us: u64,
    pub(super) bfee_count: u16,
    /// Records lost in the driver since the last that it handed on; `None` before the first.
    pub(super) dropped_since: Option<u64>,
    pub(super) last_arrival_ns: i64,
    pub(super) timing: Stream,
    pub(super) loss: Stream,
    /// The answer to the last frame heard.
    pub(super) away: Away,
}

/// A frame heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameHeard {
    pub(super) start_ns: i64,
    pub(super) end_ns: i64,
    pub(super) instant_ns: i64,
    /// Deviation of the host's interrupt from its usual time.
    pub(super) away_ns: i64,
    pub(super) number: Option<u32>,
}

/// A frame in a card's queue.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) not_before_ns: i64,
    pub(super) instant_ns: Option<i64>,
    pub(super) mcs: u8,
    pub(super) retries: u8,
    pub(super) bytes: FrameBytes,
}

/// Frames that a monitor interface holds until they are fetched; the kernel's default holds about as many.
const PASSED: usize = 256;

impl Node {
    /// Passes a frame to the robot's monitor interface, if it is taken.
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
