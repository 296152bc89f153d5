//! A log over time: CSI as heat maps, amplitude by antenna, RSSI and gain, rate, and what is missing.
use super::axes::{Axes, extent};
use super::canvas::{BLACK, BLUE, Canvas, GREEN, GREY, Key, ORANGE, PURPLE, RED, Rgb, series_colour};
use super::{Error, Format};
use crate::course::{AntennaCourse, COLUMNS, Course};
use csi5300::signal::channel::SUBCARRIERS;
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
/// Losses drawn at most; more of them lie on each other.
const MARKS: usize = 2_000;

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

    /// The frames of `n` panels below each other.
    fn panels(&self, n: usize) -> Vec<[f64; 4]> {
        let (width, height) = self.size;
        let each = ((height - TOP - BOTTOM - GAP * (n as f64 - 1.0)) / n as f64).max(30.0);
        (0..n).map(|k| [LEFT, TOP + k as f64 * (each + GAP), width - LEFT - RIGHT, each]).collect()
    }

    fn csi(&self) -> Canvas {
        let (width, height) = self.size;
        let mut canvas = Canvas::sized(width, height, &format!("{}: CSI, first stream", self.title));
        let antennas = &self.course.antennas;
        let panels = self.panels(2 * antennas.len());
        for (k, antenna) in antennas.iter().enumerate() {
            let last = k + 1 == antennas.len();
            let name = format!("antenna {}: amplitude (dB of a step), subcarrier", antenna.antenna);
            let range = extent(antenna.amplitude_db.iter().copied(), 0.0).unwrap_or((0.0, 1.0));
            let ticks = [range.0, (range.0 + range.1) / 2.0, range.1].map(|db| (db, format!("{db:.0} dB")));
            let shade = |share: f64| ColorMap::Viridis.map_rgb(share).unwrap_or(GREY);
            self.heat(&mut canvas, panels[2 * k], &antenna.amplitude_db, (range, &ticks, &shade), (&name, ""));
            let name =
                format!("antenna {}: phase relative to the middle subcarrier (rad), subcarrier", antenna.antenna);
            let ticks = [(-PI, "-π".into()), (0.0, "0".into()), (PI, "π".into())];
            let below = if last { "time (s)" } else { "" };
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
        axes.y_ticks = Some([0, 10, 20, 30].map(|k| (f64::from(k), k.to_string())).to_vec());
        axes.draw(canvas, x_label, name);
        let (w, h) = (axes.width / COLUMNS as f64, axes.height / SUBCARRIERS as f64);
        let share = |value: f64| ((value - range.0) / (range.1 - range.0)).clamp(0.0, 1.0);
        let known = values.iter().enumerate().filter(|(_, value)| value.is_finite());
        canvas.cells(known.map(|(cell, value)| {
            let (row, column) = (cell / COLUMNS, cell % COLUMNS);
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

    fn levels(&self) -> Result<Canvas, Error> {
        let (width, height) = self.size;
        let course = self.course;
        let mut canvas = Canvas::sized(width, height, &format!("{}: levels and rate", self.title));
        let name = |antenna: &AntennaCourse| format!("antenna {}", antenna.antenna);
        let mut keys: Vec<(Key, Rgb, String)> = course.antennas.iter().map(|a| (Key::Line, of(a), name(a))).collect();
        keys.push((Key::Line, GREY, "gain (AGC)".into()));
        let lost: u64 = course.losses.iter().map(|loss| loss.1).sum();
        let marks = [
            (course.gaps_s.len(), ORANGE, format!("{} gaps", course.gaps_s.len())),
            (course.losses.len(), RED, format!("losses at {} places, {lost} numbers missing", course.losses.len())),
            (course.steps_back.len(), PURPLE, format!("{} steps back of the clock", course.steps_back.len())),
        ];
        keys.extend(marks.into_iter().filter(|mark| mark.0 > 0).map(|(_, colour, words)| (Key::Line, colour, words)));
        canvas.legend(58.0, &keys);
        let panels = self.panels(3);
        let amplitude: Vec<_> = course.antennas.iter().map(|antenna| (of(antenna), &antenna.line_db)).collect();
        self.lines(&mut canvas, panels[0], &amplitude, ("mean amplitude over the subcarriers (dB of a step)", ""));
        let antennas = (0..3).filter(|k| course.antennas.iter().any(|a| a.antenna as usize == *k));
        let mut levels: Vec<_> = antennas.map(|k| (series_colour(k), &course.rssi[k])).collect();
        levels.push((GREY, &course.agc));
        self.lines(&mut canvas, panels[1], &levels, ("RSSI of each antenna, and gain (dB)", ""));
        self.rate(&mut canvas, panels[2])?;
        Ok(canvas)
    }

    fn lines(
        &self,
        canvas: &mut Canvas,
        frame: [f64; 4],
        series: &[(Rgb, &Vec<(f64, f64)>)],
        (name, x_label): (&str, &str),
    ) {
        let all = series.iter().flat_map(|(_, points)| points.iter().map(|point| point.1));
        let axes = Axes::new(frame, self.course.span_s, extent(all, 0.08).unwrap_or((0.0, 1.0)));
        axes.draw(canvas, x_label, name);
        for (colour, points) in series {
            canvas.polyline(points.iter().map(|p| axes.at(p.0, p.1)).collect(), *colour, 1.8);
        }
    }

    /// Records per second, with everything that is missing.
    fn rate(&self, canvas: &mut Canvas, frame: [f64; 4]) -> Result<(), Error> {
        let course = self.course;
        let rates = || course.rate_hz.iter().map(|point| point.1);
        let top = extent(rates().chain([0.0]), 0.08).ok_or(Error::Empty { what: "rate" })?.1;
        let axes = Axes::new(frame, course.span_s, (0.0, top));
        axes.draw(canvas, "time (s)", "records per second; gaps, losses and steps back of the clock");
        canvas.clipped(&axes, |canvas| {
            for (from, to) in &course.gaps_s {
                let corners = [(*from, 0.0), (*to, 0.0), (*to, top), (*from, top)].map(|p| axes.at(p.0, p.1));
                canvas.polygon(&corners, ORANGE, 0.35);
            }
            let every = course.losses.len().div_ceil(MARKS).max(1);
            for (t_s, _) in course.losses.iter().step_by(every) {
                canvas.line(axes.at(*t_s, 0.0), axes.at(*t_s, 0.18 * top), RED, 1.5, false);
            }
            for (t_s, _) in &course.steps_back {
                canvas.line(axes.at(*t_s, 0.0), axes.at(*t_s, top), PURPLE, 2.5, true);
            }
            // Steps: a bin's rate holds over all of it.
            let half = 0.5 * (course.span_s.1 - course.span_s.0) / course.rate_hz.len().max(1) as f64;
            let stairs = course.rate_hz.iter().flat_map(|p| [axes.at(p.0 - half, p.1), axes.at(p.0 + half, p.1)]);
            canvas.polyline(stairs.collect(), if course.gaps_s.is_empty() { BLUE } else { GREEN }, 2.5);
        });
        Ok(())
    }
}

fn of(antenna: &AntennaCourse) -> Rgb {
    series_colour(antenna.antenna as usize)
}

/// A colour for each angle, the same at both ends of the range.
fn circular(share: f64) -> Rgb {
    let part = |shift: f64| (127.5 + 100.0 * (2.0 * PI * (share + shift)).cos()).round() as u8;
    (part(0.5), part(0.83), part(0.17))
}
