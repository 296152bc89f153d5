//! Puts the card into monitor mode for sounding, and back: the patched drivers, or the stock driver with `csi5300.ko` beside
//! it (driver-iface/kmod), whose firmware and module have steps of their own.

use super::System;
use super::card::{Card, FIRMWARE, FIRMWARE_BYTES, number, secure_boot_is_on, wins};
use super::host::rate_file;
use csi5300::signal::channel::{Channel, Width};

/// Bit of a rate that makes it 40 MHz wide.
const RATE_HT40: u32 = 0x800;
/// `ack_len` with which the WSR driver answers nothing (its default).
const NEVER_ANSWER: u32 = 1_000_000;

/// Drivers that make the CSI records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// csitool.
    Stock,
    /// WSR: it answers sounding frames of its own length (`ack_len`).
    Wsr,
    /// The distribution's driver and the module `csi5300` beside it (driver-iface/kmod).
    Module,
}

impl Driver {
    /// Rate of injected frames: HT, MCS 1, antenna A (csitool's injection notes: 0x4101; WSR's set-up: 0x4100, MCS 0).
    fn rate(self) -> u32 {
        if self == Self::Wsr { 0x4100 } else { 0x4101 }
    }
}

/// The robot's role in a sounding round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Sends the forward frames.
    Initiator,
    /// Answers them.
    Responder,
}

/// The requested set-up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The card's interface.
    pub interface: String,
    /// The channel.
    pub channel: Channel,
    /// Initiator or responder.
    pub role: Role,
    /// The driver; by default found by its parameters.
    pub driver: Option<Driver>,
    /// Length of the frames that this robot answers in the kernel, frame check sequence included (WSR driver or module,
    /// responder): 57, 59 ...
    pub ack_len: Option<u32>,
}

/// What a step does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Runs a program.
    Run(Vec<String>),
    /// Writes a file.
    Write {
        /// The file.
        path: String,
        /// What is written.
        text: String,
    },
    /// Writes the rate file of an interface's card, which earlier steps make appear.
    WriteRate {
        /// The interface.
        interface: String,
        /// What is written.
        text: String,
    },
}

/// One step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    /// Why it is taken.
    pub why: &'static str,
    /// What it does.
    pub action: Action,
    /// True if a failure does not matter, because its object may be absent.
    pub may_fail: bool,
}

impl Step {
    fn run(why: &'static str, words: &[&str]) -> Self {
        Self { why, action: Action::Run(words.iter().map(ToString::to_string).collect()), may_fail: false }
    }

    fn may_fail(mut self) -> Self {
        self.may_fail = true;
        self
    }

    /// The step as a line for a shell.
    #[must_use]
    pub fn line(&self) -> String {
        match &self.action {
            Action::Run(words) => format!("sudo {}", words.join(" ")),
            Action::Write { path, text } => format!("echo {text} | sudo tee {path}"),
            // Only root's shell can look for names in debugfs. The file's depth differs between kernels.
            Action::WriteRate { interface, text } => {
                let phy = format!("$(cat /sys/class/net/{interface}/phy80211/name)");
                let file = format!("$(find /sys/kernel/debug/ieee80211/{phy}/iwlwifi -name monitor_tx_rate)");
                format!("sudo sh -c 'echo {text} > \"{file}\"'")
            }
        }
    }

    /// Takes the step.
    ///
    /// # Errors
    /// What failed and how, unless that does not matter.
    pub fn take(&self, system: &dyn System) -> Result<(), String> {
        let write =
            |path: &str, text: &str| system.write(path, text).map_err(|error| format!("writing {path}: {error}"));
        let outcome = match &self.action {
            Action::Write { path, text } => write(path, text),
            Action::WriteRate { interface, text } => {
                let phy = system.text(&format!("/sys/class/net/{interface}/phy80211/name"));
                match phy.and_then(|phy| rate_file(system, &phy)) {
                    Some(path) => write(&path, text),
                    None => Err(format!(
                        "{interface} has no monitor_tx_rate in /sys/kernel/debug: is debugfs mounted, and its driver a CSI \
                         driver?"
                    )),
                }
            }
            Action::Run(words) => match system.run(&words.iter().map(String::as_str).collect::<Vec<_>>()) {
                Some(ran) if ran.ok => Ok(()),
                Some(ran) => Err(format!("{}: {}", words.join(" "), ran.text.trim())),
                None => Err(format!("{} is not installed", words.first().map_or("", String::as_str))),
            },
        };
        if self.may_fail { Ok(()) } else { outcome }
    }
}

