//! A log over time: CSI as heat maps, amplitude by antenna, RSSI and gain, rate, and what is missing.
mod events;

use super::axes::{Axes, extent};
use super::canvas::{BLACK, Canvas, GREY, Key, ORANGE, Rgb, series_colour};
use super::{Error, Format};
use crate::course::{AntennaCourse, Course};
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::source::survey::TimeBase;
use kuva::plot::ColorMap;
use kuva::render::render::TextAnchor;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Lowest and highest value of a colour bar, its ticks, and the colour of a value.
type Shades<'a> = ((f64, f64), &'a [(f64, String)], &'a dyn Fn(f64) -> Rgb);

/// Pictures of one log.
#[derive(Clone, Copy, Debug)]
pub struct LogPictures<'a> {
    /// Headline.
    pub title: &'a str,
    /// What is drawn.
    pub course: &'a Course,
    /// Width and height of the drawing, pixels at 96 to the inch.
    pub size: (f64, f64),
}

const LEFT: f64 = 110.0;
const RIGHT: f64 = 120.0;
const TOP: f64 = 150.0;
const BOTTOM: f64 = 90.0;
/// Between panels: the upper one's ticks and the lower one's name.
const GAP: f64 = 70.0;
/// Rows of a heat map that have a tick: the outermost subcarriers, those beside the centre, and two between.
const TICKED: [usize; 6] = [0, 7, 14, 15, 22, SUBCARRIERS - 1];

