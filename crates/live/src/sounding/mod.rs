//! Sounding, live: the scheduler's state machine ([`csi5300::exchange::tdma`]) on a monitor interface, in a thread of its own.
//!
//! * [`Exchange`] is one robot's side: frames from the air into the machine, frames from the machine into the air, and
//!   figures of what that took. It has no clock of its own.
//! * [`Setup`] opens one: interface, plan, key, session.
//! * [`Running`] is its thread, under SCHED_FIFO and in locked memory if allowed. It waits for frames and absolute
//!   deadlines; estimates cannot delay a slot.
//! * [`Session`] is a complete run with the driver's messages; an [`Observer`] gets records and news, and [`Finished`]
//!   has the result.
//! * [`products()`] takes the card's records and the measurements in the answers, for live bearings computed [`Beside`]
//!   the session.
//! * [`set_rate`] sets the rate of the CSI driver, which ignores radiotap's.

mod exchange;
mod products;
mod sessions;
mod thread;

pub use exchange::{Exchange, Figures, KERNEL_TURN_AROUND_US, News, Notice, Spread, spread_of};
pub use products::{Beside, Measuring, measurement, products};
pub use thread::{Running, Settings};

use crate::doctor::{IWL5300, MODULE_RATE, System, rate_file};
use crate::listener::Listener;
use crate::logged::Logged;
use crate::monitor::{self, AirCounts, Monitor};
use crate::refused;
use crate::wait::{Monotonic, wall_us};
use csi5300::exchange::tdma::{Config, Key, Phy, Request, Tdma, TdmaCounts};
use csi5300::source::recorder::Totals;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, rate};
use driver_iface::radiotap::Bandwidth;
use sessions::PeerSessions;
use std::os::fd::{AsFd, BorrowedFd};

/// Interval at which news are fetched and [`Observer::look`] is called.
const LOOK: Span = Span::from_ms(50);
/// Longest time to read the driver after the end.
const LAST_WORDS: Span = Span::from_ms(500);

/// A program's reactions. The default methods do nothing.
pub trait Observer {
    /// An item of the driver. The running exchange takes orders.
    fn record(&mut self, _next: &Next<'_>, _running: &Running) {}

    /// News of the sender's thread.
    fn news(&mut self, _news: &News) {}

    /// Called every 50 ms and after all available items.
    fn look(&mut self, _now: Instant, _running: &Running) {}
}

/// The end of a session, and its system settings.
#[derive(Clone, Copy, Debug)]
pub struct Session<'a> {
    /// Its clock.
    pub clock: Monotonic,
    /// It ends when this is readable: a signal's file descriptor, the reading end of a pipe.
    pub stop: BorrowedFd<'a>,
    /// Settings of the sender's thread. At [`Settings::stop_at`] that thread ends by itself, however long an [`Observer`]
    /// takes, and its end is the session's.
    pub settings: Settings,
}

/// The result of a session.
#[derive(Debug)]
pub struct Finished {
    /// The machine with its counts, the interface with its counters, and how punctual the host was.
    pub exchange: Exchange<Monitor>,
    /// Counts of the interface.
    pub air: AirCounts,
    /// News that were lost because they were not fetched in time.
    pub news_lost: u64,
    /// The log, where there was one.
    pub log: Option<LogTotals>,
    /// The error that ended the session, if any.
    pub error: Option<Error>,
}

impl<'a> Session<'a> {
    /// Sounds until it is stopped, the time is up, or the interface or the listener fails. `messages` are the card's records, if
    /// anybody listens to it.
    ///
    /// # Errors
    /// If it cannot be started, waited for or ended. A failure while it runs is in [`Finished::error`].
    pub fn run(
        &self,
        opened: Opened,
        mut messages: Option<Logged<Listener>>,
        observer: &mut dyn Observer,
    ) -> Result<Finished, Error> {
        let connector = messages.as_ref().map(|messages| messages.source().as_fd().try_clone_to_owned());
        let connector = connector.transpose().map_err(Error::io("what is listened to"))?;
        let running = Running::start(opened, self.clock, self.settings)?;
        let failed = loop {
            if let Err(error) = take(messages.as_mut(), self.clock.now(), &running, observer) {
                break Some(error);
            }
            while let Some(news) = running.news() {
                observer.news(&news);
            }
            let now = self.clock.now();
            observer.look(now, &running);
            if running.has_ended() || self.settings.stop_at.is_some_and(|end| end <= now) {
                break None;
            }
            let next_at = messages.as_ref().and_then(CsiSource::next_at);
            let until = [next_at, self.settings.stop_at, Some(now + LOOK)].into_iter().flatten().min();
            // Without a listener this waits for the stop twice.
            let first = connector.as_ref().map_or(self.stop, |fd| fd.as_fd());
            if self.clock.wait([first, self.stop], until)?[1] {
                break None;
            }
        };
        self.end(running, messages, failed, observer)
    }

