//! `csi5300 node` and `csi5300 watch`: the robot's service is a program of its own, `csi5300-node`, which is started with the
//! same arguments.

use super::Result;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

/// The robot's service.
const PROGRAM: &str = "csi5300-node";

// Arguments of `node`; what they mean is the service's.
#[derive(clap::Args)]
pub struct NodeArgs {
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
pub struct WatchArgs {
    /// The node's status socket [default: that of the configuration that `node` finds, else /run/csi5300/status.sock]
    #[arg(value_name = "SOCKET")]
    socket: Option<PathBuf>,
    /// Print one state as a table and exit. Without it, an output that is no terminal gets one state as JSON
    #[arg(long)]
    once: bool,
}

/// Becomes the robot's service: the program beside this one, else the first in the search path.
pub fn run() -> Result {
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(PROGRAM)).filter(|file| file.is_file());
    let program = beside.unwrap_or_else(|| PROGRAM.into());
    let refused = Command::new(&program).args(std::env::args_os().skip(1)).exec();
    Err(match refused.kind() {
        std::io::ErrorKind::NotFound => format!(
            "the robot's service is a program of its own, {PROGRAM}, which is neither beside this one nor in PATH: packages have \
             both, and `cargo build --release -p csi5300-node` makes it"
        ),
        _ => format!("{}: {refused}", program.display()),
    })
}
