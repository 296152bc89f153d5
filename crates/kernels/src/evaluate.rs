//! Computes the values on rings or at listed directions: directly, by a planar NUFFT, or slab by slab.

use std::f64::consts::{PI, TAU};

use fearless_simd::Level;
use num_complex::Complex;

use crate::nufft::{Axis, CARRY, Cone, Kernel, Nufft, Setting, Targets, Work};
use crate::simd::Real;
use crate::sums::{Columns, Sines, pairs};

/// Samples as an evaluation takes them: positions in turns about the middle, along the axes of the plan.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Along the first axis, turns.
    pub x: Vec<f64>,
    /// Along the second axis, turns.
    pub y: Vec<f64>,
    /// Along the third axis, turns; empty for a plane.
    pub z: Vec<f64>,
    /// Real parts of the weighted samples.
    pub re: Vec<f64>,
    /// Imaginary parts.
    pub im: Vec<f64>,
}

/// Where values are wanted.
pub enum Places {
    /// `d` azimuths from -pi on rings at elevations (at least 0); with `tall` also at their negatives.
    Rings {
        /// Azimuths of a ring.
        d: usize,
        /// Elevations, radians, at least 0.
        nodes: Vec<f64>,
        /// Also at the negatives of the elevations.
        tall: bool,
    },
    /// Unit vectors in the axes of the plan.
    List(Vec<[f64; 3]>),
}

/// A planned evaluation.
pub enum Evaluator<T: Real> {
    /// Direct sums.
    Direct {
        /// The SIMD tier.
        level: Level,
        /// Unit vectors.
        directions: Vec<[T; 3]>,
        /// The corresponding places.
        places: Places,
    },
    /// A non-uniform transform in the plane of motion.
    Planar {
        /// The transform.
        nufft: Nufft<T>,
        /// Where it is interpolated.
        targets: Targets<T>,
        /// The corresponding places.
        places: Places,
    },
    /// One planar transform for each of several heights, joined by interpolation.
    Slab(Slab<T>),
    /// Motion along a line: a one-dimensional transform.
    Cone(Cone<T>),
}

/// Buffers of an evaluation.
#[derive(Clone, Default)]
pub struct Buffers<T> {
    pub(crate) cells: Vec<Complex<T>>,
    carried: Vec<Complex<f64>>,
    pub(crate) work: Work<T>,
    found: Vec<Complex<T>>,
    pub(crate) column: [Vec<T>; 5],
    /// The values: `[node][above, (tall) below][d]`, or one per listed direction.
    pub values: Vec<Complex<T>>,
}

impl Places {
    /// Number of places.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        match self {
            Self::Rings { d, nodes, tall } => d * nodes.len() * if *tall { 2 } else { 1 },
            Self::List(list) => list.len(),
        }
    }

    /// Plans the places for a planar transform with direction cosines scaled by `scale` (at most 1).
    pub fn targets<T: Real>(&self, nufft: &Nufft<T>, scale: f64) -> Targets<T> {
        match self {
            Self::Rings { d, nodes, .. } => nufft.quads(quarter(*d, nodes).map(|u| u.map(|c| c * scale))),
            Self::List(list) => nufft.targets(list.iter().map(|u| [u[0] * scale, u[1] * scale])),
        }
    }

    /// Copies an interpolation's results into `values`.
    pub fn sort<T: Real>(&self, found: &mut Vec<Complex<T>>, values: &mut Vec<Complex<T>>) {
        match self {
            Self::List(_) => std::mem::swap(values, found),
            Self::Rings { d, .. } => {
                values.resize(self.len(), Complex::new(T::of(0.0), T::of(0.0)));
                let per_ring = 4 * (d / 4 + 1);
                for (ring, found) in values.chunks_exact_mut(*d).zip(found.chunks_exact(per_ring)) {
                    for (q, four) in found.chunks_exact(4).enumerate() {
                        for (to, value) in quarter_places(q, *d).into_iter().zip(four) {
                            ring[to] = *value;
                        }
                    }
                }
            }
        }
    }

    /// Directions that a direct sum of antipodal pairs needs.
    fn direct<T: Real>(&self) -> Vec<[T; 3]> {
        match self {
            Self::Rings { d, nodes, tall } => nodes
                .iter()
                .flat_map(|&e| (0..if *tall { *d } else { d / 2 }).map(move |j| ring_direction(j, *d, e).map(T::of)))
                .collect(),
            Self::List(list) => list.iter().map(|u| u.map(T::of)).collect(),
        }
    }
}

