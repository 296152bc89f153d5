//! Checks of all requirements of a first record, in the order in which they usually fail, and the set-up of the card.
//!
//! Every check reads the machine through [`System`], so that tests can stage each failure with a folder of files. The
//! facts are those of csitool's and WSR's installation notes and of their users' reports.

mod card;
mod host;
mod setup;

pub(crate) use card::{EBPF_NEEDS, IWL5300, no_ebpf};
pub use host::{channel_flags, other_channel};
pub(crate) use host::{grant, rate_file};
pub(crate) use setup::MODULE_RATE;
pub use setup::{Action, Driver, Request, Role, Step, default_interface, plan, undo, warnings};

use csi5300::source::Next;
use csi5300::source::survey::Survey;
use driver_iface::bfee::{Bfee, Iq};
use driver_iface::record::code;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Good,
    /// A possible problem.
    Doubt,
    /// A problem.
    Bad,
    /// Unknown.
    Unknown,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// The result.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
    /// The command or step that repairs it.
    pub mend: Option<String>,
}

/// What a check found: the verdict, the words, and what repairs it.
struct Found(Verdict, String, Option<String>);

impl Found {
    fn mend(self, mend: impl Into<String>) -> Self {
        Self(self.0, self.1, Some(mend.into()))
    }

    /// The check of this name, and what it expects.
    fn of(self, name: &'static str, expected: impl Into<String>) -> Check {
        Check { name, verdict: self.0, found: self.1, expected: expected.into(), mend: self.2 }
    }
}

fn good(found: impl Into<String>) -> Found {
    Found(Verdict::Good, found.into(), None)
}

fn bad(found: impl Into<String>) -> Found {
    Found(Verdict::Bad, found.into(), None)
}

fn doubt(found: impl Into<String>) -> Found {
    Found(Verdict::Doubt, found.into(), None)
}

fn unknown(found: impl Into<String>) -> Found {
    Found(Verdict::Unknown, found.into(), None)
}

/// The checks that need no reception, in order.
pub fn examine(system: &dyn System) -> Vec<Check> {
    let card = card::Card::find(system);
    if card.is_none()
        && let Some(checks) = card::ax2xx_checks(system)
    {
        return checks;
    }
    let ways = card::Ways::find(system);
    let mut checks = card::checks(system, card.as_ref(), &ways);
    checks.extend(host::radio_checks(system, card.as_ref()));
    checks.extend(host::checks(system, &ways));
    checks
}

/// What a command printed and whether it succeeded.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ran {
    /// Exit status 0.
    pub ok: bool,
    /// Standard output, then standard error.
    pub text: String,
}

/// Files and commands of a machine. Paths are absolute; absent ones are `None` or empty.
pub trait System {
    /// Where this program finds a file of the machine.
    fn at(&self, path: &str) -> PathBuf;
    /// Runs a program; `None` if it is not installed.
    fn run(&self, words: &[&str]) -> Option<Ran>;

