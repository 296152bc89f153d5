//! The state of the robot as `rqt_robot_monitor` and Foxglove show it: card, odometry, each peer, the program.

use crate::health::Health;
use csi5300::pipeline::live::PeerState;
use csi5300_bag::messages::shown::{Byte, DiagnosticArray, DiagnosticStatus, KeyValue};
use csi5300_bag::messages::standard::Header;

const WELL: Byte = Byte(0);
const WARNING: Byte = Byte(1);
const STALE: Byte = Byte(3);

fn status(
    health: &Health,
    part: &str,
    (level, message): (Byte, String),
    values: &[(&str, String)],
) -> DiagnosticStatus {
    let value = |(key, value): &(&str, String)| KeyValue { key: (*key).to_owned(), value: value.clone() };
    DiagnosticStatus {
        level,
        name: format!("csi5300: {part}"),
        message,
        hardware_id: health.name.clone(),
        values: values.iter().map(value).collect(),
    }
}

/// All parts.
pub(super) fn of(header: Header, health: &Health) -> DiagnosticArray {
    let rate = |what: &str, hz: f64| (if hz > 0.0 { WELL } else { STALE }, format!("{hz:.0} {what} a second"));
    let card = status(
        health,
        "card",
        rate("records", health.records_hz),
        &[
            ("records", health.records.to_string()),
            ("records_hz", format!("{:.1}", health.records_hz)),
            ("losses", health.losses.to_string()),
            ("missing", health.missing.to_string()),
            ("strangers", health.strangers.to_string()),
        ],
    );
    let odometry = status(
        health,
        "odometry",
        rate("poses", health.poses_hz),
        &[
            ("poses", health.poses.poses.to_string()),
            ("poses_hz", format!("{:.1}", health.poses_hz)),
            ("new_frames", health.poses.new_frames.to_string()),
        ],
    );
    let peers = health.peers.iter().map(|peer| {
        let good = |state| matches!(state, PeerState::Bearing | PeerState::Held | PeerState::NotYet);
        let (level, words) = match &peer.report {
            Some(report) => (if good(report.state) { WELL } else { WARNING }, report.words.clone()),
            None => (STALE, "nothing was said of it yet".into()),
        };
        let words = if words.is_empty() { format!("{:.0} exchanges a second", peer.pairs_hz) } else { words };
        let values = [
            ("mac", peer.mac.clone()),
            ("pairs_hz", format!("{:.1}", peer.pairs_hz)),
            ("pairs", peer.counts.pairs.to_string()),
            ("losses", peer.counts.losses.to_string()),
        ];
        status(health, &format!("peer {}", peer.name), (level, words), &values)
    });
    let trouble = match health.trouble.as_slice() {
        [] => (WELL, "well".to_owned()),
        all => (WARNING, all.join("; ")),
    };
    let node = status(
        health,
        "node",
        trouble,
        &[
            ("cpu_percent", format!("{:.1}", health.load.cpu_percent)),
            ("memory_mib", format!("{:.1}", health.load.memory_mib)),
            ("estimate_ms", format!("{:.2}", health.load.estimate_ms)),
            ("uptime_s", format!("{:.0}", health.uptime_s)),
        ],
    );
    DiagnosticArray { header, status: [card, odometry].into_iter().chain(peers).chain([node]).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_a_warning_and_silence_is_stale() {
        let mut health = Health { name: "burger".into(), records_hz: 99.6, ..Health::default() };
        health.trouble = vec!["a".into(), "b".into()];
        let said = of(Header::default(), &health);
        let levels: Vec<u8> = said.status.iter().map(|status| status.level.0).collect();
        assert_eq!(levels, [0, 3, 1]);
        assert_eq!(said.status[0].message, "100 records a second");
        assert_eq!((said.status[2].message.as_str(), said.status[2].hardware_id.as_str()), ("a; b", "burger"));
    }
}
