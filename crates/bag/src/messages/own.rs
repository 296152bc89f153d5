//! The messages of this program; the files in `packaging/ros2/csi5300_msgs` explain every field.

use super::messages;
use super::standard::{Header, Time};
use csi5300::signal::csi::Csi as Matrix;
use csi5300::source::survey::Identity;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};

messages! {
    /// The report of one peer.
    "csi5300_msgs/msg/Bearing" Bearing {
        header: Header, peer: String, mac: String, state: String, words: String, azimuth: f64, azimuth_sd: f64,
        azimuth_body: f64, mirror: f64, elevation: f64, signed_elevation: f64, range: f64, range_sd: f64, coherence: f64,
        confidence: f64, moved: f64, needed: f64, age: f64, pairs: u32,
    }
    /// One record of the card.
    "csi5300_msgs/msg/Csi" Csi {
        header: Header, mac: String, frame_count: u32, timestamp_low: u32, bfee_count: u16, n_rx: u8, n_tx: u8,
        rssi: [u8; 3], noise: i8, agc: u8, rate_n_flags: u16, antennas: Vec<u8>, re: Vec<i8>, im: Vec<i8>,
    }
    /// One record for display: |CSI| of one antenna by subcarrier, unscaled, and its phase, radians. In recordings only.
    "csi5300_msgs/msg/CsiRow" CsiRow {
        header: Header, sender: String, number: u32, card_us: u32, magnitude: Vec<f32>, phase: Vec<f32>,
    }
    /// Counts of a log's records and losses. In recordings only.
    "csi5300_msgs/msg/Counters" Counters {
        header: Header, records: u64, damages: u64, damaged_bytes: u64, impossible_records: u64, overruns: u64,
        bfee_missing: u64,
    }
}

impl Csi {
    /// From a record of the card and what is known of its sender.
    #[must_use]
    pub fn of(stamp: Time, bfee: &Bfee<'_>, identity: Identity) -> Self {
        let known = Matrix::from_bfee(bfee).ok();
        let matrix = known.unwrap_or_else(|| Matrix::raw(bfee));
        let antenna = |row: usize| known.and_then(|known| known.antenna(row));
        let number = |antenna: Antenna| Antenna::ALL.iter().position(|other| *other == antenna).unwrap_or(0) as u8;
        Self {
            header: Header { stamp, frame_id: String::new() },
            mac: if identity.mac == Mac::ZERO { String::new() } else { identity.mac.to_string() },
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
            // The card's 8 bits.
            re: matrix.as_slice().iter().map(|h| h.re as i8).collect(),
            im: matrix.as_slice().iter().map(|h| h.im as i8).collect(),
        }
    }
}
