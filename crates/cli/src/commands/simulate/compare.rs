//! `csi5300 simulate --rx ...`: a recorded capture beside a simulated one.

use super::Args;
use crate::commands::files::{self, BagArgs, Inputs};
use crate::commands::{
    InWords, Outcome, Result, Words, draft, fixed, is_same_file, print, print_json, progress, read_trajectory,
    simulate, some, usage,
};
use csi5300::Log;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::compare::fit::{Known, check_width};
use csi5300_lab::compare::{FigureRow, Figures, Verdict, channel_about, channel_of, fit, measure, rows, scene_channel};
use csi5300_lab::evaluate::{Capture, channel_in, find};
use csi5300_say::{Tone, toned};
use csi5300_sim::Scene;
use driver_iface::bfee::rate;
use std::fmt::Write;
use std::path::{Path, PathBuf};

// A recorded capture.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Recorded capture to compare with")]
pub struct Recorded {
    /// Recorded log of the robot that moved. SCENE may then also be a folder that --out wrote; without SCENE, a scene
    /// is fitted to the recording
    #[arg(long, value_name = "RX.dat")]
    rx: Option<PathBuf>,
    /// Recorded log of the other robot
    #[arg(long, value_name = "TX.dat")]
    tx: Option<PathBuf>,
    /// The recorded trajectory
    #[arg(long, value_name = "T.csv")]
    trajectory: Option<PathBuf>,
    #[command(flatten)]
    bag: BagArgs,
    /// Recorded trajectory of the other robot, if it moved, on the first one's clock
    #[arg(long, value_name = "T.csv")]
    tx_trajectory: Option<PathBuf>,
    /// WiFi channel of the recording, with + or - for 40 MHz [default: the scene's or the simulated folder's]
    #[arg(long, value_name = "NUMBER")]
    channel: Option<Channel>,
}

impl Recorded {
    /// True if one was named.
    pub fn is_named(&self) -> bool {
        self.bag.bag.is_some()
            || self.rx.is_some()
            || self.tx.is_some()
            || self.trajectory.is_some()
            || self.tx_trajectory.is_some()
            || self.channel.is_some()
    }
}

/// Compares a recorded capture with a scene or with a folder of a simulated capture, or fits a scene to it. `out` gets the fitted scene and its
/// trajectory, the simulated capture and the pictures.
pub fn run(args: &Args, out: &Path) -> Result {
    let with = args.scene.as_deref();
    // Checked before minutes of reading and fitting.
    let tx: Vec<PathBuf> = args.recorded.tx.iter().cloned().collect();
    let (inputs, named) =
        args.recorded.bag.resolve(args.recorded.rx.clone(), tx, args.recorded.trajectory.clone(), None)?;
    let tx = match &named.tx[..] {
        [tx] => tx,
        [] => return Err("the other robot's log is needed: --tx LOG".into()),
        several => {
            let several: Vec<String> = several.iter().map(|topic| topic.display().to_string()).collect();
            return Err(format!("several logs could be the other robot's ({}): --tx names one", several.join(", ")));
        }
    };
    args.check_outputs(out, inputs.bag().into_iter().chain([&*named.rx, tx, &named.trajectory]))?;
    let given = with.filter(|with| !with.is_dir()).map(simulate::load).transpose()?;
    let options = Options::new(args.channel(given.as_ref())?);
    let trajectory = inputs.trajectory(&named.trajectory)?;
    let displaced = args.recorded.tx_trajectory.as_deref().map(|path| inputs.trajectory(path)).transpose()?;
    let recorded = read(&inputs, (&named.rx, tx), (&trajectory, displaced.as_ref()), &options)?;
    check_width(&recorded, options.channel).in_words()?;
    let folder = out.join(SIMULATED);
    // A fitted scene's robot strays from the recorded trajectory; a recording has only the latter.
    let along = with.is_none().then_some(&trajectory);
    let capture = match (with, given) {
        (Some(folder), None) => folder.to_owned(),
        (_, given) => {
            let scene = given.map_or_else(|| fitted(out, &recorded, &trajectory, &options), Ok)?;
            clear(&folder)?;
            simulate::write(&scene, &folder)?;
            folder
        }
    };
    let simulated = read_folder(&capture, along, &options)?;
    let table = rows(&recorded, &simulated);
    if args.json {
        table.iter().for_each(print_json);
    } else {
        print(&describe(&table));
    }
    draw(args.json, out, &recorded, &simulated)?;
    Ok(if inputs.lost() { Outcome::DataLost } else { Outcome::Done })
}

