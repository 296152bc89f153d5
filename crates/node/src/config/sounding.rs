//! A robot's part in the sounding exchange, as the file says it.

use super::Capture;
use super::{Config, hundred, positive};
use std::path::PathBuf;

/// A robot's part in the sounding exchange, in the native dialect, as `csi5300 sound` and `respond` have it (feature
/// `live`). The peers are those of the file; what is not said to be this robot's own is the same on all robots.
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

impl Config {
    pub(super) fn sounding_problem(&self) -> Option<String> {
        let asked = self.sounding.as_ref()?;
        match (self.capture.get_ref(), &asked.interface) {
            (Capture::Card(_), Some(_)) | (Capture::Served(_), None) => {}
            (Capture::Card(_), None) => return Some("[sounding]: `interface`, a monitor interface, is missing".into()),
            (Capture::Served(_), Some(_)) => {
                return Some("[sounding]: a served room is the air itself: leave `interface` out".into());
            }
            (Capture::Replay(_) | Capture::Room(_), _) => {
                let why = "[sounding] is done with a card: it needs `capture.card` or `capture.served`";
                return Some(why.into());
            }
        }
        if self.peer.is_empty() {
            return Some("[sounding] needs a [[peer]] to sound".into());
        }
        if let Some(key) = asked.key.as_ref().filter(|key| !key.is_file()) {
            return Some(format!("there is no key {}", key.display()));
        }
        let is_40_mhz = self.channel.width() != csi5300::signal::channel::Width::Ht20;
        crate::sounder::problem(asked, self.peer.len(), is_40_mhz).map(|why| format!("[sounding]: {why}"))
    }
}

fn yes() -> bool {
    true
}

fn mcs_1() -> u8 {
    1
}

fn guard_us() -> u32 {
    csi5300::exchange::tdma::GUARD_US
}

fn turn_around_us() -> u32 {
    csi5300::exchange::tdma::TURN_AROUND_US
}
