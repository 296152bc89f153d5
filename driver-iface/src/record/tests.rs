use super::*;
use crate::bfee::{self, Iq};
use crate::mpdu;
use proptest::collection::vec;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// A bfee record whose samples depend on `seed`.
pub(super) fn bfee_record(seed: u8, n_rx: u8, n_tx: u8, wsr: bool) -> Vec<u8> {
    let wsr = wsr.then(|| bfee::Wsr { tv_sec: 1, frame_count: Some(seed.into()), ..bfee::Wsr::default() });
    let timestamp_low = u32::from(seed) << 20 | 0x1234;
    let repr = bfee::Repr { n_rx, n_tx, bfee_count: seed.into(), timestamp_low, wsr, ..bfee::Repr::default() };
    let mut state = u32::from(seed) + 1;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as i8
    };
    let csi: Vec<Iq> = (0..repr.samples()).map(|_| Iq { i: next(), q: next() }).collect();
    let mut body = vec![0; repr.body_len()];
    repr.emit(&csi, &mut body).unwrap();
    framed(code::BFEE, &body)
}

pub(super) fn mpdu_record(seed: u8, len: usize) -> Vec<u8> {
    let payload: Vec<u8> = (0..len).map(|k| (k as u8).wrapping_mul(37) ^ seed).collect();
    let addr = crate::Mac([0, 0x16, 0xea, 0x12, 0x34, seed]);
    let repr = mpdu::Repr {
        frame_control: 8,
        duration_us: 48,
        addr1: addr,
        addr2: addr,
        addr3: addr,
        seq_ctrl: 0,
        payload: &payload,
    };
    let mut body = vec![0; repr.emit_len()];
    repr.emit(&mut body).unwrap();
    framed(code::MPDU, &body)
}

pub(super) fn framed(code: u8, body: &[u8]) -> Vec<u8> {
    let record = Record { code, body };
    let mut out = vec![0; record.emit_len()];
    assert_eq!(record.emit(&mut out), Ok(out.len()));
    out
}

/// WSR, stock, with MPDUs, with noise and unknown codes.
fn logs() -> Vec<Vec<Vec<u8>>> {
    let wsr = (0..6).map(|k| bfee_record(k, 3, 1, true)).collect();
    let sizes = [(1, 1), (3, 3), (2, 1), (3, 2), (1, 3), (2, 2)];
    let stock = (0..6).map(|k| bfee_record(k, sizes[usize::from(k)].0, sizes[usize::from(k)].1, false)).collect();
    let frames = (0..8).map(|k| if k % 2 == 0 { mpdu_record(k, 101) } else { bfee_record(k, 3, 1, false) }).collect();
    let only_mpdu = (0..9).map(|k| mpdu_record(k, 40 + usize::from(k))).collect();
    let mut mixed = Vec::new();
    for k in 0..4 {
        mixed.push(bfee_record(k, 2, 1, k % 2 == 0));
        mixed.push(framed(code::NOISE, &(-92 - i32::from(k)).to_le_bytes()));
        mixed.push(framed(0x42, &[k; 30]));
    }
    vec![wsr, stock, frames, only_mpdu, mixed]
}

pub(super) fn records(bytes: &[u8]) -> Vec<Vec<u8>> {
    events(bytes)
        .filter_map(|step| match step {
            Step::Record { record, .. } => Some(framed(record.code, record.body)),
            _ => None,
        })
        .collect()
}

/// Intact records that were not found.
fn missing(intact: &[Vec<u8>], found: &[Vec<u8>]) -> usize {
    let mut found = found.iter();
    intact.iter().filter(|record| !found.clone().any(|f| f == *record && found.by_ref().any(|g| g == f))).count()
}

/// The log without the record in which byte `at` lies, and that record's number.
fn without(log: &[Vec<u8>], at: usize) -> Vec<Vec<u8>> {
    let mut end = 0;
    let hit = log.iter().position(|record| {
        end += record.len();
        at < end
    });
    log.iter().enumerate().filter(|(k, _)| Some(*k) != hit).map(|(_, record)| record.clone()).collect()
}

