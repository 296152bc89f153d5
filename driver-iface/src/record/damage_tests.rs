//! Damage that looks like records, and records hidden by damage.

use super::tests::{bfee_record, framed, in_chunks, mpdu_record, records};
use super::*;
use crate::bfee::{self, Iq};
use std::vec;
use std::vec::Vec;

/// The damaged stretches of a stream: offset, length, reason.
fn damage(bytes: &[u8]) -> Vec<(u64, usize, Reason)> {
    let bad = events(bytes).filter_map(|step| match step {
        Step::Bad { offset, skipped, reason } => Some((offset, skipped, reason)),
        _ => None,
    });
    bad.collect()
}

#[test]
fn an_unfollowed_record_is_reported_with_its_code() {
    let good = [bfee_record(1, 3, 1, true), bfee_record(2, 3, 1, true)];
    let stream = [framed(0x42, &[0; 10]), vec![0; 7], good.concat()].concat();
    assert_eq!(damage(&stream), [(0, 20, Reason::NotFollowed { code: 0x42, expect: 13 })]);
    assert!(records(&stream) == good);
    // The stream's end does not vouch for half a record either.
    let half = [good.concat(), framed(0x42, &[0; 10])[..9].to_vec()].concat();
    assert_eq!(damage(&half), [(466, 9, Reason::NotFollowed { code: 0x42, expect: 13 })]);
}

#[test]
fn any_number_of_frames_with_wrong_checksums_is_refused() {
    // 120 KB of them, each after foreign bytes and before a bfee: only the checksum shows that it is damaged.
    let mut wrong = mpdu_record(3, 3000);
    *wrong.last_mut().unwrap() ^= 1;
    let round = |k: u8| [bfee_record(k, 3, 1, true), vec![0xff; 5], wrong.clone(), bfee_record(k + 100, 3, 1, true)];
    let stream: Vec<u8> = (0..40).flat_map(|k| round(k).concat()).collect();
    let bfees: Vec<Vec<u8>> = (0..40).flat_map(|k| [k, k + 100]).map(|k| bfee_record(k, 3, 1, true)).collect();
    assert!(records(&stream) == bfees);
}

#[test]
fn records_whose_unknown_code_equals_their_length_are_kept() {
    for length in [0x42_u8, 0x13] {
        let log = vec![framed(length, &vec![7; usize::from(length) - 1]); 20];
        assert!(records(&log.concat()) == log, "{length}");
    }
}

/// Part of a bfee is lost, and the bytes where its length ends, inside the next record, happen to lead to the one after that.
#[test]
fn a_chance_successor_hides_no_record() {
    let [cut, mut hidden, last] = [1, 2, 3].map(|k| bfee_record(k, 3, 1, true));
    let kept = 133;
    let lands = cut.len() - kept;
    let leads = u16::try_from(hidden.len() - lands - 2).unwrap().to_be_bytes();
    hidden[lands..lands + 3].copy_from_slice(&[leads[0], leads[1], 0x42]);
    let stream = [&cut[..kept], &hidden, &last].concat();
    assert_eq!(damage(&stream), [(0, kept, Reason::Overlapped { expect: 233, got: kept })]);
    assert!(records(&stream) == [hidden, last]);
}

/// A frame loses as many bytes as the following bfee has: where its length ends, a record begins.
#[test]
fn a_bfee_in_place_of_a_frames_end_is_found() {
    for (n_rx, n_tx, wsr) in [(1, 1, false), (3, 1, true), (2, 3, false), (3, 3, false), (3, 3, true)] {
        let [first, hidden, last] = [1, 2, 3].map(|k| bfee_record(k, n_rx, n_tx, wsr));
        let frame = mpdu_record(4, 900);
        let kept = frame.len() - hidden.len();
        let stream = [&first, &frame[..kept], &hidden, &last].concat();
        let reason = Reason::Overlapped { expect: frame.len(), got: kept };
        assert_eq!(damage(&stream), [(first.len() as u64, kept, reason)], "{n_rx} x {n_tx}");
        assert!(records(&stream) == [first, hidden, last], "{n_rx} x {n_tx}");
    }
}

#[test]
fn a_record_after_long_damage_is_found() {
    for foreign in [16_380, 20_000, 33_000, 50_000] {
        let log = [bfee_record(1, 3, 1, true), bfee_record(2, 2, 2, false)];
        let stream = [vec![0; foreign], log.concat()].concat();
        assert!(records(&stream) == log, "{foreign}");
        assert_eq!(damage(&stream).iter().map(|(_, skipped, _)| skipped).sum::<usize>(), foreign);
    }
}

/// The last four bytes of a frame are lost. The following bfee has numbers that look like a noise record at the frame's expected
/// end: with only these bytes, nothing can be decided yet.
#[test]
fn the_framer_waits_for_a_record_that_begins_in_the_last_bytes() {
    let noise = framed(code::NOISE, &(-92_i32).to_le_bytes());
    let repr = bfee::Repr {
        timestamp_low: u32::from_le_bytes([0, noise[0], noise[1], noise[2]]),
        bfee_count: u16::from_le_bytes([noise[3], noise[4]]),
        reserved: u16::from_le_bytes([noise[5], noise[6]]),
        n_rx: 3,
        n_tx: 1,
        ..bfee::Repr::default()
    };
    let mut body = vec![0; repr.body_len()];
    repr.emit(&vec![Iq { i: 1, q: 2 }; repr.samples()], &mut body).unwrap();
    let (frame, hidden) = (mpdu_record(4, 60), framed(code::BFEE, &body));
    assert_eq!(hidden[4..11], noise);
    let kept = frame.len() - 4;
    let stream = [&frame[..kept], &hidden, &bfee_record(1, 3, 1, true)].concat();
    let whole = in_chunks(&stream, &[stream.len()]);
    assert_eq!(whole[0], (0, kept, Some(Reason::Overlapped { expect: frame.len(), got: kept })));
    assert_eq!(whole.len(), 3);
    for first in frame.len()..frame.len() + 30 {
        assert_eq!(in_chunks(&stream, &[first, stream.len()]), whole, "the first {first} bytes");
    }
}

/// Each new byte has the same front judged again. Its checksum is computed once: with the credit used up, a later frame with a bad
/// checksum would count as unchecked and be accepted.
#[test]
fn a_doubtful_frame_is_checked_once_in_any_chunks() {
    let mut wrong = mpdu_record(4, 60);
    *wrong.last_mut().unwrap() ^= 1;
    let good = [bfee_record(1, 3, 1, true), bfee_record(2, 3, 1, true)].concat();
    let stream = [wrong.as_slice(), &[0; 2_000], &wrong, &good].concat();
    let whole = in_chunks(&stream, &[stream.len()]);
    assert_eq!((whole[0].1, whole.len()), (stream.len() - good.len(), 3));
    assert_eq!(in_chunks(&stream, &[1]), whole);
}
