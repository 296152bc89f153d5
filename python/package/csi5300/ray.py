"""Data sets of many captures on a Ray cluster, or on threads of this machine: :func:`evaluate`, :func:`convert`.

A task is one capture (or one log). Ray repeats a task whose node is lost. Results are stored by the task's number, so nothing counts
twice. Files may be anywhere that fsspec reads: the task that needs a capture's files copies them into a temporary folder.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import _native, _options
from ._errors import Error, OptionError, OptionFileError
from ._evaluate import NO_CAPTURE, Capture, Evaluation, combinations, found_below, joined, one, workers_of
from ._scan import WIDEST, Scan

__all__ = ["Converted", "convert", "evaluate", "sweep"]

Progress = Callable[[int, int], None]
RETRIES = 8
"""How often Ray repeats a task whose node or process was lost."""
_PART = re.compile(r"part-\d{5,}\.parquet")


def _remote(uri: str) -> tuple[Any, str]:
    """fsspec's file system, and the path in it."""
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
    """A capture with remote files."""

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
    """Captures with the same names that :func:`csi5300._evaluate.find` gives for a local folder."""
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
        logs = [match for name in names if (match := re.fullmatch(r"csi_(rx|tx\d*)_(.+)\.dat", name))]
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
    """The connected module ray; None for threads."""
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
    """Results as they arrive, with the number of their task; one each."""
    remote = ray.remote(num_cpus=cpus, max_retries=RETRIES)(work)
    shared = [ray.put(value) for value in rest]
    limit = max(int(ray.cluster_resources().get("CPU", 1) / max(cpus, 0.01)), 1) * 4
    waiting: dict[Any, int] = {}
    places = iter(enumerate(tasks))
    try:
        while True:
            # A few tasks per core wait in the cluster, the others here: millions of tasks cost no memory.
            while len(waiting) < limit and (following := next(places, None)) is not None:
                place, task = following
                waiting[remote.remote(task, *shared)] = place
            if not waiting:
                return
            done, _ = ray.wait(list(waiting), num_returns=1)
            for reference in done:
                yield waiting.pop(reference), ray.get(reference)
    finally:
        # After an interrupt or an error of a task, nobody waits for the others.
        for reference in waiting:
            ray.cancel(reference)


def _on_threads(work: Callable[..., Any], tasks: Sequence[Any], rest: tuple[Any, ...], workers: int | None) -> Iterator[tuple[int, Any]]:
    cancel = _native.Cancel()
    with ThreadPoolExecutor(workers_of(workers)) as pool:
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
    """:func:`csi5300.evaluate` for a folder or an fsspec location (``s3://bucket/prefix``), one task per capture.

    ``use_ray``: None for Ray if it is installed (a cluster joined by ``ray.init``, else this machine), False for threads. ``sweep``: the
    task that copied the capture evaluates all combinations. A failed capture becomes a row with its ``error``.
    The rows are those of :func:`csi5300.evaluate`, in the order of the captures.
    """
    uri = os.fspath(uri)
    runs = combinations(options, sweep)
    workers_of(workers)
    tasks: list[Capture] | list[_Remote]
    tasks, unreadable = found_below(uri) if _is_local(uri) else (_find_remote(uri), [])
    if not tasks:
        raise OptionError(f"no capture below {uri}: {NO_CAPTURE}", uri)
    if use_ray is not False or workers is not None:
        # One capture per core: its links are estimated one after the other, unless the caller sets it.
        runs = [{"threads": max(int(cpus_per_task), 1), **run} for run in runs]
    parts = _all(_evaluate_task, tasks, (runs, list(sweep or ())), use_ray, workers, cpus_per_task, progress)
    return joined(parts, unreadable)


def sweep(uri: str | os.PathLike[str], options: Mapping[str, Sequence[Any]], **rest: Any) -> Evaluation:
    """:func:`evaluate` with every combination of ``options``: ``sweep(uri, {"elevation_max": [0, 20]})``."""
    return evaluate(uri, sweep=options, **rest)


@dataclass(frozen=True)
class Converted:
    """The result of a log's conversion."""

    log: str
    """Its path relative to the converted folder."""
    parts: list[str]
    """The Parquet files that were written; none for a log without a frame."""
    frames: int
    lost_something: bool
    """True if anything before the log's end was damaged or dropped."""
    error: str | None = None
    tail: dict[str, int | None] | None = None
    """Where the log was cut inside a record, as in :attr:`csi5300.Log.tail`."""


