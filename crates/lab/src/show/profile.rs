//! Bartlett profiles over azimuth, and over azimuth and elevation.
use super::axes::Axes;
use super::canvas::{BLACK, BLUE, Canvas, GREEN, GREY, Key, PALE, RED, Rgb, series_colour};
use super::{Error, Format};
use crate::words::fixed;
use csi5300::maths::wrap_rad;
use kuva::plot::ColorMap;
use kuva::render::render::TextAnchor;
use std::path::{Path, PathBuf};

/// Polar profiles: azimuth 0 is +x to the right, counter-clockwise; the radius is linear, each series relative to its own
/// maximum. Beside them, an enlarged view around the answer (or the truth, or the maximum).
#[derive(Debug, Clone, Default)]
pub struct ProfilePlot {
    /// Headline.
    pub title: String,
    /// Name, azimuths (degrees, rising) and values (linear, not dB) of the curve from which the answer was chosen: drawn thick.
    pub chosen_from: (String, Vec<f64>, Vec<f64>),
    /// Other curves, in the same form, drawn thin below it.
    pub others: Vec<(String, Vec<f64>, Vec<f64>)>,
    /// Azimuths of the candidates marked on the thick curve, degrees.
    pub candidates_deg: Vec<f64>,
    /// The answer, degrees.
    pub answer_deg: Option<f64>,
    /// Its predicted standard deviation, degrees: an error bar of one to each side.
    pub answer_sd_deg: Option<f64>,
    /// True azimuth, degrees.
    pub truth_deg: Option<f64>,
    /// Mirror azimuth, degrees.
    pub mirror_deg: Option<f64>,
}

const CENTRE: (f64, f64) = (390.0, 520.0);
const RADIUS: f64 = 310.0;
/// Position and size of the enlarged view, pixels.
const ENLARGED: [f64; 4] = [820.0, 210.0, 340.0, 620.0];
/// Least and largest half width of the enlarged view, degrees.
const HALF_WIDTH_DEG: (f64, f64) = (6.0, 60.0);

/// Points of one series, largest value 1.
type Curve = Vec<(f64, f64)>;

fn polar(azimuth_deg: f64, radius: f64) -> (f64, f64) {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    (CENTRE.0 + RADIUS * radius * cos, CENTRE.1 - RADIUS * radius * sin)
}

/// The finite points of a series relative to its maximum; `None` if no value is above 0.
fn relative(series: &(String, Vec<f64>, Vec<f64>)) -> Result<Option<Curve>, Error> {
    let (_, azimuths, values) = series;
    if azimuths.len() != values.len() {
        return Err(Error::Length { what: "profile values", expect: azimuths.len(), got: values.len() });
    }
    let points = azimuths.iter().copied().zip(values.iter().copied());
    let curve: Curve = points.filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    let top = curve.iter().map(|p| p.1).fold(0.0, f64::max);
    Ok((top > 0.0).then(|| curve.iter().map(|p| (p.0, (p.1 / top).max(0.0))).collect()))
}

/// Height of a curve at an azimuth, interpolated between the nearest points.
fn height(curve: &Curve, azimuth_deg: f64) -> f64 {
    let offset = |p: &(f64, f64)| wrap_deg(p.0 - azimuth_deg);
    let below = curve.iter().filter(|p| offset(p) <= 0.0).max_by(|a, b| offset(a).total_cmp(&offset(b)));
    let above = curve.iter().filter(|p| offset(p) >= 0.0).min_by(|a, b| offset(a).total_cmp(&offset(b)));
    match (below, above) {
        (Some(a), Some(b)) if offset(b) > offset(a) => a.1 - (b.1 - a.1) * offset(a) / (offset(b) - offset(a)),
        (Some(p), _) | (_, Some(p)) => p.1,
        _ => 0.0,
    }
}

fn wrap_deg(degrees: f64) -> f64 {
    wrap_rad(degrees.to_radians()).to_degrees()
}

