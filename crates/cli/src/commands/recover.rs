//! `csi5300 recover`.

use super::{Outcome, Result};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Next, side_path};
use csi5300::time::Instant;
use driver_iface::bfee::{Bfee, Iq, Repr};
use driver_iface::record::{Record, code};
use driver_iface::side_file::{self, Width};
use driver_iface::{Mac, mpdu};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Arguments of `recover`.
#[derive(clap::Args)]
pub struct Args {
    /// The damaged log; - is standard input
    input: PathBuf,
    /// Where the intact records go
    output: PathBuf,
    /// Also bring records into this layout, which other tools (csiread, csitool) read
    #[arg(long, value_enum, value_name = "LAYOUT")]
    layout: Option<Layout>,
    /// One JSON object about what was written and what was lost
    #[arg(long)]
    json: bool,
    /// Overwrite the output if it is there
    #[arg(long)]
    force: bool,
}

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    output: &'a Path,
    /// Records written.
    records: u64,
    /// Records that were framed but hold something impossible.
    bad_bfee: u64,
    /// Stretches of bytes that are no record, and the bytes in them.
    damages: u64,
    damaged_bytes: u64,
}

/// A layout to bring records into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Layout {
    /// The original CSI tool's: sender and number of a WSR record go into a copy of its frame before it, host times into
    /// a side file (OUTPUTstp, 8 bytes a record)
    Stock,
}

type Words<T> = std::result::Result<T, String>;

/// A file that is made anew.
fn create(path: &Path, force: bool) -> Words<BufWriter<File>> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true);
    // Truncating the input while it is being read would lose it.
    if force {
        options.truncate(true)
    } else {
        options.create_new(true)
    };
    let output = path.display();
    let file = options.open(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => format!("{output} is there already: --force overwrites it"),
        _ => format!("cannot write {output}: {error}"),
    })?;
    Ok(BufWriter::with_capacity(256 * 1024, file))
}

/// What is being written.
struct Output {
    data: BufWriter<File>,
    /// With host times, in the stock layout.
    side: Option<BufWriter<File>>,
    name: String,
    /// Records of the input that are in it.
    kept: u64,
    frame: Vec<u8>,
}

impl Output {
    fn write(&mut self, record: Record<'_>, host_us: Option<i64>) -> Words<()> {
        self.frame.resize(record.emit_len(), 0);
        record.emit(&mut self.frame).map_err(|error| error.to_string())?;
        let name = &self.name;
        let failed = |error: std::io::Error| format!("writing {name}: {error}");
        self.data.write_all(&self.frame).map_err(failed)?;
        if let Some(side) = &mut self.side {
            let mut entry = [0; Width::Narrow.bytes()];
            // A time that does not fit stays zeros: not known.
            let _ = side_file::emit(host_us, Width::Narrow, &mut entry);
            side.write_all(&entry).map_err(failed)?;
        }
        Ok(())
    }

    /// A record of the WSR layout as the stock driver would have written it: its frame, then its CSI.
    fn write_stock(&mut self, bfee: &Bfee<'_>, identity: Identity) -> Words<()> {
        if let Some(number) = identity.frame_count {
            let frame = sounding_frame(identity.mac, number)?;
            self.write(Record { code: code::MPDU, body: &frame }, identity.host_us)?;
        }
        let repr = Repr { wsr: None, ..Repr::parse(bfee) };
        let rows = (0..bfee.n_rx()).flat_map(|rx| (0..bfee.n_tx()).map(move |tx| (rx, tx)));
        let all =
            (0..csi5300::signal::channel::SUBCARRIERS).flat_map(|k| rows.clone().map(move |(rx, tx)| (k, rx, tx)));
        let csi: Vec<Iq> = all.filter_map(|(k, rx, tx)| bfee.iq(k, rx, tx)).collect();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi, &mut body).map_err(|error| error.to_string())?;
        self.write(Record { code: code::BFEE, body: &body }, identity.host_us)
    }

    fn flush(&mut self) -> Words<()> {
        let side = self.side.as_mut().map_or(Ok(()), Write::flush);
        self.data.flush().and(side).map_err(|error| format!("writing {}: {error}", self.name))
    }
}

/// A frame as the CSI tool logs it: sender in address 3, number in the payload.
fn sounding_frame(mac: Mac, number: u32) -> Words<Vec<u8>> {
    let payload = number.to_be_bytes();
    let repr = mpdu::Repr {
        // A data frame.
        frame_control: 0x0008,
        duration_us: 0,
        seq_ctrl: 0,
        addr1: Mac([0xff; 6]),
        addr2: mac,
        addr3: mac,
        payload: &payload,
    };
    let mut frame = vec![0; repr.emit_len()];
    repr.emit(&mut frame).map_err(|error| error.to_string())?;
    Ok(frame)
}

/// Copies the intact records of a log.
pub fn run(args: &Args) -> Result {
    let output = args.output.display().to_string();
    if super::is_same_file(&args.input, &args.output) {
        return Err(format!("{output} is the input itself: name another file"));
    }
    let mut source = super::open_log(&args.input)?;
    let stock = args.layout == Some(Layout::Stock);
    let data = create(&args.output, args.force)?;
    let side = stock.then(|| create(&side_path(&args.output), args.force)).transpose()?;
    let mut out = Output { data, side, name: output.clone(), kept: 0, frame: Vec::new() };
    let mut survey = Survey::default();
    loop {
        let next = source.receive(Instant::ZERO).map_err(|error| error.to_string())?;
        let noted = survey.note(&next);
        match (next, noted) {
            (Next::Record(..), Some((bfee, identity))) if stock && bfee.wsr().is_some() => {
                out.write_stock(&bfee, identity)?;
            }
            (Next::Record(_, record), None) if record.code == code::BFEE => continue,
            (Next::Record(stamps, record), noted) => {
                let host_us = noted.and_then(|(_, identity)| identity.host_us).or(stamps.host_us);
                out.write(record, host_us)?;
            }
            (Next::End(_), _) => break,
            (Next::Lost(_) | Next::Pending, _) => continue,
        }
        out.kept += 1;
    }
    out.flush()?;
    if args.json {
        let Survey { bad_bfee, damages, damaged_bytes, .. } = survey;
        super::print_json(&Row { output: &args.output, records: out.kept, bad_bfee, damages, damaged_bytes });
    }
    notes!("{}", super::info::losses(&survey, source.bytes()));
    if out.kept == 0 {
        super::remove_empty(&args.output);
        if stock {
            super::remove_empty(&side_path(&args.output));
        }
    } else {
        note!("{} written to {output}", super::some(out.kept, "intact record", "intact records"));
    }
    Ok(match (out.kept, survey.lost_something()) {
        (0, _) => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        (_, false) => Outcome::Done,
    })
}