impl LogPictures<'_> {
    /// Writes `STEM-csi` (heat maps of each antenna) and `STEM-levels` (amplitude, RSSI and gain, rate).
    ///
    /// # Errors
    /// If there is nothing to draw, or a picture cannot be drawn or written.
    pub fn write(&self, stem: &Path, format: &Format) -> Result<Vec<PathBuf>, Error> {
        if self.course.records == 0 {
            return Err(Error::Empty { what: "log" });
        }
        let [csi, levels] = Self::stems(stem);
        format.check(&[csi.clone(), levels.clone()])?;
        let mut written = Vec::new();
        if !self.course.antennas.is_empty() {
            written.extend(self.csi().save(&csi, format)?);
        }
        written.extend(self.levels()?.save(&levels, format)?);
        Ok(written)
    }

    /// What its two pictures are called, without their endings.
    #[must_use]
    pub fn stems(stem: &Path) -> [PathBuf; 2] {
        ["csi", "levels"].map(|what| {
            let mut name = stem.as_os_str().to_owned();
            name.push(format!("-{what}"));
            PathBuf::from(name)
        })
    }

    /// The frames of `n` panels below each other, from `top` on, with `below` pixels left under them.
    fn panels(&self, n: usize, top: f64, below: f64) -> Vec<[f64; 4]> {
        let (width, height) = self.size;
        let each = ((height - top - BOTTOM - below - GAP * (n as f64 - 1.0)) / n as f64).max(30.0);
        (0..n).map(|k| [LEFT, top + k as f64 * (each + GAP), width - LEFT - RIGHT, each]).collect()
    }

    fn csi(&self) -> Canvas {
        let (width, height) = self.size;
        let mut canvas = Canvas::sized(width, height, &format!("{}: CSI, first stream", self.title));
        let antennas = &self.course.antennas;
        let panels = self.panels(2 * antennas.len(), TOP, 0.0);
        for (k, antenna) in antennas.iter().enumerate() {
            let last = k + 1 == antennas.len();
            let name = format!("antenna {}: amplitude by subcarrier (dB, 0 is the card's step)", antenna.antenna);
            let range = extent(antenna.amplitude_db.iter().copied(), 0.0).unwrap_or((0.0, 1.0));
            let ticks = [range.0, (range.0 + range.1) / 2.0, range.1].map(|db| (db, format!("{db:.0} dB")));
            let shade = |share: f64| ColorMap::Viridis.map_rgb(share).unwrap_or(GREY);
            self.heat(&mut canvas, panels[2 * k], &antenna.amplitude_db, (range, &ticks, &shade), (&name, ""));
            let name = format!("antenna {}: phase by subcarrier, less the middle one's (rad)", antenna.antenna);
            let ticks = [(-PI, "-π".into()), (0.0, "0".into()), (PI, "π".into())];
            let below = if last { self.time_words() } else { "" };
            self.heat(
                &mut canvas,
                panels[2 * k + 1],
                &antenna.phase_rad,
                ((-PI, PI), &ticks, &circular),
                (&name, below),
            );
        }
        canvas
    }

    /// A heat map over time and subcarrier with its scale.
    fn heat(
        &self,
        canvas: &mut Canvas,
        frame: [f64; 4],
        values: &[f64],
        (range, ticks, shade): Shades<'_>,
        (name, x_label): (&str, &str),
    ) {
        let mut axes = Axes::new(frame, self.course.span_s, (0.0, SUBCARRIERS as f64));
        axes.y_ticks = Some(self.subcarrier_ticks(axes.height));
        axes.draw(canvas, x_label, name);
        let columns = self.course.columns;
        let (w, h) = (axes.width / columns as f64, axes.height / SUBCARRIERS as f64);
        let share = |value: f64| ((value - range.0) / (range.1 - range.0)).clamp(0.0, 1.0);
        let known = values.iter().enumerate().filter(|(_, value)| value.is_finite());
        canvas.cells(known.map(|(cell, value)| {
            let (row, column) = (cell / columns, cell % columns);
            let at = [axes.left + column as f64 * w, axes.top + axes.height - (row + 1) as f64 * h, w + 0.6, h + 0.6];
            (at, shade(share(*value)))
        }));
        let (x, steps) = (axes.left + axes.width + 14.0, 64);
        let step = axes.height / f64::from(steps);
        canvas.cells((0..steps).map(|k| {
            let at = [x, axes.top + f64::from(k) * step, 18.0, step + 0.6];
            (at, shade(1.0 - (f64::from(k) + 0.5) / f64::from(steps)))
        }));
        for (value, name) in ticks {
            let y = axes.top + axes.height * (1.0 - share(*value));
            canvas.text(
                (x + 26.0, y.clamp(axes.top + 14.0, axes.top + axes.height)),
                name,
                18,
                TextAnchor::Start,
                BLACK,
            );
        }
    }

    /// Ticks at subcarriers' own indices; at their places in the record where frames of both widths are in the log.
    fn subcarrier_ticks(&self, height: f64) -> Vec<(f64, String)> {
        let name = |row: usize| match self.course.subcarriers.and_then(|indices| indices.get(row).copied()) {
            Some(index) => index.to_string(),
            None => row.to_string(),
        };
        // Both sides of the centre are one row apart: one of them has the tick.
        let rows =
            TICKED.into_iter().filter(|row| *row != 14 && (height > 110.0 || [0, SUBCARRIERS - 1].contains(row)));
        rows.map(|row| (row as f64 + 0.5, name(row))).collect()
    }

    /// What the times are.
    fn time_words(&self) -> &'static str {
        match self.course.base {
            TimeBase::Host => "time (s), of the host: the card's clock stands",
            TimeBase::Number => "record: the card's clock stands, and there are no host times",
            _ => "time (s)",
        }
    }

    fn levels(&self) -> Result<Canvas, Error> {
        let (width, height) = self.size;
        let course = self.course;
        let mut canvas = Canvas::sized(width, height, &format!("{}: levels and rate", self.title));
        let name = |antenna: &AntennaCourse| format!("antenna {}", antenna.antenna);
        let mut keys: Vec<(Key, Rgb, String)> = course.antennas.iter().map(|a| (Key::Line, of(a), name(a))).collect();
        keys.push((Key::Line, GREY, "gain (AGC)".into()));
        keys.push((Key::Line, BLACK, "rate".into()));
        if !course.gaps_s.is_empty() {
            keys.push((Key::Area, ORANGE, crate::words::count(course.gaps_s.len() as u64, "gap", "gaps")));
        }
        let top = TOP.max(58.0 + canvas.legend(58.0, &keys) + 50.0);
        let events = events::of(course);
        let below = events::height(&events);
        let panels = self.panels(3, top, below);
        let amplitude: Vec<_> = course.antennas.iter().map(|antenna| (of(antenna), &antenna.line_db)).collect();
        let words = "mean amplitude (dB, 0 is the card's step)";
        self.lines(&mut canvas, panels[0], &amplitude, words);
        let antennas = (0..3).filter(|k| course.antennas.iter().any(|a| a.antenna as usize == *k));
        let mut levels: Vec<_> = antennas.map(|k| (series_colour(k), &course.rssi[k])).collect();
        levels.push((GREY, &course.agc));
        self.lines(&mut canvas, panels[1], &levels, "RSSI of each antenna, and gain (dB)");
        let axes = self.rate(&mut canvas, panels[2])?;
        events::draw(&mut canvas, &axes, &events);
        axes.under(&mut canvas, self.time_words(), (below - 24.0).max(0.0));
        Ok(canvas)
    }

    fn lines(&self, canvas: &mut Canvas, frame: [f64; 4], series: &[(Rgb, &Vec<(f64, f64)>)], name: &str) {
        let all = series.iter().flat_map(|(_, points)| points.iter().map(|point| point.1));
        let axes = Axes::new(frame, self.course.span_s, extent(all, 0.08).unwrap_or((0.0, 1.0)));
        axes.draw(canvas, "", name);
        for (colour, points) in series {
            for piece in points.chunk_by(|a, b| !is_broken(a.0, b.0, &self.course.gaps_s)) {
                let piece: Vec<_> = piece.iter().map(|p| axes.at(p.0, p.1)).collect();
                match piece.as_slice() {
                    [alone] => canvas.dots(&[*alone], 1.5, *colour, 1.0),
                    _ => canvas.polyline(piece, *colour, 1.8),
                }
            }
        }
    }

    /// Records per second, with the gaps.
    fn rate(&self, canvas: &mut Canvas, frame: [f64; 4]) -> Result<Axes, Error> {
        let course = self.course;
        let rates = || course.rate_hz.iter().map(|point| point.1);
        let top = extent(rates().chain([0.0]), 0.08).ok_or(Error::Empty { what: "rate" })?.1;
        let axes = Axes::new(frame, course.span_s, (0.0, top));
        let words = if course.base == TimeBase::Number { "no rate: there is no clock" } else { "records per second" };
        axes.draw(canvas, "", words);
        canvas.clipped(&axes, |canvas| {
            for (from, to) in &course.gaps_s {
                let ((left, below), (right, above)) = (axes.at(*from, 0.0), axes.at(*to, top));
                let right = right.max(left + 1.5);
                canvas.polygon(&[(left, below), (right, below), (right, above), (left, above)], ORANGE, 0.35);
            }
            // Steps: a bin's rate holds over all of it.
            let half = 0.5 * (course.span_s.1 - course.span_s.0) / course.rate_hz.len().max(1) as f64;
            let stairs = course.rate_hz.iter().flat_map(|p| [axes.at(p.0 - half, p.1), axes.at(p.0 + half, p.1)]);
            canvas.polyline(stairs.collect(), BLACK, 2.0);
        });
        Ok(axes)
    }
}

