//! Lines, text, legends and marks on kuva's scene, with axes, written as PNG and SVG. Pixels, y down.

use super::ending;
use crate::Failure;
use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};
use std::path::{Path, PathBuf};

pub(super) type Rgb = (u8, u8, u8);
pub(super) const BLACK: Rgb = (30, 30, 30);
pub(super) const GREY: Rgb = (120, 120, 120);
pub(super) const PALE: Rgb = (222, 222, 222);
pub(super) const BLUE: Rgb = (0, 114, 178);
pub(super) const ORANGE: Rgb = (230, 159, 0);
pub(super) const GREEN: Rgb = (0, 158, 115);
pub(super) const RED: Rgb = (213, 94, 0);
pub(super) const PURPLE: Rgb = (204, 121, 167);
pub(super) const SKY: Rgb = (86, 180, 233);
/// Colours of series in order (Okabe and Ito 2008).
const SERIES: [Rgb; 6] = [BLUE, RED, GREEN, PURPLE, ORANGE, SKY];
pub(super) const WIDTH: f64 = 1200.0;
const FONT: u32 = 22;

/// The colour of series `i`; they repeat after six.
pub(super) fn series_colour(i: usize) -> Rgb {
    SERIES.get(i % SERIES.len()).copied().unwrap_or(BLACK)
}

/// How a legend entry looks.
#[derive(Clone, Copy)]
pub(super) enum Key {
    Dot,
    Ring,
    Line,
    Dash,
    Area,
}

pub(super) struct Canvas(Scene);

/// Number of points from which [`Canvas::cloud`] uses bins, and the size of a bin, pixels.
const BINNED_FROM: usize = 4_000;
const BIN_PX: f64 = 3.0;

fn colour(c: Rgb) -> Color {
    Color::Rgb(c.0, c.1, c.2)
}

/// A text of at most `most` letters: a longer one loses its middle.
fn shortened(text: &str, most: usize) -> String {
    let n = text.chars().count();
    if n <= most {
        return text.to_owned();
    }
    let half = most.saturating_sub(3) / 2;
    text.chars().take(half).chain("...".chars()).chain(text.chars().skip(n - half)).collect()
}

impl Canvas {
    pub(super) fn new(height: f64, title: &str) -> Self {
        let mut scene = Scene::new(WIDTH, height);
        scene.font_family = Some("DejaVu Sans, Verdana, sans-serif".into());
        let mut canvas = Self(scene);
        // A character is 0.6 of its size wide.
        let title = shortened(title, 140);
        let size = (WIDTH - 20.0) / (0.6 * title.chars().count().max(1) as f64);
        canvas.text((WIDTH / 2.0, 42.0), &title, size.clamp(14.0, 28.0) as u32, TextAnchor::Middle, BLACK);
        canvas
    }

    /// Makes it at least this high.
    pub(super) fn grow_to(&mut self, height: f64) {
        self.0.height = self.0.height.max(height);
    }

    pub(super) fn line(&mut self, from: (f64, f64), to: (f64, f64), c: Rgb, width: f64, dash: bool) {
        self.0.elements.push(Primitive::Line {
            x1: from.0,
            y1: from.1,
            x2: to.0,
            y2: to.1,
            stroke: colour(c),
            stroke_width: width,
            stroke_dasharray: dash.then(|| "10,7".into()),
        });
    }

    pub(super) fn polyline(&mut self, points: Vec<(f64, f64)>, c: Rgb, width: f64) {
        let stroke = colour(c);
        self.0.elements.push(Primitive::PolyLine { points, stroke, stroke_width: width, stroke_dasharray: None });
    }

    pub(super) fn dots(&mut self, points: &[(f64, f64)], r: f64, c: Rgb, opacity: f64) {
        let (cx, cy) = points.iter().copied().unzip();
        let (fill_opacity, fill) = (Some(opacity), colour(c));
        self.0.elements.push(Primitive::CircleBatch {
            cx,
            cy,
            r,
            fill,
            fill_opacity,
            stroke: None,
            stroke_width: None,
        });
    }

    pub(super) fn ring(&mut self, at: (f64, f64), r: f64, c: Rgb, width: f64) {
        self.0.elements.push(Primitive::Circle {
            cx: at.0,
            cy: at.1,
            r,
            fill: Color::None,
            fill_opacity: None,
            stroke: Some(colour(c)),
            stroke_width: Some(width),
        });
    }

