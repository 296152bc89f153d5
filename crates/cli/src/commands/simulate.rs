//! `csi5300 simulate`.

mod compare;
mod serve;

use super::draft::{Draft, must_not_be_read};
use super::{InWords, Outcome, Result, Words, print, print_json, progress, some, usage};
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::suite::{REPETITIONS, Summary, experiments, run_all, summarise};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::scene::Driver;
use csi5300_sim::{Injected, Room, Scene, WrittenCapture, write_dataset};
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `simulate`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  csi5300 simulate lab-circle --out room\n  \
                        csi5300 simulate --rx RX.dat --tx TX.dat --trajectory T.csv --channel 108\n  \
                        csi5300 simulate suite --repetitions 3")]
pub struct Args {
    /// A scene file, a built-in scene (lab-circle, lab-line, paper-circle, paper-line, two-antennas), or suite:
    /// repeated experiments of Dijkstra et al. as a table
    #[arg(required_unless_present_any = ["rx", "bag"])]
    scene: Option<PathBuf>,
    /// Folder for logs, trajectories and truth; of a comparison: fitted scene, simulated capture, pictures
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seed instead of the scene's
    #[arg(long)]
    seed: Option<u64>,
    /// Layout of the records instead of the scene's
    #[arg(long, value_enum, value_name = "LAYOUT")]
    layout: Option<Layout>,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    live: serve::Args,
    #[command(flatten)]
    recorded: compare::Recorded,
    #[command(flatten)]
    which: Which,
}

/// A layout of records: that of a driver.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Layout {
    /// The WSR toolbox's driver: host time, MAC and frame number in each record
    Wsr,
    /// The CSI tool's: each record after a copy of its frame; host times in a side file
    Stock,
}

/// The name in place of a scene that runs the experiments.
const SUITE: &str = "suite";
/// Default outputs of a comparison and of the experiments.
const COMPARED: &str = "csi5300-compare";
const TABLE: &str = "csi5300-suite.csv";

impl Args {
    /// True if anything was asked of serving.
    fn serves(&self) -> bool {
        self.live.serve || self.live.asked()
    }

    /// Runs a comparison or the experiments.
    fn other(&self) -> Option<Result> {
        let changed = self.seed.is_some() || self.layout.is_some();
        let out = |usual: &str| self.out.clone().unwrap_or_else(|| usual.into());
        let is_suite = self.scene.as_deref().is_some_and(|scene| scene.as_os_str() == SUITE && !scene.exists());
        if !is_suite && self.which.is_asked() {
            usage("--repetitions and --only belong to the experiments: csi5300 simulate suite");
        }
        if (is_suite || self.recorded.is_named()) && (changed || self.serves()) {
            usage("--seed, --layout, --serve and its options need a scene that is simulated by itself");
        }
        if is_suite && self.recorded.is_named() {
            usage("a recording is compared with a scene, not with the experiments");
        }
        if is_suite {
            return Some(run_suite(&self.which, &out(TABLE), self.force, self.json));
        }
        self.recorded.is_named().then(|| compare::run(self, &out(COMPARED)))
    }
}

/// Simulates a scene and writes what the robots' cards, drivers and loggers would write.
pub fn run(args: &Args) -> Result {
    if let Some(done) = args.other() {
        return done;
    }
    let Some(file) = &args.scene else { usage("a scene is needed") };
    let mut scene = load(file)?;
    scene.seed = args.seed.unwrap_or(scene.seed);
    scene.driver = match args.layout {
        None => scene.driver,
        Some(Layout::Wsr) => Driver::Wsr,
        Some(Layout::Stock) => Driver::Stock,
    };
    if args.live.serve {
        return serve::run(scene, file, &args.live, args.json);
    }
    if args.live.asked() {
        usage("--socket, --robot, --poses and --speed need --serve");
    }
    let out = args.out.as_deref().unwrap_or_else(|| usage("--out names the folder to write into"));
    let used = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if used && !args.force {
        return Err(format!("{} is not empty: --force writes into it", out.display()));
    }
    let (captures, injected) = write(&scene, out)?;
    if args.json {
        captures.iter().for_each(|capture| print_json(&row(&scene, capture)));
    } else {
        print(&describe(&scene, &captures, &injected));
    }
    if captures.iter().flat_map(|capture| &capture.logs).any(|log| log.records > 0) {
        return Ok(Outcome::Done);
    }
    if scene.sounding.is_none() {
        note!("no record: no robot of this scene sounds. Add [sounding], or --serve it to programs that do");
    }
    Ok(Outcome::Nothing)
}