/// Direction `j` of `d` on the ring at `elevation`, azimuths from -pi.
fn ring_direction(j: usize, d: usize, elevation: f64) -> [f64; 3] {
    let (sin, cos) = (TAU * j as f64 / d as f64 - PI).sin_cos();
    let (sin_el, cos_el) = elevation.sin_cos();
    [cos_el * cos, cos_el * sin, sin_el]
}

/// Quadruples of a quarter ring, and the place of each of the four.
fn quarter(d: usize, nodes: &[f64]) -> impl Iterator<Item = [f64; 2]> + '_ {
    nodes.iter().flat_map(move |&e| {
        (0..=d / 4).map(move |q| {
            let [x, y, _] = ring_direction(q, d, e);
            [x, y]
        })
    })
}

/// Azimuth indices of quadruple `q`: `(x, y)`, `(-x, y)`, `(x, -y)`, `(-x, -y)`.
fn quarter_places(q: usize, d: usize) -> [usize; 4] {
    [q, d / 2 - q, (d - q) % d, (d / 2 + q) % d]
}

impl<T: Real> Evaluator<T> {
    /// Direct sums at every place.
    pub fn direct(level: Level, places: Places) -> Self {
        Self::Direct { level, directions: places.direct(), places }
    }

    /// A transform in the plane of motion.
    pub fn planar(nufft: Nufft<T>, places: Places) -> Self {
        let targets = places.targets(&nufft, 1.0);
        Self::Planar { nufft, targets, places }
    }

    /// Memory of the plan, bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Direct { directions, .. } => size_of_val(&directions[..]),
            Self::Planar { targets, .. } => targets.bytes(),
            Self::Slab(slab) => slab.targets.bytes(),
            Self::Cone(cone) => cone.bytes(),
        }
    }

    /// Computes `buffers.values`.
    pub fn run(&self, batch: &Batch, buffers: &mut Buffers<T>) {
        T::run(self, batch, buffers);
    }

    pub(crate) fn run_of(&self, batch: &Batch, buffers: &mut Buffers<T>) {
        match self {
            Self::Direct { level, directions, places } => direct(*level, directions, places, batch, buffers),
            Self::Planar { nufft, .. } => {
                spread_all(nufft, batch, buffers);
                self.finish(buffers);
            }
            Self::Slab(slab) => slab.run(batch, buffers),
            Self::Cone(cone) => cone.run(batch, buffers),
        }
    }

    /// The planar transform of `buffers.cells` at all places.
    pub fn finish(&self, buffers: &mut Buffers<T>) {
        let Self::Planar { nufft, targets, places } = self else { return };
        nufft.transform(&buffers.cells, &mut buffers.work);
        nufft.interpolate(&buffers.work.plane, targets, &mut buffers.found);
        places.sort(&mut buffers.found, &mut buffers.values);
    }
}

fn fill<T: Real>(column: &mut Vec<T>, from: &[f64]) {
    column.clear();
    column.extend(from.iter().map(|v| T::of(*v)));
}

fn direct<T: Real>(level: Level, directions: &[[T; 3]], places: &Places, batch: &Batch, buffers: &mut Buffers<T>) {
    let [x, y, z, re, im] = &mut buffers.column;
    for (column, from) in [(&mut *x, &batch.x), (y, &batch.y), (z, &batch.z), (re, &batch.re), (im, &batch.im)] {
        fill(column, from);
    }
    let [x, y, z, re, im] = &buffers.column;
    let sums = pairs::<T>(level, Columns { x, y, z, re, im }, directions, Sines::Fine);
    let narrow = |c: num_complex::Complex64| Complex::new(T::of(c.re), T::of(c.im));
    buffers.values.clear();
    match places {
        Places::List(_) => buffers.values.extend(sums.iter().map(|s| narrow(s.here()))),
        Places::Rings { d, tall: false, .. } => {
            for ring in sums.chunks_exact(d / 2) {
                buffers.values.extend(ring.iter().map(|s| narrow(s.here())));
                buffers.values.extend(ring.iter().map(|s| narrow(s.opposite())));
            }
        }
        Places::Rings { d, tall: true, .. } => {
            for ring in sums.chunks_exact(*d) {
                buffers.values.extend(ring.iter().map(|s| narrow(s.here())));
                // The antipode of (a, e) is (a + pi, -e).
                let opposite = (0..*d).map(|j| narrow(ring[(j + d / 2) % d].opposite()));
                buffers.values.extend(opposite);
            }
        }
    }
}

