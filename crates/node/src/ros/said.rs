//! What messages of ROS 1 and of ROS 2 say alike. Their types differ in the header and in how they are written, not in these fields:
//! `packaging/ros/csi5300_msgs` and `packaging/ros2/csi5300_msgs` have each with its meaning.

use csi5300::pipeline::live::{PeerReport, PeerState};

/// True for a report with a bearing, new or said again.
pub(crate) fn has_bearing(report: &PeerReport) -> bool {
    matches!(report.state, PeerState::Bearing | PeerState::Held)
}

/// The state of a report as the lines of JSON have it.
pub(crate) fn state_name(state: PeerState) -> String {
    let name = serde_json::to_value(state).ok().and_then(|state| state.as_str().map(str::to_owned));
    name.unwrap_or_default()
}

/// The turn (x, y, z, w) from the x axis to a direction, radians: about z by the azimuth, then up by the elevation.
pub(crate) fn looking_along(azimuth_rad: f64, elevation_rad: f64) -> [f64; 4] {
    // About the turned y; upwards is the negative turn.
    let ((sin, cos), (up, level)) = ((0.5 * azimuth_rad).sin_cos(), (-0.5 * elevation_rad).sin_cos());
    [-sin * up, cos * up, sin * level, cos * level]
}

/// A `csi5300_msgs/Bearing` of the type `$Bearing`; angles in radians, NaN for what is not known.
macro_rules! bearing_message {
    ($Bearing:ident, $header:expr, $peer:expr, $mac:expr, $report:expr) => {{
        let (report, answer) = ($report, &$report.answer);
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let angle = |degrees: Option<f64>| number(degrees).to_radians();
        $Bearing {
            header: $header,
            peer: $peer.to_owned(),
            mac: $mac.to_owned(),
            state: $crate::ros::said::state_name(report.state),
            words: report.words.clone(),
            azimuth: angle(answer.azimuth_deg),
            azimuth_sd: angle(answer.azimuth_sd_deg),
            azimuth_body: angle(answer.azimuth_body_deg),
            mirror: angle(answer.mirror_deg),
            elevation: angle(answer.abs_elevation_deg),
            signed_elevation: angle(answer.elevation_deg),
            range: number(answer.range_m),
            range_sd: number(answer.range_sd_m),
            coherence: number(answer.coherence),
            confidence: number(answer.confidence),
            moved: report.moved_m,
            needed: report.needed_m,
            age: report.age_s,
            pairs: u32::try_from(answer.pairs_in_motion).unwrap_or(u32::MAX),
        }
    }};
}
pub(crate) use bearing_message;

/// A `csi5300_msgs/Csi` of the type `$Csi`, from a record and what is known of its sender.
macro_rules! csi_message {
    ($Csi:ident, $header:expr, $bfee:expr, $identity:expr) => {{
        use csi5300::signal::csi::Csi as Matrix;
        use driver_iface::bfee::Antenna;
        let (bfee, identity) = ($bfee, $identity);
        let known = Matrix::from_bfee(bfee).ok();
        let matrix = known.unwrap_or_else(|| Matrix::raw(bfee));
        let antenna = |row: usize| known.and_then(|known| known.antenna(row));
        let number = |antenna: Antenna| Antenna::ALL.iter().position(|other| *other == antenna).unwrap_or(0) as u8;
        $Csi {
            header: $header,
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
    }};
}
pub(crate) use csi_message;
