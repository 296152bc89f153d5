//! The kinds of picture: series over two axes, phase over time, maps, profiles.

use super::canvas::{
    Axes, BLACK, BLUE, Canvas, GREEN, GREY, Key, ORANGE, PALE, PURPLE, RED, Rgb, SKY, WIDTH, extent, extent_log,
    series_colour,
};
use super::empty;
use crate::curves::Curve;
use crate::{Failure, wrap_deg};
use csi5300::maths::{unwrap_rad, wrap_rad};
use csi5300_say::fixed;
use kuva::render::render::TextAnchor;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

/// How a series looks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Look {
    /// Dots.
    #[default]
    Dots,
    /// Dots, joined by a line.
    Joined,
    /// A line.
    Line,
    /// A line that continues to the right edge: a distribution.
    Steps,
    /// A dashed line. If it has at most two points, they are drawn, too.
    Dashed,
}

/// Points of one kind.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Its name in the legend; empty for a part of another series.
    pub name: String,
    /// Its points, in the line's order.
    pub points: Vec<(f64, f64)>,
    /// How they look.
    pub look: Look,
    /// The number of their colour.
    pub colour: usize,
}

/// Series over two axes.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Headline; empty for none.
    pub title: String,
    /// Quantity and unit of x.
    pub x_label: String,
    /// Quantity and unit of y.
    pub y_label: String,
    /// The series.
    pub series: Vec<Series>,
    /// True for a logarithmic x axis; an exact zero is at its left edge.
    pub log_x: bool,
    /// The range of x, instead of that of the points.
    pub x: Option<(f64, f64)>,
    /// The same of y.
    pub y: Option<(f64, f64)>,
}

/// Height of a chart.
const HEIGHT: f64 = 780.0;

/// A dashed line with at most this many points has dots, too.
const FEW: usize = 2;

/// From this number of points on, dots are small.
const MANY: usize = 100;

impl Chart {
    /// Writes it as `stem`.png and .svg.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        self.draw()?.save(stem)
    }

    /// The picture as the text of an SVG for a page, which says how wide it is.
    pub fn svg(&self) -> Result<String, Failure> {
        let size = format!("width=\"{WIDTH}\" height=\"{HEIGHT}\"");
        let view = format!("viewBox=\"0 0 {WIDTH} {HEIGHT}\"");
        self.draw().map(|canvas| canvas.svg().replacen(&size, &view, 1))
    }

    fn draw(&self) -> Result<Canvas, Failure> {
        let good = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let of = |own: &Series| own.points.iter().filter(good).copied().collect::<Vec<_>>();
        let drawn: Vec<(&Series, Points)> = self.series.iter().map(|own| (own, of(own))).collect();
        let all: Points = drawn.iter().flat_map(|(_, points)| points).copied().collect();
        let (xs, ys) = (all.iter().map(|p| p.0), all.iter().map(|p| p.1));
        let x = match self.log_x {
            // Zeros alone have no place on a log axis: they are at the edge of an arbitrary decade.
            true => extent_log(xs).or((!all.is_empty()).then_some((0.1, 1.0))),
            false => extent(xs, 0.05),
        };
        let (x, y) =
            self.x.or(x).zip(self.y.or(extent(ys, 0.05))).filter(|_| !all.is_empty()).ok_or_else(|| empty("points"))?;
        let mut canvas = Canvas::new(HEIGHT, &self.title);
        let named = drawn.iter().filter(|(own, points)| !own.name.is_empty() && !points.is_empty());
        let key = |look: Look| match look {
            Look::Dots | Look::Joined => Key::Dot,
            Look::Line | Look::Steps => Key::Line,
            Look::Dashed => Key::Dash,
        };
        let keys = named.map(|(own, _)| (key(own.look), series_colour(own.colour), own.name.clone()));
        let top = 80.0 + canvas.legend(58.0, &keys.collect::<Vec<_>>());
        let mut axes = Axes::new([130.0, top, WIDTH - 170.0, 690.0 - top], x, y);
        axes.log_x = self.log_x;
        axes.draw(&mut canvas, &self.x_label, &self.y_label);
        for (own, points) in &drawn {
            let edge = if self.log_x { x.0 } else { f64::NEG_INFINITY };
            let mut px: Vec<_> = points.iter().map(|p| axes.at(p.0.max(edge), p.1)).collect();
            let colour = series_colour(own.colour);
            if matches!(own.look, Look::Dots | Look::Joined) || own.look == Look::Dashed && px.len() <= FEW {
                let (r, opacity) = if px.len() > MANY { (3.0, 0.7) } else { (7.0, 0.9) };
                canvas.dots(&px, r, colour, opacity);
            }
            if own.look == Look::Steps {
                px.extend(px.last().map(|last| (axes.at(x.1, y.0).0, last.1)));
            }
            match own.look {
                Look::Dots => {}
                Look::Dashed => px.windows(2).for_each(|pair| canvas.line(pair[0], pair[1], colour, 2.0, true)),
                Look::Joined | Look::Line | Look::Steps => canvas.polyline(px, colour, 3.0),
            }
        }
        Ok(canvas)
    }
}

