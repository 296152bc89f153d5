use super::*;
use crate::bfee::{Antennas, Bfee, Layout, MAX_BODY};
use std::vec;
use std::vec::Vec;

/// 0xC0 with RSSI 33, 32, 31, gain 40, time 0x0102030405, MCS 1, one configured word with the order C, B, A.
fn phy() -> Vec<u8> {
    let mut data = vec![0; 64];
    data[1] = 1;
    data[4..12].copy_from_slice(&0x01_0203_0405_u64.to_le_bytes());
    data[24..28].copy_from_slice(&(40_u32 << 9 | 0x1ff).to_le_bytes());
    data[28..32].copy_from_slice(&(32_u32 << 16 | 33).to_le_bytes());
    data[32] = 31;
    data[52..56].copy_from_slice(&0x4101_u32.to_le_bytes());
    data[60] = 0x06;
    data
}

/// 0xC1 with a frame of 57 bytes, number 0x01020304, from 00:21:6a:00:00:07.
fn mpdu() -> Vec<u8> {
    let mut data = vec![0; 4 + 57 + 4];
    data[0] = 57;
    data[4 + 16..4 + 22].copy_from_slice(&[0, 0x21, 0x6a, 0, 0, 7]);
    data[4 + 24..4 + 28].copy_from_slice(&[1, 2, 3, 4]);
    data[4 + 57] = 3;
    data
}

/// 0xBB of 3x1 chains, CSI bytes 1, 2, 3 ...
fn csi() -> Vec<u8> {
    let mut data = vec![0x77; 20];
    (data[8], data[9]) = (3, 1);
    data[16..18].copy_from_slice(&192_u16.to_le_bytes());
    data.extend((0..192).map(|k| k as u8));
    data
}

/// Handles all packets of a stream; returns the records as code and body.
fn records(card: &mut Card, options: &Options, stream: &[(u8, Vec<u8>)]) -> Vec<(u8, Vec<u8>)> {
    let mut body = [0; MAX_BODY];
    let one = |(command, data): &(u8, Vec<u8>)| {
        let record = card.handle(options, &Packet::new(*command, data), 1_700_000_000_000_123, &mut body)?;
        Some((record.code, record.body.to_vec()))
    };
    stream.iter().filter_map(one).collect()
}

#[test]
fn the_three_packets_of_a_frame_are_a_record() {
    let (mut card, options) = (Card::default(), Options::default().with_frames(true));
    let got = records(&mut card, &options, &[(0xC0, phy()), (0xC1, mpdu()), (0xBB, csi())]);
    assert_eq!(got[0], (0xC1, mpdu()[4..61].to_vec()));
    let bfee = Bfee::new_checked(&got[1].1).unwrap();
    assert_eq!((bfee.layout(), bfee.timestamp_low(), bfee.bfee_count()), (Layout::Wsr, 0x0203_0405, 1));
    assert_eq!((bfee.rssi(), bfee.agc(), bfee.noise_dbm(), bfee.rate_n_flags()), ([33, 32, 31], 40, -127, 0x0101));
    assert_eq!((bfee.antenna_sel(), bfee.reserved(), bfee.payload()), (0x06, 0x7777, &csi()[20..]));
    let wsr = bfee.wsr().unwrap();
    assert_eq!((wsr.tv_sec, wsr.tv_usec, wsr.frame_count), (1_700_000_000, 123, Some(0x0102_0304)));
    assert_eq!(wsr.mac, "00:21:6a:00:00:07".parse().unwrap());
    let expect = Counts { phy: 1, mpdu: 1, bfee: 1, records: 1, ..Counts::default() };
    assert_eq!((got.len(), card.counts(), expect.dropped()), (2, expect, 0));
}

