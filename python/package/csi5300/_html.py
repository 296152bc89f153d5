"""A log in a notebook: the summary of ``csi5300 info``, and a small picture."""

from __future__ import annotations

import base64
import html
import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ._log import Log

WIDTH = 240


def png(grey: NDArray[np.uint8]) -> bytes:
    """A grey picture (rows, columns) as PNG."""
    rows, columns = grey.shape
    lines = b"".join(b"\0" + grey[row].tobytes() for row in range(rows))

    def part(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", zlib.compress(lines)) + part(b"IEND", b"")


def picture(log: Log) -> bytes:
    """Amplitude of the first antenna and stream over time (to the right) and subcarrier (upwards), dB, as PNG."""
    places = np.unique(np.linspace(0, len(log) - 1, min(WIDTH, len(log))).astype(np.int64))
    csi = log[places].csi
    power = np.abs(csi[:, 0, 0, :]) if csi.size else np.ones((1, 30), dtype=np.float32)
    level = 20 * np.log10(np.maximum(np.nan_to_num(power), 0.5))
    low, high = np.percentile(level, [2, 98])
    grey = np.clip((level - low) / max(float(high - low), 1e-6) * 255, 0, 255).astype(np.uint8)
    return png(np.ascontiguousarray(np.repeat(grey.T[::-1], 4, axis=0)))


def of_log(log: Log) -> str:
    """A table and a picture."""
    survey: dict[str, Any] = log.info["survey"]
    senders = ", ".join(f"{s['mac'] or 'unknown'} ({s['records']})" for s in log.info["senders"][:6])
    more = len(log.info["senders"]) - 6
    length = float(log.t[-1] - log.t[0]) if len(log) else 0.0
    host = str(log.host_time[0]) if len(log) and not np.isnat(log.host_time[0]) else "not known"
    lost = f"{survey['damages']} damaged stretches, {survey['damaged_bytes']} bytes; {survey['bad_bfee']} impossible records"
    shape = (len(log), len(log.antennas), log.streams, 30)
    rows = [
        ("frames", f"{len(log)} over {length:.3f} s, csi {shape}, antennas {log.antennas}"),
        ("of the log", f"{survey['records']} records, {survey['stock']} stock and {survey['wsr'] + survey['wsr_2021']} WSR with CSI"),
        ("senders", senders + (f" and {more} more" if more > 0 else "")),
        ("first frame at", host),
        ("missing before the log", f"{survey['bfee_missing']} by bfee_count"),
        ("lost in the log", lost if log.lost_something else "nothing"),
    ]
    if log.tail is not None:
        rows.append(("cut", f"in the middle of a record at byte {log.tail['offset']}"))
    cells = "".join(f"<tr><th style='text-align:left'>{k}</th><td>{html.escape(v)}</td></tr>" for k, v in rows)
    image = ""
    if len(log) and log.antennas:
        data = base64.b64encode(picture(log)).decode()
        title = "amplitude (dB) over time and subcarrier"
        image = f"<img style='width:{WIDTH}px;height:120px' alt='{title}' title='{title}' src='data:image/png;base64,{data}'>"
    return f"<div><b>{html.escape(log.name)}</b><table>{cells}</table>{image}</div>"
