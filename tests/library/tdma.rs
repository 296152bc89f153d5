//! The scheduler on a virtual air: what plans promise is kept, lossy or not, for hours; join, leave, crash, restart, a lost turn, two
//! initiators; the golden table; the dialect of the WSR toolbox; hostile air; who is believed.

use crate::air::{Adversary, Air, Skew, Station, everybody, mac};
use csi5300::exchange::tdma::{Cause, Config, Dialect, Epoch, Event, Key, PlanError, Request, Tdma};
use csi5300::internal::before_first_number;
use csi5300::time::{Instant, Span};
use csi5300_sim::random::Stream;
use driver_iface::Mac;
use driver_iface::bfee::SUBCARRIERS;
use driver_iface::sounding::native::{self, Measurement};
use driver_iface::sounding::{Frame, wsr};
use std::fmt::Write;

/// One initiator and `peers` responders.
fn one_initiator(peers: usize, request: Request) -> Vec<Config> {
    let mut configs = everybody(peers + 1, request);
    configs.iter_mut().skip(1).for_each(|config| config.initiate = false);
    configs
}

#[test]
fn what_a_plan_promises_is_sounded_and_32_peers_get_the_rate_that_is_offered() {
    let Err(PlanError::Rate { highest_hz, .. }) = Tdma::new(&one_initiator(32, Request::new(32, 100.0))[0]) else {
        panic!("32 peers at 100 rounds/s cannot fit");
    };
    for (peers, rate_hz) in [(12, 100.0), (32, highest_hz)] {
        let mut air = Air::new(&one_initiator(peers, Request::new(peers as u16, rate_hz)), 1);
        air.jitter_us = 40;
        air.run_s(2);
        let before = air.stations[0].answered.clone();
        air.run_s(10);
        for (peer, (after, before)) in air.stations[0].answered.iter().zip(&before).enumerate().skip(1) {
            let off = (after - before) as f64 - 10.0 * rate_hz;
            assert!(off.abs() <= 1.0, "{off} answers of peer {peer} of {peers} too many in 10 s");
        }
        assert_eq!((air.collisions, air.stations[0].tdma.counts().missed_slots), (0, 0));
        assert!(air.stations.iter().all(|station| station.tdma.initiator() == Some(mac(0))));
    }
}

#[test]
fn any_number_of_robots_keeps_in_step_by_hearing_alone() {
    for n in [2usize, 3, 8, 16, 32] {
        let mut configs = everybody(n, Request::new(n as u16 - 1, 1_200.0 / n as f64));
        let skews: Vec<Skew> = (0..n as i64)
            .map(|k| Skew { offset_us: 1_000_003 * k * k - 7_000_000, ppm: (k * 37 % 101) - 50 })
            .collect();
        for (k, config) in configs.iter_mut().enumerate() {
            config.epoch = Epoch::Heard(skews[k].local(0));
            config.initiate = k == 0;
        }
        let mut air = Air::new(&configs, n as u64);
        air.restart_with_skew(&configs, &skews);
        // Eight hear each other well, and long enough to show who gets how much.
        (air.loss, air.jitter_us) = (if n == 8 { 0.1 } else { 0.4 }, 40);
        air.run_s(6);
        assert!(air.stations.iter().all(|station| station.tdma.is_synchronised()), "{n} robots");
        (0..n).for_each(|k| air.set_initiate(k, true));
        air.run_s(if n == 8 { 300 } else { 10 });
        let off: u64 = air.stations.iter().map(|station| station.tdma.counts().off_epoch).sum();
        assert_eq!(air.collisions, 0, "{n} robots");
        assert!(air.stations.iter().all(|station| station.tdma.counts().turns > 0), "{n} robots");
        assert!(n != 8 || off <= 1 && air.jain() > 0.97, "{off} off, {}", air.jain());
    }
}

#[test]
fn only_the_chosen_links_are_sounded() {
    let mut configs = one_initiator(4, Request::new(4, 100.0));
    configs[0].links = Some(vec![mac(3), mac(1), mac(4)]);
    let mut air = Air::new(&configs, 11);
    air.run_s(2);
    let before = air.stations[0].answered.clone();
    air.run_s(10);
    let answers: Vec<u64> = (0..5).map(|k| air.stations[0].answered[k] - before[k]).collect();
    assert_eq!(answers[2], 0);
    assert!([1, 3, 4].iter().all(|k| (999..=1_001).contains(&answers[*k])), "{answers:?}");
}

