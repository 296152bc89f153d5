//! HTTP for browsers on this machine: a connection is one request, on a thread of its own.
//!
//! It admits requests of this page, but not requests that other pages cause: a page of the web can make a browser ask a server on
//! localhost, by its number or by a name of the page's own that resolves to it (DNS rebinding). The browser then says another
//! `Host`, `Origin` or `Sec-Fetch-Site` than this page's.

use crate::{Answer, Error, View};
use nix::sys::signal::{SigSet, Signal};
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
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
        let failed = |errno: nix::Error| Error::start("waiting for signals", &io::Error::from(errno));
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
        let failed = |source: io::Error| Error::Words(format!("cannot listen on {address}: {source}"));
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
        self.start(Arc::clone(view)).map_err(|source| Error::start("the server", &source))?;
        let failed = |errno: nix::Error| Error::start("waiting for signals", &io::Error::from(errno));
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
    if let Err((status, words)) = admit(address, method, field("host"), field("origin"), field("sec-fetch-site")) {
        return plain(&mut stream, method, status, words);
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
fn tell(stream: &mut TcpStream, events: &Receiver<Arc<str>>) -> io::Result<()> {
    stream.write_all(start(200, "text/event-stream", None).as_bytes())?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    loop {
        if let Ok(event) = events.recv_timeout(LOOK) {
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

/// Why a request is refused, with the status of the answer.
type Refused = (u16, &'static str);

/// It names no host, or one by a name.
const HOST: Refused = (403, "this page is at an address in numbers or at localhost, not at this host");
/// It comes from another page.
const ORIGIN: Refused = (403, "another page may not look here");
/// It wants to do something.
const METHOD: Refused = (405, "there is nothing to do here but to look (GET)");

/// Admits a request to `listening` by its method and these fields, or returns why not.
fn admit(
    listening: SocketAddr,
    method: &str,
    host: Option<&str>,
    origin: Option<&str>,
    fetch_site: Option<&str>,
) -> Result<(), Refused> {
    if !matches!(method, "GET" | "HEAD") {
        return Err(METHOD);
    }
    let host = host.filter(|host| is_own(listening, host)).ok_or(HOST)?;
    let own = origin.is_none_or(|origin| origin.strip_prefix("http://") == Some(host));
    let same = fetch_site.is_none_or(|site| matches!(site, "same-origin" | "none"));
    if own && same { Ok(()) } else { Err(ORIGIN) }
}

/// True for `localhost` and for addresses in numbers; where only this machine is listened to, for its own only. Any port:
/// a tunnel has another.
fn is_own(listening: SocketAddr, host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    match name.parse::<IpAddr>() {
        Ok(address) => address.is_loopback() || !listening.ip().is_loopback(),
        Err(_) => name.eq_ignore_ascii_case("localhost"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// A server of the fixtures.
    fn with_server<T>(ask: impl FnOnce(SocketAddr, Arc<View>) -> T) -> T {
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
        let view = View::open(&fixtures, crate::tests::reading()).unwrap();
        let (view, mut server) = (Arc::new(view), Server::listen("127.0.0.1:0".parse().unwrap()).unwrap());
        // Longer than any test.
        server.patience = Duration::from_secs(1_000_000);
        let address = server.address();
        server.start(Arc::clone(&view)).unwrap();
        ask(address, view)
    }

    /// All that comes to one request, whose connection then ends.
    fn asked(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        // Of a head that is too long the rest is thrown away, and the connection with it.
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn request(line: &str, more: &str) -> String {
        format!("{line} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{more}\r\n")
    }

    #[test]
    fn answers_have_their_status_and_may_load_nothing_from_elsewhere() {
        with_server(|address, _| {
            let page = asked(address, &request("GET /", ""));
            assert!(page.starts_with("HTTP/1.1 200") && page.contains("<!doctype html>"), "{page}");
            for header in [
                "content-security-policy: default-src 'none'",
                "x-content-type-options: nosniff",
                "cache-control: no-store",
            ] {
                assert!(page.contains(header), "{header}: {page}");
            }
            let known = [
                ("GET /data/overview", "", "200"),
                ("HEAD /page.js", "", "200"),
                ("GET /data/log/0/csi?columns=10", "Origin: http://localhost\r\n", "200"),
                ("GET /data/log/99", "", "404"),
                ("GET /data/log/0/levels?from=x", "", "400"),
                ("GET /..%2f..%2fetc/passwd", "", "404"),
                ("POST /", "", "405"),
                ("GET /", "Origin: http://evil.example\r\n", "403"),
                ("GET /events", "Sec-Fetch-Site: cross-site\r\n", "403"),
            ];
            for (line, more, status) in known {
                let answer = asked(address, &request(line, more));
                assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{line} {more}: {answer}");
            }
            let nameless = asked(address, "GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
            assert!(nameless.starts_with("HTTP/1.1 403"), "{nameless}");
            let endless = asked(address, &request("GET /", &format!("X: {}\r\n", "x".repeat(HEAD))));
            assert!(!endless.starts_with("HTTP/1.1 200"), "{endless}");
        });
    }

    #[test]
    fn events_come_as_they_happen() {
        with_server(|address, view| {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(request("GET /events", "").as_bytes()).unwrap();
            let mut said = [0; 1024];
            let head = stream.read(&mut said).unwrap();
            assert!(String::from_utf8_lossy(&said[..head]).contains("content-type: text/event-stream"));
            view.events.tell("rows", "{\"done\":1}");
            let mut text = String::new();
            while !text.contains("data: {\"done\":1}") {
                let more = stream.read(&mut said).unwrap();
                assert!(more > 0, "{text}");
                text += &String::from_utf8_lossy(&said[..more]);
            }
        });
    }

    #[test]
    fn connections_are_not_without_number_and_one_that_goes_makes_room() {
        with_server(|address, _| {
            let mut idle = Vec::new();
            for _ in 0..CONNECTIONS {
                idle.push(TcpStream::connect(address).unwrap());
            }
            assert_eq!(asked(address, &request("GET /", "")), "", "no place is left");
            drop(idle.pop());
            while asked(address, &request("GET /", "")).is_empty() {}
        });
    }

    fn ask(listening: &str, host: Option<&str>) -> Result<(), Refused> {
        admit(listening.parse().unwrap(), "GET", host, None, None)
    }

    #[test]
    fn only_numbers_and_localhost_are_this_page() {
        for name in ["127.0.0.1:8080", "localhost:8080", "LocalHost", "[::1]:8080", "127.0.0.1:9000", "[::1"] {
            assert_eq!(ask("127.0.0.1:8080", Some(name)), Ok(()), "{name}");
        }
        for name in ["evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example", "", "10.0.0.7:8080"] {
            assert_eq!(ask("127.0.0.1:8080", Some(name)), Err(HOST), "{name}");
        }
        assert_eq!(ask("127.0.0.1:8080", None), Err(HOST));
        assert_eq!(ask("10.0.0.7:8080", Some("10.0.0.7:8080")), Ok(()));
        assert_eq!(ask("10.0.0.7:8080", Some("robot.example:8080")), Err(HOST));
    }

    #[test]
    fn another_page_may_neither_read_nor_embed() {
        for (origin, site, expected) in [
            (Some("http://127.0.0.1:8080"), Some("same-origin"), Ok(())),
            (None, Some("none"), Ok(())),
            (Some("http://evil.example"), None, Err(ORIGIN)),
            (Some("null"), None, Err(ORIGIN)),
            (Some("https://127.0.0.1:8080"), None, Err(ORIGIN)),
            (None, Some("cross-site"), Err(ORIGIN)),
            (None, Some("same-site"), Err(ORIGIN)),
        ] {
            let host = "127.0.0.1:8080";
            assert_eq!(admit(host.parse().unwrap(), "GET", Some(host), origin, site), expected, "{origin:?} {site:?}");
        }
    }

    #[test]
    fn nothing_can_be_done() {
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT"] {
            assert_eq!(admit("127.0.0.1:1".parse().unwrap(), method, Some("localhost"), None, None), Err(METHOD));
        }
    }
}
