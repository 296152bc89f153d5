use super::*;
use crate::EmitError;
use proptest::collection::vec;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

pub(crate) fn any_repr() -> impl Strategy<Value = (Repr, Vec<Iq>)> {
    let wsr = proptest::option::of(
        (any::<u32>(), any::<u32>(), any::<[u8; 6]>(), any::<Option<u32>>())
            .prop_map(|(tv_sec, tv_usec, mac, frame_count)| Wsr { tv_sec, tv_usec, mac: Mac(mac), frame_count }),
    );
    let head = (any::<u32>(), any::<u16>(), any::<u16>(), 1..=3_u8, 1..=3_u8, any::<[u8; 3]>());
    let tail = (any::<i8>(), any::<u8>(), any::<u8>(), any::<u16>(), wsr);
    let repr = (head, tail).prop_map(|((t, n, r, n_rx, n_tx, rssi), (noise, agc, sel, rate, wsr))| Repr {
        timestamp_low: t,
        bfee_count: n,
        reserved: r,
        n_rx,
        n_tx,
        rssi,
        noise_dbm: noise,
        agc,
        antenna_sel: sel,
        rate_n_flags: rate,
        wsr,
    });
    repr.prop_flat_map(|repr| {
        let iq = any::<(i8, i8)>().prop_map(|(i, q)| Iq { i, q });
        (Just(repr), vec(iq, repr.samples()))
    })
}

fn emitted(repr: &Repr, csi: &[Iq]) -> Vec<u8> {
    let mut body = vec![0xa5; repr.body_len()];
    assert_eq!(repr.emit(csi, &mut body), Ok(body.len()));
    body
}

proptest! {
    #[test]
    fn emit_then_parse_is_the_identity((repr, csi) in any_repr()) {
        let body = emitted(&repr, &csi);
        let bfee = Bfee::new_checked(&body).unwrap();
        prop_assert_eq!(Repr::parse(&bfee), repr);
        prop_assert!(bfee.gaps_are_clear());
        let mut bits = vec![Iq::default(); repr.samples()];
        prop_assert_eq!(bfee.unpack_bits(&mut bits), Some(csi.len()));
        prop_assert_eq!(&bits, &csi);
    }

    #[test]
    fn fast_ways_agree_with_the_bit_loop_on_any_payload((repr, csi) in any_repr(), noise in vec(any::<u8>(), 552)) {
        let mut body = emitted(&repr, &csi);
        let header = body.len() - csi_len(repr.n_rx, repr.n_tx);
        body[header..].iter_mut().zip(noise).for_each(|(b, n)| *b = n);
        let bfee = Bfee::new_checked(&body).unwrap();
        let mut oracle = vec![Iq::default(); repr.samples()];
        bfee.unpack_bits(&mut oracle).unwrap();

        let mut words = vec![Iq::default(); repr.samples()];
        bfee.unpack(&mut words).unwrap();
        prop_assert_eq!(&words, &oracle);

        let mut floats = vec![9.0_f32; 2 * repr.samples() + 3];
        prop_assert_eq!(bfee.unpack_f32(&mut floats), Some(oracle.len()));
        let as_f32: Vec<f32> = oracle.iter().flat_map(|iq| [f32::from(iq.i), f32::from(iq.q)]).collect();
        prop_assert_eq!(&floats[..as_f32.len()], &as_f32[..]);
        prop_assert_eq!(&floats[as_f32.len()..], &[9.0; 3]);

        let (n_rx, n_tx) = (bfee.n_rx(), bfee.n_tx());
        let some = [29, 0, 7, 7, 28];
        let mut none = [Iq::default(); 5];
        prop_assert!(bfee.column(n_rx, 0, &some, &mut none).is_none() && bfee.column(0, n_tx, &some, &mut none).is_none());
        prop_assert!(bfee.column(0, 0, &[29, 30], &mut none[..2]).is_none());
        for rx in 0..n_rx {
            for tx in 0..n_tx {
                let (mut iq, mut re_im) = ([Iq::default(); 5], [0.0; 10]);
                bfee.column(rx, tx, &some, &mut iq).unwrap();
                bfee.column_f32(rx, tx, &some, &mut re_im).unwrap();
                for (k, &s) in some.iter().enumerate() {
                    let expect = oracle[(usize::from(s) * n_rx + rx) * n_tx + tx];
                    prop_assert_eq!(iq[k], expect);
                    prop_assert_eq!(bfee.iq(s.into(), rx, tx), Some(expect));
                    prop_assert_eq!([re_im[2 * k], re_im[2 * k + 1]], [f32::from(expect.i), f32::from(expect.q)]);
                }
            }
        }
    }

    #[test]
    fn a_column_has_one_sample_per_requested_subcarrier((repr, csi) in any_repr(), some in vec(0..30_u8, 0..30)) {
        let body = emitted(&repr, &csi);
        let bfee = Bfee::new_checked(&body).unwrap();
        let (rx, tx) = (bfee.n_rx() - 1, bfee.n_tx() - 1);
        let expect: Vec<f32> = some.iter().filter_map(|&s| bfee.iq(s.into(), rx, tx)).flat_map(|iq| [iq.i.into(), iq.q.into()]).collect();
        let mut column = vec![9.0; 2 * some.len()];
        prop_assert_eq!(bfee.column_f32(rx, tx, &some, &mut column), Some(some.len()));
        prop_assert_eq!(column, expect);
    }

    #[test]
    fn any_bytes_are_read_or_refused(body in vec(any::<u8>(), 0..600)) {
        if let Ok(bfee) = Bfee::new_checked(&body) {
            let mut out = [Iq::default(); MAX_SAMPLES];
            prop_assert_eq!(bfee.unpack(&mut out), Some(bfee.samples()));
            let _ = (bfee.antennas(), bfee.wsr(), bfee.gaps_are_clear());
        }
    }

    #[test]
    fn a_set_gap_bit_is_seen((repr, csi) in any_repr(), subcarrier in 0..30_usize, bit in 0..3_usize) {
        let mut body = emitted(&repr, &csi);
        let n = usize::from(repr.n_rx * repr.n_tx);
        let at = 8 * (body.len() - csi_len(repr.n_rx, repr.n_tx)) + subcarrier * (3 + 16 * n) + bit;
        body[at / 8] |= 1 << (at % 8);
        prop_assert!(!Bfee::new_checked(&body).unwrap().gaps_are_clear());
    }
}

