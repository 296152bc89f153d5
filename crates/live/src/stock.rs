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

use crate::doctor::{EBPF_NEEDS, Machine, grant, no_ebpf};
use crate::refused;
use crate::wait::{monotonic_ns, wall_us};
use aya::maps::{Array, MapData, RingBuf};
use aya::programs::KProbe;
use aya::programs::kprobe::KProbeLinkId;
use aya::{Ebpf, EbpfLoader};
use csi5300::source::{CsiSource, Error, Loss, Next, Origin, Stamps};
use csi5300::time::{HostTimes, Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Bfee, MAX_BODY};
use driver_iface::record::{MAX_LENGTH, Record, code};
use driver_iface::stock::{self, Card, Event, Packet};
use nix::sys::resource::{RLIM_INFINITY, Resource, setrlimit};
use std::error::Error as StdError;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::{fmt, io};

/// Default size of the ring, bytes: a record's three packets take about 850 bytes, so it holds 10 s at 1,000 records a
/// second.
pub const RING: usize = 8 * 1024 * 1024;
/// The smallest and the largest ring, bytes.
const RINGS: std::ops::RangeInclusive<usize> = 64 * 1024..=1 << 30;
/// Interval of checks for a reloaded driver.
const LOOK: Span = Span::from_ms(1_000);

/// How to listen.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Which records to make, in which layout.
    pub records: stock::Options,
    /// Bytes of ring; the next power of two is taken.
    pub ring: usize,
    /// This robot's MAC. No card hears its own frames: one that does is another robot's on this machine, and its
    /// records are skipped from then on.
    pub own: Option<Mac>,
}

/// Everything that was counted since the program was loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StockCounts {
    /// Packets of any command that the driver handed over.
    pub hits: u64,
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
    pub cards: stock::Counts,
    /// Times that the driver was reloaded and the program attached to it.
    pub reattached: u64,
}

/// The packets of this machine's cards as a source of records. Never blocks; wait on its file descriptor for
/// [`Next::Pending`] to end, and until [`CsiSource::next_at`].
pub struct Stock {
    // The ring before the program, so that the mapping is dropped first.
    ring: RingBuf<MapData>,
    program: Program,
    /// Bytes of the ring.
    pub ring_bytes: usize,
    intake: Intake,
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
    /// An unfit kernel, no driver, missing capabilities; each with what to do.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let ring_bytes = options.ring.clamp(*RINGS.start(), *RINGS.end()).next_power_of_two();
        let (program, ring) = Program::load(ring_bytes as u32, options.records.frames)?;
        let intake = Intake::new(options.records, options.own);
        Ok(Self { ring, program, ring_bytes, intake, look_at: None, reattached: 0 })
    }

    /// Everything counted so far; losses after the last event included.
    #[must_use]
    pub fn counters(&self) -> StockCounts {
        let (reattached, missed) = (self.reattached, self.program.missed());
        let mut counters = StockCounts { reattached, missed, ..self.intake.counters };
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
                self.intake.cards.clear();
            }
        }
        Ok(())
    }
}

