//! The host: connector, privileges, namespace, buffers, clock.

use super::card;
use super::ways::Ways;
use super::{Check, System};
use driver_iface::connector::{CN_IDX, registered_idx};

/// CAP_NET_ADMIN (`linux/capability.h`).
const CAP_NET_ADMIN: u32 = 12;
/// Receive buffer that holds a second of WSR records at 1 kHz (1,280 bytes are booked for each).
const ENOUGH_BUFFER: u64 = 1_280 * 1_000;

pub(super) fn checks(system: &dyn System, ways: &Ways) -> Vec<Check> {
    vec![namespace(system), connector(system, ways), capability(system), buffers(system), clock(system)]
}

fn namespace(system: &dyn System) -> Check {
    let expected = "the first network namespace: the driver's messages reach no other";
    let name = "network namespace";
    if system.text("/proc/net/connector").is_some() {
        return Check::good(name, "the kernel's connector is in it", expected);
    }
    let (own, first) = (system.link("/proc/self/ns/net"), system.link("/proc/1/ns/net"));
    let found = match (own, first) {
        (Some(own), Some(first)) if own == first => {
            return Check::bad(name, "the first one, but /proc/net/connector is absent", "a kernel with a connector")
                .mend("use a kernel with CONFIG_CONNECTOR=y");
        }
        _ => "no /proc/net/connector: a container, `ip netns`, or a kernel without CONFIG_CONNECTOR",
    };
    Check::bad(name, found, expected).mend("run on the host itself, or with `docker run --network host`")
}

fn connector(system: &dyn System, ways: &Ways) -> Check {
    let expected = format!("the driver registered as `iwlagn`, usually with index {CN_IDX}");
    let name = "connector index";
    let Some(text) = system.text("/proc/net/connector") else {
        return Check::unknown(name, "no /proc/net/connector", expected);
    };
    match registered_idx(&text) {
        Some(index @ 1..=32) => Check::good(name, format!("{index}"), expected),
        Some(index) => Check::bad(name, format!("{index}: no socket can join a group above 32"), expected)
            .mend("use a newer CSI driver (4.15)"),
        None if ways.without_patch() => {
            Check::unknown(name, "`iwlagn` is not registered; `record --stock` needs no connector", expected)
        }
        None if card::leads_elsewhere(system, ways) => {
            Check::unknown(name, "`iwlagn` is not registered: `way to CSI` names the driver", expected)
        }
        None => Check::bad(name, "`iwlagn` is not registered: no CSI driver is running", expected)
            .mend("sudo modprobe iwlwifi connector_log=0x1"),
    }
}

fn capability(system: &dyn System) -> Check {
    let expected = "CAP_NET_ADMIN";
    let name = "capability";
    match holds(system, CAP_NET_ADMIN) {
        Some(true) => Check::good(name, "held", expected),
        Some(_) => Check::bad(name, "not held", expected).mend("sudo setcap cap_net_admin+ep $(command -v csi5300)"),
        None => Check::unknown(name, "not in /proc/self/status", expected),
    }
}

/// Whether this process holds a capability; `None` if unknown.
pub(super) fn holds(system: &dyn System, capability: u32) -> Option<bool> {
    let status = system.text("/proc/self/status")?;
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"))?;
    u64::from_str_radix(effective.trim(), 16).ok().map(|held| held >> capability & 1 == 1)
}

pub(super) fn buffers(system: &dyn System) -> Check {
    let expected = format!("net.core.rmem_max of {ENOUGH_BUFFER} bytes or more, a second at 1 kHz");
    let name = "receive buffer";
    match system.text("/proc/sys/net/core/rmem_max").and_then(|text| text.parse::<u64>().ok()) {
        Some(limit) if limit >= ENOUGH_BUFFER => Check::good(name, format!("{limit}"), expected),
        Some(limit) => {
            Check::doubt(name, format!("{limit}: only a listener with CAP_NET_ADMIN may exceed it"), expected)
                .mend(format!("sudo sysctl -w net.core.rmem_max={}", 32 << 20))
        }
        None => Check::unknown(name, "net.core.rmem_max cannot be read", expected),
    }
}

pub(super) fn clock(system: &dyn System) -> Check {
    let expected = "synchronised: the receiver's clock joins records and trajectory";
    let name = "clock";
    match system.run(&["timedatectl", "show", "-p", "NTPSynchronized"]) {
        Some(ran) if ran.text.contains("=yes") => Check::good(name, "synchronised", expected),
        Some(ran) if ran.text.contains("=no") => {
            Check::doubt(name, "not synchronised", expected).mend("sudo apt install chrony && sudo chronyc -a makestep")
        }
        _ => Check::unknown(name, "timedatectl does not report it", expected).mend("chronyc tracking"),
    }
}
