//! The numbers that were chosen by hand on captures, chosen again by a program, in each fold of places.
//!
//! All links are estimated with every setting of a family (a process each, as everywhere here). A setting's loss over some
//! places is the sum over the columns of the mean over places of the mean over links of the error, which counts 60 degrees at
//! most (180 where a link fails). In each fold the setting of least loss at the other places is judged at the place that was
//! left out; of equal ones the one that is shipped, then the first.

use crate::{Fallible, child_of};
use csi5300::internal::chosen_tuning_json;
use csi5300::maths::median;
use csi5300::pipeline::{Accuracy, Options};
use csi5300_lab::evaluate::quality::receivers;
use csi5300_lab::evaluate::{Capture, Judged, TrajectorySource, find};
use csi5300_lab::folds::{Kind, gather, set_and_place};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// No error counts more than this in a setting's loss, degrees: beyond, a bearing is wrong, however far.
const MOST_DEG: f64 = 60.0;
/// What a link that failed counts as in what is reported, degrees.
const FAILED_DEG: f64 = 180.0;

/// Numbers that are chosen together.
#[derive(Clone, Copy, PartialEq)]
pub enum Family {
    /// Exponents of the views of the round trip, the channel centre and the one-way channel.
    Exponents,
    /// Exponents that turn the joint power into a likelihood, between peaks and within one.
    Looks,
    /// The power of a link's evidence where several locate a receiver.
    Place,
}

impl Family {
    /// By name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "exponents" => Some(Self::Exponents),
            "looks" => Some(Self::Looks),
            "place" => Some(Self::Place),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Exponents => "exponents",
            Self::Looks => "looks",
            Self::Place => "place",
        }
    }

    /// Its settings, the one that is shipped first: every number by each of its factors.
    fn settings(self) -> Fallible<Vec<Value>> {
        let chosen: Value = serde_json::from_str(&chosen_tuning_json()?)?;
        let around = [1.0, 0.5, 1.5];
        let (group, numbers, factors): (_, &[&str], &[f64]) = match self {
            Self::Exponents => ("views", &["round_trip_weight", "centre_weight", "one_way_weight"], &around),
            Self::Looks => ("prior", &["looks_between_peaks", "looks_within_peak"], &[1.0, 0.5, 0.7, 1.4]),
            Self::Place => ("locate", &["candidate_power"], &[1.0, 0.25, 0.5, 0.7, 1.4, 2.0, 4.0]),
        };
        let mut settings = vec![Map::new()];
        for number in numbers {
            let own = chosen[group][number].as_f64().ok_or_else(|| format!("there is no {group}.{number}"))?;
            let with = |setting: &Map<String, Value>, by: f64| {
                let mut setting = setting.clone();
                setting.insert((*number).to_owned(), json!(own * by));
                setting
            };
            settings = settings.iter().flat_map(|setting| factors.iter().map(|by| with(setting, *by))).collect();
        }
        Ok(settings.into_iter().map(|setting| json!({ group: setting })).collect())
    }
}

/// An error of one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    column: String,
    place: String,
    /// Absolute, degrees.
    error_deg: f64,
}

/// What a child measures: every link with the numbers in its environment.
pub fn seen(family: Family, folders: &[&str]) -> Fallible<Vec<Seen>> {
    let mut captures = Vec::new();
    for folder in folders {
        let (found, unreadable) = find(Path::new(folder));
        if let Some(first) = unreadable.first() {
            return Err(first.clone().into());
        }
        captures.extend(found);
    }
    let options = Options::new("108".parse()?).with_accuracy(Accuracy::default().with_paths(false));
    Ok(match family {
        Family::Exponents | Family::Looks => answers(&captures, &options),
        Family::Place => located(&captures, &options),
    })
}

fn sight(set: &str) -> &'static str {
    if set.contains("NLOS") { "NLOS" } else { "LOS" }
}

fn trajectory(source: TrajectorySource) -> &'static str {
    match source {
        TrajectorySource::GroundTruth => "motion capture",
        TrajectorySource::T265 => "tracking camera",
        TrajectorySource::RollingT265 => "rolling camera",
        TrajectorySource::Odometry => "wheel odometry",
    }
}

/// Bearings by every trajectory over whole motions and parts.
fn answers(captures: &[Capture], options: &Options) -> Vec<Seen> {
    let rows = gather(captures, options);
    let of_row = |row: &csi5300_lab::folds::FoldRow| Seen {
        column: format!("{}, 1/{}, {}", trajectory(row.source), row.part.of, sight(&row.set)),
        place: row.place.clone(),
        error_deg: row.answered(Kind::Full).map_or(FAILED_DEG, |own| own.error_deg.abs()),
    };
    rows.iter().map(of_row).collect()
}

