"""Bearings from logs and a trajectory, and the profile behind one.

usage: python examples/python/bearings.py CHANNEL RX.dat TRAJECTORY.csv TX.dat...     (without: a simulated room)
"""

import sys

import csi5300

if len(sys.argv) > 4:
    channel, rx, trajectory, *tx = sys.argv[1:]
    found = csi5300.bearings(rx, tx, trajectory=trajectory, channel=channel)
else:
    found = csi5300.simulate("lab-circle").bearings()

for bearing in found:
    if not bearing:
        print(f"{bearing.link}: {bearing.error}")
        continue
    print(f"{bearing.link}: {bearing.azimuth_deg:.2f} +- {bearing.azimuth_sd_deg:.2f} deg, confidence {bearing.confidence:.2f}")
    profile = bearing.profile(azimuth=360, elevation=[0.0, 10.0, 20.0])
    row, column = divmod(int(profile.value.argmax()), profile.value.shape[1])
    print(f"  plane wave: best at {profile.azimuth_deg[row, column]:.0f} deg, elevation {profile.elevation_deg[row, column]:.0f}")
    try:
        bearing.plot().savefig(f"{bearing.link}.png")
        print(f"  picture: {bearing.link}.png")
    except ImportError as error:
        print(f"  no picture: {error}")
