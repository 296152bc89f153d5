//! `csi5300 mcap`.

use super::args::Estimation;
use super::files::{read_trajectory, told_apart};
use super::{InWords, Outcome, Result, Words, fixed, info, some, usage};
use csi5300::bartlett::{self, Grid};
use csi5300::internal::{FrameHeard, Front};
use csi5300::motion::odometry::csv::Columns;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Answer, Bearing, JoinBy, Options, Transmitter, bearings, lost_something};
use csi5300::signal::channel::Channel;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::{Instant, Unwrap32};
use csi5300_bag::mcap::McapWriter;
use csi5300_bag::messages::{
    Counters, CsiRow, Header, LaserScan, Message, Path as PathMessage, Pose as Placed, PoseStamped, Quaternion,
    TfMessage, Time, Transform, TransformStamped, Vector3,
};
use driver_iface::Mac;
use driver_iface::bfee::SUBCARRIERS;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

// Arguments of `mcap`.
#[derive(clap::Args)]
pub struct Args {
    /// Logs. With a trajectory, the first is the receiver's and each other one gives a bearing
    #[arg(required = true, value_name = "IN.dat")]
    logs: Vec<PathBuf>,
    /// The recording
    #[arg(long, short, value_name = "OUT.mcap")]
    out: PathBuf,
    /// Trajectory of the receiver (docs/reference/formats.md)
    #[arg(long, value_name = "T.csv")]
    trajectory: Option<PathBuf>,
    /// Columns of trajectories, instead of their headings: t,x,y,yaw (also ns, z, qx, qy, qz, qw; t_ms, x_mm, yaw_deg
    /// ..; _ skips a column)
    #[arg(long, value_name = "NAMES", allow_hyphen_values = true, requires = "trajectory")]
    columns: Option<Columns>,
    /// WiFi channel, with + or - for 40 MHz; needed for bearings
    #[arg(long, value_name = "NUMBER", requires = "trajectory")]
    channel: Option<Channel>,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    estimation: Estimation,
}

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    output: &'a Path,
    logs: Vec<LogRow<'a>>,
    bearings: Vec<LinkRow>,
}

#[derive(serde::Serialize)]
struct LogRow<'a> {
    log: &'a Path,
    records: u64,
}

#[derive(serde::Serialize)]
struct LinkRow {
    link: String,
    azimuth_deg: Option<f64>,
    azimuth_sd_deg: Option<f64>,
    mirror_deg: Option<f64>,
    error: Option<String>,
}

/// Converts captures.
pub fn run(args: &Args) -> Result {
    args.check();
    let draft = super::draft::Draft::create(&args.out, args.force)?;
    let failed = |error: io::Error| failed(args, &error);
    // As parts of topics.
    let stem = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let names = told_apart(args.logs.iter().map(stem).collect());
    let trajectory = args.trajectory.as_deref().map(|path| read_trajectory(path, args.columns.as_ref())).transpose()?;
    // Options are checked before the file is created.
    let options =
        args.channel.map(|channel| args.estimation.options(channel).unwrap_or_else(|message| usage(&message)));
    let frame = trajectory.as_ref().map_or("odom", Trajectory::frame);
    let mut recording = Recording::create(draft.path(), frame).map_err(failed)?;
    let (mut written, mut lost) = (0, false);
    let mut row = Row { output: &args.out, logs: Vec::new(), bearings: Vec::new() };
    // The receiver's records and its poses have one clock.
    let offsets_s = std::iter::once(args.estimation.clock_offset.0).chain(std::iter::repeat(0.0));
    for ((name, path), offset_s) in names.iter().zip(&args.logs).zip(offsets_s) {
        let (survey, bytes, records) = convert(&mut recording, (name, path, offset_s), args)?;
        written += records;
        row.logs.push(LogRow { log: path, records });
        lost |= survey.lost_something();
        notes!("{}: {}\n{}", path.display(), some(records, "record", "records"), info::losses(&survey, bytes));
        if records < survey.bfees() {
            let lacking = some(survey.bfees() - records, "record lacks", "records lack");
            note!("  {lacking} antenna {}", args.estimation.antenna());
        }
    }
    if let Some(trajectory) = &trajectory {
        trajectory.poses().iter().try_for_each(|pose| recording.pose(pose)).map_err(failed)?;
        recording.path(trajectory.span_s().0, trajectory.poses()).map_err(failed)?;
        match &options {
            Some(options) => {
                let (bearings, has_doubts) = estimate(&mut recording, &names, trajectory, options, args)?;
                row.bearings = bearings;
                lost |= has_doubts;
            }
            None if args.logs.len() > 1 => note!("no bearings: they need --channel"),
            None => {}
        }
    }
    recording.finish().map_err(failed)?;
    let usable = written > 0 || row.bearings.iter().any(|link| link.azimuth_deg.is_some());
    if usable {
        draft.keep(false).map_err(failed)?;
    } else {
        note!("nothing to write: no {}", args.out.display());
    }
    if args.json {
        super::print_json(&row);
    }
    Ok(Outcome::of(usable, lost))
}

