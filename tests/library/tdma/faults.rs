//! Join, leave, crash, restart, a lost turn, two initiators: each has its outcome.

use super::air::{Air, Skew, everybody, mac};
use csi5300::exchange::tdma::{Cause, Config, Dialect, Epoch, Event, Key, Request, Tdma};
use csi5300::internal::before_first_number;
use csi5300::time::Instant;

/// 3 robots at 100 rounds/s: slots of 5 ms, turns of 32 slots = 160 ms, silence of 64 slots = 320 ms.
const SILENCE_US: i64 = 320_000;

fn three() -> Vec<Config> {
    everybody(3, Request::new(2, 100.0))
}

/// Times of the events of robot `k` that `wanted` picks.
fn times(air: &Air, k: usize, wanted: impl Fn(&Event) -> bool) -> Vec<i64> {
    air.stations[k].events.iter().filter(|(_, event)| wanted(event)).map(|(at, _)| *at).collect()
}

fn began(cause: Cause) -> impl Fn(&Event) -> bool {
    move |event| matches!(event, Event::TurnBegan { cause: found, .. } if *found == cause)
}

#[test]
fn a_late_starter_is_heard_and_given_turns() {
    let configs = three();
    let mut air = Air::new(&configs, 1);
    air.loss = 0.2;
    air.crash(2);
    air.run_s(10);
    assert!(times(&air, 0, |event| *event == Event::Absent(mac(2))).len() == 1);
    let start_us = air.now_us;
    air.start(2, &configs[2]);
    air.run_s(10);
    let joined = times(&air, 0, |event| *event == Event::Joined(mac(2)));
    assert_eq!(joined.len(), 1);
    let first_turn = times(&air, 2, began(Cause::Passed));
    assert!(first_turn[0] - start_us < 2_000_000, "{} us until its first turn", first_turn[0] - start_us);
    assert_eq!(air.collisions, 0);
    assert!(times(&air, 2, began(Cause::Claimed)).is_empty());
}

#[test]
fn a_crashed_responder_is_absent_and_asked_rarely() {
    let mut configs = three();
    configs.iter_mut().skip(1).for_each(|config| config.initiate = false);
    let mut air = Air::new(&configs, 2);
    air.run_s(5);
    air.crash(1);
    let sounded = |air: &Air| air.stations[0].tdma.link_counts(mac(1)).unwrap().sounded;
    let before = sounded(&air);
    air.run_s(10);
    // 64 rounds until it is absent, then every eighth (priority 32 of 255) of the rest.
    let asked = sounded(&air) - before;
    assert!((64 + 100..64 + 135).contains(&asked), "{asked}");
    air.start(1, &configs[1].clone().with_session(2));
    let (before, answers) = (sounded(&air), air.stations[0].answered[1]);
    air.run_s(1);
    assert!(sounded(&air) - before >= 90);
    assert!(air.stations[0].answered[1] - answers >= 90);
    let restarted = Event::Restarted { peer: mac(1), session: 2 };
    assert_eq!(times(&air, 0, |event| *event == restarted).len(), 1);
}

#[test]
fn a_robot_that_leaves_during_its_turn_is_missed_for_a_silence_at_most_once() {
    let mut air = Air::new(&three(), 3);
    air.loss = 0.3;
    air.run_s(5);
    while !air.stations[1].tdma.has_turn() {
        air.run_us(1_000);
    }
    air.run_us(60_000);
    air.stations[1].tdma.leave();
    air.run_s(20);
    // Robots 0 and 2 go on between themselves: 100 rounds/s each while it has the turn.
    assert_eq!((air.collisions, air.initiators()), (0, 1));
    let lost = times(&air, 0, began(Cause::Claimed)).len() + times(&air, 2, began(Cause::Claimed)).len();
    let taken_back = times(&air, 0, began(Cause::TakenBack)).len() + times(&air, 2, began(Cause::TakenBack)).len();
    assert_eq!(lost, 1, "at the start only: who is next knew it, and went on at the announced end");
    assert!(taken_back <= 1, "it is given the turn once more at most: {taken_back}");
}

