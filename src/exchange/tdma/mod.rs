//! The round-robin TDMA scheduler: who sounds whom, when, and who answers. Sans-IO.
//!
//! A robot that wants bearings sounds its peers in turn: in every slot it sends a forward frame to one peer, which
//! answers at once with a backward frame of the same number. Both cards measure, and the carrier offset cancels in the
//! product of both measurements. A round is one exchange with every peer; after one or more rounds the turn goes to the
//! next robot that wants it.
//!
//! * [`Plan`] divides time into slots, and refuses a rate that does not fit with the highest that does.
//! * [`Tdma`] is one robot's state machine, with its contract. The live card's thread and the simulated air drive the
//!   same one.
//! * [`Dialect`] chooses between the frames of the WSR toolbox and the native ones of this project.
//!
//! ```
//! use csi5300::exchange::tdma::{Config, Epoch, Plan, PlanError, Request, Tdma};
//! use csi5300::driver_iface::Mac;
//! use csi5300::time::Instant;
//!
//! // Twelve peers at 100 rounds per second fit, 32 do not; the error says what would.
//! let plan = Plan::new(&Request::new(12, 100.0))?;
//! assert!(plan.slot_us > f64::from(plan.shortest_slot_us));
//! assert!(matches!(Plan::new(&Request::new(32, 100.0)), Err(PlanError::Rate { highest_hz, .. }) if highest_hz > 40.0));
//!
//! // Two robots on one air, without loss. The first initiates, the second answers.
//! let (a, b) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
//! let request = Request::new(1, 100.0);
//! let mut first = Tdma::new(&Config { initiate: true, ..Config::new(a, 0, &[b], request, 1) })?;
//! let mut second = Tdma::new(&Config::new(b, 0, &[a], request, 1))?;
//! let mut now = Instant::ZERO;
//! while first.counts().answered < 3 {
//!     now = now.max(first.poll_timeout().unwrap_or(now));
//!     let heard = first.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!     if let Some(frame) = heard {
//!         second.handle_heard(now, now, &frame);
//!         let answer = second.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!         first.handle_heard(now, now, &answer.unwrap_or_default());
//!     }
//! }
//! # Ok::<(), PlanError>(())
//! ```

pub(crate) mod auth;
mod machine;
pub(crate) mod roster;

use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::native::{self, Measurement};
use driver_iface::sounding::wsr;

pub use auth::Key;
pub(crate) use auth::{Proof, Prover};
pub use machine::{Epoch, Tdma, Transmit};

/// Something that the driver should know. Events are queued; see [`Tdma::poll_event`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A forward frame of this robot was answered: both cards have measured number `number` of this session.
    Answered {
        /// The responder.
        peer: Mac,
        /// The frame number that both frames carry.
        number: u32,
        /// The responder's session: another one than before means that it was restarted. 0 in the WSR dialect.
        peer_session: u32,
        /// What the responder measured, of this frame or an earlier one (see [`Measurement::number`]).
        measurement: Option<Measurement>,
    },
    /// A forward frame of this robot was not answered in time.
    Unanswered {
        /// The robot that should have answered.
        peer: Mac,
        /// The number of the forward frame.
        number: u32,
    },
    /// This robot heard a forward frame for itself; its answer is due at once.
    Asked {
        /// The initiator.
        peer: Mac,
        /// Its frame number.
        number: u32,
        /// Its session: numbers of different sessions do not belong together. 0 in the WSR dialect.
        session: u32,
    },
    /// Slots of this robot's turn were skipped, as the driver came later than the guard.
    Missed {
        /// How many in a row.
        slots: u32,
        /// From the start of the first of them to the driver's call.
        late: Span,
        /// From the start of one to that of the next.
        slot: Span,
    },
    /// A robot was heard for the first time, or again after it was absent.
    Joined(Mac),
    /// A robot has not answered 64 times in a row; it is asked less often from now on, and not given the turn.
    Absent(Mac),
    /// A robot restarted: its numbers restart in another session.
    Restarted {
        /// The robot.
        peer: Mac,
        /// Its new session.
        session: u32,
    },
    /// This robot initiates from now on. A renewed turn is no new event.
    TurnBegan {
        /// Number of the turn.
        turn: u32,
        /// How it got the turn.
        cause: Cause,
    },
    /// This robot's turn is over.
    TurnEnded {
        /// Number of the turn.
        turn: u32,
        /// Who is next, if the turn was passed on.
        next: Option<Mac>,
    },
    /// Another robot initiates at the same time and takes precedence: this robot's turn is over.
    Yielded {
        /// The robot that continues.
        to: Mac,
        /// Number of its turn.
        turn: u32,
    },
}

