//! Words to calls, results to exit codes. Results go to standard output, diagnostics to standard error.

mod args;
mod bearing;
mod captures;
#[cfg(feature = "live")]
mod card;
mod compare;
mod completions;
mod demo;
mod draft;
mod evaluate;
mod explain;
mod export;
mod files;
mod folds;
mod hint;
mod info;
mod inputs;
mod key;
mod locate;
mod mcap;
mod mounting;
mod node;
#[cfg(feature = "plot")]
mod pictures;
#[cfg(feature = "plot")]
mod plot;
mod profile;
mod recover;
#[cfg(feature = "plot")]
mod report;
mod simulate;
mod suite;
mod threads;
mod unbag;
#[cfg(feature = "view")]
mod view;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Parser, Subcommand};
use csi5300_say::{self as say, Level, When};
pub use csi5300_say::{Outcome, Result, count as some, fixed, is_end_of_room, print, print_json, usage};
pub use files::{is_same_file, must_not_exist, open_log, read_trajectory};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bearings between robots from WiFi alone: CSI of the Intel 5300, live, replayed or simulated.
#[derive(Parser)]
#[command(
    name = "csi5300",
    version,
    after_help = "Exit status, of every command:\n  \
                  0  done; a log cut at its end, a room that ends and a stop by a signal are normal\n  \
                  1  nothing usable: a file that is missing or cannot be written, no link with a bearing, no record\n  \
                  2  wrong usage: arguments, extensions, configurations and scenes that cannot be meant\n  \
                  3  done, but records were lost before the end of a log, rows of a trajectory were left out, or a link or\n     \
                  capture failed"
)]
struct Cli {
    /// Say nothing but results and errors: no notes, no progress
    #[arg(short, long, global = true, display_order = 900)]
    quiet: bool,
    /// Also say what is read, how long the command took and how much memory
    #[arg(short, long, global = true, conflicts_with = "quiet", display_order = 901)]
    verbose: bool,
    /// Colours in words
    #[arg(
        long,
        alias = "colour",
        default_value = When::NAMES[0],
        value_parser = PossibleValuesParser::new(When::NAMES).map(|name| When::named(&name)),
        value_name = "WHEN",
        global = true,
        display_order = 902
    )]
    color: When,
    #[command(subcommand)]
    command: Command,
}

// What a command takes is made when it is the one: all of them take longer than reading a trajectory. So structs of arguments
// have no doc comments: those would replace what is said of a command here.
#[derive(Subcommand)]
#[command(defer = true)]
enum Command {
    /// The circle and line experiments of Dijkstra et al., simulated, decoded and estimated, with pictures
    Demo(demo::Args),
    /// The bearing from a receiver that moved to one or more transmitters, from their logs
    Bearing(Box<bearing::Args>),
    /// What is in logs: layout, senders, rates, losses with their offsets, where and why a log was cut
    Info(info::Args),
    /// A log over time as pictures: CSI, levels, rate, gaps and losses
    #[cfg(feature = "plot")]
    Plot(plot::Args),
    /// Bearings of a whole tree of captures against the truth
    Evaluate(evaluate::Args),
    /// One self-contained HTML page about a tree of captures: pictures, tables, losses
    #[cfg(feature = "plot")]
    Report(report::Args),
    /// A page in the browser: logs, the links of captures with their errors, or a running node
    #[cfg(feature = "view")]
    View(view::Args),
    /// Where the receiver of a capture is, from its links to transmitters whose places are known; or where transmitters are
    Locate(locate::Args),
    /// One link from end to end: phase, compensation, autofocus, candidates and paths, with pictures
    Explain(explain::Args),
    /// Copies every intact record of a damaged log, and nothing else
    Recover(recover::Args),
    /// CSI of a log as CSV, NPZ, MAT or Parquet, raw or scaled
    Export(export::Args),
    /// Captures as MCAP, for Foxglove, Lichtblick and MCAP readers
    Mcap(mcap::Args),
    /// Logs and trajectories from a recording of ROS 2
    Unbag(unbag::Args),
    /// A room full of robots: writes the logs that their cards would have recorded
    Simulate(simulate::Args),
    /// A recorded capture beside a simulated one: every figure of both, and pictures
    Compare(compare::Args),
    /// The experiments of Dijkstra et al., simulated, with repetitions: a table of errors, confidence and phase residual
    Suite(suite::Args),
    /// Keys of the sounding exchange: a new secret of a group, and from it one robot's own
    Key(key::Args),
    /// The script with which a shell completes commands and options
    Completions(completions::Args),
    /// The card on this machine
    #[cfg(feature = "live")]
    #[command(flatten)]
    Card(card::Command),
    /// The robot's own service: capture, odometry, peers, live bearings
    Node(node::NodeArgs),
    /// A running node in a terminal: peers, rates, losses, bearings on a compass
    Watch(node::WatchArgs),
}

