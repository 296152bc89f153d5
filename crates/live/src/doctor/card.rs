//! The card, its driver and its firmware, and the ways to CSI that are open to it.
//!
//! A 5300 has three: the patched driver, the kernel module beside the distribution's driver, or an eBPF program beside
//! it. An AX200 or AX210 has one: FeitCSI, a patched `iwlwifi` and a program (firmware-notes/other-cards.md).

use super::host::{self, CAP_BPF, CAP_PERFMON, grant, holds};
use super::setup::ASIDE;
use super::{Check, Found, System, bad, doubt, good, unknown};

/// PCI identities of the Intel 5300 (`iwlwifi/pcie/drv.c`).
pub(crate) const IWL5300: [&str; 2] = ["0x4235", "0x4236"];
/// Other cards of the 5000 series with the same firmware: 5100, 5350, 5150.
const SERIES_5000: [&str; 6] = ["0x4232", "0x4237", "0x423a", "0x423b", "0x423c", "0x423d"];
/// Bytes of csitool's firmware; its driver refuses any other (`iwl-drv.c`).
pub(super) const FIRMWARE_BYTES: u64 = 336_252;
const FIRMWARE_VERSION: &str = "8.24.2.12";
pub(super) const FIRMWARE: &str = "/lib/firmware/iwlwifi-5000-2.ucode";
/// Kernels for which a patched driver is published: csitool's branches, and 4.15 (spanev, WSR).
const KERNELS: [&str; 11] = ["3.2", "3.5", "3.11", "3.13", "3.16", "3.17", "3.18", "3.19", "4.1", "4.2", "4.15"];
const PARAMETERS: &str = "/sys/module/iwlwifi/parameters";

/// The card found on the PCI bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Card {
    pub(super) slot: String,
    pub(super) device: String,
    /// Its interfaces, monitors among them.
    pub(super) interfaces: Vec<String>,
    pub(super) phy: Option<String>,
}

impl Card {
    /// Its device number, as `lspci` prints it.
    fn number(&self) -> &str {
        self.device.trim_start_matches("0x")
    }

    /// A card of the 5000 series.
    pub(super) fn find(system: &dyn System) -> Option<Self> {
        Self::find_by(system, |device| IWL5300.contains(&device) || SERIES_5000.contains(&device))
    }

    /// The first of Intel's cards that is known by its identity.
    fn find_by(system: &dyn System, known: impl Fn(&str) -> bool) -> Option<Self> {
        let bus = "/sys/bus/pci/devices";
        system.names(bus).into_iter().find_map(|slot| {
            let vendor = system.text(&format!("{bus}/{slot}/vendor"))?;
            let device = system.text(&format!("{bus}/{slot}/device"))?.to_lowercase();
            (vendor == "0x8086" && known(&device)).then(|| Self {
                interfaces: system.names(&format!("{bus}/{slot}/net")),
                phy: system.names(&format!("{bus}/{slot}/ieee80211")).into_iter().next(),
                slot,
                device,
            })
        })
    }
}

/// The firmware's variable of Secure Boot: four bytes of attributes, then 1 where it is on.
const SECURE_BOOT: &str = "/sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c";

/// `None` without the variable: not booted by EFI, or without Secure Boot.
pub(super) fn secure_boot_is_on(system: &dyn System) -> Option<bool> {
    system.bytes(SECURE_BOOT)?.get(4).map(|state| *state == 1)
}

fn release(system: &dyn System) -> Option<String> {
    system.text("/proc/sys/kernel/osrelease")
}

fn kernel_log(system: &dyn System) -> String {
    system.run(&["dmesg"]).filter(|ran| ran.ok).map(|ran| ran.text).unwrap_or_default()
}

fn has_crashed(log: &str) -> bool {
    log.lines().any(|line| line.contains("iwlwifi") && line.contains("Microcode SW error"))
}

/// A module's parameter as a number, decimal or hexadecimal.
pub(super) fn number(text: &str) -> Option<u32> {
    text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |hex| u32::from_str_radix(hex, 16).ok())
}

