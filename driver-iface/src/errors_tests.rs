//! Every error contains its numbers: the value read and the value expected.

use crate::bfee::{self, Antenna, InvalidPerm};
use crate::record::Reason;
use crate::stock::{BadPacket, EventError};
use crate::{EmitError, Mac, ParseMacError, connector, mpdu, radiotap, sounding};
use std::string::{String, ToString};

/// True if a number stands alone in a text, not as part of a longer one.
fn says(text: &str, number: &str) -> bool {
    text.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == number)
}

#[track_caller]
fn holds(error: impl ToString, numbers: &[&str]) {
    let text: String = error.to_string();
    for number in numbers {
        assert!(says(&text, number), "{number} is not in: {text}");
    }
    assert!(text.split(' ').count() >= 3, "{text}");
}

#[test]
fn errors_of_emit() {
    holds(EmitError::Buffer { need: 31, got: 17 }, &["31", "17"]);
    holds(EmitError::Field { name: "length", got: 70_001, max: 65_535 }, &["length", "70001", "65535"]);
    holds(EmitError::Samples { expect: 270, got: 90 }, &["270", "90"]);
}

#[test]
fn of_records() {
    holds(bfee::Error::Short { got: 7 }, &["7", "20"]);
    holds(bfee::Error::Chains { n_rx: 4, n_tx: 9 }, &["4", "9"]);
    holds(bfee::Error::CsiLength { expect: 72, got: 71 }, &["72", "71"]);
    holds(bfee::Error::BodyLength { csi: 72, got: 99 }, &["99", "72", "92", "110", "106"]);
    holds(InvalidPerm { antenna_sel: 0x39, n_rx: 0 }, &["0x39", "0", "1", "2", "3"]);
    holds(mpdu::Short { got: 27 }, &["27"]);
    holds(Reason::ZeroLength, &["0"]);
    holds(Reason::ImpossibleLength { got: 9_000, max: 8_192 }, &["9000", "8192"]);
    holds(Reason::BfeeLength { got: 77 }, &["77"]);
    holds(Reason::Bfee(bfee::Error::Short { got: 7 }), &["7", "20"]);
    holds(Reason::Overlapped { expect: 215, got: 100 }, &["215", "100"]);
    holds(Reason::GapBits, &["bits"]);
    holds(Reason::NotFollowed { code: 0xD1, expect: 40 }, &["0xd1", "40"]);
    holds(Reason::Checksum, &["checksum"]);
    holds(Reason::StillLost, &["still"]);
}

#[test]
fn errors_of_datagrams_and_events() {
    holds(connector::Error::Short { need: 36, got: 12 }, &["36", "12"]);
    holds(connector::Error::MessageLength { nlmsg_len: 500, received: 90 }, &["500", "90", "36"]);
    holds(connector::Error::MessageType { got: 2 }, &["2", "3"]);
    holds(connector::Error::DataLength { len: 700, left: 50 }, &["700", "50"]);
    holds(BadPacket::Phy { got: 5 }, &["5"]);
    holds(BadPacket::Mpdu { byte_count: 9_999, got: 40 }, &["9999", "40"]);
    holds(BadPacket::CsiShort { need: 20, got: 3 }, &["20", "3"]);
    holds(BadPacket::Csi(bfee::Error::Chains { n_rx: 4, n_tx: 9 }), &["4", "9"]);
    holds(EventError::Short { need: 32, got: 31 }, &["32", "31"]);
    holds(EventError::Kept { kept: 64, left: 8, data_len: 100 }, &["64", "8", "100"]);
    holds(EventError::Flags { got: 0x80 }, &["0x80"]);
}

#[test]
fn of_frames() {
    holds(radiotap::Error::Length { expect: 25, got: 8 }, &["25", "8"]);
    holds(radiotap::Error::Version(3), &["3", "0"]);
    holds(radiotap::Error::HeaderLength(5), &["5", "8"]);
    holds(sounding::Error::Length { expect: 30, got: 29 }, &["30", "29"]);
    holds(sounding::Error::FrameControl([0x80, 0x40]), &["80", "40", "08"]);
    holds(sounding::Error::Receiver(Mac([1, 2, 3, 4, 5, 6])), &["01", "06"]);
    holds(sounding::Error::Magic([0xab, 0xcd, 0xef]), &["ab", "cd", "ef"]);
    holds(sounding::Error::Version(77), &["77"]);
    holds(sounding::Error::Role(7), &["7", "0", "1"]);
    holds(sounding::Error::Flags(0x90), &["0x90"]);
    holds(ParseMacError, &["six"]);
    assert_eq!([Antenna::A, Antenna::B, Antenna::C].map(|antenna| antenna.to_string()), ["A", "B", "C"]);
}
