//! Phase of the round-trip product over time.
use super::Error;
use super::axes::{Axes, extent};
use super::canvas::{BLACK, BLUE, Canvas, Key, ORANGE, WIDTH};
use csi5300::maths::{unwrap_rad, wrap_rad};
use kuva::render::render::TextAnchor;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// The phase of one capture; the three vectors have one length.
#[derive(Debug, Clone, Default)]
pub struct PhaseTrack {
    /// Name above the column, for example "recorded" or "simulated".
    pub label: String,
    /// Time in seconds.
    pub t_s: Vec<f64>,
    /// Phase before CFO and turn-around removal (forward CSI, or the product uncompensated), radians, any wrapping.
    pub before_rad: Vec<f64>,
    /// Phase of the round-trip product after CFO and turn-around removal, radians, any wrapping.
    pub after_rad: Vec<f64>,
}

/// Phase before and after CFO and turn-around removal: wrapped points above, the unwrapped result below.
#[derive(Debug, Clone, Default)]
pub struct PhasePlot {
    /// Headline.
    pub title: String,
    /// The capture.
    pub capture: PhaseTrack,
    /// A second capture beside it, for example the simulated one.
    pub other: Option<PhaseTrack>,
}

impl PhasePlot {
    /// Writes `stem.png` and `stem.svg`.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Error> {
        let tracks: Vec<&PhaseTrack> = std::iter::once(&self.capture).chain(&self.other).collect();
        let mut canvas = Canvas::new(920.0, &self.title);
        let keys = [(Key::Dot, ORANGE, "before removal".into()), (Key::Dot, BLUE, "after removal".into())];
        canvas.legend(62.0, &keys);
        let gap = 120.0;
        let width = (WIDTH - 150.0 - gap * (tracks.len() - 1) as f64) / tracks.len() as f64;
        for (i, track) in tracks.iter().enumerate() {
            draw_track(&mut canvas, track, 120.0 + i as f64 * (width + gap), width)?;
        }
        canvas.save(stem)
    }
}

fn draw_track(canvas: &mut Canvas, track: &PhaseTrack, left: f64, width: f64) -> Result<(), Error> {
    let expect = track.t_s.len();
    for (what, got) in [("before_rad", track.before_rad.len()), ("after_rad", track.after_rad.len())] {
        if got != expect {
            return Err(Error::Length { what, expect, got });
        }
    }
    let points = |phase: &[f64]| -> Vec<(f64, f64)> {
        let pairs = track.t_s.iter().copied().zip(phase.iter().copied());
        pairs.filter(|p| p.0.is_finite() && p.1.is_finite()).collect()
    };
    let (before, after) = (points(&track.before_rad), points(&track.after_rad));
    let empty = Error::Empty { what: "phase over time" };
    let times = extent(before.iter().chain(&after).map(|p| p.0), 0.02).ok_or(empty)?;
    canvas.text((left + width / 2.0, 128.0), &track.label, 22, TextAnchor::Middle, BLACK);

    let mut wrapped = Axes::new([left, 142.0, width, 330.0], times, (-PI * 1.06, PI * 1.06));
    let names = ["-π", "-π/2", "0", "π/2", "π"];
    wrapped.y_ticks = Some((-2..).zip(names).map(|(k, name)| (f64::from(k) * PI / 2.0, name.into())).collect());
    wrapped.draw(canvas, "", "wrapped phase (rad)");
    for (phase, colour, opacity) in [(&before, ORANGE, 0.55), (&after, BLUE, 0.8)] {
        let r = if phase.len() > 800 { 2.2 } else { 3.2 };
        let px: Vec<_> = phase.iter().map(|p| wrapped.at(p.0, wrap_rad(p.1))).collect();
        canvas.dots(&px, r, colour, opacity);
    }
    let line = unwrap(&after);
    if let Some(range) = extent(line.iter().map(|p| p.1), 0.06) {
        let below = Axes::new([left, 530.0, width, 290.0], times, range);
        below.draw(canvas, "time (s)", "unwrapped (rad)");
        canvas.polyline(line.iter().map(|p| below.at(p.0, p.1)).collect(), BLUE, 2.5);
    }
    Ok(())
}

/// Phases without jumps of whole turns between neighbours; the first becomes zero.
fn unwrap(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let phases = unwrap_rad(&points.iter().map(|point| point.1).collect::<Vec<_>>());
    let first = phases.first().copied().unwrap_or(0.0);
    points.iter().zip(&phases).map(|(point, phase)| (point.0, phase - first)).collect()
}