    /// A file's bytes.
    fn bytes(&self, path: &str) -> Option<Vec<u8>> {
        fs::read(self.at(path)).ok()
    }
    /// Names in a folder, sorted.
    fn names(&self, path: &str) -> Vec<String> {
        let Ok(entries) = fs::read_dir(self.at(path)) else { return Vec::new() };
        let mut names: Vec<_> =
            entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
    /// The last part of a symbolic link's target.
    fn link(&self, path: &str) -> Option<String> {
        Some(fs::read_link(self.at(path)).ok()?.file_name()?.to_string_lossy().into_owned())
    }
    /// A file's size.
    fn size(&self, path: &str) -> Option<u64> {
        fs::metadata(self.at(path)).ok().map(|about| about.len())
    }
    /// Replaces a file's content.
    ///
    /// # Errors
    /// The operating system's answer.
    fn write(&self, path: &str, text: &str) -> std::io::Result<()> {
        fs::write(self.at(path), text)
    }
    /// A file as trimmed text.
    fn text(&self, path: &str) -> Option<String> {
        self.bytes(path).map(|bytes| String::from_utf8_lossy(&bytes).trim().to_string())
    }
}

/// The counters of the module `csi5300`.
const COUNTERS: &str = "/sys/module/csi5300/counters";

/// The counters of the module `csi5300`, by name; none where it is not loaded.
#[must_use]
pub fn module_counters(system: &dyn System) -> BTreeMap<String, u64> {
    let value = |name: &String| system.text(&format!("{COUNTERS}/{name}"))?.parse().ok();
    system.names(COUNTERS).into_iter().filter_map(|name| value(&name).map(|count| (name, count))).collect()
}

/// By how much each counter of the module grew since `before`.
#[must_use]
pub fn module_growth(system: &dyn System, before: &BTreeMap<String, u64>) -> BTreeMap<String, u64> {
    let mut counters = module_counters(system);
    for (name, count) in &mut counters {
        *count = count.wrapping_sub(before.get(name).copied().unwrap_or(0));
    }
    counters
}

/// This machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Machine;

impl System for Machine {
    fn at(&self, path: &str) -> PathBuf {
        path.into()
    }
    fn run(&self, words: &[&str]) -> Option<Ran> {
        let (program, arguments) = words.split_first()?;
        let mut command = Command::new(program);
        // Administrators' tools are often outside of a user's path, and their output is parsed in English.
        let path = std::env::var("PATH").unwrap_or_default();
        command.args(arguments).env("PATH", format!("{path}:/usr/sbin:/sbin")).env("LC_ALL", "C").stdin(Stdio::null());
        let out = command.output().ok()?;
        let text = [out.stdout, out.stderr].concat();
        Some(Ran { ok: out.status.success(), text: String::from_utf8_lossy(&text).into_owned() })
    }
}

/// A copy of a machine's files under a folder; a command's output is the file `run/<its words>`, `/` written as `_`.
#[derive(Clone, Debug)]
pub struct Tree(pub PathBuf);

impl System for Tree {
    fn at(&self, path: &str) -> PathBuf {
        self.0.join(path.trim_start_matches('/'))
    }
    fn run(&self, words: &[&str]) -> Option<Ran> {
        let text = fs::read_to_string(self.0.join("run").join(words.join(" ").replace('/', "_"))).ok()?;
        Some(Ran { ok: true, text })
    }
}

/// True for CSI of zeros only.
#[must_use]
pub fn is_silent(bfee: &Bfee<'_>) -> bool {
    let mut columns = (0..bfee.n_rx()).flat_map(|chain| (0..bfee.n_tx()).map(move |stream| (chain, stream)));
    columns.all(|(chain, stream)| bfee.column(chain, stream).is_none_or(|iq| iq.iter().all(|iq| *iq == Iq::default())))
}

/// A running reception.
#[derive(Debug, Default)]
pub struct Reception {
    /// Everything counted.
    pub survey: Survey,
    zero_csi: u64,
    nrx_steps: u64,
    last_nrx: Option<usize>,
    unnumbered: u64,
}

impl Reception {
    /// Counts an item of a source.
    pub fn note(&mut self, next: &Next<'_>) {
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        self.zero_csi += u64::from(is_silent(&bfee));
        self.nrx_steps += u64::from(self.last_nrx.is_some_and(|last| last != bfee.n_rx()));
        self.last_nrx = Some(bfee.n_rx());
        self.unnumbered += u64::from(identity.frame_count.is_none());
    }

    /// Its checks, the worst first; one good check without problems.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let check = |found: Found| found.of("reception", "bfee records with CSI from known senders");
        self.found().into_iter().map(check).collect()
    }

    fn found(&self) -> Vec<Found> {
        let survey = &self.survey;
        let bfees = survey.bfees();
        if survey.records == 0 {
            return vec![bad("nothing").mend(
                "is another robot sending HT frames to and from 00:16:ea:12:34:56 on this channel and width? If the \
                 checks above are good, look for a firmware crash in `sudo dmesg`",
            )];
        }
        if bfees == 0 {
            let found = match survey.by_code.keys().all(|code| *code == code::MPDU) {
                true => {
                    "only frames (0xC1), no CSI (0xBB): none of them is HT, or none goes to and from 00:16:ea:12:34:56"
                }
                false => "messages of the driver, but no CSI among them",
            };
            return vec![bad(found).mend("on the sender: `echo 0x4101` into monitor_tx_rate")];
        }
        let mut all = Vec::new();
        if self.zero_csi > 0 {
            let words = format!("{} of {bfees} records have only zeros as CSI", self.zero_csi);
            let found = if self.zero_csi == bfees { bad(words) } else { doubt(words) };
            all.push(found.mend("reload the driver; if it stays, try another card"));
        }
        if survey.bad_bfee > 0 {
            all.push(doubt(format!("{} contradictory bfee records", survey.bad_bfee)));
        }
        if self.unnumbered == bfees {
            let found = doubt("no record names its sender: the csitool driver without connector_log bit 0x4");
            all.push(found.mend("use the WSR driver, or connector_log=0x5, to tell senders apart"));
        } else if self.unnumbered * 2 > bfees {
            all.push(doubt(format!("{} of {bfees} records from unknown senders", self.unnumbered)));
        }
        if survey.rssi.iter().flatten().count() == 1 {
            let mend = "enough for bearings from motion; otherwise check the pigtails and rx_chains_msk (0x7)";
            all.push(doubt("only one antenna receives").mend(mend));
        }
        if self.nrx_steps * 20 > bfees {
            let words = format!("the number of receive chains changes {} times in {bfees} records", self.nrx_steps);
            all.push(doubt(words).mend("connect all three antennas, or fix rx_chains_msk to one number"));
        }
        let (overruns, missing) = (survey.overruns, survey.bfee_missing);
        if overruns > 0 || missing * 100 > bfees {
            let found = doubt(format!("{overruns} overruns, {missing} numbers missing from bfee_count"));
            all.push(found.mend("a larger --receive-buffer of `record`; fewer programs on this host"));
        }
        if all.is_empty() {
            all.push(good(format!("{bfees} bfee records, {} senders", survey.senders.len())));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::signal::channel::Channel;
    use csi5300::source::Stamps;
    use driver_iface::bfee::{self, csi_len};
    use driver_iface::record::Record;
    use std::cell::RefCell;
    use std::os::unix::fs::symlink;

    /// A machine as a folder of files, gone when dropped.
    pub(super) struct Stage {
        pub(super) root: PathBuf,
    }

    impl Drop for Stage {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.root);
        }
    }

