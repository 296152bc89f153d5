//! The cards' records for the claims: collected, and paired by exchange into forward and backward frames.

use crate::claims::CLAIMS;
use crate::report::Report;
use crate::stats::line;
use csi5300::exchange::pairing::LinkSide;
use csi5300::internal::{ByClock, Refusal};
use csi5300::motion::pose::Trajectory;
use csi5300::signal::cfo::{TurnAround, at_centre, round_trip_at_centre};
use csi5300::signal::channel::Channel;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Injector, Next, Stamps};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Antennas, Iq, MAX_SAMPLES, Repr, SUBCARRIERS};
use driver_iface::record::code;
use driver_iface::sounding::wsr::{self, Lfsr};
use num_complex::{Complex32, Complex64};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Limit of a card's records for the claims: an hour at 100 a second. Later ones are counted and logged.
const RECORDS: usize = 360_000;

/// What is known of the desk.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The channel that both cards are tuned to.
    pub channel: Channel,
    /// Addresses of the first and the second robot, if known; else the most frequent senders.
    pub macs: Option<[Mac; 2]>,
    /// Neither robot moves.
    pub at_rest: bool,
    /// The first robot's motion and the true direction to the second.
    pub truth: Option<Truth>,
}

/// The truth about the link.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The first robot's motion, on its host's clock.
    pub trajectory: Trajectory,
    /// Direction from the first robot to the second in the trajectory's frame, radians from +x towards +y.
    pub azimuth_rad: f64,
}

impl Plan {
    /// A desk with only a known channel.
    #[must_use]
    pub fn new(channel: Channel) -> Self {
        Self { channel, macs: None, at_rest: false, truth: None }
    }
}

/// Which of the two cards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The first robot's.
    Near,
    /// The second robot's.
    Far,
}

/// One received record.
#[derive(Clone, Debug, PartialEq)]
pub struct HeardRecord {
    /// Host time, microseconds since the Unix epoch, where it is known.
    pub host_us: Option<i64>,
    /// The card's clock, microseconds, its wraps taken out.
    pub card_us: i64,
    /// The sender; zero where it is not known.
    pub mac: Mac,
    /// The frame's number, where it is known.
    pub number: Option<u32>,
    /// All header fields.
    pub head: Repr,
    /// Coefficients, `[subcarrier][chain][stream]`.
    pub csi: Box<[Iq]>,
}

/// The data of one card.
#[derive(Debug, Default)]
pub struct Heard {
    /// Its records with CSI, in order.
    pub records: Vec<HeardRecord>,
    /// All counts.
    pub survey: Survey,
    /// The bytes of a `.dat` file with the same records.
    pub log: Vec<u8>,
    /// When the host received each record of the log, microseconds since the Unix epoch, as a side file has it.
    pub times: Vec<Option<i64>>,
    /// The records come from a log, not from a card.
    pub recorded: bool,
    /// The end of each record in the log, bytes from its start.
    pub(crate) ends: Vec<usize>,
}

impl Heard {
    /// True if the records were made from another card's log, as [`csi5300::source::other_card`] does.
    pub(crate) fn is_of_another_card(&self) -> bool {
        self.survey.by_code.contains_key(&code::CARD_CLOCK)
    }

    fn note(&mut self, next: &Next<'_>) {
        if let Next::Record(stamps, record) = next
            && csi5300::source::append(*record, &mut self.log)
        {
            self.times.push(stamps.host_us);
        }
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        self.ends.push(self.log.len());
        if self.records.len() == RECORDS {
            return;
        }
        let mut csi = [Iq::default(); MAX_SAMPLES];
        let samples = bfee.unpack(&mut csi).unwrap_or(0);
        self.records.push(HeardRecord {
            host_us: identity.host_us,
            card_us: self.survey.clock_us.map_or(0, |(_, last)| last),
            mac: identity.mac,
            number: identity.frame_count,
            head: Repr::parse(&bfee),
            csi: csi.get(..samples).unwrap_or(&[]).into(),
        });
    }

    /// All records of a log.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn of(log: &mut impl CsiSource) -> Result<Self, Error> {
        let mut heard = Self { recorded: true, ..Self::default() };
        loop {
            let next = log.receive(Instant::ZERO)?;
            let end = matches!(next, Next::End(_));
            heard.note(&next);
            if end {
                return Ok(heard);
            }
        }
    }

    /// All records of a log's bytes, which have no side file.
    #[must_use]
    pub fn of_log(bytes: &[u8]) -> Self {
        Self::of(&mut Replay::new(bytes, "log".into())).unwrap_or_default()
    }

    /// Its records again, with their host times.
    pub(crate) fn again(&self) -> impl CsiSource + '_ {
        Again { log: Replay::new(self.log.as_slice(), "log".into()), times: self.times.iter() }
    }
}