pub(super) fn checks(system: &dyn System, card: Option<&Card>, ways: &Ways) -> Vec<Check> {
    let mut checks = vec![
        on_the_bus(card).of("card", "an Intel 5300 (8086:4235 or 8086:4236)"),
        ways.best()
            .of("way to CSI", "the patched driver, the module csi5300, or Linux 5.8 and later for `record --stock`"),
        kernel(system, ways).of("kernel", format!("one with a published CSI driver: {}", KERNELS.join(", "))),
        secure_boot(system, ways).of("Secure Boot", "off: it refuses the patched module, which is unsigned"),
    ];
    checks.extend(card.map(|card| driver(system, card)));
    checks.extend([
        patched(system, ways).of("patched module", "an iwlwifi module with the parameter connector_log"),
        parameters(system).of(
            "connector_log",
            "bit 0x1 (CSI); with csitool's driver 0x5, which adds the frames and so their senders",
        ),
        firmware_file(system).of("firmware file", format!("{FIRMWARE}, {FIRMWARE_BYTES} bytes")),
        newer_firmware(system)
            .of("other firmware", "no other iwlwifi-5000-*.ucode: the driver loads the highest number"),
        firmware_loaded(system, card).of("firmware loaded", format!("version {FIRMWARE_VERSION}")),
    ]);
    checks
}

fn on_the_bus(card: Option<&Card>) -> Found {
    match card {
        Some(card) if IWL5300.contains(&card.device.as_str()) => {
            good(format!("8086:{} in slot {}", card.number(), card.slot))
        }
        Some(card) => {
            let found = format!("8086:{}: of the same series, but not a 5300", card.number());
            doubt(found).mend("use an Intel 5300: the firmware was made for it")
        }
        None => bad("none on the PCI bus")
            .mend("seat the card; look with `lspci -nn -d 8086:`; some BIOSes refuse cards that are not on their list"),
    }
}

/// True if a patched driver is published for a kernel of this release.
fn has_patch(release: &str) -> bool {
    let is_of =
        |tree: &&str| release.strip_prefix(*tree).is_some_and(|rest| !rest.starts_with(|c: char| c.is_ascii_digit()));
    KERNELS.iter().any(is_of)
}

/// True if no patched driver exists for this kernel, and another way is one step away.
pub(super) fn leads_elsewhere(system: &dyn System, ways: &Ways) -> bool {
    let release = release(system).unwrap_or_default();
    ways.leads_past_patch() && !has_patch(&release)
}

fn kernel(system: &dyn System, ways: &Ways) -> Found {
    let Some(release) = release(system) else {
        return unknown("no /proc/sys/kernel/osrelease");
    };
    if has_patch(&release) {
        good(release)
    } else if ways.without_patch() {
        good(format!("{release}: no patched driver is known for it, and none is needed"))
    } else if ways.leads_past_patch() {
        let found = format!("{release}: no patched driver is known for it, see `way to CSI` for another way");
        good(found)
    } else {
        doubt(format!("{release}: no CSI driver is known for it"))
            .mend("install Ubuntu 18.04 with kernel 4.15 and hold it: `sudo apt-mark hold linux-image-$(uname -r)`")
    }
}

fn secure_boot(system: &dyn System, ways: &Ways) -> Found {
    match secure_boot_is_on(system) {
        Some(true) if ways.without_patch() => good("on: this machine's way to CSI (above) works with it"),
        Some(true) => bad("on").mend("switch Secure Boot off in the BIOS set-up"),
        Some(_) => good("off"),
        None => good("no such variable: not booted by EFI, or without it"),
    }
}

fn driver(system: &dyn System, card: &Card) -> Check {
    let found = match system.link(&format!("/sys/bus/pci/devices/{}/driver", card.slot)) {
        Some(name) if name == "iwlwifi" => good(name),
        Some(name) => bad(format!("bound to {name}")).mend("sudo modprobe iwlwifi"),
        None => bad("no driver is bound to the card")
            .mend("sudo modprobe iwlwifi; if it does not come up, `sudo dmesg | grep iwlwifi` shows why"),
    };
    found.of("driver", "iwlwifi")
}

fn patched(system: &dyn System, ways: &Ways) -> Found {
    if system.text(&format!("{PARAMETERS}/connector_log")).is_some() {
        let layout = match system.text(&format!("{PARAMETERS}/ack_len")) {
            Some(_) => "the WSR driver (it has ack_len)",
            None => "the csitool driver",
        };
        let log = kernel_log(system);
        let unsigned = log.lines().any(|line| line.contains("iwl") && line.contains("module verification failed"));
        let mut found = layout.to_string();
        if unsigned {
            found += "; `module verification failed` in the kernel's log is harmless: nobody signed a module that was built here";
        }
        return good(found);
    }
    if ways.without_patch() {
        return good("absent, and not needed: see `way to CSI`");
    }
    if leads_elsewhere(system, ways) {
        return unknown("absent: this kernel has none, see `way to CSI`");
    }
    let mend = "build and install the CSI driver (firmware-notes/install-up-squared.md), then `sudo modprobe -r iwldvm \
                iwlwifi && sudo modprobe iwlwifi connector_log=0x5` (csitool's; WSR's: 0x1)";
    let found = match system.names("/sys/module/iwlwifi").is_empty() {
        true => "iwlwifi is not loaded",
        false => "iwlwifi without connector_log: the distribution's module",
    };
    bad(found).mend(mend)
}

