//! The C header has the same constants as Rust. No C compiler is needed: the header contains only `#define`s.

use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;
use std::{assert_eq, format, vec};

use crate::{bfee, connector, mpdu, radiotap, record, sounding};

/// Every object-like macro of the header: name without prefix, and value as text.
fn macros() -> BTreeMap<&'static str, &'static str> {
    let header = include_str!("../include/csi5300.h");
    let mut found = BTreeMap::new();
    for line in header.lines().filter_map(|line| line.strip_prefix("#define CSI5300_")) {
        let (name, rest) = line.split_once([' ', '(']).unwrap_or((line, ""));
        let value = rest.split("/*").next().unwrap().trim();
        assert!(found.insert(name, value).is_none(), "{name} is defined twice");
    }
    found
}

fn number(text: &str) -> i64 {
    let text = text.trim_start_matches('(').trim_end_matches(')');
    text.strip_prefix("0x").map_or_else(|| text.parse().unwrap(), |hex| i64::from_str_radix(hex, 16).unwrap())
}

/// Names and values as Rust has them; those that only C needs, as Linux's headers do.
#[rustfmt::skip]
fn of_rust() -> Vec<(&'static str, i64)> {
    use bfee::{offset as b, rate};
    use connector::{self as c, offset as d};
    use mpdu::{self as m, offset as h};
    use record::code;
    macro_rules! table { ($($name:literal => $value:expr,)*) => { vec![$(($name, i64::try_from($value).unwrap())),*] } }
    table! {
        "AF_NETLINK" => 16, "NETLINK_CONNECTOR" => c::NETLINK_CONNECTOR, "SOL_NETLINK" => 270,
        "NETLINK_ADD_MEMBERSHIP" => 1, "NETLINK_NO_ENOBUFS" => 5,
        "NLMSG_DONE" => c::NLMSG_DONE, "NLMSGHDR" => c::NLMSGHDR, "CN_MSG" => c::CN_MSG, "HEADERS" => c::HEADERS,
        "MAX_DATAGRAM" => c::MAX_DATAGRAM, "CN_IDX" => c::CN_IDX, "CN_IDX_10_USERS" => c::CN_IDX_10_USERS,
        "CN_IDX_8_USERS" => 23, "CN_IDX_EARLY" => 254, "CN_VAL" => c::CN_VAL,
        "OFF_NLMSG_LEN" => 0, "OFF_NLMSG_TYPE" => d::NLMSG_TYPE, "OFF_NLMSG_FLAGS" => 6,
        "OFF_NLMSG_SEQ" => 8, "OFF_NLMSG_PID" => 12, "OFF_CN_IDX" => d::CN_IDX,
        "OFF_CN_VAL" => d::CN_VAL, "OFF_CN_SEQ" => 24, "OFF_CN_ACK" => 28, "OFF_CN_LEN" => d::CN_LEN,
        "OFF_CN_FLAGS" => 34, "OFF_DATA" => c::HEADERS,
        "LENGTH_FIELD" => record::LENGTH_FIELD, "MAX_LENGTH" => record::MAX_LENGTH,
        "CODE_BFEE" => code::BFEE, "CODE_RX_PHY" => code::RX_PHY, "CODE_MPDU" => code::MPDU, "CODE_RX" => code::RX,
        "CODE_NOISE" => code::NOISE, "CODE_TX_RESP" => code::TX_RESP, "CODE_TX_BLOCK_AGG" => code::TX_BLOCK_AGG,
        "CODE_STATUS" => code::STATUS, "CODE_PARALLEL" => code::PARALLEL,
        "CODE_CARD_CLOCK" => code::CARD_CLOCK, "CODE_LEFT_OUT" => code::LEFT_OUT,
        "SUBCARRIERS" => bfee::SUBCARRIERS, "STOCK_HEADER" => bfee::STOCK_HEADER, "WSR_EXTRA" => bfee::WSR_EXTRA,
        "WSR_2021_EXTRA" => bfee::WSR_2021_EXTRA, "WSR_2021_HEADER" => bfee::WSR_2021_HEADER,
        "WSR_HEADER" => bfee::WSR_HEADER, "MAX_BODY" => bfee::MAX_BODY, "NOISE_UNKNOWN_DBM" => bfee::NOISE_UNKNOWN_DBM,
        "BFEE_TIMESTAMP_LOW" => 0, "BFEE_BFEE_COUNT" => b::BFEE_COUNT, "BFEE_RESERVED" => b::RESERVED,
        "BFEE_N_RX" => b::N_RX, "BFEE_N_TX" => b::N_TX, "BFEE_RSSI" => b::RSSI, "BFEE_NOISE" => b::NOISE,
        "BFEE_AGC" => b::AGC, "BFEE_ANTENNA_SEL" => b::ANTENNA_SEL, "BFEE_LEN" => b::LEN,
        "BFEE_RATE_N_FLAGS" => b::RATE_N_FLAGS, "BFEE_TV_SEC" => b::TV_SEC, "BFEE_TV_USEC" => 24,
        "BFEE_MAC" => 28, "BFEE_FRAME_COUNT" => 34,
        "RATE_HT" => rate::HT, "RATE_CCK" => rate::CCK, "RATE_GREENFIELD" => rate::GREENFIELD,
        "RATE_HT40" => rate::HT40, "RATE_DUPLICATE" => rate::DUPLICATE, "RATE_SHORT_GI" => rate::SHORT_GI,
        "MPDU_HEADER" => m::HEADER, "MPDU_FCS" => m::FCS, "MPDU_FRAME_CONTROL" => h::FRAME_CONTROL,
        "MPDU_DURATION" => h::DURATION, "MPDU_ADDR1" => h::ADDR1, "MPDU_ADDR2" => h::ADDR2, "MPDU_ADDR3" => h::ADDR3,
        "MPDU_SEQ_CTRL" => h::SEQ_CTRL, "MPDU_COUNTER" => h::COUNTER,
        "SOUNDING_HEADER_LEN" => m::HEADER, "SOUNDING_FCS_LEN" => m::FCS,
        "SOUNDING_MIN_LEN" => sounding::MIN_LEN, "SOUNDING_DEFAULT_LEN" => sounding::wsr::DEFAULT_LEN,
        "SOUNDING_REPLY_GROWTH" => sounding::wsr::REPLY_GROWTH, "RADIOTAP_MIN_LEN" => radiotap::MIN_LEN,
        "RADIOTAP_FLAGS_FCS" => radiotap::FLAGS_FCS, "RADIOTAP_FLAGS_DATAPAD" => 0x20,
        "RADIOTAP_FLAGS_BAD_FCS" => radiotap::FLAGS_BAD_FCS, "RADIOTAP_TX_FLAGS_NO_ACK" => radiotap::TX_FLAGS_NO_ACK,
    }
}

#[test]
fn every_constant_equals_rusts() {
    let mut macros = macros();
    for (name, value) in of_rust() {
        let text = macros.remove(name).unwrap_or_else(|| panic!("CSI5300_{name} is not in the header"));
        assert_eq!(number(text), value, "CSI5300_{name}");
    }
    assert_eq!(macros.remove("H"), Some(""));
    assert_eq!(macros.remove("CN_NAME"), Some(format!("{:?}", connector::CN_NAME).as_str()));
    let magic: String = sounding::MAGIC_MAC.0.iter().map(|octet| format!("\\x{octet:02x}")).collect();
    assert_eq!(macros.remove("SOUNDING_MAGIC_MAC"), Some(format!("\"{magic}\"").as_str()));
    assert_eq!(macros.remove("CSI_LEN"), Some("n_rx, n_tx) (60 * (n_rx) * (n_tx) + 12)"));
    assert_eq!(bfee::csi_len(3, 2), 60 * 3 * 2 + 12);
    assert!(macros.is_empty(), "not held equal to anything: {macros:?}");
}
