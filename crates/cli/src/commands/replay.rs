//! `csi5300 replay`.

use super::live::{Signals, duration, speed};
use super::{InWords, Outcome, Result};
use csi5300::source::replay::Paced;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Span;
use csi5300_live::netlink::Sender;
use csi5300_live::wait::{Monotonic, Output};
use driver_iface::connector::CN_IDX;
use driver_iface::record::{Record, Tail};
use std::io::{ErrorKind, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// The driver's connector index, as an argument is.
const CN_IDX_TEXT: &str = "26";
const _: () = assert!(CN_IDX == 26);

// Arguments of `replay`.
#[derive(clap::Args)]
pub struct Args {
    /// The log; - is standard input
    file: PathBuf,
    /// Speed relative to the recording; `max` does not wait
    #[arg(long, default_value = "1", value_parser = speed)]
    speed: f64,
    /// Shorten longer pauses to this
    #[arg(long, value_parser = duration, value_name = "TIME")]
    longest_pause: Option<Span>,
    /// Multicast to the driver's connector group (or to INDEX) as the driver would, instead of writing to standard
    /// output
    #[arg(
        long,
        value_name = "INDEX",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = CN_IDX_TEXT,
        value_parser = clap::value_parser!(u32).range(1..=32)
    )]
    connector: Option<u32>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long, requires = "connector")]
    json: bool,
}

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    log: &'a Path,
    /// Records sent, and how long that took, seconds.
    records: u64,
    seconds: f64,
    /// Damage that was not played.
    bad_bfee: u64,
    damages: u64,
    damaged_bytes: u64,
    /// Whether the last record is cut.
    cut: bool,
}

/// Bytes that are written to standard output at once, and records between two looks at signals.
const PART: usize = 1 << 16;
const BURST: u64 = 256;

enum Target {
    Connector(Sender),
    /// And what waits for it.
    Stdout(Output, Vec<u8>),
}

impl Target {
    fn send(&mut self, record: Record<'_>) -> std::result::Result<(), Error> {
        match self {
            Self::Connector(sender) => sender.send(record),
            Self::Stdout(_, waiting) => {
                let from = waiting.len();
                waiting.resize(from + record.emit_len(), 0);
                let frame = waiting.get_mut(from..).unwrap_or_default();
                record.emit(frame).map_err(|error| Error::Backend(Box::new(error)))?;
                if waiting.len() >= PART { self.flush() } else { Ok(()) }
            }
        }
    }

    fn flush(&mut self) -> std::result::Result<(), Error> {
        let Self::Stdout(out, waiting) = self else { return Ok(()) };
        out.write_all(waiting).map_err(of_stdout)?;
        waiting.clear();
        Ok(())
    }
}

fn of_stdout(source: std::io::Error) -> Error {
    Error::Io { what: "standard output".into(), source }
}

/// The outcome where a target takes no more. A closed reader (`| head`) ends the command quietly.
fn refused(error: &Error, sent: u64) -> Outcome {
    if matches!(error, Error::Io { source, .. } if source.kind() == ErrorKind::BrokenPipe) {
        return Outcome::Done;
    }
    wrong!("after {sent} records: {error}");
    Outcome::DataLost
}

/// Plays a log.
pub fn run(args: &Args) -> Result {
    let signals = Signals::catch().in_words()?;
    let log = super::open_log(&args.file)?;
    let mut target = match args.connector {
        Some(index) => Target::Connector(Sender::open(index, true).in_words()?),
        None => Target::Stdout(Output::new(&signals).map_err(of_stdout).in_words()?, Vec::new()),
    };
    let mut source = Paced::new(log, args.speed, args.longest_pause);
    let (clock, mut survey) = (Monotonic::new(), Survey::default());
    let begun = clock.now();
    loop {
        let next = source.receive(clock.now()).in_words()?;
        if let Next::Record(_, record) = next
            && let Err(error) = target.send(record)
        {
            return Ok(refused(&error, survey.came()));
        }
        survey.note(&next);
        let until = match next {
            Next::Record(..) if survey.came() % BURST == 0 => clock.now(),
            Next::Record(..) | Next::Lost(_) => continue,
            Next::End(_) => break,
            Next::Pending => {
                if let Err(error) = target.flush() {
                    return Ok(refused(&error, survey.came()));
                }
                source.next_at().unwrap_or_else(|| clock.now())
            }
        };
        if clock.wait([signals.as_fd()], Some(until)).in_words()?[0] {
            break;
        }
    }
    let sent = survey.came();
    if let Err(error) = target.flush() {
        return Ok(refused(&error, sent));
    }
    if args.json {
        let Survey { bad_bfee, damages, damaged_bytes, .. } = survey;
        let cut = survey.tail.is_some_and(|tail| !matches!(tail, Tail::Clean));
        let (log, seconds) = (args.file.as_path(), (clock.now() - begun).as_s());
        super::print_json(&Row { log, records: sent, seconds, bad_bfee, damages, damaged_bytes, cut });
    }
    notes!("{}", super::info::losses(&survey, source.source().bytes()));
    note!("{} played", super::some(sent, "record", "records"));
    Ok(Outcome::of(sent > 0, survey.lost_something()))
}
