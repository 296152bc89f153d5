from __future__ import annotations

import copy
import io
import multiprocessing
import pickle
from pathlib import Path
from typing import Any

import csi5300
import numpy as np
import pytest
from conftest import CSITOOL
from oracle import by_antenna, packets


def test_every_field_equals_the_records(rx: Path) -> None:
    log = csi5300.read(rx)
    no_noise = np.ma.getmaskarray(log.noise)
    truth = list(packets(rx.read_bytes()))
    assert len(log) == len(truth) > 100
    assert log.csi.dtype == np.complex64 and log.csi.shape == (len(log), len(log.antennas), 1, 30)
    for k, packet in enumerate(truth):
        assert log.timestamp_low[k] == packet.timestamp_low
        assert log.bfee_count[k] == packet.bfee_count
        assert tuple(log.rssi[k]) == packet.rssi
        assert (log.agc[k], log.rate[k], log.offset[k]) == (packet.agc, packet.rate, packet.offset)
        assert log.noise.data[k] == packet.noise and bool(no_noise[k]) == (packet.noise == -127)
        rows = by_antenna(packet, log.antennas)
        assert rows is not None and np.array_equal(log.csi[k], rows, equal_nan=True)
    assert set(log.mac) == {"02:53:00:00:00:02"}
    assert not log.frame.mask.any() and log.antennas_known.all()
    assert list(log.subcarriers[[0, 14, 15, 29]]) == [-28, -1, 1, 28]
    # The logger was killed: the fixture ends inside a record.
    assert not log.lost_something and log.losses == [] and log.tail == {"offset": 65473, "bytes": 63, "expected": 233}


def test_the_clock_is_unwrapped(rx: Path) -> None:
    log = csi5300.read(rx)
    assert log.timestamp_low[0] > log.timestamp_low[-1], "the fixture's clock wraps"
    assert (np.diff(log.time_us) > 0).all() and log.t[0] == 0
    assert ((log.time_us - log.timestamp_low) % 2**32 == 0).all()
    host = log.host_time
    assert host.dtype == np.dtype("datetime64[us]") and str(host[0]).startswith("2023-11-14T22:13:2")