#[test]
fn records_that_continue_after_their_csi_are_accepted() {
    let padded = |seed, behind: usize| {
        let record = bfee_record(seed, 3, 1, seed % 2 == 0);
        framed(code::BFEE, &[&record[3..], &vec![0; behind]].concat())
    };
    for behind in [1, 3, 5] {
        let log: Vec<u8> = (0..9).flat_map(|seed| padded(seed, behind)).collect();
        let steps: Vec<_> = events(&log).collect();
        assert_eq!(steps.len(), 10);
        assert_eq!(steps.last(), Some(&Step::End(Tail::Clean)));
        for step in &steps[..9] {
            let Step::Record { record, .. } = step else { panic!("{step:?}") };
            assert_eq!(bfee::Bfee::new_checked(record.body).unwrap().behind_csi().len(), behind);
        }
        // A wrong length field does not count as such a continuation.
        let mut damaged = (0..9).flat_map(|seed| bfee_record(seed, 3, 1, true)).collect::<Vec<u8>>();
        damaged[1] += behind as u8;
        let found = events(&damaged).filter(|step| matches!(step, Step::Record { .. })).count();
        assert_eq!(found, 8);
    }
}

#[test]
fn complete_records_end_at_their_lengths() {
    let bytes = [0, 2, 0xBB, 1, 0, 1, 0xC1, 0, 3, 1, 2, 3];
    let all: Vec<_> = (0..=bytes.len()).map(|upto| whole_records(&bytes, upto)).collect();
    assert_eq!(all[3], (0, 0));
    assert_eq!(all[4], (4, 1));
    assert_eq!(all[7], (7, 2));
    assert_eq!(all[11], (7, 2));
    assert_eq!(all[12], (12, 3));
}

#[test]
fn intact_logs_are_read_whole() {
    for log in logs() {
        let whole = log.concat();
        assert!(records(&whole) == log);
        assert_eq!(events(&whole).last(), Some(Step::End(Tail::Clean)));
    }
}

#[test]
fn records_of_unknown_codes_are_kept() {
    let unknown = |code: u8| framed(code, &[code; 40]);
    let mut log = vec![bfee_record(0, 3, 1, true)];
    log.extend((0..20).map(|_| unknown(0x42)));
    log.extend((0..20).map(|k| unknown(0x43 + k % 2)));
    log.push(framed(0x50, &[]));
    log.push(bfee_record(1, 3, 1, true));
    for log in [&log[..], &log[1..], &log[..21]] {
        assert!(records(&log.concat()) == log);
    }
}

#[test]
fn a_lost_byte_costs_its_record_and_at_most_one_more() {
    for (which, log) in logs().iter().enumerate() {
        let whole = log.concat();
        let last = whole.len() - log.last().unwrap().len();
        let mut lost = 0;
        for at in 0..last {
            let mut cut = whole.clone();
            cut.remove(at);
            let missing = missing(&without(log, at), &records(&cut));
            lost += missing;
            assert!(missing <= 1, "log {which}, byte {at}: {missing} intact records lost");
        }
        // Only a record of unknown code right after the damage may be lost with it.
        let allowed = if which == 4 { last / 2 } else { 0 };
        assert!(lost <= allowed, "log {which}: {lost} intact records lost over all {last} cuts");
    }
}

#[test]
fn garbage_costs_its_record_and_at_most_one_more() {
    let mut state = 7_u32;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    for (which, log) in logs().iter().enumerate() {
        let whole = log.concat();
        let mut lost = 0;
        for at in 0..whole.len() {
            let garbage: Vec<u8> = match at % 3 {
                0 => vec![0; 100],
                1 => vec![0xff; 100],
                _ => (0..100).map(|_| next()).collect(),
            };
            let mut damaged = whole.clone();
            damaged.splice(at..at, garbage);
            let missing = missing(&without(log, at), &records(&damaged));
            lost += missing;
            assert!(missing <= 1, "log {which}, byte {at}: {missing} intact records lost");
        }
        let allowed = if which == 4 { whole.len() / 2 } else { 0 };
        assert!(lost <= allowed, "log {which}: {lost} intact records lost over all {} places", whole.len());
    }
}

