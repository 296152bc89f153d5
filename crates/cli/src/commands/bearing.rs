//! `csi5300 bearing`.

mod captures;
mod graph;
mod located;
mod one_log;
mod pairs;
mod roles;
mod transmitters;
mod words;

use self::words::{describe, explain_lines};
use super::Words;
use super::args::{Baseline, Estimation, baseline, channel, columns, mac};
use super::files::Log;
use super::inputs::{BagArgs, Inputs, order_unknown};
use super::mounting::Mounting;
use super::{Outcome, Result, hint, info, is_same_file, print, print_json, profile, usage};
use csi5300::bartlett::Grid;
use csi5300::motion::odometry::csv::Columns;
use csi5300::pipeline::LinkError;
use csi5300::pipeline::LinkPlan;
use csi5300::pipeline::{Answer, lost_something};
use csi5300::pipeline::{CaptureReport, Effort, LinkReport, LogReport, OdometryFit, Options, Transmitter, bearings};
use csi5300::signal::channel::Channel;
use csi5300::source::{CsiSource, read_key};
use csi5300_say::{Level, says};
use driver_iface::Mac;
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `bearing`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  csi5300 bearing DIR/tx2 --plot pictures\n  \
                        csi5300 bearing RX.dat TX.dat T.csv --channel 108\n  \
                        csi5300 bearing RX.dat T.csv --channel 108 --antennas A,B --baseline 0.1,0,0\n\
                        --help lists all options.")]
pub struct Args {
    /// Folders of captures, one link (FOLDER/tx2), or logs and a trajectory, recognised by their content. Two or more
    /// links to known positions also locate the receiver
    #[arg(value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// WiFi channel, with + or - for 40 MHz [default: the capture's]
    #[arg(long, value_parser = channel, value_name = "NUMBER", required_unless_present = "captures")]
    channel: Option<Channel>,
    #[command(flatten)]
    mounting: Mounting,
    /// Correct odometry by the phases of all links, and print its scale, turn and the antenna's offset with deviations
    #[arg(long, value_name = "WHAT", conflicts_with_all = ["transmitters", "baseline"], hide_short_help = true)]
    fit: Option<Fit>,
    /// Draw phase, trajectory and profile of each link, and a map of each capture, into this folder
    #[arg(long, visible_alias = "out", value_name = "DIR")]
    plot: Option<PathBuf>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    /// Print which steps of each link were computed or skipped, and why
    #[arg(long, hide_short_help = true)]
    explain: bool,
    /// Overwrite existing outputs
    #[arg(long, hide_short_help = true)]
    force: bool,
    #[command(flatten)]
    logs: Logs,
    #[command(flatten)]
    estimation: Estimation,
    /// Required accuracy of the azimuth: 3 and more search on the coarse grid only; 0 computes every step [default:
    /// what the scene needs]
    #[arg(long, value_name = "DEGREES", value_parser = accuracy, conflicts_with_all = ["transmitters", "baseline"], hide_short_help = true)]
    accuracy: Option<f64>,
    /// Refuse bearings whose probability of being within 5 degrees is unknown or below this (0 to 1)
    #[arg(long, value_name = "P", hide_short_help = true)]
    min_confidence: Option<f64>,
    /// Position of a transmitter in the trajectory's frame, metres: tx2=-3.18,1.11. It replaces the capture's truth.
    /// Heights give the receiver's height too, if the motion shows elevations
    #[arg(
        long,
        value_name = "NAME=X,Y[,Z]",
        value_parser = captures::place,
        allow_hyphen_values = true,
        requires = "captures",
        hide_short_help = true
    )]
    place: Vec<(String, captures::Place)>,
    #[command(flatten)]
    together: transmitters::Together,
    #[command(flatten)]
    graph: graph::Graph,
    /// Write the profile of each link as CSV or NPZ
    #[arg(long, value_name = "OUT.npz|.csv", hide_short_help = true, help_heading = "Profiles")]
    profile: Option<PathBuf>,
    /// Directions of the profile: 360x181 (azimuth x elevation), 360 (azimuth only), or wsr (the toolbox's grid)
    #[arg(long, default_value = "360", value_parser = profile::grid, value_name = "GRID", hide_short_help = true, help_heading = "Profiles")]
    grid: Grid,
}

/// What is fitted before bearings.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Fit {
    Odometry,
}