impl Args {
    /// Ends the program if options would be ignored.
    fn check(&self) {
        let Estimation { antenna, elevation_max, range_min, height, heading_sd, from, to, .. } = &self.estimation;
        if antenna.len() > 1 {
            usage("--antenna: the recording has the CSI of one antenna");
        }
        if self.channel.is_some() && self.logs.len() < 2 {
            usage("--channel is for bearings, which need a transmitter's log behind the receiver's");
        }
        let of_bearings = [elevation_max, range_min, height, heading_sd, from, to];
        if self.channel.is_none() && of_bearings.iter().any(|given| given.is_some()) {
            usage("options of bearings, such as --from, need --trajectory and --channel; all records are written");
        }
        let (offset_s, join) = self.estimation.clock_offset;
        if self.trajectory.is_none() && offset_s != 0.0 || self.channel.is_none() && join == JoinBy::Row {
            usage("--clock-offset needs --trajectory, and as `rows` --channel");
        }
    }
}

/// The recording could not be written.
fn failed(args: &Args, error: &io::Error) -> String {
    format!("cannot write {}: {error}", args.out.display())
}

/// Every record of a log, and how many were written. `offset_s` is added to host times; records without one get the card's, from
/// the log's beginning on.
fn convert(
    recording: &mut Recording,
    (name, path, offset_s): (&str, &Path, f64),
    args: &Args,
) -> Words<(Survey, u64, u64)> {
    let failed = |error: io::Error| failed(args, &error);
    let (mut records, mut end_s) = (0, 0.0);
    let mut log = super::open_log(path)?;
    let mut front = Front::new(args.estimation.antenna());
    let (mut clock, mut first_card_us) = (Unwrap32::default(), None);
    loop {
        let next = log.receive(Instant::ZERO).in_words()?;
        if let Some((sender, heard, _)) = front.note_any(&next) {
            // It wraps every 71.6 minutes.
            let card_us = clock.next(heard.timestamp_low);
            let since_us = card_us - *first_card_us.get_or_insert(card_us);
            end_s = heard.host_us.map_or(since_us as f64 * 1e-6, |us| us as f64 * 1e-6 + offset_s);
            recording.record(name, end_s, sender, &heard).map_err(failed)?;
            records += 1;
        }
        if matches!(next, Next::End(_)) {
            break;
        }
    }
    recording.counters(name, end_s, &front.log.survey).map_err(failed)?;
    Ok((front.log.survey, log.bytes(), records))
}