/// The installed driver, by the parameters of the modules.
fn installed(system: &dyn System) -> Result<Driver, String> {
    let loaded = |name: &str| system.text(&format!("/sys/module/iwlwifi/parameters/{name}")).is_some();
    let known = system.run(&["modinfo", "-p", "iwlwifi"]).map(|ran| ran.text).unwrap_or_default();
    let has = |name: &str| loaded(name) || known.lines().any(|line| line.starts_with(&format!("{name}:")));
    match (has("ack_len"), has("connector_log")) {
        (true, _) => Ok(Driver::Wsr),
        (false, true) => Ok(Driver::Stock),
        (false, false) if module_installed(system) => Ok(Driver::Module),
        (false, false) => Err(
            "iwlwifi has no connector_log: it is not a CSI driver. With the distribution's driver: install the module csi5300 \
             (packaging/dkms) and use --driver module (details: `csi5300 doctor`)"
                .into(),
        ),
    }
}

/// The steps from whatever state the card is in to sounding on the channel. Taking them twice changes nothing.
///
/// # Errors
/// If no CSI driver is installed, or `ack_len` is missing or would be ignored.
pub fn plan(system: &dyn System, request: &Request) -> Result<Vec<Step>, String> {
    let driver = match request.driver {
        Some(driver) => driver,
        None => installed(system)?,
    };
    let interface = request.interface.as_str();
    let mut steps = hands_off(interface);
    match (driver, request.role, request.ack_len) {
        (Driver::Wsr, Role::Responder, None) => {
            let why = "a responder with the WSR driver needs --ack-len, the length of the frames meant for it (57 for the first \
                       robot, 59 for the second ...)";
            return Err(why.into());
        }
        (Driver::Wsr | Driver::Module, Role::Initiator, Some(_)) | (Driver::Stock, _, Some(_)) => {
            let why = "an initiator, and a robot with csitool's driver, answers no frames by their length: leave out --ack-len";
            return Err(why.into());
        }
        (Driver::Wsr, Role::Responder, Some(length)) => steps.extend(reload(system, Some(length))),
        (Driver::Wsr, Role::Initiator, None) => steps.extend(reload(system, Some(NEVER_ANSWER))),
        (Driver::Stock, _, _) => steps.extend(reload(system, None)),
        (Driver::Module, _, _) => {
            let firmware = place_firmware(system);
            if !firmware.is_empty() {
                steps.extend(firmware);
                steps.extend(without_parameters("the firmware is loaded with the driver"));
            }
            steps.extend(load_module(system, request));
        }
    }
    steps.extend(tune(interface, request.channel));
    // Answers are injected frames too, so both roles need an HT rate.
    let width = if request.channel.width() == Width::Ht20 { 0 } else { RATE_HT40 };
    let text = format!("{:#x}", driver.rate() | width);
    let action = if driver == Driver::Module {
        Action::Write { path: MODULE_RATE.into(), text }
    } else {
        let mount = ["mount", "-t", "debugfs", "none", "/sys/kernel/debug"];
        steps.push(Step::run("the rate file is in debugfs", &mount).may_fail());
        Action::WriteRate { interface: interface.into(), text }
    };
    steps.push(Step { why: "frames must be HT to carry CSI", action, may_fail: false });
    Ok(steps)
}

/// Other programs let go of the card.
fn hands_off(interface: &str) -> Vec<Step> {
    vec![
        Step::run("NetworkManager must not touch it", &["nmcli", "device", "set", interface, "managed", "no"])
            .may_fail(),
        Step::run("the radio must be on", &["rfkill", "unblock", "wifi"]).may_fail(),
    ]
}

