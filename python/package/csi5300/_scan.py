"""Logs of any size in constant memory: :func:`scan`."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from typing import Any

from . import _native, _options
from ._frame import Lost
from ._log import File, Log, _file

WIDEST = ("ABC", 3)
"""Rows and columns that every frame of the card fits in."""


class Scan(Lost, Iterator[Log]):
    """The pieces of a log, one after the other: what :func:`scan` gives.

    :attr:`info`, :attr:`losses`, :attr:`lost_something` and :attr:`tail` are those of the log up to where it was read, so of all of
    it after the last piece.
    """

    def __init__(
        self,
        file: File,
        chunk: int,
        filters: tuple[list[str] | None, tuple[float | None, float | None] | None, str | None],
        shape: tuple[str, int],
    ) -> None:
        self._scanner = _native.Scanner(_file(file), chunk, *filters)
        self._shape = shape

    def __iter__(self) -> Scan:
        return self

    def __next__(self) -> Log:
        piece = self._scanner.next()
        if piece is None:
            raise StopIteration
        records, columns = piece
        letters, streams = self._shape
        return Log(records, columns, self.info, letters, streams=streams)

    @property
    def info(self) -> dict[str, Any]:
        """What was counted so far, as :attr:`Log.info` has it."""
        info: dict[str, Any] = json.loads(self._scanner.info())
        return info

    def _counted(self) -> dict[str, Any]:
        return self.info


def scan(
    file: File,
    *,
    chunk: int = 8192,
    macs: str | Iterable[str] | None = None,
    t: tuple[float | None, float | None] | None = None,
    antennas: str | Iterable[str] | None = None,
    streams: int | None = None,
) -> Scan:
    """Reads a log of any size in constant memory: an iterator over :class:`Log` after :class:`Log` of up to ``chunk`` frames.

    Filters and errors are those of :func:`read`, and the pieces of a log have one shape of CSI, which concatenate: rows for
    ``antennas`` and ``streams`` columns or, where either is not given, as many as any frame needs, for which the log is read once
    before; what can be read once only (a FIFO, standard input, a file object that cannot ``seek``) has ``"ABC"`` and 3.

    :attr:`Log.losses` and :attr:`Log.tail` of a piece are those of the log up to the record behind it, so of all of it in the last
    piece. There is one piece at least: of a log without a frame an empty one, which says what was lost.
    """
    rows, columns = _options.letters(antennas), _options.streams(streams)
    filters = (_options.macs(macs), _options.stretch(t), rows)
    number = _options.whole("chunk", chunk, 1)
    if rows is None or columns is None:
        used, most = _widest(file, filters)
        rows, columns = rows or used, columns or most
    return Scan(file, number, filters, (rows, columns))


def _widest(file: Any, filters: Any) -> tuple[str, int]:
    """What the CSI of the frames needs, where the log can be read twice."""
    if hasattr(file, "read"):
        if not (hasattr(file, "seekable") and file.seekable()):
            return WIDEST
        start = file.tell()
        found = _native.widest(file, *filters)
        file.seek(start)
        return found
    if isinstance(file, (str, os.PathLike)) and (os.fspath(file) == "-" or not os.path.isfile(file)):
        # Standard input, a FIFO, or what the native half refuses with its reason.
        return WIDEST
    return _native.widest(_file(file), *filters)
