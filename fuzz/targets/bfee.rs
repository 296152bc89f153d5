//! Any bytes as a bfee body: refused, or all accessors work, the ways to unpack agree, and emit reproduces it.

use driver_iface::bfee::{ALL_SUBCARRIERS, Bfee, Iq, MAX_BODY, MAX_SAMPLES, Repr};

/// Runs the target.
pub fn run(body: &[u8]) {
    let Ok(bfee) = Bfee::new_checked(body) else { return };
    let (mut words, mut bits) = ([Iq::default(); MAX_SAMPLES], [Iq::default(); MAX_SAMPLES]);
    let n = bfee.unpack(&mut words).unwrap();
    assert_eq!(bfee.unpack_bits(&mut bits), Some(n));
    assert!(words == bits);
    let mut floats = [0.0; 2 * MAX_SAMPLES];
    bfee.unpack_f32(&mut floats).unwrap();
    let agree = |iq: &Iq, pair: &[f32]| *pair == [f32::from(iq.i), f32::from(iq.q)];
    assert!(words.iter().zip(floats.chunks(2)).take(n).all(|(iq, pair)| agree(iq, pair)));
    let rx = bfee.antennas().ok().map_or(0, |antennas| antennas.as_slice().len() - 1);
    let mut column = [0.0; 60];
    bfee.column_f32(rx, bfee.n_tx() - 1, &ALL_SUBCARRIERS, &mut column).unwrap();
    for (subcarrier, pair) in column.chunks(2).enumerate() {
        assert!(agree(&bfee.iq(subcarrier, rx, bfee.n_tx() - 1).unwrap(), pair));
    }
    let mut again = [0; MAX_BODY];
    let len = Repr::parse(&bfee).emit(&words[..n], &mut again).unwrap();
    let body = &body[..body.len() - bfee.behind_csi().len()];
    assert_eq!(again[..len] == *body, bfee.gaps_are_clear());
}
