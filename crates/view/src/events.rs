//! What the page is told without asking: server-sent events.

use hyper::body::Bytes;
use std::sync::{Mutex, PoisonError};
use tokio::sync::mpsc::{Receiver, Sender, channel, error::TrySendError};

/// Events that wait for one page; further ones are left out, and each event says the whole of what it is about.
const WAITING: usize = 32;
/// Pages that are told at a time.
const LISTENERS: usize = 16;

/// Everyone who listens.
#[derive(Debug, Default)]
pub(crate) struct Events {
    listeners: Mutex<Vec<Sender<Bytes>>>,
}

impl Events {
    /// A new listener; none if there are too many.
    pub fn listen(&self) -> Option<Receiver<Bytes>> {
        let mut listeners = self.listeners.lock().unwrap_or_else(PoisonError::into_inner);
        listeners.retain(|listener| !listener.is_closed());
        if listeners.len() >= LISTENERS {
            return None;
        }
        let (sender, receiver) = channel(WAITING);
        listeners.push(sender);
        Some(receiver)
    }

    /// Tells all of them. `json` has no line breaks.
    pub fn tell(&self, event: &str, json: &str) {
        let text = Bytes::from(format!("event: {event}\ndata: {json}\n\n"));
        let mut listeners = self.listeners.lock().unwrap_or_else(PoisonError::into_inner);
        listeners.retain(|listener| !matches!(listener.try_send(text.clone()), Err(TrySendError::Closed(_))));
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
        let first = all[0].try_recv().unwrap();
        assert_eq!(&first[..], b"event: rows\ndata: 0\n\n");
        assert_eq!(std::iter::from_fn(|| all[1].try_recv().ok()).count(), WAITING);
    }
}
