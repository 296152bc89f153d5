use super::numbering::before_first_number;
use super::*;
use proptest::prelude::*;

fn run(receiver: &[(u32, u32)], transmitter: &[(u32, u32)]) -> (Vec<u32>, Pairing<u32>) {
    let mut pairing = Pairing::new(1_024);
    let (mut r, mut t) = (receiver.iter(), transmitter.iter());
    let mut numbers = Vec::new();
    loop {
        let side = pairing.behind();
        let next = match side {
            LinkSide::Receiver => {
                r.next().map(|n| (LinkSide::Receiver, n)).or_else(|| t.next().map(|n| (LinkSide::Transmitter, n)))
            }
            LinkSide::Transmitter => {
                t.next().map(|n| (LinkSide::Transmitter, n)).or_else(|| r.next().map(|n| (LinkSide::Receiver, n)))
            }
        };
        let Some((side, &(number, clock))) = next else { break };
        pairing.handle(side, number, clock, number);
        while let Some(pair) = pairing.poll_pair() {
            assert_eq!(pair.receiver, pair.transmitter);
            numbers.push(pair.number);
        }
    }
    pairing.finish();
    while let Some(pair) = pairing.poll_pair() {
        assert_eq!(pair.receiver, pair.transmitter);
        numbers.push(pair.number);
    }
    (numbers, pairing)
}

fn log(numbers: impl IntoIterator<Item = u32>, start_us: u32) -> Vec<(u32, u32)> {
    numbers.into_iter().enumerate().map(|(k, n)| (n, start_us.wrapping_add(10_000 * k as u32))).collect()
}

/// The same, with the clock tied to the number, so that missing numbers leave gaps in time.
fn timed(numbers: impl IntoIterator<Item = u32>, start_us: u32) -> Vec<(u32, u32)> {
    numbers.into_iter().map(|n| (n, start_us.wrapping_add(n.wrapping_mul(10_000)))).collect()
}

#[test]
fn loss_on_either_side_costs_only_those_numbers() {
    let (numbers, pairing) =
        run(&timed((1..100).filter(|n| n % 7 != 0), 5), &timed((1..120).filter(|n| n % 5 != 0), 900_000));
    assert_eq!(numbers, (1..100).filter(|n| n % 7 != 0 && n % 5 != 0).collect::<Vec<_>>());
    let counts = pairing.counts(LinkSide::Receiver);
    assert_eq!(counts.handed, counts.paired + counts.unpaired);
}

#[test]
fn restart_opens_a_session_and_old_numbers_do_not_pair_with_new_ones() {
    let r: Vec<_> = log((1..50).chain(1..30), 0);
    let t: Vec<_> = log((1..50).chain(1..30), 77);
    let (numbers, pairing) = run(&r, &t);
    assert_eq!(numbers.len(), 49 + 29);
    assert_eq!(pairing.counts(LinkSide::Receiver).restarts, 1);
    assert_eq!(pairing.counts(LinkSide::Receiver).duplicates, 0);
}

/// Numbers from 1, 10 ms apart, the sender's timer off by up to a millisecond.
fn session(count: u32, at_us: u32, salt: u32) -> impl Iterator<Item = (u32, u32)> {
    (1..=count).map(move |n| {
        let noise = ((n ^ (salt << 12)).wrapping_mul(0x9e37_79b9) ^ (n * 77)).wrapping_mul(0x85eb_ca6b) >> 22;
        (n, at_us.wrapping_add(n * 10_000 + noise))
    })
}

#[test]
fn card_clocks_identify_a_session_that_one_log_missed() {
    // The receiver logged three sessions; the transmitter missed the middle one, or all but the last.
    let starts = [0, 100_000_000, 200_000_000];
    let of = |k: usize| session(200, starts[k], k as u32);
    let r: Vec<_> = (0..3).flat_map(of).collect();
    let late = |k: usize| of(k).map(|(n, c)| (n, c + 250));
    let t: Vec<_> = late(0).chain(late(2)).collect();
    let (_, pairing) = run(&r, &t);
    let counts = pairing.counts(LinkSide::Receiver);
    assert_eq!((counts.paired, pairing.counts(LinkSide::Transmitter).paired), (400, 400), "{counts:?}");
    let (_, pairing) = run(&r, &late(2).collect::<Vec<_>>());
    assert_eq!(pairing.counts(LinkSide::Transmitter).paired, 200);
}

