//! Live bearings: products of forward and backward frames while robots sound, with no second network.
//!
//! The initiator's card reports the backward frame; what the responder's card reported of the forward frame comes in a
//! later answer ([`driver_iface::sounding::native::Measurement`]). Both go into the library's live estimator, as a node's
//! records do.

use csi5300::exchange::tdma::Key;
use csi5300::internal::FrameHeard;
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::live::{Links, LiveEstimator, LivePeer, LiveSettings, Track};
use csi5300::pipeline::{Options, UnusedRecords};
use csi5300::source::Next;
use csi5300::source::survey::Identity;
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::sounding::native::Measurement;

/// One antenna's CSI of a forward frame, to be sent to its initiator; `None` without that antenna or a number.
#[must_use]
pub fn measurement(bfee: &Bfee<'_>, identity: &Identity, antenna: Antenna) -> Option<Measurement> {
    let heard = FrameHeard::of(bfee, antenna, identity.frame_count?, None, 0)?;
    Some(Measurement {
        number: heard.number,
        timestamp_low: heard.timestamp_low,
        rx_antenna: antenna as u8,
        antenna_sel: bfee.antenna_sel(),
        rssi: bfee.rssi(),
        noise_dbm: bfee.noise_dbm(),
        agc: bfee.agc(),
        iq: heard.iq(),
    })
}

/// The links of one initiator to peers that stand still.
pub struct Products {
    estimator: LiveEstimator,
}

impl Products {
    /// Links to `peers`.
    #[must_use]
    pub fn new(peers: &[Mac], options: Options) -> Self {
        let still = || Track::still(Vector3::zeros(), 0.0);
        let peer = |mac: &Mac| LivePeer { name: mac.to_string(), mac: *mac, track: still(), yaw_rad: 0.0 };
        let peers = peers.iter().map(peer).collect();
        // It gives bearings on request, without a schedule, and has no peer's log that shows this robot's MAC.
        let (own, now) = (Mac::ZERO, Instant::ZERO);
        let settings = LiveSettings::new(options.channel.wavelength_m());
        Self { estimator: LiveEstimator::new(own, Track::default(), peers, settings, options, now) }
    }

    /// The same, where robots share a key: only exchanges that are [confirmed](Self::confirmed) are used.
    #[must_use]
    pub fn with_key(mut self, key: Option<&Key>) -> Self {
        if let Some(key) = key {
            self.estimator.require_key(key);
        }
        self
    }

    /// The scheduler has seen the answer of this number, its tag valid.
    pub fn confirmed(&mut self, peer: Mac, number: u32, now: Instant) {
        self.estimator.handle_confirmed(peer, number, now);
    }

    /// Numbers with two records, of all peers: somebody answers in a peer's name. Neither is used.
    #[must_use]
    pub fn contested(&self) -> u64 {
        self.estimator.peers().map(|(_, counts)| counts.refused.contested).sum()
    }

    /// Takes an item of the card's driver.
    pub fn note(&mut self, next: &Next<'_>) {
        self.estimator.handle_own(next);
    }

    /// Takes the measurement in a peer's answer.
    pub fn answered(&mut self, peer: Mac, measurement: &Measurement) {
        self.estimator.handle_measurement(peer, measurement);
    }

    /// Records of the card that could not be used, by reason.
    #[must_use]
    pub fn unused(&self) -> UnusedRecords {
        self.estimator.own_log().unused
    }

    /// Measurements of another antenna than the one in use: not used.
    #[must_use]
    pub fn other_antenna(&self) -> u64 {
        self.estimator.other_antenna()
    }

    /// All products so far, for bearings.
    #[must_use]
    pub fn links(&self) -> Links {
        self.estimator.links()
    }
}
