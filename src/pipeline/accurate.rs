//! Beyond a plane wave at the channel centre: all subcarriers, aligned; the one-way channel; spherical waves.

use super::Options;
use super::link::Bearing;
use crate::bartlett::Estimate;
use crate::maths::wrap_rad;
use crate::place::confidence::confidence;
use crate::place::near_field::{
    self, Aperture, Fix, Focus, Limits, Maps, ONE_WAY_VIEWS, Path, ROUND_TRIP_VIEWS, Search, View,
};
use crate::signal::alignment::{Alignment, Row, align, remove_common_slope};
use crate::signal::one_way::one_way;
use crate::signal::samples::Samples;
use nalgebra::Vector3;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;

/// Which steps are taken. Every one can be left out, to see what it brings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Spherical waves: range and position beside the bearing.
    pub near_field: bool,
    /// Alignment of the sampling time from packet to packet.
    pub align: bool,
    /// The one-way channel beside the round trip.
    pub one_way: bool,
    /// Autofocus of the trajectory over all transmitters of a capture.
    pub focus: bool,
    /// The paths beside the answer.
    pub paths: bool,
    /// Shortest distance of a transmitter, metres.
    pub range_min_m: f64,
    /// The transmitter's height above the receiver's antenna, metres, where known.
    pub height_m: Option<f64>,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self {
            near_field: true,
            align: true,
            one_way: true,
            focus: true,
            paths: true,
            range_min_m: 1.8,
            height_m: None,
        }
    }
}

impl Accuracy {
    /// Without any step: a plane wave at the channel centre.
    #[must_use]
    pub fn without_layers(self) -> Self {
        Self { near_field: false, align: false, one_way: false, ..self }
    }
}

/// What the accurate path found.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// The search's answer.
    pub fix: Fix,
    /// Sampling-time alignment, where it was made.
    pub alignment: Option<Alignment>,
    /// Share of the one-way channel's power at sign slips, where it was made.
    pub slips: Option<f64>,
    /// Probability that the azimuth is within five degrees.
    pub confidence: f64,
    /// What autofocus found of the trajectory, where several links were there to tell.
    pub focus: Option<Focus>,
    /// The paths in the round trip, the answer first.
    pub paths: Vec<Path>,
    /// The joint power over azimuth, elevation and range, where the course is kept for pictures.
    pub maps: Option<Maps>,
}

/// Cells around of the maps.
const MAP_AZIMUTHS: usize = 360;

/// A range is reported where its predicted deviation is below this share of it.
const RANGE_SHARE: f64 = 0.35;

impl Placed {
    /// Range and its standard deviation, metres, where the curvature fixes it.
    #[must_use]
    pub fn range_m(&self) -> Option<(f64, f64)> {
        self.fix.range_m(RANGE_SHARE)
    }
}

/// A round trip of unit power with the turn-around taken out: `turn` is what the compensation multiplied by.
pub(super) fn compensated(product: &Row, turn: Complex64) -> Row {
    let power = product.iter().map(Complex32::norm_sqr).sum::<f32>() / product.len() as f32;
    let factor = Complex32::new(turn.re as f32, turn.im as f32) / power.sqrt();
    if factor.is_finite() { product.map(|v| v * factor) } else { Row::default() }
}