// Logs named one by one.
#[derive(clap::Args)]
#[command(next_help_heading = "Single logs")]
struct Logs {
    /// Log of the receiver; - is standard input
    #[arg(long, value_name = "RX.dat", required_unless_present_any = ["captures", "bag"], hide_short_help = true)]
    rx: Option<PathBuf>,
    /// Log of a transmitter; several may follow: --tx csi_tx*.dat
    #[arg(long, value_name = "TX.dat", hide_short_help = true)]
    tx: Vec<PathBuf>,
    /// Trajectory of the receiver: CSV, TUM, KITTI, Motive or ROS text (docs/reference/formats.md). For a capture: gt
    /// (motion capture, the default), t265 (tracking camera) or odom (wheels)
    #[arg(long, value_name = "T.csv", required_unless_present_any = ["captures", "bag"], hide_short_help = true)]
    trajectory: Option<PathBuf>,
    /// Columns of trajectories, instead of their headings: t,x,y,yaw (also ns, z, qx, qy, qz, qw; t_ms, x_mm, yaw_deg
    /// ..; _ skips a column)
    #[arg(long, value_parser = columns, value_name = "NAMES", hide_short_help = true)]
    columns: Option<Columns>,
    #[command(flatten)]
    bag: BagArgs,
    /// Position of the first of --antennas relative to the second: metres forward, left, up; repeat it for a third antenna.
    /// Two antennas of a robot that turns give bearings to all senders in --rx; --tx adds the answers. With the constant DEG of
    /// the chains and its deviation SD (`chain_constants_deg` of --json), the robot may stand
    #[arg(
        long,
        value_name = "X,Y,Z[,DEG[,SD]]",
        value_parser = baseline,
        allow_hyphen_values = true,
        conflicts_with_all = ["tx_trajectory", "bag", "camera_mount", "explain"],
        hide_short_help = true
    )]
    baseline: Vec<Baseline>,
    /// Trajectory of a transmitter that moved, in the order of --tx, on the receiver's clock
    #[arg(long, value_name = "T.csv", hide_short_help = true)]
    tx_trajectory: Vec<PathBuf>,
    /// MAC of a transmitter, in the order of --tx; by default found from the clocks
    #[arg(long, value_parser = mac, value_name = "MAC", hide_short_help = true)]
    tx_mac: Vec<Mac>,
    /// MAC of the receiver in the transmitters' logs; by default the most frequent one
    #[arg(long, value_parser = mac, value_name = "MAC", hide_short_help = true)]
    rx_mac: Option<Mac>,
    /// Key of the robots: skip frames (0xC1) without its tag. Records without frames, as of the WSR driver, are counted
    /// as unchecked
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    key: Option<PathBuf>,
}

/// Ends the program if arguments contradict each other.
fn check(args: &Args) {
    if args.logs.tx_trajectory.len() > args.logs.tx.len() || args.logs.tx_mac.len() > args.logs.tx.len() {
        usage("more --tx-trajectory or --tx-mac than --tx");
    }
    if (1..args.logs.tx_mac.len()).any(|k| args.logs.tx_mac[..k].contains(&args.logs.tx_mac[k])) {
        usage("one --tx-mac is given twice: each log belongs to another transmitter");
    }
    if args.logs.rx.iter().chain(&args.logs.tx).filter(|path| path.as_os_str() == "-").count() > 1 {
        usage("standard input can be one log only");
    }
    let logs = || args.logs.rx.iter().chain(&args.logs.tx).enumerate();
    let is_same = |a: &Path, b: &Path| a == b || is_same_file(a, b);
    if let Some((_, twice)) = logs().find(|(k, log)| logs().take(*k).any(|(_, other)| is_same(log, other))) {
        usage(&format!("{} is given twice: each robot has its own log", twice.display()));
    }
    if let Some(path) = args.profile.as_deref().filter(|path| !profile::is_known(path)) {
        usage(&format!("{}: a profile is written as .csv or .npz", path.display()));
    }
}

