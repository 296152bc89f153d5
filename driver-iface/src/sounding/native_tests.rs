use super::*;
use crate::sounding::MAGIC_MAC;
use proptest::prelude::*;

fn any_measurement() -> impl Strategy<Value = Measurement> {
    let iq = proptest::collection::vec(any::<[i8; 2]>(), SUBCARRIERS);
    (any::<(u32, u32, u8, u8, [u8; 3], i8, u8)>(), iq).prop_map(|(m, iq)| Measurement {
        number: m.0,
        timestamp_low: m.1,
        rx_antenna: m.2,
        antenna_sel: m.3,
        rssi: m.4,
        noise_dbm: m.5,
        agc: m.6,
        iq: iq.try_into().unwrap(),
    })
}

fn any_repr() -> impl Strategy<Value = Repr> {
    let addresses = any::<([u8; 6], [u8; 6], [u8; 6], u32, bool, bool)>();
    let numbers = any::<(u32, u32, u32, u16, u64, u32, u16)>();
    let extras = (proptest::option::of(any_measurement()), any::<Option<[u8; TAG_LEN]>>());
    (addresses, numbers, extras).prop_map(|(a, n, (measurement, tag))| Repr {
        sender: Mac(a.0),
        destination: Mac(a.1),
        next: Mac(a.2),
        number: a.3,
        role: if a.4 { Role::Forward } else { Role::Backward },
        wants_turn: a.5,
        session: n.0,
        sender_session: n.1,
        turn: n.2,
        left: n.3,
        slot: n.4,
        round_us: n.5,
        slots: n.6,
        measurement,
        tag,
    })
}

fn plain() -> Repr {
    Repr {
        sender: Mac([2, 0, 0, 0, 0, 1]),
        number: 0x0102_0304,
        role: Role::Forward,
        destination: Mac([2, 0, 0, 0, 0, 2]),
        next: Mac([2, 0, 0, 0, 0, 3]),
        wants_turn: true,
        session: 5,
        sender_session: 5,
        turn: 6,
        left: 7,
        slot: 8,
        round_us: 10_000,
        slots: 12,
        measurement: None,
        tag: None,
    }
}

#[test]
fn a_native_frame_keeps_what_csi_and_wsr_logs_need() {
    let mut buffer = [0; MAX_LEN];
    let len = plain().emit(&mut buffer).unwrap();
    assert_eq!(len, 74);
    assert_eq!(buffer[4..10], MAGIC_MAC.0);
    assert_eq!(buffer[10..16], MAGIC_MAC.0);
    assert_eq!(buffer[16..22], [2, 0, 0, 0, 0, 1]);
    assert_eq!(buffer[24..28], [1, 2, 3, 4]);
    assert_eq!(buffer[28..34], [b'c', b's', b'i', 1, 0, 4]);
    assert_eq!(buffer[58..74], [0, 7, 0, 0, 0, 0, 0, 0, 0, 8, 0, 0, 0x27, 0x10, 0, 12]);
}

#[test]
fn every_damage_is_named() {
    let mut buffer = [0; MAX_LEN];
    let len = plain().emit(&mut buffer).unwrap();
    let parse = |bytes: &[u8]| Repr::parse(&Frame::new_checked(bytes).unwrap());
    assert_eq!(parse(&buffer[..len]), Ok(plain()));
    assert_eq!(parse(&buffer[..len - 1]), Err(Error::Length { expect: 74, got: 73 }));
    assert_eq!(parse(&buffer[..len + 1]), Err(Error::Length { expect: 74, got: 75 }));
    for (at, value, error) in [
        (28, b'x', Error::Magic(*b"xsi")),
        (31, 2, Error::Version(2)),
        (32, 2, Error::Role(2)),
        (33, 8, Error::Flags(8)),
        (33, 3, Error::Length { expect: 166, got: 74 }),
    ] {
        let mut damaged = buffer;
        damaged[at] = value;
        assert_eq!(parse(&damaged[..len]), Err(error));
    }
}

#[test]
fn the_tag_covers_all_but_what_the_card_rewrites() {
    let mut buffer = [0; MAX_LEN];
    let len = Repr { tag: Some([0; TAG_LEN]), ..plain() }.emit(&mut buffer).unwrap();
    set_tag(&mut buffer[..len], [9; TAG_LEN]);
    let frame = &buffer[..len];
    assert_eq!(Repr::parse(&Frame::new_checked(frame).unwrap()).unwrap().tag, Some([9; TAG_LEN]));
    let [addresses, rest] = authenticated_parts(frame);
    assert_eq!(addresses, &frame[4..22]);
    assert_eq!(rest, &frame[24..74]);
    assert_eq!(authenticated_parts(&[]), [&[] as &[u8]; 2]);
}

proptest! {
    #[test]
    fn emit_then_parse_is_the_identity(repr in any_repr()) {
        let mut buffer = [0xee; MAX_LEN];
        let len = repr.emit(&mut buffer).unwrap();
        prop_assert_eq!(len, repr.mpdu_len());
        let frame = Frame::new_checked(&buffer[..len]).unwrap();
        let extras = (repr.measurement.is_some(), repr.tag.is_some());
        prop_assert_eq!(frame.len_with_fcs(), len_with_fcs(extras.0, extras.1));
        prop_assert_eq!(len == MAX_LEN, extras == (true, true));
        prop_assert_eq!(Repr::parse(&frame), Ok(repr));
    }

    #[test]
    fn foreign_bytes_never_panic(repr in any_repr(), cut in 0usize..200, at in 0usize..200, value: u8) {
        let mut buffer = [0; MAX_LEN + 40];
        repr.emit(&mut buffer).unwrap();
        if let Some(byte) = buffer.get_mut(at) {
            *byte = value;
        }
        if let Ok(frame) = Frame::new_checked(&buffer[..cut]) {
            let _ = Repr::parse(&frame);
        }
    }
}

#[test]
fn only_plain_data_frames_are_sounding_frames() {
    let repr = plain();
    let mut bytes = [0; MAX_LEN];
    let len = repr.emit(&mut bytes).unwrap();
    // ToDS, FromDS, more fragments, protected; a frame may have the other bits: retry, power, more data, order.
    for (bit, refused) in [(0, true), (1, true), (2, true), (3, false), (4, false), (5, false), (6, true), (7, false)] {
        let mut frame = bytes;
        frame[1] |= 1 << bit;
        let got = Frame::new_checked(&frame[..len]).map(|_| ());
        let expected = if refused { Err(Error::FrameControl([8, 1 << bit])) } else { Ok(()) };
        assert_eq!(got, expected, "bit {bit}");
    }
}
