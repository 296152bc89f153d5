use super::*;
use driver_iface::bfee::{Iq, Repr, Wsr};

fn sender(numbers: &[u32]) -> Sender {
    let mut sender = Sender::default();
    for (at, number) in numbers.iter().enumerate() {
        sender.note(Some(*number), 10_000 * at as u32);
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
    let mut survey = Survey::default();
    for (mac, bfee_count, rate_n_flags) in records {
        let wsr = Wsr { mac, frame_count: 1, ..Wsr::default() };
        let repr = Repr { bfee_count, rate_n_flags, wsr: Some(wsr), ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let record = Record { code: code::BFEE, body: &body };
        assert!(survey.note(&Next::Record(Stamps::default(), record)).is_some());
    }
    survey
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
}
