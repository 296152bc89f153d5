//! Fewer samples for a neighbourhood of places: steered to its centre, samples differ little from the next, and runs of
//! them are summed before the places are looked at one by one (\[ulander2003\] in docs/references.md, one level of it).

use super::grid::Axes;
use super::kernel::{powers, steerings};
use super::prepared::{ABREAST, Abreast, PreparedAperture, PreparedView, Window};
use super::search::Search;
use super::types::{Elevations, Place, Precision};
use crate::tuning::TUNING;
use csi5300_kernels::simd::on_tier;
use fearless_simd::Level;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Azimuths of a grid that are looked at together.
const TOGETHER: usize = 8;
/// Runs that are no longer than this times what an aperture's rows are summed over save nothing.
const WORTHWHILE: f64 = 1.5;
/// Cells of azimuth on either side of its start that a climb may go to on the samples of its neighbourhood.
const ABOUT_CELLS: f64 = 2.0;

/// The places that samples are summed for.
struct Neighbourhood {
    centre: Place,
    /// Largest change of a sample's phase, in turns per turn of its distance, from the centre to any place.
    change: f64,
}

/// A grid of places, and the sums that serve them: those of an aperture's positions, whatever its samples are.
pub(super) struct Sectors {
    places: Vec<Place>,
    /// Places of a sector, but for the last of them.
    each: usize,
    /// Where runs of samples begin, and each sector's sums over them; none where that saves too little.
    thinned: Option<(Vec<usize>, Vec<Thinning>)>,
}

/// How the samples of an aperture are summed over runs for one neighbourhood.
struct Thinning {
    /// The places of the sums, without samples.
    thin: PreparedAperture,
    /// What steers each sample to the middle of the neighbourhood, and each sum back from it.
    there: Vec<(f32, f32)>,
    back: Vec<(f32, f32)>,
}

impl Search {
    /// The power of every view of `aperture` on the grid `axes`, roughly: `powers[place * views + view]`.
    pub(super) fn powers_on(&self, aperture: &PreparedAperture, axes: &Axes) -> Vec<f32> {
        self.powers_in(aperture, &self.sectors(aperture, axes))
    }

    /// The same on a grid that was made ready, for this aperture or another one of the same positions and windows.
    pub(super) fn powers_in(&self, aperture: &PreparedAperture, sectors: &Sectors) -> Vec<f32> {
        let Sectors { places, each, thinned } = sectors;
        let Some((runs, thinnings)) = thinned else {
            return powers(self.level(), std::slice::from_ref(aperture), places, Precision::Rough);
        };
        let sectors: Vec<_> = places.chunks(*each).zip(thinnings).collect();
        self.limits
            .each(&sectors, |(places, thinning)| {
                let thin = [aperture.summed(self.level(), thinning, runs)];
                powers(self.level(), &thin, places, Precision::Rough)
            })
            .concat()
    }

    /// The grid `axes` of an aperture, in sectors of some azimuths.
    pub(super) fn sectors(&self, aperture: &PreparedAperture, axes: &Axes) -> Sectors {
        let places: Vec<Place> = axes.places().iter().map(|place| self.at_height(place)).collect();
        let each = TOGETHER * places.len() / axes.azimuths;
        let thinned = match self.limits.elevations {
            Elevations::Expected if axes.azimuths >= 2 * TOGETHER => self.thinnings(aperture, axes),
            _ => None,
        };
        Sectors { places, each, thinned }
    }

    fn thinnings(&self, aperture: &PreparedAperture, axes: &Axes) -> Option<(Vec<usize>, Vec<Thinning>)> {
        let sectors = axes.azimuths.div_ceil(TOGETHER);
        let half_rad = 0.5 * TAU * TOGETHER as f64 / axes.azimuths as f64;
        let about = |sector: usize| {
            let azimuth = TAU * ((sector * TOGETHER) as f64 + 0.5 * (TOGETHER - 1) as f64) / axes.azimuths as f64;
            self.neighbourhood(aperture, azimuth, half_rad)
        };
        let around: Vec<Neighbourhood> = (0..sectors).map(about).collect();
        let runs = around.first().and_then(|own| aperture.runs(own.change))?;
        let centres: Vec<Place> = around.iter().map(|own| own.centre).collect();
        let steering = steerings(self.level(), aperture, &centres);
        let thinning =
            |(centre, there): (&Place, Vec<(f32, f32)>)| aperture.thinning(self.level(), centre, there, &runs);
        let thinnings = centres.iter().zip(steering).map(thinning).collect();
        Some((runs, thinnings))
    }

    /// `apertures` with the samples of a neighbourhood of `start`: some cells of azimuth, every elevation and range.
    pub(super) fn apertures_about(&self, apertures: &[PreparedAperture], start: &Place) -> Vec<PreparedAperture> {
        let half_rad = ABOUT_CELLS * TAU / self.axes.azimuths as f64;
        let about = |aperture: &PreparedAperture| {
            let own = self.neighbourhood(aperture, start.azimuth, half_rad);
            let runs = (self.limits.elevations == Elevations::Expected).then(|| aperture.runs(own.change)).flatten();
            runs.map_or_else(
                || aperture.clone(),
                |runs| {
                    let there = steerings(self.level(), aperture, &[own.centre]).pop().unwrap_or_default();
                    aperture.summed(self.level(), &aperture.thinning(self.level(), &own.centre, there, &runs), &runs)
                },
            )
        };
        apertures.iter().map(about).collect()
    }