#[test]
fn nothing_of_another_frame_is_ever_used() {
    let options = Options::default();
    let count = |stream: &[(u8, Vec<u8>)]| {
        let mut card = Card::default();
        (records(&mut card, &options, stream).len(), card.counts())
    };
    let [c0, c1, bb] = [(0xC0, phy()), (0xC1, mpdu()), (0xBB, csi())];
    let short = |(command, data): &(u8, Vec<u8>)| (*command, data[..data.len() - 9].to_vec());
    // A second 0xBB; one before any 0xC0; one after an unreadable 0xC0; one after a firmware restart.
    assert_eq!(count(&[c0.clone(), c1.clone(), bb.clone(), bb.clone()]).1.no_phy, 1);
    assert_eq!(
        count(&[c1.clone(), bb.clone()]).1,
        Counts { mpdu: 1, mpdu_no_phy: 1, bfee: 1, no_phy: 1, ..Counts::default() }
    );
    assert_eq!(count(&[c0.clone(), short(&c0), bb.clone()]).0, 0);
    assert_eq!(count(&[c0.clone(), c1.clone(), (0x01, vec![]), bb.clone()]).1.no_phy, 1);
    // The previous frame's sender is not this frame's.
    assert_eq!(count(&[c0.clone(), c1.clone(), c0.clone(), bb.clone()]).1.no_sender, 1);
    assert_eq!(count(&[c0.clone(), c1.clone(), short(&c1), bb.clone()]).1.no_sender, 1);
    // Packets are missing.
    let (mut card, mut body) = (Card::default(), [0; MAX_BODY]);
    assert!(card.handle(&options, &Packet::new(0xC0, &c0.1), 0, &mut body).is_none());
    card.gap();
    assert!(card.handle(&options, &Packet::new(0xBB, &bb.1), 0, &mut body).is_none());
    assert_eq!((card.counts().records, card.counts().no_phy), (0, 1));
}

#[test]
fn an_unreported_order_names_no_antenna() {
    for (said, len) in [(0, 64), (1, 60), (1, 63)] {
        let mut c0 = phy();
        c0[1] = said;
        c0.truncate(len);
        let mut card = Card::default();
        let got = records(&mut card, &Options::default().with_layout(Layout::Stock), &[(0xC0, c0), (0xBB, csi())]);
        let bfee = Bfee::new_checked(&got[0].1).unwrap();
        assert_eq!((bfee.layout(), bfee.antenna_sel(), card.counts().no_order), (Layout::Stock, ORDER_UNKNOWN, 1));
        assert!(bfee.antennas().is_err());
        // With one chain, it is the only antenna with a nonzero RSSI.
        assert!(Antennas::new(ORDER_UNKNOWN, 1, [0, 30, 0]).is_ok());
    }
}

#[test]
fn refusals_say_what_is_wrong() {
    assert_eq!(RxPhy::new_checked(&[0; 59]), Err(BadPacket::Phy { got: 59 }));
    let mut long = mpdu();
    long[0] = 58;
    assert_eq!(RxMpdu::new_checked(&long).unwrap_err(), BadPacket::Mpdu { byte_count: 58, got: 65 });
    assert!(RxMpdu::from_start(65, &mpdu()[..31], 3).is_err() && RxMpdu::from_start(65, &mpdu()[..32], 3).is_ok());
    let whole = mpdu();
    let checked = RxMpdu::new_checked(&whole).unwrap();
    assert_eq!((checked.byte_count(), checked.frame()), (57, whole.get(4..61)));
    assert!(
        (whole.len() - 8..whole.len()).all(|len| RxMpdu::from_start(len, &whole, 3).is_err()),
        "no room for the status"
    );
    let mut bb = csi();
    bb.truncate(211);
    assert_eq!(CsiNotification::new_checked(&bb).unwrap_err(), BadPacket::CsiShort { need: 212, got: 211 });
    bb[16] = 191;
    let refused = CsiNotification::new_checked(&bb).unwrap_err();
    assert_eq!(refused, BadPacket::Csi(crate::bfee::Error::CsiLength { expect: 192, got: 191 }));
    assert!(std::format!("{refused}").contains("191"));
}

#[test]
fn the_longest_frame_is_that_of_the_longest_record() {
    let packet = |len: u16| {
        let mut data = std::vec![0; 4 + usize::from(len) + STATUS_LEN];
        data[..2].copy_from_slice(&len.to_le_bytes());
        data
    };
    for (len, fits) in [(13, false), (14, true), (8_191, true), (8_192, false)] {
        let data = packet(len);
        assert_eq!(RxMpdu::new_checked(&data).is_ok(), fits, "{len}");
        assert_eq!(RxMpdu::from_start(data.len(), &data, 3).is_ok(), fits, "{len}");
    }
}

#[test]
fn the_kept_beginning_of_a_frame_is_as_long_as_needed() {
    let data = mpdu();
    let frame = |kept: usize| RxMpdu::from_start(data.len(), &data[..kept], 3).map(|mpdu| mpdu.byte_count());
    assert_eq!([frame(32), frame(33), frame(data.len())], [Ok(57); 3]);
    for kept in [2, 3, 4, 5, 31] {
        assert_eq!(frame(kept), Err(BadPacket::Mpdu { byte_count: 57, got: kept }));
    }
    assert_eq!(frame(1), Err(BadPacket::Mpdu { byte_count: 0, got: data.len() }));
}

