//! Puts the card into monitor mode for sounding, and back.

pub(crate) mod module;

use super::SetupError;
use super::card::Card;
use super::radio::rate_file;
use super::system::System;
use csi5300::signal::channel::{Channel, Width};

/// Rate of injected frames: HT, MCS 1, antenna A (csitool's injection notes: 0x4101; WSR's set-up: 0x4100, MCS 0).
const RATE: [(Driver, &str); 3] = [(Driver::Stock, "0x4101"), (Driver::Wsr, "0x4100"), (Driver::Module, "0x4101")];
/// Bit of a rate that makes it 40 MHz wide.
const RATE_HT40: u32 = 0x800;
/// `ack_len` with which the WSR driver answers nothing (its default).
const NEVER_ANSWER: u32 = 1_000_000;

/// Drivers that make the CSI records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Driver {
    /// csitool.
    Stock,
    /// WSR: it answers sounding frames of its own length (`ack_len`).
    Wsr,
    /// The distribution's driver and the module `csi5300` beside it (driver-iface/kmod).
    Module,
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
        /// The file; a pattern if earlier steps make it appear.
        path: String,
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
        }
    }

    /// Takes the step.
    ///
    /// # Errors
    /// What failed and how, unless that does not matter.
    pub fn take(&self, system: &dyn System) -> Result<(), SetupError> {
        let outcome = match &self.action {
            Action::Write { path, text } => match find_rate_file(system, path) {
                Some(path) => system.write(&path, text).map_err(|source| SetupError::Write { path, source }),
                None => Err(SetupError::NoRateFile { pattern: path.clone() }),
            },
            Action::Run(words) => match system.run(&words.iter().map(String::as_str).collect::<Vec<_>>()) {
                Some(ran) if ran.ok => Ok(()),
                Some(ran) => Err(SetupError::Command { command: words.join(" "), output: ran.text.trim().to_owned() }),
                None => Err(SetupError::NotInstalled { program: words.first().cloned().unwrap_or_default() }),
            },
        };
        if self.may_fail { Ok(()) } else { outcome }
    }
}

/// The pattern for the rate file of whichever phy the card gets.
const RATE_FILE: &str = "/sys/kernel/debug/ieee80211/phy*/iwlwifi/*/debug/monitor_tx_rate";

fn find_rate_file(system: &dyn System, path: &str) -> Option<String> {
    if path != RATE_FILE {
        return Some(path.to_string());
    }
    system.names("/sys/kernel/debug/ieee80211").iter().find_map(|phy| rate_file(system, phy))
}

/// The installed driver, by the parameters of the modules.
fn installed(system: &dyn System) -> Result<Driver, SetupError> {
    let loaded = |name: &str| system.text(&format!("/sys/module/iwlwifi/parameters/{name}")).is_some();
    let known = system.run(&["modinfo", "-p", "iwlwifi"]).map(|ran| ran.text).unwrap_or_default();
    let has = |name: &str| loaded(name) || known.lines().any(|line| line.starts_with(&format!("{name}:")));
    match (has("ack_len"), has("connector_log")) {
        (true, _) => Ok(Driver::Wsr),
        (false, true) => Ok(Driver::Stock),
        (false, false) if module::installed(system) => Ok(Driver::Module),
        (false, false) => Err(SetupError::NoCsiDriver),
    }
}

/// The steps from whatever state the card is in to sounding on the channel. Taking them twice changes nothing.
///
/// # Errors
/// If no CSI driver is installed, or a responder's `ack_len` is missing.
pub fn plan(system: &dyn System, request: &Request) -> Result<Vec<Step>, SetupError> {
    let driver = match request.driver {
        Some(driver) => driver,
        None => installed(system)?,
    };
    let interface = request.interface.as_str();
    let mut steps = hands_off(interface);
    match (driver, request.role, request.ack_len) {
        (Driver::Wsr, Role::Responder, None) => return Err(SetupError::NoAckLen),
        (Driver::Wsr, Role::Responder, Some(length)) => steps.extend(reload(system, Some(length))),
        (Driver::Wsr, Role::Initiator, _) => steps.extend(reload(system, Some(NEVER_ANSWER))),
        (Driver::Stock, _, _) => steps.extend(reload(system, None)),
        (Driver::Module, _, _) => {
            let firmware = module::firmware(system);
            if !firmware.is_empty() {
                steps.extend(firmware);
                steps.extend(without_parameters("the firmware is loaded with the driver"));
            }
            steps.extend(module::load(system, request));
        }
    }
    steps.extend(tune(interface, request.channel));
    // Answers are injected frames too, so both roles need an HT rate.
    let rate = RATE.iter().find(|(known, _)| *known == driver).map_or("0x4101", |(_, rate)| rate);
    let wide = u32::from_str_radix(rate.trim_start_matches("0x"), 16).unwrap_or(0x4101);
    let rate = if request.channel.width() != Width::Ht20 { format!("{:#x}", wide | RATE_HT40) } else { rate.into() };
    if driver != Driver::Module {
        let mount = ["mount", "-t", "debugfs", "none", "/sys/kernel/debug"];
        steps.push(Step::run("the rate file is in debugfs", &mount).may_fail());
    }
    let path = if driver == Driver::Module { module::RATE } else { RATE_FILE };
    steps.push(Step {
        why: "frames must be HT to carry CSI",
        action: Action::Write { path: path.into(), text: rate },
        may_fail: false,
    });
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
        let text = system.text(&format!("/sys/module/iwlwifi/parameters/{name}")).unwrap_or_default();
        let value = text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |hex| u32::from_str_radix(hex, 16).ok());
        value == Some(wanted)
    };
    if is("connector_log", 1) && ack_len.is_none_or(|length| is("ack_len", length)) {
        return Vec::new();
    }
    let mut load = vec!["modprobe".to_string(), "iwlwifi".into(), "connector_log=0x1".into()];
    load.extend(ack_len.map(|length| format!("ack_len={length}")));
    vec![
        Step::run("the driver takes its parameters when it is loaded", &["modprobe", "-r", "iwldvm", "iwlwifi"])
            .may_fail(),
        Step { why: "CSI to the connector", action: Action::Run(load), may_fail: false },
        Step::run("the interface comes up a moment after the module", &["udevadm", "settle", "--timeout=10"])
            .may_fail(),
    ]
}

/// Reloads the driver.
fn without_parameters(why: &'static str) -> [Step; 3] {
    [
        Step::run(why, &["modprobe", "-r", "iwldvm", "iwlwifi"]).may_fail(),
        Step::run(why, &["modprobe", "iwlwifi"]),
        Step::run("the interface comes up a moment after the module", &["udevadm", "settle", "--timeout=10"])
            .may_fail(),
    ]
}

/// Problems on this machine that no step can repair, in words.
#[must_use]
pub fn warnings(system: &dyn System, request: &Request) -> Vec<String> {
    module::warnings(system, request.driver.or_else(|| installed(system).ok()))
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
    let (module, firmware) = module::undo(system);
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
pub fn default_interface(system: &dyn System) -> Result<String, SetupError> {
    let card = Card::find(system).ok_or(SetupError::NoCard)?;
    card.interfaces.into_iter().next().ok_or(SetupError::NoInterface)
}