    const CARD: &str = "sys/bus/pci/devices/0000:01:00.0";
    const EFIVAR: &str = "sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c";
    const RATE_PATH: &str = "sys/kernel/debug/ieee80211/phy0/iwlwifi/iwldvm/debug/monitor_tx_rate";

    impl Stage {
        pub(super) fn empty(name: &str) -> Self {
            let root = std::env::temp_dir().join(format!("csi5300-doctor-{}-{name}", std::process::id()));
            let _ = std::fs::remove_dir_all(&root);
            Self { root }
        }

        /// A machine without problems.
        fn healthy(name: &str) -> Self {
            let stage = Self::empty(name);
            for (path, text) in [
                (&*format!("{CARD}/vendor"), "0x8086\n"),
                (&format!("{CARD}/device"), "0x4236\n"),
                (&format!("{CARD}/net/wlp1s0/address"), "00:16:ea:00:00:01\n"),
                (&format!("{CARD}/ieee80211/phy0/index"), "0\n"),
                ("proc/sys/kernel/osrelease", "4.15.0-45-generic\n"),
                ("proc/sys/net/core/rmem_max", "33554432\n"),
                ("proc/net/connector", "Name            ID\ncn_proc         1:1\niwlagn          26:1\n"),
                ("proc/self/status", "Name:\tcsi5300\nCapEff:\t0000000000001000\n"),
                ("sys/module/iwlwifi/parameters/connector_log", "5\n"),
                ("sys/class/rfkill/rfkill0/type", "wlan\n"),
                ("sys/class/rfkill/rfkill0/soft", "0\n"),
                ("sys/class/rfkill/rfkill0/hard", "0\n"),
                ("sys/class/net/wlp1s0/type", "803\n"),
                ("sys/class/net/wlp1s0/flags", "0x1003\n"),
                ("sys/class/net/wlp1s0/phy80211/name", "phy0\n"),
                (RATE_PATH, "0x4101\n"),
                ("run/dmesg", "iwlwifi 0000:01:00.0: loaded firmware version 8.24.2.12\n"),
                (
                    "run/iw dev wlp1s0 info",
                    "Interface wlp1s0\n\ttype monitor\n\tchannel 108 (5540 MHz), width: 20 MHz\n",
                ),
                (
                    "run/iw phy phy0 info",
                    "\t\t\t* 5540 MHz [108] (20.0 dBm)\n\t\t\t* 5560 MHz [112] (no IR, radar detection)\n",
                ),
                ("run/iw reg get", "global\ncountry BO: DFS-JP\n"),
                ("run/nmcli -t -f DEVICE,STATE device", "eth0:connected\nwlp1s0:unmanaged\n"),
                ("run/timedatectl show -p NTPSynchronized", "NTPSynchronized=yes\n"),
                ("lib/firmware/iwlwifi-5000-2.ucode", &"x".repeat(336_252)),
                ("lib/firmware/iwlwifi-5150-2.ucode", "another card's"),
                ("sys/bus/pci/drivers/iwlwifi/bind", ""),
            ] {
                stage.put(path, text);
            }
            symlink("../../drivers/iwlwifi", stage.root.join(format!("{CARD}/driver"))).unwrap();
            stage
        }

        pub(super) fn put(&self, path: &str, text: &str) {
            let path = self.root.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }

        pub(super) fn remove(&self, path: &str) {
            let path = self.root.join(path);
            if path.is_dir() { std::fs::remove_dir_all(path).unwrap() } else { std::fs::remove_file(path).unwrap() }
        }

        pub(super) fn tree(&self) -> Tree {
            Tree(self.root.clone())
        }

        fn examine(&self) -> Vec<Check> {
            examine(&self.tree())
        }

        fn check(&self, name: &str) -> Check {
            let checks = self.examine();
            checks
                .iter()
                .find(|check| check.name == name)
                .unwrap_or_else(|| panic!("no check `{name}`: {checks:?}"))
                .clone()
        }
    }

