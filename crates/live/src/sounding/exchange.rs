//! One robot's side of the exchange: connects air and state machine, in the order of the machine's contract.
//! Its figures say how punctual it was, its watch whether frames go out at all: the kernel drops forbidden ones silently.

use csi5300::exchange::tdma::{Event, Tdma, Transmit};
use csi5300::internal::FrameReceiver;
use csi5300::source::{Error, Injector, NotSent};
use csi5300::time::{Instant, Span};
use driver_iface::mpdu;
use driver_iface::sounding::native::Role;
use hdrhistogram::Histogram;
use std::fmt::Write;

/// News of the exchange.
#[derive(Clone, Debug)]
pub enum News {
    /// The thread runs: what the system granted, in words.
    Started(String),
    /// Something happened on the air.
    Event(Event),
    /// Something that the user should know.
    Notice(Notice),
}

/// The machine, the air, and timing figures.
#[derive(Debug)]
pub struct Exchange<A> {
    /// The machine: its plan and counts.
    pub tdma: Tdma,
    /// The interface: its counters.
    pub air: A,
    /// Lateness and turn-around.
    pub figures: Figures,
    watch: Watch,
    /// Number and hand-over of the last forward frame.
    last_forward: Option<(u32, Instant)>,
    /// The optional end: from then on nothing is received or sent.
    pub stop_at: Option<Instant>,
}

/// The frame being handled: when its reception ended, and its length with FCS.
type FrameEnd = (Instant, usize);

impl<A: Injector + FrameReceiver> Exchange<A> {
    /// A machine on an interface.
    #[must_use]
    pub fn new(tdma: Tdma, air: A) -> Self {
        Self { tdma, air, figures: Figures::default(), watch: Watch::default(), last_forward: None, stop_at: None }
    }

    /// True from the time at which it ends.
    #[must_use]
    pub fn is_over(&self, now: Instant) -> bool {
        self.stop_at.is_some_and(|end| end <= now)
    }

    /// Takes all received frames, sends all due ones, and returns the time of the next step. Does nothing once it [is
    /// over](Self::is_over).
    ///
    /// # Errors
    /// If the interface failed for good. Refused frames are only counted and reported in a [`Notice`].
    pub fn step(&mut self, now: &impl Fn() -> Instant, tell: &mut impl FnMut(News)) -> Result<Option<Instant>, Error> {
        loop {
            // The time is read before the frame's age, so that delays between make answers early, never late.
            let at = now();
            if self.is_over(at) {
                return Ok(None);
            }
            let Some(heard) = self.air.hear()? else { break };
            let ended = at - heard.age;
            let heard_len = heard.frame.len() + mpdu::FCS;
            self.tdma.handle_heard(at, ended, heard.frame);
            self.send_due(now, Some((ended, heard_len)), tell)?;
        }
        self.send_due(now, None, tell)?;
        if let Some(notice) = self.watch.look(now(), self.air.sent_for_certain(), self.air.failed_for_certain()) {
            tell(News::Notice(notice));
        }
        Ok([self.tdma.poll_timeout(), self.stop_at].into_iter().flatten().min())
    }

    fn send_due(
        &mut self,
        now: &impl Fn() -> Instant,
        heard: Option<FrameEnd>,
        tell: &mut impl FnMut(News),
    ) -> Result<(), Error> {
        loop {
            let at = now();
            let due = if self.is_over(at) { None } else { self.tdma.poll_transmit(at) };
            let Some(transmit) = due else { break };
            let before = now();
            let (role, number) = (transmit.role, transmit.number);
            if role == Role::Forward {
                note(&mut self.figures.due_us, before - transmit.at);
            }
            // The host may have been busy since the machine returned the frame.
            if before > transmit.latest {
                self.figures.too_late += 1;
                self.tdma.not_sent(role, number);
                continue;
            }
            let taken = self.air.inject(before, transmit.frame);
            if let Err(error) = taken {
                self.tdma.not_sent(role, number);
                let Error::NotSent(why) = error else { return Err(error) };
                self.watch.not_sent(why).map(News::Notice).into_iter().for_each(&mut *tell);
                continue;
            }
            let after = now();
            self.figures.note_sent(&transmit, before, after, heard.map(|(ended, _)| ended));
            self.watch.sent(role, before);
            if role == Role::Forward {
                self.last_forward = Some((number, before));
            }
        }
        while let Some(event) = self.tdma.poll_event() {
            match event {
                Event::Answered { number, .. } => {
                    self.watch.answered();
                    self.note_answer(number, heard);
                }
                Event::Missed { slots, late, slot } => self.figures.note_missed(slots, late, slot),
                _ => {}
            }
            tell(News::Event(event));
        }
        Ok(())
    }

