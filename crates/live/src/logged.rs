//! A source whose records also go to a log, or do not.

use csi5300::source::recorder::{LogFiles, Options, Recorder, Totals};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;

/// A source, with a log of everything or without.
pub enum Logged<S> {
    /// Not logged.
    Plain(S),
    /// Logged.
    Recorded(Box<Recorder<S, LogFiles>>),
}

impl<S: CsiSource> Logged<S> {
    /// A source whose records go to these files, if there are any.
    ///
    /// # Errors
    /// If the recorder's thread cannot be started.
    pub fn new(source: S, files: Option<LogFiles>) -> Result<Self, Error> {
        let Some(files) = files else { return Ok(Self::Plain(source)) };
        Ok(Self::Recorded(Box::new(Recorder::new(source, files, Options::default())?)))
    }

    /// The source.
    pub fn source(&self) -> &S {
        match self {
            Self::Plain(source) => source,
            Self::Recorded(recorder) => recorder.source(),
        }
    }

    /// What is in the log.
    pub fn totals(&self) -> Option<Totals> {
        match self {
            Self::Plain(_) => None,
            Self::Recorded(recorder) => Some(recorder.totals()),
        }
    }

    /// Ends the log with every record in it; returns the source and what is in the log.
    ///
    /// # Errors
    /// If the writer died.
    pub fn finish(self, now: Instant) -> Result<(S, Option<Totals>), Error> {
        match self {
            Self::Plain(source) => Ok((source, None)),
            Self::Recorded(recorder) => recorder.finish(now).map(|(source, _, totals)| (source, Some(totals))),
        }
    }
}

impl<S: CsiSource> CsiSource for Logged<S> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self {
            Self::Plain(source) => source.receive(now),
            Self::Recorded(recorder) => recorder.receive(now),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        match self {
            Self::Plain(source) => source.next_at(),
            Self::Recorded(recorder) => recorder.next_at(),
        }
    }
}
