//! The grid: scores of every place on it, and the peaks of their evidence over azimuth.

use super::prior;
use super::search::Search;
use super::types::Scored;
use crate::maths::wrap_rad;

impl Search {
    /// Peaks of the evidence over azimuth (with the best elevation and range of each), falling, and every view's own best
    /// azimuth, radians.
    pub(super) fn scan(&mut self) -> (Vec<Scored>, Vec<f64>) {
        let places = self.axes.places();
        let depth = places.len() / self.axes.azimuths;
        let (scores, view_azimuths) = self.grid_scores(places.len());
        let (shares, weight) =
            (prior::shares(&self.axes, self.limits.elevation_max_rad), self.weights.choosing.iter().sum());
        self.averaging = scores.chunks(depth).map(|own| prior::averaging(own, &shares, weight)).collect();
        let best = |(i, (own, averaging)): (usize, (&[f64], &f64))| {
            let (k, score) = own.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap_or((0, &f64::MIN));
            Scored { place: places[i * depth + k], score: score + averaging }
        };
        let ridge: Vec<Scored> = scores.chunks(depth).zip(&self.averaging).enumerate().map(best).collect();
        (peaks(&ridge), view_azimuths)
    }

    /// The score of every place of the grid, and the best azimuth of each view. Each aperture is computed on the grid that
    /// it asks for: one-way waves are twice as long, and need an eighth of the places.
    fn grid_scores(&mut self, places: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut scores, mut view_azimuths) = (vec![0.0; places], Vec::new());
        let mut weights = self.weights.choosing.iter();
        for (aperture, own) in self.apertures.iter().zip(&self.own_axes) {
            let own_places = own.places();
            let powers = self.powers_on(aperture, own);
            self.evaluations += own_places.len();
            let views = aperture.views.len();
            for (view, weight) in (0..views).zip(&mut weights) {
                let powers: Vec<f32> = powers.iter().skip(view).step_by(views).copied().collect();
                let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
                view_azimuths.push(best.map_or(0.0, |(index, _)| wrap_rad(own_places[index].azimuth)));
                let powers = if *own == self.axes { powers } else { own.spread(&powers, &self.axes) };
                scores.iter_mut().zip(powers).for_each(|(s, p)| *s += weight * f64::from(p.max(1e-12).ln()));
            }
        }
        (scores, view_azimuths)
    }
}

/// Local maxima around the circle, falling; the first point if there is none.
fn peaks(ridge: &[Scored]) -> Vec<Scored> {
    let n = ridge.len();
    let score = |i: usize| ridge[i % n].score;
    let is_peak = |i: &usize| score(*i) >= score(i + 1) && score(*i) > score(i + n - 1);
    let mut peaks: Vec<Scored> = (0..n).filter(is_peak).map(|i| ridge[i]).collect();
    peaks.sort_by(|a, b| b.score.total_cmp(&a.score));
    if peaks.is_empty() {
        peaks.extend(ridge.first());
    }
    peaks
}
