//! The same listener for programs that live in tokio.

use super::Netlink;
use crate::sys::watch_fd;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use std::os::fd::{AsFd, OwnedFd};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// A [`Netlink`] listener registered with tokio's reactor. Must be made inside a runtime with I/O enabled.
pub struct Stream {
    listener: Netlink,
    /// A second descriptor of the listener's socket.
    ready: AsyncFd<OwnedFd>,
}

impl Stream {
    /// Registers the listener.
    ///
    /// # Errors
    /// If the reactor refuses it.
    pub fn new(listener: Netlink) -> Result<Self, Error> {
        let io = |source| Error::Io { what: "cannot register the connector socket with tokio".into(), source };
        let ready = listener.as_fd().try_clone_to_owned().and_then(watch_fd).map_err(io)?;
        Ok(Self { listener, ready })
    }

    /// The listener, for its counters.
    #[must_use]
    pub fn listener(&self) -> &Netlink {
        &self.listener
    }

    /// Hands every record and loss that is there now to `each`, after waiting until there is something.
    ///
    /// Safe to cancel: nothing is taken from the socket before the wait is over. `now` is asked after the wait.
    ///
    /// # Errors
    /// As [`CsiSource::receive`].
    pub async fn next_batch(
        &mut self,
        mut now: impl FnMut() -> Instant,
        mut each: impl FnMut(Next<'_>),
    ) -> Result<usize, Error> {
        let io = |source| Error::Io { what: "waiting for the connector socket".into(), source };
        let mut ready = self.ready.ready(Interest::READABLE | Interest::ERROR).await.map_err(io)?;
        let mut given = 0;
        loop {
            match self.listener.receive(now())? {
                Next::Pending => {
                    ready.clear_ready();
                    return Ok(given);
                }
                next => each(next),
            }
            given += 1;
        }
    }
}
