//! `csi5300 completions`, made from the same arguments that the program parses.

use super::{Outcome, Result, print};
use clap::CommandFactory;

// Arguments of `completions`.
#[derive(clap::Args)]
#[command(after_help = "Example, for the running shell and for every later one:\n  \
                        source <(csi5300 completions bash)\n  \
                        csi5300 completions bash > ~/.local/share/bash-completion/completions/csi5300")]
pub struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

/// Prints the script of a shell.
pub fn run(args: &Args) -> Result {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::Cli::command(), "csi5300", &mut script);
    print(&String::from_utf8_lossy(&script));
    Ok(Outcome::Done)
}
