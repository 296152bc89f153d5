//! `csi5300 record`.

use super::live::{
    Listening, Needs, Signals, create_refused, duration, rotation_size, size, some_duration,
    summary as listener_summary,
};
use super::{InWords, Outcome, Result, Words, say};
use csi5300::source::recorder::{LogFiles, Options, Pipe, Recorder, Rotation, Totals};
use csi5300::source::{CsiSource, Error, Loss, Next, side_path};
use csi5300::time::{Instant, Span};
use csi5300_live::feitcsi::{Command, FeitCsi, Frames};
use csi5300_live::status::{Losses, Status};
use csi5300_live::wait::{Monotonic, Output, wall_us};
use driver_iface::side_file::Layout;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};

/// How often the live view is drawn.
const LOOK: Span = Span::from_ms(500);
/// Pause before the next read of the socket, so that one wake-up serves several records. Host times come from the
/// card's clock ([`csi5300::time::HostTimes`]), not from the time of reading.
const REST: Span = Span::from_ms(8);
/// No pause after more records than this at once.
const FEW: u32 = 32;
/// No pause with a smaller receive buffer than this, bytes: the kernel's queue could overflow.
const ROOMY: usize = 1 << 20;
/// Records between two looks at signals and the view when the source never pauses.
const BURST: u32 = 256;

// Arguments of `record`.
#[derive(clap::Args)]
pub struct Args {
    /// The log; its side file with host times is OUT.datstp
    #[arg(value_name = "OUT.dat")]
    out: PathBuf,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
    /// Write checksums of all records into the side file, which commands then check. csiread cannot read such side
    /// files
    #[arg(long)]
    checksums: bool,
    /// Write the log to disk this often, against power cuts; 0s leaves it to the system
    #[arg(long, value_parser = duration, default_value = "1s", value_name = "TIME")]
    sync_every: Span,
    /// Continue in a new file (OUT-0001.dat ...) before this size: 500k, 100M, 2G
    #[arg(long, value_parser = rotation_size, value_name = "SIZE")]
    rotate_size: Option<u64>,
    /// Continue in a new file after this time: 30s, 10m, 1h
    #[arg(long, value_parser = some_duration, value_name = "TIME")]
    rotate_every: Option<Span>,
    /// Stop after this time (30s, 10m, 1h), or after so many records (500records)
    #[arg(long, value_parser = limit, value_name = "TIME")]
    stop_after: Option<Limit>,
    /// Also write the records to standard output, for another program
    #[arg(long)]
    live: bool,
    /// Show a page of live figures instead of one line
    #[arg(long)]
    watch: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long, conflicts_with = "live")]
    json: bool,
    /// Receive buffer to ask the kernel for
    #[arg(long, value_parser = size, default_value = "32M", value_name = "SIZE", conflicts_with_all = ["feitcsi", "room"])]
    receive_buffer: u64,
    /// Record an AX200 or AX210 by FeitCSI: the address of its UDP socket and its options, such as "127.0.0.1:8008 --frequency
    /// 5180 --channel-width 80 --format VHT", or - if it writes to the standard input. OUT is then a log of FeitCSI
    #[arg(long, value_name = "ADDRESS OPTIONS", value_parser = feitcsi_source, conflicts_with_all = ["live", "checksums", "connector_index", "allow_user_sender", "room"])]
    #[arg(conflicts_with = "stock")]
    feitcsi: Option<Way>,
    #[command(flatten)]
    listening: Listening,
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Limit {
    After(Span),
    Records(u64),
}

fn limit(text: &str) -> Words<Limit> {
    match text.strip_suffix("records") {
        Some(count) => match count.trim_end().parse() {
            Ok(count) if count > 0 => Ok(Limit::Records(count)),
            _ => Err("a number of records above 0, such as 500records".into()),
        },
        None => duration(text).map(Limit::After),
    }
}

impl Args {
    fn options(&self) -> Options {
        let mut options = Options::default();
        options.sync_every = (self.sync_every > Span::default()).then_some(self.sync_every);
        options
    }

    /// What helps where nothing came. The doctor listens to no room, and not to FeitCSI.
    fn if_nothing(&self) -> &'static str {
        match (&self.feitcsi, &self.listening.room) {
            (_, Some(_)) => ": nobody sounded in the room meanwhile",
            (Some(_), _) => ": `csi5300 doctor` reports what may be wrong",
            (None, None) => ": `csi5300 doctor --listen 10s` reports what may be wrong",
        }
    }

    fn rotation(&self) -> Rotation {
        Rotation { bytes: self.rotate_size, every: self.rotate_every }
    }
}

