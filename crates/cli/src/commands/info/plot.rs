//! `csi5300 info --plot`: a log over time as pictures.

use super::super::Words;
use super::super::args::{antenna, mac};
use super::super::{draft, files, hint, usage};
use csi5300_lab::cards;
use csi5300_lab::course::{Course, Wanted};
use csi5300_lab::show::file_safe;
use csi5300_lab::show::log::LogPictures;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use std::path::{Path, PathBuf};

/// Size of the drawing, pixels; higher where its panels and rows need more.
const SIZE: (f64, f64) = (1200.0, 1100.0);

// What is drawn of logs.
#[derive(clap::Args)]
#[group(id = "drawn")]
#[command(next_help_heading = "Pictures")]
pub struct Args {
    /// Draw each log into this folder: NAME-csi (CSI of the sender with the most records, by antenna) and NAME-levels
    /// (amplitude, RSSI, gain, rate, gaps, losses, steps back of the clock). Times are the card's, the host's if that
    /// clock stands still, or record numbers
    #[arg(long, visible_alias = "out", value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Draw only frames of these senders
    #[arg(long, value_delimiter = ',', value_parser = mac, value_name = "MAC,..", requires = "plot")]
    mac: Vec<Mac>,
    /// Draw only these antennas (RF ports): A,B,C
    #[arg(long, value_delimiter = ',', value_parser = antenna, value_name = "A,..", requires = "plot")]
    antenna: Vec<Antenna>,
    /// Draw from this time, seconds after the first record
    #[arg(long, value_name = "SECONDS", requires = "plot")]
    from: Option<f64>,
    /// Draw up to this time, seconds after the first record
    #[arg(long, value_name = "SECONDS", requires = "plot")]
    to: Option<f64>,
}

/// What a log's pictures are called: its name, with a number where another log has the same.
fn stem(folder: &Path, logs: &[PathBuf], k: usize) -> PathBuf {
    let name = |log: &PathBuf| log.file_stem().map_or("log".into(), |stem| stem.to_string_lossy().into_owned());
    let own = logs.get(k).map(name).unwrap_or_default();
    let same = logs.iter().filter(|log| name(log) == own).count() > 1;
    folder.join(file_safe(&if same { format!("{own}.{}", k + 1) } else { own }))
}

/// Draws the `k`th log, if requested; returns the pictures.
pub fn draw(args: &Args, logs: &[PathBuf], k: usize) -> Words<Vec<PathBuf>> {
    let (Some(folder), Some(log)) = (&args.plot, logs.get(k)) else { return Ok(Vec::new()) };
    let stem = stem(folder, logs, k);
    if log.as_os_str() == "-" {
        usage("a log is read again for its pictures, and standard input only once: name a file");
    }
    if !cards::is_log(log) {
        files::must_be_log(log)?;
    }
    let wanted =
        Wanted::default().with_macs(args.mac.clone()).with_antennas(args.antenna.clone()).with_cut(args.from, args.to);
    let course = Course::read(log, &wanted).map_err(|error| hint::log_refused(&error))?;
    if course.records == 0 {
        return Err(format!("{}: no matching record to draw", log.display()));
    }
    if let Some(left_out) = course.left_out() {
        note!("{}: the heat maps are {left_out} (--mac chooses senders)", log.display());
    }
    let title = log.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let drawn = LogPictures { title: &title, course: &course, size: SIZE };
    drawn.write(&stem, &draft::read_files()).map_err(|error| error.to_string())
}
