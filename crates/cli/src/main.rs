//! The `csi5300` command.

mod commands;

fn main() -> std::process::ExitCode {
    commands::run()
}