#[test]
fn pairs_continue_after_a_reset_of_a_card() {
    let r: Vec<_> =
        session(300, 0, 1).chain((301..=600).zip(session(300, 3_000_000, 2)).map(|(n, (_, c))| (n, c))).collect();
    let reset = |(n, c): (u32, u32)| (n, if n > 300 { c - 3_000_000 } else { c + 250 });
    let t: Vec<_> = r.iter().copied().map(reset).collect();
    let (numbers, _) = run(&r, &t);
    assert_eq!(numbers, (1..=600).collect::<Vec<_>>());
}

#[test]
fn one_altered_number_costs_one_pair() {
    for off in [33, 40, 1_000, 1 << 20, 1 << 22, 1 << 31, u32::MAX - 300] {
        let r = log(1..400, 0);
        let mut t = r.clone();
        t[200].0 = t[200].0.wrapping_add(off);
        let (numbers, pairing) = run(&r, &t);
        assert_eq!(numbers.len(), 398, "{off}: {:?}", pairing.counts(LinkSide::Transmitter));
        assert_eq!(pairing.counts(LinkSide::Transmitter).implausible, 1, "{off}");
    }
}

#[test]
fn a_long_gap_is_no_restart() {
    let kept = |n: &u32| !(100..400).contains(n);
    let (numbers, pairing) = run(&timed((1..600).filter(kept), 0), &timed(1..600, 70));
    assert_eq!(numbers.len(), 299);
    let counts = pairing.counts(LinkSide::Receiver);
    assert_eq!((counts.restarts, counts.missing), (0, 300));
}

#[test]
fn wrap_is_a_step_of_one_and_noise_in_the_counter_is_dropped() {
    let around = |k: u32| u32::MAX.wrapping_sub(20).wrapping_add(k);
    let r = log((0..50).map(around), 0);
    let mut t = r.clone();
    t.insert(25, (0x1f3d_5b79, 250_001));
    let (numbers, pairing) = run(&r, &t);
    assert_eq!(numbers.len(), 50);
    assert_eq!(pairing.counts(LinkSide::Transmitter).implausible, 1);
    assert_eq!(pairing.counts(LinkSide::Receiver).restarts, 0);
}

#[test]
fn duplicates_keep_the_first_and_are_counted() {
    let mut r = log(1..100, 0);
    r.insert(40, r[39]);
    r.insert(60, r[58]);
    let (numbers, pairing) = run(&r, &log(1..100, 0));
    assert_eq!(numbers, (1..100).collect::<Vec<_>>());
    assert_eq!(pairing.counts(LinkSide::Receiver).duplicates, 2);
}

proptest! {
    #[test]
    fn nothing_panics_and_the_books_balance(
        r in prop::collection::vec((any::<u32>(), any::<u32>()), 0..200),
        t in prop::collection::vec((0..50u32, 0..1_000u32), 0..200),
    ) {
        let (numbers, pairing) = run(&r, &t);
        for side in [LinkSide::Receiver, LinkSide::Transmitter] {
            let c = pairing.counts(side);
            prop_assert_eq!(c.handed, c.paired + c.unpaired + c.duplicates + c.implausible + c.mispaired);
            prop_assert_eq!(c.paired, numbers.len() as u64);
        }
    }
}

/// The logs of two robots that initiate in turns of `slots` slots: what both logs hold of the link, each record with
/// its exchange as its item. `lost(side, exchange)` is not in that log.
fn in_turns(
    slots: u32,
    exchanges: u32,
    first: [u32; 2],
    lost: impl Fn(LinkSide, u32) -> bool,
) -> [Vec<(u32, u32, u32)>; 2] {
    let mut next = first;
    let (mut receiver, mut transmitter) = (Vec::new(), Vec::new());
    for exchange in 0..exchanges {
        let initiator = (exchange / slots % 2) as usize;
        let number = next[initiator];
        next[initiator] = number.wrapping_add(1);
        // 300 us of turn-around, before or after the other's clock, and some jitter.
        let at = exchange * 5_000 + (exchange.wrapping_mul(0x9e37_79b9) >> 28);
        let (rx, tx) = if initiator == 0 { (at + 300, at) } else { (at, at + 300) };
        if !lost(LinkSide::Receiver, exchange) {
            receiver.push((number, rx, exchange));
        }
        if !lost(LinkSide::Transmitter, exchange) {
            transmitter.push((number, tx.wrapping_sub(77_000), exchange));
        }
    }
    [receiver, transmitter]
}