/// How a robot got the turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The last initiator passed it on.
    Passed,
    /// This robot passed it on, but nobody took it up.
    TakenBack,
    /// Nobody was heard for long.
    Claimed,
}

/// Everything that was counted since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct TdmaCounts {
    /// Forward frames handed to the driver, and not reported as not sent.
    pub forward: u64,
    /// Of these, answered.
    pub answered: u64,
    /// Of these, not answered in time.
    pub unanswered: u64,
    /// Slots in which a forward frame was due but the driver came later than the guard: skipped, not sent late. All slots of a
    /// turn that it slept through are among them.
    pub missed_slots: u64,
    /// Answers handed to the driver, and not reported as not sent.
    pub replies: u64,
    /// Answers that would have begun too late: skipped.
    pub missed_replies: u64,
    /// Turns begun.
    pub turns: u64,
    /// Turns given up to a rival.
    pub yields: u64,
    /// Turns lost because the driver was late.
    pub overslept: u64,
    /// Frames given to [`Tdma::handle_heard`].
    pub heard: u64,
    /// Of these: not sounding frames, of another dialect or version, or damaged.
    pub foreign: u64,
    /// From robots that are not in the list.
    pub strangers: u64,
    /// Copies of this robot's own frames.
    pub own_echoes: u64,
    /// Without a tag, or with a wrong one.
    pub unauthenticated: u64,
    /// With a key: measurements that were not sent, because the card reported two frames of their number.
    pub contested: u64,
    /// Forward frames heard before, or of an old session.
    pub replayed: u64,
    /// Backward frames for this robot that answer nothing (late, replayed, forged).
    pub unmatched: u64,
    /// Frames of another plan (round length or slots): answered, but ignored for turn and epoch.
    pub other_plan: u64,
    /// Frames that contradict an earlier initiator or turn.
    pub rivals: u64,
    /// Frames that contradict the epoch.
    pub off_epoch: u64,
    /// Events dropped because the driver did not fetch them; the oldest go first.
    pub events_lost: u64,
    /// Calls with a time before an earlier call's; they take the earlier time.
    pub time_ran_back: u64,
}

/// Counts of one link, this robot initiating.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LinkCounts {
    /// Forward frames sent.
    pub sounded: u64,
    /// Of these, answered.
    pub answered: u64,
}

/// A robot of the exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Robot {
    /// Its own MAC, addr3 of its frames.
    pub mac: Mac,
    /// WSR dialect: forward frames to it are `first_len + 2 * index` long (its driver's `ack_len`). Otherwise unused.
    #[doc(alias = "ack_len")]
    pub index: u16,
}

