//! Checks, inside the guest of tests/checks/kernel.sh, what `csi5300 record` received from the kernel module.

use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use driver_iface::bfee::Bfee;
use driver_iface::record::Tail;

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