    pub(super) fn polygon(&mut self, points: &[(f64, f64)], c: Rgb, opacity: f64) {
        let mut d = String::new();
        for (i, p) in points.iter().enumerate() {
            d += &format!("{}{:.2},{:.2} ", if i == 0 { "M" } else { "L" }, p.0, p.1);
        }
        self.0.elements.push(Primitive::Path(Box::new(PathData {
            d: d + "Z",
            fill: Some(colour(c)),
            stroke: Color::None,
            stroke_width: 0.0,
            opacity: Some(opacity),
            stroke_dasharray: None,
        })));
    }

    pub(super) fn cells(&mut self, cells: impl Iterator<Item = ([f64; 4], Rgb)>) {
        let (mut x, mut y, mut w, mut h, mut fills) = (vec![], vec![], vec![], vec![], vec![]);
        for (rect, c) in cells {
            x.push(rect[0]);
            y.push(rect[1]);
            w.push(rect[2]);
            h.push(rect[3]);
            fills.push(colour(c));
        }
        self.0.elements.push(Primitive::RectBatch { x, y, w, h, fills });
    }

    pub(super) fn text(&mut self, at: (f64, f64), content: &str, size: u32, anchor: TextAnchor, c: Rgb) {
        // A dollar sign starts a formula in kuva.
        let (content, color) = (content.replace('$', "\\$"), Some(colour(c)));
        let rotate = None;
        self.0.elements.push(Primitive::Text { x: at.0, y: at.1, content, size, anchor, rotate, bold: false, color });
    }

    /// Text on a white background, readable over lines.
    pub(super) fn backed_text(&mut self, at: (f64, f64), content: &str, size: u32, anchor: TextAnchor) {
        // DejaVu Sans: words are about 0.53 em wide per letter, digits 0.64.
        let letter = |c: char| if c.is_ascii_digit() || c.is_uppercase() { 0.64 } else { 0.53 };
        let width = f64::from(size) * content.chars().map(letter).sum::<f64>();
        let x = match anchor {
            TextAnchor::Start => at.0,
            TextAnchor::Middle => at.0 - width / 2.0,
            TextAnchor::End => at.0 - width,
        };
        let (y, height, opacity) = (at.1 - 0.85 * f64::from(size), 1.15 * f64::from(size), Some(0.8));
        let fill = colour((255, 255, 255));
        self.0.elements.push(Primitive::Rect { x, y, width, height, fill, stroke: None, stroke_width: None, opacity });
        self.text(at, content, size, anchor, BLACK);
    }

    /// Legend rows centred below `y`, outside the axes; returns their height.
    pub(super) fn legend(&mut self, y: f64, entries: &[(Key, Rgb, String)]) -> f64 {
        let entries: Vec<_> = entries.iter().map(|(key, colour, name)| (*key, *colour, shortened(name, 85))).collect();
        let width = |e: &(Key, Rgb, String)| 80.0 + 12.5 * e.2.chars().count() as f64;
        let mut rows: Vec<Vec<&(Key, Rgb, String)>> = vec![vec![]];
        let mut used = 0.0;
        for e in &entries {
            if used + width(e) > self.0.width - 40.0 && used > 0.0 {
                rows.push(vec![]);
                used = 0.0;
            }
            used += width(e);
            if let Some(row) = rows.last_mut() {
                row.push(e);
            }
        }
        for (i, row) in rows.iter().enumerate() {
            let mut x = (self.0.width - row.iter().map(|e| width(e)).sum::<f64>()) / 2.0 + 10.0;
            let y = y + 20.0 + 32.0 * i as f64;
            for e in row {
                match e.0 {
                    Key::Dot => self.dots(&[(x + 20.0, y - 7.0)], 7.0, e.1, 1.0),
                    Key::Ring => self.ring((x + 20.0, y - 7.0), 7.0, e.1, 2.0),
                    Key::Line => self.line((x, y - 7.0), (x + 40.0, y - 7.0), e.1, 4.0, false),
                    Key::Dash => self.line((x, y - 7.0), (x + 40.0, y - 7.0), e.1, 3.0, true),
                    Key::Area => {
                        let corners = [(x, y - 16.0), (x + 40.0, y - 16.0), (x + 40.0, y + 2.0), (x, y + 2.0)];
                        self.polygon(&corners, e.1, 0.35);
                    }
                }
                self.text((x + 50.0, y), &e.2, FONT - 2, TextAnchor::Start, BLACK);
                x += width(e);
            }
        }
        32.0 * rows.len() as f64
    }

