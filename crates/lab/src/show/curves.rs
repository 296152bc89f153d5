//! Error distributions and benchmark curves.
use super::axes::{Axes, extent, extent_log};
use super::canvas::{Canvas, Key, WIDTH, series_colour};
use super::{Error, Format};
use csi5300::maths::percentile;
use std::path::{Path, PathBuf};

/// Empirical distribution functions over a logarithmic x axis.
#[derive(Debug, Clone, Default)]
pub struct CdfPlot {
    /// Headline.
    pub title: String,
    /// Quantity and unit, for example "bearing error (degrees)".
    pub x_label: String,
    /// Name and errors of each series, in any order. Magnitudes are drawn; an exact zero is at the left edge.
    pub series: Vec<(String, Vec<f64>)>,
    /// Name and known points (error, share) of others' distributions, dashed, in the colours of the series in their order.
    pub known: Vec<(String, Vec<(f64, f64)>)>,
}

/// A known distribution with at most this many points is drawn as points, a longer one as steps.
const FEW: usize = 2;

impl CdfPlot {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let sizes = |v: &[f64]| {
            let mut sizes: Vec<f64> = v.iter().map(|x| x.abs()).filter(|x| x.is_finite()).collect();
            sizes.sort_by(f64::total_cmp);
            sizes
        };
        let sorted: Vec<Vec<f64>> = self.series.iter().map(|s| sizes(&s.1)).collect();
        // Errors that are all zero have no place on a log axis: they are drawn at the edge of an arbitrary decade.
        let zeros = sorted.iter().any(|v| !v.is_empty()).then_some((0.1, 1.0));
        let points = self.known.iter().flat_map(|known| known.1.iter().map(|point| point.0));
        let range = extent_log(sorted.iter().flatten().copied().chain(points)).or(zeros);
        let range = range.ok_or(Error::Empty { what: "error distribution" })?;
        let mut canvas = Canvas::new(780.0, &self.title);
        let median = |v: &[f64]| match v {
            [] => String::new(),
            _ => format!(" (median {:.2})", percentile(v, 0.5)),
        };
        let keys = self.series.iter().zip(&sorted).enumerate();
        let mut keys: Vec<_> =
            keys.map(|(i, (s, v))| (Key::Line, series_colour(i), s.0.clone() + &median(v))).collect();
        let known = self.known.iter().enumerate().filter(|(_, known)| !known.1.is_empty());
        keys.extend(known.map(|(i, known)| (Key::Dash, series_colour(i), known.0.clone())));
        let top = 74.0 + canvas.legend(58.0, &keys);
        let mut axes = Axes::new([120.0, top, WIDTH - 160.0, 690.0 - top], range, (0.0, 1.02));
        axes.log_x = true;
        axes.draw(&mut canvas, &self.x_label, "cumulative share");
        for (i, values) in sorted.iter().enumerate() {
            let n = values.len() as f64;
            let stairs = values.iter().enumerate().flat_map(|(k, &v)| {
                let v = v.max(range.0);
                [axes.at(v, k as f64 / n), axes.at(v, (k + 1) as f64 / n)]
            });
            let end = (!values.is_empty()).then(|| axes.at(range.1, 1.0));
            canvas.polyline(stairs.chain(end).collect(), series_colour(i), 3.0);
        }
        for (i, known) in self.known.iter().enumerate() {
            let points: Vec<_> = known.1.iter().map(|&(error, share)| axes.at(error, share)).collect();
            points.windows(2).for_each(|pair| canvas.line(pair[0], pair[1], series_colour(i), 2.0, true));
            // A complete distribution is a line; a few points of one are points.
            if points.len() <= FEW {
                canvas.dots(&points, 6.0, series_colour(i), 1.0);
            }
        }
        canvas.save(stem, format)
    }
}

/// Points, joined by lines if requested, on linear or logarithmic axes.
#[derive(Debug, Clone, Default)]
pub struct ScatterLines {
    /// Headline.
    pub title: String,
    /// Quantity and unit of x.
    pub x_label: String,
    /// Quantity and unit of y.
    pub y_label: String,
    /// Logarithmic x; drops values of zero and below.
    pub log_x: bool,
    /// Logarithmic y; drops values of zero and below.
    pub log_y: bool,
    /// Name and points of each series, in the line's order.
    pub series: Vec<(String, Vec<(f64, f64)>)>,
    /// Whether the points of a series are joined.
    pub lines: bool,
}

impl ScatterLines {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let fits = |v: f64, log: bool| v.is_finite() && (!log || v > 0.0);
        let good = |p: &&(f64, f64)| fits(p.0, self.log_x) && fits(p.1, self.log_y);
        let kept: Vec<Vec<(f64, f64)>> =
            self.series.iter().map(|s| s.1.iter().filter(good).copied().collect()).collect();
        let range = |log: bool, pick: fn(&(f64, f64)) -> f64| {
            let values = kept.iter().flatten().map(pick);
            if log { extent_log(values) } else { extent(values, 0.05) }.ok_or(Error::Empty { what: "points" })
        };
        let (x, y) = (range(self.log_x, |p| p.0)?, range(self.log_y, |p| p.1)?);
        let mut canvas = Canvas::new(780.0, &self.title);
        let keys: Vec<_> =
            self.series.iter().enumerate().map(|(i, s)| (Key::Dot, series_colour(i), s.0.clone())).collect();
        let top = 74.0 + canvas.legend(58.0, &keys);
        let mut axes = Axes::new([130.0, top, WIDTH - 170.0, 690.0 - top], x, y);
        (axes.log_x, axes.log_y) = (self.log_x, self.log_y);
        axes.draw(&mut canvas, &self.x_label, &self.y_label);
        for (i, points) in kept.iter().enumerate() {
            let px: Vec<_> = points.iter().map(|p| axes.at(p.0, p.1)).collect();
            canvas.dots(&px, 7.0, series_colour(i), 0.9);
            if self.lines {
                canvas.polyline(px, series_colour(i), 2.5);
            }
        }
        canvas.save(stem, format)
    }
}
