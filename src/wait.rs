//! The clocks of this machine, and waiting on them: for programs that drive live or paced sources.
//!
//! Everything below is handed the time; here is where it comes from.

use crate::backend::Error;
use crate::time::Instant;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// The host's monotonic clock, from the moment this was made.
#[derive(Clone, Copy, Debug)]
pub struct Monotonic {
    origin: std::time::Instant,
}

impl Default for Monotonic {
    fn default() -> Self {
        Self::new()
    }
}

impl Monotonic {
    /// A clock that shows zero now.
    #[must_use]
    pub fn new() -> Self {
        Self { origin: std::time::Instant::now() }
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::from_us(i64::try_from(self.origin.elapsed().as_micros()).unwrap_or(i64::MAX))
    }

    /// Sleeps until one of `fds` is readable or in error, or until `until`. Gives which ones are.
    ///
    /// An interrupting signal ends the wait early, with none ready.
    ///
    /// # Errors
    /// If the kernel refuses to poll.
    pub fn wait<const N: usize>(&self, fds: [BorrowedFd<'_>; N], until: Option<Instant>) -> Result<[bool; N], Error> {
        let left = until.map(|until| {
            let us = (until - self.now()).as_us().max(0);
            TimeSpec::from_duration(Duration::from_micros(us.cast_unsigned()))
        });
        let mut polled = fds.map(|fd| PollFd::new(fd, PollFlags::POLLIN));
        match ppoll(&mut polled, left, None) {
            Ok(_) => Ok(polled.map(|fd| fd.any().unwrap_or(true))),
            Err(nix::errno::Errno::EINTR) => Ok([false; N]),
            Err(errno) => Err(Error::Io { what: "waiting for records".into(), source: errno.into() }),
        }
    }
}

/// The host's wall clock, microseconds since the Unix epoch; `None` before it.
#[must_use]
pub fn wall_us() -> Option<i64> {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).ok()?;
    i64::try_from(since.as_micros()).ok()
}

/// Processor time that this process has used so far, seconds.
#[cfg(feature = "node")]
#[must_use]
pub fn processor_s() -> f64 {
    let Ok(used) = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF) else { return 0.0 };
    let seconds = |time: nix::sys::time::TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    seconds(used.user_time()) + seconds(used.system_time())
}