    /// The places within `half_rad` of an azimuth, at every elevation and range of the search.
    fn neighbourhood(&self, aperture: &PreparedAperture, azimuth: f64, half_rad: f64) -> Neighbourhood {
        let [_, highest] = self.limits.elevation_span_rad();
        // Between the elevations in the middle of their cosines, and between the ranges in the middle of the curves.
        let centre = Place { azimuth, elevation: (0.5 + 0.5 * highest.cos()).acos(), curve: 0.5 * self.curve_max };
        let [rim, height] = aperture.reach_turns();
        let across = 2.0 * (0.5 * half_rad).sin() + 0.5 * (1.0 - highest.cos());
        let up = if rim > 0.0 { height / rim * highest.sin() } else { 0.0 };
        let bend = 0.5 * self.curve_max * rim * f64::from(aperture.turn_m);
        Neighbourhood { centre: self.at_height(&centre), change: across + up + bend }
    }
}

impl PreparedAperture {
    /// Largest distance from the middle and largest height above or below it, turns.
    fn reach_turns(&self) -> [f64; 2] {
        let largest = |values: &[f32]| values.iter().fold(0f32, |most, v| most.max(v.abs()));
        [f64::from(largest(&self.square)).sqrt(), f64::from(largest(&self.z))]
    }

    /// Where runs of samples begin whose phases change by so much of their distance, and the end of the last; none where
    /// that saves too little. Runs end where windows do.
    fn runs(&self, change: f64) -> Option<Vec<usize>> {
        let reach = (TUNING.aperture.span_turns / change.max(1e-3)).min(2.0);
        if reach < WORTHWHILE * TUNING.aperture.span_turns {
            return None;
        }
        let mut cut = vec![false; self.len() + 1];
        for window in self.views.iter().flat_map(|view| &view.windows) {
            let length = window.columns.first().map_or(0, Vec::len);
            for at in [window.from, window.from + length] {
                if let Some(cut) = cut.get_mut(at) {
                    *cut = true;
                }
            }
        }
        let square = (reach * reach) as f32;
        let (mut runs, mut first) = (vec![0], 0);
        for (t, is_cut) in cut.iter().enumerate().take(self.len()).skip(1) {
            let apart = [self.x[t] - self.x[first], self.y[t] - self.y[first], self.z[t] - self.z[first]];
            if *is_cut || apart.iter().map(|v| v * v).sum::<f32>() > square {
                runs.push(t);
                first = t;
            }
        }
        runs.push(self.len());
        Some(runs)
    }

    /// How samples are summed over `runs`: each steered to `centre` (by `there`) and back from where the mean of its run is.
    fn thinning(&self, level: Level, centre: &Place, there: Vec<(f32, f32)>, runs: &[usize]) -> Thinning {
        let mean = |values: &[f32]| -> Vec<f32> {
            let of = |run: &[usize]| values[run[0]..run[1]].iter().sum::<f32>() / (run[1] - run[0]) as f32;
            runs.windows(2).map(of).collect()
        };
        let (x, y, z) = (mean(&self.x), mean(&self.y), mean(&self.z));
        let square = x.iter().zip(&y).zip(&z).map(|((x, y), z)| x * x + y * y + z * z).collect();
        let thin = Self { x, y, z, square, recorded_m: Vec::new(), views: Arc::new([]), ..*self };
        let back = steerings(level, &thin, &[*centre]).into_iter().flatten().map(|(cos, sin)| (cos, -sin)).collect();
        Thinning { thin, there, back }
    }

    /// The sums over `runs` of the samples.
    fn summed(&self, level: Level, thinning: &Thinning, runs: &[usize]) -> Self {
        let Thinning { thin, there, back } = thinning;
        let window = |window: &Window| {
            let from = runs.partition_point(|at| *at < window.from);
            let length = window.columns.first().map_or(0, Vec::len);
            let within = runs[from..].partition_point(|at| *at < window.from + length);
            let own = Runs { runs: &runs[from..], back: &back[from..][..within], first: window.from };
            let column = |samples: &Vec<Abreast>| on_tier!(level, _simd => own.sums(samples, there));
            Window { from, columns: window.columns.iter().map(column).collect() }
        };
        let view =
            |view: &PreparedView| PreparedView { windows: view.windows.iter().map(window).collect(), full: view.full };
        Self { views: self.views.iter().map(view).collect(), ..thin.clone() }
    }
}

/// The runs of a window.
struct Runs<'a> {
    /// Where they begin, and what follows.
    runs: &'a [usize],
    /// The steering of each back from where its mean is.
    back: &'a [(f32, f32)],
    /// The window's first sample.
    first: usize,
}

impl Runs<'_> {
    /// `back * sum sample * steering` over each run of a column.
    #[inline(always)]
    fn sums(&self, samples: &[Abreast], steering: &[(f32, f32)]) -> Vec<Abreast> {
        let mut sums = Vec::with_capacity(self.back.len());
        for (run, back) in self.runs.windows(2).zip(self.back) {
            let within = run[0] - self.first..(run[1] - self.first).min(samples.len());
            // Plain products of (re, im) in a row: vector code.
            let (mut by_cos, mut by_sin) = ([0f32; 2 * ABREAST], [0f32; 2 * ABREAST]);
            for (sample, (cos, sin)) in samples[within].iter().zip(&steering[run[0]..]) {
                for i in 0..ABREAST {
                    let (re, im) = sample[i];
                    by_cos[2 * i] += cos * re;
                    by_cos[2 * i + 1] += cos * im;
                    by_sin[2 * i] += sin * re;
                    by_sin[2 * i + 1] += sin * im;
                }
            }
            let mut sum = [(0.0, 0.0); ABREAST];
            for (i, sum) in sum.iter_mut().enumerate() {
                let (re, im) = (by_cos[2 * i] - by_sin[2 * i + 1], by_cos[2 * i + 1] + by_sin[2 * i]);
                *sum = (re * back.0 - im * back.1, re * back.1 + im * back.0);
            }
            sums.push(sum);
        }
        sums
    }
}