/// A scene from its file, or the built-in one of that name if there is no such file. One that makes no sense is wrong usage, as a
/// configuration is.
pub fn load(file: &Path) -> Words<Scene> {
    Scene::find(file).map_err(|error| match error.is_of_text() {
        true => usage(&error.of_file(file)),
        false => error.of_file(file),
    })
}

/// Runs a scene into a folder, with a progress bar on a terminal.
pub fn write(scene: &Scene, folder: &Path) -> Words<(Vec<WrittenCapture>, Vec<Injected>)> {
    let mut room = Room::new(scene).in_words()?;
    for robot in &scene.robot {
        if let RobotMotion::Recorded(recorded) = &robot.motion {
            super::draft::reads(&recorded.file);
        }
    }
    let draft = super::draft::FolderDraft::new(folder)?;
    let bar = super::bar(100, &format!("{:.0} s", scene.duration_s));
    let captures = write_dataset(&mut room, draft.path(), &mut |share| bar.set((share * 100.0) as u64));
    bar.clear();
    let mut captures = captures.map_err(|error| draft.words(&error.to_string()))?;
    for capture in &mut captures {
        capture.dir = draft.at_last(&capture.dir);
        capture.logs.iter_mut().for_each(|log| log.path = draft.at_last(&log.path));
    }
    let stamp = captures.first().map_or("", |capture| capture.stamp.as_str());
    let earlier = earlier(scene, folder, stamp, draft.path());
    draft.keep()?;
    for path in earlier.into_iter().filter(|path| path.exists()) {
        std::fs::remove_file(&path).map_err(|error| format!("cannot remove the older {}: {error}", path.display()))?;
    }
    Ok((captures, room.injected()))
}

/// Logs, their side files and trajectories that an earlier run with the same time stamp left in the folder and this one does
/// not replace. Readers would take them for parts of this one.
fn earlier(scene: &Scene, folder: &Path, stamp: &str, written: &Path) -> Vec<PathBuf> {
    let names = scene.robot.iter().map(|robot| robot.name.as_str());
    let mut found = Vec::new();
    for below in std::iter::once("").chain(names) {
        for entry in std::fs::read_dir(folder.join(below)).into_iter().flatten().flatten() {
            let (name, path) = (entry.file_name(), entry.path());
            let is_older = name.to_str().is_some_and(|name| is_of_a_room(name, stamp))
                && path.is_file()
                && !written.join(below).join(&name).exists();
            if is_older && must_not_be_read(&path).is_ok() {
                found.push(path);
            }
        }
    }
    found
}

/// True for the names that [`write_dataset`] gives logs, their side files and trajectories.
fn is_of_a_room(name: &str, stamp: &str) -> bool {
    let log = name.strip_suffix("stp").unwrap_or(name).strip_prefix("csi_");
    let log = log.and_then(|rest| rest.strip_suffix(&format!("_{stamp}.dat")));
    let path = || name.strip_suffix(&format!("_trajectory_{stamp}_.csv"));
    let robot = log.or_else(path).map(|robot| robot.strip_prefix("odom_").unwrap_or(robot));
    robot.is_some_and(|robot| robot == "rx" || robot.trim_end_matches(|c: char| c.is_ascii_digit()) == "tx")
}

/// A line of JSON.
#[derive(serde::Serialize)]
struct CaptureRow<'a> {
    folder: &'a Path,
    receiver: &'a str,
    time_stamp: &'a str,
    logs: Vec<LogRow<'a>>,
}

#[derive(serde::Serialize)]
struct LogRow<'a> {
    file: &'a Path,
    robot: &'a str,
    records: u64,
}

fn row<'a>(scene: &'a Scene, capture: &'a WrittenCapture) -> CaptureRow<'a> {
    let name = |robot: usize| scene.robot.get(robot).map_or("?", |robot| robot.name.as_str());
    let log =
        |log: &'a csi5300_sim::WrittenLog| LogRow { file: &log.path, robot: name(log.robot), records: log.records };
    let logs = capture.logs.iter().map(log).collect();
    CaptureRow { folder: &capture.dir, receiver: name(capture.receiver), time_stamp: &capture.stamp, logs }
}

