//! A few paths, taken out of the round trip one after the other.
//!
//! The round trip is the square of the channel: beside each path it holds the product of every two, a wave from between
//! them. Orthogonal matching pursuit: the place that explains most of what is left joins the list, all amplitudes are
//! fitted and all places climbed to anew (RELAX, \[li-stoica1996\] in docs/references.md), and what they leave is searched again. A find that
//! two stronger ones would make between them, and that is no stronger than they can make it, is reported as their cross
//! term.

use super::fix::Source;
use super::kernel::powers;
use super::prepared::PreparedAperture;
use super::search::Search;
use super::thin::Sectors;
use super::types::{Place, Precision};
use crate::maths::wrap_rad;
use crate::tuning::TUNING;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// One wave of the round trip.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Path {
    /// Azimuth from the middle of the motion, radians.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, where the motion distinguishes the two.
    pub signed_elevation_rad: Option<f64>,
    /// 1 / range, 1/m; 0 is a plane wave.
    pub inverse_range_per_m: f64,
    /// Power of the one-way path over that of the strongest, dB.
    pub relative_power_db: f64,
    /// Where it is the product of two other paths: their places in the list.
    pub cross_term_of: Option<[usize; 2]>,
}

impl Path {
    /// The path of an answer beside which there is no other.
    pub(crate) fn only(source: &Source) -> Self {
        Self {
            azimuth_rad: source.azimuth_rad,
            abs_elevation_rad: source.abs_elevation_rad,
            signed_elevation_rad: source.signed_elevation_rad,
            inverse_range_per_m: source.inverse_range_per_m,
            relative_power_db: 0.0,
            cross_term_of: None,
        }
    }
}

/// What has been found: places and how each is steered to.
struct Found {
    places: Vec<Place>,
    steering: Vec<Vec<Complex64>>,
    /// Amplitudes of each, column by column.
    amplitudes: Vec<DVector<Complex64>>,
    /// Power of each, summed over the columns.
    powers: Vec<f64>,
}

impl Search {
    /// The paths of the first aperture's first view, the answer `first`. Empty where it has no samples.
    #[must_use]
    pub fn paths(&mut self, first: &Source) -> Vec<Path> {
        let Some(whole) = self.apertures.first().map(PreparedAperture::columns) else { return Vec::new() };
        let mut found = Found { places: Vec::new(), steering: Vec::new(), amplitudes: Vec::new(), powers: Vec::new() };
        let mut next = Place::from(first);
        // The sums that serve the grid are the same for every path.
        let sectors = self.sectors(&self.apertures[0].with_columns(&whole), &self.axes);
        let energy = |columns: &[Vec<Complex64>]| columns.iter().flatten().map(Complex64::norm_sqr).sum::<f64>();
        let mut left = energy(&whole);
        while found.places.len() < TUNING.paths.most {
            let steering = self.apertures[0].steering(&self.at_height(&next));
            found.places.push(next);
            found.steering.push(steering);
            self.relax(&mut found, &whole);
            let Some(rest) = found.fit(&whole) else {
                found.drop_last();
                break;
            };
            let now = energy(&rest);
            let strongest = found.powers.iter().copied().fold(0.0, f64::max);
            let weak = found.powers.last().is_none_or(|own| *own < TUNING.paths.weakest * strongest);
            if found.places.len() > 1 && (left - now < TUNING.paths.least_share * left || weak) {
                found.drop_last();
                let _ = found.fit(&whole);
                break;
            }
            left = now;
            next = self.strongest(&self.apertures[0].with_columns(&rest), &sectors);
        }
        found.list(first.signed_elevation_rad.is_some())
    }

    /// Moves every wave but the answer to where it explains most of what the others leave (\[li-stoica1996\]), once around.
    fn relax(&self, found: &mut Found, whole: &[Vec<Complex64>]) {
        for i in 1..found.places.len() {
            let Some(mut rest) = found.fit(whole) else { return };
            for (column, amplitudes) in rest.iter_mut().zip(&found.amplitudes) {
                column.iter_mut().zip(&found.steering[i]).for_each(|(v, s)| *v += amplitudes[i] * s.conj());
            }
            let aperture = self.apertures[0].with_columns(&rest);
            found.places[i] = self.climb_in(&aperture, found.places[i]);
            found.steering[i] = aperture.steering(&self.at_height(&found.places[i]));
        }
    }

    /// The place that explains most of `aperture`.
    fn strongest(&self, aperture: &PreparedAperture, sectors: &Sectors) -> Place {
        let powers = self.powers_in(aperture, sectors);
        let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
        self.climb_in(aperture, self.axes.places()[best])
    }

