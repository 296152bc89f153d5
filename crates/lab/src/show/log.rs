//! A log over time: CSI as heat maps, amplitude by antenna, RSSI and gain, rate, losses.

use super::canvas::{Axes, BLACK, Canvas, GREY, Key, ORANGE, PALE, Rgb, WIDTH, extent, series_colour};
use super::{empty, ending};
use crate::Failure;
use crate::course::{AntennaCourse, Course, letter};
use csi5300::source::survey::TimeBase;
use csi5300_say::count;
use kuva::plot::ColorMap;
use kuva::render::render::TextAnchor;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Lowest and highest value of a colour bar, its ticks, and the colour for a value.
type Shades<'a> = ((f64, f64), &'a [(f64, String)], &'a dyn Fn(f64) -> Rgb);

/// Lines of a panel with their colours.
type Lines<'a> = Vec<(Rgb, &'a Vec<(f64, f64)>)>;

/// Pictures of one log.
#[derive(Clone, Copy, Debug)]
pub struct LogPictures<'a> {
    /// Headline.
    pub title: &'a str,
    /// The log's data.
    pub course: &'a Course,
}

/// Height of the drawing; more if its panels need it.
const HEIGHT: f64 = 1_100.0;
const LEFT: f64 = 110.0;
const RIGHT: f64 = 120.0;
const TOP: f64 = 150.0;
const BOTTOM: f64 = 90.0;
/// Space between panels: the upper one's ticks and the lower one's title.
const GAP: f64 = 70.0;
/// Smallest height of a panel: the three labels of a colour bar.
const LEAST: f64 = 60.0;
/// Height of a panel that is only an axis.
const FLAT: f64 = 8.0;
/// Subtitle: the CSI's sender, and skipped frames.
const BELOW_TITLE: f64 = 76.0;

