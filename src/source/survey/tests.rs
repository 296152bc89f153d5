use super::bounds::SENDERS_KEPT;
use super::sender::{COUNTS_KEPT, SAME_COUNT};
use super::*;
use crate::source::Refused;
use driver_iface::bfee::{Iq, Repr, Wsr};

fn sender(numbers: &[u32]) -> Sender {
    let mut sender = Sender::default();
    for (at, number) in numbers.iter().enumerate() {
        sender.note(Some(*number), 10_000 * at as u32, None);
    }
    sender
}

#[test]
fn skipped_repeated_and_restarted_numbers_are_told_apart() {
    let sender = sender(&[7, 8, 8, 12, 13, 1, 2, 2, 2, 4]);
    assert_eq!((sender.frames_skipped, sender.frames_repeated, sender.frames_restarted), (3 + 1, 3, 1));
    assert_eq!(sender.frame_count, Some((1, 13)));
    assert_eq!(sender.rate_hz(), Some(100.0));
}

#[test]
fn numbers_wrap_without_a_restart() {
    let sender = sender(&[u32::MAX - 1, u32::MAX, 0, 1]);
    assert_eq!((sender.frames_skipped, sender.frames_restarted), (0, 0));
}

/// A survey of WSR records with the senders, `bfee_count`s and rates given.
fn survey(records: impl Iterator<Item = (Mac, u16, u16)>) -> Survey {
    heard_by(Survey::default(), records)
}