    /// The number of the first line with these words.
    pub(super) fn place(lines: &[String], words: &str) -> usize {
        lines.iter().position(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {lines:?}"))
    }

    #[test]
    fn another_channel_than_that_of_the_bearings_is_said() {
        let stage = Stage::healthy("channel");
        let told = |channel: &str| other_channel(&stage.tree(), "wlp1s0", channel.parse().unwrap());
        assert_eq!(told("108"), None);
        assert!(told("64").unwrap().starts_with("wlp1s0 is on channel 108 (5540 MHz), width: 20 MHz; bearings"));
        assert!(told("108+").is_some());
        stage.put("run/iw dev wlp1s0 info", "\tchannel 108 (5540 MHz), width: 40 MHz, center1: 5550 MHz\n");
        assert_eq!((told("108+"), told("108").is_some()), (None, true));
        assert_eq!(other_channel(&stage.tree(), "mon7", "64".parse().unwrap()), None, "nobody knows");
    }

    #[test]
    fn a_healthy_machine_has_nothing_in_the_way() {
        let stage = Stage::healthy("healthy");
        for check in stage.examine() {
            assert_eq!(check.verdict, Verdict::Good, "{check:?}");
            assert_eq!(check.mend, None, "{check:?}");
        }
        assert_eq!(stage.examine().len(), 21);
    }

    #[test]
    fn an_ax210_has_its_own_way_to_csi() {
        let stage = Stage::healthy("ax210");
        let csi_enabled = "sys/kernel/debug/iwlwifi/0000:01:00.0/iwlmvm/csi_enabled";
        stage.put(&format!("{CARD}/device"), "0x2725\n");
        stage.put(csi_enabled, "0\n");
        stage.put("run/feitcsi --version", "FeitCSI 2.0.0\n");
        stage.put("run/dmesg", "iwlwifi 0000:01:00.0: loaded firmware version 77.2df8986f.0 ty-a0-gf-a0-77.ucode\n");
        for check in stage.examine() {
            assert_eq!(check.verdict, Verdict::Good, "{check:?}");
        }
        assert!(stage.check("card").found.contains("AX210 (8086:2725)"), "{:?}", stage.check("card"));
        assert!(stage.check("way to CSI").mend.unwrap().contains("record OUT.csi --feitcsi"));
        assert_eq!(stage.check("FeitCSI").found, "FeitCSI 2.0.0");
        stage.remove(csi_enabled);
        let check = stage.check("way to CSI");
        assert!(check.verdict == Verdict::Bad && check.mend.unwrap().contains("feitcsi-iwlwifi"));
        stage.remove("sys/kernel/debug/iwlwifi");
        assert_eq!(stage.check("way to CSI").verdict, Verdict::Unknown);
        stage.remove("run/feitcsi --version");
        assert_eq!(stage.check("FeitCSI").verdict, Verdict::Bad);
        stage.put("run/dmesg", "iwlwifi 0000:01:00.0: Microcode SW error detected. Restarting 0x0.\n");
        assert_eq!(stage.check("firmware loaded").verdict, Verdict::Bad);
        // A 5300 beside it is examined.
        stage.put("sys/bus/pci/devices/0000:02:00.0/vendor", "0x8086\n");
        stage.put("sys/bus/pci/devices/0000:02:00.0/device", "0x4236\n");
        assert!(stage.check("card").found.contains("4236"));
    }

    /// Failures, one a line: the check that reports it, the verdict, a word of the finding, a word of the remedy, and what
    /// stages it: `- PATH` removes, `PATH = TEXT` writes.
    const FAILURES: &[&str] = &[
        "card | bad | none on the PCI bus | lspci | - CARD",
        "card | doubt | 4232 | 5300 | CARD/device = 0x4232",
        "kernel | doubt | 4.4.0 | 4.15 | proc/sys/kernel/osrelease = 4.4.0-1",
        "kernel | doubt | 4.150 | 4.15 | proc/sys/kernel/osrelease = 4.150.1",
        "Secure Boot | bad | on | BIOS | EFIVAR = \u{6}\0\0\0\u{1}",
        "driver | bad | no driver | modprobe iwlwifi | - CARD/driver",
        // The distribution's module.
        "patched module | bad | the distribution's module | connector_log=0x5 | - MODULE/connector_log | MODULE/swcrypto = 0",
        "patched module | bad | not loaded | install | - sys/module/iwlwifi",
        "connector_log | bad | no CSI | 0x5 | MODULE/connector_log = 4",
        "connector_log | bad | no CSI | 0x1 | MODULE/connector_log = 4 | MODULE/ack_len = 57",
        "connector_log | doubt | no record names its sender | connector_log=0x5 (`csi5300 setup` | MODULE/connector_log = 1",
        "connector_log | good | 0x1, ack_len 57 |  | MODULE/connector_log = 1 | MODULE/ack_len = 57",
        "firmware file | bad | 1 bytes | sudo mv /lib/firmware/iwlwifi-5000-2.ucode /lib/firmware/iwlwifi-5000-2.ucode.csi5300-aside && sudo cp | lib/firmware/iwlwifi-5000-2.ucode = y",
        "firmware file | bad | not there | sigcomm2010 | - lib/firmware",
        "other firmware | bad | iwlwifi-5000-5.ucode win | iwlwifi-5000-5.ucode.csi5300-aside | lib/firmware/iwlwifi-5000-5.ucode = z",
        "other firmware | bad | 5000-5 | mv  | lib/firmware/iwlwifi-5000-5.ucode.zst = z",
        "firmware loaded | bad | 8.83.5.1 | reload | run/dmesg = iwlwifi: loaded firmware version 8.83.5.1 build 33692",
        "firmware loaded | bad | crashed | modprobe -r | run/dmesg = iwlwifi 0000:01:00.0: Microcode SW error detected.  Restarting 0x2000000.",
        "rfkill | bad | software | unblock | sys/class/rfkill/rfkill0/soft = 1",
        "rfkill | bad | switch | switch | sys/class/rfkill/rfkill0/hard = 1",
        "interface | bad | none | iwldvm | - CARD/net",
        "interface | doubt | not a monitor | type monitor | NET/type = 1",
        "interface | bad | down | up | NET/flags = 0x1002",
        // Managed mode: not associated, and with access points that are legacy, encrypted, open.
        "association | bad | not associated | iw dev wlp1s0 connect | NET/type = 1 | IW link = Not connected.\n",
        "association | bad | 54.0 MBit/s: a legacy rate | 802.11n | NET/type = 1 | \
         IW link = Connected to 02:53:00:00:00:aa (on wlp1s0)\n\ttx bitrate: 54.0 MBit/s\n",
        "association | bad | 02:53:00:00:00:aa encrypts | open network | NET/type = 1 | \
         IW link = Connected to 02:53:00:00:00:aa (on wlp1s0)\n\tSSID: lab\n\ttx bitrate: 26.0 MBit/s MCS 3\n | \
         IW scan dump = BSS 02:53:00:00:00:bb(on wlp1s0)\n\tSSID: open\nBSS 02:53:00:00:00:AA(on wlp1s0)\n\tRSN:\t * Version: 1\n",
        "association | good | associated with 02:53:00:00:00:bb |  | NET/type = 1 | \
         IW link = Connected to 02:53:00:00:00:bb (on wlp1s0)\n\ttx bitrate: 26.0 MBit/s MCS 3\n | \
         IW scan = BSS 02:53:00:00:00:bb\n\tSSID: open\nBSS 02:53:00:00:00:aa\n\tRSN: * Version: 1\n",
        // A monitor beside the first interface, which is up.
        "other owners | bad | wlp1s0 is up on the same card | sudo ip link set wlp1s0 down | NET/type = 1\n | \
         CARD/net/mon0/address = 00:16:ea:00:00:01\n | sys/class/net/mon0/type = 803\n | sys/class/net/mon0/flags = 0x1003\n",
        "other owners | bad | NetworkManager | managed no | run/nmcli -t -f DEVICE,STATE device = wlp1s0:disconnected\n",
        "other owners | bad | 4242 | kill 4242 | proc/4242/cmdline = /sbin/wpa_supplicant\0-iwlp1s0\0-c/etc/w.conf\0",
        "patched module | good | harmless |  | \
         run/dmesg = iwlwifi: module verification failed: signature and/or required key missing\n",
        "channel | bad | none | set channel | IW info = Interface",
        "channel | doubt | 2.4 GHz | HT20 | IW info = \tchannel 6 (2437 MHz), width: 20 MHz",
        "channel | doubt | no IR | without these flags | IW info = \tchannel 112 (5560 MHz), width: 20 MHz",
        "monitor_tx_rate | doubt | not HT | 0x4101 | RATE_PATH = 0x4005",
        "monitor_tx_rate | doubt | not HT | monitor_tx_rate | RATE_PATH = 0x0",
        "monitor_tx_rate | unknown | not found | debugfs | - sys/kernel/debug",
        "regulatory domain | doubt | 00 | reg set | run/iw reg get = country 00: DFS-UNSET",
        "network namespace | bad | container | host | - proc/net/connector",
        "connector index | bad | not registered | modprobe -r | proc/net/connector = Name ID\n",
        "connector index | bad | 254 | newer | proc/net/connector = iwlagn 254:1",
        "capability | bad | not held | setcap | proc/self/status = CapEff:\t0",
        "receive buffer | doubt | 212992 | sysctl | proc/sys/net/core/rmem_max = 212992",
        "clock | doubt | not synchronised | chrony | run/timedatectl show -p NTPSynchronized = NTPSynchronized=no",
    ];

    #[test]
    fn each_failure_is_reported_with_its_remedy() {
        let short = [("CARD", CARD), ("MODULE", "sys/module/iwlwifi/parameters"), ("EFIVAR", EFIVAR)];
        let short =
            [&short[..], &[("NET", "sys/class/net/wlp1s0"), ("IW", "run/iw dev wlp1s0"), ("RATE_PATH", RATE_PATH)]];
        for (number, failure) in FAILURES.iter().enumerate() {
            let stage = Stage::healthy(&format!("failure-{number}"));
            let columns: Vec<&str> = failure.split(" | ").collect();
            let [check, verdict, found, mend, staged @ ..] = &columns[..] else { panic!("{failure}") };
            for step in staged {
                let path = |path: &str| {
                    let known =
                        short.iter().copied().flatten().find_map(|(name, at)| Some((at, path.strip_prefix(name)?)));
                    known.map_or(path.to_owned(), |(at, rest)| format!("{at}{rest}"))
                };
                match (step.strip_prefix("- "), step.split_once(" = ")) {
                    (Some(gone), _) => stage.remove(&path(gone)),
                    (None, Some((file, text))) => stage.put(&path(file), text),
                    (None, None) => panic!("{failure}"),
                }
            }
            let check = stage.check(check);
            assert_eq!(format!("{:?}", check.verdict).to_lowercase(), *verdict, "{failure}: {check:?}");
            assert!(check.found.contains(found), "{failure}: {check:?}");
            let mends = check.mend.as_ref().map_or(mend.is_empty(), |said| said.contains(mend));
            assert!(mends, "{failure}: {check:?}");
        }
    }

    fn bfee(n_rx: u8, rssi: [u8; 3], csi: u8, count: u16) -> Vec<u8> {
        let mut body = vec![0; bfee::STOCK_HEADER];
        body.resize(bfee::STOCK_HEADER + csi_len(n_rx, 1), csi);
        body[bfee::offset::BFEE_COUNT..][..2].copy_from_slice(&count.to_le_bytes());
        (body[bfee::offset::N_RX], body[bfee::offset::N_TX]) = (n_rx, 1);
        body[bfee::offset::RSSI..][..3].copy_from_slice(&rssi);
        body[bfee::offset::ANTENNA_SEL] = 0b10_01_00;
        body[bfee::offset::LEN..][..2].copy_from_slice(&(csi_len(n_rx, 1) as u16).to_le_bytes());
        body
    }

    fn hear(records: &[(u8, Vec<u8>)]) -> Vec<Check> {
        let mut heard = Reception::default();
        for (code, body) in records {
            heard.note(&Next::Record(Stamps::default(), Record { code: *code, body }));
        }
        heard.checks()
    }

    fn found(checks: &[Check], words: &str) -> bool {
        checks.iter().any(|check| check.found.contains(words) && check.verdict != Verdict::Good)
    }

    #[test]
    fn receptions_are_told_apart() {
        let all = [30, 31, 32];
        let bfees = |n: u16, make: &dyn Fn(u16) -> Vec<u8>| (0..n).map(|k| (code::BFEE, make(k))).collect::<Vec<_>>();
        assert!(found(&hear(&[]), "nothing"));
        assert!(found(&hear(&[(code::MPDU, vec![0; 60])]), "only frames (0xC1)"));
        assert!(found(&hear(&[(code::NOISE, vec![0; 4])]), "no CSI among them"));
        assert!(found(&hear(&bfees(9, &|k| bfee(3, all, 0, k))), "only zeros"));
        assert!(found(&hear(&bfees(9, &|k| bfee(3, all, 0x5a, k))), "no record names its sender"));
        assert!(found(&hear(&bfees(9, &|k| bfee(1, [30, 0, 0], 0x5a, k))), "only one antenna"));
        assert!(!found(&hear(&bfees(9, &|k| bfee(3, all, 0x5a, k))), "only one antenna"));
        assert!(found(
            &hear(&bfees(40, &|k| bfee(1 + (k % 3) as u8, all, 0x5a, k))),
            "receive chains changes 39 times"
        ));
        assert!(found(&hear(&bfees(9, &|k| bfee(3, all, 0x5a, 3 * k))), "16 numbers missing"));
        // The WSR layout names its sender: nothing is left to say against it.
        let wsr = |k: u16| {
            let stock = bfee(3, all, 0x5a, k);
            let (head, csi) = stock.split_at(bfee::STOCK_HEADER);
            [head, &[1, 0, 0, 0, 1, 0, 0, 0, 2, 2, 2, 2, 2, 2, k as u8 + 1, 0, 0, 0], csi].concat()
        };
        let checks = hear(&bfees(9, &wsr));
        assert_eq!((checks.len(), checks[0].verdict), (1, Verdict::Good), "{checks:?}");
        assert_eq!(checks[0].found, "9 bfee records, 1 senders");
    }

    /// A machine on which commands succeed, are recorded, and change the state.
    struct Remembering<'a> {
        tree: Tree,
        stage: &'a Stage,
        done: RefCell<Vec<String>>,
    }

