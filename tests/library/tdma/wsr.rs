//! The dialect of the WSR toolbox: byte-exact frames, the kernel's responder, counters beyond 100,000.

use super::air::{Air, everybody, mac};
use csi5300::exchange::tdma::{Config, Dialect, Event, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::{Frame, wsr};

fn request(links: u16, rate_hz: f64) -> Request {
    Request::new(links, rate_hz).with_dialect(Dialect::Wsr { first_len: 57 })
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

#[test]
fn three_kernel_responders_are_sounded_beyond_100_000_packets() {
    let (own, peers) = (mac(200), [mac(3), mac(1), mac(2)]);
    let config = Config::new(own, 0, &peers, request(3, 100.0), 1).with_initiate(true);
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
        let request = request(3, 100.0);
        let mut config = Config::new(mac(9), 0, &[mac(1), mac(2), mac(3)], request, 1).with_initiate(true);
        config.open_loop = open_loop;
        let mut tdma = Tdma::new(&config).unwrap();
        let begun = tdma.poll_timeout().unwrap();
        while tdma.poll_timeout().unwrap() < begun + Span::from_s(20.0) {
            let now = tdma.poll_timeout().unwrap();
            while tdma.poll_transmit(now).is_some() {}
        }
        let sent = tdma.counts().forward;
        assert!(if open_loop { sent == sounded } else { sent < 2 * sounded }, "{sent}");
    }
}

#[test]
fn our_responder_answers_as_the_kernel_does() {
    let (own, initiator) = (mac(5), mac(200));
    let mut tdma = Tdma::new(&Config::new(own, 1, &[initiator], request(3, 100.0), 1)).unwrap();
    let mut filler = wsr::Lfsr::default();
    let mut buffer = [0; 80];
    for (number, k) in (1..=300u32).zip([0, 1, 2].into_iter().cycle()) {
        let repr = wsr::Repr { sender: initiator, number, len_with_fcs: 57 + 2 * k };
        let len = repr.emit(&mut buffer, &mut filler).unwrap();
        let now = Instant::from_us(i64::from(number) * 3_000);
        tdma.handle_heard(now, now, &buffer[..len]);
        let answer = tdma.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
        let kernel = kernel_answer(&buffer[..len], 59, own);
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
    let (own, initiator) = (mac(5), mac(200));
    let mut tdma = Tdma::new(&Config::new(own, 1, &[initiator], request(3, 100.0), 1)).unwrap();
    let mut buffer = [0; 80];
    for number in 1..=100u32 {
        for k in [0, 1, 1, 2] {
            let repr = wsr::Repr { sender: initiator, number, len_with_fcs: 57 + 2 * k };
            let len = repr.emit(&mut buffer, &mut wsr::Lfsr::default()).unwrap();
            let now = Instant::from_us(i64::from(number) * 10_000 + k as i64 * 3_000);
            tdma.handle_heard(now, now, &buffer[..len]);
            while tdma.poll_transmit(now).is_some() {}
        }
    }
    let counts = tdma.counts();
    assert_eq!((counts.replies, counts.replayed), (100, 100), "the second frame for this robot is a repetition");
}

#[test]
fn an_answer_given_too_late_is_skipped() {
    let (own, initiator) = (mac(5), mac(200));
    let mut tdma = Tdma::new(&Config::new(own, 0, &[initiator], request(3, 100.0), 1)).unwrap();
    let mut buffer = [0; 80];
    let repr = wsr::Repr { sender: initiator, number: 1, len_with_fcs: 57 };
    let len = repr.emit(&mut buffer, &mut wsr::Lfsr::default()).unwrap();
    let ended = Instant::from_us(1_000);
    tdma.handle_heard(ended + Span::from_us(300), ended, &buffer[..len]);
    assert!(tdma.poll_transmit(ended + Span::from_us(323)).is_none());
    assert_eq!((tdma.counts().replies, tdma.counts().missed_replies), (0, 1));
}

#[test]
fn an_answer_is_given_up_to_one_turn_around_after_its_frame_and_only_the_newest() {
    let (own, initiator) = (mac(5), mac(200));
    let mut tdma = Tdma::new(&Config::new(own, 0, &[initiator], request(3, 100.0), 1)).unwrap();
    let hear = |tdma: &mut Tdma, number, ended| {
        let mut buffer = [0; 80];
        let repr = wsr::Repr { sender: initiator, number, len_with_fcs: 57 };
        let len = repr.emit(&mut buffer, &mut wsr::Lfsr::default()).unwrap();
        tdma.handle_heard(ended, ended, &buffer[..len]);
    };
    let ended = Instant::from_us(1_000);
    let latest = ended + Span::from_us(i64::from(request(3, 100.0).turn_around_us));
    hear(&mut tdma, 1, ended);
    hear(&mut tdma, 2, ended);
    assert_eq!(tdma.counts().missed_replies, 1, "the first was not fetched");
    let answer = tdma.poll_transmit(latest).map(|transmit| (transmit.number, transmit.latest));
    assert_eq!(answer, Some((2, latest)), "at the very last");
    assert_eq!((tdma.counts().replies, tdma.counts().missed_replies), (1, 1));
}

#[test]
fn lengths_of_no_robot_are_foreign_and_an_answer_counts_once() {
    let config = Config::new(mac(5), 1, &[mac(200)], request(3, 100.0), 1).with_initiate(true);
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
    let mut buffer = [0; 120];
    for foreign in 1..4 {
        // Beyond the last robot's, and no answer's.
        let repr = wsr::Repr { sender: mac(200), number: foreign, len_with_fcs: 97 };
        let len = repr.emit(&mut buffer, &mut wsr::Lfsr::default()).unwrap();
        tdma.handle_heard(now, now, &buffer[..len]);
        assert_eq!(tdma.counts().foreign, u64::from(foreign));
    }
}

#[test]
fn robots_of_one_length_scheme_share_the_air() {
    let mut configs = everybody(5, request(5, 100.0));
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
    let mut configs = everybody(4, request(4, 100.0));
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
