"""Elements of a log: :class:`Frame`, :class:`Loss`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Loss:
    """A stretch of a log that holds no intact record."""

    offset: int
    """First lost byte in the file."""
    bytes: int
    """Bytes skipped."""
    reason: str
    """Why."""


class Lost(ABC):
    """What was lost of a log, from what was counted."""

    @abstractmethod
    def _counted(self) -> dict[str, Any]:
        """What ``info`` has."""

    @property
    def losses(self) -> list[Loss]:
        """The first 16 stretches of the log without an intact record; all are counted in ``info``."""
        return [Loss(**loss) for loss in self._counted()["survey"]["losses"]]

    @property
    def lost_something(self) -> bool:
        """True if anything before the log's end was damaged or dropped."""
        return bool(self._counted()["lost_something"])

    @property
    def tail(self) -> dict[str, int | None] | None:
        """Where the log was cut in the middle of a record: ``offset``, ``bytes``, ``expected``; None if it was not."""
        tail: dict[str, int | None] | None = self._counted()["tail"]
        return tail


# Compared by identity: arrays are not equal or unequal as a whole.
@dataclass(frozen=True, eq=False)
class Frame:
    """One received frame: an element of a :class:`Log`."""

    csi: NDArray[np.complex64]
    """(n_rx, n_tx, 30), the card's integers; rows are antennas as :attr:`Log.antennas` has them."""
    time_us: int
    """The card's clock, unwrapped, microseconds from an arbitrary origin."""
    host_time: np.datetime64
    """The host's wall clock (UTC); NaT where not known."""
    mac: str | None
    """The sender, where known."""
    frame: int | None
    """The sender's number of the frame, where known."""
    rssi: NDArray[np.uint8]
    """(3,) dB above an internal reference at antennas A, B, C; 0 where nothing was heard."""
    agc: int
    """The receiver's gain, dB."""
    noise: int | None
    """Noise floor, dBm, where the driver measured one."""
    rate: int
    """``rate_n_flags`` of the driver."""
    offset: int
    """Bytes of the log before the record."""
