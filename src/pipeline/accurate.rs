//! Beyond a plane wave at the channel centre: all subcarriers, aligned; the one-way channel; spherical waves.

use super::direction::Direction;
use super::options::Options;
use crate::place::near_field::mirror::{decisive, log_odds};
use crate::place::near_field::{
    self, Aperture, Edge, Elevations, Evidence, Fix, Focus, Limits, Maps, Path, Search, View, one_way_views,
    round_trip_views,
};
use crate::signal::alignment::planes::Planes;
use crate::signal::alignment::{Alignment, CsiRow, align_planes, remove_slope};
use crate::signal::one_way::{is_dense_enough, take_roots};
use crate::signal::samples::Samples;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use num_complex::Complex64;
use rayon::prelude::*;

/// What the search over places found, and what it was made of.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Placed {
    /// The search's answer.
    pub fix: Fix,
    /// Sampling-time alignment, where it was made.
    pub alignment: Option<Alignment>,
    /// Share of the one-way channel's power at sign slips, where it was made.
    pub slips: Option<f64>,
    /// The change of the trajectory that autofocus found, where there were two links or more.
    pub focus: Option<Focus>,
    /// The paths in the round trip, the answer first.
    pub paths: Vec<Path>,
    /// The joint power over azimuth, elevation and range, where maps are kept for pictures.
    pub maps: Option<Maps>,
    /// What the azimuth was chosen from, where the course is kept for pictures.
    pub evidence: Option<Evidence>,
}

/// Cells around of the maps.
const MAP_AZIMUTHS: usize = 360;
/// Azimuths of the evidence beside the answers' own: half a degree, a third of the first null's distance for a motion of 1 m. It is
/// searched as exactly as an answer, so it costs what it has azimuths.
const EVIDENCE_AZIMUTHS: usize = 720;

impl Placed {
    /// The answer of one wave that leaves nothing but noise.
    pub(super) fn of_one_wave(fix: Fix) -> Self {
        Self { fix, alignment: None, slips: None, focus: None, paths: Vec::new(), maps: None, evidence: None }
    }

    /// Range and its standard deviation, metres, where the curvature fixes it.
    #[must_use]
    pub(crate) fn range_m(&self) -> Option<(f64, f64)> {
        self.fix.range_m(TUNING.deviations.range_share)
    }
}

/// Searches the place of the transmitter. `rows` are the round trips of all pairs of the link, of unit power: those taken at
/// rest do not depend on the bearing, but help to find slopes and signs. `used` are those of `samples`.
pub(super) fn place(
    samples: &Samples,
    mut rows: Vec<Planes>,
    used: &[usize],
    direction: &Direction,
    options: &Options,
) -> Option<(Placed, Search)> {
    let steps = &options.accuracy;
    let wavelength_m = options.channel.wavelength_m();
    let indices = options.channel.subcarriers();
    let tier = options.search.tier;
    let alignment = steps.align.then(|| align_planes(&mut rows, &indices, tier, options.parallel));
    remove_slope(&mut rows, &indices, tier);
    let displacement_m: Vec<Vector3<f64>> = samples.displacements_m().collect();
    let gather = |rows: &[Planes], centre: &[Complex64], path_gain: u8| {
        let row = |k: usize| used.get(k).and_then(|&index| rows.get(index)).map_or_else(CsiRow::default, Planes::row);
        Aperture::gather_by(&displacement_m, row, centre, path_gain, wavelength_m)
    };
    let round_trip = gather(&rows, samples.z(), 2);
    let spacing_wavelengths = samples.spacing_m() / wavelength_m;
    let has_signs = steps.one_way && is_dense_enough(spacing_wavelengths);
    let slips = has_signs.then(|| take_roots(&mut rows, spacing_wavelengths, tier).slips);
    let one_way = slips.map(|_| gather(&rows, &[], 1));
    drop(rows);
    let views = (round_trip_views(round_trip.path_m() / wavelength_m), one_way_views());
    let mut layers: Vec<(&Aperture, &[View])> = vec![(&round_trip, &views.0)];
    layers.extend(one_way.as_ref().map(|aperture| (aperture, views.1.as_slice())));
    let limits = limits(direction, options);
    let middle_m = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
    let run = |limits: &Limits| {
        let mut search = Search::new(&layers, middle_m, wavelength_m, limits)?;
        Some((search.run()?, search))
    };
    let (fix, search) = beyond_expected(run(&limits)?, &limits, direction.beyond, run);
    Some((Placed { alignment, slips, ..Placed::of_one_wave(fix) }, search))
}

