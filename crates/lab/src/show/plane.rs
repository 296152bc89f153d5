//! Pictures in the plane of motion: a trajectory with its bearing, and the map of all robots.
use super::axes::{Axes, extent};
use super::canvas::{BLACK, BLUE, Canvas, GREEN, GREY, Key, PURPLE, RED, Rgb, SKY, WIDTH};
use super::{Error, Format};
use crate::words::fixed;
use kuva::render::render::TextAnchor;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

/// A receiver's path with its bearing, equal scales in x and y.
#[derive(Debug, Clone, Default)]
pub struct TrajectoryPlot {
    /// Headline.
    pub title: String,
    /// Whole path of the receiver, metres, in the odometry frame.
    pub path_m: Vec<[f64; 2]>,
    /// Positions at which CSI was used, metres.
    pub used_m: Vec<[f64; 2]>,
    /// Estimated bearing, radians; drawn from the mean position.
    pub azimuth_rad: f64,
    /// The mirror bearing that a straight path cannot tell apart, radians.
    pub mirror_rad: Option<f64>,
    /// Standard deviation of the bearing, radians; the wedge extends two of them to each side.
    pub sd_rad: Option<f64>,
    /// True bearing, radians.
    pub truth_rad: Option<f64>,
    /// True position of the transmitter, metres; not shown beyond eight path lengths.
    pub transmitter_m: Option<[f64; 2]>,
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
    /// Estimated positions.
    pub ellipses: Vec<Ellipse>,
}

fn finite(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    points.iter().filter(|p| p.iter().all(|v| v.is_finite())).copied().collect()
}

/// Equal axes below `top` that show all points.
fn axes(top: f64, points: &[[f64; 2]], pad: f64, what: &'static str) -> Result<Axes, Error> {
    let range = |k: usize| extent(points.iter().filter_map(|p| p.get(k).copied()), 0.0).ok_or(Error::Empty { what });
    let ((x0, x1), (y0, y1)) = (range(0)?, range(1)?);
    let more = pad * (x1 - x0).max(y1 - y0);
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

impl TrajectoryPlot {
    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let (path, used) = (finite(&self.path_m), finite(&self.used_m));
        let mut view: Vec<[f64; 2]> = path.iter().chain(&used).copied().collect();
        let own = axes(0.0, &view, 0.0, "trajectory")?;
        let size = (own.x.1 - own.x.0).max(own.y.1 - own.y.0);
        let of = if used.is_empty() { &path } else { &used };
        let n = of.len() as f64;
        let mean = [of.iter().map(|p| p[0]).sum::<f64>() / n, of.iter().map(|p| p[1]).sum::<f64>() / n];
        let near = |p: &[f64; 2]| (p[0] - mean[0]).hypot(p[1] - mean[1]) <= 8.0 * size;
        let transmitter = self.transmitter_m.filter(near);
        view.extend(transmitter);

        let rays = [
            (self.truth_rad, GREEN, false, "truth"),
            (self.mirror_rad, GREY, true, "mirror"),
            (Some(self.azimuth_rad), RED, false, "bearing"),
        ];
        let rays: Vec<_> = rays.iter().filter_map(|r| Some((r.0.filter(|a| a.is_finite())?, r.1, r.2, r.3))).collect();
        let bar = (self.azimuth_rad, self.sd_rad.filter(|sd| sd.is_finite() && self.azimuth_rad.is_finite()));
        let mut keys = vec![(Key::Line, SKY, "path".to_owned()), (Key::Dot, BLUE, "CSI used".to_owned())];
        keys.extend(rays.iter().rev().map(|&(azimuth, colour, dash, name)| {
            let key = if dash { Key::Dash } else { Key::Line };
            (key, colour, format!("{name} {}°", fixed(azimuth.to_degrees(), 2)))
        }));
        keys.extend(bar.1.map(|_| (Key::Area, RED, TWO_DEVIATIONS.to_owned())));
        let mut canvas = Canvas::new(900.0, &self.title);
        let top = 74.0 + canvas.legend(58.0, &keys);
        let axes = axes(top, &view, 0.3, "trajectory")?;
        axes.draw(&mut canvas, "x (m)", "y (m)");
        canvas.clipped(&axes, |canvas| {
            let start = axes.at(mean[0], mean[1]);
            wedge(canvas, &axes, mean, bar, 0.18);
            // The truth is drawn wider than the bearing, so that both are visible where they agree.
            for &(azimuth, colour, dash, name) in &rays {
                let width = if name == "truth" { 9.0 } else { 3.0 };
                canvas.line(start, beyond(&axes, mean, azimuth), colour, width, dash);
            }
            canvas.polyline(pixels(&axes, &path), SKY, 4.0);
            canvas.dots(&pixels(&axes, &used), 3.5, BLUE, 0.9);
        });
        if let Some(p) = transmitter {
            star(&mut canvas, axes.at(p[0], p[1]), "transmitter", &axes);
        }
        canvas.save(stem, format)
    }
}

