//! Phase of the round-trip product over time.
use super::axes::{Axes, extent};
use super::canvas::{BLACK, BLUE, Canvas, GREEN, GREY, Key, ORANGE, PURPLE, Rgb, WIDTH};
use super::{Error, Format};
use csi5300::maths::{unwrap_rad, wrap_rad};
use kuva::render::render::TextAnchor;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// The phase of one capture; `t_s`, `before_rad` and `after_rad` have the same length.
#[derive(Debug, Clone, Default)]
pub struct PhaseTrack {
    /// Name above the column, for example "recorded" or "simulated".
    pub label: String,
    /// Time in seconds.
    pub t_s: Vec<f64>,
    /// Phase before CFO and turn-around removal (forward CSI, or the uncompensated product), radians, wrapped or not.
    pub before_rad: Vec<f64>,
    /// Phase of the product of both directions without turn-around removal, radians; empty, or one for each time.
    pub product_rad: Vec<f64>,
    /// Phase of the round-trip product after CFO and turn-around removal, radians, wrapped or not.
    pub after_rad: Vec<f64>,
    /// Whether each time is one of the bearing's samples; others are drawn pale. Empty if all are alike.
    pub is_used: Vec<bool>,
    /// Residual of `after_rad` without the phase that the motion causes under the answer: time (seconds, as in `t_s`) and phase
    /// (radians); empty if there is none.
    pub left: Vec<(f64, f64)>,
}

/// Phase before and after removal of CFO and turn-around: wrapped points at the top, the unwrapped result below, and the
/// residual without the motion.
#[derive(Debug, Clone, Default)]
pub struct PhasePlot {
    /// Headline.
    pub title: String,
    /// The meaning of `before_rad`.
    pub before: String,
    /// The capture.
    pub capture: PhaseTrack,
    /// A second capture beside it, for example the simulated one.
    pub other: Option<PhaseTrack>,
    /// Pairs averaged before the phase is unwrapped; 0 means five.
    pub averaged: usize,
}

/// Height of a panel, and distance from one to the next.
const PANEL: f64 = 190.0;
const STEP: f64 = 256.0;
const TOP: f64 = 196.0;

/// Pairs averaged before their phases are unwrapped. With fewer, noise adds whole turns; with more, turns of the motion are
/// lost.
const AVERAGED: usize = 5;

impl PhasePlot {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let tracks: Vec<&PhaseTrack> = std::iter::once(&self.capture).chain(&self.other).collect();
        let panels = if tracks.iter().any(|track| !track.left.is_empty()) { 4 } else { 3 };
        let mut canvas = Canvas::new(TOP + STEP * f64::from(panels) + 20.0, &self.title);
        let before = if self.before.is_empty() { "before" } else { &self.before };
        let mut keys = vec![(Key::Dot, ORANGE, before.to_owned())];
        if tracks.iter().any(|track| !track.product_rad.is_empty()) {
            keys.push((Key::Dot, PURPLE, "both directions multiplied".into()));
        }
        keys.push((Key::Dot, BLUE, "and the turn-around removed".into()));
        if tracks.iter().any(|track| track.is_used.contains(&false)) {
            keys.push((Key::Dot, pale(GREY), "pale: not used (standing, or cut)".into()));
        }
        canvas.legend(62.0, &keys);
        let gap = 120.0;
        let width = (WIDTH - 150.0 - gap * (tracks.len() - 1) as f64) / tracks.len() as f64;
        for (i, track) in tracks.iter().enumerate() {
            let averaged = if self.averaged == 0 { AVERAGED } else { self.averaged };
            draw_track(&mut canvas, track, (120.0 + i as f64 * (width + gap), width), averaged)?;
        }
        canvas.save(stem, format)
    }
}

/// A colour mixed with two thirds of white.
fn pale((r, g, b): Rgb) -> Rgb {
    let mix = |own: u8| 255 - (255 - own) / 3;
    (mix(r), mix(g), mix(b))
}

/// Times and phases of one kind.
type Points = Vec<(f64, f64)>;

impl PhaseTrack {
    fn check(&self) -> Result<(), Error> {
        let expect = self.t_s.len();
        let or_all = |own: usize| if own == 0 { expect } else { own };
        for (what, got) in [
            ("before_rad", self.before_rad.len()),
            ("after_rad", self.after_rad.len()),
            ("product_rad", or_all(self.product_rad.len())),
            ("is_used", or_all(self.is_used.len())),
        ] {
            if got != expect {
                return Err(Error::Length { what, expect, got });
            }
        }
        Ok(())
    }

