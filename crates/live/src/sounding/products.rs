//! Live bearings: products of forward and backward frames while robots sound, with no second network.
//!
//! The initiator's card reports the backward frame; what the responder's card reported of the forward frame comes in a
//! later answer ([`driver_iface::sounding::native::Measurement`]). Both go into the pipeline's [`Link`], as from logs.

use csi5300::exchange::pairing::Side;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Bearing, FrameHeard, Front, Link, LinkError, LinkJoin, Options, UnusedRecords, estimate};
use csi5300::source::Next;
use csi5300::source::survey::Identity;
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

/// The links of one initiator.
#[derive(Debug)]
pub struct Products {
    options: Options,
    /// Each with the number of measurements that came of it.
    links: Vec<(Link, u32)>,
    front: Front,
    /// Measurements of another antenna than the one in use; not used.
    pub other_antenna: u64,
}

impl Products {
    /// Links to `peers`.
    #[must_use]
    pub fn new(peers: &[Mac], options: Options) -> Self {
        let links = peers.iter().map(|mac| (Link::new(*mac, None), 0)).collect();
        Self { front: Front::new(options.antenna), options, links, other_antenna: 0 }
    }

    /// Takes what the card's driver gave.
    pub fn note(&mut self, next: &Next<'_>) {
        let Some((mac, heard)) = self.front.note(next) else { return };
        if let Some((link, _)) = find(&mut self.links, mac) {
            link.handle(Side::Receiver, heard, &self.options);
        }
    }

    /// Takes what a peer's answer carried.
    pub fn answered(&mut self, peer: Mac, measurement: &Measurement) {
        if measurement.rx_antenna != self.options.antenna as u8 {
            self.other_antenna += 1;
            return;
        }
        let Some((link, row)) = find(&mut self.links, peer) else { return };
        link.handle(Side::Transmitter, FrameHeard::measured(measurement, *row), &self.options);
        *row += 1;
    }

    /// Records of the card that could not be used, by reason.
    #[must_use]
    pub fn unused(&self) -> UnusedRecords {
        self.front.unused
    }

    /// Products that there are, by link.
    pub fn pairs(&self) -> impl Iterator<Item = (Mac, usize)> {
        self.links.iter().map(|(link, _)| (link.mac, link.pairs()))
    }

    /// The bearings to all peers with a product, from all products so far; an error where there is nothing to make one
    /// from yet.
    #[must_use]
    pub fn bearings(&self, trajectory: &Trajectory) -> Vec<(Mac, Result<Bearing, LinkError>)> {
        let links = || self.links.iter().map(|(link, _)| link).filter(|link| link.pairs() > 0);
        let join = |link| LinkJoin { link, receiver: trajectory, transmitter: None };
        let made = estimate(&links().map(join).collect::<Vec<_>>(), &self.options);
        links().map(|link| link.mac).zip(made).collect()
    }
}

fn find(links: &mut [(Link, u32)], mac: Mac) -> Option<&mut (Link, u32)> {
    links.iter_mut().find(|(link, _)| link.mac == mac)
}
