//! Tests in a user, network and mount namespace of their own: the real netlink of the running kernel, no root needed.
#![allow(dead_code)]

use csi5300::source::{CsiSource, Loss, Next};
use csi5300::time::Instant;
use csi5300_live::netlink::{Netlink, Options, Sender};
use driver_iface::bfee::{self, csi_len};
use driver_iface::record::{Record, code};
use std::io::Write;
use std::process::Command;

/// Set for a test that already is in its namespaces.
const INSIDE: &str = "CSI5300_TEST_NAMESPACE";

/// `test` is its path, `concat!(module_path!(), "::name")`. True where the test's body is to run: in namespaces of its own, or in a machine of its own where this is set to
/// `own`. Otherwise runs the test there (with `options` of unshare(1)) and gives false.
pub fn inside(test: &str, options: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let possible = Command::new("unshare").args([options, "true"]).output().is_ok_and(|out| out.status.success());
    if !possible {
        crate::common::skipped(&format!("`unshare {options}` is not permitted or not installed here"));
        return false;
    }
    let own = std::env::current_exe().unwrap();
    // The harness knows tests by their path within the crate.
    let test = test.split_once("::").map_or(test, |(_, path)| path);
    let mut command = Command::new("unshare");
    command.arg(options).arg(own).args(["--exact", test, "--nocapture"]).env(INSIDE, "1");
    let out = command.output().unwrap();
    let said = String::from_utf8_lossy(&out.stdout);
    let complained = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "in its namespaces:\n{said}{complained}");
    assert!(said.contains("1 passed"), "`{test}` did not run in its namespaces:\n{said}");
    // Past the harness: what was skipped inside shows.
    let _ = std::io::stderr().write_all(complained.as_bytes());
    false
}

/// A listener that believes other programs.
pub fn listen(receive_buffer: usize, connector_index: Option<u32>) -> Netlink {
    let options = Options { connector_index, allow_user_sender: true, receive_buffer, wall_us: || Some(1) };
    Netlink::open(&options).unwrap()
}

/// A bfee body with its number, chains and layout; zeros for CSI.
pub fn body(count: u16, n_rx: u8, n_tx: u8, wsr: bool) -> Vec<u8> {
    let header = if wsr { bfee::WSR_HEADER } else { bfee::STOCK_HEADER };
    let len = csi_len(n_rx, n_tx);
    let mut body = vec![0; header + len];
    body[..4].copy_from_slice(&(u32::from(count) * 1_000).to_le_bytes());
    body[bfee::offset::BFEE_COUNT..][..2].copy_from_slice(&count.to_le_bytes());
    (body[bfee::offset::N_RX], body[bfee::offset::N_TX]) = (n_rx, n_tx);
    body[bfee::offset::ANTENNA_SEL] = 0b10_01_00;
    body[bfee::offset::LEN..][..2].copy_from_slice(&(len as u16).to_le_bytes());
    body
}

/// Sends 3x1 stock bfee records with these numbers.
pub fn send(sender: &mut Sender, counts: std::ops::Range<u16>) {
    for count in counts {
        sender.send(Record { code: code::BFEE, body: &body(count, 3, 1, false) }).unwrap();
    }
}

/// What a listener gives until it has nothing more.
#[derive(Debug, PartialEq, Eq)]
pub enum Got {
    /// A bfee by its number.
    Bfee(u16),
    /// Any other record.
    Other(u8, Vec<u8>),
    /// A loss.
    Lost(Loss),
}

/// Takes everything that is there.
pub fn take(source: &mut dyn CsiSource) -> Vec<Got> {
    let mut got = Vec::new();
    loop {
        match source.receive(Instant::ZERO).unwrap() {
            Next::Record(_, record) if record.code == code::BFEE => {
                got.push(Got::Bfee(bfee::Bfee::new_checked(record.body).unwrap().bfee_count()));
            }
            Next::Record(_, record) => got.push(Got::Other(record.code, record.body.to_vec())),
            Next::Lost(loss) => got.push(Got::Lost(loss)),
            Next::Pending => return got,
            Next::End(_) => panic!("a live source ended"),
        }
    }
}

/// Sends numbered records no faster than they are read: in batches, each taken from every queue before the next.
pub fn send_gently(sender: &mut Sender, counts: std::ops::Range<u16>) {
    for from in counts.clone().step_by(100) {
        send(sender, from..counts.end.min(from + 100));
        while queued_bytes() > 0 {
            std::thread::yield_now();
        }
    }
}

/// Bytes that wait in the connector sockets of this namespace.
pub fn queued_bytes() -> u64 {
    let table = std::fs::read_to_string("/proc/thread-self/net/netlink").unwrap();
    let rows = table.lines().skip(1).map(|line| line.split_whitespace().collect::<Vec<_>>());
    rows.filter(|row| row[1] == "11").map(|row| row[4].parse::<u64>().unwrap()).sum()
}