    /// The points of a phase that can be drawn: of used pairs, and of the others.
    fn points(&self, phase: &[f64]) -> [Points; 2] {
        let used = |k: usize| self.is_used.get(k).copied().unwrap_or(true);
        let all = self.t_s.iter().copied().zip(phase.iter().copied()).enumerate();
        let known = all.filter(|(_, p)| p.0.is_finite() && p.1.is_finite());
        let (used, others): (Vec<_>, Vec<_>) = known.partition(|(k, _)| used(*k));
        [used, others].map(|points| points.into_iter().map(|(_, point)| point).collect())
    }
}

fn draw_track(canvas: &mut Canvas, track: &PhaseTrack, (left, width): (f64, f64), over: usize) -> Result<(), Error> {
    track.check()?;
    let drawn = |phase: &[f64], colour| {
        let [used, others] = track.points(phase);
        [(others, pale(colour)), (used, colour)]
    };
    let (before, after) = (drawn(&track.before_rad, ORANGE), drawn(&track.after_rad, BLUE));
    let product = drawn(&track.product_rad, PURPLE);
    let empty = Error::Empty { what: "phase over time" };
    let times = before.iter().chain(&after).flat_map(|(points, _)| points.iter().map(|p| p.0));
    let times = extent(times, 0.02).ok_or(empty)?;
    canvas.text((left + width / 2.0, 148.0), &track.label, 22, TextAnchor::Middle, BLACK);
    let frame = |panel: f64| [left, TOP + STEP * panel, width, PANEL];
    wrapped(canvas, frame(0.0), times, &before, ("", "before: wrapped phase (rad)"));
    wrapped(canvas, frame(1.0), times, &[product, after].concat(), ("", "after: wrapped phase (rad)"));
    let still: Points = track.left.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    let named = |is_last: bool| if is_last { "time (s)" } else { "" };
    let line = unwrap(&averaged(&track.points(&track.after_rad).concat(), over));
    if let Some(range) = extent(line.iter().map(|p| p.1), 0.06) {
        let below = Axes::new(frame(2.0), times, range);
        below.draw(canvas, named(still.is_empty()), &format!("after, unwrapped: means of {over} pairs (rad)"));
        canvas.polyline(line.iter().map(|p| below.at(p.0, p.1)).collect(), BLUE, 2.5);
    }
    if !still.is_empty() {
        let words = (named(true), "after, less the phase that this motion makes under this bearing (rad)");
        wrapped(canvas, frame(3.0), times, &[(still, GREEN)], words);
    }
    Ok(())
}

/// Means of a few neighbours in time, each phase as a point on the unit circle.
fn averaged(points: &Points, over: usize) -> Points {
    let mut sorted = points.clone();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mean = |near: &[(f64, f64)]| {
        let sum = near.iter().map(|p| p.1.sin_cos()).fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
        let middle = near.get(near.len() / 2).map_or(0.0, |p| p.0);
        (middle, f64::atan2(sum.0, sum.1))
    };
    sorted.windows(over.min(sorted.len()).max(1)).map(mean).collect()
}

/// A panel of wrapped phases.
fn wrapped(
    canvas: &mut Canvas,
    frame: [f64; 4],
    times: (f64, f64),
    series: &[(Points, Rgb)],
    (x_label, y_label): (&str, &str),
) {
    let mut axes = Axes::new(frame, times, (-PI * 1.06, PI * 1.06));
    let names = ["-π", "-π/2", "0", "π/2", "π"];
    axes.y_ticks = Some((-2..).zip(names).map(|(k, name)| (f64::from(k) * PI / 2.0, name.into())).collect());
    axes.draw(canvas, x_label, y_label);
    let radius = if series.iter().map(|(phase, _)| phase.len()).sum::<usize>() > 800 { 2.2 } else { 3.2 };
    for (phase, colour) in series {
        let px: Vec<_> = phase.iter().map(|p| axes.at(p.0, wrap_rad(p.1))).collect();
        canvas.cloud(&axes, &px, radius, *colour, 0.7);
    }
}

/// Unwrapped phases, starting at zero.
fn unwrap(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let phases = unwrap_rad(&points.iter().map(|point| point.1).collect::<Vec<_>>());
    let first = phases.first().copied().unwrap_or(0.0);
    points.iter().zip(&phases).map(|(point, phase)| (point.0, phase - first)).collect()
}
