"""Reads a log: its content, its losses, its CSI as an array, and the same piece by piece.

usage: python examples/python/reading.py [LOG.dat]     (without one: a simulated log)
"""

import sys

import csi5300
import numpy as np

source: str | bytes = sys.argv[1] if len(sys.argv) > 1 else csi5300.simulate("lab-circle")["rx"].data

log = csi5300.read(source)
print(log)
if not len(log):
    sys.exit(f"no frame; lost: {log.losses}")
print(f"{log.t[-1]:.1f} s, senders {sorted(set(log.mac.tolist()))}, RSSI at A {log.rssi[:, 0].mean():.1f} dB")
for loss in log.losses:
    print(f"lost: {loss.bytes} bytes at {loss.offset}: {loss.reason}")

h = log.scaled()  # (n, n_rx, n_tx, 30), sqrt(SNR)
print(f"median SNR of the first antenna: {20 * np.log10(np.nanmedian(np.abs(h[:, 0]))):.1f} dB")

second = csi5300.read(source, t=(1.0, 2.0))
print(f"frames in the second second: {len(second)}")
for frame in second[:1]:
    print(f"  the first: {frame.host_time} from {frame.mac}")

pieces = csi5300.scan(source, chunk=512)
power = [np.nanmean(np.abs(piece.csi) ** 2) for piece in pieces]
print(f"mean power in pieces of 512 frames: {np.round(power, 1)}, lost something: {pieces.lost_something}")
