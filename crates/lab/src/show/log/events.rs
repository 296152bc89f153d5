//! Losses and counter events of a log, one row of ticks per kind, under the rate.

use super::super::axes::Axes;
use super::super::canvas::{BLACK, Canvas, PALE};
use crate::course::Course;
use crate::words::count;
use kuva::render::render::TextAnchor;

/// Ticks of a row at most; more would overlap.
const MARKS: usize = 2_000;
/// Height of a row and of its ticks.
const ROW: f64 = 44.0;
const TICK: f64 = 14.0;

/// One kind of event.
#[derive(Debug, PartialEq)]
pub(super) struct Events {
    words: String,
    times_s: Vec<f64>,
}

/// Every kind that occurs in the log.
pub(super) fn of(course: &Course) -> Vec<Events> {
    let row = |words: String, times_s: Vec<f64>| Events { words, times_s };
    let sum = |marks: &[(f64, u64)]| marks.iter().map(|mark| mark.1).sum::<u64>();
    let times = |marks: &[(f64, u64)]| marks.iter().map(|mark| mark.0).collect::<Vec<_>>();
    let back = count(course.steps_back.len() as u64, "step back of the card's clock", "steps back of the card's clock");
    let missing = count(sum(&course.missing), "number missing", "numbers missing");
    let damaged = count(course.damaged.len() as u64, "damaged stretch", "damaged stretches");
    let skipped = count(sum(&course.skipped), "number skipped", "numbers skipped");
    let repeated = count(course.repeated.len() as u64, "frame reported twice", "frames reported twice");
    let all = [
        row(damaged, course.damaged.clone()),
        row(format!("{missing} from bfee_count"), times(&course.missing)),
        row(format!("{skipped} in frame_count (not heard)"), times(&course.skipped)),
        row(repeated, course.repeated.clone()),
        row(back, course.steps_back.iter().map(|step| step.0).collect()),
    ];
    all.into_iter().filter(|events| !events.times_s.is_empty()).collect()
}

/// Height of the rows under the rate.
pub(super) fn height(events: &[Events]) -> f64 {
    if events.is_empty() { 0.0 } else { 30.0 + ROW * events.len() as f64 }
}

/// Draws them below a panel, over the same times.
pub(super) fn draw(canvas: &mut Canvas, above: &Axes, events: &[Events]) {
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

    #[test]
    fn only_existing_events_have_rows_and_one_is_singular() {
        let mut course = Course::default();
        assert!(of(&course).is_empty() && height(&of(&course)) == 0.0);
        (course.missing, course.repeated) = (vec![(1.0, 1)], vec![2.0, 3.0]);
        course.steps_back = vec![(4.0, 0.5)];
        let words: Vec<String> = of(&course).into_iter().map(|row| row.words).collect();
        let expected =
            ["1 number missing from bfee_count", "2 frames reported twice", "1 step back of the card's clock"];
        assert_eq!(words, expected);
    }
}
