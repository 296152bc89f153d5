//! The exchange in virtual time, on a scripted air.

use super::*;
use csi5300::exchange::tdma::{Config, Epoch, Event, Request, Tdma};
use csi5300::internal::{FrameReceiver, HeardFrame};
use csi5300::source::{Error, Injector, NotSent};
use csi5300::time::{Instant, Span};
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
    let mut exchange = Exchange::new(initiator(), &mut script).with_stop_at(Some(end));
    // At its end it sleeps for ever.
    run(&mut exchange, 0, i64::MAX);
    assert!(exchange.is_over(Instant::from_us(exchange.air.clock.get())) && !exchange.is_over(end - Span::from_us(1)));
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
    let mut figures = Figures::new();
    assert_eq!(spread_of(&figures.answer_us), "none");
    for us in [3, 5, 40, 70, 12_000] {
        figures.note_answer_us(us);
    }
    let words = spread_of(&figures.answer_us);
    assert!(words.starts_with("p50 40, p90 12"), "{words}");
    assert!(words.ends_with("(<10: 2, <50: 1, <100: 1, <100000: 1)"), "{words}");
}

/// Keeps what comes.
#[derive(Default)]
struct Kept {
    news: Vec<News>,
    looks: u32,
}

impl Observer for Kept {
    fn news(&mut self, news: &News) {
        self.news.push(news.clone());
    }

    fn look(&mut self, _: Instant, _: &Running) {
        self.looks += 1;
    }
}

/// A session on a socket, with what `stop_at` and `stopped` end it by.
fn session(stopped: bool, stop_at: Option<Instant>) -> (Kept, Finished) {
    use nix::sys::socket::{AddressFamily, SockFlag, SockType, socketpair};
    let (ours, _theirs) = socketpair(AddressFamily::Unix, SockType::SeqPacket, None, SockFlag::SOCK_NONBLOCK).unwrap();
    let (own, peer) = (A, B);
    let setup = Setup {
        interface: "a socket".into(),
        mac: Some(own),
        peers: vec![peer],
        request: Request::new(1, 100.0),
        own_index: 0,
        key: None,
    };
    let monitor = crate::monitor::Monitor::over(ours, own, &setup.options()).unwrap();
    let tdma = Tdma::new(&config(A, B)).unwrap();
    let opened =
        Opened { tdma, monitor, own, key: None, heard: super::peer_sessions::PeerSessions::default(), warning: None };
    let (stop, end) = std::io::pipe().unwrap();
    let end = Some(end).filter(|_| !stopped);
    let mut kept = Kept::default();
    let session = Session::new(crate::wait::Monotonic::new(), std::os::fd::AsFd::as_fd(&stop))
        .with_settings(Settings { fifo_priority: None, ..Settings::default() })
        .with_stop_at(stop_at);
    let finished = session.run(opened, DriverMessages::none(), &mut kept).unwrap();
    drop(end);
    (kept, finished)
}

#[test]
fn a_session_ends_when_it_is_stopped_and_when_its_time_is_up() {
    for (kept, finished) in [session(true, None), session(false, Some(Instant::ZERO))] {
        assert!(matches!(kept.news[..], [News::Started(_), ..]), "{:?}", kept.news);
        assert!(kept.looks > 0 && finished.error.is_none() && finished.log.is_none());
        assert_eq!((finished.sent(), finished.confirmed(), finished.news_lost), (0, 0, 0));
        assert!(!finished.lost_anything());
    }
}
