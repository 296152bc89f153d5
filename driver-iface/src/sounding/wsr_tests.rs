use super::*;
use crate::sounding::{HEADER_LEN, MAGIC_MAC};
use proptest::prelude::*;
use std::vec::Vec;

/// The register as WSR writes it, one shift at a time.
fn slow_byte(state: &mut u32) -> u8 {
    for _ in 0..8 {
        let bit = (*state >> 31 ^ *state >> 29 ^ *state >> 25 ^ *state >> 24) & 1;
        *state = *state << 1 | bit;
    }
    *state as u8
}

#[test]
fn filler_equals_the_bitwise_register_and_the_bytes_on_air() {
    let (mut fast, mut slow) = (Lfsr::default(), 0x1f3d_5b79);
    // First payload bytes of frames 1 to 3 of csiread's sample_0x5_64_3000.dat (100 payload bytes each, no number).
    let on_air: [[u8; 6]; 3] = [
        [0x32, 0x33, 0x54, 0x48, 0x6f, 0x81],
        [0x7c, 0x5d, 0x0f, 0xb6, 0xb4, 0xed],
        [0x67, 0xcb, 0x81, 0x10, 0xef, 0xc5],
    ];
    for expect in on_air {
        let window: Vec<u8> = (0..100).map(|_| fast.next_byte()).collect();
        assert_eq!(window[..6], expect);
        assert!(window.iter().all(|byte| *byte == slow_byte(&mut slow)));
    }
}

#[test]
fn the_header_equals_the_stock_senders_except_addr3_and_duration() {
    // Header of frame 1 of sample_0x5_64_3000.dat; the card rewrote the duration to 48 us.
    let on_air = [
        0x08, 0x00, 0x30, 0x00, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0xff, 0xff,
        0xff, 0xff, 0xff, 0xff, 0x00, 0x00,
    ];
    let mut buffer = [0; 64];
    let repr = Repr { sender: Mac([0xff; 6]), number: 1, len_with_fcs: 57 };
    assert_eq!(repr.emit(&mut buffer, &mut Lfsr::default()), Ok(53));
    assert_eq!(buffer[..2], on_air[..2]);
    assert_eq!(buffer[2..4], [0xff, 0xff]);
    assert_eq!(buffer[4..HEADER_LEN], on_air[4..]);
    assert_eq!(buffer[24..34], [0, 0, 0, 1, 0x32, 0x33, 0x54, 0x48, 0x6f, 0x81]);
}

#[test]
fn the_counter_stays_true_and_the_filler_runs_on_beyond_68_966_frames() {
    let (mut filler, mut slow) = (Lfsr::default(), 0x1f3d_5b79);
    let mut buffer = [0; 64];
    for number in 1..=150_000u32 {
        let repr = Repr { sender: Mac([2; 6]), number, len_with_fcs: 57 };
        let len = repr.emit(&mut buffer, &mut filler).unwrap();
        let frame = Frame::new_checked(&buffer[..len]).unwrap();
        assert_eq!(Repr::parse(&frame), repr);
        assert_eq!(frame.body(), &buffer[28..len]);
        assert!(frame.body().iter().all(|byte| *byte == slow_byte(&mut slow)));
    }
}

#[test]
fn an_answer_is_the_forward_frame_grown_by_five_with_the_responders_mac() {
    let mut buffer = [0; 64];
    let len =
        Repr { sender: Mac([2; 6]), number: 9, len_with_fcs: 59 }.emit(&mut buffer, &mut Lfsr::default()).unwrap();
    let forward = Frame::new_checked(&buffer[..len]).unwrap();
    let mut reply = [0xee; 64];
    let reply_len = emit_reply(&forward, [1, 2, 3, 4], Mac([7; 6]), &mut reply).unwrap();
    let answer = Frame::new_checked(&reply[..reply_len]).unwrap();
    assert_eq!(answer.len_with_fcs(), 64); // driver-interface: 62, 64, 66 for 57, 59, 61
    assert_eq!((answer.sender(), answer.number()), (Mac([7; 6]), 9));
    assert_eq!(answer.mpdu()[..16], buffer[..16]);
    assert_eq!(answer.mpdu()[22..55], buffer[22..55]);
    assert_eq!(reply[55..60], [1, 2, 3, 4, 0]);
    assert_eq!(answer.addr2(), MAGIC_MAC);
    assert_eq!(emit_reply(&forward, [0; 4], Mac([7; 6]), &mut [0; 59]), Err(Error::Length { expect: 60, got: 59 }));
}

#[test]
fn a_frame_to_each_robot_is_two_bytes_longer_than_to_the_one_before() {
    assert_eq!([0, 1, 2, 5].map(|k| forward_len(DEFAULT_LEN, k)), [57, 59, 61, 67]);
    // The shortest one is the shortest odd length with room for its number.
    let emitted = |len_with_fcs| {
        let repr = Repr { sender: Mac([2; 6]), number: 1, len_with_fcs };
        repr.emit(&mut [0; 64], &mut Lfsr::default()).map(|len| len + FCS_LEN)
    };
    assert_eq!((MIN_FORWARD_LEN % 2, emitted(MIN_FORWARD_LEN)), (1, Ok(MIN_FORWARD_LEN)));
    assert!(emitted(MIN_FORWARD_LEN - 2).is_err());
}

#[test]
fn no_answer_is_ever_answered() {
    for first in (MIN_FORWARD_LEN..200).step_by(2) {
        for (a, b) in (0..40).flat_map(|a| (0..40).map(move |b| (a, b))) {
            assert_ne!(forward_len(first, a) + REPLY_GROWTH, forward_len(first, b));
        }
    }
}

#[test]
fn frames_too_short_or_not_ours_are_refused() {
    let mut buffer = [0; 64];
    let short = Repr { sender: Mac([2; 6]), number: 1, len_with_fcs: 31 };
    assert_eq!(short.emit(&mut buffer, &mut Lfsr::default()), Err(Error::Length { expect: 28, got: 27 }));
    let len = Repr { len_with_fcs: 57, ..short }.emit(&mut buffer, &mut Lfsr::default()).unwrap();
    assert_eq!(Frame::new_checked(&buffer[..27]).err(), Some(Error::Length { expect: 28, got: 27 }));
    let mut other = buffer;
    other[0] = 0x80;
    assert_eq!(Frame::new_checked(&other[..len]).err(), Some(Error::FrameControl([0x80, 0])));
    other = buffer;
    other[9] = 0x57;
    assert!(matches!(Frame::new_checked(&other[..len]), Err(Error::Receiver(_))));
}

proptest! {
    #[test]
    fn emit_then_parse_is_the_identity(sender: [u8; 6], number: u32, len_with_fcs in 32usize..300) {
        let repr = Repr { sender: Mac(sender), number, len_with_fcs };
        let mut buffer = [0; 300];
        let len = repr.emit(&mut buffer, &mut Lfsr::default()).unwrap();
        prop_assert_eq!(Repr::parse(&Frame::new_checked(&buffer[..len]).unwrap()), repr);
    }
}
