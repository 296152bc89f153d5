//! Any bytes as a record stream: no panic, every byte accounted for, and chunks do not matter.

use driver_iface::bfee::Bfee;
use driver_iface::mpdu;
use driver_iface::record::{Framer, LOOKAHEAD, Step, Tail, code, events};

/// Runs the target; the first byte is the size of the chunks.
pub fn run(bytes: &[u8]) {
    let Some((&chunk, log)) = bytes.split_first() else { return };
    let mut at = 0_u64;
    let mut framer = Framer::new();
    let (mut from, mut to) = (0, 0);
    for expect in events(log) {
        let step = loop {
            match framer.step(&log[from..to], to == log.len()) {
                Step::Incomplete => {
                    assert!(to - from < LOOKAHEAD && to < log.len());
                    to = (to + 1 + usize::from(chunk)).min(log.len());
                }
                step => break step,
            }
        };
        assert_eq!(step, expect);
        match expect {
            Step::Record { offset, used, record } => {
                assert_eq!((offset, used), (at, record.emit_len()));
                match record.code {
                    code::BFEE => assert!(Bfee::new_checked(record.body).is_ok()),
                    code::MPDU => drop(mpdu::Repr::parse(record.body).map(|mpdu| mpdu.sounding_counter())),
                    _ => {}
                }
                (at, from) = (at + used as u64, from + used);
            }
            Step::Bad { offset, skipped, .. } => {
                assert!(offset == at && skipped > 0);
                (at, from) = (at + skipped as u64, from + skipped);
            }
            Step::End(Tail::Clean) => assert_eq!(at, log.len() as u64),
            Step::End(Tail::Cut { offset, bytes, .. }) => {
                assert!(offset == at && at + bytes == log.len() as u64 && bytes > 0);
            }
            Step::Incomplete => panic!("incomplete at the end"),
        }
    }
}