    /// Points of `series` as dots; from [`BINNED_FROM`] points on, as cells of one pixel grid that are darker the more points they
    /// hold.
    pub(super) fn cloud(&mut self, a: &Axes, points: &[(f64, f64)], r: f64, c: Rgb, opacity: f64) {
        if points.len() < BINNED_FROM {
            self.dots(points, r, c, opacity);
            return;
        }
        let (columns, rows) = ((a.width / BIN_PX) as usize + 1, (a.height / BIN_PX) as usize + 1);
        let mut counts = vec![0_u32; columns * rows];
        for p in points {
            let (x, y) = ((p.0 - a.left) / BIN_PX, (p.1 - a.top) / BIN_PX);
            if x >= 0.0 && y >= 0.0 && x < columns as f64 && y < rows as f64 {
                counts[y as usize * columns + x as usize] += 1;
            }
        }
        let most = f64::from(counts.iter().copied().max().unwrap_or(1).max(1));
        let cells = counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(i, count)| {
            let share = 0.25 + 0.75 * (f64::from(*count) / most).sqrt();
            let mix = |own: u8| (255.0 - share * (255.0 - f64::from(own))).round() as u8;
            let at = [a.left + (i % columns) as f64 * BIN_PX, a.top + (i / columns) as f64 * BIN_PX, BIN_PX, BIN_PX];
            (at, (mix(c.0), mix(c.1), mix(c.2)))
        });
        self.cells(cells);
    }

    /// Draws, and clips what leaves the axes.
    pub(super) fn clipped(&mut self, a: &Axes, draw: impl FnOnce(&mut Self)) {
        let id = format!("clip{}", self.0.elements.len());
        // SVG defines the region separately from its use.
        let (x, y, width, height) = (a.left, a.top, a.width, a.height);
        let rect = format!("<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"/>");
        self.0.defs.push(format!("<clipPath id=\"{id}\">{rect}</clipPath>"));
        self.0.elements.push(Primitive::ClipStart { x: a.left, y: a.top, width: a.width, height: a.height, id });
        draw(self);
        self.0.elements.push(Primitive::ClipEnd);
    }

    /// The text of an SVG.
    pub(super) fn svg(&self) -> String {
        SvgBackend::new().render_scene(&self.0)
    }

    /// Writes a picture as PNG and SVG: `stem` with these endings.
    pub(super) fn save(self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        let fail = |path: &Path| {
            let path = path.display().to_string();
            move |error| format!("cannot write {path}: {error}; check the folder and its rights")
        };
        if let Some(folder) = stem.parent() {
            std::fs::create_dir_all(folder).map_err(fail(folder))?;
        }
        let png = RasterBackend::new()
            .with_scale(1.0)
            .render_scene(&self.0)
            .map_err(|error| format!("drawing failed: {error}"))?;
        let svg = self.svg().into_bytes();
        let write = |(kind, bytes): (&str, Vec<u8>)| {
            let path = ending(stem, kind);
            std::fs::write(&path, bytes).map_err(fail(&path))?;
            Ok(path)
        };
        [(".png", png), (".svg", svg)].into_iter().map(write).collect()
    }
}

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
    /// Ticks of y instead of the round ones.
    pub y_ticks: Option<Vec<(f64, String)>>,
}

fn fraction(v: f64, range: (f64, f64), log: bool) -> f64 {
    if log { (v / range.0).ln() / (range.1 / range.0).ln() } else { (v - range.0) / (range.1 - range.0) }
}

impl Axes {
    pub(super) fn new(frame: [f64; 4], x: (f64, f64), y: (f64, f64)) -> Self {
        let [left, top, width, height] = frame;
        Self { left, top, width, height, x, y, log_x: false, y_ticks: None }
    }

    /// Pixel of a point.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let (u, v) = (fraction(x, self.x, self.log_x), fraction(y, self.y, false));
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
        let x_ticks = ticks(self.x, self.log_x, (self.width / 110.0) as usize);
        for (v, name) in x_ticks {
            let x = self.at(v, self.y.0).0;
            canvas.line((x, self.top), (x, bottom), PALE, 1.0, false);
            canvas.line((x, bottom), (x, bottom + 7.0), BLACK, 1.5, false);
            canvas.text((x, bottom + 31.0), &name, FONT - 2, TextAnchor::Middle, BLACK);
        }
        let y_ticks = self.y_ticks.clone().unwrap_or_else(|| ticks(self.y, false, (self.height / 45.0) as usize));
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