/// A card's log and the host times beside it.
struct Again<'a> {
    log: Replay<&'a [u8]>,
    times: std::slice::Iter<'a, Option<i64>>,
}

impl CsiSource for Again<'_> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        Ok(match self.log.receive(now)? {
            Next::Record(stamps, record) => {
                Next::Record(Stamps { host_us: self.times.next().copied().flatten(), ..stamps }, record)
            }
            next => next,
        })
    }

    fn next_at(&self) -> Option<Instant> {
        self.log.next_at()
    }
}

/// A person's action on a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// Tuned it to another channel and back.
    Retuned,
    /// Reloaded its driver.
    Reloaded,
}

/// The cards' data after that, at the same places.
#[derive(Debug)]
pub struct After {
    /// The action.
    pub done: Done,
    /// What the first robot's card gave.
    pub near: Heard,
    /// The second robot's data, if there is a log.
    pub far: Option<Heard>,
}

/// The sending interface's own reports.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Interface {
    /// Frames that the driver reported as sent.
    pub confirmed: Option<u64>,
    /// Of these, frames that the driver reported as sent more than once.
    pub retried: u64,
    /// The channel's regulatory flags, in parentheses in `iw phy`; empty without restrictions.
    pub channel_flags: Option<String>,
}

/// A frame that was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sent {
    /// Its number.
    pub number: u32,
    /// Frames a second at that time.
    pub rate_hz: f64,
    /// The injector took it.
    pub taken: bool,
}

/// Frames a second at which the suite sends, and how many frames at each: 16.4 s in all.
const RATES: [(f64, usize); 4] = [(20.0, 200), (50.0, 200), (200.0, 400), (1_000.0, 400)];

/// What the first robot sends: frames of the WSR dialect at 20, 50, 200 and 1,000 a second.
pub struct Sending {
    sender: Mac,
    left: Vec<f64>,
    next_at: Instant,
    filler: Lfsr,
    number: u32,
}

impl Sending {
    /// Frames of this sender, the first one 0.1 s after `begin`, when the radio has settled.
    #[must_use]
    pub fn new(sender: Mac, begin: Instant) -> Self {
        let left = RATES.iter().rev().flat_map(|(rate_hz, count)| std::iter::repeat_n(*rate_hz, *count)).collect();
        Self { sender, left, next_at: begin + Span::from_ms(100), filler: Lfsr::default(), number: 0 }
    }

    /// How long all of it takes.
    #[must_use]
    pub fn takes() -> Span {
        Span::from_s(RATES.iter().map(|(rate_hz, count)| *count as f64 / rate_hz).sum())
    }

    /// Bytes of a frame, without its check sequence.
    #[must_use]
    pub fn frame_len() -> usize {
        wsr::Repr { sender: Mac::ZERO, number: 0, len_with_fcs: wsr::DEFAULT_LEN }.mpdu_len()
    }

    /// When the next frame is due; `None` after the last one.
    #[must_use]
    pub fn next_at(&self) -> Option<Instant> {
        (!self.left.is_empty()).then_some(self.next_at)
    }

    /// Sends the next frame if it is due, and returns it.
    pub fn send(&mut self, now: Instant, injector: &mut dyn Injector) -> Option<Sent> {
        if now < self.next_at {
            return None;
        }
        let rate_hz = self.left.pop()?;
        self.number += 1;
        let repr = wsr::Repr { sender: self.sender, number: self.number, len_with_fcs: wsr::DEFAULT_LEN };
        let mut frame = vec![0; repr.mpdu_len()];
        let taken = repr.emit(&mut frame, &mut self.filler).is_some() && injector.inject(now, &frame).is_ok();
        self.next_at = now.max(self.next_at) + Span::from_s(1.0 / rate_hz);
        Some(Sent { number: self.number, rate_hz, taken })
    }
}

/// The evidence for the claims.
#[derive(Debug)]
pub struct Evidence {
    /// What is known of the desk.
    pub plan: Plan,
    /// What the first robot's card gave.
    pub near: Heard,
    /// The second robot's data, if any.
    pub far: Option<Heard>,
    /// The frames that the first robot sent, if known.
    pub sent: Vec<Sent>,
    /// What the interface knows that sent them.
    pub interface: Interface,
    /// The cards' data after each retune and each reload.
    pub after: Vec<After>,
    /// The first robot's data with one antenna unplugged and no other. Live records go to the last entry.
    pub unplugged: Vec<(Antenna, Heard)>,
    /// How late the host woke, microseconds.
    pub lateness_us: Vec<f64>,
    /// Growth of each counter of the kernel module; empty without the module.
    pub counters: BTreeMap<String, u64>,
    pub(crate) pairs: Option<Pairs>,
}

