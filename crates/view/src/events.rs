//! Server-sent events for the page.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

/// Limit of waiting events of one page; further ones are dropped, because each event is complete.
const WAITING: usize = 32;
/// Pages that are told at a time.
const LISTENERS: usize = 16;

/// The way to one who listens, and whether it still does.
type Told = (SyncSender<Arc<str>>, Weak<()>);

/// Everyone who listens.
#[derive(Debug, Default)]
pub(crate) struct Events {
    listeners: Mutex<Vec<Told>>,
}

/// One who listens.
#[derive(Debug)]
pub(crate) struct Listener {
    events: Receiver<Arc<str>>,
    _is_here: Arc<()>,
}

impl Listener {
    /// The next event, if one comes within `limit`.
    pub fn wait(&self, limit: Duration) -> Option<Arc<str>> {
        self.events.recv_timeout(limit).ok()
    }
}

impl Events {
    /// A new listener; none if there are too many.
    pub fn listen(&self) -> Option<Listener> {
        let mut listeners = self.listeners.lock().unwrap_or_else(PoisonError::into_inner);
        listeners.retain(|(_, is_here)| is_here.strong_count() > 0);
        if listeners.len() >= LISTENERS {
            return None;
        }
        let ((sender, events), is_here) = (sync_channel(WAITING), Arc::new(()));
        listeners.push((sender, Arc::downgrade(&is_here)));
        Some(Listener { events, _is_here: is_here })
    }

    /// Tells all of them. `json` has no line breaks.
    pub fn tell(&self, event: &str, json: &str) {
        let text: Arc<str> = format!("event: {event}\ndata: {json}\n\n").into();
        let mut listeners = self.listeners.lock().unwrap_or_else(PoisonError::into_inner);
        let is_closed =
            |sender: &SyncSender<_>| matches!(sender.try_send(Arc::clone(&text)), Err(TrySendError::Disconnected(_)));
        listeners.retain(|(sender, _)| !is_closed(sender));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn listeners_are_not_without_number_and_one_that_goes_makes_room() {
        let events = Events::default();
        let mut all: Vec<_> = (0..LISTENERS).map(|_| events.listen().unwrap()).collect();
        assert!(events.listen().is_none());
        drop(all.pop());
        all.push(events.listen().unwrap());
        // One that takes nothing costs its own events only.
        (0..WAITING + 5).for_each(|k| events.tell("rows", &k.to_string()));
        let next = |listener: &Listener| listener.wait(Duration::ZERO);
        assert_eq!(next(&all[0]).as_deref(), Some("event: rows\ndata: 0\n\n"));
        assert_eq!(std::iter::from_fn(|| next(&all[1])).count(), WAITING);
    }
}
