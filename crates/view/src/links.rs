//! Links of captures, evaluated in the background; those that somebody wants to see at once, while the background rests. Of each
//! one its row, and what the page draws: profiles, the robot's path, phases.

use crate::Error;
use crate::node::Events;
use csi5300::motion::pose::Mount;
use csi5300::pipeline::{Bearing, Options, Phase};
use csi5300::signal::channel::Channel;
use csi5300_lab::curves::{Curve, evidence, plane_wave, without_motion};
use csi5300_lab::evaluate::quality::{Beside, Table};
use csi5300_lab::evaluate::receivers::receivers;
use csi5300_lab::evaluate::{Capture, Errors, Judged, SetSummary, TrajectorySource, find_all, summarise};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Captures that somebody waits for at a time, each on a thread of its own; further ones are next in the background.
const URGENT: usize = 2;

/// How captures are read and their links estimated.
#[derive(Clone)]
pub struct Reading {
    /// Whose trajectories.
    pub source: TrajectorySource,
    /// The channel of all captures, if it is not each one's own.
    pub channel: Option<Channel>,
    /// How links are estimated.
    pub options: Options,
    /// The antenna, this far (metres forward, left, up) from what the trajectories of the camera or the wheels are of.
    pub antenna_offset_m: Option<[f64; 3]>,
    /// The tracking camera on the robot ([`Capture::camera`]).
    pub camera: Option<Mount>,
}

impl Reading {
    /// Captures with these places of antenna and camera.
    #[must_use]
    pub fn mounted(&self, mut captures: Vec<Capture>) -> Vec<Capture> {
        for capture in &mut captures {
            (capture.antenna_offset_m, capture.camera) = (self.antenna_offset_m, self.camera);
        }
        captures
    }
}

/// A row of the table: a line of `evaluate --json`, and what another program answers.
#[derive(Serialize)]
struct Row<'a> {
    number: usize,
    set: &'a str,
    #[serde(flatten)]
    judged: &'a Judged,
    beside: Option<Beside>,
}

/// Errors of a set, and those of another program on the same links.
#[derive(Serialize)]
struct SetRow {
    #[serde(flatten)]
    own: SetSummary,
    beside: Option<Errors>,
}

/// One link that was evaluated.
struct Done {
    row: Judged,
    /// What the page shows of it, JSON; none without a bearing.
    detail: Option<Arc<str>>,
    beside: Option<Beside>,
}

#[derive(Default)]
struct State {
    /// Captures without a worker yet.
    waiting: VecDeque<usize>,
    /// Captures that are worked on because somebody waits for them.
    urgent: usize,
    links: Vec<Option<Done>>,
    /// Links in the order in which they came.
    arrived: Vec<usize>,
    notes: Vec<String>,
    lost: bool,
}

/// The links of captures.
pub(crate) struct Links {
    captures: Vec<Capture>,
    /// The number of each capture's first link, and one more: that of all links.
    first: Vec<usize>,
    reading: Reading,
    table: Option<Table>,
    state: Mutex<State>,
    /// None is urgent any more.
    calm: Condvar,
}

/// A capture that somebody waits for; until this is dropped no other is begun in the background.
pub(crate) struct Urgent<'a> {
    links: &'a Links,
    capture: usize,
}

impl Urgent<'_> {
    /// Evaluates it.
    pub fn work(self, events: &Events) {
        self.links.evaluate(self.capture, events);
    }
}

impl Drop for Urgent<'_> {
    fn drop(&mut self) {
        self.links.state().urgent -= 1;
        self.links.calm.notify_all();
    }
}

