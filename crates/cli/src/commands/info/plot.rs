//! `csi5300 plot`.

use super::args::{antenna, mac};
use super::pictures::{self, Drawing};
use super::{Outcome, Result, hint, usage};
use csi5300_lab::course::{Course, Wanted};
use csi5300_lab::show::log::LogPictures;
use csi5300_lab::show::{Format, file_safe};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use std::path::{Path, PathBuf};

// Arguments of `plot`.
#[derive(clap::Args)]
#[command(
    after_help = "NAME-csi: amplitude and phase of each antenna over time and subcarrier, as heat maps. NAME-levels: \
                        amplitude, RSSI and gain over time, and the rate, with gaps, losses and steps back of the card's \
                        clock marked. Times are of the card's clock, from the first record on: what `info` counts.\n\
                        Where that clock stands they are the host's, and where there are none the records' numbers.\n\
                        Examples:\n  csi5300 plot rx.dat --antenna A --from 2 --to 8 --out pictures\n  \
                        csi5300 plot rx.dat --format pdf --size 900x700"
)]
pub struct Args {
    /// Logs
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Folder for the pictures
    #[arg(long, visible_alias = "plot", default_value = ".", value_name = "DIR")]
    out: PathBuf,
    /// Only frames of these senders
    #[arg(long, value_delimiter = ',', value_parser = mac, value_name = "MAC,..")]
    mac: Vec<Mac>,
    /// Only these antennas (RF ports): A,B,C
    #[arg(long, value_delimiter = ',', value_parser = antenna, value_name = "A,..")]
    antenna: Vec<Antenna>,
    /// From this time on, seconds after the first record
    #[arg(long, value_name = "SECONDS")]
    from: Option<f64>,
    /// Up to this time, seconds after the first record
    #[arg(long, value_name = "SECONDS")]
    to: Option<f64>,
    /// Size of the drawing, pixels at 96 to the inch; higher where its panels and rows need more
    #[arg(long, default_value = "1200x1100", value_parser = size, value_name = "WIDTHxHEIGHT")]
    size: (f64, f64),
    #[command(flatten)]
    drawing: Drawing,
    /// JSON Lines: one object a log, with the names of its pictures
    #[arg(long)]
    json: bool,
    /// Overwrite pictures of the same names
    #[arg(long)]
    force: bool,
}

/// A line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    log: &'a Path,
    pictures: &'a [PathBuf],
}

fn size(text: &str) -> std::result::Result<(f64, f64), String> {
    let parts = text.split_once('x').and_then(|(w, h)| Some((w.parse::<f64>().ok()?, h.parse::<f64>().ok()?)));
    let good = |side: f64| (400.0..=10_000.0).contains(&side);
    parts
        .filter(|(w, h)| good(*w) && good(*h))
        .ok_or_else(|| "WIDTHxHEIGHT, each 400 to 10000, such as 1600x1000".into())
}

/// Draws logs.
pub fn run(args: &Args) -> Result {
    let format = args.drawing.format(args.force);
    let wanted =
        Wanted::default().with_macs(args.mac.clone()).with_antennas(args.antenna.clone()).with_cut(args.from, args.to);
    let (mut drawn, mut failed, mut lost) = (0, 0, false);
    for (k, log) in args.logs.iter().enumerate() {
        super::progress(&format!("{} of {} logs", k + 1, args.logs.len()));
        match draw(args, log, &stem(args, k), &wanted, &format) {
            Ok((written, loss)) => {
                super::progress("");
                drawn += 1;
                lost |= loss;
                if args.json {
                    super::print_json(&Row { log, pictures: &written });
                } else {
                    written.iter().for_each(|path| note!("{}", path.display()));
                }
            }
            Err(message) => {
                super::progress("");
                failed += 1;
                wrong!("{message}");
            }
        }
    }
    Ok(match (drawn, failed) {
        (0, _) => Outcome::Nothing,
        (_, 0) if !lost => Outcome::Done,
        _ => Outcome::DataLost,
    })
}

/// What a log's pictures are called: its name, with a number where another log has the same.
fn stem(args: &Args, k: usize) -> PathBuf {
    let name = |log: &PathBuf| log.file_stem().map_or("log".into(), |stem| stem.to_string_lossy().into_owned());
    let own = name(&args.logs[k]);
    let same = args.logs.iter().filter(|log| name(log) == own).count() > 1;
    args.out.join(file_safe(&if same { format!("{own}.{}", k + 1) } else { own }))
}

/// Draws a log; gives the pictures, and whether the log lost records before its end.
fn draw(
    args: &Args,
    log: &Path,
    stem: &Path,
    wanted: &Wanted,
    format: &Format,
) -> std::result::Result<(Vec<PathBuf>, bool), String> {
    format.check(&LogPictures::stems(stem)).map_err(|error| pictures::refused(&error))?;
    if log.as_os_str() == "-" {
        usage("a log is read twice for its pictures, and standard input only once: name a file");
    }
    super::files::must_be_log(log)?;
    let course = Course::read(log, wanted).map_err(|error| hint::log_refused(&error))?;
    if course.records == 0 {
        return Err(format!("{}: no record that is wanted: `csi5300 info` says what is in it", log.display()));
    }
    let title = log.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let drawn = LogPictures { title: &title, course: &course, size: args.size };
    let written = drawn.write(stem, format).map_err(|error| pictures::refused(&error))?;
    if course.lost_something {
        note!("{}: records were lost before its end: `csi5300 info` says where", log.display());
    }
    Ok((written, course.lost_something))
}
