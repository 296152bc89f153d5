//! The program `csi5300-node`: the robot's service, and a display of a running one. `csi5300 node` and `csi5300 watch`
//! start it.

#[macro_use]
extern crate csi5300_say;

mod watch;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Parser, Subcommand};
use csi5300_node::config::{Antennas, Capture, Config, Feitcsi, Odometry, Team};
use csi5300_node::service::{self, Ended};
use csi5300_say::{Level, Outcome, Result, Tone, When, count, is_end_of_room, print, toned, usage};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A configuration's name in each folder.
const NAME: &str = "robot.toml";
/// Default status socket.
const STATUS_SOCKET: &str = "/run/csi5300/status.sock";

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
    service: Args,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Run the service, as without a command
    #[command(hide = true)]
    Node(Args),
    /// Show a running node in a terminal: peers, rates, losses, bearings on a compass
    Watch(watch::Args),
}

fn main() -> ExitCode {
    let begun = std::time::Instant::now();
    csi5300_say::add_names(std::env::args_os().skip(1));
    let cli = Cli::try_parse()
        .unwrap_or_else(|error| csi5300_say::misused(&error.render().to_string(), error.exit_code(), || error.exit()));
    csi5300_say::set("csi5300-node", Level::of(cli.quiet, cli.verbose), cli.color);
    let result = match cli.command {
        Some(_) if !cli.service.is_empty() => csi5300_say::usage("put options of the service after `node`"),
        Some(Command::Watch(args)) => watch::run(&args),
        Some(Command::Node(args)) => run(&args),
        None => run(&cli.service),
    };
    csi5300_say::ended(begun, result)
}

// Arguments of the service.
#[derive(clap::Args)]
struct Args {
    /// The robot's configuration; packaging/robot.toml explains every key [default: robot.toml in this folder, in
    /// ~/.config/csi5300 ($XDG_CONFIG_HOME), or in /etc/csi5300]
    #[arg(long, value_name = "ROBOT.toml")]
    config: Option<PathBuf>,
    /// Check the configuration, start nothing
    #[arg(long)]
    check: bool,
}

impl Args {
    /// True without any option.
    fn is_empty(&self) -> bool {
        self.config.is_none() && !self.check
    }
}

/// Runs the robot's own service.
fn run(args: &Args) -> Result {
    let found = args.config.clone().map_or_else(configuration, Ok);
    let file = found.unwrap_or_else(|message| usage(&message));
    // A missing file is not wrong usage.
    let text = Config::text_of(&file).map_err(|error| format!("{}: cannot be read: {error}", file.display()))?;
    let config = Config::of_file(&text, &file).unwrap_or_else(|error| {
        let lines: Vec<String> = error.0.iter().map(|problem| format!("{}: {problem}", file.display())).collect();
        usage(&lines.join("\ncsi5300-node: "))
    });
    if args.check {
        print(&format!("{}: {}\n{}", file.display(), toned("good", Tone::Good), what_will_run(&config)));
        return Ok(Outcome::Done);
    }
    let name = config.name.clone().unwrap_or_else(host_name);
    if let Some(words) = config.ros2_reach() {
        note!("{words}");
    }
    let ended = service::run(&config, name).map_err(|error| error.to_string())?;
    notes!("{}", summary(&ended));
    match &ended.error {
        Some(error) if matches!(config.capture.get_ref(), Capture::Served(_)) && is_end_of_room(error) => {
            note!("the room has ended");
        }
        Some(error) => return Err(error.to_string()),
        None => {}
    }
    let wants_bearings = !config.peer.is_empty() || config.array.is_some();
    let is_nothing = ended.health.records == 0 || (wants_bearings && ended.bearings == 0 && config.log.is_none());
    Ok(if is_nothing && !ended.signalled {
        Outcome::Nothing
    } else if !ended.health.lost().is_empty() {
        Outcome::DataLost
    } else {
        Outcome::Done
    })
}

/// The plan of a configuration, one item a line.
fn what_will_run(config: &Config) -> String {
    let capture = match config.capture.get_ref() {
        Capture::Card(_) => "the card of this machine, by its patched driver".to_owned(),
        Capture::Stock(_) => "the card of this machine, under the kernel's own driver".to_owned(),
        Capture::Feitcsi(Feitcsi::Udp(command)) => {
            format!("the AX200 or AX210 that FeitCSI at {} measures", command.to)
        }
        Capture::Feitcsi(Feitcsi::Pipe(pipe)) => {
            format!("the AX200 or AX210 of this machine: what FeitCSI writes to {}", pipe.display())
        }
        Capture::Replay(replay) => format!("the log {}, at {} times its pace", replay.file.display(), replay.speed),
        Capture::Room(room) => format!("robot {} of the simulated room {}", room.robot, room.scene.display()),
        Capture::Served(served) => format!("robot {} of the room at {}", served.robot, served.socket.display()),
    };
    let odometry = match &config.odometry {
        Odometry::Opencr(open_cr) => format!("the OpenCR board at {}", open_cr.port.display()),
        Odometry::Csv(csv) => format!("the trajectory {}", csv.file.display()),
        Odometry::Room(_) => "the simulated room".into(),
        Odometry::Ros(_) => "a ROS 1 topic".into(),
        Odometry::Ros2(_) => "a ROS 2 topic".into(),
        Odometry::Static(_) => "none: this robot stands".into(),
        Odometry::Network(_) => "the robots' network".into(),
    };
    let output = &config.output;
    let bearings = match output.bearings.as_str() {
        "" => None,
        "-" => Some("standard output".into()),
        file => Some(file.to_owned()),
    };
    let lines = [
        ("channel", Some(config.channel.to_string())),
        ("records", Some(capture)),
        ("poses", Some(odometry)),
        ("antennas", config.array.as_ref().map(antennas)),
        ("peers", Some(bearings_of(config))),
        ("sounding", config.sounding.as_ref().map(|own| (if own.initiate { "initiates" } else { "answers" }).into())),
        ("log", config.log.as_ref().map(|log| log.file.display().to_string())),
        ("team", config.team.as_ref().map(team)),
        ("output", bearings),
        ("status", output.status_socket.as_ref().map(|socket| socket.display().to_string())),
        ("Foxglove", output.foxglove.map(|address| address.to_string())),
        ("network", config.network.as_ref().map(|network| format!("group {}", network.group()))),
        ("ROS 1", config.ros.as_ref().map(|ros| format!("frame {}", ros.frame))),
        ("ROS 2", config.ros2.as_ref().map(|ros| format!("frame {}", ros.frame))),
    ];
    lines.into_iter().filter_map(|(what, value)| Some(format!("  {what:12} {}\n", value?))).collect()
}

