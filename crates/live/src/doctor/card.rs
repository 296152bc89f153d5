//! The card, its driver and its firmware.

use super::ways::Ways;
use super::{Check, System};

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
    /// A card of the 5000 series.
    pub(super) fn find(system: &dyn System) -> Option<Self> {
        Self::find_by(system, |device| IWL5300.contains(&device) || SERIES_5000.contains(&device))
    }

    /// The first of Intel's cards that is known by its identity.
    pub(super) fn find_by(system: &dyn System, known: impl Fn(&str) -> bool) -> Option<Self> {
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
pub(super) const SECURE_BOOT: &str = "/sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c";

pub(super) fn checks(system: &dyn System, card: Option<&Card>, ways: &Ways) -> Vec<Check> {
    let mut checks = vec![on_the_bus(card), ways.check(), kernel(system, ways), secure_boot(system, ways)];
    if let Some(card) = card {
        checks.push(driver(system, card));
    }
    checks.extend([patched(system, ways), parameters(system), firmware_file(system), newer_firmware(system)]);
    checks.push(firmware_loaded(system, card));
    checks
}

fn on_the_bus(card: Option<&Card>) -> Check {
    let expected = "an Intel 5300 (8086:4235 or 8086:4236)";
    match card {
        Some(card) if IWL5300.contains(&card.device.as_str()) => Check::good(
            "card",
            format!("8086:{} in slot {}", card.device.trim_start_matches("0x"), card.slot),
            expected,
        ),
        Some(card) => {
            let found = format!("8086:{}: of the same series, but not a 5300", card.device.trim_start_matches("0x"));
            Check::doubt("card", found, expected).mend("use an Intel 5300: the firmware was made for it")
        }
        None => Check::bad("card", "none on the PCI bus", expected)
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
    let release = system.text("/proc/sys/kernel/osrelease").unwrap_or_default();
    ways.leads_past_patch() && !has_patch(&release)
}

fn kernel(system: &dyn System, ways: &Ways) -> Check {
    let expected = format!("one with a published CSI driver: {}", KERNELS.join(", "));
    let Some(release) = system.text("/proc/sys/kernel/osrelease") else {
        return Check::unknown("kernel", "no /proc/sys/kernel/osrelease", expected);
    };
    if has_patch(&release) {
        Check::good("kernel", release, expected)
    } else if ways.without_patch() {
        Check::good("kernel", format!("{release}: no patched driver is known for it, and none is needed"), expected)
    } else if ways.leads_past_patch() {
        let found = format!("{release}: no patched driver is known for it, see `way to CSI` for another way");
        Check::good("kernel", found, expected)
    } else {
        Check::doubt("kernel", format!("{release}: no CSI driver is known for it"), expected)
            .mend("install Ubuntu 18.04 with kernel 4.15 and hold it: `sudo apt-mark hold linux-image-$(uname -r)`")
    }
}

fn secure_boot(system: &dyn System, ways: &Ways) -> Check {
    let expected = "off: it refuses the patched module, which is unsigned";
    match system.bytes(SECURE_BOOT).and_then(|bytes| bytes.get(4).copied()) {
        Some(1) if ways.without_patch() => {
            Check::good("Secure Boot", "on: this machine's way to CSI (above) works with it", expected)
        }
        Some(1) => Check::bad("Secure Boot", "on", expected).mend("switch Secure Boot off in the BIOS set-up"),
        Some(_) => Check::good("Secure Boot", "off", expected),
        None => Check::good("Secure Boot", "no such variable: not booted by EFI, or without it", expected),
    }
}

pub(super) fn driver(system: &dyn System, card: &Card) -> Check {
    match system.link(&format!("/sys/bus/pci/devices/{}/driver", card.slot)) {
        Some(name) if name == "iwlwifi" => Check::good("driver", name, "iwlwifi"),
        Some(name) => Check::bad("driver", format!("bound to {name}"), "iwlwifi").mend("sudo modprobe iwlwifi"),
        None => Check::bad("driver", "no driver is bound to the card", "iwlwifi")
            .mend("sudo modprobe iwlwifi; if it does not come up, `sudo dmesg | grep iwlwifi` shows why"),
    }
}

fn patched(system: &dyn System, ways: &Ways) -> Check {
    let expected = "an iwlwifi module with the parameter connector_log";
    if system.text(&format!("{PARAMETERS}/connector_log")).is_some() {
        let layout = match system.text(&format!("{PARAMETERS}/ack_len")) {
            Some(_) => "the WSR driver (it has ack_len)",
            None => "the csitool driver",
        };
        let log = system.run(&["dmesg"]).filter(|ran| ran.ok).map(|ran| ran.text).unwrap_or_default();
        let unsigned = log.lines().any(|line| line.contains("iwl") && line.contains("module verification failed"));
        let note = match unsigned {
            true => {
                "; `module verification failed` in the kernel's log is harmless: nobody signed a module that was built here"
            }
            false => "",
        };
        return Check::good("patched module", format!("{layout}{note}"), expected);
    }
    if ways.without_patch() {
        return Check::good("patched module", "absent, and not needed: see `way to CSI`", expected);
    }
    if leads_elsewhere(system, ways) {
        return Check::unknown("patched module", "absent: this kernel has none, see `way to CSI`", expected);
    }
    let mend = "build and install the CSI driver (firmware-notes/install-up-squared.md), then `sudo modprobe -r iwldvm \
                iwlwifi && sudo modprobe iwlwifi connector_log=0x1`";
    let found = match system.names("/sys/module/iwlwifi").is_empty() {
        true => "iwlwifi is not loaded",
        false => "iwlwifi without connector_log: the distribution's module",
    };
    Check::bad("patched module", found, expected).mend(mend)
}

fn parameters(system: &dyn System) -> Check {
    let expected = "connector_log with bit 0x1 (CSI); 0x5 adds the frames themselves";
    let Some(text) = system.text(&format!("{PARAMETERS}/connector_log")) else {
        return Check::unknown("connector_log", "not there", expected);
    };
    let parsed = text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |hex| u32::from_str_radix(hex, 16).ok());
    let ack = system.text(&format!("{PARAMETERS}/ack_len")).map_or(String::new(), |ack| format!(", ack_len {ack}"));
    match parsed {
        Some(bits) if bits & 1 != 0 => Check::good("connector_log", format!("{bits:#x}{ack}"), expected),
        _ => Check::bad("connector_log", format!("{text}{ack}: no CSI is sent"), expected)
            .mend("sudo modprobe -r iwldvm iwlwifi && sudo modprobe iwlwifi connector_log=0x1"),
    }
}

fn firmware_file(system: &dyn System) -> Check {
    let expected = format!("{FIRMWARE}, {FIRMWARE_BYTES} bytes");
    let mend = "sudo cp iwlwifi-5000-2.ucode.sigcomm2010 /lib/firmware/ && sudo ln -sf iwlwifi-5000-2.ucode.sigcomm2010 \
                /lib/firmware/iwlwifi-5000-2.ucode (the file is in csitool's supplementary repository)";
    match system.size(FIRMWARE) {
        Some(FIRMWARE_BYTES) => Check::good("firmware file", format!("{FIRMWARE_BYTES} bytes"), expected),
        Some(other) => Check::bad("firmware file", format!("{other} bytes: another firmware"), expected).mend(mend),
        None => Check::bad("firmware file", "not there", expected).mend(mend),
    }
}

/// True for a firmware file that the driver prefers to csitool's, compressed ones too; not for one moved aside.
pub(super) fn wins(name: &str) -> bool {
    let parts = name.strip_prefix("iwlwifi-5000-").and_then(|rest| rest.split_once('.'));
    parts.is_some_and(|(api, kind)| {
        ["ucode", "ucode.xz", "ucode.zst"].contains(&kind) && api.parse().is_ok_and(|api: u32| api > 2)
    })
}

fn newer_firmware(system: &dyn System) -> Check {
    let expected = "no other iwlwifi-5000-*.ucode: the driver loads the highest number";
    let ours = "iwlwifi-5000-2.ucode";
    let newer: Vec<_> = system.names("/lib/firmware").into_iter().filter(|name| wins(name)).collect();
    if newer.is_empty() {
        return Check::good("other firmware", format!("none above {ours}"), expected);
    }
    let moves: Vec<_> =
        newer.iter().map(|name| format!("sudo mv /lib/firmware/{name} /lib/firmware/{name}.orig")).collect();
    Check::bad("other firmware", format!("{} win over {ours}", newer.join(", ")), expected).mend(moves.join(" && "))
}

fn firmware_loaded(system: &dyn System, card: Option<&Card>) -> Check {
    let expected = format!("version {FIRMWARE_VERSION}");
    let name = "firmware loaded";
    let log = system.run(&["dmesg"]).filter(|ran| ran.ok).map(|ran| ran.text).unwrap_or_default();
    if log.lines().any(|line| line.contains("iwlwifi") && line.contains("Microcode SW error")) {
        return Check::bad(name, "the firmware crashed (Microcode SW error in the kernel's log)", expected)
            .mend("sudo modprobe -r iwldvm iwlwifi && sudo modprobe iwlwifi connector_log=0x1");
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
        Some(version) if version == FIRMWARE_VERSION => Check::good(name, version, expected),
        Some(version) => Check::bad(name, format!("{version}: it never sends CSI"), expected)
            .mend("mend the firmware files above, then reload the driver"),
        None => Check::unknown(name, "not in the kernel's log", expected)
            .mend("sudo dmesg | grep 'loaded firmware version'"),
    }
}
