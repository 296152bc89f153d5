//! What `record` listens to: the kernel's connector, or the card under the kernel's own driver.

use super::live::Listening;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use csi5300_live::netlink::Netlink;
#[cfg(feature = "stock")]
use csi5300_live::stock::{Options, Stock};
use std::fmt::Write;
use std::os::fd::{AsFd, BorrowedFd};

/// How to take the card's packets from under an unmodified driver.
#[derive(clap::Args, Clone, Debug)]
pub struct StockArgs {
    /// Take the card's packets from the kernel's own, unpatched driver, by an eBPF program (Linux 5.8 and later)
    #[cfg(feature = "stock")]
    #[arg(long, conflicts_with_all = ["connector_index", "allow_user_sender", "room"])]
    stock: bool,
    /// With --stock: records as the WSR driver makes them, with sender and frame number, or as csitool's does
    #[cfg(feature = "stock")]
    #[arg(long, value_enum, default_value_t = Layout::Wsr, requires = "stock", value_name = "LAYOUT")]
    stock_layout: Layout,
    /// With --stock: record the frames themselves too (0xC1), as connector_log 0x5 does
    #[cfg(feature = "stock")]
    #[arg(long, requires = "stock")]
    stock_frames: bool,
}

/// Whose records.
#[cfg(feature = "stock")]
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    Wsr,
    Csitool,
}

/// A source of live records.
pub enum Listener {
    Connector(Box<Netlink>),
    #[cfg(feature = "stock")]
    Stock(Box<Stock>),
}

/// What a listener lost, and what it says about it.
#[derive(Clone, Debug, Default)]
pub struct Lost {
    /// Messages or packets that the kernel dropped for want of room.
    pub kernel: u64,
    /// Records that were missing before.
    pub driver: u64,
}

impl Listener {
    /// Opens what the arguments name.
    pub fn open(listening: &Listening, args: &StockArgs) -> Result<Self, String> {
        #[cfg(feature = "stock")]
        if args.stock {
            let layout = match args.stock_layout {
                Layout::Wsr => driver_iface::bfee::Layout::Wsr,
                Layout::Csitool => driver_iface::bfee::Layout::Stock,
            };
            let records = driver_iface::stock::Options::default().with_layout(layout).with_frames(args.stock_frames);
            let ring = usize::try_from(listening.receive_buffer).unwrap_or(usize::MAX);
            let stock = Stock::open(&Options::default().with_records(records).with_ring(ring));
            return stock.map(|stock| Self::Stock(Box::new(stock))).map_err(|error| with_causes(&error));
        }
        let _ = args;
        listening.open().map(|listener| Self::Connector(Box::new(listener)))
    }

    /// What is listened to, in words.
    pub fn describe(&self) -> String {
        match self {
            Self::Connector(listener) => Listening::describe(listener),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => {
                format!("listening to the packets of the unpatched iwlwifi, ring of {} KiB", stock.ring_bytes() / 1024)
            }
        }
    }

    /// Bytes of buffer in the kernel.
    pub fn buffer(&self) -> usize {
        match self {
            Self::Connector(listener) => listener.receive_buffer(),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => stock.ring_bytes(),
        }
    }

    /// What was lost so far.
    pub fn lost(&self) -> Lost {
        match self {
            Self::Connector(listener) => {
                let counters = listener.counters();
                // Where the kernel does not say how much it dropped, the jump in bfee_count does.
                let kernel = counters.kernel_drops.max(counters.overrun_bfee_gap);
                Lost { kernel, driver: counters.other_bfee_gap }
            }
            #[cfg(feature = "stock")]
            Self::Stock(stock) => {
                let counters = stock.counters();
                let dropped = u64::from(counters.cards.dropped());
                Lost { kernel: counters.ring_full + counters.unreadable, driver: dropped + counters.malformed }
            }
        }
    }

    /// Lines for the summary.
    pub fn summary(&self) -> String {
        match self {
            Self::Connector(listener) => connector_summary(listener),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => stock_summary(stock),
        }
    }
}

/// An error with what caused it: the kernel's own answer is at the end.
#[cfg(feature = "stock")]
fn with_causes(error: &Error) -> String {
    let mut text = error.to_string();
    let mut at = std::error::Error::source(error);
    while let Some(cause) = at {
        let _ = write!(text, ": {cause}");
        at = cause.source();
    }
    text
}

/// A line for each counter that is not zero.
fn counted(text: &mut String, counts: &[(u64, &str)]) {
    for (count, what) in counts.iter().filter(|(count, _)| *count > 0) {
        let _ = writeln!(text, "  {count} {what}");
    }
}

fn connector_summary(listener: &Netlink) -> String {
    let mut text = String::new();
    let counters = listener.counters();
    if counters.overruns > 0 {
        let _ = writeln!(
            text,
            "  {} overruns: the kernel dropped {} messages, bfee_count has gaps of {}",
            counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap
        );
    }
    let counts = [
        (counters.other_bfee_gap, "numbers missing from bfee_count before this socket"),
        (counters.truncated, "datagrams longer than the buffer"),
        (counters.malformed, "datagrams that contradict themselves"),
        (counters.foreign, "foreign messages left out"),
        (counters.user_senders, "messages from other programs refused (--allow-user-sender takes them)"),
    ];
    counted(&mut text, &counts);
    text
}

#[cfg(feature = "stock")]
fn stock_summary(stock: &Stock) -> String {
    let mut text = String::new();
    let counters = stock.counters();
    let cards = counters.cards;
    let _ = writeln!(
        text,
        "  {} packets of the driver, {} of them receptions, {} with CSI",
        counters.hits, cards.phy, cards.bfee
    );
    let counts = [
        (counters.ring_full, "packets dropped, the ring was full (--receive-buffer makes it larger)"),
        (counters.unreadable, "packets that could not be read"),
        (counters.malformed, "events that contradict themselves"),
        (cards.bad_phy.into(), "receptions (0xC0) too short"),
        (cards.bad_mpdu.into(), "frames (0xC1) whose lengths contradict each other"),
        (cards.bad_bfee.into(), "CSI notifications (0xBB) that contradict themselves, dropped"),
        (cards.no_phy.into(), "CSI notifications without their reception (0xC0), dropped"),
        (cards.no_order.into(), "records whose antenna order the card did not say"),
        (cards.no_sender.into(), "records of an unknown sender: no good frame (0xC1) came with them"),
        (counters.held_back, "frames before the first CSI, not recorded"),
        (
            counters.reattached,
            "times the driver was loaded anew; what came before the next look, a second at most, is missing",
        ),
    ];
    counted(&mut text, &counts);
    if counters.cards_seen > 1 {
        let _ = writeln!(text, "  {} cards, or one whose driver was loaded anew", counters.cards_seen);
    }
    if counters.hits == 0 {
        text.push_str(
            "  the card sent no packet at all: is its interface up, in monitor mode, on the right channel?\n",
        );
    }
    text
}

impl CsiSource for Listener {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self {
            Self::Connector(listener) => listener.receive(now),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => stock.receive(now),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        match self {
            Self::Connector(listener) => listener.next_at(),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => stock.next_at(),
        }
    }
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Connector(listener) => listener.as_fd(),
            #[cfg(feature = "stock")]
            Self::Stock(stock) => stock.as_fd(),
        }
    }
}
