//! Runs the fuzz targets (`fuzz/`) on their corpus, and on a million damaged valid inputs from a seeded generator.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../fuzz/targets/bfee.rs"]
mod bfee;
#[path = "../../fuzz/targets/connector.rs"]
mod connector;
#[path = "../../tests/common/corpus.rs"]
mod corpus;
#[path = "../../fuzz/targets/frame.rs"]
mod frame;
#[path = "../../fuzz/targets/record_stream.rs"]
mod record_stream;
#[path = "../../fuzz/targets/side_file.rs"]
mod side_file;
#[path = "../../fuzz/targets/stock.rs"]
mod stock;

use corpus::Random;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::connector as cn;
use driver_iface::record::{Record, code};

/// A bfee body, either layout, any chains.
fn body(random: &mut Random) -> Vec<u8> {
    let wsr = (random.below(2) == 0)
        .then(|| Wsr { frame_count: (random.below(2) == 0).then(|| random.next() as u32), ..Wsr::default() });
    let (n_rx, n_tx) = (1 + random.below(3) as u8, 1 + random.below(3) as u8);
    let antenna_sel = random.next() as u8;
    let repr = Repr { n_rx, n_tx, antenna_sel, timestamp_low: random.next() as u32, wsr, ..Repr::default() };
    let seed = random.next() as u8;
    let value = |k: usize| (k as u8).wrapping_mul(seed | 1).cast_signed();
    let csi: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: value(k), q: value(k + 7) }).collect();
    let mut body = vec![0; repr.body_len()];
    repr.emit(&csi, &mut body).unwrap();
    body
}

/// A record of any code, often a bfee.
fn record(random: &mut Random) -> Vec<u8> {
    let (code, body) = match random.below(4) {
        0 => (random.next() as u8, {
            let n = random.below(60);
            random.bytes(n)
        }),
        1 => (code::MPDU, {
            let n = 28 + random.below(60);
            random.bytes(n)
        }),
        _ => (code::BFEE, body(random)),
    };
    let record = Record { code, body: &body };
    let mut out = vec![0; record.emit_len()];
    record.emit(&mut out).unwrap();
    out
}

#[test]
fn record_streams() {
    let mut random = Random(0x5300_0001);
    for case in 0..200_000 {
        let mut bytes = vec![random.next() as u8];
        if case % 4 == 0 {
            let n = random.below(300);
            bytes.extend(random.bytes(n));
        } else {
            for _ in 0..=random.below(3) {
                bytes.extend(record(&mut random));
            }
            random.damage(&mut bytes);
        }
        record_stream::run(&bytes);
    }
}

#[test]
fn bfees() {
    let mut random = Random(0x5300_0002);
    for case in 0..300_000 {
        let mut body = body(&mut random);
        if case % 3 == 0 {
            random.damage(&mut body);
        } else {
            let at = random.below(body.len());
            body[at] = random.next() as u8;
        }
        bfee::run(&body);
    }
}

#[test]
fn datagrams() {
    let mut random = Random(0x5300_0003);
    for case in 0..500_000 {
        let n = random.below(40);
        let body = random.bytes(n);
        let record = Record { code: random.next() as u8, body: &body };
        let repr =
            cn::Repr { idx: 20 + random.below(10) as u32, val: random.below(3) as u32, record, padded: case % 2 == 0 };
        let mut datagram = vec![0; repr.emit_len()];
        repr.emit(&mut datagram).unwrap();
        random.damage(&mut datagram);
        connector::run(&datagram);
    }
}

#[test]
fn corpora() {
    corpus::replay("bfee", bfee::run);
    corpus::replay("connector", connector::run);
    corpus::replay("frame", frame::run);
    corpus::replay("record_stream", record_stream::run);
    corpus::replay("side_file", side_file::run);
    corpus::replay("stock", stock::run);
}