/// Header bytes written by hand from the format's table, not by `emit`.
#[test]
fn fields_lie_where_the_format_says() {
    let mut body = vec![0_u8; 38 + 72];
    body[..20].copy_from_slice(&[
        0x78, 0x56, 0x34, 0x12, 0xcd, 0xab, 0, 0, 1, 1, 33, 0, 0, 0x81, 38, 0x24, 72, 0, 0x01, 0x29,
    ]);
    body[20..38].copy_from_slice(&[1, 0, 0, 0, 2, 0, 0, 0, 0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2, 5, 4, 3, 2]);
    // The first sample begins at bit 3: -1 - 128j.
    body[38] = 0xf8;
    body[39] = 0x07;
    body[40] = 0x04;
    let bfee = Bfee::new_checked(&body).unwrap();
    assert_eq!(bfee.layout(), Layout::Wsr);
    assert_eq!((bfee.timestamp_low(), bfee.bfee_count()), (0x1234_5678, 0xabcd));
    assert_eq!((bfee.n_rx(), bfee.n_tx(), bfee.rssi()), (1, 1, [33, 0, 0]));
    assert_eq!((bfee.noise_dbm(), bfee.agc(), bfee.rate_n_flags()), (NOISE_UNKNOWN_DBM, 38, 0x2901));
    assert!(bfee.is_40_mhz());
    let mac = Mac([0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2]);
    assert_eq!(bfee.wsr(), Some(Wsr { tv_sec: 1, tv_usec: 2, mac, frame_count: Some(0x0203_0405) }));
    assert_eq!(bfee.iq(0, 0, 0), Some(Iq { i: -1, q: -128 }));
    assert_eq!(bfee.iq(30, 0, 0), None);
    assert_eq!(bfee.iq(0, 1, 0), None);
    body.drain(34..38);
    let unnumbered = Bfee::new_checked(&body).unwrap();
    assert_eq!((unnumbered.layout(), unnumbered.iq(0, 0, 0)), (Layout::Wsr2021, bfee_first()));
    assert_eq!(unnumbered.wsr(), Some(Wsr { tv_sec: 1, tv_usec: 2, mac, frame_count: None }));
    body.drain(20..34);
    let stock = Bfee::new_checked(&body).unwrap();
    assert_eq!((stock.layout(), stock.wsr(), stock.iq(0, 0, 0)), (Layout::Stock, None, bfee_first()));
}

fn bfee_first() -> Option<Iq> {
    Some(Iq { i: -1, q: -128 })
}

#[test]
fn a_body_that_continues_after_its_csi_is_read_in_its_layout() {
    let numbered = Wsr { tv_sec: 5, tv_usec: 6, mac: Mac([2; 6]), frame_count: Some(7) };
    for wsr in [None, Some(Wsr { frame_count: None, ..numbered }), Some(numbered)] {
        let repr = Repr { wsr, ..Repr::default() };
        let csi: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: k as i8, q: !(k as i8) }).collect();
        let body = emitted(&repr, &csi);
        for behind in 0..40 {
            let longer: Vec<u8> = body.iter().copied().chain(0xa0..0xa0 + behind).collect();
            let bfee = Bfee::new_checked(&longer).unwrap();
            // By its length such a body has another layout.
            if Layout::Wsr2021.header_len() + 192 != longer.len() && Layout::Wsr.header_len() + 192 != longer.len() {
                assert_eq!((Repr::parse(&bfee), bfee.iq(29, 2, 0)), (repr, csi.last().copied()), "{behind} behind");
                assert_eq!(bfee.behind_csi(), &longer[body.len()..]);
            }
        }
    }
}

