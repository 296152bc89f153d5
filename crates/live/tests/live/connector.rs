//! The listener against the connector of the running kernel, in namespaces of its own.

use crate::private::{Got, body, inside, listen, send, take};
use csi5300::source::{CsiSource, Loss, Next, Refused};
use csi5300::time::Instant;
use csi5300_live::netlink::{Netlink, Options, Sender};
use driver_iface::connector::{CN_IDX, CN_IDX_10_USERS, CN_VAL, Repr};
use driver_iface::record::{MAX_LENGTH, Record, code};

const LARGE: usize = 4 << 20;

fn bfees(counts: std::ops::Range<u16>) -> Vec<Got> {
    counts.map(Got::Bfee).collect()
}

#[test]
fn every_layout_arrives_byte_for_byte() {
    if !inside(concat!(module_path!(), "::every_layout_arrives_byte_for_byte"), "-Urn") {
        return;
    }
    for padded in [true, false] {
        let mut listener = listen(LARGE, None);
        assert!(listener.at.contains("26 and 25 (no CSI driver"), "{}", listener.at);
        // The unpadded ones under an old tree's index.
        let index = if padded { CN_IDX } else { CN_IDX_10_USERS };
        let mut sender = Sender::open(index, padded).unwrap();
        let mut sent = Vec::new();
        for wsr in [false, true] {
            for (n_rx, n_tx) in (1..=3).flat_map(|n_rx| (1..=3).map(move |n_tx| (n_rx, n_tx))) {
                let mut body = body(sent.len() as u16, n_rx, n_tx, wsr);
                let len = body.len();
                body[len - 400.min(len / 2)..].fill(0xA5);
                sent.push((code::BFEE, body));
            }
        }
        for len in [0, 1, 2, 3, 4, 1_500, MAX_LENGTH - 1] {
            sent.push((code::MPDU, (0..len).map(|k| k as u8).collect()));
        }
        for (code, body) in &sent {
            sender.send(Record { code: *code, body }).unwrap();
        }
        for (k, (code, body)) in sent.iter().enumerate() {
            match listener.receive(Instant::from_us(7)).unwrap() {
                Next::Record(stamps, record) => {
                    assert_eq!((record.code, record.body), (*code, body.as_slice()), "record {k}, padded {padded}");
                    assert_eq!((stamps.at, stamps.host_us), (Instant::from_us(7), Some(1)));
                }
                other => panic!("record {k}: {other:?}"),
            }
        }
        assert!(matches!(listener.receive(Instant::ZERO).unwrap(), Next::Pending));
        assert_eq!(listener.counters().records, sent.len() as u64);
    }
}

/// Every kind of damage: `netlink::tests`.
#[test]
fn a_cut_datagram_is_reported_and_foreign_traffic_never_queued() {
    if !inside(concat!(module_path!(), "::a_cut_datagram_is_reported_and_foreign_traffic_never_queued"), "-Urn") {
        return;
    }
    let mut listener = listen(LARGE, Some(CN_IDX));
    let sender = Sender::open(CN_IDX, true).unwrap();
    let datagram = |idx, val| {
        let record = Record { code: code::BFEE, body: &body(1, 3, 1, false) };
        let repr = Repr { idx, val, record, padded: true };
        let mut out = vec![0; repr.emit_len()];
        repr.emit(&mut out).unwrap();
        out
    };
    let good = datagram(CN_IDX, CN_VAL);
    let long = [good.clone(), vec![0; 70_000]].concat();
    for bytes in [datagram(99, CN_VAL), datagram(CN_IDX, 7), long, good] {
        sender.send_bytes(&bytes).unwrap();
    }
    let got = take(&mut listener);
    let [Got::Lost(Loss::Datagram { reason: Refused::Truncated { sent: 70_252, .. }, .. }), Got::Bfee(1)] = got[..]
    else {
        panic!("{got:?}")
    };
    let counters = listener.counters();
    // The foreign index was kept out by the socket's filter; the foreign value was seen and left out.
    assert_eq!((counters.datagrams, counters.foreign, counters.records, counters.truncated), (3, 1, 1, 1));
}