#[test]
fn an_event_with_a_frames_beginning_identifies_the_frame() {
    let (data, mut bytes) = (mpdu(), [0; 128]);
    let kept = [&data[..36], &3_u32.to_le_bytes()].concat();
    let start = EventRepr { data_len: 65, command: 0xC1, flags: 1, ..EventRepr::default() };
    start.emit(&kept, &mut bytes).unwrap();
    let sender = |bytes: &[u8]| match Event::new_checked(bytes).unwrap().packet() {
        Packet::RxMpdu(Ok(frame)) => (frame.byte_count(), frame.sender()),
        other => panic!("{other:?}"),
    };
    let right = (57, Some(("00:21:6a:00:00:07".parse().unwrap(), 0x0102_0304)));
    assert_eq!(sender(&bytes), right);
    // An uncut event has its status at its own end.
    EventRepr { flags: 0, ..start }.emit(&data, &mut bytes).unwrap();
    assert_eq!(sender(&bytes), right);
}

#[test]
fn unwanted_records_are_not_returned() {
    let packets = [(0xC0, phy()), (0xC1, mpdu()), (0xBB, csi())];
    for (csi, frames, codes) in
        [(true, false, &[0xBB][..]), (true, true, &[0xC1, 0xBB]), (false, true, &[0xC1]), (false, false, &[])]
    {
        let options = Options::default().with_csi(csi).with_frames(frames);
        let got = records(&mut Card::default(), &options, &packets);
        assert_eq!(got.iter().map(|(code, _)| *code).collect::<Vec<u8>>(), codes, "csi {csi}, frames {frames}");
    }
}

#[test]
fn only_a_cut_frame_has_its_status_at_the_end() {
    for (command, flags, kept) in [(0xC1, 1, 12), (0xC1, 0, 8), (0xBB, 1, 8), (0xBB, 0, 8)] {
        let fields = EventRepr { data_len: 8, command, flags, ..EventRepr::default() };
        let mut bytes = [0; 64];
        for (len, fits) in [(kept, true), (kept + 1, false)] {
            fields.emit(&[7; 13][..len], &mut bytes).unwrap();
            assert_eq!(Event::new_checked(&bytes).is_ok(), fits, "{command:#x} {flags} {len}");
        }
    }
}

#[test]
fn events_round_trip() {
    let fields = EventRepr {
        card: 0x1122_3344_5566_7788,
        time_ns: 0x0102_0304_0506_0708,
        ring_full: 0x0a0b_0c0d,
        unreadable: 0x1a1b_1c1d,
        data_len: 0x0102_0304,
        command: 0xBB,
        flags: 0,
    };
    let mut bytes = [0xee; 64];
    let len = fields.emit(&[5, 6, 7], &mut bytes).unwrap();
    let event = Event::new_checked(&bytes).unwrap();
    assert_eq!((len, event.card(), event.time_ns()), (35, fields.card, fields.time_ns));
    assert_eq!((event.ring_full(), event.unreadable()), (fields.ring_full, fields.unreadable));
    assert_eq!((event.data_len(), event.command(), event.flags()), (0x0102_0304, 0xBB, 0));
}

#[test]
fn a_good_and_long_enough_frame_names_the_sender() {
    let sender = |status: u32, byte_count: u8| {
        let mut data = mpdu();
        data[0] = byte_count;
        RxMpdu::from_start(data.len(), &data, status).unwrap().sender()
    };
    let right = ("00:21:6a:00:00:07".parse().unwrap(), 0x0102_0304);
    // Address 3 and the number end at byte 28; the checksum follows.
    assert_eq!([sender(3, 57), sender(3, 32), sender(3, 31)], [Some(right), Some(right), None]);
    // A wrong checksum, an overflow, both.
    assert_eq!([sender(1, 57), sender(2, 57), sender(0, 57)], [None; 3]);
}

#[test]
fn dropped_counts_every_notification_without_a_record() {
    let counts = Counts { bfee: 9, records: 4, bad_bfee: 2, no_phy: 3, ..Counts::default() };
    assert_eq!((counts.dropped(), counts.plus(&counts).dropped()), (5, 10));
    assert_eq!(Counts { bad_bfee: u32::MAX, ..counts }.dropped(), 2);
}
