//! The sending thread: its priority, its waits, and its queues.

use super::Opened;
use super::exchange::{Exchange, News};
use super::sessions::PeerSessions;
use crate::monitor::Monitor;
use crate::wait::Monotonic;
use crate::{refused, sys};
use csi5300::source::Error;
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::prctl::set_timerslack;
use std::collections::VecDeque;
use std::io::{PipeReader, PipeWriter};
use std::os::fd::AsFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread::JoinHandle;

/// System settings, and the end.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Priority under SCHED_FIFO, 1 to 99; `None` leaves the ordinary scheduler.
    pub fifo_priority: Option<i32>,
    /// The thread ends by itself at this time.
    pub stop_at: Option<Instant>,
}

impl Default for Settings {
    /// Priority 50, as interrupt threads have, and no end.
    fn default() -> Self {
        Self { fifo_priority: Some(50), stop_at: None }
    }
}

/// An exchange that runs.
#[derive(Debug)]
pub struct Running {
    thread: JoinHandle<Ended>,
    stop: PipeWriter,
    measured: Arc<Mailbox<(Mac, Measurement)>>,
    news: Arc<Mailbox<News>>,
    heard: Mutex<PeerSessions>,
}

/// The result of a thread.
struct Ended {
    exchange: Exchange<Monitor>,
    error: Option<Error>,
    news: Outbox<News>,
}

impl Running {
    /// Starts the thread. It takes over what signals are blocked here.
    ///
    /// # Errors
    /// If pipe or thread cannot be created.
    pub fn start(opened: Opened, clock: Monotonic, settings: Settings) -> Result<Self, Error> {
        let what = "cannot start the thread that sends";
        let (stopped, stop) = std::io::pipe().map_err(Error::io(what))?;
        let (measured, news) = (Mailbox::new(), Mailbox::new());
        let (to_carry, told) = (Arc::clone(&measured), Outbox::new(&news));
        let mut exchange = Exchange::new(opened.tdma, opened.monitor);
        exchange.stop_at = settings.stop_at;
        let work = move || run(exchange, clock, settings, &stopped, &to_carry, told);
        let thread = std::thread::Builder::new().name("csi5300 sender".into()).spawn(work).map_err(Error::io(what))?;
        Ok(Self { thread, stop, measured, news, heard: Mutex::new(opened.heard) })
    }

    /// Hands over this robot's measurement of a forward frame of that peer, for the next answer to it. Where too many wait it is
    /// dropped: the next one is newer.
    pub fn carry(&self, peer: Mac, measurement: Measurement) {
        self.measured.put((peer, measurement));
    }

    /// The next news, if there are any.
    pub fn news(&self) -> Option<News> {
        let news = self.news.take();
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        match &news {
            Some(news) => heard.note(news),
            None => heard.keep_if_due(),
        }
        news
    }

    /// True if the thread has ended by itself: its time is up, or its interface failed.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Stops the thread; returns the exchange, unfetched news, the number of lost news, and the error that ended it, if
    /// any.
    ///
    /// # Errors
    /// If the thread panicked.
    #[allow(clippy::type_complexity)]
    pub fn stop(self) -> Result<(Exchange<Monitor>, Vec<News>, u64, Option<Error>), Error> {
        drop(self.stop);
        let ended = self.thread.join().map_err(|_| refused("the thread that sends has panicked"))?;
        let left = std::iter::from_fn(|| self.news.take()).collect::<Vec<_>>();
        let (held, lost) = ended.news.finish();
        let left: Vec<News> = left.into_iter().chain(held).collect();
        let mut heard = self.heard.into_inner().unwrap_or_else(PoisonError::into_inner);
        left.iter().for_each(|news| heard.note(news));
        heard.keep();
        Ok((ended.exchange, left, lost, ended.error))
    }
}

/// Requests what makes the thread punctual; says what the system granted, or why not.
fn ask(settings: Settings) -> String {
    // Without SCHED_FIFO timers may be 50 us late to save power.
    let _ = set_timerslack(1);
    // Only current memory: with MCL_FUTURE a later bearing could hit the limit and abort.
    let locked = match mlockall(MlockAllFlags::MCL_CURRENT) {
        Ok(()) => ", memory locked".to_owned(),
        Err(errno) => format!("; memory not locked ({})", std::io::Error::from(errno)),
    };
    let fifo = settings.fifo_priority.map(sys::schedule_fifo);
    let fifo = fifo.map_or_else(|| Err("as asked for".into()), |asked| asked.map_err(|error| error.to_string()));
    match fifo {
        Ok(()) => format!("sending under SCHED_FIFO{locked}"),
        Err(why) => format!("sending under the ordinary scheduler ({why}); slots will be missed under load{locked}"),
    }
}

