//! The kernel: how well spherical waves from many places explain the samples, a SIMD vector of places at a time.

use super::bend::BendPolynomial;
use super::prepared::{ABREAST, PreparedAperture, Window};
use super::types::{Place, Precision};
use csi5300_kernels::simd::{V, on_tier, rough_sin_cos_turns, sin_cos_turns};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat};

/// The power of every view of every aperture for each place, 0..1, view by view: `powers[place * views + view]`.
pub(super) fn powers(level: Level, apertures: &[PreparedAperture], places: &[Place], precision: Precision) -> Vec<f32> {
    let views: usize = apertures.iter().map(|aperture| aperture.views.len()).sum();
    let mut powers = vec![0.0; views * places.len()];
    on_tier!(level, simd => powers_simd(simd, apertures, places, views, precision, &mut powers));
    powers
}

#[inline(always)]
fn powers_simd<S: Simd>(
    simd: S,
    apertures: &[PreparedAperture],
    places: &[Place],
    views: usize,
    precision: Precision,
    powers: &mut [f32],
) {
    let lanes = V::<S, f32>::LEN;
    let longest = apertures.iter().map(PreparedAperture::len).max().unwrap_or(0);
    let mut steering = vec![(V::<S, f32>::splat(simd, 0.0), V::<S, f32>::splat(simd, 0.0)); longest];
    // Cosines and sines of a double cost as much as some packets: once for all apertures.
    let points = points_of(places);
    for (points, powers) in points.chunks(lanes).zip(powers.chunks_mut(lanes * views)) {
        let mut view = 0;
        for aperture in apertures {
            let lanes = PlaceLanes::<S>::new(simd, aperture, points);
            match aperture.polynomial.filter(|_| precision == Precision::Rough) {
                Some(polynomial) => steer_roughly(simd, aperture, &lanes, &polynomial, &mut steering),
                None => steer(simd, aperture, &lanes, &mut steering),
            }
            for own in aperture.views.iter() {
                let mut sum = V::<S, f32>::splat(simd, 0.0);
                for window in &own.windows {
                    sum += window_power(simd, window, &steering);
                }
                for i in 0..points.len() {
                    powers[i * views + view] = if own.full > 0.0 { (sum[i] / own.full).min(1.0) } else { 0.0 };
                }
                view += 1;
            }
        }
    }
}

/// Cosine and sine of the steering of every sample towards each place: `steerings[place][sample]`.
pub(super) fn steerings(level: Level, aperture: &PreparedAperture, places: &[Place]) -> Vec<Vec<(f32, f32)>> {
    let mut all = vec![vec![(0.0, 0.0); aperture.len()]; places.len()];
    on_tier!(level, simd => steerings_simd(simd, aperture, places, &mut all));
    all
}

#[inline(always)]
fn steerings_simd<S: Simd>(simd: S, aperture: &PreparedAperture, places: &[Place], all: &mut [Vec<(f32, f32)>]) {
    let lanes = V::<S, f32>::LEN;
    let zero = V::<S, f32>::splat(simd, 0.0);
    let mut steering = vec![(zero, zero); aperture.len()];
    let points = points_of(places);
    for (points, all) in points.chunks(lanes).zip(all.chunks_mut(lanes)) {
        steer(simd, aperture, &PlaceLanes::<S>::new(simd, aperture, points), &mut steering);
        for (i, own) in all.iter_mut().enumerate() {
            own.iter_mut().zip(&steering).for_each(|(slot, (cos, sin))| *slot = (cos[i], sin[i]));
        }
    }
}

/// A place as the kernel takes it: unit vector, and 1 / range in 1/m.
type Point = ([f32; 3], f32);

/// Places as the kernel takes them. Neighbours share azimuth or elevation: each angle's sine and cosine are taken once.
fn points_of(places: &[Place]) -> Vec<Point> {
    /// Elevations that are kept.
    const KEPT: usize = 8;
    let mut azimuth = (f64::NAN, (0.0, 0.0));
    let mut elevations: Vec<(f64, (f64, f64))> = Vec::with_capacity(KEPT);
    let mut points = Vec::with_capacity(places.len());
    for place in places {
        if azimuth.0 != place.azimuth {
            azimuth = (place.azimuth, place.azimuth.sin_cos());
        }
        let known = elevations.iter().find(|(elevation, _)| *elevation == place.elevation).map(|known| known.1);
        let (sin_el, cos_el) = known.unwrap_or_else(|| {
            let own = place.elevation.sin_cos();
            if elevations.len() == KEPT {
                elevations.clear();
            }
            elevations.push((place.elevation, own));
            own
        });
        let (sin_az, cos_az) = azimuth.1;
        points.push(([(cos_el * cos_az) as f32, (cos_el * sin_az) as f32, sin_el as f32], place.curve as f32));
    }
    points
}

/// Cosine and sine of the steering phase, a lane for each place.
type Turn<S> = (V<S, f32>, V<S, f32>);

