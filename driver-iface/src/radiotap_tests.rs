//! Bytes seen on real kernels, and property tests.

use super::*;
use proptest::prelude::*;
use std::vec::Vec;

fn emitted(repr: Repr) -> Vec<u8> {
    let mut buffer = [0xee; MAX_EMIT_LEN];
    let len = repr.emit(&mut buffer).unwrap();
    buffer[..len].to_vec()
}

fn parsed(bytes: &[u8]) -> Repr {
    Repr::parse(&Packet::new_checked(bytes).unwrap()).unwrap()
}

#[test]
fn the_three_injection_headers_have_their_known_bytes() {
    // Accepted by mac80211 (6.1, mac80211_hwsim) as HT MCS 7, no acknowledgement.
    let ht = emitted(Repr::injected(7, Bandwidth::Ht20));
    assert_eq!(ht, [0, 0, 13, 0, 0, 0x80, 8, 0, 8, 0, 0x37, 0, 7]);
    assert_eq!(emitted(Repr::injected(1, Bandwidth::Ht40))[10..], [0x37, 1, 1]);
    assert_eq!(emitted(Repr::default()), [0, 0, 8, 0, 0, 0, 0, 0]);
    // LORCON's mac80211inject.c with the frequency filled in: 5540 = 0x15a4.
    assert_eq!(emitted(Repr::lorcon(5540)), [0, 0, 14, 0, 14, 0, 0, 0, 0, 0, 0xa4, 0x15, 0, 0]);
}

#[test]
fn a_received_frame_of_linux_is_read() {
    // Presence 0x0008482b as mac80211_hwsim (6.1) delivers an HT frame, 29 bytes.
    let mut bytes = std::vec![0, 0, 29, 0, 0x2b, 0x48, 8, 0];
    bytes.extend(0x0102_0304_0506_0708u64.to_le_bytes()); // TSFT at 8
    bytes.extend([0x00]); // flags at 16
    bytes.extend([0x00]); // pad to 18
    bytes.extend([0xa4, 0x15, 0x40, 0x01]); // channel 5540, OFDM 5 GHz
    bytes.extend([(-50i8).cast_unsigned(), 0]); // signal, antenna
    bytes.extend([0, 0]); // RX flags at 24
    bytes.extend([7, 0, 7]); // MCS
    assert_eq!(bytes.len(), 29);
    bytes.extend([1, 2, 3, 4, 5]);
    let packet = Packet::new_checked(&bytes[..]).unwrap();
    let repr = Repr::parse(&packet).unwrap();
    assert_eq!(repr.tsft_us, Some(0x0102_0304_0506_0708));
    assert_eq!(repr.channel, Some(Channel { freq_mhz: 5540, flags: 0x0140 }));
    assert_eq!((repr.signal_dbm, repr.antenna), (Some(-50), Some(0)));
    assert_eq!(repr.mcs.map(|mcs| mcs.index), Some(7));
    assert_eq!(repr.mcs.and_then(|mcs| mcs.bandwidth()), Some(Bandwidth::Ht20));
    assert!(!repr.is_own_echo());
    assert_eq!(packet.frame(&repr).unwrap(), [1, 2, 3, 4, 5]);
}

#[test]
fn an_announced_fcs_is_not_part_of_the_frame() {
    let mut bytes = emitted(Repr { flags: Some(FLAGS_FCS | FLAGS_BAD_FCS), ..Repr::default() });
    bytes.extend([1, 2, 3, 4, 5]);
    let packet = Packet::new_checked(&bytes[..]).unwrap();
    let repr = Repr::parse(&packet).unwrap();
    assert!(repr.has_fcs() && repr.is_bad_fcs());
    assert_eq!(packet.frame(&repr).unwrap(), [1]);
    let short = Packet::new_checked(&bytes[..12]).unwrap();
    assert_eq!(short.frame(&repr), Err(Error::Length { expect: 4, got: 3 }));
}

#[test]
fn a_wrong_checksum_has_its_own_bit() {
    for (flags, bad) in
        [(None, false), (Some(0), false), (Some(0xff ^ FLAGS_BAD_FCS), false), (Some(FLAGS_BAD_FCS), true)]
    {
        assert_eq!(parsed(&emitted(Repr { flags, ..Repr::default() })).is_bad_fcs(), bad, "{flags:?}");
    }
}

#[test]
fn a_header_is_as_long_as_it_says() {
    for repr in [Repr::default(), Repr::injected(7, Bandwidth::Ht20), Repr::lorcon(5540)] {
        let header = emitted(repr);
        let bytes = [&header[..], &[1, 2, 3]].concat();
        let packet = Packet::new_checked(&bytes[..]).unwrap();
        assert_eq!((packet.header_len(), packet.payload()), (header.len(), &[1, 2, 3][..]));
    }
}