/// The driver with its parameters, unless it already runs with them.
fn reload(system: &dyn System, ack_len: Option<u32>) -> Vec<Step> {
    let is = |name: &str, wanted: u32| {
        let text = system.text(&format!("/sys/module/iwlwifi/parameters/{name}"));
        text.and_then(|text| number(&text)) == Some(wanted)
    };
    // csitool's records name their sender and its number only by the frames (0x4).
    let log = if ack_len.is_some() { 0x1 } else { 0x5 };
    if is("connector_log", log) && ack_len.is_none_or(|length| is("ack_len", length)) {
        return Vec::new();
    }
    let mut load = vec!["modprobe".to_string(), "iwlwifi".into(), format!("connector_log={log:#x}")];
    load.extend(ack_len.map(|length| format!("ack_len={length}")));
    let load = Step { why: "CSI to the connector", action: Action::Run(load), may_fail: false };
    loaded_again("the driver takes its parameters when it is loaded", load).into()
}

/// The driver without parameters.
fn without_parameters(why: &'static str) -> [Step; 3] {
    loaded_again(why, Step::run(why, &["modprobe", "iwlwifi"]))
}

fn loaded_again(why: &'static str, load: Step) -> [Step; 3] {
    let settle = ["udevadm", "settle", "--timeout=10"];
    [
        Step::run(why, &["modprobe", "-r", "iwldvm", "iwlwifi"]).may_fail(),
        load,
        Step::run("the interface comes up a moment after the module", &settle).may_fail(),
    ]
}

/// Monitor mode and channel. The interface is down for the mode and up for the channel (newer kernels return -16
/// otherwise).
fn tune(interface: &str, channel: Channel) -> Vec<Step> {
    let number = channel.number().to_string();
    let width = match channel.width() {
        Width::Ht20 => "HT20",
        Width::Ht40Plus => "HT40+",
        Width::Ht40Minus => "HT40-",
    };
    vec![
        Step::run("the mode changes while it is down", &["ip", "link", "set", interface, "down"]),
        Step::run("monitor mode", &["iw", "dev", interface, "set", "type", "monitor"]),
        Step::run("up before the channel", &["ip", "link", "set", interface, "up"]),
        Step::run("the channel", &["iw", "dev", interface, "set", "channel", &number, width]),
    ]
}

/// The steps back to an ordinary WiFi card.
#[must_use]
pub fn undo(system: &dyn System, interface: &str) -> Vec<Step> {
    let mut steps = vec![
        Step::run("the mode changes while it is down", &["ip", "link", "set", interface, "down"]).may_fail(),
        Step::run("managed mode", &["iw", "dev", interface, "set", "type", "managed"]).may_fail(),
    ];
    let (module, firmware) = undo_module(system);
    steps.extend(module);
    let rate_written = system.names("/sys/kernel/debug/ieee80211").iter().any(|phy| rate_file(system, phy).is_some());
    let logging = system.text("/sys/module/iwlwifi/parameters/connector_log").is_some_and(|log| log != "0");
    if rate_written || logging || !firmware.is_empty() {
        steps.extend(firmware);
        steps.extend(without_parameters("without parameters"));
    }
    steps
        .push(Step::run("back to NetworkManager", &["nmcli", "device", "set", interface, "managed", "yes"]).may_fail());
    steps
}

/// The interface of the card, when none is named.
///
/// # Errors
/// When there is no card, or it has no interface.
pub fn default_interface(system: &dyn System) -> Result<String, String> {
    let card = Card::find(system).ok_or("no Intel 5300 on the PCI bus (details: `csi5300 doctor`)")?;
    let interface = card.interfaces.into_iter().next();
    interface.ok_or_else(|| "the card has no interface: name one with --interface".into())
}

/// A hash of the sources of the module that is loaded.
const BUILD: &str = "/sys/module/csi5300/srcversion";
/// The module's parameters.
const MODULE_PARAMETERS: &str = "/sys/module/csi5300/parameters";
/// The module's rate of sounding frames.
pub(crate) const MODULE_RATE: &str = "/sys/module/csi5300/parameters/monitor_tx_rate";
const FOLDER: &str = "/lib/firmware";
/// csitool's firmware under the name that it is published under.
const PUBLISHED: &str = "iwlwifi-5000-2.ucode.sigcomm2010";
/// What is appended to the name of a firmware that is moved aside, so that [`undo`] finds it.
pub(super) const ASIDE: &str = ".csi5300-aside";

/// True if the module is loaded, or can be.
fn module_installed(system: &dyn System) -> bool {
    let known =
        || system.run(&["modinfo", "-F", "license", "csi5300"]).is_some_and(|ran| ran.ok && !ran.text.is_empty());
    system.text(&format!("{MODULE_PARAMETERS}/layout")).is_some() || known()
}

