//! The `csi5300` command.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