fn run(
    mut exchange: Exchange<Monitor>,
    clock: Monotonic,
    settings: Settings,
    stopped: &PipeReader,
    measured: &Mailbox<(Mac, Measurement)>,
    mut news: Outbox<News>,
) -> Ended {
    news.put(News::Started(ask(settings)));
    let error = loop {
        while let Some((peer, measurement)) = measured.take_at_once() {
            // A frame that was not for this robot, or a robot that is no peer: nothing to be done about it.
            let _ = exchange.tdma.set_measurement(peer, measurement);
        }
        if exchange.is_over(clock.now()) {
            break None;
        }
        let stepped = exchange.step(&|| clock.now(), &mut |told| news.put(told));
        news.flush();
        let waited = stepped.and_then(|until| {
            clock.wait_closely([exchange.air.as_fd(), stopped.as_fd()], until, exchange.tdma.transmit_at())
        });
        match waited {
            Ok([_, false]) => {}
            Ok([_, true]) => break None,
            Err(error) => break Some(error),
        }
    };
    Ended { exchange, error, news }
}

/// What may wait; made at the start.
const CAPACITY: usize = 4_096;

/// A bounded queue that both sides hold.
///
/// A thread under SCHED_FIFO must not wait or spin for a lock, because the thread that holds it may not run meanwhile. So
/// it takes the lock only if it is free.
#[derive(Debug)]
struct Mailbox<T>(Mutex<VecDeque<T>>);

impl<T> Mailbox<T> {
    fn new() -> Arc<Self> {
        Arc::new(Self(Mutex::new(VecDeque::with_capacity(CAPACITY))))
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock_at_once(&self) -> Option<MutexGuard<'_, VecDeque<T>>> {
        match self.0.try_lock() {
            Ok(queue) => Some(queue),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Puts one in, for an ordinary thread. False if there is no room.
    fn put(&self, item: T) -> bool {
        let mut queue = self.lock();
        let has_room = queue.len() < CAPACITY;
        if has_room {
            queue.push_back(item);
        }
        has_room
    }

    /// Takes the oldest out, for an ordinary thread.
    fn take(&self) -> Option<T> {
        self.lock().pop_front()
    }

    /// Takes the oldest out, for the sending thread: none if the other side holds the lock.
    fn take_at_once(&self) -> Option<T> {
        self.lock_at_once()?.pop_front()
    }
}

/// The sending thread's end of a [`Mailbox`]: keeps items that it cannot hand over at once.
#[derive(Debug)]
struct Outbox<T> {
    mailbox: Arc<Mailbox<T>>,
    held: VecDeque<T>,
    lost: u64,
}

impl<T> Outbox<T> {
    fn new(mailbox: &Arc<Mailbox<T>>) -> Self {
        Self { mailbox: Arc::clone(mailbox), held: VecDeque::with_capacity(CAPACITY), lost: 0 }
    }

    /// Keeps one for the next [`Outbox::flush`]; without room it is lost and counted.
    fn put(&mut self, item: T) {
        if self.held.len() < CAPACITY {
            self.held.push_back(item);
        } else {
            self.lost += 1;
        }
    }

    /// Hands over as many as fit, unless the other side holds the lock.
    fn flush(&mut self) {
        if self.held.is_empty() {
            return;
        }
        let Some(mut queue) = self.mailbox.lock_at_once() else { return };
        let room = CAPACITY.saturating_sub(queue.len()).min(self.held.len());
        queue.extend(self.held.drain(..room));
    }

    /// The remaining items, and the number of lost ones.
    fn finish(self) -> (VecDeque<T>, u64) {
        (self.held, self.lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thread_that_sends_never_waits_for_the_other_side() {
        let mailbox = Mailbox::new();
        let mut outbox = Outbox::new(&mailbox);
        outbox.put(1);
        let held = mailbox.lock();
        outbox.flush();
        assert_eq!(mailbox.take_at_once(), None::<i32>);
        drop(held);
        outbox.put(2);
        outbox.flush();
        assert_eq!([mailbox.take(), mailbox.take_at_once(), mailbox.take()], [Some(1), Some(2), None]);
    }

    #[test]
    fn nothing_grows_and_what_has_no_room_is_counted() {
        let mailbox = Mailbox::new();
        let mut outbox = Outbox::new(&mailbox);
        for item in 0..CAPACITY + 3 {
            outbox.put(item);
        }
        outbox.flush();
        assert!(!mailbox.put(9), "full");
        outbox.put(7);
        outbox.flush();
        assert_eq!(mailbox.take(), Some(0));
        assert_eq!(outbox.finish(), (VecDeque::from([7]), 3));
    }
}