/// A vector of places, as all samples of an aperture see them: twice their direction, and 1 / range in 1/turns.
struct PlaceLanes<S: Simd> {
    twice: [V<S, f32>; 3],
    curve: V<S, f32>,
}

impl<S: Simd> PlaceLanes<S> {
    /// `points` are unit vectors and 1 / range in 1/m; lanes beyond them are zero.
    #[inline(always)]
    fn new(simd: S, aperture: &PreparedAperture, points: &[Point]) -> Self {
        let lane = |f: &dyn Fn(&Point) -> f32| V::<S, f32>::from_fn(simd, |i| points.get(i).map_or(0.0, f));
        let twice = [0, 1, 2].map(|axis| lane(&|(unit, _)| 2.0 * unit[axis]));
        Self { twice, curve: lane(&|(_, inverse_range)| inverse_range * aperture.turn_m) }
    }

    /// `length^2 / range^2 = 1 + curve * bend`; `length - range = bend / (length / range + 1)`.
    #[inline(always)]
    fn bend(&self, simd: S, aperture: &PreparedAperture, t: usize) -> V<S, f32> {
        let splat = |value: f32| V::<S, f32>::splat(simd, value);
        let [x, y, z] = self.twice;
        let along = x.mul_add(splat(aperture.x[t]), y.mul_add(splat(aperture.y[t]), z * splat(aperture.z[t])));
        self.curve.mul_add(splat(aperture.square[t]), -along)
    }
}

/// `exp(j 2 pi (|rx - place| - range))` in turns for each sample, as (cosine, sine): what undoes the path. The difference
/// of the two lengths is written without cancellation, and holds for infinite range.
#[inline(always)]
fn steer<S: Simd>(simd: S, aperture: &PreparedAperture, lanes: &PlaceLanes<S>, steering: &mut [Turn<S>]) {
    let (zero, one) = (V::<S, f32>::splat(simd, 0.0), V::<S, f32>::splat(simd, 1.0));
    for (t, slot) in steering.iter_mut().enumerate().take(aperture.len()) {
        let bend = lanes.bend(simd, aperture, t);
        let ratio = lanes.curve.mul_add(bend, one).max(zero).sqrt();
        let (sin, cos) = sin_cos_turns::<S, f32>(simd, bend / (ratio + one));
        *slot = (cos, sin);
    }
}

/// As [`steer`], by the polynomial and with a rough sine.
#[inline(always)]
fn steer_roughly<S: Simd>(
    simd: S,
    aperture: &PreparedAperture,
    lanes: &PlaceLanes<S>,
    polynomial: &BendPolynomial,
    steering: &mut [Turn<S>],
) {
    let coefficients = polynomial.coefficients.map(|c| V::<S, f32>::splat(simd, c));
    let scaled = lanes.curve * V::<S, f32>::splat(simd, polynomial.scale);
    let offset = V::<S, f32>::splat(simd, -polynomial.middle * polynomial.scale);
    for (t, slot) in steering.iter_mut().enumerate().take(aperture.len()) {
        let bend = lanes.bend(simd, aperture, t);
        let s = scaled.mul_add(bend, offset);
        let mut part = coefficients[0];
        for c in &coefficients[1..] {
            part = part.mul_add(s, *c);
        }
        let (sin, cos) = rough_sin_cos_turns::<S, f32>(simd, bend * part);
        *slot = (cos, sin);
    }
}

/// The power of a window in each lane, summed over its columns.
#[inline(always)]
fn window_power<S: Simd>(simd: S, window: &Window, steering: &[Turn<S>]) -> V<S, f32> {
    let zero = V::<S, f32>::splat(simd, 0.0);
    let mut power = zero;
    for samples in &window.columns {
        let mut sums = [[zero; 4]; ABREAST];
        for (sample, (cos, sin)) in samples.iter().zip(&steering[window.from..]) {
            for (sum, &(re, im)) in sums.iter_mut().zip(sample) {
                let (re, im) = (V::<S, f32>::splat(simd, re), V::<S, f32>::splat(simd, im));
                sum[0] = cos.mul_add(re, sum[0]);
                sum[1] = sin.mul_add(im, sum[1]);
                sum[2] = sin.mul_add(re, sum[2]);
                sum[3] = cos.mul_add(im, sum[3]);
            }
        }
        for [re_cos, im_sin, re_sin, im_cos] in sums {
            let (re, im) = (re_cos - im_sin, im_cos + re_sin);
            power = re.mul_add(re, im.mul_add(im, power));
        }
    }
    power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_the_places_one_by_one() {
        let place = |k: usize| Place {
            azimuth: (k / 30) as f64 * 0.7 - 2.0,
            elevation: (k % 10) as f64 * 0.1 - 0.4,
            curve: k as f64 * 1e-3,
        };
        let places: Vec<Place> = (0..120).map(place).collect();
        let expected: Vec<Point> = places.iter().map(|place| (place.unit(), place.curve as f32)).collect();
        assert_eq!(points_of(&places), expected);
    }
}
