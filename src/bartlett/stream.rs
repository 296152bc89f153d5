//! A stream of packets: added one by one, queried at any time; sliding windows as a ring of blocks.
//!
//! The spread grid of a planar NUFFT is linear in the samples, so a packet only adds to it and a profile of the packets
//! so far is one transform. Nothing is ever subtracted: a window drops whole blocks.

use std::collections::VecDeque;

use nalgebra::Vector3;
use num_complex::{Complex, Complex64};

use super::bessel::tail_order;
use super::error::Error;
use super::evaluate::{Buffers, Evaluator, Places, carry, narrow};
use super::fft::Ffts;
use super::front::exponent_above;
use super::grid::{Grid, Layout};
use super::nufft::{CARRY, Nufft, Setting};
use super::rings::{RingWork, Rings};
use super::scene::ldexp;
use super::simd::Tier;

/// Packets that are spread together.
const PENDING: usize = 256;
/// Blocks of a sliding window.
const BLOCKS: usize = 8;
/// Samples may be this much larger than the first.
const HEADROOM: f64 = (1u64 << 40) as f64;

/// What a stream is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamOptions {
    /// Wavelength, metres.
    pub wavelength_m: f64,
    /// How often a sample holds the path ([`crate::signal::samples::Coherent`]).
    pub path_gain: u8,
    /// Middle of the area that the robot will move in, metres.
    pub middle_m: Vector3<f64>,
    /// How far from the middle it may go in x and y, metres.
    pub reach_m: f64,
    /// Packets of a sliding window; none: all of them. The window moves by an eighth of its length.
    pub window: Option<usize>,
    /// The guarantee of a query, at least 1e-5: `|f~ - f| <= eps * sum |z|`.
    pub eps: f64,
    /// SIMD tier.
    pub tier: Tier,
}

/// Packets on a plane, and the profile of them.
pub struct Stream {
    options: StreamOptions,
    turn_m: f64,
    per_metre: f64,
    /// Turns.
    reach: f64,
    evaluator: Evaluator<f32>,
    rings: Rings<f32>,
    grid: Grid,
    pending: Pending,
    /// Power of two that samples are multiplied by, from the first that is not zero; the power in two factors.
    exponent: Option<i32>,
    factors: [f64; 2],
    open: Block,
    /// Packets in `open.cells`.
    in_cells: usize,
    closed: VecDeque<Block>,
    buffers: Buffers<f32>,
    work: RingWork<f32>,
}

#[derive(Default)]
struct Pending {
    x: Vec<f64>,
    y: Vec<f64>,
    re: Vec<f32>,
    im: Vec<f32>,
}

/// A piece of the window.
#[derive(Default)]
struct Block {
    cells: Vec<Complex<f32>>,
    /// What [`CARRY`] packets after another left in the cells; empty while there were fewer.
    carried: Vec<Complex64>,
    packets: usize,
    sum_abs: f64,
}

impl Block {
    /// Empty, in the memory of an old one.
    fn renewed(mut self, cells: usize) -> Self {
        self.cells.clear();
        self.cells.resize(cells, Complex::new(0.0, 0.0));
        self.carried.clear();
        Self { packets: 0, sum_abs: 0.0, ..self }
    }

    /// Moves what is in the cells to double precision.
    fn carry(&mut self) {
        self.carried.resize(self.cells.len(), Complex64::ZERO);
        carry(&mut self.cells, &mut self.carried);
    }
}

impl Stream {
    /// A stream whose queries fill `grid`: a grid of rings, its number of azimuths a multiple of 4.
    ///
    /// # Errors
    /// [`Error`] for a wavelength, a path gain or a reach that are none, a tolerance below 1e-5
    /// ([`Error::Tolerance`]), or a grid without such rings ([`Error::Direction`]).
    pub fn new(options: StreamOptions, grid: &Grid) -> Result<Self, Error> {
        let StreamOptions { wavelength_m, reach_m, eps, .. } = options;
        for length_m in [wavelength_m, reach_m] {
            if !(length_m.is_finite() && length_m > 0.0) {
                return Err(Error::Wavelength { wavelength_m: length_m });
            }
        }
        if options.path_gain == 0 {
            return Err(Error::PathGain);
        }
        let setting = Setting::for_eps(eps / 4.0, true).filter(|_| eps >= 1e-5).ok_or(Error::Tolerance { eps })?;
        let Layout::Rings { azimuths, elevations_rad } = &*grid.layout else {
            return Err(Error::Direction { index: 0 });
        };
        if azimuths % 4 != 0 {
            return Err(Error::Direction { index: *azimuths });
        }
        let turn_m = wavelength_m / f64::from(options.path_gain);
        let reach = reach_m / turn_m;
        let order = tail_order(std::f64::consts::TAU * reach, eps / 8.0);
        let mut ffts = Ffts::new(options.tier);
        let level = options.tier.level_or_portable();
        let rings = Rings::new(*azimuths, elevations_rad, [order; 2], false, level, &mut ffts);
        let places = Places::Rings { d: rings.d, nodes: rings.nodes.clone(), tall: false };
        let nufft = Nufft::new([reach; 2], setting, &mut ffts);
        let cells = nufft.cells();
        Ok(Self {
            options,
            turn_m,
            per_metre: 1.0 / turn_m,
            reach,
            evaluator: Evaluator::planar(nufft, places),
            rings,
            grid: grid.clone(),
            pending: Pending::default(),
            exponent: None,
            factors: [1.0; 2],
            open: Block::default().renewed(cells),
            in_cells: 0,
            closed: VecDeque::new(),
            buffers: Buffers::default(),
            work: RingWork::default(),
        })
    }