/// What a search over places may expect.
pub(super) fn limits(direction: &Direction, options: &Options) -> Limits {
    let steps = &options.accuracy;
    Limits {
        elevation_max_rad: if direction.elevation_searched() { options.search.elevation_max_rad } else { 0.0 },
        elevations: direction.elevations,
        // Motion in space tells near places from far ones: there is no need to expect any.
        range_min_m: if direction.elevations == Elevations::Signed { 0.0 } else { steps.range_min_m },
        height_m: steps.height_m,
        tier: options.search.tier,
        parallel: options.parallel,
    }
}

/// The same of a search along the horizon: the fewest places that any search takes.
pub(super) fn horizon(options: &Options) -> Limits {
    let steps = &options.accuracy;
    Limits { tier: options.search.tier, ..Limits::new(0.0, steps.range_min_m).with_height_m(steps.height_m) }
}

/// The answer within what is expected, or one beyond it that leaves no doubt: higher, where the plane wave is (`higher`);
/// nearer, where the answer is at the shortest range.
fn beyond_expected(
    expected: (Fix, Search),
    limits: &Limits,
    higher: bool,
    run: impl Fn(&Limits) -> Option<(Fix, Search)>,
) -> (Fix, Search) {
    let nearer = matches!(expected.0.edge(), Some(Edge::Range | Edge::ElevationAndRange));
    if !(higher || nearer) {
        return expected;
    }
    let elevations = if higher { Elevations::Beyond } else { limits.elevations };
    let range_min_m = if nearer { 0.0 } else { limits.range_min_m };
    let wider = run(&Limits { elevations, range_min_m, ..*limits });
    let likelier = |(fix, _): &(Fix, Search)| decisive(log_odds(fix.best().power, expected.0.best().power));
    wider.filter(likelier).unwrap_or(expected)
}

/// Changes the trajectory that all links share where that raises the joint powers of two or more of them by more than its
/// parameters do by chance.
pub(super) fn refocus(links: &mut [&mut (Placed, Search)], parallel: bool) {
    if links.len() < 2 {
        return;
    }
    let mut pairs: Vec<(&mut Search, &Fix)> = links.iter_mut().map(|(placed, search)| (search, &placed.fix)).collect();
    let focus = near_field::focus(&mut pairs, parallel);
    links.iter_mut().for_each(|(placed, _)| placed.focus = Some(focus));
    let again = |(placed, search): &mut &mut (Placed, Search)| {
        if let Some(fix) = search.run() {
            placed.fix = fix;
        }
        // They were those of the trajectory as it was.
        placed.paths.clear();
    };
    match (focus.worthwhile, parallel) {
        (true, true) => links.par_iter_mut().for_each(again),
        (true, false) => links.iter_mut().for_each(again),
        (false, _) => {}
    }
}

/// Finds the paths where they are asked for and not found yet. Of one wave that leaves nothing but noise the only path is the
/// answer.
pub(super) fn find_paths(placed: &mut Placed, search: &mut Search, one_wave: bool, options: &Options) {
    if options.accuracy.paths && placed.paths.is_empty() {
        let best = placed.fix.best();
        placed.paths = if one_wave { vec![Path::only(&best)] } else { search.paths(&best) };
    }
}

/// What is taken from a search when it is over: the paths, and maps for pictures.
pub(super) fn extract((mut placed, mut search): (Placed, Search), one_wave: bool, options: &Options) -> Placed {
    find_paths(&mut placed, &mut search, one_wave, options);
    if options.keep_maps {
        placed.maps = Some(search.maps(MAP_AZIMUTHS));
    }
    if options.keep_course {
        placed.evidence = Some(search.evidence(EVIDENCE_AZIMUTHS, &placed.fix.sources));
    }
    placed
}