/// Pairs, and those of which the two frames are not of one exchange.
fn pair_in_turns([receiver, transmitter]: &[Vec<(u32, u32, u32)>; 2]) -> (usize, usize, Pairing<u32>) {
    let mut pairing = Pairing::new(1_024);
    let (mut r, mut t) = (receiver.iter(), transmitter.iter());
    let (mut pairs, mut wrong) = (0, 0);
    let mut ended = false;
    while !ended {
        let next = match pairing.behind() {
            LinkSide::Receiver => {
                r.next().map(|n| (LinkSide::Receiver, n)).or_else(|| t.next().map(|n| (LinkSide::Transmitter, n)))
            }
            LinkSide::Transmitter => {
                t.next().map(|n| (LinkSide::Transmitter, n)).or_else(|| r.next().map(|n| (LinkSide::Receiver, n)))
            }
        };
        match next {
            Some((side, &(number, clock, exchange))) => pairing.handle(side, number, clock, exchange),
            None => {
                pairing.finish();
                ended = true;
            }
        }
        while let Some(pair) = pairing.poll_pair() {
            pairs += 1;
            wrong += usize::from(pair.receiver != pair.transmitter);
        }
    }
    (pairs, wrong, pairing)
}

#[test]
fn where_both_robots_initiate_every_exchange_is_one_pair() {
    let apart = [before_first_number(0, 2) + 1, before_first_number(1, 2) + 1];
    for slots in [1, 2, 7, 32, 5_000] {
        let (pairs, wrong, pairing) = pair_in_turns(&in_turns(slots, 20_000, apart, |_, _| false));
        let counts = pairing.counts(LinkSide::Receiver);
        assert_eq!((pairs, wrong), (20_000, 0), "{slots} slots: {counts:?}");
        assert_eq!((counts.restarts, counts.missing), (1, 0), "{slots} slots");
    }
}

#[test]
fn losses_and_restarts_of_two_initiators_make_no_wrong_pair() {
    let dice = |side: LinkSide, exchange: u32| {
        let salt = if side == LinkSide::Receiver { 1 } else { 2 };
        (exchange ^ salt << 20).wrapping_mul(0x85eb_ca6b) >> 24
    };
    let apart = [before_first_number(0, 2) + 1, before_first_number(1, 2) + 1];
    for slots in [1, 4, 32] {
        // A fifth of the records is lost, whole turns among them, and the second robot restarts half-way.
        let lost = |side: LinkSide, exchange: u32| dice(side, exchange) < 51 || dice(side, exchange / 50 + 9_000) < 4;
        let [mut r, mut t] = in_turns(slots, 10_000, apart, lost);
        let both = r.iter().filter(|one| t.iter().any(|other| other.2 == one.2)).count();
        let (pairs, wrong, pairing) = pair_in_turns(&[r.clone(), t.clone()]);
        let counts = pairing.counts(LinkSide::Receiver);
        assert_eq!(wrong, 0, "{slots} slots");
        assert!(pairs + 8 >= both, "{slots} slots: {pairs} of {both}: {counts:?}");
        for log in [&mut r, &mut t] {
            for one in log.iter_mut().filter(|one| one.2 >= 5_000 && one.0 >= apart[1]) {
                one.0 -= 2_500;
            }
        }
        let (pairs, wrong, _) = pair_in_turns(&[r, t]);
        assert_eq!(wrong, 0, "{slots} slots, restarted");
        assert!(pairs + 16 >= both, "{slots} slots, restarted: {pairs} of {both}");
    }
}

#[test]
fn counts_that_begin_together_cost_pairs_and_make_no_wrong_ones() {
    for slots in [1, 32, 100] {
        let (pairs, wrong, pairing) = pair_in_turns(&in_turns(slots, 10_000, [1, 1], |_, _| false));
        assert_eq!(wrong, 0, "{slots} slots: {:?}", pairing.counts(LinkSide::Receiver));
        assert!(pairs >= 4_000, "{slots} slots: {pairs}");
    }
}

#[test]
fn a_third_robots_count_in_one_log_delays_no_pair() {
    // The receiver's log also has what the transmitter answers a third robot; the transmitter's has not.
    let count = |from: u32| (0..20_000).map(move |k| (from + k, 10_000 * k));
    let third = before_first_number(2, 3) + 1;
    let r: Vec<_> = count(1).zip(count(third)).flat_map(|((n, c), (m, _))| [(n, c), (m, c + 5_000)]).collect();
    let (numbers, pairing) = run(&r, &count(1).map(|(n, c)| (n, c + 70)).collect::<Vec<_>>());
    assert_eq!(numbers.len(), 20_000, "{:?}", pairing.counts(LinkSide::Receiver));
}