fn heard_by(mut survey: Survey, records: impl Iterator<Item = (Mac, u16, u16)>) -> Survey {
    for (mac, bfee_count, rate_n_flags) in records {
        let wsr = Wsr { mac, frame_count: Some(1), ..Wsr::default() };
        let repr = Repr { bfee_count, rate_n_flags, wsr: Some(wsr), ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let record = Record { code: code::BFEE, body: &body };
        assert!(survey.note(&Next::Record(Stamps::default(), record)).is_some());
    }
    survey
}

#[test]
fn numbers_of_several_initiators_are_counts_of_their_own() {
    let far = SAME_COUNT + 1;
    let two = sender(&[10, 10 + far, 11, 11 + far, 13, 12 + far]);
    assert_eq!((two.frames_skipped, two.frames_restarted), (1, 0));
    // One count more than are kept: its numbers are restarts of what is nearest.
    let begin = |k: u32| 2 * far * k;
    let all: Vec<u32> = (0..=COUNTS_KEPT as u32).map(begin).collect();
    assert_eq!(sender(&all[..COUNTS_KEPT]).frames_restarted, 0);
    assert_eq!(sender(&all).frames_restarted, 1);
}

#[test]
fn rates_are_counted_each() {
    let survey = survey([0x101, 0x102, 0x101, 0x101].into_iter().map(|rate| (Mac([2; 6]), 0, rate)));
    assert_eq!((survey.rates[&0x101], survey.rates[&0x102]), (3, 1));
}

#[test]
fn a_driver_that_was_loaded_anew_is_no_loss() {
    let counts = [65_534, 65_535, 0, 1, 1, 5, 0, 1];
    let survey = survey(counts.iter().map(|count| (Mac([2; 6]), *count, 0x101)));
    assert_eq!((survey.bfee_missing, survey.bfee_repeated, survey.bfee_restarted), (3, 1, 1));
}

#[test]
fn what_noise_makes_up_is_bounded() {
    let survey = survey((0..1_000).map(|n: u16| (Mac([2, 0, 0, 0, (n >> 8) as u8, n as u8]), n, n)));
    assert_eq!((survey.senders.len(), survey.rates.len()), (SENDERS_KEPT, SENDERS_KEPT));
    assert_eq!(survey.further_senders, 1_000 - SENDERS_KEPT as u64);
    assert_eq!(survey.senders_forgotten, 1_000 - SENDERS_KEPT as u64);
}

#[test]
fn a_clock_that_pauses_or_steps_back_is_seen_and_the_rate_is_that_of_the_whole_log() {
    let mut sender = Sender::default();
    // 101 frames 10 ms apart, a pause of 9 s, 100 more; then the clock falls back by 3 s and 10 frames follow.
    let steps = [vec![10_000_i64; 100], vec![9_000_000], vec![10_000; 99], vec![-3_000_000], vec![10_000; 9]].concat();
    let mut at_us = 5_000_000_i64;
    sender.note(None, at_us as u32, None);
    for step in steps {
        at_us += step;
        sender.note(None, at_us as u32, None);
    }
    let clock = sender.clock_steps;
    assert_eq!((clock.pauses, clock.longest_pause_us), (1, 9_000_000));
    assert_eq!((clock.steps_back, clock.furthest_back_us), (1, 3_000_000));
    assert_eq!(clock.forward_us, 208 * 10_000 + 9_000_000);
    assert_eq!(sender.rate_hz(), Some(100.0));
    let mean = sender.mean_rate_hz().unwrap();
    assert!((mean - 209.0 / 11.08).abs() < 1e-9, "{mean}");
}

#[test]
fn a_sender_whose_clock_stands_has_the_rate_of_the_hosts_times_or_none() {
    let sender = |host_us: fn(u32) -> Option<i64>| {
        let mut sender = Sender::default();
        (0..101).for_each(|k| sender.note(None, k / 50, host_us(k)));
        sender
    };
    let by_host = sender(|k| Some(1_700_000_000_000_000 + 10_000 * i64::from(k)));
    assert_eq!((by_host.mean_rate_hz(), by_host.rate_hz()), (Some(100.0), None));
    assert_eq!(sender(|_| None).mean_rate_hz(), None);
    // A pause in which the card's clock goes on by more than half of its range is one of a sender, too.
    let mut paused = Sender::default();
    for (card_us, host_us) in [(0, 0), (3_553_500_000_u32, 3_553_500_000)] {
        paused.note(None, card_us, Some(host_us));
    }
    assert_eq!((paused.clock_steps.pauses, paused.clock_steps.steps_back), (1, 0));
}

#[test]
fn random_payload_is_no_frame_number() {
    let random: Vec<u32> = (1..500_u32).map(|k| k.wrapping_mul(2_654_435_761) ^ 0x5bd1_e995).collect();
    assert!(!sender(&random).counts_up());
    assert!(sender(&[7, 8, 8, 12, 13, 1, 2, 2, 2, 4]).counts_up());
    assert!(!Sender::default().counts_up());
}

#[test]
fn a_broadcast_address_is_no_sender() {
    let frame = |addr1, addr3| {
        let repr = driver_iface::mpdu::Repr {
            frame_control: 0x0008,
            duration_us: 0,
            seq_ctrl: 0,
            addr1,
            addr2: Mac([4; 6]),
            addr3,
            payload: &[0, 0, 0, 9],
        };
        let mut frame = vec![0; repr.emit_len()];
        repr.emit(&mut frame).unwrap();
        frame
    };
    let (magic, four, six, all) = (driver_iface::sounding::MAGIC_MAC, Mac([4; 6]), Mac([6; 6]), Mac([0xff; 6]));
    for (addr1, addr3, sender, number) in
        [(magic, all, four, None), (magic, six, six, Some(9)), (Mac([2; 6]), six, four, None)]
    {
        let repr = Repr::default();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let mut survey = Survey::default();
        let mpdu = frame(addr1, addr3);
        survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &mpdu }));
        let record = Record { code: code::BFEE, body: &body };
        let (_, identity) = survey.note(&Next::Record(Stamps::default(), record)).unwrap();
        assert_eq!((identity.mac, identity.frame_count), (sender, number));
    }
}

#[test]
fn what_was_never_measured_has_no_range() {
    let mut range = Range::default();
    assert!(!range.is_measured());
    [-3, 5, 1].iter().for_each(|value| range.note(*value));
    assert!(range.is_measured());
    assert_eq!((range.min, range.max, range.mean), (-3, 5, 1.0));
    let mut above = Range::default();
    [7, 9].iter().for_each(|value| above.note(*value));
    assert_eq!((above.min, above.max, above.mean), (7, 9, 8.0), "0 was not measured");
    let json = |range: Range| serde_json::to_value(range).unwrap();
    assert_eq!(json(above), serde_json::json!({"min": 7, "max": 9, "mean": 8.0}));
    assert_eq!(json(Range::default()), serde_json::Value::Null);
}

