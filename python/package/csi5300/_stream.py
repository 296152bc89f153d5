"""Records as they come: :class:`Stream`."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterable, Iterator
from types import TracebackType
from typing import Any

from . import _native
from ._errors import LiveError
from ._log import Log, _macs


class Stream:
    """Frames of this machine's card, or of a robot in a served room (``csi5300 simulate SCENE --serve --socket PATH``).

    ``for log in stream`` and ``async for log in stream`` give a :class:`Log` of the frames that came since the last one, until a
    served room ends or the stream is closed. Listening to the card needs CAP_NET_ADMIN. Raises :class:`LiveError`.
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
        """``room`` is ``PATH#ROBOT``; without it the driver of this machine's card is listened to."""
        self._listener: _native.Listener | None = _native.Listener(
            room, connector_index, allow_user_sender, receive_buffer, _macs(macs)
        )

    def _open(self) -> _native.Listener:
        if self._listener is None:
            raise LiveError("the stream is closed")
        return self._listener

    @property
    def info(self) -> dict[str, Any]:
        """What was counted so far, losses included."""
        info: dict[str, Any] = json.loads(self._open().info())
        return info

    @property
    def ended(self) -> bool:
        """True once a served room ended, or the stream was closed."""
        return self._listener is None or self._listener.ended

    def fileno(self) -> int:
        """The socket: readable when frames wait."""
        return self._open().fileno()

    def read(self, timeout: float | None = None) -> Log:
        """The frames that wait; where there are none, those that come within ``timeout`` seconds (None: waits for one)."""
        listener = self._open()
        records, columns = listener.read(timeout)
        return Log(records, columns, json.loads(listener.info()))

    def close(self) -> None:
        """Stops listening."""
        self._listener = None

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Log]:
        while not self.ended:
            log = self.read()
            if len(log):
                yield log

    async def __aiter__(self) -> AsyncIterator[Log]:
        loop = asyncio.get_running_loop()
        while not self.ended:
            log = self.read(0)
            if len(log):
                yield log
            elif not self.ended:
                await self._readable(loop)

    async def _readable(self, loop: asyncio.AbstractEventLoop) -> None:
        ready = asyncio.Event()
        socket = self.fileno()
        loop.add_reader(socket, ready.set)
        try:
            await ready.wait()
        finally:
            loop.remove_reader(socket)