impl Evidence {
    /// No evidence yet.
    #[must_use]
    pub fn new(plan: Plan) -> Self {
        Self {
            plan,
            near: Heard::default(),
            far: None,
            sent: Vec::new(),
            interface: Interface::default(),
            after: Vec::new(),
            unplugged: Vec::new(),
            lateness_us: Vec::new(),
            counters: BTreeMap::new(),
            pairs: None,
        }
    }

    /// Takes an item of a card; of the first robot's for the last unplugged antenna, if there is one.
    pub fn heard(&mut self, side: Side, next: &Next<'_>) {
        match side {
            Side::Near => self.unplugged.last_mut().map_or(&mut self.near, |(_, heard)| heard).note(next),
            Side::Far => self.far.get_or_insert_default().note(next),
        }
    }

    /// Judges every claim.
    #[must_use]
    pub fn judge(&mut self) -> Report {
        self.pairs = self.far.as_ref().map(|far| Pairs::of(&self.near, far, &self.plan));
        Report::new(self, CLAIMS.iter().flat_map(|claim| claim.judge(self)).collect())
    }
}

/// Reads two cards to their ends in virtual time and judges every claim: for sources that end, like simulated cards and
/// logs.
///
/// # Errors
/// The error of a source. Losses are no error; a claim reports them.
pub fn run<'a>(near: &'a mut dyn CsiSource, far: Option<&'a mut dyn CsiSource>, plan: Plan) -> Result<Report, Error> {
    collect(near, far, None, plan).map(|mut evidence| evidence.judge())
}

/// The evidence that [`run`] judges.
///
/// # Errors
/// As [`run`].
pub fn collect<'a>(
    near: &'a mut dyn CsiSource,
    far: Option<&'a mut dyn CsiSource>,
    mut sending: Option<(Sending, &mut dyn Injector)>,
    plan: Plan,
) -> Result<Evidence, Error> {
    let mut evidence = Evidence::new(plan);
    let mut sources: Vec<(Side, &'a mut dyn CsiSource)> = vec![(Side::Near, near)];
    sources.extend(far.map(|far| (Side::Far, far)));
    let mut now = Instant::ZERO;
    while !sources.is_empty() {
        let mut next_at = None;
        if let Some((sending, injector)) = &mut sending {
            evidence.sent.extend(std::iter::from_fn(|| sending.send(now, *injector)));
            next_at = sending.next_at();
        }
        let mut open = Vec::new();
        for (side, source) in sources {
            let goes_on = loop {
                let next = source.receive(now)?;
                let (pending, end) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
                evidence.heard(side, &next);
                if pending || end {
                    break pending;
                }
            };
            if goes_on {
                let at = source.next_at().ok_or(Error::Endless)?;
                next_at = Some(next_at.map_or(at, |earlier| earlier.min(at)));
                open.push((side, source));
            }
        }
        sources = open;
        // Time moves on even if a source is due at once.
        now = next_at.map_or(now, |at| at.max(now + Span::from_us(1)));
    }
    Ok(evidence)
}

/// Exchanges of two cards: all frames that each heard of the other, paired by number, or by the cards' clocks without
/// numbers.
#[derive(Debug, Default)]
pub(crate) struct Pairs {
    /// Frames that each card heard of the other, each number once.
    pub frames: [usize; 2],
    /// Why frames without numbers could not be paired by the cards' clocks.
    pub refused: Option<Refusal>,
    /// The near robot sounds others too, so not all frames that the far card heard were for the far robot.
    pub among_others: bool,
    /// The near card's clock at each pair, microseconds.
    pub near_us: Vec<i64>,
    /// Far clock less near clock, microseconds.
    pub difference_us: Vec<i64>,
    /// Forward times backward at the channel centre, of antenna A.
    pub product: Vec<Complex64>,
    /// Forward times the conjugate of backward.
    pub ratio: Vec<Complex64>,
    /// One direction alone: the near card's CSI.
    pub one_way: Vec<Complex64>,
    /// Turn-around of each pair less the clocks' line, microseconds.
    pub turn_us: Vec<f64>,
    /// Drift of the far clock against the near one by that line, ppm, and its standard error.
    pub drift_ppm: Option<(f64, f64)>,
    /// The library's compensation of the product.
    pub compensation: Option<TurnAround>,
    /// The same of the ratio.
    pub ratio_compensation: Option<TurnAround>,
}

/// Antenna A's coefficients of the first stream; the first chain's if the record does not name A.
pub(crate) fn antenna_a(record: &HeardRecord) -> [Complex32; SUBCARRIERS] {
    column(record, antennas(record).and_then(|antennas| antennas.chain_of(Antenna::A)).unwrap_or(0))
}

/// The antennas of a record's chains, if it names them.
pub(crate) fn antennas(record: &HeardRecord) -> Option<Antennas> {
    Antennas::new(record.head.antenna_sel, record.head.n_rx, record.head.rssi).ok()
}

/// The coefficients of one chain, first stream.
pub(crate) fn column(record: &HeardRecord, chain: usize) -> [Complex32; SUBCARRIERS] {
    let (n_rx, n_tx) = (usize::from(record.head.n_rx), usize::from(record.head.n_tx));
    std::array::from_fn(|k| {
        let iq = record.csi.get((k * n_rx + chain) * n_tx).copied().unwrap_or_default();
        Complex32::new(f32::from(iq.i), f32::from(iq.q))
    })
}

/// Senders of records with or without numbers, and how many each has.
fn senders(heard: &Heard, numbered: bool) -> BTreeMap<Mac, usize> {
    let mut counts = BTreeMap::new();
    for record in heard.records.iter().filter(|record| record.number.is_some() == numbered) {
        *counts.entry(record.mac).or_default() += 1;
    }
    counts
}

/// The sender that most numbered records have.
pub(crate) fn usual_sender(heard: &Heard) -> Option<Mac> {
    senders(heard, true).into_iter().max_by_key(|(mac, count)| (*count, *mac)).map(|(mac, _)| mac)
}

/// The near card's record and the far card's of each exchange.
struct Partners<'a> {
    pairs: Vec<(&'a HeardRecord, &'a HeardRecord)>,
    frames: [usize; 2],
    refused: Option<Refusal>,
}