/// Names of the files written into the folder; the scene names the copy of the trajectory.
const TRAJECTORY: &str = "fitted-trajectory.csv";
const SCENE: &str = "scene.toml";
const SIMULATED: &str = "simulated";

impl Args {
    /// The channel of both captures: the scene's, the folder's, or the requested one.
    fn channel(&self, scene: Option<&Scene>) -> Words<Channel> {
        match (&self.scene, scene) {
            (Some(file), Some(scene)) => of_scene(file, scene, self.recorded.channel),
            (Some(folder), None) => of_folder(folder, self.recorded.channel),
            (None, _) => Ok(self.recorded.channel.unwrap_or_else(|| usage("--channel is needed to fit a scene"))),
        }
    }

    /// Refuses outputs that are inputs, and existing ones without --force.
    fn check_outputs<'a>(&'a self, out: &Path, read: impl Iterator<Item = &'a Path>) -> Words<()> {
        let simulated = out.join(SIMULATED);
        let written: Vec<PathBuf> = match &self.scene {
            Some(folder) if folder.is_dir() => return Ok(()),
            Some(_) => Vec::new(),
            None => [TRAJECTORY, SCENE].iter().map(|name| out.join(name)).collect(),
        };
        for input in read.chain(self.recorded.tx_trajectory.as_deref()).chain(self.scene.as_deref()) {
            if let Some(output) = written.iter().find(|output| is_same_file(input, output)) {
                return Err(format!("{} is an input: name another --out", output.display()));
            }
            let inside = input.canonicalize().ok().zip(simulated.canonicalize().ok());
            if inside.is_some_and(|(input, folder)| input.starts_with(folder)) {
                let (input, folder) = (input.display(), simulated.display());
                return Err(format!(
                    "{input} is an input inside {folder}, which this run overwrites: name another --out"
                ));
            }
        }
        let used = std::fs::read_dir(&simulated).is_ok_and(|mut entries| entries.next().is_some());
        let there = written.into_iter().find(|output| output.exists()).or(used.then_some(simulated));
        match there.filter(|_| !self.force) {
            Some(there) => Err(format!("{} already exists: --force replaces it", there.display())),
            None => Ok(()),
        }
    }
}

/// The channel of the scene in this file. It must be the requested one, if any.
fn of_scene(file: &Path, scene: &Scene, asked: Option<Channel>) -> Words<Channel> {
    let is_other = |channel: &Channel| {
        (scene.channel, scene.bandwidth_mhz == 40) != (scene_channel(*channel), channel.width() != Width::Ht20)
    };
    match asked {
        Some(channel) if is_other(&channel) => Err(format!(
            "{} is of channel {} at {} MHz, not of --channel {channel}",
            file.display(),
            scene.channel,
            scene.bandwidth_mhz
        )),
        Some(channel) => Ok(channel),
        None => channel_of(scene).map_err(|error| format!("{}: {error}", file.display())),
    }
}

/// The channel of the first capture in a folder. It must be the requested one, if any. Truth files name the centre and not the
/// width, which records do.
fn of_folder(folder: &Path, asked: Option<Channel>) -> Words<Channel> {
    let capture = first_capture(folder)?;
    match (asked, channel_in(&capture.folder).in_words()?) {
        (Some(channel), Some(own)) if scene_channel(channel) != scene_channel(own) => {
            Err(format!("{} is of channel {own}, not of --channel {channel}", folder.display()))
        }
        (Some(channel), _) => Ok(channel),
        (None, Some(own)) => {
            let log = Log::open(capture.receiver_log()).in_words()?;
            let is_wide = log.flatten().next().is_some_and(|frame| frame.rate_n_flags & rate::HT40 != 0);
            channel_about(scene_channel(own).into(), is_wide).in_words()
        }
        (None, None) => usage(&format!("--channel is needed: no file with a truth in {} names it", folder.display())),
    }
}

fn first_capture(folder: &Path) -> Words<Capture> {
    find(folder).0.into_iter().next().ok_or_else(|| format!("no capture in {}", folder.display()))
}