    /// How long after the forward frame's hand-over the answer to it began.
    fn note_answer(&mut self, number: u32, heard: Option<FrameEnd>) {
        let sent = self.last_forward.filter(|(sent, _)| *sent == number);
        if let (Some((_, sent)), Some((ended, len))) = (sent, heard) {
            let airtime_us = i64::from(self.tdma.plan().phy.airtime_us(len));
            note(&mut self.figures.answer_us, ended - sent - Span::from_us(airtime_us));
        }
    }
}

/// Turn-around of the WSR kernel responder, microseconds, from the rise of the forward frame to that of its answer: at
/// least, median, at most (892 answers in WSR's `test_count_rx_5.dat`).
pub const KERNEL_TURN_AROUND_US: [u32; 3] = [145, 225, 322];
/// Longer times count as this, microseconds.
const LONGEST_US: u64 = 10_000_000;
/// Upper edges of the classes in which a histogram is printed, microseconds.
const EDGES_US: [u64; 12] = [10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 100_000, LONGEST_US];

/// Timing figures of sounding. Nothing is allocated after the start.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Microseconds from a slot's start until the host reached it, for every due slot, also skipped and refused ones:
    /// the measure of the host's punctuality.
    pub due_us: Histogram<u64>,
    /// Microseconds from a slot's start to the hand-over of its forward frame: of frames sent, so never above the guard.
    pub lateness_us: Histogram<u64>,
    /// Microseconds from the kernel's stamp on a forward frame to the hand-over of its answer.
    pub turn_around_us: Histogram<u64>,
    /// Microseconds from the hand-over of a forward frame to the start of its received answer.
    pub answer_us: Histogram<u64>,
    /// Frames that the machine returned in time but the host reached too late: skipped.
    pub too_late: u64,
    /// Frames handed over in time, while the call returned too late: they may have been late on air.
    pub perhaps_late: u64,
}

#[allow(clippy::expect_used, reason = "constant bounds, which the test below has seen accepted")]
fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_US, 3).expect("bounds that are accepted")
}

impl Default for Figures {
    /// Nothing measured yet.
    fn default() -> Self {
        Self {
            due_us: histogram(),
            lateness_us: histogram(),
            turn_around_us: histogram(),
            answer_us: histogram(),
            too_late: 0,
            perhaps_late: 0,
        }
    }
}

impl Figures {
    /// Notes a run of missed slots: `late` after the first one's start, each a `slot` later.
    fn note_missed(&mut self, slots: u32, late: Span, slot: Span) {
        for k in 0..i64::from(slots) {
            note(&mut self.due_us, Span::from_us(late.as_us() - k * slot.as_us()));
        }
    }

    /// Notes a hand-over: `before` and `after` the call, `ended` the end of the frame that it answers.
    fn note_sent(&mut self, transmit: &Transmit<'_>, before: Instant, after: Instant, ended: Option<Instant>) {
        match (transmit.role, ended) {
            (Role::Forward, _) => note(&mut self.lateness_us, before - transmit.at),
            (Role::Backward, Some(ended)) => note(&mut self.turn_around_us, after - ended),
            (Role::Backward, None) => {}
        }
        self.perhaps_late += u64::from(after > transmit.latest);
    }
}

fn note(histogram: &mut Histogram<u64>, span: Span) {
    histogram.saturating_record(span.as_us().max(0).cast_unsigned());
}

/// Quantiles of times, microseconds.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Spread {
    p50: u64,
    p90: u64,
    p99: u64,
    max: u64,
}

impl Spread {
    /// Those of a histogram, if there is something in it.
    #[must_use]
    pub fn of(histogram: &Histogram<u64>) -> Option<Self> {
        let [p50, p90, p99] = [0.5, 0.9, 0.99].map(|share| histogram.value_at_quantile(share));
        (!histogram.is_empty()).then(|| Self { p50, p90, p99, max: histogram.max() })
    }
}

/// `p50 12, p90 40, p99 62, max 265 us`, and the share of every class.
#[must_use]
pub fn spread_of(histogram: &Histogram<u64>) -> String {
    let Some(Spread { p50, p90, p99, max }) = Spread::of(histogram) else { return "none".into() };
    let mut text = format!("p50 {p50}, p90 {p90}, p99 {p99}, max {max} us");
    let (mut low, mut parts) = (0, Vec::new());
    for edge in EDGES_US {
        let count = histogram.count_between(low, edge - 1);
        if count > 0 {
            parts.push(format!("<{edge}: {count}"));
        }
        low = edge;
    }
    let _ = write!(text, " ({})", parts.join(", "));
    text
}

