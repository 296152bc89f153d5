//! The host and its interface: mode, channel, rate and other owners; connector, privileges, namespace, buffers, clock.

use csi5300::signal::channel::Channel;
use driver_iface::connector::{CN_IDX, registered_idx};

use super::card::{self, Card, Ways};
use super::{Check, Found, Ran, System, bad, doubt, good, unknown};

/// Capabilities that commands need, by their bits of CapEff (`linux/capability.h`).
const CAPABILITIES: [(u32, &str); 6] = [
    (CAP_BPF, "cap_bpf"),
    (CAP_PERFMON, "cap_perfmon"),
    (13, "cap_net_raw"),
    (CAP_NET_ADMIN, "cap_net_admin"),
    (23, "cap_sys_nice"),
    (14, "cap_ipc_lock"),
];
const CAP_NET_ADMIN: u32 = 12;
pub(super) const CAP_PERFMON: u32 = 38;
pub(super) const CAP_BPF: u32 = 39;
/// Receive buffer that holds a second of WSR records at 1 kHz (1,280 bytes are booked for each).
const ENOUGH_BUFFER: u64 = 1_280 * 1_000;

pub(super) fn checks(system: &dyn System, ways: &Ways) -> Vec<Check> {
    vec![
        namespace(system).of(
            "network namespace",
            "the first network namespace, with a connector: the driver's messages reach no other",
        ),
        connector(system, ways)
            .of("connector index", format!("the driver registered as `iwlagn`, usually with index {CN_IDX}")),
        capability(system).of("capability", "CAP_NET_ADMIN"),
        buffers(system),
        clock(system),
    ]
}

fn namespace(system: &dyn System) -> Found {
    if system.text("/proc/net/connector").is_some() {
        return good("the kernel's connector is in it");
    }
    match (system.link("/proc/self/ns/net"), system.link("/proc/1/ns/net")) {
        (Some(own), Some(first)) if own == first => {
            bad("the first one, but /proc/net/connector is absent").mend("use a kernel with CONFIG_CONNECTOR=y")
        }
        _ => bad("no /proc/net/connector: a container, `ip netns`, or a kernel without CONFIG_CONNECTOR")
            .mend("run on the host itself, or with `docker run --network host`"),
    }
}

fn connector(system: &dyn System, ways: &Ways) -> Found {
    let Some(text) = system.text("/proc/net/connector") else {
        return unknown("no /proc/net/connector");
    };
    match registered_idx(&text) {
        Some(index @ 1..=32) => good(format!("{index}")),
        Some(index) => {
            bad(format!("{index}: no socket can join a group above 32")).mend("use a newer CSI driver (4.15)")
        }
        None if ways.without_patch() => unknown("`iwlagn` is not registered; `record --stock` needs no connector"),
        None if card::leads_elsewhere(system, ways) => {
            unknown("`iwlagn` is not registered: `way to CSI` names the driver")
        }
        None => bad("`iwlagn` is not registered: no CSI driver is running").mend(card::reload(system)),
    }
}

fn capability(system: &dyn System) -> Found {
    match holds(system, CAP_NET_ADMIN) {
        Some(true) => good("held"),
        Some(_) => bad("not held").mend(grant(system, &["cap_net_admin"])),
        None => unknown("not in /proc/self/status"),
    }
}

/// Whether this process holds a capability; `None` if unknown.
pub(super) fn holds(system: &dyn System, capability: u32) -> Option<bool> {
    let status = system.text("/proc/self/status")?;
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"))?;
    u64::from_str_radix(effective.trim(), 16).ok().map(|held| held >> capability & 1 == 1)
}

/// The command that gives this program capabilities beside those that it holds, because `setcap` takes away what it does not name.
pub(crate) fn grant(system: &dyn System, needed: &[&str]) -> String {
    let is_named = |(bit, name): &(u32, &str)| needed.contains(name) || holds(system, *bit) == Some(true);
    let names: Vec<&str> = CAPABILITIES.into_iter().filter(is_named).map(|(_, name)| name).collect();
    format!("sudo setcap {}+ep $(command -v {})", names.join(","), crate::sys::program())
}