#[test]
fn a_cut_tail_is_reported_with_its_place() {
    let whole = logs()[0].concat();
    let last = 5 * 233;
    for len in last + 1..whole.len() {
        let steps: Vec<_> = events(&whole[..len]).collect();
        let expected = (len - last >= 23).then_some(233);
        let tail = Tail::Cut { offset: last as u64, bytes: (len - last) as u64, expected };
        assert_eq!(steps.last(), Some(&Step::End(tail)));
        assert_eq!(steps.len(), 6);
        assert!(!tail.is_unflushed_buffer());
    }
    let tail = Tail::Cut { offset: 4000, bytes: 96, expected: Some(233) };
    assert!(tail.is_unflushed_buffer() && !Tail::Clean.is_unflushed_buffer());
}

#[test]
fn damage_has_a_reason_with_numbers() {
    let mut log: Vec<Vec<u8>> = (0..4).map(|k| bfee_record(k, 3, 1, true)).collect();
    let reason_of = |log: &[Vec<u8>]| {
        let bytes = log.concat();
        let bad: Vec<_> = events(&bytes)
            .filter_map(|step| match step {
                Step::Bad { offset, skipped, reason } => Some((offset, skipped, reason)),
                _ => None,
            })
            .collect();
        assert_eq!(bad.len(), 1, "{bad:?}");
        assert_eq!(records(&bytes).len(), log.len() - 1);
        bad[0]
    };
    let mut with = |change: &dyn Fn(&mut Vec<u8>)| {
        let intact = log[1].clone();
        change(&mut log[1]);
        let reason = reason_of(&log);
        log[1] = intact;
        reason
    };
    assert_eq!(with(&|r| r[..2].fill(0)), (233, 233, Reason::ZeroLength));
    assert_eq!(with(&|r| r[0] = 0x20), (233, 233, Reason::ImpossibleLength { got: 0x20e7, max: 8192 }));
    assert_eq!(
        with(&|r| r[..2].copy_from_slice(&[0x20, 0])),
        (233, 233, Reason::Overlapped { expect: 8194, got: 233 })
    );
    assert_eq!(with(&|r| r[1] = 0xe8), (233, 233, Reason::NotFollowed { code: code::BFEE, expect: 234 }));
    assert_eq!(with(&|r| r[1] = 0x40), (233, 233, Reason::BfeeLength { got: 0x40 }));
    let chains = |n_rx| Reason::Bfee(bfee::Error::Chains { n_rx, n_tx: 1 });
    assert_eq!(with(&|r| r[11] = 0), (233, 233, chains(0)));
    assert_eq!(with(&|r| r[11] = 4), (233, 233, chains(4)));
    let seven = Reason::Bfee(bfee::Error::Chains { n_rx: 7, n_tx: 7 });
    assert_eq!(with(&|r| *r = framed(code::BFEE, &[7; 8191])), (233, 8194, seven));
    let overlapped = Reason::Overlapped { expect: 233, got: 232 };
    assert_eq!(with(&|r| r.truncate(232)), (233, 232, overlapped));
    assert_eq!(with(&|r| drop(r.splice(50..50, [0x55; 10]))), (233, 243, Reason::GapBits));
}