/// True if a gap that is no short one beside them lies between two neighbouring points of a line.
fn is_broken(from_s: f64, to_s: f64, gaps_s: &[(f64, f64)]) -> bool {
    let between = gaps_s.partition_point(|gap| 0.5 * (gap.0 + gap.1) <= from_s);
    let inside = gaps_s.iter().skip(between).take_while(|gap| 0.5 * (gap.0 + gap.1) < to_s);
    inside.map(|gap| gap.1 - gap.0).fold(0.0, f64::max) >= 0.5 * (to_s - from_s)
}

fn of(antenna: &AntennaCourse) -> Rgb {
    series_colour(antenna.antenna as usize)
}

/// A colour for each angle, the same at both ends of the range.
fn circular(share: f64) -> Rgb {
    let part = |shift: f64| (127.5 + 100.0 * (2.0 * PI * (share + shift)).cos()).round() as u8;
    (part(0.5), part(0.83), part(0.17))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_broken_at_a_gap_and_not_at_one_that_is_short_beside_its_points() {
        let gaps = [(1.0, 2.0), (5.0, 5.01)];
        assert!(is_broken(0.9, 2.1, &gaps) && is_broken(1.0, 2.0, &gaps));
        assert!(!is_broken(2.1, 3.0, &gaps) && !is_broken(4.0, 6.0, &gaps));
        assert!(is_broken(4.995, 5.012, &gaps));
        assert!(!is_broken(0.0, 1.0, &[]));
    }
}
