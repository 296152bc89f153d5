#!/usr/bin/env python3
"""Runs FINUFFT (one thread, plans kept), a vectorised double loop in C, and NumPy on the samples of `cargo bench --bench pareto`.

Arguments: job (planar, azimuth, helix), packets, radius, samples.bin, reference.bin.
Prints lines of: method, eps, milliseconds (fastest of many), largest error of F / max F.
For level motion FINUFFT gets only the 32,760 directions of the upper hemisphere and the horizon.
"""
import ctypes
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
import finufft  # noqa: E402
import numpy as np  # noqa: E402


def quickest(call, budget_s=1.0, least=5):
    best, spent, rounds = np.inf, 0.0, 0
    while rounds < least or (spent < budget_s and rounds < 500):
        start = time.thread_time()
        call()
        took = time.thread_time() - start
        best, spent, rounds = min(best, took), spent + took, rounds + 1
        if spent > 8 * budget_s and rounds >= 2:
            break
    return best * 1e3


def first(timing):
    return timing[0]


def compiled():
    """The double loop of benches/peers, compiled by this machine's gcc; None without gcc."""
    source = pathlib.Path(__file__).parent.parent / "benches/peers/double_loop.c"
    gcc = shutil.which("gcc")
    if not gcc:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = f"{folder}/double_loop.so"
        options = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
        subprocess.run([gcc, *options, "-o", library, source, "-lmvec", "-lm"], check=True)
        return ctypes.CDLL(library)


def main():
    job, packets = sys.argv[1], int(sys.argv[2])
    x, y, z, re, im = np.fromfile(sys.argv[4]).reshape(-1, 5).T.copy()
    values = re + 1j * im
    elevations = [0.0] if job == "azimuth" else np.radians(np.arange(181) - 90.0)
    el, az = np.meshgrid(elevations, np.radians(np.arange(360) - 180.0), indexing="ij")
    reference = np.fromfile(sys.argv[5])
    u = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)]).reshape(3, -1)
    keep = slice(None) if job != "planar" else slice(90 * 360, None)
    u, reference_kept, top = u[:, keep], reference[keep], reference.max()

    def report(who, eps, ms, f):
        error = np.abs(np.abs(f) ** 2 - reference_kept).max() / top
        print(f"{who},{eps:.0e},{ms:.5f},{error:.3e}")

    dim = 3 if job == "helix" else 2
    positions, directions = [x, y, z][:dim], u[:dim]
    for real, cplx, tolerances in (
        ("float32", "complex64", (1e-3, 1e-4, 1e-5)),
        ("float64", "complex128", (1e-6, 1e-9, 1e-12)),
    ):
        p = [np.ascontiguousarray(c, real) for c in positions]
        d = [np.ascontiguousarray(c, real) for c in directions]
        v = values.astype(cplx)
        for eps in tolerances:
            if job == "helix" and packets > 3000 and eps in (1e-4, 1e-9):
                continue
            # The user can choose the oversampling: each at its best.
            fresh, kept = [], []
            for factor in (2.0, 1.25):
                plan = finufft.Plan(3, dim, eps=eps, isign=-1, dtype=cplx, nthreads=1, upsampfac=factor)

                def anew():
                    plan.setpts(*p, *([None] * (3 - dim)), *d)
                    return plan.execute(v)

                fresh.append((quickest(anew), factor, anew()))
                kept.append((quickest(lambda: plan.execute(v)), factor, plan.execute(v)))
            for note, (ms, factor, f) in (("", min(fresh, key=first)), (" unchanged", min(kept, key=first))):
                report(f"FINUFFT {real[5:]}-bit{note}:{factor}", eps, ms, f)
    library = compiled()
    # A part of the grid, scaled up, as for the naive loop.
    part = slice(None, None, max(1, u.shape[1] * packets // 20_000_000))
    for name, real in (("f64", np.float64), ("f32", np.float32)) if library else ():
        columns = [np.ascontiguousarray(c, real) for c in (x, y, z, re, im)]
        some = np.ascontiguousarray(u[:, part], real)
        power = np.empty(some.shape[1], real)
        call = getattr(library, f"profile_{name}")
        pointers = [c.ctypes.data_as(ctypes.c_void_p) for c in columns]
        ends = [ctypes.c_long(packets), some.ctypes.data_as(ctypes.c_void_p), ctypes.c_long(some.shape[1])]
        ms = quickest(lambda: call(*pointers, *ends, power.ctypes.data_as(ctypes.c_void_p)), 0.5, 3)
        error = np.abs(power - reference_kept[part]).max() / top
        print(f"double loop vectorised {name},0,{ms * u.shape[1] / some.shape[1]:.5f},{error:.3e}")
    if packets * u.shape[1] <= 4e7:

        def blocked():
            block = max(1, int(4e6 // packets))
            out = [np.exp(-1j * (u[:, i : i + block].T @ np.array([x, y, z]))) @ values
                   for i in range(0, u.shape[1], block)]
            return np.concatenate(out)

        report("NumPy", 1e-15, quickest(blocked, 0.1, 2), blocked())


main()
