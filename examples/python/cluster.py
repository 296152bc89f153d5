"""Evaluates a tree of captures on a Ray cluster (or threads, where Ray is not installed), with a sweep over one option.

usage: python examples/python/cluster.py FOLDER|s3://BUCKET/PREFIX
"""

import statistics
import sys

import csi5300.ray

if len(sys.argv) < 2:
    sys.exit(__doc__)
result = csi5300.ray.evaluate(
    sys.argv[1],
    sweep={"without": [[], ["near-field"]]},
    progress=lambda done, of: print(f"\r{done} of {of} captures", end="", file=sys.stderr),
)
print(file=sys.stderr)
for left_out in ([], ["near-field"]):
    errors = [
        abs(row["error_from_mean_pose_deg"])
        for row in result
        if row.get("option_without") == left_out and row.get("error_from_mean_pose_deg") is not None
    ]
    if errors:
        print(f"without {left_out}: {len(errors)} links, median {statistics.median(errors):.2f} deg, largest {max(errors):.1f}")
for row in result:
    if row.get("error"):
        print(f"{row['link']}: {row['error']}")
