//! Maps of the apparent sources: azimuth against one more coordinate.
use super::axes::Axes;
use super::canvas::{BLACK, Canvas, GREEN, Key, RED, WIDTH};
use super::profile::{FLOOR_DB, shade};
use super::{Error, Format};
use crate::words::fixed;
use kuva::render::render::TextAnchor;
use std::path::{Path, PathBuf};

/// Heat map over azimuth (full circle) and another coordinate, in dB below the maximum, down to -20 dB.
#[derive(Debug, Clone, Default)]
pub struct PlaceMap {
    /// Headline.
    pub title: String,
    /// The other coordinate and its unit.
    pub y_label: String,
    /// Its value at the lower and upper edge.
    pub y: (f64, f64),
    /// Its ticks; round ones if empty.
    pub y_ticks: Vec<(f64, String)>,
    /// Cells over azimuth, of equal width over -180 to 180 degrees.
    pub n_az: usize,
    /// `value[row][az]`, row-major from the lower edge on, linear power.
    pub value: Vec<f64>,
    /// Numbered places, the answer first: azimuth (degrees) and the other coordinate.
    pub marks: Vec<(f64, f64)>,
    /// True azimuth, degrees.
    pub truth_deg: Option<f64>,
}

/// Height of the numbers of places, pixels.
const NUMBER_PX: u32 = 18;

/// Position of a place's number: above its ring, or below it if it would leave the frame.
fn numbered(at: (f64, f64), axes: &Axes) -> (f64, f64) {
    let above = at.1 - 16.0;
    let is_within = above - f64::from(NUMBER_PX) >= axes.top;
    (at.0, if is_within { above } else { at.1 + 14.0 + f64::from(NUMBER_PX) })
}

impl PlaceMap {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let rows = self.value.len() / self.n_az.max(1);
        if rows * self.n_az != self.value.len() {
            let expect = rows * self.n_az;
            return Err(Error::Length { what: "map of places", expect, got: self.value.len() });
        }
        let top = self.value.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
        if top <= 0.0 {
            return Err(Error::Empty { what: "map of places" });
        }
        let mut canvas = Canvas::new(700.0, &self.title);
        let mut keys = vec![(Key::Dot, RED, "candidates, 1 is the answer".to_owned())];
        if let Some(truth) = self.truth_deg {
            keys.push((Key::Dash, GREEN, format!("truth {}°", fixed(truth, 1))));
        }
        let head = 74.0 + canvas.legend(58.0, &keys);
        let mut axes = Axes::new([130.0, head, WIDTH - 300.0, 600.0 - head], (-180.0, 180.0), self.y);
        axes.x_ticks = Some((-4..=4).map(|k| (f64::from(45 * k), format!("{}", 45 * k))).collect());
        axes.y_ticks = (!self.y_ticks.is_empty()).then(|| self.y_ticks.clone());
        axes.draw(&mut canvas, "azimuth (degrees)", &self.y_label);
        let (w, h) = (axes.width / self.n_az as f64, axes.height / rows as f64);
        let finite = self.value.iter().enumerate().filter(|(_, v)| v.is_finite());
        canvas.cells(finite.map(|(i, v)| {
            let (row, az) = (i / self.n_az, i % self.n_az);
            let at = [axes.left + az as f64 * w, axes.top + axes.height - (row + 1) as f64 * h, w + 0.5, h + 0.5];
            (at, shade(10.0 * (v.max(0.0) / top).log10()))
        }));
        if let Some(truth) = self.truth_deg {
            canvas.line(axes.at(truth, self.y.0), axes.at(truth, self.y.1), GREEN, 3.0, true);
        }
        for (number, mark) in self.marks.iter().enumerate() {
            let at = axes.at(mark.0, mark.1.clamp(self.y.0, self.y.1));
            canvas.ring(at, 10.0, RED, 3.0);
            canvas.backed_text(numbered(at, &axes), &format!("{}", number + 1), NUMBER_PX, TextAnchor::Middle);
        }
        let (scale, left) = (128, axes.left + axes.width + 30.0);
        let step = axes.height / f64::from(scale);
        canvas.cells((0..scale).map(|k| {
            let db = FLOOR_DB * (f64::from(k) + 0.5) / f64::from(scale);
            ([left, axes.top + f64::from(k) * step, 28.0, step + 0.5], shade(db))
        }));
        for k in 0..=4 {
            let y = axes.top + axes.height * f64::from(k) / 4.0 + 7.0;
            canvas.text((left + 38.0, y), &format!("{} dB", -5 * k), 20, TextAnchor::Start, BLACK);
        }
        canvas.save(stem, format)
    }
}
