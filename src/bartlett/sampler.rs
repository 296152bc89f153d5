//! The profile sampled on rings of constant elevation, so densely that no maximum falls between the samples unnoticed.
//!
//! Around a ring `f` is band limited: it is summed at `2 M + 2` azimuths or a few more and interpolated; `M` is that of the
//! radius as seen from the ring, which falls with the cosine of its elevation. Antipodes share their sums: `f(-u)` has the
//! same terms conjugated in their phases. Rings are taken some at a time, from the horizon outwards, and only their maxima
//! are kept: all of a sphere would be megabytes.

use super::scene::Scene;
use csi5300_kernels::fft::{Ffts, near_size};
use csi5300_kernels::resample::{Resample, ResampleWork};
use csi5300_kernels::simd::{Real, Tier};
use csi5300_kernels::sums::{Columns, PairSum, Sines, pairs};
use num_complex::Complex;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Largest change of any phase between neighbouring rings of elevation, radians: no more than 0.5 to the nearest.
pub(super) const RING_STEP: f64 = 1.0;

/// Above this many samples noise alone would be sampled as badly as rough sines are.
const ROUGH_SAMPLES: usize = 4_096;

/// FFTs and buffers of one precision.
pub(super) struct Sampler<T: Real> {
    ffts: Ffts<T>,
    columns: [Vec<T>; 5],
    directions: Vec<[T; 3]>,
    rows: Vec<Complex<T>>,
    work: ResampleWork<T>,
    /// Whether sums are split over the threads of the current rayon pool; they are the same numbers.
    pub parallel: bool,
}

/// A sampled profile.
#[derive(Default)]
pub(super) struct Sampled {
    /// Its rows, those below the horizon among them.
    pub rows: usize,
    /// Directions that were summed, antipodes among them.
    pub summed: usize,
    /// Its local maxima.
    pub maxima: Vec<Maximum>,
}

impl Sampled {
    /// Place in its row and value of the highest sample; (0, 0) if there is none.
    pub fn highest(&self) -> (usize, f64) {
        let highest = self.maxima.iter().max_by(|a, b| a.value().total_cmp(&b.value()));
        highest.map_or((0, 0.0), |maximum| (maximum.column, maximum.value()))
    }

    /// Multiplies the samples: scenes are scaled each by a power of two.
    pub fn scale(&mut self, by: f64) {
        self.maxima.iter_mut().flat_map(|maximum| &mut maximum.around).for_each(|value| *value *= by);
    }
}

/// Elevations from 0 to `limit` whose phases differ by at most [`RING_STEP`] from one to the next.
pub(super) fn elevation_rings(scene: &Scene, limit: f64) -> Vec<f64> {
    let (radius, height) = (scene.radius, scene.half_height);
    let change = TAU * (radius * (1.0 - limit.cos()) + height * limit.sin());
    let steps = (change / RING_STEP).ceil().max(1.0);
    // r (1 - cos e) + h sin e = c: with w = hypot(r, h) and p = atan2(h, r), e = acos((r - c) / w) - p.
    let (width, phase) = (radius.hypot(height), height.atan2(radius));
    let elevation = |part: f64| (((radius - part / TAU) / width).clamp(-1.0, 1.0).acos() - phase).clamp(0.0, limit);
    let ring = |i: usize| if i == 0 { 0.0 } else { elevation(change * i as f64 / steps) };
    (0..steps as usize).map(ring).chain([limit]).collect()
}

impl Scene {
    /// The sines that a search of these samples needs: errors count against the highest peak of noise.
    pub(super) fn sines(&self) -> Sines {
        if self.len() <= ROUGH_SAMPLES { Sines::Rough } else { Sines::Fine }
    }
}

/// Into how many parts the cosine of the elevation is cut: each has a band limit.
const PARTS: usize = 4;
/// Directions that are summed before their rings are interpolated: what fits a core's own memory.
const AT_ONCE: usize = 2_048;
/// Directions that one thread sums at a time.
const SPLIT: usize = 512;

