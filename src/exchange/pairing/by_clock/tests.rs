use super::*;

/// xorshift: the same on every run.
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Self {
        Self((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    /// Between two values.
    fn between(&mut self, from: f64, to: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        from + (to - from) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn chance(&mut self, of: f64) -> bool {
        self.between(0.0, 1.0) < of
    }
}

/// What is exchanged, and how it is heard.
#[derive(Clone, Copy)]
struct Link {
    exchanges: usize,
    /// Mean pause, and how far it varies to both sides, us.
    pause_us: (f64, f64),
    lost: f64,
    drift: f64,
    clocks: [CardClock; 2],
    seed: u64,
}

const USUAL: Link = Link {
    exchanges: 1_500,
    pause_us: (10_000.0, 250.0),
    lost: 0.0,
    drift: 15e-6,
    clocks: [CardClock::INTEL_5300; 2],
    seed: 7,
};

/// Records of the two logs: ticks, and the exchange that they are of.
type Heard = [Vec<(u64, usize)>; 2];

impl Link {
    /// Frames at the ticks of a timer that come late by up to `pause_us.1`; answers after some tens of us, a tenth of them later.
    fn heard(self) -> Heard {
        let mut random = Random::new(self.seed);
        let offsets = [random.between(0.0, 4e9), random.between(0.0, 4e9)];
        let mut heard = [Vec::new(), Vec::new()];
        for k in 0..self.exchanges {
            let sent = k as f64 * self.pause_us.0 + random.between(-self.pause_us.1, self.pause_us.1);
            let much = if random.chance(0.1) { 250.0 } else { 30.0 };
            let late = random.between(0.0, much);
            for (side, at) in [(0, sent + 300.0 + late), (1, sent)] {
                if !random.chance(self.lost) {
                    let rate = if side == 1 { 1.0 + self.drift } else { 1.0 };
                    heard[side].push((ticks(self.clocks[side], (at + 1e6) * rate + offsets[side]), k));
                }
            }
        }
        heard
    }
}

/// A time as a card's clock shows it.
fn ticks(clock: CardClock, us: f64) -> u64 {
    let ticks = (us * 1e6 / f64::from(clock.tick_ps)) as u64;
    if clock.bits >= 64 { ticks } else { ticks & ((1 << clock.bits) - 1) }
}

/// Pairs found, wrong ones among them, and what was said of the clocks.
fn pair(link: &Link, heard: &Heard) -> Result<(usize, usize, Fit), Refusal> {
    let mut machine = ByClock::new(link.clocks[0], link.clocks[1]);
    for (side, records) in [LinkSide::Receiver, LinkSide::Transmitter].into_iter().zip(heard) {
        records.iter().for_each(|(ticks, exchange)| machine.handle(side, *ticks, None, *exchange));
    }
    let fit = machine.finish()?;
    let pairs: Vec<Pair<usize>> = std::iter::from_fn(|| machine.poll_pair()).collect();
    assert!(pairs.iter().zip(0..).all(|(pair, number)| pair.number == number));
    assert!(pairs.windows(2).all(|two| two[0].clock_rx_us < two[1].clock_rx_us));
    for side in [LinkSide::Receiver, LinkSide::Transmitter] {
        let counts = machine.counts(side);
        assert_eq!(counts.handed, counts.paired + counts.unpaired + counts.twice + counts.ambiguous, "{counts:?}");
        assert_eq!(counts.paired, pairs.len());
    }
    Ok((pairs.len(), pairs.iter().filter(|pair| pair.receiver != pair.transmitter).count(), fit))
}

/// Exchanges that are in both logs.
fn common(heard: &Heard) -> usize {
    heard[0].iter().filter(|(_, k)| heard[1].iter().any(|(_, other)| other == k)).count()
}

#[test]
fn exchanges_are_found_whatever_the_clocks_and_however_many_are_lost() {
    let wide = (20_000.0, 8_000.0);
    for (name, link) in [
        ("usual", USUAL),
        ("30 % lost on each side", Link { lost: 0.3, ..USUAL }),
        ("100 ppm", Link { drift: 100e-6, ..USUAL }),
        ("-100 ppm, 30 % lost", Link { drift: -100e-6, lost: 0.3, ..USUAL }),
        ("FTM clocks, that wrap every 13.4 s", Link { clocks: [CardClock::FTM; 2], exchanges: 4_000, ..USUAL }),
        ("two kinds of clocks", Link { clocks: [CardClock::FTM, CardClock::INTEL_5300], lost: 0.2, ..USUAL }),
        ("irregular, few", Link { exchanges: 80, pause_us: wide, ..USUAL }),
        ("irregular, many lost", Link { exchanges: 400, pause_us: wide, lost: 0.3, drift: 60e-6, ..USUAL }),
        ("4 ms", Link { pause_us: (4_000.0, 150.0), exchanges: 900, ..USUAL }),
    ] {
        for seed in 0..3 {
            let link = Link { seed, ..link };
            let heard = link.heard();
            let (found, wrong, fit) = pair(&link, &heard).unwrap_or_else(|why| panic!("{name}, seed {seed}: {why}"));
            let common = common(&heard);
            assert!(found as f64 >= 0.995 * common as f64 && wrong == 0, "{name}: {found} of {common}, {wrong} wrong");
            // Two bins over the stretch that was aligned.
            let error_ppm = 20e6 / (link.pause_us.0 * link.exchanges.min(STRETCH) as f64);
            assert!((fit.drift_ppm - 1e6 * link.drift).abs() < error_ppm, "{name}: {fit:?}");
        }
    }
}

#[test]
fn logs_of_two_runs_are_refused_and_so_is_a_rate_without_any_variation() {
    for seed in 0..4 {
        let [own, _] = Link { seed, ..USUAL }.heard();
        let [_, other] = Link { seed: seed + 100, ..USUAL }.heard();
        assert!(matches!(pair(&USUAL, &[own, other]), Err(Refusal::Strangers { .. })), "seed {seed}");
        let regular = Link { pause_us: (10_000.0, 2.0), seed, ..USUAL };
        let Err(Refusal::TooRegular { period_us }) = pair(&regular, &regular.heard()) else { panic!("seed {seed}") };
        assert!((period_us - 10_000.0).abs() < 30.0);
    }
    let few = Link { exchanges: 20, ..USUAL };
    assert_eq!(pair(&few, &few.heard()), Err(Refusal::TooFew { receiver: 20, transmitter: 20 }));
}

#[test]
fn hosts_that_agree_settle_a_regular_rate() {
    let link = Link { pause_us: (10_000.0, 2.0), ..USUAL };
    let [rx, tx] = link.heard();
    let mut machine = ByClock::new(link.clocks[0], link.clocks[1]).with_hosts_within(Some(4_000));
    let host = |k: usize, ahead: i64| Some(1_700_000_000_000_000 + 10_000 * k as i64 + ahead);
    rx.iter().for_each(|(ticks, k)| machine.handle(LinkSide::Receiver, *ticks, host(*k, 900), *k));
    tx.iter().for_each(|(ticks, k)| machine.handle(LinkSide::Transmitter, *ticks, host(*k, 0), *k));
    assert!(machine.finish().unwrap().by_hosts);
    let mut pairs = std::iter::from_fn(|| machine.poll_pair());
    assert!(pairs.next().is_some() && pairs.all(|pair| pair.receiver == pair.transmitter));
}

#[test]
fn a_set_clock_splits_a_log_and_loses_nothing_else() {
    let mut heard = USUAL.heard();
    // The transmitter's card restarts in the middle.
    let at = heard[1].len() / 2;
    let from = heard[1][at].0 - 5_000;
    heard[1][at..].iter_mut().for_each(|(ticks, _)| *ticks = ticks.wrapping_sub(from) & 0xffff_ffff);
    let (found, wrong, _) = pair(&USUAL, &heard).unwrap();
    assert!(found >= USUAL.exchanges - 8 && wrong == 0, "{found}, {wrong} wrong");
}

#[test]
fn frames_of_others_and_frames_that_are_reported_twice_take_no_partner() {
    let heard = USUAL.heard();
    let mut random = Random::new(1);
    // The transmitter also hears what the receiver sends to a third robot, some 5 ms after each; some records come twice.
    let mut tx: Vec<(u64, usize)> = Vec::new();
    for &(ticks, k) in &heard[1] {
        tx.push((ticks, k));
        if k % 10 == 0 {
            tx.push((ticks + 40, usize::MAX));
        }
        if random.chance(0.6) {
            tx.push((ticks + 5_000 + random.between(0.0, 200.0) as u64, usize::MAX));
        }
    }
    let (found, wrong, _) = pair(&USUAL, &[heard[0].clone(), tx]).unwrap();
    assert!(found as f64 >= 0.995 * USUAL.exchanges as f64 && wrong == 0, "{found}, {wrong} wrong");
}

#[test]
fn a_log_that_covers_a_part_of_the_other_is_paired_there() {
    let heard = USUAL.heard();
    let part = heard[1][900..].to_vec();
    let (found, wrong, _) = pair(&USUAL, &[heard[0].clone(), part]).unwrap();
    assert_eq!((found, wrong), (600, 0));
}

/// The same as records come, the transmitter's `late` of them behind: pairs, and wrong ones.
fn pair_live(link: &Link, heard: &Heard, late: usize) -> (Vec<(usize, usize)>, Live<usize>) {
    let mut machine = Live::new(link.clocks[0], link.clocks[1]);
    let [rx, tx] = heard;
    let mut pairs = Vec::new();
    let mut records = |machine: &mut Live<usize>, side, record: Option<&(u64, usize)>| {
        record.into_iter().for_each(|(ticks, exchange)| machine.handle(side, *ticks, *exchange));
        pairs.extend(std::iter::from_fn(|| machine.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)));
    };
    let (mut i, mut j) = (0, 0);
    while i < rx.len() || j < tx.len() {
        let own_is_next = rx.get(i).is_some_and(|(_, k)| tx.get(j).is_none_or(|(_, other)| *k < other + late));
        if own_is_next {
            records(&mut machine, LinkSide::Receiver, rx.get(i));
            i += 1;
        } else {
            records(&mut machine, LinkSide::Transmitter, tx.get(j));
            j += 1;
        }
    }
    machine.finish();
    records(&mut machine, LinkSide::Receiver, None);
    for side in [LinkSide::Receiver, LinkSide::Transmitter] {
        let counts = machine.counts(side);
        assert_eq!(counts.handed, counts.paired + counts.unpaired + counts.twice + counts.ambiguous, "{counts:?}");
        assert_eq!(counts.paired, pairs.len());
    }
    (pairs, machine)
}

fn wrong(pairs: &[(usize, usize)]) -> usize {
    pairs.iter().filter(|(a, b)| a != b).count()
}

#[test]
fn records_are_paired_as_they_come_as_in_whole_logs() {
    let wide = (20_000.0, 8_000.0);
    for (name, link) in [
        ("usual", USUAL),
        ("30 % lost on each side", Link { lost: 0.3, ..USUAL }),
        ("100 ppm, 30 % lost, many", Link { drift: 100e-6, lost: 0.3, exchanges: 9_000, ..USUAL }),
        ("FTM clocks, that wrap every 13.4 s", Link { clocks: [CardClock::FTM; 2], exchanges: 4_000, ..USUAL }),
        ("irregular, many lost", Link { exchanges: 400, pause_us: wide, lost: 0.3, drift: 60e-6, ..USUAL }),
    ] {
        for (seed, late) in [(0, 0), (1, 1), (2, 150)] {
            let link = Link { seed, ..link };
            let heard = link.heard();
            let mut whole = ByClock::new(link.clocks[0], link.clocks[1]);
            for (side, records) in [LinkSide::Receiver, LinkSide::Transmitter].into_iter().zip(&heard) {
                records.iter().for_each(|(ticks, exchange)| whole.handle(side, *ticks, None, *exchange));
            }
            whole.finish().unwrap();
            let whole: Vec<(usize, usize)> =
                std::iter::from_fn(|| whole.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)).collect();
            let (live, _) = pair_live(&link, &heard, late);
            assert_eq!(live, whole, "{name}, seed {seed}");
        }
    }
}

#[test]
fn a_pair_comes_with_the_next_exchange_once_the_clocks_are_understood() {
    let [rx, tx] = USUAL.heard();
    let mut machine = Live::new(USUAL.clocks[0], USUAL.clocks[1]);
    let (mut first, mut newest) = (None, 0);
    for ((a, i), (b, j)) in rx.iter().zip(&tx) {
        machine.handle(LinkSide::Receiver, *a, *i);
        machine.handle(LinkSide::Transmitter, *b, *j);
        newest = std::iter::from_fn(|| machine.poll_pair()).map(|pair| pair.receiver).last().unwrap_or(newest);
        first = first.or((newest > 0).then_some(*i));
        assert!(first.is_none() || newest + 1 >= *i, "{newest} at {i}");
    }
    assert!(first.is_some_and(|first| first < 200), "{first:?}");
    assert!(machine.kept() <= WINDOW_KEPT);
}

/// Records of a side that may be in memory while clocks are understood and no side is behind.
const WINDOW_KEPT: usize = 2 * STRETCH + 2;

#[test]
fn either_card_may_restart_while_records_come_and_clocks_may_jump() {
    for (side, jump_us) in [(1, None), (0, None), (1, Some(7_003_000)), (0, Some(200_000_000))] {
        let mut heard = Link { exchanges: 3_000, ..USUAL }.heard();
        let at = heard[side].len() / 2;
        let from = heard[side][at].0 - 5_000;
        for (ticks, _) in &mut heard[side][at..] {
            *ticks = jump_us.map_or(ticks.wrapping_sub(from), |us| *ticks + us) & 0xffff_ffff;
        }
        let (pairs, machine) = pair_live(&USUAL, &heard, 0);
        assert_eq!(machine.restarts(), 1, "{side} {jump_us:?}");
        let wrong = wrong(&pairs);
        let most = if jump_us == Some(7_003_000) { 24 } else { 0 };
        assert!(pairs.len() >= 2_900 && wrong <= most, "{side} {jump_us:?}: {} pairs, {wrong} wrong", pairs.len());
    }
}

#[test]
fn records_of_two_runs_give_no_pairs_as_they_come_and_memory_is_bounded() {
    let [own, _] = Link { exchanges: 5_000, ..USUAL }.heard();
    let [_, other] = Link { exchanges: 5_000, seed: 107, ..USUAL }.heard();
    let (pairs, machine) = pair_live(&USUAL, &[own, other], 0);
    assert!(pairs.is_empty(), "{}", pairs.len());
    assert!(matches!(machine.refusal(), Some(Refusal::Strangers { .. })), "{:?}", machine.refusal());
    assert!(machine.kept() <= WINDOW_KEPT);
    // A feed that stops does not fill the memory either, and goes on where it comes back.
    let link = Link { exchanges: 9_000, ..USUAL };
    let [rx, tx] = link.heard();
    let stops: Vec<(u64, usize)> = tx.iter().filter(|(_, k)| !(2_000..2_900).contains(k)).copied().collect();
    let (pairs, machine) = pair_live(&link, &[rx, stops], 0);
    assert!(pairs.len() >= 8_000 && wrong(&pairs) == 0, "{} {}", pairs.len(), wrong(&pairs));
    assert!(machine.kept() <= WINDOW_KEPT, "{}", machine.kept());
}