impl Links {
    /// The captures below a folder.
    pub fn below(folder: &Path, mut reading: Reading) -> Option<Self> {
        // Curves, paths and phases are what the page shows.
        reading.options = Options { keep_course: true, ..reading.options };
        let (captures, unreadable) = find_all(folder);
        let captures = reading.mounted(captures);
        if captures.is_empty() {
            return None;
        }
        let mut notes: Vec<String> = unreadable.iter().map(|folder| format!("cannot read {folder}")).collect();
        let (table, note) = Table::noted(folder, reading.source);
        notes.extend(note);
        let mut first = vec![0];
        for capture in &captures {
            let links = capture.transmitters.len().max(1);
            first.push(first.last().map_or(0, |last| last + links));
        }
        let links = first.last().map_or_else(Vec::new, |all| (0..*all).map(|_| None).collect());
        let lost = !notes.is_empty();
        let state = State { waiting: (0..captures.len()).collect(), links, notes, lost, ..State::default() };
        Some(Self { captures, first, reading, table, state: Mutex::new(state), calm: Condvar::new() })
    }

    pub fn captures(&self) -> &[Capture] {
        &self.captures
    }

    /// True if there is a table of another program's answers.
    pub fn has_beside(&self) -> bool {
        self.table.is_some()
    }

    /// How many there are, done or not.
    pub fn len(&self) -> usize {
        self.first.last().copied().unwrap_or_default()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The capture of a link, and its place in it.
    pub fn place(&self, link: usize) -> Option<(usize, usize)> {
        let capture = self.first.partition_point(|first| *first <= link).checked_sub(1)?;
        (link < self.len()).then(|| (capture, link - self.first[capture]))
    }

    /// Names of all links, done or not.
    pub fn names(&self) -> Vec<String> {
        let named = |capture: &Capture| match capture.transmitters.as_slice() {
            [] => vec![capture.link_name("")],
            some => some.iter().map(|(name, _)| capture.link_name(name)).collect(),
        };
        self.captures.iter().flat_map(named).collect()
    }

    /// Evaluates the next capture, once none is urgent; false if none remains.
    pub fn work(&self, events: &Events) -> bool {
        let rested = self.calm.wait_while(self.state(), |state| state.urgent > 0);
        let next = rested.unwrap_or_else(PoisonError::into_inner).waiting.pop_front();
        next.is_some_and(|number| {
            self.evaluate(number, events);
            true
        })
    }

    /// The capture of a link to be worked on now; none if somebody works on it, or on too many.
    pub fn urgent(&self, link: usize) -> Option<Urgent<'_>> {
        let (capture, _) = self.place(link)?;
        let mut state = self.state();
        let at = state.waiting.iter().position(|waiting| *waiting == capture).filter(|_| state.urgent < URGENT)?;
        state.waiting.remove(at);
        state.urgent += 1;
        Some(Urgent { links: self, capture })
    }

    fn evaluate(&self, number: usize, events: &Events) {
        let Some(capture) = self.captures.get(number) else { return };
        let mut details: BTreeMap<String, Arc<str>> = BTreeMap::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| {
            details.insert(name.to_owned(), drawn(bearing).to_string().into());
        };
        let Reading { source, channel, options, .. } = &self.reading;
        let evaluated = capture.evaluate_and(*source, *channel, options, &mut look);
        let done = {
            let mut state = self.state();
            state.lost |= evaluated.lost;
            state.notes.extend(evaluated.notes);
            for (k, row) in evaluated.rows.into_iter().enumerate() {
                let link = self.first[number] + k;
                let beside = self.table.as_ref().and_then(|table| table.of(&row.answer.link));
                let detail = details.remove(&row.answer.link);
                if let Some(place) = state.links.get_mut(link) {
                    *place = Some(Done { row, detail, beside });
                    state.arrived.push(link);
                }
            }
            state.arrived.len()
        };
        events.tell("rows", &format!("{{\"done\":{done},\"of\":{}}}", self.len()));
    }

    /// Evaluates all that is left; `progress` is handed how many links are done.
    pub fn finish(&self, events: &Events, mut progress: impl FnMut(usize)) {
        while self.work(events) {
            progress(self.state().arrived.len());
        }
    }

    /// True if a link has a bearing, and whether something was lost or failed.
    pub fn outcome(&self) -> (bool, bool) {
        let state = self.state();
        let mut rows = state.links.iter().flatten();
        (rows.any(|done| done.row.answer.azimuth_deg.is_some()), state.lost)
    }

