//! Admission to the viewers' websocket: limits of number, time and pages.
//!
//! The server behind it listens on this machine only, without checks. A connection is admitted once the head of its
//! request is complete; later bytes are copied.

use crate::adapters::are_descriptors_to_spare;
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Viewers at a time.
const VIEWERS: usize = 8;
/// Bytes of a request's head at most.
const HEAD: usize = 8 * 1024;
/// A head must be complete within this time.
const PATIENCE: Duration = Duration::from_secs(5);
/// A viewer that reads nothing for this time is disconnected.
const STUCK: Duration = Duration::from_secs(30);
/// Foxglove's own pages. Programs send no origin.
const PAGES: [&str; 2] = ["https://app.foxglove.dev", "https://studio.foxglove.dev"];
/// Pause when no more connections can be accepted.
const NO_DESCRIPTORS: Duration = Duration::from_millis(500);

/// The rules of admission.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    /// Further pages that may connect, such as `https://lichtblick.lab`.
    pub origins: Vec<String>,
    /// See [`VIEWERS`].
    pub viewers: usize,
    /// See [`PATIENCE`].
    pub patience: Duration,
}

impl Rules {
    /// The usual ones, and these pages.
    pub(crate) fn new(origins: Vec<String>) -> Self {
        Self { origins, viewers: VIEWERS, patience: PATIENCE }
    }
}

/// A door; it closes when dropped.
#[derive(Debug)]
pub(crate) struct Door {
    address: SocketAddr,
    over: Arc<AtomicBool>,
    waiter: Option<thread::JoinHandle<()>>,
}

impl Door {
    /// Listens at `address` and forwards to the server at `inside`.
    ///
    /// # Errors
    /// If nobody can listen there.
    pub(crate) fn open(address: SocketAddr, inside: SocketAddr, rules: Rules) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&over);
        let wait = move || wait(&listener, inside, &Arc::new(rules), &seen);
        let waiter = Some(thread::Builder::new().name("csi5300 viewers".into()).spawn(wait)?);
        Ok(Self { address, over, waiter })
    }

    /// Its address.
    #[cfg(test)]
    fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        // A connection to itself wakes the waiting thread.
        let _ = TcpStream::connect(self.address);
        if let Some(waiter) = self.waiter.take() {
            let _ = waiter.join();
        }
    }
}

fn wait(listener: &TcpListener, inside: SocketAddr, rules: &Arc<Rules>, over: &AtomicBool) {
    // Each viewer holds a clone.
    let places = Arc::new(());
    loop {
        let came = listener.accept();
        if over.load(Ordering::Relaxed) {
            return;
        }
        let Ok((viewer, _)) = came else {
            thread::sleep(NO_DESCRIPTORS);
            continue;
        };
        // Without a free place the connection is closed at once.
        if Arc::strong_count(&places) > rules.viewers || !are_descriptors_to_spare() {
            continue;
        }
        let place = Arc::clone(&places);
        let rules = Arc::clone(rules);
        let lead = move || {
            let _ = lead(viewer, inside, &rules);
            drop(place);
        };
        let _ = thread::Builder::new().name("csi5300 viewer".into()).spawn(lead);
    }
}

/// Admits one viewer, and copies until either side ends.
fn lead(mut viewer: TcpStream, inside: SocketAddr, rules: &Rules) -> io::Result<()> {
    let Some(head) = read_head(&mut viewer, rules.patience)? else { return Ok(()) };
    if !origin(&head).is_none_or(|origin| is_welcome(origin, rules)) {
        return viewer.write_all(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    }
    let mut server = TcpStream::connect(inside)?;
    server.write_all(&head)?;
    viewer.set_read_timeout(None)?;
    viewer.set_write_timeout(Some(STUCK))?;
    let (mut from_viewer, mut to_server) = (viewer.try_clone()?, server.try_clone()?);
    let there = thread::Builder::new().name("csi5300 viewer".into()).spawn(move || {
        let _ = io::copy(&mut from_viewer, &mut to_server);
        let _ = to_server.shutdown(Shutdown::Both);
    })?;
    let _ = io::copy(&mut server, &mut viewer);
    let _ = viewer.shutdown(Shutdown::Both);
    let _ = server.shutdown(Shutdown::Both);
    let _ = there.join();
    Ok(())
}

/// The head of a request, with later bytes; `None` if it is too long or incomplete in time.
fn read_head(viewer: &mut TcpStream, patience: Duration) -> io::Result<Option<Vec<u8>>> {
    let end = Instant::now() + patience;
    let (mut head, mut part) = (Vec::new(), [0; 1024]);
    while head.len() < HEAD {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(None);
        }
        viewer.set_read_timeout(Some(left))?;
        let read = viewer.read(&mut part)?;
        if read == 0 {
            return Ok(None);
        }
        head.extend(part.get(..read).unwrap_or_default());
        if head.windows(4).any(|four| four == b"\r\n\r\n") {
            return Ok(Some(head));
        }
    }
    Ok(None)
}

