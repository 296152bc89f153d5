//! The eBPF program: loaded, attached, and attached again when the driver comes back.

use super::error::{KPROBE_TYPE, LOCKDOWN, PARANOID, StockError, of_attaching, of_loading};
use crate::doctor::{EBPF_FROM, kernel_version};
use aya::maps::{Array, MapData, RingBuf};
use aya::programs::KProbe;
use aya::programs::kprobe::KProbeLinkId;
use aya::{Ebpf, EbpfLoader};
use nix::sys::resource::{RLIM_INFINITY, Resource, setrlimit};
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Built from `driver-iface/bpf/csi5300.bpf.c`; `tests/checks/ebpf.sh` holds it equal to that.
static OBJECT: &[u8] = aya::include_bytes_aligned!("../../../../driver-iface/bpf/csi5300.bpf.o");
/// The function that iwldvm hands every packet to, in iwlwifi.
const FUNCTION: &str = "iwl_notification_wait";
/// Where the module is, once loaded.
const DRIVER: &str = "/sys/module/iwlwifi";

/// The driver's parameter for larger receive buffers: 2 makes them 8 KiB, and iwldvm has 4 KiB otherwise (`dvm/main.c`).
const BUFFERS: &str = "/sys/module/iwlwifi/parameters/amsdu_size";

/// Hits, events without room in the ring, packets that could not be read (`struct counts` of the program).
pub(super) type Counts = [u64; 3];

/// The loaded program.
pub(super) struct Program {
    ebpf: Ebpf,
    link: Option<KProbeLinkId>,
    counts: Array<MapData, Counts>,
    /// The inode of [`DRIVER`] to which the probe belongs: another one each time that the module is loaded.
    driver: Option<u64>,
}

impl Program {
    /// Loads and attaches. The ring has `ring` bytes, a power of two and of whole pages.
    pub(super) fn load(ring: u32, whole_frames: bool) -> Result<(Self, RingBuf<MapData>), StockError> {
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
        kprobe(&mut ebpf)?.load().map_err(|error| locked_down().unwrap_or_else(|| of_loading(error)))?;
        let taken = |map: Option<aya::maps::Map>| map.ok_or_else(missing);
        let events = RingBuf::try_from(taken(ebpf.take_map("EVENTS"))?).map_err(of_loading)?;
        let counts = Array::try_from(taken(ebpf.take_map("COUNTS"))?).map_err(of_loading)?;
        let mut program = Self { ebpf, link: None, counts, driver: driver() };
        program.attach()?;
        Ok((program, events))
    }

    fn attach(&mut self) -> Result<(), StockError> {
        self.link = Some(
            kprobe(&mut self.ebpf)?.attach(FUNCTION, 0).map_err(|error| of_attaching(error, FUNCTION, paranoid()))?,
        );
        Ok(())
    }

    /// Attaches again if the driver was reloaded: the kernel removes the probe with the module. True if so.
    pub(super) fn follow_driver(&mut self) -> Result<bool, StockError> {
        let driver = driver();
        if driver.is_none() || driver == self.driver {
            return Ok(false);
        }
        if let Some(link) = self.link.take() {
            kprobe(&mut self.ebpf)?.detach(link).map_err(|error| of_attaching(error, FUNCTION, paranoid()))?;
        }
        match self.attach() {
            Ok(()) => self.driver = driver,
            // The module is loading; the next check will find it.
            Err(StockError::NoFunction { .. }) => return Ok(false),
            Err(error) => return Err(error),
        }
        Ok(true)
    }

    /// True while the driver to which the probe belongs is loaded.
    pub(super) fn is_attached(&self) -> bool {
        self.link.is_some() && driver() == self.driver
    }

    /// Hits at which the kernel did not run the program, because another one ran on that processor; 0 if it does not
    /// count them (before 6.7).
    pub(super) fn missed(&self) -> u64 {
        let program = self.ebpf.program("csi5300").and_then(|program| program.fd().ok());
        let about = program
            .and_then(|fd| std::fs::read_to_string(format!("/proc/self/fdinfo/{}", fd.as_fd().as_raw_fd())).ok());
        missed_of(&about.unwrap_or_default())
    }

    /// The program's counters; `None` if the kernel refuses them.
    pub(super) fn counts(&self) -> Option<Counts> {
        self.counts.get(&0, 0).ok()
    }
}

/// What the kernel says of a program's file descriptor (`bpf_prog_show_fdinfo`).
fn missed_of(about: &str) -> u64 {
    let line = about.lines().find_map(|line| line.strip_prefix("recursion_misses:"));
    line.and_then(|count| count.trim().parse().ok()).unwrap_or(0)
}

/// The kprobe in the object.
fn kprobe(ebpf: &mut Ebpf) -> Result<&mut KProbe, StockError> {
    let program = ebpf.program_mut("csi5300").ok_or_else(missing)?;
    program.try_into().map_err(|error: aya::programs::ProgramError| StockError::Load { source: Box::new(error) })
}

/// The object does not match its source.
fn missing() -> StockError {
    StockError::Load { source: "the object lacks a map or the program".into() }
}

fn driver() -> Option<u64> {
    Path::new(DRIVER).metadata().ok().map(|about| about.ino())
}

fn paranoid() -> Option<i32> {
    std::fs::read_to_string(PARANOID).ok()?.trim().parse().ok()
}

fn locked_down() -> Option<StockError> {
    let levels = std::fs::read_to_string(LOCKDOWN).ok()?;
    levels.contains("[confidentiality]").then_some(StockError::LockedDown)
}

/// Checks with clearer errors than the kernel's.
fn prerequisites() -> Result<(), StockError> {
    if !cfg!(target_arch = "x86_64") {
        return Err(StockError::Architecture { architecture: std::env::consts::ARCH });
    }
    let release = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    if let Some(found) = kernel_version(&release).filter(|found| *found < EBPF_FROM) {
        return Err(StockError::Kernel { found });
    }
    if !Path::new(KPROBE_TYPE).exists() {
        return Err(StockError::NoKprobes);
    }
    driver().map(|_| ()).ok_or(StockError::NoDriver)
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
}