#[test]
fn other_files_yield_no_record() {
    let text = "It was a bright cold day in April, and the clocks were striking thirteen.\n".repeat(3000);
    let same = |byte: u8| vec![byte; 100_000];
    for bytes in [text.as_bytes(), b"hi\n", b"x", &same(0), &same(0x41), &same(0xff), &same(b'\n')] {
        assert!(records(bytes).is_empty());
    }
    assert_eq!(events(&[]).collect::<Vec<_>>(), [Step::End(Tail::Clean)]);
    // Damage of any length is one report and its continuations.
    let zeros = same(0);
    let reasons: Vec<_> = events(&zeros).collect();
    assert!(matches!(reasons[0], Step::Bad { offset: 0, reason: Reason::ZeroLength, .. }));
    let skipped: usize = reasons.iter().map(|s| if let Step::Bad { skipped, .. } = s { *skipped } else { 0 }).sum();
    assert_eq!(skipped, zeros.len());
    let middle = &reasons[1..reasons.len() - 1];
    assert!(middle.iter().all(|step| matches!(step, Step::Bad { reason: Reason::StillLost, .. })));
}

#[test]
fn random_bytes_yield_no_record() {
    let mut state = 1_u64;
    let bytes: Vec<u8> = (0..4_000_000)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        })
        .collect();
    assert!(records(&bytes).is_empty());
}

/// The steps if the stream arrives in chunks of the given sizes, repeated.
pub(super) fn in_chunks(bytes: &[u8], sizes: &[usize]) -> Vec<(u64, usize, Option<Reason>)> {
    let (mut framer, mut steps) = (Framer::new(), Vec::new());
    let (mut from, mut to) = (0, 0);
    let mut sizes = sizes.iter().cycle();
    loop {
        match framer.step(&bytes[from..to], to == bytes.len()) {
            Step::Record { offset, used, record } => {
                assert_eq!(used, record.emit_len());
                steps.push((offset, used, None));
                from += used;
            }
            Step::Bad { offset, skipped, reason } => {
                assert!(skipped > 0);
                steps.push((offset, skipped, Some(reason)));
                from += skipped;
            }
            Step::Incomplete => {
                assert!(to - from < LOOKAHEAD, "{LOOKAHEAD} bytes are said to be enough");
                to = (to + sizes.next().unwrap()).min(bytes.len());
            }
            Step::End(_) => return steps,
        }
        assert_eq!(framer.offset(), from as u64);
    }
}

proptest! {
    #[test]
    fn chunks_do_not_matter(
        which in 0..5_usize, cuts in vec((any::<prop::sample::Index>(), 0..3_usize, vec(any::<u8>(), 0..200)), 0..4),
        sizes in vec(1..400_usize, 1..6),
    ) {
        let mut bytes = logs()[which].concat();
        for (at, remove, insert) in cuts {
            let at = at.index(bytes.len());
            let to = (at + remove).min(bytes.len());
            bytes.splice(at..to, insert);
        }
        prop_assert_eq!(in_chunks(&bytes, &sizes), in_chunks(&bytes, &[bytes.len()]));
    }

    #[test]
    fn every_byte_is_accounted_for(parts in vec((0..5_usize, any::<prop::sample::Index>(), vec(any::<u8>(), 0..30)), 0..8)) {
        let logs = logs();
        let mut bytes = Vec::new();
        for (which, record, garbage) in &parts {
            bytes.extend_from_slice(&logs[*which][record.index(logs[*which].len())]);
            bytes.extend_from_slice(garbage);
        }
        let mut at = 0;
        for step in events(&bytes) {
            match step {
                Step::Record { offset, used: n, .. } | Step::Bad { offset, skipped: n, .. } => {
                    prop_assert_eq!(offset, at);
                    at += n as u64;
                }
                Step::End(Tail::Clean) => prop_assert_eq!(at, bytes.len() as u64),
                Step::End(Tail::Cut { offset, bytes: n, .. }) => {
                    prop_assert_eq!(offset, at);
                    prop_assert_eq!(at + n, bytes.len() as u64);
                }
                Step::Incomplete => prop_assert!(false, "incomplete at the end"),
            }
        }
    }
}