#[test]
fn an_overrun_is_a_gap_of_known_size_and_nothing_after_it_is_lost() {
    if !inside(concat!(module_path!(), "::an_overrun_is_a_gap_of_known_size_and_nothing_after_it_is_lost"), "-Urn") {
        return;
    }
    let mut listener = listen(32 * 1024, Some(CN_IDX));
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    send(&mut sender, 0..5_000);
    let mut got = take(&mut listener);
    let Some(Got::Lost(Loss::Overrun { dropped: Some(dropped) })) = got.pop() else { panic!("no overrun: {got:?}") };
    let kept = got.len() as u16;
    assert!(kept > 0 && u64::from(kept) + dropped == 5_000, "{kept} kept, {dropped} dropped");
    assert_eq!(got, bfees(0..kept), "the oldest are kept, whole and in order");
    // After recovery every record arrives, and the gap in the numbers is what the kernel said.
    for from in (5_000..6_000).step_by(10) {
        send(&mut sender, from..from + 10);
        assert_eq!(take(&mut listener), bfees(from..from + 10));
    }
    let counters = listener.counters();
    assert_eq!((counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap), (1, dropped, dropped));
    assert_eq!(counters.other_bfee_gap, 0);
}

#[test]
fn messages_are_dropped_and_counted_until_the_queue_is_empty() {
    if !inside(concat!(module_path!(), "::messages_are_dropped_and_counted_until_the_queue_is_empty"), "-Urn") {
        return;
    }
    let mut listener = listen(32 * 1024, Some(CN_IDX));
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    send(&mut sender, 0..1_000);
    // A few are read; the kernel goes on dropping until all are.
    for expected in 0..3 {
        let Next::Record(_, record) = listener.receive(Instant::ZERO).unwrap() else { panic!("record {expected}") };
        assert_eq!(record.body[4], expected);
    }
    send(&mut sender, 1_000..1_050);
    let mut got = take(&mut listener);
    assert!(matches!(got.pop(), Some(Got::Lost(Loss::Overrun { dropped: Some(_) }))));
    let last = 3 + got.len() as u16;
    assert_eq!(got, bfees(3..last));
    send(&mut sender, 1_050..1_060);
    assert_eq!(take(&mut listener), bfees(1_050..1_060));
    let counters = listener.counters();
    assert_eq!(counters.kernel_drops, 1_050 - u64::from(last));
    assert_eq!(counters.overrun_bfee_gap, counters.kernel_drops);
}

#[test]
fn a_slow_listener_loses_only_its_own_copy() {
    if !inside(concat!(module_path!(), "::a_slow_listener_loses_only_its_own_copy"), "-Urn") {
        return;
    }
    let (mut fast, mut slow) = (listen(LARGE, Some(CN_IDX)), listen(32 * 1024, Some(CN_IDX)));
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    let mut received = Vec::new();
    for from in (0..5_000).step_by(100) {
        send(&mut sender, from..from + 100);
        received.extend(take(&mut fast));
    }
    assert_eq!(received, bfees(0..5_000));
    assert_eq!(fast.counters().overruns, 0);
    let late = take(&mut slow);
    assert!(matches!(late.last(), Some(Got::Lost(Loss::Overrun { dropped: Some(dropped) })) if *dropped > 0));
}

#[test]
fn refusals_say_what_to_do() {
    if !inside(concat!(module_path!(), "::refusals_say_what_to_do"), "-Urn") {
        return;
    }
    if std::path::Path::new("/proc/net/connector").exists() {
        return;
    }
    let refused = Netlink::open(&Options::default()).unwrap_err().to_string();
    assert!(refused.contains("network namespace"), "{refused}");
    let options = Options { connector_index: Some(33), allow_user_sender: true, ..Options::default() };
    let refused = Netlink::open(&options).unwrap_err().to_string();
    assert!(refused.contains("1 to 32"), "{refused}");
    assert!(Sender::open(0, true).is_err() && Sender::open(33, true).is_err());
}

#[test]
fn a_missing_capability_is_reported_with_its_remedy() {
    // Without -r the user is mapped to nobody, and exec takes the new namespace's capabilities away.
    if !inside(concat!(module_path!(), "::a_missing_capability_is_reported_with_its_remedy"), "-Un") {
        return;
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:")).unwrap().trim();
    if u64::from_str_radix(effective, 16).unwrap() & 1 << 12 != 0 {
        crate::common::skipped("CAP_NET_ADMIN is still held");
        return;
    }
    let refused = Netlink::open(&Options { allow_user_sender: true, ..Options::default() }).unwrap_err().to_string();
    assert!(refused.contains("setcap cap_net_admin+ep"), "{refused}");
}