impl LogPictures<'_> {
    /// Writes `STEM-csi` (heat maps of each antenna) and `STEM-levels` (amplitude, RSSI and gain, rate).
    ///
    /// # Errors
    /// If there is nothing to draw, or a picture cannot be drawn or written.
    pub fn write(&self, stem: &Path) -> Result<Vec<PathBuf>, Failure> {
        if self.course.records == 0 {
            return Err(empty("log"));
        }
        let mut written = Vec::new();
        if !self.course.antennas.is_empty() {
            written.extend(self.csi().save(&ending(stem, "-csi"))?);
        }
        written.extend(self.levels()?.save(&ending(stem, "-levels"))?);
        Ok(written)
    }

    /// The frames of `n` panels below each other, starting at `top`, with `below` pixels free under them; the canvas grows if they
    /// do not fit.
    fn panels(&self, canvas: &mut Canvas, n: usize, top: f64, below: f64) -> Vec<[f64; 4]> {
        let rest = top + BOTTOM + below + GAP * (n as f64 - 1.0);
        let each = ((HEIGHT - rest) / n as f64).max(LEAST);
        canvas.grow_to(rest + n as f64 * each);
        (0..n).map(|k| [LEFT, top + k as f64 * (each + GAP), WIDTH - LEFT - RIGHT, each]).collect()
    }

    fn csi(&self) -> Canvas {
        let mut canvas = Canvas::new(HEIGHT, &format!("{}: CSI, first stream", self.title));
        canvas.text((WIDTH / 2.0, BELOW_TITLE), &self.whose(), 18, TextAnchor::Middle, BLACK);
        let antennas = &self.course.antennas;
        let panels = self.panels(&mut canvas, 2 * antennas.len(), TOP, 0.0);
        for (k, antenna) in antennas.iter().enumerate() {
            let last = k + 1 == antennas.len();
            let own = letter(antenna.antenna);
            let name = format!("antenna {own}: amplitude by subcarrier (dB, 0 is the card's step)");
            let range = extent(antenna.amplitude_db.iter().copied(), 0.0).unwrap_or((0.0, 1.0));
            let ticks = [range.0, (range.0 + range.1) / 2.0, range.1].map(|db| (db, format!("{db:.0} dB")));
            let shade = |share: f64| ColorMap::Viridis.map_rgb(share).unwrap_or(GREY);
            self.heat(&mut canvas, panels[2 * k], &antenna.amplitude_db, (range, &ticks, &shade), (&name, ""));
            let name = format!("antenna {own}: phase by subcarrier, less the middle one's (rad)");
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
        let (rows, columns) = (&self.course.rows, self.course.columns);
        let mut axes = Axes::new(frame, self.course.span_s, (0.0, rows.subcarriers as f64));
        axes.y_ticks = Some(self.subcarrier_ticks(axes.height));
        axes.draw(canvas, x_label, name);
        // The last row may have fewer subcarriers.
        let top_of = |row: usize| axes.at(0.0, ((row + 1) * rows.each).min(rows.subcarriers) as f64).1;
        let w = axes.width / columns as f64;
        let share = |value: f64| ((value - range.0) / (range.1 - range.0)).clamp(0.0, 1.0);
        let known = values.iter().enumerate().filter(|(_, value)| value.is_finite());
        canvas.cells(known.map(|(cell, value)| {
            let (row, column) = (cell / columns, cell % columns);
            let (top, below) = (top_of(row), axes.at(0.0, (row * rows.each) as f64).1);
            ([axes.left + column as f64 * w, top, w + 0.6, below - top + 0.6], shade(share(*value)))
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

    /// The CSI's sender, its kind of frames, and skipped frames.
    fn whose(&self) -> String {
        let course = self.course;
        let each = course.rows.each;
        let parts = [
            course.format.map(str::to_owned),
            course.sender.map(|mac| format!("from {mac}")),
            course.rows.frames.clone(),
            (each > 1).then(|| format!("each row is {each} subcarriers")),
            course.left_out(),
        ];
        parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }

    /// Ticks at subcarrier indices. In a log with frames of both widths, ticks at positions in the record: the outermost ones, the
    /// one above the centre, and two in between.
    fn subcarrier_ticks(&self, height: f64) -> Vec<(f64, String)> {
        let rows = &self.course.rows;
        let n = rows.subcarriers;
        let outer = [0, n.saturating_sub(1)];
        let mut ticked = vec![outer[0], n / 4, n / 2, 3 * n / 4, outer[1]];
        ticked.dedup();
        ticked.retain(|place| height > 110.0 || outer.contains(place));
        ticked.into_iter().map(|place| (place as f64 + 0.5, rows.index(place).to_string())).collect()
    }

    /// The frames of this number of line panels, and of the rate, which is only an axis without a clock.
    fn level_panels(&self, canvas: &mut Canvas, lines: usize, top: f64, below: f64) -> Vec<[f64; 4]> {
        if self.has_clock() {
            return self.panels(canvas, lines + 1, top, below);
        }
        let mut panels = self.panels(canvas, lines, top, below + GAP + FLAT);
        let last = panels.last().map(|[left, top, width, height]| [*left, top + height + GAP, *width, FLAT]);
        panels.extend(last);
        panels
    }

    /// True if there are times; without them there is no rate.
    fn has_clock(&self) -> bool {
        self.course.base != TimeBase::Number
    }

    /// The label of the time axis.
    fn time_words(&self) -> &'static str {
        match self.course.base {
            TimeBase::Host if self.course.format.is_some() => "time (s), of the host",
            TimeBase::Number if self.course.format.is_some() => "frame: the log has no times",
            TimeBase::Host => "time (s), of the host: the card's clock stands still",
            TimeBase::Number => "record: the card's clock stands still, and there are no host times",
            _ => "time (s)",
        }
    }

    fn levels(&self) -> Result<Canvas, Failure> {
        let course = self.course;
        let what = if self.has_clock() { "levels and rate" } else { "levels" };
        let mut canvas = Canvas::new(HEIGHT, &format!("{}: {what}", self.title));
        let name = |antenna: usize| format!("antenna {}", letter(antenna));
        // Only the CSI's antennas: others were not requested.
        let drawn = |antenna: usize| course.antennas.iter().any(|own| own.antenna == antenna);
        let mut keys: Vec<(Key, Rgb, String)> =
            course.antennas.iter().map(|a| (Key::Line, of(a), name(a.antenna))).collect();
        keys.extend((!course.agc.is_empty()).then(|| (Key::Line, GREY, "gain (AGC)".into())));
        keys.extend(self.has_clock().then(|| (Key::Line, BLACK, "rate".into())));
        if !course.gaps_s.is_empty() {
            keys.push((Key::Area, ORANGE, count(course.gaps_s.len() as u64, "gap", "gaps")));
        }
        let mut series: Vec<(String, Lines<'_>)> = Vec::new();
        let amplitude: Lines<'_> = course.antennas.iter().map(|antenna| (of(antenna), &antenna.line_db)).collect();
        let sender = course.sender.map_or(String::new(), |mac| format!(" of {mac}"));
        series.push((format!("mean amplitude{sender} (dB, 0 is the card's step)"), amplitude));
        let rssi = course.rssi.iter().enumerate().filter(|(antenna, line)| drawn(*antenna) && !line.is_empty());
        let mut levels: Lines<'_> = rssi.map(|(antenna, line)| (series_colour(antenna), line)).collect();
        let unit = if course.rssi_in_dbm { "dBm" } else { "dB" };
        let words = if course.agc.is_empty() { "RSSI of each antenna" } else { "RSSI of each antenna, and gain" };
        levels.extend((!course.agc.is_empty()).then_some((GREY, &course.agc)));
        series.push((format!("{words} ({unit})"), levels));
        // A value that the format does not contain has no panel.
        series.retain(|(_, lines)| !lines.is_empty());
        let top = TOP.max(58.0 + canvas.legend(58.0, &keys) + 50.0);
        let events = events_of(course);
        let below = events_height(&events);
        let panels = self.level_panels(&mut canvas, series.len(), top, below);
        let [panels @ .., last] = panels.as_slice() else { return Err(empty("levels")) };
        for ((words, lines), panel) in series.iter().zip(panels) {
            self.lines(&mut canvas, *panel, lines, words);
        }
        let axes = self.rate(&mut canvas, *last)?;
        draw_events(&mut canvas, &axes, &events);
        axes.under(&mut canvas, self.time_words(), (below - 24.0).max(0.0));
        Ok(canvas)
    }

    fn lines(&self, canvas: &mut Canvas, frame: [f64; 4], series: &Lines<'_>, name: &str) {
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

    /// Records per second with gaps; without a clock, only the axis.
    fn rate(&self, canvas: &mut Canvas, frame: [f64; 4]) -> Result<Axes, Failure> {
        let course = self.course;
        if !self.has_clock() {
            let mut axes = Axes::new(frame, course.span_s, (0.0, 1.0));
            axes.y_ticks = Some(Vec::new());
            axes.draw(canvas, "", "no rate: there is no clock");
            return Ok(axes);
        }
        let rates = || course.rate_hz.iter().map(|point| point.1);
        let top = extent(rates().chain([0.0]), 0.08).ok_or_else(|| empty("rate"))?.1;
        let axes = Axes::new(frame, course.span_s, (0.0, top));
        axes.draw(canvas, "", "records per second");
        canvas.clipped(&axes, |canvas| {
            for (from, to) in &course.gaps_s {
                let ((left, below), (right, above)) = (axes.at(*from, 0.0), axes.at(*to, top));
                let right = right.max(left + 1.5);
                canvas.polygon(&[(left, below), (right, below), (right, above), (left, above)], ORANGE, 0.35);
            }
            // Steps: a bin's rate applies to all of it.
            let half = 0.5 * (course.span_s.1 - course.span_s.0) / course.rate_hz.len().max(1) as f64;
            let stairs = course.rate_hz.iter().flat_map(|p| [axes.at(p.0 - half, p.1), axes.at(p.0 + half, p.1)]);
            canvas.polyline(stairs.collect(), BLACK, 2.0);
        });
        Ok(axes)
    }
}

/// True if a gap of at least half their distance lies between two neighbouring points of a line.
fn is_broken(from_s: f64, to_s: f64, gaps_s: &[(f64, f64)]) -> bool {
    let between = gaps_s.partition_point(|gap| 0.5 * (gap.0 + gap.1) <= from_s);
    let inside = gaps_s.iter().skip(between).take_while(|gap| 0.5 * (gap.0 + gap.1) < to_s);
    inside.map(|gap| gap.1 - gap.0).fold(0.0, f64::max) >= 0.5 * (to_s - from_s)
}

fn of(antenna: &AntennaCourse) -> Rgb {
    series_colour(antenna.antenna)
}

/// A colour for each angle, the same at both ends of the range.
fn circular(share: f64) -> Rgb {
    let part = |shift: f64| (127.5 + 100.0 * (2.0 * PI * (share + shift)).cos()).round() as u8;
    (part(0.5), part(0.83), part(0.17))
}

/// Ticks of a row at most; more would overlap.
const MARKS: usize = 2_000;
/// Height of a row and of its ticks.
const ROW: f64 = 44.0;
const TICK: f64 = 14.0;

/// One kind of event.
#[derive(Debug, PartialEq)]
struct Events {
    words: String,
    times_s: Vec<f64>,
}

/// Every kind that occurs in the log.
fn events_of(course: &Course) -> Vec<Events> {
    let all = [
        (&course.damaged, "damaged stretch", "damaged stretches", ""),
        (&course.missing, "number missing", "numbers missing", " from bfee_count"),
        (&course.skipped, "number skipped", "numbers skipped", " in frame_count (not heard)"),
        (&course.repeated, "frame reported twice", "frames reported twice", ""),
    ];
    let counted = all.into_iter().map(|(marks, one, many, of)| {
        let sum = marks.iter().map(|mark| mark.1).sum();
        Events { words: count(sum, one, many) + of, times_s: marks.iter().map(|mark| mark.0).collect() }
    });
    let back = count(course.steps_back.len() as u64, "step back of the card's clock", "steps back of the card's clock");
    let back = Events { words: back, times_s: course.steps_back.iter().map(|step| step.0).collect() };
    counted.chain([back]).filter(|events| !events.times_s.is_empty()).collect()
}

/// Height of the rows under the rate.
fn events_height(events: &[Events]) -> f64 {
    if events.is_empty() { 0.0 } else { 30.0 + ROW * events.len() as f64 }
}

/// Draws them below a panel, over the same times.
fn draw_events(canvas: &mut Canvas, above: &Axes, events: &[Events]) {
    for (k, row) in events.iter().enumerate() {
        let top = above.top + above.height + 46.0 + ROW * (k as f64 + 0.4);
        canvas.text((above.left, top - 5.0), &row.words, 18, TextAnchor::Start, BLACK);
        let middle = top + 0.5 * TICK;
        canvas.line((above.left, middle), (above.left + above.width, middle), PALE, 1.0, false);
        for t_s in row.times_s.iter().step_by(row.times_s.len().div_ceil(MARKS).max(1)) {
            let x = above.at(*t_s, above.y.0).0;
            canvas.line((x, top), (x, top + TICK), BLACK, 2.0, false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::course::HeatRows;

    #[test]
    fn a_line_breaks_at_a_gap_that_is_long_relative_to_its_points() {
        let gaps = [(1.0, 2.0), (5.0, 5.01)];
        assert!(is_broken(0.9, 2.1, &gaps) && is_broken(1.0, 2.0, &gaps));
        assert!(!is_broken(2.1, 3.0, &gaps) && !is_broken(4.0, 6.0, &gaps));
        assert!(is_broken(4.995, 5.012, &gaps));
        assert!(!is_broken(0.0, 1.0, &[]));
    }

    /// Draws a course; the SVG of its two pictures.
    fn drawn(course: &Course) -> Vec<String> {
        let folder = crate::temporary::Temporary::folder("log");
        let written = LogPictures { title: "a.dat", course }.write(&folder.0.join("a")).unwrap();
        let svgs = written.iter().filter(|path| path.extension().is_some_and(|kind| kind == "svg"));
        svgs.map(|path| std::fs::read_to_string(path).unwrap()).collect()
    }

    /// A log of three antennas with an event of every kind.
    fn eventful(base: TimeBase) -> Course {
        let antenna = |antenna| AntennaCourse {
            antenna,
            amplitude_db: vec![1.0; 30 * 2],
            phase_rad: vec![0.0; 30 * 2],
            line_db: vec![(0.0, 1.0), (9.0, 2.0)],
        };
        Course {
            records: 9,
            base,
            span_s: (0.0, 9.0),
            columns: 2,
            rows: HeatRows::new(None, 30, 30),
            antennas: (0..3).map(antenna).collect(),
            rssi: vec![vec![(0.0, 30.0), (9.0, 31.0)]; 3],
            agc: vec![(0.0, 20.0), (9.0, 20.0)],
            rate_hz: vec![(4.5, 123.0)],
            missing: vec![(1.0, 1)],
            damaged: vec![(2.0, 1)],
            skipped: vec![(3.0, 2)],
            repeated: vec![(4.0, 1)],
            steps_back: vec![(5.0, 1.0)],
            ..Course::default()
        }
    }

    /// Values of an attribute in all tags.
    fn numbers(svg: &str, name: &str) -> Vec<f64> {
        let name = format!(" {name}=\"");
        let parts = svg.split(&name).skip(1);
        parts.filter_map(|rest| rest.split('"').next()?.parse().ok()).collect()
    }

    #[test]
    fn a_picture_is_not_cut_off_and_grows_with_its_panels() {
        for (base, antennas) in [TimeBase::Card, TimeBase::Number].into_iter().flat_map(|base| [(base, 3), (base, 8)]) {
            let mut course = eventful(base);
            course.antennas = course.antennas.iter().cycle().take(antennas).cloned().collect();
            let heights = drawn(&course).into_iter().map(|svg| {
                let height = numbers(&svg, "height")[0];
                let lowest = ["y", "y1", "y2"].iter().flat_map(|name| numbers(&svg, name)).fold(0.0, f64::max);
                assert!(height >= HEIGHT && lowest <= height - 10.0, "{lowest} of {height}");
                height
            });
            assert_eq!(heights.map(|height| height > HEIGHT).collect::<Vec<_>>(), [antennas > 3, false]);
        }
    }

    #[test]
    fn without_a_clock_there_is_no_rate() {
        let levels = |base| drawn(&eventful(base)).pop().unwrap();
        let (with, without) = (levels(TimeBase::Host), levels(TimeBase::Number));
        assert!(with.contains(">rate<") && with.contains("levels and rate") && !with.contains("no rate"));
        assert!(
            !without.contains(">rate<") && !without.contains("and rate") && without.contains("no rate: there is no")
        );
        assert_eq!(with.matches("<path").count(), without.matches("<path").count() + 1);
        assert!(without.contains("numbers skipped") && without.contains("record: the card"), "{without}");
    }

    #[test]
    fn only_existing_events_have_rows_and_one_is_singular() {
        let mut course = Course::default();
        assert!(events_of(&course).is_empty() && events_height(&events_of(&course)) == 0.0);
        (course.missing, course.repeated) = (vec![(1.0, 1)], vec![(2.0, 1), (3.0, 1)]);
        course.steps_back = vec![(4.0, 0.5)];
        let words: Vec<String> = events_of(&course).into_iter().map(|row| row.words).collect();
        let expected =
            ["1 number missing from bfee_count", "2 frames reported twice", "1 step back of the card's clock"];
        assert_eq!(words, expected);
    }
}
