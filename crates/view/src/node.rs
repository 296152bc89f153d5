//! The states of a running node, as its status socket gives them, a line of JSON a look; and server-sent events for the page.

use crate::Error;
use csi5300::internal::lock;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

/// States kept for a page that comes later.
const KEPT: usize = 1_200;
/// Limit of a state, bytes.
const LONGEST: u64 = 1 << 20;
/// From the end of a connection to the next try.
const AGAIN: Duration = Duration::from_secs(1);

/// What a node said.
pub(crate) struct Node {
    path: PathBuf,
    said: Mutex<VecDeque<Arc<str>>>,
}

impl Node {
    /// A node whose socket is there, and its states from then on. Whenever it ends it is waited for.
    ///
    /// # Errors
    /// If the socket has no listener, or the thread cannot be started.
    pub fn open(path: &Path, events: Weak<Events>) -> Result<Arc<Self>, Error> {
        let silent = |source: std::io::Error| {
            let path = path.display();
            Error::Words(format!("{path}: {source}; does the node run, and is this its `output.status_socket`?"))
        };
        let stream = UnixStream::connect(path).map_err(silent)?;
        let node = Arc::new(Self { path: path.to_owned(), said: Mutex::default() });
        let of = Arc::downgrade(&node);
        let listen = move || listen(&of, &events, Some(stream));
        let thread = std::thread::Builder::new().name("csi5300 node".into()).spawn(listen);
        thread.map_err(|source| Error::start("the thread that listens to the node", &source))?;
        Ok(node)
    }

    fn keep(&self, state: &str) {
        let mut said = lock(&self.said);
        if said.len() >= KEPT {
            said.pop_front();
        }
        said.push_back(state.into());
    }

    /// All states that are kept, a JSON array.
    pub fn states(&self) -> Vec<u8> {
        let said = lock(&self.said);
        let all: Vec<&str> = said.iter().map(AsRef::as_ref).collect();
        format!("[{}]", all.join(",")).into_bytes()
    }
}

/// Hears the node for as long as somebody has it.
fn listen(node: &Weak<Node>, events: &Weak<Events>, mut stream: Option<UnixStream>) {
    loop {
        if let Some(stream) = stream.take() {
            hear(node, events, stream);
        }
        let (Some(node), Some(events)) = (node.upgrade(), events.upgrade()) else { return };
        events.tell("silent", "{}");
        drop(events);
        std::thread::sleep(AGAIN);
        stream = UnixStream::connect(&node.path).ok();
    }
}

/// Hears one connection until it ends.
fn hear(node: &Weak<Node>, events: &Weak<Events>, stream: impl Read) {
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    loop {
        line.clear();
        match (&mut reader).take(LONGEST).read_line(&mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let (Some(node), Some(events)) = (node.upgrade(), events.upgrade()) else { return };
        // What is no JSON object would end the page's reading.
        let text = line.trim();
        if serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(text).is_ok() {
            node.keep(text);
            events.tell("state", text);
        }
    }
}

/// Limit of waiting events of one page; further ones are dropped, because each event is complete.
const WAITING: usize = 32;
/// Pages that are told at a time.
const LISTENERS: usize = 16;

/// Everyone who listens.
#[derive(Debug, Default)]
pub(crate) struct Events(Mutex<Vec<SyncSender<Arc<str>>>>);

impl Events {
    /// A new listener; none if there are too many.
    pub fn listen(&self) -> Option<Receiver<Arc<str>>> {
        // A comment, which pages ignore: who has gone does not take it.
        self.send(":\n\n");
        let mut listeners = lock(&self.0);
        if listeners.len() >= LISTENERS {
            return None;
        }
        let (sender, events) = sync_channel(WAITING);
        listeners.push(sender);
        Some(events)
    }

    /// Tells all of them. `json` has no line breaks.
    pub fn tell(&self, event: &str, json: &str) {
        self.send(&format!("event: {event}\ndata: {json}\n\n"));
    }

    fn send(&self, text: &str) {
        let text: Arc<str> = text.into();
        let is_closed =
            |sender: &SyncSender<_>| matches!(sender.try_send(Arc::clone(&text)), Err(TrySendError::Disconnected(_)));
        lock(&self.0).retain(|sender| !is_closed(sender));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_told_and_kept_and_what_is_none_is_left_out() {
        let events = Arc::new(Events::default());
        let page = events.listen().unwrap();
        let node = Arc::new(Node { path: PathBuf::new(), said: Mutex::default() });
        let said = "{\"name\":\"a\"}\n\nno state\n[1]\n{\"name\":\"b\"}\n";
        hear(&Arc::downgrade(&node), &Arc::downgrade(&events), said.as_bytes());
        assert_eq!(node.states(), br#"[{"name":"a"},{"name":"b"}]"#);
        let told: Vec<String> = page.try_iter().map(|event| event.to_string()).collect();
        assert_eq!(told, ["event: state\ndata: {\"name\":\"a\"}\n\n", "event: state\ndata: {\"name\":\"b\"}\n\n"]);
    }

    #[test]
    fn the_oldest_states_are_forgotten() {
        let node = Node { path: PathBuf::new(), said: Mutex::default() };
        (0..KEPT + 3).for_each(|k| node.keep(&k.to_string()));
        assert!(node.states().starts_with(b"[3,4,"));
    }

    #[test]
    fn listeners_are_not_without_number_and_one_that_goes_makes_room() {
        let events = Events::default();
        let mut all: Vec<_> = (0..LISTENERS).map(|_| events.listen().unwrap()).collect();
        assert!(events.listen().is_none());
        drop(all.pop());
        all.push(events.listen().unwrap());
        // One that takes nothing costs its own events only.
        (0..WAITING + 5).for_each(|k| events.tell("rows", &k.to_string()));
        let mut told = all[0].try_iter().filter(|event| !event.starts_with(':'));
        assert_eq!(told.next().as_deref(), Some("event: rows\ndata: 0\n\n"));
        assert_eq!(all[1].try_iter().count(), WAITING);
    }
}
