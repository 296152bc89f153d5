use super::*;
use crate::Reading;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::TrajectorySource;
use std::path::Path;

/// A server of the fixtures.
fn with_server<T>(ask: impl FnOnce(SocketAddr, Arc<View>) -> T) -> T {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    let view = View::open(&fixtures, Reading::new(TrajectorySource::GroundTruth, None, options)).unwrap();
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