/// Spreads a batch; adds long single-precision batches to double block by block.
fn spread_all<T: Real>(nufft: &Nufft<T>, batch: &Batch, buffers: &mut Buffers<T>) {
    let zero = Complex::new(T::of(0.0), T::of(0.0));
    let [_, _, _, re, im] = &mut buffers.column;
    fill(re, &batch.re);
    fill(im, &batch.im);
    let n = batch.re.len();
    buffers.cells.clear();
    buffers.cells.resize(nufft.cells(), zero);
    let one_block = n <= CARRY || size_of::<T>() == 8;
    if !one_block {
        buffers.carried.clear();
        buffers.carried.resize(nufft.cells(), Complex::new(0.0, 0.0));
    }
    for from in (0..n).step_by(if one_block { n.max(1) } else { CARRY }) {
        let to = if one_block { n } else { (from + CARRY).min(n) };
        nufft.spread([&batch.x[from..to], &batch.y[from..to]], &re[from..to], &im[from..to], &mut buffers.cells);
        if !one_block {
            carry(&mut buffers.cells, &mut buffers.carried);
        }
    }
    if !one_block {
        narrow(&buffers.carried, &mut buffers.cells);
    }
}

/// Moves the content of `cells` to the double-precision `carried`.
pub fn carry<T: Real>(cells: &mut [Complex<T>], carried: &mut [Complex<f64>]) {
    for (cell, sum) in cells.iter_mut().zip(carried) {
        *sum += Complex::new(cell.re.into(), cell.im.into());
        *cell = Complex::new(T::of(0.0), T::of(0.0));
    }
}

/// Rounds `carried` into `cells`.
pub fn narrow<T: Real>(carried: &[Complex<f64>], cells: &mut [Complex<T>]) {
    for (cell, sum) in cells.iter_mut().zip(carried) {
        *cell = Complex::new(T::of(sum.re), T::of(sum.im));
    }
}

/// Motion in three dimensions, or nearly in a plane. The same kernel in z spreads samples onto a few planes, each with a
/// planar transform; along z there is no FFT: each ring of one elevation sums its planes, one phase each.
pub struct Slab<T: Real> {
    nufft: Nufft<T>,
    kernel: Kernel,
    z: Axis,
    targets: Targets<T>,
    places: Places,
    /// Per plane, per ring or listed direction: the phase, with the kernel's correction.
    phases: Vec<Complex<T>>,
}

impl<T: Real> Slab<T> {
    /// For samples within `height` turns of the middle, and directions with `|sin(elevation)| <= steepest`.
    pub fn new(nufft: Nufft<T>, height: f64, steepest: f64, setting: Setting, places: Places) -> Self {
        let kernel = Kernel::new(setting.width, setting.oversampling);
        let mut z = Axis::new(height * steepest, setting);
        // Cells per turn for cosines up to `steepest` instead of 1.
        z.per_turn *= steepest;
        let heights: Vec<f64> = match &places {
            Places::Rings { nodes, .. } => nodes.iter().map(|e| e.sin()).collect(),
            Places::List(list) => list.iter().map(|u| u[2]).collect(),
        };
        let targets = places.targets(&nufft, 1.0);
        let mut phases = Vec::with_capacity(heights.len() * (2 * z.half + 1));
        for plane in 0..=2 * z.half {
            let at = (plane as f64 - z.half as f64) / z.per_turn;
            for &u in &heights {
                let (sin, cos) = (TAU * (at * u)).sin_cos();
                let undo = 1.0 / kernel.transform(u / z.per_turn);
                phases.push(Complex::new(T::of(cos * undo), T::of(-sin * undo)));
            }
        }
        Self { nufft, kernel, z, targets, places, phases }
    }