/// Times (seconds) and phases (radians, wrapped or not) of one kind.
type Points = Vec<(f64, f64)>;

/// The phase of one capture.
#[derive(Debug, Clone, Default)]
pub struct PhaseTrack {
    /// Name above the column, for example "recorded" or "simulated".
    pub label: String,
    /// Phase before CFO and turn-around removal (forward CSI, or the uncompensated product).
    pub before: Points,
    /// Phase of the product of both directions without turn-around removal; may be empty.
    pub product: Points,
    /// Phase of the round-trip product after CFO and turn-around removal.
    pub after: Points,
    /// Whether each point is one of the bearing's samples; others are drawn pale. Empty if all are alike.
    pub is_used: Vec<bool>,
    /// Residual of `after` without the phase that the motion causes under the answer; empty if there is none.
    pub left: Points,
}

/// Phase before and after removal of CFO and turn-around: wrapped points at the top, the unwrapped result below, and the
/// residual without the motion.
#[derive(Debug, Clone, Default)]
pub struct PhasePlot {
    /// Headline.
    pub title: String,
    /// The meaning of [`PhaseTrack::before`].
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
    /// Writes it as `stem`.png and .svg.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        let tracks: Vec<&PhaseTrack> = std::iter::once(&self.capture).chain(&self.other).collect();
        let panels = if tracks.iter().any(|track| !track.left.is_empty()) { 4 } else { 3 };
        let mut canvas = Canvas::new(TOP + STEP * f64::from(panels) + 20.0, &self.title);
        let before = if self.before.is_empty() { "before" } else { &self.before };
        let mut keys = vec![(Key::Dot, ORANGE, before.to_owned())];
        if tracks.iter().any(|track| !track.product.is_empty()) {
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
        canvas.save(stem)
    }
}

/// A colour mixed with two thirds of white.
fn pale((r, g, b): Rgb) -> Rgb {
    let mix = |own: u8| 255 - (255 - own) / 3;
    (mix(r), mix(g), mix(b))
}

impl PhaseTrack {
    /// The points of a phase that can be drawn: of used pairs, and of the others.
    fn points(&self, phase: &Points) -> [Points; 2] {
        let used = |k: usize| self.is_used.get(k).copied().unwrap_or(true);
        let known = phase.iter().copied().enumerate().filter(|(_, p)| p.0.is_finite() && p.1.is_finite());
        let (used, others): (Vec<_>, Vec<_>) = known.partition(|(k, _)| used(*k));
        [used, others].map(|points| points.into_iter().map(|(_, point)| point).collect())
    }
}

