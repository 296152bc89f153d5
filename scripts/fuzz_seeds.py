#!/usr/bin/env python3
"""First inputs of the fuzz targets (fuzz/corpus), from tests/fixtures and scenes of our simulator. scripts/fuzz.sh extends and reduces them."""
import pathlib
import struct

root = pathlib.Path(__file__).resolve().parent.parent
corpus = root / "fuzz/corpus"
fixture = root / "tests/fixtures/small-circle"


def seed(target: str, name: str, data: bytes) -> None:
    (corpus / target).mkdir(parents=True, exist_ok=True)
    (corpus / target / name).write_bytes(data)


def records(log: bytes):
    at = 0
    while at + 2 <= len(log):
        end = at + 2 + int.from_bytes(log[at : at + 2], "big")
        if end > len(log):
            return
        yield log[at:end]
        at = end


log = list(records(min(fixture.glob("*rx*.dat")).read_bytes()))
# An 802.11 frame as the sounding robots send it: data, three addresses, a number and a body.
frame = bytes.fromhex("08000000ffffffffffff00166e00000102000000000100000000000100") + bytes(range(30))
# The first byte of a stream is its chunk size.
seed("record_stream", "log", b"\x40" + b"".join(log[:4]))
mpdu = b"\xc1" + frame + b"\0\0\0\0"
seed("record_stream", "frames", b"\x07" + len(mpdu).to_bytes(2, "big") + mpdu + log[0])
seed("bfee", "wsr", log[0][3:])
wsr = log[0][3:]
seed("bfee", "stock", wsr[:20] + wsr[-(len(wsr) - 38) :])
message = log[0][2:]
connector = struct.pack("<IIIIHH", 5, 1, 1, 0, len(message), 0) + message
seed("connector", "message", struct.pack("<IHHII", 16 + len(connector), 3, 0, 1, 0) + connector)
radiotap = bytes.fromhex("000019006f08000000000000000000001002990900a0000000")
seed("frame", "radiotap", radiotap + frame)
seed("frame", "bare", frame)
seed("side_file", "narrow", struct.pack("<6I", 1_700_000_000, 1, 1_700_000_000, 2, 1_700_000_001, 3))
seed("side_file", "wide", struct.pack("<4q", 1_700_000_000, 1, 1_700_000_001, 2))
seed("side_file", "checked", b"csi5300 checks 1" + struct.pack("<qII", 1_700_000_000_000_000, 215, 7) + bytes(16))
event = lambda command, data: struct.pack("<QQIIIBBH", 1, 2, 0, 0, len(data), command, 0, len(data)) + data
pad = lambda event: bytes([(len(event) + 7) // 8]) + event + bytes(-len(event) % 8)
phy = bytes(range(36))
seed("stock", "alive", b"\0" + pad(event(1, b"")) + pad(event(0xC0, phy)) + pad(event(0xBB, wsr[:20] + wsr[-192:])))
item = struct.pack("<q", 1_700_000_000_000_000) + log[0]
message = b"c5r1" + struct.pack("<IQ", 1, 0) + item + item
poses = b"c5p2" + struct.pack("<IQ", 1, 0) + struct.pack("<Q5d", 0, 1.0, 2.0, 3.0, 0.0, 0.5)
seed("remote", "records", struct.pack("<H", len(message)) + message)
seed("remote", "poses", struct.pack("<H", len(poses)) + poses)
seed("sounding", "exchange", bytes([0, 5, 0, 0, 50, 5, 0, 3, 0, 1, 2, 3, 4, 1, len(frame)]) + frame + bytes([5, 0, 4, 1]))
seed("trajectory_csv", "rows", b"\n".join(min(fixture.glob("rx_trajectory*.csv")).read_bytes().splitlines()[:4]))
for scene in sorted((root / "scenes").glob("*.toml")):
    seed("scene", scene.stem, scene.read_bytes())
