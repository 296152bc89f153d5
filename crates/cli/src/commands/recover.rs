//! `csi5300 recover`.

use super::{Outcome, Result};
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use driver_iface::bfee::Bfee;
use driver_iface::record::code;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

/// Arguments of `recover`.
#[derive(clap::Args)]
pub struct Args {
    /// The damaged log; - is standard input
    input: PathBuf,
    /// Where the intact records go
    output: PathBuf,
    /// Overwrite the output if it is there
    #[arg(long)]
    force: bool,
}

/// Copies the intact records of a log.
pub fn run(args: &Args) -> Result {
    let mut source = Replay::open(&args.input).map_err(|error| super::hint::log_refused(&error))?;
    let output = args.output.display();
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true);
    // Truncating the input while it is being read would lose it.
    if args.force {
        options.truncate(true)
    } else {
        options.create_new(true)
    };
    if super::is_same_file(&args.input, &args.output) {
        return Err(format!("{output} is the input itself: name another file"));
    }
    let file = options.open(&args.output).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => format!("{output} is there already: --force overwrites it"),
        _ => format!("cannot write {output}: {error}"),
    })?;
    let mut writer = BufWriter::with_capacity(256 * 1024, file);
    let mut survey = Survey::default();
    let (mut kept, mut frame) = (0u64, Vec::new());
    loop {
        let next = source.receive(Instant::ZERO).map_err(|error| error.to_string())?;
        survey.note(&next);
        match next {
            Next::Record(_, record) => {
                if record.code == code::BFEE && Bfee::new_checked(record.body).is_err() {
                    continue;
                }
                frame.resize(record.emit_len(), 0);
                record.emit(&mut frame).map_err(|error| error.to_string())?;
                writer.write_all(&frame).map_err(|error| format!("writing {output}: {error}"))?;
                kept += 1;
            }
            Next::End(_) => break,
            Next::Lost(_) | Next::Pending => {}
        }
    }
    writer.flush().map_err(|error| format!("writing {output}: {error}"))?;
    eprint!("{}", super::info::losses(&survey, source.bytes()));
    if kept == 0 {
        super::remove_empty(&args.output);
    } else {
        eprintln!("{kept} intact records written to {output}");
    }
    Ok(match (kept, survey.lost_something()) {
        (0, _) => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        (_, false) => Outcome::Done,
    })
}
