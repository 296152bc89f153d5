//! What this program publishes; the files with every field's meaning are in `packaging/ros2/csi5300_msgs`.

use super::messages;
use super::standard::Header;

messages! {
    /// What is said of one peer.
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
}