/// Puts csitool's firmware where the driver finds it, and moves preferred ones away. If the file is not on this
/// machine, the user must copy it, as the doctor reports.
fn place_firmware(system: &dyn System) -> Vec<Step> {
    let at = |name: &str| format!("{FOLDER}/{name}");
    let aside =
        |name: &str| Step::run("kept, but out of the driver's way", &["mv", &at(name), &at(&format!("{name}{ASIDE}"))]);
    let mut steps: Vec<_> = system.names(FOLDER).iter().filter(|name| wins(name)).map(|name| aside(name)).collect();
    if system.size(FIRMWARE) == Some(FIRMWARE_BYTES) || system.size(&at(PUBLISHED)) != Some(FIRMWARE_BYTES) {
        return steps;
    }
    if system.size(FIRMWARE).is_some() {
        steps.push(aside("iwlwifi-5000-2.ucode"));
    }
    steps.push(Step::run("the firmware that sends CSI", &["ln", "-s", PUBLISHED, FIRMWARE]));
    steps
}

/// True if the loaded module was built from other sources than the one on this disk, as after an update.
fn is_another_build(system: &dyn System) -> bool {
    let on_disk = system.run(&["modinfo", "-F", "srcversion", "csi5300"]).filter(|ran| ran.ok);
    let on_disk = on_disk.map(|ran| ran.text.trim().to_owned()).filter(|build| !build.is_empty());
    on_disk.is_some_and(|build| system.text(BUILD).unwrap_or_default().trim() != build)
}

/// The module with its parameters, unless it already runs with them and is the one on the disk.
fn load_module(system: &dyn System, request: &Request) -> Vec<Step> {
    let text = |name: &str| system.text(&format!("{MODULE_PARAMETERS}/{name}")).unwrap_or_default();
    let answered = request.ack_len.unwrap_or(0).to_string();
    // Records of the WSR layout name the sender themselves; those of the stock layout need the frame before them.
    let (layout, log) = if request.ack_len.is_some() { ("wsr", "1") } else { ("stock", "5") };
    let first_of = |names: String| names.split(',').next().unwrap_or_default().to_string();
    let there = request.ack_len.is_none() || first_of(text("answer_on")) == request.interface;
    let is_loaded = system.text(&format!("{MODULE_PARAMETERS}/layout")).is_some();
    let another = is_loaded && is_another_build(system);
    if [text("layout"), text("connector_log"), text("ack_len")] == [layout, log, &answered] && there && !another {
        return Vec::new();
    }
    let why = match another {
        true => "the loaded csi5300 is another build than the one on this disk (srcversion)",
        false => "the module takes its parameters when it is loaded",
    };
    let mut words = vec!["modprobe", "csi5300"];
    let parameters = [
        format!("layout={layout}"),
        format!("connector_log={log}"),
        format!("ack_len={answered}"),
        format!("answer_on={}", request.interface),
    ];
    words.extend(parameters.iter().take(if request.ack_len.is_some() { 4 } else { 2 }).map(String::as_str));
    vec![Step::run(why, &["modprobe", "-r", "csi5300"]).may_fail(), Step::run("CSI to the connector", &words)]
}

/// The steps that remove the module, and those that restore the firmware.
fn undo_module(system: &dyn System) -> (Option<Step>, Vec<Step>) {
    let loaded = system.text(&format!("{MODULE_PARAMETERS}/layout")).is_some();
    let module = loaded.then(|| Step::run("without the module", &["modprobe", "-r", "csi5300"]));
    let moved: Vec<_> = system.names(FOLDER).into_iter().filter(|name| name.ends_with(ASIDE)).collect();
    let mut steps = Vec::new();
    if !moved.is_empty() && system.link(FIRMWARE).as_deref() == Some(PUBLISHED) {
        steps.push(Step::run("the link that the set-up made", &["rm", FIRMWARE]));
    }
    for name in moved {
        let (from, to) = (format!("{FOLDER}/{name}"), format!("{FOLDER}/{}", name.trim_end_matches(ASIDE)));
        steps.push(Step::run("the firmware that was there before", &["mv", &from, &to]));
    }
    (module, steps)
}

