//! Errors of reading a card's packets under the kernel's own driver.

use std::error::Error as StdError;
use std::io;

/// Why the eBPF program cannot be loaded or attached; inside [`csi5300::source::Error::Backend`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StockError {
    /// The program reads the arguments of a function as x86-64 passes them.
    #[error("the eBPF program is for x86-64, and this is {architecture}")]
    Architecture {
        /// This program's architecture.
        architecture: &'static str,
    },
    /// The kernel has no ring buffer for eBPF.
    #[error("Linux {}.{} is too old for the eBPF program, which needs 5.8; the patched driver is for such kernels", .found.0, .found.1)]
    Kernel {
        /// Version and patch level.
        found: (u32, u32),
    },
    /// The kernel lacks kprobes.
    #[error("the kernel has no kprobes for perf (CONFIG_KPROBES and CONFIG_KPROBE_EVENTS): {KPROBE_TYPE} is absent")]
    NoKprobes,
    /// The driver is not loaded.
    #[error(
        "iwlwifi is not loaded: `sudo modprobe iwlwifi`; if it does not stay, `sudo dmesg | grep iwlwifi` shows why"
    )]
    NoDriver,
    /// The driver has no function of this name.
    #[error("iwlwifi is loaded, but `{function}` is not in /proc/kallsyms as a function that can be probed")]
    NoFunction {
        /// The function.
        function: &'static str,
        /// The kernel's answer.
        source: io::Error,
    },
    /// The process lacks a capability.
    #[error(
        "the kernel refuses eBPF to this process: CAP_BPF and CAP_PERFMON are needed; \
         `sudo setcap cap_bpf,cap_perfmon,cap_net_admin+ep $(command -v csi5300)`, or run it as root"
    )]
    Refused {
        /// The kernel's answer.
        source: io::Error,
    },
    /// Debian's and Ubuntu's kernels require more than CAP_PERFMON for a probe above a level of their own.
    #[error(
        "{PARANOID} is {level}: with more than 2 kernels of Debian and Ubuntu leave probes to CAP_SYS_ADMIN; \
         `sudo sysctl -w kernel.perf_event_paranoid=2`, or run it as root"
    )]
    Paranoid {
        /// The level in force.
        level: i32,
    },
    /// Secure Boot in its strictest form.
    #[error("the kernel is locked down (confidentiality, see {LOCKDOWN}): no program may read its memory")]
    LockedDown,
    /// The kernel refuses the program, or an earlier step failed.
    #[error("the kernel does not take the eBPF program")]
    Load {
        /// The reason, with the verifier's message if any.
        source: Box<dyn StdError + Send + Sync>,
    },
}

/// The type of perf events that are kprobes.
pub(super) const KPROBE_TYPE: &str = "/sys/bus/event_source/devices/kprobe/type";
/// From which capability on perf events are allowed.
pub(super) const PARANOID: &str = "/proc/sys/kernel/perf_event_paranoid";
/// The kernel's lockdown, the level in force in brackets.
pub(super) const LOCKDOWN: &str = "/sys/kernel/security/lockdown";

impl From<StockError> for csi5300::source::Error {
    fn from(error: StockError) -> Self {
        Self::Backend(Box::new(error))
    }
}

/// The operating system's answer at the root of an error, if it has one.
fn io_root<'e>(error: &'e (dyn StdError + 'static)) -> Option<&'e io::Error> {
    let mut at = Some(error);
    while let Some(error) = at {
        if let Some(io) = error.downcast_ref::<io::Error>() {
            return Some(io);
        }
        at = error.source();
    }
    None
}

/// Sorts a failure of loading by the kernel's answer. EACCES is the verifier's "no", with its words.
pub(super) fn of_loading(error: impl StdError + Send + Sync + 'static) -> StockError {
    match io_root(&error).and_then(io::Error::raw_os_error) {
        Some(code @ libc::EPERM) => StockError::Refused { source: io::Error::from_raw_os_error(code) },
        _ => StockError::Load { source: Box::new(error) },
    }
}

/// Sorts a failure of attaching to a function by the kernel's answer and its level of [`PARANOID`].
pub(super) fn of_attaching(
    error: impl StdError + Send + Sync + 'static,
    function: &'static str,
    paranoid: Option<i32>,
) -> StockError {
    let code = io_root(&error).and_then(io::Error::raw_os_error);
    let source = || io::Error::from_raw_os_error(code.unwrap_or_default());
    match (code, paranoid) {
        // The program was loaded, so CAP_BPF and CAP_PERFMON are held.
        (Some(libc::EACCES), Some(level)) if level > 2 => StockError::Paranoid { level },
        (Some(libc::EPERM | libc::EACCES), _) => StockError::Refused { source: source() },
        // A function that is not there, and one that cannot be probed.
        (Some(libc::ENOENT | libc::EADDRNOTAVAIL | libc::EINVAL), _) => {
            StockError::NoFunction { function, source: source() }
        }
        _ => StockError::Load { source: Box::new(error) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("outer")]
    struct Outer(#[source] io::Error);

    #[test]
    fn failures_are_sorted_by_the_kernel_s_answer() {
        let answer = |code| Outer(io::Error::from_raw_os_error(code));
        assert!(matches!(of_loading(answer(libc::EPERM)), StockError::Refused { .. }));
        assert!(matches!(of_loading(answer(libc::EACCES)), StockError::Load { .. }));
        assert!(matches!(of_attaching(answer(libc::EACCES), "f", Some(2)), StockError::Refused { .. }));
        let debian = of_attaching(answer(libc::EACCES), "f", Some(3));
        assert!(debian.to_string().contains("sysctl -w kernel.perf_event_paranoid=2"), "{debian}");
        assert!(matches!(
            of_attaching(answer(libc::ENOENT), "f", Some(3)),
            StockError::NoFunction { function: "f", .. }
        ));
        assert!(matches!(of_attaching(answer(libc::ENOMEM), "f", None), StockError::Load { .. }));
        assert!(of_loading(answer(libc::EPERM)).to_string().contains("setcap cap_bpf,cap_perfmon"));
    }
}
