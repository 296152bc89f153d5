//! `csi5300 bearing`: from the logs of two robots; with --antennas and --baseline those of all senders in one log, from antennas on a
//! turning robot.

mod captures;
mod words;

use super::args::{Baseline, Estimation, Mounting, baseline};
use super::files::{
    BagArgs, Inputs, Log, first_of_each, is_read_once, must_not_be_empty, order_unknown, refuse_twice, told_apart,
};
use super::{InWords, Outcome, Result, Words, hint, info, print, print_json, usage};
use captures::MirrorOf;
use csi_formats::{Item, Items};
use csi5300::bartlett::{self, Grid, Profile};
use csi5300::motion::odometry::csv::{self, Columns};
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{
    Answer, Array, ArrayError, CaptureReport, ChainConstant, Effort, LinkError, LinkPlan, LinkReport, LogReport,
    OdometryFit, OneLog, Options, Transmitter, bearings, lost_something, one_log,
};
use csi5300::signal::channel::Channel;
use csi5300::source::{CsiSource, read_key, side_path};
use csi5300_lab::cards::{CardSurvey, is_log};
use csi5300_lab::evaluate::captures::{Sorted, loose_files, receiver, the_trajectory};
use csi5300_lab::evaluate::{TRUTH_FILE, channel_in};
use csi5300_lab::export::Npz;
use csi5300_lab::kinds::trajectory_refused;
use csi5300_say::{Level, says};
use driver_iface::Mac;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use words::{describe, doubts, explain_lines, fitted, pairs, records};

// Arguments of `bearing`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  csi5300 bearing DIR/tx2 --plot pictures\n  \
                        csi5300 bearing RX.dat TX.dat T.csv --channel 108\n  \
                        csi5300 bearing RX.dat T.csv --channel 108 --antennas A,B --baseline 0.1,0,0\n\
                        --help lists all options.")]
