"""Elements of a log: :class:`Frame`, :class:`Loss`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Loss:
    """A stretch of a log without an intact record."""

    offset: int
    """Offset of the first lost byte in the file."""
    bytes: int
    """Bytes skipped."""
    reason: str
    """Why."""


class Lost(ABC):
    """A log's losses, from its counters."""

    @abstractmethod
    def _counted(self) -> dict[str, Any]:
        """The content of ``info``."""

    @property
    def losses(self) -> list[Loss]:
        """The first 16 stretches of the log without an intact record; ``info`` counts all."""
        return [Loss(**loss) for loss in self._counted()["survey"]["losses"]]

    @property
    def lost_something(self) -> bool:
        """True if anything before the log's end was damaged or dropped."""
        return bool(self._counted()["lost_something"])

    @property
    def tail(self) -> dict[str, int | None] | None:
        """Where the log was cut inside a record: ``offset``, ``bytes``, ``expected``; None if it was not."""
        tail: dict[str, int | None] | None = self._counted()["tail"]
        return tail


# Compared by identity: arrays have no single truth value.
@dataclass(frozen=True, eq=False)
class Frame:
    """One received frame: an element of a :class:`Log`."""

    csi: NDArray[np.complex64]
    """(n_rx, n_tx, 30), the card's integers; rows are antennas as in :attr:`Log.antennas`."""
    time_us: int
    """The card's clock, unwrapped, microseconds from an arbitrary origin."""
    host_time: np.datetime64
    """The host's wall clock (UTC); NaT if unknown."""
    mac: str | None
    """The sender, if known."""
    frame: int | None
    """The sender's frame number, if known."""
    rssi: NDArray[np.uint8]
    """(3,) dB above an internal reference at antennas A, B, C; 0 if nothing was heard."""
    agc: int
    """The receiver's gain, dB."""
    noise: int | None
    """Noise floor, dBm, if the driver measured it."""
    rate: int
    """``rate_n_flags`` of the driver."""
    offset: int
    """Offset of the record in the log, bytes."""