/// When and how to stop and show.
struct Session<'a> {
    args: &'a Args,
    clock: Monotonic,
    socket: OwnedFd,
    signals: Signals,
    status: Status,
    view: View,
    /// Whether a pause after records is safe and wanted.
    rests: bool,
}

/// Where the live view goes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum View {
    None,
    Line,
    Page,
}

/// Records until a signal or a limit ends it.
pub fn run(args: &Args) -> Result {
    // Signals first: one that comes during the opening must not leave half a start behind.
    let signals = Signals::catch().in_words()?;
    if let Some(from) = &args.feitcsi {
        return run_feitcsi(args, from, signals);
    }
    let listener = args.listening.open(Needs { receive_buffer: Some(args.receive_buffer), ..Needs::default() })?;
    let files = LogFiles::create(&args.out, args.rotation(), args.force).map_err(|error| create_refused(&error))?;
    let files = files.with_side_layout(if args.checksums { Layout::Checked } else { Layout::Narrow });
    let rests = !args.live && listener.buffer() >= ROOMY;
    let mut session = Session::new(args, signals, &listener, rests)?;
    let clock = session.clock;
    note!("{}; recording to {}", listener.describe(), args.out.display());
    let recorder = Recorder::new(listener, files, args.options()).in_words()?;
    let (failed, recorder) = if args.live {
        let pipe = Pipe::new(Output::new(&session.signals).map_err(|error| format!("standard output: {error}"))?);
        let mut options = Options::default();
        (options.sync_every, options.hand_over) = (None, Span::from_ms(10));
        let mut tee = Recorder::new(recorder, pipe, options).in_words()?;
        let failed = session.capture(&mut tee, |tee| (tee.source().totals(), tee.source().source().lost())).err();
        let (recorder, _, piped) = tee.finish(clock.now()).in_words()?;
        let missed = piped.received - piped.written;
        if missed > 0 {
            note!("standard output missed {missed} records; the log has them");
        }
        (failed, recorder)
    } else {
        let mut recorder = recorder;
        (session.capture(&mut recorder, |own| (own.totals(), own.source().lost())).err(), recorder)
    };
    let (listener, files, totals) = recorder.finish(clock.now()).in_words()?;
    let told = (listener_summary(&listener), listener.lost());
    Ok(session.end(failed, &told, &totals, &files))
}

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row {
    files: Vec<PathBuf>,
    /// Records in them.
    records: u64,
    /// From the first record to the last, seconds.
    seconds: f64,
    /// Messages that the kernel dropped, records that the driver did, and those that the disk did not take.
    lost_kernel: u64,
    lost_driver: u64,
    lost_disk: u64,
    /// Records by sender.
    senders: std::collections::BTreeMap<String, u64>,
}

impl Row {
    fn new(status: &Status, totals: &Totals, lost: Losses, files: &LogFiles) -> Self {
        let senders = status.survey.senders.iter().map(|(mac, sender)| (mac.to_string(), sender.records));
        Self {
            files: files.paths(),
            records: totals.written,
            seconds: status.first_at.zip(status.last_at).map_or(0.0, |(first, last)| (last - first).as_s()),
            lost_kernel: lost.kernel,
            lost_driver: lost.driver,
            lost_disk: lost.disk,
            senders: senders.collect(),
        }
    }
}

fn outcome(totals: &Totals, lost: Losses, damaged: bool, files: &LogFiles) -> Outcome {
    match totals.written {
        0 => {
            // Nobody takes them for a recording, and the next try needs no --force.
            let paths = files.paths();
            paths.iter().flat_map(|log| [log.clone(), side_path(log)]).for_each(|path| remove_empty(&path));
            Outcome::Nothing
        }
        // Failing: the disk refuses it, or it was deleted.
        _ if lost != Losses::default() || damaged || totals.failing => Outcome::DataLost,
        _ => Outcome::Done,
    }
}

fn losses(totals: &Totals, lost: &Losses) -> Losses {
    Losses { disk: totals.dropped + totals.lost_on_disk, ..*lost }
}

