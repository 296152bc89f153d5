//! A row of subcarriers as two planes, real and imaginary, padded with zeros to whole vectors: plain loops over them are
//! vector code on every tier (inside [`on_tier`](csi5300_kernels::simd::on_tier)).

use crate::bartlett::Tier;
use crate::signal::cfo::Heard;
use crate::signal::channel::SUBCARRIERS;
use csi5300_kernels::simd::on_tier;
use num_complex::{Complex32, Complex64};

/// Subcarriers, and two places that stay zero.
pub(crate) const LANES: usize = 32;

/// One number per subcarrier.
pub(crate) type Lanes = [f32; LANES];

/// One channel sample on every reported subcarrier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Planes {
    pub re: Lanes,
    pub im: Lanes,
}

/// `f` of every place.
#[inline(always)]
pub(crate) fn lanes(f: impl Fn(usize) -> f32) -> Lanes {
    let mut out = [0.0; LANES];
    for (k, slot) in out.iter_mut().enumerate() {
        *slot = f(k);
    }
    out
}

/// The sum of all places, in an order that vectors can follow.
#[inline(always)]
pub(crate) fn sum(x: &Lanes) -> f32 {
    let mut part = [0.0f32; 8];
    for chunk in x.chunks_exact(8) {
        part.iter_mut().zip(chunk).for_each(|(p, v)| *p += v);
    }
    let [a, b, c, d, e, f, g, h] = part;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

impl Planes {
    /// Of phase 0 and unit power on every subcarrier.
    pub const ONE: Self = {
        let mut re = [0.0; LANES];
        let mut k = 0;
        while k < SUBCARRIERS {
            re[k] = 1.0;
            k += 1;
        }
        Self { re, im: [0.0; LANES] }
    };
    pub const ZERO: Self = Self { re: [0.0; LANES], im: [0.0; LANES] };

    /// Place by place.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        self.re.iter_mut().zip(&other.re).for_each(|(s, v)| *s += v);
        self.im.iter_mut().zip(&other.im).for_each(|(s, v)| *s += v);
    }

    /// Place by place.
    #[inline(always)]
    pub fn times(&self, other: &Self) -> Self {
        let (a, b) = (self, other);
        Self {
            re: lanes(|k| a.re[k] * b.re[k] - a.im[k] * b.im[k]),
            im: lanes(|k| a.re[k] * b.im[k] + a.im[k] * b.re[k]),
        }
    }

    /// `self conj(other)`, place by place.
    #[inline(always)]
    pub fn against(&self, other: &Self) -> Self {
        let (a, b) = (self, other);
        Self {
            re: lanes(|k| a.re[k] * b.re[k] + a.im[k] * b.im[k]),
            im: lanes(|k| a.im[k] * b.re[k] - a.re[k] * b.im[k]),
        }
    }

    /// The magnitude of each place.
    #[inline(always)]
    pub fn sizes(&self) -> Lanes {
        lanes(|k| (self.re[k] * self.re[k] + self.im[k] * self.im[k]).sqrt())
    }

    #[inline(always)]
    pub fn sum(&self) -> Complex32 {
        Complex32::new(sum(&self.re), sum(&self.im))
    }
}

/// The round trip of each pair (forward, backward) of frames, of unit power and with the given rotation; zeros if it is
/// not finite.
pub(crate) fn round_trips(pairs: &[[Heard; 2]], turns: impl Iterator<Item = Complex64>, tier: Tier) -> Vec<Planes> {
    let mut rows = Vec::with_capacity(pairs.len());
    on_tier!(tier.level_or_portable(), _simd => {
        for (pair, turn) in pairs.iter().zip(turns) {
            rows.push(round_trip(pair, turn));
        }
    });
    rows
}

#[inline(always)]
fn round_trip([forward, backward]: &[Heard; 2], turn: Complex64) -> Planes {
    let product = raw(forward).times(&raw(backward));
    let power = lanes(|k| product.re[k] * product.re[k] + product.im[k] * product.im[k]);
    let factor = Complex32::new(turn.re as f32, turn.im as f32) / (sum(&power) / SUBCARRIERS as f32).sqrt();
    let factor = if factor.is_finite() { factor } else { Complex32::default() };
    product.times(&Planes { re: [factor.re; LANES], im: [factor.im; LANES] })
}

/// The CSI, unscaled.
#[inline(always)]
fn raw(heard: &Heard) -> Planes {
    let mut planes = Planes::ZERO;
    for (k, iq) in heard.iter().enumerate() {
        (planes.re[k], planes.im[k]) = (f32::from(iq.i), f32::from(iq.q));
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::bfee::Iq;

    fn of(row: &[Complex32]) -> Planes {
        let own = |k: usize| row.get(k).copied().unwrap_or_default();
        Planes { re: lanes(|k| own(k).re), im: lanes(|k| own(k).im) }
    }

    fn row(planes: &Planes) -> Vec<Complex32> {
        (0..SUBCARRIERS).map(|k| Complex32::new(planes.re[k], planes.im[k])).collect()
    }

    #[test]
    fn planes_are_multiplied_place_by_place() {
        let a: Vec<Complex32> =
            (0..SUBCARRIERS).map(|k| Complex32::new(k as f32 - 3.5, 2.0 - 0.3 * k as f32)).collect();
        let b: Vec<Complex32> = (0..SUBCARRIERS).map(|k| Complex32::cis(0.7 * k as f32)).collect();
        let near = |got: Planes, expected: &dyn Fn(usize) -> Complex32| {
            row(&got).iter().enumerate().all(|(k, v)| (v - expected(k)).norm() < 1e-5)
        };
        assert!(near(of(&a).times(&of(&b)), &|k| a[k] * b[k]));
        assert!(near(of(&a).against(&of(&b)), &|k| a[k] * b[k].conj()));
        assert!((of(&a).sum() - a.iter().sum::<Complex32>()).norm() < 1e-4);
        assert!((sum(&of(&a).sizes()) - a.iter().map(|v| v.norm()).sum::<f32>()).abs() < 1e-3);
    }

    #[test]
    fn round_trips_are_products_of_unit_power_turned() {
        let heard = |of: &dyn Fn(usize) -> (i8, i8)| -> Heard {
            std::array::from_fn(|k| {
                let (i, q) = of(k);
                Iq { i, q }
            })
        };
        let forward = heard(&|k| (k as i8 - 40, 3));
        let backward = heard(&|k| (5, 2 * k as i8 - 9));
        let silent = heard(&|_| (0, 0));
        let turn = Complex64::cis(0.4);
        let pairs = [[forward, backward], [forward, silent]];
        let wide = |iq: Iq| Complex32::new(f32::from(iq.i), f32::from(iq.q));
        let product: Vec<Complex32> = forward.iter().zip(&backward).map(|(a, b)| wide(*a) * wide(*b)).collect();
        let power = product.iter().map(Complex32::norm_sqr).sum::<f32>() / SUBCARRIERS as f32;
        for tier in Tier::available() {
            let rows = round_trips(&pairs, [turn; 2].into_iter(), tier);
            let own = row(&rows[0]);
            let expected = product.iter().map(|v| v * Complex32::cis(0.4) / power.sqrt());
            assert!(own.iter().zip(expected).all(|(got, expected)| (got - expected).norm() < 1e-6), "{tier:?}");
            assert_eq!((rows[1], rows[0].re[LANES - 1]), (Planes::ZERO, 0.0));
        }
    }
}