#[command(group = clap::ArgGroup::new("directions").args(["profile", "explain"]).multiple(true))]
pub struct Args {
    /// Folders of captures, one link (FOLDER/tx2), or logs and a trajectory, recognised by their content. Two or more
    /// links to known positions also locate the receiver
    #[arg(value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// WiFi channel, with + or - for 40 MHz [default: the capture's]
    #[arg(long, value_name = "NUMBER", required_unless_present = "captures")]
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
    together: captures::Together,
    #[command(flatten)]
    graph: captures::Graph,
    /// Write the profile of each link as CSV or NPZ
    #[arg(long, value_name = "OUT.npz|.csv", hide_short_help = true, help_heading = "Profiles")]
    profile: Option<PathBuf>,
    /// Directions of the profile: 360x181 (azimuth x elevation), 360 (azimuth only), or wsr (the toolbox's grid) [default: 360]
    #[arg(long, requires = "directions", value_parser = grid, value_name = "GRID", hide_short_help = true, help_heading = "Profiles")]
    grid: Option<Grid>,
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
    #[arg(long, value_name = "NAMES", allow_hyphen_values = true, hide_short_help = true)]
    columns: Option<Columns>,
    #[command(flatten)]
    bag: BagArgs,
    /// Position of the first of --antennas relative to the second: metres forward, left, up; repeat it for a third antenna.
    /// Two antennas of a robot that turns give bearings to all senders in --rx, and places if it drives; --tx adds the
    /// answers. With the constant DEG of the chains and its deviation SD (`chain_constants_deg` of --json), the robot may stand
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
    #[arg(long, value_name = "MAC", hide_short_help = true)]
    tx_mac: Vec<Mac>,
    /// MAC of the receiver in the transmitters' logs; by default the most frequent one
    #[arg(long, value_name = "MAC", hide_short_help = true)]
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
    refuse_twice(args.logs.rx.iter().chain(&args.logs.tx));
    if let Some(path) = args.profile.as_deref().filter(|path| !is_profile(path)) {
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
    if args.captures.is_empty() {
        let of_captures = [
            ("--ranges and --factors need", args.graph.is_wanted()),
            ("--place needs", !args.place.is_empty()),
            ("--transmitters needs", args.together.transmitters),
        ];
        if let Some((needs, _)) = of_captures.iter().find(|(_, given)| *given) {
            usage(&format!("{needs} a capture with transmitters: name its folder instead of single logs"));
        }
    }
    if !args.logs.baseline.is_empty() && args.logs.tx.is_empty() {
        if args.logs.rx_mac.is_some() || args.logs.key.is_some() || args.estimation.range_min.is_some() {
            usage("with --baseline, --rx-mac, --key and --range-min need --tx");
        }
        return Some(run_one_log(args));
    }
    if !args.captures.is_empty() {
        return Some(captures::run(args));
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
    take_roles(&mut args)?;
    if let Some(done) = run_other(&args) {
        return done;
    }
    let options = options(&args).unwrap_or_else(|message| usage(&message));
    let key = args.logs.key.as_deref().map(read_key).transpose().in_words()?;
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
    let mut options = Options { key, parallel: args.logs.tx.len() > 1, ..options };
    let trajectory = args.mounting.of_antenna(inputs.trajectory(&named.trajectory)?)?;
    let is_fitted = args.mounting.antenna_offset.is_some() || args.fit.is_some();
    args.estimation.say_heading(&named.trajectory, &trajectory, is_fitted);
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
    // One for each core, this one among them.
    let threads = rayon::ThreadPoolBuilder::new().use_current_thread();
    csi5300_live::sys::keep_heap();
    threads.start_handler(|_| csi5300_live::sys::keep_heap()).build_global().in_words()?;
    let mut report = bearings(&mut receiver, transmitters, &trajectory, &options).in_words()?;
    if !args.logs.baseline.is_empty() {
        join_one_log(&args, &inputs, (&rx, &named.trajectory), &mut report)?;
    }
    let names = told_apart(args.logs.tx.iter().map(|path| link_name(&inputs, path)).collect());
    let (mut answered, links) = (0, names.len() + unread.len());
    print_fit(&args, report.links.iter().find_map(|link| link.bearing.as_ref().ok()?.odometry_fit.as_ref()));
    for (name, link) in names.iter().zip(&report.links) {
        let mut answer = answer(&args, name, link);
        if let (true, Ok(bearing)) = (args.explain, &link.bearing) {
            answer.plan = Some(LinkPlan::of(bearing, &options, &args.grid()).in_words()?);
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
    let contradiction = report.contradiction(std::iter::once(&trajectory).chain(&partners), &options);
    contradiction.iter().for_each(|words| note!("{}: {words}", rx.display()));
    report.clock_doubt().iter().for_each(|doubt| note!("{}: {doubt}", rx.display()));
    let lost = answered < report.links.len() || !unread.is_empty() || lost_something(&report) || inputs.lost();
    let lost = lost || contradiction.is_some();
    Ok(Outcome::of(answered > 0, lost))
}

/// The answer for a link, with a hint, and refused below `--min-confidence`.
fn answer(args: &Args, name: &str, link: &LinkReport) -> Answer {
    let mut answer = Answer::new(name.to_owned(), link);
    hint::add(&mut answer);
    if let Some(least) = args.min_confidence {
        answer.refuse_below(least);
    }
    answer
}

/// Degrees that an azimuth may be off.
fn accuracy(text: &str) -> Words<f64> {
    let degrees = text.parse().ok().filter(|degrees| (0.0..=45.0).contains(degrees));
    degrees.ok_or_else(|| "degrees from 0 to 45".into())
}

impl Args {
    fn grid(&self) -> Grid {
        self.grid.clone().unwrap_or_else(|| Grid::azimuth(360))
    }

    /// Options with the effort that the accuracy needs, and with what is drawn or printed beside the bearing.
    fn asked(&self, options: Options) -> Options {
        let has_figures = self.json || says(Level::Verbose);
        let mut options = Options { range_change: self.json, figures: has_figures, ..options };
        options.fit_odometry = self.fit.is_some();
        options.keep_course = self.plot.is_some();
        let effort = match self.accuracy {
            None => return options,
            Some(0.0) => Effort::Everything,
            Some(degrees) => Effort::Within(degrees.to_radians()),
        };
        options.accuracy.effort = effort;
        options
    }
}

fn options(args: &Args) -> Words<Options> {
    let options = args.asked(args.estimation.options(args.channel.ok_or("--channel is needed")?)?);
    Ok(Options { rx_mac: args.logs.rx_mac, tx_macs: args.logs.tx_mac.clone(), ..options })
}

/// Writes the profile and the pictures of a link that has a bearing.
fn artefacts(args: &Args, name: &str, link: &LinkReport, links: usize) -> Words<()> {
    let Ok(bearing) = &link.bearing else { return Ok(()) };
    if let Some(path) = &args.profile {
        let path = if links > 1 { numbered(path, name) } else { path.clone() };
        let draft = super::draft::Draft::create(&path, args.force)?;
        let profile = bartlett::profile(&bearing.samples, &args.grid()).in_words()?;
        let written = write_profile(draft.path(), &profile).and_then(|()| draft.keep(false));
        written.map_err(|error| format!("cannot write {}: {error}", path.display()))?;
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
    let written = super::draft::pictures(folder, |folder| pictures.write(folder, name))?;
    let first: Vec<String> = first_of_each(&written).map(|path| path.display().to_string()).collect();
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
    print(&fitted(fit, args.mounting.antenna_offset.unwrap_or_default()));
}

/// One link's answer, and why there is none.
fn tell(answer: &Answer, links: usize, json: bool) {
    if json {
        print_json(answer);
    } else {
        print(&describe(answer, captures::MirrorOf::Motion, links, &doubts(answer), &pairs(answer)));
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

/// The result of another card's log, and whether something was lost or in doubt; `None` for other files.
fn other_card(
    path: &Path,
    trajectory: &Trajectory,
    array: &Array,
    options: &Options,
) -> Words<Option<(CaptureReport, bool)>> {
    let Some((format, bytes)) = csi5300_lab::cards::read(path) else { return Ok(None) };
    let mut one = OneLog::new(array.clone(), options.clone());
    let (mut survey, mut without, mut elsewhere) = (CardSurvey::default(), 0_u64, BTreeMap::<u16, u64>::new());
    let channel = options.channel;
    for item in Items::new(format, &bytes) {
        survey.note(&item);
        let Item::Frame(frame) = item else { continue };
        without += u64::from(!one.note_frame(&frame));
        // Within half of the width, the channel may be one of several that the frame covers.
        let half_hz = 5e5 * f64::from(frame.width_mhz.max(20));
        let is_off = |mhz: &u16| (1e6 * f64::from(*mhz) - channel.centre_hz()).abs() > half_hz;
        if let Some(mhz) = frame.centre_mhz.filter(is_off) {
            *elsewhere.entry(mhz).or_default() += 1;
        }
    }
    let (frames, skipped) = (survey.frames, info::not_read(&survey.skipped));
    notes!("{}: {}, {frames} frames, {without} lack an antenna\n{skipped}", path.display(), format.name());
    for (mhz, count) in &elsewhere {
        note!(
            "  {count} of its frames are of {mhz} MHz, not of --channel {channel}: the bearing has a wrong wavelength"
        );
    }
    Ok(Some((one.bearings(trajectory), survey.is_damaged || !elsewhere.is_empty())))
}

/// The bearings from one log.
struct Alone {
    report: CaptureReport,
    lost: bool,
    /// Unused and lost records of a 5300's log.
    notes: Option<String>,
}

impl Alone {
    fn read(inputs: &Inputs, rx: &Path, trajectory: &Trajectory, (array, options): (&Array, &Options)) -> Words<Self> {
        if let Some((report, lost)) = other_card(rx, trajectory, array, options)? {
            return Ok(Self { report, lost, notes: None });
        }
        let mut log = inputs.open(rx)?;
        let report = one_log(&mut log, trajectory, array, options).in_words()?;
        let (survey, unused) = (&report.receiver.survey, report.receiver.unused);
        let losses = info::unusual_losses(survey, log.bytes());
        let contradiction = report.contradiction([trajectory], options);
        let has_notes = unused.no_antenna > 0 || !losses.is_empty() || contradiction.is_some();
        let notes = has_notes.then(|| {
            let (bfees, lacking) = (survey.bfees(), unused.no_antenna);
            let contradiction = contradiction.iter().map(|words| format!("  {words}\n")).collect::<String>();
            format!("{}: {bfees} bfee records, {lacking} lack an antenna\n{losses}{contradiction}", rx.display())
        });
        Ok(Self { lost: survey.lost_something() || contradiction.is_some(), notes, report })
    }
}

/// The name of a link: that of the log, with the sender if there are several.
fn sender_name(inputs: &Inputs, rx: &Path, link: &LinkReport, links: usize) -> String {
    let own = link_name(inputs, rx);
    match link.mac {
        _ if links == 1 => own,
        Some(mac) => format!("{own}/{mac}"),
        None => format!("{own}/unknown"),
    }
}

/// The antennas, their baselines and, if given, the constants of their chains.
fn array(args: &Args) -> std::result::Result<Array, ArrayError> {
    let metres: Vec<Vector3<f64>> = args.logs.baseline.iter().map(|baseline| baseline.metres).collect();
    let array = Array::new(&args.estimation.antenna, &metres)?;
    let array = if args.mounting.antenna_offset.is_some() { array.on_trajectory() } else { array };
    let constants: Vec<ChainConstant> = args.logs.baseline.iter().filter_map(|baseline| baseline.constant).collect();
    array.with_constants(&constants)
}

/// Combines the bearings of two logs with those of the receiver's log alone.
fn join_one_log(args: &Args, inputs: &Inputs, (rx, path): (&Path, &Path), report: &mut CaptureReport) -> Words<()> {
    if is_read_once(rx) {
        usage("--baseline with --tx reads the log twice: --rx cannot be standard input or a pipe");
    }
    let array = array(args).unwrap_or_else(|error| usage(&format!("--antennas, --baseline: {error}")));
    let mut options = options(args).unwrap_or_else(|message| usage(&message));
    // All senders: pairing by clocks has identified the transmitters.
    options.tx_macs.clear();
    let trajectory = inputs.trajectory(path).and_then(|recorded| args.mounting.of_antenna(recorded))?;
    let Alone { report: one, .. } = Alone::read(inputs, rx, &trajectory, (&array, &options))?;
    for link in &mut report.links {
        let heard = one.links.iter().find(|heard| heard.mac.is_some() && heard.mac == link.mac);
        let Some(heard) = heard.map(|heard| &heard.bearing) else { continue };
        match (&link.bearing, heard) {
            (Ok(two), Ok(heard)) => link.bearing = Ok(two.with_one_log(heard)),
            (Err(why), Ok(heard)) => {
                note!("the two logs give no bearing ({why}): this one is from {} alone", rx.display());
                link.bearing = Ok(heard.clone());
            }
            (_, Err(why)) => note!("{} alone gives no bearing: {why}", rx.display()),
        }
    }
    Ok(())
}

/// Estimates and prints the bearings.
fn run_one_log(args: &Args) -> Result {
    let array = array(args).unwrap_or_else(|error| usage(&format!("--antennas, --baseline: {error}")));
    let options = options(args).unwrap_or_else(|message| usage(&message));
    let (Some(rx), Some(path)) = (&args.logs.rx, &args.logs.trajectory) else {
        usage("--rx and --trajectory are needed");
    };
    let inputs = Inputs::files(args.logs.columns.clone());
    let trajectory = inputs.trajectory(path).and_then(|recorded| args.mounting.of_antenna(recorded))?;
    args.estimation.say_heading(path, &trajectory, true);
    let Alone { report, mut lost, notes } = Alone::read(&inputs, rx, &trajectory, (&array, &options))?;
    let mut answered = 0;
    for link in &report.links {
        let name = sender_name(&inputs, rx, link, report.links.len());
        let answer = answer(args, &name, link);
        answered += usize::from(answer.azimuth_deg.is_some());
        if args.json {
            print_json(&answer);
        } else {
            // With known constants, the robot may stand still.
            let stands = args.logs.baseline.iter().any(|baseline| baseline.constant.is_some());
            let of = if stands { MirrorOf::Antennas } else { MirrorOf::Turn };
            print(&describe(&answer, of, report.links.len(), "", &records(&answer)));
        }
        if let Some(error) = &answer.error {
            wrong!("{}: {error}", answer.link);
        }
        artefacts(args, &name, link, report.links.len())?;
    }
    if report.links.is_empty() {
        wrong!(
            "{}: no record has the CSI of all named antennas (--antennas); `csi5300 info` shows how many antennas there are, and with --plot whether one is silent",
            rx.display()
        );
    }
    if !args.json {
        explain_lines(report.links.len());
    }
    if let Some(notes) = notes {
        notes!("{notes}");
    }
    lost |= answered < report.links.len();
    Ok(Outcome::of(answered > 0, lost))
}

/// Gives each file its role, as if `--rx`, `--tx` and `--trajectory` had named it. It leaves folders of captures with the usual file names, and links
/// of them, alone.
fn take_roles(args: &mut Args) -> Words<()> {
    let files = match args.captures.as_slice() {
        [] => return Ok(()),
        [folder] if folder.is_dir() => match loose_files(folder) {
            Some(files) => files,
            None => return refuse_named(args),
        },
        named if named.iter().all(|path| path.is_file()) => named.to_vec(),
        named => {
            if let Some(path) = named.iter().find(|path| is_read_once(path)) {
                let which = "name each file by --rx, --tx and --trajectory";
                usage(&format!("{} can be read only once, too late to recognise its content: {which}", path.display()));
            }
            let missing = named.iter().find(|path| !path.exists() && path.extension().is_some());
            return match missing.filter(|_| named.iter().any(|path| path.is_file())) {
                Some(path) => Err(format!("{}: no such file", path.display())),
                None => refuse_named(args),
            };
        }
    };
    let is_named_one_by_one = args.captures.iter().all(|path| path.is_file());
    if !is_named_one_by_one && (args.logs.rx.is_some() || !args.logs.tx.is_empty()) {
        usage("name the logs one by one, or their folder without --rx and --tx");
    }
    // A shell expands `--tx csi_tx*.dat` to one name behind the option and others that stand alone.
    let files: Vec<PathBuf> = args.logs.tx.drain(..).chain(files).collect();
    refuse_twice(files.iter());
    let Sorted { mut logs, trajectories, others } = Sorted::new(files, args.logs.columns.as_ref());
    let (cards, others): (Vec<PathBuf>, Vec<PathBuf>) = others.into_iter().partition(|file| is_log(file));
    if !args.logs.baseline.is_empty() && (logs.is_empty() || is_named_one_by_one) {
        logs.extend(cards);
    } else if let (Some(file), true) = (cards.first(), is_named_one_by_one) {
        let needed = "one robot with two antennas gives bearings (--antennas, --baseline)";
        return Err(format!("{} is a log of another card: of these, {needed}", file.display()));
    }
    // What `*` brings along of a folder is read with the logs.
    let is_beside = |file: &PathBuf| file.ends_with(TRUTH_FILE) || logs.iter().any(|log| side_path(log) == *file);
    if let (Some(file), true) = (others.iter().find(|file| !is_beside(file)), is_named_one_by_one) {
        must_not_be_empty(file)?;
        let why = csv::read(file, args.logs.columns.as_ref()).err();
        let why = why.map_or_else(|| file.display().to_string(), |error| trajectory_refused(file, &error));
        return Err(format!("neither a log of CSI nor a trajectory: {why}"));
    }
    let trajectory = args.logs.trajectory.take().map_or_else(|| the_trajectory(&trajectories), Ok)?;
    let rx = match args.logs.rx.take() {
        Some(rx) => rx,
        None => receiver(&logs, &trajectory, args.logs.baseline.is_empty())?,
    };
    args.logs.tx = logs.iter().filter(|log| **log != rx).cloned().collect();
    note!("{} is the receiver's log, {} its trajectory", rx.display(), trajectory.display());
    if args.channel.is_none() {
        let folder = rx.parent().unwrap_or(Path::new(""));
        let Some(channel) = channel_in(folder).in_words()? else {
            usage(
                "--channel is needed, such as --channel 108: no groundtruth_positions.json beside these logs names it",
            );
        };
        args.channel = Some(channel);
        note!("channel {channel}, by {}", folder.join(TRUTH_FILE).display());
    }
    (args.logs.rx, args.logs.trajectory) = (Some(rx), Some(trajectory));
    args.captures.clear();
    Ok(())
}

/// Refuses options of single logs for a capture, which brings its own files.
fn refuse_named(args: &Args) -> Words<()> {
    let logs = &args.logs;
    let given = [
        ("--rx", logs.rx.is_some()),
        ("--tx", !logs.tx.is_empty()),
        ("--tx-trajectory", !logs.tx_trajectory.is_empty()),
        ("--tx-mac", !logs.tx_mac.is_empty()),
        ("--rx-mac", logs.rx_mac.is_some()),
        ("--key", logs.key.is_some()),
        ("--bag", logs.bag.bag.is_some()),
        ("--columns", logs.columns.is_some()),
        ("--baseline", !logs.baseline.is_empty()),
        ("--profile", args.profile.is_some()),
    ];
    if let Some((name, _)) = given.iter().find(|(_, given)| *given) {
        usage(&format!("{name} applies to single logs: name the files of the capture instead of its folder"));
    }
    Ok(())
}

/// The grid named by `--grid`.
fn grid(text: &str) -> Words<Grid> {
    const LIMIT: usize = 10_000_000;
    let wrong = || format!("`{text}` is no grid: 360 (azimuths), 360x181 (azimuths x elevations) or wsr");
    let count = |text: &str| text.parse::<usize>().ok().filter(|n| (1..=LIMIT).contains(n)).ok_or_else(wrong);
    match text.split_once('x') {
        _ if text == "wsr" => Ok(Grid::wsr()),
        None => Ok(Grid::azimuth(count(text)?)),
        Some((azimuths, elevations)) => {
            let (azimuths, elevations) = (count(azimuths)?, count(elevations)?);
            let all = azimuths.checked_mul(elevations).filter(|all| *all <= LIMIT);
            all.map(|_| Grid::azimuth_elevation(azimuths, elevations))
                .ok_or_else(|| format!("{text}: over {LIMIT} directions"))
        }
    }
}

/// True for a file that [`write_profile`] can write.
fn is_profile(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "csv" || extension == "npz")
}

/// Writes a profile to a .csv (azimuth_deg, elevation_deg, value) or an .npz (arrays
/// `azimuth_deg`, `elevation_deg`, `value`, rows of elevations by columns of azimuths).
///
/// Values are `|f|^2 / (sum |z|)^2`, 0 to 1.
fn write_profile(path: &Path, profile: &Profile) -> std::io::Result<()> {
    let (rows, columns) = profile.grid.shape();
    let shape = [rows as u64, columns as u64];
    let angles = || (0..profile.values.len()).map(|index| profile.grid.at(index));
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("npz") => {
            let mut npz = Npz::create(path)?;
            npz.array("azimuth_deg", &shape, angles().map(|(azimuth, _)| azimuth.to_degrees()))?;
            npz.array("elevation_deg", &shape, angles().map(|(_, elevation)| elevation.to_degrees()))?;
            npz.array("value", &shape, profile.values.iter().copied())?;
            npz.finish()
        }
        _ => {
            let mut out = BufWriter::new(std::fs::File::create(path)?);
            writeln!(out, "azimuth_deg,elevation_deg,value")?;
            for ((azimuth, elevation), value) in angles().zip(&profile.values) {
                writeln!(out, "{:.6},{:.6},{value:.9e}", azimuth.to_degrees(), elevation.to_degrees())?;
            }
            out.flush()
        }
    }
}
