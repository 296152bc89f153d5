//! HTTP for browsers on this machine.

use crate::body::Content;
use crate::guard::{Asked, Refused, admit};
use crate::{Answer, Error, View};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::Semaphore;

/// Connections at a time; a browser opens six for one page.
const CONNECTIONS: usize = 64;
/// A request's head must be whole within this time, and an idle connection ends after it.
const PATIENCE: Duration = Duration::from_secs(20);
/// Bytes of a request's head at most.
const HEAD: usize = 16 * 1024;
/// Pause when no more connections can be accepted.
const NO_DESCRIPTORS: Duration = Duration::from_millis(500);
/// What the page may load: itself. Scripts and styles are files of their own.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// A server that listens.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// Listens; port 0 is any that is free.
    ///
    /// # Errors
    /// If nobody can listen there.
    pub fn listen(address: SocketAddr) -> Result<Self, Error> {
        let failed = |source| Error::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers until the process is asked to end (SIGINT, SIGTERM, and with `hangup` SIGHUP, which is otherwise left as it is).
    ///
    /// # Errors
    /// If the server cannot be started.
    pub fn run(self, view: &Arc<View>, hangup: bool) -> Result<(), Error> {
        let failed = |source| Error::Start { what: "the server", source };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
        runtime.block_on(async {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate()].into_iter();
            let kinds = kinds.chain(hangup.then(SignalKind::hangup));
            let mut signals = kinds.map(signal).collect::<std::io::Result<Vec<_>>>().map_err(failed)?;
            let listener = tokio::net::TcpListener::from_std(self.listener).map_err(failed)?;
            tokio::spawn(accept(listener, self.address, Arc::clone(view)));
            // Whichever comes first.
            std::future::poll_fn(|context| {
                let ended = signals.iter_mut().any(|signal| signal.poll_recv(context).is_ready());
                if ended { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
            })
            .await;
            Ok::<(), Error>(())
        })?;
        // A log that is being read is not waited for.
        runtime.shutdown_background();
        Ok(())
    }
}

async fn accept(listener: tokio::net::TcpListener, address: SocketAddr, view: Arc<View>) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(NO_DESCRIPTORS).await;
            continue;
        };
        // Whoever finds no place is let go at once.
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let view = Arc::clone(&view);
        tokio::spawn(async move {
            let service = service_fn(move |request| {
                let view = Arc::clone(&view);
                async move { Ok::<_, Infallible>(respond(address, view, request).await) }
            });
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new()).header_read_timeout(PATIENCE).max_buf_size(HEAD);
            // A browser that goes away in the middle is no error of ours.
            let _ = http.serve_connection(TokioIo::new(stream), service).await;
            drop(place);
        });
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

async fn respond(address: SocketAddr, view: Arc<View>, request: Request<Incoming>) -> Response<Content> {
    let headers = request.headers();
    let asked = Asked {
        method: request.method().as_str(),
        host: text(headers, header::HOST),
        origin: text(headers, header::ORIGIN),
        fetch_site: text(headers, HeaderName::from_static("sec-fetch-site")),
    };
    if let Err(refused) = admit(address, asked) {
        return refuse(refused);
    }
    let (path, query) = (request.uri().path().to_owned(), request.uri().query().unwrap_or_default().to_owned());
    if path == "/events" {
        return match view.events.listen() {
            Some(events) => whole(StatusCode::OK, "text/event-stream", Content::Events(events)),
            None => plain(StatusCode::SERVICE_UNAVAILABLE, "too many pages listen already"),
        };
    }
    // Reading a log takes time: other answers do not wait for it.
    match tokio::task::spawn_blocking(move || view.answer(&path, &query)).await {
        Ok(Ok(Answer { kind, bytes })) => whole(StatusCode::OK, kind, Content::Whole(Some(Bytes::from(bytes)))),
        Ok(Err(error)) => {
            let status = StatusCode::from_u16(error.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
            plain(status, &error.to_string())
        }
        Err(_) => plain(StatusCode::INTERNAL_SERVER_ERROR, "the answer failed"),
    }
}

fn refuse(refused: Refused) -> Response<Content> {
    plain(StatusCode::from_u16(refused.status()).unwrap_or(StatusCode::FORBIDDEN), &refused.to_string())
}

fn plain(status: StatusCode, words: &str) -> Response<Content> {
    whole(status, "text/plain; charset=utf-8", Content::Whole(Some(Bytes::from(format!("{words}\n")))))
}

fn whole(status: StatusCode, kind: &'static str, content: Content) -> Response<Content> {
    let mut response = Response::new(content);
    *response.status_mut() = status;
    let fixed = [
        ("content-type", kind),
        ("content-security-policy", POLICY),
        ("cross-origin-resource-policy", "same-origin"),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cache-control", "no-store"),
    ];
    for (name, value) in fixed {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests;