impl CsiSource for Stock {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            if !self.intake.is_held
                && let Some(event) = self.ring.next()
            {
                self.intake.take(&event);
            }
            if !self.intake.is_held {
                self.look(now)?;
                return Ok(Next::Pending);
            }
            let clocks = Clocks { monotonic_ns: monotonic_ns(), wall_us: wall_us() };
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

/// Limit of cards, more than a machine can hold. A new one replaces the one seen first.
const CARDS_KEPT: usize = 8;

/// The two clocks, read together.
#[derive(Clone, Copy, Debug)]
struct Clocks {
    /// CLOCK_MONOTONIC, nanoseconds.
    monotonic_ns: i64,
    /// Wall clock, microseconds since the Unix epoch.
    wall_us: Option<i64>,
}

impl Clocks {
    /// The wall clock at another point of the monotonic one, microseconds.
    fn wall_at(&self, monotonic_ns: u64) -> Option<i64> {
        let since_ns = self.monotonic_ns.saturating_sub(i64::try_from(monotonic_ns).ok()?);
        Some(self.wall_us?.saturating_sub(since_ns / 1_000))
    }
}

/// The result of an event.
#[derive(Debug, PartialEq, Eq)]
enum Turn {
    /// A record: call [`Intake::record`]. With its host time, microseconds.
    Record(Option<i64>),
    /// Packets are missing before this event: call [`Intake::turn`] again, it is kept.
    Lost(Loss),
    /// Nothing: take the next event.
    Next,
}

#[derive(Default)]
struct Known {
    key: u64,
    card: Card,
    host_times: HostTimes,
    has_csi: bool,
    /// It heard this robot's own frames, so it is another robot's.
    is_others: bool,
}

/// The decisions on the events of one ring.
struct Intake {
    options: stock::Options,
    own: Option<Mac>,
    cards: Vec<Known>,
    /// The event at hand, copied from the ring.
    event: Vec<u8>,
    is_held: bool,
    code: u8,
    body: Vec<u8>,
    scratch: Box<[u8; MAX_BODY]>,
    /// The program's counters as the last event had them; they wrap.
    seen: (u32, u32),
    counters: StockCounts,
}

impl Intake {
    fn new(options: stock::Options, own: Option<Mac>) -> Self {
        Self {
            options,
            own,
            cards: Vec::with_capacity(CARDS_KEPT),
            event: Vec::with_capacity(MAX_LENGTH),
            is_held: false,
            code: 0,
            body: Vec::with_capacity(MAX_LENGTH),
            scratch: Box::new([0; MAX_BODY]),
            seen: (0, 0),
            counters: StockCounts::default(),
        }
    }

    /// Takes an event from the ring.
    fn take(&mut self, bytes: &[u8]) {
        self.event.clear();
        self.event.extend_from_slice(bytes);
        self.is_held = true;
    }

    /// Looks at the event at hand.
    fn turn(&mut self, clocks: Clocks) -> Turn {
        let Some(event) = Event::new_checked(&self.event) else {
            self.is_held = false;
            self.counters.malformed += 1;
            self.cards.iter_mut().for_each(|known| known.card.gap());
            return Turn::Next;
        };
        let Event { ring_full, unreadable, .. } = event;
        let missing = [ring_full.wrapping_sub(self.seen.0), unreadable.wrapping_sub(self.seen.1)];
        if missing != [0, 0] {
            // For all cards: none may combine packets before and after the gap.
            self.seen = (ring_full, unreadable);
            self.cards.iter_mut().for_each(|known| known.card.gap());
            self.counters.ring_full += u64::from(missing[0]);
            self.counters.unreadable += u64::from(missing[1]);
            return Turn::Lost(Loss::Overrun { dropped: Some(missing.into_iter().map(u64::from).sum()) });
        }
        self.is_held = false;
        let host_us = clocks.wall_at(event.time_ns);
        let at = place(&mut self.cards, &mut self.counters, event.card);
        let Some(known) = self.cards.get_mut(at) else { return Turn::Next };
        let packet = event.packet();
        if let Packet::RxMpdu(Some(mpdu)) = &packet {
            let sender = mpdu.sender().map(|(mac, _)| mac);
            known.is_others |= sender.is_some() && sender == self.own;
        }
        let counts = &mut self.counters.cards;
        let records = counts.records;
        let handled = known.card.handle(counts, &self.options, &packet, host_us.unwrap_or(0), &mut self.scratch);
        known.has_csi |= self.counters.cards.records != records;
        let Some(record) = handled else { return Turn::Next };
        if known.is_others {
            self.counters.others += 1;
            return Turn::Next;
        }
        if record.code == code::MPDU && !known.has_csi {
            // Possibly another kind of card, whose driver shares the function.
            self.counters.held_back += 1;
            return Turn::Next;
        }
        self.code = record.code;
        self.body.clear();
        self.body.extend_from_slice(record.body);
        self.counters.records += 1;
        let stamp = Bfee::new_checked(&self.body).ok().filter(|_| self.code == code::BFEE);
        let came = |us| stamp.map_or(us, |bfee| known.host_times.came_at(us, bfee.timestamp_low()));
        Turn::Record(host_us.map(came))
    }

