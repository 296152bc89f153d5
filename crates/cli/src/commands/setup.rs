//! `csi5300 setup`.

use super::args::channel_of_5300;
use super::{Outcome, Result, print, print_json};
use clap::ValueEnum;
use csi5300::signal::channel::Channel;
use csi5300_live::doctor::{self, Machine, Request, Step, default_interface, plan, undo, warnings};

// Arguments of `setup`.
#[derive(clap::Args)]
pub struct Args {
    /// The card's interface [default: found on the PCI bus]
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// WiFi channel, with + or - for 40 MHz; the same on all robots
    #[arg(long, value_parser = channel_of_5300, value_name = "NUMBER", required_unless_present = "undo")]
    channel: Option<Channel>,
    /// This robot's role in a round
    #[arg(long, value_enum, required_unless_present = "undo")]
    role: Option<Role>,
    /// The driver that makes the CSI records [default: found by its parameters]
    #[arg(long, value_enum)]
    driver: Option<Driver>,
    /// Length of the frames that a responder's kernel answers, checksum included (WSR driver or module): 57, 59 ...
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u32).range(28..=2304))]
    ack_len: Option<u32>,
    /// Run the steps instead of printing them
    #[arg(long)]
    apply: bool,
    /// Print the steps back to an ordinary WiFi card; --apply runs them
    #[arg(long, conflicts_with_all = ["channel", "role", "driver", "ack_len"])]
    undo: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
}

/// A line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    command: String,
    why: &'a str,
    may_fail: bool,
    taken: bool,
}

/// What the robot does in a round.
#[derive(Clone, Copy, ValueEnum)]
enum Role {
    /// Sends the forward frames
    Initiator,
    /// Answers them
    Responder,
}

/// The CSI driver.
#[derive(Clone, Copy, ValueEnum)]
enum Driver {
    /// csitool
    Stock,
    /// WSR
    Wsr,
    /// The distribution's driver, with the module csi5300 beside it
    Module,
}

/// Prints or takes the steps.
pub fn run(args: &Args) -> Result {
    let system = Machine;
    let interface = match &args.interface {
        Some(name) if name.is_empty() || name.starts_with('-') || name.contains(['/', ' ']) => {
            return Err(format!("`{name}` is no name of an interface"));
        }
        Some(name) => name.clone(),
        None => default_interface(&system)?,
    };
    let steps = match (args.undo, args.channel, args.role) {
        (true, _, _) => undo(&system, &interface),
        (false, Some(channel), Some(role)) => {
            let role = match role {
                Role::Initiator => doctor::Role::Initiator,
                Role::Responder => doctor::Role::Responder,
            };
            let driver = args.driver.map(|driver| match driver {
                Driver::Stock => doctor::Driver::Stock,
                Driver::Wsr => doctor::Driver::Wsr,
                Driver::Module => doctor::Driver::Module,
            });
            let request = Request { interface, channel, role, driver, ack_len: args.ack_len };
            warnings(&system, &request).iter().for_each(|warning| note!("{warning}"));
            plan(&system, &request)?
        }
        (false, _, _) => return Err("--channel and --role are needed".into()),
    };
    for step in &steps {
        if !args.json {
            print(&line(step));
        }
        if args.apply {
            step.take(&system)
                .map_err(|error| format!("{error}\n  (`csi5300 setup --undo --apply` undoes all of it)"))?;
        }
        if args.json {
            print_json(&Row { command: step.line(), why: step.why, may_fail: step.may_fail, taken: args.apply });
        }
    }
    if !args.apply {
        note!("nothing was changed: --apply takes these steps");
    }
    Ok(Outcome::Done)
}

fn line(step: &Step) -> String {
    let allowed = if step.may_fail { " || true" } else { "" };
    format!("{}{allowed}  # {}\n", step.line(), step.why)
}
