//! `csi5300 evaluate`.

use super::args::{Estimation, Step};
use super::captures::{A_CAPTURE, Reading};
use super::{Outcome, Result, fixed, print, print_json, usage};
use clap::ValueEnum;
use csi5300::maths::median;
use csi5300_lab::evaluate::quality::{Ranges, over_bound, ranges, receivers, risk_coverage, sure};
use csi5300_lab::evaluate::{
    ALL_SETS, Capture, Errors, Evaluated, Judged, SetSummary, TrajectorySource, find, reliability, summarise,
};
#[cfg(feature = "plot")]
use csi5300_lab::show::set::{self, Others};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

// Arguments of `evaluate`.
#[derive(clap::Args)]
pub struct Args {
    /// Folders with captures below them, as in the WSR data set
    #[arg(required_unless_present = "rooms", value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Also evaluate this many simulated rooms with the transmitters in sight, and as many with walls before them (with
    /// the true trajectory or odometry)
    #[arg(long, value_name = "N")]
    rooms: Option<u64>,
    /// Seed of the first simulated room
    #[arg(long, default_value_t = 1, value_name = "NUMBER")]
    seed: u64,
    /// Folder for pictures: error distributions, refusals, reliability, a map of each place; with --folds reliability
    #[cfg(feature = "plot")]
    #[arg(long, visible_alias = "plot", value_name = "DIR", conflicts_with = "ablation")]
    out: Option<PathBuf>,
    #[cfg(feature = "plot")]
    #[command(flatten)]
    pictures: super::pictures::Pictures,
    #[command(flatten)]
    reading: Reading,
    /// JSON Lines: one object a link, then a summary
    #[arg(long)]
    json: bool,
    /// Also evaluate with each step left out, and print what it brings
    #[arg(long)]
    ablation: bool,
    /// Leave each place out in turn, with everything fitted to the others: errors with intervals, by motion capture,
    /// the tracking camera (as recorded, and held to what wheels can roll) and wheels, whole motions, halves and quarters.
    /// A place is the last two folders of a capture
    #[arg(long, value_enum, value_name = "UNIT", conflicts_with_all = ["ablation", "trajectory"])]
    folds: Option<Folds>,
    /// Captures worked on at a time; 0 is one for each core
    #[arg(long, default_value_t = 0, value_name = "N")]
    threads: usize,
}

/// What is left out in turn.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Folds {
    /// A set's folder, with all of its captures
    Places,
}

/// Simulated rooms in a folder of their own, which goes with the value.
struct Rooms(PathBuf);

impl Rooms {
    fn write(count: u64, seed: u64) -> std::result::Result<Self, String> {
        let folder = std::env::temp_dir().join(format!("csi5300-rooms-{}", std::process::id()));
        let rooms = Self(folder);
        csi5300_lab::rooms::write(&rooms.0, count, seed).map_err(|error| error.to_string())?;
        Ok(rooms)
    }
}

