//! Tests of deadlines, measurements, counts and leaving.

use super::*;
use crate::exchange::tdma::{Epoch, Request};
use crate::time::Span;
use driver_iface::sounding::native::SUBCARRIERS;

fn mac(k: u8) -> Mac {
    Mac([2, 0x53, 0, 0, 0, k])
}

/// Two robots in slots of 10 ms, with a common clock; the first one initiates.
fn two(key: Option<Key>) -> [Tdma; 2] {
    [0, 1].map(|k| {
        let dialect = Dialect::Native { measurement: true, authenticated: key.is_some() };
        let request = Request::new(1, 100.0).with_dialect(dialect);
        let config = Config::new(mac(k), u16::from(k), &[mac(1 - k)], request, 1);
        let config = config.with_key(key.clone()).with_initiate(k == 0).with_epoch(Epoch::Common(Instant::ZERO));
        Tdma::new(&config).unwrap()
    })
}

/// The next forward frame: when, its number and its bytes.
fn forward(tdma: &mut Tdma) -> (Instant, u32, Vec<u8>) {
    loop {
        let now = tdma.poll_timeout().unwrap();
        if let Some(sent) = tdma.poll_transmit(now) {
            return (now, sent.number, sent.frame.to_vec());
        }
    }
}

fn measured(number: u32, timestamp_low: u32) -> Measurement {
    Measurement {
        number,
        timestamp_low,
        rx_antenna: 0,
        antenna_sel: 0,
        rssi: [33; 3],
        noise_dbm: -127,
        agc: 20,
        iq: [[1; 2]; SUBCARRIERS],
    }
}

#[test]
fn every_exchange_and_every_event_that_is_lost_is_counted() {
    let [mut first, mut second] = two(None);
    for count in 1..400 {
        let (now, _, frame) = forward(&mut first);
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).unwrap().frame.to_vec();
        first.handle_heard(now, now, &answer);
        assert_eq!(first.link_counts(mac(1)), Some(LinkCounts { sounded: count, answered: count }));
        assert_eq!((first.counts().heard, first.counts().answered, second.counts().replies), (count, count, count));
    }
    assert_eq!(
        (first.counts().time_ran_back, second.counts().time_ran_back),
        (0, 0),
        "the same time again is none before"
    );
    let kept = std::iter::from_fn(|| second.poll_event()).count() as u64;
    // It heard of the first robot once, and was asked 399 times.
    assert_eq!((kept, second.counts().events_lost), (256, 400 - 256));
}

#[test]
fn the_deadline_of_a_forward_frame_is_told_apart_from_others() {
    let [mut first, mut second] = two(None);
    assert_eq!(second.transmit_at(), None, "it does not initiate");
    let due = first.transmit_at();
    assert_eq!((due, first.poll_timeout()), (due, due));
    let (now, _, frame) = forward(&mut first);
    assert_eq!(Some(now), due);
    assert_eq!(first.transmit_at(), Some(now + Span::from_ms(10)));
    second.handle_heard(now, now, &frame);
    assert_eq!((second.poll_timeout(), second.transmit_at()), (Some(now), None), "an answer is no forward frame");
}

#[test]
fn a_follower_is_synchronised_by_the_first_frame() {
    let [mut first, second] = two(None);
    assert!(first.is_synchronised() && second.is_synchronised(), "a common epoch");
    let config = Config::new(mac(1), 1, &[mac(0)], Request::new(1, 100.0), 1);
    let mut heard = Tdma::new(&config).unwrap();
    assert!(!heard.is_synchronised());
    let (now, _, frame) = forward(&mut first);
    let later = now + Span::from_us(3_333);
    heard.handle_heard(later, later, &frame);
    assert!(heard.is_synchronised());
}

#[test]
fn a_leaving_robot_sends_nothing_and_waits_for_nothing() {
    let [mut first, mut second] = two(None);
    let (now, _, frame) = forward(&mut first);
    assert!(first.has_turn());
    first.leave();
    assert!(!first.has_turn());
    assert_eq!(first.transmit_at(), None);
    // Neither does one that was about to answer.
    second.handle_heard(now, now, &frame);
    second.leave();
    assert_eq!((second.poll_timeout(), second.poll_transmit(now)), (None, None));
    second.handle_heard(now, now, &frame);
    assert_eq!(second.poll_transmit(now), None);
}

