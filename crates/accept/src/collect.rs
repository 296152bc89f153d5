//! Collects the cards' records for the claims.

use crate::claims::CLAIMS;
use crate::pairs::Pairs;
use crate::report::Report;
use csi5300::motion::pose::Trajectory;
use csi5300::signal::channel::Channel;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Injector, Next};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Iq, MAX_SAMPLES, Repr};
use driver_iface::record::code;
use driver_iface::sounding::wsr::{self, Lfsr};

/// Limit of a card's records for the claims: an hour at 100 a second. Later ones are counted and logged.
const RECORDS: usize = 360_000;

/// A wrap of the card's clock, microseconds.
const WRAP_US: i64 = 1 << 32;

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
    /// The records come from a log, not from a card.
    pub recorded: bool,
    /// The end of each record in the log, bytes from its start.
    pub(crate) ends: Vec<usize>,
    /// The last `timestamp_low`, the clock without wraps there, and the host's.
    card_us: Option<(u32, i64, Option<i64>)>,
}

impl Heard {
    /// True if the records were made from another card's log, as [`csi5300::source::other_card`] does.
    pub(crate) fn is_of_another_card(&self) -> bool {
        self.survey.by_code.contains_key(&code::CARD_CLOCK)
    }

    fn note(&mut self, next: &Next<'_>) {
        if let Next::Record(_, record) = next {
            let from = self.log.len();
            self.log.resize(from + record.emit_len(), 0);
            let room = self.log.get_mut(from..).unwrap_or_default();
            if record.emit(room).is_err() {
                self.log.truncate(from);
            }
        }
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        let low = bfee.timestamp_low();
        let card_us = match self.card_us {
            Some((before, us, host_us)) => {
                let step = i64::from(low.wrapping_sub(before).cast_signed());
                // After a pause of more than half a wrap, the host's clock gives the number of wraps.
                let off = identity.host_us.zip(host_us).map_or(0, |(now, before)| now - before - step);
                us + step + (off + WRAP_US / 2).div_euclid(WRAP_US) * WRAP_US
            }
            None => i64::from(low),
        };
        self.card_us = Some((low, card_us, identity.host_us));
        self.ends.push(self.log.len());
        if self.records.len() == RECORDS {
            return;
        }
        let mut csi = [Iq::default(); MAX_SAMPLES];
        let samples = bfee.unpack_bits(&mut csi).unwrap_or(0);
        self.records.push(HeardRecord {
            host_us: identity.host_us,
            card_us,
            mac: identity.mac,
            number: identity.frame_count,
            head: Repr::parse(&bfee),
            csi: csi.get(..samples).unwrap_or(&[]).into(),
        });
    }

    /// All records of a log's bytes.
    #[must_use]
    pub fn of_log(bytes: &[u8]) -> Self {
        let mut heard = Self { recorded: true, ..Self::default() };
        let mut replay = csi5300::source::replay::Replay::new(bytes, "log".into());
        while let Ok(next) = replay.receive(Instant::ZERO) {
            let end = matches!(next, Next::End(_));
            heard.note(&next);
            if end {
                break;
            }
        }
        heard
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
    pub(crate) pairs: Option<Pairs>,
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

/// The first robot's transmitter: frames of the WSR dialect at several rates.
pub struct Sending<'a> {
    injector: &'a mut dyn Injector,
    sender: Mac,
    left: Vec<f64>,
    next_at: Instant,
    filler: Lfsr,
    number: u32,
}

/// Frames a second at which the suite sends, and how many frames at each: 16.4 s in all.
const RATES: [(f64, usize); 4] = [(20.0, 200), (50.0, 200), (200.0, 400), (1_000.0, 400)];

impl<'a> Sending<'a> {
    /// Frames of this sender, at 20, 50, 200 and 1,000 a second.
    pub fn new(injector: &'a mut dyn Injector, sender: Mac) -> Self {
        let left = RATES.iter().rev().flat_map(|(rate_hz, count)| std::iter::repeat_n(*rate_hz, *count)).collect();
        // The radio has settled by then.
        Self { injector, sender, left, next_at: Instant::from_us(100_000), filler: Lfsr::default(), number: 0 }
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

    /// Sends the due frames; returns them.
    pub fn send(&mut self, now: Instant) -> Option<Sent> {
        if now < self.next_at {
            return None;
        }
        let rate_hz = self.left.pop()?;
        self.number += 1;
        let repr = wsr::Repr { sender: self.sender, number: self.number, len_with_fcs: wsr::DEFAULT_LEN };
        let mut frame = vec![0; repr.mpdu_len()];
        let taken = repr.emit(&mut frame, &mut self.filler).is_ok() && self.injector.inject(now, &frame).is_ok();
        self.next_at = now.max(self.next_at) + Span::from_s(1.0 / rate_hz);
        Some(Sent { number: self.number, rate_hz, taken })
    }
}

/// Takes the cards' items.
#[derive(Debug)]
pub struct Collector {
    plan: Plan,
    near: Heard,
    far: Option<Heard>,
    sent: Vec<Sent>,
    interface: Interface,
    after: Vec<After>,
    unplugged: Vec<(Antenna, Heard)>,
    lateness_us: Vec<f64>,
    counters: Vec<(String, u64)>,
}

impl Collector {
    /// An empty collector.
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
            counters: Vec::new(),
        }
    }

