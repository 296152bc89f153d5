//! A sounding session: the sender's thread, the driver's messages, and the program's observer.

use super::messages::{DriverMessages, LogTotals};
use super::{Exchange, News, Opened, Running, Settings};
use crate::monitor::{AirCounts, Monitor};
use crate::wait::Monotonic;
use csi5300::exchange::tdma::TdmaCounts;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use std::os::fd::{AsFd, BorrowedFd};

/// Interval at which news are fetched and [`Observer::look`] is called.
const LOOK: Span = Span::from_ms(50);
/// Longest time to read the driver after the end.
const LAST_WORDS: Span = Span::from_ms(500);

/// A program's reactions. The default methods do nothing.
pub trait Observer {
    /// An item of the driver. `running` takes orders.
    fn record(&mut self, next: &Next<'_>, running: &Running) {
        let _ = (next, running);
    }

    /// News of the sender's thread.
    fn news(&mut self, news: &News) {
        let _ = news;
    }

    /// Called every 50 ms and after all available items.
    fn look(&mut self, now: Instant, running: &Running) {
        let _ = (now, running);
    }
}

/// The end of a session, and its system settings.
#[derive(Clone, Copy, Debug)]
pub struct Session<'a> {
    clock: Monotonic,
    stop: BorrowedFd<'a>,
    stop_at: Option<Instant>,
    settings: Settings,
}

/// The result of a session.
#[derive(Debug)]
pub struct Finished {
    /// The machine with its counts, the interface with its counters, and how punctual the host was.
    pub exchange: Exchange<Monitor>,
    /// Counts of the interface.
    pub air: AirCounts,
    /// News that were lost because they were not fetched in time.
    pub news_lost: u64,
    /// The log, where there was one.
    pub log: Option<LogTotals>,
    /// The error that ended the session, if any.
    pub error: Option<Error>,
}

impl<'a> Session<'a> {
    /// A session on `clock` that ends when `stop` is readable: a signal's file descriptor, the reading end of a pipe.
    #[must_use]
    pub fn new(clock: Monotonic, stop: BorrowedFd<'a>) -> Self {
        Self { clock, stop, stop_at: None, settings: Settings::default() }
    }

    /// It also ends at this optional time; the sending thread does so by itself, however long an [`Observer`] takes.
    #[must_use]
    pub fn with_stop_at(mut self, stop_at: Option<Instant>) -> Self {
        self.stop_at = stop_at;
        self
    }

    /// The system settings of the sender's thread; its end is the session's.
    #[must_use]
    pub fn with_settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// Sounds until it is stopped, the time is up, or the interface or the listener fails.
    ///
    /// # Errors
    /// If it cannot be started, waited for or ended. A failure while it runs is in [`Finished::error`].
    pub fn run(
        &self,
        opened: Opened,
        mut messages: DriverMessages,
        observer: &mut dyn Observer,
    ) -> Result<Finished, Error> {
        let connector = messages.fd()?;
        let settings = Settings { stop_at: self.stop_at, ..self.settings };
        let running = Running::start_opened(opened, self.clock, settings)?;
        let failed = loop {
            if let Err(error) = take(&mut messages, self.clock.now(), &running, observer) {
                break Some(error);
            }
            while let Some(news) = running.news() {
                observer.news(&news);
            }
            let now = self.clock.now();
            observer.look(now, &running);
            if running.has_ended() || self.stop_at.is_some_and(|end| end <= now) {
                break None;
            }
            let until = [messages.next_at(), self.stop_at, Some(now + LOOK)].into_iter().flatten().min();
            // Without a listener this waits for the stop twice.
            let first = connector.as_ref().map_or(self.stop, |fd| fd.as_fd());
            if self.clock.wait([first, self.stop], until)?[1] {
                break None;
            }
        };
        self.end(running, messages, failed, observer)
    }

    fn end(
        &self,
        running: Running,
        mut messages: DriverMessages,
        mut failed: Option<Error>,
        observer: &mut dyn Observer,
    ) -> Result<Finished, Error> {
        let (mut exchange, left, news_lost, error) = running.stop()?;
        left.iter().for_each(|news| observer.news(news));
        // Messages sent before the end belong in the log. A driver without pauses does not delay the end.
        let enough_at = self.clock.now() + LAST_WORDS;
        while failed.is_none() && messages.is_recorded() && self.clock.now() < enough_at {
            match messages.receive(self.clock.now()) {
                Ok(Next::Pending | Next::End(_)) => break,
                Ok(_) => {}
                Err(error) => failed = Some(error),
            }
        }
        let log = messages.finish(self.clock.now())?;
        Ok(Finished { air: exchange.air.counters(), exchange, news_lost, log, error: failed.or(error) })
    }
}

/// Takes everything that the driver has sent.
fn take(
    messages: &mut DriverMessages,
    now: Instant,
    running: &Running,
    observer: &mut dyn Observer,
) -> Result<(), Error> {
    loop {
        let next = messages.receive(now)?;
        if matches!(next, Next::Pending | Next::End(_)) {
            return Ok(());
        }
        observer.record(&next, running);
    }
}

impl Finished {
    /// Counts of the machine.
    #[must_use]
    pub fn counts(&self) -> &TdmaCounts {
        self.exchange.tdma.counts()
    }

    /// True if frames were not taken, records are not in the log, or something failed.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        self.air.not_taken() > 0 || self.error.is_some() || self.log.as_ref().is_some_and(|log| log.missing() > 0)
    }

    /// Frames that the machine sent: forward frames and answers.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.counts().forward + self.counts().replies
    }

    /// Of these, those that the kernel reports as failed.
    #[must_use]
    pub fn reported_failed(&self) -> u64 {
        self.air.tx_failed.min(self.sent())
    }

    /// Of these, those that the kernel reports as sent.
    #[must_use]
    pub fn confirmed(&self) -> u64 {
        self.air.tx_status.saturating_sub(self.air.tx_failed).min(self.sent())
    }
}