    /// The record of the last [`Turn::Record`].
    fn record(&self) -> Record<'_> {
        Record { code: self.code, body: &self.body }
    }
}

/// The place of a card, made if it is new.
fn place(cards: &mut Vec<Known>, counters: &mut StockCounts, key: u64) -> usize {
    if let Some(at) = cards.iter().position(|known| known.key == key) {
        return at;
    }
    if cards.len() >= CARDS_KEPT {
        cards.remove(0);
    }
    counters.cards_seen += 1;
    cards.push(Known { key, ..Known::default() });
    cards.len() - 1
}

/// Built from `driver-iface/bpf/csi5300.bpf.c`; `tests/checks/ebpf.sh` holds it equal to that.
static OBJECT: &[u8] = aya::include_bytes_aligned!("../../../driver-iface/bpf/csi5300.bpf.o");
/// The function that iwldvm hands every packet to, in iwlwifi.
const FUNCTION: &str = "iwl_notification_wait";
/// Where the module is, once loaded.
const DRIVER: &str = "/sys/module/iwlwifi";

/// The driver's parameter for larger receive buffers: 2 makes them 8 KiB, and iwldvm has 4 KiB otherwise (`dvm/main.c`).
const BUFFERS: &str = "/sys/module/iwlwifi/parameters/amsdu_size";

/// Hits, events without room in the ring, packets that could not be read (`struct counts` of the program).
type Counts = [u64; 3];

/// The loaded program.
struct Program {
    ebpf: Ebpf,
    link: Option<KProbeLinkId>,
    counts: Array<MapData, Counts>,
    /// The inode of [`DRIVER`] to which the probe belongs: another one each time that the module is loaded.
    driver: Option<u64>,
}

impl Program {
    /// Loads and attaches. The ring has `ring` bytes, a power of two and of whole pages.
    fn load(ring: u32, whole_frames: bool) -> Result<(Self, RingBuf<MapData>), Error> {
        prerequisites()?;
        // Before 5.11 maps count as locked memory. Where it is refused the kernel says so below.
        let _ = setrlimit(Resource::RLIMIT_MEMLOCK, RLIM_INFINITY, RLIM_INFINITY);
        let whole = u8::from(whole_frames);
        let buffer =
            if std::fs::read_to_string(BUFFERS).is_ok_and(|size| size.trim() == "2") { 8_192_u32 } else { 4_096 };
        let mut loader = EbpfLoader::new();
        loader.map_max_entries("EVENTS", ring).override_global("WHOLE_FRAMES", &whole, true);
        loader.override_global("BUFFER", &buffer, true);
        let mut ebpf = loader.load(OBJECT).map_err(of_loading)?;
        kprobe(&mut ebpf)?.load().map_err(of_loading)?;
        let taken = |map: Option<aya::maps::Map>| map.ok_or_else(missing);
        let events = RingBuf::try_from(taken(ebpf.take_map("EVENTS"))?).map_err(of_loading)?;
        let counts = Array::try_from(taken(ebpf.take_map("COUNTS"))?).map_err(of_loading)?;
        let mut program = Self { ebpf, link: None, counts, driver: driver() };
        if !program.attach()? {
            return Err(refused(format!(
                "iwlwifi is loaded, but `{FUNCTION}` is not in /proc/kallsyms as a function that can be probed"
            )));
        }
        Ok((program, events))
    }