#[test]
fn lengths_and_chains_must_agree() {
    let repr = Repr::default();
    let csi = vec![Iq::default(); repr.samples()];
    let good = emitted(&repr, &csi);
    let error = |body: &[u8]| Bfee::new_checked(body).unwrap_err();
    assert_eq!(error(&good[..19]), Error::Short { got: 19 });
    assert_eq!(error(&good[..211]), Error::BodyLength { csi: 192, got: 211 });
    for (at, value, expect) in [
        (offset::N_RX, 0, Error::Chains { n_rx: 0, n_tx: 1 }),
        (offset::N_RX, 4, Error::Chains { n_rx: 4, n_tx: 1 }),
        (offset::N_TX, 9, Error::Chains { n_rx: 3, n_tx: 9 }),
        (offset::N_TX, 2, Error::CsiLength { expect: 372, got: 192 }),
        (offset::LEN, 193, Error::CsiLength { expect: 192, got: 193 }),
    ] {
        let mut body = good.clone();
        body[at] = value;
        assert_eq!(error(&body), expect);
    }
    let mut out = [0; 300];
    assert_eq!(Repr { n_rx: 4, ..repr }.emit(&csi, &mut out), Err(EmitError::Field { name: "n_rx", got: 4, max: 3 }));
    assert_eq!(repr.emit(&csi[1..], &mut out), Err(EmitError::Samples { expect: 90, got: 89 }));
    assert_eq!(repr.emit(&csi, &mut out[..211]), Err(EmitError::Buffer { need: 212, got: 211 }));
}

#[test]
fn antennas_of_known_selections() {
    use Antenna::{A, B, C};
    let of = |sel, n_rx, rssi| Antennas::new(sel, n_rx, rssi).map(|a| a.as_slice().to_vec());
    // Values seen in captures.
    assert_eq!(of(0x24, 3, [1; 3]), Ok(vec![A, B, C]));
    assert_eq!(of(0x18, 3, [1; 3]), Ok(vec![A, C, B]));
    assert_eq!(of(0x09, 3, [1; 3]), Ok(vec![B, C, A]));
    assert_eq!(of(0x06, 3, [1; 3]), Ok(vec![C, B, A]));
    // Two chains: antennas A and C.
    assert_eq!(of(0x08, 2, [1, 0, 1]), Ok(vec![A, C]));
    assert_eq!(Antennas::new(0x08, 2, [1, 0, 1]).unwrap().chain_of(C), Some(1));
    assert_eq!(Antennas::new(0x08, 2, [1, 0, 1]).unwrap().chain_of(B), None);
    // One chain: named, or the only one with a nonzero RSSI.
    assert_eq!(of(0x02, 1, [0; 3]), Ok(vec![C]));
    assert_eq!(of(0x03, 1, [0, 7, 0]), Ok(vec![B]));
    for (sel, n_rx, rssi) in [
        (0x3f, 3, [1; 3]),
        (0x00, 3, [1; 3]),
        (0x05, 2, [1; 3]),
        (0x0c, 2, [1; 3]),
        (0x03, 1, [1, 1, 0]),
        (0x24, 4, [1; 3]),
    ] {
        assert_eq!(of(sel, n_rx, rssi), Err(InvalidPerm { antenna_sel: sel, n_rx }));
    }
}

#[test]
fn a_sender_is_unknown_where_address_and_number_are_zero() {
    let known = |mac, frame_count| Wsr { mac, frame_count: Some(frame_count), ..Wsr::default() }.sender_known();
    let some = Mac([0, 0, 0, 0, 0, 1]);
    assert_eq!(
        [known(Mac::default(), 0), known(Mac::default(), 1), known(some, 0), known(some, 1)],
        [false, true, true, true]
    );
}

#[test]
fn a_record_has_its_width_and_antennas() {
    for (rate_n_flags, wide) in [(0x0101, false), (0x0901, true), (!rate::HT40, false), (rate::HT40, true)] {
        // Chains 1 and 2 were connected to C and A.
        let repr = Repr { n_rx: 2, antenna_sel: 0b00_0010, rate_n_flags, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let bfee = Bfee::new_checked(&body).unwrap();
        assert_eq!(bfee.is_40_mhz(), wide, "{rate_n_flags:#06x}");
        assert_eq!(Antenna::ALL.map(|antenna| bfee.chain_of(antenna)), [Some(1), None, Some(0)]);
    }
    assert_eq!(Antenna::ALL.map(Antenna::index), [0, 1, 2]);
}

#[test]
fn a_sample_outside_the_record_is_none() {
    let repr = Repr { n_rx: 2, n_tx: 2, ..Repr::default() };
    let iq: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: k as i8, q: 1 }).collect();
    let mut body = vec![0; repr.body_len()];
    repr.emit(&iq, &mut body).unwrap();
    let bfee = Bfee::new_checked(&body).unwrap();
    assert_eq!(bfee.iq(29, 1, 1), Some(Iq { i: 119, q: 1 }));
    assert_eq!([bfee.iq(30, 0, 0), bfee.iq(0, 2, 0), bfee.iq(0, 0, 2)], [None; 3]);
}
