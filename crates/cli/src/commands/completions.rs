//! `csi5300 completions` and `csi5300 manual`: what a package installs beside the program, made from the same arguments that it parses.

use super::{Outcome, Result, print};
use clap::CommandFactory;
use std::path::PathBuf;

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

// Arguments of `manual`.
#[derive(clap::Args)]
pub struct ManualArgs {
    /// A folder, made where it is absent: csi5300.1 and a page for each command
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints the script of a shell.
pub fn run(args: &Args) -> Result {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::Cli::command(), "csi5300", &mut script);
    print(&String::from_utf8_lossy(&script));
    Ok(Outcome::Done)
}

/// Writes the pages.
pub fn manual(args: &ManualArgs) -> Result {
    let refused = |error| format!("{}: {error}", args.out.display());
    std::fs::create_dir_all(&args.out).map_err(refused)?;
    clap_mangen::generate_to(super::Cli::command(), &args.out).map_err(refused)?;
    Ok(Outcome::Done)
}
