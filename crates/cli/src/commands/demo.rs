//! `csi5300 demo`: what cancelling the carrier offset does to the phase of two robots that stand, then the circle and the
//! line of Dijkstra et al. (\[paper\] in docs/references.md), simulated, decoded and estimated.

use super::args::Estimation;
use super::{Outcome, Result, print, simulate};
use csi5300::maths::wrap_rad;
use csi5300::motion::odometry;
use csi5300::pipeline::{Bearing, CaptureReport, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{CsiSource, replay::Replay};
use csi5300_lab::suite::{Standing, standing};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Scene, WrittenCapture};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for logs and pictures
    #[arg(long, default_value = "csi5300-demo", value_name = "DIR")]
    out: PathBuf,
    /// A recorded capture whose phase is drawn beside the simulated circle's
    #[arg(long, num_args = 3, value_names = ["RX.dat", "TX.dat", "T.csv"])]
    recorded: Vec<PathBuf>,
    /// Write into a folder that is not empty
    #[arg(long)]
    force: bool,
}

/// Its two experiments with motion, and what they are drawn as.
const SCENES: [(&str, &str); 2] = [
    ("circle", include_str!("../../../../scenes/paper-circle.toml")),
    ("line", include_str!("../../../../scenes/paper-line.toml")),
];
/// Whose cards stand still first.
const CARDS: &str = include_str!("../../../../scenes/lab-circle.toml");
/// How long, seconds.
const STANDING_S: f64 = 10.0;

type Words<T> = std::result::Result<T, String>;

/// One row of the table at the end.
struct Shown {
    name: &'static str,
    bearing: Bearing,
    truth_rad: Option<f64>,
}

/// Runs the demonstration.
pub fn run(args: &Args) -> Result {
    let used = std::fs::read_dir(&args.out).is_ok_and(|mut entries| entries.next().is_some());
    if used && !args.force {
        return Err(format!("{} is not empty: --force writes into it all the same", args.out.display()));
    }
    print(
        "Two robots, simulated down to the bytes that their cards, drivers and loggers would have written. What follows\n\
         reads those logs as if they were recorded.\n\n",
    );
    let channel = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
    let options = Estimation::default().options(channel)?.with_keep_course(true);
    let recorded = match args.recorded.as_slice() {
        [rx, tx, trajectory] => Some(bearing_of(estimate(rx, tx, trajectory, &options)?)?),
        _ => None,
    };
    stand(&args.out, &options)?;
    let (mut next, mut shown) = (String::new(), Vec::new());
    for (name, text) in SCENES {
        let scene = Scene::from_toml(text).map_err(|error| format!("scene {name}: {error}"))?;
        let (rx, tx, trajectory) = simulated(&scene, &args.out.join(name))?;
        if next.is_empty() {
            next = commands(&rx, &tx, &trajectory);
        }
        let bearing = bearing_of(estimate(&rx, &tx, &trajectory, &options)?)?;
        let truth_rad = truth(&scene, &bearing);
        draw(&args.out, name, &bearing, &scene, truth_rad, recorded.as_ref().filter(|_| name == "circle"))?;
        shown.push(Shown { name, bearing, truth_rad });
    }
    print("\nThe circle and the line of Dijkstra et al., 3 dB of signal to noise, a transmitter about 4 m away:\n\n");
    print(&table(&shown));
    print(&format!("\nLogs and pictures are in {}. Try next:\n{next}", args.out.display()));
    Ok(Outcome::Done)
}

/// Two robots that stand: their phase should be constant, and is not before the offset is cancelled.
fn stand(out: &Path, options: &Options) -> Words<()> {
    let mut scene = Scene::from_toml(CARDS).map_err(|error| format!("scene: {error}"))?;
    scene.duration_s = STANDING_S;
    if let Some(robot) = scene.robot.first_mut() {
        robot.motion = RobotMotion::Static;
    }
    let (rx, tx, trajectory) = simulated(&scene, &out.join("standing"))?;
    let report = estimate(&rx, &tx, &trajectory, options)?;
    let standing = standing(&report, options).ok_or("the robots that stand gave too few pairs")?;
    print(&describe_standing(&standing));
    draw_standing(out, &standing)
}

fn describe_standing(standing: &Standing) -> String {
    let Standing { course, turn_around, spread_one_way_rad, spread_rad, spread_compensated_rad } = standing;
    format!(
        "standing: {} exchanges in {STANDING_S:.0} s, nothing moves; the phase should stand still.\n\
         \x20 one direction                  {spread_one_way_rad:5.2} rad from packet to packet (1.0 and more: random)\n\
         \x20 both directions multiplied     {spread_rad:5.2} rad: the carrier offset ({:.0} Hz) cancels, but for the time between\n\
         \x20                                          the two frames, which jitters by {:.1} us (median)\n\
         \x20 and the turn-around taken out  {spread_compensated_rad:5.2} rad: that time is on the cards' clocks\n",
        course.len(),
        turn_around.df_hz,
        turn_around.jitter_median_us,
    )
}

/// Simulates a scene into a folder: the logs of receiver and transmitter, and the receiver's trajectory.
fn simulated(scene: &Scene, folder: &Path) -> Words<(PathBuf, PathBuf, PathBuf)> {
    let (captures, _) = simulate::write(scene, folder)?;
    let capture = captures.first().ok_or_else(|| format!("scene {} has no initiator", scene.name))?;
    Ok(files(capture))
}