    /// What was noted, and why links have no bearing.
    pub fn said(&self) -> (Vec<String>, Vec<String>) {
        let state = self.state();
        let answers = state.links.iter().flatten().map(|done| &done.row.answer);
        let failed = answers.filter_map(|answer| Some(format!("{}: {}", answer.link, answer.error.as_deref()?)));
        (state.notes.clone(), failed.collect())
    }

    /// The rows that arrived after the first `known`, how many arrived, and what was noted.
    pub fn rows(&self, known: usize) -> Result<Vec<u8>, Error> {
        let state = self.state();
        let new = state.arrived.iter().skip(known);
        let row = |number: &usize| {
            let Done { row, beside, .. } = state.links.get(*number)?.as_ref()?;
            Some(Row { number: *number, set: row.set(), judged: row, beside: *beside })
        };
        let rows: Vec<Row<'_>> = new.filter_map(row).collect();
        let (known, of) = (state.arrived.len(), self.len());
        Ok(serde_json::to_vec(&json!({ "known": known, "of": of, "rows": rows, "notes": state.notes }))?)
    }

    /// Errors by set so far, and another program's on the same links.
    pub fn sets(&self) -> Result<Vec<u8>, Error> {
        let state = self.state();
        let rows: Vec<Judged> = state.links.iter().flatten().map(|done| done.row.clone()).collect();
        let beside = |set: &str| {
            let own = state.links.iter().flatten().filter(|done| set == "all" || done.row.set() == set);
            let errors = Errors::of(own.filter_map(|done| done.beside).map(|beside| beside.error_deg));
            (errors.links > 0).then_some(errors)
        };
        let sets = summarise(&rows).into_iter().map(|(set, own)| {
            let beside = beside(&set);
            (set, SetRow { own, beside })
        });
        Ok(serde_json::to_vec(&sets.collect::<BTreeMap<_, _>>())?)
    }

    /// A link: its row, the place of its capture's receiver, and its drawn data. A capture without a worker comes next,
    /// and until it is done the answer has only `waiting`, true, and the logs. `logs` are the numbers of the receiver's
    /// and the transmitter's log. The second value is true for a capture without a worker.
    pub fn link(&self, link: usize, logs: [Option<usize>; 2]) -> Result<Option<(Vec<u8>, bool)>, Error> {
        let Some((capture, _)) = self.place(link) else { return Ok(None) };
        let numbers = json!({ "receiver": logs[0], "transmitter": logs[1] });
        let mut state = self.state();
        let Some(done) = state.links.get(link).and_then(Option::as_ref) else {
            let at = state.waiting.iter().position(|waiting| *waiting == capture);
            if let Some(at) = at {
                state.waiting.remove(at);
                state.waiting.push_front(capture);
            }
            let answer = serde_json::to_vec(&json!({ "waiting": true, "logs": numbers }))?;
            return Ok(Some((answer, at.is_some())));
        };
        let siblings = self.first[capture]..self.first[capture + 1];
        let rows = siblings.filter_map(|k| state.links.get(k)?.as_ref().map(|done| done.row.clone()));
        let receiver = receivers(&rows.collect::<Vec<_>>()).into_iter().next();
        let head = json!({
            "number": link, "row": done.row, "beside": done.beside, "receiver": receiver, "logs": numbers,
        });
        let mut text = serde_json::to_string(&head)?;
        // The drawn part is JSON already.
        text.pop();
        let detail = done.detail.as_deref().unwrap_or("null");
        text += &format!(",\"drawn\":{detail}}}");
        Ok(Some((text.into_bytes(), false)))
    }
}

/// Poses of the path, and positions of samples, at most.
const PLACES: usize = 1_000;
/// Phases at most.
const PHASES: usize = 1_500;
/// Points of a profile at most.
const POINTS: usize = 720;