/// What a scheduler is made from: robots and request are the same on every robot, the rest is its own.
#[derive(Clone, Debug)]
pub struct Config {
    /// This robot.
    pub own: Robot,
    /// All others, in any order.
    pub peers: Vec<Robot>,
    /// MACs of the peers that this robot sounds, in order of their slots; `None` for all, in order of `peers`.
    pub links: Option<Vec<Mac>>,
    /// Rate, frames and timing; `links` of the request are the slots of a round, at least as many as any robot's
    /// links. The same on every robot.
    pub request: Request,
    /// This robot wants the turn; otherwise it only answers ([`Tdma`] can change it).
    pub initiate: bool,
    /// This robot answers forward frames. False if the WSR kernel driver does it.
    pub respond: bool,
    /// The card measures answers, but they need not reach this scheduler, as with WSR's sender: links are sounded in
    /// every round, and no slot is skipped to listen.
    pub open_loop: bool,
    /// Number of this start: larger after every restart (wrapping), such as seconds since 1970. In the native dialect
    /// frame numbers are counted within it; with a key, robots ignore frames of an older session.
    pub session: u32,
    /// With a key: robots that were heard before this start, with their newest session and number: frames of an older
    /// session, or of this session up to this number, are ignored.
    pub heard: Vec<(Mac, u32, u32)>,
    /// Shared key; needs [`Dialect::Native`] with `authenticated`.
    pub key: Option<Key>,
    /// Where slot 0 is. The WSR dialect has no slot numbers, so there a heard epoch stays this robot's own.
    pub epoch: Epoch,
    /// When this robot is switched on, on its own clock. Before the first claim it listens for a while.
    pub start: Instant,
    /// Silence, in slots, after which the last initiator counts as gone. A turn that was passed on is taken back after
    /// one such silence, a lost one is claimed after two. At 60 % loss a robot that sounds in every slot is silent for
    /// 64 slots once in 10^14.
    pub silence_slots: u32,
    /// How long to wait for an answer, microseconds, at least a slot; the host may delay reception. A shorter time
    /// leaves a stranger less time to replay a lost answer, which no tag can prevent.
    pub patience_us: u32,
}

impl Config {
    /// A robot that only answers, with the epoch of the frames that it hears.
    ///
    /// Peers are given by MAC and get indices in their order; `own_index` is this robot's in the WSR dialect.
    #[must_use]
    pub fn new(own: Mac, own_index: u16, peers: &[Mac], request: Request, session: u32) -> Self {
        let peers = peers.iter().zip(0..).map(|(&mac, index)| Robot { mac, index }).collect();
        Self {
            own: Robot { mac: own, index: own_index },
            peers,
            links: None,
            request,
            initiate: false,
            respond: true,
            open_loop: false,
            session,
            heard: Vec::new(),
            key: None,
            epoch: Epoch::Heard(Instant::ZERO),
            start: Instant::ZERO,
            silence_slots: 64,
            patience_us: 10_000,
        }
    }

    /// The MACs this robot sounds.
    fn link_macs(&self) -> Vec<Mac> {
        self.links.clone().unwrap_or_else(|| self.peer_macs())
    }

    /// MACs of all other robots.
    fn peer_macs(&self) -> Vec<Mac> {
        self.peers.iter().map(|peer| peer.mac).collect()
    }

    /// Checks the robots and the key against the plan.
    fn check(&self, plan: &Plan) -> Result<(), PlanError> {
        let links = self.link_macs();
        if links.len() > usize::from(plan.slots) {
            return Err(PlanError::Links(links.len()));
        }
        if self.peers.len() >= MAX_ROBOTS {
            return Err(PlanError::Links(self.peers.len()));
        }
        for (position, mac) in links.iter().enumerate() {
            if !self.peers.iter().any(|peer| peer.mac == *mac) {
                return Err(PlanError::UnknownPeer(*mac));
            }
            if links.iter().skip(position + 1).any(|other| other == mac) {
                return Err(PlanError::Twice(*mac));
            }
        }
        self.check_robots(plan)?;
        let authenticated = matches!(plan.request.dialect, Dialect::Native { authenticated: true, .. });
        if authenticated != self.key.is_some() { Err(PlanError::Key) } else { Ok(()) }
    }

    fn check_robots(&self, plan: &Plan) -> Result<(), PlanError> {
        let by_length = matches!(plan.request.dialect, Dialect::Wsr { .. });
        for (position, robot) in self.peers.iter().enumerate() {
            let later = self.peers.iter().skip(position + 1);
            if later.chain([&self.own]).any(|other| other.mac == robot.mac) {
                return Err(PlanError::Twice(robot.mac));
            }
            let mut later = self.peers.iter().skip(position + 1);
            if by_length && later.any(|other| other.index == robot.index) {
                return Err(PlanError::Twice(robot.mac));
            }
            if by_length && robot.index > plan.slots {
                return Err(PlanError::Index { index: robot.index, links: plan.slots });
            }
        }
        Ok(())
    }
}

