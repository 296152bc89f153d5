//! Hostile air: random, crafted and replayed frames neither stop the exchange nor make a pair that was not sounded
//! (the air checks every pair that is reported).

use super::air::{Air, everybody, mac};
use csi5300::exchange::tdma::{Dialect, Event, Key, Request, Tdma};
use csi5300::time::{Instant, Span};
use csi5300_sim::random::Stream;
use driver_iface::sounding::native::Role;
use proptest::prelude::*;

/// What a stranger makes of a frame overheard.
fn forge(original: &[u8], dice: &mut Stream) -> Vec<u8> {
    let mut bytes = original.to_vec();
    let mut put = |at: usize, len: usize, dice: &mut Stream| {
        bytes.iter_mut().skip(at).take(len).for_each(|byte| *byte = dice.bits() as u8);
    };
    match dice.below(12) {
        0 => return (0..dice.below(200)).map(|_| dice.bits() as u8).collect(),
        1 => bytes.truncate(dice.below(180) as usize),
        2 => bytes.extend((0..dice.below(90)).map(|_| 0)),
        3 => bytes[32] ^= 1,                                               // the other role
        4 => put(24, 4, dice),                                             // number
        5 => put(46, 8, dice),                                             // sessions
        6 => put(54, 4, dice),                                             // turn
        7 => put(58, 10, dice),                                            // left and slot
        8 => put(68, 6, dice),                                             // plan
        9 => put(40, 6, dice),                                             // next
        10 => bytes[57] = bytes[57].wrapping_add(1 + dice.below(9) as u8), // a turn or a few later
        _ => {
            let (at, bit) = (dice.below(bytes.len() as u64) as usize, dice.below(8));
            // Without a key, a stranger that hits upon the number in time is not found out.
            if !(24..28).contains(&at) {
                bytes[at] ^= 1 << bit;
            }
        }
    }
    bytes
}

/// An adversary that forges from frames that are at least `age_us` old, as often as others send.
fn adversary(age_us: i64, dice_seed: u64) -> super::air::Adversary {
    let mut heard: Vec<(i64, Vec<u8>)> = Vec::new();
    let mut dice = Stream::of_seed(dice_seed);
    Box::new(move |now_us, bytes, _| {
        heard.push((now_us, bytes.to_vec()));
        let old = heard.iter().take_while(|(at, _)| *at + age_us <= now_us).count() as u64;
        if old == 0 {
            return Vec::new();
        }
        // Mostly recent ones: their turns and numbers are the most plausible.
        let at = old - 1 - dice.below(old.min(40));
        let original = heard[at as usize].1.clone();
        let frame = if dice.happens(0.3) { original } else { forge(&original, &mut dice) };
        if heard.len() > 1_000 {
            heard.drain(..500);
        }
        vec![(dice.below(1_000) as i64, frame)]
    })
}

/// One link for all, authenticated.
pub(super) fn one_link() -> Request {
    let mut request = request(true);
    request.links = 1;
    request
}

/// Three links, 200 rounds a second, answers with measurements.
pub(super) fn request(authenticated: bool) -> Request {
    Request::new(3, 200.0).with_dialect(Dialect::Native { measurement: true, authenticated })
}

#[test]
fn a_stranger_without_the_key_does_not_even_slow_the_exchange() {
    let key = Key::new(*b"0123456789abcdef");
    let mut configs = everybody(4, request(true));
    configs.iter_mut().for_each(|config| (config.key, config.patience_us) = (Some(key.clone()), 0));
    for loss in [0.0, 0.3] {
        let pairs: Vec<u64> = [false, true]
            .map(|hostile| {
                let mut air = Air::new(&configs, 5);
                air.loss = loss;
                air.adversary = hostile.then(|| adversary(1_700, 3));
                air.run_s(60);
                assert_eq!((air.collisions, air.initiators()), (0, 1));
                let bad = |station: &super::air::Station| {
                    let counts = station.tdma.counts();
                    counts.unauthenticated + counts.replayed + counts.unmatched + counts.foreign
                };
                assert!(!hostile || air.stations.iter().all(|station| bad(station) > 20_000));
                air.pairs()
            })
            .to_vec();
        assert_eq!(pairs[0], pairs[1], "with and without a stranger, {loss} lost");
    }
}

