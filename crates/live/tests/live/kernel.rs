//! Checks, inside the guest of tests/checks/kernel.sh, what `csi5300 record` received from the kernel module, and the logs of
//! robots that sounded each other over mac80211.

use csi5300::exchange::pairing::{LinkSide, Pairing};
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::Bfee;
use driver_iface::mpdu;
use driver_iface::record::{Tail, code};
use driver_iface::sounding::Frame;
use driver_iface::sounding::native::{self, Role};

#[test]
fn the_module_s_records_are_in_the_log() {
    let Some(log) = std::env::var_os("CSI5300_TEST_GUEST_LOG") else {
        crate::common::skipped("runs in the guest of tests/checks/kernel.sh");
        return;
    };
    let chains = std::env::var("CSI5300_TEST_GUEST_CHAINS").unwrap();
    let (n_rx, n_tx) = chains.split_once(' ').unwrap();
    let (n_rx, n_tx) = (n_rx.parse::<usize>().unwrap(), n_tx.parse::<usize>().unwrap());
    let count: u32 = std::env::var("CSI5300_TEST_GUEST_COUNT").unwrap().parse().unwrap();
    let mut replay = Replay::open(log.as_ref()).unwrap();
    for k in 0..count {
        let Next::Record(stamps, record) = replay.receive(Instant::ZERO).unwrap() else { panic!("record {k}") };
        assert!(stamps.host_us.is_some(), "record {k} has no host time");
        let bfee = Bfee::new_checked(record.body).unwrap();
        assert_eq!((bfee.n_rx(), bfee.n_tx(), u32::from(bfee.bfee_count())), (n_rx, n_tx, k));
        assert_eq!((bfee.timestamp_low(), bfee.rssi(), bfee.noise_dbm()), (k * 1_000, [33, 32, 31], -127));
        assert_eq!((bfee.rate_n_flags(), bfee.payload().len()), (0x0101, 60 * n_rx * n_tx + 12));
        // driver-iface/kmod: byte i of record k is (31 k + i) mod 256.
        assert!(bfee.payload().iter().enumerate().all(|(i, &byte)| byte == (31 * k + i as u32) as u8), "record {k}");
    }
    let end = replay.receive(Instant::ZERO).unwrap();
    assert!(matches!(end, Next::End(Tail::Clean)), "{end:?}");
}

/// Number, card clock and first CSI byte of every frame of `sender` in a log, in the log's order; where the log tells
/// roles (native frames, with an MPDU before each record), only those of `role` if one is named.
fn heard(log: &str, sender: Mac, role: Option<Role>) -> Vec<(u32, u32, u8)> {
    let mut replay = Replay::open(log.as_ref()).unwrap();
    let (mut survey, mut frames, mut other) = (Survey::default(), Vec::new(), false);
    loop {
        let next = replay.receive(Instant::ZERO).unwrap();
        if let Next::Record(_, record) = &next
            && record.code == code::MPDU
        {
            let frame = Frame::new_checked(&record.body[..record.body.len() - mpdu::FCS]).unwrap();
            other = native::Repr::parse(&frame).is_some_and(|frame| role.is_some_and(|role| frame.role != role));
        }
        if matches!(next, Next::End(_)) {
            break;
        }
        if let Some((bfee, identity)) = survey.note(&next)
            && identity.mac == sender
            && !other
        {
            frames.push((identity.frame_count.unwrap(), bfee.timestamp_low(), bfee.payload()[0]));
        }
    }
    assert!(!survey.lost_something() && survey.bfee_missing == 0, "{log}: {survey:?}");
    frames
}

/// Numbers of the pairs that two logs give, in the order in which they come.
fn pairs(backward: &[(u32, u32, u8)], forward: &[(u32, u32, u8)]) -> Vec<u32> {
    let mut pairing = Pairing::new(4_096);
    let mut pairs = Vec::new();
    let (mut rx, mut tx) = (backward.iter().peekable(), forward.iter().peekable());
    while rx.peek().is_some() || tx.peek().is_some() {
        let side = if tx.peek().is_none() { LinkSide::Receiver } else { pairing.behind() };
        let side = if rx.peek().is_none() { LinkSide::Transmitter } else { side };
        let next = if side == LinkSide::Receiver { rx.next() } else { tx.next() };
        let (number, clock, _) = next.unwrap();
        pairing.handle(side, *number, *clock, ());
        pairs.extend(std::iter::from_fn(|| pairing.poll_pair()).map(|pair| pair.number));
    }
    pairing.finish();
    pairs.extend(std::iter::from_fn(|| pairing.poll_pair()).map(|pair| pair.number));
    pairs
}

/// `sounded` and `answered` of a link in what `csi5300 sound` said at its end.
fn said(path: &str, peer: Mac) -> [usize; 2] {
    let text = std::fs::read_to_string(path).unwrap();
    let line = text.lines().find(|line| line.trim_start().starts_with(&format!("{peer}: "))).unwrap();
    let number = |before: &str| line.split(before).next().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    [number(" sounded"), number(" answered")]
}

#[test]
fn every_answered_frame_is_a_pair_of_the_logs() {
    let Ok(links) = std::env::var("CSI5300_TEST_GUEST_LINKS") else {
        crate::common::skipped("runs in the guest of tests/checks/kernel.sh");
        return;
    };
    for link in links.lines() {
        let words: Vec<&str> = link.split_whitespace().collect();
        let [rx, own, tx, peer, summary] = words[..] else { panic!("{link}") };
        let (own, peer): (Mac, Mac) = (own.parse().unwrap(), peer.parse().unwrap());
        let (backward, forward) = (heard(rx, peer, Some(Role::Backward)), heard(tx, own, Some(Role::Forward)));
        let [sounded, answered] = said(summary, peer);
        assert!(answered > 50, "{link}: {answered} answered of {sounded}");
        let numbers = |frames: &[(u32, u32, u8)]| frames.iter().map(|frame| frame.0).collect::<Vec<_>>();
        assert!(numbers(&forward).is_sorted_by(|a, b| a < b), "{tx}: out of order");
        for (number, _, byte) in forward.iter().chain(&backward) {
            assert_eq!(*byte, number.wrapping_mul(31) as u8, "CSI of another frame");
        }
        let pairs = pairs(&backward, &forward);
        assert!(pairs.is_sorted_by(|a, b| a < b), "{link}: pairs out of order");
        println!("{own} to {peer}: {sounded} sounded, {answered} answered, {} pairs", pairs.len());
        // Where both initiate, each log also has the other direction's exchanges, under numbers of another count.
        let mixed = self::pairs(&heard(rx, peer, None), &heard(tx, own, None));
        println!("  {} pairs with those of the other direction, if it initiates too", mixed.len());
        assert!(mixed.len() >= answered, "{link}: the other direction's exchanges cost pairs");
        assert!(pairs.len() >= answered, "{link}: every answered frame is a pair");
        assert!(pairs.len() <= sounded, "{link}: no pair that was not sounded");
        assert!(answered * 100 >= sounded * 95, "{link}: simulated radios lose nothing");
    }
}