/// Longest time from the end of a forward frame to the start of its answer, microseconds: the WSR driver answers
/// within 145 to 322 us, median 225 (892 second frames in WSR's `test_count_rx_5.dat`, rise to rise).
const TURN_AROUND_US: u32 = 322;
/// Default guard, microseconds: how late a frame may start, and again how far clocks may be apart.
const GUARD_US: u32 = 50;
/// Most robots in one exchange, this one included.
const MAX_ROBOTS: usize = 256;
/// Default length of a turn, slots: every frame of it names the next initiator, which at 60 % loss misses all of them
/// once in 10^7 turns.
const TURN_SLOTS: u16 = 32;
/// Longest turn, slots (before it is rounded up to whole rounds).
const MAX_TURN_SLOTS: u16 = 60_000;

/// The request for a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Links that an initiator sounds in one round; every robot of an exchange asks for the same number.
    pub links: u16,
    /// Rounds per second while a robot has the turn. A round is one forward and one backward frame on every link.
    pub rate_hz: f64,
    /// Modulation.
    pub phy: Phy,
    /// Frame dialect.
    pub dialect: Dialect,
    /// Longest time from the end of a forward frame to the start of its answer, microseconds.
    pub turn_around_us: u32,
    /// How late a forward frame may start, microseconds; the same time is kept free between slots.
    pub guard_us: u32,
    /// Slots of a turn, rounded up to whole rounds. Short turns interleave the robots' samples more finely, but if the
    /// next robot hears nothing of a turn, a silence follows.
    pub turn_slots: u16,
}

impl Default for Request {
    /// One link, sounded 100 times a second; otherwise as [`Request::new`].
    fn default() -> Self {
        Self::new(1, 100.0)
    }
}

impl Request {
    /// A request with the native dialect (measurements, no tag), MCS 1 and the default guard and turn-around.
    #[must_use]
    pub fn new(links: u16, rate_hz: f64) -> Self {
        Self {
            links,
            rate_hz,
            phy: Phy::default(),
            dialect: Dialect::Native { measurement: true, authenticated: false },
            turn_around_us: TURN_AROUND_US,
            guard_us: GUARD_US,
            turn_slots: TURN_SLOTS,
        }
    }
}

/// Why there is no plan, or no scheduler for it.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The rounds do not fit.
    #[error(
        "{asked_hz} rounds/s of {links} links do not fit: a slot takes {slot_us} us; at most {highest_hz:.3} rounds/s do"
    )]
    Rate {
        /// Requested rate.
        asked_hz: f64,
        /// Links in a round.
        links: u16,
        /// Shortest slot.
        slot_us: u32,
        /// Highest rate that fits; asking for it gives a plan.
        highest_hz: f64,
    },
    /// A rate that is not positive and finite, or slower than one round in 1,000 s.
    #[error("{0} rounds/s is no rate; give one from 0.001 up")]
    NotARate(f64),
    /// No link, or more than robots are allowed.
    #[error("{0} links in a round; 1 to {max} are possible", max = MAX_ROBOTS - 1)]
    Links(usize),
    /// A turn without slots, or one too long to be announced.
    #[error("turns of {0} slots; 1 to {max} are possible", max = MAX_TURN_SLOTS)]
    TurnSlots(u16),
    /// An MCS index that is not planned for.
    #[error("MCS {0}; 0 to {max} are possible", max = Phy::MAX_MCS)]
    Mcs(u8),
    /// A WSR length at which a responder would take a forward frame for an answer.
    #[error("first length {0}; odd and at least {min} is needed, WSR's own is 57", min = wsr::MIN_FORWARD_LEN)]
    FirstLen(u16),
    /// The same MAC (or, in the WSR dialect, the same index) twice.
    #[error("{0} is in the list of robots twice, or (WSR frames) another one has its number")]
    Twice(Mac),
    /// A WSR index whose frames are longer than the plan allows for.
    #[error("index {index} is beyond the {links} links that the slot length was planned for; number robots from 0")]
    Index {
        /// The index.
        index: u16,
        /// Links in a round.
        links: u16,
    },
    /// A link to a robot that is not among the peers.
    #[error("{0} is to be sounded but is not among the peers")]
    UnknownPeer(Mac),
    /// A key without tags in the dialect, or tags without a key.
    #[error("a key is given and frames have no tag, or the other way round; WSR frames have none")]
    Key,
}