fn by_number<'a>(near: &'a Heard, far: &'a Heard, [of_near, of_far]: [Mac; 2]) -> Partners<'a> {
    // A repeated number identifies no exchange.
    let mut heard_by_far: HashMap<u32, Option<&HeardRecord>> = HashMap::new();
    for record in far.records.iter().filter(|record| record.mac == of_near) {
        if let Some(number) = record.number {
            heard_by_far.entry(number).and_modify(|twice| *twice = None).or_insert(Some(record));
        }
    }
    let (mut pairs, mut heard_by_near, mut last) = (Vec::new(), Vec::new(), None);
    for record in near.records.iter().filter(|record| record.mac == of_far && record.number.is_some()) {
        if record.number == last {
            continue;
        }
        last = record.number;
        heard_by_near.extend(record.number);
        let other = record.number.and_then(|number| heard_by_far.get(&number).copied().flatten());
        pairs.extend(other.map(|other| (record, other)));
    }
    // Exchanges with robots that are sounded as often need no partner, unless one number is that of an exchange with each.
    let elsewhere = |heard: &Heard, partner: Mac| -> HashSet<u32> {
        let counts = senders(heard, true);
        let as_often = |n: &usize| 4 * n >= 3 * pairs.len() && 3 * n <= 4 * pairs.len();
        let is_robot = |mac: &Mac| *mac != partner && counts.get(mac).is_some_and(as_often);
        let others = heard.records.iter().filter(|record| is_robot(&record.mac));
        let numbers: HashSet<u32> = others.filter_map(|record| record.number).collect();
        let is_there = |number: Option<u32>| number.is_some_and(|number| numbers.contains(&number));
        let shared = pairs.iter().filter(|(record, _)| is_there(record.number)).count();
        if 2 * shared > pairs.len() { HashSet::new() } else { numbers }
    };
    let (by_near, by_far) = (elsewhere(near, of_far), elsewhere(far, of_near));
    let frames = [
        heard_by_near.iter().filter(|number| !by_far.contains(number)).count(),
        heard_by_far.keys().filter(|number| !by_near.contains(number)).count(),
    ];
    Partners { pairs, frames, refused: None }
}

fn by_clock<'a>(near: &'a Heard, far: &'a Heard, [of_near, of_far]: [Mac; 2]) -> Partners<'a> {
    // Whole microseconds, without wraps.
    let mut machine = ByClock::new(64);
    for (side, heard, sender) in [(LinkSide::Receiver, near, of_far), (LinkSide::Transmitter, far, of_near)] {
        for record in heard.records.iter().filter(|record| record.mac == sender) {
            machine.handle(side, record.card_us.cast_unsigned(), record);
        }
    }
    let refused = machine.finish().err();
    let frames = machine.records();
    let pairs = std::iter::from_fn(|| machine.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)).collect();
    Partners { pairs, frames, refused }
}

