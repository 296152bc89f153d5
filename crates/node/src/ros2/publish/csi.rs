//! Every record of the card, as a message.

use super::super::inputs::SimClock;
use super::super::link::Publisher;
use super::super::messages::own::Csi;
use super::super::messages::standard::{Header, Time};
use crate::machine::Tap;
use csi5300::motion::pose::Pose;
use csi5300::signal::csi::Csi as Matrix;
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{Next, Stamps};
use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::record::Record;

/// Publishes records.
pub(in crate::ros2) struct Records {
    pub csi: Publisher<Csi>,
    pub clock: SimClock,
    pub survey: Survey,
}

impl Tap for Records {
    fn record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        let stamps = Stamps { host_us, ..Stamps::default() };
        let next = Next::Record(stamps, record);
        let Some((bfee, identity)) = self.survey.note(&next) else { return };
        let stamp = Time::from_us(self.clock.to_stamp(identity.host_us.unwrap_or(0)));
        self.csi.put(&csi(stamp, &bfee, identity));
    }

    fn pose(&mut self, _: Option<Pose>) {}
}

/// A record as a message.
pub(in crate::ros2) fn csi(stamp: Time, bfee: &Bfee<'_>, identity: Identity) -> Csi {
    let known = Matrix::from_bfee(bfee).ok();
    let matrix = known.unwrap_or_else(|| Matrix::raw(bfee));
    let antenna = |row: usize| known.and_then(|known| known.antenna(row));
    let number = |antenna: Antenna| Antenna::ALL.iter().position(|other| *other == antenna).unwrap_or(0) as u8;
    Csi {
        header: Header { stamp, frame_id: String::new() },
        mac: if identity.mac == driver_iface::Mac::ZERO { String::new() } else { identity.mac.to_string() },
        frame_count: identity.frame_count.unwrap_or(0),
        timestamp_low: bfee.timestamp_low(),
        bfee_count: bfee.bfee_count(),
        n_rx: matrix.n_rx() as u8,
        n_tx: matrix.n_tx() as u8,
        rssi: bfee.rssi(),
        noise: bfee.noise_dbm(),
        agc: bfee.agc(),
        rate_n_flags: bfee.rate_n_flags(),
        antennas: (0..matrix.n_rx()).filter_map(antenna).map(number).collect(),
        // They are the card's 8 bits.
        re: matrix.as_slice().iter().map(|h| h.re as i8).collect(),
        im: matrix.as_slice().iter().map(|h| h.im as i8).collect(),
    }
}
