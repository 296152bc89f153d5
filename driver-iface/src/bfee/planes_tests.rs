//! Compares unpacking by chain pair and to bytes with unpacking bit by bit.

use super::{Bfee, Iq, MAX_SAMPLE_BYTES, MAX_SAMPLES, Repr, SUBCARRIERS};
use std::vec;
use std::vec::Vec;

/// Samples over the whole range of values, with different neighbours.
fn samples(count: usize) -> Vec<Iq> {
    let value = |k: usize| (k * 73 + 11) as u8;
    (0..count).map(|k| Iq { i: value(2 * k).cast_signed(), q: value(2 * k + 1).cast_signed() }).collect()
}

/// Passes on a record of every number of chains and streams, with its samples unpacked bit by bit.
fn each_size(mut show: impl FnMut(&Repr, &Bfee<'_>, &[Iq])) {
    for (n_rx, n_tx) in (1..=3).flat_map(|n_rx| (1..=3).map(move |n_tx| (n_rx, n_tx))) {
        let repr = Repr { n_rx, n_tx, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&samples(repr.samples()), &mut body).unwrap();
        let bfee = Bfee::new_checked(&body).unwrap();
        let mut bits = vec![Iq::default(); repr.samples()];
        assert_eq!(bfee.unpack_bits(&mut bits), Some(repr.samples()));
        show(&repr, &bfee, &bits);
    }
}

#[test]
fn planes_are_the_samples_by_chain_pair() {
    each_size(|repr, bfee, bits| {
        let (n_rx, n_tx) = (repr.n_rx, repr.n_tx);
        let mut planes = [[99; 2]; MAX_SAMPLES];
        assert_eq!(bfee.unpack_planes(&mut planes), Some(repr.samples()));
        let pairs = usize::from(n_rx) * usize::from(n_tx);
        for (k, iq) in bits.iter().enumerate() {
            let (subcarrier, pair) = (k / pairs, k % pairs);
            assert_eq!(planes[pair * SUBCARRIERS + subcarrier], [iq.i, iq.q], "{n_rx}x{n_tx}, sample {k}");
        }
        assert!(planes[repr.samples()..].iter().all(|rest| *rest == [99; 2]), "written beyond the record");
        assert_eq!(bfee.unpack_planes(&mut planes[..repr.samples() - 1]), None);
    });
}

#[test]
fn bytes_are_the_samples_in_the_order_of_the_payload() {
    each_size(|repr, bfee, bits| {
        let (n_rx, n_tx) = (repr.n_rx, repr.n_tx);
        let mut bytes = [99; MAX_SAMPLE_BYTES + 1];
        assert_eq!(bfee.unpack_bytes(&mut bytes), Some(repr.samples()));
        let (used, rest) = bytes.split_at(2 * repr.samples());
        let expected: Vec<u8> = bits.iter().flat_map(|iq| [iq.i.cast_unsigned(), iq.q.cast_unsigned()]).collect();
        assert_eq!(used, expected, "{n_rx}x{n_tx}");
        assert!(rest.iter().skip(8).all(|byte| *byte == 99), "written beyond a word more");
        let short = 2 * repr.samples() + 7;
        assert_eq!(bfee.unpack_bytes(&mut bytes[..short]), None);
    });
}
