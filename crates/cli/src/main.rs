//! The `csi5300` command.

#[macro_use]
extern crate csi5300_say;

mod commands;

fn main() -> std::process::ExitCode {
    commands::run()
}