/// The division of time; the same on every robot of an exchange.
///
/// Slot `n` starts at `epoch + n * round / slots`, so deadlines never drift. Within a slot the forward frame starts at
/// most one guard late, the answer at most one turn-around after its end, and one guard remains for clock differences.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Plan {
    /// Slots of a round, one per link.
    pub slots: u16,
    /// Modulation.
    pub phy: Phy,
    /// Rounds per second.
    pub rate_hz: f64,
    /// Mean length of a slot, microseconds.
    pub slot_us: f64,
    /// The shortest slot that holds an exchange, microseconds: guard, forward frame, turn-around, backward frame, guard.
    pub shortest_slot_us: u32,
    /// Slots of one turn: whole rounds, at least as many as requested.
    pub turn_slots: u32,
    /// Length of a round, microseconds.
    round_us: u32,
    /// Airtime of the longest forward frame, microseconds.
    forward_us: u32,
    request: Request,
}

impl Plan {
    /// Plans rounds.
    ///
    /// # Errors
    /// [`PlanError::Rate`] with the highest feasible rate if the rounds do not fit; others for a request that makes
    /// no sense.
    pub fn new(request: &Request) -> Result<Self, PlanError> {
        let Request { links, rate_hz, phy, dialect, turn_slots, turn_around_us, guard_us, .. } = *request;
        if links == 0 || usize::from(links) >= MAX_ROBOTS {
            return Err(PlanError::Links(usize::from(links)));
        }
        if turn_slots == 0 || turn_slots > MAX_TURN_SLOTS {
            return Err(PlanError::TurnSlots(turn_slots));
        }
        if phy.mcs > Phy::MAX_MCS {
            return Err(PlanError::Mcs(phy.mcs));
        }
        if let Dialect::Wsr { first_len } = dialect
            && (first_len % 2 == 0 || usize::from(first_len) < wsr::MIN_FORWARD_LEN || first_len > 1_000)
        {
            return Err(PlanError::FirstLen(first_len));
        }
        if !rate_hz.is_finite() || rate_hz < 1e-3 {
            return Err(PlanError::NotARate(rate_hz));
        }
        let (forward_len, backward_len) = dialect.longest(usize::from(links));
        let (forward_us, backward_us) = (phy.airtime_us(forward_len), phy.airtime_us(backward_len));
        let round_us = (1e6 / rate_hz).round() as u32;
        let guards_us = guard_us.saturating_mul(2);
        let slot_us = [turn_around_us, backward_us, guards_us].into_iter().fold(forward_us, u32::saturating_add);
        if u64::from(round_us) < u64::from(slot_us) * u64::from(links) {
            let highest_hz = 1e6 / (f64::from(slot_us) * f64::from(links));
            return Err(PlanError::Rate { asked_hz: rate_hz, links, slot_us, highest_hz });
        }
        Ok(Self {
            slots: links,
            phy,
            rate_hz: 1e6 / f64::from(round_us),
            slot_us: f64::from(round_us) / f64::from(links),
            shortest_slot_us: slot_us,
            turn_slots: u32::from(turn_slots).next_multiple_of(links.into()),
            round_us,
            forward_us,
            request: *request,
        })
    }

    /// `slots` slots as a span, rounded down to the microsecond.
    #[must_use]
    pub fn span_of(&self, slots: u32) -> Span {
        Span::from_us(i64::from(self.round_us) * i64::from(slots) / i64::from(self.slots))
    }