    /// The best place about `start`.
    fn climb_in(&self, aperture: &PreparedAperture, start: Place) -> Place {
        let axes = &self.axes;
        let step = TAU / axes.azimuths as f64;
        let mut best = start;
        let (mut across, mut along) = (0.5 * step, 0.5 * axes.curves.get(1).copied().unwrap_or(0.0));
        let (low, high) = (axes.elevations[0], axes.elevations[axes.elevations.len() - 1]);
        let mut up = 0.25 * (high - low);
        // No climb leaves the places that samples alike there may be summed for.
        let thin = self.apertures_about(std::slice::from_ref(aperture), &start);
        for _ in 0..5 {
            let mut around = vec![best];
            for (a, e, c) in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1)] {
                for sign in [-1.0, 1.0] {
                    let by = |k: i32, size: f64| sign * f64::from(k) * size;
                    around.push(Place {
                        azimuth: best.azimuth + by(a, across),
                        elevation: (best.elevation + by(e, up)).clamp(low, high),
                        curve: (best.curve + by(c, along)).clamp(0.0, axes.curves[axes.curves.len() - 1]),
                    });
                }
            }
            best = self.highest(&thin, &around);
            (across, up, along) = (0.6 * across, 0.6 * up, 0.6 * along);
        }
        best
    }

    fn highest(&self, apertures: &[PreparedAperture], places: &[Place]) -> Place {
        let at_height: Vec<Place> = places.iter().map(|place| self.at_height(place)).collect();
        let powers = powers(self.level(), apertures, &at_height, Precision::Exact);
        let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
        places[best]
    }
}

impl Found {
    fn drop_last(&mut self) {
        self.places.pop();
        self.steering.pop();
    }

    /// Fits all amplitudes to `whole`, column by column, and gives what they leave; `None` if their steering vectors are
    /// linearly dependent.
    fn fit(&mut self, whole: &[Vec<Complex64>]) -> Option<Vec<Vec<Complex64>>> {
        let n = self.steering.len();
        let along = |a: &[Complex64], b: &[Complex64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<Complex64>();
        // A wave is the conjugate of its steering: <w_i, w_k> = sum s_i conj(s_k).
        let product = |i: usize, k: usize| -> Complex64 {
            self.steering[i].iter().zip(&self.steering[k]).map(|(a, b)| a * b.conj()).sum()
        };
        let gram = DMatrix::from_fn(n, n, product);
        let inverse = gram.try_inverse()?;
        let mut rest = whole.to_vec();
        self.powers = vec![0.0; n];
        self.amplitudes.clear();
        for column in &mut rest {
            let side = DVector::from_fn(n, |i, _| along(&self.steering[i], column));
            let amplitudes = &inverse * side;
            for (i, steering) in self.steering.iter().enumerate() {
                self.powers[i] += amplitudes[i].norm_sqr();
                column.iter_mut().zip(steering).for_each(|(v, s)| *v -= amplitudes[i] * s.conj());
            }
            self.amplitudes.push(amplitudes);
        }
        self.powers.iter().all(|p| p.is_finite()).then_some(rest)
    }

    /// The answer first, the others falling in power, with the cross terms among them; `signed` where elevations have a
    /// sign.
    fn list(&self, signed: bool) -> Vec<Path> {
        let mut order: Vec<usize> = (0..self.places.len()).collect();
        order.get_mut(1..).unwrap_or_default().sort_by(|a, b| self.powers[*b].total_cmp(&self.powers[*a]));
        let parents = self.parents(&order);
        let sources = order.iter().zip(&parents).filter(|(_, parents)| parents.is_none());
        let strongest = sources.map(|(own, _)| self.powers[*own]).fold(f64::MIN_POSITIVE, f64::max);
        let path = |(&own, &cross_term_of): (&usize, &Option<[usize; 2]>)| {
            let place = &self.places[own];
            Path {
                azimuth_rad: wrap_rad(place.azimuth),
                abs_elevation_rad: place.elevation.abs(),
                signed_elevation_rad: signed.then_some(place.elevation),
                inverse_range_per_m: place.curve,
                // The round trip has the square of the path's power.
                relative_power_db: 5.0 * (self.powers[own] / strongest).max(1e-12).log10(),
                cross_term_of,
            }
        };
        order.iter().zip(&parents).map(path).collect()
    }

    /// Of each wave of `order` the two whose product it may be; both of them are sources themselves. The likest products are
    /// taken first: what explains one is explained by no other.
    fn parents(&self, order: &[usize]) -> Vec<Option<[usize; 2]>> {
        let count = order.len();
        let mut likest = Vec::new();
        // The answer, which comes first, is a source.
        for at in 1..count {
            let pairs = (0..count).flat_map(|i| (i + 1..count).map(move |k| [i, k])).filter(|pair| !pair.contains(&at));
            for pair in pairs {
                let [own, a, b] = [order[at], order[pair[0]], order[pair[1]]];
                let possible = self.powers[own] < TUNING.paths.cross_gain * (self.powers[a] * self.powers[b]).sqrt();
                let alike = if possible { self.resemblance(own, a, b) } else { 0.0 };
                if alike > TUNING.paths.alike {
                    likest.push((alike, at, pair));
                }
            }
        }
        likest.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut parents = vec![None; count];
        let mut is_source = vec![false; count];
        for (_, at, pair) in likest {
            if !is_source[at] && parents[at].is_none() && pair.iter().all(|&k| parents[k].is_none()) {
                parents[at] = Some(pair);
                pair.iter().for_each(|&k| is_source[k] = true);
            }
        }
        parents
    }

    /// How much wave `own` is like the product of the one-way waves of `a` and `b`, 0..1. The square of that product is
    /// the product of their round trips, so nothing has to be unwrapped.
    fn resemblance(&self, own: usize, a: usize, b: usize) -> f64 {
        let (own, a, b) = (&self.steering[own], &self.steering[a], &self.steering[b]);
        let squared = own.iter().zip(a).zip(b).map(|((own, a), b)| own * own * (a * b).conj());
        squared.sum::<Complex64>().norm() / own.len().max(1) as f64
    }
}