    impl System for Remembering<'_> {
        fn at(&self, path: &str) -> PathBuf {
            self.tree.at(path)
        }
        fn run(&self, words: &[&str]) -> Option<Ran> {
            let line = words.join(" ");
            if let Some(parameters) = line.strip_prefix("modprobe iwlwifi") {
                for (name, value) in parameters.split_whitespace().filter_map(|word| word.split_once('=')) {
                    self.stage.put(&format!("sys/module/iwlwifi/parameters/{name}"), value.trim_start_matches("0x"));
                }
            }
            self.done.borrow_mut().push(line);
            Some(Ran { ok: true, text: String::new() })
        }
        fn write(&self, path: &str, text: &str) -> std::io::Result<()> {
            self.done.borrow_mut().push(format!("{path} <- {text}"));
            self.tree.write(path, text)
        }
    }

    fn request(role: Role, channel: &str, ack_len: Option<u32>) -> Request {
        Request {
            interface: "wlp1s0".into(),
            channel: channel.parse::<Channel>().unwrap(),
            role,
            driver: None,
            ack_len,
        }
    }

    fn apply(system: &Remembering<'_>, steps: &[Step]) -> Vec<String> {
        for step in steps {
            step.take(system).unwrap();
        }
        system.done.take()
    }

    #[test]
    fn set_up_takes_each_step_once_and_can_be_undone() {
        let stage = Stage::healthy("setup");
        stage.put("sys/module/iwlwifi/parameters/connector_log", "0");
        stage.put("sys/module/iwlwifi/parameters/ack_len", "1000000");
        stage.put(RATE_PATH, "0x0");
        let system = Remembering { tree: stage.tree(), stage: &stage, done: RefCell::default() };

        let refused = plan(&system, &request(Role::Responder, "108", None)).unwrap_err();
        assert!(refused.contains("needs --ack-len"), "{refused}");

        let wanted = request(Role::Responder, "108", Some(57));
        let done = apply(&system, &plan(&system, &wanted).unwrap());
        let at = |words: &str| place(&done, words);
        assert!(at("managed no") < at("modprobe -r iwldvm iwlwifi"));
        assert!(at("modprobe -r") < at("modprobe iwlwifi connector_log=0x1 ack_len=57"));
        assert!(
            at("link set wlp1s0 down") < at("set type monitor") && at("set type monitor") < at("link set wlp1s0 up")
        );
        assert!(at("link set wlp1s0 up") < at("set channel 108 HT20"));
        assert_eq!(done.last().unwrap(), &format!("/{RATE_PATH} <- 0x4100"));
        assert_eq!(stage.check("monitor_tx_rate").verdict, Verdict::Good);

        // A second time the driver is left alone, and the end is the same.
        let again = apply(&system, &plan(&system, &wanted).unwrap());
        assert!(!again.iter().any(|line| line.contains("modprobe")), "{again:?}");
        // Another role needs other parameters.
        let initiator = plan(&system, &request(Role::Initiator, "36+", None)).unwrap();
        let lines: Vec<_> = initiator.iter().map(Step::line).collect();
        assert!(lines.iter().any(|line| line.contains("ack_len=1000000")), "{lines:?}");
        assert!(lines.iter().any(|line| line.contains("set channel 36 HT40+")), "{lines:?}");
        assert!(lines.last().unwrap().starts_with("sudo sh -c 'echo 0x4900 > "), "{lines:?}");

        let undone = apply(&system, &undo(&system, "wlp1s0"));
        assert!(undone.iter().any(|line| line.contains("set type managed")));
        assert!(undone.iter().any(|line| line == "modprobe iwlwifi"));
        assert_eq!(undone.last().unwrap(), "nmcli device set wlp1s0 managed yes");
    }

    #[test]
    fn of_two_cards_the_one_that_is_set_up_gets_the_rate() {
        let stage = Stage::healthy("two-cards");
        let other = RATE_PATH.replace("phy0", "phy1");
        stage.put(&other, "0x0");
        stage.put("sys/class/net/wlp2s0/phy80211/name", "phy1\n");
        let system = Remembering { tree: stage.tree(), stage: &stage, done: RefCell::default() };
        for (interface, path) in [("wlp2s0", &*other), ("wlp1s0", RATE_PATH)] {
            let request = Request { interface: interface.into(), ..request(Role::Responder, "64", None) };
            let steps = plan(&system, &request).unwrap();
            assert_eq!(apply(&system, &steps).last().unwrap(), &format!("/{path} <- 0x4101"));
            assert!(steps.last().unwrap().line().contains(&format!("/sys/class/net/{interface}/phy80211/name")));
        }
        stage.remove(&other);
        let request = Request { interface: "wlp2s0".into(), ..request(Role::Responder, "64", None) };
        let error = plan(&system, &request).unwrap().last().unwrap().take(&system).unwrap_err();
        assert!(error.starts_with("wlp2s0 has no monitor_tx_rate"), "{error}");
    }

    #[test]
    fn the_stock_driver_gets_its_own_rate_and_no_ack_len() {
        let stage = Stage::healthy("stock");
        stage.put("run/modinfo -p iwlwifi", "connector_log:what to log (int)\n");
        stage.remove("sys/module/iwlwifi");
        let system = stage.tree();
        let lines: Vec<_> =
            plan(&system, &request(Role::Responder, "64", None)).unwrap().iter().map(Step::line).collect();
        assert!(lines.iter().any(|line| line == "sudo modprobe iwlwifi connector_log=0x5"), "{lines:?}");
        assert!(lines.last().unwrap().starts_with("sudo sh -c 'echo 0x4101 > "), "{lines:?}");
        stage.put("run/modinfo -p iwlwifi", "swcrypto:software crypto (int)\n");
        assert!(
            plan(&system, &request(Role::Initiator, "64", None)).unwrap_err().to_string().contains("no connector_log")
        );
        assert_eq!(default_interface(&system).unwrap(), "wlp1s0");
    }

    /// A distribution's kernel of today with its own driver, run with CAP_BPF, CAP_PERFMON and CAP_NET_ADMIN.
    fn todays(name: &str) -> Stage {
        let stage = Stage::healthy(name);
        stage.remove("sys/module/iwlwifi");
        stage.remove("proc/net/connector");
        for (path, text) in [
            ("sys/module/iwlwifi/parameters/power_save", "N\n"),
            ("proc/net/connector", "Name            ID\ncn_proc         1:1\n"),
            ("proc/sys/kernel/osrelease", "6.1.0-56-amd64\n"),
            ("proc/self/status", "CapEff:\t000000c000001000\n"),
            ("sys/bus/event_source/devices/kprobe/type", "8\n"),
            ("sys/kernel/security/lockdown", "none [integrity] confidentiality\n"),
            ("run/uname -m", "x86_64\n"),
        ] {
            stage.put(path, text);
        }
        stage
    }

    #[test]
    fn a_kernel_of_today_needs_no_patch() {
        let stage = todays("today");
        stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
        let way = stage.check("way to CSI");
        assert_eq!(way.verdict, Verdict::Good, "{way:?}");
        assert!(way.found.contains("Best here: eBPF") && way.found.contains("patched driver: no"), "{way:?}");
        assert!(way.found.contains("module: no (Secure Boot"), "{way:?}");
        assert!(way.mend.unwrap().contains("record --stock"));
        for name in ["kernel", "Secure Boot", "patched module"] {
            assert_eq!(stage.check(name).verdict, Verdict::Good, "{name}");
        }
        assert!(stage.examine().iter().all(|check| check.verdict != Verdict::Bad), "{:?}", stage.examine());
    }

    #[test]
    fn another_way_one_step_away_excuses_the_kernel() {
        let stage = todays("a-step");
        stage.put("proc/self/status", "CapEff:\t0000000000001000\n");
        assert_eq!(stage.check("way to CSI").verdict, Verdict::Doubt);
        for name in ["kernel", "patched module", "connector index"] {
            let check = stage.check(name);
            assert!(check.verdict != Verdict::Bad && check.mend.is_none(), "{check:?}");
        }
        // If every other way is closed, an older kernel remains.
        stage.remove("sys/bus/event_source");
        stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
        assert!(stage.check("kernel").mend.unwrap().contains("4.15"));
        assert_eq!(stage.check("patched module").verdict, Verdict::Bad);
    }

    #[test]
    fn a_missing_feature_is_reported() {
        let expect = |stage: &Stage, verdict: Verdict, words: &str| {
            let way = stage.check("way to CSI");
            assert!(way.verdict == verdict && way.found.contains(words), "{words}: {way:?}");
        };
        let cases: [(&str, &str, Verdict, &str); 7] = [
            ("proc/sys/kernel/osrelease", "5.7.19\n", Verdict::Doubt, "eBPF: no (5.7.19 is older than 5.8)"),
            ("run/uname -m", "aarch64\n", Verdict::Doubt, "eBPF: no (not x86-64)"),
            (
                "sys/kernel/security/lockdown",
                "none integrity [confidentiality]\n",
                Verdict::Doubt,
                "eBPF: no (kernel lockdown",
            ),
            ("proc/self/status", "CapEff:\t0000000000001000\n", Verdict::Doubt, "CAP_BPF and CAP_PERFMON are not held"),
            ("proc/sys/kernel/perf_event_paranoid", "3\n", Verdict::Doubt, "perf_event_paranoid above 2 wants root"),
            ("sys/module/csi5300/refcnt", "0\n", Verdict::Good, "Best here: module"),
            ("sys/module/iwlwifi/parameters/connector_log", "1\n", Verdict::Good, "Best here: patched driver"),
        ];
        for (k, (path, text, verdict, words)) in cases.into_iter().enumerate() {
            let stage = todays(&format!("missing-{k}"));
            stage.put(path, text);
            expect(&stage, verdict, words);
        }
        let stage = todays("no-kprobes");
        stage.remove("sys/bus/event_source");
        stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
        expect(&stage, Verdict::Bad, "eBPF: no (the kernel has no kprobes");
        assert_eq!(stage.check("Secure Boot").verdict, Verdict::Bad);
    }
}
