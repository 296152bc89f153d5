//! CSI beside the kernel's own driver, without a kernel module: an eBPF program copies the card's packets where `iwldvm`
//! hands them to `iwl_notification_wait` of `iwlwifi`, and the records are made here ([`driver_iface::stock`]).
//!
//! The binary contains the program (`driver-iface/bpf`); the kernel's verifier checks it before it runs. It needs Linux
//! 5.8 on x86-64, the CSI firmware under the distribution's `iwlwifi`, and CAP_BPF with CAP_PERFMON, but neither BTF
//! nor kernel headers; Secure Boot may be on.
//!
//! It only receives. The kernel module may run beside it, for an HT rate of sent frames and for the patched drivers'
//! requests to the card (`driver-iface/kmod/csi5300_asks.h`).
//!
//! With [`frames`](driver_iface::stock::Options::frames) a card's 0xC1 records begin after its first CSI: before it the
//! packets may be those of another Intel card.
//!
//! **Losses.** Where the ring is full the program drops packets and counts them; the next event has the count, so
//! [`Loss::Overrun`](csi5300::source::Loss) stands where the gap is, and no record is made of two frames' parts.
//! **Reloads.** The kernel takes the probe away with the driver. A look once a second finds a driver that was loaded
//! anew and attaches again; what the card sent in between is not seen.

mod error;
mod intake;
mod program;

pub use error::StockError;

use crate::wait::monotonic_ns;
use aya::maps::{MapData, RingBuf};
use csi5300::source::{CsiSource, Error, Next, Origin, Stamps};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::stock::Counts;
use intake::{Clocks, Intake, Turn};
use program::Program;
use std::fmt;
use std::os::fd::{AsFd, BorrowedFd};

/// Default size of the ring, bytes: a record's three packets take about 850 bytes, so it holds 10 s at 1,000 records a
/// second.
pub const RING: usize = 8 * 1024 * 1024;
/// The smallest and the largest ring, bytes.
const RINGS: std::ops::RangeInclusive<usize> = 64 * 1024..=1 << 30;
/// Interval of checks for a reloaded driver.
const LOOK: Span = Span::from_ms(1_000);

/// How to listen.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Options {
    /// Which records to make, in which layout.
    pub records: driver_iface::stock::Options,
    /// Bytes of ring; the next power of two is taken.
    pub ring: usize,
    /// Reads the host's wall clock, microseconds since the Unix epoch.
    pub wall_us: fn() -> Option<i64>,
    /// This robot's MAC. No card hears its own frames: one that does is another robot's on this machine, and its
    /// records are skipped from then on.
    pub own: Option<Mac>,
}

impl Default for Options {
    /// CSI in WSR's layout, a ring of [`RING`] bytes, the host's time.
    fn default() -> Self {
        let records = driver_iface::stock::Options::default();
        Self { records, ring: RING, wall_us: crate::wait::wall_us, own: None }
    }
}

impl Options {
    /// Sets [`records`](Self::records).
    #[must_use]
    pub fn with_records(self, records: driver_iface::stock::Options) -> Self {
        Self { records, ..self }
    }

    /// Sets [`ring`](Self::ring), bytes.
    #[must_use]
    pub fn with_ring(self, ring: usize) -> Self {
        Self { ring, ..self }
    }

    /// Sets [`wall_us`](Self::wall_us).
    #[must_use]
    pub fn with_wall_us(self, wall_us: fn() -> Option<i64>) -> Self {
        Self { wall_us, ..self }
    }

    /// Sets [`own`](Self::own).
    #[must_use]
    pub fn with_own(self, own: Option<Mac>) -> Self {
        Self { own, ..self }
    }
}

