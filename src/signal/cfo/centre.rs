//! CSI at the channel centre: a line through the phase over the subcarriers.

use crate::maths::wrap_rad;
use crate::signal::channel::SUBCARRIERS;
use crate::signal::samples::Coherent;
use num_complex::{Complex32, Complex64};

/// Brings the CSI of one direction to the channel centre (subcarrier index 0, which the card does not report): the
/// least-squares line through the unwrapped phase over the true subcarrier `indices`, evaluated at 0.
///
/// So that unwrapping does not slip on noise the slope is first removed as the phase of the summed neighbour products,
/// and the rest unwrapped and fitted; nothing is lost, the fit is of the sum of both.
/// A subcarrier at (0, 0) has no phase and no part in the line. The magnitude is the root mean square over all subcarriers.
/// `None` if all are zero.
#[must_use]
pub fn at_centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> Option<Coherent> {
    Some(Coherent { h: centre(csi, indices, slope(csi, indices))?, path_gain: 1 })
}

/// The usual phase step from one subcarrier to the next, radians per index.
pub(super) fn slope(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> f64 {
    let usual = indices[1] - indices[0];
    // Steps of the usual width only; the centre and one edge have narrower ones.
    let steps = (1..SUBCARRIERS).filter(|&k| indices[k] - indices[k - 1] == usual);
    let turn: Complex32 = steps.map(|k| csi[k] * csi[k - 1].conj()).sum();
    f64::from(turn.arg()) / f64::from(usual)
}

/// The centre of `csi`, given about how steep its phase is, radians per index.
pub(super) fn centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS], slope: f64) -> Option<Complex64> {
    let power: f32 = csi.iter().map(Complex32::norm_sqr).sum();
    if !(power > 0.0 && power.is_finite()) {
        return None;
    }
    let mut last = None;
    let (mut n, mut sum, mut sum_x, mut sum_xx, mut sum_xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for k in (0..SUBCARRIERS).filter(|&k| csi[k] != Complex32::default()) {
        let x = f64::from(indices[k]);
        let phase = f64::from(csi[k].arg()) - slope * x;
        let phase = last.map_or(phase, |last| last + wrap_rad(phase - last));
        last = Some(phase);
        n += 1.0;
        sum += phase;
        sum_x += x;
        sum_xx += x * x;
        sum_xy += x * phase;
    }
    let spread = n * sum_xx - sum_x * sum_x;
    // Of a single subcarrier the line has no slope of its own.
    let rest = if spread > 0.0 { (n * sum_xy - sum_x * sum) / spread } else { 0.0 };
    let phase = (sum - rest * sum_x) / n;
    Some(Complex64::from_polar((f64::from(power) / SUBCARRIERS as f64).sqrt(), phase))
}