#[test]
fn a_tx_status_copy_is_known_by_its_tx_flags() {
    let status = parsed(&emitted(Repr { tx_flags: Some(0), data_retries: Some(0), ..Repr::default() }));
    assert!(status.is_own_echo());
    assert!(parsed(&emitted(Repr::injected(0, Bandwidth::Ht20))).is_own_echo());
}

#[test]
fn per_antenna_words_are_skipped_and_the_first_value_kept() {
    // As iwlwifi writes for several chains: signal in word 0, then words of {signal, antenna} in the same namespace.
    let bytes = [
        0, 0, 23, 0, 0x22, 0, 0, 0xa0, 0x20, 0x08, 0, 0xa0, 0x20, 0x08, 0, 0, // three words
        0x10, 0xce, // flags, signal -50 dBm
        0xcc, 0, // signal -52 dBm on antenna 0
        0xca, 1, // signal -54 dBm on antenna 1
        0,
    ];
    let repr = parsed(&bytes);
    assert_eq!((repr.signal_dbm, repr.antenna, repr.flags), (Some(-50), Some(0), Some(0x10)));
}

#[test]
fn vendor_fields_are_skipped_by_their_length() {
    let bytes = [
        0, 0, 31, 0, 0x02, 0, 0, 0xc0, // flags, vendor namespace, more
        0xff, 0xff, 0xff, 0xbf, // the vendor's bits: all, then the radiotap namespace again, more
        0x20, 0, 0, 0, // signal
        0x40, 0, // flags at 16, pad
        1, 2, 3, 0, 6, 0, // OUI, sub-namespace, 6 bytes of vendor's fields
        9, 9, 9, 9, 9, 9, 0xce, // signal
    ];
    let repr = parsed(&bytes);
    assert_eq!((repr.flags, repr.signal_dbm), (Some(0x40), Some(-50)));
    // They may end the header, but not exceed it.
    for (len, fits) in [(1, true), (2, true), (3, false), (0xffff, false)] {
        let mut header = std::vec![0, 0, 16, 0, 0, 0, 0, 0x40, 1, 2, 3, 0, 0, 0, 9, 9];
        header[12..14].copy_from_slice(&u16::to_le_bytes(len));
        let parsed = Packet::new_checked(header).and_then(|packet| Repr::parse(&packet));
        assert_eq!(parsed.is_ok(), fits, "{len} bytes of vendor's fields");
    }
}

#[test]
fn every_skipped_field_has_the_right_size_and_alignment() {
    // TX flags after bits 4, 7, 8, 9, 10, 12, 13; MCS after 16 and 18: offsets by hand.
    let present: u32 = 1 << 4 | 1 << 7 | 1 << 8 | 1 << 9 | 1 << 10 | 1 << 12 | 1 << 13 | 1 << 15 | 1 << 16 | 1 << 18;
    let mut bytes = std::vec![0, 0, 0, 0];
    bytes.extend((present | 1 << 19 | 1 << 22 | 1 << 27).to_le_bytes());
    bytes.extend([1, 1, 2, 2, 3, 3, 4, 4, 5, 6, 7, 0]); // FHSS 8, lock 10, att 12, dB 14, power 16, 17, 18, pad
    bytes.extend([0x18, 0, 8, 0]); // TX flags at 20, RTS retries 22, pad to 24
    bytes.extend([9; 8]); // XChannel at 24
    bytes.extend([0x37, 0, 5]); // MCS at 32
    bytes.extend([0; 5]); // to 40
    bytes.extend([0; 12]); // timestamp at 40
    bytes.extend([0; 4]); // L-SIG at 52
    let len = bytes.len();
    assert_eq!(len, 56);
    bytes[2] = len as u8;
    let repr = parsed(&bytes);
    assert_eq!(repr.tx_flags, Some(0x18));
    assert_eq!(repr.mcs, Some(Mcs { known: 0x37, flags: 0, index: 5 }));
    bytes[2] = len as u8 - 1;
    let cut = Repr::parse(&Packet::new_checked(&bytes[..]).unwrap());
    assert_eq!(cut, Err(Error::Length { expect: 56, got: 55 }));
}

