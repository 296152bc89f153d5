"""Data sets of many captures on a Ray cluster: :func:`evaluate`, :func:`convert`. Without Ray: threads of this machine.

A task is one capture (or one log). A task whose node is lost is done again by Ray; each task gives its rows once, by its place in
the list, so nothing is counted twice. Files come from anywhere that fsspec reads: a capture's files are fetched by the task that
needs them, into a folder that goes with it.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import _native
from ._errors import Error, OptionError
from ._evaluate import Capture, Evaluation, combinations, find, joined, one
from ._log import scan

__all__ = ["Converted", "convert", "evaluate", "sweep"]

Progress = Callable[[int, int], None]
RETRIES = 8
"""Times that Ray does a task again whose node or process was lost."""


def _remote(uri: str) -> tuple[Any, str]:
    """fsspec's file system and the path in it."""
    try:
        import fsspec
    except ImportError as error:
        raise ImportError(f"{uri}: other places than local folders need fsspec: pip install fsspec") from error
    found: tuple[Any, str] = fsspec.core.url_to_fs(uri)
    return found


def _is_local(uri: str) -> bool:
    return "://" not in uri


@dataclass(frozen=True)
class _Remote:
    """A capture whose files are elsewhere."""

    uri: str
    capture: Capture
    files: list[str]

    def evaluate(
        self, runs: Sequence[Mapping[str, Any]], swept: Sequence[str], cancel: _native.Cancel | None
    ) -> Evaluation:
        with tempfile.TemporaryDirectory(prefix="csi5300-") as folder:
            system, _ = _remote(self.uri)
            for file in self.files:
                system.get_file(file, os.path.join(folder, posixpath.basename(file)))
            local = [(name, os.path.join(folder, posixpath.basename(log))) for name, log in self.capture.transmitters]
            return one(replace(self.capture, folder=folder, transmitters=local), runs, swept, cancel)


def _find_remote(uri: str) -> list[_Remote]:
    """Captures by the same names as :func:`csi5300._evaluate.find` gives below a local folder."""
    system, root = _remote(uri)
    folders: dict[str, list[str]] = {}
    for file in system.find(root):
        folders.setdefault(posixpath.dirname(file), []).append(file)
    found = []
    for folder, files in folders.items():
        names = {posixpath.basename(file): file for file in files}
        if "groundtruth_positions.json" not in names:
            continue
        place = posixpath.relpath(folder, root.rstrip("/"))
        logs = [match for name in names if (match := re.fullmatch(r"csi_(rx|tx\d+)_(.+)\.dat", name))]
        for stamp in sorted({match[2] for match in logs}):
            transmitters = sorted((m[1], names[m[0]]) for m in logs if m[2] == stamp and m[1] != "rx")
            own = [file for name, file in names.items() if stamp in name or name == "groundtruth_positions.json"]
            capture = Capture("" if place == "." else place, stamp, folder, transmitters)
            found.append(_Remote(uri, capture, own))
    return sorted(found, key=lambda remote: (remote.capture.place, remote.capture.stamp))


def _evaluate_task(
    task: Capture | _Remote,
    runs: Sequence[Mapping[str, Any]],
    swept: Sequence[str],
    cancel: _native.Cancel | None = None,
) -> Evaluation:
    try:
        return task.evaluate(runs, swept, cancel) if isinstance(task, _Remote) else one(task, runs, swept, cancel)
    except OSError as error:
        capture = task.capture if isinstance(task, _Remote) else task
        row = {"link": capture.name, "capture": capture.name, "azimuth_deg": None, "error": str(error)}
        return Evaluation([row], lost=True)


def _ray(use_ray: bool | None) -> Any:
    """The module ray, connected; None for threads."""
    if use_ray is False:
        return None
    try:
        import ray
    except ImportError:
        if use_ray:
            raise ImportError("Ray is not installed: pip install 'ray[default]', or use_ray=False for threads") from None
        return None
    if not ray.is_initialized():
        ray.init(log_to_driver=False, configure_logging=False)
    return ray


def _on_ray(ray: Any, work: Callable[..., Any], tasks: Sequence[Any], rest: tuple[Any, ...], cpus: float) -> Iterator[tuple[int, Any]]:
    """Results as they come, with the place of their task; each once."""
    remote = ray.remote(num_cpus=cpus, max_retries=RETRIES)(work)
    shared = [ray.put(value) for value in rest]
    limit = max(int(ray.cluster_resources().get("CPU", 1) / max(cpus, 0.01)), 1) * 4
    waiting: dict[Any, int] = {}
    places = iter(enumerate(tasks))
    try:
        while True:
            # A few tasks for each core wait in the cluster, the others here: millions of them cost no memory.
            while len(waiting) < limit and (following := next(places, None)) is not None:
                place, task = following
                waiting[remote.remote(task, *shared)] = place
            if not waiting:
                return
            done, _ = ray.wait(list(waiting), num_returns=1)
            for reference in done:
                yield waiting.pop(reference), ray.get(reference)
    finally:
        # After an interrupt or a task's own mistake: nobody waits for the others.
        for reference in waiting:
            ray.cancel(reference)


