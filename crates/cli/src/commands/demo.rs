//! `csi5300 demo`: the circle and line of Dijkstra et al. (\[paper\] in docs/references.md), simulated, decoded
//! and estimated.

use super::args::Estimation;
use super::{Outcome, Result, print, simulate};
use csi5300::maths::wrap_rad;
use csi5300::motion::odometry;
use csi5300::pipeline::Bearing;
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{CsiSource, replay::Replay};
use csi5300_sim::{Scene, WrittenCapture};
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
}

/// Its two experiments, and what they are drawn as.
const SCENES: [(&str, &str); 2] = [
    ("circle", include_str!("../../../../scenes/paper-circle.toml")),
    ("line", include_str!("../../../../scenes/paper-line.toml")),
];

type Words<T> = std::result::Result<T, String>;

/// Runs the demonstration.
pub fn run(args: &Args) -> Result {
    print(
        "Two robots, simulated down to the bytes their cards, drivers and loggers would have written: TDMA exchange,\n",
    );
    print("CFO, 3 dB of noise, 8-bit CSI. What follows reads those logs as if they were recorded.\n\n");
    let channel = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
    let options = Estimation::default().options(channel)?.with_keep_course(true);
    let recorded = match args.recorded.as_slice() {
        [rx, tx, trajectory] => Some(estimate(rx, tx, trajectory, &options)?),
        _ => None,
    };
    let mut next = String::new();
    for (name, text) in SCENES {
        let scene = Scene::from_toml(text).map_err(|error| format!("scene {name}: {error}"))?;
        let folder = args.out.join(name);
        let (captures, _) = simulate::write(&scene, &folder)?;
        let capture = captures.first().ok_or_else(|| format!("scene {name} has no initiator"))?;
        let (rx, tx, trajectory) = files(capture);
        if next.is_empty() {
            next = commands(&rx, &tx, &trajectory);
        }
        let bearing = estimate(&rx, &tx, &trajectory, &options)?;
        let truth_rad = truth(&scene, &bearing);
        print(&describe(name, &folder, &bearing, truth_rad));
        draw(&args.out, name, &bearing, truth_rad, recorded.as_ref().filter(|_| name == "circle"))?;
    }
    print(&format!("\nLogs and pictures are in {}. Try next:\n{next}", args.out.display()));
    Ok(Outcome::Done)
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

fn estimate(rx: &Path, tx: &Path, trajectory: &Path, options: &Options) -> Words<Bearing> {
    let open = |path: &Path| Replay::open(path).map_err(|error| super::hint::log_refused(&error));
    let (mut receiver, mut transmitter) = (open(rx)?, open(tx)?);
    let (path, _) = odometry::csv::read(trajectory).map_err(|error| format!("{}: {error}", trajectory.display()))?;
    let transmitters = vec![Transmitter { log: &mut transmitter as &mut dyn CsiSource, trajectory: None }];
    let report = bearings(&mut receiver, transmitters, &path, options).map_err(|error| error.to_string())?;
    let link = report.links.into_iter().next().ok_or("no link")?;
    link.bearing.map_err(|error| format!("{}: {error}", tx.display()))
}

/// The bearing to the scene's transmitter from the mean pose of the samples.
fn truth(scene: &Scene, bearing: &Bearing) -> Option<f64> {
    let [x, y, _] = scene.robot.get(1)?.position_m;
    Some((y - bearing.mean_position_m.y).atan2(x - bearing.mean_position_m.x))
}

fn describe(name: &str, folder: &Path, bearing: &Bearing, truth_rad: Option<f64>) -> String {
    let answer = &bearing.answer;
    let mut text = format!(
        "{name}: {} pairs; azimuth {:.2} +- {:.2} deg",
        bearing.pairs.formed,
        answer.azimuth_rad.to_degrees(),
        answer.azimuth_sd_rad.to_degrees()
    );
    if let Some(mirror) = answer.mirror_rad {
        text += &format!(", or its mirror {:.2} deg (a line cannot tell them apart)", mirror.to_degrees());
    }
    if let Some(truth_rad) = truth_rad {
        let off = |azimuth: f64| wrap_rad(azimuth - truth_rad).to_degrees();
        let errors = [Some(answer.azimuth_rad), answer.mirror_rad].into_iter().flatten().map(off);
        let error = errors.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or_default();
        text += &format!("\n  truth {:.2} deg from the mean pose: error {error:+.2} deg", truth_rad.to_degrees());
    }
    let share = bearing.figures.likelihood_share.unwrap_or_default();
    text += &format!(
        "\n  coherence {:.2}, likelihood share {share:.4}; logs in {}\n",
        bearing.plane_wave.coherence,
        folder.display()
    );
    text
}

#[cfg(not(feature = "plot"))]
fn draw(_: &Path, _: &str, _: &Bearing, _: Option<f64>, _: Option<&Bearing>) -> Words<()> {
    Ok(())
}

#[cfg(feature = "plot")]
fn draw(out: &Path, name: &str, bearing: &Bearing, truth_rad: Option<f64>, recorded: Option<&Bearing>) -> Words<()> {
    let pictures = csi5300_lab::show::link::LinkPictures { bearing, truth_rad, recorded };
    for path in pictures.write(out, name).map_err(|error| error.to_string())? {
        if path.extension().is_some_and(|extension| extension == "png") {
            print(&format!("  picture {}\n", path.display()));
        }
    }
    Ok(())
}
