//! A byte is missing in the middle of a log, and a hundred are foreign. Prints what is lost, where and why, and how many records
//! are left.
//!
//! `cargo run --example damaged_log`

use driver_iface::record::{Step, events};

fn main() {
    let whole = include_bytes!("../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let mut damaged = whole.to_vec();
    damaged.remove(20_000);
    damaged.splice(40_000..40_000, [0xBB; 100]);
    let count = |bytes: &[u8]| events(bytes).filter(|step| matches!(step, Step::Record { .. })).count();
    println!("{} records in the whole log, {} in the damaged one", count(whole), count(&damaged));
    for step in events(&damaged) {
        match step {
            Step::Bad { offset, skipped, reason } => println!("{skipped} bytes lost at offset {offset}: {reason}"),
            Step::End(tail) => println!("end: {tail:?}"),
            Step::Record { .. } | Step::Incomplete => {}
        }
    }
}
