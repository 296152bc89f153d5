//! The card's records while robots sound: ignored, read, or read and recorded.

use crate::listener::Listener;
use csi5300::source::recorder::{LogFiles, Options, Recorder, Totals};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use std::os::fd::{AsFd, OwnedFd};

/// The source of the card's records, and their log.
pub struct DriverMessages(Kind);

enum Kind {
    None,
    Read(Listener),
    Recorded(Box<Recorder<Listener, LogFiles>>),
}

/// The result of a recorded log.
#[derive(Clone, Debug)]
pub struct LogTotals {
    /// What was recorded.
    pub recorded: Totals,
    /// Records that were lost before they were read.
    pub dropped_before: u64,
}

impl LogTotals {
    /// Records of the card that the log does not have.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.recorded.dropped + self.recorded.lost_on_disk + self.dropped_before
    }
}

impl DriverMessages {
    /// The driver is not listened to.
    #[must_use]
    pub fn none() -> Self {
        Self(Kind::None)
    }

    /// They are read.
    #[must_use]
    pub fn read(listener: impl Into<Listener>) -> Self {
        Self(Kind::Read(listener.into()))
    }

    /// They are read, and recorded in `files`.
    ///
    /// # Errors
    /// If the recorder's thread cannot be started.
    pub fn recorded(listener: impl Into<Listener>, files: LogFiles) -> Result<Self, Error> {
        Ok(Self(Kind::Recorded(Box::new(Recorder::new(listener.into(), files, Options::default())?))))
    }

    pub(super) fn is_recorded(&self) -> bool {
        matches!(self.0, Kind::Recorded(_))
    }

    /// Something to wait on, where there is a listener.
    pub(super) fn fd(&self) -> Result<Option<OwnedFd>, Error> {
        let fd = match &self.0 {
            Kind::None => return Ok(None),
            Kind::Read(listener) => listener.as_fd(),
            Kind::Recorded(recorder) => recorder.source().as_fd(),
        };
        let io = |source| Error::Io { what: "what is listened to".into(), source };
        fd.try_clone_to_owned().map(Some).map_err(io)
    }

    /// Ends the log, if there is one.
    pub(super) fn finish(self, now: Instant) -> Result<Option<LogTotals>, Error> {
        let Kind::Recorded(recorder) = self.0 else { return Ok(None) };
        let (listener, _, recorded) = recorder.finish(now)?;
        Ok(Some(LogTotals { recorded, dropped_before: listener.lost().total() }))
    }
}

impl CsiSource for DriverMessages {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match &mut self.0 {
            Kind::None => Ok(Next::Pending),
            Kind::Read(listener) => listener.receive(now),
            Kind::Recorded(recorder) => recorder.receive(now),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        match &self.0 {
            Kind::None => None,
            Kind::Read(listener) => listener.next_at(),
            Kind::Recorded(recorder) => recorder.next_at(),
        }
    }
}