/// The bearings of the first log to the others, and whether something was lost or is doubtful, as of `bearing`.
fn estimate(
    recording: &mut Recording,
    names: &[String],
    trajectory: &Trajectory,
    options: &Options,
    args: &Args,
) -> Words<(Vec<LinkRow>, bool)> {
    let text = |error: csi5300::source::Error| super::hint::log_refused(&error);
    let Some((rx, others)) = args.logs.split_first() else { return Ok((Vec::new(), false)) };
    let mut receiver = super::open_log(rx)?;
    let mut logs = others.iter().map(|path| super::open_log(path)).collect::<std::result::Result<Vec<_>, _>>()?;
    let transmitters =
        logs.iter_mut().map(|log| Transmitter { log: log as &mut (dyn CsiSource + Send), trajectory: None }).collect();
    let report = bearings(&mut receiver, transmitters, trajectory, options).map_err(text)?;
    let mut rows = Vec::new();
    for (name, link) in names.iter().skip(1).zip(&report.links) {
        let Answer { azimuth_deg, azimuth_sd_deg, mirror_deg, error, .. } = Answer::new(name.clone(), link);
        match &link.bearing {
            Ok(bearing) => {
                recording.bearing(name, bearing).map_err(|error| failed(args, &error))?;
                let [azimuth, sd] = [bearing.answer.azimuth_rad, bearing.answer.azimuth_sd_rad].map(f64::to_degrees);
                let mirror = mirror_deg.map_or(String::new(), |deg| format!(", or its mirror {} deg", fixed(deg, 2)));
                note!("{name}: {} deg +- {}{mirror}", fixed(azimuth, 2), fixed(sd, 2));
            }
            Err(error) => wrong!("{name}: {error}"),
        }
        rows.push(LinkRow { link: name.clone(), azimuth_deg, azimuth_sd_deg, mirror_deg, error });
    }
    let contradiction = report.contradiction([trajectory], options);
    contradiction.iter().for_each(|words| note!("{}: {words}", rx.display()));
    report.clock_doubt().iter().for_each(|doubt| note!("{}: {doubt}", rx.display()));
    Ok((rows, contradiction.is_some() || lost_something(&report)))
}

/// Directions of a profile.
const DIRECTIONS: usize = 360;
/// The robot's frame.
const ROBOT: &str = "robot";

/// A recording being written.
pub struct Recording {
    file: McapWriter<BufWriter<File>>,
    /// The trajectory's frame.
    frame: &'static str,
}

impl Recording {
    /// Begins a file.
    pub fn create(path: &Path, frame: &'static str) -> io::Result<Self> {
        Ok(Self { file: McapWriter::new(BufWriter::new(File::create(path)?))?, frame })
    }