/// How rings are sampled.
#[derive(Clone, Copy)]
pub(super) struct Rings {
    /// Azimuths that are summed on rings whose elevation's cosine is at most 1/4, 1/2, 3/4 and 1.
    evaluated: [usize; PARTS],
    /// Azimuths that are interpolated from them.
    pub dense: usize,
    /// Level motion: the antipode of a direction is on its ring.
    flat: bool,
}

impl Rings {
    /// Of a motion whose ring on the horizon needs modes up to `order`, for elevations up to `highest`; the modes of a share of
    /// the radius are asked for by `order_of`, where rings are as high.
    pub fn new(order: usize, dense: usize, flat: bool, highest: f64, order_of: impl Fn(f64) -> usize) -> Self {
        let size = |k: usize| match (k + 1) as f64 / PARTS as f64 {
            share if share < 1.0 && highest.cos() <= share => Self::summed(order_of(share).min(order)),
            _ => Self::summed(order),
        };
        Self { evaluated: std::array::from_fn(size), dense, flat }
    }

    /// The azimuths that hold the modes up to `order`.
    pub fn summed(order: usize) -> usize {
        near_size(2 * order + 2, 2)
    }

    fn evaluated(&self, elevation: f64) -> usize {
        let part = (PARTS as f64 * elevation.cos()).ceil() as usize;
        self.evaluated[part.clamp(1, PARTS) - 1]
    }

    /// Whether the antipodes of half a ring are its other half; those of any other ring are the ring below the horizon.
    fn is_whole(&self, elevation: f64) -> bool {
        self.flat || elevation == 0.0
    }

    /// Directions to be summed at an elevation.
    fn columns(&self, elevation: f64) -> usize {
        let evaluated = self.evaluated(elevation);
        if self.is_whole(elevation) { evaluated / 2 } else { evaluated }
    }

    /// `elevations` from the front that are sampled as the first of them is, no more than are taken at once.
    fn alike(&self, elevations: &[f64]) -> usize {
        let Some(first) = elevations.first() else { return 0 };
        let evaluated = self.evaluated(*first);
        let most = (AT_ONCE / evaluated).max(1);
        elevations.iter().take(most).take_while(|e| self.evaluated(**e) == evaluated).count()
    }
}

impl<T: Real> Sampler<T> {
    pub fn new(tier: Tier) -> Self {
        let (columns, work) = (Default::default(), ResampleWork::default());
        Self { ffts: Ffts::new(tier), columns, directions: Vec::new(), rows: Vec::new(), work, parallel: false }
    }

