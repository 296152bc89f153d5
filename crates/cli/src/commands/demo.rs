//! `csi5300 demo`: what cancelling the carrier offset does to the phase of two robots that stand, then the circle and the
//! line of Dijkstra et al. (\[paper\] in docs/reference/references.md), simulated, decoded and estimated.

use super::args::Estimation;
use super::draft::pictures;
use super::{InWords, Outcome, Result, Words, fixed, print, print_json, simulate};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Bearing, CaptureReport, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::suite::{Standing, standing};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Scene, WrittenCapture};
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for logs and pictures
    #[arg(long, default_value = "csi5300-demo", value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
}

/// Its two experiments with motion, and what they are drawn as.
const SCENES: [(&str, &str); 2] = [
    ("circle", include_str!("../../../../scenes/paper-circle.toml")),
    ("line", include_str!("../../../../scenes/paper-line.toml")),
];
/// The scene whose robots first stand still.
const CARDS: &str = include_str!("../../../../scenes/lab-circle.toml");
/// How long they stand, seconds.
const STANDING_S: f64 = 10.0;

/// One row of the table at the end.
#[derive(serde::Serialize)]
struct Shown {
    experiment: &'static str,
    exchanges: usize,
    azimuth_deg: f64,
    azimuth_sd_deg: f64,
    mirror_deg: Option<f64>,
    truth_deg: Option<f64>,
    /// Of the azimuth or its mirror, whichever is nearer.
    error_deg: Option<f64>,
    /// Spread from packet to packet of the product of both directions.
    phase_before_rad: Option<f64>,
    /// The same after turn-around compensation.
    phase_after_rad: Option<f64>,
}

impl Shown {
    fn new(experiment: &'static str, bearing: &Bearing, truth_rad: Option<f64>) -> Self {
        let answer = &bearing.answer;
        let off = |azimuth: f64| truth_rad.map(|truth| wrap_rad(azimuth - truth));
        let errors = [Some(answer.azimuth_rad), answer.mirror_rad].into_iter().flatten().filter_map(off);
        let spread = |coherence: f64| csi5300_lab::suite::spread_rad(coherence);
        Self {
            experiment,
            exchanges: bearing.pairs.formed,
            azimuth_deg: answer.azimuth_rad.to_degrees(),
            azimuth_sd_deg: answer.azimuth_sd_rad.to_degrees(),
            mirror_deg: answer.mirror_rad.map(f64::to_degrees),
            truth_deg: truth_rad.map(f64::to_degrees),
            error_deg: errors.min_by(|a, b| a.abs().total_cmp(&b.abs())).map(f64::to_degrees),
            phase_before_rad: bearing.turn_around.as_ref().map(|t| spread(t.coherence_before)),
            phase_after_rad: bearing.turn_around.as_ref().map(|t| spread(t.coherence_after)),
        }
    }
}

/// Runs the demonstration.
pub fn run(args: &Args) -> Result {
    // An earlier demonstration is overwritten.
    let is_own = |name: std::ffi::OsString| {
        ["standing", "circle", "line"].iter().any(|own| name.to_string_lossy().starts_with(own))
    };
    let holds_more =
        |mut entries: std::fs::ReadDir| entries.any(|entry| entry.is_ok_and(|entry| !is_own(entry.file_name())));
    if !args.force && std::fs::read_dir(&args.out).is_ok_and(holds_more) {
        return Err(format!("{} holds other files: --force writes into it", args.out.display()));
    }
    let tell = |text: &str| {
        if !args.json {
            print(text)
        }
    };
    tell(
        "Two robots, simulated down to the bytes of their logs. The rest of this program\n\
         reads these logs like recorded ones.\n\n",
    );
    let channel = Channel::new(108, Width::Ht20).in_words()?;
    let options = Options { keep_course: true, ..Estimation::default().options(channel)? };
    stand(args, &options)?;
    let mut shown = Vec::new();
    for (name, text) in SCENES {
        let scene = Scene::from_toml(text).map_err(|error| format!("scene {name}: {error}"))?;
        let (rx, tx, trajectory) = simulated(&scene, &args.out.join(name))?;
        let bearing = bearing_of(estimate(&rx, &tx, &trajectory, &options)?)?;
        let truth_rad = truth(&scene, &bearing);
        say_pictures(args, &draw(args, name, &bearing, &scene, truth_rad)?);
        shown.push(Shown::new(name, &bearing, truth_rad));
    }
    if args.json {
        shown.iter().for_each(print_json);
        return Ok(Outcome::Done);
    }
    print(
        "\nThe circle and the line of Dijkstra et al., 3 dB of signal to noise, a transmitter\n\
         about 4 m away. before, after: spread of the phase from packet to packet before and\n\
         after turn-around compensation:\n\n",
    );
    print(&table(&shown));
    let out = args.out.display();
    print(&format!(
        "\nLogs and pictures are in {out}. Try next:\n  csi5300 bearing {out}/circle\n  csi5300 view {out} --open\n"
    ));
    Ok(Outcome::Done)
}

/// Two standing robots: their phase is constant only once the offset is cancelled.
fn stand(args: &Args, options: &Options) -> Words<()> {
    let mut scene = Scene::from_toml(CARDS).map_err(|error| format!("scene: {error}"))?;
    scene.duration_s = STANDING_S;
    if let Some(robot) = scene.robot.first_mut() {
        robot.motion = RobotMotion::Static;
    }
    let (rx, tx, trajectory) = simulated(&scene, &args.out.join("standing"))?;
    let report = estimate(&rx, &tx, &trajectory, options)?;
    let standing = standing(&report, options).ok_or("the standing robots gave too few pairs")?;
    if args.json {
        print_json(&StandingRow { experiment: "standing", standing: &standing });
    } else {
        print(&describe_standing(&standing));
    }
    say_pictures(args, &draw_standing(args, &standing)?);
    only_logs(&args.out.join("standing"), &trajectory).in_words()
}

