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

use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::connector as cn;
use driver_iface::record::{Record, code};

/// xorshift64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| self.next() as u8).collect()
    }

    /// A bfee body, either layout, any chains.
    fn body(&mut self) -> Vec<u8> {
        let wsr = (self.below(2) == 0)
            .then(|| Wsr { frame_count: (self.below(2) == 0).then(|| self.next() as u32), ..Wsr::default() });
        let (n_rx, n_tx) = (1 + self.below(3) as u8, 1 + self.below(3) as u8);
        let antenna_sel = self.next() as u8;
        let repr = Repr { n_rx, n_tx, antenna_sel, timestamp_low: self.next() as u32, wsr, ..Repr::default() };
        let seed = self.next() as u8;
        let value = |k: usize| (k as u8).wrapping_mul(seed | 1).cast_signed();
        let csi: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: value(k), q: value(k + 7) }).collect();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi, &mut body).unwrap();
        body
    }

    /// A record of any code, often a bfee.
    fn record(&mut self) -> Vec<u8> {
        let (code, body) = match self.below(4) {
            0 => (self.next() as u8, {
                let n = self.below(60);
                self.bytes(n)
            }),
            1 => (code::MPDU, {
                let n = 28 + self.below(60);
                self.bytes(n)
            }),
            _ => (code::BFEE, self.body()),
        };
        let record = Record { code, body: &body };
        let mut out = vec![0; record.emit_len()];
        record.emit(&mut out).unwrap();
        out
    }

    /// Changes a few bytes: overwritten, removed, inserted, cut.
    fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..self.below(4) {
            let at = self.below(bytes.len());
            match self.below(5) {
                0 => bytes.truncate(at),
                1 if at < bytes.len() => drop(bytes.remove(at)),
                2 => bytes.insert(at, self.next() as u8),
                3 => {
                    let n = self.below(20);
                    let garbage = self.bytes(n);
                    bytes.splice(at..at, garbage);
                }
                _ if at < bytes.len() => bytes[at] = self.next() as u8,
                _ => {}
            }
        }
    }
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
                bytes.extend(random.record());
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
        let mut body = random.body();
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
