//! `csi5300 export`.

use super::npz::Npz;
use super::{Outcome, Result, info};
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::signal::csi::{Csi, scale_factor, total_rss_dbm};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use driver_iface::bfee::{Antenna, Bfee};
use num_complex::Complex32;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Arguments of `export`.
#[derive(clap::Args)]
pub struct Args {
    /// The log; - is standard input (CSV only)
    file: PathBuf,
    /// Where to write: .csv, one row a record, or .npz
    output: PathBuf,
    /// CSI in units of sqrt(SNR) instead of the card's integers
    #[arg(long)]
    scaled: bool,
    /// Undo the spatial mapping of frames with 2 or 3 streams
    #[arg(long)]
    remove_spatial_mapping: bool,
    /// Overwrite the output if it is there
    #[arg(long)]
    force: bool,
}

type Words<T> = std::result::Result<T, String>;

/// Writes the CSI of a log.
pub fn run(args: &Args) -> Result {
    if args.output.exists() && !args.force {
        return Err(format!("{} is there already: --force overwrites it", args.output.display()));
    }
    if super::is_same_file(&args.file, &args.output) {
        return Err(format!("{} is the input itself: name another file", args.output.display()));
    }
    let (survey, bytes) = match args.output.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => csv(args)?,
        Some("npz") => npz(args)?,
        _ => return Err(format!("{}: CSI is exported as .csv or .npz", args.output.display())),
    };
    eprint!("{}", info::losses(&survey, bytes));
    if survey.bad_permutations > 0 {
        eprintln!(
            "  {} records without a valid antenna_sel are in chain order (antennas_known 0)",
            survey.bad_permutations
        );
    }
    if survey.bfees() == 0 {
        super::remove_empty(&args.output);
    } else {
        eprintln!("{} records written to {}", survey.bfees(), args.output.display());
    }
    Ok(match (survey.bfees(), survey.lost_something()) {
        (0, _) => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        (_, false) => Outcome::Done,
    })
}