#[test]
fn a_crashed_initiator_is_replaced_within_the_claim_windows() {
    let mut air = Air::new(&three(), 4);
    air.loss = 0.4;
    for victim in [0, 1, 2] {
        air.run_s(5);
        while !air.stations[victim].tdma.has_turn() {
            air.run_us(1_000);
        }
        let crash_us = air.now_us;
        air.crash(victim);
        while air.initiators() == 0 {
            air.run_us(1_000);
        }
        // Two silences, and then one window of a silence for each of three robots.
        assert!(air.now_us - crash_us <= 5 * SILENCE_US + 50_000, "{} us", air.now_us - crash_us);
        let config = three()[victim].clone().with_session(2);
        air.start(victim, &config);
    }
    air.run_s(5);
    assert_eq!((air.collisions, air.initiators()), (0, 1));
}

#[test]
fn a_turn_that_nobody_takes_up_is_taken_back() {
    let mut air = Air::new(&three(), 5);
    air.run_s(5);
    while !air.stations[0].tdma.has_turn() {
        air.run_us(1_000);
    }
    air.run_us(100_000);
    air.crash(1); // who is next
    let before_us = air.now_us;
    air.run_s(5);
    let taken_back = times(&air, 0, began(Cause::TakenBack));
    assert_eq!(taken_back.len(), 1);
    assert!(taken_back[0] - before_us < 160_000 + SILENCE_US + 5_000);
    assert!(times(&air, 2, began(Cause::Passed)).iter().any(|at| *at > taken_back[0]), "the third is next instead");
    assert_eq!(air.collisions, 0);
}

#[test]
fn a_restart_begins_numbers_anew_under_another_session() {
    let configs = three();
    let mut air = Air::new(&configs, 6);
    air.run_s(10);
    let before = *air.stations[1].numbers.last().unwrap();
    assert!(before > 300);
    air.crash(1);
    air.run_us(1_234_567);
    air.stations[1].numbers.clear();
    air.start(1, &configs[1].clone().with_session(7));
    air.run_s(10);
    let numbers = &air.stations[1].numbers;
    assert_eq!(numbers[0], before_first_number(1, 3) + 1);
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "no loss: every number pairs, in order");
    for k in [0, 2] {
        let restarted = Event::Restarted { peer: mac(1), session: 7 };
        assert_eq!(times(&air, k, |event| *event == restarted).len(), 1);
    }
    assert_eq!(air.collisions, 0);
}

#[test]
fn of_two_initiators_at_once_one_yields_and_the_exchange_goes_on() {
    // Two cells that do not hear each other each have an initiator and an epoch of its own; then the wall falls.
    let (mut yields, mut overlaps) = (0, 0);
    for seed in 0..30 {
        let mut configs = everybody(4, Request::new(3, 250.0));
        let skews: Vec<Skew> = (0..4).map(|k| Skew { offset_us: 997 * k * (seed + 1), ppm: 10 * k }).collect();
        for (config, skew) in configs.iter_mut().zip(&skews) {
            config.epoch = Epoch::Heard(skew.local(0));
        }
        let mut air = Air::new(&configs, seed as u64);
        air.restart_with_skew(&configs, &skews);
        (air.loss, air.jitter_us) = (0.1, 30);
        air.cell = vec![0, 0, 1, 1];
        air.run_us(5_000_000 + 10_007 * seed);
        assert_eq!((air.initiators(), air.collisions), (2, 0), "seed {seed}");
        let heal_us = air.now_us;
        air.cell = vec![0; 4];
        air.run_s(20);
        let settled_us = air.last_collision_us.saturating_sub(heal_us);
        assert!(settled_us < 5_000_000, "seed {seed}: overlaps for {settled_us} us");
        overlaps += u64::from(air.collisions > 0);
        yields += air.stations.iter().map(|station| station.tdma.counts().yields).sum::<u64>();
        let before = air.pairs();
        air.run_s(10);
        let share = (air.pairs() - before) as f64 / 7_500.0;
        assert!((0.75..0.83).contains(&share), "seed {seed}: {share} of the slots answered, 0.81 get through");
    }
    assert!(yields >= 10 && overlaps >= 5, "{yields} yields, {overlaps} runs with overlaps: the rule was not tried");
}