/// Opens the transmitters' logs. Removes an unreadable one, with its MAC and trajectory, from the arguments and gives
/// its error as an answer; an error if it is the only log.
fn open_transmitters(args: &mut Args, inputs: &Inputs) -> Words<(Vec<Log>, Vec<Answer>)> {
    let (mut logs, mut unread, mut k) = (Vec::new(), Vec::new(), 0);
    while let Some(path) = args.logs.tx.get(k) {
        match inputs.open(path) {
            Ok(log) => {
                logs.push(log);
                k += 1;
            }
            Err(error) if logs.is_empty() && args.logs.tx.len() == 1 => return Err(error),
            Err(error) => {
                let link = link_name(inputs, &args.logs.tx.remove(k));
                unread.push(Answer::failed(link, error));
                if k < args.logs.tx_mac.len() {
                    args.logs.tx_mac.remove(k);
                }
                if k < args.logs.tx_trajectory.len() {
                    args.logs.tx_trajectory.remove(k);
                }
            }
        }
    }
    Ok((logs, unread))
}

/// Runs what does not estimate bearings from two logs: one log, or captures. Ends the program if the other log is missing.
fn run_other(args: &Args) -> Option<Result> {
    if !args.logs.baseline.is_empty() && args.logs.tx.is_empty() {
        if args.logs.rx_mac.is_some() || args.logs.key.is_some() || args.mounting.antenna_offset.is_some() {
            usage("with --baseline, --rx-mac, --key and --antenna-offset need --tx");
        }
        return Some(one_log::run(args));
    }
    if !args.captures.is_empty() {
        return Some(captures::run(args));
    }
    if args.graph.is_wanted() {
        usage("--ranges and --factors need a capture with transmitters at known places");
    }
    if args.logs.tx.is_empty() && args.logs.bag.bag.is_none() {
        usage("--tx is needed: the other robot's log. For a bearing from one log, add --antennas and --baseline");
    }
    None
}

/// Estimates and prints the bearings.
pub fn run(mut args: Args) -> Result {
    if args.min_confidence.is_some_and(|least| !(0.0..=1.0).contains(&least)) {
        usage("--min-confidence takes a probability, 0 to 1");
    }
    if args.estimation.antenna.len() > 1 && args.logs.baseline.is_empty() {
        usage(
            "two antennas of one robot need --baseline X,Y,Z: where the first is seen from the second, in metres forward, left, up",
        );
    }
    roles::take(&mut args)?;
    if let Some(done) = run_other(&args) {
        return done;
    }
    let options = options(&args).unwrap_or_else(|message| usage(&message));
    let key = args.logs.key.as_deref().map(read_key).transpose().map_err(|error| error.to_string())?;
    let is_named = !args.logs.tx.is_empty();
    let (inputs, named) = args.logs.bag.resolve(
        args.logs.rx.take(),
        std::mem::take(&mut args.logs.tx),
        args.logs.trajectory.take(),
        args.logs.columns.as_ref(),
    )?;
    (args.logs.rx, args.logs.tx) = (Some(named.rx.clone()), named.tx);
    let rx = named.rx;
    check(&args);
    if !is_named && args.logs.tx.len() > 1 && args.logs.tx_mac.len() + args.logs.tx_trajectory.len() > 0 {
        usage(&order_unknown(&args.logs.tx));
    }
    let mut options = options.with_key(key).with_parallel(args.logs.tx.len() > 1);
    let trajectory = args.mounting.of_antenna(inputs.trajectory(&named.trajectory)?)?;
    let mut receiver = inputs.open(&rx)?;
    let (mut logs, unread) = open_transmitters(&mut args, &inputs)?;
    options.tx_macs.clone_from(&args.logs.tx_mac);
    let partners = args.logs.tx_trajectory.iter().map(|path| inputs.trajectory(path));
    let partners = partners.collect::<std::result::Result<Vec<_>, _>>()?;
    let transmitters = logs
        .iter_mut()
        .enumerate()
        .map(|(k, log)| Transmitter { log: log as &mut (dyn CsiSource + Send), trajectory: partners.get(k) })
        .collect();
    super::threads::make(0)?;
    let mut report = bearings(&mut receiver, transmitters, &trajectory, &options).map_err(|error| error.to_string())?;
    if !args.logs.baseline.is_empty() {
        one_log::join(&args, &inputs, (&rx, &named.trajectory), &mut report)?;
    }
    let names = told_apart(args.logs.tx.iter().map(|path| link_name(&inputs, path)).collect());
    let (mut answered, links) = (0, names.len() + unread.len());
    print_fit(&args, report.links.iter().find_map(|link| link.bearing.as_ref().ok()?.odometry_fit.as_ref()));
    for (name, link) in names.iter().zip(&report.links) {
        let mut answer = Answer::new(name.clone(), link);
        hint::add(&mut answer);
        if let Some(least) = args.min_confidence {
            answer.refuse_below(least);
        }
        if let (true, Ok(bearing)) = (args.explain, &link.bearing) {
            answer.plan = Some(LinkPlan::of(bearing, &options, &args.grid).map_err(|error| error.to_string())?);
        }
        answered += usize::from(answer.azimuth_deg.is_some());
        tell(&answer, links, args.json);
        say_heard(&rx, &report, link);
        artefacts(&args, name, link, report.links.len())?;
    }
    unread.iter().for_each(|answer| tell(answer, links, args.json));
    if !args.json {
        explain_lines(links);
    }
    say_losses(&args, &rx, &report, &receiver, &logs);
    Ok(if answered == 0 {
        Outcome::Nothing
    } else if answered < report.links.len() || !unread.is_empty() || lost_something(&report) || inputs.lost() {
        Outcome::DataLost
    } else {
        Outcome::Done
    })
}

