//! The rate of injected frames for drivers that ignore radiotap's: the patched drivers read it from debugfs,
//! `csi5300.ko` from a parameter.

use crate::doctor::{IWL5300, MODULE_RATE, System, rate_file};
use csi5300::exchange::tdma::Phy;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;

/// RATE_MCS_HT_MSK (`dvm/commands.h`): an HT rate, the only ones with CSI.
const HT: u32 = 0x100;
/// RATE_MCS_HT40_MSK: 40 MHz wide.
const HT40: u32 = 0x800;

/// Antennas of the card.
const ANTENNAS: u32 = 3;

/// How to get an HT rate under the kernel's own driver.
const LOAD: &str = "load the module csi5300 (`csi5300 setup --driver module` says how)";

/// The result for the driver's rate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Rate {
    /// The driver has no such file: it takes the rate from radiotap.
    FromRadiotap,
    /// A card under the kernel's own driver, which sends every injected frame at a legacy rate; the remedy.
    Legacy(&'static str),
    /// It was right already.
    Right(u32),
    /// It was set; the rate before.
    Set(u32, String),
    /// It is another rate and could not be set; the command that does.
    Other {
        /// The current rate.
        found: String,
        /// The error.
        error: String,
        /// The command that sets it.
        mend: String,
    },
}

/// The driver's number for a rate (`rate_n_flags`, `dvm/commands.h`): 0x4101 is MCS 1, 20 MHz, antenna A.
///
/// Several streams (MCS 8 and up) go out on as many antennas: `antenna` and the next ones, A after C. `None` for more
/// streams than the card has antennas (MCS 24 and up).
#[must_use]
pub fn rate_n_flags(phy: Phy, antenna: Antenna) -> Option<u32> {
    const ANTENNA_A: u32 = 0x4000;
    let streams = u32::from(phy.mcs / 8 + 1);
    if streams > ANTENNAS {
        return None;
    }
    let first = match antenna {
        Antenna::A => 0,
        Antenna::B => 1,
        Antenna::C => 2,
    };
    let antennas = (first..first + streams).fold(0, |bits, k| bits | ANTENNA_A << (k % ANTENNAS));
    let width = match phy.bandwidth {
        Bandwidth::Ht20 => 0,
        Bandwidth::Ht40 => HT40,
    };
    Some(antennas | width | HT | u32::from(phy.mcs))
}

/// Sets the rate of a driver that ignores radiotap.
#[must_use]
pub fn set_rate(system: &dyn System, interface: &str, rate: u32) -> Rate {
    let phy = system.text(&format!("/sys/class/net/{interface}/phy80211/name"));
    let patched = phy.and_then(|phy| rate_file(system, &phy));
    // The module's rate is for all cards under iwldvm; other drivers' cards take theirs from radiotap.
    let driver = system.link(&format!("/sys/class/net/{interface}/device/driver"));
    let module = || (driver.as_deref() == Some("iwlwifi")).then(|| MODULE_RATE.to_string());
    let module = || module().filter(|path| system.text(path).is_some());
    let Some(path) = patched.or_else(module) else {
        let device = system.text(&format!("/sys/class/net/{interface}/device/device")).unwrap_or_default();
        let is_card = driver.as_deref() == Some("iwlwifi") && IWL5300.contains(&device.to_lowercase().as_str());
        return if is_card { Rate::Legacy(LOAD) } else { Rate::FromRadiotap };
    };
    let found = system.text(&path).unwrap_or_default();
    if u32::from_str_radix(found.trim_start_matches("0x"), 16) == Ok(rate) {
        return Rate::Right(rate);
    }
    match system.write(&path, &format!("{rate:#x}")) {
        Ok(()) => Rate::Set(rate, found),
        Err(error) => Rate::Other {
            found,
            error: format!("writing {path}: {error}"),
            mend: format!("echo {rate:#x} | sudo tee {path}"),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Tree;

    #[test]
    fn every_stream_has_an_antenna() {
        let rate = |mcs, antenna| rate_n_flags(Phy { mcs, bandwidth: Bandwidth::Ht20 }, antenna);
        assert_eq!(rate_n_flags(Phy { mcs: 0, bandwidth: Bandwidth::Ht40 }, Antenna::B), Some(0x8900));
        assert_eq!([rate(7, Antenna::C), rate(8, Antenna::A)], [Some(0x1_0107), Some(0xc108)]);
        assert_eq!([rate(15, Antenna::C), rate(16, Antenna::B)], [Some(0x1_410f), Some(0x1_c110)]);
        assert_eq!([rate(23, Antenna::A), rate(24, Antenna::A)], [Some(0x1_c117), None]);
    }

    #[test]
    fn the_driver_s_file_is_found_by_the_interface_and_set_once() {
        let root = std::env::temp_dir().join(format!("csi5300-rate-{}", std::process::id()));
        let files = [
            ("sys/class/net/mon0/phy80211/name", "phy3\n"),
            ("sys/kernel/debug/ieee80211/phy3/iwlwifi/iwldvm/debug/monitor_tx_rate", "0x0\n"),
            ("sys/class/net/mon1/phy80211/name", "phy4\n"),
            ("sys/class/net/mon2/phy80211/name", "phy5\n"),
            ("sys/class/net/mon2/device/device", "0x4235\n"),
            ("sys/module/csi5300/parameters/monitor_tx_rate", "0x4100\n"),
        ];
        for (path, text) in files {
            let path = root.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        std::os::unix::fs::symlink("../iwlwifi", root.join("sys/class/net/mon2/device/driver")).unwrap();
        let tree = Tree::new(root.clone());
        let phy = Phy { mcs: 1, bandwidth: Bandwidth::Ht20 };
        let rate = rate_n_flags(phy, Antenna::A).unwrap();
        assert_eq!(rate, 0x4101);
        assert_eq!(set_rate(&tree, "mon1", rate), Rate::FromRadiotap);
        assert_eq!(set_rate(&tree, "mon0", rate), Rate::Set(rate, "0x0".into()));
        assert_eq!(set_rate(&tree, "mon0", rate), Rate::Right(rate));
        // The stock driver with the module.
        assert_eq!(set_rate(&tree, "mon2", rate), Rate::Set(rate, "0x4100".into()));
        assert_eq!(set_rate(&tree, "mon2", rate), Rate::Right(rate));
        // And without it, which another Intel card does not need.
        std::fs::remove_file(root.join("sys/module/csi5300/parameters/monitor_tx_rate")).unwrap();
        assert_eq!(set_rate(&tree, "mon2", rate), Rate::Legacy(LOAD));
        std::fs::write(root.join("sys/class/net/mon2/device/device"), "0x2723\n").unwrap();
        assert_eq!(set_rate(&tree, "mon2", rate), Rate::FromRadiotap);
        std::fs::remove_dir_all(root).unwrap();
    }
}
