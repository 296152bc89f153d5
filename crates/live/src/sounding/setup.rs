//! Opens an exchange: interface, plan, key and session.

use super::peer_sessions::PeerSessions;
use super::{SoundingError, session};
use crate::monitor::{Monitor, Options};
use crate::wait::wall_us;
use csi5300::exchange::tdma::{Config, Key, Request, Tdma};
use csi5300::source::Error;
use driver_iface::Mac;
use std::path::Path;

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

/// An exchange that can be started with [`Running::start`](super::Running::start).
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
    pub(super) heard: PeerSessions,
    /// A warning about the session's number.
    pub warning: Option<String>,
}

impl Setup {
    /// The options of the interface.
    #[must_use]
    pub fn options(&self) -> Options {
        let (forward, backward) = self.request.dialect.longest(usize::from(self.request.links));
        let phy = self.request.phy;
        Options::new(self.interface.clone(), forward.max(backward)).with_rate(phy.mcs, phy.bandwidth)
    }

    /// Opens the interface and makes the machine; `settle` may change its configuration.
    ///
    /// # Errors
    /// If the interface cannot be opened or has no MAC, or the plan does not fit.
    pub fn open(&self, settle: impl FnOnce(&mut Config)) -> Result<Opened, Error> {
        self.open_on(Monitor::open(&self.options())?, settle)
    }

    /// As [`Setup::open`], on an interface that is open.
    ///
    /// # Errors
    /// If it has no MAC, or the plan does not fit.
    pub fn open_on(&self, monitor: Monitor, settle: impl FnOnce(&mut Config)) -> Result<Opened, Error> {
        let nameless = || SoundingError::NoMac { interface: self.interface.clone() };
        let own = self.mac.or(monitor.mac()).ok_or_else(nameless)?;
        let (session, warning) = session::begin(own, wall_us());
        let mut config = self.config(own, session);
        let stranger = self.key.as_ref().and_then(|key| self.peers.iter().find(|peer| !key.has_pair(own, **peer)));
        if let Some(peer) = stranger {
            return Err(SoundingError::NoKeyWith { own, peer: *peer }.into());
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

/// Reads a key: see [`csi5300::source::read_key`].
///
/// # Errors
/// If the file is refused.
pub fn read_key(path: &Path) -> Result<Key, Error> {
    csi5300::source::read_key(path).map_err(|error| Error::Backend(Box::new(error)))
}