/// Everything that was counted since the program was loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct StockCounts {
    /// Packets of any command that the driver handed over.
    pub hits: u64,
    /// Events taken from the ring.
    pub events: u64,
    /// Records handed on.
    pub records: u64,
    /// Packets dropped because the ring was full.
    pub ring_full: u64,
    /// Packets that the program could not read.
    pub unreadable: u64,
    /// Packets at which the kernel did not run the program, because another one ran on the same processor.
    pub missed: u64,
    /// Inconsistent events: program and reader do not match.
    pub malformed: u64,
    /// Skipped frames (0xC1) of cards without CSI so far: the driver of another Intel card shares the function.
    pub held_back: u64,
    /// Skipped records of other robots' cards on this machine.
    pub others: u64,
    /// Cards seen, each one counted again after its driver was reloaded.
    pub cards_seen: u64,
    /// Counts of all cards' packets and records.
    pub cards: Counts,
    /// Times that the driver was reloaded and the program attached to it.
    pub reattached: u64,
}

/// The packets of this machine's cards as a source of records. Never blocks; wait on its file descriptor for
/// [`Next::Pending`] to end, and until [`CsiSource::next_at`].
pub struct Stock {
    // The ring before the program, so that the mapping is dropped first.
    ring: RingBuf<MapData>,
    program: Program,
    ring_bytes: usize,
    intake: Intake,
    wall_us: fn() -> Option<i64>,
    look_at: Option<Instant>,
    reattached: u64,
}

impl fmt::Debug for Stock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stock").field("ring_bytes", &self.ring_bytes).field("counters", &self.counters()).finish()
    }
}

impl Stock {
    /// Loads the program and attaches it to the driver.
    ///
    /// # Errors
    /// [`StockError`] inside [`Error::Backend`]: an unfit kernel, no driver, missing capabilities; each with what to do.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let ring_bytes = options.ring.clamp(*RINGS.start(), *RINGS.end()).next_power_of_two();
        let (program, ring) = Program::load(ring_bytes as u32, options.records.frames)?;
        let (intake, wall_us) = (Intake::new(options.records, options.own), options.wall_us);
        Ok(Self { ring, program, ring_bytes, intake, wall_us, look_at: None, reattached: 0 })
    }

    /// Bytes of the ring.
    #[must_use]
    pub fn ring_bytes(&self) -> usize {
        self.ring_bytes
    }

    /// True while the driver to which the program is attached is loaded.
    #[must_use]
    pub fn is_attached(&self) -> bool {
        self.program.is_attached()
    }

    /// Everything counted so far; losses after the last event included.
    #[must_use]
    pub fn counters(&self) -> StockCounts {
        let (reattached, missed) = (self.reattached, self.program.missed());
        let mut counters = StockCounts { reattached, missed, ..self.intake.counters() };
        if let Some([hits, ring_full, unreadable]) = self.program.counts() {
            counters.hits = hits;
            counters.ring_full = counters.ring_full.max(ring_full);
            counters.unreadable = counters.unreadable.max(unreadable);
        }
        counters
    }

    /// Checks at intervals whether the program is attached to the current driver.
    fn look(&mut self, now: Instant) -> Result<(), Error> {
        if self.look_at.is_none_or(|at| at <= now) {
            let first = self.look_at.replace(now + LOOK).is_none();
            if !first && self.program.follow_driver()? {
                self.reattached += 1;
                self.intake.forget_cards();
            }
        }
        Ok(())
    }
}

impl CsiSource for Stock {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            if !self.intake.is_held()
                && let Some(event) = self.ring.next()
            {
                self.intake.take(&event);
            }
            if !self.intake.is_held() {
                self.look(now)?;
                return Ok(Next::Pending);
            }
            let clocks = Clocks { monotonic_ns: monotonic_ns(), wall_us: (self.wall_us)() };
            match self.intake.turn(clocks) {
                Turn::Next => {}
                Turn::Lost(loss) => return Ok(Next::Lost(loss)),
                Turn::Record(host_us) => {
                    let origin = Origin::Live { number: self.intake.counters.records - 1 };
                    return Ok(Next::Record(Stamps { at: now, host_us, origin }, self.intake.record()));
                }
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        self.look_at
    }
}

impl AsFd for Stock {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.ring.as_fd()
    }
}
