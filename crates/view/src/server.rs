//! HTTP for browsers on this machine: a connection is one request, on a thread of its own.

use crate::events::Listener;
use crate::guard::{Asked, admit};
use crate::{Answer, Error, View};
use nix::sys::signal::{SigSet, Signal};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// Connections at a time; a browser opens six for one page.
const CONNECTIONS: usize = 64;
/// Usual time limit for a request's head, and for a browser that reads nothing.
const PATIENCE: Duration = Duration::from_secs(20);
/// Bytes of a request's head at most, and fields in it.
const HEAD: usize = 16 * 1024;
const FIELDS: usize = 64;
/// How often is looked after a page that events are sent to.
const LOOK: Duration = Duration::from_secs(1);
/// Pause when no more connections can be accepted.
const NO_DESCRIPTORS: Duration = Duration::from_millis(500);
/// What the page may load: itself. Scripts and styles are files of their own.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The signals that end the page: SIGINT, SIGTERM and, where that is wanted, SIGHUP.
#[derive(Debug)]
pub struct Ends(SigSet);

impl Ends {
    /// From here on they end nothing by themselves. Threads started later inherit that.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn catch(hangup: bool) -> Result<Self, Error> {
        let all = [Signal::SIGINT, Signal::SIGTERM].into_iter().chain(hangup.then_some(Signal::SIGHUP));
        let set = SigSet::from_iter(all);
        let failed = |errno: nix::Error| Error::Start { what: "waiting for signals", source: errno.into() };
        set.thread_block().map(|()| Self(set)).map_err(failed)
    }
}

/// A server that listens.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    /// See [`PATIENCE`].
    patience: Duration,
}

impl Server {
    /// Listens; port 0 is any that is free.
    ///
    /// # Errors
    /// If the address cannot be used.
    pub fn listen(address: SocketAddr) -> Result<Self, Error> {
        let failed = |source| Error::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address, patience: PATIENCE })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers until a signal comes. A log that is being read is not waited for.
    ///
    /// # Errors
    /// If the server cannot be started.
    pub fn run(self, view: &Arc<View>, ends: &Ends) -> Result<(), Error> {
        self.start(Arc::clone(view)).map_err(|source| Error::Start { what: "the server", source })?;
        let failed = |errno: nix::Error| Error::Start { what: "waiting for signals", source: errno.into() };
        ends.0.wait().map(drop).map_err(failed)
    }

    /// Answers on threads of its own, for as long as the process runs.
    fn start(self, view: Arc<View>) -> io::Result<()> {
        let Self { listener, address, patience } = self;
        let accept = move || {
            // Each connection has a copy.
            let places = Arc::new(());
            loop {
                let Ok((stream, _)) = listener.accept() else {
                    thread::sleep(NO_DESCRIPTORS);
                    continue;
                };
                // Whoever finds no place is let go at once.
                if Arc::strong_count(&places) > CONNECTIONS {
                    continue;
                }
                let (view, place) = (Arc::clone(&view), Arc::clone(&places));
                let serve = move || {
                    // A browser that goes away in the middle is no error of ours.
                    let _ = respond(stream, (address, patience), &view);
                    drop(place);
                };
                let _ = thread::Builder::new().name("csi5300 page".into()).spawn(serve);
            }
        };
        thread::Builder::new().name("csi5300 pages".into()).spawn(accept).map(drop)
    }
}

/// The head of a request.
fn head(stream: &mut TcpStream, patience: Duration) -> io::Result<Vec<u8>> {
    let (until, mut head) = (Instant::now() + patience, Vec::new());
    loop {
        let left = until.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
        stream.set_read_timeout(Some(left))?;
        let mut bytes = [0; 4096];
        let count = stream.read(&mut bytes)?;
        head.extend_from_slice(bytes.get(..count).unwrap_or_default());
        let is_whole = head.windows(4).any(|four| four == b"\r\n\r\n");
        if head.len() > HEAD || (!is_whole && (count == 0 || Instant::now() >= until)) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        if is_whole {
            return Ok(head);
        }
    }
}

/// Answers one request.
fn respond(mut stream: TcpStream, (address, patience): (SocketAddr, Duration), view: &View) -> io::Result<()> {
    stream.set_write_timeout(Some(patience))?;
    let head = head(&mut stream, patience)?;
    let mut fields = [httparse::EMPTY_HEADER; FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    let is_whole = request.parse(&head).is_ok_and(|parsed| parsed.is_complete());
    let (Some(method), Some(target), true) = (request.method, request.path, is_whole) else {
        return plain(&mut stream, "", 400, "this is no request");
    };
    let field = |name: &str| {
        let mut found = request.headers.iter().filter(|field| field.name.eq_ignore_ascii_case(name));
        let first = found.next().map(|field| std::str::from_utf8(field.value).unwrap_or_default());
        // Two of them are none that could be judged.
        if found.next().is_some() { Some("") } else { first }
    };
    let (host, origin, fetch_site) = (field("host"), field("origin"), field("sec-fetch-site"));
    if let Err(refused) = admit(address, Asked { method, host, origin, fetch_site }) {
        return plain(&mut stream, method, refused.status(), &refused.to_string());
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    if path == "/events" {
        return match view.events.listen() {
            Some(events) => tell(&mut stream, &events),
            None => plain(&mut stream, method, 503, "too many pages listen already"),
        };
    }
    match view.answer(path, query) {
        Ok(Answer { kind, bytes }) => whole(&mut stream, method, 200, kind, &bytes),
        Err(error) => plain(&mut stream, method, error.status(), &error.to_string()),
    }
}

/// Sends events until the page disconnects.
fn tell(stream: &mut TcpStream, events: &Listener) -> io::Result<()> {
    stream.write_all(start(200, "text/event-stream", None).as_bytes())?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    loop {
        if let Some(event) = events.wait(LOOK) {
            stream.write_all(event.as_bytes())?;
        }
        if matches!(stream.peek(&mut [0]), Ok(0)) {
            return Ok(());
        }
    }
}

fn plain(stream: &mut TcpStream, method: &str, status: u16, words: &str) -> io::Result<()> {
    whole(stream, method, status, "text/plain; charset=utf-8", format!("{words}\n").as_bytes())
}

fn whole(stream: &mut TcpStream, method: &str, status: u16, kind: &str, bytes: &[u8]) -> io::Result<()> {
    stream.write_all(start(status, kind, Some(bytes.len())).as_bytes())?;
    stream.write_all(if method == "HEAD" { &[] } else { bytes })?;
    stream.shutdown(std::net::Shutdown::Write)
}

/// The head of an answer.
fn start(status: u16, kind: &str, length: Option<usize>) -> String {
    let reason = match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        503 => "Service Unavailable",
        _ => "Error",
    };
    let length = length.map_or(String::new(), |length| format!("content-length: {length}\r\n"));
    format!(
        "HTTP/1.1 {status} {reason}\r\ncontent-type: {kind}\r\n{length}content-security-policy: {POLICY}\r\n\
         cross-origin-resource-policy: same-origin\r\nx-content-type-options: nosniff\r\nreferrer-policy: no-referrer\r\n\
         cache-control: no-store\r\nconnection: close\r\n\r\n"
    )
}

#[cfg(test)]
mod tests;