#[test]
fn losses_are_counted_whatever_they_are_of_and_the_first_are_kept() {
    let mut survey = Survey::default();
    assert!(!survey.lost_something());
    let reason = driver_iface::record::Reason::Checksum;
    let of = |loss| {
        let mut survey = Survey::default();
        survey.note(&Next::Lost(loss));
        assert!(survey.lost_something());
        (survey.damages, survey.damaged_bytes, survey.overruns)
    };
    assert_eq!(of(Loss::Bytes { offset: 5, len: 9, reason }), (1, 9, 0));
    let datagram = Loss::Datagram { number: 5, len: 9, reason: Refused::Truncated { sent: 90, kept: 81 } };
    assert_eq!(of(datagram), (1, 9, 0));
    assert_eq!(of(Loss::Overrun { dropped: Some(3) }), (0, 0, 3));
    assert_eq!(of(Loss::Overrun { dropped: None }), (0, 0, 1));
    for offset in 0..LOSSES_KEPT as u64 + 2 {
        survey.note(&Next::Lost(Loss::Bytes { offset, len: 2, reason }));
        survey.note(&Next::Lost(Loss::Overrun { dropped: Some(2) }));
    }
    let lost = LOSSES_KEPT as u64 + 2;
    assert_eq!((survey.damages, survey.damaged_bytes, survey.overruns), (lost, 2 * lost, 2 * lost));
    assert_eq!(survey.losses.iter().map(|lost| lost.offset).collect::<Vec<_>>(), (0..lost - 2).collect::<Vec<_>>());
}

#[test]
fn losses_that_a_peer_makes_up_add_up_to_no_more_than_can_be_counted() {
    let mut survey = Survey::default();
    for dropped in [u64::MAX - 1, u64::MAX - 1, 1] {
        survey.note(&Next::Lost(Loss::Overrun { dropped: Some(dropped) }));
    }
    assert_eq!(survey.overruns, u64::MAX);
}

#[test]
fn records_are_counted_by_code_and_one_that_cannot_be_read_is_something_lost() {
    let mut survey = Survey::default();
    for (code, times) in [(0x7f, 3), (code::BFEE, 2)] {
        (0..times).for_each(|_| {
            assert!(survey.note(&Next::Record(Stamps::default(), Record { code, body: &[1, 2, 3] })).is_none());
        });
    }
    assert_eq!((survey.records, survey.bad_bfee, survey.bfees()), (5, 2, 0));
    assert_eq!((survey.by_code[&0x7f], survey.by_code[&code::BFEE], survey.losses.len()), (3, 2, 2));
    assert!(survey.lost_something());
    // Of a record, its length field, and its code, which are lost with it.
    assert_eq!(survey.losses.iter().map(|lost| lost.bytes).collect::<Vec<_>>(), [6, 6]);
}

