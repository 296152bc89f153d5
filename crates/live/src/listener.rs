//! The source of this machine's records: the driver's messages on the connector, or the card's packets under the
//! kernel's own driver (feature `stock`).

use crate::netlink::Netlink;
use crate::status::Losses;
use crate::stock::{Stock, StockCounts};
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

impl Listener {
    /// Bytes of buffer in the kernel.
    #[must_use]
    pub fn buffer(&self) -> usize {
        match self {
            Self::Connector(listener) => listener.receive_buffer,
            Self::Stock(stock) => stock.ring_bytes,
        }
    }

    /// What is listened to, in words.
    #[must_use]
    pub fn describe(&self) -> String {
        let kib = self.buffer() / 1024;
        match self {
            Self::Connector(listener) => format!("listening {}, receive buffer {kib} KiB", listener.at),
            Self::Stock(_) => format!("listening to the packets of the unpatched iwlwifi, ring of {kib} KiB"),
        }
    }

    /// What was lost so far on the way here; `disk` is 0.
    #[must_use]
    pub fn lost(&self) -> Losses {
        let (kernel, driver) = match self {
            Self::Connector(listener) => {
                let counters = listener.counters();
                // If the kernel does not report its drops, the jump in bfee_count does.
                let kernel = counters.kernel_drops.max(counters.overrun_bfee_gap);
                (kernel, counters.other_bfee_gap)
            }
            Self::Stock(stock) => lost_of(&stock.counters()),
        };
        Losses { kernel, driver, disk: 0 }
    }
}

/// What the kernel lost of the stock driver's packets, and what was lost before or behind that.
fn lost_of(counters: &StockCounts) -> (u64, u64) {
    let dropped = u64::from(counters.cards.dropped());
    (counters.ring_full + counters.unreadable + counters.missed, dropped + counters.malformed)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_at_which_the_program_did_not_run_are_lost_too() {
        let counters =
            StockCounts { ring_full: 1, unreadable: 10, missed: 100, malformed: 1_000, ..StockCounts::default() };
        assert_eq!(lost_of(&counters), (111, 1_000));
    }
}