#[test]
fn counts_of_many_robots_begin_far_apart() {
    for robots in [1, 2, 3, 12, 256] {
        let numbers: Vec<u32> = (0..robots as u16).map(|rank| before_first_number(rank, robots)).collect();
        assert_eq!(numbers[0], 0);
        assert!(numbers.windows(2).all(|two| two[1] - two[0] >= 1 << 23), "{numbers:?}");
    }
}

#[test]
fn logs_too_short_to_understand_their_clocks_give_their_pairs_at_the_end() {
    for pairs in 1..5 {
        let (numbers, _) = run(&log(1..=pairs, 7), &log(1..=pairs, 900));
        assert_eq!(numbers, (1..=pairs).collect::<Vec<_>>());
    }
}

#[test]
fn a_single_pair_with_other_clocks_is_refused_once_they_are_known() {
    let (mut r, mut t) = (log(1..50, 0), log(1..50, 77));
    r.push((50, 490_000));
    t.push((50, 10_490_000));
    let (numbers, pairing) = run(&r, &t);
    assert_eq!(numbers, (1..50).collect::<Vec<_>>());
    for side in [LinkSide::Receiver, LinkSide::Transmitter] {
        assert_eq!((pairing.counts(side).mispaired, pairing.counts(side).unpaired), (1, 0), "{side:?}");
    }
}

#[test]
fn clocks_of_pairs_go_on_over_their_wrap_and_a_pause() {
    let start = u32::MAX - 1_000_000;
    // 10 ms apart, then a pause of 1,000 s in which the clocks part by 100 ppm.
    let at = |n: u32| n * 10_000 + if n > 300 { 1_000_000_000 } else { 0 };
    let parted = |n: u32| if n > 300 { 100_000 } else { 0 };
    let mut pairing = Pairing::new(1_024);
    for n in 1..=400_u32 {
        pairing.handle(LinkSide::Receiver, n, start.wrapping_add(at(n)), n);
        pairing.handle(LinkSide::Transmitter, n, start.wrapping_add(at(n) + 77 + parted(n)), n);
    }
    let mut first = None;
    let mut pairs = 0;
    while let Some(pair) = pairing.poll_pair() {
        let (rx, difference) = *first.get_or_insert((pair.clock_rx_us - i64::from(at(pair.number)), 77));
        assert_eq!(pair.clock_rx_us - i64::from(at(pair.number)), rx, "{}", pair.number);
        assert_eq!(pair.clock_difference_us, difference + i64::from(parted(pair.number)), "{}", pair.number);
        pairs += 1;
    }
    assert_eq!(pairs, 400);
}

#[test]
fn the_log_that_is_behind_is_read_next() {
    use LinkSide::{Receiver, Transmitter};
    let behind = |records: &[(LinkSide, u32)]| {
        let mut pairing = Pairing::new(64);
        records.iter().for_each(|(side, number)| pairing.handle(*side, *number, 0, ()));
        pairing.behind()
    };
    assert_eq!(behind(&[]), Receiver);
    assert_eq!(behind(&[(Receiver, 1)]), Transmitter);
    assert_eq!(behind(&[(Transmitter, 1)]), Receiver);
    assert_eq!(behind(&[(Receiver, 9), (Transmitter, 8)]), Transmitter);
    assert_eq!(behind(&[(Receiver, 8), (Transmitter, 9)]), Receiver);
    // At the same number, however many records were handed in.
    assert_eq!(behind(&[(Receiver, 8), (Receiver, 8), (Transmitter, 8)]), Receiver);
    // Counts that have nothing to do with each other: by records.
    assert_eq!(behind(&[(Receiver, 1), (Transmitter, 1 << 24)]), Receiver);
    assert_eq!(behind(&[(Receiver, 1), (Receiver, 2), (Transmitter, 1 << 24)]), Transmitter);
    // The receiver's newest record is of a count that the other log has not.
    let third = 1 << 24;
    let ahead = [(Receiver, 1), (Receiver, third), (Receiver, third + 1)];
    assert_eq!(behind(&[&ahead[..], &[(Transmitter, 1); 9]].concat()), Transmitter);
    // One restarted: it is ahead, though its numbers are lower.
    let again = (40..60).chain([1, 2]).map(|number| (Receiver, number));
    let still = (40..50).map(|number| (Transmitter, number));
    assert_eq!(behind(&again.chain(still).collect::<Vec<_>>()), Transmitter);
    // Both begin anew: neither is ahead by that.
    let log = |side| (40..60).chain([1, 2]).map(move |number| (side, number));
    let anew: Vec<_> = log(Receiver).chain(log(Transmitter)).chain([(Receiver, 2)]).collect();
    assert_eq!(behind(&anew), Receiver);
}