impl<'a> Session<'a> {
    fn new(args: &'a Args, signals: Signals, listener: &impl AsFd, rests: bool) -> Words<Self> {
        let (terminal, clock) = (std::io::stderr().is_terminal(), Monotonic::new());
        let socket = listener.as_fd().try_clone_to_owned().map_err(|error| format!("listener: {error}"))?;
        let view = match args.watch {
            true => View::Page,
            false if terminal && say::says(say::Level::Usual) => View::Line,
            false => View::None,
        };
        Ok(Self { args, clock, rests, socket, signals, status: Status::new(clock.now()), view })
    }

    /// Reports what was recorded. `told` is what the listener says of itself, and what it lost.
    fn end(&self, failed: Option<String>, told: &(String, Losses), totals: &Totals, files: &LogFiles) -> Outcome {
        self.clear();
        notes!("{}", summary(&self.status, &told.0, totals, &files.paths()));
        if totals.received == 0 {
            note!("  nothing came{}", self.args.if_nothing());
        }
        if let Some(next) = files.left_over() {
            note!("  {} and those after it are of an earlier recording", next.display());
        }
        if let Some(message) = &failed {
            wrong!("{message}");
        }
        let lost = losses(totals, &told.1);
        if self.args.json {
            super::print_json(&Row::new(&self.status, totals, lost, files));
        }
        outcome(totals, lost, failed.is_some() || self.status.survey.lost_something(), files)
    }

    /// Receives until a signal, a limit, or an error; what was received is in the recorder either way.
    fn capture<S: CsiSource>(&mut self, source: &mut S, tell: impl Fn(&S) -> (Totals, Losses)) -> Words<()> {
        let (most, end_at) = match self.args.stop_after {
            Some(Limit::Records(count)) => (count, None),
            Some(Limit::After(span)) => (u64::MAX, Some(self.clock.now() + span)),
            None => (u64::MAX, None),
        };
        let mut look_at = self.clock.now() + LOOK;
        let mut told = None;
        let mut burst = 0;
        let mut ending = false;
        // Records since the last wait.
        let mut taken = 0;
        loop {
            let now = self.clock.now();
            let next = source.receive(now).in_words()?;
            self.status.note(now, &next);
            let pending = match &next {
                Next::Lost(loss) => {
                    self.clear();
                    note!("{}", loss_words(loss));
                    false
                }
                // What was queued when the signal came has been read.
                Next::Pending if ending => return Ok(()),
                Next::Pending => true,
                Next::End(_) => return Ok(()),
                Next::Record(..) => {
                    taken += 1;
                    false
                }
            };
            burst += 1;
            if !pending && burst < BURST && self.status.survey.came() < most {
                continue;
            }
            burst = 0;
            if self.status.survey.came() >= most || end_at.is_some_and(|end| end <= now) {
                return Ok(());
            }
            if look_at <= now {
                let (totals, lost) = tell(source);
                if totals.error != told {
                    self.clear();
                    wrong!("{}", totals.error.as_deref().unwrap_or_default());
                    told = totals.error.clone();
                }
                self.look(now, losses(&totals, &lost));
                look_at = now + LOOK;
            }
            let until =
                if pending { [source.next_at(), end_at, Some(look_at)].into_iter().flatten().min() } else { Some(now) };
            let may_rest = (1..=FEW).contains(&std::mem::take(&mut taken)) && self.rests;
            let rest = (pending && may_rest).then_some(now + REST);
            ending |= self.wait(until, rest).in_words()?;
        }
    }

    /// Waits for records until `until`, or rests from them until `rest`. True if a signal came.
    fn wait(&self, until: Option<Instant>, rest: Option<Instant>) -> std::result::Result<bool, Error> {
        match rest {
            Some(rest) => {
                let until = until.map_or(rest, |until| until.min(rest));
                self.clock.wait([self.signals.as_fd()], Some(until)).map(|[signalled]| signalled)
            }
            None => self.clock.wait([self.socket.as_fd(), self.signals.as_fd()], until).map(|[_, signalled]| signalled),
        }
    }

    fn look(&mut self, now: Instant, losses: Losses) {
        self.status.refresh(now);
        let text = match self.view {
            View::None => return,
            View::Line => format!("\r\x1b[K{}", self.status.line(losses)),
            View::Page => {
                let title = say::printable(&self.args.out.display().to_string()).into_owned();
                format!("\x1b[H\x1b[J{}", self.status.page(now, &title, losses))
            }
        };
        let mut stderr = std::io::stderr().lock();
        let _ = stderr.write_all(text.as_bytes()).and_then(|()| stderr.flush());
    }