#[test]
fn records_counted_in_a_row_are_those_that_are_counted_each() {
    let body = |antenna_sel, rate_n_flags| {
        let repr = Repr { antenna_sel, rate_n_flags, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        (code::BFEE, body)
    };
    let row: Vec<(u8, Vec<u8>)> = [
        vec![(0x7f, vec![1]); 2],
        vec![body(0x24, 0x101); 3],
        vec![body(0x21, 0x101); 2],
        vec![(0x7f, vec![1])],
        vec![body(0x24, 0x102); 4],
        vec![body(0x24, 0x101), (0, vec![1])],
    ]
    .concat();
    let (mut each, mut in_a_row, mut tally) = (Survey::default(), Survey::default(), Tally::default());
    for (code, body) in &row {
        let record = Next::Record(Stamps::default(), Record { code: *code, body });
        let noted = [each.note(&record), in_a_row.note_in(&mut tally, &record)].map(|noted| noted.map(|(_, who)| who));
        assert_eq!(noted[0], noted[1]);
    }
    in_a_row.settle(&mut tally);
    // Settled again it counts nothing again.
    in_a_row.settle(&mut tally);
    for survey in [each, in_a_row] {
        assert_eq!(survey.by_code, BTreeMap::from([(0, 1), (0x7f, 3), (code::BFEE, 10)]));
        assert_eq!(survey.antenna_sel, BTreeMap::from([(0x21, 2), (0x24, 8)]));
        assert_eq!(survey.rates, BTreeMap::from([(0x101, 6), (0x102, 4)]));
    }
}

#[test]
fn a_log_without_csi_has_no_antennas_and_no_rates() {
    let mut survey = Survey::default();
    survey.note(&Next::Pending);
    assert!(survey.by_code.is_empty(), "nor has nothing a code");
    survey.note(&Next::Record(Stamps::default(), Record { code: 0x7f, body: &[1] }));
    assert_eq!(survey.by_code, BTreeMap::from([(0x7f, 1)]));
    assert!(survey.antenna_sel.is_empty() && survey.rates.is_empty());
}

#[test]
fn a_number_that_is_sent_again_counts_up_too() {
    // Ten records, of which five, or four, repeat the one before: half of them are enough.
    let far = |k: u32| 0x1000_0000 * (k + 1);
    let with = |repeated: usize| [vec![7; repeated + 1], (0..9 - repeated as u32).map(far).collect()].concat();
    assert!(sender(&with(5)).counts_up());
    assert!(!sender(&with(4)).counts_up());
    // Nine records have eight steps, of which four are half.
    let nine = |counting: u32| [(0..=counting).collect(), (0..8 - counting).map(far).collect::<Vec<_>>()].concat();
    assert!(sender(&nine(4)).counts_up());
    assert!(!sender(&nine(3)).counts_up());
}

#[test]
fn a_wsr_record_has_its_drivers_time_and_a_stock_one_the_listeners() {
    let stamps = Stamps { host_us: Some(77), ..Stamps::default() };
    let mut survey = Survey::default();
    let mut host_us = |wsr: Option<Wsr>| {
        let repr = Repr { wsr, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let (_, identity) = survey.note(&Next::Record(stamps, Record { code: code::BFEE, body: &body })).unwrap();
        (identity.host_us, survey.wsr, survey.stock, survey.bfees())
    };
    let wsr = |tv_sec, tv_usec| Some(Wsr { tv_sec, tv_usec, frame_count: Some(0), ..Wsr::default() });
    assert_eq!(host_us(wsr(5, 7)), (Some(5_000_007), 1, 0, 1));
    assert_eq!(host_us(wsr(0, 0)), (Some(77), 2, 0, 2));
    assert_eq!(host_us(None), (Some(77), 2, 1, 3));
}

#[test]
fn the_rate_is_that_of_the_first_4096_steps() {
    // As many of 20 ms as of 10 ms, the upper median of which is 20 ms; one more of 10 ms comes too late.
    let steps = [vec![10_000; 2_048], vec![20_000; 2_048], vec![10_000]].concat();
    let (mut sender, mut at) = (Sender::default(), 0);
    sender.note(None, at, None);
    for step in steps {
        at += step;
        sender.note(None, at, None);
    }
    assert_eq!(sender.rate_hz(), Some(50.0));
}

#[test]
fn half_of_the_range_of_the_drivers_count_is_a_gap_and_more_a_restart() {
    for (step, missing, restarted) in [(0x7fff, 0x7ffe, 0), (0x8000, 0, 1)] {
        let survey = survey([0, step].into_iter().map(|count| (Mac([2; 6]), count, 0x101)));
        assert_eq!((survey.bfee_missing, survey.bfee_restarted), (missing, restarted), "a step of {step}");
    }
}

#[test]
fn what_the_card_says_of_each_record_is_counted() {
    let mut survey = Survey::default();
    let mut hear = |n_rx, n_tx, antenna_sel, noise_dbm, rssi, agc| {
        let repr = Repr { n_rx, n_tx, antenna_sel, noise_dbm, rssi, agc, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        assert!(survey.note(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body })).is_some());
    };
    (0..2).for_each(|_| hear(3, 2, 0x24, -90, [30, 31, 32], 40));
    (0..3).for_each(|_| hear(1, 1, 0, -127, [30, 0, 0], 20));
    hear(2, 3, 0xff, -80, [10, 11, 0], 30);
    assert_eq!(survey.streams, [[3, 0, 0], [0, 0, 1], [0, 2, 0]]);
    assert_eq!((survey.antenna_sel[&0x24], survey.antenna_sel[&0], survey.antenna_sel[&0xff]), (2, 3, 1));
    assert_eq!((survey.bad_permutations, survey.noise_unknown), (1, 3));
    let range = |range: Range| (range.min, range.max, range.count);
    assert_eq!(range(survey.noise_dbm), (-90, -80, 3));
    assert_eq!(survey.rssi.map(range), [(10, 30, 6), (11, 31, 3), (32, 32, 2)], "0 is no antenna");
    assert_eq!((range(survey.agc), survey.agc.mean), ((20, 40, 6), 170.0 / 6.0));
    let broken = [0; 40];
    (0..2).for_each(|_| {
        survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &broken }));
    });
    assert_eq!((survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (0, 2), "no frame of the log has one");
    let ack = [0xd4, 0, 0, 0, 2, 2, 2, 2, 2, 2];
    let ack = [&ack[..], &driver_iface::mpdu::crc32(&ack).to_le_bytes()].concat();
    survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &ack }));
    assert_eq!((survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (2, 0), "all frames of the log have one");
}

