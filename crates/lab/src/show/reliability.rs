//! Reliability diagrams: probabilities against observed frequencies.
use super::axes::Axes;
use super::canvas::{BLACK, Canvas, Key, WIDTH, series_colour};
use super::{Error, Format};
use std::path::{Path, PathBuf};

/// Bearings of similar probability: one point of a [`ReliabilityPlot`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReliabilityPoint {
    /// Their mean probability, 0..1.
    pub said: f64,
    /// Share that was right, 0..1.
    pub right: f64,
    /// Number of bearings.
    pub count: usize,
}

/// A reliability diagram: points on the diagonal are correct probabilities. Bars are the 68 % interval of the share for as many
/// independent bearings (Wilson); bearings of one place are not independent, so the bars are rather short.
#[derive(Debug, Clone, Default)]
pub struct ReliabilityPlot {
    /// Headline.
    pub title: String,
    /// Name and points of each series.
    pub series: Vec<(String, Vec<ReliabilityPoint>)>,
}

/// Wilson's interval of one deviation for `right` of `count` tries.
fn wilson(right: f64, count: usize) -> [f64; 2] {
    let n = count.max(1) as f64;
    let middle = (right + 0.5 / n) / (1.0 + 1.0 / n);
    let half = (right * (1.0 - right) / n + 0.25 / (n * n)).sqrt() / (1.0 + 1.0 / n);
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

impl ReliabilityPlot {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let good = |p: &&ReliabilityPoint| p.said.is_finite() && p.right.is_finite() && p.count > 0;
        let kept: Vec<Vec<ReliabilityPoint>> =
            self.series.iter().map(|s| s.1.iter().filter(good).copied().collect()).collect();
        if kept.iter().all(Vec::is_empty) {
            return Err(Error::Empty { what: "reliability" });
        }
        let mut canvas = Canvas::new(960.0, &self.title);
        let count = |points: &[ReliabilityPoint]| points.iter().map(|p| p.count).sum::<usize>();
        let series = self.series.iter().zip(&kept).enumerate();
        let mut keys: Vec<_> =
            series.map(|(i, (s, own))| (Key::Dot, series_colour(i), format!("{} ({})", s.0, count(own)))).collect();
        keys.push((Key::Dash, BLACK, "correct probabilities".into()));
        let top = 74.0 + canvas.legend(58.0, &keys);
        let axes = Axes::new([120.0, top, WIDTH - 160.0, 870.0 - top], (0.0, 1.0), (0.0, 1.0));
        axes.draw(&mut canvas, "mean probability given", "share that was within 5 degrees");
        canvas.line(axes.at(0.0, 0.0), axes.at(1.0, 1.0), BLACK, 2.0, true);
        for (i, points) in kept.iter().enumerate() {
            for point in points {
                let [low, high] = wilson(point.right, point.count);
                canvas.line(axes.at(point.said, low), axes.at(point.said, high), series_colour(i), 3.0, false);
            }
            let at: Vec<(f64, f64)> = points.iter().map(|point| axes.at(point.said, point.right)).collect();
            canvas.dots(&at, 9.0, series_colour(i), 1.0);
            canvas.polyline(at, series_colour(i), 1.5);
        }
        canvas.save(stem, format)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_shares_are_wilsons() {
        // Half of 100: 0.5 +- 0.5 / sqrt(101). None of 4: up to 1 / (4 + 1).
        let [low, high] = wilson(0.5, 100);
        assert!((high - 0.5 - 0.5 / 101f64.sqrt()).abs() < 1e-12 && (low + high - 1.0).abs() < 1e-12);
        let [low, high] = wilson(0.0, 4);
        assert!(low.abs() < 1e-12 && (high - 0.2).abs() < 1e-12, "{low} {high}");
    }
}