pub(super) fn buffers(system: &dyn System) -> Check {
    let found = match system.text("/proc/sys/net/core/rmem_max").and_then(|text| text.parse::<u64>().ok()) {
        Some(limit) if limit >= ENOUGH_BUFFER => good(format!("{limit}")),
        Some(limit) => doubt(format!("{limit}: only a listener with CAP_NET_ADMIN may exceed it"))
            .mend(format!("sudo sysctl -w net.core.rmem_max={}", 32 << 20)),
        None => unknown("net.core.rmem_max cannot be read"),
    };
    let expected = format!("net.core.rmem_max of {ENOUGH_BUFFER} bytes or more, a second at 1 kHz");
    found.of("receive buffer", expected)
}

pub(super) fn clock(system: &dyn System) -> Check {
    let found = match system.run(&["timedatectl", "show", "-p", "NTPSynchronized"]) {
        Some(ran) if ran.text.contains("=yes") => good("synchronised"),
        Some(ran) if ran.text.contains("=no") => {
            doubt("not synchronised").mend("sudo apt install chrony && sudo chronyc -a makestep")
        }
        _ => unknown("timedatectl does not report it").mend("chronyc tracking"),
    };
    found.of("clock", "synchronised: the receiver's clock joins records and trajectory")
}

/// `type` of a monitor interface in sysfs (ARPHRD_IEEE80211_RADIOTAP).
const RADIOTAP: &str = "803";
/// RATE_MCS_HT_MSK of a transmission rate (`dvm/commands.h`): only HT frames carry CSI.
const RATE_HT: u32 = 0x100;

pub(super) fn radio_checks(system: &dyn System, card: Option<&Card>) -> Vec<Check> {
    let mut checks = vec![rfkill(system)];
    if let Some(card) = card {
        let Some(interface) = interface(system, card) else {
            let mend = "sudo modprobe iwldvm; if none comes up, `sudo dmesg | grep iwl` shows why";
            checks.push(bad("the card has none").mend(mend).of("interface", "a network interface on the card"));
            return checks;
        };
        checks.extend([
            mode(system, &interface).of(
                "interface",
                "monitor mode, up (for frames between robots; an access point's CSI comes in managed mode too)",
            ),
            owner(system, &interface, card)
                .of("other owners", "no other program and no other interface of the card sets its mode and channel"),
            channel(system, &interface, card).of(
                "channel",
                "a 5 GHz channel, the same width and channel on all robots, on which the card may transmit",
            ),
        ]);
        let found = if is_monitor(system, &interface) { Vec::new() } else { association(system, &interface) };
        let associated = "associated with an open access point that sends HT frames (802.11n)";
        checks.extend(found.into_iter().map(|found| found.of("association", associated)));
        let expected = "an HT rate, such as 0x4101 (antenna A, MCS 1), on robots that transmit";
        checks.push(rate(system, card).of("monitor_tx_rate", expected));
    }
    checks.push(domain(system));
    checks
}

/// The monitor interface if there is one, else the first.
fn interface(system: &dyn System, card: &Card) -> Option<String> {
    let monitor = |name: &&String| is_monitor(system, name);
    card.interfaces.iter().find(monitor).or(card.interfaces.first()).cloned()
}

fn is_monitor(system: &dyn System, interface: &str) -> bool {
    system.text(&format!("/sys/class/net/{interface}/type")).as_deref() == Some(RADIOTAP)
}

fn is_up(system: &dyn System, interface: &str) -> bool {
    let flags = system.text(&format!("/sys/class/net/{interface}/flags")).unwrap_or_default();
    u32::from_str_radix(flags.trim_start_matches("0x"), 16).is_ok_and(|flags| flags & 1 != 0)
}

pub(super) fn rfkill(system: &dyn System) -> Check {
    let class = "/sys/class/rfkill";
    let mut blocked = Vec::new();
    for name in system.names(class) {
        let is = |file: &str, value: &str| system.text(&format!("{class}/{name}/{file}")).as_deref() == Some(value);
        if is("type", "wlan") {
            blocked.extend(is("hard", "1").then_some("by a switch (hard)"));
            blocked.extend(is("soft", "1").then_some("by software (soft)"));
        }
    }
    let found = match blocked.first() {
        None => good("not blocked"),
        Some(how) if how.contains("hard") => bad(format!("blocked {how}"))
            .mend("turn on the machine's radio switch, or the card's disable pin (mini-PCIe pin 20) is held low"),
        Some(how) => bad(format!("blocked {how}")).mend("sudo rfkill unblock wifi"),
    };
    found.of("rfkill", "WiFi is not blocked")
}