    /// Planes for a height and a setting.
    pub fn planes(height: f64, steepest: f64, setting: Setting) -> usize {
        2 * Axis::new(height * steepest, setting).half + 1
    }

    fn run(&self, batch: &Batch, buffers: &mut Buffers<T>) {
        let zero = Complex::new(T::of(0.0), T::of(0.0));
        let planes = 2 * self.z.half + 1;
        let order = self.by_plane(batch);
        buffers.values.clear();
        buffers.values.resize(self.places.len(), zero);
        let per_plane = self.phases.len() / planes;
        let mut layer = Batch::default();
        for plane in 0..planes {
            self.layer(batch, &order, plane, &mut layer);
            if layer.re.is_empty() {
                continue;
            }
            spread_all(&self.nufft, &layer, buffers);
            self.nufft.transform(&buffers.cells, &mut buffers.work);
            self.nufft.interpolate(&buffers.work.plane, &self.targets, &mut buffers.found);
            let phases = &self.phases[plane * per_plane..(plane + 1) * per_plane];
            self.add(phases, &buffers.found, &mut buffers.values);
        }
    }

    /// Samples in the order of the first plane that they touch: (plane, sample, offset).
    fn by_plane(&self, batch: &Batch) -> Vec<(usize, usize, f64)> {
        let middle = (self.kernel.width as f64 - 1.0) / 2.0;
        let mut order: Vec<_> = batch
            .z
            .iter()
            .enumerate()
            .map(|(t, z)| {
                let x = z * self.z.per_turn;
                let first = (x - middle).round_ties_even();
                ((first + self.z.half as f64) as usize, t, x - first - middle)
            })
            .collect();
        order.sort_unstable_by_key(|o| o.0);
        order
    }

    /// The samples that touch `plane`, with their weights there.
    fn layer(&self, batch: &Batch, order: &[(usize, usize, f64)], plane: usize, layer: &mut Batch) {
        let width = self.kernel.width;
        for column in [&mut layer.x, &mut layer.y, &mut layer.re, &mut layer.im] {
            column.clear();
        }
        let from = order.partition_point(|o| o.0 + width <= plane);
        let to = order.partition_point(|o| o.0 <= plane);
        for &(first, t, s) in &order[from..to] {
            let weight = self.nufft.weight(plane - first, s);
            layer.x.push(batch.x[t]);
            layer.y.push(batch.y[t]);
            layer.re.push(batch.re[t] * weight);
            layer.im.push(batch.im[t] * weight);
        }
    }

    /// Adds one plane's values with their phases.
    fn add(&self, phases: &[Complex<T>], found: &[Complex<T>], values: &mut [Complex<T>]) {
        match &self.places {
            Places::List(_) => {
                for ((value, v), phase) in values.iter_mut().zip(found).zip(phases) {
                    *value += v * phase;
                }
            }
            Places::Rings { d, tall, .. } => {
                let rings = values.chunks_exact_mut(if *tall { 2 * d } else { *d });
                for ((ring, found), phase) in rings.zip(found.chunks_exact(4 * (d / 4 + 1))).zip(phases) {
                    let (above, below) = ring.split_at_mut(*d);
                    for (q, four) in found.chunks_exact(4).enumerate() {
                        // On the axes, two of the four directions coincide.
                        let count = if q == 0 || 4 * q == *d { 2 } else { 4 };
                        let pick = if q == 0 {
                            [0, 1, 0, 0]
                        } else if 4 * q == *d {
                            [0, 2, 0, 0]
                        } else {
                            [0, 1, 2, 3]
                        };
                        for &p in &pick[..count] {
                            let to = quarter_places(q, *d)[p];
                            above[to] += four[p] * phase;
                            if *tall {
                                below[to] += four[p] * phase.conj();
                            }
                        }
                    }
                }
            }
        }
    }
}
