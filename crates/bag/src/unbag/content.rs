//! Converts a message to a record of a log or a row of a trajectory.

use super::{Channel, compressed};
use crate::cdr::{Cdr, CdrReader};
use crate::messages::own::Csi;
use crate::messages::standard::{Header, Odometry, Pose as PoseMessage, PoseStamped};
use csi5300::internal::heading_of;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::Record;

/// Code of a record with CSI.
pub(super) const BFEE: u8 = 0xbb;
/// Two bits that name no antenna.
const NO_ANTENNA: u8 = 3;

/// Topics that estimates use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Content {
    /// Records of a card (`csi5300_msgs/msg/Csi`): they make a log in the WSR layout.
    Csi,
    /// Poses (`nav_msgs/msg/Odometry`, `geometry_msgs/msg/PoseStamped`): they make the rows of a trajectory.
    Poses,
}

impl Content {
    /// The content of a topic; `None` if it is neither.
    pub(super) fn of(channel: &Channel) -> Option<Self> {
        match channel.kind.as_str() {
            "csi5300_msgs/msg/Csi" => Some(Self::Csi),
            "nav_msgs/msg/Odometry" => Some(Self::Poses),
            "geometry_msgs/msg/PoseStamped" if !is_direction(&channel.topic) => Some(Self::Poses),
            _ => None,
        }
    }

    /// The extension of its file.
    pub(super) fn ending(self) -> &'static str {
        match self {
            Self::Csi => "dat",
            Self::Poses => "csv",
        }
    }
}

/// True for a bearing published as a pose, `/csi5300_ROBOT/PEER/direction`, which is not odometry.
fn is_direction(topic: &str) -> bool {
    let mut parts = topic.rsplit('/');
    parts.next() == Some("direction") && parts.nth(1).is_some_and(|node| node.starts_with("csi5300"))
}

/// The bytes that a message adds to its file; a payload may be compressed by itself.
pub(super) fn bytes(channel: &Channel, payload: &[u8]) -> Option<Vec<u8>> {
    let whole = if compressed::is_zstd(payload) {
        Some(compressed::bounded(compressed::Frames::new(payload), compressed::LARGEST_MESSAGE).ok()?)
    } else {
        None
    };
    let payload = whole.as_deref().unwrap_or(payload);
    let mut from = match channel.encoding.as_str() {
        // Each begins with a header; that of ROS 1 has a sequence number.
        "ros1" => CdrReader::ros1(payload.get(4..)?),
        _ => CdrReader::of_payload(payload).ok()?,
    };
    match channel.kind.as_str() {
        "csi5300_msgs/msg/Csi" => record(&Csi::read(&mut from).ok()?),
        "nav_msgs/msg/Odometry" => {
            let told = Odometry::read(&mut from).ok()?;
            row(&told.header, &told.pose.pose)
        }
        _ => {
            let told = PoseStamped::read(&mut from).ok()?;
            row(&told.header, &told.pose)
        }
    }
}

fn row(header: &Header, pose: &PoseMessage) -> Option<Vec<u8>> {
    let pose = pose.isometry()?;
    let heading_rad = Some(heading_of(&pose.rotation));
    let t_s = header.stamp.us() as f64 * 1e-6;
    Some(csv::line(&Pose { t_s, position_m: pose.translation.vector, heading_rad }).into_bytes())
}

/// A record as the WSR driver's logger writes it: length and code first.
fn record(csi: &Csi) -> Option<Vec<u8>> {
    let antenna = |row: usize| csi.antennas.get(row).copied().filter(|antenna| *antenna < 3).unwrap_or(NO_ANTENNA);
    let us = u64::try_from(csi.header.stamp.us()).ok()?;
    let mac = if csi.mac.is_empty() { driver_iface::Mac::ZERO } else { csi.mac.parse().ok()? };
    let wsr = Wsr {
        tv_sec: u32::try_from(us / 1_000_000).ok()?,
        tv_usec: (us % 1_000_000) as u32,
        mac,
        frame_count: Some(csi.frame_count),
    };
    let repr = Repr {
        timestamp_low: csi.timestamp_low,
        bfee_count: csi.bfee_count,
        reserved: 0,
        n_rx: csi.n_rx,
        n_tx: csi.n_tx,
        rssi: csi.rssi,
        noise_dbm: csi.noise,
        agc: csi.agc,
        antenna_sel: (0..3).fold(0, |all, row| all | (antenna(row) & 3) << (2 * row)),
        rate_n_flags: csi.rate_n_flags,
        wsr: Some(wsr),
    };
    if csi.re.len() != csi.im.len() {
        return None;
    }
    let iq: Vec<Iq> = csi.re.iter().zip(&csi.im).map(|(i, q)| Iq { i: *i, q: *q }).collect();
    let mut body = vec![0; driver_iface::bfee::MAX_BODY];
    let length = repr.emit(&iq, &mut body).ok()?;
    let record = Record { code: BFEE, body: body.get(..length)? };
    let mut bytes = vec![0; record.emit_len()];
    let length = record.emit(&mut bytes).ok()?;
    bytes.truncate(length);
    Some(bytes)
}
