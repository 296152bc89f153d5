//! Undisturbed and lossy exchanges: what plans promise is kept, for hours.

use super::air::{Air, Skew, everybody, mac};
use csi5300::exchange::tdma::{Config, Epoch, Event, PlanError, Priority, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::sounding::Frame;
use driver_iface::sounding::native::{self, Measurement, SUBCARRIERS};

/// One initiator and `peers` responders.
fn one_initiator(peers: usize, request: Request) -> Vec<Config> {
    let mut configs = everybody(peers + 1, request);
    configs.iter_mut().skip(1).for_each(|config| config.initiate = false);
    configs
}

#[test]
fn twelve_peers_at_100_rounds_per_second_run() {
    let mut air = Air::new(&one_initiator(12, Request::new(12, 100.0)), 1);
    air.jitter_us = 40;
    air.run_s(2);
    let before = air.stations[0].answered.clone();
    air.run_s(10);
    for (peer, (after, before)) in air.stations[0].answered.iter().zip(&before).enumerate().skip(1) {
        let answers = after - before;
        assert!((999..=1_001).contains(&answers), "{answers} answers of peer {peer} in 10 s");
    }
    assert_eq!((air.collisions, air.stations[0].tdma.counts().missed_slots), (0, 0));
    assert!(air.stations.iter().all(|station| station.tdma.initiator() == Some(mac(0))));
}

#[test]
fn thirty_two_peers_are_refused_at_100_and_run_at_the_rate_that_is_offered() {
    let request = Request::new(32, 100.0);
    let Err(PlanError::Rate { highest_hz, .. }) = Tdma::new(&one_initiator(32, request)[0]) else {
        panic!("32 peers at 100 rounds/s cannot fit");
    };
    let mut air = Air::new(&one_initiator(32, request.with_rate_hz(highest_hz)), 2);
    air.jitter_us = 50;
    air.run_s(5);
    let before = air.pairs();
    air.run_s(10);
    let expect = highest_hz * 32.0 * 10.0;
    assert!(((air.pairs() - before) as f64 - expect).abs() <= 33.0, "{} of {expect}", air.pairs() - before);
    assert_eq!(air.collisions, 0);
}

#[test]
fn an_hour_of_two_robots_at_60_percent_loss_has_no_overlap_and_no_drift() {
    let mut air = Air::new(&everybody(2, Request::new(1, 100.0)), 3);
    (air.loss, air.jitter_us) = (0.6, 50);
    air.run_s(3_600);
    let sounded: u64 = air.stations.iter().map(|station| station.tdma.counts().forward).sum();
    assert_eq!(air.collisions, 0);
    assert!(sounded > 355_000, "{sounded} of 360,000 slots used");
    let rate = air.pairs() as f64 / sounded as f64;
    assert!((rate - 0.16).abs() < 0.005, "both frames get through in 16 % of the rounds, not {rate}");
}

#[test]
fn answers_are_fair_under_20_percent_loss() {
    for n in [2, 5, 12] {
        let mut air = Air::new(&everybody(n, Request::new(n as u16 - 1, 50.0)), 4 + n as u64);
        (air.loss, air.jitter_us) = (0.2, 50);
        let turn_us = air.stations[0].tdma.plan().cycle_us(n as u32) as i64;
        air.run_us(turn_us * 60);
        assert!(air.jain() > 0.99, "{n} robots: {}", air.jain());
        assert_eq!(air.collisions, 0);
    }
}

#[test]
fn short_turns_interleave_the_robots() {
    let mut request = Request::new(2, 100.0);
    request.turn_slots = 2;
    let mut air = Air::new(&everybody(3, request), 14);
    air.loss = 0.02;
    air.run_s(60);
    let turns: u64 = air.stations.iter().map(|station| station.tdma.counts().turns).sum();
    assert!(turns > 5_500, "{turns} turns of one round in 60 s");
    assert_eq!(air.collisions, 0);
    assert!(air.jain() > 0.99);
}

#[test]
fn robots_without_a_common_clock_take_the_epoch_from_the_air() {
    let request = Request::new(4, 100.0);
    let mut configs = everybody(5, request);
    let skews: Vec<Skew> = (0..5)
        .map(|k| Skew { offset_us: 1_000_003 * k * k - 7_000_000, ppm: [0, 20, -20, 40, -40][k as usize] })
        .collect();
    for (k, config) in configs.iter_mut().enumerate() {
        config.epoch = Epoch::Heard(skews[k].local(0));
        config.initiate = k == 2;
    }
    let mut air = Air::new(&configs, 9);
    air.restart_with_skew(&configs, &skews);
    (air.loss, air.jitter_us) = (0.1, 30);
    air.run_s(5);
    assert!(air.stations.iter().all(|station| station.tdma.is_synchronised()));
    (0..5).for_each(|k| air.set_initiate(k, true));
    air.run_s(600);
    assert_eq!(air.collisions, 0);
    let turns: Vec<u64> = air.stations.iter().map(|station| station.tdma.counts().turns).collect();
    assert!(turns.iter().all(|count| *count > 300), "{turns:?}");
    assert!(air.jain() > 0.98, "{}", air.jain());
    let off: u64 = air.stations.iter().map(|station| station.tdma.counts().off_epoch).sum();
    assert_eq!(off, 0);
}

#[test]
fn any_number_of_robots_keeps_in_step_by_hearing_alone() {
    for n in [2usize, 3, 8, 16, 32] {
        let mut configs = everybody(n, Request::new(n as u16 - 1, 1_200.0 / n as f64));
        let skews: Vec<Skew> =
            (0..n as i64).map(|k| Skew { offset_us: 333_337 * k, ppm: (k * 37 % 101) - 50 }).collect();
        for (k, config) in configs.iter_mut().enumerate() {
            config.epoch = Epoch::Heard(skews[k].local(0));
            config.initiate = k == 0;
        }
        let mut air = Air::new(&configs, n as u64);
        air.restart_with_skew(&configs, &skews);
        (air.loss, air.jitter_us) = (0.4, 40);
        air.run_s(6);
        assert!(air.stations.iter().all(|station| station.tdma.is_synchronised()), "{n} robots");
        (0..n).for_each(|k| air.set_initiate(k, true));
        air.run_s(10);
        assert_eq!(air.collisions, 0, "{n} robots");
        let took_turns = air.stations.iter().filter(|station| station.tdma.counts().turns > 0).count();
        assert_eq!(took_turns, n);
    }
}

#[test]
fn a_late_driver_loses_slots_and_sends_nothing_late() {
    let mut air = Air::new(&one_initiator(3, Request::new(3, 100.0)), 10);
    air.jitter_us = 150; // three guards: two of three wake-ups are too late
    air.run_s(20);
    let counts = air.stations[0].tdma.counts();
    let share = counts.missed_slots as f64 / (counts.missed_slots + counts.forward) as f64;
    assert!((0.6..0.72).contains(&share), "{share}");
    assert_eq!(air.collisions, 0);
}

#[test]
fn only_the_chosen_links_are_sounded_and_priorities_thin_them_out() {
    let mut configs = one_initiator(4, Request::new(4, 100.0));
    configs[0].links = Some(vec![mac(3), mac(1), mac(4)]);
    let mut air = Air::new(&configs, 11);
    let first = &mut air.stations[0].tdma;
    assert!(first.set_priority(mac(1), Priority::every(5)));
    assert!(first.set_priority(mac(4), Priority::share(0.0)));
    assert!(!first.set_priority(mac(2), Priority::share(1.0)), "no link");
    air.run_s(2);
    let before = air.stations[0].answered.clone();
    air.run_s(10);
    let answers: Vec<u64> = (0..5).map(|k| air.stations[0].answered[k] - before[k]).collect();
    assert_eq!((answers[2], answers[4]), (0, 0));
    assert!((999..=1_001).contains(&answers[3]), "{answers:?}");
    assert!((199..=201).contains(&answers[1]), "{answers:?}");
}

#[test]
fn an_initiator_is_heard_to_be_there_even_if_no_link_matters() {
    let mut configs = everybody(3, Request::new(2, 100.0));
    configs[2].initiate = false;
    let mut air = Air::new(&configs, 12);
    for k in 0..2 {
        (0..3).filter(|other| *other != k).for_each(|other| {
            air.stations[k].tdma.set_priority(mac(other), Priority::share(0.0));
        });
    }
    air.run_s(60);
    let sent: u64 = air.stations.iter().map(|station| station.tdma.counts().forward).sum();
    assert!((2_900..=3_050).contains(&sent), "a quarter of the slots: {sent} of 12,000");
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
        let mut first = Tdma::new(&configs[0].clone().with_session(session)).unwrap();
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

#[test]
fn the_answer_carries_the_responders_measurement_once() {
    let configs = one_initiator(1, Request::new(1, 100.0));
    let mut first = Tdma::new(&configs[0]).unwrap();
    let mut second = Tdma::new(&configs[1]).unwrap();
    let measurement = measured(1);
    assert!(!second.set_measurement(mac(0), measurement), "not heard yet: kept for the answer to that frame");
    assert!(!second.set_measurement(mac(7), measurement));
    let mut received = Vec::new();
    let mut now = Instant::ZERO;
    while received.len() < 2 {
        now = now.max(first.poll_timeout().unwrap());
        let Some(frame) = first.poll_transmit(now).map(|transmit| transmit.frame.to_vec()) else { continue };
        second.handle_heard(now, now, &frame);
        let answer = second.poll_transmit(now).map(|transmit| transmit.frame.to_vec()).unwrap();
        first.handle_heard(now, now, &answer);
        while let Some(event) = first.poll_event() {
            if let Event::Answered { number, measurement, .. } = event {
                received.push((number, measurement));
            }
        }
    }
    assert_eq!(received, [(1, Some(measurement)), (2, None)]);
}