@pytest.mark.parametrize("path", CSITOOL, ids=lambda path: path.name)
def test_real_logs_equal_the_oracle(path: Path) -> None:
    data = path.read_bytes()
    log = csi5300.read(path)
    scaled = log.scaled()
    # Long logs at about 300 places: the oracle is slow.
    for k in range(0, len(log), max(1, len(log) // 300)):
        packet = next(packets(data, int(log.offset[k])))
        assert packet.offset == log.offset[k] and packet.timestamp_low == log.timestamp_low[k]
        rows = by_antenna(packet, log.antennas)
        if rows is None:
            assert not log.antennas_known[k]
            continue
        own = log.csi[k, :, : packet.n_tx]
        assert np.array_equal(own, rows, equal_nan=True), k
        assert np.isnan(log.csi[k, :, packet.n_tx :]).all()
        assert np.array_equal(log.present[k, :, : packet.n_tx], ~np.isnan(rows[:, :, 0]))
        assert not log.present[k, :, packet.n_tx :].any()
        if any(packet.rssi):
            theirs = np.nan_to_num(packet.scaled().transpose(1, 2, 0))
            ours = np.nan_to_num(scaled[k][np.isfinite(scaled[k])])
            assert np.sort_complex(ours) == pytest.approx(np.sort_complex(theirs.ravel()), rel=1e-5, abs=1e-6)


def test_all_sources_give_the_same_log(rx: Path) -> None:
    data = rx.read_bytes()
    log = csi5300.read(rx)
    with open(rx, "rb") as file:
        others = [csi5300.read(str(rx)), csi5300.read(data), csi5300.read(bytearray(data)), csi5300.read(file)]
    others.append(csi5300.read(io.BytesIO(data)))
    for other in others:
        assert np.array_equal(other.csi, log.csi) and np.array_equal(other.time_us, log.time_us)
        assert np.array_equal(other.host_time, log.host_time)


def test_filters(rx: Path) -> None:
    log = csi5300.read(rx)
    part = csi5300.read(rx, t=(0.5, 1.0))
    assert 0 < len(part) < len(log)
    assert np.array_equal(part.time_us, log.time_us[(log.t >= 0.5) & (log.t < 1.0)])
    assert len(csi5300.read(rx, macs="02:53:00:00:00:02")) == len(log)
    nobody = csi5300.read(rx, macs=["02:53:00:00:00:77"])
    assert len(nobody) == 0 and nobody.info["left_out"] == len(log) and nobody.csi.shape[0] == 0
    assert csi5300.read(rx, antennas="a").antennas == "A"
    for wrong in ({"macs": "nobody"}, {"t": (2.0, 1.0)}, {"t": (float("nan"), 1.0)}, {"antennas": "D"}):
        with pytest.raises(csi5300.OptionError):
            csi5300.read(rx, **wrong)  # type: ignore[arg-type, unused-ignore]


def test_pieces_add_up_to_the_whole(rx: Path) -> None:
    log = csi5300.read(rx)
    pieces = list(csi5300.scan(rx, chunk=64))
    assert [len(piece) for piece in pieces[:-1]] == [64] * (len(pieces) - 1)
    assert np.array_equal(np.concatenate([piece.csi for piece in pieces]), log.csi)
    assert np.array_equal(np.concatenate([piece.time_us for piece in pieces]), log.time_us)


def test_losses_after_the_last_record_are_reported(rx: Path) -> None:
    whole = csi5300.read(rx)
    n, end = len(whole), int(whole.offset[-1])
    clean = rx.read_bytes()[: 2 * end - int(whole.offset[-2])]
    for data in (clean + b"\xff" * 5000, rx.read_bytes(), b"It was a dark and stormy night. " * 200, clean[: end + 40], b""):
        log = csi5300.read(data)
        assert log.lost_something or log.tail or data == b""
        for chunk in (n + 1, n, n - 1):
            scanned = csi5300.scan(data, chunk=chunk)
            pieces = list(scanned)
            assert sum(map(len, pieces)) == len(log) and len(pieces) == max(1, -(-len(log) // chunk))
            for last in (pieces[-1], scanned):
                assert last.info == log.info and last.tail == log.tail
                assert (last.lost_something, last.losses) == (log.lost_something, log.losses)


@pytest.mark.parametrize("path", CSITOOL, ids=lambda path: path.name)
def test_pieces_have_the_shape_of_the_whole(path: Path) -> None:
    log = csi5300.read(path)
    with path.open("rb") as file:
        for source in (path, file):
            pieces = list(csi5300.scan(source, chunk=max(2, len(log) // 7)))
            assert {(piece.antennas, piece.streams) for piece in pieces} == {(log.antennas, log.streams)}
            assert np.array_equal(np.concatenate([piece.csi for piece in pieces]), log.csi, equal_nan=True)
    assert log[:0].csi.shape == log.csi[:0].shape and log[:2].csi.shape == log.csi[:2].shape
    part = pickle.loads(pickle.dumps(log[:2]))
    assert np.array_equal(part.csi, log.csi[:2], equal_nan=True)


def test_antennas_and_streams_are_as_requested(rx: Path) -> None:
    for log in (csi5300.read(rx, antennas="CA", streams=2), next(csi5300.scan(rx, antennas="CA", streams=2, chunk=9))):
        assert (log.antennas, log.streams, log.csi.shape[1:]) == ("AC", 2, (2, 2, 30))
        assert np.isnan(log.csi[:, :, 1]).all() and log.present[:, :, 1].sum() == 0

    class Once:
        """A file that cannot seek."""

        def __init__(self, data: bytes) -> None:
            self.read = io.BytesIO(data).read

    log = csi5300.read(rx)
    (piece,) = csi5300.scan(Once(rx.read_bytes()))  # type: ignore[arg-type]
    assert piece.csi.shape == (len(log), 3, 3, 30)
    assert np.array_equal(piece.csi[:, ["ABC".index(a) for a in log.antennas], : log.streams], log.csi, equal_nan=True)
    for wrong in ({"streams": 4}, {"streams": 1.5}, {"chunk": -1}, {"chunk": "many"}, {"t": (1,)}, {"t": [0, 1, 2]}, {"t": 5}):
        with pytest.raises(csi5300.OptionError, match=next(iter(wrong))):
            csi5300.scan(rx, **wrong)  # type: ignore[arg-type, unused-ignore]
    assert len(csi5300.read(rx, t=np.array([0.5, 1.0]))) == len(csi5300.read(rx, t=(0.5, 1)))  # type: ignore[arg-type]


def test_a_frame_has_one_time(rx: Path) -> None:
    log = csi5300.read(rx)
    part = csi5300.read(rx, t=(0.5, 1.0))
    chosen = (log.t >= 0.5) & (log.t < 1.0)
    assert np.array_equal(part.t, log.t[chosen]) and np.array_equal(log[chosen].t, part.t) and part.t[0] >= 0.5
    assert np.array_equal(np.concatenate([piece.t for piece in csi5300.scan(rx, chunk=50)]), log.t)
    assert np.array_equal(pickle.loads(pickle.dumps(part)).t, part.t)


def test_masked_indices_select_no_masked_frame(rx: Path) -> None:
    log = csi5300.read(rx)
    masked = np.ma.masked_array(np.ones(len(log), bool), mask=np.arange(len(log)) >= 5)
    assert len(log[masked]) == 5
    nothing = np.ma.masked_array(log.agc, mask=True)
    assert len(log[nothing < 255]) == 0 and len(log[np.ma.masked_array([3, 4], mask=[True, False])]) == 1


def test_invalid_indices_are_refused(rx: Path) -> None:
    log = csi5300.read(rx)
    assert len(log[[]]) == 0 and len(csi5300.read(b"")[[]]) == 0
    third: Any = np.array(3)
    assert log[third].offset == log.offset[3]
    wrong: list[Any] = [np.zeros((2, 2), int), True, 1.5, [1.5], "a", None]
    for index in wrong:
        with pytest.raises(IndexError, match="a log takes"):
            log[index]


def test_senders_have_their_octets(rx: Path) -> None:
    log = csi5300.read(rx)
    octets = np.random.default_rng(1).choice(np.array([0, 1, 0x80, 0xFF], np.uint8), size=(len(log), 6))
    octets[::7] = 0
    other = csi5300.Log(log._records, {**log._columns, "mac": octets}, log.info)
    assert other.mac.tolist() == [bytes(row).hex(":") if row.any() else "" for row in octets]
    assert log[:0].mac.tolist() == [] and log[:0].mac.dtype == log.mac.dtype


def test_frames_are_compared_by_identity(rx: Path) -> None:
    log = csi5300.read(rx)
    first, again = log[0], log[0]
    assert first == first and first != again and len({first, again}) == 2


def test_slices_masks_and_frames(rx: Path) -> None:
    log = csi5300.read(rx)
    for index in (slice(10, 20), slice(None, None, -3), np.array([5, 1, 5]), log.rssi[:, 0] > np.median(log.rssi[:, 0])):
        part = log[index]
        assert np.array_equal(part.csi, log.csi[index]) and np.array_equal(part.time_us, log.time_us[index])
        assert np.array_equal(part.scaled(), log.scaled()[index], equal_nan=True)
    assert np.array_equal(log[20:40][5:10].csi, log.csi[25:30])
    frame = log[-1]
    assert frame.time_us == log.time_us[-1] and frame.mac == "02:53:00:00:00:02" and frame.frame == log.frame[-1]
    assert np.array_equal(frame.csi, log.csi[-1])
    frames = list(log)
    assert len(frames) == len(log) and all(np.array_equal(f.csi, h) for f, h in zip(frames, log.csi, strict=True))
    with pytest.raises(IndexError):
        log[len(log)]


def test_pickle_and_copy(rx: Path) -> None:
    log = csi5300.read(rx)[7:300]
    for other in (pickle.loads(pickle.dumps(log)), copy.copy(log), copy.deepcopy(log)):
        assert np.array_equal(other.csi, log.csi) and np.array_equal(other.mac, log.mac)
        assert other.name == log.name and repr(other) == repr(log)


def _decode(path: str) -> float:
    return float(np.abs(csi5300.read(path).csi).sum())


def test_reading_continues_in_a_fork(rx: Path) -> None:
    here = _decode(str(rx))
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map(_decode, [str(rx)] * 4) == [here] * 4


def test_damage_is_counted_not_raised(rx: Path) -> None:
    data = bytearray(rx.read_bytes())
    whole = csi5300.read(bytes(data))
    at = int(whole.offset[20])
    data[at : at + 10] = b"\xff" * 10
    log = csi5300.read(bytes(data))
    assert len(whole) - 3 <= len(log) < len(whole)
    assert log.lost_something and log.losses[0].offset <= at < log.losses[0].offset + log.losses[0].bytes
    assert log.losses[0].reason and log.info["survey"]["damages"] >= 1
    assert csi5300.read(b"").csi.shape[0] == 0
    assert csi5300.read(rx.read_bytes()[: int(whole.offset[50])]).tail is None


def test_html_has_the_log_and_a_picture(rx: Path) -> None:
    text = csi5300.read(rx)._repr_html_()
    assert "csi_rx_" in text and "data:image/png;base64," in text and "02:53:00:00:00:02" in text
    assert "nothing" in csi5300.read(b"")._repr_html_()


def test_memory_is_filled_once(rx: Path) -> None:
    log = csi5300.read(rx)
    assert log.csi is log.csi and log.csi.flags.c_contiguous and log.csi.flags.writeable
    assert np.array_equal(log.scaled(), log.csi * log.scale.astype(np.float32)[:, None, None, None], equal_nan=True)
    assert log.nbytes < log.csi.nbytes * 2


def test_memory_is_reused(rx: Path) -> None:
    log = csi5300.read(rx)
    out = np.full(log.csi.shape, 7, np.complex64)
    assert log.scaled(out=out) is out and np.array_equal(out, log.scaled(), equal_nan=True)
    assert log[:10].raw(out=out[:10]).base is out and np.array_equal(out[:10], log.csi[:10], equal_nan=True)
    shape = log.csi.shape
    wrong = [np.zeros(shape, np.complex128), np.zeros(shape[1:], np.complex64), np.zeros((1, *shape[1:]), np.complex64)]
    frozen = np.zeros(shape, np.complex64)
    frozen.flags.writeable = False
    for array in [*wrong, np.zeros(shape[::-1], np.complex64).T, frozen, "memory"]:
        with pytest.raises(csi5300.OptionError, match="out"):
            log.scaled(out=array)  # type: ignore[arg-type]


def test_a_long_log_equals_its_pieces(rx: Path, tmp_path: Path) -> None:
    # Several blocks of memory, with damage: read by two threads at once, and by one, step by step.
    whole = rx.read_bytes()[: int(csi5300.read(rx).offset[-1])]
    data = bytearray(whole * (20_000_000 // len(whole)))
    for at in range(40_000 * 233, 40_400 * 233, 2 * 233):
        data[at] = 0x55
    (tmp_path / "long.dat").write_bytes(data)
    log = csi5300.read(tmp_path / "long.dat")
    pieces = list(csi5300.scan(io.BytesIO(data), chunk=10_000))
    assert len(log) > 80_000 and log.info["survey"]["damages"] > 100
    assert log.info["survey"] == pieces[-1].info["survey"] and log.info["senders"] == pieces[-1].info["senders"]
    for name in ("time_us", "offset", "rssi", "agc", "frame", "mac", "bfee_count"):
        assert np.array_equal(getattr(log, name), np.concatenate([getattr(piece, name) for piece in pieces])), name
    assert np.array_equal(log.scaled(), np.concatenate([piece.scaled() for piece in pieces]), equal_nan=True)
    assert (log.antennas, log.streams) == (log[:].antennas, log[:].streams)
    few = csi5300.read(bytes(data), t=(0.5, 0.75))
    assert 0 < len(few) < len(log) // 4
    assert np.array_equal(few.csi, log[(log.t >= 0.5) & (log.t < 0.75)].csi, equal_nan=True)