fn team(team: &Team) -> String {
    let names = |what: &str, names: Vec<&String>| match names.as_slice() {
        [] => String::new(),
        names => format!(", {what} {}", names.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(", ")),
    };
    let places = names("known places of", team.places.keys().collect());
    let frame = if team.places.is_empty() { String::new() } else { format!(" in frame {}", team.frame) };
    format!("one graph{places}{frame}{}", names("ranges to", team.ranges.keys().collect()))
}

/// The antennas of bearings of what is heard alone.
fn antennas(array: &Antennas) -> String {
    let names: Vec<String> = array.antennas.iter().map(ToString::to_string).collect();
    let stands = if array.chain_constants_deg.is_empty() { "" } else { ", with the constants of their chains" };
    format!("{}{stands}", names.join(", "))
}

fn bearings_of(config: &Config) -> String {
    let peers: Vec<&str> = config.peer.iter().map(|peer| peer.get_ref().name.as_str()).collect();
    match (peers.join(", "), &config.array) {
        (names, None) if names.is_empty() => "nobody: add a [[peer]] or an [array]".into(),
        (names, None) => names,
        (names, Some(_)) if names.is_empty() => "every sender that is heard".into(),
        (names, Some(_)) => format!("{names}, and every other sender that is heard"),
    }
}

fn host_name() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname").map_or_else(|_| "robot".into(), |name| name.trim().to_owned())
}

fn summary(ended: &Ended) -> String {
    let health = &ended.health;
    let mut text = format!(
        "{} and {} in {:.1} s; {}\n",
        count(health.records, "record", "records"),
        count(health.poses.poses, "pose", "poses"),
        health.uptime_s,
        count(ended.bearings, "bearing", "bearings")
    );
    for peer in &health.peers {
        let words = peer.report.as_ref().map_or("no report", |report| report.words.as_str());
        let counts = &peer.counts;
        text += &format!(
            "  {}: {words}; {} of {} here and {} there\n",
            peer.name,
            count(counts.pairs, "pair", "pairs"),
            count(counts.heard, "record", "records"),
            counts.heard_by_peer
        );
    }
    if let Some(log) = &health.log {
        let missing = log.dropped + log.lost_on_disk;
        text += &format!("  {} in the log, {missing} not\n", count(log.written, "record", "records"));
    }
    let lost = health.lost();
    if !lost.is_empty() {
        text += &format!("lost: {}\n", lost.join(", "));
    }
    for trouble in &health.trouble {
        text += &format!("  {trouble}\n");
    }
    text
}

/// The possible files, in order: in this folder, the user's, the machine's. The first that exists is used.
fn configurations() -> Vec<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")));
    let folders = [user, Some(PathBuf::from("/etc"))].into_iter().flatten().map(|folder| folder.join("csi5300"));
    std::iter::once(PathBuf::from(NAME)).chain(folders.map(|folder| folder.join(NAME))).collect()
}

/// The default configuration.
///
/// # Errors
/// If there is none, in words.
fn configuration() -> std::result::Result<PathBuf, String> {
    let looked = configurations();
    match looked.iter().find(|file| file.is_file()) {
        Some(file) => {
            note!("configuration {}", file.display());
            Ok(file.clone())
        }
        None => {
            let names: Vec<String> = looked.iter().map(|file| file.display().to_string()).collect();
            Err(format!("no configuration: name one with --config, or put it at {}", names.join(", or at ")))
        }
    }
}

/// The status socket of the default configuration, if it names one.
fn status_socket() -> PathBuf {
    let found = configurations().into_iter().find(|file| file.is_file());
    let named = found.and_then(|file| match Config::text_of(&file).map(|text| Config::of_file(&text, &file)) {
        Ok(Ok(config)) => config.output.status_socket,
        _ => {
            note!("{} is not valid (csi5300-node --check): looking at {STATUS_SOCKET}", file.display());
            None
        }
    });
    named.unwrap_or_else(|| Path::new(STATUS_SOCKET).to_path_buf())
}
