//! The same listener for programs that live in tokio.

use super::Netlink;
use crate::backend::sys::watch;
use crate::backend::{CsiSource, Error, Next};
use crate::time::Instant;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// A [`Netlink`] listener registered with tokio's reactor. Must be made inside a runtime with I/O enabled.
pub struct Stream {
    inner: AsyncFd<Netlink>,
}

impl Stream {
    /// Registers the listener.
    ///
    /// # Errors
    /// If the reactor refuses it.
    pub fn new(listener: Netlink) -> Result<Self, Error> {
        let io = |source| Error::Io { what: "cannot register the connector socket with tokio".into(), source };
        Ok(Self { inner: watch(listener).map_err(io)? })
    }

    /// The listener, for its counters.
    #[must_use]
    pub fn listener(&self) -> &Netlink {
        self.inner.get_ref()
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
        let mut ready = self.inner.ready_mut(Interest::READABLE | Interest::ERROR).await.map_err(io)?;
        let mut given = 0;
        loop {
            match ready.get_inner_mut().receive(now())? {
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