    /// Ends the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.file.finish()
    }

    fn put<T: Message>(&mut self, topic: &str, t_s: f64, message: &T) -> io::Result<()> {
        self.file.put((topic, T::TYPE, T::definition), us(t_s).unsigned_abs().saturating_mul(1_000), &message.payload())
    }

    /// A record of the log `log`, received at `t_s`, seconds since the Unix epoch.
    pub fn record(&mut self, log: &str, t_s: f64, sender: Mac, heard: &FrameHeard) -> io::Result<()> {
        let csi: [_; SUBCARRIERS] = heard.csi();
        let row = CsiRow {
            header: header(t_s, ""),
            sender: sender.to_string(),
            number: heard.number,
            card_us: heard.timestamp_low,
            magnitude: csi.iter().map(|h| h.norm()).collect(),
            phase: csi.iter().map(|h| h.arg()).collect(),
        };
        self.put(&format!("/csi/{log}"), t_s, &row)
    }

    /// Counts of a log until `t_s`.
    pub fn counters(&mut self, log: &str, t_s: f64, survey: &Survey) -> io::Result<()> {
        let counters = Counters {
            header: header(t_s, ""),
            records: survey.records,
            damages: survey.damages,
            damaged_bytes: survey.damaged_bytes,
            impossible_records: survey.bad_bfee,
            overruns: survey.overruns,
            bfee_missing: survey.bfee_missing,
        };
        self.put(&format!("/counters/{log}"), t_s, &counters)
    }

    /// Where the robot is.
    pub fn pose(&mut self, pose: &Pose) -> io::Result<()> {
        // A transform has an orientation, known or not.
        self.transform(ROBOT, pose, Quaternion::along(pose.heading_rad.unwrap_or(0.0), 0.0))?;
        self.put("/pose", pose.t_s, &self.placed(pose, turned(pose)))
    }

    fn transform(&mut self, child: &str, place: &Pose, rotation: Quaternion) -> io::Result<()> {
        let [x, y, z] = place.position_m.into();
        let transform = Transform { translation: Vector3 { x, y, z }, rotation };
        let told =
            TransformStamped { header: header(place.t_s, self.frame), child_frame_id: child.to_owned(), transform };
        self.put("/tf", place.t_s, &TfMessage { transforms: vec![told] })
    }

    fn placed(&self, pose: &Pose, orientation: Quaternion) -> PoseStamped {
        let position = <[f64; 3]>::from(pose.position_m).into();
        PoseStamped { header: header(pose.t_s, self.frame), pose: Placed { position, orientation } }
    }

    /// The robot's path, as known at `t_s`.
    pub fn path(&mut self, t_s: f64, poses: &[Pose]) -> io::Result<()> {
        let poses = poses.iter().map(|pose| self.placed(pose, turned(pose))).collect();
        self.put("/trajectory", t_s, &PathMessage { header: header(t_s, self.frame), poses })
    }

    /// A bearing, its mirror if it has one, and its profile.
    pub fn bearing(&mut self, link: &str, bearing: &Bearing) -> io::Result<()> {
        let (answer, t_s) = (&bearing.answer, bearing.samples.t_s().last().copied().unwrap_or(0.0));
        let from = Pose { t_s, position_m: bearing.mean_position_m, heading_rad: None };
        let towards = Quaternion::along(answer.azimuth_rad, answer.signed_elevation_rad.unwrap_or(0.0));
        let scan = profile(link, t_s, bearing).map_err(io::Error::other)?;
        self.put(&format!("/bearing/{link}"), t_s, &self.placed(&from, towards.clone()))?;
        if let Some(mirror_rad) = answer.mirror_rad {
            let mirror = self.placed(&from, Quaternion::along(mirror_rad, answer.mirror_elevation_rad.unwrap_or(0.0)));
            self.put(&format!("/mirror/{link}"), t_s, &mirror)?;
        }
        self.transform(&format!("bearing/{link}"), &from, towards)?;
        self.put(&format!("/aoa_profile/{link}"), t_s, &scan)
    }
}

/// A pose's heading; ROS's null quaternion if that is not known.
fn turned(pose: &Pose) -> Quaternion {
    pose.heading_rad.map_or_else(Quaternion::default, |heading_rad| Quaternion::along(heading_rad, 0.0))
}

/// The profile about the middle of the motion, from the bearing on.
fn profile(link: &str, t_s: f64, bearing: &Bearing) -> std::result::Result<LaserScan, bartlett::Error> {
    let (azimuth, elevation) = (bearing.answer.azimuth_rad, bearing.answer.elevation_rad());
    let step = std::f64::consts::TAU / DIRECTIONS as f64;
    let angles = (0..DIRECTIONS).map(|k| k as f64 * step - std::f64::consts::PI);
    let directions = angles.map(|angle| (csi5300::maths::wrap_rad(azimuth + angle), elevation)).collect();
    let profile = bartlett::profile(&bearing.samples, &Grid::directions(directions))?;
    let peak = profile.values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok(LaserScan {
        header: header(t_s, &format!("bearing/{link}")),
        angle_min: -std::f32::consts::PI,
        angle_max: (std::f64::consts::PI - step) as f32,
        angle_increment: step as f32,
        range_max: 1.0,
        ranges: profile.values.iter().map(|value| (value / peak) as f32).collect(),
        intensities: profile.values.iter().map(|value| *value as f32).collect(),
        ..LaserScan::default()
    })
}

fn us(t_s: f64) -> i64 {
    (t_s.max(0.0) * 1e6).round() as i64
}

fn header(t_s: f64, frame: &str) -> Header {
    Header { stamp: Time::from_us(us(t_s)), frame_id: frame.to_owned() }
}