/// The wedge's label in legends.
const TWO_DEVIATIONS: &str = "two deviations";

/// Two standard deviations to each side of a bearing.
fn wedge(canvas: &mut Canvas, axes: &Axes, from: [f64; 2], (azimuth_rad, sd_rad): (f64, Option<f64>), opacity: f64) {
    let Some(sd) = sd_rad.filter(|sd| sd.is_finite() && azimuth_rad.is_finite()) else { return };
    canvas.polygon(&sector(axes, from, azimuth_rad, 2.0 * sd.abs()), RED, opacity);
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
            Self::Measured => (RED, false, "measured bearing"),
            Self::Mirror => (GREY, true, "mirror"),
            Self::Truth => (GREEN, false, "true direction"),
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

    /// Writes it as `stem` with the extension of each format.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        let path = finite(&self.path_m);
        let usable = |r: &&Ray| r.azimuth_rad.is_finite() && r.origin_m.iter().all(|v| v.is_finite());
        let rays: Vec<&Ray> = self.rays.iter().filter(usable).collect();
        let truth: Vec<_> = self.truth.iter().filter(|t| t.1.iter().all(|v| v.is_finite())).collect();
        let mut view = path.clone();
        view.extend(truth.iter().map(|t| t.1).chain(rays.iter().map(|r| r.origin_m)));
        let ellipses = self.in_view(&view);
        view.extend(ellipses.iter().map(|ellipse| ellipse.centre_m));
        let mut keys = vec![];
        if !path.is_empty() {
            keys.push((Key::Line, BLUE, "path of the receiver".to_owned()));
        }
        for class in [RayClass::Measured, RayClass::Mirror, RayClass::Truth] {
            if rays.iter().any(|r| r.class == class) {
                let (colour, dash, name) = class.look();
                keys.push((if dash { Key::Dash } else { Key::Line }, colour, name.to_owned()));
            }
        }
        if rays.iter().any(|ray| ray.sd_rad.is_some()) {
            keys.push((Key::Area, RED, TWO_DEVIATIONS.to_owned()));
        }
        if !ellipses.is_empty() {
            keys.push((Key::Dot, PURPLE, "position found, 95 %".to_owned()));
        }
        let mut canvas = Canvas::new(900.0, &self.title);
        let top = 74.0 + canvas.legend(58.0, &keys);
        let axes = axes(top, &view, 0.12, "map")?;
        axes.draw(&mut canvas, "x (m)", "y (m)");
        let reach = 0.16 * (axes.y.1 - axes.y.0).max(axes.x.1 - axes.x.0);
        canvas.clipped(&axes, |canvas| {
            for ray in &rays {
                wedge(canvas, &axes, ray.origin_m, (ray.azimuth_rad, ray.sd_rad), 0.12);
            }
            for ellipse in &ellipses {
                canvas.polygon(&pixels(&axes, &ellipse.around()), PURPLE, 0.35);
                canvas.dots(&pixels(&axes, &finite(&[ellipse.centre_m])), 5.0, PURPLE, 1.0);
            }
            canvas.polyline(pixels(&axes, &path), BLUE, 4.0);
            for ray in &rays {
                let (colour, dash, _) = ray.class.look();
                let from = axes.at(ray.origin_m[0], ray.origin_m[1]);
                let end = beyond(&axes, ray.origin_m, ray.azimuth_rad);
                canvas.line(from, end, colour, if dash { 2.0 } else { 2.5 }, dash);
            }
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
        canvas.save(stem, format)
    }
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
