//! `csi5300 export`.

use super::npz::Npz;
use super::{Outcome, Result, info, usage};
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
    let extension = args.output.extension().and_then(|extension| extension.to_str());
    if !matches!(extension, Some("csv" | "npz")) {
        usage(&format!("{}: CSI is exported as .csv or .npz", args.output.display()));
    }
    super::must_not_exist(&args.output, args.force)?;
    if super::is_same_file(&args.file, &args.output) {
        return Err(format!("{} is the input itself: name another file", args.output.display()));
    }
    let mut unscaled = 0;
    let (survey, bytes) = match extension {
        Some("csv") => csv(args, &mut unscaled)?,
        _ => npz(args, &mut unscaled)?,
    };
    eprint!("{}", info::losses(&survey, bytes));
    if survey.bad_permutations > 0 {
        eprintln!(
            "  {} records without a valid antenna_sel are in chain order (antennas_known 0)",
            survey.bad_permutations
        );
    }
    if unscaled > 0 {
        let of = survey.bfees();
        eprintln!("  {unscaled} of {of} records have no scale (RSSI or CSI all 0): not a number there");
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

/// The CSI of a record as asked for, and whether its rows are antennas (rather than chains); counts in `unscaled` a record
/// that has no scale, and gives nothing for it.
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

/// A value as an array of its field holds it. Integers that a record does not have are -1.
#[derive(Clone, Copy, Debug)]
enum Value {
    U8(u8),
    I8(i8),
    U16(u16),
    U32(u32),
    I64(Option<i64>),
    F64(f64),
}

impl std::fmt::Display for Value {
    /// As a cell of CSV: nothing where there is no value.
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::U8(value) => value.fmt(out),
            Self::I8(value) => value.fmt(out),
            Self::U16(value) => value.fmt(out),
            Self::U32(value) => value.fmt(out),
            Self::I64(value) => value.map_or(Ok(()), |value| value.fmt(out)),
            Self::F64(value) if value.is_nan() => Ok(()),
            Self::F64(value) => value.fmt(out),
        }
    }
}

/// The value of a field.
fn field(name: &str, index: u64, bfee: &Bfee<'_>, identity: Identity) -> Value {
    let [a, b, c] = bfee.rssi();
    match name {
        "record" => Value::I64(i64::try_from(index).ok()),
        "timestamp_low" => Value::U32(bfee.timestamp_low()),
        "bfee_count" => Value::U16(bfee.bfee_count()),
        "host_us" => Value::I64(identity.host_us),
        "frame_count" => Value::I64(identity.frame_count.map(i64::from)),
        "n_rx" => Value::U8(bfee.n_rx() as u8),
        "n_tx" => Value::U8(bfee.n_tx() as u8),
        "rssi_a" => Value::U8(a),
        "rssi_b" => Value::U8(b),
        "rssi_c" => Value::U8(c),
        "noise_dbm" => Value::I8(bfee.noise_dbm()),
        "agc" => Value::U8(bfee.agc()),
        "antenna_sel" => Value::U8(bfee.antenna_sel()),
        "rate_n_flags" => Value::U16(bfee.rate_n_flags()),
        "antennas_known" => Value::U8(u8::from(bfee.antennas().is_ok())),
        "total_rss_dbm" => Value::F64(total_rss_dbm(bfee).unwrap_or(f64::NAN)),
        _ => Value::F64(scale_factor(bfee).unwrap_or(f64::NAN)),
    }
}

/// One field of all records as an array of its own kind.
fn field_array(npz: &mut Npz, name: &str, n: u64, path: &Path) -> Words<()> {
    // One kind a field: what the first match says of a field holds for all its records.
    macro_rules! array {
        ($kind:pat => $value:expr) => {
            npz.array_in(name, &[n], |push| {
                let mut index = 0;
                let each = |bfee: &Bfee<'_>, identity: Identity| {
                    index += 1;
                    match field(name, index - 1, bfee, identity) {
                        $kind => push($value),
                        other => Err(format!("{name}: {other:?} is of another kind than the field")),
                    }
                };
                scan(path, each).map(|_| ())
            })
        };
    }
    match name {
        "record" | "host_us" | "frame_count" => array!(Value::I64(value) => value.unwrap_or(-1)),
        "timestamp_low" => array!(Value::U32(value) => value),
        "bfee_count" | "rate_n_flags" => array!(Value::U16(value) => value),
        "noise_dbm" => array!(Value::I8(value) => value),
        "total_rss_dbm" | "scale" => array!(Value::F64(value) => value),
        _ => array!(Value::U8(value) => value),
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

fn csv(args: &Args, unscaled: &mut u64) -> Words<(Survey, u64)> {
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
            line += &format!("{},", field(name, index, bfee, identity));
        }
        line += &identity.mac.to_string();
        let csi = csi(bfee, args, unscaled);
        for (s, port, stream) in cells() {
            let sample = csi.as_ref().and_then(|(csi, known)| sample(csi, *known, s, port, stream));
            line += &sample.map_or(",,".into(), |h| format!(",{},{}", h.re, h.im));
        }
        index += 1;
        writeln!(out, "{line}").map_err(failed)
    })?;
    out.flush().map_err(failed)?;
    Ok(done)
}

/// Arrays go into an NPZ one after the other and whole, so the log is read once for each: time is cheap here, memory
/// stays small for a log of any size.
fn npz(args: &Args, unscaled: &mut u64) -> Words<(Survey, u64)> {
    if args.file.as_os_str() == "-" {
        usage("an .npz needs several passes, and standard input has one: export to .csv, or name a file");
    }
    let streams = streams(&args.file)?;
    let (survey, bytes) = scan(&args.file, |_, _| Ok(()))?;
    let n = survey.bfees();
    let mut npz = Npz::create(&args.output)?;
    npz.array_in("csi", &[n, SUBCARRIERS as u64, 3, streams as u64], |push| {
        let nothing = Complex32::new(f32::NAN, f32::NAN);
        scan(&args.file, |bfee, _| {
            let csi = csi(bfee, args, unscaled);
            for s in 0..SUBCARRIERS {
                for (port, stream) in (0..3).flat_map(|port| (0..streams).map(move |stream| (port, stream))) {
                    let sample = csi.as_ref().and_then(|(csi, known)| sample(csi, *known, s, port, stream));
                    push(sample.unwrap_or(nothing))?;
                }
            }
            Ok(())
        })
        .map(|_| ())
    })?;
    for name in FIELDS {
        field_array(&mut npz, name, n, &args.file)?;
    }
    npz.array_in("mac", &[n, 6], |push| {
        scan(&args.file, |_, identity| identity.mac.0.iter().try_for_each(|byte| push(*byte))).map(|_| ())
    })?;
    npz.finish()?;
    Ok((survey, bytes))
}
