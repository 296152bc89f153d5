"""Compares csi-formats' reading of other cards' logs with CSIKit and csiread, element by element.

formats.py PROGRAM FOLDER: PROGRAM prints one line per frame (crates/csi-formats/examples/frames.rs).
"""
import os
import subprocess
import sys

import numpy as np

program, folder = sys.argv[1:3]
failed = []


def ours(name):
    """Frames of a log: known fields as text, CSI of shape (rx, tx, subcarrier)."""
    lines = subprocess.run([program, os.path.join(folder, name), "--csi"], check=True, capture_output=True, text=True).stdout
    for line in lines.splitlines():
        words = line.split()
        keys = "offset clock slow_clock host sender kind width n_rx n_tx n measured first_rx rssi".split()
        head = dict(zip(keys, words))
        flat = np.array(words[len(keys):], float)
        shape = [int(head[key]) for key in ("n_rx", "n_tx", "n")]
        yield head, (flat[0::2] + 1j * flat[1::2]).reshape(shape)


def report(name, oracle, compared, wrong, remark=""):
    print(f"| `{name}` | {oracle} | {compared} | {wrong} | {remark} |")
    if wrong or not compared:
        failed.append(name)


def compare(name, oracle, theirs, mine=lambda csi: csi, remark=""):
    """`theirs` are arrays of (rx, tx, subcarrier), one per frame, None where the oracle has none."""
    frames = list(ours(name))
    pairs = [(mine(csi), other) for (_, csi), other in zip(frames, theirs) if other is not None]
    wrong = sum(a.shape != np.shape(b) or not np.allclose(a, b) for a, b in pairs)
    if len(frames) != len(theirs):
        remark += f"; {len(frames)} frames, there {len(theirs)}"
    report(name, oracle, len(pairs), wrong, remark)
    return frames


def feitcsi():
    from CSIKit.reader import FeitCSIBeamformReader
    for file in sorted(os.listdir(os.path.join(folder, "feitcsi"))):
        name = f"feitcsi/{file}"
        data = FeitCSIBeamformReader().read_file(os.path.join(folder, name), interpolate=False)
        theirs = [frame.csi_matrix.transpose(1, 2, 0) for frame in data.frames]
        frames = compare(name, "CSIKit", theirs)
        for (head, _), frame in zip(frames, data.frames):
            known = int(head["clock"]), int(head["slow_clock"]), head["width"]
            if known != (frame.ftm_clock, frame.mu_clock, frame.channel_width):
                failed.append(f"{name}: head {head}")
            if [int(x) for x in head["rssi"].split(",")] != [-frame.rssi_1, -frame.rssi_2]:
                failed.append(f"{name}: rssi {head}")


def packets(path):
    """Sizes of the packets of a pcap."""
    data, at = open(path, "rb").read(), 24
    while at < len(data):
        size = int.from_bytes(data[at + 8:at + 12], "little")
        yield size
        at += 16 + size


def nexmon():
    from CSIKit.reader import NEXBeamformReader
    for file, chip in (("example_43455c0.pcap", "43455c0"), ("example_4358.pcap", "4358")):
        name = f"nexmon/{file}"
        reader = NEXBeamformReader(fill_skipped_frames=False)
        # One frame per datagram, as in csi-formats: CSIKit's own batches lose frames after a change of sequence number.
        frames = []
        from CSIKit.reader.readers.read_pcap import Pcap
        pcap = Pcap(os.path.join(folder, name))
        pcap.read()
        reader.scaled, reader.chip = False, ""
        for packet in pcap.frames:
            frames.append(reader.read_bfee(packet, pcap.bandwidth).csi_matrix.reshape(1, 1, -1))
        ethernet = 14 + 20 + 8 + 18 + 4 * 256
        with_fcs = [k for k, size in enumerate(packets(os.path.join(folder, name))) if size != ethernet]
        for k in with_fcs:
            frames.insert(k, None)
        compare(name, "CSIKit", frames, remark=f"{len(with_fcs)} packets with 4 bytes behind the datagram, which it skips")
        import csiread
        theirs = csiread.Nexmon(os.path.join(folder, name), chip=chip, bw=80)
        theirs.read()
        compare(name, "csiread", [csi.reshape(1, 1, -1) for csi in theirs.csi])


