//! The program `csi5300-node`: the robot's service, and a display of a running one. `csi5300 node` and `csi5300 watch`
//! start it.

#[macro_use]
extern crate csi5300_say;

mod places;
mod run;
mod watch;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Parser, Subcommand};
use csi5300_say::{Level, Outcome, When};
use std::process::ExitCode;

/// The robot's own service: capture, odometry, peers, live bearings
#[derive(Parser)]
#[command(name = "csi5300-node", version)]
struct Cli {
    /// Print results and errors only: no notes, no progress
    #[arg(short, long, global = true, display_order = 900)]
    quiet: bool,
    /// Print run time and memory too
    #[arg(short, long, global = true, conflicts_with = "quiet", display_order = 901)]
    verbose: bool,
    /// Colours in text
    #[arg(long, alias = "colour", default_value = When::NAMES[0], value_name = "WHEN", global = true, display_order = 902,
        value_parser = PossibleValuesParser::new(When::NAMES).map(|name| When::named(&name)))]
    color: When,
    #[command(flatten)]
    service: run::Args,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Run the service, as without a command
    #[command(hide = true)]
    Node(run::Args),
    /// Show a running node in a terminal: peers, rates, losses, bearings on a compass
    Watch(watch::Args),
}

fn main() -> ExitCode {
    let begun = std::time::Instant::now();
    csi5300_say::add_names(std::env::args_os().skip(1));
    let cli = Cli::try_parse()
        .unwrap_or_else(|error| csi5300_say::misused(&error.render().to_string(), error.exit_code(), || error.exit()));
    let level = match (cli.quiet, cli.verbose) {
        (true, _) => Level::Quiet,
        (false, false) => Level::Usual,
        (false, true) => Level::Verbose,
    };
    csi5300_say::set("csi5300-node", level, cli.color);
    let result = match cli.command {
        Some(_) if !cli.service.is_empty() => csi5300_say::usage("put options of the service after `node`"),
        Some(Command::Watch(args)) => watch::run(&args),
        Some(Command::Node(args)) => run::run(&args),
        None => run::run(&cli.service),
    };
    detail!("{}", csi5300_say::used(begun));
    result.map_or_else(
        |message| {
            wrong!("{message}");
            Outcome::Nothing.into()
        },
        ExitCode::from,
    )
}
