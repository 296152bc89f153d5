//! The clocks of this machine and waits on them, for programs that drive live or paced sources.
//!
//! The library takes the time as an argument; it is read here.

use csi5300::source::Error;
use csi5300::time::{Instant, Span};
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

/// A wait for a deadline watches files until this long before it, and then sleeps until the deadline.
const NEAR: Span = Span::from_us(300);

/// The host's monotonic clock, from the moment this was made.
#[derive(Clone, Copy, Debug)]
pub struct Monotonic {
    /// CLOCK_MONOTONIC at that moment, nanoseconds.
    origin_ns: i64,
}

/// CLOCK_MONOTONIC, which every Linux has, nanoseconds.
pub(crate) fn monotonic_ns() -> i64 {
    clock_gettime(ClockId::CLOCK_MONOTONIC).map_or(0, |now| now.tv_sec() * 1_000_000_000 + now.tv_nsec())
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
        Self { origin_ns: monotonic_ns() }
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::from_us((monotonic_ns() - self.origin_ns) / 1_000)
    }

    /// Sleeps until `until` on the absolute clock (clock_nanosleep), so that delays before the call do not add up. A
    /// signal ends it early.
    pub fn sleep_until(&self, until: Instant) {
        let at_ns = until.as_us().saturating_mul(1_000).saturating_add(self.origin_ns).max(0);
        let at = TimeSpec::new(at_ns / 1_000_000_000, at_ns % 1_000_000_000);
        let _ = clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at);
    }

    /// As [`Monotonic::wait`], with a deadline `point` to meet closely: it sleeps through the last 300 us before it,
    /// unless something is readable at their start.
    ///
    /// # Errors
    /// If the kernel refuses to poll.
    pub fn wait_closely<const N: usize>(
        &self,
        fds: [BorrowedFd<'_>; N],
        until: Option<Instant>,
        point: Option<Instant>,
    ) -> Result<[bool; N], Error> {
        let near = |point: &Instant| until.is_none_or(|until| until >= *point - NEAR);
        let Some(point) = point.filter(near) else { return self.wait(fds, until) };
        // Polls the files at least once, however near the deadline is.
        let ready = self.wait(fds, Some(point - NEAR))?;
        if ready.contains(&true) || self.now() < point - NEAR {
            return Ok(ready);
        }
        self.sleep_until(point);
        Ok([false; N])
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
            Err(errno) => Err(Error::io("waiting for records")(errno)),
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
#[must_use]
pub fn processor_s() -> f64 {
    let Ok(used) = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF) else { return 0.0 };
    let seconds = |time: nix::sys::time::TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    seconds(used.user_time()) + seconds(used.system_time())
}

/// True for a signal that this program was started to ignore, as SIGHUP under `nohup`: by the mask in `/proc/self/status`.
///
/// Call it before the program changes the signal's action.
#[must_use]
pub fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal as i32 - 1) & 1 == 1
}

/// SIGINT, SIGTERM and SIGHUP as a file descriptor; without SIGHUP if it is ignored, as under `nohup`.
#[derive(Debug)]
pub struct Signals {
    fd: SignalFd,
}

impl Signals {
    /// Blocks these signals, also for later threads.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn catch() -> std::io::Result<Self> {
        Self::catch_with(&[])
    }

    /// The same with `more` signals.
    ///
    /// # Errors
    /// As [`Signals::catch`].
    pub fn catch_with(more: &[Signal]) -> std::io::Result<Self> {
        // The others also end a recording in the background, for which shells ignore them.
        let hangup = Some(Signal::SIGHUP).filter(|hangup| !is_ignored(*hangup));
        let set = SigSet::from_iter([Signal::SIGINT, Signal::SIGTERM].iter().chain(more).copied().chain(hangup));
        let blocked = set
            .thread_block()
            .and_then(|()| SignalFd::with_flags(&set, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC));
        blocked.map(|fd| Self { fd }).map_err(|errno| std::io::Error::other(format!("cannot catch signals: {errno}")))
    }

    /// Takes pending signals, so that no other wait ends by them.
    pub fn take(&self) {
        while let Ok(Some(_)) = self.fd.read_signal() {}
    }
}

impl AsFd for Signals {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

/// A reader that takes nothing for this time is given up once the program was told to end.
const PATIENCE: Duration = Duration::from_secs(5);

/// Standard output for records. Without it a reader that stands still would keep a program from its signals.
#[derive(Debug)]
pub struct Output {
    out: File,
    signals: OwnedFd,
    patience: Duration,
}

impl Output {
    /// Standard output, given up if its reader takes nothing and one of the signals came.
    ///
    /// # Errors
    /// If the system gives no descriptors for it.
    pub fn new(signals: &Signals) -> io::Result<Self> {
        let out = io::stdout().as_fd().try_clone_to_owned()?.into();
        Ok(Self { out, signals: signals.as_fd().try_clone_to_owned()?, patience: PATIENCE })
    }

    fn is_over(&self) -> bool {
        Monotonic::new().wait([self.signals.as_fd()], Some(Instant::ZERO)).is_ok_and(|[came]| came)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // A pipe with room takes this many without waiting.
        let part = bytes.get(..bytes.len().min(libc::PIPE_BUF)).unwrap_or_default();
        loop {
            let mut polled = [PollFd::new(self.out.as_fd(), PollFlags::POLLOUT)];
            match ppoll(&mut polled, Some(TimeSpec::from_duration(self.patience)), None) {
                Ok(0) if self.is_over() => {
                    return Err(io::Error::new(ErrorKind::TimedOut, "its reader takes nothing"));
                }
                Ok(0) | Err(nix::errno::Errno::EINTR) => {}
                Ok(_) => match self.out.write(part) {
                    Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                    done => return done,
                },
                Err(errno) => return Err(errno.into()),
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_takes_nothing_keeps_no_program_that_was_told_to_end() {
        let (mut reader, out) = io::pipe().unwrap();
        let (signals, mut tell) = io::pipe().unwrap();
        let (out, patience) = (File::from(OwnedFd::from(out)), Duration::ZERO);
        let mut out = Output { out, signals: signals.into(), patience };
        let record = vec![7; 3 * libc::PIPE_BUF];
        out.write_all(&record).unwrap();
        let mut read = vec![0; record.len()];
        io::Read::read_exact(&mut reader, &mut read).unwrap();
        assert_eq!(read, record);
        tell.write_all(&[0]).unwrap();
        let given_up = std::iter::repeat_with(|| out.write(&record)).find_map(Result::err).unwrap();
        assert_eq!(given_up.kind(), ErrorKind::TimedOut);
        io::Read::read_exact(&mut reader, &mut read).unwrap();
        assert!(out.write(&record).is_ok(), "a reader that takes something is waited for");
        drop(reader);
        assert_eq!(out.write(&record).unwrap_err().kind(), ErrorKind::BrokenPipe);
    }
}