/// The names of links, those that stand more than once with their place among all behind them.
fn told_apart(stems: Vec<String>) -> Vec<String> {
    let is_shared = |name: &String| stems.iter().filter(|other| *other == name).count() > 1;
    let apart = |(k, name): (usize, &String)| if is_shared(name) { format!("{name}.{}", k + 1) } else { name.clone() };
    stems.iter().enumerate().map(apart).collect()
}

/// Degrees that an azimuth may be off.
fn accuracy(text: &str) -> Words<f64> {
    let degrees = text.parse().ok().filter(|degrees| (0.0..=45.0).contains(degrees));
    degrees.ok_or_else(|| "degrees from 0 to 45".into())
}

impl Args {
    /// Options with the effort that the accuracy needs, and with what is drawn or printed beside the bearing.
    fn asked(&self, options: Options) -> Options {
        let has_figures = self.json || says(Level::Verbose);
        let mut options = options.with_range_change(self.json).with_figures(has_figures);
        options = options.with_fit_odometry(self.fit.is_some());
        options = options.with_keep_course(self.plot.is_some());
        let effort = match self.accuracy {
            None => return options,
            Some(0.0) => Effort::Everything,
            Some(degrees) => Effort::Within(degrees.to_radians()),
        };
        options.accuracy = options.accuracy.with_effort(effort);
        options
    }
}

fn options(args: &Args) -> Words<Options> {
    let options = args.asked(args.estimation.options(args.channel.ok_or("--channel is needed")?)?);
    Ok(options.with_macs(args.logs.rx_mac, args.logs.tx_mac.clone()))
}

/// Writes the profile and the pictures of a link that has a bearing.
fn artefacts(args: &Args, name: &str, link: &LinkReport, links: usize) -> Words<()> {
    let Ok(bearing) = &link.bearing else { return Ok(()) };
    if let Some(path) = &args.profile {
        let path = if links > 1 { numbered(path, name) } else { path.clone() };
        let draft = super::draft::Draft::create(&path, args.force)?;
        profile::write(draft.path(), &args.grid, &bearing.samples).map_err(|error| draft.words(&error))?;
        draft.keep(false).map_err(|error| format!("writing {}: {error}", path.display()))?;
        note!("profile of {name}: {}", path.display());
    }
    if let Some(folder) = &args.plot {
        let pictures = csi5300_lab::show::results::LinkPictures { bearing, truth_rad: None, transmitter_m: None };
        write(&pictures, folder, name)?;
    }
    Ok(())
}

/// Writes the pictures of a link.
fn write(pictures: &csi5300_lab::show::results::LinkPictures<'_>, folder: &Path, name: &str) -> Words<()> {
    let written = pictures.write(folder, name, &super::draft::read_files()).map_err(|error| error.to_string())?;
    let first: Vec<String> = super::pictures::first_of_each(&written).map(|path| path.display().to_string()).collect();
    note!("pictures of {name}, also as .svg: {}", first.join(", "));
    Ok(())
}

/// `out.npz` becomes `out.NAME.npz`.
fn numbered(path: &Path, name: &str) -> PathBuf {
    let extension = path.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_extension(format!("{}.{extension}", name.replace('/', "_")))
}

