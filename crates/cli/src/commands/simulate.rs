//! `csi5300 simulate`.

use super::{Outcome, Result, print, print_json};
use csi5300_sim::scene::Driver;
use csi5300_sim::{Injected, Room, Scene, WrittenCapture, write_dataset};
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `simulate`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene, a file or the name of a built-in one: lab-circle, lab-line, paper-circle, paper-line
    scene: PathBuf,
    /// Folder for logs, trajectories and truth
    #[cfg_attr(feature = "live", arg(long, value_name = "DIR", required_unless_present = "serve"))]
    #[cfg_attr(not(feature = "live"), arg(long, value_name = "DIR", required = true))]
    out: Option<PathBuf>,
    /// Seed instead of the scene's
    #[arg(long)]
    seed: Option<u64>,
    /// Layout of the records instead of the scene's
    #[arg(long, value_enum, value_name = "LAYOUT")]
    layout: Option<Layout>,
    /// Write into a folder that is not empty
    #[arg(long)]
    force: bool,
    /// JSON Lines: one object a capture written; one object about the room that was served
    #[arg(long)]
    json: bool,
    #[cfg(feature = "live")]
    #[command(flatten)]
    live: super::card::serve::Args,
}

/// A layout of records: that of a driver.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Layout {
    /// The WSR toolbox's driver: host time, MAC and frame number in each record
    Wsr,
    /// The original CSI tool's: each record after a copy of its frame; host times in a side file
    Stock,
}

/// Simulates a scene and writes what the robots' cards, drivers and loggers would have.
pub fn run(args: &Args) -> Result {
    let mut scene = load(&args.scene)?;
    scene.seed = args.seed.unwrap_or(scene.seed);
    scene.driver = match args.layout {
        None => scene.driver,
        Some(Layout::Wsr) => Driver::Wsr,
        Some(Layout::Stock) => Driver::Stock,
    };
    #[cfg(feature = "live")]
    if args.live.serve {
        return super::card::serve::run(scene, &args.scene, &args.live, args.json);
    }
    #[cfg(feature = "live")]
    if args.live.asked() {
        super::usage("--socket, --robot, --poses and --speed need --serve");
    }
    let out = args.out.as_deref().ok_or("--out names the folder to write into")?;
    let used = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if used && !args.force {
        return Err(format!("{} is not empty: --force writes into it all the same", out.display()));
    }
    let (captures, injected) = write(&scene, out)?;
    if args.json {
        captures.iter().for_each(|capture| print_json(&row(&scene, capture)));
    } else {
        print(&describe(&scene, &captures, &injected));
    }
    Ok(if captures.is_empty() { Outcome::Nothing } else { Outcome::Done })
}

/// A scene from its file, or the built-in one of that name where there is no such file. One that makes no sense is wrong usage, as a
/// configuration is.
pub fn load(file: &Path) -> std::result::Result<Scene, String> {
    Scene::find(file).map_err(|error| match error.is_of_text() {
        true => super::usage(&error.of_file(file)),
        false => error.of_file(file),
    })
}

/// Runs a scene into a folder, with a progress bar on a terminal.
pub fn write(scene: &Scene, folder: &Path) -> std::result::Result<(Vec<WrittenCapture>, Vec<Injected>), String> {
    let mut room = Room::new(scene).map_err(|error| error.to_string())?;
    let bar = super::bar(100, &format!("{:.0} s", scene.duration_s));
    let captures = write_dataset(&mut room, folder, &mut |share| bar.set((share * 100.0) as u64));
    bar.clear();
    Ok((captures.map_err(|error| error.to_string())?, room.injected()))
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
