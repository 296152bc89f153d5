//! Where least squares begin.

use super::likelihood::{Field, Place, WIDEST};
use super::posterior::Steps;
use super::prior::Prior;
use super::radius_m;
use super::signal::Bins;
use crate::bartlett::{Estimate, Tier};
use crate::signal::samples::Samples;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Places of a grid that are looked at more closely.
const KEPT: usize = 4;

/// The best of the places about the plane wave, on a grid.
pub(crate) fn beside(
    samples: &Samples,
    points: &[Vector3<f64>],
    plane_wave: &Estimate,
    prior: &Prior,
    steps: &Steps,
    tier: Tier,
) -> Place {
    let bins = Bins::for_start(points, samples.wavelength_m());
    let field = Field::new(&bins.points_m(points), Vec::new(), samples.wavelength_m(), 0.0, 1, tier);
    let elevation = plane_wave.signed_elevation_rad.unwrap_or(plane_wave.abs_elevation_rad);
    let mut elevations = vec![elevation];
    match prior.is_signed() {
        true => elevations.push(-elevation),
        false => elevations.extend([0.0, prior.elevation_rad[1]]),
    }
    let curves = prior.curves([0.0, prior.curve_max], 0.5 * steps.curve());
    let mut places = Vec::new();
    for k in -5..=5 {
        let azimuth = plane_wave.azimuth_rad + 0.4 * f64::from(k) * steps.azimuth();
        for &elevation in &elevations {
            let at = |curve: f64| prior.at_height(Place { azimuth, elevation, curve });
            places.push(at(0.0));
            places.extend(curves.iter().map(|cell| at(cell.at)));
        }
    }
    let powers = field.powers(&bins.phasors(samples.z()), samples.path_gain(), &places, usize::MAX);
    let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
    places[best]
}

/// The place of the strongest wave, whatever its direction and range. Over a short window a wave front is plane, and a coarse grid
/// finds it; each time the windows double, the grid about its best places halves its steps, until the wave is coherent over the whole
/// motion. `means` are those of [`Bins::for_start`], `points` their places.
pub(crate) fn anywhere(means: &Samples, points: &[Vector3<f64>], prior: &Prior, tier: Tier) -> Option<Place> {
    let field = Field::new(points, Vec::new(), means.wavelength_m(), 0.0, 1, tier);
    let mut grid = Grid::new(points, means.wavelength_m() / f64::from(means.path_gain()), prior);
    let mut nodes = grid.all();
    let all = points.len().div_ceil(WIDEST);
    let mut blocks = 1;
    loop {
        let places: Vec<Place> = nodes.iter().map(|node| grid.place(node)).collect();
        let powers = field.powers(means.z(), means.path_gain(), &places, blocks);
        let best = best(&nodes, &powers);
        if blocks >= 2 * all {
            return best.first().map(|node| grid.place(node));
        }
        blocks *= 2;
        nodes = grid.closer(&best);
    }
}

/// Places at equal steps of azimuth, elevation (of its cosine, where its sign does not show) and the angle at which a place
/// sees the motion's radius: far away, that goes as 1 / range.
struct Grid<'a> {
    prior: &'a Prior,
    radius_m: f64,
    counts: [i32; 3],
}

type Node = [i32; 3];

impl<'a> Grid<'a> {
    /// For windows of [`WIDEST`] points; a way longer by `turn_m`, metres, is a turn of phase.
    fn new(points: &[Vector3<f64>], turn_m: f64, prior: &'a Prior) -> Self {
        let window_m = points.chunks(WIDEST).map(radius_m).fold(turn_m, f64::max);
        let count = |span: f64, step: f64| (span / step).ceil().clamp(0.0, 1e6) as i32;
        let grid = Self { prior, radius_m: radius_m(points).max(window_m), counts: [0; 3] };
        let [from, to] = grid.elevations();
        let elevations = if prior.elevation_is_open() { count(to - from, turn_m / window_m) } else { 0 };
        let angles = count(grid.largest_rad(), turn_m / window_m);
        Self { counts: [count(TAU, turn_m / window_m).max(4), elevations, angles], ..grid }
    }

    /// The limits of the elevation, or of its cosine.
    fn elevations(&self) -> [f64; 2] {
        let [low, high] = self.prior.elevation_rad;
        if self.prior.is_signed() { [low, high] } else { [high.cos(), low.cos()] }
    }

    /// The angle at which the nearest place sees the radius, radians.
    fn largest_rad(&self) -> f64 {
        (self.prior.curve_max * self.radius_m).atan()
    }

    fn all(&self) -> Vec<Node> {
        let [azimuths, elevations, angles] = self.counts;
        let each = |a: i32| (0..=elevations).flat_map(move |e| (0..=angles).map(move |c| [a, e, c]));
        (0..azimuths).flat_map(each).collect()
    }

    fn place(&self, node: &Node) -> Place {
        let share = |k: usize| f64::from(node[k]) / f64::from(self.counts[k].max(1));
        let [from, to] = self.elevations();
        let elevation = from + share(1) * (to - from);
        let elevation = if self.prior.is_signed() { elevation } else { elevation.min(1.0).acos() };
        let curve = (share(2) * self.largest_rad()).tan() / self.radius_m;
        self.prior.at_height(Place { azimuth: TAU * share(0), elevation, curve: curve.min(self.prior.curve_max) })
    }

    /// The nodes up to two steps beside some, at half the steps.
    fn closer(&mut self, nodes: &[Node]) -> Vec<Node> {
        self.counts = self.counts.map(|count| 2 * count);
        let [azimuths, elevations, angles] = self.counts;
        let beside = |node: &Node| {
            let [a, e, c] = node.map(|k| 2 * k);
            let near = move |off: i32| [a + off / 25 - 2, e + off / 5 % 5 - 2, c + off % 5 - 2];
            (0..125).map(near)
        };
        let inside = |[a, e, c]: Node| {
            let is_inside = (0..=elevations).contains(&e) && (0..=angles).contains(&c);
            is_inside.then_some([a.rem_euclid(azimuths), e, c])
        };
        let mut all: Vec<Node> = nodes.iter().flat_map(beside).filter_map(inside).collect();
        all.sort_unstable();
        all.dedup();
        all
    }
}

/// The nodes with the highest powers, none beside another, the highest first.
fn best(nodes: &[Node], powers: &[f64]) -> Vec<Node> {
    let mut order: Vec<usize> = (0..nodes.len()).collect();
    order.sort_by(|a, b| powers[*b].total_cmp(&powers[*a]));
    let mut kept: Vec<Node> = Vec::new();
    for node in order.into_iter().map(|k| nodes[k]) {
        let is_beside = |other: &Node| node.iter().zip(other).all(|(a, b)| (a - b).abs() <= 1);
        if !kept.iter().any(is_beside) {
            kept.push(node);
        }
        if kept.len() == KEPT {
            break;
        }
    }
    kept
}
