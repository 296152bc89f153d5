//! `csi5300 export`.

mod recover;

use super::draft::Draft;
use super::{InWords, Outcome, Result, Words, info, print_json, usage};
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::signal::csi::{Csi, scale_factor, total_rss_dbm};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_lab::export::{CardFrames, Export, KNOWN, is_known};
use csi5300_lab::table::{Advise, Filter, Form, Reading};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};
use num_complex::Complex32;
use std::fmt::Write as _;
use std::io::{BufWriter, Write};
use std::mem::MaybeUninit;
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
    fn filter(&self) -> std::result::Result<Filter, csi5300_lab::table::FilterError> {
        let mut filter = Filter::default().with_time(self.from, self.to)?;
        if !self.mac.is_empty() {
            filter = filter.with_macs(&self.mac)?;
        }
        match &self.antennas {
            Some(letters) => filter.with_antennas(letters),
            None => Ok(filter),
        }
    }

    fn form(&self) -> Form {
        Form { scaled: self.scaled, without_spatial_mapping: self.remove_spatial_mapping }
    }
}

/// Counts of records read and written.
struct Written {
    survey: Survey,
    /// Bytes of the log.
    bytes: u64,
    /// Records written.
    records: u64,
    /// Records without the requested scale.
    unscaled: u64,
    /// Records whose antennas are not known.
    without_antennas: u64,
}

