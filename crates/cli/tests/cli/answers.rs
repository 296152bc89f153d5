//! A node that needs no network: its peer's records come with the answers to its frames.

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
    // The one that answers listens to the room; the one that asks hears of the other's card through its answers only.
    let answers = "name = \"rx\"\nrecords.room = {}\nposes.room = {}";
    let asks = "name = \"tx\"\nmac = \"02:00:00:00:00:0b\"\nrecords.sounding = {}";
    let nodes = [node("rx", true, "odometry.room = {}", asks), node("tx", false, "", answers)];
    let (last, _) = crate::served::two_nodes("answers", &nodes, 6);
    assert!(last["transmitter_records"]["paired"].as_u64() >= Some(50), "{last}");
}