proptest! {
    /// The search for a record inside another tries only these codes.
    #[test]
    fn only_vouching_codes_vouch_for_themselves(mut bytes in vec(any::<u8>(), 23..80), code in any::<u8>(), length in 1_u16..700) {
        bytes[..2].copy_from_slice(&length.to_be_bytes());
        bytes[2] = code;
        let head = head::head(&bytes, &head::Codes::default());
        let sure = matches!(head, head::Head::Good { bits, .. } if bits >= head::SURE);
        prop_assert!(!sure || head::VOUCHING_CODES.contains(&code));
        prop_assert!(!matches!(head, head::Head::Short));
    }
}

/// Any number of foreign bytes before a record costs these bytes and no record.
#[test]
fn foreign_bytes_before_a_record_cost_no_record() {
    for foreign in 0..40 {
        for byte in [0x00, 0xff] {
            let mut stream = vec![byte; foreign];
            let records = [bfee_record(1, 3, 1, true), bfee_record(2, 3, 1, true)];
            stream.extend(records.concat());
            let found = events(&stream).filter(|step| matches!(step, Step::Record { .. })).count();
            let skipped: usize =
                events(&stream).map(|step| if let Step::Bad { skipped, .. } = step { skipped } else { 0 }).sum();
            assert_eq!((found, skipped), (2, foreign), "{foreign} bytes {byte:#x}");
        }
    }
}

#[test]
fn existing_frame_versions_and_types_are_evidence() {
    use super::head::{Codes, Head, head};
    let bits = |control: u8, length: u8| match head(&[0, length, code::MPDU, control], &Codes::default()) {
        Head::Good { bits, .. } => bits,
        other => panic!("{other:?}"),
    };
    // Management, control and data of version 0, of any subtype; not type 3 or other versions.
    for (control, plausible) in
        [(0x00, true), (0xd4, true), (0x08, true), (0x88, true), (0x0c, false), (0x09, false), (0x02, false)]
    {
        assert_eq!(bits(control, 60), if plausible { 13 } else { 0 }, "{control:#04x}");
    }
    // An acknowledgement has 14 bytes, and the code is counted.
    assert_eq!([bits(0xd4, 14), bits(0xd4, 15)], [0, 13]);
}

#[test]
fn known_codes_and_lengths_are_evidence() {
    use super::head::{Codes, Head, SURE, head, likely, sure};
    let bits = |seen: &Codes, bytes: &[u8]| match head(bytes, seen) {
        Head::Good { len, bits } => (len, bits),
        other => panic!("{other:?}"),
    };
    let none = Codes::default();
    // Reports of an aggregated transmission have nine bytes; with another length only the code counts.
    assert_eq!(bits(&none, &[0, 9, code::TX_BLOCK_AGG]), (11, 24));
    assert_eq!([8, 10].map(|length| bits(&none, &[0, length, code::TX_BLOCK_AGG]).1), [8, 8]);
    // An unknown code, until it was met in this log.
    let mut seen = Codes::default();
    seen.insert(0x42);
    assert_eq!([bits(&none, &[1, 2, 0x42]), bits(&seen, &[1, 2, 0x42])], [(0x104, 0), (0x104, 8)]);
    // Noise is four bytes, -255 to -1 dBm.
    let noise = |length: u8, dbm: i32| [&[0, length, code::NOISE][..], &dbm.to_le_bytes()].concat();
    for (length, dbm, is_noise) in
        [(5, -92, true), (5, -255, true), (5, -1, true), (5, 0, false), (5, -256, false), (6, -92, false)]
    {
        let bytes = noise(length, dbm);
        assert_eq!(bits(&none, &bytes), (2 + usize::from(length), if is_noise { SURE } else { 0 }), "{length}, {dbm}");
        assert_eq!((sure(&bytes).is_some(), likely(&bytes, &none)), (is_noise, None), "{length}, {dbm}");
    }
    assert_eq!(head(&noise(5, -92)[..6], &none), Head::Short);
}
