//! What each method would cost: a count of the work of its steps, each by what a unit of it takes.
//!
//! Only ratios matter: the planner takes the cheapest method, and `explain` prints its estimate. Constants are measured
//! (`cargo bench --bench pareto` prints the time of every method beside each other, forced ones included); a wrong one
//! costs time, never accuracy.

use super::explain::{Method, Precision};
use super::key::{Key, cone_rows, ring_shape};
use csi5300_kernels::evaluate::Slab;
use csi5300_kernels::setting::{Axis, Setting};
use csi5300_kernels::simd::Tier;

/// The oracle: one term, a sine and a cosine to the last bit with the phase reduced exactly, nanoseconds.
pub(super) const ORACLE_TERM_NS: f64 = 60.0;
/// A complex cell of a kernel's square in units of a real one.
const COMPLEX: f64 = 2.0;
/// Spreading a sample onto a kernel's square in units of interpolating from one: it reads and writes.
const SPREAD: f64 = 1.5;
/// The same for a kernel in one dimension, where weights are a larger share.
const SPREAD_LINE: f64 = 3.0;
/// A term of the interpolation over elevations (a node for a pair of mirrored values), in units of an assembled value.
const ELEVATION_TERM: f64 = 0.06;
/// The interpolation over azimuths by FFT, in units of an assembled value each.
const AZIMUTH_FFT: f64 = 0.3;
/// What a transform of a plane takes however small it is, nanoseconds.
const PLANE_NS: f64 = 3_000.0;
/// Half the doublings of a transform in one dimension: those of 256 points, whatever its size.
const LINE_DOUBLINGS: f64 = 4.0;
/// The least tolerance that a kernel can be had for, in single precision and in double.
const NARROWEST: [f64; 2] = [7.5e-7, 6e-14];

/// Nanoseconds per unit of work.
#[derive(Clone, Copy)]
struct UnitCosts {
    /// An antipodal pair of terms: one sine and cosine, two complex products.
    pair: f64,
    /// A real cell of a kernel's square.
    cell: f64,
    /// A point of an FFT for each two doublings of its size.
    fft: f64,
    /// A value of the profile put into its place and squared.
    assembled: f64,
}

impl UnitCosts {
    /// Measured in single precision on a Xeon and an EPYC with AVX-512; double takes twice that. The portable code is that
    /// of SSE4.2 without its rounding instructions.
    fn of(tier: Tier, precision: Precision) -> Self {
        let [pair, cell, fft, assembled] = match tier {
            Tier::Avx512 => [0.27, 0.07, 0.25, 0.5],
            Tier::Avx2 => [0.5, 0.09, 0.25, 0.6],
            Tier::Sse42 | Tier::Native => [1.45, 0.14, 0.39, 0.95],
            Tier::Portable => [3.0, 0.3, 1.0, 1.6],
        };
        let factor = if precision == Precision::Single { 1.0 } else { 2.0 };
        Self { pair: pair * factor, cell: cell * factor, fft: fft * factor, assembled: assembled * factor }
    }
}

/// An antipodal pair of terms of a direct sum, nanoseconds.
pub(crate) fn pair_ns(tier: Tier, precision: Precision) -> f64 {
    UnitCosts::of(tier, precision).pair
}

/// The least tolerance that single precision is trusted with, for a radius in radians of phase.
///
/// Direct sums round phases to 2^-24 of themselves three times: measured on single packets, 0.4 of this floor. The NUFFT
/// rounds weights and FFTs, whatever the radius: measured, 3e-7 at 0.03 m, with room for kernels and many packets.
pub(super) fn single_floor(method: Method, radius: f64) -> f64 {
    match method {
        Method::Direct | Method::RingsDirect => 1e-6 + 2e-7 * radius,
        _ => 1e-5,
    }
}

/// What a method would cost here, nanoseconds, with its precision and its kernel; none if it cannot serve.
pub(super) fn price(
    key: &Key,
    method: Method,
    order: [usize; 2],
    tier: Tier,
) -> Option<(Precision, Option<Setting>, f64)> {
    let tall = key.extent[2] > 0.0;
    let rings = ring_shape(key, order);
    let serves = match method {
        Method::RingsDirect => rings.is_some(),
        Method::RingsNufft => rings.is_some() && !tall,
        Method::TargetsNufft => !tall,
        Method::Slab => tall,
        Method::Cone => key.line,
        _ => true,
    };
    if !serves {
        return None;
    }
    let precision = match key.options.precision {
        Some(precision) => precision,
        None if key.options.eps >= single_floor(method, key.radius[1]) => Precision::Single,
        None => Precision::Double,
    };
    let setting = match method {
        Method::Direct | Method::RingsDirect => None,
        _ => Some(kernel(key, method, precision)?),
    };
    let cost = Work { key, rings, unit: UnitCosts::of(tier, precision) }.cost_ns(method, setting)?;
    Some((precision, setting, cost))
}

