//! What each tuned number of the library does at half and at double: the last column of docs/tuning.md. First on captures;
//! what does nothing there, on simulated rooms and links.
//!
//! `cargo run --release -p csi5300-lab --features tunable --example sensitivity -- run CAPTURES RESULTS` measures and
//! appends to the file RESULTS what is not in it yet, two numbers at a time (of the groups and numbers named behind it, such
//! as `certainty search.polishes`, if any are); `.. -- table RESULTS` prints a line for
//! each number, and `.. -- write RESULTS src/tuning/values.rs` writes these lines into the source. What is measured, and in
//! which words it is said, is in `figures.rs` and `words.rs`. The same captures give the same figures; processor time
//! is as exact as the machine is quiet.
//!
//! `.. -- refit exponents CAPTURES..`, `looks` and `place` choose numbers again that were chosen by hand, in each
//! fold of places, and print what that gives where it was not chosen (`refit.rs`).

mod changes;
mod figures;
mod pairs;
mod refit;
mod source;
mod words;

use changes::{Change, changes};
use csi5300::internal::TUNING_VARIABLE;
use figures::{Figures, of_captures, of_scenes};
use refit::Family;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Measurements at a time.
const ABREAST: usize = 2;
/// The parts of what is measured.
const CAPTURES: &str = "captures";
const SCENES: &str = "scenes";
/// Rooms of either kind.
const ROOMS: u64 = 4;
/// Measurements without any change: the median of their times is what others are compared with.
const UNCHANGED: usize = 3;

type Fallible<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// What was measured, by the name of the change. None where the program refused or died.
type Results = BTreeMap<String, Option<Figures>>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["captures", folder] => of_captures(Path::new(folder)).and_then(|figures| print(&figures)),
        ["scenes", rooms] => of_scenes(Path::new(rooms)).and_then(|figures| print(&figures)),
        ["run", captures, results, numbers @ ..] => run(Path::new(captures), Path::new(results), numbers),
        ["seen", family, folders @ ..] => {
            let family = Family::named(family).ok_or("no such family");
            family.map_err(Into::into).and_then(|family| print(&refit::seen(family, folders)?))
        }
        ["refit", family, folders @ ..] => match Family::named(family) {
            Some(family) => refit::refit(family, folders),
            None => Err("exponents, looks or place".into()),
        },
        ["table", results] => table(Path::new(results)),
        ["write", results, source] => write(Path::new(results), Path::new(source)),
        _ => Err(
            "usage: sensitivity run CAPTURES RESULTS [GROUP | GROUP.NUMBER ...] | table RESULTS | write RESULTS SOURCE | \
             refit exponents|looks|place CAPTURES.."
                .into(),
        ),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// What a child ends with.
fn print<T: Serialize>(figures: &T) -> Fallible<()> {
    println!("{}", serde_json::to_string(figures)?);
    Ok(())
}

/// A part of what is measured, on a folder of its own.
#[derive(Clone, Copy)]
struct Part<'a> {
    name: &'static str,
    folder: &'a Path,
}

impl Part<'_> {
    /// What a result is called.
    fn of(self, change: &Change) -> String {
        format!("{} {}", change.name, self.name)
    }
}

/// Measures whatever is not in `results` yet, of these numbers and groups; of all where none is named.
fn run(captures: &Path, results: &Path, numbers: &[&str]) -> Fallible<()> {
    let mut jobs: Vec<Change> = (0..UNCHANGED).map(Change::none).collect();
    let group = |change: &Change| change.field.split('.').next().unwrap_or_default().to_owned();
    let is_of = |change: &Change| numbers.iter().any(|name| *name == change.field || *name == group(change));
    jobs.extend(changes()?.into_iter().filter(|change| numbers.is_empty() || is_of(change)));
    let captures = Part { name: CAPTURES, folder: captures };
    measure(&jobs, captures, results)?;
    let known = read(results)?;
    let base = unchanged(&known, CAPTURES)?;
    let still = |job: &Change| {
        let own = known.get(&captures.of(job)).and_then(Option::as_ref);
        own.is_some_and(|own| words::is_still(&base, own))
    };
    jobs.retain(still);
    let rooms = rooms_folder()?;
    measure(&jobs, Part { name: SCENES, folder: &rooms }, results)
}