fn draw_track(canvas: &mut Canvas, track: &PhaseTrack, (left, width): (f64, f64), over: usize) -> Result<(), Failure> {
    let drawn = |phase: &Points, colour| {
        let [used, others] = track.points(phase);
        [(others, pale(colour)), (used, colour)]
    };
    let (before, after) = (drawn(&track.before, ORANGE), drawn(&track.after, BLUE));
    let product = drawn(&track.product, PURPLE);
    let times = before.iter().chain(&after).flat_map(|(points, _)| points.iter().map(|p| p.0));
    let times = extent(times, 0.02).ok_or_else(|| empty("phase over time"))?;
    canvas.text((left + width / 2.0, 148.0), &track.label, 22, TextAnchor::Middle, BLACK);
    let frame = |panel: f64| [left, TOP + STEP * panel, width, PANEL];
    wrapped(canvas, frame(0.0), times, &before, ("", "before: wrapped phase (rad)"));
    wrapped(canvas, frame(1.0), times, &[product, after].concat(), ("", "after: wrapped phase (rad)"));
    let still: Points = track.left.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    let named = |is_last: bool| if is_last { "time (s)" } else { "" };
    let line = unwrap(&averaged(&track.points(&track.after).concat(), over));
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

/// The meaning of a ray of [`MapPlot`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayClass {
    /// A measured bearing.
    Measured,
    /// Its mirror image.
    Mirror,
    /// The true direction.
    Truth,
}

/// A bearing drawn on the map.
#[derive(Debug, Clone)]
pub struct Ray {
    /// Where it starts, metres.
    pub origin_m: [f64; 2],
    /// Its azimuth, radians.
    pub azimuth_rad: f64,
    /// Standard deviation of the azimuth, radians; the wedge extends two of them to each side.
    pub sd_rad: Option<f64>,
    /// Label at its tip; may be empty.
    pub label: String,
    /// Its meaning.
    pub class: RayClass,
}

/// Deviations in which 95 % of the errors in a plane are: `sqrt(-2 ln 0.05)`.
const HOLDS_95: f64 = 2.447_75;

/// A position with the ellipse that holds 95 %.
#[derive(Debug, Clone)]
pub struct Ellipse {
    /// The position, metres.
    pub centre_m: [f64; 2],
    /// Its covariance, metres squared.
    pub covariance_m2: [[f64; 2]; 2],
    /// Label beside it; may be empty.
    pub label: String,
}

impl Ellipse {
    /// Points of the ellipse, metres: the covariance's square root (Cholesky) applied to a circle of [`HOLDS_95`] deviations.
    fn around(&self) -> Vec<[f64; 2]> {
        let [[a, b], [_, d]] = self.covariance_m2;
        let l = a.max(1e-12).sqrt();
        let (m, n) = (b / l, (d - b * b / (l * l)).max(0.0).sqrt());
        let point = |k: i32| {
            let (sin, cos) = (TAU * f64::from(k) / 72.0).sin_cos();
            [self.centre_m[0] + HOLDS_95 * l * cos, self.centre_m[1] + HOLDS_95 * (m * cos + n * sin)]
        };
        finite(&(0..72).map(point).collect::<Vec<_>>())
    }
}

/// Map of robots, paths and bearings, equal scales in x and y.
#[derive(Debug, Clone, Default)]
pub struct MapPlot {
    /// Headline.
    pub title: String,
    /// Name and true position of each robot or beacon, metres.
    pub truth: Vec<(String, [f64; 2])>,
    /// Bearings.
    pub rays: Vec<Ray>,
    /// Path of the receiver, metres.
    pub path_m: Vec<[f64; 2]>,
    /// Positions at which CSI was used, metres.
    pub used_m: Vec<[f64; 2]>,
    /// Estimated positions.
    pub ellipses: Vec<Ellipse>,
}

fn finite(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    points.iter().filter(|p| p.iter().all(|v| v.is_finite())).copied().collect()
}

/// Equal axes below `top` that show all points.
fn axes(top: f64, points: &[[f64; 2]]) -> Result<Axes, Failure> {
    let range = |k: usize| extent(points.iter().map(|p| p[k]), 0.0).ok_or_else(|| empty("map"));
    let ((x0, x1), (y0, y1)) = (range(0)?, range(1)?);
    let more = 0.15 * (x1 - x0).max(y1 - y0);
    let frame = [120.0, top, WIDTH - 160.0, 810.0 - top];
    Ok(Axes::new(frame, (x0 - more, x1 + more), (y0 - more, y1 + more)).equal_aspect())
}

/// A pixel in a direction from a place in the frame, at twice the frame's diagonal.
fn beyond(axes: &Axes, from: [f64; 2], azimuth: f64) -> (f64, f64) {
    let far = 2.0 * (axes.x.1 - axes.x.0).hypot(axes.y.1 - axes.y.0);
    axes.at(from[0] + far * azimuth.cos(), from[1] + far * azimuth.sin())
}

