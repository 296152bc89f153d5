//! The commands for the card on this machine.

mod doctor;
mod listener;
mod live;
mod record;
mod replay;
mod respond;
pub mod serve;
mod setup;
mod sound;
mod sounding;

use super::*;

#[derive(Subcommand)]
pub enum Command {
    /// Sounds other robots: sends them frames in turn, which they answer, so that both cards measure; live bearings
    Sound(Box<sound::Args>),
    /// Answers the frames of robots that sound
    Respond(respond::Args),
    /// Records the driver's messages to a log, live
    Record(record::Args),
    /// Plays a log at its own pace, to standard output or into the kernel's connector
    Replay(replay::Args),
    /// What stands between this machine and a first record, and the command that mends it
    Doctor(doctor::Args),
    /// The steps that put the card into monitor mode: printed, or taken with --apply
    Setup(setup::Args),
}

/// Runs the command.
pub fn run(command: Command) -> Result {
    match command {
        Command::Sound(args) => sound::run(&args),
        Command::Respond(args) => respond::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Setup(args) => setup::run(&args),
    }
}