/// All bearings, as they are answered and as the places of their receivers choose them, where these have one.
fn located(captures: &[Capture], options: &Options) -> Vec<Seen> {
    let mut seen = Vec::new();
    for source in [TrajectorySource::GroundTruth, TrajectorySource::T265] {
        for capture in captures {
            let rows: Vec<Judged> = capture.evaluate(source, None, options).rows;
            let (set, place) = set_and_place(&capture.place);
            let mut add = |kind: &str, error_deg: f64| {
                let column = format!("{}, {}, {kind}", trajectory(source), sight(&set));
                seen.push(Seen { column, place: place.clone(), error_deg: error_deg.abs() });
            };
            let receivers = receivers(&rows);
            let mut chosen: BTreeMap<&str, f64> = BTreeMap::new();
            for receiver in &receivers {
                chosen
                    .extend(receiver.names.iter().map(String::as_str).zip(receiver.azimuth_errors_deg.iter().copied()));
            }
            for row in &rows {
                let answered = row.error_from_mean_pose_deg.unwrap_or(FAILED_DEG);
                add("as answered", answered);
                add("as the place chooses", chosen.get(row.answer.link.as_str()).copied().unwrap_or(answered));
            }
        }
    }
    seen
}

/// Errors by column and place.
type Table<'a> = BTreeMap<&'a str, BTreeMap<&'a str, Vec<f64>>>;

fn table(seen: &[Seen]) -> Table<'_> {
    let mut table = Table::new();
    for one in seen {
        table.entry(&one.column).or_default().entry(&one.place).or_default().push(one.error_deg);
    }
    table
}

/// The loss of a setting over all places but one.
fn loss(table: &Table<'_>, without: Option<&str>) -> f64 {
    let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len().max(1) as f64;
    let of_places = |places: &BTreeMap<&str, Vec<f64>>| {
        let capped = |errors: &Vec<f64>| mean(&errors.iter().map(|error| error.min(MOST_DEG)).collect::<Vec<_>>());
        let others = places.iter().filter(|(place, _)| Some(**place) != without);
        mean(&others.map(|(_, errors)| capped(errors)).collect::<Vec<_>>())
    };
    table.values().map(of_places).sum()
}

/// The setting of least loss without a place.
fn best(tables: &[Table<'_>], without: Option<&str>) -> usize {
    let losses: Vec<f64> = tables.iter().map(|table| loss(table, without)).collect();
    (0..losses.len()).min_by(|a, b| losses[*a].total_cmp(&losses[*b])).unwrap_or(0)
}

fn figures(errors: impl Iterator<Item = f64>) -> String {
    let mut all: Vec<f64> = errors.collect();
    let (count, wide) = (all.len().max(1) as f64, all.iter().filter(|error| **error > 20.0).count());
    let mean = all.iter().sum::<f64>() / count;
    format!("{mean:.2} / {:.2} / {:.1} %", median(&mut all).unwrap_or(f64::NAN), 100.0 * wide as f64 / count)
}

/// Measures all settings of a family and prints, for each column, the errors (mean / median / share over 20 degrees) with the
/// numbers that are shipped, with those that each fold chooses, and with those that all places together choose.
pub fn refit(family: Family, folders: &[&str]) -> Fallible<()> {
    let settings = family.settings()?;
    let found: Mutex<BTreeMap<usize, Vec<Seen>>> = Mutex::default();
    let next = AtomicUsize::new(0);
    let work = || -> Fallible<()> {
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(setting) = settings.get(at) else { return Ok(()) };
            let words = [&["seen", family.name()], folders].concat();
            let own: Option<Vec<Seen>> = child_of(&words, &setting.to_string())?;
            let own =
                own.filter(|own| !own.is_empty()).ok_or_else(|| format!("nothing was measured with {setting}"))?;
            eprintln!("{} of {} settings", at + 1, settings.len());
            found.lock().map_err(|_| "another measurement died")?.insert(at, own);
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..crate::ABREAST).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().map_err(|_| "a worker died")?)
    })?;
    let found = found.into_inner().map_err(|_| "a measurement died")?;
    let tables: Vec<Table<'_>> = found.values().map(|seen| table(seen)).collect();
    print(&settings, &tables);
    Ok(())
}

fn print(settings: &[Value], tables: &[Table<'_>]) {
    let Some(shipped) = tables.first() else { return };
    let places: BTreeSet<&str> = shipped.values().flat_map(|places| places.keys().copied()).collect();
    let chosen: BTreeMap<&str, usize> = places.iter().map(|place| (*place, best(tables, Some(place)))).collect();
    let all = best(tables, None);
    let mut times: BTreeMap<usize, usize> = BTreeMap::new();
    chosen.values().for_each(|at| *times.entry(*at).or_default() += 1);
    println!(
        "{} places, {} settings; absolute errors, degrees: mean / median / share over 20",
        places.len(),
        settings.len()
    );
    for (at, count) in &times {
        println!("in {count} folds: {}", settings[*at]);
    }
    println!(
        "by all places: {}; loss {:.3}, shipped {:.3}",
        settings[all],
        loss(&tables[all], None),
        loss(shipped, None)
    );
    println!("column: shipped; chosen in each fold; by all places");
    for (column, own) in shipped {
        let of = |at: usize| tables[at].get(column).map(|places| places.values().flatten().copied());
        let folds = own.keys().filter_map(|place| tables[chosen[place]].get(column)?.get(place)).flatten().copied();
        println!(
            "{column}: {}; {}; {}",
            figures(of(0).into_iter().flatten()),
            figures(folds),
            figures(of(all).into_iter().flatten())
        );
    }
}