    /// `F` on rings at the given elevations (from 0 upwards) and, unless the motion is level, at their negatives.
    pub fn sample(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], rings: &Rings) -> Sampled {
        let c = scene.columns();
        for (column, from) in self.columns.iter_mut().zip([c.x, c.y, c.z, c.re, c.im]) {
            column.clear();
            column.extend(from.iter().map(|v| T::of(*v)));
        }
        let mut sides = Sides::default();
        let mut rest = elevations;
        while !rest.is_empty() {
            let (group, tail) = rest.split_at(rings.alike(rest));
            rest = tail;
            self.sum(tier, scene, group, rings);
            let mut dense = self.work.dense.chunks_exact(rings.dense);
            for &elevation in group {
                let evaluated = rings.evaluated(elevation);
                if !rings.is_whole(elevation) {
                    sides.below(dense.next().unwrap_or_default(), elevation, evaluated);
                }
                sides.above(dense.next().unwrap_or_default(), elevation, evaluated);
            }
        }
        sides.end()
    }

    /// Fills `work.dense` with the rows of `elevations`, which are summed alike: before each comes the one below the horizon,
    /// if it has one.
    fn sum(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], rings: &Rings) {
        let evaluated = elevations.first().map_or(0, |first| rings.evaluated(*first));
        let angle = |j: usize| (TAU * j as f64 / evaluated as f64).sin_cos();
        let circle: Vec<(f64, f64)> = (0..evaluated).map(angle).collect();
        self.directions.clear();
        for &elevation in elevations {
            let (sin_el, cos_el) = elevation.sin_cos();
            let turned = |(sin, cos): &(f64, f64)| [cos_el * cos, cos_el * sin, sin_el].map(T::of);
            self.directions.extend(circle[..rings.columns(elevation)].iter().map(turned));
        }
        let [x, y, z, re, im] = &self.columns;
        let columns = Columns { x, y, z, re, im };
        let of = |directions: &[[T; 3]]| pairs::<T>(tier.level_or_portable(), columns, directions, scene.sines());
        let sums = match self.parallel {
            true => self.directions.par_chunks(SPLIT).map(of).collect::<Vec<_>>().concat(),
            false => of(&self.directions),
        };
        self.rows.clear();
        let mut rest = sums.as_slice();
        for &elevation in elevations {
            let (row, tail) = rest.split_at(rings.columns(elevation));
            rest = tail;
            self.arrange(row, rings.is_whole(elevation));
        }
        Resample::new(evaluated, rings.dense, &mut self.ffts).run(&self.rows, &mut self.work);
    }

    /// Rows from the sums of antipodal pairs: the antipode of (a, e) is (a + pi, -e).
    fn arrange(&mut self, row: &[PairSum], is_whole: bool) {
        let narrow = |c: num_complex::Complex64| Complex::new(T::of(c.re), T::of(c.im));
        let here = row.iter().map(|s| narrow(s.here()));
        if is_whole {
            self.rows.extend(here.chain(row.iter().map(|s| narrow(s.opposite()))));
        } else {
            let (first, second) = row.split_at(row.len() / 2);
            self.rows.extend(second.iter().chain(first).map(|s| narrow(s.opposite())).chain(here));
        }
    }
}

/// Both sides of the horizon, as their rows come: of each elevation the one below first.
#[derive(Default)]
struct Sides {
    up: Side,
    down: Option<Side>,
    row: Vec<f64>,
    sampled: Sampled,
}

impl Sides {
    /// Takes the sums of a row.
    fn take<T: Real>(&mut self, row: &[Complex<T>], evaluated: usize) {
        self.row.clear();
        self.row.extend(row.iter().map(|f| -> f64 { f.norm_sqr().into() }));
        self.sampled.rows += 1;
        self.sampled.summed += evaluated;
    }

    fn above<T: Real>(&mut self, row: &[Complex<T>], elevation: f64, evaluated: usize) {
        self.take(row, evaluated);
        self.up.push(&self.row, elevation, &mut self.sampled.maxima);
    }

    fn below<T: Real>(&mut self, row: &[Complex<T>], elevation: f64, evaluated: usize) {
        self.take(row, evaluated);
        // The first of them is a neighbour of the horizon, which is the last row above as yet.
        let down = self.down.get_or_insert_with(|| self.up.met_by(&self.row));
        down.push(&self.row, -elevation, &mut self.sampled.maxima);
    }

    fn end(mut self) -> Sampled {
        for side in std::iter::once(&mut self.up).chain(&mut self.down) {
            side.end(&mut self.sampled.maxima);
        }
        self.sampled
    }
}

/// A sample that none of its eight neighbours exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Maximum {
    /// Elevation of its row, radians.
    pub elevation: f64,
    /// Its place in the row.
    column: usize,
    /// The sample before it on its row, itself, and the one after it.
    around: [f64; 3],
}

impl Maximum {
    pub fn value(&self) -> f64 {
        self.around[1]
    }

    /// Where it is in its row, in steps: the vertex of the parabola through the logarithms of the three samples.
    pub fn vertex(&self) -> f64 {
        let [before, here, after] = self.around.map(|value| value.max(f64::MIN_POSITIVE).ln());
        let bend = before - 2.0 * here + after;
        let offset = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        self.column as f64 + offset
    }
}