/// The page that a request names as its origin.
fn origin(head: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(head);
    let lines = text.split("\r\n\r\n").next().unwrap_or_default().lines().skip(1);
    let named =
        lines.filter_map(|line| line.split_once(':')).filter(|(name, _)| name.trim().eq_ignore_ascii_case("origin"));
    // Several origins are refused.
    let all: Vec<&str> = named.map(|(_, value)| value.trim()).collect();
    (!all.is_empty()).then(|| all.join(" "))
}

fn is_welcome(origin: String, rules: &Rules) -> bool {
    let host = origin.split_once("://").map_or("", |(_, host)| host);
    let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name);
    ["localhost", "127.0.0.1", "[::1]"].contains(&name)
        || PAGES.contains(&origin.as_str())
        || rules.origins.contains(&origin)
        // A program, such as Foxglove's on the desktop.
        || origin.starts_with("file://")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Longer than any test.
    const LONG: Duration = Duration::from_secs(1_000_000);

    /// A door before a server that echoes.
    fn house(viewers: usize, patience: Duration) -> Door {
        let inside = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = inside.local_addr().unwrap();
        thread::spawn(move || {
            for stream in inside.incoming() {
                let mut stream = stream.unwrap();
                thread::spawn(move || io::copy(&mut stream.try_clone().unwrap(), &mut stream));
            }
        });
        let rules = Rules { origins: vec!["https://lichtblick.lab".into()], viewers, patience };
        Door::open("127.0.0.1:0".parse().unwrap(), address, rules).unwrap()
    }

    fn ask(door: &Door, origin: &str) -> TcpStream {
        let mut stream = TcpStream::connect(door.address()).unwrap();
        let line = if origin.is_empty() { String::new() } else { format!("oRigin: {origin}\r\n") };
        // A refused connection may be closed before everything is written.
        let _ = write!(stream, "GET / HTTP/1.1\r\nHost: robot\r\n{line}\r\n");
        stream
    }

    fn first(stream: &mut TcpStream, len: usize) -> String {
        let mut bytes = vec![0; len];
        let mut read = 0;
        while read < len {
            match stream.read(&mut bytes[read..]) {
                Ok(0) | Err(_) => break,
                Ok(more) => read += more,
            }
        }
        String::from_utf8_lossy(&bytes[..read]).into_owned()
    }

    #[test]
    fn programs_and_pages_that_are_named_come_in() {
        let door = house(8, LONG);
        for origin in [
            "",
            "http://localhost:8080",
            "http://127.0.0.1",
            "http://[::1]:1",
            "https://app.foxglove.dev",
            "https://lichtblick.lab",
            "file://",
        ] {
            let mut viewer = ask(&door, origin);
            assert_eq!(first(&mut viewer, 3), "GET", "{origin}");
        }
        for origin in [
            "https://evil.example",
            "http://localhost.evil.example",
            "http://[::1].evil.example",
            "http://localhost:1@evil.example",
            "https://app.foxglove.dev.evil",
            "null",
            "https://lichtblick.lab\r\nOrigin: http://localhost",
        ] {
            let mut viewer = ask(&door, origin);
            assert_eq!(first(&mut viewer, 12), "HTTP/1.1 403", "{origin}");
        }
    }

    #[test]
    fn a_silent_connection_is_closed_and_frees_its_place() {
        let door = house(1, Duration::from_millis(30));
        let mut silent = TcpStream::connect(door.address()).unwrap();
        assert_eq!(first(&mut silent, 1), "", "closed");
        let mut endless = TcpStream::connect(door.address()).unwrap();
        let _ = endless.write_all(&vec![b'a'; 2 * HEAD]);
        assert_eq!(first(&mut endless, 1), "", "closed");
    }

    #[test]
    fn no_more_come_in_than_there_are_places() {
        let door = house(2, LONG);
        let mut inside: Vec<TcpStream> = (0..2).map(|_| ask(&door, "")).collect();
        inside.iter_mut().for_each(|viewer| assert_eq!(first(viewer, 3), "GET"));
        let mut further = ask(&door, "");
        assert_eq!(first(&mut further, 3), "");
        // Bytes after the head are copied too, both ways.
        inside[0].write_all(b"#").unwrap();
        assert!(first(&mut inside[0], "GET / HTTP/1.1\r\nHost: robot\r\n\r\n#".len() - 3).ends_with('#'));
    }
}