#[test]
fn a_robot_without_links_never_takes_the_turn() {
    let mut config = Config::new(mac(0), 0, &[mac(1)], Request::new(1, 100.0), 1).with_initiate(true);
    assert!(Tdma::new(&config).unwrap().poll_timeout().is_some());
    config.links = Some(Vec::new());
    assert_eq!(Tdma::new(&config).unwrap().poll_timeout(), None);
}

#[test]
fn a_measurement_that_came_before_its_frame_goes_with_the_answer_to_it_only() {
    for (number, carried) in [(1, true), (2, false)] {
        let [mut first, mut second] = two(None);
        assert!(!second.set_measurement(mac(0), measured(number, 5)));
        let (now, sent, frame) = forward(&mut first);
        assert_eq!(sent, 1);
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).unwrap().frame.to_vec();
        first.handle_heard(now, now, &answer);
        let answered = std::iter::from_fn(|| first.poll_event()).find_map(|event| match event {
            Event::Answered { measurement, .. } => Some(measurement.map(|measurement| measurement.number)),
            _ => None,
        });
        assert_eq!(answered, Some(carried.then_some(number)));
    }
}

/// Hands over measurements as (number, clock), before or after the exchange of number 1. Returns the result of each,
/// the count of contested ones, and the number that the next answer carries.
fn handed_over(key: Option<Key>, before: &[(u32, u32)], behind: &[(u32, u32)]) -> (Vec<bool>, u64, Option<u32>) {
    let [mut first, mut second] = two(key);
    let mut said = Vec::new();
    let mut exchange = |first: &mut Tdma, second: &mut Tdma, handed: &[(u32, u32)]| {
        said.extend(handed.iter().map(|(number, clock)| second.set_measurement(mac(0), measured(*number, *clock))));
        let (now, _, frame) = forward(first);
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).unwrap().frame.to_vec();
        first.handle_heard(now, now, &answer);
    };
    exchange(&mut first, &mut second, before);
    while first.poll_event().is_some() {}
    exchange(&mut first, &mut second, behind);
    let carried = std::iter::from_fn(|| first.poll_event()).find_map(|event| match event {
        Event::Answered { measurement, .. } => measurement.map(|measurement| measurement.number),
        _ => None,
    });
    (said, second.counts().contested, carried)
}

#[test]
fn with_a_key_a_number_of_two_measurements_is_contested_and_neither_is_sent() {
    let key = || Some(Key::new([7; 16]));
    assert_eq!(handed_over(key(), &[], &[(1, 5)]), (vec![true], 0, Some(1)));
    assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 5)]), (vec![true, true], 0, Some(1)), "the same one again");
    assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 6)]), (vec![true, false], 1, None));
    assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 6), (1, 7)]), (vec![true, false, false], 2, None));
    assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 6), (1, 6)]), (vec![true, false, false], 2, None), "and again");
    assert_eq!(handed_over(key(), &[], &[(9, 5), (1, 6)]), (vec![false, true], 0, Some(1)), "of two numbers");
    // Before their frame: neither goes with its answer, nor with a later one.
    assert_eq!(handed_over(key(), &[(2, 5), (2, 6)], &[]), (vec![false, false], 1, None));
    // One that is taken back does not take another number's with it.
    assert_eq!(handed_over(key(), &[(2, 5)], &[(1, 6), (1, 7)]), (vec![false, true, false], 1, Some(2)));
    assert_eq!(handed_over(key(), &[], &[(1, 4), (9, 5), (9, 6)]), (vec![true, false, false], 1, Some(1)));
    // Without one nothing says whose frames they were of.
    assert_eq!(handed_over(None, &[], &[(1, 5), (1, 6)]), (vec![true, true], 0, Some(1)));
}