    /// Adds a packet at a position (receiver less transmitter displacement, metres).
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a NaN or an infinity (`index` is the number of packets so far), [`Error::Aperture`]
    /// outside the reach, [`Error::Weight`] for a sample 2^40 times the first. The stream is as before.
    pub fn push(&mut self, z: Complex64, position_m: Vector3<f64>) -> Result<(), Error> {
        let p = (position_m - self.options.middle_m) * self.per_metre;
        if !(z.re.is_finite() && z.im.is_finite()) {
            return Err(Error::NonFinite { what: "sample", index: self.len() });
        }
        if !(p.x.is_finite() && p.y.is_finite()) {
            return Err(Error::NonFinite { what: "position", index: self.len() });
        }
        let limit_m = self.options.reach_m;
        if p.x * p.x + p.y * p.y > self.reach * self.reach {
            return Err(Error::Aperture { extent_m: p.x.hypot(p.y) * self.turn_m, limit_m });
        }
        let size = z.re.abs().max(z.im.abs());
        if size == 0.0 {
            self.open.packets += 1;
            return Ok(());
        }
        if self.exponent.is_none() {
            let exponent = -exponent_above(size);
            self.exponent = Some(exponent);
            self.factors = [exponent / 2, exponent - exponent / 2].map(|half| 2f64.powi(half));
        }
        let [a, b] = self.factors;
        let (re, im) = (z.re * a * b, z.im * a * b);
        if re.abs().max(im.abs()) > HEADROOM {
            return Err(Error::Weight { index: self.len(), weight: size });
        }
        self.open.packets += 1;
        self.open.sum_abs += (re * re + im * im).sqrt();
        self.pending.x.push(p.x);
        self.pending.y.push(p.y);
        self.pending.re.push(re as f32);
        self.pending.im.push(im as f32);
        if self.pending.x.len() == PENDING {
            self.flush();
        }
        if self.options.window.is_some_and(|w| self.open.packets >= w.div_ceil(BLOCKS)) {
            self.close();
        }
        Ok(())
    }

    /// Packets that a query covers.
    #[must_use]
    pub fn len(&self) -> usize {
        self.open.packets + self.closed.iter().map(|b| b.packets).sum::<usize>()
    }

    /// True before the first packet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Spreads what is pending.
    fn flush(&mut self) {
        let Evaluator::Planar { nufft, .. } = &self.evaluator else { return };
        let Pending { x, y, re, im } = &mut self.pending;
        nufft.spread([x, y], re, im, &mut self.open.cells);
        self.in_cells += x.len();
        x.clear();
        y.clear();
        re.clear();
        im.clear();
        if self.in_cells + PENDING > CARRY {
            self.open.carry();
            self.in_cells = 0;
        }
    }

    /// Ends a block of the window and lets go of the oldest.
    fn close(&mut self) {
        self.flush();
        self.in_cells = 0;
        let oldest = if self.closed.len() == BLOCKS { self.closed.pop_front() } else { None };
        let fresh = oldest.unwrap_or_default().renewed(self.open.cells.len());
        self.closed.push_back(std::mem::replace(&mut self.open, fresh));
    }

    /// The cells of the whole window into `buffers.cells`.
    fn gather(&mut self) {
        let to = &mut self.buffers.cells;
        to.clear();
        to.extend_from_slice(&self.open.cells);
        let blocks = || self.closed.iter().chain([&self.open]);
        if blocks().all(|b| b.carried.is_empty()) {
            for block in &self.closed {
                to.iter_mut().zip(&block.cells).for_each(|(t, c)| *t += c);
            }
            return;
        }
        let mut total = vec![Complex64::ZERO; to.len()];
        for block in blocks() {
            total.iter_mut().zip(&block.carried).for_each(|(t, c)| *t += c);
            let cells = block.cells.iter().map(|c| Complex64::new(c.re.into(), c.im.into()));
            total.iter_mut().zip(cells).for_each(|(t, c)| *t += c);
        }
        narrow(&total, to);
    }

    /// Fills `out` with the profile of the packets in the window, `F / (sum |z|)^2`; returns `sum |z|`.
    ///
    /// # Errors
    /// [`Error::Empty`] before the first packet, [`Error::ZeroEnergy`] if all were zero.
    pub fn query(&mut self, out: &mut Vec<f64>) -> Result<f64, Error> {
        self.flush();
        let count = self.len();
        if count == 0 {
            return Err(Error::Empty);
        }
        let sum_abs = self.open.sum_abs + self.closed.iter().map(|b| b.sum_abs).sum::<f64>();
        if sum_abs == 0.0 {
            return Err(Error::ZeroEnergy { count });
        }
        self.gather();
        self.evaluator.finish(&mut self.buffers);
        out.resize(self.grid.len(), 0.0);
        self.rings.powers(&self.buffers.values, 1.0 / (sum_abs * sum_abs), &mut self.work, out);
        Ok(ldexp(sum_abs, -self.exponent.unwrap_or(0)))
    }
}