fn mode(system: &dyn System, interface: &str) -> Found {
    let set = format!(
        "sudo ip link set {interface} down && sudo iw dev {interface} set type monitor && sudo ip link set {interface} up"
    );
    let kind = system.text(&format!("/sys/class/net/{interface}/type"));
    match (kind.as_deref(), is_up(system, interface)) {
        (Some(RADIOTAP), true) => good(format!("{interface}: monitor, up")),
        (Some(RADIOTAP), false) => {
            bad(format!("{interface}: monitor, but down")).mend(format!("sudo ip link set {interface} up"))
        }
        _ => doubt(format!("{interface}: not a monitor")).mend(set),
    }
}

fn owner(system: &dyn System, interface: &str, card: &Card) -> Found {
    let other = card.interfaces.iter().find(|other| *other != interface && is_up(system, other));
    if let Some(other) = other.filter(|_| is_monitor(system, interface)) {
        let found = format!(
            "{other} is up on the same card: {interface} hears its channel, and cannot be set to another (busy)"
        );
        return bad(found).mend(format!("sudo ip link set {other} down"));
    }
    if let Some(ran) = system.run(&["nmcli", "-t", "-f", "DEVICE,STATE", "device"]) {
        let state =
            ran.text.lines().find_map(|line| line.strip_prefix(interface)?.strip_prefix(':').map(str::to_string));
        if let Some(state) = state.filter(|state| state != "unmanaged") {
            return bad(format!("NetworkManager has {interface} ({state})"))
                .mend(format!("sudo nmcli device set {interface} managed no"));
        }
    }
    let supplicant =
        system.names("/proc").into_iter().filter(|pid| pid.bytes().all(|b| b.is_ascii_digit())).find(|pid| {
            let words = system.bytes(&format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let words: Vec<_> = words.split(|byte| *byte == 0).map(String::from_utf8_lossy).collect();
            let program = words.first().is_some_and(|word| word.ends_with("wpa_supplicant"));
            // Started for this interface; NetworkManager's own (-u) is idle on unmanaged ones.
            program && words.iter().any(|word| word.trim_start_matches("-i") == interface)
        });
    match supplicant {
        Some(pid) => bad(format!("wpa_supplicant (process {pid}) has {interface}"))
            .mend(format!("sudo kill {pid}, and leave {interface} out of /etc/network/interfaces or netplan")),
        None => good("none seen"),
    }
}

/// Requirements for CSI of an access point's frames.
fn association(system: &dyn System, interface: &str) -> Vec<Found> {
    let Some(link) = system.run(&["iw", "dev", interface, "link"]).map(|ran| ran.text) else { return Vec::new() };
    let Some(station) = link.trim().strip_prefix("Connected to ") else {
        let mend =
            format!("sudo iw dev {interface} connect SSID, of an open network (or monitor mode, see `interface`)");
        return vec![bad("not associated: no frames come to this card, and so no CSI").mend(mend)];
    };
    let station = station.split_whitespace().next().unwrap_or_default();
    let mut checks = Vec::new();
    // The card measures CSI of the access point's frames; without their rate, this card's own rate is taken.
    let rate =
        |which: &str| link.lines().find_map(|line| line.trim().strip_prefix(which).map(|rate| rate.trim().to_owned()));
    if let Some(rate) = rate("rx bitrate:").or_else(|| rate("tx bitrate:")).filter(|rate| !rate.contains("MCS")) {
        let found = format!("{rate}: a legacy rate, and only HT frames (MCS) carry CSI");
        let mend = "802.11n on the access point (mode n, WMM on, open: WEP and TKIP end HT), `swcrypto` and `11n_disable` of \
                    iwlwifi at 0, and traffic: ping -i 0.01 to the access point";
        checks.push(bad(found).mend(mend));
    }
    if is_encrypted(system, interface, station) {
        let mend = "an open network on the access point, for the time of the measurement";
        let found = format!("{station} encrypts: the CSI firmware measures no encrypted frames");
        checks.push(bad(found).mend(mend));
    }
    if checks.is_empty() {
        checks.push(good(format!("associated with {station}")));
    }
    checks
}

/// True if the last scan found that a station encrypts.
fn is_encrypted(system: &dyn System, interface: &str, station: &str) -> bool {
    // Known scan results; a copy of a machine may have the scan itself.
    let known = system.run(&["iw", "dev", interface, "scan", "dump"]);
    let scan = known.or_else(|| system.run(&["iw", "dev", interface, "scan"])).map(|ran| ran.text).unwrap_or_default();
    let of_station =
        |part: &&str| part.split(['(', ' ', '\n', '\t']).next().is_some_and(|own| own.eq_ignore_ascii_case(station));
    let mut lines = scan.split("BSS ").find(of_station).unwrap_or_default().lines().map(str::trim);
    lines.any(|line| {
        line.starts_with("RSN:")
            || line.starts_with("WPA:")
            || (line.starts_with("capability:") && line.contains("Privacy"))
    })
}

/// A transmission rate (`rate_n_flags` of `dvm/commands.h`) in words.
fn rate_words(rate: u32) -> String {
    // OFDM, then CCK, whose codes are the speeds in 100 kbit/s.
    const OFDM: [u32; 8] = [0xd, 0xf, 0x5, 0x7, 0x9, 0xb, 0x1, 0x3];
    const SPEEDS: [&str; 8] = ["6", "9", "12", "18", "24", "36", "48", "54"];
    const CCK: [u32; 4] = [10, 20, 55, 110];
    let code = rate & 0xff;
    let cck = rate & 0x200 != 0;
    let kind = if rate & RATE_HT != 0 {
        format!("HT, MCS {}", code & 0x1f)
    } else {
        let ofdm = OFDM.iter().position(|own| *own == code).map(|k| SPEEDS[k].to_owned());
        let speed = if cck { CCK.contains(&code).then(|| (f64::from(code) / 10.0).to_string()) } else { ofdm };
        let speed = speed.map_or_else(|| "an unknown rate".to_owned(), |speed| format!("{speed} Mbit/s"));
        format!("legacy {}, {speed}", if cck { "CCK" } else { "OFDM" })
    };
    let antennas: String = [(0x4000, 'A'), (0x8000, 'B'), (0x1_0000, 'C')]
        .into_iter()
        .filter_map(|(bit, name)| (rate & bit != 0).then_some(name))
        .collect();
    let width = if rate & 0x800 != 0 { "40 MHz" } else { "20 MHz" };
    let guard = if rate & 0x2000 != 0 { ", short guard" } else { "" };
    let antennas = if antennas.is_empty() { "no antenna".into() } else { format!("antennas {antennas}") };
    format!("{kind}, {width}{guard}, {antennas}")
}

/// What an interface is tuned to, as `iw` prints it behind `channel`.
fn tuned(info: &str) -> Option<String> {
    info.lines().find_map(|line| line.trim().strip_prefix("channel ").map(str::to_string))
}

/// What is wrong if an interface is tuned to another channel than this one, whose wavelength bearings are made with.
#[must_use]
pub fn other_channel(system: &dyn System, interface: &str, channel: Channel) -> Option<String> {
    let line = tuned(&system.run(&["iw", "dev", interface, "info"])?.text)?;
    let (_, centre) = line.split_once("center1: ").or_else(|| line.split_once('('))?;
    let mhz: f64 = centre.split_whitespace().next()?.parse().ok()?;
    let is_other = (mhz - channel.centre_hz() * 1e-6).abs() > 1.0;
    is_other.then(|| format!("{interface} is on channel {line}; bearings are made for channel {channel}"))
}

fn channel(system: &dyn System, interface: &str, card: &Card) -> Found {
    let Some(ran) = system.run(&["iw", "dev", interface, "info"]) else {
        return unknown("iw is not installed").mend("sudo apt install iw");
    };
    let Some(line) = tuned(&ran.text) else {
        return bad(format!("{interface} has none"))
            .mend(format!("sudo ip link set {interface} up && sudo iw dev {interface} set channel 64 HT20"));
    };
    let mhz: Option<u32> = line.split_once('(').and_then(|(_, rest)| rest.split_whitespace().next()?.parse().ok());
    if mhz.is_some_and(|mhz| mhz < 3_000) {
        return doubt(format!("{line}: at 2.4 GHz each antenna's phase jumps by multiples of pi/2"))
            .mend(format!("sudo iw dev {interface} set channel 64 HT20"));
    }
    let flags = mhz.zip(card.phy.as_ref()).and_then(|(mhz, phy)| flags_of_phy(system, phy, mhz)).unwrap_or_default();
    let forbidden = ["disabled", "no IR", "passive", "radar"].iter().find(|flag| flags.contains(**flag));
    match forbidden {
        None => good(line),
        Some(_) => doubt(format!("{line}; this card may not start to transmit there ({flags})"))
            .mend("enough to receive; to transmit, take a channel without these flags in `iw phy`"),
    }
}

/// The text in parentheses after a channel in `iw`'s output.
fn flags_of_phy(system: &dyn System, phy: &str, mhz: u32) -> Option<String> {
    let text = system.run(&["iw", "phy", phy, "info"])?.text;
    let line = text.lines().find(|line| {
        let mut words = line.trim().trim_start_matches("* ").split_whitespace();
        let frequency = words.next().and_then(|word| word.parse::<f64>().ok());
        words.next() == Some("MHz") && frequency.is_some_and(|found| (found - f64::from(mhz)).abs() < 0.5)
    })?;
    Some(line.split_once(']')?.1.trim().to_string())
}

/// Flags of a channel for an interface, as `iw phy` prints them in parentheses; `mhz` is its centre. `None` without such a channel, or
/// without `iw`.
#[must_use]
pub fn channel_flags(system: &dyn System, interface: &str, mhz: u32) -> Option<String> {
    flags_of_phy(system, &system.text(&format!("/sys/class/net/{interface}/phy80211/name"))?, mhz)
}

/// The path of the driver's `monitor_tx_rate`; its depth differs between kernels.
pub(crate) fn rate_file(system: &dyn System, phy: &str) -> Option<String> {
    let base = format!("/sys/kernel/debug/ieee80211/{phy}/iwlwifi");
    let places = ["debug", "iwldvm/debug", "iwldvm", ""];
    let at = |place: &&str| format!("{base}/{place}/monitor_tx_rate").replace("//", "/");
    places.iter().map(at).find(|path| system.size(path).is_some())
}

fn rate(system: &dyn System, card: &Card) -> Found {
    let Some(path) = card.phy.as_ref().and_then(|phy| rate_file(system, phy)) else {
        return unknown("not found: debugfs not mounted, not root, or not the CSI driver")
            .mend("sudo mount -t debugfs none /sys/kernel/debug; run the doctor as root");
    };
    let text = system.text(&path).unwrap_or_default();
    let rate = u32::from_str_radix(text.trim_start_matches("0x"), 16);
    let found = rate.as_ref().map_or(text, |rate| format!("{rate:#x} ({})", rate_words(*rate)));
    if rate.is_ok_and(|rate| rate & RATE_HT != 0) {
        return good(found);
    }
    doubt(format!("{found}: not HT, so what this card sends gives no CSI to others"))
        .mend(format!("echo 0x4101 | sudo tee {path}"))
}

pub(super) fn domain(system: &dyn System) -> Check {
    let ran = system.run(&["iw", "reg", "get"]);
    let country =
        |ran: &Ran| ran.text.lines().find_map(|line| line.trim().strip_prefix("country ").map(str::to_string));
    let found = match ran.as_ref().map(country) {
        None => unknown("iw is not installed").mend("sudo apt install iw"),
        Some(Some(country)) if !country.starts_with("00") => good(country),
        Some(Some(_)) => doubt("00 (world): most 5 GHz channels are for listening only")
            .mend("sudo iw reg set XX with your country's code, wait two seconds, then set the channel"),
        Some(None) => unknown("iw does not report it"),
    };
    found.of("regulatory domain", "the country that the robots are in")
}