/// Problems on this machine that no step can repair, in words.
#[must_use]
pub fn warnings(system: &dyn System, request: &Request) -> Vec<String> {
    let driver = request.driver.or_else(|| installed(system).ok());
    let secure = secure_boot_is_on(system) == Some(true);
    let mut warnings = Vec::new();
    match driver {
        Some(Driver::Module) if secure => warnings.push(
            "Secure Boot is on: csi5300.ko loads only with the key of DKMS enrolled (`sudo mokutil --import \
             /var/lib/dkms/mok.pub`, on Ubuntu /var/lib/shim-signed/mok/MOK.der; reboot and confirm), or with Secure Boot \
             off",
        ),
        _ if secure => warnings.push("Secure Boot is on: it refuses a patched iwlwifi that is not signed"),
        _ => {}
    }
    if driver == Some(Driver::Module) && !module_installed(system) {
        warnings.push(
            "csi5300.ko is not installed: `sudo dpkg -i csi5300-dkms_*_all.deb` builds it for this kernel \
             (packaging/dkms/build.sh makes the package)",
        );
    }
    let published = format!("{FOLDER}/{PUBLISHED}");
    let sizes = [system.size(FIRMWARE), system.size(&published)];
    if driver == Some(Driver::Module) && !sizes.contains(&Some(FIRMWARE_BYTES)) {
        warnings.push(
            "csitool's firmware is not on this machine: copy iwlwifi-5000-2.ucode.sigcomm2010 (336,252 bytes, from csitool's \
             supplementary repository) to /lib/firmware first",
        );
    }
    warnings.into_iter().map(str::to_string).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Stage, place};
    use super::*;

    /// A machine with the module `csi5300` beside the distribution's driver.
    fn stage(name: &str) -> Stage {
        let stage = Stage::empty(&format!("module-{name}"));
        stage.put("run/modinfo -F license csi5300", "GPL\n");
        stage.put("run/modinfo -p iwlwifi", "swcrypto:software crypto (int)\n");
        stage
    }

    /// csitool's firmware under the name that it is published under, and as the one that the driver loads.
    fn put_firmware(stage: &Stage, is_linked: bool) {
        stage.put(&format!("lib/firmware/{PUBLISHED}"), &"x".repeat(FIRMWARE_BYTES as usize));
        if is_linked {
            std::os::unix::fs::symlink(PUBLISHED, stage.root.join("lib/firmware/iwlwifi-5000-2.ucode")).unwrap();
        }
    }

    fn lines(stage: &Stage, ack_len: Option<u32>) -> Vec<String> {
        plan(&stage.tree(), &request(ack_len)).unwrap().iter().map(Step::line).collect()
    }

    fn request(ack_len: Option<u32>) -> Request {
        let (interface, channel) = ("wlp1s0".to_string(), "60+".parse().unwrap());
        Request { interface, channel, role: Role::Responder, driver: None, ack_len }
    }

    #[test]
    fn a_fresh_system_gets_firmware_module_and_rate() {
        let stage = stage("fresh");
        stage.put("lib/firmware/iwlwifi-5000-2.ucode", "the distribution's");
        stage.put("lib/firmware/iwlwifi-5000-5.ucode.zst", "newer");
        stage.put("lib/firmware/iwlwifi-5150-2.ucode", "another card's");
        put_firmware(&stage, false);
        let lines = lines(&stage, None);
        let at = |words: &str| place(&lines, words);
        let (newer, own) =
            (at("mv /lib/firmware/iwlwifi-5000-5.ucode.zst"), at("mv /lib/firmware/iwlwifi-5000-2.ucode "));
        let link = at("ln -s iwlwifi-5000-2.ucode.sigcomm2010 /lib/firmware/iwlwifi-5000-2.ucode");
        assert!(newer < link && own < link && link < at("modprobe -r iwldvm iwlwifi"));
        assert!(at("modprobe iwlwifi") < at("modprobe csi5300 layout=stock connector_log=5"));
        assert!(at("modprobe csi5300") < at("set type monitor"));
        assert!(!lines.iter().any(|line| line.contains("5150") || line.contains("debugfs")), "{lines:?}");
        assert_eq!(lines.last().unwrap(), &format!("echo 0x4901 | sudo tee {MODULE_RATE}"));
        assert!(warnings(&stage.tree(), &request(None)).is_empty());
    }

    #[test]
    fn a_correct_set_up_is_kept_and_can_be_undone() {
        let stage = stage("running");
        stage.put("lib/firmware/iwlwifi-5000-5.ucode.csi5300-aside", "newer");
        put_firmware(&stage, true);
        for (name, value) in
            [("layout", "wsr"), ("connector_log", "1"), ("ack_len", "59"), ("answer_on", "wlp1s0,(null)")]
        {
            stage.put(&format!("sys/module/csi5300/parameters/{name}"), value);
        }
        assert!(!lines(&stage, Some(59)).iter().any(|line| line.contains("modprobe") || line.contains("firmware")));
        let other = lines(&stage, Some(57));
        let wanted = "sudo modprobe csi5300 layout=wsr connector_log=1 ack_len=57 answer_on=wlp1s0";
        assert!(other.iter().any(|line| line == wanted), "{other:?}");
        let initiator = Request { role: Role::Initiator, ..request(Some(57)) };
        assert!(plan(&stage.tree(), &initiator).unwrap_err().contains("leave out --ack-len"));
        let undone: Vec<_> = undo(&stage.tree(), "wlp1s0").iter().map(Step::line).collect();
        let at = |words: &str| place(&undone, words);
        assert!(at("modprobe -r csi5300") < at("rm /lib/firmware/iwlwifi-5000-2.ucode"));
        assert!(
            at("rm ") < at("mv /lib/firmware/iwlwifi-5000-5.ucode.csi5300-aside /lib/firmware/iwlwifi-5000-5.ucode")
        );
        assert!(at("mv ") < at("modprobe iwlwifi"));
    }

    #[test]
    fn the_printed_step_finds_the_rate_file_wherever_a_kernel_has_it() {
        for place in ["debug", "iwldvm/debug", "iwldvm", "."] {
            let stage = stage("rate");
            let file = format!("sys/kernel/debug/ieee80211/phy0/iwlwifi/{place}/monitor_tx_rate");
            stage.put("sys/class/net/mon0/phy80211/name", "phy0\n");
            stage.put(&file, "0x0\n");
            let action = Action::WriteRate { interface: "mon0".into(), text: "0x4101".into() };
            let line = Step { why: "", action, may_fail: false }.line();
            let here = line.trim_start_matches("sudo ").replace("/sys/", &format!("{}/sys/", stage.root.display()));
            assert!(std::process::Command::new("sh").args(["-c", &here]).status().unwrap().success(), "{here}");
            assert_eq!(stage.tree().text(&file).as_deref(), Some("0x4101"), "{line}");
        }
    }

    #[test]
    fn another_build_than_the_one_on_disk_is_reloaded() {
        let stage = stage("build");
        put_firmware(&stage, true);
        for (name, value) in [("layout", "stock"), ("connector_log", "5"), ("ack_len", "0")] {
            stage.put(&format!("sys/module/csi5300/parameters/{name}"), value);
        }
        let load = || load_module(&stage.tree(), &request(None));
        assert!(load().is_empty(), "nothing says which builds they are");
        stage.put("run/modinfo -F srcversion csi5300", "0123456789ABCDEF01234AB\n");
        for (loaded, steps) in
            [(None, 2), (Some("FFFFFFFFFFFFFFFFFFFFFFF\n"), 2), (Some("0123456789ABCDEF01234AB\n"), 0)]
        {
            loaded.iter().for_each(|build| stage.put(BUILD.trim_start_matches('/'), build));
            let planned = load();
            assert_eq!(planned.len(), steps, "{loaded:?}");
            assert!(
                planned
                    .iter()
                    .take(1)
                    .all(|step| step.why.contains("another build") && step.line().contains("-r csi5300"))
            );
        }
    }

    #[test]
    fn problems_without_a_step_are_reported() {
        let stage = stage("warned");
        stage.put("sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c", "\u{6}\0\0\0\u{1}");
        stage.remove("run/modinfo -F license csi5300");
        let request = Request { driver: Some(Driver::Module), ..request(None) };
        let said = warnings(&stage.tree(), &request);
        assert_eq!(said.len(), 3, "{said:?}");
        assert!(said[0].contains("mokutil") && said[1].contains("dpkg -i") && said[2].contains("336,252"), "{said:?}");
    }
}