fn commands(rx: &Path, tx: &Path, trajectory: &Path) -> String {
    let (rx, tx, trajectory) = (rx.display(), tx.display(), trajectory.display());
    let bearing = format!("csi5300 bearing --channel 108 --rx {rx} --tx {tx} --trajectory {trajectory} --plot .");
    format!("  csi5300 info {rx}\n  {bearing}\n")
}

fn files(capture: &WrittenCapture) -> (PathBuf, PathBuf, PathBuf) {
    let log = |receiver: bool| {
        let own = capture.logs.iter().find(|log| (log.robot == capture.receiver) == receiver);
        own.map(|log| log.path.clone()).unwrap_or_default()
    };
    (log(true), log(false), capture.dir.join(format!("rx_trajectory_{}_.csv", capture.stamp)))
}

fn estimate(rx: &Path, tx: &Path, trajectory: &Path, options: &Options) -> Words<CaptureReport> {
    let open = |path: &Path| Replay::open(path).map_err(|error| super::hint::log_refused(&error));
    let (mut receiver, mut transmitter) = (open(rx)?, open(tx)?);
    let (path, _) = odometry::csv::read(trajectory).map_err(|error| format!("{}: {error}", trajectory.display()))?;
    let transmitters = vec![Transmitter { log: &mut transmitter as &mut dyn CsiSource, trajectory: None }];
    bearings(&mut receiver, transmitters, &path, options).map_err(|error| error.to_string())
}

fn bearing_of(report: CaptureReport) -> Words<Bearing> {
    let link = report.links.into_iter().next().ok_or("no link")?;
    link.bearing.map_err(|error| error.to_string())
}

/// The bearing to the scene's transmitter from the mean pose of the samples.
fn truth(scene: &Scene, bearing: &Bearing) -> Option<f64> {
    let [x, y, _] = scene.robot.get(1)?.position_m;
    Some((y - bearing.mean_position_m.y).atan2(x - bearing.mean_position_m.x))
}

fn table(shown: &[Shown]) -> String {
    let mut text = String::from(
        "          exchanges   azimuth       +-    mirror     truth     error   phase, before   after\n\
         \x20                       deg      deg       deg       deg       deg   cancelling      rad\n",
    );
    let degrees = |rad: Option<f64>| rad.map_or("-".into(), |rad| format!("{:.2}", rad.to_degrees()));
    for Shown { name, bearing, truth_rad } in shown {
        let answer = &bearing.answer;
        let off = |azimuth: f64| truth_rad.map(|truth| wrap_rad(azimuth - truth));
        let errors = [Some(answer.azimuth_rad), answer.mirror_rad].into_iter().flatten().filter_map(off);
        let error = errors.min_by(|a, b| a.abs().total_cmp(&b.abs()));
        let (before, after) = bearing.turn_around.as_ref().map_or((f64::NAN, f64::NAN), |t| {
            (csi5300_lab::suite::spread_rad(t.coherence_before), csi5300_lab::suite::spread_rad(t.coherence_after))
        });
        let _ = writeln!(
            text,
            "  {name:<8} {:>8} {:>9} {:>8.2} {:>9} {:>9} {:>+9.2} {:>15} {:>7}",
            bearing.pairs.formed,
            degrees(Some(answer.azimuth_rad)),
            answer.azimuth_sd_rad.to_degrees(),
            degrees(answer.mirror_rad),
            degrees(*truth_rad),
            error.unwrap_or(f64::NAN).to_degrees(),
            format!("{before:.2} rad"),
            format!("{after:.2}"),
        );
    }
    text += "\nA line cannot tell a bearing from its mirror image: the error is that of the nearer of the two.\n";
    text
}

#[cfg(not(feature = "plot"))]
fn draw(_: &Path, _: &str, _: &Bearing, _: &Scene, _: Option<f64>, _: Option<&Bearing>) -> Words<()> {
    Ok(())
}

#[cfg(not(feature = "plot"))]
fn draw_standing(_: &Path, _: &Standing) -> Words<()> {
    Ok(())
}

#[cfg(feature = "plot")]
fn draw_standing(out: &Path, standing: &Standing) -> Words<()> {
    let written = csi5300_lab::show::repeated::standing(standing).write(&out.join("standing-phase"));
    say_pictures(&written.map_err(|error| error.to_string())?);
    Ok(())
}

#[cfg(feature = "plot")]
fn draw(
    out: &Path,
    name: &str,
    bearing: &Bearing,
    scene: &Scene,
    truth_rad: Option<f64>,
    recorded: Option<&Bearing>,
) -> Words<()> {
    let transmitter_m = scene.robot.get(1).map(|robot| [robot.position_m[0], robot.position_m[1]]);
    let pictures = csi5300_lab::show::link::LinkPictures { bearing, truth_rad, transmitter_m, recorded };
    say_pictures(&pictures.write(out, name).map_err(|error| error.to_string())?);
    Ok(())
}

#[cfg(feature = "plot")]
fn say_pictures(written: &[PathBuf]) {
    for path in written.iter().filter(|path| path.extension().is_some_and(|extension| extension == "png")) {
        print(&format!("  picture {}\n", path.display()));
    }
}
