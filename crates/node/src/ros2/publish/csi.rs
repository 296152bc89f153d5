//! Every record of the card, as a message.

use super::super::inputs::SimClock;
use super::super::link::Publisher;
use super::super::messages::own::Csi;
use super::super::messages::standard::{Header, Time};
use crate::machine::Tap;
use crate::ros::said::csi_message;
use csi5300::motion::pose::Pose;
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{Next, Stamps};
use driver_iface::bfee::Bfee;
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
    csi_message!(Csi, Header { stamp, frame_id: String::new() }, bfee, identity)
}