#[test]
fn an_initiator_is_heard_to_be_there_even_if_nobody_answers() {
    let mut configs = everybody(3, Request::new(2, 100.0));
    configs[2].initiate = false;
    configs.iter_mut().for_each(|config| config.respond = false);
    let mut air = Air::new(&configs, 12);
    // Until all are absent.
    air.run_s(4);
    let before: u64 = air.stations.iter().map(|station| station.tdma.counts().forward).sum();
    air.run_s(60);
    let sent = air.stations.iter().map(|station| station.tdma.counts().forward).sum::<u64>() - before;
    assert!((3_000..=4_500).contains(&sent), "a quarter of the slots, and some of the absent: {sent} of 12,000");
    assert_eq!(air.collisions, 0);
}

/// What a card measured of frame `number`.
fn measured(number: u32) -> Measurement {
    Measurement {
        number,
        timestamp_low: 77,
        rx_antenna: 2,
        antenna_sel: 0x24,
        rssi: [40, 41, 42],
        noise_dbm: -92,
        agc: 30,
        iq: [[-128, 127]; SUBCARRIERS],
    }
}

#[test]
fn answers_carry_only_measurements_of_frames_that_were_for_their_robot() {
    // A card reports every frame that it hears, whoever it is for, so many frames after it.
    for lag in 0..6 {
        let configs = one_initiator(2, Request::new(2, 100.0));
        let mut robots: Vec<Tdma> = configs.iter().map(|config| Tdma::new(config).unwrap()).collect();
        let (mut sounded, mut carried) = (Vec::new(), [0, 0, 0]);
        let mut now = Instant::ZERO;
        while sounded.len() < 200 {
            now = now.max(robots[0].poll_timeout().unwrap());
            let Some(transmit) = robots[0].poll_transmit(now) else { continue };
            let frame = transmit.frame.to_vec();
            sounded.push((transmit.number, transmit.peer));
            for k in [1, 2] {
                robots[k].handle_heard(now, now, &frame);
                let answer = robots[k].poll_transmit(now).map(|transmit| transmit.frame.to_vec());
                answer.iter().for_each(|answer| robots[0].handle_heard(now, now, answer));
                let reported = sounded.len().checked_sub(lag + 1).map(|at| sounded[at]);
                if let Some((number, peer)) = reported {
                    assert_eq!(robots[k].set_measurement(mac(0), measured(number)), peer == mac(k));
                }
            }
            while let Some(event) = robots[0].poll_event() {
                if let Event::Answered { peer, measurement: Some(measurement), .. } = event {
                    assert!(
                        sounded.contains(&(measurement.number, peer)),
                        "{} was not for {peer:?}",
                        measurement.number
                    );
                    carried[usize::from(peer == mac(2)) + 1] += 1;
                }
            }
        }
        assert!(carried[1] >= 95 && carried[2] >= 95, "{carried:?} of 100 each, reported {lag} frames later");
    }
}

#[test]
fn measurements_of_another_session_are_not_carried() {
    let configs = one_initiator(1, Request::new(1, 100.0));
    let mut second = Tdma::new(&configs[1]).unwrap();
    let mut carried = Vec::new();
    for session in [1, 2] {
        let mut first = Tdma::new(&Config { session, ..configs[0].clone() }).unwrap();
        let (now, frame) = loop {
            let now = first.poll_timeout().unwrap();
            if let Some(transmit) = first.poll_transmit(now) {
                break (now, transmit.frame.to_vec());
            }
        };
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).unwrap().frame.to_vec();
        carried.push(native::Repr::parse(&Frame::new_checked(&answer).unwrap()).unwrap().measurement);
        assert!(second.set_measurement(mac(0), measured(1)));
    }
    assert_eq!(carried, [None, None]);
}