#[test]
fn without_a_key_forgeries_cost_some_pairs_and_stop_nothing() {
    let mut configs = everybody(4, request(false));
    configs.iter_mut().zip(1_700_000_000..).for_each(|(config, start)| config.session = start);
    let mut air = Air::new(&configs, 6);
    (air.loss, air.jitter_us) = (0.05, 30);
    air.adversary = Some(adversary(15_000, 4)); // older than answers are waited for
    let mut last = 0;
    for minute in 0..5 {
        air.run_s(60);
        let pairs = air.pairs() - last;
        last += pairs;
        let share = pairs as f64 / (600.0 * 60.0);
        println!("minute {minute}: {share:.3} of the slots answered");
        assert!(share > 0.8, "minute {minute}: {share} of the slots answered under as many forgeries as frames");
    }
    air.adversary = None;
    air.run_s(5);
    let before = (air.pairs(), air.collisions);
    air.run_s(10);
    assert_eq!(air.collisions, before.1, "the damage does not outlast the stranger");
    assert!(air.pairs() - before.0 > 5_200);
}

/// The `n`-th forward frame of robot `k`, which hears nothing, is switched on at `start` and waits for a short silence.
fn frame_of(k: usize, start: Instant, n: usize) -> (Instant, Vec<u8>) {
    let mut config = everybody(4, request(false))[k].clone();
    (config.start, config.silence_slots) = (start, 4);
    let mut tdma = Tdma::new(&config).unwrap();
    let mut frames = std::iter::repeat_with(|| {
        let now = tdma.poll_timeout().unwrap();
        tdma.poll_transmit(now).map(|sent| (now, sent.frame.to_vec()))
    });
    frames.by_ref().flatten().nth(n).unwrap()
}

#[test]
fn an_initiator_of_an_earlier_turn_is_believed_at_once_only_after_a_silence() {
    // Robot 0 had some fifty turns when it was heard; robot 1 begins with its first.
    let (at, late) = frame_of(0, Instant::ZERO, 2_000);
    for (pause_us, believed) in [(0, false), (1_000_000, true)] {
        let mut listener = Tdma::new(&everybody(4, request(false))[3].clone().with_initiate(false)).unwrap();
        listener.handle_heard(at, at, &late);
        assert_eq!(listener.initiator(), Some(mac(0)));
        let (then, early) = frame_of(1, at + Span::from_us(pause_us), 0);
        listener.handle_heard(then, then, &early);
        assert_eq!(listener.initiator(), Some(mac(usize::from(believed))), "a pause of {} us", (then - at).as_us());
    }
}

/// One step of a hostile driver.
#[derive(Clone, Debug)]
enum Step {
    Wait(i64),
    Hear(Vec<u8>),
    /// Hears something made of the `.0`-th last own or foreign frame.
    Forged(usize, u64),
    Toggle(bool),
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (-500i64..30_000).prop_map(Step::Wait),
        1 => (30_000i64..3_000_000).prop_map(Step::Wait),
        1 => proptest::collection::vec(any::<u8>(), 0..200).prop_map(Step::Hear),
        6 => (0usize..12, any::<u64>()).prop_map(|(at, seed)| Step::Forged(at, seed)),
        1 => any::<bool>().prop_map(Step::Toggle),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn nothing_heard_in_any_order_breaks_the_contract(
        steps in proptest::collection::vec(any_step(), 1..120),
        by_length: bool,
    ) {
        let dialect = if by_length { Dialect::Wsr { first_len: 57 } } else { request(false).dialect };
        let configs = everybody(4, request(false).with_dialect(dialect));
        let mut tdmas: Vec<Tdma> = configs.iter().take(2).map(|config| Tdma::new(config).unwrap()).collect();
        let mut frames: Vec<Vec<u8>> = vec![Vec::new()];
        let (mut now, mut sounded) = (Instant::ZERO, Vec::new());
        for step in steps {
            match &step {
                Step::Wait(us) => now += Span::from_us(*us),
                Step::Hear(bytes) => tdmas.iter_mut().for_each(|tdma| tdma.handle_heard(now, now, bytes)),
                Step::Forged(at, seed) => {
                    let original = frames[frames.len().saturating_sub(1 + at)].clone();
                    let bytes = if original.len() < 60 { original } else { forge(&original, &mut Stream::of_seed(*seed)) };
                    tdmas.iter_mut().for_each(|tdma| tdma.handle_heard(now, now, &bytes));
                }
                Step::Toggle(initiate) => tdmas[0].set_initiate(*initiate),
            }
            for tdma in &mut tdmas {
                while let Some(transmit) = tdma.poll_transmit(now) {
                    prop_assert!(transmit.at <= transmit.latest);
                    frames.push(transmit.frame.to_vec());
                    if transmit.role == Role::Forward {
                        sounded.push((transmit.peer, transmit.number));
                    }
                }
                if let Some(at) = tdma.poll_timeout() {
                    prop_assert!(at > now || tdma.counts().time_ran_back > 0);
                }
                while let Some(event) = tdma.poll_event() {
                    if let Event::Answered { peer, number, .. } = event {
                        prop_assert!(sounded.contains(&(peer, number)));
                        prop_assert!(peer != mac(9));
                    }
                }
            }
        }
    }
}