/// The kernel of a method; none if it cannot be accurate enough.
fn kernel(key: &Key, method: Method, precision: Precision) -> Option<Setting> {
    let eps = key.options.eps;
    // A third dimension has a kernel of its own.
    let share = if method == Method::Slab { eps / 6.0 } else { eps / 4.0 };
    let single = precision == Precision::Single;
    let narrow = if single { NARROWEST[0] } else { NARROWEST[1] };
    let found = Setting::for_eps(share.max(narrow), single)?;
    (share >= narrow || key.options.precision.is_some()).then_some(found)
}

/// The work that a plan for a key has.
struct Work<'a> {
    key: &'a Key,
    /// Azimuths and elevations that are evaluated for a grid of rings.
    rings: Option<(usize, usize)>,
    unit: UnitCosts,
}

impl Work<'_> {
    fn cost_ns(&self, method: Method, setting: Option<Setting>) -> Option<f64> {
        let UnitCosts { pair, cell, assembled, .. } = self.unit;
        let (n, all) = (self.key.count as f64, self.key.grid.len() as f64);
        let ring_points = self.ring_points();
        let square = setting.map_or(0.0, |s| (s.width * s.width) as f64);
        Some(match (method, setting) {
            (Method::Direct, _) => all * n * pair + all * assembled,
            (Method::RingsDirect, _) => ring_points / 2.0 * n * pair + self.assembly(),
            (Method::RingsNufft, Some(s)) => {
                (n * SPREAD + ring_points) * square * cell * COMPLEX + self.plane(s) + self.assembly()
            }
            (Method::TargetsNufft, Some(s)) => {
                (n * SPREAD + all) * square * cell * COMPLEX + self.plane(s) + all * assembled
            }
            (Method::Cone, Some(s)) => self.cone(s),
            (Method::Slab, Some(s)) => {
                let planes = Slab::<f64>::planes(self.key.extent[2], self.key.grid.steepest, s) as f64;
                let points = if self.rings.is_some() { ring_points / 2.0 } else { all };
                let spread = n * s.width as f64 * SPREAD * square * cell * COMPLEX;
                spread + planes * (points * square * cell * COMPLEX + self.plane(s)) + self.assembly()
            }
            _ => return None,
        })
    }

    /// Directions that are evaluated for a grid of rings.
    fn ring_points(&self) -> f64 {
        let sides = if self.key.extent[2] > 0.0 { 2 } else { 1 };
        self.rings.map_or(0.0, |(d, nodes)| (d * nodes * sides) as f64)
    }

    /// From the rings that were evaluated to the grid.
    fn assembly(&self) -> f64 {
        let all = self.key.grid.len();
        self.rings.map_or(0.0, |(d, nodes)| {
            let azimuths = if d * nodes < all { all as f64 * AZIMUTH_FFT } else { 0.0 };
            let work = all as f64 / 2.0 * nodes as f64 * ELEVATION_TERM + azimuths;
            (work + all as f64) * self.unit.assembled
        })
    }

    /// The transform of a plane.
    fn plane(&self, s: Setting) -> f64 {
        let [x, y] = [Axis::new(self.key.extent[0], s), Axis::new(self.key.extent[1], s)];
        let points = ((2 * y.half + 1) * x.n) as f64 + x.n as f64 / s.oversampling * y.n as f64;
        points * (points.log2() / 2.0).max(1.0) * self.unit.fft + PLANE_NS
    }

    /// Motion along a line: a transform in one dimension.
    fn cone(&self, s: Setting) -> f64 {
        let UnitCosts { cell, fft, assembled, .. } = self.unit;
        let all = self.key.grid.len() as f64;
        // Whole vectors of the kernel are computed.
        let width = s.width.next_multiple_of(8) as f64;
        let rows = cone_rows(self.key);
        let n = self.key.count as f64 * SPREAD_LINE
            + rows.map_or(all, |(rows, _)| (rows.len() * self.key.grid.shape().1) as f64);
        n * width * cell * COMPLEX + Axis::new(self.key.extent[0], s).n as f64 * LINE_DOUBLINGS * fft + all * assembled
    }
}