/// Reads a log once and hands over each intact bfee record.
fn scan(path: &Path, mut each: impl FnMut(&Bfee<'_>, Identity) -> Words<()>) -> Words<(Survey, u64)> {
    let mut source = Replay::open(path).map_err(|error| super::hint::log_refused(&error))?;
    let mut survey = Survey::default();
    loop {
        let next = source.receive(Instant::ZERO).map_err(|error| error.to_string())?;
        if let Some((bfee, identity)) = survey.note(&next) {
            each(&bfee, identity)?;
        }
        if matches!(next, Next::End(_)) {
            return Ok((survey, source.bytes()));
        }
    }
}

/// The CSI of a record as asked for, and whether its rows are antennas (rather than chains).
fn csi(bfee: &Bfee<'_>, args: &Args) -> (Csi, bool) {
    let (mut csi, known) = match Csi::from_bfee(bfee) {
        Ok(csi) => (csi, true),
        Err(_) => (Csi::raw(bfee), false),
    };
    if args.scaled {
        // A record without energy has no scale; it stays zero.
        csi = csi.scaled(bfee).unwrap_or(csi);
    }
    if args.remove_spatial_mapping {
        csi = csi.without_spatial_mapping(bfee.is_40_mhz());
    }
    (csi, known)
}

/// One sample by antenna A, B, C (chain 1, 2, 3 where the antennas are not known); `None` where there is none.
fn sample(csi: &Csi, known: bool, subcarrier: usize, port: usize, stream: usize) -> Option<Complex32> {
    let row = if known { csi.row(*Antenna::ALL.get(port)?)? } else { port };
    csi.get(subcarrier, row, stream)
}

/// The fields of a record beside its CSI, by column name.
const FIELDS: [&str; 17] = [
    "timestamp_low",
    "bfee_count",
    "host_us",
    "frame_count",
    "n_rx",
    "n_tx",
    "rssi_a",
    "rssi_b",
    "rssi_c",
    "noise_dbm",
    "agc",
    "antenna_sel",
    "rate_n_flags",
    "antennas_known",
    "total_rss_dbm",
    "scale",
    "record",
];

/// The value of a field; not a number where the record does not have it.
fn field(name: &str, index: u64, bfee: &Bfee<'_>, identity: Identity) -> f64 {
    let [a, b, c] = bfee.rssi();
    match name {
        "record" => index as f64,
        "timestamp_low" => f64::from(bfee.timestamp_low()),
        "bfee_count" => f64::from(bfee.bfee_count()),
        "host_us" => identity.host_us.map_or(f64::NAN, |us| us as f64),
        "frame_count" => identity.frame_count.map_or(f64::NAN, f64::from),
        "n_rx" => bfee.n_rx() as f64,
        "n_tx" => bfee.n_tx() as f64,
        "rssi_a" => f64::from(a),
        "rssi_b" => f64::from(b),
        "rssi_c" => f64::from(c),
        "noise_dbm" => f64::from(bfee.noise_dbm()),
        "agc" => f64::from(bfee.agc()),
        "antenna_sel" => f64::from(bfee.antenna_sel()),
        "rate_n_flags" => f64::from(bfee.rate_n_flags()),
        "antennas_known" => f64::from(u8::from(bfee.antennas().is_ok())),
        "total_rss_dbm" => total_rss_dbm(bfee).unwrap_or(f64::NAN),
        _ => scale_factor(bfee).unwrap_or(f64::NAN),
    }
}

/// The largest number of streams in a log; 3 for standard input, which can be read only once.
fn streams(path: &Path) -> Words<usize> {
    if path.as_os_str() == "-" {
        return Ok(3);
    }
    let (survey, _) = scan(path, |_, _| Ok(()))?;
    let used = |stream: &usize| survey.streams.iter().any(|row| row.get(stream - 1).is_some_and(|count| *count > 0));
    Ok((1..=3).rev().find(used).unwrap_or(1))
}

fn csv(args: &Args) -> Words<(Survey, u64)> {
    let streams = streams(&args.file)?;
    let failed = |error: std::io::Error| format!("writing {}: {error}", args.output.display());
    let mut out = BufWriter::with_capacity(1 << 18, std::fs::File::create(&args.output).map_err(failed)?);
    let mut header = FIELDS.join(",") + ",mac";
    let cells = || {
        let port = move |s| (0..3).flat_map(move |port| (0..streams).map(move |stream| (s, port, stream)));
        (0..SUBCARRIERS).flat_map(port)
    };
    for (s, port, stream) in cells() {
        let name = format!("{s}_{}_{}", ["a", "b", "c"][port], stream + 1);
        header += &format!(",re_{name},im_{name}");
    }
    writeln!(out, "{header}").map_err(failed)?;
    let mut index = 0;
    let done = scan(&args.file, |bfee, identity| {
        let mut line = String::with_capacity(2_048);
        for name in FIELDS {
            let value = field(name, index, bfee, identity);
            line += &if value.is_nan() { ",".into() } else { format!("{value},") };
        }
        line += &identity.mac.to_string();
        let (csi, known) = csi(bfee, args);
        for (s, port, stream) in cells() {
            line += &sample(&csi, known, s, port, stream).map_or(",,".into(), |h| format!(",{},{}", h.re, h.im));
        }
        index += 1;
        writeln!(out, "{line}").map_err(failed)
    })?;
    out.flush().map_err(failed)?;
    Ok(done)
}

/// Arrays go into an NPZ one after the other and whole, so the log is read once for each: time is cheap here, memory
/// stays small for a log of any size.
fn npz(args: &Args) -> Words<(Survey, u64)> {
    if args.file.as_os_str() == "-" {
        return Err("an .npz needs several passes, and standard input has one: export to .csv, or name a file".into());
    }
    let streams = streams(&args.file)?;
    let (survey, bytes) = scan(&args.file, |_, _| Ok(()))?;
    let n = survey.bfees();
    let mut npz = Npz::create(&args.output)?;
    npz.array_in("csi", &[n, SUBCARRIERS as u64, 3, streams as u64], |push| {
        let nothing = Complex32::new(f32::NAN, f32::NAN);
        scan(&args.file, |bfee, _| {
            let (csi, known) = csi(bfee, args);
            for s in 0..SUBCARRIERS {
                for (port, stream) in (0..3).flat_map(|port| (0..streams).map(move |stream| (port, stream))) {
                    push(sample(&csi, known, s, port, stream).unwrap_or(nothing))?;
                }
            }
            Ok(())
        })
        .map(|_| ())
    })?;
    for name in FIELDS {
        npz.array_in(name, &[n], |push| {
            let mut index = 0;
            let each = |bfee: &Bfee<'_>, identity: Identity| {
                index += 1;
                push(field(name, index - 1, bfee, identity))
            };
            scan(&args.file, each).map(|_| ())
        })?;
    }
    npz.array_in("mac", &[n, 6], |push| {
        scan(&args.file, |_, identity| identity.mac.0.iter().try_for_each(|byte| push(*byte))).map(|_| ())
    })?;
    npz.finish()?;
    Ok((survey, bytes))
}