fn parameters(system: &dyn System) -> Found {
    let Some(text) = system.text(&format!("{PARAMETERS}/connector_log")) else {
        return unknown("not there");
    };
    let ack_len = system.text(&format!("{PARAMETERS}/ack_len"));
    let is_csitool = ack_len.is_none();
    let ack = ack_len.map_or(String::new(), |ack| format!(", ack_len {ack}"));
    match number(&text) {
        Some(bits) if is_csitool && bits & 5 == 1 => doubt(format!(
            "{bits:#x}: CSI without its frames, so no record names its sender or number: senders cannot be told apart, nor \
             exchanges paired"
        ))
        .mend(format!("{} (`csi5300 setup` does it)", reload(system))),
        Some(bits) if bits & 1 != 0 => good(format!("{bits:#x}{ack}")),
        _ => bad(format!("{text}{ack}: no CSI is sent")).mend(reload(system)),
    }
}

/// The command that loads the driver again; csitool's, which has no `ack_len`, with the frames too.
pub(super) fn reload(system: &dyn System) -> String {
    let is_wsr = system.text(&format!("{PARAMETERS}/ack_len")).is_some();
    let log = if is_wsr { "0x1" } else { "0x5" };
    format!("sudo modprobe -r iwldvm iwlwifi && sudo modprobe iwlwifi connector_log={log}")
}

fn firmware_file(system: &dyn System) -> Found {
    let mend = "sudo cp iwlwifi-5000-2.ucode.sigcomm2010 /lib/firmware/ && sudo ln -sf iwlwifi-5000-2.ucode.sigcomm2010 \
                /lib/firmware/iwlwifi-5000-2.ucode (the file is in csitool's supplementary repository)";
    match system.size(FIRMWARE) {
        Some(FIRMWARE_BYTES) => good(format!("{FIRMWARE_BYTES} bytes")),
        Some(other) => {
            bad(format!("{other} bytes: another firmware")).mend(format!("{} && {mend}", move_aside(FIRMWARE)))
        }
        None => bad("not there").mend(mend),
    }
}

/// The command that takes a firmware out of the driver's way; `setup --undo` puts it back.
fn move_aside(file: &str) -> String {
    format!("sudo mv {file} {file}{ASIDE}")
}

/// True for a firmware file that the driver prefers to csitool's, compressed ones too; not for one moved aside.
pub(super) fn wins(name: &str) -> bool {
    let parts = name.strip_prefix("iwlwifi-5000-").and_then(|rest| rest.split_once('.'));
    parts.is_some_and(|(api, kind)| {
        ["ucode", "ucode.xz", "ucode.zst"].contains(&kind) && api.parse().is_ok_and(|api: u32| api > 2)
    })
}

fn newer_firmware(system: &dyn System) -> Found {
    let ours = "iwlwifi-5000-2.ucode";
    let newer: Vec<_> = system.names("/lib/firmware").into_iter().filter(|name| wins(name)).collect();
    if newer.is_empty() {
        return good(format!("none above {ours}"));
    }
    let moves: Vec<_> = newer.iter().map(|name| move_aside(&format!("/lib/firmware/{name}"))).collect();
    bad(format!("{} win over {ours}", newer.join(", "))).mend(moves.join(" && "))
}

fn firmware_loaded(system: &dyn System, card: Option<&Card>) -> Found {
    let log = kernel_log(system);
    if has_crashed(&log) {
        return bad("the firmware crashed (Microcode SW error in the kernel's log)").mend(reload(system));
    }
    let told = log.lines().rev().find_map(|line| {
        let version = line.split_once("loaded firmware version ")?.1;
        version.split_whitespace().next().map(str::to_string)
    });
    let asked = || {
        let interface = card?.interfaces.first()?;
        let ran = system.run(&["ethtool", "-i", interface])?;
        let version = ran.text.lines().find_map(|line| line.strip_prefix("firmware-version:").map(str::trim))?;
        version.split_whitespace().next().map(str::to_string)
    };
    match told.or_else(asked) {
        Some(version) if version == FIRMWARE_VERSION => good(version),
        Some(version) => {
            bad(format!("{version}: it never sends CSI")).mend("mend the firmware files above, then reload the driver")
        }
        None => unknown("not in the kernel's log").mend("sudo dmesg | grep 'loaded firmware version'"),
    }
}

