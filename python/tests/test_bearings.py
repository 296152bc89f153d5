from __future__ import annotations

import copy
import json
import math
import pickle
from pathlib import Path
from typing import Any

import csi5300
import numpy as np
import pytest
from conftest import CIRCLE

ANSWER = json.loads((CIRCLE.parent / "small-circle.answer.json").read_text())


def test_paths_logs_and_arrays_give_one_bearing(rx: Path, tx: Path, path_csv: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    assert bearing and bearing.error is None and bearing.link == tx.stem
    assert bearing.azimuth_deg == pytest.approx(120.5, abs=0.5)
    track = csi5300.read_trajectory(path_csv)
    assert track.shape[1] == 5
    ways = [
        csi5300.bearings(csi5300.read(rx), [csi5300.read(tx)], trajectory=track, channel="108"),
        csi5300.bearings(rx.read_bytes(), tx.read_bytes(), trajectory=track[:, :4], channel=108),
        csi5300.bearings(pickle.loads(pickle.dumps(csi5300.read(rx))), tx, trajectory=track.tolist(), channel=108),
    ]
    for (other,) in ways:
        assert other.azimuth_deg == bearing.azimuth_deg and other.azimuth_sd_deg == bearing.azimuth_sd_deg


def test_a_translated_log_in_memory_keeps_the_cards_clock() -> None:
    scene = {
        "duration_s": 6.0,
        "card": "ax210",
        "cfo": "physical",
        "radio": {"noise": {"snr_db": 20.0}, "send_jitter_us": 60.0, "turn_around": {"spread_us": 8.0}},
        "sounding": {"rate_hz": 50.0},
        "robot": [
            {"name": "rx", "motion": {"circle": {"radius_m": 0.25, "duration_s": 6.0}}},
            {"name": "tx", "position_m": [-4.0, 9.0, 0.0], "crystal": {"offset_ppm": -6.0}},
        ],
    }
    room = csi5300.simulate(scene)
    options: dict[str, Any] = {"channel": room.channel, "tx_mac": room["tx"].mac, "columns": "t,x,y,z,yaw"}
    options["trajectory"] = room["rx"].path
    (of_bytes,) = csi5300.bearings(room["rx"].data, room["tx"].data, **options)
    logs = [pickle.loads(pickle.dumps(room[name].log)) for name in ("rx", "tx")]
    (of_logs,) = csi5300.bearings(logs[0], logs[1], **options)
    named = {"link": None}
    assert of_bytes and {**of_logs.answer, **named} == {**of_bytes.answer, **named}


def test_rows_of_an_array_without_a_place_are_skipped_as_those_of_a_file(rx: Path, tx: Path, path_csv: Path) -> None:
    rows = csi5300.read_trajectory(path_csv)
    rows[:, 4] = np.nan
    rows[5, 2] = np.nan
    with pytest.warns(UserWarning, match="1 rows skipped, the first in line 6: column 3 is not a finite number"):
        (bearing,) = csi5300.bearings(rx, tx, trajectory=rows, channel=108)
    (of_file,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    assert bearing.azimuth_deg == pytest.approx(of_file.azimuth_deg, abs=0.1)


def test_logs_that_contradict_themselves_or_the_channel_warn(rx: Path, tx: Path, path_csv: Path) -> None:
    backward = csi5300.read(rx)[::-1]
    with pytest.warns(UserWarning, match=r"\d+ of \d+ records are older than the one before: sort them by time"):
        csi5300.bearings(backward, tx, trajectory=path_csv, channel=108)
    with pytest.warns(UserWarning, match=r"records are 20 MHz wide, channel 108\+ is not.*: name it 108"):
        csi5300.bearings(rx, tx, trajectory=path_csv, channel="108+")


def test_what_a_notebook_shows_fits_on_a_line_or_in_a_table(rx: Path, tx: Path, path_csv: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    text = repr(bearing)
    assert text.startswith(f"<Bearing {tx.stem} 120.") and "deg +-" in text and ", p " in text and len(text) < 120
    assert "<table>" in bearing._repr_html_() and "azimuth_bound_deg" in bearing._repr_html_()
    (none,) = csi5300.bearings(rx, b"", trajectory=path_csv, channel=108)
    assert "no bearing: " in repr(none) and "<table>" in none._repr_html_()
    result = csi5300.evaluate(CIRCLE)
    assert repr(result).startswith("<Evaluation of 1 links, 0 failed; error mean ") and len(repr(result)) < 120
    assert "error_from_mean_pose_deg" in result._repr_html_()
    assert {"bearings", "csiread", "plot"} <= set(dir(csi5300)) and "importlib" not in dir(csi5300)


def test_arrays_are_read_like_files_or_refused(rx: Path, tx: Path, path_csv: Path, tmp_path: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    track = csi5300.read_trajectory(path_csv)
    file = np.column_stack([track[:, 0], np.zeros(len(track)), track[:, 1:4]])
    with pytest.raises(csi5300.TrajectoryError, match=r"t,x,y,z,yaw or t,ns,x,y,z.*columns="):
        csi5300.bearings(rx, tx, trajectory=file, channel=108)
    yaw = np.column_stack([file, np.full(len(track), 0.5)])
    named = np.column_stack([track[:, 0], track[:, 2], -track[:, 1]])
    for rows, columns in ((file, "t,ns,x,y,z"), (yaw, None), (named, "t,y,-x")):
        (same,) = csi5300.bearings(rx, tx, trajectory=rows, channel=108, columns=columns)
        assert abs(same.azimuth_deg - bearing.azimuth_deg) < 1e-6, columns
    other = tmp_path / "t.csv"
    np.savetxt(other, named, fmt="%.9f", delimiter=",")
    with pytest.raises(csi5300.TrajectoryError, match="3 columns without headings"):
        csi5300.read_trajectory(other)
    assert np.allclose(csi5300.read_trajectory(other, columns="t,y,-x")[:, 1:3], track[:, 1:3], atol=1e-8)
    with pytest.raises(csi5300.OptionError, match="columns: name no y"):
        csi5300.bearings(rx, tx, trajectory=named, channel=108, columns="t,x")


def test_masked_rows_and_tables_are_taken_for_what_they_say(rx: Path, tx: Path, path_csv: Path) -> None:
    track = csi5300.read_trajectory(path_csv)[:, :4]
    (bearing,) = csi5300.bearings(rx, tx, trajectory=track, channel=108)
    masked = np.ma.masked_array(track.copy(), mask=False)
    masked[100:110, 1:] += 5.0
    masked[100:110, 1:] = np.ma.masked
    with pytest.warns(UserWarning, match="10 rows skipped, the first in line 101: column 2"):
        (kept,) = csi5300.bearings(rx, tx, trajectory=masked, channel=108)
    (skipped,) = csi5300.bearings(rx, tx, trajectory=np.delete(track, range(100, 110), axis=0), channel=108)
    assert kept.answer == skipped.answer
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(track, columns=["t", "x", "y", "z"])
    turned = {"t": table.t, "x": 0.0 * table.x, "y": table.x, "yaw": 0.0 * table.x}
    for own, columns in (
        (table[["y", "x", "t", "z"]], None),
        (table.drop(columns="z"), None),
        (table.assign(t=pandas.to_datetime(table.t, unit="s")), None),
        (table[["y", "x", "t"]], "y,x,t"),
        (pandas.DataFrame(track), None),
    ):
        (same,) = csi5300.bearings(rx, tx, trajectory=own, channel=108, columns=columns)
        assert same.azimuth_deg == pytest.approx(bearing.azimuth_deg, abs=1e-3), list(own.columns)
    # x is 0 throughout, and cannot be taken for nanoseconds.
    (line,) = csi5300.bearings(rx, tx, trajectory=pandas.DataFrame(turned), channel=108)
    assert line.answer["geometry"] == "along a line"
    for wrong in (table.set_index("t"), table.rename(columns={"t": "time"}), table.assign(t=pandas.to_datetime(table.t, unit="s", utc=True))):
        with pytest.raises(csi5300.TrajectoryError, match="^trajectory: "):
            csi5300.bearings(rx, tx, trajectory=wrong, channel=108)


def test_one_transmitter_that_moves_needs_no_list(rx: Path, tx: Path, path_csv: Path) -> None:
    track = csi5300.read_trajectory(path_csv)[:, :4]
    track[:, 1:] *= -1.0
    (listed,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, tx_trajectory=[track])
    (alone,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, tx_trajectory=track)
    (still,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, tx_trajectory=None)
    (stands,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    assert listed.answer == alone.answer != stands.answer == still.answer
    (parallel,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, tx_trajectory=path_csv)
    assert "spans 0.000000 m" in str(parallel.error)
    with pytest.raises(csi5300.OptionError, match="tx_trajectory: more than tx"):
        csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, tx_trajectory=[track, track])


def test_options_match_the_command_line(rx: Path, tx: Path, path_csv: Path) -> None:
    (full,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    (lean,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without="near-field", threads=1)
    assert (full.answer["model"], lean.answer["model"]) == ("spherical_wave", "plane_wave")
    (bare,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, no_compensation=True)
    assert full.answer["compensated"] and not bare.answer["compensated"]
    (part,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, from_=0.5, to=1.5)
    assert 0 < part.answer["pairs_in_motion"] < full.answer["pairs_in_motion"]
    (fourth,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, decimate=4)
    assert abs(4 * fourth.answer["pairs_in_motion"] - full.answer["pairs_in_motion"]) <= 4
    with pytest.raises(csi5300.OptionError, match="decimate"):
        csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, decimate=0)


def test_a_link_without_a_bearing_says_why(rx: Path, tx: Path, path_csv: Path) -> None:
    good, bad = csi5300.bearings(rx, [tx, b""], trajectory=path_csv, channel=108)
    assert good and not bad and bad.error and np.isnan(bad.azimuth_deg)
    with pytest.raises(csi5300.LinkError, match="no bearing"):
        bad.profile()


def test_profiles(rx: Path, tx: Path, path_csv: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without=["near-field", "elevation"])
    around = bearing.profile()
    assert around.value.shape == around.azimuth_deg.shape == (1, 360)
    best = around.azimuth_deg.flat[around.value.argmax()]
    assert abs(best - bearing.azimuth_deg) <= 1
    both = bearing.profile(36, 5)
    assert both.value.shape == (5, 36) and both.elevation_deg[0, 0] == -90
    chosen = bearing.profile([-180.0, -170.0], [0.0, 45.0])
    assert chosen.value.shape == (2, 2) and np.allclose(chosen.elevation_deg[:, 0], [0, 45])
    assert chosen.value[1, 0] == pytest.approx(both.value[both.elevation_deg[:, 0] == 45, 0][0], rel=1e-3)
    assert chosen.value[0, 0] == pytest.approx(around.value[0, 0], rel=1e-3)
    with pytest.raises(csi5300.OptionError):
        bearing.profile(0)


def test_steps_are_whole_numbers_of_any_kind(rx: Path, tx: Path, path_csv: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without="near-field")
    steps = bearing.profile(36)
    for number in (np.int64(36), np.array(36), np.uint8(36)):
        assert np.array_equal(bearing.profile(number).value, steps.value)
    assert np.array_equal(bearing.profile(36, 1).value, steps.value)
    for elevation in (bearing.profile([0.0], 1), bearing.profile([0.0])):
        assert elevation.elevation_deg.tolist() == [[0.0]]
    for wrong in (36.0, np.float64(36), True, "36", None, 0, [], ["north"], [[0.0], [1.0, 2.0]]):
        with pytest.raises(csi5300.OptionError, match="azimuth"):
            bearing.profile(wrong)  # type: ignore[arg-type]


def test_pickled_bearings_keep_their_evidence(rx: Path, tx: Path, path_csv: Path) -> None:
    good, bad = csi5300.bearings(rx, [tx, b""], trajectory=path_csv, channel=108, every=1.0)
    for other in (pickle.loads(pickle.dumps(good)), copy.copy(good), copy.deepcopy(good)):
        assert other and other.answer == good.answer and other.stretches == good.stretches
        assert np.array_equal(other.profile(90, 3).value, good.profile(90, 3).value)
        assert all(np.array_equal(values, other.samples[name]) for name, values in good.samples.items())
    again = pickle.loads(pickle.dumps(bad))
    assert not again and again.error == bad.error and len({good, bad, again}) == 3
    state = good.__getstate__()
    state["link"][1][0] = np.nan
    with pytest.raises(csi5300.OptionError, match="damaged"):
        copy.copy(good).__setstate__(state)


def test_the_range_change_is_returned_on_request(rx: Path, tx: Path, path_csv: Path) -> None:
    (plain,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108)
    assert plain.samples["range_change"].shape == (0, 3) and "range_change" not in plain.answer
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, range_change=True)
    summary, rows = bearing.answer["range_change"], bearing.samples["range_change"]
    assert summary["held_share"] > 0.9 and len(rows) > 100 and rows[0, 1] == 0.0
    assert rows[-1, 1:].tolist() == [summary["end_m"], summary["end_sd_m"]]
    # A circle through a turn: the distance varies by at most the circle's width (radius 0.3 m) and returns.
    assert 0.01 < np.ptp(rows[:, 1]) < 0.61
    other = pickle.loads(pickle.dumps(bearing))
    assert np.array_equal(other.samples["range_change"], rows)


def test_odometry_is_fitted_on_request(rx: Path, tx: Path, path_csv: Path) -> None:
    options: dict[str, Any] = {"channel": 108, "fit": "odometry"}
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, **options)
    assert bearing.answer["odometry_fit"]["refused"] == "the trajectory has no headings"
    track = csi5300.read_trajectory(path_csv)
    steps = np.gradient(track[:, 1:3], axis=0)
    moving = np.hypot(*steps.T) > 1e-6
    track[:, 4] = np.interp(track[:, 0], track[moving, 0], np.unwrap(np.arctan2(steps[moving, 1], steps[moving, 0])))
    # Wheels 12 cm to the right of the antenna.
    wheels = track.copy()
    wheels[:, 1] += 0.12 * np.sin(track[:, 4])
    wheels[:, 2] -= 0.12 * np.cos(track[:, 4])
    (plain,) = csi5300.bearings(rx, tx, trajectory=wheels, channel=108)
    assert "odometry_fit" not in plain.answer
    (bearing,) = csi5300.bearings(rx, tx, trajectory=wheels, **options)
    fit = bearing.answer["odometry_fit"]
    # One circle: its radius shows, where on it the antenna is does not.
    assert "refused" not in fit and fit["links"] == 1 and not fit["forward_m"]["known"], fit
    assert abs(fit["left_m"]["value"] - 0.12) < 2 * fit["left_m"]["sd"] + 0.01, fit
    with pytest.raises(csi5300.OptionError, match="^fit: 'walls' is not 'odometry'"):
        csi5300.bearings(rx, tx, trajectory=wheels, channel=108, fit="walls")


def test_a_log_without_records_is_reported(rx: Path, tx: Path, path_csv: Path) -> None:
    noise = b"It was a dark and stormy night. " * 20
    (bearing,) = csi5300.bearings(noise, tx, trajectory=path_csv, channel=108)
    assert bearing.error and "the receiver's log holds no record with CSI" in bearing.error
    (bearing,) = csi5300.bearings(rx, b"", trajectory=path_csv, channel=108)
    assert bearing.error and "the transmitter's log holds no record with CSI" in bearing.error


def test_samples_make_the_profile(rx: Path, tx: Path, path_csv: Path) -> None:
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without="near-field")
    samples, around = bearing.samples, bearing.profile()
    assert samples["z"].shape == samples["t_s"].shape == (len(samples["receiver_m"]),)
    wavelength = 299_792_458.0 / 5.54e9
    for k in (0, 100, 300):
        azimuth = np.radians(around.azimuth_deg[0, k])
        along = samples["receiver_m"][:, :2] @ np.array([np.cos(azimuth), np.sin(azimuth)])
        total = np.abs(np.sum(samples["z"] * np.exp(-4j * np.pi * along / wavelength))) ** 2
        assert around.value[0, k] == pytest.approx(total / np.sum(np.abs(samples["z"])) ** 2, abs=1e-4)
    assert samples["phase"].shape[1] == 4 and samples["path_m"].shape[1] == 3


def test_a_room_has_its_bearing() -> None:
    scene = {
        "duration_s": 6.0,
        "seed": 5,
        "channel": 64,
        "sounding": {"rate_hz": 100.0},
        "radio": {"phase_noise_rad": 0.1},
        "robot": [
            {"name": "rx", "motion": {"circle": {"radius_m": 0.4, "duration_s": 6.0}}},
            {"name": "tx", "position_m": [3.0, 2.5, 0.0]},
        ],
    }
    room = csi5300.simulate(scene)
    assert [robot.name for robot in room] == ["rx", "tx"] and room.initiators == ["rx"] and room.channel == 64
    assert len(room["rx"].log) == 600 and room["rx"].path is not None
    (bearing,) = room.bearings()
    assert bearing.azimuth_deg == pytest.approx(room.true_azimuth_deg("tx"), abs=3)
    assert csi5300.simulate(scene)["tx"].data == room["tx"].data, "a seed is a room"
    wide = csi5300.simulate({**scene, "channel": 102, "bandwidth_mhz": 40})
    (bearing,) = wide.bearings()
    assert wide.channel == "5510MHz" and bearing.azimuth_deg == pytest.approx(wide.true_azimuth_deg("tx"), abs=3)
    assert csi5300.simulate(scene, seed=6)["tx"].data != room["tx"].data
    stock = csi5300.simulate(scene, layout="stock")
    assert stock["rx"].log.info["survey"]["stock"] == 600
    assert set(stock["rx"].log.mac) == {room["tx"].mac}
    with pytest.raises(KeyError, match="no robot 'nobody' in this room: rx, tx"):
        room["nobody"]
    assert len({*room, *room}) == 2 and room["rx"] == room["rx"]
    with pytest.raises(csi5300.OptionError, match="channel"):
        room.bearings(channel=None)
    scene["duration_s"], scene["robot"][1]["position_m"] = np.float32(6), np.array([3.0, 2.5, 0.0])  # type: ignore[index]
    assert csi5300.simulate(scene)["tx"].data == room["tx"].data, "NumPy's values are values"


def test_a_room_knows_that_transmitters_move() -> None:
    clock = {"offset_s": 3.0, "drift_ppm": 20.0}
    line = {"length_m": 1.0, "duration_s": 5.0}
    scene = {
        "duration_s": 6.0,
        "sounding": {"rate_hz": 100.0},
        "radio": {"phase_noise_rad": 0.1},
        "robot": [
            {"name": "rx", "motion": {"circle": {"radius_m": 0.3, "duration_s": 6.0}}},
            {"name": "tx", "position_m": [3.0, 5.0, 0.0], "motion": {"line": line}, "host_clock": clock},
            {"name": "still", "position_m": [-3.0, 4.0, 0.0]},
        ],
    }
    room = csi5300.simulate(scene)
    for bearing, name in zip(room.bearings(), ("tx", "still"), strict=True):
        assert bearing.azimuth_deg == pytest.approx(room.true_azimuth_deg(name), abs=1.5), name
    (back, _) = room.bearings(rx="tx")
    assert back.azimuth_deg == pytest.approx(room.true_azimuth_deg("rx", "tx"), abs=1.5)
    (alone, _) = room.bearings(tx_trajectory=None)
    assert abs(alone.azimuth_deg - room.true_azimuth_deg("tx")) > 10, "a path that the caller gives, or None, is kept"


def test_one_log_has_the_bearing_of_every_sender() -> None:
    turn = {"circle": {"radius_m": 0.0, "duration_s": 5.0}}
    rx: dict[str, Any] = {"name": "rx", "position_m": [0.3, 0.2, 0.0], "antenna_b_m": [-0.025, 0.0, 0.0], "motion": turn}
    scene = {
        "duration_s": 5.0,
        "sounding": {"rate_hz": 40.0},
        "radio": {"noise": {"snr_db": 20.0}, "chain_deg": [-50.0, 0.0]},
        "robot": [rx, {"name": "tx", "position_m": [30.3, 40.2, 0.0]}],
    }
    room = csi5300.simulate(scene)
    own: dict[str, Any] = {"channel": 108, "elevation_max": 0, "antennas": "A,B"}
    path = room["rx"].path
    assert path is not None
    (turned,) = csi5300.bearings(room["rx"].log, trajectory=path, baseline=(0.025, 0, 0), **own)
    assert turned.azimuth_deg == pytest.approx(53.13, abs=1) and math.isnan(turned.range_m)
    ((deg, sd_deg),) = turned.answer["chain_constants_deg"]
    assert deg == pytest.approx(50, abs=4 * sd_deg) and sd_deg < 2
    del rx["motion"]
    room = csi5300.simulate(scene)
    still: dict[str, Any] = {"trajectory": room["rx"].path, **own}
    (refused,) = csi5300.bearings(room["rx"].log, baseline=[(0.025, 0, 0)], **still)
    assert not refused and "no turn" in str(refused.error)
    (found,) = csi5300.bearings(room["rx"].log, baseline=(0.025, 0, 0, deg, sd_deg), **still)
    assert sorted((found.azimuth_deg, found.mirror_deg)) == pytest.approx([-53.13, 53.13], abs=2)
    cases: list[tuple[Any, str]] = [((0.025, 0), "three numbers"), ("x", "baseline"), ((0.025, 0, 0, 1, 2, 3), "three numbers")]
    for wrong, words in cases:
        with pytest.raises(csi5300.OptionError, match=words):
            csi5300.bearings(room["rx"].log, baseline=wrong, **still)
    with pytest.raises(csi5300.CaptureError, match="no record has the CSI of all named antennas"):
        csi5300.bearings(room["rx"].log[:0], baseline=(0.025, 0, 0), **still)
    of_two_robots: dict[str, Any] = {"camera_mount": (0, 0, 1), "range_change": True, "range_min": 2.0, "no_compensation": True}
    for name, value in (of_two_robots | {"without": ["alignment"]}).items():
        with pytest.raises(csi5300.OptionError, match=f"{name}: not allowed with baseline"):
            csi5300.bearings(room["rx"].log, baseline=(0.025, 0, 0), **still, **{name: value})


def test_a_baseline_is_of_the_antennas_in_their_order() -> None:
    room = csi5300.simulate("two-antennas")
    truth_deg = room.true_azimuth_deg("tx")
    # The robot turns at the origin: x, y and z of its path are 0.
    path = room["rx"].path
    assert path is not None
    cases: list[tuple[Any, Any]] = [("AB", (0.1, 0, 0)), ("B,A", (-0.1, 0, 0)), (["B", "A"], np.array([[-0.1, 0.0, 0.0]]))]
    for antennas, baseline in cases:
        (bearing,) = csi5300.bearings(
            room["rx"].log, trajectory=path, channel=108, antennas=antennas, baseline=baseline
        )
        assert bearing.azimuth_deg == pytest.approx(truth_deg, abs=1.5), antennas
    (own,) = room.bearings(antennas="AB", baseline=(0.1, 0, 0))
    assert own.azimuth_deg == pytest.approx(truth_deg, abs=1.5)
    with pytest.raises(csi5300.OptionError, match="antenna: 'B' is not A, which alone sends"):
        room.bearings(antenna="B")
    with pytest.raises(csi5300.OptionError, match="antenna A is named twice"):
        room.bearings(antennas="AA", baseline=(0.1, 0, 0))
    others: dict[str, Any] = {"camera_mount": np.zeros(3), "every": 0.0, "range_min": 0.0, "tx_trajectory": np.zeros((2, 4))}
    for name, value in others.items():
        with pytest.raises(csi5300.OptionError, match=f"{name}: not allowed with baseline"):
            room.bearings(antennas="AB", baseline=(0.1, 0, 0), rx="rx", **{name: value})


def test_stock_logs_in_memory_keep_senders_and_numbers(rx: Path) -> None:
    room = csi5300.simulate("lab-circle", layout="stock")
    rx_log, tx_log = room["rx"].log, room[[r.name for r in room if r.name != "rx"][0]].log
    assert room["rx"].path is not None
    (whole,) = csi5300.bearings(
        room["rx"].data, tx_log, trajectory=room["rx"].path, channel=room.channel, join_rows=True, rx_mac=room["rx"].mac
    )
    (held,) = csi5300.bearings(
        rx_log, tx_log, trajectory=room["rx"].path, channel=room.channel, join_rows=True, rx_mac=room["rx"].mac
    )
    assert held.azimuth_deg == whole.azimuth_deg or (not held and held.error == whole.error)
    assert held.answer["pairs"] == whole.answer["pairs"] > 100


def test_a_tree_is_evaluated() -> None:
    done: list[tuple[int, int]] = []
    result = csi5300.evaluate(CIRCLE, progress=lambda part, whole: done.append((part, whole)))
    assert done == [(1, 1)] and len(result) == 1 and not result.lost
    (row,) = result
    assert row["azimuth_deg"] == pytest.approx(120.5, abs=0.5) and abs(row["error_from_mean_pose_deg"]) < 2
    assert result.summary()["all"]["links"] == 1
    assert result.summary()["all"]["median"] == abs(row["error_from_mean_pose_deg"])
    swept = csi5300.evaluate(CIRCLE, sweep={"without": [[], ["near-field"]], "elevation_max": [0.0, 20.0]})
    assert [(r["option_without"], r["option_elevation_max"]) for r in swept] == [
        ([], 0.0),
        ([], 20.0),
        (["near-field"], 0.0),
        (["near-field"], 20.0),
    ]
    assert swept.rows[1]["azimuth_deg"] == row["azimuth_deg"]
    with pytest.raises(csi5300.OptionFileError, match="not a readable folder"):
        csi5300.evaluate(CIRCLE.parent / "none")
    with pytest.raises(csi5300.OptionError, match="no capture"):
        csi5300.evaluate(CIRCLE.parent.parent / "checks")
    with pytest.raises(csi5300.OptionError, match="nonsense"):
        csi5300.evaluate(CIRCLE, nonsense=1)


def test_a_folder_without_usual_names_is_evaluated(tmp_path: Path) -> None:
    names = {"csi_rx": "mine.dat", "csi_tx1": "tx1.dat", "rx_trajectory": "drive.csv", "groundtruth": "groundtruth_positions.json"}
    for file in CIRCLE.iterdir():
        for start, name in names.items():
            if file.name.startswith(start):
                (tmp_path / name).write_bytes(file.read_bytes())
    (row,) = csi5300.evaluate(tmp_path)
    (usual,) = csi5300.evaluate(CIRCLE)
    for name in ("azimuth_deg", "error_from_mean_pose_deg"):
        assert row[name] == usual[name], row
    assert (row["link"], row["capture"]) == ("tx1", tmp_path.name)


def test_an_evaluation_is_a_table() -> None:
    pytest.importorskip("pyarrow")
    result = csi5300.evaluate(CIRCLE, sweep={"to": [1.0, 2.0]})
    table = result.to_arrow()
    assert table.num_rows == 2 and table["option_to"].to_pylist() == [1.0, 2.0]
    assert table["azimuth_deg"].to_pylist() == [row["azimuth_deg"] for row in result]
    for library, frame in (("pandas", result.to_pandas), ("polars", result.to_polars)):
        pytest.importorskip(library)
        assert list(frame()["link"]) == [row["link"] for row in result], library


def test_tables_have_columns_of_one_kind() -> None:
    result = csi5300.evaluate(CIRCLE, sweep={"without": [None, "alignment", ["alignment", "one-way"]], "to": [1, 2.5]})
    said = [None, None, "alignment", "alignment", "alignment,one-way", "alignment,one-way"]
    rows = [{**row, "nowhere_deg": None} for row in result]
    result = csi5300.Evaluation(rows)
    for library, frame in (("pyarrow", result.to_arrow), ("polars", result.to_polars)):
        pytest.importorskip(library)
        table = frame()
        column = table["option_without"].to_pylist() if library == "pyarrow" else table["option_without"].to_list()
        assert column == said and table["nowhere_deg"].to_numpy().dtype == np.float64, library
    pytest.importorskip("pandas")
    table = result.to_pandas()
    assert table["nowhere_deg"].dtype == np.float64 and table["option_to"].dtype == np.float64
    assert len(table.groupby("option_without", dropna=False)) == 3
