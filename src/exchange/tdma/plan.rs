//! What fits into a round: the airtime of frames, slot length, the highest rate.

use crate::time::Span;
use driver_iface::Mac;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::{native, wsr};

/// Longest time from the end of a forward frame to the start of its answer, microseconds: the WSR driver answers
/// within 145 to 322 us, median 225 (892 second frames in WSR's `test_count_rx_5.dat`, rise to rise).
const TURN_AROUND_US: u32 = 322;
/// Default guard, microseconds: how late a frame may start, and again how far clocks may be apart.
const GUARD_US: u32 = 50;
/// Most robots in one exchange, this one included.
pub(super) const MAX_ROBOTS: usize = 256;
/// Default length of a turn, slots: every frame of it names the next initiator, which at 60 % loss misses all of them
/// once in 10^7 turns.
const TURN_SLOTS: u16 = 32;
/// Longest turn, slots (before it is rounded up to whole rounds).
const MAX_TURN_SLOTS: u16 = 60_000;

/// The request for a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
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

    /// Rounds per second.
    #[must_use]
    pub const fn with_rate_hz(mut self, rate_hz: f64) -> Self {
        self.rate_hz = rate_hz;
        self
    }

    /// Modulation.
    #[must_use]
    pub const fn with_phy(mut self, phy: Phy) -> Self {
        self.phy = phy;
        self
    }

    /// Frame dialect.
    #[must_use]
    pub const fn with_dialect(mut self, dialect: Dialect) -> Self {
        self.dialect = dialect;
        self
    }

    /// Longest time from the end of a forward frame to the start of its answer, microseconds.
    #[must_use]
    pub const fn with_turn_around_us(mut self, turn_around_us: u32) -> Self {
        self.turn_around_us = turn_around_us;
        self
    }

    /// How late a forward frame may start, microseconds.
    #[must_use]
    pub const fn with_guard_us(mut self, guard_us: u32) -> Self {
        self.guard_us = guard_us;
        self
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Plan {
    /// Slots of a round, one per link.
    pub slots: u16,
    /// Modulation.
    pub phy: Phy,
    /// Length of a round, microseconds.
    pub(super) round_us: u32,
    /// Airtime of the longest forward frame, microseconds.
    pub(super) forward_us: u32,
    backward_us: u32,
    turn_around_us: u32,
    guard_us: u32,
    turn_slots: u16,
    pub(super) dialect: Dialect,
}

impl Plan {
    /// Plans rounds.
    ///
    /// # Errors
    /// [`PlanError::Rate`] with the highest feasible rate if the rounds do not fit; others for a request that makes
    /// no sense.
    pub fn new(request: &Request) -> Result<Self, PlanError> {
        let Request { links, rate_hz, phy, dialect, turn_around_us, guard_us, turn_slots } = *request;
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
        let plan = Self {
            round_us,
            slots: links,
            forward_us,
            backward_us,
            turn_around_us,
            guard_us,
            turn_slots,
            phy,
            dialect,
        };
        let slot_us = plan.shortest_slot_us();
        if u64::from(round_us) < u64::from(slot_us) * u64::from(links) {
            let highest_hz = 1e6 / (f64::from(slot_us) * f64::from(links));
            return Err(PlanError::Rate { asked_hz: rate_hz, links, slot_us, highest_hz });
        }
        Ok(plan)
    }

    /// The shortest slot that holds an exchange: guard, forward frame, turn-around, backward frame, guard.
    #[must_use]
    pub fn shortest_slot_us(&self) -> u32 {
        let [forward, turn_around, backward, guard] =
            [self.forward_us, self.turn_around_us, self.backward_us, self.guard_us];
        forward.saturating_add(turn_around).saturating_add(backward).saturating_add(guard.saturating_mul(2))
    }

    /// Rounds per second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        1e6 / f64::from(self.round_us)
    }

    /// Mean length of a slot, microseconds.
    #[must_use]
    pub fn slot_us(&self) -> f64 {
        f64::from(self.round_us) / f64::from(self.slots)
    }

    /// `slots` slots as a span, rounded down to the microsecond.
    #[must_use]
    pub fn span_of(&self, slots: u32) -> Span {
        Span::from_us(i64::from(self.round_us) * i64::from(slots) / i64::from(self.slots))
    }

    /// Slots of one turn: whole rounds, at least as many as requested.
    #[must_use]
    pub(super) fn turn_slots(&self) -> u32 {
        u32::from(self.turn_slots).next_multiple_of(u32::from(self.slots))
    }

    /// Time in which each of `initiators` robots has the turn once, microseconds, if no turn is lost.
    #[must_use]
    pub fn cycle_us(&self, initiators: u32) -> u64 {
        u64::from(initiators) * u64::from(self.turn_slots()) * u64::from(self.round_us) / u64::from(self.slots)
    }

    /// How late a forward frame may start.
    #[must_use]
    pub(super) fn guard(&self) -> Span {
        Span::from_us(i64::from(self.guard_us))
    }

    /// How long after the end of a forward frame its answer may start.
    #[must_use]
    pub(crate) fn turn_around(&self) -> Span {
        Span::from_us(i64::from(self.turn_around_us))
    }

    /// Start of slot `n` after the epoch: `floor(n * round / slots)`, exact for every `n`.
    #[must_use]
    pub(super) fn offset_of(&self, n: i64) -> Span {
        let slots = i64::from(self.slots);
        let (rounds, rest) = (n.div_euclid(slots), n.rem_euclid(slots));
        let round_us = i64::from(self.round_us);
        Span::from_us(rounds.saturating_mul(round_us).saturating_add(rest * round_us / slots))
    }

    /// The slot that contains the point `offset` after the epoch; the inverse of [`Plan::offset_of`].
    #[must_use]
    pub(super) fn slot_at(&self, offset: Span) -> i64 {
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

    #[test]
    fn twelve_peers_at_100_rounds_fit_and_32_are_refused_with_a_rate_that_fits() {
        for dialect in [
            Dialect::Wsr { first_len: 57 },
            Dialect::Native { measurement: true, authenticated: false },
            Dialect::Native { measurement: true, authenticated: true },
        ] {
            let request = Request { dialect, ..Request::new(12, 100.0) };
            let plan = Plan::new(&request).unwrap();
            assert_eq!((plan.round_us, plan.slots, plan.rate_hz()), (10_000, 12, 100.0));
            assert!((plan.slot_us() - 833.333).abs() < 0.001);
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
            prop_assert!((end - start).as_us() >= i64::from(plan.shortest_slot_us()));
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