def _on_threads(work: Callable[..., Any], tasks: Sequence[Any], rest: tuple[Any, ...], workers: int | None) -> Iterator[tuple[int, Any]]:
    cancel = _native.Cancel()
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        futures = {pool.submit(work, task, *rest, cancel=cancel): place for place, task in enumerate(tasks)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            cancel.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _all(
    work: Callable[..., Any],
    tasks: Sequence[Any],
    rest: tuple[Any, ...],
    use_ray: bool | None,
    workers: int | None,
    cpus: float,
    progress: Progress | None,
) -> list[Any]:
    ray = _ray(use_ray)
    results = _on_threads(work, tasks, rest, workers) if ray is None else _on_ray(ray, work, tasks, rest, cpus)
    by_place: dict[int, Any] = {}
    for place, result in results:
        by_place[place] = result
        if progress is not None:
            progress(len(by_place), len(tasks))
    return [by_place[place] for place in range(len(tasks))]


def evaluate(
    uri: str | os.PathLike[str],
    *,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    use_ray: bool | None = None,
    workers: int | None = None,
    cpus_per_task: float = 1,
    progress: Progress | None = None,
    **options: Any,
) -> Evaluation:
    """:func:`csi5300.evaluate` of a folder or of a place that fsspec knows (``s3://bucket/prefix``), a task a capture.

    ``use_ray``: None for Ray where it is installed (a cluster that was joined by ``ray.init``, else this machine), False for threads.
    ``sweep``: all its combinations are evaluated by the task that fetched the capture, from files read once. A capture that fails is a row with its
    ``error``. The rows are in the order of the captures, whoever was done first, and those of :func:`csi5300.evaluate`.
    """
    uri = os.fspath(uri)
    runs = combinations(options, sweep)
    tasks: list[Capture] | list[_Remote]
    tasks, unreadable = find(uri) if _is_local(uri) else (_find_remote(uri), [])
    if not tasks:
        raise OptionError(f"no capture below {uri}: a capture is a folder with groundtruth_positions.json and csi_rx_TS.dat")
    if use_ray is not False or workers is not None:
        # One capture a core: its links one after the other, unless that was asked for.
        runs = [{"threads": max(int(cpus_per_task), 1), **run} for run in runs]
    parts = _all(_evaluate_task, tasks, (runs, list(sweep or ())), use_ray, workers, cpus_per_task, progress)
    return joined(parts, unreadable)


def sweep(uri: str | os.PathLike[str], options: Mapping[str, Sequence[Any]], **rest: Any) -> Evaluation:
    """:func:`evaluate` with every combination of ``options``: ``sweep(uri, {"elevation_max": [0, 20]})``."""
    return evaluate(uri, sweep=options, **rest)


@dataclass(frozen=True)
class Converted:
    """What became of a log."""

    log: str
    """Its place below the folder that was converted."""
    parts: list[str]
    """The Parquet files that were written."""
    frames: int
    lost_something: bool
    error: str | None = None


def _convert_task(
    file: str, uri_in: str, uri_out: str, chunk: int, scaled: bool, cancel: _native.Cancel | None = None
) -> Converted:
    source, root = (None, uri_in) if _is_local(uri_in) else _remote(uri_in)
    place = posixpath.relpath(file, root.rstrip("/")) if source is not None else Path(file).relative_to(root).as_posix()
    done = Converted(place, [], 0, False)
    try:
        with tempfile.TemporaryDirectory(prefix="csi5300-") as folder:
            log = file
            if source is not None:
                log = os.path.join(folder, posixpath.basename(file))
                source.get_file(file, log)
                if source.exists(f"{file}stp"):
                    source.get_file(f"{file}stp", f"{log}stp")
            for number, piece in enumerate(scan(log, chunk=chunk)):
                if cancel is not None and cancel.is_set():
                    return replace(done, error="the conversion was stopped")
                part = os.path.join(folder, "part.parquet")
                piece.write(part, scaled=scaled)
                done.parts.append(_put(part, uri_out, f"log={place.replace('/', '__')}/part-{number:05}.parquet"))
                done = replace(done, frames=done.frames + len(piece), lost_something=piece.lost_something)
    except (Error, OSError) as error:
        return replace(done, error=str(error))
    return done


def _put(file: str, uri_out: str, name: str) -> str:
    """Moves a file to its place; whole or not at all, so that a task may be done twice."""
    if _is_local(uri_out):
        target = Path(uri_out) / name
        target.parent.mkdir(parents=True, exist_ok=True)
        half = target.with_name(f".{target.name}.{os.getpid()}")
        shutil.copyfile(file, half)
        half.replace(target)
        return str(target)
    system, root = _remote(uri_out)
    path = posixpath.join(root, name)
    system.put_file(file, path)
    return str(system.unstrip_protocol(path))


def convert(
    uri_in: str | os.PathLike[str],
    uri_out: str | os.PathLike[str],
    *,
    scaled: bool = False,
    chunk: int = 1_000_000,
    use_ray: bool | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[Converted]:
    """Writes each log (``*.dat``) below ``uri_in`` as Parquet below ``uri_out``: ``log=PLACE/part-00000.parquet``, ``chunk`` frames a file.

    ``/`` in PLACE is written ``__``. A log that cannot be read is in the list with its ``error``. Files are written whole or not at
    all, under names that follow from the log's: a task that Ray does again writes the same ones.
    """
    uri_in, uri_out = os.fspath(uri_in), os.fspath(uri_out)
    if _is_local(uri_in):
        files = sorted(str(file) for file in Path(uri_in).rglob("*.dat"))
    else:
        system, root = _remote(uri_in)
        files = sorted(file for file in system.find(root) if file.endswith(".dat"))
    if not files:
        raise OptionError(f"no log (*.dat) below {uri_in}")
    return _all(_convert_task, files, (uri_in, uri_out, chunk, scaled), use_ray, workers, 1, progress)