    /// Clears the live line before other output.
    fn clear(&self) {
        if self.view == View::Line {
            // The terminal may be gone.
            let _ = std::io::stderr().lock().write_all(b"\r\x1b[K");
        }
    }
}

fn loss_words(loss: &Loss) -> String {
    match loss {
        Loss::Overrun { dropped: Some(dropped) } => format!("overrun: the kernel dropped {dropped} messages"),
        Loss::Overrun { dropped: None } => "overrun: the kernel dropped messages".into(),
        Loss::Datagram { number, reason, .. } => format!("datagram {number}: {reason}"),
        Loss::Bytes { offset, len, reason } => format!("{len} bytes at {offset}: {reason}"),
    }
}

fn summary(status: &Status, listener: &str, totals: &Totals, files: &[PathBuf]) -> String {
    let mut text = String::new();
    let names: Vec<_> = files.iter().map(|path: &PathBuf| Path::display(path).to_string()).collect();
    let seconds = status.first_at.zip(status.last_at).map_or(0.0, |(first, last)| (last - first).as_s());
    if totals.written > 0 {
        let records = super::some(totals.written, "record", "records");
        let _ = writeln!(text, "{records} written to {} in {seconds:.1} s", names.join(", "));
    }
    if seconds > 0.0 {
        let _ = writeln!(text, "  {:.1} records/s", totals.written as f64 / seconds);
    }
    text.push_str(listener);
    if totals.dropped + totals.lost_on_disk > 0 {
        let _ = writeln!(
            text,
            "  not in the log: {} records for which the disk was too slow, {} that it refused",
            totals.dropped, totals.lost_on_disk
        );
    }
    if let Some(error) = &totals.error {
        let _ = writeln!(text, "  {error}");
    }
    if let Some(words) = super::info::host_words(&status.survey.host_steps) {
        let _ = writeln!(text, "  {words}");
    }
    for (mac, sender) in &status.survey.senders {
        let name = if mac.is_zero() { "an unknown sender".to_string() } else { mac.to_string() };
        let _ = writeln!(text, "  from {name}: {}", super::some(sender.records, "record", "records"));
    }
    text
}

/// Removes an empty output; devices, pipes, and an earlier log that nothing took the place of stay.
fn remove_empty(output: &Path) {
    let is_empty = output.metadata().is_ok_and(|found| found.is_file() && found.len() == 0);
    if is_empty && std::fs::remove_file(output).is_ok() {
        note!("nothing to write: no {}", output.display());
    }
}

/// Source of FeitCSI's records.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Way {
    Input,
    Asked(Command),
}

fn feitcsi_source(text: &str) -> Words<Way> {
    match text {
        "-" => Ok(Way::Input),
        _ => text.parse().map(Way::Asked).map_err(|why| format!("{why}, or - for standard input")),
    }
}

/// Records until a signal, a limit or the end of the input.
fn run_feitcsi(args: &Args, from: &Way, signals: Signals) -> Result {
    let (frames, words) = match from {
        Way::Input => {
            let input = std::io::stdin().as_fd().try_clone_to_owned();
            let input = input.map_err(|error| format!("standard input: {error}"))?;
            (Frames::read(input, wall_us), "reading FeitCSI's output from standard input".to_owned())
        }
        Way::Asked(command) => {
            let frames = Frames::ask(command, wall_us).in_words()?;
            (frames, format!("asked FeitCSI at {} to measure", command.to))
        }
    };
    let files = LogFiles::create_bodies(&args.out, args.rotation(), args.force);
    let files = files.map_err(|error| create_refused(&error))?;
    let mut session = Session::new(args, signals, &frames, false)?;
    note!("{words}; recording to {}", args.out.display());
    let recorder = Recorder::new(frames, files, args.options()).in_words()?;
    let mut source = FeitCsi::new(recorder);
    let lost = |frames: &Frames| Losses { kernel: frames.dropped(), ..Losses::default() };
    let failed = session.capture(&mut source, |source| (source.frames.totals(), lost(source.frames.source()))).err();
    let (frames, files, totals) = source.frames.finish(session.clock.now()).in_words()?;
    Ok(session.end(failed, &(String::new(), lost(&frames)), &totals, &files))
}
