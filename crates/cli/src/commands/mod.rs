//! Parses arguments, runs the command, and turns results into exit codes. Results go to standard output, messages to
//! standard error.

mod args;
mod bearing;
mod demo;
mod doctor;
mod draft;
mod evaluate;
mod export;
mod files;
mod hint;
mod info;
mod key;
mod live;
mod mcap;
mod record;
mod replay;
mod setup;
mod simulate;
mod sound;
mod unbag;
mod view;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use csi5300_say as say;
use csi5300_say::{Level, When};
pub use csi5300_say::{Outcome, Result, count as some, fixed, is_end_of_room, print, print_json, usage};
pub use files::{is_same_file, must_not_exist, open_log, read_trajectory};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

/// A result whose error is words for the user.
pub type Words<T> = std::result::Result<T, String>;

/// Errors in words.
trait InWords<T> {
    /// The value, or the error in words.
    fn in_words(self) -> Words<T>;
}

impl<T, E: std::fmt::Display> InWords<T> for std::result::Result<T, E> {
    fn in_words(self) -> Words<T> {
        self.map_err(|error| error.to_string())
    }
}

/// Bearings between robots from WiFi alone: CSI of the Intel 5300, live, replayed or simulated.
#[derive(Parser)]
#[command(
    name = "csi5300",
    version,
    after_help = "`csi5300 help --all` lists rarely needed commands, too.\n\nExit status of every command:\n  \
                  0  done; a log cut at its end, a room that ends and a stop by a signal are normal\n  \
                  1  nothing usable: a file that is missing or cannot be written, no link with a bearing, no record\n  \
                  2  wrong usage: an invalid argument, extension, configuration or scene\n  \
                  3  done, but a log lost records before its end, trajectory rows were skipped, or a link failed"
)]
struct Cli {
    /// Print results and errors only: no notes, no progress
    #[arg(short, long, global = true, display_order = 900, hide_short_help = true)]
    quiet: bool,
    /// Print details: how an answer was made, files, time and memory
    #[arg(short, long, global = true, conflicts_with = "quiet", display_order = 901)]
    verbose: bool,
    /// Colours in text
    #[arg(
        long,
        alias = "colour",
        default_value = When::NAMES[0],
        value_parser = PossibleValuesParser::new(When::NAMES).map(|name| When::named(&name)),
        value_name = "WHEN",
        global = true,
        display_order = 902,
        hide_short_help = true
    )]
    color: When,
    #[command(subcommand)]
    command: Command,
}

// Only the arguments of the chosen command are built: building all takes longer than reading a trajectory. Structs of
// arguments have no doc comments, which would replace the ones here.
#[derive(Subcommand)]
#[command(defer = true)]
enum Command {
    /// Simulate the circle and line experiments of Dijkstra et al., decode their logs, and draw the bearings
    Demo(demo::Args),
    /// Show logs, captures or a running node on a page in the browser
    View(view::Args),
    /// Print the bearing from a receiver that moved to each transmitter it heard
    Bearing(Box<bearing::Args>),
    /// Print what logs hold: layout, senders, rates, losses, and where a log was cut
    Info(info::Args),
    /// Write a log's CSI as CSV, NPZ, MAT or Parquet, or the intact records of a damaged log
    Export(export::Args),
    /// Compare the bearings of captures with the truth: table, pictures or one HTML page
    Evaluate(evaluate::Args),
    /// Check everything between this machine and its first record, and print how to repair it
    Doctor(doctor::Args),
    /// Print the steps that put the card into monitor mode, or take them with --apply
    Setup(setup::Args),
    /// Record the driver's messages to a log
    Record(record::Args),
    /// Play a log at its own pace, to standard output or into the kernel's connector
    Replay(replay::Args),
    /// Exchange frames with other robots so that both cards measure; print live bearings
    Sound(Box<sound::Args>),
    /// Run the service of a robot: capture, odometry, peers, live bearings
    Node(NodeArgs),
    /// Show a running node in the terminal: peers, rates, losses, bearings on a compass
    Watch(WatchArgs),
    /// Simulate a room of robots: write the logs of their cards, serve them live, or compare a recording
    Simulate(Box<simulate::Args>),
    /// Write captures as MCAP, for Foxglove, Lichtblick and MCAP readers
    #[command(hide = true)]
    Mcap(Box<mcap::Args>),
    /// Write logs and trajectories from a recording of ROS 2
    #[command(hide = true)]
    Unbag(unbag::Args),
    /// Make keys of the sounding exchange: a group's secret, and each robot's keys from it
    #[command(hide = true)]
    Key(key::Args),
    /// Print the script by which a shell completes commands and options
    #[command(hide = true)]
    Completions(CompletionsArgs),
}