/// Frames without a sign of life, and least time, before a notice.
const FRAMES: u64 = 32;
const TIME: Span = Span::from_ms(1_000);

/// A notice to the user, given once until it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Frames are handed over, but none was reported as sent or answered.
    NothingGoesOut {
        /// So many.
        frames: u64,
    },
    /// Frames are handed over, but all were reported as failed, and none was answered.
    AllFail {
        /// So many.
        frames: u64,
    },
    /// After [`Notice::NothingGoesOut`] or [`Notice::AllFail`]: a frame was sent or answered.
    GoesOut,
    /// A frame was not taken.
    NotSent(NotSent),
}

impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NothingGoesOut { frames } => write!(
                f,
                "{frames} frames were handed to the kernel, but it reports none of them as sent and none was answered. \
                 It drops frames silently on channels where the card may not start to transmit (no IR, passive, \
                 radar/DFS): look at `iw phy` and take another channel; the regulatory domain is left as it is. If the \
                 channel is allowed, no peer hears this robot"
            ),
            Self::AllFail { frames } => write!(
                f,
                "{frames} frames were handed to the kernel, but it reports that sending failed, and none was answered: \
                 the peers are not there or on another channel, or the card cannot send (see `dmesg`)"
            ),
            Self::GoesOut => write!(f, "frames go out now"),
            Self::NotSent(why) => write!(f, "{why}; further such frames are only counted"),
        }
    }
}

/// Signs that frames go out: tx-status copies, and answers to forward frames.
#[derive(Clone, Debug, Default)]
struct Watch {
    /// Frames since the last sign, and of these the forward ones.
    without_sign: u64,
    unanswered: u64,
    since: Instant,
    certain: u64,
    /// Failed frames, and their number at the last sign.
    failed: u64,
    failed_before: u64,
    said: bool,
    last_refusal: Option<std::mem::Discriminant<NotSent>>,
}

impl Watch {
    /// A frame was taken.
    fn sent(&mut self, role: Role, now: Instant) {
        if self.without_sign == 0 {
            self.since = now;
        }
        self.without_sign += 1;
        self.unanswered += u64::from(role == Role::Forward);
        self.last_refusal = None;
    }

    /// One was answered: it had gone out.
    fn answered(&mut self) {
        (self.without_sign, self.unanswered, self.failed_before) = (0, 0, self.failed);
    }

    /// A frame was refused: a notice if the one before was taken, or refused for another reason.
    fn not_sent(&mut self, why: NotSent) -> Option<Notice> {
        let kind = std::mem::discriminant(&why);
        (self.last_refusal.replace(kind) != Some(kind)).then_some(Notice::NotSent(why))
    }

