//! The CSI driver's messages while robots sound: not listened to, only read, or recorded as well.

use crate::netlink::Netlink;
use csi5300::source::recorder::{LogFiles, Options, Recorder, Totals};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use std::os::fd::{AsFd, OwnedFd};

/// Where the driver's messages come from, and whether they are recorded.
pub struct DriverMessages(Kind);

enum Kind {
    None,
    Read(Box<Netlink>),
    Recorded(Box<Recorder<Netlink, LogFiles>>),
}

/// What became of a recorded log.
#[derive(Clone, Debug)]
pub struct LogTotals {
    /// What was recorded.
    pub recorded: Totals,
    /// Records that the kernel dropped before they were read.
    pub dropped_before: u64,
}

impl LogTotals {
    /// Records that the driver sent and the log does not have.
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
    pub fn read(listener: Netlink) -> Self {
        Self(Kind::Read(Box::new(listener)))
    }

    /// They are read, and recorded in `files`.
    ///
    /// # Errors
    /// If the recorder's thread cannot be started.
    pub fn recorded(listener: Netlink, files: LogFiles) -> Result<Self, Error> {
        Ok(Self(Kind::Recorded(Box::new(Recorder::new(listener, files, Options::default())?))))
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
        let io = |source| Error::Io { what: "the connector socket".into(), source };
        fd.try_clone_to_owned().map(Some).map_err(io)
    }

    /// Ends the log, if there is one.
    pub(super) fn finish(self, now: Instant) -> Result<Option<LogTotals>, Error> {
        let Kind::Recorded(recorder) = self.0 else { return Ok(None) };
        let (listener, _, recorded) = recorder.finish(now)?;
        let counters = listener.counters();
        let dropped_before = counters.kernel_drops.max(counters.overrun_bfee_gap) + counters.other_bfee_gap;
        Ok(Some(LogTotals { recorded, dropped_before }))
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
        if let Kind::Recorded(recorder) = &self.0 { recorder.next_at() } else { None }
    }
}