/// The pixels of a sector around an azimuth, `half_rad` to either side, from a place in the frame. It ends beyond the frame; from
/// half a turn on it is the full circle.
fn sector(axes: &Axes, from: [f64; 2], azimuth: f64, half_rad: f64) -> Vec<(f64, f64)> {
    let half = half_rad.min(PI);
    let steps = (half / ARC_STEP_RAD).ceil().max(1.0);
    let edge = |k: i32| beyond(axes, from, azimuth + half * f64::from(k) / steps);
    let mut around: Vec<_> = (-steps as i32..=steps as i32).map(edge).collect();
    if half < PI {
        around.push(axes.at(from[0], from[1]));
    }
    around
}

/// Largest step along the arc of a sector, radians: its chords stay beyond the frame.
const ARC_STEP_RAD: f64 = PI / 24.0;

fn pixels(axes: &Axes, points: &[[f64; 2]]) -> Vec<(f64, f64)> {
    points.iter().map(|p| axes.at(p[0], p[1])).collect()
}

/// Two standard deviations to each side of a bearing.
fn wedge(canvas: &mut Canvas, axes: &Axes, ray: &Ray) {
    let Some(sd) = ray.sd_rad.filter(|sd| sd.is_finite()) else { return };
    canvas.polygon(&sector(axes, ray.origin_m, ray.azimuth_rad, 2.0 * sd.abs()), RED, 0.15);
}

/// A ringed dot with a label on the side that has room.
fn star(canvas: &mut Canvas, at: (f64, f64), name: &str, axes: &Axes) {
    canvas.dots(&[at], 7.0, BLACK, 1.0);
    canvas.ring(at, 13.0, BLACK, 2.5);
    let left = at.0 > axes.left + 0.8 * axes.width;
    let (dx, anchor) = if left { (-20.0, TextAnchor::End) } else { (20.0, TextAnchor::Start) };
    canvas.backed_text((at.0 + dx, at.1 - 14.0), name, 20, anchor);
}

impl RayClass {
    fn look(self) -> (Rgb, bool, &'static str) {
        match self {
            Self::Measured => (RED, false, "bearing"),
            Self::Mirror => (GREY, true, "mirror"),
            Self::Truth => (GREEN, false, "truth"),
        }
    }
}

impl MapPlot {
    /// Estimated positions no further from the robots than these are from each other: others would shrink the map.
    fn in_view(&self, points: &[[f64; 2]]) -> Vec<&Ellipse> {
        let range = |k: usize| extent(points.iter().filter_map(|p| p.get(k).copied()), 0.0);
        let (Some(x), Some(y)) = (range(0), range(1)) else { return Vec::new() };
        let room = (x.1 - x.0).max(y.1 - y.0);
        let inside = |v: f64, range: (f64, f64)| (range.0 - room..=range.1 + room).contains(&v);
        self.ellipses
            .iter()
            .filter(|ellipse| inside(ellipse.centre_m[0], x) && inside(ellipse.centre_m[1], y))
            .collect()
    }