    /// How late a forward frame may start.
    #[must_use]
    fn guard(&self) -> Span {
        Span::from_us(i64::from(self.request.guard_us))
    }

    /// How long after the end of a forward frame its answer may start.
    #[must_use]
    pub(crate) fn turn_around(&self) -> Span {
        Span::from_us(i64::from(self.request.turn_around_us))
    }

    /// Start of slot `n` after the epoch: `floor(n * round / slots)`, exact for every `n`.
    #[must_use]
    fn offset_of(&self, n: i64) -> Span {
        let slots = i64::from(self.slots);
        let (rounds, rest) = (n.div_euclid(slots), n.rem_euclid(slots));
        let round_us = i64::from(self.round_us);
        Span::from_us(rounds.saturating_mul(round_us).saturating_add(rest * round_us / slots))
    }

    /// The slot that contains the point `offset` after the epoch; the inverse of [`Plan::offset_of`].
    #[must_use]
    fn slot_at(&self, offset: Span) -> i64 {
        let (slots, round_us) = (i64::from(self.slots), i64::from(self.round_us));
        let (rounds, rest) = (offset.as_us().div_euclid(round_us), offset.as_us().rem_euclid(round_us));
        rounds * slots + ((rest + 1) * slots - 1) / round_us
    }
}

/// HT modulation of every frame: one of MCS 0 to 31, long guard interval, BCC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Phy {
    /// MCS index; `monitor_tx_rate` 0x4101 is MCS 1.
    pub mcs: u8,
    /// Channel width.
    pub bandwidth: Bandwidth,
}

impl Default for Phy {
    /// HT20 MCS 1, 13 Mb/s: what the csitool README sets (0x4101).
    fn default() -> Self {
        Self { mcs: 1, bandwidth: Bandwidth::Ht20 }
    }
}

impl Phy {
    /// Highest MCS with equal modulation on up to four streams (802.11-2016 clause 19.5).
    const MAX_MCS: u8 = 31;

    /// Data bits in one OFDM symbol of 4 us (802.11-2016 tables 19-27 to 19-34).
    #[must_use]
    fn bits_per_symbol(&self) -> u32 {
        const HT20: [u32; 8] = [26, 52, 78, 104, 156, 208, 234, 260];
        const HT40: [u32; 8] = [54, 108, 162, 216, 324, 432, 486, 540];
        let table = match self.bandwidth {
            Bandwidth::Ht20 => HT20,
            Bandwidth::Ht40 => HT40,
        };
        let one_stream = table.get(usize::from(self.mcs % 8)).copied().unwrap_or(26);
        one_stream * self.streams()
    }

    fn streams(&self) -> u32 {
        u32::from(self.mcs / 8 + 1)
    }

    /// Time on air of a frame of `len_with_fcs` bytes, microseconds: HT-mixed preamble (L-STF, L-LTF, L-SIG, HT-SIG,
    /// HT-STF, one HT-LTF per stream, four for three) and whole symbols of 4 us (802.11-2016 equation 19-90).
    #[must_use]
    pub fn airtime_us(&self, len_with_fcs: usize) -> u32 {
        let ltf = match self.streams() {
            3 => 4,
            streams => streams,
        };
        let preamble = 8 + 8 + 4 + 8 + 4 + 4 * ltf;
        let bits = 16 + 8 * len_with_fcs as u32 + 6;
        preamble + 4 * bits.div_ceil(self.bits_per_symbol())
    }
}

/// The format of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// As the WSR toolbox: the length of a frame addresses a robot.
    Wsr {
        /// On-air length (FCS included) of the forward frame to the robot of index 0; odd.
        first_len: u16,
    },
    /// The dialect of this project, see [`driver_iface::sounding::native`].
    Native {
        /// Leave room for a measurement in the backward frame.
        measurement: bool,
        /// Leave room for an authentication tag in every frame.
        authenticated: bool,
    },
}