impl Drop for Rooms {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Evaluates a tree of captures.
pub fn run(args: &Args) -> Result {
    #[cfg(feature = "plot")]
    check_pictures(args)?;
    let rooms = args.rooms.map(|count| Rooms::write(count, args.seed)).transpose()?;
    let source = args.reading.source();
    let mut options = args.reading.options().unwrap_or_else(|message| usage(&message));
    // Paths are in the lines of JSON only, and change no bearing.
    options.accuracy = options.accuracy.with_paths(options.accuracy.paths && args.json);
    let (captures, unreadable) = find_all(args.folders.iter().chain(rooms.as_ref().map(|rooms| &rooms.0)))?;
    let captures = args.reading.mounted(captures);
    #[cfg(feature = "plot")]
    if let Some(folder) = args.out.as_ref().filter(|_| args.folds.is_none()) {
        args.pictures.check_maps(folder, &captures)?;
    }
    for folder in &unreadable {
        wrong!("cannot read {folder}");
    }
    let beside = Beside::read(args);
    let bar = super::bar(captures.len() as u64, &super::some(captures.len() as u64, "capture", "captures"));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build().map_err(|error| error.to_string())?;
    if let Some(Folds::Places) = args.folds {
        bar.clear();
        let report = pool.install(|| super::folds::run(&captures, &options, args.json));
        #[cfg(feature = "plot")]
        if let Some(folder) = &args.out {
            let written = set::write_folds(&report, folder, &args.pictures.format());
            let written = written.map_err(|error| super::pictures::refused(&error))?;
            note!("{}: {}", folder.display(), super::some(written.len() as u64, "picture", "pictures"));
        }
        return Ok(super::folds::outcome(&report));
    }
    let one = |capture: &Capture| {
        let mut evaluated = capture.evaluate(source, args.reading.channel, &options);
        super::hint::add_all(&mut evaluated.rows);
        bar.inc();
        evaluated
    };
    if args.ablation {
        let rows = pool.install(|| ablation(args, source, &captures));
        bar.clear();
        show_ablation(&rows?, args.json);
        return Ok(Outcome::Done);
    }
    let results: Vec<Evaluated> = pool.install(|| captures.par_iter().map(one).collect());
    bar.clear();
    for note in results.iter().flat_map(|result| &result.notes) {
        note!("{note}");
    }
    let lost = !unreadable.is_empty() || beside.lost || results.iter().any(|result| result.lost);
    let rows: Vec<Judged> = results.into_iter().flat_map(|result| result.rows).collect();
    let shown = show(args, &rows, &beside);
    for row in rows.iter().filter(|row| row.answer.error.is_some()) {
        wrong!("{}: {}", row.answer.link, row.answer.error.as_deref().unwrap_or_default());
    }
    shown?;
    Ok(match rows.iter().any(|row| row.answer.azimuth_deg.is_some()) {
        false => Outcome::Nothing,
        true if lost => Outcome::DataLost,
        true => Outcome::Done,
    })
}

/// What another program answers on the links, for the pictures.
#[derive(Default)]
struct Beside {
    #[cfg(feature = "plot")]
    others: Others,
    /// True if some of it could not be read.
    lost: bool,
}

impl Beside {
    /// Reads the tables beside the captures where they are drawn, and says what of them is left out.
    fn read(args: &Args) -> Self {
        #[cfg_attr(not(feature = "plot"), allow(unused_mut))]
        let mut beside = Self::default();
        #[cfg(feature = "plot")]
        for folder in args.folders.iter().filter(|_| args.out.is_some() && args.folds.is_none()) {
            if let Some(words) = beside.others.add(folder, args.reading.source()) {
                note!("{words}");
                beside.lost = true;
            }
        }
        #[cfg(not(feature = "plot"))]
        let _ = args;
        beside
    }
}

/// Refuses pictures that are there before minutes of work, not after.
#[cfg(feature = "plot")]
fn check_pictures(args: &Args) -> std::result::Result<(), String> {
    args.pictures.must_have(args.out.as_deref(), "--out");
    let Some(folder) = &args.out else { return Ok(()) };
    let stems = match args.folds {
        Some(Folds::Places) => set::fold_stems(folder).to_vec(),
        None => set::stems(folder).to_vec(),
    };
    args.pictures.check(&stems)
}

/// The captures below all folders, and folders that could not be read.
fn find_all<'a>(
    folders: impl Iterator<Item = &'a PathBuf>,
) -> std::result::Result<(Vec<Capture>, Vec<String>), String> {
    let (mut captures, mut unreadable) = (Vec::new(), Vec::new());
    for folder in folders {
        if !folder.is_dir() {
            return Err(format!("{} is not a folder", folder.display()));
        }
        let (found, failed) = find(folder);
        if found.is_empty() {
            let without = csi5300_lab::evaluate::find_all(folder).0.len();
            return Err(match without {
                0 => format!("no capture below {}: {A_CAPTURE}", folder.display()),
                _ => format!(
                    "no capture with a truth below {} (groundtruth_positions.json); {} without one: `report`, `view`, \
                     `explain` and `locate` take {}",
                    folder.display(),
                    super::some(without as u64, "capture", "captures"),
                    if without == 1 { "it" } else { "them" }
                ),
            });
        }
        captures.extend(found);
        unreadable.extend(failed);
    }
    Ok((captures, unreadable))
}

