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
"""Rows and columns with room for every frame of the card."""


class Scan(Lost, Iterator[Log]):
    """The result of :func:`scan`: the pieces of a log, in order.

    :attr:`info`, :attr:`losses`, :attr:`lost_something` and :attr:`tail` refer to the part read so far, so to the whole log after the
    last piece.
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
        """The counters so far, as in :attr:`Log.info`."""
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

    Filters and errors are those of :func:`read`. All pieces have the same shape of CSI, so they can be concatenated: rows for
    ``antennas`` and ``streams`` columns. If either is not given, it is the most that any frame needs; for that the log is read once
    before. A source that can only be read once (a FIFO, standard input, a file object that cannot ``seek``) gets ``"ABC"`` and 3.

    :attr:`Log.losses` and :attr:`Log.tail` of a piece refer to the log up to the record after it, so to the whole log in the last
    piece. There is at least one piece: a log without a frame gives an empty one, with the losses.
    """
    rows, columns = _options.letters(antennas), _options.streams(streams)
    filters = (_options.macs(macs), _options.stretch(t), rows)
    number = _options.whole("chunk", chunk, 1)
    if rows is None or columns is None:
        used, most = _widest(file, filters)
        rows, columns = rows or used, columns or most
    return Scan(file, number, filters, (rows, columns))


def _widest(file: Any, filters: Any) -> tuple[str, int]:
    """The shape that the frames' CSI needs, if the log can be read twice."""
    if hasattr(file, "read"):
        if not (hasattr(file, "seekable") and file.seekable()):
            return WIDEST
        start = file.tell()
        found = _native.widest(file, *filters)
        file.seek(start)
        return found
    if isinstance(file, (str, os.PathLike)) and (os.fspath(file) == "-" or not os.path.isfile(file)):
        # Standard input, a FIFO, or a file that the native half refuses with its reason.
        return WIDEST
    return _native.widest(_file(file), *filters)