#[test]
fn a_pause_longer_than_the_cards_clock_is_seen_by_the_hosts() {
    let mut survey = Survey::default();
    // An hour and a half between the second and the third: the card's clock wrapped once.
    let hour_us = 3_600_000_000_i64;
    let at = [5_000_000, 5_010_000, 5_010_000 + 3 * hour_us / 2, 5_020_000 + 3 * hour_us / 2];
    for now_us in at {
        let repr = Repr { timestamp_low: now_us as u32, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let stamps = Stamps { host_us: Some(1_700_000_000_000_000 + now_us), ..Stamps::default() };
        survey.note(&Next::Record(stamps, Record { code: code::BFEE, body: &body }));
    }
    assert_eq!(survey.clock_us, Some((at[0], at[3])));
    assert_eq!(survey.host_us, Some((1_700_000_000_000_000 + at[0], 1_700_000_000_000_000 + at[3])));
    let steps = survey.clock_steps;
    assert_eq!((steps.pauses, steps.longest_pause_us, steps.forward_us), (1, 3 * hour_us / 2, at[3] - at[0]));
    assert_eq!(survey.host_steps.set, 0);
}

#[test]
fn there_is_no_rate_without_a_step_forward() {
    let rate = |clocks: &[u32]| {
        let mut sender = Sender::default();
        clocks.iter().for_each(|clock| sender.note(None, *clock, None));
        (sender.rate_hz(), sender.mean_rate_hz())
    };
    assert_eq!([rate(&[]), rate(&[5]), rate(&[5, 5])], [(None, None); 3]);
    assert_eq!(rate(&[5, 1_005]), (Some(1_000.0), Some(1_000.0)));
    assert_eq!(rate(&[9_000_000, 5]).1, None, "the clock stepped back");
}

fn made_up(n: u32) -> Mac {
    let [_, a, b, c] = n.to_be_bytes();
    Mac([2, 0x66, 0, a, b, c])
}

#[test]
fn a_busy_stranger_has_a_place_among_any_number_of_made_up_ones() {
    // Made up before it came, and three for each of its records.
    let before = (0..1_000).map(made_up);
    let busy = Mac([2; 6]);
    let among = (0..2_000).flat_map(|n| [made_up(1_000 + 3 * n), made_up(1_001 + 3 * n), busy, made_up(1_002 + 3 * n)]);
    let survey = survey(before.chain(among).map(|mac| (mac, 0, 0x101)));
    let sender = &survey.senders[&busy];
    assert!(sender.records >= 1_990, "{}", sender.records);
    assert_eq!(survey.senders.len(), SENDERS_KEPT);
    let kept: u64 = survey.senders.values().map(|sender| sender.records).sum();
    assert_eq!(kept + survey.further_senders, 9_000, "every record is counted once");
}

#[test]
fn strangers_of_long_ago_make_room() {
    let old = (0..SENDERS_KEPT as u32).flat_map(|n| vec![made_up(n); if n == 0 { 5_000 } else { 50 }]);
    // One in twenty is of a robot that came later.
    let late = Mac([2; 6]);
    let later = (0..60_000).map(|n| if n % 20 == 0 { late } else { made_up(1_000 + n) });
    let survey = survey(old.chain(later).map(|mac| (mac, 0, 0x101)));
    let records = survey.senders[&late].records;
    assert!(records >= 1_500, "{records} of 3,000");
    assert!(!survey.senders.contains_key(&made_up(0)), "nothing was heard of it since, however much before");
}

#[test]
fn who_is_known_keeps_its_place_among_any_number_of_strangers() {
    let known = Mac([2; 6]);
    let heard = || [known].into_iter().chain((0..1_000).map(made_up)).map(|mac| (mac, 0, 0x101));
    let survey = heard_by(Survey::with_known([known]), heard());
    assert_eq!((survey.senders[&known].records, survey.senders.len()), (1, SENDERS_KEPT + 1));
    assert!(!heard_by(Survey::default(), heard()).senders.contains_key(&known));
}