    /// Writes it as `stem`.png and .svg.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        let (path, used) = (finite(&self.path_m), finite(&self.used_m));
        let usable = |r: &&Ray| r.azimuth_rad.is_finite() && r.origin_m.iter().all(|v| v.is_finite());
        let rays: Vec<&Ray> = self.rays.iter().filter(usable).collect();
        let truth: Vec<_> = self.truth.iter().filter(|t| t.1.iter().all(|v| v.is_finite())).collect();
        let mut view = [&path[..], &used].concat();
        view.extend(truth.iter().map(|t| t.1).chain(rays.iter().map(|r| r.origin_m)));
        let ellipses = self.in_view(&view);
        view.extend(ellipses.iter().map(|ellipse| ellipse.centre_m));
        let mut keys = vec![];
        if !path.is_empty() {
            keys.push((Key::Line, SKY, "path of the receiver".to_owned()));
        }
        if !used.is_empty() {
            keys.push((Key::Dot, BLUE, "CSI used".to_owned()));
        }
        for class in [RayClass::Measured, RayClass::Mirror, RayClass::Truth] {
            let (colour, dash, name) = class.look();
            let own: Vec<f64> = rays.iter().filter(|r| r.class == class).map(|r| r.azimuth_rad.to_degrees()).collect();
            let words = match own[..] {
                [] => continue,
                [deg] => format!("{name} {}°", fixed(deg, 2)),
                _ => name.to_owned(),
            };
            keys.push((if dash { Key::Dash } else { Key::Line }, colour, words));
        }
        if rays.iter().any(|ray| ray.sd_rad.is_some_and(f64::is_finite)) {
            keys.push((Key::Area, RED, "two deviations".to_owned()));
        }
        if !ellipses.is_empty() {
            keys.push((Key::Dot, PURPLE, "position found, 95 %".to_owned()));
        }
        let mut canvas = Canvas::new(900.0, &self.title);
        let top = 80.0 + canvas.legend(58.0, &keys);
        let axes = axes(top, &view)?;
        axes.draw(&mut canvas, "x (m)", "y (m)");
        let reach = 0.16 * (axes.y.1 - axes.y.0).max(axes.x.1 - axes.x.0);
        canvas.clipped(&axes, |canvas| {
            for ray in &rays {
                wedge(canvas, &axes, ray);
            }
            for ellipse in &ellipses {
                canvas.polygon(&pixels(&axes, &ellipse.around()), PURPLE, 0.35);
                canvas.dots(&pixels(&axes, &finite(&[ellipse.centre_m])), 5.0, PURPLE, 1.0);
            }
            for ray in &rays {
                let (colour, dash, _) = ray.class.look();
                let from = axes.at(ray.origin_m[0], ray.origin_m[1]);
                // The truth is so much wider that a bearing or a mirror's dashes are visible where they agree with it.
                let width = if ray.class == RayClass::Truth { 9.0 } else { 3.0 };
                canvas.line(from, beyond(&axes, ray.origin_m, ray.azimuth_rad), colour, width, dash);
            }
            canvas.polyline(pixels(&axes, &path), SKY, 4.0);
            canvas.dots(&pixels(&axes, &used), 3.5, BLUE, 0.9);
        });
        for ray in rays.iter().filter(|r| !r.label.is_empty()) {
            let (sin, cos) = ray.azimuth_rad.sin_cos();
            let tip = axes.at(ray.origin_m[0] + reach * cos, ray.origin_m[1] + reach * sin);
            canvas.backed_text((tip.0, tip.1 + 7.0), &ray.label, 20, TextAnchor::Middle);
        }
        let is_new = |ellipse: &&&Ellipse| truth.iter().all(|(name, _)| *name != ellipse.label);
        for ellipse in ellipses.iter().filter(is_new).filter(|ellipse| !ellipse.label.is_empty()) {
            let at = axes.at(ellipse.centre_m[0], ellipse.centre_m[1]);
            canvas.backed_text((at.0, at.1 - 14.0), &ellipse.label, 20, TextAnchor::Middle);
        }
        for (name, p) in &truth {
            let at = axes.at(p[0], p[1]);
            star(&mut canvas, at, name, &axes);
        }
        canvas.save(stem)
    }
}