/// Runs the command named by the arguments.
pub fn run() -> ExitCode {
    let begun = std::time::Instant::now();
    // A file as large as files may be here (`ulimit -f`) is a full disk: the write fails with EFBIG, and the signal ends nothing.
    let _ = nix::sys::signal::SigSet::from_iter([nix::sys::signal::Signal::SIGXFSZ]).thread_block();
    let cli = Cli::try_parse()
        .unwrap_or_else(|error| say::misused(&error.render().to_string(), error.exit_code(), || error.exit()));
    let level = match (cli.quiet, cli.verbose) {
        (true, _) => Level::Quiet,
        (false, false) => Level::Usual,
        (false, true) => Level::Verbose,
    };
    say::set("csi5300", level, cli.color);
    let result = execute(cli.command);
    detail!("{}", say::used(begun));
    match result {
        Ok(Outcome::Done) if files::rows_were_lost() => Outcome::DataLost.into(),
        Ok(outcome) => outcome.into(),
        Err(message) => {
            wrong!("{message}");
            Outcome::Nothing.into()
        }
    }
}

fn execute(command: Command) -> Result {
    match command {
        Command::Demo(args) => demo::run(&args),
        Command::Bearing(args) => bearing::run(*args),
        Command::Info(args) => info::run(&args),
        #[cfg(feature = "plot")]
        Command::Plot(args) => plot::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        #[cfg(feature = "plot")]
        Command::Report(args) => report::run(&args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(&args),
        Command::Locate(args) => locate::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Recover(args) => recover::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Mcap(args) => mcap::run(&args),
        Command::Unbag(args) => unbag::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Suite(args) => suite::run(&args),
        Command::Key(args) => key::run(&args),
        Command::Completions(args) => completions::run(&args),
        #[cfg(feature = "live")]
        Command::Card(command) => card::run(command),
        Command::Node(_) | Command::Watch(_) => node::run(),
    }
}

/// Says on a terminal how far a long command is; an empty text takes the line away.
pub fn progress(text: &str) {
    use std::io::{IsTerminal, Write};
    let mut stderr = std::io::stderr().lock();
    if stderr.is_terminal() && say::says(Level::Usual) {
        let _ = write!(stderr, "\r\x1b[K{}", say::printable(text)).and_then(|()| stderr.flush());
    }
}

/// A bar on a terminal that says how far a long command is.
pub struct Bar {
    steps: u64,
    done: AtomicU64,
    /// Percent when it was last drawn.
    drawn: AtomicU64,
    what: String,
    begun: std::time::Instant,
}

/// A bar for so many steps of `what`.
pub fn bar(steps: u64, what: &str) -> Bar {
    let (done, drawn, what) = (AtomicU64::new(0), AtomicU64::new(u64::MAX), what.to_owned());
    Bar { steps, done, drawn, what, begun: std::time::Instant::now() }
}

impl Bar {
    /// One more step is done.
    pub fn inc(&self) {
        self.set(self.done.load(Ordering::Relaxed) + 1);
    }

    /// So many steps are done.
    pub fn set(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
        let percent = 100 * done.min(self.steps) / self.steps.max(1);
        if self.drawn.swap(percent, Ordering::Relaxed) != percent {
            let full = "#".repeat(percent as usize * 2 / 5);
            let left_s = self.begun.elapsed().as_secs_f64() * (100.0 / percent.max(1) as f64 - 1.0);
            progress(&format!("{full:-<40} {percent} % of {}, {left_s:.0} s left", self.what));
        }
    }

    /// Takes it away.
    pub fn clear(&self) {
        progress("");
    }
}

#[cfg(test)]
mod tests {
    use super::Cli;
    use clap::CommandFactory;

    #[test]
    fn a_command_says_of_itself_what_the_list_says() {
        let said = |command: &clap::Command| {
            let of = |one: &clap::Command| (one.get_name().to_owned(), one.get_about().map(ToString::to_string));
            command.get_subcommands().map(of).collect::<Vec<_>>()
        };
        let listed = said(&Cli::command());
        let mut command = Cli::command();
        command.build();
        let own: Vec<_> = said(&command).into_iter().filter(|(name, _)| name != "help").collect();
        assert_eq!(listed, own);
        assert!(own.iter().all(|(_, about)| about.as_ref().is_some_and(|about| !about.is_empty())), "{own:?}");
    }
}