/// Runs the command named by the arguments.
pub fn run() -> ExitCode {
    let begun = std::time::Instant::now();
    // A file at the size limit (`ulimit -f`) acts as a full disk: the write fails with EFBIG, and the signal is
    // blocked.
    let _ = nix::sys::signal::SigSet::from_iter([nix::sys::signal::Signal::SIGXFSZ]).thread_block();
    let args: Vec<_> = std::env::args_os().collect();
    say::add_names(args.iter().skip(1).cloned());
    if args.get(1..).is_some_and(|rest| *rest == ["help", "--all"]) {
        print(&all(&Cli::command()));
        return ExitCode::SUCCESS;
    }
    let mut command = Cli::command();
    let parsed = command.try_get_matches_from_mut(args).and_then(|matches| {
        let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
        Ok((cli, matches))
    });
    let (cli, matches) =
        parsed.unwrap_or_else(|error| say::misused(&error.render().to_string(), error.exit_code(), || error.exit()));
    say::set("csi5300", Level::of(cli.quiet, cli.verbose), cli.color);
    let result = outputs_are_no_inputs(&command, &matches).and_then(|()| execute(cli.command));
    let lost_rows =
        |outcome| if files::rows_were_lost() && outcome == Outcome::Done { Outcome::DataLost } else { outcome };
    say::ended(begun, result.map(lost_rows))
}

/// Every command, hidden ones too.
fn all(cli: &clap::Command) -> String {
    let mut text = String::new();
    for hidden in [false, true] {
        text += if hidden { "\nSeldom needed:\n" } else { "Commands:\n" };
        for one in cli.get_subcommands().filter(|one| one.is_hide_set() == hidden) {
            let about = one.get_about().map(ToString::to_string).unwrap_or_default();
            text += &format!("  {:<12} {about}\n", one.get_name());
        }
    }
    text
}

/// Options and arguments that name outputs. All others that name files or folders are inputs.
const OUTPUTS: [&str; 9] = ["out", "output", "profile", "plot", "html", "log", "poses", "report", "factors"];

/// Notes what this run reads, and refuses outputs among it.
fn outputs_are_no_inputs(command: &clap::Command, matches: &clap::ArgMatches) -> Words<()> {
    let Some((name, given)) = matches.subcommand() else { return Ok(()) };
    let named = |arg: &clap::Arg| {
        let takes = arg.get_action().takes_values();
        let values = given.try_get_raw(arg.get_id().as_str()).ok().flatten().filter(|_| takes);
        values.into_iter().flatten().map(std::path::PathBuf::from).collect::<Vec<_>>()
    };
    let args = || command.find_subcommand(name).into_iter().flat_map(clap::Command::get_arguments);
    let is_output = |arg: &&clap::Arg| OUTPUTS.contains(&arg.get_id().as_str());
    for read in args().filter(|arg| !is_output(arg)).flat_map(named) {
        if read.exists() || read.as_os_str() == "-" {
            draft::reads(&read);
        }
    }
    args().filter(is_output).flat_map(named).try_for_each(|output| draft::must_not_be_read(&output))
}