    fn end(
        &self,
        running: Running,
        mut messages: Option<Logged<Listener>>,
        mut failed: Option<Error>,
        observer: &mut dyn Observer,
    ) -> Result<Finished, Error> {
        let (mut exchange, left, news_lost, error) = running.stop()?;
        left.iter().for_each(|news| observer.news(news));
        // Messages sent before the end belong in the log. A driver without pauses does not delay the end.
        let enough_at = self.clock.now() + LAST_WORDS;
        while let Some(recorded @ Logged::Recorded(_)) = &mut messages
            && failed.is_none()
            && self.clock.now() < enough_at
        {
            match recorded.receive(self.clock.now()) {
                Ok(Next::Pending | Next::End(_)) => break,
                Ok(_) => {}
                Err(error) => failed = Some(error),
            }
        }
        let ended = messages.map(|messages| messages.finish(self.clock.now())).transpose()?;
        let log = ended.and_then(|(listener, recorded)| {
            let lost = listener.lost();
            recorded.map(|recorded| LogTotals { recorded, dropped_before: lost.kernel + lost.driver })
        });
        Ok(Finished { air: exchange.air.counters(), exchange, news_lost, log, error: failed.or(error) })
    }
}

/// Takes everything that the driver has sent.
fn take(
    messages: Option<&mut Logged<Listener>>,
    now: Instant,
    running: &Running,
    observer: &mut dyn Observer,
) -> Result<(), Error> {
    let Some(messages) = messages else { return Ok(()) };
    loop {
        let next = messages.receive(now)?;
        if matches!(next, Next::Pending | Next::End(_)) {
            return Ok(());
        }
        observer.record(&next, running);
    }
}

impl Finished {
    /// Counts of the machine.
    #[must_use]
    pub fn counts(&self) -> &TdmaCounts {
        self.exchange.tdma.counts()
    }

    /// True if frames were not taken, records are not in the log, or something failed.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        self.air.not_taken() > 0 || self.error.is_some() || self.log.as_ref().is_some_and(|log| log.missing() > 0)
    }

    /// Frames that the machine sent: forward frames and answers.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.counts().forward + self.counts().replies
    }

    /// Of these, those that the kernel reports as failed.
    #[must_use]
    pub fn reported_failed(&self) -> u64 {
        self.air.tx_failed.min(self.sent())
    }

    /// Of these, those that the kernel reports as sent.
    #[must_use]
    pub fn confirmed(&self) -> u64 {
        self.air.tx_status.saturating_sub(self.air.tx_failed).min(self.sent())
    }
}

/// The result of a recorded log.
#[derive(Clone, Debug)]
pub struct LogTotals {
    /// What was recorded.
    pub recorded: Totals,
    /// Records that were lost before they were read.
    pub dropped_before: u64,
}

impl LogTotals {
    /// Records of the card that the log does not have.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.recorded.dropped + self.recorded.lost_on_disk + self.dropped_before
    }
}

/// The settings of an exchange.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Monitor interface; only a name for messages with [`Setup::open_on`].
    pub interface: String,
    /// This robot's MAC, instead of the interface's own.
    pub mac: Option<Mac>,
    /// All other robots.
    pub peers: Vec<Mac>,
    /// Rate, frames and timing: the same on every robot.
    pub request: Request,
    /// WSR dialect: this robot's index.
    pub own_index: u16,
    /// Key that all robots share.
    pub key: Option<Key>,
}

