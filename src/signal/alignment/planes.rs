//! A row of subcarriers as two planes, real and imaginary, padded with zeros to whole vectors: plain loops over them are
//! vector code on every tier (inside [`on_tier`](csi5300_kernels::simd::on_tier)).

use super::CsiRow;
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
    pub const ZERO: Self = Self { re: [0.0; LANES], im: [0.0; LANES] };

    #[inline(always)]
    pub fn of(row: &CsiRow) -> Self {
        let mut planes = Self::ZERO;
        for (k, value) in row.iter().enumerate() {
            (planes.re[k], planes.im[k]) = (value.re, value.im);
        }
        planes
    }

    #[inline(always)]
    pub fn row(&self) -> CsiRow {
        let mut row = [Complex32::default(); SUBCARRIERS];
        for (k, value) in row.iter_mut().enumerate() {
            *value = Complex32::new(self.re[k], self.im[k]);
        }
        row
    }

    /// Place by place.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        self.re.iter_mut().zip(&other.re).for_each(|(s, v)| *s += v);
        self.im.iter_mut().zip(&other.im).for_each(|(s, v)| *s += v);
    }

    /// Place by place.
    #[inline(always)]
    pub fn take(&mut self, other: &Self) {
        self.re.iter_mut().zip(&other.re).for_each(|(s, v)| *s -= v);
        self.im.iter_mut().zip(&other.im).for_each(|(s, v)| *s -= v);
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

    /// Turns the whole row by so many radians.
    #[inline(always)]
    pub fn turn(&mut self, by_rad: f64) {
        let (sin, cos) = (by_rad.sin() as f32, by_rad.cos() as f32);
        for (re, im) in self.re.iter_mut().zip(&mut self.im) {
            (*re, *im) = (*re * cos - *im * sin, *re * sin + *im * cos);
        }
    }

    /// The sum over all places, each times its number in `by`.
    #[inline(always)]
    pub fn moment(&self, by: &Lanes) -> Complex32 {
        Complex32::new(sum(&lanes(|k| self.re[k] * by[k])), sum(&lanes(|k| self.im[k] * by[k])))
    }

    #[inline(always)]
    pub fn sum(&self) -> Complex32 {
        Complex32::new(sum(&self.re), sum(&self.im))
    }
}

/// The round trip of each pair (forward, backward) of frames, of unit power and turned by what goes with it; zeros where that
/// is not finite.
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

/// What was heard as it is, unscaled.
#[inline(always)]
fn raw(heard: &Heard) -> Planes {
    let mut planes = Planes::ZERO;
    for (k, iq) in heard.iter().enumerate() {
        (planes.re[k], planes.im[k]) = (f32::from(iq.i), f32::from(iq.q));
    }
    planes
}

/// The planes of `rows`.
pub(crate) fn planes_of(rows: &[CsiRow]) -> Vec<Planes> {
    rows.iter().map(Planes::of).collect()
}

/// Turns each row as a whole so that it has the phase of the row before it, measured on the subcarriers of `weights`: what
/// motion and carrier do from packet to packet, and what would let the sum over neighbours fade where they go fast. Adds to
/// `turned` what each row was turned back by, radians, counted on from the first.
#[inline(always)]
pub(crate) fn settle(rows: &mut [Planes], weights: &Lanes, turned: &mut [f64]) {
    let mut total = 0.0;
    let mut before: Option<Planes> = None;
    for (row, turned) in rows.iter_mut().zip(turned) {
        let step = before.replace(*row).map_or(0.0, |before| {
            let product = row.against(&before);
            let weighted = |part: &Lanes| sum(&lanes(|k| part[k] * weights[k]));
            f64::from(Complex32::new(weighted(&product.re), weighted(&product.im)).arg())
        });
        total += step;
        row.turn(-total);
        *turned += total;
    }
}

/// The sum over `2 reach + 1` rows about one (fewer at the ends), on its way along all rows: a running sum over the rows as they
/// are.
pub(crate) struct Around {
    reach: usize,
    sum: Planes,
    /// The rows of before, which the sum still has to lose.
    old: Vec<Planes>,
    /// The row that comes next.
    next: usize,
}

impl Around {
    /// As it is before the first row.
    #[inline(always)]
    pub fn first(rows: &[Planes], reach: usize) -> Self {
        Self::before(rows, reach, 0)
    }