/// Searches the place of the transmitter and, where there is one, makes it the estimate. `rows` are all pairs of the
/// link: those taken at rest tell nothing of the bearing, but settle slopes and signs. `used` are those of `samples`.
pub(super) fn place(
    samples: &Samples,
    mut rows: Vec<Row>,
    used: &[usize],
    estimate: &mut Estimate,
    options: &Options,
) -> Option<(Placed, Search)> {
    let steps = &options.accuracy;
    let wavelength_m = options.channel.wavelength_m();
    let indices = options.channel.subcarriers();
    let alignment = steps.align.then(|| align(&mut rows, &indices, options.search.tier));
    remove_common_slope(&mut rows, &indices);
    let displacement_m: Vec<Vector3<f64>> = samples.displacements_m().collect();
    let round_trip = Aperture::gather_with_centre(&displacement_m, &pick(&rows, used), samples.z(), 2, wavelength_m);
    let roots = steps.one_way.then(|| one_way(&rows, options.search.tier));
    let one_way =
        roots.as_ref().map(|roots| Aperture::gather(&displacement_m, &pick(&roots.rows, used), 1, wavelength_m));
    let mut layers: Vec<(&Aperture, &[View])> = vec![(&round_trip, &ROUND_TRIP_VIEWS)];
    layers.extend(one_way.as_ref().map(|aperture| (aperture, ONE_WAY_VIEWS.as_slice())));
    let limits = Limits {
        elevation_max_rad: if estimate.elevation_searched { options.search.elevation_max_rad } else { 0.0 },
        range_min_m: steps.range_min_m,
        height_m: steps.height_m,
        tier: options.search.tier,
    };
    let middle_m = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
    let mut search = Search::new(&layers, middle_m, wavelength_m, &limits)?;
    let fix = search.run()?;
    adopt(&fix, estimate);
    let (confidence, slips) = (confidence(&fix), roots.map(|roots| roots.slips));
    Some((Placed { fix, alignment, slips, confidence, focus: None, paths: Vec::new(), maps: None }, search))
}

/// What takes all links of a capture: autofocus of their common trajectory and, after it, the paths of each.
pub(super) fn finish(bearings: &mut [&mut Bearing], options: &Options) {
    if options.accuracy.focus {
        refocus(bearings);
    }
    let extract = |bearing: &mut &mut Bearing| {
        let (Some(placed), Some(mut search)) = (&mut bearing.placed, bearing.search.take()) else { return };
        if options.accuracy.paths {
            placed.paths = search.paths(&placed.fix.best());
        }
        placed.maps = options.keep_course.then(|| search.maps(MAP_AZIMUTHS));
    };
    match options.parallel {
        true => bearings.par_iter_mut().for_each(extract),
        false => bearings.iter_mut().for_each(extract),
    }
}

/// Changes the trajectory where that makes the answers of two or more links sharper than chance does.
fn refocus(bearings: &mut [&mut Bearing]) {
    let part = |bearing: &'_ &mut Bearing| bearing.search.is_some() && bearing.placed.is_some();
    if bearings.iter().filter(|bearing| part(bearing)).count() < 2 {
        return;
    }
    let mut links: Vec<(&mut Search, &Fix)> = bearings
        .iter_mut()
        .filter_map(|bearing| Some((bearing.search.as_mut()?, &bearing.placed.as_ref()?.fix)))
        .collect();
    let focus = near_field::focus(&mut links);
    for bearing in bearings {
        let (Some(search), Some(placed)) = (&mut bearing.search, &mut bearing.placed) else { continue };
        placed.focus = Some(focus);
        if focus.worthwhile
            && let Some(fix) = search.run()
        {
            adopt(&fix, &mut bearing.estimate);
            placed.confidence = confidence(&fix);
            placed.fix = fix;
        }
    }
}

fn pick(rows: &[Row], used: &[usize]) -> Vec<Row> {
    used.iter().filter_map(|&index| rows.get(index)).copied().collect()
}

/// Makes the answer of the search the estimate; a mirror stays the reflection about the line of motion.
fn adopt(fix: &Fix, estimate: &mut Estimate) {
    let best = fix.best();
    if let Some(mirror) = estimate.mirror_rad {
        estimate.mirror_rad = Some(wrap_rad(estimate.azimuth_rad + mirror - fix.azimuth_rad));
    }
    estimate.azimuth_rad = fix.azimuth_rad;
    estimate.azimuth_sd_rad = fix.deviations.azimuth_rad;
    estimate.abs_elevation_rad = best.abs_elevation_rad;
    estimate.elevation_sd_rad = fix.deviations.elevation_rad;
    estimate.signed_elevation_rad = None;
    estimate.peak_ratio = fix.sources.get(1).map(|other| (other.evidence / best.evidence).min(1.0));
}
