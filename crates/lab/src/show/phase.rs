//! Phase of the round-trip product over time.
use super::axes::{Axes, extent};
use super::canvas::{BLACK, BLUE, Canvas, GREEN, Key, ORANGE, PURPLE, Rgb, WIDTH};
use super::{Error, Format};
use csi5300::maths::{unwrap_rad, wrap_rad};
use kuva::render::render::TextAnchor;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// The phase of one capture; `t_s`, `before_rad` and `after_rad` have one length.
#[derive(Debug, Clone, Default)]
pub struct PhaseTrack {
    /// Name above the column, for example "recorded" or "simulated".
    pub label: String,
    /// Time in seconds.
    pub t_s: Vec<f64>,
    /// Phase before CFO and turn-around removal (forward CSI, or the product uncompensated), radians, any wrapping.
    pub before_rad: Vec<f64>,
    /// Phase of the product of both directions with the turn-around left in, radians; empty, or one for each time.
    pub product_rad: Vec<f64>,
    /// Phase of the round-trip product after CFO and turn-around removal, radians, any wrapping.
    pub after_rad: Vec<f64>,
    /// What is left of `after_rad` once the phase that the motion makes, seen from the answer, is taken out: time in
    /// motion (seconds) and phase (radians); empty where there is none.
    pub left: Vec<(f64, f64)>,
}

/// Phase before and after CFO and turn-around removal: wrapped points above, the unwrapped result below, and what is left
/// without the motion.
#[derive(Debug, Clone, Default)]
pub struct PhasePlot {
    /// Headline.
    pub title: String,
    /// What `before_rad` is.
    pub before: String,
    /// The capture.
    pub capture: PhaseTrack,
    /// A second capture beside it, for example the simulated one.
    pub other: Option<PhaseTrack>,
}

/// Height of a panel, and from one to the next.
const PANEL: f64 = 190.0;
const STEP: f64 = 256.0;
const TOP: f64 = 182.0;

impl PhasePlot {
    /// Writes it as `stem` with the ending of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let tracks: Vec<&PhaseTrack> = std::iter::once(&self.capture).chain(&self.other).collect();
        let panels = if tracks.iter().any(|track| !track.left.is_empty()) { 4 } else { 3 };
        let mut canvas = Canvas::new(TOP + STEP * f64::from(panels) + 20.0, &self.title);
        let before = if self.before.is_empty() { "before" } else { &self.before };
        let mut keys = vec![(Key::Dot, ORANGE, before.to_owned())];
        if tracks.iter().any(|track| !track.product_rad.is_empty()) {
            keys.push((Key::Dot, PURPLE, "both directions multiplied".into()));
        }
        keys.push((Key::Dot, BLUE, "and the turn-around taken out".into()));
        canvas.legend(62.0, &keys);
        let gap = 120.0;
        let width = (WIDTH - 150.0 - gap * (tracks.len() - 1) as f64) / tracks.len() as f64;
        for (i, track) in tracks.iter().enumerate() {
            draw_track(&mut canvas, track, 120.0 + i as f64 * (width + gap), width)?;
        }
        canvas.save(stem, format)
    }
}

fn draw_track(canvas: &mut Canvas, track: &PhaseTrack, left: f64, width: f64) -> Result<(), Error> {
    let expect = track.t_s.len();
    let own = if track.product_rad.is_empty() { expect } else { track.product_rad.len() };
    for (what, got) in
        [("before_rad", track.before_rad.len()), ("after_rad", track.after_rad.len()), ("product_rad", own)]
    {
        if got != expect {
            return Err(Error::Length { what, expect, got });
        }
    }
    let points = |phase: &[f64]| -> Vec<(f64, f64)> {
        let pairs = track.t_s.iter().copied().zip(phase.iter().copied());
        pairs.filter(|p| p.0.is_finite() && p.1.is_finite()).collect()
    };
    let (before, after) = (points(&track.before_rad), points(&track.after_rad));
    let product = points(&track.product_rad);
    let empty = Error::Empty { what: "phase over time" };
    let times = extent(before.iter().chain(&after).map(|p| p.0), 0.02).ok_or(empty)?;
    canvas.text((left + width / 2.0, 128.0), &track.label, 22, TextAnchor::Middle, BLACK);
    let frame = |panel: f64| [left, TOP + STEP * panel, width, PANEL];
    wrapped(canvas, frame(0.0), times, &[(&before, ORANGE)], ("", "before: wrapped phase (rad)"));
    wrapped(canvas, frame(1.0), times, &[(&product, PURPLE), (&after, BLUE)], ("", "after: wrapped phase (rad)"));
    let line = unwrap(&after);
    let named = |panels: bool| if panels { "" } else { "time (s)" };
    if let Some(range) = extent(line.iter().map(|p| p.1), 0.06) {
        let below = Axes::new(frame(2.0), times, range);
        below.draw(canvas, named(!track.left.is_empty()), "after, unwrapped (rad)");
        canvas.polyline(line.iter().map(|p| below.at(p.0, p.1)).collect(), BLUE, 2.5);
    }
    let still: Vec<(f64, f64)> = track.left.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    if let Some(times) = extent(still.iter().map(|p| p.0), 0.02) {
        let words = ("time in motion (s)", "after, less what the motion makes seen from the answer (rad)");
        wrapped(canvas, frame(3.0), times, &[(&still, GREEN)], words);
    }
    Ok(())
}

/// A panel of wrapped phases.
fn wrapped(
    canvas: &mut Canvas,
    frame: [f64; 4],
    times: (f64, f64),
    series: &[(&Vec<(f64, f64)>, Rgb)],
    (x_label, y_label): (&str, &str),
) {
    let mut axes = Axes::new(frame, times, (-PI * 1.06, PI * 1.06));
    let names = ["-π", "-π/2", "0", "π/2", "π"];
    axes.y_ticks = Some((-2..).zip(names).map(|(k, name)| (f64::from(k) * PI / 2.0, name.into())).collect());
    axes.draw(canvas, x_label, y_label);
    for (phase, colour) in series {
        let px: Vec<_> = phase.iter().map(|p| axes.at(p.0, wrap_rad(p.1))).collect();
        canvas.cloud(&axes, &px, if phase.len() > 800 { 2.2 } else { 3.2 }, *colour, 0.7);
    }
}

/// Phases without jumps of whole turns between neighbours; the first becomes zero.
fn unwrap(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let phases = unwrap_rad(&points.iter().map(|point| point.1).collect::<Vec<_>>());
    let first = phases.first().copied().unwrap_or(0.0);
    points.iter().zip(&phases).map(|(point, phase)| (point.0, phase - first)).collect()
}
