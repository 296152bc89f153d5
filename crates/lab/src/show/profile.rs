//! Bartlett profiles over azimuth, and over azimuth and elevation.
use super::Error;
use super::axes::Axes;
use super::canvas::{BLACK, Canvas, GREY, Key, PALE, RED, WIDTH, series_colour};
use kuva::plot::ColorMap;
use kuva::render::render::TextAnchor;
use std::path::{Path, PathBuf};

/// Polar profiles: azimuth 0 is +x to the right, counter-clockwise; the radius is linear and the largest value of all
/// series is one.
#[derive(Debug, Clone, Default)]
pub struct ProfilePlot {
    /// Headline.
    pub title: String,
    /// Name, azimuths (degrees) and values (linear, not dB) of each series; an average goes last and on top.
    pub series: Vec<(String, Vec<f64>, Vec<f64>)>,
    /// Azimuth (degrees) and value (linear) of the peaks to mark, strongest first.
    pub peaks: Vec<(f64, f64)>,
    /// True azimuth, degrees.
    pub truth_deg: Option<f64>,
    /// Mirror azimuth, degrees.
    pub mirror_deg: Option<f64>,
}

const CENTRE: (f64, f64) = (WIDTH / 2.0, 575.0);
const RADIUS: f64 = 420.0;

fn polar(azimuth_deg: f64, radius: f64) -> (f64, f64) {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    (CENTRE.0 + RADIUS * radius * cos, CENTRE.1 - RADIUS * radius * sin)
}

impl ProfilePlot {
    /// Writes `stem.png` and `stem.svg`.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Error> {
        let good = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let mut curves: Vec<Vec<(f64, f64)>> = vec![];
        for (_, azimuth, value) in &self.series {
            if azimuth.len() != value.len() {
                return Err(Error::Length { what: "profile values", expect: azimuth.len(), got: value.len() });
            }
            curves.push(azimuth.iter().copied().zip(value.iter().copied()).filter(good).collect());
        }
        let top = curves.iter().flatten().map(|p| p.1).fold(0.0, f64::max);
        if top <= 0.0 {
            return Err(Error::Empty { what: "profile" });
        }
        let names = self.series.iter().enumerate();
        let mut keys: Vec<_> = names.map(|(i, s)| (Key::Line, series_colour(i), s.0.clone())).collect();
        let peaks: Vec<_> = self.peaks.iter().filter(|p| good(p)).collect();
        if let Some(p) = peaks.first() {
            keys.push((Key::Dot, BLACK, format!("peak {:.1}°", p.0)));
        }
        let marks = [(self.truth_deg, BLACK, "truth"), (self.mirror_deg, GREY, "mirror")];
        let marks: Vec<_> = marks.iter().filter_map(|m| Some((m.0.filter(|a| a.is_finite())?, m.1, m.2))).collect();
        keys.extend(marks.iter().map(|m| (Key::Dash, m.1, format!("{} {:.1}°", m.2, m.0))));
        let mut canvas = Canvas::new(1090.0, &self.title);
        canvas.legend(58.0, &keys);
        draw_grid(&mut canvas);
        for &(azimuth, colour, _) in &marks {
            canvas.line(CENTRE, polar(azimuth, 1.0), colour, 3.0, true);
        }
        for (i, curve) in curves.iter().enumerate() {
            let mut px: Vec<_> = curve.iter().map(|p| polar(p.0, (p.1 / top).max(0.0))).collect();
            // A profile over the whole circle is closed; one over a sector is not.
            if let (Some(a), Some(b), Some(first)) = (curve.first(), curve.last(), px.first().copied())
                && (b.0 - a.0).abs() > 350.0
            {
                px.push(first);
            }
            canvas.polyline(px, series_colour(i), if i + 1 == curves.len() { 3.5 } else { 2.0 });
        }
        for p in peaks {
            let at = polar(p.0, (p.1 / top).clamp(0.0, 1.0));
            canvas.dots(&[at], 7.0, BLACK, 1.0);
        }
        canvas.save(stem)
    }
}

fn draw_grid(canvas: &mut Canvas) {
    for k in 0..12 {
        let azimuth = f64::from(30 * k);
        canvas.line(CENTRE, polar(azimuth, 1.0), PALE, 1.0, false);
        let at = polar(azimuth, 1.07);
        canvas.text((at.0, at.1 + 7.0), &format!("{azimuth:.0}°"), 20, TextAnchor::Middle, BLACK);
    }
    for k in 1..=4 {
        let r = f64::from(k) / 4.0;
        canvas.ring(CENTRE, RADIUS * r, if k == 4 { BLACK } else { PALE }, 1.5);
        let at = polar(75.0, r - 0.05);
        canvas.text(at, &format!("{r}"), 16, TextAnchor::Middle, GREY);
    }
    canvas.text((CENTRE.0, 1078.0), "azimuth; radius: power relative to the peak", 22, TextAnchor::Middle, BLACK);
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
    /// Writes `stem.png` and `stem.svg`.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Error> {
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
        canvas.save(stem)
    }
}

pub(super) fn shade(db: f64) -> (u8, u8, u8) {
    ColorMap::Viridis.map_rgb((1.0 - db.max(FLOOR_DB) / FLOOR_DB).clamp(0.0, 1.0)).unwrap_or(PALE)
}
