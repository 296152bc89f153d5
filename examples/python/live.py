"""Listens for three seconds: to this machine's card, or to a robot of a served room, and prints rate and RSSI of each sender.

usage: python examples/python/live.py [PATH#ROBOT]
       docs/guides/tutorial.md has a served room and two robots that sound each other in it: room.sock#rx
"""

import asyncio
import sys
from collections import Counter

import csi5300


async def listen(stream: csi5300.Stream) -> None:
    async for log in stream:
        seen = Counter(log.mac.tolist())
        for mac, frames in seen.items():
            rssi = log.rssi[log.mac == mac, 0].mean()
            print(f"{mac or 'unknown'}: {frames} frames, RSSI at A {rssi:.1f} dB, newest {log.host_time[-1]}")
        await asyncio.sleep(0.5)


async def main() -> None:
    with csi5300.Stream(sys.argv[1] if len(sys.argv) > 1 else None) as stream:
        try:
            await asyncio.wait_for(listen(stream), timeout=3)
        except asyncio.TimeoutError:
            print(f"{stream.info['survey']['records']} records in all")


asyncio.run(main())