/// The name of a link by its transmitter's log: `TS/txK` for csi_txK_TS.dat, as of captures, else the log's name; of a topic of
/// a recording the topic's, without the first `/`.
fn link_name(inputs: &Inputs, path: &Path) -> String {
    if inputs.is_topic(path) {
        return path.to_string_lossy().trim_matches('/').to_owned();
    }
    let stem = path.file_stem().map_or_else(|| path.display().to_string(), |stem| stem.to_string_lossy().into_owned());
    let parts = stem.strip_prefix("csi_tx").map(|rest| {
        let (number, stamp) = rest.split_at(rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len()));
        (number, stamp.strip_prefix('_').filter(|stamp| !stamp.is_empty()))
    });
    match parts {
        Some((number, Some(stamp))) => format!("{stamp}/tx{number}"),
        _ => stem,
    }
}

/// True if frames of 80 or 160 MHz are taken about their centre, and the channel was given by a number, which is that of 20 MHz.
fn lacks_centre(report: &LogReport, channel: Option<Channel>) -> bool {
    let is_wide = report.survey.rates.keys().any(|rate| rate & csi5300::source::other_card::WIDE != 0);
    is_wide && channel.is_none_or(|channel| !channel.to_string().ends_with("MHz"))
}

fn say_losses(args: &Args, rx_path: &Path, report: &CaptureReport, rx: &Log, txs: &[Log]) {
    let log = |path: &Path, report: &LogReport, bytes: u64| {
        let lines = info::unusual_losses(&report.survey, bytes);
        let unused = report.unused;
        let mut text = String::new();
        if unused.unauthenticated > 0 {
            let _ = writeln!(text, "  not used: {} records of frames without a valid tag", unused.unauthenticated);
        }
        if report.unchecked > 0 {
            let _ = writeln!(
                text,
                "  {} records have no frame with them (WSR's layout, or a robot's key for frames of others): their tags \
                 cannot be checked, so anybody may have sent them with the robots' addresses",
                report.unchecked
            );
        }
        // A receiver hears every transmitter, so frames of others are usual.
        let others = if says(Level::Verbose) { unused.other_sender } else { 0 };
        for (count, what) in [
            (unused.no_number, "without a frame number"),
            (unused.no_antenna, "without the antenna"),
            (others, "of other senders"),
        ] {
            if count > 0 {
                let _ = writeln!(text, "  not used: {} {what}", super::some(count, "record", "records"));
            }
        }
        if lacks_centre(report, args.channel) {
            let _ = writeln!(
                text,
                "  frames of 80 or 160 MHz are taken about their centre: name the channel by that, for example --channel 5530MHz"
            );
        }
        if let Some((better, above_db)) = report.survey.better_antenna(args.estimation.antenna()) {
            let _ = writeln!(
                text,
                "  antenna {} hears {above_db:.0} dB less than {better}, as a port without an antenna does (--antenna {better})",
                args.estimation.antenna()
            );
        }
        if !lines.is_empty() || !text.is_empty() {
            notes!("{}: {} bfee records\n{lines}{text}", path.display(), report.survey.bfees());
        }
    };
    log(rx_path, &report.receiver, rx.bytes());
    for ((path, report), source) in args.logs.tx.iter().zip(&report.transmitters).zip(txs) {
        log(path, report, source.bytes());
    }
}

/// What the odometry got wrong, and how the antenna's place is given from now on. JSON has it in every link.
fn print_fit(args: &Args, fit: Option<&OdometryFit>) {
    let Some(fit) = fit.filter(|_| !args.json) else { return };
    print(&words::fitted(fit, args.mounting.antenna_offset.unwrap_or_default()));
}

/// One link's answer, and why there is none.
fn tell(answer: &Answer, links: usize, json: bool) {
    if json {
        print_json(answer);
    } else {
        print(&describe(answer, captures::MirrorOf::Motion, links, &pairs::doubts(answer), &pairs::pairs(answer)));
        print(&answer.plan.as_ref().map(ToString::to_string).unwrap_or_default());
    }
    if let Some(error) = &answer.error {
        wrong!("{}: {error}", answer.link);
    }
}

/// Of a link without a single frame in the receiver's log: whose frames there are.
fn say_heard(rx: &Path, report: &CaptureReport, link: &LinkReport) {
    if let Err(LinkError::NoPairs { receiver: 0, .. }) = &link.bearing {
        let senders = report.receiver.survey.senders.iter();
        let heard: Vec<String> = senders
            .map(|(mac, sender)| format!("{mac} ({})", super::some(sender.records, "record", "records")))
            .collect();
        note!(
            "  {} has frames of: {}",
            rx.display(),
            if heard.is_empty() { "nobody".into() } else { heard.join(", ") }
        );
    }
}
