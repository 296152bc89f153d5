use super::*;
use crate::bfee::{self, Iq};
use std::vec;
use std::vec::Vec;

/// A log of `n` bfee records whose samples count up from `seed`.
fn bfee_record(seed: u8, n_rx: u8, n_tx: u8, wsr: bool) -> Vec<u8> {
    let wsr = wsr.then(|| bfee::Wsr { tv_sec: 1, frame_count: seed.into(), ..bfee::Wsr::default() });
    let repr = bfee::Repr {
        n_rx,
        n_tx,
        bfee_count: seed.into(),
        timestamp_low: u32::from(seed) << 20,
        wsr,
        ..bfee::Repr::default()
    };
    let mut state = u32::from(seed) + 1;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as i8
    };
    let csi: Vec<Iq> = (0..repr.samples()).map(|_| Iq { i: next(), q: next() }).collect();
    let mut body = vec![0; repr.body_len()];
    repr.emit(&csi, &mut body).unwrap();
    framed(code::BFEE, &body)
}

fn framed(code: u8, body: &[u8]) -> Vec<u8> {
    let record = Record { code, body };
    let mut out = vec![0; record.emit_len()];
    assert_eq!(record.emit(&mut out), Ok(out.len()));
    out
}

fn records(bytes: &[u8]) -> Vec<Vec<u8>> {
    events(bytes)
        .filter_map(|step| match step {
            Step::Record { record, .. } => Some(framed(record.code, record.body)),
            _ => None,
        })
        .collect()
}

#[test]
fn one_byte_less_anywhere_costs_one_record() {
    let log: Vec<Vec<u8>> = (0..6).map(|k| bfee_record(k, 3, 1, true)).collect();
    let whole = log.concat();
    assert_eq!(records(&whole), log);
    for at in 0..5 * 233 {
        let mut cut = whole.clone();
        cut.remove(at);
        let mut expect = log.clone();
        expect.remove(at / 233);
        let got = records(&cut);
        assert!(expect.iter().filter(|r| !got.contains(r)).count() <= 1, "byte {at}");
        assert!(got.len() <= 5 || cut[..233] == whole[..233], "byte {at}: a damaged record was believed");
    }
}