fn execute(command: Command) -> Result {
    match command {
        Command::Demo(args) => demo::run(&args),
        Command::View(args) => view::run(&args),
        Command::Bearing(args) => bearing::run(*args),
        Command::Info(args) => info::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Setup(args) => setup::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Sound(args) => sound::run(&args),
        Command::Node(_) | Command::Watch(_) => become_node(),
        Command::Simulate(args) => simulate::run(&args),
        Command::Mcap(args) => mcap::run(&args),
        Command::Unbag(args) => unbag::run(&args),
        Command::Key(args) => key::run(&args),
        Command::Completions(args) => completions(&args),
    }
}

/// Shows the progress of a long command on a terminal; an empty text clears the line.
pub fn progress(text: &str) {
    use std::io::{IsTerminal, Write};
    let mut stderr = std::io::stderr().lock();
    if stderr.is_terminal() && say::says(Level::Usual) {
        let _ = write!(stderr, "\r\x1b[K{}", say::printable(text)).and_then(|()| stderr.flush());
    }
}

/// A progress bar on a terminal.
pub struct Bar {
    steps: u64,
    done: AtomicU64,
    /// Percent when it was last drawn.
    drawn: AtomicU64,
    what: String,
    begun: std::time::Instant,
}

/// A bar for this many steps of `what`.
pub fn bar(steps: u64, what: &str) -> Bar {
    let (done, drawn, what) = (AtomicU64::new(0), AtomicU64::new(u64::MAX), what.to_owned());
    Bar { steps, done, drawn, what, begun: std::time::Instant::now() }
}

impl Bar {
    /// One more step is done.
    pub fn inc(&self) {
        self.set(self.done.load(Ordering::Relaxed) + 1);
    }

    /// Sets the number of finished steps.
    pub fn set(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
        let percent = 100 * done.min(self.steps) / self.steps.max(1);
        if self.drawn.swap(percent, Ordering::Relaxed) != percent {
            let full = "#".repeat(percent as usize * 2 / 5);
            let left_s = self.begun.elapsed().as_secs_f64() * (100.0 / percent.max(1) as f64 - 1.0);
            progress(&format!("{full:-<40} {percent} % of {}, {left_s:.0} s left", self.what));
        }
    }

    /// Clears the line.
    pub fn clear(&self) {
        progress("");
    }
}

// Arguments of `completions`.
#[derive(clap::Args)]
#[command(after_help = "Example, for the running shell and for every later one:\n  \
                        source <(csi5300 completions bash)\n  \
                        csi5300 completions bash > ~/.local/share/bash-completion/completions/csi5300")]
struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

/// Prints the script of a shell.
fn completions(args: &CompletionsArgs) -> Result {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "csi5300", &mut script);
    print(&String::from_utf8_lossy(&script));
    Ok(Outcome::Done)
}

/// The robot's service.
const PROGRAM: &str = "csi5300-node";

// Arguments of `node`; what they mean is the service's.
#[derive(clap::Args)]
struct NodeArgs {
    /// The robot's configuration; packaging/robot.toml explains every key [default: robot.toml in this folder, in
    /// ~/.config/csi5300 ($XDG_CONFIG_HOME), or in /etc/csi5300]
    #[arg(long, value_name = "ROBOT.toml")]
    config: Option<PathBuf>,
    /// Check the configuration, start nothing
    #[arg(long)]
    check: bool,
}

// Arguments of `watch`.
#[derive(clap::Args)]
struct WatchArgs {
    /// The node's status socket [default: that of the configuration that `node` finds, else /run/csi5300/status.sock]
    #[arg(value_name = "SOCKET")]
    socket: Option<PathBuf>,
    /// Print one state as a table and exit. Without it, an output that is no terminal gets one state as JSON
    #[arg(long)]
    once: bool,
}