/// Polar profiles: azimuth 0 is +x to the right, counter-clockwise; the radius is linear, each series relative to its own
/// maximum. Beside them, an enlarged view around the answer (or the truth, or the maximum).
#[derive(Debug, Clone, Default)]
pub struct ProfilePlot {
    /// Headline.
    pub title: String,
    /// The curve from which the answer was chosen: drawn thick.
    pub chosen_from: Curve,
    /// Other curves, drawn thin below it.
    pub others: Vec<Curve>,
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

fn polar(azimuth_deg: f64, radius: f64) -> (f64, f64) {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    (CENTRE.0 + RADIUS * radius * cos, CENTRE.1 - RADIUS * radius * sin)
}

/// The finite points of a curve relative to its maximum; `None` if no value is above 0.
fn relative(curve: &Curve) -> Option<Points> {
    let points = curve.points.iter().filter(|p| p.0.is_finite() && p.1.is_finite());
    let top = points.clone().map(|p| p.1).fold(0.0, f64::max);
    (top > 0.0).then(|| points.map(|p| (p.0, (p.1 / top).max(0.0))).collect())
}

/// Height of a curve at an azimuth, interpolated between the nearest points.
fn height(curve: &Points, azimuth_deg: f64) -> f64 {
    let offset = |p: &(f64, f64)| wrap_deg(p.0 - azimuth_deg);
    let below = curve.iter().filter(|p| offset(p) <= 0.0).max_by(|a, b| offset(a).total_cmp(&offset(b)));
    let above = curve.iter().filter(|p| offset(p) >= 0.0).min_by(|a, b| offset(a).total_cmp(&offset(b)));
    match (below, above) {
        (Some(a), Some(b)) if offset(b) > offset(a) => a.1 - (b.1 - a.1) * offset(a) / (offset(b) - offset(a)),
        (Some(p), _) | (_, Some(p)) => p.1,
        _ => 0.0,
    }
}

impl ProfilePlot {
    /// Writes it as `stem`.png and .svg.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        let chosen = relative(&self.chosen_from).ok_or_else(|| empty("profile"))?;
        let others = self.others.iter().enumerate();
        let others: Vec<_> =
            others.filter_map(|(i, other)| Some((self.colour_of_other(i), relative(other)?))).collect();
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
        canvas.save(stem)
    }

    fn answer(&self) -> Option<f64> {
        self.answer_deg.filter(|azimuth| azimuth.is_finite())
    }

    /// An unnamed curve belongs to the one before and has its colour.
    fn colour_of_other(&self, i: usize) -> Rgb {
        let is_named = |k: &usize| self.others.get(*k).is_some_and(|other| !other.name.is_empty());
        series_colour((0..=i).rev().find(is_named).unwrap_or(i) + 3)
    }

    fn keys(&self) -> Vec<(Key, Rgb, String)> {
        let mut keys = vec![(Key::Line, BLUE, self.chosen_from.name.clone())];
        let others = self.others.iter().enumerate().filter(|(_, other)| !other.name.is_empty());
        keys.extend(others.map(|(i, other)| (Key::Line, self.colour_of_other(i), other.name.clone())));
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
    fn enlarged(&self, canvas: &mut Canvas, chosen: &Points, others: &[(Rgb, Points)], candidates: &[f64]) {
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
            let line = |curve: &Points| {
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
fn around(curve: &Points) -> Vec<(f64, f64)> {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// True for a pixel inside a polygon: a ray from it crosses the edges an odd number of times.
    fn is_inside(polygon: &[(f64, f64)], (x, y): (f64, f64)) -> bool {
        let ends = polygon.iter().zip(polygon.iter().cycle().skip(1));
        let crossed = ends.filter(|(a, b)| (a.1 > y) != (b.1 > y) && x < a.0 + (y - a.1) / (b.1 - a.1) * (b.0 - a.0));
        crossed.count() % 2 == 1
    }

    #[test]
    fn a_wedge_covers_exactly_its_directions_of_the_frame() {
        let axes = Axes::new([120.0, 106.0, 1_040.0, 704.0], (-4.5, 7.0), (-5.9, 2.0)).equal_aspect();
        let from = [-4.0, 1.5];
        for (azimuth, half) in [(-1.4, 0.01), (-1.4, 1.0), (3.0, 1.5), (-1.4, 1.9), (0.5, 3.1), (-1.4, PI), (2.0, 9.0)]
        {
            let polygon = sector(&axes, from, azimuth, half);
            for (i, j) in (0..60).flat_map(|i| (0..40).map(move |j| (i, j))) {
                let at = [-4.5 + 11.5 * (f64::from(i) + 0.5) / 60.0, -5.9 + 7.9 * (f64::from(j) + 0.5) / 40.0];
                let off = (at[1] - from[1]).atan2(at[0] - from[0]) - azimuth;
                let off = csi5300::maths::wrap_rad(off).abs();
                if (off - half).abs() > 1e-3 {
                    let inside = is_inside(&polygon, axes.at(at[0], at[1]));
                    assert_eq!(inside, off < half, "{half} rad about {azimuth}: {at:?}, {off} rad off");
                }
            }
        }
    }
}