    /// Takes the counts of tx-status copies so far: `certain` for sent frames, `failed` for others.
    fn look(&mut self, now: Instant, certain: Option<u64>, failed: u64) -> Option<Notice> {
        let certain = certain.unwrap_or(0);
        self.failed = failed;
        if certain > self.certain {
            self.certain = certain;
            self.answered();
        }
        let silent = self.without_sign >= FRAMES && now - self.since >= TIME;
        let all_fail = failed > self.failed_before;
        // A kernel may report every unacknowledged frame as failed, so answers must be missing too.
        if silent && !self.said && (!all_fail || self.unanswered >= FRAMES) {
            self.said = true;
            let frames = self.without_sign;
            return Some(if all_fail { Notice::AllFail { frames } } else { Notice::NothingGoesOut { frames } });
        }
        if self.said && self.without_sign == 0 {
            self.said = false;
            return Some(Notice::GoesOut);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::exchange::tdma::{Config, Epoch, Request};
    use csi5300::internal::HeardFrame;
    use driver_iface::Mac;
    use std::cell::Cell;
    use std::collections::VecDeque;
    use std::rc::Rc;

    const A: Mac = Mac([2, 0, 0, 0, 0, 1]);
    const B: Mac = Mac([2, 0, 0, 0, 0, 2]);

    /// An air that keeps sent frames and returns queued ones, on a host that takes time.
    #[derive(Default)]
    struct Script {
        clock: Cell<i64>,
        /// Every injection takes so long.
        takes_us: i64,
        refuses: Option<NotSent>,
        sent: Vec<(Instant, Vec<u8>)>,
        incoming: VecDeque<(Vec<u8>, Span)>,
        last: Vec<u8>,
        certain: Option<u64>,
        failed: u64,
        /// A host that is busy for this time after a request for a frame.
        stall: Option<(Rc<Cell<i64>>, i64)>,
    }

    impl Injector for &mut Script {
        fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
            if let Some(why) = self.refuses {
                return Err(why.into());
            }
            self.sent.push((now, frame.to_vec()));
            self.clock.set(self.clock.get() + self.takes_us);
            Ok(())
        }
    }

    impl FrameReceiver for &mut Script {
        fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error> {
            let Some((frame, age)) = self.incoming.pop_front() else { return Ok(None) };
            self.last = frame;
            if let Some((clock, us)) = &self.stall {
                clock.set(clock.get() + us);
            }
            Ok(Some(HeardFrame { frame: &self.last, age }))
        }

        fn sent_for_certain(&self) -> Option<u64> {
            self.certain
        }

        fn failed_for_certain(&self) -> u64 {
            self.failed
        }
    }

    fn initiator() -> Tdma {
        // In an open loop it sounds in every round, answered or not.
        let mut config = Config { initiate: true, epoch: Epoch::Common(Instant::ZERO), ..config(A, B) };
        config.open_loop = true;
        Tdma::new(&config).unwrap()
    }

    fn config(own: Mac, peer: Mac) -> Config {
        Config::new(own, 0, &[peer], Request::new(1, 100.0), 1)
    }

    /// Steps at every deadline, `late_us` late, until `until_us`; gives the news.
    fn run(exchange: &mut Exchange<&mut Script>, late_us: i64, until_us: i64) -> Vec<News> {
        let (mut told, mut at) = (Vec::new(), exchange.tdma.poll_timeout());
        while let Some(due) = at.filter(|due| due.as_us() < until_us) {
            let us = exchange.air.clock.get().max(due.as_us() + late_us);
            exchange.air.clock.set(us);
            at = exchange.step(&|| Instant::from_us(us), &mut |news| told.push(news)).unwrap();
        }
        told
    }

    fn notices(told: &[News]) -> Vec<Notice> {
        told.iter().filter_map(|news| if let News::Notice(notice) = news { Some(*notice) } else { None }).collect()
    }

    #[test]
    fn lateness_is_what_it_was_and_nothing_is_sent_beyond_the_guard() {
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        run(&mut exchange, 30, 5_000_000);
        let sent = exchange.figures.lateness_us.len();
        assert!(sent > 200 && exchange.figures.lateness_us.max() == 30);
        run(&mut exchange, 51, 10_000_000);
        assert_eq!(exchange.figures.lateness_us.len(), sent, "51 us are beyond the guard of 50");
        assert!(exchange.tdma.counts().missed_slots > 200);
        let (due, missed) = (&exchange.figures.due_us, exchange.tdma.counts().missed_slots);
        assert_eq!((due.len(), due.max()), (sent + missed, 51), "those that were skipped are in the figures, too");
        assert_eq!(script.sent.len() as u64, sent);
    }

    #[test]
    fn a_host_busy_between_machine_and_air_sends_nothing_late() {
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        let begin = exchange.tdma.poll_timeout().unwrap();
        // Each look at the clock takes 20 us: in time for the machine, too late for the air.
        let clock = Cell::new(begin.as_us());
        let slow = || {
            let now = clock.get();
            clock.set(now + 20);
            Instant::from_us(now + 20)
        };
        exchange.step(&slow, &mut |_| {}).unwrap();
        assert_eq!((exchange.figures.too_late, exchange.figures.lateness_us.len()), (1, 0));
        assert_eq!((exchange.figures.due_us.len(), exchange.figures.due_us.max()), (1, 60));
        assert_eq!((exchange.tdma.counts().forward, exchange.tdma.link_counts(B).unwrap().sounded), (0, 0));
        assert!(script.sent.is_empty());
    }

    #[test]
    fn frames_that_vanish_are_noticed_once_and_so_is_their_return() {
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        let told = notices(&run(&mut exchange, 0, 20_000_000));
        assert!(matches!(told[..], [Notice::NothingGoesOut { frames: 32.. }]), "{told:?}");
        exchange.air.certain = Some(1);
        assert_eq!(notices(&run(&mut exchange, 0, 20_100_000)), [Notice::GoesOut]);
        // A card that reports every frame as sent, and a peer that does not answer.
        let mut certain = 1;
        for second in 21..40 {
            certain += 50;
            exchange.air.certain = Some(certain);
            assert_eq!(notices(&run(&mut exchange, 0, second * 1_000_000)), []);
        }
    }

    #[test]
    fn refusals_are_reported_once_for_each_cause_in_a_row() {
        let mut script = Script { refuses: Some(NotSent::NoRoom), ..Script::default() };
        let mut exchange = Exchange::new(initiator(), &mut script);
        assert_eq!(notices(&run(&mut exchange, 0, 5_000_000)), [Notice::NotSent(NotSent::NoRoom)]);
        exchange.air.refuses = Some(NotSent::Down);
        assert_eq!(notices(&run(&mut exchange, 0, 6_000_000)), [Notice::NotSent(NotSent::Down)]);
        assert_eq!(exchange.figures.lateness_us.len(), 0);
        assert!(exchange.figures.due_us.len() > 200);
        // What was not sent is not waited for either.
        let counts = *exchange.tdma.counts();
        assert_eq!((counts.forward, counts.unanswered), (0, 0));
        assert_eq!(exchange.tdma.link_counts(B).unwrap().sounded, 0);
    }

    #[test]
    fn an_exchange_ends_at_its_time_whatever_is_due_or_heard() {
        let end = Instant::from_us(3_000_000);
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        exchange.stop_at = Some(end);
        // At its end it sleeps for ever.
        run(&mut exchange, 0, i64::MAX);
        assert!(
            exchange.is_over(Instant::from_us(exchange.air.clock.get())) && !exchange.is_over(end - Span::from_us(1))
        );
        let (_, last) = exchange.air.sent.last().cloned().unwrap();
        let latest = exchange.air.sent.iter().map(|(at, _)| *at).max().unwrap();
        assert!(latest < end && end - latest < Span::from_ms(20), "{latest:?}");
        let sent = exchange.air.sent.len();
        exchange.air.incoming.push_back((last, Span::default()));
        assert_eq!(exchange.step(&|| end, &mut |_| {}).unwrap(), None);
        assert_eq!((exchange.air.sent.len(), exchange.air.incoming.len()), (sent, 1), "not heard, not answered");
    }

    #[test]
    fn slots_slept_through_are_in_the_figures() {
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        run(&mut exchange, 0, 2_000_000);
        let (due, at) = (exchange.figures.due_us.len(), exchange.tdma.poll_timeout().unwrap());
        // Slots of 10 ms; 64 of them are what a turn survives.
        exchange.step(&|| at + Span::from_ms(55), &mut |_| {}).unwrap();
        assert_eq!((exchange.figures.due_us.len() - due, exchange.tdma.counts().missed_slots), (6, 6));
        assert!((54_900..=55_100).contains(&exchange.figures.due_us.max()));
        let at = exchange.tdma.poll_timeout().unwrap();
        exchange.step(&|| at + Span::from_ms(100_000), &mut |_| {}).unwrap();
        assert_eq!(exchange.tdma.counts().overslept, 1);
        assert!(exchange.figures.due_us.len() > due + 6);
        assert!(exchange.figures.due_us.max() > 9_000_000, "as long as is told apart");
    }

    #[test]
    fn a_responder_notices_that_its_answers_vanish_too() {
        let mut asked = Script::default();
        run(&mut Exchange::new(initiator(), &mut asked), 0, 10_000_000);
        let answer_all = |failed, certain: fn(u64) -> u64| {
            let mut air = Script::default();
            let mut exchange = Exchange::new(Tdma::new(&config(B, A)).unwrap(), &mut air);
            let mut told = Vec::new();
            for (k, (at, frame)) in (1..).zip(&asked.sent) {
                exchange.air.incoming.push_back((frame.clone(), Span::default()));
                exchange.air.certain = Some(certain(k));
                exchange.air.failed = if failed { k } else { 0 };
                exchange.step(&|| *at, &mut |news| told.push(news)).unwrap();
            }
            assert!(exchange.tdma.counts().replies > 200);
            notices(&told)
        };
        assert!(matches!(answer_all(false, |_| 0)[..], [Notice::NothingGoesOut { frames: 32.. }]));
        assert_eq!(answer_all(false, |k| k), []);
        assert_eq!(answer_all(true, |_| 0), [], "nobody acknowledges, nor answers, an answer");
    }

    #[test]
    fn frames_that_all_fail_are_noticed() {
        let mut script = Script { certain: Some(0), ..Script::default() };
        let mut exchange = Exchange::new(initiator(), &mut script);
        let mut told = Vec::new();
        for tenth in 1..40 {
            exchange.air.failed += 10;
            told.extend(notices(&run(&mut exchange, 0, tenth * 100_000)));
        }
        assert!(matches!(told[..], [Notice::AllFail { frames: 32.. }]), "{told:?}");
        exchange.air.certain = Some(1);
        assert_eq!(notices(&run(&mut exchange, 0, 4_100_000)), [Notice::GoesOut]);
    }

    #[test]
    fn a_host_busy_while_it_takes_a_frame_answers_nothing_late() {
        let mut asked = Script::default();
        run(&mut Exchange::new(initiator(), &mut asked), 0, 3_000_000);
        let (_, forward) = asked.sent.remove(0);
        for (stall_us, answers) in [(200, 1), (300, 0)] {
            let clock = Rc::new(Cell::new(1_000_000));
            let mut script = Script { stall: Some((clock.clone(), stall_us)), ..Script::default() };
            // 60 us old when its age was read.
            script.incoming.push_back((forward.clone(), Span::from_us(60)));
            let mut exchange = Exchange::new(Tdma::new(&config(B, A)).unwrap(), &mut script);
            exchange.step(&|| Instant::from_us(clock.get()), &mut |_| {}).unwrap();
            assert_eq!(exchange.air.sent.len(), answers, "{stall_us} us");
        }
    }

    #[test]
    fn an_answer_follows_its_frame_at_once_and_its_turn_around_is_measured() {
        let mut asked = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut asked);
        run(&mut exchange, 0, 3_000_000);
        let (_, forward) = asked.sent.remove(0);
        let mut script = Script { takes_us: 7, ..Script::default() };
        script.incoming.push_back((forward.clone(), Span::from_us(60)));
        script.clock.set(1_000_000);
        let mut exchange = Exchange::new(Tdma::new(&config(B, A)).unwrap(), &mut script);
        let mut told = Vec::new();
        exchange.step(&|| Instant::from_us(1_000_090), &mut |news| told.push(news)).unwrap();
        assert!(matches!(told[..], [.., News::Event(Event::Asked { peer: A, .. })]), "{told:?}");
        assert_eq!((exchange.figures.turn_around_us.len(), exchange.figures.turn_around_us.max()), (1, 60));
        assert_eq!(exchange.air.sent[0].1[24..28], forward[24..28], "the same number");
        // One that was held up for longer than a turn-around is not answered.
        let mut script = Script::default();
        script.incoming.push_back((forward, Span::from_us(323)));
        let mut exchange = Exchange::new(Tdma::new(&config(B, A)).unwrap(), &mut script);
        exchange.step(&|| Instant::from_us(1_000_000), &mut |_| {}).unwrap();
        assert_eq!((exchange.air.sent.len(), exchange.tdma.counts().missed_replies), (0, 1));
    }

