use super::*;
use driver_iface::bfee;
use driver_iface::connector::{CN_IDX, CN_IDX_10_USERS, Repr};

/// A 3x1 bfee body of the stock layout.
fn body(count: u16) -> Vec<u8> {
    let mut body = vec![0; bfee::STOCK_HEADER + bfee::csi_len(3, 1)];
    body[bfee::offset::BFEE_COUNT..][..2].copy_from_slice(&count.to_le_bytes());
    body[bfee::offset::N_RX] = 3;
    body[bfee::offset::N_TX] = 1;
    let len = bfee::csi_len(3, 1) as u16;
    body[bfee::offset::LEN..][..2].copy_from_slice(&len.to_le_bytes());
    body
}

fn datagram(idx: u32, code: u8, body: &[u8]) -> Vec<u8> {
    let repr = Repr { idx, val: CN_VAL, record: Record { code, body }, padded: true };
    let mut out = vec![0; repr.emit_len()];
    repr.emit(&mut out).unwrap();
    out
}

fn put(intake: &mut Intake, bytes: &[u8], port: u32) -> Option<Loss> {
    let kept = bytes.len().min(intake.buffer().len());
    intake.buffer()[..kept].copy_from_slice(&bytes[..kept]);
    intake.datagram(bytes.len(), port)
}

fn intake() -> Intake {
    Intake::new(vec![CN_IDX, CN_IDX_10_USERS], false)
}

/// Puts a bfee in and takes it out again.
fn hand(intake: &mut Intake, count: u16) {
    assert_eq!(put(intake, &datagram(CN_IDX_10_USERS, code::BFEE, &body(count)), 0), None);
    assert!(matches!(intake.turn(), Turn::Record(_)));
    assert_eq!(intake.take().unwrap().body, body(count));
    assert_eq!(intake.turn(), Turn::Receive);
}

#[test]
fn a_record_comes_out_as_it_went_in_and_names_its_index() {
    let mut intake = intake();
    assert_eq!(intake.turn(), Turn::Receive);
    assert_eq!(intake.delivered(), None);
    hand(&mut intake, 7);
    hand(&mut intake, 8);
    assert_eq!(intake.delivered(), Some(CN_IDX_10_USERS));
    assert_eq!(intake.counters, SocketCounts { datagrams: 2, records: 2, ..SocketCounts::default() });
}

#[test]
fn only_the_kernels_messages_are_accepted() {
    let mut intake = intake();
    let bytes = datagram(CN_IDX, code::BFEE, &body(1));
    assert_eq!(put(&mut intake, &bytes, 4242), None);
    assert_eq!(intake.turn(), Turn::Receive);
    assert_eq!((intake.counters.user_senders, intake.counters.records), (1, 0));
    intake.allow_user_sender = true;
    put(&mut intake, &bytes, 4242);
    assert!(matches!(intake.turn(), Turn::Record(_)));
}

#[test]
fn foreign_messages_around_ours_are_skipped() {
    let mut intake = intake();
    let (foreign, ours) = (datagram(1, 0, &[9; 6]), datagram(CN_IDX, code::BFEE, &body(3)));
    // Several cn_msg in one netlink message: the first header stays, the others are dropped, no padding between.
    let mut bytes = foreign[..16 + 20 + 7].to_vec();
    bytes.extend_from_slice(&ours[16..249]);
    bytes.extend_from_slice(&foreign[16..16 + 20 + 7]);
    let len = bytes.len() as u32;
    bytes[..4].copy_from_slice(&len.to_le_bytes());
    assert_eq!(put(&mut intake, &bytes, 0), None);
    assert!(matches!(intake.turn(), Turn::Record(_)));
    assert_eq!(intake.take().unwrap().body, body(3));
    assert_eq!(intake.turn(), Turn::Receive);
    assert_eq!(intake.counters.foreign, 2);
}

#[test]
fn cut_lying_and_oversized_datagrams_are_losses() {
    let mut intake = intake();
    let too_long = vec![0; MAX_DATAGRAM + 1];
    let reason = Refused::Truncated { sent: MAX_DATAGRAM + 1, kept: MAX_DATAGRAM };
    let number_0 = Loss::Datagram { number: 0, len: too_long.len() as u64, reason };
    assert_eq!(put(&mut intake, &too_long, 0), Some(number_0));
    assert_eq!(intake.turn(), Turn::Receive);

    let good = datagram(CN_IDX, code::BFEE, &body(3));
    for cut in 1..249 {
        put(&mut intake, &good[..cut], 0);
        let turn = intake.turn();
        assert!(matches!(turn, Turn::Lost(Loss::Datagram { reason: Refused::Connector(_), .. })), "{cut}: {turn:?}");
        assert_eq!(intake.turn(), Turn::Receive);
    }
    put(&mut intake, &datagram(CN_IDX, code::MPDU, &[0; MAX_LENGTH]), 0);
    let reason = Refused::Oversized { got: MAX_LENGTH + 1, max: MAX_LENGTH };
    assert!(matches!(intake.turn(), Turn::Lost(Loss::Datagram { number: 249, reason: r, .. }) if r == reason));
    assert_eq!(intake.turn(), Turn::Receive);
    assert_eq!((intake.counters.truncated, intake.counters.malformed, intake.counters.records), (1, 249, 0));
}

#[test]
fn an_overrun_is_told_where_the_numbers_jump() {
    let mut intake = intake();
    hand(&mut intake, 10);
    intake.overrun();
    // Still queued from before the gap.
    hand(&mut intake, 11);
    put(&mut intake, &datagram(CN_IDX, code::BFEE, &body(20)), 0);
    assert_eq!(intake.turn(), Turn::AskDrops);
    assert_eq!(intake.report_overrun(Some(8)), Loss::Overrun { dropped: Some(8) });
    assert!(matches!(intake.turn(), Turn::Record(_)));
    assert_eq!(intake.take().unwrap().body, body(20));
    assert!(!intake.drained());
    let counters = intake.counters;
    assert_eq!((counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap), (1, 8, 8));
    assert_eq!(counters.other_bfee_gap, 0);
}

#[test]
fn an_overrun_with_nothing_after_it_is_told_when_the_queue_is_empty() {
    let mut intake = intake();
    hand(&mut intake, 10);
    intake.overrun();
    hand(&mut intake, 11);
    assert!(intake.drained());
    assert_eq!(intake.report_overrun(Some(3)), Loss::Overrun { dropped: Some(3) });
    assert!(!intake.drained());
    // The gap itself is measured later; a later jump is not the overrun's.
    hand(&mut intake, 15);
    hand(&mut intake, 17);
    let counters = intake.counters;
    assert_eq!((counters.kernel_drops, counters.overrun_bfee_gap, counters.other_bfee_gap), (3, 3, 1));
    // The kernel's counter goes on from where it was.
    intake.overrun();
    assert_eq!(intake.report_overrun(Some(5)), Loss::Overrun { dropped: Some(2) });
    assert_eq!(intake.report_overrun(None), Loss::Overrun { dropped: None });
}
