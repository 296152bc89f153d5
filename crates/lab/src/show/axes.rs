//! Axes: data to pixels, grids, ticks and labels.
use super::canvas::{BLACK, Canvas, FONT, PALE};
use kuva::render::render::TextAnchor;

/// A rectangle of pixels and the ranges of data that it shows.
#[derive(Clone)]
pub(super) struct Axes {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
    pub x: (f64, f64),
    pub y: (f64, f64),
    pub log_x: bool,
    pub log_y: bool,
    /// Ticks of y instead of the round ones.
    pub y_ticks: Option<Vec<(f64, String)>>,
    pub x_ticks: Option<Vec<(f64, String)>>,
}

fn fraction(v: f64, range: (f64, f64), log: bool) -> f64 {
    if log { (v / range.0).ln() / (range.1 / range.0).ln() } else { (v - range.0) / (range.1 - range.0) }
}

impl Axes {
    pub(super) fn new(frame: [f64; 4], x: (f64, f64), y: (f64, f64)) -> Self {
        let [left, top, width, height] = frame;
        Self { left, top, width, height, x, y, log_x: false, log_y: false, y_ticks: None, x_ticks: None }
    }

    /// Pixel of a point.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let (u, v) = (fraction(x, self.x, self.log_x), fraction(y, self.y, self.log_y));
        (self.left + u * self.width, self.top + (1.0 - v) * self.height)
    }

    /// Widens one range so that a metre is equally long in x and y.
    pub(super) fn equal_aspect(mut self) -> Self {
        let per_px = ((self.x.1 - self.x.0) / self.width).max((self.y.1 - self.y.0) / self.height);
        let widen = |r: (f64, f64), px: f64| ((r.0 + r.1 - px * per_px) / 2.0, (r.0 + r.1 + px * per_px) / 2.0);
        (self.x, self.y) = (widen(self.x, self.width), widen(self.y, self.height));
        self
    }

    /// Grid, frame, ticks and axis labels; drawn first, below the data.
    pub(super) fn draw(&self, canvas: &mut Canvas, x_label: &str, y_label: &str) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        let x_ticks = self.x_ticks.clone().unwrap_or_else(|| ticks(self.x, self.log_x, (self.width / 110.0) as usize));
        for (v, name) in x_ticks {
            let x = self.at(v, self.y.0).0;
            canvas.line((x, self.top), (x, bottom), PALE, 1.0, false);
            canvas.line((x, bottom), (x, bottom + 7.0), BLACK, 1.5, false);
            canvas.text((x, bottom + 31.0), &name, FONT - 2, TextAnchor::Middle, BLACK);
        }
        let y_ticks = self.y_ticks.clone().unwrap_or_else(|| ticks(self.y, self.log_y, (self.height / 45.0) as usize));
        for (v, name) in y_ticks {
            let y = self.at(self.x.0, v).1;
            canvas.line((self.left, y), (right, y), PALE, 1.0, false);
            canvas.line((self.left - 7.0, y), (self.left, y), BLACK, 1.5, false);
            canvas.text((self.left - 12.0, y + 7.0), &name, FONT - 2, TextAnchor::End, BLACK);
        }
        let corners = [(self.left, self.top), (right, self.top), (right, bottom), (self.left, bottom)];
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            canvas.line(*from, *to, BLACK, 1.5, false);
        }
        self.under(canvas, x_label, 0.0);
        // Horizontal, above the axis: kuva smears rotated letters.
        canvas.text(((self.left - 82.0).max(20.0), self.top - 11.0), y_label, FONT - 2, TextAnchor::Start, BLACK);
    }
}

impl Axes {
    /// The label of x, lowered by this many pixels.
    pub(super) fn under(&self, canvas: &mut Canvas, x_label: &str, further: f64) {
        let at = (self.left + self.width / 2.0, self.top + self.height + 64.0 + further);
        canvas.text(at, x_label, FONT, TextAnchor::Middle, BLACK);
    }
}

/// About `n` round tick values inside `range`, with their labels.
fn ticks(range: (f64, f64), log: bool, n: usize) -> Vec<(f64, String)> {
    let inside = |v: f64| v >= range.0 * (1.0 - 1e-9) && v <= range.1 * (1.0 + 1e-9);
    if log {
        let (low, high) = (range.0.log10().floor() as i32, range.1.log10().ceil() as i32);
        let steps: &[f64] = if high - low <= 3 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let every = (high - low) as usize / n.max(2) + 1;
        let all = (low..=high).step_by(every).flat_map(|k| steps.iter().map(move |s| s * 10f64.powi(k)));
        let round: Vec<_> = all.filter(|v| inside(*v)).map(|v| (v, log_name(v))).collect();
        if round.len() > 1 {
            return round;
        }
        // Less than a decade: even steps, as on a linear axis.
    }
    let rough = (range.1 - range.0) / n.max(2) as f64;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].iter().map(|s| s * decade).find(|s| *s >= rough).unwrap_or(decade * 10.0);
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (range.0 / step - 1e-9).ceil();
    let count = ((range.1 / step + 1e-9).floor() - first).clamp(0.0, 100.0) as usize;
    (0..=count).map(|i| (first + i as f64) * step).map(|v| (v, format!("{:.decimals$}", v + 0.0))).collect()
}

fn log_name(v: f64) -> String {
    if (1e-4..1e6).contains(&v) { format!("{}", (v * 1e6).round() / 1e6) } else { format!("{v:.0e}") }
}

/// Smallest and largest finite value, never equal; `pad` is the share added on both sides.
pub(super) fn extent(values: impl Iterator<Item = f64>, pad: f64) -> Option<(f64, f64)> {
    let seen = values
        .filter(|v| v.is_finite())
        .fold(None, |r: Option<(f64, f64)>, v| Some(r.map_or((v, v), |(low, high)| (low.min(v), high.max(v)))));
    let (low, high) = seen?;
    let least = 1e-9_f64.max(low.abs().max(high.abs()) * 1e-9);
    let (low, high) = if high - low < least { (low - least.max(0.5), high + least.max(0.5)) } else { (low, high) };
    let more = (high - low) * pad;
    Some((low - more, high + more))
}

/// As [`extent`], for a log axis: positive values only, padded by a factor.
pub(super) fn extent_log(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let logs = values.filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10);
    extent(logs, 0.05).map(|(low, high)| (10f64.powf(low), 10f64.powf(high)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_has_at_least_two_ticks_in_its_range() {
        let ranges = [(0.29, 0.43), (1.01, 1.99), (0.03, 40.0), (1e-9, 1e3), (2.1, 4.9)];
        for (range, log) in ranges.iter().flat_map(|range| [(*range, false), (*range, true)]) {
            let found = ticks(range, log, 8);
            assert!(found.len() > 1, "{range:?} {log}: {found:?}");
            // To less than a pixel.
            let slack = 1e-6 * (range.1 - range.0);
            assert!(found.iter().all(|(v, _)| (range.0 - slack..=range.1 + slack).contains(v)), "{range:?}: {found:?}");
        }
        let names: Vec<String> = ticks((0.29, 0.43), true, 4).into_iter().map(|tick| tick.1).collect();
        assert_eq!(names, ["0.30", "0.35", "0.40"]);
    }
}