impl ProfilePlot {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let chosen = relative(&self.chosen_from)?.ok_or(Error::Empty { what: "profile" })?;
        let mut others = Vec::new();
        for (i, series) in self.others.iter().enumerate() {
            others.extend(relative(series)?.map(|curve| (self.colour_of_other(i), curve)));
        }
        let mut canvas = Canvas::new(950.0, &self.title);
        canvas.legend(58.0, &self.keys());
        draw_grid(&mut canvas);
        let rays = [(self.truth_deg, GREEN, 7.0, false), (self.mirror_deg, GREY, 3.0, true)];
        for (azimuth, colour, width, dash) in rays {
            if let Some(azimuth) = azimuth.filter(|azimuth| azimuth.is_finite()) {
                canvas.line(CENTRE, polar(azimuth, 1.0), colour, width, dash);
            }
        }
        for (colour, curve) in &others {
            canvas.polyline(around(curve), *colour, 1.5);
        }
        canvas.polyline(around(&chosen), BLUE, 3.5);
        let candidates: Vec<f64> = self.candidates_deg.iter().copied().filter(|azimuth| azimuth.is_finite()).collect();
        let marks: Vec<_> = candidates.iter().map(|&azimuth| polar(azimuth, height(&chosen, azimuth))).collect();
        marks.iter().for_each(|&at| canvas.ring(at, 7.0, BLACK, 2.0));
        if let Some(answer) = self.answer() {
            canvas.line(CENTRE, polar(answer, 1.0), RED, 2.5, false);
            canvas.dots(&[polar(answer, height(&chosen, answer))], 7.0, RED, 1.0);
        }
        self.enlarged(&mut canvas, &chosen, &others, &candidates);
        canvas.save(stem, format)
    }

    fn answer(&self) -> Option<f64> {
        self.answer_deg.filter(|azimuth| azimuth.is_finite())
    }

    /// An unnamed curve belongs to the one before and has its colour.
    fn colour_of_other(&self, i: usize) -> Rgb {
        let is_named = |k: &usize| self.others.get(*k).is_some_and(|other| !other.0.is_empty());
        series_colour((0..=i).rev().find(is_named).unwrap_or(i) + 3)
    }

    fn keys(&self) -> Vec<(Key, Rgb, String)> {
        let mut keys = vec![(Key::Line, BLUE, self.chosen_from.0.clone())];
        let others = self.others.iter().enumerate().filter(|(_, other)| !other.0.is_empty());
        keys.extend(others.map(|(i, other)| (Key::Line, self.colour_of_other(i), other.0.clone())));
        if let Some(answer) = self.answer() {
            let sd = self.answer_sd_deg.filter(|sd| sd.is_finite()).map_or(String::new(), |sd| format!(" ± {sd:.2}°"));
            keys.push((Key::Dot, RED, format!("answer {}°{sd}", fixed(answer, 2))));
        }
        let mark = |azimuth: Option<f64>, key, colour, name: &str| {
            azimuth.filter(|a| a.is_finite()).map(|azimuth| (key, colour, format!("{name} {}°", fixed(azimuth, 2))))
        };
        keys.extend(mark(self.mirror_deg, Key::Dash, GREY, "mirror"));
        keys.extend(mark(self.truth_deg, Key::Line, GREEN, "truth"));
        if self.candidates_deg.len() > 1 {
            keys.push((Key::Ring, BLACK, "candidates".into()));
        }
        keys
    }

    /// The enlarged view around the answer: azimuth to the right, height upwards.
    fn enlarged(&self, canvas: &mut Canvas, chosen: &Curve, others: &[(Rgb, Curve)], candidates: &[f64]) {
        let highest = chosen.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|p| p.0);
        let Some(middle) = self.answer().or(self.truth_deg.filter(|truth| truth.is_finite())).or(highest) else {
            return;
        };
        let off = self.truth_deg.map_or(0.0, |truth| 1.3 * wrap_deg(truth - middle).abs());
        let wide = self.answer_sd_deg.filter(|sd| sd.is_finite()).map_or(0.0, |sd| 3.0 * sd);
        let half = off.max(wide).clamp(HALF_WIDTH_DEG.0, HALF_WIDTH_DEG.1);
        let mut axes = Axes::new(ENLARGED, (middle - half, middle + half), (0.0, 1.05));
        axes.y_ticks = Some((0..=4).map(|k| (0.25 * f64::from(k), format!("{}", 0.25 * f64::from(k)))).collect());
        axes.draw(canvas, "azimuth (degrees)", "enlarged: relative to the highest");
        let at = |azimuth: f64, value: f64| axes.at(middle + wrap_deg(azimuth - middle), value);
        canvas.clipped(&axes, |canvas| {
            if let Some(truth) = self.truth_deg.filter(|truth| truth.is_finite()) {
                canvas.line(at(truth, 0.0), at(truth, 1.05), GREEN, 7.0, false);
            }
            let line = |curve: &Curve| {
                let mut points: Vec<(f64, f64)> = curve.iter().map(|p| at(p.0, p.1)).collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                points
            };
            others.iter().for_each(|(colour, curve)| canvas.polyline(line(curve), *colour, 1.5));
            canvas.polyline(line(chosen), BLUE, 3.5);
            for &azimuth in candidates {
                canvas.ring(at(azimuth, height(chosen, azimuth)), 7.0, BLACK, 2.0);
            }
            if let Some(answer) = self.answer() {
                let value = height(chosen, answer);
                canvas.line(at(answer, 0.0), at(answer, value), RED, 2.5, false);
                canvas.dots(&[at(answer, value)], 7.0, RED, 1.0);
                if let Some(sd) = self.answer_sd_deg.filter(|sd| sd.is_finite()) {
                    let (left, right) = (axes.at(middle - sd, value), axes.at(middle + sd, value));
                    canvas.line(left, right, RED, 3.0, false);
                    for end in [left, right] {
                        canvas.line((end.0, end.1 - 9.0), (end.0, end.1 + 9.0), RED, 3.0, false);
                    }
                }
            }
        });
    }
}

