"""Simulates a room in memory, estimates the bearing and compares it with the truth; then with a wall before the transmitter."""

import csi5300

scene = {
    "duration_s": 10.0,
    "seed": 3,
    "channel": 108,
    "sounding": {"rate_hz": 100.0},
    "robot": [
        {"name": "rx", "motion": {"circle": {"radius_m": 0.4, "duration_s": 10.0}}},
        {"name": "tx", "position_m": [4.0, 3.0, 0.2]},
    ],
}
behind = {"wall": [{"from_m": [2.0, 2.5], "to_m": [3.0, 1.0], "through_db": 12.0}]}
for name, room in (("in sight", csi5300.simulate(scene)), ("behind a wall", csi5300.simulate({**scene, **behind}))):
    (bearing,) = room.bearings()
    truth = room.true_azimuth_deg("tx")
    dbm = room["rx"].log.total_rss.mean()
    print(f"{name}: {bearing.azimuth_deg:.1f} +- {bearing.azimuth_sd_deg:.1f} deg, truth {truth:.1f}, received {dbm:.0f} dBm")