    /// Attaches; false if the driver has no function of this name that can be probed.
    fn attach(&mut self) -> Result<bool, Error> {
        match kprobe(&mut self.ebpf)?.attach(FUNCTION, 0) {
            Ok(link) => self.link = Some(link),
            Err(error) => match code_of(&error) {
                Some(libc::ENOENT | libc::EADDRNOTAVAIL | libc::EINVAL) => return Ok(false),
                _ => return Err(of_attaching(error, paranoid())),
            },
        }
        Ok(true)
    }

    /// Attaches again if the driver was reloaded: the kernel removes the probe with the module. True if so.
    fn follow_driver(&mut self) -> Result<bool, Error> {
        let driver = driver();
        if driver.is_none() || driver == self.driver {
            return Ok(false);
        }
        if let Some(link) = self.link.take() {
            kprobe(&mut self.ebpf)?.detach(link).map_err(|error| of_attaching(error, paranoid()))?;
        }
        // While the module is loading it has no function; the next check will find it.
        let is_attached = self.attach()?;
        self.driver = if is_attached { driver } else { self.driver };
        Ok(is_attached)
    }

    /// Hits at which the kernel did not run the program, because another one ran on that processor; 0 if it does not
    /// count them (before 6.7).
    fn missed(&self) -> u64 {
        let program = self.ebpf.program("csi5300").and_then(|program| program.fd().ok());
        let about = program
            .and_then(|fd| std::fs::read_to_string(format!("/proc/self/fdinfo/{}", fd.as_fd().as_raw_fd())).ok());
        missed_of(&about.unwrap_or_default())
    }

    /// The program's counters; `None` if the kernel refuses them.
    fn counts(&self) -> Option<Counts> {
        self.counts.get(&0, 0).ok()
    }
}

/// What the kernel says of a program's file descriptor (`bpf_prog_show_fdinfo`).
fn missed_of(about: &str) -> u64 {
    let line = about.lines().find_map(|line| line.strip_prefix("recursion_misses:"));
    line.and_then(|count| count.trim().parse().ok()).unwrap_or(0)
}

/// The kprobe in the object.
fn kprobe(ebpf: &mut Ebpf) -> Result<&mut KProbe, Error> {
    let program = ebpf.program_mut("csi5300").ok_or_else(missing)?;
    program.try_into().map_err(|error: aya::programs::ProgramError| not_taken(&error))
}

/// The object does not match its source.
fn missing() -> Error {
    refused("the object of the eBPF program lacks a map or the program")
}

fn driver() -> Option<u64> {
    Path::new(DRIVER).metadata().ok().map(|about| about.ino())
}

fn paranoid() -> Option<i32> {
    std::fs::read_to_string(PARANOID).ok()?.trim().parse().ok()
}

/// Checks with clearer errors than the kernel's.
fn prerequisites() -> Result<(), Error> {
    if let Some(why) = no_ebpf(&Machine) {
        let words =
            format!("this kernel does not take the eBPF program ({why}): `csi5300 doctor` names the other ways to CSI");
        return Err(refused(words));
    }
    let hint =
        "iwlwifi is not loaded: `sudo modprobe iwlwifi`; if it does not stay, `sudo dmesg | grep iwlwifi` shows why";
    driver().map(|_| ()).ok_or_else(|| refused(hint))
}

/// From which capability on perf events are allowed.
const PARANOID: &str = "/proc/sys/kernel/perf_event_paranoid";

/// What the program needs of the kernel's permissions.
fn not_allowed() -> Error {
    let grant = grant(&Machine, &EBPF_NEEDS);
    refused(format!(
        "the kernel refuses eBPF to this process: CAP_BPF and CAP_PERFMON are needed; `{grant}`, or run it as root"
    ))
}