/// The first kernel with a ring buffer for eBPF (BPF_MAP_TYPE_RINGBUF), and with CAP_BPF and CAP_PERFMON.
pub(crate) const EBPF_FROM: (u32, u32) = (5, 8);
/// What loading and attaching the program needs, and the connector.
pub(crate) const EBPF_NEEDS: [&str; 3] = ["cap_bpf", "cap_perfmon", "cap_net_admin"];
/// A bit of CapEff (`linux/capability.h`).
const CAP_SYS_ADMIN: u32 = 21;
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
    Needs(&'static str, String),
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
        let patched = match system.text(&format!("{PARAMETERS}/connector_log")) {
            Some(_) => Way::Taken("iwlwifi has connector_log"),
            None => Way::Closed("this iwlwifi has no connector_log".into()),
        };
        Self { patched, module: module_way(system), ebpf: ebpf_way(system) }
    }

    /// True if another way than the patched driver works, so that its problems do not matter.
    pub(super) fn without_patch(&self) -> bool {
        !matches!(self.patched, Way::Taken(_))
            && [&self.module, &self.ebpf].iter().any(|way| matches!(way, Way::Taken(_) | Way::Open(_)))
    }

    /// True if one of the other ways needs at most one step.
    fn leads_past_patch(&self) -> bool {
        !matches!(self.patched, Way::Taken(_))
            && [&self.module, &self.ebpf].iter().any(|way| !matches!(way, Way::Closed(_)))
    }

    fn best(&self) -> Found {
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
        match best {
            Some((best, Way::Taken(_))) => good(format!("{list}. Best here: {best}")),
            Some((best, Way::Open(what))) => good(format!("{list}. Best here: {best}")).mend(*what),
            Some((best, Way::Needs(_, mend))) => doubt(format!("{list}. Best here: {best}")).mend(mend.clone()),
            _ => bad(list).mend("install a kernel for which a way is open: any distribution's of 5.8 or later will do"),
        }
    }
}

fn module_way(system: &dyn System) -> Way {
    if !system.names(MODULE).is_empty() {
        return Way::Taken("csi5300 is loaded");
    }
    let Some(release) = release(system) else {
        return Way::Closed("the kernel's release is unknown".into());
    };
    if secure_boot_is_on(system) == Some(true) {
        return Way::Closed("Secure Boot refuses unsigned modules".into());
    }
    if system.names(&format!("/lib/modules/{release}/build")).is_empty() {
        let mend = "sudo apt install linux-headers-$(uname -r) dkms, then the package of packaging/dkms";
        return Way::Needs("no kernel headers", mend.into());
    }
    Way::Needs("headers are there", "sudo apt install dkms, then the package of packaging/dkms".into())
}

/// Why this kernel cannot take the eBPF program.
pub(crate) fn no_ebpf(system: &dyn System) -> Option<String> {
    let release = release(system).unwrap_or_default();
    match kernel_version(&release) {
        Some(version) if version >= EBPF_FROM => {}
        Some(_) => return Some(format!("{release} is older than 5.8")),
        None => return Some("the kernel's release is unknown".into()),
    }
    if system.run(&["uname", "-m"]).is_some_and(|ran| ran.ok && ran.text.trim() != "x86_64") {
        return Some("not x86-64".into());
    }
    if system.text("/sys/bus/event_source/devices/kprobe/type").is_none() {
        return Some("the kernel has no kprobes (CONFIG_KPROBES and CONFIG_KPROBE_EVENTS)".into());
    }
    let lockdown = system.text("/sys/kernel/security/lockdown").unwrap_or_default();
    lockdown
        .contains("[confidentiality]")
        .then(|| "kernel lockdown `confidentiality`: no program may read its memory".into())
}