    #[test]
    fn the_initiator_sees_when_an_answer_began() {
        let mut script = Script::default();
        let mut exchange = Exchange::new(initiator(), &mut script);
        let begin = exchange.tdma.poll_timeout().unwrap();
        exchange.step(&|| begin, &mut |_| {}).unwrap();
        let (_, forward) = exchange.air.sent.remove(0);
        let mut responder = Tdma::new(&config(B, A)).unwrap();
        responder.handle_heard(begin, begin, &forward);
        let answer = responder.poll_transmit(begin).unwrap().frame.to_vec();
        let airtime_us = i64::from(exchange.tdma.plan().phy.airtime_us(answer.len() + 4));
        exchange.air.incoming.push_back((answer, Span::from_us(100)));
        exchange.step(&|| begin + Span::from_us(330 + airtime_us), &mut |_| {}).unwrap();
        assert_eq!((exchange.figures.answer_us.len(), exchange.figures.answer_us.max()), (1, 230));
    }

    #[test]
    fn a_histogram_in_words() {
        let mut figures = Figures::default();
        assert_eq!(spread_of(&figures.answer_us), "none");
        for us in [3, 5, 40, 70, 12_000] {
            note(&mut figures.answer_us, Span::from_us(us));
        }
        let words = spread_of(&figures.answer_us);
        assert!(words.starts_with("p50 40, p90 12"), "{words}");
        assert!(words.ends_with("(<10: 2, <50: 1, <100: 1, <100000: 1)"), "{words}");
    }
}