/// The rows on one side of the horizon, from the horizon outwards: each is searched once the next one is there. Three rows are kept,
/// and never all of them.
#[derive(Default)]
struct Side {
    /// The row before the last one, and the last one; empty if there is none.
    before: Vec<f64>,
    last: Vec<f64>,
    elevation: f64,
    /// The last row is searched by another side.
    only_beside: bool,
    /// Which samples of a row may be maxima of it.
    high: Vec<bool>,
}

impl Side {
    /// The other side of a horizon that is the only row as yet; `row` is the first one there. The horizon is searched by this
    /// side alone.
    fn met_by(&mut self, row: &[f64]) -> Self {
        self.before = row.to_vec();
        Self { last: self.last.clone(), only_beside: true, ..Self::default() }
    }

    /// Takes the next row.
    fn push(&mut self, row: &[f64], elevation: f64, maxima: &mut Vec<Maximum>) {
        self.search(row, maxima);
        std::mem::swap(&mut self.before, &mut self.last);
        self.last.clear();
        self.last.extend_from_slice(row);
        (self.elevation, self.only_beside) = (elevation, false);
    }

    /// Searches the last row, after which there is none.
    fn end(&mut self, maxima: &mut Vec<Maximum>) {
        self.search(&[], maxima);
    }

    fn search(&mut self, next: &[f64], maxima: &mut Vec<Maximum>) {
        let ring = self.last.len();
        if self.only_beside || ring == 0 {
            return;
        }
        let row = &self.last;
        // Most are below a neighbour on their own ring: said of all in a plain loop, which is vector code.
        self.high.clear();
        self.high.resize(ring, false);
        for (high, around) in self.high[1..].iter_mut().zip(row.windows(3)) {
            *high = (around[1] >= around[0]) & (around[1] >= around[2]);
        }
        (self.high[0], self.high[ring - 1]) = (true, true);
        for (column, _) in self.high.iter().enumerate().filter(|(_, high)| **high) {
            let (before, after) =
                (if column == 0 { ring - 1 } else { column - 1 }, if column + 1 == ring { 0 } else { column + 1 });
            let around = [row[before], row[column], row[after]];
            let value = around[1];
            let below = |row: &[f64]| row.is_empty() || [before, column, after].iter().all(|c| row[*c] <= value);
            if around[0] <= value && around[2] <= value && below(&self.before) && below(next) {
                maxima.push(Maximum { elevation: self.elevation, column, around });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of ascending elevation, `rows[half]` the horizon.
    fn found(rows: &[Vec<f64>]) -> Vec<Maximum> {
        let half = rows.len() / 2;
        let mut maxima = Vec::new();
        let mut up = Side::default();
        up.push(&rows[half], 0.0, &mut maxima);
        if half > 0 {
            let mut down = up.met_by(&rows[half - 1]);
            for k in 1..=half {
                down.push(&rows[half - k], -(k as f64), &mut maxima);
                up.push(&rows[half + k], k as f64, &mut maxima);
            }
            down.end(&mut maxima);
        }
        up.end(&mut maxima);
        maxima
    }

    #[test]
    fn the_maxima_are_those_that_no_neighbour_exceeds() {
        let mut state = 9u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64
        };
        for half in [0, 1, 2, 7] {
            let (n, ring) = (2 * half + 1, 11);
            let rows: Vec<Vec<f64>> = (0..n).map(|_| (0..ring).map(|_| random()).collect()).collect();
            let mut expected = Vec::new();
            for (r, own) in rows.iter().enumerate() {
                for (column, value) in own.iter().enumerate() {
                    let near = |row: &Vec<f64>| [ring - 1, 0, 1].map(|d| row[(column + d) % ring]);
                    let around = near(own);
                    let beside = rows[r.saturating_sub(1)..(r + 2).min(n)].iter().flat_map(near);
                    if beside.fold(0.0, f64::max) <= *value {
                        expected.push((r as f64 - half as f64, column, around));
                    }
                }
            }
            let mut got: Vec<_> = found(&rows).iter().map(|m| (m.elevation, m.column, m.around)).collect();
            got.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert!(!expected.is_empty());
            assert_eq!(got, expected, "{half}");
        }
    }
}
