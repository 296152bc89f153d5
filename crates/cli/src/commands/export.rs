//! `csi5300 export`.

mod recover;

use super::draft::Draft;
use super::{InWords, Outcome, Result, Words, info, print_json, usage};
use csi5300::source::survey::Survey;
use csi5300::time::Instant;
use csi5300_lab::export::{CardFrames, Export, KNOWN, is_known};
use csi5300_lab::table::{Filter, Form, Reading};
use driver_iface::Mac;
use std::fmt::Display;
use std::path::{Path, PathBuf};

// Arguments of `export`.
#[derive(clap::Args)]
pub struct Args {
    /// The log; - is standard input
    file: PathBuf,
    /// Output: .csv (a row for each record), .npz, .mat, .parquet (feature `parquet`); with --dat a log
    output: PathBuf,
    /// Write a log of all intact records
    #[arg(long, conflicts_with_all = ["scaled", "remove_spatial_mapping", "mac", "from", "to", "antennas"])]
    dat: bool,
    /// With --dat: convert records to this layout, for csiread and csitool
    #[arg(long, value_enum, value_name = "LAYOUT", requires = "dat")]
    layout: Option<recover::Layout>,
    /// CSI in units of sqrt(SNR) instead of the card's integers
    #[arg(long)]
    scaled: bool,
    /// Undo the spatial mapping of frames with 2 or 3 streams
    #[arg(long)]
    remove_spatial_mapping: bool,
    /// Only frames of this sender; repeat for several
    #[arg(long, value_name = "MAC")]
    mac: Vec<String>,
    /// Only records from this many seconds after the first one
    #[arg(long, value_name = "SECONDS")]
    from: Option<f64>,
    /// Only records before this many seconds after the first one
    #[arg(long, value_name = "SECONDS")]
    to: Option<f64>,
    /// Only records that used one of these antennas, and only their CSI: letters such as AC
    #[arg(long, value_name = "LETTERS")]
    antennas: Option<String>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
}

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    output: &'a Path,
    /// Records written.
    records: u64,
    /// Records outside the request.
    left_out: u64,
    /// Records written without a scale.
    without_scale: u64,
    /// Records written in the order of chains, as their antennas are not known.
    without_antennas: u64,
    /// Records and stretches of the log that were damaged.
    damaged: u64,
}

impl Args {
    fn filter(&self) -> Words<Filter> {
        let mut filter = Filter::default().with_time(self.from, self.to)?;
        if !self.mac.is_empty() {
            filter = filter.with_macs(&self.mac)?;
        }
        match &self.antennas {
            Some(letters) => filter.with_antennas(letters),
            None => Ok(filter),
        }
    }

    /// Why the output was not written.
    fn failed(&self, error: &dyn Display) -> String {
        format!("cannot write {}: {error}", self.output.display())
    }

    fn form(&self) -> Form {
        Form { scaled: self.scaled, without_spatial_mapping: self.remove_spatial_mapping }
    }
}

/// Writes the CSI of a log.
pub fn run(args: &Args) -> Result {
    if args.dat {
        if is_known(&args.output) {
            usage(&format!("{}: --dat writes a log, not a table: drop --dat, or name a .dat", args.output.display()));
        }
        return recover::run(args);
    }
    let extension = args.output.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    if !is_known(&args.output) {
        let hint = match extension.as_deref() {
            Some("parquet") => "; .parquet needs a program built with the feature: --features parquet",
            Some("dat") => "; --dat writes a log",
            _ => "",
        };
        usage(&format!("{}: CSI is exported as {KNOWN}{hint}", args.output.display()));
    }
    let filter = args.filter().unwrap_or_else(|error| usage(&error));
    if let Some((format, bytes)) = csi5300_lab::cards::read(&args.file) {
        return other_card(args, format, &bytes);
    }
    let draft = Draft::create(&args.output, args.force)?;
    let (row, survey, bytes) = write(args, draft.path(), filter)?;
    let Row { records, without_antennas, without_scale, .. } = row;
    if records > 0 {
        draft.keep(false).map_err(|error| args.failed(&error))?;
    }
    if args.json {
        print_json(&row);
    }
    notes!("{}", info::losses(&survey, bytes));
    if without_antennas > 0 {
        let some = super::some(without_antennas, "record", "records");
        note!("  {some} without a valid antenna_sel in chain order (antennas_known 0)");
    }
    if without_scale > 0 {
        note!("  {without_scale} of {records} records have no scale (RSSI or CSI all 0): NaN there");
    }
    if records < survey.bfees() {
        note!("  {} records were skipped by --mac, --from, --to or --antennas", survey.bfees() - records);
    }
    if records == 0 {
        note!("nothing to write: no {}", args.output.display());
    } else {
        note!("{} written to {}", super::some(records, "record", "records"), args.output.display());
    }
    Ok(Outcome::of(records > 0, survey.lost_something()))
}