/// A curve in pixels, closed if it covers the full circle.
fn around(curve: &Curve) -> Vec<(f64, f64)> {
    let mut px: Vec<_> = curve.iter().map(|p| polar(p.0, p.1)).collect();
    if let (Some(a), Some(b), Some(first)) = (curve.first(), curve.last(), px.first().copied())
        && (b.0 - a.0).abs() > 350.0
    {
        px.push(first);
    }
    px
}

fn draw_grid(canvas: &mut Canvas) {
    for k in 0..12 {
        let azimuth = f64::from(30 * k);
        canvas.line(CENTRE, polar(azimuth, 1.0), PALE, 1.0, false);
        let at = polar(azimuth, 1.09);
        let signed = if k > 6 { azimuth - 360.0 } else { azimuth };
        canvas.text((at.0, at.1 + 7.0), &format!("{signed:.0}°"), 20, TextAnchor::Middle, BLACK);
    }
    for k in 1..=4 {
        let r = f64::from(k) / 4.0;
        canvas.ring(CENTRE, RADIUS * r, if k == 4 { BLACK } else { PALE }, 1.5);
        let at = polar(75.0, r - 0.05);
        canvas.text(at, &format!("{r}"), 16, TextAnchor::Middle, GREY);
    }
    let words = "azimuth; radius: relative to the highest of each curve";
    canvas.text((CENTRE.0, 912.0), words, 20, TextAnchor::Middle, BLACK);
}

/// Heat map over azimuth and elevation, in dB below the peak, down to -20 dB.
#[derive(Debug, Clone, Default)]
pub struct ProfileMap {
    /// Headline.
    pub title: String,
    /// Azimuths: `n_az` cells of equal width over -180 to 180 degrees.
    pub n_az: usize,
    /// Elevations: `n_el` cells of equal height over 0 to 90 degrees.
    pub n_el: usize,
    /// `value[el][az]`, row-major, linear power.
    pub value: Vec<f64>,
}

pub(super) const FLOOR_DB: f64 = -20.0;

impl ProfileMap {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let expect = self.n_az.saturating_mul(self.n_el);
        if self.value.len() != expect {
            return Err(Error::Length { what: "profile map", expect, got: self.value.len() });
        }
        let top = self.value.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
        if top <= 0.0 {
            return Err(Error::Empty { what: "profile map" });
        }
        let mut canvas = Canvas::new(640.0, &self.title);
        let mut axes = Axes::new([120.0, 80.0, 900.0, 450.0], (-180.0, 180.0), (0.0, 90.0));
        axes.x_ticks = Some((-4..=4).map(|k| (f64::from(45 * k), format!("{}", 45 * k))).collect());
        axes.y_ticks = Some((0..=6).map(|k| (f64::from(15 * k), format!("{}", 15 * k))).collect());
        axes.draw(&mut canvas, "azimuth (degrees)", "elevation (degrees)");
        let (w, h) = (axes.width / self.n_az as f64, axes.height / self.n_el as f64);
        let finite = self.value.iter().enumerate().filter(|(_, v)| v.is_finite());
        canvas.cells(finite.map(|(i, v)| {
            let (el, az) = (i / self.n_az, i % self.n_az);
            let db = 10.0 * (v.max(0.0) / top).log10();
            let at = [axes.left + az as f64 * w, axes.top + axes.height - (el + 1) as f64 * h, w + 0.5, h + 0.5];
            (at, shade(db))
        }));
        let best = self.value.iter().position(|v| *v == top).unwrap_or(0);
        let azimuth = -180.0 + ((best % self.n_az) as f64 + 0.5) * 360.0 / self.n_az as f64;
        canvas.ring(axes.at(azimuth, ((best / self.n_az) as f64 + 0.5) * 90.0 / self.n_el as f64), 12.0, RED, 3.0);
        let scale = 128;
        let step = axes.height / f64::from(scale);
        canvas.cells((0..scale).map(|k| {
            let db = FLOOR_DB * (f64::from(k) + 0.5) / f64::from(scale);
            ([1050.0, axes.top + f64::from(k) * step, 28.0, step + 0.5], shade(db))
        }));
        for k in 0..=4 {
            let y = axes.top + axes.height * f64::from(k) / 4.0 + 7.0;
            canvas.text((1088.0, y), &format!("{} dB", -5 * k), 20, TextAnchor::Start, BLACK);
        }
        canvas.save(stem, format)
    }
}

pub(super) fn shade(db: f64) -> Rgb {
    ColorMap::Viridis.map_rgb((1.0 - db.max(FLOOR_DB) / FLOOR_DB).clamp(0.0, 1.0)).unwrap_or(PALE)
}