/// Removes the trajectories and the truth beside the logs: robots at rest have no bearing, so `evaluate` would count a failed link.
fn only_logs(folder: &Path, trajectory: &Path) -> std::io::Result<()> {
    let name = trajectory.file_name().unwrap_or_default().to_string_lossy();
    for name in ["groundtruth_positions.json", &name, &format!("odom_{name}")] {
        std::fs::remove_file(folder.join(name))?;
    }
    Ok(())
}

/// The JSON line of the standing robots.
#[derive(serde::Serialize)]
struct StandingRow<'a> {
    experiment: &'static str,
    #[serde(flatten)]
    standing: &'a Standing,
}

fn describe_standing(standing: &Standing) -> String {
    let Standing { exchanges, cfo_hz, turn_around_jitter_us, .. } = standing;
    let [one_way, both, after] = [standing.phase_one_way_rad, standing.phase_before_rad, standing.phase_after_rad];
    format!(
        "standing: {exchanges} exchanges in {STANDING_S:.0} s at rest; the phase should be constant.\n\
         \x20 one direction                  {one_way:5.2} rad from packet to packet (1.0 and more: random)\n\
         \x20 both directions multiplied     {both:5.2} rad: the carrier offset ({cfo_hz:.0} Hz) cancels,\n\
         \x20                                          except over the time between the frames,\n\
         \x20                                          which jitters by {turn_around_jitter_us:.1} us (median)\n\
         \x20 and the turn-around removed    {after:5.2} rad: that time is on the cards' clocks\n"
    )
}

/// Simulates a scene into a folder: the logs of receiver and transmitter, and the receiver's trajectory.
fn simulated(scene: &Scene, folder: &Path) -> Words<(PathBuf, PathBuf, PathBuf)> {
    let (captures, _) = simulate::write(scene, folder)?;
    let capture = captures.first().ok_or_else(|| format!("scene {} has no initiator", scene.name))?;
    Ok(files(capture))
}

fn files(capture: &WrittenCapture) -> (PathBuf, PathBuf, PathBuf) {
    let log = |receiver: bool| {
        let own = capture.logs.iter().find(|log| (log.robot == capture.receiver) == receiver);
        own.map(|log| log.path.clone()).unwrap_or_default()
    };
    (log(true), log(false), capture.dir.join(format!("rx_trajectory_{}_.csv", capture.stamp)))
}

fn estimate(rx: &Path, tx: &Path, trajectory: &Path, options: &Options) -> Words<CaptureReport> {
    let (mut receiver, mut transmitter) = (super::open_log(rx)?, super::open_log(tx)?);
    let path = super::read_trajectory(trajectory, None)?;
    let transmitters = vec![Transmitter { log: &mut transmitter, trajectory: None }];
    bearings(&mut receiver, transmitters, &path, options).in_words()
}

fn bearing_of(report: CaptureReport) -> Words<Bearing> {
    let link = report.links.into_iter().next().ok_or("no link")?;
    link.bearing.in_words()
}

/// The bearing to the scene's transmitter from the mean pose of the samples.
fn truth(scene: &Scene, bearing: &Bearing) -> Option<f64> {
    let [x, y, _] = scene.robot.get(1)?.position_m;
    Some((y - bearing.mean_position_m.y).atan2(x - bearing.mean_position_m.x))
}

fn table(shown: &[Shown]) -> String {
    let mut text = String::from(
        "          exchanges  azimuth    +-   mirror    truth   error  before  after\n\
         \x20                      deg   deg      deg      deg     deg     rad    rad\n",
    );
    let figure = |value: Option<f64>| value.map_or("-".into(), |value| fixed(value, 2));
    for row in shown {
        let error = figure(row.error_deg);
        let error = if row.error_deg.is_some() && !error.starts_with('-') { format!("+{error}") } else { error };
        let _ = writeln!(
            text,
            "  {:<8} {:>8} {:>8} {:>5.2} {:>8} {:>8} {error:>7} {:>7} {:>6}",
            row.experiment,
            row.exchanges,
            fixed(row.azimuth_deg, 2),
            row.azimuth_sd_deg,
            figure(row.mirror_deg),
            figure(row.truth_deg),
            figure(row.phase_before_rad),
            figure(row.phase_after_rad),
        );
    }
    text += "\nFrom a line, a bearing and its mirror look the same: the error is that of the nearer\none.\n";
    text
}

fn draw_standing(args: &Args, standing: &Standing) -> Words<Vec<PathBuf>> {
    let picture = csi5300_lab::show::results::standing(standing);
    pictures(&args.out, |folder| picture.write(&folder.join("standing-phase")))
}

fn draw(args: &Args, name: &str, bearing: &Bearing, scene: &Scene, truth_rad: Option<f64>) -> Words<Vec<PathBuf>> {
    let transmitter_m = scene.robot.get(1).map(|robot| [robot.position_m[0], robot.position_m[1]]);
    let own = csi5300_lab::show::results::LinkPictures { bearing, truth_rad, transmitter_m };
    pictures(&args.out, |folder| own.write(folder, name))
}

/// A line for each picture, by the first of its formats.
fn say_pictures(args: &Args, written: &[PathBuf]) {
    for path in super::files::first_of_each(written).filter(|_| !args.json) {
        print(&format!("  picture {}\n", path.display()));
    }
}