@dataclass(frozen=True)
class _Conversion:
    """The conversion options of each log."""

    uri_in: str
    uri_out: str
    chunk: int
    scaled: bool
    filters: tuple[list[str] | None, tuple[float | None, float | None] | None, str | None]
    shape: tuple[str, int]

    def place(self, file: str) -> str:
        """A log's path relative to the folder."""
        if _is_local(self.uri_in):
            return Path(file).relative_to(self.uri_in).as_posix()
        return posixpath.relpath(file, _remote(self.uri_in)[1].rstrip("/"))

    def partition(self, file: str) -> str:
        """The folder of a log's parts."""
        return f"log={self.place(file).replace('/', '__')}"

    def fetched(self, file: str, folder: str) -> str:
        """The log as a local file."""
        if _is_local(self.uri_in):
            return file
        source, _ = _remote(self.uri_in)
        log = os.path.join(folder, posixpath.basename(file))
        source.get_file(file, log)
        if source.exists(f"{file}stp"):
            source.get_file(f"{file}stp", f"{log}stp")
        return log


def _convert_task(file: str, work: _Conversion, cancel: _native.Cancel | None = None) -> Converted:
    done = Converted(work.place(file), [], 0, False)
    try:
        with tempfile.TemporaryDirectory(prefix="csi5300-") as folder:
            pieces = Scan(work.fetched(file, folder), work.chunk, work.filters, work.shape)
            for number, piece in enumerate(pieces):
                if cancel is not None and cancel.is_set():
                    return replace(done, error="the conversion was stopped")
                if number == 0:
                    # Parts of an earlier conversion may have other frames.
                    _clear(work.uri_out, work.partition(file))
                if len(piece):
                    part = os.path.join(folder, "part.parquet")
                    piece.write(part, scaled=work.scaled)
                    done.parts.append(_put(part, work.uri_out, f"{work.partition(file)}/part-{number:05}.parquet"))
                done = replace(done, frames=done.frames + len(piece), lost_something=piece.lost_something, tail=piece.tail)
    except (Error, OSError) as error:
        return replace(done, error=str(error))
    return done


def _clear(uri_out: str, partition: str) -> None:
    """Removes the parts of a log."""
    if _is_local(uri_out):
        folder = Path(uri_out) / partition
        for part in folder.iterdir() if folder.is_dir() else ():
            if _PART.fullmatch(part.name):
                part.unlink()
        return
    system, root = _remote(uri_out)
    system.invalidate_cache()
    try:
        there = system.ls(posixpath.join(root, partition), detail=False)
    except FileNotFoundError:
        return
    for name in there:
        if _PART.fullmatch(posixpath.basename(name)):
            system.rm_file(name)


def _put(file: str, uri_out: str, name: str) -> str:
    """Moves a file to its destination, completely or not at all, so that a task can be repeated."""
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
    macs: str | Iterable[str] | None = None,
    t: tuple[float | None, float | None] | None = None,
    antennas: str | Iterable[str] | None = None,
    streams: int | None = None,
    scaled: bool = False,
    chunk: int = 1_000_000,
    use_ray: bool | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[Converted]:
    """Writes each log (``*.dat``) below ``uri_in`` as Parquet below ``uri_out``: ``log=PLACE/part-00000.parquet``, ``chunk`` frames a file.

    All files have the same schema and can be read as one table: CSI of ``antennas`` and ``streams``, by default antennas A, B and C and
    3 streams, null where a frame has none. Filters are those of :func:`csi5300.read`.

    ``/`` in PLACE is written ``__``. An unreadable log is in the list with its ``error``; the result of a readable one has its losses.
    Files are written completely or not at all, under names derived from the log's. Those of an earlier conversion of the log are
    removed, so repeating a conversion does not count anything twice. Raises :class:`csi5300.OptionError`.
    """
    uri_in, uri_out = os.fspath(uri_in), os.fspath(uri_out)
    letters, columns = _options.letters(antennas), _options.streams(streams)
    filters = (_options.macs(macs), _options.stretch(t), letters)
    shape = (letters or WIDEST[0], columns or WIDEST[1])
    work = _Conversion(uri_in, uri_out, _options.whole("chunk", chunk, 1), _options.flag("scaled", scaled), filters, shape)
    # Options that are invalid for one log are invalid for all.
    Scan(b"", work.chunk, filters, shape)
    files = _logs(uri_in)
    partitions: dict[str, str] = {}
    for file in files:
        other = partitions.setdefault(work.partition(file), file)
        if other != file:
            raise OptionError(f"{other} and {file} would be one partition, {work.partition(file)}: rename one of them", file)
    return _all(_convert_task, files, (work,), use_ray, workers, 1, progress)


def _logs(uri: str) -> list[str]:
    if _is_local(uri):
        if not os.path.isdir(uri):
            raise OptionFileError(f"uri_in: {uri} is not a readable folder", uri)
        files = sorted(str(file) for file in Path(uri).rglob("*.dat"))
    else:
        system, root = _remote(uri)
        files = sorted(file for file in system.find(root) if file.endswith(".dat"))
    if not files:
        raise OptionError(f"no log (*.dat) below {uri}", uri)
    return files