/// An error and what is below it.
fn causes<'e>(error: &'e (dyn StdError + 'static)) -> impl Iterator<Item = &'e (dyn StdError + 'static)> {
    let mut next = Some(error);
    std::iter::from_fn(move || {
        let cause = next?;
        next = cause.source();
        Some(cause)
    })
}

/// The operating system's answer in an error, if it has one.
fn code_of(error: &(dyn StdError + 'static)) -> Option<i32> {
    causes(error).find_map(|error| error.downcast_ref::<io::Error>()?.raw_os_error())
}

/// The kernel's refusal with all its reasons, the verifier's too.
fn not_taken(error: &(dyn StdError + 'static)) -> Error {
    let mut text = "the kernel does not take the eBPF program".to_owned();
    for cause in causes(error).map(ToString::to_string) {
        if !text.contains(&cause) {
            text += &format!(": {cause}");
        }
    }
    refused(text)
}

/// A failure of loading, by the kernel's answer. EACCES is the verifier's "no", with its words.
fn of_loading(error: impl StdError + 'static) -> Error {
    if code_of(&error) == Some(libc::EPERM) { not_allowed() } else { not_taken(&error) }
}

/// A failure of attaching, by the kernel's answer and its level of [`PARANOID`].
fn of_attaching(error: impl StdError + 'static, paranoid: Option<i32>) -> Error {
    match (code_of(&error), paranoid) {
        // The program was loaded, so CAP_BPF and CAP_PERFMON are held.
        (Some(libc::EACCES), Some(level)) if level > 2 => refused(format!(
            "{PARANOID} is {level}: with more than 2 kernels of Debian and Ubuntu leave probes to CAP_SYS_ADMIN; \
             `sudo sysctl -w kernel.perf_event_paranoid=2`, or run it as root"
        )),
        (Some(libc::EPERM | libc::EACCES), _) => not_allowed(),
        _ => not_taken(&error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_object_has_what_is_loaded_from_it() {
        for name in
            ["EVENTS", "COUNTS", "SCRATCH", "WHOLE_FRAMES", "BUFFER", "kprobe/iwl_notification_wait", "Dual MIT/GPL"]
        {
            assert!(OBJECT.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
        }
    }

    #[test]
    fn missed_hits_are_what_the_kernel_says() {
        let about = "prog_type:\t2\nrun_cnt:\t9\nrecursion_misses:\t7\nverified_insns:\t300\n";
        assert_eq!((missed_of(about), missed_of("prog_type:\t2\n")), (7, 0));
    }

    #[derive(Debug, thiserror::Error)]
    #[error("outer")]
    struct Outer(#[source] io::Error);

    #[test]
    fn failures_are_sorted_by_the_kernel_s_answer() {
        let answer = |code| Outer(io::Error::from_raw_os_error(code));
        assert!(of_loading(answer(libc::EPERM)).to_string().contains("setcap cap_bpf,cap_perfmon"));
        assert!(of_attaching(answer(libc::EACCES), Some(2)).to_string().contains("setcap cap_bpf,cap_perfmon"));
        let debian = of_attaching(answer(libc::EACCES), Some(3)).to_string();
        assert!(debian.contains("sysctl -w kernel.perf_event_paranoid=2"), "{debian}");
        // With its reasons, which the verifier writes.
        let refused = "the kernel does not take the eBPF program: outer: ";
        for told in [of_loading(answer(libc::EACCES)), of_attaching(answer(libc::ENOMEM), None)] {
            let told = told.to_string();
            assert!(told.starts_with(refused) && told.contains("os error"), "{told}");
        }
    }

    const NOW: Clocks = Clocks { monotonic_ns: 5_000_000_000, wall_us: Some(1_700_000_000_000_000) };

    /// An event of a card, `age_us` before now, after `ring_full` losses.
    fn event(card: u64, age_us: u64, ring_full: u32, command: u8, data: &[u8]) -> Vec<u8> {
        let time_ns = NOW.monotonic_ns as u64 - age_us * 1_000;
        let data_len = data.len() as u32;
        let event = Event { card, time_ns, ring_full, command, data_len, data, ..Event::default() };
        let mut out = vec![0; 32 + data.len()];
        event.emit(&mut out).unwrap();
        out
    }

    fn phy(timestamp: u32) -> Vec<u8> {
        let mut data = vec![0; 64];
        data[1] = 1;
        data[4..8].copy_from_slice(&timestamp.to_le_bytes());
        data[60] = 0x24;
        data
    }

    fn csi() -> Vec<u8> {
        let mut data = vec![0; 20 + 192];
        (data[8], data[9], data[16]) = (3, 1, 192);
        data
    }

    /// Every turn of some events: records as (code, host time), and losses.
    fn turns(intake: &mut Intake, events: &[Vec<u8>]) -> (Vec<(u8, Option<i64>)>, Vec<Loss>) {
        let (mut records, mut losses) = (Vec::new(), Vec::new());
        for event in events {
            intake.take(event);
            while intake.is_held {
                match intake.turn(NOW) {
                    Turn::Record(host_us) => records.push((intake.record().code, host_us)),
                    Turn::Lost(loss) => losses.push(loss),
                    Turn::Next => {}
                }
            }
        }
        (records, losses)
    }

    #[test]
    fn host_times_are_those_of_the_kernel() {
        let mut intake = Intake::new(stock::Options::default(), None);
        let events: Vec<_> = (0..3)
            .flat_map(|k| {
                [
                    event(1, 3_000 - k * 1_000, 0, 0xC0, &phy(k as u32 * 1_000)),
                    event(1, 2_990 - k * 1_000, 0, 0xBB, &csi()),
                ]
            })
            .collect();
        let (records, losses) = turns(&mut intake, &events);
        let at = |age_us: i64| (0xBB, Some(1_700_000_000_000_000 - age_us));
        assert_eq!((records, losses), (vec![at(2_990), at(1_990), at(990)], vec![]));
        intake.take(&event(1, 0, 0, 0xC0, &phy(3_000)));
        assert_eq!(intake.turn(NOW), Turn::Next);
        intake.take(&event(1, 0, 0, 0xBB, &csi()));
        assert_eq!(intake.turn(Clocks { wall_us: None, ..NOW }), Turn::Record(None));
    }

    #[test]
    fn a_full_ring_is_reported_at_its_gap_and_no_record_spans_it() {
        let mut intake = Intake::new(stock::Options::default(), None);
        let events = [
            event(1, 0, 0, 0xC0, &phy(1)),
            // The 0xBB of this frame and the 0xC0 of the next were lost.
            event(1, 0, 2, 0xBB, &csi()),
            event(1, 0, 2, 0xC0, &phy(2)),
            event(1, 0, 2, 0xBB, &csi()),
        ];
        let (records, losses) = turns(&mut intake, &events);
        assert_eq!(losses, [Loss::Overrun { dropped: Some(2) }]);
        assert_eq!(records.len(), 1);
        let counters = intake.counters;
        assert_eq!((counters.ring_full, counters.records, counters.cards.no_phy), (2, 1, 1));
        // The program's counter is 32 bits wide here, and wraps.
        let (mut intake, wrapped) = (Intake::new(stock::Options::default(), None), event(1, 0, 1, 0xC0, &phy(1)));
        assert_eq!(turns(&mut intake, &[event(1, 0, u32::MAX, 0xC0, &phy(1)), wrapped]).1.len(), 2);
        assert_eq!(intake.counters.ring_full, u64::from(u32::MAX) + 2);
    }

    #[test]
    fn cards_are_kept_apart() {
        let mut intake = Intake::new(stock::Options::default(), None);
        let [a, b] = [0xffff_8880_0000_1000, 0xffff_8880_0000_2000];
        let events = [event(a, 0, 0, 0xC0, &phy(1)), event(b, 0, 0, 0xBB, &csi()), event(a, 0, 0, 0xBB, &csi())];
        let (records, _) = turns(&mut intake, &events);
        assert_eq!((records.len(), intake.counters.cards.no_phy, intake.counters.cards_seen), (1, 1, 2));
        // More cards than are kept: the counts of those that made room stay.
        let many: Vec<_> = (0..100).map(|k| event(k, 0, 0, 0xC0, &phy(1))).collect();
        turns(&mut intake, &many);
        let counters = intake.counters;
        assert_eq!((counters.cards_seen, counters.cards.phy, counters.cards.records), (102, 101, 1));
        intake.cards.clear();
        assert_eq!(intake.counters.cards.phy, 101);
        // After the driver's reload the 0xC0 from before it is not used.
        assert_eq!(turns(&mut intake, &[event(99, 0, 0, 0xBB, &csi())]).0.len(), 0);
    }

    #[test]
    fn frames_of_a_card_without_csi_are_held_back() {
        let mut intake = Intake::new(stock::Options { frames: true, ..stock::Options::default() }, None);
        let mut mpdu = vec![0; 4 + 40 + 4];
        mpdu[0] = 40;
        let frame = |card| [event(card, 0, 0, 0xC0, &phy(1)), event(card, 0, 0, 0xC1, &mpdu)];
        let of = |events: &[Vec<u8>], intake: &mut Intake| -> Vec<u8> {
            turns(intake, events).0.into_iter().map(|(code, _)| code).collect()
        };
        assert!(of(&frame(7), &mut intake).is_empty());
        assert_eq!(of(&[event(7, 0, 0, 0xBB, &csi())], &mut intake), [0xBB]);
        assert_eq!(of(&frame(7), &mut intake), [0xC1]);
        assert!(of(&frame(8), &mut intake).is_empty());
        assert_eq!(intake.counters.held_back, 2);
    }

    #[test]
    fn invalid_events_are_counted() {
        let mut intake = Intake::new(stock::Options::default(), None);
        let mut flagged = event(1, 0, 0, 0xC0, &phy(1));
        flagged[29] = 0x80;
        let (records, losses) = turns(&mut intake, &[vec![], vec![0; 31], flagged, event(1, 0, 0, 0xBB, &csi())]);
        assert!(records.is_empty() && losses.is_empty());
        assert_eq!(intake.counters.malformed, 3);
    }

    #[test]
    fn a_card_that_hears_this_robot_belongs_to_another() {
        let own = Mac([0, 0x21, 0x6a, 0, 0, 1]);
        let mut intake = Intake::new(stock::Options::default(), Some(own));
        let mut mpdu = vec![0; 4 + 40 + 4];
        (mpdu[0], mpdu[44]) = (40, 3);
        let heard = |card: u64, sender: Mac| {
            let mut mpdu = mpdu.clone();
            mpdu[4 + 16..4 + 22].copy_from_slice(&sender.0);
            mpdu[4 + 27] = 9;
            vec![event(card, 0, 0, 0xC0, &phy(1)), event(card, 0, 0, 0xC1, &mpdu), event(card, 0, 0, 0xBB, &csi())]
        };
        let (peer, third) = (Mac([2; 6]), Mac([3; 6]));
        let mut given = |events: Vec<Vec<u8>>| turns(&mut intake, &events).0.len();
        // Card 1 is this robot's: it hears the peer. Card 2 is the peer's: from its first frame of this robot on nothing of it is given.
        assert_eq!(
            [given(heard(1, peer)), given(heard(2, own)), given(heard(2, third)), given(heard(1, third))],
            [1, 0, 0, 1]
        );
        assert_eq!((intake.counters.others, intake.counters.records), (2, 2));
        // A frame with a bad checksum says nothing of its sender.
        let mut bad = heard(1, own);
        let status = bad[1].len() - 4;
        bad[1][status] = 0;
        assert_eq!(turns(&mut intake, &bad).0.len(), 1);
    }
}