/// Prints rows and summary, and draws the pictures that were asked for.
#[cfg_attr(not(feature = "plot"), allow(unused_variables))]
fn show(args: &Args, rows: &[Judged], beside: &Beside) -> std::result::Result<(), String> {
    let summary = summarise(rows);
    if args.json {
        rows.iter().for_each(print_json);
        print_json(&BTreeMap::from([("summary", &summary)]));
    } else {
        print(&table(rows, &summary));
        print(&worth(rows));
    }
    #[cfg(feature = "plot")]
    if let Some(folder) = &args.out {
        let written = set::write(rows, &beside.others, folder, &args.pictures.format());
        let written = written.map_err(|error| super::pictures::refused(&error))?;
        note!("{}: {}", folder.display(), super::some(written.len() as u64, "picture", "pictures"));
    }
    Ok(())
}

fn table(rows: &[Judged], summary: &BTreeMap<String, SetSummary>) -> String {
    let width = rows.iter().map(|row| row.answer.link.len()).max().unwrap_or(4).max(4);
    let mut text = format!(
        "{:width$}  {:>9} {:>6} {:>9} {:>9} {:>9} {:>5} {:>6} {:>8}\n{:width$}  {:>9} {:>6} {:>9} {:>9} {:>9} {:>5} {:>6} {:>8}\n",
        "link",
        "azimuth",
        "+-",
        "mirror",
        "truth",
        "error",
        "coh.",
        "pairs",
        "CFO",
        "",
        "deg",
        "deg",
        "deg",
        "deg",
        "deg",
        "",
        "",
        "Hz"
    );
    let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| fixed(value, digits));
    for row in rows {
        let a = &row.answer;
        let _ = writeln!(
            text,
            "{:width$}  {:>9} {:>6} {:>9} {:>9} {:>9} {:>5} {:>6} {:>8}",
            a.link,
            number(a.azimuth_deg, 2),
            number(a.azimuth_sd_deg, 2),
            number(a.mirror_deg, 2),
            number(row.true_from_mean_pose_deg, 2),
            number(row.error_from_mean_pose_deg, 2),
            number(a.coherence, 2),
            a.pairs_in_motion,
            number(a.cfo_hz, 0),
        );
    }
    let _ = writeln!(text, "\nabsolute error, degrees: mean / median / 90th percentile / share over 20 degrees");
    for (set, s) in all_last(summary) {
        let _ = writeln!(
            text,
            "{set}: {}, {} failed; from the mean pose {}; from the start {}",
            super::some(s.links as u64, "link", "links"),
            s.failed,
            line(&s.from_mean_pose),
            line(&s.from_start)
        );
    }
    text
}

/// Sets in their order, then all of them together.
fn all_last<T>(sets: &BTreeMap<String, T>) -> impl Iterator<Item = (&String, &T)> {
    let named = |all: bool| sets.iter().filter(move |(set, _)| (*set == ALL_SETS) == all);
    named(false).chain(named(true))
}

pub(super) fn line(errors: &Errors) -> String {
    let Errors { links, mean_deg, median_deg, p90_deg, over_20, .. } = errors;
    if *links == 0 {
        return "-".into();
    }
    format!("{mean_deg:.2} / {median_deg:.2} / {p90_deg:.2} / {:.1} %", over_20 * 100.0)
}