fn describe(scene: &Scene, captures: &[WrittenCapture], injected: &[Injected]) -> String {
    let mut text = String::new();
    let name = |robot: usize| scene.robot.get(robot).map_or("?", |robot| robot.name.as_str());
    for capture in captures {
        let _ = writeln!(
            text,
            "{}: receiver {}, time stamp {}",
            capture.dir.display(),
            name(capture.receiver),
            capture.stamp
        );
        for log in &capture.logs {
            let records = super::some(log.records, "record", "records");
            let _ = writeln!(text, "  {}: {records} of {}", log.path.display(), name(log.robot));
        }
    }
    for (robot, injected) in injected.iter().enumerate().filter(|(_, injected)| **injected != Injected::default()) {
        let _ = writeln!(text, "  in the room, {}: {injected}", name(robot));
    }
    text
}

// Which experiments to run.
#[derive(clap::Args, Clone)]
#[command(
    next_help_heading = "The experiments of Dijkstra et al. (SCENE is suite; --out names a CSV table with a row for each repetition)"
)]
pub struct Which {
    /// Repetitions of each experiment [default: 10]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    repetitions: Option<u64>,
    /// Only experiments whose name contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
}

impl Which {
    /// True if anything was asked of them.
    fn is_asked(&self) -> bool {
        self.repetitions.is_some() || self.only.is_some()
    }
}

/// Runs the experiments of Dijkstra et al. (\[paper\] in docs/reference/references.md) and prints a table of them.
fn run_suite(which: &Which, path: &Path, force: bool, json: bool) -> Result {
    let mut all = experiments();
    if let Some(text) = &which.only {
        all.retain(|experiment| experiment.name.contains(text));
    }
    if all.is_empty() {
        let names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        usage(&format!("no experiment has that in its name; there are: {}", names.join("; ")));
    }
    let channel = Channel::new(108, Width::Ht20).in_words()?;
    let failed = |error: String| format!("cannot write {}: {error}", path.display());
    let draft = Draft::create(path, force)?;
    // Opened first, so that an unwritable file fails before minutes of work.
    let mut csv = csv::Writer::from_path(draft.path()).map_err(|error| failed(error.to_string()))?;
    let mut runs = Vec::new();
    for (k, experiment) in all.iter().enumerate() {
        progress(&format!("{} of {} experiments: {}", k + 1, all.len(), experiment.name));
        let own =
            run_all(std::slice::from_ref(experiment), which.repetitions.unwrap_or(REPETITIONS), &Options::new(channel));
        runs.extend(own?);
    }
    progress("");
    runs.iter().try_for_each(|run| csv.serialize(run)).map_err(|error| failed(error.to_string()))?;
    csv.flush().map_err(|error| failed(error.to_string()))?;
    draft.keep(false).map_err(|error| failed(error.to_string()))?;
    let table = summarise(&runs);
    if json {
        table.iter().for_each(print_json);
    } else {
        print(&describe_suite(&table));
    }
    note!("{} in {}", some(runs.len() as u64, "repetition", "repetitions"), path.display());
    Ok(Outcome::Done)
}

fn describe_suite(table: &[Summary]) -> String {
    let line = |[name, runs, error, confidence, likelihood, coherence, residual]: [&str; 7]| {
        format!("{name:<34} {runs:>5} {error:>17} {confidence:>11} {likelihood:>10} {coherence:>10} {residual:>17}\n")
    };
    let heads = ["experiment", "runs", "|error| mean, max", "confidence", "likelihood", "coherence", "residual, comp."];
    let mut text = line(heads) + &line(["", "", "deg", "", "share", "", "rad"]);
    let value = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    for row in table {
        let errors = row.mean_error_deg.zip(row.largest_error_deg);
        let error = errors.map_or_else(|| "-".into(), |(mean, largest)| format!("{mean:.3}, {largest:.3}"));
        let residual = format!("{:.3}, {:.3}", row.residual_rad, row.residual_compensated_rad);
        let [confidence, likelihood] = [value(row.confidence, 2), value(row.likelihood_share, 4)];
        let (runs, coherence) = (row.repetitions.to_string(), value(row.coherence, 3));
        text += &line([&row.experiment, &runs, &error, &confidence, &likelihood, &coherence, &residual]);
    }
    text
}