/// Becomes the robot's service: the program beside this one, else the first in the search path.
fn become_node() -> Result {
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(PROGRAM)).filter(|file| file.is_file());
    let program = beside.unwrap_or_else(|| PROGRAM.into());
    let refused = std::process::Command::new(&program).args(std::env::args_os().skip(1)).exec();
    Err(match refused.kind() {
        std::io::ErrorKind::NotFound => format!(
            "the robot's service is a program of its own, {PROGRAM}, which is neither beside this one nor in PATH: packages have \
             both, and `cargo build --release -p csi5300-node` makes it"
        ),
        _ => format!("{}: {refused}", program.display()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Arg, Command};

    /// Every option that names a file is listed as an output or an input.
    #[test]
    fn options_that_write_are_known() {
        let mut command = Cli::command();
        command.build();
        let path = clap::builder::ValueParser::path_buf().type_id();
        let mut written = Vec::new();
        for (command, arg) in
            command.get_subcommands().flat_map(|one| one.get_arguments().map(move |arg| (one.get_name(), arg)))
        {
            let is_path = arg.get_value_parser().type_id() == path;
            if is_path && OUTPUTS.contains(&arg.get_id().as_str()) {
                written.push(format!("{command} {}", arg.get_id()));
            }
        }
        let mut all = vec!["bearing profile", "bearing factors", "simulate out", "export output", "demo out"];
        all.extend(["bearing plot", "evaluate plot", "info plot"]);
        for known in all {
            assert!(written.iter().any(|one| one == known), "{known}: {written:?}");
        }
        // Inputs. `file` of `key` is a new file; existing ones are never overwritten.
        let inputs = [
            "bag",
            "captures",
            "config",
            "file",
            "files",
            "folders",
            "group",
            "key",
            "logs",
            "ranges",
            "rx",
            "scene",
            "socket",
            "trajectory",
            "tx",
            "tx_trajectory",
            "what",
        ];
        for arg in command.get_subcommands().flat_map(clap::Command::get_arguments) {
            let is_path = arg.get_value_parser().type_id() == path;
            let name = arg.get_id().as_str();
            assert!(!is_path || OUTPUTS.contains(&name) || inputs.contains(&name), "--{name}: an input or an output?");
        }
    }

    #[test]
    fn the_list_of_commands_and_their_own_help_agree() {
        let said = |command: &Command| {
            let of = |one: &Command| (one.get_name().to_owned(), one.get_about().map(ToString::to_string));
            command.get_subcommands().map(of).collect::<Vec<_>>()
        };
        let listed = said(&Cli::command());
        let mut command = Cli::command();
        command.build();
        let own: Vec<_> = said(&command).into_iter().filter(|(name, _)| name != "help").collect();
        assert_eq!(listed, own);
        assert!(own.iter().all(|(_, about)| about.as_ref().is_some_and(|about| !about.is_empty())), "{own:?}");
    }

    /// Long options of a command and its subcommands, without global and hidden ones and help.
    fn options(command: &Command) -> usize {
        let is_own = |arg: &&Arg| {
            !arg.is_global_set()
                && !arg.is_hide_set()
                && arg.get_long().is_some_and(|long| !["help", "version"].contains(&long))
        };
        command.get_arguments().filter(is_own).count() + command.get_subcommands().map(options).sum::<usize>()
    }

    /// Limits of listed commands and of options, counted once per command; global ones once. `manual` is for packages;
    /// `mcap` is not counted.
    #[test]
    fn there_are_few_commands_and_options() {
        let mut cli = Cli::command();
        cli.build();
        let listed = cli.get_subcommands().filter(|one| !one.is_hide_set()).count();
        let counted = cli.get_subcommands().filter(|one| !["help", "manual", "mcap"].contains(&one.get_name()));
        let counts: Vec<(&str, usize)> = counted.map(|one| (one.get_name(), options(one))).collect();
        let globals = cli.get_arguments().filter(|arg| arg.is_global_set()).count();
        let all = globals + counts.iter().map(|(_, count)| count).sum::<usize>();
        println!("{listed} commands, {all} options: {globals} global, {counts:?}");
        assert!(listed <= 16 && all <= 160, "{listed} commands, {all} options: {counts:?}");
    }
}