    /// Takes an item of a card.
    pub fn heard(&mut self, side: Side, next: &Next<'_>) {
        match side {
            Side::Near => self.unplugged.last_mut().map_or(&mut self.near, |(_, heard)| heard).note(next),
            Side::Far => self.far.get_or_insert_default().note(next),
        }
    }

    /// The first robot sent a frame.
    pub fn sent(&mut self, frame: Sent) {
        self.sent.push(frame);
    }

    /// What the interface knows that sent them.
    pub fn interface(&mut self, interface: Interface) {
        self.interface = interface;
    }

    /// Logs of both cards after something was done to the first one.
    pub fn after(&mut self, done: Done, near: &[u8], far: Option<&[u8]>) {
        let (near, far) = (Heard::of_log(near), far.map(Heard::of_log));
        let pairs = far.as_ref().map(|far| Pairs::of(&near, far, &self.plan));
        self.after.push(After { done, near, far, pairs });
    }

    /// From now on this antenna of the first robot, and no other, is unplugged; later records are kept separately. It
    /// must be last in a run.
    pub fn unplugged(&mut self, antenna: Antenna) {
        self.unplugged.push((antenna, Heard::default()));
    }

    /// Takes a log of the first robot's card with this antenna unplugged.
    pub fn unplugged_log(&mut self, antenna: Antenna, bytes: &[u8]) {
        self.unplugged.push((antenna, Heard::of_log(bytes)));
    }

    /// Takes a log as one card's data, in place of live ones.
    pub fn log(&mut self, side: Side, bytes: &[u8]) {
        match side {
            Side::Near => self.near = Heard::of_log(bytes),
            Side::Far => self.far = Some(Heard::of_log(bytes)),
        }
    }

    /// Notes the lateness of a wake-up.
    pub fn woke_late(&mut self, late: Span) {
        self.lateness_us.push(late.as_us() as f64);
    }

    /// Notes the growth of a counter of the kernel module.
    pub fn counted(&mut self, name: &str, more: u64) {
        self.counters.push((name.to_owned(), more));
    }

    /// Records with CSI of the near card so far.
    #[must_use]
    pub fn records(&self) -> usize {
        self.near.records.len()
    }

    /// The collected evidence.
    #[must_use]
    pub fn finish(self) -> Evidence {
        let pairs = self.far.as_ref().map(|far| Pairs::of(&self.near, far, &self.plan));
        let Self { plan, near, far, sent, interface, after, unplugged, lateness_us, counters } = self;
        Evidence { plan, near, far, sent, interface, after, unplugged, lateness_us, counters, pairs }
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
    /// The first robot's data with one antenna unplugged.
    pub unplugged: Vec<(Antenna, Heard)>,
    /// How late the host woke, microseconds.
    pub lateness_us: Vec<f64>,
    /// Growth of each counter of the kernel module; empty without the module.
    pub counters: Vec<(String, u64)>,
    pub(crate) pairs: Option<Pairs>,
}

impl Evidence {
    /// Judges every claim.
    #[must_use]
    pub fn judge(&self) -> Report {
        Report::new(self, CLAIMS.iter().flat_map(|claim| claim.judge(self)).collect())
    }
}

/// Reads two cards to their ends in virtual time and judges every claim: for sources that end, like simulated cards and
/// logs.
///
/// # Errors
/// The error of a source. Losses are no error; a claim reports them.
pub fn run<'a>(near: &'a mut dyn CsiSource, far: Option<&'a mut dyn CsiSource>, plan: Plan) -> Result<Report, Error> {
    collect(near, far, None, plan).map(|evidence| evidence.judge())
}

/// [`run`], and the first robot sends meanwhile.
///
/// # Errors
/// As [`run`]. A refused frame is no error; a claim reports it.
pub fn run_sending<'a>(
    near: &'a mut dyn CsiSource,
    far: Option<&'a mut dyn CsiSource>,
    sending: Sending<'_>,
    plan: Plan,
) -> Result<Report, Error> {
    collect(near, far, Some(sending), plan).map(|evidence| evidence.judge())
}

/// The evidence that [`run`] judges.
///
/// # Errors
/// As [`run`].
pub fn collect<'a>(
    near: &'a mut dyn CsiSource,
    far: Option<&'a mut dyn CsiSource>,
    mut sending: Option<Sending<'_>>,
    plan: Plan,
) -> Result<Evidence, Error> {
    let mut collector = Collector::new(plan);
    let mut sources: Vec<(Side, &'a mut dyn CsiSource)> = vec![(Side::Near, near)];
    sources.extend(far.map(|far| (Side::Far, far)));
    let mut now = Instant::ZERO;
    while !sources.is_empty() {
        while let Some(sent) = sending.as_mut().and_then(|sending| sending.send(now)) {
            collector.sent(sent);
        }
        let mut next_at = sending.as_ref().and_then(Sending::next_at);
        let mut open = Vec::new();
        for (side, source) in sources {
            let goes_on = loop {
                let next = source.receive(now)?;
                let (pending, end) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
                collector.heard(side, &next);
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
    Ok(collector.finish())
}