    /// As it is before row `next`, summed anew.
    #[inline(always)]
    pub fn before(rows: &[Planes], reach: usize, next: usize) -> Self {
        let mut around = Self { reach, sum: Planes::ZERO, old: vec![Planes::ZERO; reach + 1], next };
        let from = next.saturating_sub(reach + 1);
        rows.iter().skip(from).take(next + reach - from).for_each(|row| around.sum.add(row));
        rows.iter().enumerate().take(next).skip(from).for_each(|(k, row)| around.old[k % (reach + 1)] = *row);
        around
    }

    /// As it is before row `middle`, and the rows from there on that sums of rows before it take in: with both, the two parts
    /// can be gone along side by side, to the same numbers as one after the other.
    #[inline(always)]
    pub fn parted(rows: &[Planes], reach: usize, middle: usize) -> (Self, Vec<Planes>) {
        let mut around = Self::first(rows, reach);
        (0..middle).for_each(|k| around.step(&rows[k], rows.get(k + reach)));
        (around, rows.iter().skip(middle).take(reach).copied().collect())
    }

    /// Goes along `rows`, the first of which is the row that comes next; `behind` follows them. Hands `step` each row's place in
    /// `rows` and the sum about it: `step` may only change the row that it is handed, which the sums of later rows do not see.
    #[inline(always)]
    pub fn along(mut self, rows: &mut [Planes], behind: &[Planes], mut step: impl FnMut(usize, &mut Planes, &Planes)) {
        let (count, reach) = (rows.len(), self.reach);
        for k in 0..count {
            let ahead = k + reach;
            self.step(&rows[k], if ahead < count { rows.get(ahead) } else { behind.get(ahead - count) });
            step(k, &mut rows[k], &self.sum);
        }
    }

    #[inline(always)]
    fn step(&mut self, row: &Planes, ahead: Option<&Planes>) {
        if let Some(ahead) = ahead {
            self.sum.add(ahead);
        }
        let slot = self.next % (self.reach + 1);
        if self.next > self.reach {
            self.sum.take(&self.old[slot]);
        }
        self.old[slot] = *row;
        self.next += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::bfee::Iq;

    #[test]
    fn planes_and_rows_are_the_same_numbers() {
        let row: CsiRow = std::array::from_fn(|k| Complex32::new(k as f32 - 3.5, 2.0 - 0.3 * k as f32));
        let other: CsiRow = std::array::from_fn(|k| Complex32::cis(0.7 * k as f32));
        let (a, b) = (Planes::of(&row), Planes::of(&other));
        assert_eq!(a.row(), row);
        let near = |got: Planes, expected: &dyn Fn(usize) -> Complex32| {
            got.row().iter().enumerate().all(|(k, v)| (v - expected(k)).norm() < 1e-5)
        };
        assert!(near(a.times(&b), &|k| row[k] * other[k]));
        assert!(near(a.against(&b), &|k| row[k] * other[k].conj()));
        let total: Complex32 = row.iter().sum();
        assert!((a.sum() - total).norm() < 1e-4);
        assert!((sum(&a.sizes()) - row.iter().map(|v| v.norm()).sum::<f32>()).abs() < 1e-3);
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
            let own = rows[0].row();
            let expected = product.iter().map(|v| v * Complex32::cis(0.4) / power.sqrt());
            assert!(own.iter().zip(expected).all(|(got, expected)| (got - expected).norm() < 1e-6), "{tier:?}");
            assert_eq!((rows[1], rows[0].re[LANES - 1]), (Planes::ZERO, 0.0));
        }
    }

    #[test]
    fn neighbours_are_summed_as_they_were() {
        let row = |k: usize| Planes { re: [k as f32; LANES], im: [1.0; LANES] };
        for (n, reach) in [(1, 3), (5, 2), (20, 4)] {
            let mut rows: Vec<Planes> = (0..n).map(row).collect();
            let mut seen = 0;
            Around::first(&rows, reach).along(&mut rows, &[], |k, row, sum| {
                let around = k.saturating_sub(reach)..(k + reach + 1).min(n);
                assert_eq!((sum.re[3], sum.im[7]), (around.clone().sum::<usize>() as f32, around.len() as f32));
                // What is changed is not seen by later sums.
                *row = Planes { re: [1e6; LANES], im: [1e6; LANES] };
                seen += 1;
            });
            assert_eq!(seen, n);
        }
    }
}