#[test]
fn a_frame_that_was_not_sent_neither_counts_nor_waits() {
    let configs = one_initiator(1, Request::new(1, 100.0));
    let mut first = Tdma::new(&configs[0]).unwrap();
    let mut second = Tdma::new(&configs[1]).unwrap();
    let (mut given, mut now) = (0, Instant::ZERO);
    while given < 100 {
        now = now.max(first.poll_timeout().unwrap());
        let Some(transmit) = first.poll_transmit(now) else { continue };
        let (role, number, frame) = (transmit.role, transmit.number, transmit.frame.to_vec());
        given += 1;
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).map(|transmit| (transmit.role, transmit.number));
        if given % 4 == 0 {
            first.not_sent(role, number);
            first.not_sent(role, number);
            let (role, number) = answer.unwrap();
            second.not_sent(role, number);
        }
    }
    now = first.poll_timeout().unwrap().max(now + Span::from_ms(1_000));
    let _ = first.poll_transmit(now);
    let counts = first.counts();
    assert_eq!((counts.forward, first.link_counts(mac(1)).unwrap().sounded, counts.unanswered), (75, 75, 75));
    assert_eq!(second.counts().replies, 75);
}

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
    air.start(1, &Config { session: 2, ..configs[1].clone() });
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
    air.crash(1);
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
        let config = Config { session: 2, ..three()[victim].clone() };
        air.start(victim, &config);
    }
    air.run_s(5);
    assert_eq!((air.collisions, air.initiators()), (0, 1));
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
    air.start(1, &Config { session: 7, ..configs[1].clone() });
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
fn a_turn_passed_on_is_not_given_up_to_its_successor() {
    // The successor's first frame comes before the driver of the robot whose turn is over has looked at its clock.
    let dialect = Dialect::Native { measurement: false, authenticated: true };
    let mut configs = everybody(2, Request { dialect, ..Request::new(1, 100.0) });
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

/// All robots want the turn, all have the same epoch; the rate leaves a tenth of the channel free.
fn row(n: usize, loss_percent: u32, jitter_us: u64) -> String {
    let links = n as u16 - 1;
    let shortest_us = 700.0;
    let request = Request::new(links, 1e6 / (shortest_us * 1.1 * f64::from(links)));
    let mut air = Air::new(&everybody(n, request), 1_000 * n as u64 + 10 * u64::from(loss_percent) + jitter_us);
    (air.loss, air.jitter_us) = (f64::from(loss_percent) / 100.0, jitter_us);
    let plan = air.stations[0].tdma.plan();
    let cycle_us = plan.span_of(n as u32 * plan.turn_slots).as_us();
    air.run_us(cycle_us * (120 / n as i64).max(10));
    let total = |count: fn(&csi5300::exchange::tdma::TdmaCounts) -> u64| -> u64 {
        air.stations.iter().map(|station| count(station.tdma.counts())).sum()
    };
    assert_eq!(air.collisions, 0, "{n} robots, {loss_percent} % loss, {jitter_us} us jitter: frames overlapped");
    assert_eq!(total(|counts| counts.yields), 0, "{n} robots, {loss_percent} % loss: two initiators");
    // Counts that differ by chance only: s tries on each link, each a pair with probability q.
    let tries = (total(|counts| counts.forward) + total(|counts| counts.missed_slots)) as f64;
    let q = air.pairs() as f64 / tries;
    let chance = 1.0 / (1.0 + (1.0 - q) * (n * (n - 1)) as f64 / air.pairs() as f64);
    assert!(air.jain() > chance - 0.05, "{n} robots, {loss_percent} % loss: {} against {chance}", air.jain());
    format!(
        "{n:>6} {loss_percent:>6} {jitter_us:>9} {:>8} {:>8} {:>8} {:>7} {:>6} {:>10} {:.4} {chance:.4}",
        total(|counts| counts.forward),
        air.pairs(),
        total(|counts| counts.missed_slots),
        total(|counts| counts.missed_replies),
        total(|counts| counts.turns),
        air.collisions,
        air.jain()
    )
}

#[test]
fn the_golden_table_holds() {
    let mut table = String::from(
        "# Virtual air, synchronised robots that all sound all others; 120/robots cycles of turns, at\n\
         # least 10. Made by tests/library/tdma.rs. chance: Jain's index if links differ by chance only.\n\
         robots loss_% jitter_us  forward    pairs   missed replies  turns collisions   jain chance\n",
    );
    for n in [2, 3, 5, 8, 16, 32] {
        for loss_percent in [0, 20, 40, 60] {
            for jitter_us in [0, 50, 120] {
                writeln!(table, "{}", row(n, loss_percent, jitter_us)).unwrap();
            }
        }
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/tdma_golden.txt");
    if std::env::var_os("CSI5300_REGENERATE").is_some() {
        std::fs::write(&path, &table).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    for (now, kept) in table.lines().zip(kept.lines()) {
        assert_eq!(now, kept, "set CSI5300_REGENERATE if the change is meant");
    }
    assert_eq!(table.lines().count(), kept.lines().count());
}

fn wsr_request(links: u16, rate_hz: f64) -> Request {
    Request { dialect: Dialect::Wsr { first_len: 57 }, ..Request::new(links, rate_hz) }
}

/// What WSR's kernel driver does with `ack_len` (driver-interface: `check_and_send_ack`), written down again.
fn kernel_answer(mpdu: &[u8], ack_len: usize, own: Mac) -> Option<Vec<u8>> {
    let mut with_fcs = mpdu.to_vec();
    with_fcs.extend([0xde, 0xad, 0xbe, 0xef]);
    if with_fcs.len() != ack_len {
        return None;
    }
    with_fcs.push(0x55); // whatever was in the buffer
    with_fcs[16..22].copy_from_slice(&own.0);
    Some(with_fcs)
}

/// A frame of this number, and of this length with its checksum, from robot 200.
fn wsr_frame(number: u32, len_with_fcs: usize) -> Vec<u8> {
    let mut buffer = [0; 120];
    let repr = wsr::Repr { sender: mac(200), number, len_with_fcs };
    let len = repr.emit(&mut buffer, &mut wsr::Lfsr::default()).unwrap();
    buffer[..len].to_vec()
}

#[test]
fn three_kernel_responders_are_sounded_beyond_100_000_packets() {
    let (own, peers) = (mac(200), [mac(3), mac(1), mac(2)]);
    let config = Config { initiate: true, ..Config::new(own, 0, &peers, wsr_request(3, 100.0), 1) };
    let mut tdma = Tdma::new(&config).unwrap();
    let (mut sent, mut answered) = (0u32, 0u32);
    let mut last_at = None;
    while sent < 120_000 {
        let now = tdma.poll_timeout().unwrap();
        let Some(transmit) = tdma.poll_transmit(now) else { continue };
        sent += 1;
        let frame = transmit.frame.to_vec();
        let k = ((transmit.at.as_us() % 10_000 + 1) * 3 / 10_000) as usize; // slot in its round of 10 ms
        let robot = peers.iter().position(|peer| *peer == transmit.peer).unwrap();
        assert_eq!(robot, k);
        // Header as driver-interface 3.3, own MAC in addr3, the true number, length 57 + 2 k with FCS.
        assert_eq!(frame.len() + 4, 57 + 2 * robot);
        let header = [8, 0, 0xff, 0xff, 0, 0x16, 0xea, 0x12, 0x34, 0x56, 0, 0x16, 0xea, 0x12, 0x34, 0x56];
        assert_eq!(frame[..16], header);
        assert_eq!((&frame[16..22], &frame[22..24]), (&own.0[..], &[0, 0][..]));
        assert_eq!(frame[24..28], sent.to_be_bytes());
        if let Some(last_at) = last_at {
            let gap: Span = transmit.at - last_at;
            assert!((3_333..=3_334).contains(&gap.as_us()), "absolute deadlines: {gap:?}");
        }
        last_at = Some(transmit.at);
        let answers: Vec<Vec<u8>> = (0..3).filter_map(|k| kernel_answer(&frame, 57 + 2 * k, peers[k])).collect();
        assert_eq!(answers.len(), 1, "only the robot for whom it is meant answers");
        let heard = now + Span::from_us(400);
        tdma.handle_heard(heard, heard, &answers[0]);
        while let Some(event) = tdma.poll_event() {
            if let Event::Answered { peer, number, .. } = event {
                assert_eq!((peer, number), (peers[robot], sent));
                answered += 1;
            }
        }
    }
    assert_eq!((answered, tdma.counts().unmatched), (120_000, 0));
}

#[test]
fn an_open_loop_sender_goes_on_without_hearing_anything() {
    for (open_loop, sounded) in [(true, 6_000), (false, 1_000)] {
        let request = wsr_request(3, 100.0);
        let mut config = Config { initiate: true, ..Config::new(mac(9), 0, &[mac(1), mac(2), mac(3)], request, 1) };
        config.open_loop = open_loop;
        let mut tdma = Tdma::new(&config).unwrap();
        let (begun, mut absent) = (tdma.poll_timeout().unwrap(), false);
        while tdma.poll_timeout().unwrap() < begun + Span::from_s(20.0) {
            let now = tdma.poll_timeout().unwrap();
            while tdma.poll_transmit(now).is_some() {}
            absent |= std::iter::from_fn(|| tdma.poll_event()).any(|event| matches!(event, Event::Absent(_)));
        }
        assert_eq!(absent, !open_loop, "it is asked as often as before");
        let sent = tdma.counts().forward;
        assert!(if open_loop { sent == sounded } else { sent < 2 * sounded }, "{sent}");
    }
}

#[test]
fn our_responder_answers_as_the_kernel_does() {
    let own = mac(5);
    let mut tdma = Tdma::new(&Config::new(own, 1, &[mac(200)], wsr_request(3, 100.0), 1)).unwrap();
    for (number, k) in (1..=300u32).zip([0, 1, 2].into_iter().cycle()) {
        let frame = wsr_frame(number, 57 + 2 * k);
        let now = Instant::from_us(i64::from(number) * 3_000);
        tdma.handle_heard(now, now, &frame);
        let answer = tdma.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
        let kernel = kernel_answer(&frame, 59, own);
        assert_eq!(answer.is_some(), kernel.is_some());
        if let (Some(answer), Some(kernel)) = (answer, kernel) {
            assert_eq!(answer.len(), kernel.len());
            assert_eq!(answer[..55], kernel[..55]); // the old FCS and the spare byte are anybody's
            assert_eq!(Frame::new_checked(&answer).unwrap().len_with_fcs(), 64);
        }
    }
    assert_eq!(tdma.counts().replies, 100);
}

#[test]
fn a_sender_with_one_number_for_all_robots_of_a_round_is_answered() {
    let mut tdma = Tdma::new(&Config::new(mac(5), 1, &[mac(200)], wsr_request(3, 100.0), 1)).unwrap();
    for number in 1..=100u32 {
        for k in [0, 1, 1, 2] {
            let now = Instant::from_us(i64::from(number) * 10_000 + k as i64 * 3_000);
            tdma.handle_heard(now, now, &wsr_frame(number, 57 + 2 * k));
            while tdma.poll_transmit(now).is_some() {}
        }
    }
    let counts = tdma.counts();
    assert_eq!((counts.replies, counts.replayed), (100, 100), "the second frame for this robot is a repetition");
}

#[test]
fn an_answer_is_given_up_to_one_turn_around_after_its_frame_and_only_the_newest() {
    let request = wsr_request(3, 100.0);
    let mut tdma = Tdma::new(&Config::new(mac(5), 0, &[mac(200)], request, 1)).unwrap();
    let hear = |tdma: &mut Tdma, number, ended| tdma.handle_heard(ended, ended, &wsr_frame(number, 57));
    let ended = Instant::from_us(1_000);
    let latest = ended + Span::from_us(i64::from(request.turn_around_us));
    hear(&mut tdma, 1, ended);
    hear(&mut tdma, 2, ended);
    assert_eq!(tdma.counts().missed_replies, 1, "the first was not fetched");
    let answer = tdma.poll_transmit(latest).map(|transmit| (transmit.number, transmit.latest));
    assert_eq!(answer, Some((2, latest)), "at the very last");
    hear(&mut tdma, 3, ended);
    assert!(tdma.poll_transmit(latest + Span::from_us(1)).is_none());
    assert_eq!((tdma.counts().replies, tdma.counts().missed_replies), (1, 2));
}

#[test]
fn lengths_of_no_robot_are_foreign_and_an_answer_counts_once() {
    let config = Config { initiate: true, ..Config::new(mac(5), 1, &[mac(200)], wsr_request(3, 100.0), 1) };
    let mut tdma = Tdma::new(&config).unwrap();
    // Two of the three slots of a round are of no link.
    let (now, frame) = loop {
        let now = tdma.poll_timeout().unwrap();
        if let Some(sent) = tdma.poll_transmit(now) {
            break (now, sent.frame.to_vec());
        }
    };
    let answer = kernel_answer(&frame, 57, mac(200)).unwrap();
    for (unmatched, heard) in [0, 1, 2].into_iter().zip([&answer; 3]) {
        tdma.handle_heard(now, now, heard);
        assert_eq!((tdma.counts().answered, tdma.counts().unmatched), (1, unmatched));
    }
    for foreign in 1..4 {
        // Beyond the last robot's, and no answer's.
        tdma.handle_heard(now, now, &wsr_frame(foreign, 97));
        assert_eq!(tdma.counts().foreign, u64::from(foreign));
    }
}

#[test]
fn robots_of_one_length_scheme_share_the_air() {
    let mut configs = everybody(5, wsr_request(5, 100.0));
    configs.iter_mut().skip(1).for_each(|config| config.initiate = false);
    let mut air = Air::new(&configs, 20);
    (air.loss, air.jitter_us) = (0.1, 40);
    air.run_s(60);
    assert_eq!(air.collisions, 0);
    let share = air.pairs() as f64 / (4.0 * 100.0 * 60.0);
    assert!((0.78..0.83).contains(&share), "{share}");
    assert!(air.jain() < 0.3, "one robot has the turn all the time");
    // It gives up; another takes over after a silence.
    air.set_initiate(0, false);
    air.set_initiate(3, true);
    air.run_s(10);
    assert!(air.stations[3].tdma.has_turn() && air.initiators() == 1);
    assert_eq!(air.collisions, 0);
}

#[test]
fn of_two_wsr_initiators_the_lower_mac_goes_on() {
    let mut configs = everybody(4, wsr_request(4, 100.0));
    configs.iter_mut().skip(2).for_each(|config| config.initiate = false);
    let mut air = Air::new(&configs, 21);
    air.cell = vec![0, 1, 0, 1];
    air.run_s(10);
    assert_eq!(air.initiators(), 2);
    air.cell = vec![0; 4];
    air.run_s(5);
    assert!(air.stations[0].tdma.has_turn() && !air.stations[1].tdma.has_turn());
    assert_eq!(air.stations[1].tdma.counts().yields, 1);
    let collisions = air.collisions;
    air.run_s(20);
    assert_eq!((air.collisions, air.initiators()), (collisions, 1));
}

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
fn adversary(age_us: i64, dice_seed: u64) -> Adversary {
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

/// Three links, 200 rounds a second, answers with measurements.
fn request(authenticated: bool) -> Request {
    Request { dialect: Dialect::Native { measurement: true, authenticated }, ..Request::new(3, 200.0) }
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
                let bad = |station: &Station| {
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

#[test]
fn a_key_is_needed_on_both_sides_and_in_the_plan() {
    let key = Some(Key::new([1; 16]));
    let with = |authenticated, key| Tdma::new(&Config { key, ..everybody(4, request(authenticated))[0].clone() });
    assert_eq!(with(true, None).err(), Some(PlanError::Key));
    assert_eq!(with(false, key.clone()).err(), Some(PlanError::Key));
    assert!(with(true, key.clone()).is_ok());
    let of_wsr = Config { key, ..everybody(4, wsr_request(3, 100.0))[0].clone() };
    assert_eq!(Tdma::new(&of_wsr).err(), Some(PlanError::Key));
}

/// Three robots with files of their own, of which the first initiates.
fn three_with_keys() -> Vec<Config> {
    let configs = everybody(3, request(true));
    let macs: Vec<Mac> = configs.iter().map(|config| config.own.mac).collect();
    let with_key = |(k, config): (usize, Config)| {
        let peers: Vec<Mac> = macs.iter().copied().filter(|mac| *mac != macs[k]).collect();
        Config { key: Some(Key::new([1; 16]).for_robot(macs[k], &peers)), session: 5, initiate: k == 0, ..config }
    };
    configs.into_iter().enumerate().map(with_key).collect()
}

/// Frames of robot 0 to all others, in order: when each was sent, to whom, and its bytes.
fn sent_by_the_first(configs: &[Config], count: usize) -> Vec<(Instant, Mac, Vec<u8>)> {
    let mut tdma = Tdma::new(&configs[0]).unwrap();
    std::iter::from_fn(|| {
        let now = tdma.poll_timeout()?;
        Some(tdma.poll_transmit(now).map(|sent| (now, sent.peer, sent.frame.to_vec())))
    })
    .flatten()
    .take(count)
    .collect()
}

/// The first four of them to robot `to`, under a session.
fn four_to(to: usize, session: u32) -> Vec<(Instant, Vec<u8>)> {
    let mut configs = three_with_keys();
    configs[0].session = session;
    let sent = sent_by_the_first(&configs, 12).into_iter().filter(|(_, peer, _)| *peer == mac(to));
    sent.map(|(now, _, frame)| (now, frame)).take(4).collect()
}

#[test]
fn what_was_taped_before_a_restart_is_not_answered_after_it() {
    let (old, current) = (four_to(1, 4), four_to(1, 5));
    let number = |frame: &[u8]| native::Repr::parse(&Frame::new_checked(frame).unwrap()).unwrap().number;
    let answers = |heard: &[(Mac, u32, u32)], (now, frame): &(Instant, Vec<u8>)| {
        let config = Config { session: 9, heard: heard.to_vec(), ..three_with_keys().remove(1) };
        let mut responder = Tdma::new(&config).unwrap();
        responder.handle_heard(*now, *now, frame);
        responder.poll_transmit(*now).is_some()
    };
    assert!(answers(&[], &old[0]), "without memory a tape is as good as a frame");
    // It had heard session 5 up to the second frame's number.
    let heard = [(mac(0), 5, number(&current[1].1))];
    assert!(!answers(&heard, &old[0]) && !answers(&heard, &old[2]), "an older session");
    assert!(!answers(&heard, &current[0]) && !answers(&heard, &current[1]), "of this session, up to there");
    assert!(answers(&heard, &current[2]), "the exchange goes on");
    assert!(answers(&heard, &four_to(1, 6)[0]), "a newer session");
}

/// An initiator's exchanges with its first peer under a session: each forward frame with its answer.
fn exchanges(configs: &[Config], session: u32, count: usize) -> Vec<(Instant, Vec<u8>, Vec<u8>)> {
    let mut initiator = Tdma::new(&Config { session, ..configs[0].clone() }).unwrap();
    let mut responder = Tdma::new(&Config { initiate: false, ..configs[1].clone() }).unwrap();
    let mut found = Vec::new();
    while found.len() < count {
        let now = initiator.poll_timeout().unwrap();
        let Some(sent) = initiator.poll_transmit(now) else { continue };
        let (to, forward) = (sent.peer, sent.frame.to_vec());
        if to == configs[1].own.mac {
            responder.handle_heard(now, now, &forward);
            let answer = responder.poll_transmit(now).unwrap().frame.to_vec();
            found.push((now, forward, answer));
        }
    }
    found
}

/// Frames from robot 0 to the third, as far as the second can tell, are made by any robot of the group.
#[test]
fn what_a_robot_says_in_anothers_name_to_a_third_silences_nobody() {
    let responder = || Tdma::new(&Config { session: 9, ..three_with_keys().remove(1) }).unwrap();
    let honest = four_to(1, 5);
    for forged in [four_to(2, 5 + 0x7fff_0000).remove(0).1, four_to(2, 5).remove(3).1] {
        let mut responder = responder();
        for (now, frame) in &honest {
            responder.handle_heard(*now, *now, &forged);
            responder.handle_heard(*now, *now, frame);
            assert!(responder.poll_transmit(*now).is_some(), "{:?}", responder.counts());
        }
        let events: Vec<Event> = std::iter::from_fn(|| responder.poll_event()).collect();
        assert!(!events.iter().any(|event| matches!(event, Event::Restarted { .. })), "{events:?}");
    }
    // The robot itself says it: an older session is not answered any more.
    let mut responder = responder();
    let (now, anew) = four_to(1, 6).remove(3);
    responder.handle_heard(now, now, &anew);
    assert!(responder.poll_transmit(now).is_some());
    responder.handle_heard(now, now, &honest[3].1);
    assert!(responder.poll_transmit(now).is_none() && responder.counts().replayed == 1);
}

/// A frame that was lost here, and is played later, is new; what was heard after it is not.
#[test]
fn a_tape_that_begins_with_a_lost_frame_is_not_heard_again() {
    let configs = three_with_keys();
    let own = configs[1].own.mac;
    let sent = sent_by_the_first(&configs, 60);
    // From the lost one on, the listener gets only what is for the third.
    let lost = sent.iter().skip(10).position(|(_, to, _)| *to == own).unwrap() + 10;
    let (before, tape) = sent.split_at(lost);
    let after: Vec<_> = tape.iter().filter(|(_, to, _)| *to != own).collect();
    let mut listener = Tdma::new(&configs[1]).unwrap();
    for (now, _, frame) in before.iter().chain(after.iter().copied()) {
        listener.handle_heard(*now, *now, frame);
        listener.poll_transmit(*now);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 0));
    let later = |k: usize| sent[59].0 + Span::from_ms(300 + 5 * k as i64);
    for (k, (_, _, frame)) in tape.iter().take(1).chain(after.iter().copied()).enumerate() {
        listener.handle_heard(later(k), later(k), frame);
        assert!(listener.poll_transmit(later(k)).is_none());
    }
    assert_eq!(listener.counts().replayed, after.len() as u64);
    assert_eq!(listener.counts().off_epoch, 1, "the lost one itself, which no turn and no answer follows");
}

/// A robot that sounds only a third one shows itself to the second by nothing but the slots it keeps to.
#[test]
fn a_robot_that_only_others_are_sounded_by_is_not_silenced_by_numbers_made_up_for_it() {
    let mut configs = three_with_keys();
    configs[0].links = Some(vec![configs[2].own.mac]);
    let sent = sent_by_the_first(&configs, 80);
    let mut listener = Tdma::new(&configs[1]).unwrap();
    for (k, (now, _, frame)) in sent.iter().take(40).enumerate() {
        if k == 5 {
            // Of the same session, but far ahead.
            listener.handle_heard(*now, *now, &sent[70].2);
        }
        listener.handle_heard(*now, *now, frame);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 1), "{:?}", listener.counts());
}

/// Two slots are as near as clocks tell them apart: there, numbers tell what is over.
#[test]
fn what_is_played_in_the_next_slot_is_not_heard_again() {
    let configs = three_with_keys();
    let mut responder = Tdma::new(&configs[1]).unwrap();
    let sent = sent_by_the_first(&configs, 60);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    let mut replays = 0;
    // Robot 0 sounds robot 1, then robot 2, which listens.
    let order = [configs[1].own.mac, configs[2].own.mac];
    for pair in sent.windows(2).filter(|pair| [pair[0].1, pair[1].1] == order) {
        let [(asked, _, forward), (now, _, own)] = pair else { unreachable!() };
        responder.handle_heard(*asked, *asked, forward);
        let answer = responder.poll_transmit(*asked).unwrap().frame.to_vec();
        // In every other round what is not for the listener is lost to it, and is played when its own frame was heard.
        let is_lost = replays % 2 == 0;
        let third = [forward, &answer];
        third.iter().filter(|_| !is_lost).for_each(|frame| listener.handle_heard(*asked, *asked, frame));
        listener.handle_heard(*now, *now, own);
        assert!(listener.poll_transmit(*now).is_some());
        third.iter().for_each(|frame| listener.handle_heard(*now, *now, frame));
        replays += 1;
        assert_eq!(listener.counts().replayed, 2 * replays, "{is_lost}");
    }
    assert!(replays > 20 && listener.counts().off_epoch == 0);
}

/// Before its restart an initiator had the same slots: its session tells.
#[test]
fn what_was_taped_in_the_same_slots_of_an_older_session_is_not_heard() {
    let mut configs = three_with_keys();
    let sent = sent_by_the_first(&configs, 30);
    configs[0].session = 4;
    let tape = sent_by_the_first(&configs, 30);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    for ((now, _, frame), (then, _, taped)) in sent.iter().zip(&tape) {
        assert_eq!(now, then);
        listener.handle_heard(*now, *now, frame);
        listener.handle_heard(*now, *now, taped);
    }
    assert_eq!((listener.counts().heard, listener.counts().replayed), (60, 30));
}

/// Answers to a robot whose numbers another one made up are heard, too, in their slots.
#[test]
fn answers_in_their_slots_are_heard_whatever_was_said_of_numbers() {
    let configs = three_with_keys();
    let heard = exchanges(&configs, 5, 60);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    for (k, (now, forward, answer)) in heard.iter().take(30).enumerate() {
        if k == 5 {
            listener.handle_heard(*now, *now, &heard[50].1);
        }
        listener.handle_heard(*now, *now, forward);
        listener.handle_heard(*now, *now, answer);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 1), "{:?}", listener.counts());
    // The same once more, which is over.
    let now = heard[29].0;
    for (_, forward, answer) in heard.iter().take(30) {
        listener.handle_heard(now, now, forward);
        listener.handle_heard(now, now, answer);
    }
    assert_eq!(listener.counts().replayed, 59, "all but the last answer, which says nothing new");
}

#[test]
fn taped_answers_to_others_are_not_heard_again() {
    let configs = three_with_keys();
    let (older, now) = (exchanges(&configs, 4, 1), exchanges(&configs, 5, 3));
    let mut listener = Tdma::new(&configs[2]).unwrap();
    let mut replayed = |(at, frames): (Instant, &[&Vec<u8>])| {
        let before = listener.counts().replayed;
        frames.iter().for_each(|frame| listener.handle_heard(at, at, frame));
        listener.counts().replayed - before
    };
    for (at, forward, answer) in &now {
        assert_eq!(replayed((*at, &[forward, answer])), 0, "the exchange as it is");
    }
    let last = now[2].0;
    assert_eq!(replayed((last, &[&now[0].2, &now[1].2])), 2, "answers to frames before the last");
    assert_eq!(replayed((last, &[&older[0].2])), 1, "an answer to a frame of an older session");
}

/// Numbers begin again with each session, so an answer to the same number of an older one makes no pair.
#[test]
fn answers_to_an_older_session_of_this_robot_make_no_pair() {
    let configs = three_with_keys();
    let older = exchanges(&configs, 4, 1).remove(0);
    let (now, forward, answer) = exchanges(&configs, 5, 1).remove(0);
    let mut initiator = Tdma::new(&Config { session: 5, ..configs[0].clone() }).unwrap();
    let sent = std::iter::from_fn(|| {
        let at = initiator.poll_timeout()?;
        Some(initiator.poll_transmit(at).map(|sent| sent.frame.to_vec()))
    });
    assert!(sent.flatten().any(|frame| frame == forward));
    let mut answered = |answer: &[u8]| {
        initiator.handle_heard(now, now, answer);
        let events = std::iter::from_fn(|| initiator.poll_event());
        let pairs = events.filter(|event| matches!(event, Event::Answered { .. })).count();
        (pairs, initiator.counts().unmatched)
    };
    assert_eq!(answered(&older.2), (0, 1));
    assert_eq!(answered(&answer), (1, 1));
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