/// Writes the CSI of a log.
pub fn run(args: &Args) -> Result {
    if args.dat {
        return recover::run(args);
    }
    let extension = args.output.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    let extension = extension.as_deref();
    if extension != Some("csv") && !is_known(&args.output) {
        let missing = extension == Some("parquet") && !cfg!(feature = "parquet");
        let hint = match extension {
            Some("parquet") if missing => "; .parquet needs a program built with the feature: --features parquet",
            Some("dat") => "; --dat writes a log",
            _ => "",
        };
        usage(&format!("{}: CSI is exported as .csv, {KNOWN}{hint}", args.output.display()));
    }
    let filter = args.filter().unwrap_or_else(|error| usage(&error.to_string()));
    if let Some((format, bytes)) = csi5300_lab::cards::read(&args.file) {
        return other_card(args, format, &bytes);
    }
    let draft = Draft::create(&args.output, args.force)?;
    let Written { survey, bytes, records, unscaled, without_antennas } = match extension {
        Some("csv") => csv(args, draft.path(), &filter)?,
        _ => table(args, draft.path(), filter)?,
    };
    if records > 0 {
        draft.keep(false).map_err(|error| format!("writing {}: {error}", args.output.display()))?;
    }
    if args.json {
        print_json(&Row {
            output: &args.output,
            records,
            left_out: survey.bfees().saturating_sub(records),
            without_scale: unscaled,
            without_antennas,
            damaged: survey.damages + survey.bad_bfee,
        });
    }
    notes!("{}", info::losses(&survey, bytes));
    if without_antennas > 0 {
        let some = super::some(without_antennas, "record", "records");
        note!("  {some} without a valid antenna_sel in chain order (antennas_known 0)");
    }
    if unscaled > 0 {
        note!("  {unscaled} of {records} records have no scale (RSSI or CSI all 0): NaN there");
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
        read.write(draft.path()).map_err(|error| error.of_file(&args.output).to_string())?;
        draft.keep(false).map_err(|error| format!("writing {}: {error}", args.output.display()))?;
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

/// Writes a table of the log. A file is read twice, first for all but its CSI: that costs less than memory for all of it. What can
/// be read only once is kept in memory, packed.
fn table(args: &Args, output: &Path, filter: Filter) -> Words<Written> {
    let size = args.file.metadata().ok().filter(|found| found.is_file()).map(|found| found.len());
    let source = super::open_log(&args.file)?;
    let antennas = filter.antennas().map(<[Antenna]>::to_vec);
    let mut reading = Reading::new(source, filter);
    let read = match size {
        Some(size) => {
            reading = reading.without_bodies();
            reading.read_sized(Instant::ZERO, size, &mut Large, || true)
        }
        None => reading.read_all(Instant::ZERO, || true),
    };
    read.in_words()?;
    let (arena, columns) = reading.take();
    let (records, bytes) = (columns.len() as u64, reading.source().bytes());
    let mut export = match size {
        Some(_) => Export::of_log(&args.file, &columns, args.form()),
        None => Export::new(&arena, (0..arena.len()).collect(), &columns, args.form()),
    };
    if let Some(antennas) = antennas {
        export = export.with_antennas(&antennas);
    }
    let mut unscaled = 0;
    if records > 0 {
        unscaled = export.write(output).map_err(|error| error.of_file(&args.output).to_string())?;
    }
    Ok(Written { survey: reading.survey, bytes, records, unscaled, without_antennas: export.without_antennas() })
}

/// Memory in large pages, where the operating system has them.
struct Large;

impl Advise for Large {
    fn advise<T>(&mut self, memory: &mut [MaybeUninit<T>]) {
        // Pages of the usual size do as well.
        let _ = csi5300_live::sys::advise_large_pages(memory);
    }
}

/// Reads a log once and hands over each intact bfee record that the filter keeps.
fn scan(
    path: &Path,
    filter: &Filter,
    mut each: impl FnMut(&Bfee<'_>, Identity, i64) -> Words<()>,
) -> Words<(Survey, u64)> {
    let mut source = super::open_log(path)?;
    let (mut survey, mut first_us) = (Survey::default(), None);
    loop {
        let next = source.receive(Instant::ZERO).in_words()?;
        if let Some((bfee, identity)) = survey.note(&next) {
            let time_us = survey.clock_us.map_or(0, |(_, last)| last);
            if filter.keeps(&bfee, identity, time_us - *first_us.get_or_insert(time_us)) {
                each(&bfee, identity, time_us)?;
            }
        }
        if matches!(next, Next::End(_)) {
            return Ok((survey, source.bytes()));
        }
    }
}

/// The requested CSI of a record, and whether its rows are antennas (rather than chains). A record without a scale
/// counts in `unscaled` and gives nothing.
fn csi(bfee: &Bfee<'_>, args: &Args, unscaled: &mut u64) -> Option<(Csi, bool)> {
    let (mut csi, known) = match Csi::from_bfee(bfee) {
        Ok(csi) => (csi, true),
        Err(_) => (Csi::raw(bfee), false),
    };
    if args.scaled {
        // RSSI are what the scale is made from.
        let Ok(scaled) = csi.scaled(bfee) else {
            *unscaled += 1;
            return None;
        };
        csi = scaled;
    }
    if args.remove_spatial_mapping {
        csi = csi.without_spatial_mapping(bfee.is_40_mhz());
    }
    Some((csi, known))
}

/// One sample by antenna A, B, C (chain 1, 2, 3 if the antennas are unknown); `None` if absent.
fn sample(csi: &Csi, known: bool, subcarrier: usize, port: usize, stream: usize) -> Option<Complex32> {
    let row = if known { csi.row(*Antenna::ALL.get(port)?)? } else { port };
    csi.get(subcarrier, row, stream)
}

/// The columns of a record beside its CSI.
const FIELDS: &str = "time_us,timestamp_low,bfee_count,host_us,frame_count,n_rx,n_tx,rssi_a,rssi_b,rssi_c,noise_dbm,agc,\
                      antenna_sel,rate_n_flags,antennas_known,total_rss_dbm,scale,record,mac";

/// Their values; empty where one is not known.
fn fields(record: u64, bfee: &Bfee<'_>, identity: Identity, time_us: i64) -> String {
    let [rssi_a, rssi_b, rssi_c] = bfee.rssi();
    let host_us = identity.host_us.map_or(String::new(), |us| us.to_string());
    let frame_count = identity.frame_count.map_or(String::new(), |count| count.to_string());
    let known = |value: Option<f64>| value.filter(|value| !value.is_nan()).map_or(String::new(), |v| v.to_string());
    let (total_rss_dbm, scale) = (known(total_rss_dbm(bfee).ok()), known(scale_factor(bfee).ok()));
    format!(
        "{time_us},{},{},{host_us},{frame_count},{},{},{rssi_a},{rssi_b},{rssi_c},{},{},{},{},{},{total_rss_dbm},{scale},{record},{}",
        bfee.timestamp_low(),
        bfee.bfee_count(),
        bfee.n_rx(),
        bfee.n_tx(),
        bfee.noise_dbm(),
        bfee.agc(),
        bfee.antenna_sel(),
        bfee.rate_n_flags(),
        u8::from(bfee.antennas().is_ok()),
        identity.mac
    )
}

/// The largest number of streams in a log; 3 for standard input and pipes, which can be read only once.
fn streams(path: &Path) -> Words<usize> {
    if path.as_os_str() == "-" || path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        return Ok(3);
    }
    let (survey, _) = scan(path, &Filter::default(), |_, _, _| Ok(()))?;
    let used = |stream: &usize| survey.streams.iter().any(|row| row.get(stream - 1).is_some_and(|count| *count > 0));
    Ok((1..=3).rev().find(used).unwrap_or(1))
}

fn csv(args: &Args, output: &Path, filter: &Filter) -> Words<Written> {
    let streams = streams(&args.file)?;
    let ports: Vec<usize> = filter.antennas().unwrap_or(&Antenna::ALL).iter().map(|antenna| antenna.index()).collect();
    let failed = |error: std::io::Error| format!("writing {}: {error}", args.output.display());
    let mut out = BufWriter::with_capacity(1 << 18, std::fs::File::create(output).map_err(failed)?);
    let mut header = FIELDS.to_owned();
    let cells = || {
        let port = |s| ports.iter().flat_map(move |&port| (0..streams).map(move |stream| (s, port, stream)));
        (0..SUBCARRIERS).flat_map(port)
    };
    for (s, port, stream) in cells() {
        let name = format!("{s}_{}_{}", ["a", "b", "c"].get(port).unwrap_or(&"?"), stream + 1);
        header += &format!(",re_{name},im_{name}");
    }
    writeln!(out, "{header}").map_err(failed)?;
    let (mut records, mut unscaled, mut without_antennas) = (0, 0, 0);
    let (survey, bytes) = scan(&args.file, filter, |bfee, identity, time_us| {
        let mut line = fields(records, bfee, identity, time_us);
        let csi = csi(bfee, args, &mut unscaled);
        without_antennas += u64::from(bfee.antennas().is_err());
        for (s, port, stream) in cells() {
            let sample = csi.as_ref().and_then(|(csi, known)| sample(csi, *known, s, port, stream));
            // Writing to a string never fails.
            let _ = match sample {
                Some(h) => write!(line, ",{},{}", h.re, h.im),
                None => line.write_str(",,"),
            };
        }
        records += 1;
        writeln!(out, "{line}").map_err(failed)
    })?;
    out.flush().map_err(failed)?;
    Ok(Written { survey, bytes, records, unscaled, without_antennas })
}
