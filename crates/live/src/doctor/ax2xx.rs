//! Checks of an AX200 or AX210. FeitCSI, a patched `iwlwifi` and a program, provides its CSI (firmware-notes/other-cards.md).

use super::card::{Card, SECURE_BOOT, driver};
use super::{Check, System, host, radio};

/// PCI device IDs (`iwlwifi/pcie/drv.c`).
const CARDS: [(&str, &str); 2] = [("0x2723", "AX200"), ("0x2725", "AX210")];
/// FeitCSI's driver has its switch for CSI here, below the folder of each card.
const DEBUG: &str = "/sys/kernel/debug/iwlwifi";

/// All checks; `None` without such a card.
pub(super) fn checks(system: &dyn System) -> Option<Vec<Check>> {
    let card = Card::find_by(system, |device| CARDS.iter().any(|(known, _)| *known == device))?;
    let (_, name) = CARDS.iter().find(|(device, _)| *device == card.device)?;
    let found = format!("Intel {name} (8086:{}) in slot {}", card.device.trim_start_matches("0x"), card.slot);
    let mut checks = vec![Check::good("card", found, "an Intel 5300, AX200 or AX210"), way(system), program(system)];
    checks.extend([driver(system, &card), secure_boot(system), firmware(system)]);
    checks.extend([radio::rfkill(system), radio::domain(system), host::buffers(system), host::clock(system)]);
    Some(checks)
}

/// FeitCSI is the only way to CSI of these cards.
fn way(system: &dyn System) -> Check {
    let expected = "FeitCSI's iwlwifi, with csi_enabled in debugfs";
    let name = "way to CSI";
    let cards = system.names(DEBUG);
    if cards.iter().any(|card| system.size(&format!("{DEBUG}/{card}/iwlmvm/csi_enabled")).is_some()) {
        let next =
            "sudo feitcsi --udp-socket, then csi5300 record OUT.csi --feitcsi \"127.0.0.1:8008 --frequency 5180\"";
        return Check::good(name, "FeitCSI: its driver is loaded", expected).mend(next);
    }
    if cards.is_empty() {
        return Check::unknown(name, format!("only root can read {DEBUG}"), expected)
            .mend(format!("sudo ls {DEBUG}/*/iwlmvm/csi_enabled"));
    }
    Check::bad(name, "none: this iwlwifi is not FeitCSI's, and gives no CSI", expected).mend(
        "install the package feitcsi-iwlwifi (https://feitcsi.kuskosoft.com), then sudo modprobe -r iwlmvm iwlwifi && sudo \
         modprobe iwlwifi",
    )
}

fn program(system: &dyn System) -> Check {
    let expected = "the program feitcsi";
    match system.run(&["feitcsi", "--version"]) {
        Some(ran) => Check::good("FeitCSI", ran.text.lines().next().unwrap_or("installed"), expected),
        None => Check::bad("FeitCSI", "not installed", expected)
            .mend("install the package feitcsi (https://feitcsi.kuskosoft.com)"),
    }
}

fn secure_boot(system: &dyn System) -> Check {
    let expected = "off, or FeitCSI's module signed with an enrolled key";
    match system.bytes(SECURE_BOOT).and_then(|bytes| bytes.get(4).copied()) {
        Some(1) => Check::doubt("Secure Boot", "on", expected)
            .mend("switch off Secure Boot in the BIOS setup, or enrol the DKMS key: sudo mokutil --import"),
        _ => Check::good("Secure Boot", "off", expected),
    }
}

/// No known version lacks CSI, so the version is only reported.
fn firmware(system: &dyn System) -> Check {
    let expected = "loaded, and not crashed";
    let name = "firmware loaded";
    let log = system.run(&["dmesg"]).filter(|ran| ran.ok).map(|ran| ran.text).unwrap_or_default();
    if log.lines().any(|line| line.contains("iwlwifi") && line.contains("Microcode SW error")) {
        return Check::bad(name, "the firmware crashed (Microcode SW error in the kernel's log)", expected)
            .mend("sudo modprobe -r iwlmvm iwlwifi && sudo modprobe iwlwifi");
    }
    match log.lines().rev().find_map(|line| line.split_once("loaded firmware version ")) {
        Some((_, version)) => Check::good(name, version.trim(), expected),
        None => Check::unknown(name, "not in the kernel's log", expected)
            .mend("sudo dmesg | grep 'loaded firmware version'"),
    }
}