/// Removes the capture of an earlier run.
fn clear(folder: &Path) -> Words<()> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(format!("cannot remove the earlier {}: {error}", folder.display()))
        }
        _ => Ok(()),
    }
}

/// `paths`: the receiver's, and the transmitter's if it moved.
fn read(
    inputs: &Inputs,
    (rx, tx): (&Path, &Path),
    paths: (&Trajectory, Option<&Trajectory>),
    options: &Options,
) -> Words<Figures> {
    measure(&mut inputs.open(rx)?, &mut inputs.open(tx)?, paths.0, paths.1, options).in_words()
}

/// Reads the first capture and link of a folder in the layout of the WSR data set, along its own trajectory if no other is
/// given.
fn read_folder(folder: &Path, along: Option<&Trajectory>, options: &Options) -> Words<Figures> {
    let capture = first_capture(folder)?;
    let (name, tx) =
        capture.transmitters.first().ok_or_else(|| format!("no transmitter's log in {}", folder.display()))?;
    let path_of = |robot: &str| capture.folder.join(format!("{robot}_trajectory_{}_.csv", capture.stamp));
    let trajectory =
        along.map_or_else(|| read_trajectory(&path_of("rx"), None), |trajectory| Ok(trajectory.clone()))?;
    let displaced =
        Some(path_of(name)).filter(|path| path.is_file()).map(|path| read_trajectory(&path, None)).transpose()?;
    read(&Inputs::default(), (&capture.receiver_log(), tx), (&trajectory, displaced.as_ref()), options)
}

/// Fits a scene to the recorded capture and keeps it, with the trajectory that it names.
fn fitted(out: &Path, recorded: &Figures, trajectory: &Trajectory, options: &Options) -> Words<Scene> {
    std::fs::create_dir_all(out).map_err(|error| format!("cannot make {}: {error}", out.display()))?;
    let poses: String = trajectory.poses().iter().map(csv::line).collect();
    draft::write(&out.join(TRAJECTORY), &poses)?;
    let known = Known { trajectory, file: Path::new(TRAJECTORY), folder: out };
    progress("fitting a scene to the recording");
    let fitted = fit(recorded, &known, options).in_words();
    progress("");
    let fitted = fitted?;
    draft::write(&out.join(SCENE), &fitted.toml)?;
    Ok(fitted.scene)
}

fn describe(table: &[FigureRow]) -> String {
    let mut text = format!("{:<12} {:<40} {:>12} {:>12}\n", "", "", "recorded", "simulated");
    let value = |value: Option<f64>| value.map_or_else(|| "-".into(), short);
    for row in table {
        let verdict = match row.verdict {
            Verdict::Agrees => toned("agrees", Tone::Good),
            Verdict::Differs => toned("DIFFERS", Tone::Bad),
            Verdict::Shown => String::new(),
        };
        let (recorded, simulated) = (value(row.recorded), value(row.simulated));
        let line = format!("{:<12} {:<40} {recorded:>12} {simulated:>12} {:<9}", row.of, row.name, row.unit);
        let _ = writeln!(text, "{}", format!("{line} {verdict}").trim_end());
    }
    let count = |verdict| table.iter().filter(|row| row.verdict == verdict).count();
    let (agree, differ) = (count(Verdict::Agrees), count(Verdict::Differs));
    let _ = writeln!(text, "{} agree, {differ} differ", some(agree as u64, "figure", "figures"));
    text
}

/// Four significant digits, no exponent.
fn short(value: f64) -> String {
    if value == value.trunc() && value.abs() < 1e9 {
        return fixed(value, 0);
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    fixed(value, digits.clamp(0, 6) as usize)
}

fn draw(json: bool, out: &Path, recorded: &Figures, simulated: &Figures) -> Words<()> {
    let written =
        draft::pictures(out, |folder| csi5300_lab::show::results::write_compared(recorded, simulated, folder))?;
    for path in files::first_of_each(&written).filter(|_| !json) {
        print(&format!("picture {}\n", path.display()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_digits_and_what_is_nothing_has_no_sign() {
        assert_eq!([-0.0, -1e-9, 1000.0, -20.0].map(short), ["0", "0.000000", "1000", "-20"]);
        assert_eq!([0.642_58, 31.006, -10_955.2].map(short), ["0.6426", "31.01", "-10955"]);
    }
}