/// An exchange that can be started with [`Running::start`].
#[derive(Debug)]
pub struct Opened {
    /// The machine.
    pub tdma: Tdma,
    /// The interface.
    pub monitor: Monitor,
    /// This robot's MAC.
    pub own: Mac,
    /// The key that all robots share.
    pub key: Option<Key>,
    /// The peers' sessions, with a key.
    heard: PeerSessions,
    /// A warning about the session's number.
    pub warning: Option<String>,
}

impl Setup {
    /// The options of the interface.
    #[must_use]
    pub fn options(&self) -> monitor::Options {
        let (forward, backward) = self.request.dialect.longest(usize::from(self.request.links));
        let phy = self.request.phy;
        let options = monitor::Options::new(self.interface.clone(), forward.max(backward));
        monitor::Options { mcs: phy.mcs, bandwidth: phy.bandwidth, ..options }
    }

    /// Makes the machine on an interface that is open; `settle` may change its configuration.
    ///
    /// # Errors
    /// If it has no MAC, or the plan does not fit.
    pub fn open_on(&self, monitor: Monitor, settle: impl FnOnce(&mut Config)) -> Result<Opened, Error> {
        let nameless = || refused(format!("{} has no MAC of its own: name the one to use", self.interface));
        let own = self.mac.or(monitor.mac).ok_or_else(nameless)?;
        let (session, warning) = sessions::begin(own, wall_us());
        let mut config = self.config(own, session);
        let stranger = self.key.as_ref().and_then(|key| self.peers.iter().find(|peer| !key.has_pair(own, **peer)));
        if let Some(peer) = stranger {
            return Err(refused(format!(
                "the key file has no key of {own} with {peer}: make another with `csi5300 key robot`, all peers named"
            )));
        }
        let heard = if self.key.is_some() { PeerSessions::open(own) } else { PeerSessions::default() };
        config.heard = heard.peers();
        settle(&mut config);
        let tdma = Tdma::new(&config).map_err(|error| Error::Backend(Box::new(error)))?;
        Ok(Opened { tdma, monitor, own, key: self.key.clone(), heard, warning })
    }

    /// The machine's configuration: a robot that answers, and does not initiate.
    #[must_use]
    pub fn config(&self, own: Mac, session: u32) -> Config {
        Config { key: self.key.clone(), ..Config::new(own, self.own_index, &self.peers, self.request, session) }
    }
}

/// Antennas of the card.
const ANTENNAS: u32 = 3;

/// How to get an HT rate under the kernel's own driver.
const LOAD: &str = "load the module csi5300 (`csi5300 setup --driver module` says how)";

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
    let first = antenna as u32;
    let antennas = (first..first + streams).fold(0, |bits, k| bits | ANTENNA_A << (k % ANTENNAS));
    let width = match phy.bandwidth {
        Bandwidth::Ht20 => 0,
        Bandwidth::Ht40 => rate::HT40,
    };
    Some(antennas | u32::from(width | rate::HT) | u32::from(phy.mcs))
}