def esp32():
    from CSIKit.reader import CSVBeamformReader
    # CSIKit takes the first number, which is the imaginary part (ESP-IDF), for the real one.
    swapped = lambda csi: csi.imag + 1j * csi.real
    data = CSVBeamformReader().read_file(os.path.join(folder, "esp32/example_data.csv"))
    theirs = [frame.csi_matrix.reshape(1, 1, -1) for frame in data.frames]
    compare("esp32/example_data.csv", "CSIKit", theirs, swapped, "it takes the imaginary part for the real one")
    import csiread
    theirs = csiread.ESP32(os.path.join(folder, "esp32/example_csi.csv"), False)
    theirs.read()
    # csiread (x[::2] imaginary) agrees with ESP-IDF.
    compare("esp32/example_csi.csv", "csiread", [csi.reshape(1, 1, -1) for csi in theirs.csi])


def atheros():
    import csiread
    name = "atheros/ath_csi_1.dat"
    theirs = csiread.Atheros(os.path.join(folder, name), nrxnum=3, ntxnum=2, tones=56, if_report=False)
    theirs.read()
    frames = list(ours(name))
    # csiread fills [rx][tx] with tx fastest; in the tool's own reader (read_csi.c) and CSIKit rx is fastest.
    arrays = [
        csi[:, :nr, :nc].reshape(-1, nc, nr).transpose(2, 1, 0) for csi, nr, nc in zip(theirs.csi, theirs.nr, theirs.nc)
    ]
    with_csi = [csi for csi, n in zip(arrays, theirs.csi_len) if n > 0]
    compare(name, "csiread", with_csi, remark="it takes the receive chains for the streams")
    clocks = [int(head["clock"]) for head, _ in frames]
    if clocks != [int(t) for t, n in zip(theirs.timestamp, theirs.csi_len) if n > 0]:
        failed.append(f"{name}: clocks")
    from CSIKit.reader import ATHBeamformReader
    data = ATHBeamformReader().read_file(os.path.join(folder, name))
    plus_one = [frame.csi_matrix.transpose(2, 1, 0) - (1 + 1j) for frame in data.frames]
    compare(name, "CSIKit", plus_one, remark="it adds 1 to each part")


def picoscenes():
    # CSIKit's reader, element by element, without its frames (which fail with current NumPy: `np.complex`).
    np.complex = complex
    from CSIKit.reader.readers.read_pico import PicoScenesBeamformReader as Reader
    from CSIKit.reader.readers.pico.AbstractPicoScenesFrameSegment import AbstractPicoScenesFrameSegment as Segment
    from CSIKit.reader.readers.pico.CSISegment import CSISegment
    for file in ("picoscenes_ax200_example.csi", "rx_by_iwl5300.csi"):
        name, theirs = f"picoscenes/{file}", []
        data = open(os.path.join(folder, name), "rb").read()
        at = 0
        while at < len(data):
            length, frame = Reader.get_block(data, at)
            if len(frame) != length:
                break
            inner, csi = 11, None
            for _ in range(frame[10]):
                size, block = Reader.get_block(frame, inner)
                segment = Segment(block)
                if segment.subsegmentName == "CSI":
                    csi = CSISegment(frame[inner + segment.pos:inner + size], segment.subsegmentVersion)
                inner += size
            at += length
            if csi is not None:
                array = csi.parsed_csi.transpose(1, 2, 0)
                if csi.deviceType == 0x5300 and csi.numRx == 3:
                    # CSIKit sorts three chains of a 5300 by antenna: back to the card's order.
                    array = array[[csi.antSelByte >> shift & 3 for shift in (0, 2, 4)]]
                theirs.append(array)
        compare(name, "CSIKit", theirs)


print("| log | beside | frames | different | |\n|---|---|---|---|---|")
for check in (feitcsi, nexmon, esp32, atheros, picoscenes):
    check()
if failed:
    sys.exit(f"different: {failed}")
