//! `csi5300 mcap`.

mod recording;

use super::Words;
use super::args::{Estimation, channel, columns};
use super::files::read_trajectory_as;
use super::{Outcome, Result, fixed, info, usage};
use csi5300::internal::Front;
use csi5300::motion::odometry::csv::Columns;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::Channel;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::{Instant, Unwrap32};
use recording::Recording;
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
    #[arg(long, value_parser = columns, value_name = "NAMES", requires = "trajectory")]
    columns: Option<Columns>,
    /// WiFi channel, with + or - for 40 MHz; needed for bearings
    #[arg(long, value_parser = channel, value_name = "NUMBER")]
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
    error: Option<String>,
}

/// Converts captures.
pub fn run(args: &Args) -> Result {
    let draft = super::draft::Draft::create(&args.out, args.force)?;
    let names = names(&args.logs);
    let trajectory =
        args.trajectory.as_deref().map(|path| read_trajectory_as(path, args.columns.as_ref())).transpose()?;
    // Options are checked before the file is created.
    let options = args.channel.filter(|_| trajectory.is_some());
    let options = options.map(|channel| args.estimation.options(channel).unwrap_or_else(|message| usage(&message)));
    let mut recording = Recording::create(draft.path()).map_err(|error| draft.words(&error.to_string()))?;
    let (mut usable, mut lost) = (0, false);
    let mut row = Row { output: &args.out, logs: Vec::new(), bearings: Vec::new() };
    for (name, path) in names.iter().zip(&args.logs) {
        let (survey, bytes) = convert(&mut recording, name, path, args)?;
        usable += survey.bfees();
        row.logs.push(LogRow { log: path, records: survey.bfees() });
        lost |= survey.lost_something();
        notes!("{}: {} bfee records\n{}", path.display(), survey.bfees(), info::losses(&survey, bytes));
    }
    if let Some(trajectory) = &trajectory {
        trajectory
            .poses()
            .iter()
            .try_for_each(|pose| recording.pose(pose))
            .map_err(|error| draft.words(&error.to_string()))?;
        recording.path(trajectory.span_s().0, trajectory.poses()).map_err(|error| draft.words(&error.to_string()))?;
        match &options {
            Some(options) => row.bearings = estimate(&mut recording, &names, trajectory, options, args)?,
            None => note!("no bearings: they need --channel"),
        }
    }
    recording.finish().map_err(|error| draft.words(&error.to_string()))?;
    draft.keep(false).map_err(|error| format!("writing {}: {error}", args.out.display()))?;
    lost |= row.bearings.iter().any(|link| link.error.is_some());
    if args.json {
        super::print_json(&row);
    }
    Ok(match usable {
        0 => Outcome::Nothing,
        _ if lost => Outcome::DataLost,
        _ => Outcome::Done,
    })
}

/// Every record of a log. Those without a host time get the card's, from the log's beginning on.
fn convert(recording: &mut Recording, name: &str, path: &Path, args: &Args) -> Words<(Survey, u64)> {
    let mut log = super::open_log(path)?;
    let mut front = Front::new(args.estimation.antenna());
    let (mut clock, mut first_card_us) = (Unwrap32::default(), None);
    loop {
        let next = log.receive(Instant::ZERO).map_err(|error| error.to_string())?;
        if let Some((sender, heard)) = front.note(&next) {
            // It wraps every 71.6 minutes.
            let card_us = clock.next(heard.timestamp_low);
            let since_us = card_us - *first_card_us.get_or_insert(card_us);
            let t_s = heard.host_us.unwrap_or(since_us) as f64 * 1e-6;
            recording.record(name, t_s, sender, &heard).map_err(|error| error.to_string())?;
        }
        if matches!(next, Next::End(_)) {
            break;
        }
    }
    let end_s = front.log.survey.host_us.map_or(0.0, |(_, last)| last as f64 * 1e-6);
    recording.counters(name, end_s, &front.log.survey).map_err(|error| error.to_string())?;
    Ok((front.log.survey, log.bytes()))
}

/// The bearings of the first log to the others.
fn estimate(
    recording: &mut Recording,
    names: &[String],
    trajectory: &Trajectory,
    options: &Options,
    args: &Args,
) -> Words<Vec<LinkRow>> {
    let text = |error: csi5300::source::Error| super::hint::log_refused(&error);
    let Some((receiver, others)) = args.logs.split_first().filter(|(_, others)| !others.is_empty()) else {
        return Ok(Vec::new());
    };
    let mut receiver = super::open_log(receiver)?;
    let mut logs = others.iter().map(|path| super::open_log(path)).collect::<std::result::Result<Vec<_>, _>>()?;
    let transmitters =
        logs.iter_mut().map(|log| Transmitter { log: log as &mut (dyn CsiSource + Send), trajectory: None }).collect();
    let report = bearings(&mut receiver, transmitters, trajectory, options).map_err(text)?;
    let mut rows = Vec::new();
    for (name, link) in names.iter().skip(1).zip(&report.links) {
        match &link.bearing {
            Ok(bearing) => {
                recording.bearing(name, bearing)?;
                let azimuth_deg = bearing.answer.azimuth_rad.to_degrees();
                note!("{name}: {} deg", fixed(azimuth_deg, 2));
                rows.push(LinkRow { link: name.clone(), azimuth_deg: Some(azimuth_deg), error: None });
            }
            Err(error) => {
                wrong!("{name}: {error}");
                rows.push(LinkRow { link: name.clone(), azimuth_deg: None, error: Some(error.to_string()) });
            }
        }
    }
    Ok(rows)
}

/// Names of the logs as parts of topics: their stems, numbered where two are the same.
fn names(logs: &[PathBuf]) -> Vec<String> {
    let stems: Vec<String> =
        logs.iter().map(|path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned()).collect();
    let again = |k: usize| stems.iter().filter(|other| **other == stems[k]).count() > 1;
    (0..stems.len()).map(|k| if again(k) { format!("{}.{}", stems[k], k + 1) } else { stems[k].clone() }).collect()
}