/// Writes all subcarriers of another card's log.
fn other_card(args: &Args, format: csi_formats::Format, bytes: &[u8]) -> Result {
    let kind = format.name();
    if args.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("parquet")) {
        usage(&format!("{}: CSI of a {kind} log is exported as .npz, .mat or .csv", args.output.display()));
    }
    let given = [
        ("--scaled", args.scaled),
        ("--remove-spatial-mapping", args.remove_spatial_mapping),
        ("--antennas", args.antennas.is_some()),
    ];
    if let Some((name, _)) = given.iter().find(|(_, given)| *given) {
        usage(&format!("{name} is for logs of the Intel 5300; {} is a {kind} log", args.file.display()));
    }
    let timed = args.from.is_some() || args.to.is_some();
    let (from_s, to_s) = (args.from.unwrap_or(f64::NEG_INFINITY), args.to.unwrap_or(f64::INFINITY));
    // The filter has refused invalid addresses.
    let macs: Vec<Mac> = args.mac.iter().filter_map(|text| text.parse().ok()).collect();
    let is_sender = |mac: Option<[u8; 6]>| macs.is_empty() || mac.is_some_and(|mac| macs.contains(&Mac(mac)));
    let read = CardFrames::read(format, bytes, |frame, time_s| {
        is_sender(frame.sender) && (!timed || (from_s..to_s).contains(&time_s))
    });
    let draft = Draft::create(&args.output, args.force)?;
    let records = read.frames.len() as u64;
    if records > 0 {
        read.write(draft.path()).map_err(|error| args.failed(&error))?;
        draft.keep(false).map_err(|error| args.failed(&error))?;
    }
    let left_out = read.left_out + read.other_shapes;
    if args.json {
        let (output, damaged) = (args.output.as_path(), read.damaged);
        print_json(&Row { output, records, left_out, without_scale: 0, without_antennas: 0, damaged });
    }
    notes!("{}", info::not_read(&read.skipped));
    if read.other_shapes > 0 {
        let [n_rx, n_tx, n] = read.shape();
        note!(
            "  {} of other widths or chains skipped: most have {n_rx} x {n_tx} chains and {n} subcarriers",
            super::some(read.other_shapes, "frame", "frames")
        );
    }
    if read.left_out > 0 {
        note!("  {} skipped by --mac, --from or --to", super::some(read.left_out, "frame", "frames"));
    }
    if records == 0 {
        note!("nothing to write: no {}", args.output.display());
        return Ok(Outcome::Nothing);
    }
    note!("{} of {kind} written to {}", super::some(records, "frame", "frames"), args.output.display());
    Ok(if read.damaged + read.other_shapes > 0 { Outcome::DataLost } else { Outcome::Done })
}

/// Writes the records of the log. A file is read twice, first for all but its CSI: that costs less than memory for all of it. What can
/// be read only once is kept in memory, packed. Also returns what was found in the log, and its bytes.
fn write<'a>(args: &'a Args, output: &Path, filter: Filter) -> Words<(Row<'a>, Survey, u64)> {
    let is_file = args.file.is_file();
    let source = super::open_log(&args.file)?;
    let antennas = filter.antennas.clone();
    let mut reading = Reading::new(source, filter);
    if is_file {
        reading = reading.without_bodies();
    }
    reading.read_all(Instant::ZERO, || true).in_words()?;
    let (arena, columns) = reading.take();
    let (records, bytes) = (columns.len() as u64, reading.source.bytes());
    let mut export = match is_file {
        true => Export::of_log(&args.file, &columns, args.form()),
        false => Export::new(&arena, (0..arena.len()).collect(), &columns, args.form()),
    };
    if let Some(antennas) = antennas {
        export.antennas = antennas;
    }
    let mut without_scale = 0;
    if records > 0 {
        without_scale = export.write(output).map_err(|error| args.failed(&error))?;
    }
    let survey = reading.table.survey;
    let row = Row {
        output: &args.output,
        records,
        left_out: survey.bfees().saturating_sub(records),
        without_scale,
        without_antennas: export.without_antennas(),
        damaged: survey.damages + survey.bad_bfee,
    };
    Ok((row, survey, bytes))
}
