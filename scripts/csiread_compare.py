"""Compares the output of examples/dump_csi, and `csi5300 export`, with csiread; see csiread_compare.sh."""

import os
import subprocess
import sys
import tempfile

import csiread
import numpy as np

HEAD = 6  # offset, timestamp_low, bfee_count, n_rx, n_tx, is_40_mhz


def is_stock(path):
    """True if the first bfee has the 20-byte header: csiread misreads the other layouts, so they are skipped."""
    data = open(path, "rb").read(70_000)
    at = 0
    while at + 21 <= len(data):
        length = int.from_bytes(data[at : at + 2], "big")
        if data[at + 2] == 0xBB:
            return length - 21 == int.from_bytes(data[at + 19 : at + 21], "little")
        at += 2 + length
    return False


def ours(dump, path):
    """Yields (head, raw, scaled, without spatial mapping) of each record, as [subcarrier][antenna][tx]."""
    with tempfile.NamedTemporaryFile() as out:
        subprocess.run([dump, path, out.name], check=True)
        values = np.fromfile(out.name, dtype="<f8")
    at = 0
    while at < len(values):
        head = values[at : at + HEAD]
        n_rx, n_tx = int(head[3]), int(head[4])
        size = 2 * 30 * n_rx * n_tx
        at += HEAD
        parts = [values[at + k * size : at + (k + 1) * size].view(np.complex128).reshape(30, n_rx, n_tx) for k in range(3)]
        at += 3 * size
        yield head, *parts


def error(a, b):
    """Largest difference, relative to the largest magnitude of b."""
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def export_agrees(program, path, theirs):
    """True if the arrays of `csi5300 export` equal csiread's: NumPy opens them, antennas are in order A, B, C."""
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "log.npz")
        # Status 3: the log is damaged before its end, and the rest was exported.
        if subprocess.run([program, "export", path, out], stderr=subprocess.DEVNULL).returncode not in (0, 3):
            return False
        arrays = np.load(out)
        csi, known = arrays["csi"], arrays["antennas_known"] == 1
        fields = ("timestamp_low", "bfee_count", "rate_n_flags", "agc", "rssi_a")
        names = ("timestamp_low", "bfee_count", "rate", "agc", "rssi_a")
        same = all(np.array_equal(arrays[a], getattr(theirs, b)) for a, b in zip(fields, names))
        for k in range(len(csi)):
            n_rx, n_tx = theirs.Nrx[k], theirs.Ntx[k]
            # Like csitool, csiread puts chain i into row perm[i] if the permutation is valid.
            rows = slice(0, n_rx) if not known[k] else sorted(theirs.perm[k, :n_rx] - (theirs.perm[k].min() > 0))
            same &= np.array_equal(csi[k, :, rows, :n_tx], theirs.csi[k, :, rows, :n_tx])
        return bool(same)


def compare(dump, program, path):
    theirs = csiread.Intel(path, nrxnum=3, ntxnum=3, pl_size=2000, if_report=False)
    theirs.read()
    scaled = theirs.get_scaled_csi()
    # Not get_scaled_csi_sm(): scaling one object twice adds the first scaling's total RSS to the second's (csiread 1.4.1).
    bare = theirs.apply_sm(scaled)
    records = list(ours(dump, path))
    if len(records) != theirs.count:
        print(f"{path}: {len(records)} records, csiread has {theirs.count}")
        return False
    raw_differ, worst_scaled, worst_bare, mapped = 0, 0.0, 0.0, 0
    for k, (head, raw, ours_scaled, ours_bare) in enumerate(records):
        n_rx, n_tx = raw.shape[1:]
        same = (theirs.timestamp_low[k], theirs.bfee_count[k], theirs.Nrx[k], theirs.Ntx[k]) == tuple(head[1:5])
        raw_differ += not (same and np.array_equal(raw, theirs.csi[k, :, :n_rx, :n_tx]))
        worst_scaled = max(worst_scaled, error(ours_scaled, scaled[k, :, :n_rx, :n_tx]))
        worst_bare = max(worst_bare, error(ours_bare, bare[k, :, :n_rx, :n_tx]))
        mapped += n_tx > 1
    exported = export_agrees(program, path, theirs)
    good = exported and raw_differ == 0 and worst_scaled <= 1e-6 and worst_bare <= 1e-6
    print(
        f"{os.path.basename(path)}: {len(records)} records ({mapped} with n_tx > 1): raw differs in {raw_differ}, scaled by"
        f" {worst_scaled:.1e}, without spatial mapping by {worst_bare:.1e}, NPZ {'same' if exported else 'DIFFERS'}: {'agree' if good else 'DISAGREE'}"
    )
    return good


def main():
    dump, program, logs = sys.argv[1], sys.argv[2], sys.argv[3:]
    stock = [path for path in logs if is_stock(path)]
    for path in logs:
        if path not in stock:
            print(f"{os.path.basename(path)}: not the stock layout, left out (csiread takes its header for CSI)")
    results = [compare(dump, program, path) for path in stock]
    if not results:
        print("nothing compared")
        sys.exit(2)
    sys.exit(0 if all(results) else 1)


main()