#[test]
fn two_initiators_in_step_find_out_although_their_frames_destroy_each_other() {
    let mut configs = everybody(4, Request::new(3, 100.0));
    configs.iter_mut().skip(2).for_each(|config| config.initiate = false);
    let mut air = Air::new(&configs, 17);
    air.cell = vec![0, 1, 2, 3]; // until both have claimed the turn
    air.run_us(1_100_000);
    assert_eq!(air.initiators(), 2);
    air.cell = vec![0; 4];
    air.run_s(10);
    let (collisions, pairs) = (air.collisions, air.pairs());
    air.run_s(10);
    // Whether one yields to the other, or passes the turn to it on hearing that it wants it, is up to the pattern.
    assert!(collisions >= 20, "they were not in step: {collisions} overlaps");
    assert_eq!((air.collisions, air.initiators()), (collisions, 1));
    assert!(air.pairs() - pairs > 2_900);
}

#[test]
fn two_cold_starters_without_a_common_clock_end_up_with_one_initiator() {
    for seed in 0..20 {
        let mut configs = everybody(2, Request::new(1, 400.0));
        let skews = [Skew { offset_us: 0, ppm: 0 }, Skew { offset_us: 160_000 + 97 * seed as i64, ppm: 30 }];
        for (config, skew) in configs.iter_mut().zip(&skews) {
            config.epoch = Epoch::Heard(skew.local(0));
        }
        let mut air = Air::new(&configs, seed);
        air.restart_with_skew(&configs, &skews);
        air.jitter_us = 30;
        air.run_s(20);
        let (before, collisions) = (air.pairs(), air.collisions);
        air.run_s(10);
        assert!(air.pairs() - before > 3_900, "seed {seed}: {}", air.pairs() - before);
        assert_eq!(air.collisions, collisions, "seed {seed}");
    }
}

#[test]
fn a_driver_that_sleeps_through_its_turn_finds_it_gone() {
    let mut air = Air::new(&three(), 8);
    air.run_s(5);
    while !air.stations[2].tdma.has_turn() {
        air.run_us(1_000);
    }
    // Robot 2's driver is held up for 3 s; the others go on.
    air.crash(2);
    air.run_s(3);
    air.stations[2].on = true;
    air.run_s(5);
    assert_eq!(air.stations[2].tdma.counts().overslept, 1);
    assert_eq!((air.collisions, air.initiators()), (0, 1));
}

#[test]
fn a_turn_passed_on_is_not_given_up_to_its_successor() {
    // The successor's first frame comes before the driver of the robot whose turn is over has looked at its clock.
    let dialect = Dialect::Native { measurement: false, authenticated: true };
    let mut configs = everybody(2, Request::new(1, 100.0).with_dialect(dialect));
    configs.iter_mut().for_each(|config| config.key = Some(Key::new([1; 16])));
    let mut robots: Vec<Tdma> = configs.iter().map(|config| Tdma::new(config).unwrap()).collect();
    let mut now = Instant::ZERO;
    while now < Instant::from_us(30_000_000) {
        now = robots.iter().filter_map(Tdma::poll_timeout).min().unwrap().max(now);
        for k in [0, 1, 0] {
            while let Some(frame) = robots[k].poll_transmit(now).map(|transmit| transmit.frame.to_vec()) {
                robots[1 - k].handle_heard(now, now, &frame);
            }
        }
    }
    for robot in &robots {
        let counts = robot.counts();
        assert!(counts.turns > 40, "{counts:?}");
        assert_eq!((counts.yields, counts.rivals, counts.forward - counts.answered), (0, 0, 0), "{counts:?}");
    }
}

#[test]
fn time_that_runs_back_is_taken_as_standing_still() {
    let configs = three();
    let mut tdma = Tdma::new(&configs[0]).unwrap();
    let at = tdma.poll_timeout().unwrap();
    assert!(tdma.poll_transmit(at).is_some());
    assert_eq!(tdma.counts().time_ran_back, 0);
    assert!(tdma.poll_transmit(Instant::ZERO).is_none());
    assert_eq!(tdma.counts().time_ran_back, 1);
    assert!(tdma.poll_timeout().unwrap() > at);
}