#[test]
fn invalid_headers_are_refused_with_numbers() {
    let check = |bytes: &[u8]| Packet::new_checked(bytes.to_vec()).map(|packet| packet.header_len());
    assert_eq!(check(&[0, 0]), Err(Error::Length { expect: 8, got: 2 }));
    assert_eq!(check(&[1, 0, 8, 0, 0, 0, 0, 0]), Err(Error::Version(1)));
    assert_eq!(check(&[0, 0, 7, 0, 0, 0, 0, 0]), Err(Error::HeaderLength(7)));
    assert_eq!(check(&[0, 0, 9, 0, 0, 0, 0, 0]), Err(Error::Length { expect: 9, got: 8 }));
    assert_eq!(check(&[0, 0, 8, 0, 0, 0, 0, 0x80]), Err(Error::Length { expect: 12, got: 8 }));
    let mut small = [0; 12];
    assert_eq!(Repr::injected(0, Bandwidth::Ht20).emit(&mut small), Err(Error::Length { expect: 13, got: 12 }));
}

fn any_repr() -> impl Strategy<Value = Repr> {
    let opt = proptest::option::of::<BoxedStrategy<u8>>;
    let opt16 = proptest::option::of::<BoxedStrategy<u16>>;
    let byte = || any::<u8>().boxed();
    let word = || any::<u16>().boxed();
    let first = (proptest::option::of(any::<u64>()), opt(byte()), opt(byte()), proptest::option::of((word(), word())));
    let second = (proptest::option::of(any::<i8>()), proptest::option::of(any::<i8>()), opt(byte()));
    let third = (opt16(word()), opt16(word()), opt(byte()), proptest::option::of((byte(), byte(), byte())));
    (first, second, third).prop_map(|(a, b, c)| Repr {
        tsft_us: a.0,
        flags: a.1,
        rate: a.2,
        channel: a.3.map(|(freq_mhz, flags)| Channel { freq_mhz, flags }),
        signal_dbm: b.0,
        noise_dbm: b.1,
        antenna: b.2,
        rx_flags: c.0,
        tx_flags: c.1,
        data_retries: c.2,
        mcs: c.3.map(|(known, flags, index)| Mcs { known, flags, index }),
    })
}

proptest! {
    #[test]
    fn emit_then_parse_is_the_identity(repr in any_repr(), tail in proptest::collection::vec(any::<u8>(), 0..40)) {
        let mut bytes = emitted(repr);
        prop_assert_eq!(bytes.len(), repr.header_len());
        bytes.extend(&tail);
        let packet = Packet::new_checked(&bytes[..]).unwrap();
        prop_assert_eq!(Repr::parse(&packet).unwrap(), repr);
        prop_assert_eq!(packet.payload(), &tail[..]);
    }

    #[test]
    fn foreign_bytes_never_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..120), plausible: bool) {
        if plausible && bytes.len() >= 8 {
            let len = bytes.len() as u8;
            bytes[..4].copy_from_slice(&[0, 0, len, 0]);
        }
        if let Ok(packet) = Packet::new_checked(&bytes[..])
            && let Ok(repr) = Repr::parse(&packet)
        {
            let _ = packet.frame(&repr);
        }
    }
}

#[test]
fn a_width_is_known_if_its_bit_is_set() {
    let width = |known, flags| Mcs { known, flags, index: 1 }.bandwidth();
    use Bandwidth::{Ht20, Ht40};
    assert_eq!([0, 1, 2, 3].map(|flags| width(1, flags)), [Some(Ht20), Some(Ht40), Some(Ht20), Some(Ht20)]);
    // Other bits of both bytes have other meanings.
    assert_eq!([0, 1, 2, 3].map(|flags| width(0xfe, flags)), [None; 4]);
    assert_eq!([width(0xff, 0xfd), width(0xff, 0xfc)], [Some(Ht40), Some(Ht20)]);
}

#[test]
fn fields_of_an_unknown_namespace_end_the_walk() {
    const EXT: u32 = 1 << 31;
    const VENDOR: u32 = 1 << 30;
    const RADIOTAP: u32 = 1 << 29;
    const RATE: u32 = 1 << 2;
    let header = |words: &[u32], fields: &[u8]| {
        let len = (4 + 4 * words.len() + fields.len()) as u8;
        let mut bytes = std::vec![0, 0, len, 0];
        words.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
        bytes.extend(fields);
        bytes
    };
    // The second word has no namespace. Without fields it leads on to a word of radiotap's.
    assert_eq!(parsed(&header(&[EXT, EXT | RADIOTAP, RATE], &[12])).rate, Some(12));
    // With a field, of unknown size, nothing after it can be located: neither a rate nor vendor fields.
    for field in [0, 5, 28] {
        assert_eq!(parsed(&header(&[EXT, EXT | RADIOTAP | 1 << field, RATE], &[12])).rate, None, "{field}");
        assert_eq!(parsed(&header(&[EXT, VENDOR | 1 << field], &[])), Repr::default(), "{field}");
    }
    let cut = Repr::parse(&Packet::new_checked(header(&[EXT, VENDOR], &[])).unwrap());
    assert_eq!(cut, Err(Error::Length { expect: 18, got: 12 }));
}