/// Refusals, reliability, ranges and receivers.
fn worth(rows: &[Judged]) -> String {
    let mut text = String::from("\nkept  least confidence  error from the mean pose\n");
    for kept in risk_coverage(rows) {
        let _ =
            writeln!(text, "{:3.0} %  {:.2}              {}", kept.share * 100.0, kept.confidence, line(&kept.errors));
    }
    text += "\nconfidence  links  said  within 5 degrees\n";
    for bin in reliability(&sure(rows)) {
        let (from, to) = (bin.from, bin.to);
        let _ = writeln!(text, "{from:.1} .. {to:.1}  {:5}  {:.2}  {:.2}", bin.links, bin.said, bin.right);
    }
    let located = receivers(rows);
    for (set, own) in sets(rows) {
        let mut off: Vec<f64> = located
            .iter()
            .filter(|r| r.capture == set || r.capture.starts_with(&format!("{set}/")))
            .filter_map(|r| r.off_m)
            .collect();
        let mut parts: Vec<String> = Vec::new();
        parts.extend(over_bound(&own).map(|over| format!("error over error bar {over:.2}")));
        parts.extend(range_words(&ranges(&own)));
        let located = super::some(off.len() as u64, "receiver", "receivers");
        parts.extend(median(&mut off).map(|off| format!("{located} located, median error {off:.2} m")));
        if !parts.is_empty() {
            let _ = writeln!(text, "{set}: {}", parts.join("; "));
        }
    }
    text
}

/// How good the ranges of a set are, where some are known.
fn range_words(ranges: &Ranges) -> Option<String> {
    let median_m = ranges.median_m?;
    let links = super::some(ranges.links as u64, "link", "links");
    let over = ranges.over_bound.map_or(String::new(), |over| format!(", {over:.2} of the predicted deviation"));
    Some(format!("range from {} of {links}, median error {median_m:.2} m{over}", ranges.reported))
}

/// Links by set.
fn sets(rows: &[Judged]) -> BTreeMap<&str, Vec<&Judged>> {
    let mut sets: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        sets.entry(row.set()).or_default().push(row);
    }
    sets
}

/// Errors of a set without a step; with everything where none is named.
#[derive(serde::Serialize)]
struct AblationRow {
    without: Option<String>,
    set: String,
    #[serde(flatten)]
    errors: Errors,
}

fn show_ablation(rows: &[AblationRow], json: bool) {
    if json {
        return rows.iter().for_each(print_json);
    }
    let mut text = String::from("error from the mean pose: mean / median / 90th percentile / share over 20 degrees\n");
    for AblationRow { without, set, errors } in rows {
        let name = without.as_ref().map_or("everything".into(), |step| format!("without {step}"));
        let _ = writeln!(text, "{name:22} {set:12} {:4} links  {}", errors.links, line(errors));
    }
    print(&text);
}

/// Evaluates with everything, then without each step.
fn ablation(
    args: &Args,
    source: TrajectorySource,
    captures: &[Capture],
) -> std::result::Result<Vec<AblationRow>, String> {
    let mut found = Vec::new();
    let runs = std::iter::once(None).chain(Step::ALL.into_iter().map(Some));
    for left_out in runs {
        let estimation = Estimation { without: left_out.into_iter().collect(), ..args.reading.estimation.clone() };
        let mut options = args.reading.options_of(&estimation)?;
        options.accuracy = options.accuracy.with_paths(false);
        let rows: Vec<Judged> =
            captures.par_iter().flat_map_iter(|c| c.evaluate(source, args.reading.channel, &options).rows).collect();
        let without = left_out.and_then(|step| step.to_possible_value()).map(|value| value.get_name().to_owned());
        for (set, own) in sets(&rows) {
            let errors = Errors::of(own.iter().filter_map(|row| row.error_from_mean_pose_deg));
            found.push(AblationRow { without: without.clone(), set: set.to_owned(), errors });
        }
    }
    Ok(found)
}
