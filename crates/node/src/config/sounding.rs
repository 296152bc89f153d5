//! A robot's part in the sounding exchange, from the file.

use super::values::{hundred, positive};
use super::{Capture, Config, Records};
use csi5300::exchange::tdma::{Dialect, Phy, Plan, PlanError, Request};
use csi5300::signal::channel::Width;
use csi5300_live::sounding::rate_n_flags;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use std::path::PathBuf;

/// A robot's part in the sounding exchange, in the native dialect, as `csi5300 sound` has it (feature `live`). The
/// peers are those of the file; fields not marked as this robot's own must be equal on all robots.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sounding {
    /// Monitor interface; none in a served room, whose air it is.
    #[serde(default)]
    pub interface: Option<String>,
    /// This robot initiates, in turns with the others that do; otherwise it only answers. Its own.
    #[serde(default = "yes")]
    pub initiate: bool,
    /// Rounds a second: one exchange with every peer each.
    #[serde(default = "hundred", deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Links in a round; as many as there are peers where absent.
    #[serde(default)]
    pub links: Option<u16>,
    /// Modulation of every frame, 0 to 23.
    #[serde(default = "mcs_1")]
    pub mcs: u8,
    /// How late a frame may be sent, microseconds.
    #[serde(default = "guard_us")]
    pub guard_us: u32,
    /// How long after a forward frame its answer may begin, microseconds.
    #[serde(default = "turn_around_us")]
    pub turn_around_us: u32,
    /// Answers carry what the card measured.
    #[serde(default = "yes")]
    pub measurement: bool,
    /// File with a key that all robots share.
    #[serde(default)]
    pub key: Option<PathBuf>,
    /// Ask for SCHED_FIFO. Its own.
    #[serde(default = "yes")]
    pub fifo: bool,
}

impl Sounding {
    /// The request for this number of peers.
    #[must_use]
    pub fn request(&self, peers: usize, bandwidth: Bandwidth) -> Request {
        let links = self.links.unwrap_or(u16::try_from(peers).unwrap_or(u16::MAX));
        Request {
            phy: Phy { mcs: self.mcs, bandwidth },
            dialect: Dialect::Native { measurement: self.measurement, authenticated: self.key.is_some() },
            guard_us: self.guard_us,
            turn_around_us: self.turn_around_us,
            ..Request::new(links, self.rate_hz)
        }
    }
}

impl Config {
    /// The request of the sounding exchange, if this robot takes part.
    #[must_use]
    pub fn sounding_request(&self) -> Option<Request> {
        let is_20_mhz = self.channel.width() == Width::Ht20;
        let bandwidth = if is_20_mhz { Bandwidth::Ht20 } else { Bandwidth::Ht40 };
        let peers = self.peer.iter().filter(|peer| !matches!(peer.get_ref().records, Records::Heard(_))).count();
        Some(self.sounding.as_ref()?.request(peers, bandwidth))
    }

    /// Why this robot cannot take part as asked: the key in `[sounding]`, if it is one, and the reason.
    pub(super) fn wrong_sounding(&self) -> Option<(Option<&'static str>, String)> {
        let asked = self.sounding.as_ref()?;
        let table = |why: &str| Some((None, why.to_owned()));
        match (self.capture.get_ref(), &asked.interface) {
            (Capture::Card(_) | Capture::Stock(_), Some(_)) | (Capture::Served(_), None) => {}
            (Capture::Card(_) | Capture::Stock(_), None) => {
                return table("[sounding]: `interface`, a monitor interface, is missing");
            }
            (Capture::Served(_), Some(_)) => {
                let why = "[sounding]: a served room is the air itself: leave `interface` out";
                return Some((Some("interface"), why.into()));
            }
            (Capture::Feitcsi(_) | Capture::Replay(_) | Capture::Room(_), _) => {
                return table(
                    "[sounding] is done with a card: it needs `capture.card`, `capture.stock` or `capture.served`",
                );
            }
        }
        if self.peer.iter().all(|peer| matches!(peer.get_ref().records, Records::Heard(_))) {
            return table("[sounding] needs a [[peer]] to sound");
        }
        if let Some(key) = asked.key.as_ref().filter(|key| !key.is_file()) {
            return Some((Some("key"), format!("there is no key {}", key.display())));
        }
        wrong_plan(&self.sounding_request()?).map(|(key, why)| (key, format!("[sounding]: {why}")))
    }
}

/// Why there is no plan for a request: the key that is wrong, if it is one, and the reason.
fn wrong_plan(request: &Request) -> Option<(Option<&'static str>, String)> {
    if rate_n_flags(request.phy, Antenna::A).is_none() {
        let mcs = request.phy.mcs;
        let why = format!("mcs {mcs} has more streams than the card has antennas: 23 is the highest");
        return Some((Some("mcs"), why));
    }
    let error = Plan::new(request).err()?;
    let key = match error {
        PlanError::Rate { .. } | PlanError::NotARate(_) => Some("rate_hz"),
        PlanError::Links(_) => Some("links"),
        PlanError::Mcs(_) => Some("mcs"),
        _ => None,
    };
    Some((key, error.to_string()))
}

fn yes() -> bool {
    true
}

fn mcs_1() -> u8 {
    1
}

fn guard_us() -> u32 {
    csi5300::exchange::tdma::Request::default().guard_us
}

fn turn_around_us() -> u32 {
    csi5300::exchange::tdma::Request::default().turn_around_us
}
