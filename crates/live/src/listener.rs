//! The source of this machine's records: the driver's messages on the connector, or the card's packets under the
//! kernel's own driver (feature `stock`).

use crate::netlink::Netlink;
use crate::stock::Stock;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use std::os::fd::{AsFd, BorrowedFd};

/// A source of live records.
#[derive(Debug)]
pub enum Listener {
    /// The driver's messages: the patched driver's, or those of the module `csi5300`.
    Connector(Box<Netlink>),
    /// The card's packets, by the eBPF program.
    Stock(Box<Stock>),
}

/// What a listener lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Messages or packets that the kernel dropped for lack of room.
    pub kernel: u64,
    /// Records missing before that: numbers that the driver skipped, or CSI without a record.
    pub driver: u64,
}

impl Lost {
    /// All of it.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.kernel + self.driver
    }
}

impl Listener {
    /// Bytes of buffer in the kernel.
    #[must_use]
    pub fn buffer(&self) -> usize {
        match self {
            Self::Connector(listener) => listener.receive_buffer(),
            Self::Stock(stock) => stock.ring_bytes(),
        }
    }

    /// What was lost so far.
    #[must_use]
    pub fn lost(&self) -> Lost {
        match self {
            Self::Connector(listener) => {
                let counters = listener.counters();
                // If the kernel does not report its drops, the jump in bfee_count does.
                let kernel = counters.kernel_drops.max(counters.overrun_bfee_gap);
                Lost { kernel, driver: counters.other_bfee_gap }
            }
            Self::Stock(stock) => {
                let counters = stock.counters();
                let dropped = u64::from(counters.cards.dropped());
                Lost { kernel: counters.ring_full + counters.unreadable, driver: dropped + counters.malformed }
            }
        }
    }
}

impl From<Netlink> for Listener {
    fn from(listener: Netlink) -> Self {
        Self::Connector(Box::new(listener))
    }
}

impl From<Stock> for Listener {
    fn from(stock: Stock) -> Self {
        Self::Stock(Box::new(stock))
    }
}

impl CsiSource for Listener {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self {
            Self::Connector(listener) => listener.receive(now),
            Self::Stock(stock) => stock.receive(now),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        match self {
            Self::Connector(listener) => listener.next_at(),
            Self::Stock(stock) => stock.next_at(),
        }
    }
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Connector(listener) => listener.as_fd(),
            Self::Stock(stock) => stock.as_fd(),
        }
    }
}