/// What the page draws of a link that has a bearing, whose course was kept.
fn drawn(bearing: &Bearing) -> Value {
    // What the answer was chosen from first.
    let curves = [evidence(bearing), plane_wave(bearing).ok()].into_iter().flatten().map(relative);
    let xy = |points: &[nalgebra::Vector3<f64>]| thin(points, PLACES, |p| [round(p.x, 1e4), round(p.y, 1e4)]);
    let course = |value: fn(&Phase) -> f64| thin(&bearing.course, PHASES, |p| round(value(p), 1e4));
    let left = without_motion(bearing);
    json!({
        "curves": curves.collect::<Vec<_>>(),
        "path_m": xy(&bearing.path_m),
        "used_m": xy(&bearing.used_m()),
        "phases": {
            "t_s": course(|phase| phase.t_s),
            "one_way_rad": course(|phase| phase.one_way_rad),
            "round_trip_rad": course(|phase| phase.round_trip_rad),
            "compensated_rad": course(|phase| phase.compensated_rad),
            // The residual without the motion, from the first sample in motion.
            "left_t_s": thin(&left, PHASES, |point| round(point.0, 1e4)),
            "left_rad": thin(&left, PHASES, |point| round(point.1, 1e4)),
        },
    })
}

/// A curve relative to its highest value; of more points than are shown the highest of each few.
fn relative(curve: Curve) -> Value {
    let top = curve.points.iter().map(|point| point.1).filter(|value| value.is_finite()).fold(0.0, f64::max);
    let scale = if top > 0.0 { 1.0 / top } else { 1.0 };
    let few = curve.points.len().div_ceil(POINTS).max(1);
    let highest = |few: &[(f64, f64)]| few.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
    let kept = curve.points.chunks(few).filter_map(highest);
    let rounded = kept.map(|(azimuth, value)| (round(azimuth, 1e3), round(value * scale, 1e5)));
    let (azimuths_deg, values): (Vec<f64>, Vec<f64>) = rounded.unzip();
    json!({ "name": curve.name, "azimuths_deg": azimuths_deg, "values": values })
}

/// Every n-th value.
fn thin<T, U>(values: &[T], most: usize, show: impl Fn(&T) -> U) -> Vec<U> {
    values.iter().step_by(values.len().div_ceil(most).max(1)).map(show).collect()
}

/// A value to a fraction of `per`: what a pixel cannot show is not sent.
fn round(value: f64, per: f64) -> f64 {
    (value * per).round() / per
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_somebody_waits_for_is_done_before_what_is_next() {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
        let mut links = Links::below(&fixture, crate::tests::reading()).unwrap();
        // The same capture three times, a link each.
        links.captures = std::iter::repeat_n(links.captures[0].clone(), 3).collect();
        links.first = vec![0, 1, 2, 3];
        *links.state() = State { waiting: (0..3).collect(), links: (0..3).map(|_| None).collect(), ..State::default() };
        let events = Events::default();
        let urgent = links.urgent(2).unwrap();
        assert!(links.urgent(2).is_none() && links.urgent(3).is_none());
        std::thread::scope(|scope| {
            let background = scope.spawn(|| links.finish(&events, |_| {}));
            // The background starts after this.
            urgent.work(&events);
            background.join().unwrap();
        });
        assert_eq!(links.state().arrived, [2, 0, 1]);
        assert!(links.urgent(0).is_none(), "it is done");
    }

    #[test]
    fn the_highest_value_is_kept_and_is_one() {
        let mut points: Vec<(f64, f64)> = (0..5000).map(|k| (f64::from(k) * 0.072 - 180.0, 0.5)).collect();
        points[1234].1 = 4.0;
        let top = points[1234].0;
        let shown = relative(Curve { name: "c".into(), points });
        let values = shown["values"].as_array().unwrap();
        assert!(values.len() <= POINTS);
        let best = values.iter().position(|value| *value == 1.0).unwrap();
        assert!((shown["azimuths_deg"][best].as_f64().unwrap() - top).abs() < 1e-3);
        assert_eq!(values.iter().filter(|value| **value == 0.125).count(), values.len() - 1);
    }

    #[test]
    fn thinning_is_even_and_keeps_short_rows_whole() {
        assert_eq!(thin(&[1, 2, 3], 5, |v| *v), [1, 2, 3]);
        assert_eq!(thin(&(0..10).collect::<Vec<_>>(), 5, |v| *v), [0, 2, 4, 6, 8]);
        assert_eq!(thin(&[0; 0], 5, |v: &i32| *v), [0; 0]);
    }
}