/// Measures a part with every change for which `results` has none.
fn measure(jobs: &[Change], part: Part<'_>, results: &Path) -> Fallible<()> {
    let known = if results.exists() { read(results)? } else { Results::new() };
    let jobs: Vec<&Change> = jobs.iter().filter(|job| !known.contains_key(&part.of(job))).collect();
    let out = Mutex::new(std::fs::OpenOptions::new().create(true).append(true).open(results)?);
    let next = AtomicUsize::new(0);
    let work = || -> Fallible<()> {
        while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let line = serde_json::to_string(&(
                part.of(job),
                child_of::<Figures>(&[part.name, &part.folder.to_string_lossy()], &job.json)?,
            ))?;
            let mut out = out.lock().map_err(|_| "another measurement died")?;
            writeln!(out, "{line}")?;
            println!("{}", part.of(job));
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..ABREAST).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().map_err(|_| "a worker died")?)
    })
}

/// What a process prints with these numbers in its environment; none if it ends without any, and says why on standard error.
fn child_of<T: DeserializeOwned>(words: &[&str], json: &str) -> Fallible<Option<T>> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(words).env("RAYON_NUM_THREADS", "1").env(TUNING_VARIABLE, json);
    command.stderr(std::process::Stdio::inherit());
    let output = command.output()?;
    if !output.status.success() {
        eprintln!("{json}: {}", output.status);
        return Ok(None);
    }
    Ok(Some(serde_json::from_slice(&output.stdout)?))
}

/// Simulated rooms, always the same, written with the numbers as they are chosen.
fn rooms_folder() -> Fallible<PathBuf> {
    let folder = std::env::temp_dir().join(format!("csi5300-sensitivity-{}", std::process::id()));
    csi5300_lab::rooms::write(&folder, ROOMS, 1)?;
    Ok(folder)
}

fn read(results: &Path) -> Fallible<Results> {
    let text = std::fs::read_to_string(results).map_err(|error| format!("{}: {error}", results.display()))?;
    let line = |line: &str| -> Fallible<(String, Option<Figures>)> { Ok(serde_json::from_str(line)?) };
    text.lines().map(line).collect()
}

/// What was measured of a part without any change.
fn unchanged(results: &Results, part: &str) -> Fallible<Figures> {
    let own = |k| results.get(&format!("{} {part}", Change::none(k).name))?.as_ref();
    let all: Vec<&Figures> = (0..UNCHANGED).filter_map(own).collect();
    Ok(Figures::usual(&all).ok_or("nothing was measured without changes")?)
}

/// What is said of each number that was measured at half and at double, by its name.
fn sentences(results: &Path) -> Fallible<BTreeMap<String, String>> {
    let results = read(results)?;
    let base = unchanged(&results, CAPTURES)?.and(&unchanged(&results, SCENES).unwrap_or_default());
    let mut sentences = BTreeMap::new();
    for change in changes()? {
        let own = |by: &str, part: &str| results.get(&format!("{} {by} {part}", change.field)).map(Option::as_ref);
        let [Some(half), Some(double)] = ["half", "double"].map(|by| own(by, CAPTURES)) else { continue };
        let with_scenes = |captures: Option<&Figures>, by: &str| {
            let scenes = own(by, SCENES).flatten();
            captures.map(|captures| scenes.map_or_else(|| captures.clone(), |scenes| captures.clone().and(scenes)))
        };
        let (half, double) = (with_scenes(half, "half"), with_scenes(double, "double"));
        sentences.insert(change.field, words::sentence(&base, half.as_ref(), double.as_ref()));
    }
    Ok(sentences)
}

fn table(results: &Path) -> Fallible<()> {
    sentences(results)?.iter().for_each(|(field, sentence)| println!("{field}: {sentence}"));
    Ok(())
}

fn write(results: &Path, source: &Path) -> Fallible<()> {
    let text = std::fs::read_to_string(source).map_err(|error| format!("{}: {error}", source.display()))?;
    std::fs::write(source, source::with_sentences(&text, &sentences(results)?))?;
    Ok(())
}