impl Dialect {
    /// Longest forward and backward frames on air, FCS included, if robots' indices go up to `last_index`.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn longest(&self, last_index: usize) -> (usize, usize) {
        match *self {
            Self::Wsr { first_len } => {
                let forward = wsr::forward_len(usize::from(first_len), last_index);
                (forward, forward + wsr::REPLY_GROWTH)
            }
            Self::Native { measurement, authenticated } => {
                (native::len_with_fcs(false, authenticated), native::len_with_fcs(measurement, authenticated))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mac(last: u8) -> Mac {
        Mac([2, 0, 0, 0, 0, last])
    }

    /// What is wrong with robot 1 among 2, 3 and 4, changed so.
    fn fault(dialect: Dialect, change: impl FnOnce(&mut Config)) -> Option<PlanError> {
        let request = Request { dialect, ..Request::new(3, 10.0) };
        let mut config = Config::new(mac(1), 3, &[mac(2), mac(3), mac(4)], request, 1);
        change(&mut config);
        config.check(&Plan::new(&config.request).unwrap()).err()
    }

    const OPEN: Dialect = Dialect::Native { measurement: true, authenticated: false };
    const WSR: Dialect = Dialect::Wsr { first_len: 57 };

    #[test]
    fn robots_are_each_there_once_and_links_lead_to_them() {
        assert_eq!(fault(OPEN, |_| ()), None);
        let with =
            |links: &[u8]| fault(OPEN, |config| config.links = Some(links.iter().map(|last| mac(*last)).collect()));
        assert_eq!([with(&[]), with(&[4]), with(&[4, 2, 3])], [None, None, None]);
        assert_eq!(with(&[2, 9]), Some(PlanError::UnknownPeer(mac(9))));
        assert_eq!([with(&[3, 2, 3]), with(&[2, 3, 3])], [(); 2].map(|()| Some(PlanError::Twice(mac(3)))));
        assert_eq!(with(&[2, 3, 4, 2]), Some(PlanError::Links(4)));
        let robot = |last| Robot { mac: mac(last), index: 9 };
        assert_eq!(fault(OPEN, |config| config.peers.push(robot(1))), Some(PlanError::Links(4)));
        let of_peer = |last| {
            fault(OPEN, |config| {
                config.links = Some(vec![mac(2)]);
                config.peers.push(robot(last));
            })
        };
        assert_eq!(
            [of_peer(5), of_peer(1), of_peer(4)],
            [None, Some(PlanError::Twice(mac(1))), Some(PlanError::Twice(mac(4)))]
        );
    }

    #[test]
    fn there_are_at_most_255_peers() {
        let peers = |count: u16| {
            fault(OPEN, |config| {
                let peer = |index| Robot { mac: Mac([4, 0, 0, 0, (index >> 8) as u8, index as u8]), index };
                config.peers = (0..count).map(peer).collect();
                config.links = Some(Vec::new());
            })
        };
        assert_eq!([peers(255), peers(256)], [None, Some(PlanError::Links(256))]);
    }

    #[test]
    fn lengths_tell_wsr_robots_apart() {
        assert_eq!(fault(WSR, |_| ()), None);
        assert_eq!(fault(WSR, |config| config.peers[2].index = 0), Some(PlanError::Twice(mac(2))));
        assert_eq!(fault(OPEN, |config| config.peers[2].index = 0), None, "elsewhere they mean nothing");
        assert_eq!(fault(WSR, |config| config.peers[2].index = 3), None);
        assert_eq!(fault(WSR, |config| config.peers[2].index = 4), Some(PlanError::Index { index: 4, links: 3 }));
        assert_eq!(fault(OPEN, |config| config.peers[2].index = 4), None);
    }

    #[test]
    fn twelve_peers_at_100_rounds_fit_and_32_are_refused_with_a_rate_that_fits() {
        for dialect in [
            Dialect::Wsr { first_len: 57 },
            Dialect::Native { measurement: true, authenticated: false },
            Dialect::Native { measurement: true, authenticated: true },
        ] {
            let request = Request { dialect, ..Request::new(12, 100.0) };
            let plan = Plan::new(&request).unwrap();
            assert_eq!((plan.round_us, plan.slots, plan.rate_hz), (10_000, 12, 100.0));
            assert!((plan.slot_us - 833.333).abs() < 0.001);
            let (forward_len, _) = dialect.longest(12);
            assert_eq!(plan.forward_us, request.phy.airtime_us(forward_len));
            let Err(PlanError::Rate { highest_hz, slot_us, .. }) = Plan::new(&Request { links: 32, ..request }) else {
                panic!("32 links at 100 rounds/s must not fit");
            };
            assert!((40.0..60.0).contains(&highest_hz), "{highest_hz}");
            let plan = Plan::new(&Request { links: 32, rate_hz: highest_hz, ..request }).unwrap();
            assert_eq!(plan.round_us, slot_us * 32);
            assert!(Plan::new(&Request { links: 32, rate_hz: highest_hz * 1.001, ..request }).is_err());
        }
    }

    #[test]
    fn requests_without_sense_are_named() {
        let request = Request::new(1, 10.0);
        assert_eq!(Plan::new(&Request { links: 0, ..request }), Err(PlanError::Links(0)));
        assert_eq!(Plan::new(&Request { rate_hz: 0.0, ..request }), Err(PlanError::NotARate(0.0)));
        assert!(matches!(Plan::new(&Request { rate_hz: f64::NAN, ..request }), Err(PlanError::NotARate(_))));
        let wsr = |first_len| Plan::new(&Request { dialect: Dialect::Wsr { first_len }, ..request });
        assert_eq!(wsr(58), Err(PlanError::FirstLen(58)));
        assert_eq!(wsr(31), Err(PlanError::FirstLen(31)));
        assert_eq!(Plan::new(&Request { turn_slots: 0, ..request }), Err(PlanError::TurnSlots(0)));
        let phy = Phy { mcs: 32, ..Phy::default() };
        assert_eq!(Plan::new(&Request { phy, ..request }), Err(PlanError::Mcs(32)));
    }

    proptest! {
        #[test]
        fn slots_tile_time(links in 1u16..200, rate in 0.01f64..2.0, n in -1_000_000_000i64..1_000_000_000) {
            let plan = Plan::new(&Request::new(links, rate)).unwrap();
            let (start, end) = (plan.offset_of(n), plan.offset_of(n + 1));
            prop_assert!((end - start).as_us() >= i64::from(plan.shortest_slot_us));
            prop_assert_eq!(plan.slot_at(start), n);
            prop_assert_eq!(plan.slot_at(end - Span::from_us(1)), n);
        }
    }

    #[test]
    fn the_longest_frames_are_those_of_the_last_robot_and_of_both_additions() {
        let wsr = Dialect::Wsr { first_len: 57 };
        assert_eq!([wsr.longest(0), wsr.longest(3)], [(57, 57 + wsr::REPLY_GROWTH), (63, 63 + wsr::REPLY_GROWTH)]);
        for (measurement, authenticated) in [(false, false), (true, false), (false, true), (true, true)] {
            let (forward, backward) = Dialect::Native { measurement, authenticated }.longest(3);
            let tag = if authenticated { native::TAG_LEN } else { 0 };
            assert_eq!(forward, native::len_with_fcs(false, false) + tag);
            assert_eq!(backward, native::len_with_fcs(measurement, false) + tag);
        }
    }

    #[test]
    fn airtime_is_that_of_the_standard() {
        let ht20 = |mcs| Phy { mcs, bandwidth: Bandwidth::Ht20 };
        // 57 bytes: 478 bits; 19 symbols of 26, 10 of 52, 2 of 260.
        assert_eq!([0, 1, 7].map(|mcs| ht20(mcs).airtime_us(57)), [36 + 76, 36 + 40, 36 + 8]);
        assert_eq!(Phy { mcs: 0, bandwidth: Bandwidth::Ht40 }.airtime_us(57), 36 + 36);
        // Three streams: four HT-LTFs, 78 bits a symbol.
        assert_eq!(ht20(16).airtime_us(57), 48 + 28);
    }
}
