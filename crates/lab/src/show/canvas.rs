//! Lines, text, legends and marks on kuva's scene, which is written as PNG and SVG. Pixels, y down.
use super::Error;
use super::axes::Axes;
use super::format::{Format, write_whole};
use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};
use std::io::Write;
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
pub(super) const SERIES: [Rgb; 6] = [BLUE, RED, GREEN, PURPLE, ORANGE, SKY];
pub(super) const WIDTH: f64 = 1200.0;
pub(super) const FONT: u32 = 22;

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

impl Canvas {
    pub(super) fn new(height: f64, title: &str) -> Self {
        Self::sized(WIDTH, height, title)
    }

    pub(super) fn sized(width: f64, height: f64, title: &str) -> Self {
        let mut scene = Scene::new(width, height);
        scene.font_family = Some("DejaVu Sans, Verdana, sans-serif".into());
        let mut canvas = Self(scene);
        // A character is 0.6 of its size wide.
        let size = (width - 20.0) / (0.6 * title.chars().count().max(1) as f64);
        canvas.text((width / 2.0, 42.0), title, size.clamp(14.0, 28.0) as u32, TextAnchor::Middle, BLACK);
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
        let width = |e: &(Key, Rgb, String)| 80.0 + 12.5 * e.2.chars().count() as f64;
        let mut rows: Vec<Vec<&(Key, Rgb, String)>> = vec![vec![]];
        let mut used = 0.0;
        for e in entries {
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

    /// Writes a picture in the requested formats; a name without a folder means the current one.
    pub(super) fn save(self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        format.check(&[stem.to_owned()])?;
        let fail = |path: &Path| {
            let path = path.to_owned();
            move |source| Error::Io { path, source }
        };
        if let Some(folder) = stem.parent() {
            std::fs::create_dir_all(folder).map_err(fail(folder))?;
        }
        let files = format.files(stem);
        let png = RasterBackend::new().with_scale(1.0).render_scene(&self.0).map_err(Error::Drawing)?;
        let svg = SvgBackend::new().render_scene(&self.0).into_bytes();
        for (path, bytes) in files.iter().zip([png, svg]) {
            write_whole(path, |file| file.write_all(&bytes)).map_err(fail(path))?;
        }
        Ok(files.to_vec())
    }
}