fn ebpf_way(system: &dyn System) -> Way {
    if let Some(why) = no_ebpf(system) {
        return Way::Closed(why);
    }
    if system.names("/sys/module/iwlwifi").is_empty() {
        return Way::Needs("iwlwifi is not loaded", "sudo modprobe iwlwifi".into());
    }
    let has = |capability| holds(system, capability) == Some(true);
    let is_root = has(CAP_SYS_ADMIN);
    let may_load = is_root || (has(CAP_BPF) && has(CAP_PERFMON));
    if !may_load {
        let mend = grant(system, &EBPF_NEEDS);
        return Way::Needs("CAP_BPF and CAP_PERFMON are not held", mend);
    }
    // An extra level of Debian's and Ubuntu's kernels, at which CAP_PERFMON is not enough for a probe.
    let paranoid = system.text("/proc/sys/kernel/perf_event_paranoid").and_then(|level| level.parse::<i32>().ok());
    if paranoid.is_some_and(|level| level > 2) && !is_root {
        let mend = "sudo sysctl -w kernel.perf_event_paranoid=2 (in /etc/sysctl.d to stay), or run it as root";
        return Way::Needs("kernel.perf_event_paranoid above 2 wants root", mend.into());
    }
    Way::Open(
        "csi5300 record --stock; it only receives: an HT rate for frames sent, and asking the card for CSI, need the module",
    )
}

/// PCI device IDs (`iwlwifi/pcie/drv.c`).
const CARDS: [(&str, &str); 2] = [("0x2723", "AX200"), ("0x2725", "AX210")];
/// FeitCSI's driver has its switch for CSI here, below the folder of each card.
const DEBUG: &str = "/sys/kernel/debug/iwlwifi";

/// All checks; `None` without such a card.
pub(super) fn ax2xx_checks(system: &dyn System) -> Option<Vec<Check>> {
    let card = Card::find_by(system, |device| CARDS.iter().any(|(known, _)| *known == device))?;
    let (_, name) = CARDS.iter().find(|(device, _)| *device == card.device)?;
    let found = format!("Intel {name} (8086:{}) in slot {}", card.number(), card.slot);
    Some(vec![
        good(found).of("card", "an Intel 5300, AX200 or AX210"),
        feitcsi_way(system).of("way to CSI", "FeitCSI's iwlwifi, with csi_enabled in debugfs"),
        feitcsi_program(system).of("FeitCSI", "the program feitcsi"),
        driver(system, &card),
        feitcsi_secure_boot(system).of("Secure Boot", "off, or FeitCSI's module signed with an enrolled key"),
        feitcsi_firmware(system).of("firmware loaded", "loaded, and not crashed"),
        host::rfkill(system),
        host::domain(system),
        host::buffers(system),
        host::clock(system),
    ])
}

/// FeitCSI is the only way to CSI of these cards.
fn feitcsi_way(system: &dyn System) -> Found {
    let cards = system.names(DEBUG);
    if cards.iter().any(|card| system.size(&format!("{DEBUG}/{card}/iwlmvm/csi_enabled")).is_some()) {
        let next =
            "sudo feitcsi --udp-socket, then csi5300 record OUT.csi --feitcsi \"127.0.0.1:8008 --frequency 5180\"";
        return good("FeitCSI: its driver is loaded").mend(next);
    }
    if cards.is_empty() {
        return unknown(format!("only root can read {DEBUG}")).mend(format!("sudo ls {DEBUG}/*/iwlmvm/csi_enabled"));
    }
    bad("none: this iwlwifi is not FeitCSI's, and gives no CSI").mend(
        "install the package feitcsi-iwlwifi (https://feitcsi.kuskosoft.com), then sudo modprobe -r iwlmvm iwlwifi && sudo \
         modprobe iwlwifi",
    )
}

fn feitcsi_program(system: &dyn System) -> Found {
    match system.run(&["feitcsi", "--version"]) {
        Some(ran) => good(ran.text.lines().next().unwrap_or("installed")),
        None => bad("not installed").mend("install the package feitcsi (https://feitcsi.kuskosoft.com)"),
    }
}

fn feitcsi_secure_boot(system: &dyn System) -> Found {
    match secure_boot_is_on(system) {
        Some(true) => {
            doubt("on").mend("switch off Secure Boot in the BIOS setup, or enrol the DKMS key: sudo mokutil --import")
        }
        _ => good("off"),
    }
}

/// No known version lacks CSI, so the version is only reported.
fn feitcsi_firmware(system: &dyn System) -> Found {
    let log = kernel_log(system);
    if has_crashed(&log) {
        return bad("the firmware crashed (Microcode SW error in the kernel's log)")
            .mend("sudo modprobe -r iwlmvm iwlwifi && sudo modprobe iwlwifi");
    }
    match log.lines().rev().find_map(|line| line.split_once("loaded firmware version ")) {
        Some((_, version)) => good(version.trim()),
        None => unknown("not in the kernel's log").mend("sudo dmesg | grep 'loaded firmware version'"),
    }
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
