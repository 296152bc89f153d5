//! Queues between the sending thread and the others. A thread under SCHED_FIFO must not wait or spin for a lock,
//! because the thread that holds it may not run meanwhile. So it takes the lock only if it is free.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

/// What may wait; made at the start.
const CAPACITY: usize = 4_096;

/// A bounded queue that both sides hold.
#[derive(Debug)]
pub(super) struct Mailbox<T> {
    queue: Arc<Mutex<VecDeque<T>>>,
}

impl<T> Clone for Mailbox<T> {
    fn clone(&self) -> Self {
        Self { queue: self.queue.clone() }
    }
}

impl<T> Mailbox<T> {
    pub(super) fn new() -> Self {
        Self { queue: Arc::new(Mutex::new(VecDeque::with_capacity(CAPACITY))) }
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<T>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock_at_once(&self) -> Option<MutexGuard<'_, VecDeque<T>>> {
        match self.queue.try_lock() {
            Ok(queue) => Some(queue),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Puts one in, for an ordinary thread. False if there is no room.
    pub(super) fn put(&self, item: T) -> bool {
        let mut queue = self.lock();
        let has_room = queue.len() < CAPACITY;
        if has_room {
            queue.push_back(item);
        }
        has_room
    }

    /// Takes the oldest out, for an ordinary thread.
    pub(super) fn take(&self) -> Option<T> {
        self.lock().pop_front()
    }

    /// Takes the oldest out, for the sending thread: none if the other side holds the lock.
    pub(super) fn take_at_once(&self) -> Option<T> {
        self.lock_at_once()?.pop_front()
    }
}

/// The sending thread's end of a [`Mailbox`]: keeps items that it cannot hand over at once.
#[derive(Debug)]
pub(super) struct Outbox<T> {
    mailbox: Mailbox<T>,
    held: VecDeque<T>,
    lost: u64,
}

impl<T> Outbox<T> {
    pub(super) fn new(mailbox: &Mailbox<T>) -> Self {
        Self { mailbox: mailbox.clone(), held: VecDeque::with_capacity(CAPACITY), lost: 0 }
    }

    /// Keeps one for the next [`Outbox::flush`]; without room it is lost and counted.
    pub(super) fn put(&mut self, item: T) {
        if self.held.len() < CAPACITY {
            self.held.push_back(item);
        } else {
            self.lost += 1;
        }
    }

    /// Hands over as many as fit, unless the other side holds the lock.
    pub(super) fn flush(&mut self) {
        if self.held.is_empty() {
            return;
        }
        let Some(mut queue) = self.mailbox.lock_at_once() else { return };
        let room = CAPACITY.saturating_sub(queue.len()).min(self.held.len());
        queue.extend(self.held.drain(..room));
    }

    /// The remaining items, and the number of lost ones.
    pub(super) fn finish(self) -> (VecDeque<T>, u64) {
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
