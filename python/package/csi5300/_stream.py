"""Live records: :class:`Stream`."""

from __future__ import annotations

import asyncio
import json
import os
import warnings
from collections.abc import AsyncIterator, Iterable, Iterator
from types import TracebackType
from typing import Any

from . import _native, _options
from ._errors import LiveError, OptionError
from ._log import Log

# Silence before the hint, seconds.
_PATIENCE_S = 5.0
_SILENCE = "no frame so far: `csi5300 doctor` looks for the reason"


class Stream:
    """Frames of this machine's card, or of a robot in a served room (``csi5300 simulate SCENE --serve --socket PATH``).

    ``for log in stream`` and ``async for log in stream`` yield a :class:`Log` of the frames received since the last one, until a
    served room ends or any thread or task closes the stream. Listening to the card needs CAP_NET_ADMIN. Raises :class:`LiveError`.
    """

    def __init__(
        self,
        room: str | None = None,
        *,
        macs: str | Iterable[str] | None = None,
        connector_index: int | None = None,
        allow_user_sender: bool = False,
        receive_buffer: int | None = None,
    ) -> None:
        """``room`` is ``PATH#ROBOT``; without it the stream listens to the driver of this machine's card, which the other options but
        ``macs`` are for."""
        of_card = {"connector_index": connector_index, "allow_user_sender": allow_user_sender or None, "receive_buffer": receive_buffer}
        if room is not None and (given := [name for name, value in of_card.items() if value is not None]):
            raise OptionError(f"{given[0]}: of this machine's card, not of a room")
        self._listener: _native.Listener | None = _native.Listener(
            room, connector_index, allow_user_sender, receive_buffer, _options.macs(macs)
        )
        # Tasks that wait for frames: close() wakes them.
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()

    def _open(self) -> _native.Listener:
        if self._listener is None:
            raise LiveError("the stream is closed")
        return self._listener

    @property
    def info(self) -> dict[str, Any]:
        """The counters so far, including losses."""
        info: dict[str, Any] = json.loads(self._open().info())
        return info

    @property
    def ended(self) -> bool:
        """True once the served room ended or the stream was closed."""
        listener = self._listener
        return listener is None or listener.ended

    def fileno(self) -> int:
        """The socket: readable if frames wait."""
        return self._open().fileno()

    def read(self, timeout: float | None = None) -> Log:
        """The waiting frames; if there are none, those that arrive within ``timeout`` seconds (None: waits for one).

        Raises :class:`LiveError` if the stream is closed, even while this waits.
        """
        listener = self._open()
        log = _take(listener, None if timeout is None else _options.number("timeout", timeout))
        if not len(log):
            self._open()
        return log

    def close(self) -> None:
        """Stops listening; waits in other threads or tasks end."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()
        for loop, ready in list(self._waiting):
            loop.call_soon_threadsafe(ready.set)

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    async def __aenter__(self) -> Stream:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Log]:
        while (listener := self._listener) is not None and not listener.ended:
            log = _take(listener, None)
            if len(log):
                yield log

    async def __aiter__(self) -> AsyncIterator[Log]:
        loop = asyncio.get_running_loop()
        while (listener := self._listener) is not None and not listener.ended:
            log = _take(listener, 0)
            if len(log):
                yield log
            elif not listener.ended:
                await self._readable(listener, loop)

    async def _readable(self, listener: _native.Listener, loop: asyncio.AbstractEventLoop) -> None:
        ready = asyncio.Event()
        # Each task has its own descriptor: it stays open whoever closes the stream.
        socket = os.dup(listener.fileno())
        self._waiting.add((loop, ready))
        loop.add_reader(socket, ready.set)
        try:
            # The stream may have been closed before this task was registered as waiting.
            if self._listener is not None:
                await ready.wait()
        finally:
            loop.remove_reader(socket)
            os.close(socket)
            self._waiting.discard((loop, ready))


def _take(listener: _native.Listener, timeout: float | None) -> Log:
    """Reads from a listener; a wait without a limit prints one hint if nothing arrives."""
    log = _log(listener, _PATIENCE_S if timeout is None else timeout)
    if timeout is None and not len(log) and not listener.ended:
        warnings.warn(_SILENCE, stacklevel=3)
        log = _log(listener, None)
    return log


def _log(listener: _native.Listener, timeout: float | None) -> Log:
    records, columns = listener.read(timeout)
    return Log(records, columns, json.loads(listener.info()))