impl Pairs {
    /// Pairs each frame that near heard of far with the frame of the same number that far heard of near. If one of them heard
    /// several robots, the two with the most coherent product are used.
    pub(crate) fn of(near: &Heard, far: &Heard, plan: &Plan) -> Self {
        let numbered = [near, far].iter().all(|heard| heard.records.iter().any(|record| record.number.is_some()));
        let heard_by_far = senders(far, numbered);
        let most = heard_by_far.values().copied().max().unwrap_or(0);
        // Strangers, who are many in a monitor's log, are heard more rarely than the robots.
        let often = heard_by_far.into_iter().filter(|(_, count)| 2 * count >= most).map(|(mac, _)| mac);
        let of_near: Vec<Mac> = plan.macs.map_or_else(|| often.collect(), |macs| vec![macs[0]]);
        let pair = if numbered { by_number } else { by_clock };
        let of_far = |mac: &Mac| plan.macs.is_none_or(|macs| macs[1] == *mac);
        let of_far = senders(near, numbered).into_keys().filter(of_far);
        let both = of_far.flat_map(|of_far| of_near.iter().map(move |of_near| [*of_near, of_far]));
        let candidates = both.map(|macs| Self::with(pair(near, far, macs), plan.channel));
        let (candidates, refused): (Vec<Self>, Vec<Self>) = candidates.partition(|pairs| pairs.len() > 0);
        if let (true, Some(refused)) =
            (candidates.is_empty(), refused.into_iter().find(|pairs| pairs.refused.is_some()))
        {
            return refused;
        }
        let most = candidates.iter().map(Self::len).max().unwrap_or(0);
        let coherence = |pairs: &Self| pairs.compensation.as_ref().map_or(0.0, |found| found.coherence_after);
        let likely = candidates.into_iter().filter(|pairs| 2 * pairs.len() >= most).map(|mut pairs| {
            pairs.compensate(plan.channel.centre_hz());
            pairs
        });
        let pairs = likely.max_by(|a, b| coherence(a).total_cmp(&coherence(b))).unwrap_or_default();
        let among_others = plan.macs.is_some() && senders(near, numbered).len() > 1;
        Self { among_others, ..pairs }
    }

    fn with(partners: Partners<'_>, channel: Channel) -> Self {
        let indices = channel.subcarriers();
        let mut pairs = Self { frames: partners.frames, refused: partners.refused, ..Self::default() };
        for (record, other) in partners.pairs {
            let (backward, forward) = (antenna_a(record), antenna_a(other));
            let conjugated = backward.map(|h| h.conj());
            let product = round_trip_at_centre(&forward, &backward, &indices);
            let ratio = round_trip_at_centre(&forward, &conjugated, &indices);
            let Some(((product, ratio), one_way)) = product.zip(ratio).zip(at_centre(&backward, &indices)) else {
                continue;
            };
            pairs.near_us.push(record.card_us);
            pairs.difference_us.push(other.card_us - record.card_us);
            pairs.product.push(product);
            pairs.ratio.push(ratio);
            pairs.one_way.push(one_way);
        }
        pairs.fit();
        pairs
    }

    /// The clocks' line through the pairs.
    fn fit(&mut self) {
        let (Some(&first_us), Some(&first_difference)) = (self.near_us.first(), self.difference_us.first()) else {
            return;
        };
        let points: Vec<(f64, f64)> = self
            .near_us
            .iter()
            .zip(&self.difference_us)
            .map(|(us, difference)| ((us - first_us) as f64, (difference - first_difference) as f64))
            .collect();
        if let Some((offset, slope, error)) = line(&points) {
            self.turn_us = points.iter().map(|(x, y)| y - offset - slope * x).collect();
            self.drift_ppm = Some((slope * 1e6, error * 1e6));
        }
    }

    /// The library's compensation of the phases.
    fn compensate(&mut self, carrier_hz: f64) {
        let difference_us: Vec<f64> = self.difference_us.iter().map(|us| *us as f64).collect();
        let estimate = |z: &[Complex64]| TurnAround::estimate(z, &self.near_us, &difference_us, carrier_hz);
        let (product, ratio) = (estimate(&self.product), estimate(&self.ratio));
        (self.compensation, self.ratio_compensation) = (product, ratio);
    }

    /// Pairs that were formed.
    pub(crate) fn len(&self) -> usize {
        self.product.len()
    }
}