/// Sets the rate of a driver that ignores radiotap; says so if it was another.
///
/// # Errors
/// Why frames leave at another rate, and the remedy.
pub fn set_rate(system: &dyn System, interface: &str, rate: u32) -> Result<Option<String>, String> {
    let phy = system.text(&format!("/sys/class/net/{interface}/phy80211/name"));
    let patched = phy.and_then(|phy| rate_file(system, &phy));
    // The module's rate is for all cards under iwldvm; other drivers' cards take theirs from radiotap.
    let driver = system.link(&format!("/sys/class/net/{interface}/device/driver"));
    let is_intel = driver.as_deref() == Some("iwlwifi");
    let module = || (is_intel && system.text(MODULE_RATE).is_some()).then(|| MODULE_RATE.to_string());
    let Some(path) = patched.or_else(module) else {
        let device = system.text(&format!("/sys/class/net/{interface}/device/device")).unwrap_or_default();
        let is_card = is_intel && IWL5300.contains(&device.to_lowercase().as_str());
        // A driver without such a file takes the rate from radiotap, except the kernel's own for this card.
        let legacy = || format!("this driver sends injected frames at a legacy rate, which makes no CSI: {LOAD}");
        return if is_card { Err(legacy()) } else { Ok(None) };
    };
    let found = system.text(&path).unwrap_or_default();
    if u32::from_str_radix(found.trim_start_matches("0x"), 16) == Ok(rate) {
        return Ok(None);
    }
    match system.write(&path, &format!("{rate:#x}")) {
        Ok(()) => Ok(Some(format!("monitor_tx_rate set to {rate:#x} (was {found})"))),
        Err(error) => Err(format!(
            "monitor_tx_rate is {found}, so frames go out at another rate (writing {path}: {error}): echo {rate:#x} | sudo tee \
             {path}"
        )),
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
        let tree = Tree(root.clone());
        let phy = Phy { mcs: 1, bandwidth: Bandwidth::Ht20 };
        let rate = rate_n_flags(phy, Antenna::A).unwrap();
        assert_eq!(rate, 0x4101);
        let set = |before: &str| Ok(Some(format!("monitor_tx_rate set to 0x4101 (was {before})")));
        assert_eq!(set_rate(&tree, "mon1", rate), Ok(None));
        assert_eq!(set_rate(&tree, "mon0", rate), set("0x0"));
        assert_eq!(set_rate(&tree, "mon0", rate), Ok(None));
        // The stock driver with the module.
        assert_eq!(set_rate(&tree, "mon2", rate), set("0x4100"));
        assert_eq!(set_rate(&tree, "mon2", rate), Ok(None));
        // And without it, which another Intel card does not need.
        std::fs::remove_file(root.join("sys/module/csi5300/parameters/monitor_tx_rate")).unwrap();
        assert!(set_rate(&tree, "mon2", rate).unwrap_err().ends_with(LOAD));
        std::fs::write(root.join("sys/class/net/mon2/device/device"), "0x2723\n").unwrap();
        assert_eq!(set_rate(&tree, "mon2", rate), Ok(None));
        std::fs::remove_dir_all(root).unwrap();
    }

    /// Keeps what comes.
    #[derive(Default)]
    struct Kept {
        news: Vec<News>,
        looks: u32,
    }

    impl Observer for Kept {
        fn news(&mut self, news: &News) {
            self.news.push(news.clone());
        }

        fn look(&mut self, _: Instant, _: &Running) {
            self.looks += 1;
        }
    }

    /// A session on a socket, with what `stop_at` and `stopped` end it by.
    fn session(stopped: bool, stop_at: Option<Instant>) -> (Kept, Finished) {
        use nix::sys::socket::{AddressFamily, SockFlag, SockType, socketpair};
        let (ours, _theirs) =
            socketpair(AddressFamily::Unix, SockType::SeqPacket, None, SockFlag::SOCK_NONBLOCK).unwrap();
        let [own, peer] = [1, 2].map(|last| Mac([2, 0, 0, 0, 0, last]));
        let setup = Setup {
            interface: "a socket".into(),
            mac: Some(own),
            peers: vec![peer],
            request: Request::new(1, 100.0),
            own_index: 0,
            key: None,
        };
        let monitor = Monitor::over(ours, own, &setup.options()).unwrap();
        let tdma = Tdma::new(&setup.config(own, 1)).unwrap();
        let opened = Opened { tdma, monitor, own, key: None, heard: PeerSessions::default(), warning: None };
        let (stop, end) = std::io::pipe().unwrap();
        let end = Some(end).filter(|_| !stopped);
        let mut kept = Kept::default();
        let settings = Settings { fifo_priority: None, stop_at };
        let session = Session { clock: Monotonic::new(), stop: stop.as_fd(), settings };
        let finished = session.run(opened, None, &mut kept).unwrap();
        drop(end);
        (kept, finished)
    }

    #[test]
    fn a_session_ends_when_it_is_stopped_and_when_its_time_is_up() {
        for (kept, finished) in [session(true, None), session(false, Some(Instant::ZERO))] {
            assert!(matches!(kept.news[..], [News::Started(_), ..]), "{:?}", kept.news);
            assert!(kept.looks > 0 && finished.error.is_none() && finished.log.is_none());
            assert_eq!((finished.sent(), finished.confirmed(), finished.news_lost), (0, 0, 0));
            assert!(!finished.lost_anything());
        }
    }
}
