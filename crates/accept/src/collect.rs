//! What the cards gave, kept for the claims.

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

/// Records of one card that the claims look at: an hour at 100 a second. Later ones are counted and in the log.
const RECORDS: usize = 360_000;

/// A wrap of the card's clock, microseconds.
const WRAP_US: i64 = 1 << 32;

/// What is known of the desk.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The channel that both cards are tuned to.
    pub channel: Channel,
    /// Addresses of the first and of the second robot, where they are known; else the usual senders are taken for them.
    pub macs: Option<[Mac; 2]>,
    /// Neither robot moves.
    pub at_rest: bool,
    /// The first robot's motion and the true direction to the second.
    pub truth: Option<Truth>,
}

/// What is true of the link.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The first robot's motion, on its host's clock.
    pub trajectory: Trajectory,
    /// Direction from the first robot to the second in the trajectory's frame, radians from +x towards +y.
    pub azimuth_rad: f64,
}

impl Plan {
    /// A desk of which only the channel is known.
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

/// One record as it was heard.
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

/// All that one card gave.
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
    /// Where each of the records ends in the log, bytes from its start.
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
                // A pause of more than half a wrap: the host's clock says how many wraps it had.
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

/// What a person did to a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// Tuned it to another channel and back.
    Retuned,
    /// Loaded its driver anew.
    Reloaded,
}

/// What the cards gave after that, at the same places.
#[derive(Debug)]
pub struct After {
    /// What was done.
    pub done: Done,
    /// What the first robot's card gave.
    pub near: Heard,
    /// What the second robot's card gave, where there is its log.
    pub far: Option<Heard>,
    pub(crate) pairs: Option<Pairs>,
}

/// What the interface that sends knows of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Interface {
    /// Frames that the driver reported as sent.
    pub confirmed: Option<u64>,
    /// Of these, frames that the driver says it sent more than once.
    pub retried: u64,
    /// What the regulatory rules say of the channel, as `iw phy` has it in parentheses; empty where they allow everything.
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

/// The first robot's transmitter and what it sends: frames of the WSR dialect, so many at each rate.
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

    /// Sends what is due; what was sent.
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

/// Takes what the cards give.
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
    /// A collector that has heard nothing.
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

    /// A card gave this.
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

    /// From now on this antenna of the first robot is unplugged, and no other; what follows is kept apart. The last thing in a run.
    pub fn unplugged(&mut self, antenna: Antenna) {
        self.unplugged.push((antenna, Heard::default()));
    }

    /// A log is what the first robot's card gave while this antenna was unplugged.
    pub fn unplugged_log(&mut self, antenna: Antenna, bytes: &[u8]) {
        self.unplugged.push((antenna, Heard::of_log(bytes)));
    }

    /// A log is one card's, in place of what was heard live.
    pub fn log(&mut self, side: Side, bytes: &[u8]) {
        match side {
            Side::Near => self.near = Heard::of_log(bytes),
            Side::Far => self.far = Some(Heard::of_log(bytes)),
        }
    }

    /// The host woke this much later than it was asked to.
    pub fn woke_late(&mut self, late: Span) {
        self.lateness_us.push(late.as_us() as f64);
    }

    /// A counter of the kernel module grew by so much.
    pub fn counted(&mut self, name: &str, more: u64) {
        self.counters.push((name.to_owned(), more));
    }

    /// Records with CSI that the near card gave so far.
    #[must_use]
    pub fn records(&self) -> usize {
        self.near.records.len()
    }

    /// All that was collected.
    #[must_use]
    pub fn finish(self) -> Evidence {
        let pairs = self.far.as_ref().map(|far| Pairs::of(&self.near, far, &self.plan));
        let Self { plan, near, far, sent, interface, after, unplugged, lateness_us, counters } = self;
        Evidence { plan, near, far, sent, interface, after, unplugged, lateness_us, counters, pairs }
    }
}

/// Everything that the claims are judged by.
#[derive(Debug)]
pub struct Evidence {
    /// What is known of the desk.
    pub plan: Plan,
    /// What the first robot's card gave.
    pub near: Heard,
    /// What the second robot's card gave, where there is one.
    pub far: Option<Heard>,
    /// The frames that the first robot sent, where that is known.
    pub sent: Vec<Sent>,
    /// What the interface knows that sent them.
    pub interface: Interface,
    /// What the cards gave after each retune and each reload.
    pub after: Vec<After>,
    /// What the first robot's card gave while one antenna was unplugged.
    pub unplugged: Vec<(Antenna, Heard)>,
    /// How late the host woke, microseconds.
    pub lateness_us: Vec<f64>,
    /// By how much each counter of the kernel module grew meanwhile; empty where there is none.
    pub counters: Vec<(String, u64)>,
    pub(crate) pairs: Option<Pairs>,
}

impl Evidence {
    /// Asks every claim.
    #[must_use]
    pub fn judge(&self) -> Report {
        Report::new(self, CLAIMS.iter().flat_map(|claim| claim.judge(self)).collect())
    }
}

/// Reads two cards to their ends in virtual time and asks every claim: for sources that end, as simulated cards and logs do.
///
/// # Errors
/// What a source failed with. Losses are no failure; a claim names them.
pub fn run<'a>(near: &'a mut dyn CsiSource, far: Option<&'a mut dyn CsiSource>, plan: Plan) -> Result<Report, Error> {
    collect(near, far, None, plan).map(|evidence| evidence.judge())
}

/// [`run`], and the first robot sends meanwhile.
///
/// # Errors
/// As [`run`]. A frame that the injector did not take is no failure; a claim names it.
pub fn run_sending<'a>(
    near: &'a mut dyn CsiSource,
    far: Option<&'a mut dyn CsiSource>,
    sending: Sending<'_>,
    plan: Plan,
) -> Result<Report, Error> {
    collect(near, far, Some(sending), plan).map(|evidence| evidence.judge())
}

/// What [`run`] judges.
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
        // A source that asks to be called at once still moves on.
        now = next_at.map_or(now, |at| at.max(now + Span::from_us(1)));
    }
    Ok(collector.finish())
}
