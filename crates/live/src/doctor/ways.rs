//! Finds which of the three ways to CSI this machine can use: the patched driver, the kernel module beside the
//! distribution's driver, or an eBPF program beside it.

use super::card::SECURE_BOOT;
use super::host::holds;
use super::{Check, System};

/// The first kernel with a ring buffer for eBPF (BPF_MAP_TYPE_RINGBUF), and with CAP_BPF and CAP_PERFMON.
pub(crate) const EBPF_FROM: (u32, u32) = (5, 8);
/// Bits of CapEff (`linux/capability.h`).
const CAP_SYS_ADMIN: u32 = 21;
const CAP_PERFMON: u32 = 38;
const CAP_BPF: u32 = 39;
/// The path of the loaded module.
const MODULE: &str = "/sys/module/csi5300";

/// Version and patch level of a kernel's release: 6.1 of `6.1.0-56-amd64`.
pub(crate) fn kernel_version(release: &str) -> Option<(u32, u32)> {
    let mut numbers = release.trim().split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

/// The state of a way.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Way {
    /// In use.
    Taken(&'static str),
    /// Ready.
    Open(&'static str),
    /// One step away: what is missing, and how to get it.
    Needs(&'static str, &'static str),
    /// Impossible on this machine, and why.
    Closed(String),
}

/// The ways and their names, best first.
pub(super) struct Ways {
    patched: Way,
    module: Way,
    ebpf: Way,
}

impl Ways {
    pub(super) fn find(system: &dyn System) -> Self {
        Self { patched: patched(system), module: module(system), ebpf: ebpf(system) }
    }

    /// True if another way than the patched driver works, so that its problems do not matter.
    pub(super) fn without_patch(&self) -> bool {
        !matches!(self.patched, Way::Taken(_))
            && [&self.module, &self.ebpf].iter().any(|way| matches!(way, Way::Taken(_) | Way::Open(_)))
    }

    /// True if one of the other ways needs at most one step.
    pub(super) fn leads_past_patch(&self) -> bool {
        !matches!(self.patched, Way::Taken(_))
            && [&self.module, &self.ebpf].iter().any(|way| !matches!(way, Way::Closed(_)))
    }

    pub(super) fn check(&self) -> Check {
        let expected = "the patched driver, the module csi5300, or Linux 5.8 and later for `record --stock`";
        let all = [("patched driver", &self.patched), ("module", &self.module), ("eBPF", &self.ebpf)];
        let words = |(name, way): &(&str, &Way)| match way {
            Way::Taken(what) => format!("{name}: in use ({what})"),
            Way::Open(what) => format!("{name}: yes ({what})"),
            Way::Needs(what, _) => format!("{name}: after a step ({what})"),
            Way::Closed(why) => format!("{name}: no ({why})"),
        };
        let list = all.iter().map(words).collect::<Vec<_>>().join("; ");
        // The one in use is best, then a ready one, of these the one with more functions.
        let by = |wanted: fn(&Way) -> bool| all.iter().find(|(_, way)| wanted(way));
        let taken = by(|way| matches!(way, Way::Taken(_)));
        let best = taken.or(by(|way| matches!(way, Way::Open(_)))).or(by(|way| matches!(way, Way::Needs(..))));
        let name = "way to CSI";
        match best {
            Some((best, Way::Taken(_))) => Check::good(name, format!("{list}. Best here: {best}"), expected),
            Some((best, Way::Open(what))) => {
                Check::good(name, format!("{list}. Best here: {best}"), expected).mend(*what)
            }
            Some((best, Way::Needs(_, mend))) => {
                Check::doubt(name, format!("{list}. Best here: {best}"), expected).mend(*mend)
            }
            _ => Check::bad(name, list, expected)
                .mend("install a kernel for which a way is open: any distribution's of 5.8 or later will do"),
        }
    }
}

fn patched(system: &dyn System) -> Way {
    match system.text("/sys/module/iwlwifi/parameters/connector_log") {
        Some(_) => Way::Taken("iwlwifi has connector_log"),
        None => Way::Closed("this iwlwifi has no connector_log".into()),
    }
}

fn module(system: &dyn System) -> Way {
    if !system.names(MODULE).is_empty() {
        return Way::Taken("csi5300 is loaded");
    }
    let Some(release) = system.text("/proc/sys/kernel/osrelease") else {
        return Way::Closed("the kernel's release is unknown".into());
    };
    if system.bytes(SECURE_BOOT).and_then(|bytes| bytes.get(4).copied()) == Some(1) {
        return Way::Closed("Secure Boot refuses unsigned modules".into());
    }
    if system.names(&format!("/lib/modules/{release}/build")).is_empty() {
        let mend = "sudo apt install linux-headers-$(uname -r) dkms, then the package of packaging/dkms";
        return Way::Needs("no kernel headers", mend);
    }
    Way::Needs("headers are there", "sudo apt install dkms, then the package of packaging/dkms")
}

fn ebpf(system: &dyn System) -> Way {
    let release = system.text("/proc/sys/kernel/osrelease").unwrap_or_default();
    match kernel_version(&release) {
        Some(version) if version >= EBPF_FROM => {}
        Some(_) => return Way::Closed(format!("{release} is older than 5.8")),
        None => return Way::Closed("the kernel's release is unknown".into()),
    }
    if system.run(&["uname", "-m"]).is_some_and(|ran| ran.ok && ran.text.trim() != "x86_64") {
        return Way::Closed("not x86-64".into());
    }
    if system.text("/sys/bus/event_source/devices/kprobe/type").is_none() {
        return Way::Closed("the kernel has no kprobes".into());
    }
    let lockdown = system.text("/sys/kernel/security/lockdown").unwrap_or_default();
    if lockdown.contains("[confidentiality]") {
        return Way::Closed("kernel lockdown `confidentiality`".into());
    }
    if system.names("/sys/module/iwlwifi").is_empty() {
        return Way::Needs("iwlwifi is not loaded", "sudo modprobe iwlwifi");
    }
    if !may_load(system) {
        let mend = "sudo setcap cap_bpf,cap_perfmon,cap_net_admin+ep $(command -v csi5300)";
        return Way::Needs("CAP_BPF and CAP_PERFMON are not held", mend);
    }
    // An extra level of Debian's and Ubuntu's kernels, at which CAP_PERFMON is not enough for a probe.
    let paranoid = system.text("/proc/sys/kernel/perf_event_paranoid").and_then(|level| level.parse::<i32>().ok());
    if paranoid.is_some_and(|level| level > 2) && holds(system, CAP_SYS_ADMIN) != Some(true) {
        let mend = "sudo sysctl -w kernel.perf_event_paranoid=2 (in /etc/sysctl.d to stay), or run it as root";
        return Way::Needs("kernel.perf_event_paranoid above 2 wants root", mend);
    }
    Way::Open(
        "csi5300 record --stock; it only receives: an HT rate for frames sent, and asking the card for CSI, need the module",
    )
}

fn may_load(system: &dyn System) -> bool {
    let has = |capability| holds(system, capability) == Some(true);
    has(CAP_SYS_ADMIN) || (has(CAP_BPF) && has(CAP_PERFMON))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_kernels() {
        assert_eq!(kernel_version("6.1.0-56-amd64\n"), Some((6, 1)));
        assert_eq!(kernel_version("5.10-rc3"), Some((5, 10)));
        assert!(kernel_version("4.15.0-45-generic").unwrap() < EBPF_FROM);
        assert!(kernel_version("5.8.0").unwrap() >= EBPF_FROM);
        assert_eq!(kernel_version("mainline"), None);
    }
}
