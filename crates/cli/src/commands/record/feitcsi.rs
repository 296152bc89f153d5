//! `csi5300 record --feitcsi`: records an AX200 or AX210 to a FeitCSI log.

use super::super::Result;
use super::super::Words;
use super::super::live::{Signals, create_refused};
use super::{Args, Session};
use csi5300::source::recorder::{LogFiles, Recorder};
use csi5300_live::feitcsi::{Command, FeitCsi, Frames};
use csi5300_live::listener::Lost;
use csi5300_live::wait::wall_us;
use std::os::fd::AsFd;

/// Source of FeitCSI's records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Way {
    Input,
    Asked(Command),
}

pub fn source(text: &str) -> Words<Way> {
    match text {
        "-" => Ok(Way::Input),
        _ => text.parse().map(Way::Asked).map_err(|why| format!("{why}, or - for standard input")),
    }
}

/// Records until a signal, a limit or the end of the input.
pub fn run(args: &Args, from: &Way, signals: Signals) -> Result {
    let text = |error: csi5300::source::Error| error.to_string();
    let (frames, words) = match from {
        Way::Input => {
            let input = std::io::stdin().as_fd().try_clone_to_owned();
            let input = input.map_err(|error| format!("standard input: {error}"))?;
            (Frames::read(input, wall_us), "reading FeitCSI's output from standard input".to_owned())
        }
        Way::Asked(command) => {
            let frames = Frames::ask(command, wall_us).map_err(text)?;
            (frames, format!("asked FeitCSI at {} to measure", command.to))
        }
    };
    let files = LogFiles::create_bodies(&args.out, args.rotation(), args.force);
    let files = files.map_err(|error| create_refused(&error))?;
    let mut session = Session::new(args, signals, &frames, false)?;
    note!("{words}; recording to {}", args.out.display());
    let recorder = Recorder::new(frames, files, args.options()).map_err(text)?;
    let mut source = FeitCsi::new(recorder);
    let failed = session.capture(&mut source, |source| (source.frames().totals(), Lost::default())).err();
    let (_, files, totals) = source.into_frames().finish(session.clock.now()).map_err(text)?;
    Ok(session.end(failed, &(String::new(), Lost::default()), &totals, &files))
}
