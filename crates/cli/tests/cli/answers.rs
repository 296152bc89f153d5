//! A node that needs no network: its peer's records come with the answers to its frames.

use crate::serve::{LIVE, Program};

/// A node of robot `own`; `peer` is the rest of its peer's table.
fn node(own: &str, initiate: bool, odometry: &str, peer: &str) -> String {
    format!(
        "channel = \"108\"\ncapture.served = {{ socket = \"room\", robot = \"{own}\" }}\n{odometry}\n[[peer]]\n{peer}\n\
         [estimator]\naccurate = false\n[output]\nbearings = \"{own}.jsonl\"\nstatus_line = \"always\"\n\
         [sounding]\nrate_hz = 50.0\nturn_around_us = 6000\nguard_us = 1500\nfifo = false\ninitiate = {initiate}\n"
    )
}

#[test]
fn records_of_a_peer_come_with_its_answers() {
    let folder = std::env::temp_dir().join(format!("csi5300-answers-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let place = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(place("scene.toml"), LIVE).unwrap();
    let mut room = Program::start(&["simulate", &place("scene.toml"), "--serve", "--socket", &place("room")]);
    room.until("serving the room at");
    // The one that answers listens to the room; the one that asks hears of the other's card through its answers only.
    let answers = "name = \"rx\"\nrecords.room = {}\nposes.room = {}";
    let asks = "name = \"tx\"\nmac = \"02:00:00:00:00:0b\"\nrecords.sounding = {}";
    std::fs::write(place("tx.toml"), node("tx", false, "", answers)).unwrap();
    std::fs::write(place("rx.toml"), node("rx", true, "odometry.room = {}", asks)).unwrap();
    let tx = Program::start(&["node", "--config", &place("tx.toml")]);
    let mut rx = Program::start(&["node", "--config", &place("rx.toml")]);
    let bearings = || {
        let lines = std::fs::read_to_string(place("rx.jsonl")).unwrap_or_default();
        let lines = lines.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        lines.filter(|line| line["state"] == "bearing").collect::<Vec<_>>()
    };
    while bearings().len() < 6 {
        rx.said.clear();
        rx.until("records/s");
    }
    [&rx, &tx].into_iter().for_each(Program::stop);
    for node in [rx, tx] {
        let (status, said) = node.end();
        assert!(matches!(status, Some(0 | 3)), "{status:?}: {said}");
    }
    room.stop();
    let _ = room.end();
    let last = bearings().pop().unwrap();
    let off_deg = last["azimuth_deg"].as_f64().unwrap() - 93f64.atan2(-386.0).to_degrees();
    assert!(off_deg.abs() < 2.0, "{off_deg} degrees off: {last}");
    assert!(last["transmitter_records"]["paired"].as_u64() >= Some(50), "{last}");
    std::fs::remove_dir_all(&folder).unwrap();
}
