"""A reader of logs in plain Python, after csitool's ``read_bf_file.m`` and ``bfee.c``: slow, obvious, and the oracle of the package."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass
class Packet:
    offset: int
    timestamp_low: int
    bfee_count: int
    n_rx: int
    n_tx: int
    rssi: tuple[int, int, int]
    noise: int
    agc: int
    antenna_sel: int
    rate: int
    csi: NDArray[np.complex128]
    """(30, n_rx, n_tx) by receive chain."""

    def scaled(self) -> NDArray[np.complex128]:
        """As in csitool's get_scaled_csi.m."""
        power = sum(10 ** (rssi / 10) for rssi in self.rssi if rssi)
        rss = 10 * np.log10(power) - 44 - self.agc
        scale = 10 ** (rss / 10) / (np.sum(np.abs(self.csi) ** 2) / 30)
        noise = -92.0 if self.noise == -127 else float(self.noise)
        total = 10 ** (noise / 10) + scale * self.n_rx * self.n_tx
        streams = {1: 1.0, 2: 2**0.5, 3: 10**0.225}[self.n_tx]
        result: NDArray[np.complex128] = self.csi * np.sqrt(scale / total) * streams
        return result


def packets(data: bytes, at: int = 0) -> Iterator[Packet]:
    """The 0xbb records of an undamaged log, from byte ``at`` on."""
    while at + 3 <= len(data):
        length = int.from_bytes(data[at : at + 2], "big")
        body = data[at + 3 : at + 2 + length]
        if data[at + 2] == 0xBB and len(body) == length - 1:
            yield packet(at, body)
        at += 2 + length


def packet(offset: int, body: bytes) -> Packet:
    n_rx, n_tx = body[8], body[9]
    payload = body[len(body) - int.from_bytes(body[16:18], "little") :]
    bits = int.from_bytes(payload, "little")
    csi = np.zeros((30, n_rx, n_tx), np.complex128)
    bit = 0
    for subcarrier in range(30):
        bit += 3
        for rx in range(n_rx):
            for tx in range(n_tx):
                re, im = (bits >> bit) & 0xFF, (bits >> (bit + 8)) & 0xFF
                csi[subcarrier, rx, tx] = complex(re - 256 * (re > 127), im - 256 * (im > 127))
                bit += 16
    return Packet(
        offset,
        int.from_bytes(body[0:4], "little"),
        int.from_bytes(body[4:6], "little"),
        n_rx,
        n_tx,
        (body[10], body[11], body[12]),
        int.from_bytes(body[13:14], "little", signed=True),
        body[14],
        body[15],
        int.from_bytes(body[18:20], "little"),
        csi,
    )


def by_antenna(packet: Packet, antennas: str) -> NDArray[np.complex128] | None:
    """(rows, n_tx, 30) as in a Log, nan if the record has no such antenna; None if the record does not name its antennas."""
    order = [(packet.antenna_sel >> shift) & 3 for shift in (0, 2, 4)][: packet.n_rx]
    if 3 in order or len(set(order)) < len(order):
        return None
    rows = np.full((len(antennas), packet.n_tx, 30), np.nan + 1j * np.nan)
    for chain, antenna in enumerate(order):
        rows[antennas.index("ABC"[antenna])] = packet.csi[:, chain, :].T
    return rows
