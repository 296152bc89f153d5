"""Logs in memory: :func:`read`, :class:`Log`."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from . import _native, _options
from ._errors import OptionError
from ._frame import Frame, Lost

if TYPE_CHECKING:
    import pandas
    import polars
    import xarray
    from matplotlib.figure import Figure

File: TypeAlias = "str | os.PathLike[str] | bytes | bytearray | memoryview | BinaryIO"
Index: TypeAlias = "slice | Sequence[int] | Sequence[bool] | NDArray[np.integer[Any]] | NDArray[np.bool_]"
Masked: TypeAlias = "np.ma.MaskedArray[Any, np.dtype[Any]]"

HT40 = 0x0800
NO_ANTENNA = 255


def _file(file: File) -> Any:
    return bytes(file) if isinstance(file, (bytearray, memoryview)) else file


def read(
    file: File,
    *,
    macs: str | Iterable[str] | None = None,
    t: tuple[float | None, float | None] | None = None,
    antennas: str | Iterable[str] | None = None,
    streams: int | None = None,
) -> Log:
    """Reads a log (``.dat``, stock csitool or WSR layout, distinguished record by record) into memory.

    ``file`` is a path, bytes, or an object with ``read`` (binary). Keeps the frames of the senders ``macs``, from ``t[0]`` up to
    ``t[1]`` seconds after the first record (:attr:`Log.t`), that used an antenna of ``antennas`` (``"A"``, ``"BC"``). CSI has rows
    for these antennas and ``streams`` columns, or as many of both as any frame needs. Damage is skipped and counted:
    :attr:`Log.losses`. Host times come from ``<file>stp`` or from the records.

    Raises :class:`LogError` if the file cannot be read, :class:`OptionError` for an invalid filter.
    """
    letters, columns_of_csi = _options.letters(antennas), _options.streams(streams)
    found = _native.read(_file(file), _options.macs(macs), _options.stretch(t), letters)
    records, columns, info, (used, most) = found
    return Log(records, columns, json.loads(info), used if letters is None else letters, streams=columns_of_csi or most)


def _places(index: Any) -> int | NDArray[Any]:
    """A number, or an array of numbers or booleans. Masked elements are not selected, whatever lies under the mask."""
    if isinstance(index, np.ma.MaskedArray) and index.ndim:
        index = index.filled(False) if index.dtype == bool else index.compressed()
    places = np.asarray(index)
    if places.ndim == 1 and places.size == 0 and places.dtype != bool:
        return np.zeros(0, np.int64)
    if places.ndim == 0 and places.dtype.kind in "iu":
        return int(places)
    if places.ndim != 1 or places.dtype.kind not in "iub":
        what = f"an array {places.shape} of {places.dtype}" if places.ndim else repr(index)
        raise IndexError(f"{what}: a log takes a number, a slice, or an array of numbers or booleans")
    return places


class Log(Lost):
    """Frames of a log: a NumPy array for each field, all of length ``n``.

    ``log[3]`` is a :class:`Frame`; ``log[10:20]``, ``log[mask]`` and ``log[indices]`` are logs that share its memory. CSI is stored
    packed as the card sent it, and decoded by :attr:`csi` or :meth:`scaled`.
    """

    def __init__(
        self,
        records: _native.Records,
        columns: dict[str, NDArray[Any]],
        info: dict[str, Any],
        letters: str | None = None,
        rows: NDArray[np.int64] | None = None,
        streams: int | None = None,
    ) -> None:
        self._records = records
        self._columns = columns
        self._rows = rows
        self._letters = letters
        self._streams = streams
        self.info: dict[str, Any] = info
        """Facts about the log as a whole (``survey``: the counters of ``csi5300 info --json``)."""

    def __len__(self) -> int:
        return len(self._columns["time_us"])

    # Fields of the frames.

    @property
    def name(self) -> str:
        """The log's path, or its other source."""
        return str(self.info["name"])

    @property
    def time_us(self) -> NDArray[np.int64]:
        """(n,) The card's clock at reception, unwrapped along the log, microseconds from an arbitrary origin."""
        return self._columns["time_us"]

    @property
    def t(self) -> NDArray[np.float64]:
        """(n,) Seconds after the first record of the whole log, by the card's clock: the scale of :func:`read`'s ``t``.

        Filters, slices and the pieces of :func:`scan` do not change a frame's time, so ``log[100:].t[0]`` is not 0.
        """
        time, first = self.time_us, self.info.get("first_time_us")
        seconds: NDArray[np.float64] = (time - (time[:1].sum() if first is None else first)) * 1e-6
        return seconds

    @property
    def host_time(self) -> NDArray[np.datetime64]:
        """(n,) datetime64[us]: the host's wall clock at reception (UTC); NaT if unknown."""
        return self._columns["host_us"].view("datetime64[us]")

    @property
    def rssi(self) -> NDArray[np.uint8]:
        """(n, 3) dB above an internal reference at antennas A, B, C; 0 if nothing was heard."""
        return self._columns["rssi"]

    @property
    def agc(self) -> NDArray[np.uint8]:
        """(n,) The receiver's gain, dB."""
        return self._columns["agc"]

    @property
    def noise(self) -> Masked:
        """(n,) Noise floor, dBm; masked if the driver did not measure it."""
        noise = self._columns["noise_dbm"]
        return np.ma.masked_array(noise, mask=noise == -127)

    @property
    def rate(self) -> NDArray[np.uint16]:
        """(n,) ``rate_n_flags`` of the driver."""
        return self._columns["rate"]

    @property
    def is_40_mhz(self) -> NDArray[np.bool_]:
        """(n,) True for frames 40 MHz wide."""
        wide: NDArray[np.bool_] = (self.rate & HT40) != 0
        return wide

    @property
    def bfee_count(self) -> NDArray[np.uint16]:
        """(n,) The driver's record counter, wrapping: a gap means a record lost before logging."""
        return self._columns["bfee_count"]

    @property
    def timestamp_low(self) -> NDArray[np.uint32]:
        """(n,) The card's clock as in the record, microseconds, wrapping after 4,295 s."""
        return self._columns["timestamp_low"]

    @property
    def n_rx(self) -> NDArray[np.uint8]:
        """(n,) Receive chains of each frame, 1 to 3."""
        return self._columns["n_rx"]

    @property
    def n_tx(self) -> NDArray[np.uint8]:
        """(n,) Space-time streams of each frame, 1 to 3."""
        return self._columns["n_tx"]

    @property
    def offset(self) -> NDArray[np.int64]:
        """(n,) Offset of the record in the log, bytes."""
        return self._columns["offset"]

    @property
    def frame(self) -> Masked:
        """(n,) The sender's frame number; masked if unknown."""
        frame = self._columns["frame"]
        return np.ma.masked_array(frame, mask=frame < 0)

    @cached_property
    def mac(self) -> NDArray[np.str_]:
        """(n,) The sender, as ``00:16:ea:12:34:56``; empty if unknown."""
        octets = self._columns["mac"]
        # Addresses as numbers: sorting numbers releases the interpreter's lock, sorting rows does not.
        padded = np.zeros((len(octets), 8), np.uint8)
        padded[:, 2:] = octets
        distinct, which = np.unique(padded.view(">u8").ravel().astype(np.uint64), return_inverse=True)
        words = np.array([int(one).to_bytes(6, "big").hex(":") if one else "" for one in distinct], dtype="U17")
        named: NDArray[np.str_] = words[which.reshape(-1)]
        return named

    @property
    def antenna_order(self) -> Masked:
        """(n, 3) Antenna of each receive chain, 0 to 2 for A to C; masked for unused chains and if the record does not name it."""
        order = self._columns["antenna_order"]
        return np.ma.masked_array(order, mask=order == NO_ANTENNA)

    @property
    def antennas_known(self) -> NDArray[np.bool_]:
        """(n,) False if a record does not name its antennas: its rows of CSI are then receive chains."""
        known: NDArray[np.bool_] = self._columns["antenna_order"][:, 0] != NO_ANTENNA
        return known

    @property
    def subcarriers(self) -> NDArray[np.int8]:
        """(30,) Subcarrier indices relative to the channel centre, 312.5 kHz apart.

        Raises :class:`OptionError` if 20 and 40 MHz are mixed: ``log[log.is_40_mhz].subcarriers``.
        """
        wide = self.is_40_mhz
        if len(self) and wide.any() and not wide.all():
            raise OptionError("frames of 20 and 40 MHz are mixed: select with log[log.is_40_mhz] or log[~log.is_40_mhz]", self.name)
        indices = _native.SUBCARRIERS_40_MHZ if len(self) and wide[0] else _native.SUBCARRIERS_20_MHZ
        return np.array(indices, dtype=np.int8)

    # The channel.

    @cached_property
    def antennas(self) -> str:
        """Letters of the rows of :attr:`csi`: the requested antennas, or those that any frame of the log used; a part has those of
        the whole."""
        if self._letters is not None:
            return "".join(sorted(set(self._letters.upper()) & set("ABC")))
        order = self._columns["antenna_order"]
        used = [k for k in range(3) if (order == k).any()]
        unknown = ~self.antennas_known
        most = int(self.n_rx[unknown].max()) if unknown.any() else 0
        used += [k for k in range(3) if k not in used][: max(0, most - len(used))]
        return "".join("ABC"[k] for k in sorted(used))

    @cached_property
    def streams(self) -> int:
        """Columns of :attr:`csi`: those requested, or the most streams of any frame of the log; a part has as many as the whole."""
        if self._streams is not None:
            return self._streams
        return int(self.n_tx.max()) if len(self) else 1

    @cached_property
    def csi(self) -> NDArray[np.complex64]:
        """(n, n_rx, n_tx, 30) The card's integers, rows by :attr:`antennas`, NaN where a frame has none.

        Decoded at the first call and kept. :attr:`present` shows which values exist; :meth:`masked` masks the others.
        """
        return self._decode(scaled=False, remove_spatial_mapping=False)

    def scaled(
        self, *, remove_spatial_mapping: bool = False, out: NDArray[np.complex64] | None = None
    ) -> NDArray[np.complex64]:
        """(n, n_rx, n_tx, 30) CSI in units of sqrt(SNR), decoded anew; NaN if a frame has no scale.

        With ``remove_spatial_mapping`` columns are transmit antennas instead of streams (Intel transmitters). ``out`` is an array of
        this shape in C order that is written and returned: reusing memory is faster. Raises :class:`OptionError` for another shape or
        order.
        """
        return self._decode(scaled=True, remove_spatial_mapping=remove_spatial_mapping, out=out)

    def raw(
        self, *, remove_spatial_mapping: bool = False, out: NDArray[np.complex64] | None = None
    ) -> NDArray[np.complex64]:
        """(n, n_rx, n_tx, 30) As :attr:`csi`, decoded anew and not kept; ``out`` as in :meth:`scaled`."""
        return self._decode(scaled=False, remove_spatial_mapping=remove_spatial_mapping, out=out)

    def masked(self, *, scaled: bool = False) -> Masked:
        """(n, n_rx, n_tx, 30) CSI, masked where a frame has none."""
        csi = self.scaled() if scaled else self.csi
        return np.ma.masked_invalid(csi, copy=False)

    def _decode(
        self, *, scaled: bool, remove_spatial_mapping: bool, out: NDArray[np.complex64] | None = None
    ) -> NDArray[np.complex64]:
        if out is not None and (not isinstance(out, np.ndarray) or out.dtype != np.complex64 or out.ndim != 4):
            raise OptionError("out: an array of complex64 with four dimensions")
        return self._records.csi(self._rows, self.antennas, self.streams, scaled, remove_spatial_mapping, out)

    @property
    def present(self) -> NDArray[np.bool_]:
        """(n, n_rx, n_tx) True where a frame has CSI."""
        order, known = self._columns["antenna_order"], self.antennas_known
        rows = [
            np.where(known, (order == "ABC".index(letter)).any(axis=1), self.n_rx > row)
            for row, letter in enumerate(self.antennas)
        ]
        there = np.stack(rows, axis=1) if rows else np.zeros((len(self), 0), dtype=bool)
        streams = np.arange(self.streams)[None, :] < self.n_tx[:, None]
        both: NDArray[np.bool_] = there[:, :, None] & streams[:, None, :]
        return both

    @property
    def scale(self) -> NDArray[np.float64]:
        """(n,) Factor from the card's integers to sqrt(SNR); NaN if RSSI or CSI are all 0."""
        return self._records.scale(self._rows)

    @property
    def total_rss(self) -> NDArray[np.float64]:
        """(n,) Received power over all antennas, dBm; NaN if all RSSI are 0."""
        return self._records.total_rss_dbm(self._rows)

    def _counted(self) -> dict[str, Any]:
        return self.info

    @property
    def nbytes(self) -> int:
        """Bytes of memory of the packed records and the columns, without decoded CSI."""
        return self._records.nbytes + sum(column.nbytes for column in self._columns.values())

    # Sequence interface.

    @overload
    def __getitem__(self, index: int | np.integer[Any]) -> Frame: ...
    @overload
    def __getitem__(self, index: Index) -> Log: ...
    def __getitem__(self, index: int | np.integer[Any] | Index) -> Frame | Log:
        chosen = index if isinstance(index, slice) else _places(index)
        if isinstance(chosen, int):
            return self._frame(chosen)
        rows = np.arange(len(self), dtype=np.int64) if self._rows is None else self._rows
        columns = {name: column[chosen] for name, column in self._columns.items()}
        rows = np.ascontiguousarray(rows[chosen])
        part = Log(self._records, columns, self.info, self.antennas, rows, self.streams)
        if "csi" in self.__dict__ and isinstance(chosen, slice):
            part.__dict__["csi"] = self.csi[chosen]
        return part

    def _frame(self, index: int) -> Frame:
        n = len(self)
        if not -n <= index < n:
            raise IndexError(f"frame {index} of a log of {n}")
        index %= n
        one = self[index : index + 1]
        columns = one._columns
        number, noise = int(columns["frame"][0]), int(columns["noise_dbm"][0])
        return Frame(
            csi=one.csi[0],
            time_us=int(columns["time_us"][0]),
            host_time=one.host_time[0],
            mac=str(one.mac[0]) or None,
            frame=None if number < 0 else number,
            rssi=one.rssi[0],
            agc=int(one.agc[0]),
            noise=None if noise == -127 else noise,
            rate=int(one.rate[0]),
            offset=int(one.offset[0]),
        )

    def __iter__(self) -> Iterator[Frame]:
        # In pieces: each is decoded at once.
        for start in range(0, len(self), 1024):
            part = self[start : start + 1024]
            _ = part.csi
            for index in range(len(part)):
                yield part._frame(index)

    def __getstate__(self) -> dict[str, Any]:
        lengths, packed = self._records.dump(self._rows)
        shape = {"letters": self._letters, "streams": self._streams}
        return {"columns": self._columns, "info": self.info, **shape, "lengths": lengths, "packed": packed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        records = _native.Records.restore(state["lengths"], state["packed"])
        columns, info = state["columns"], state["info"]
        self.__init__(records, columns, info, state["letters"], streams=state["streams"])  # type: ignore[misc]

    def __copy__(self) -> Log:
        return Log(self._records, dict(self._columns), self.info, self._letters, self._rows, self._streams)

    def _held(self) -> _native._Held:
        """The arguments of native functions for a log in memory."""
        return (self._records, self._rows, self._columns["host_us"])

    # To other libraries.

    def to_xarray(self, *, scaled: bool = False) -> xarray.Dataset:
        """A dataset with dimensions time, rx, tx, subcarrier; needs xarray."""
        from . import _tables

        return _tables.to_xarray(self, scaled=scaled)

    def to_pandas(self) -> pandas.DataFrame:
        """One row per frame, without the CSI; needs pandas."""
        from . import _tables

        return _tables.to_pandas(self)

    def to_polars(self, *, scaled: bool = False) -> polars.DataFrame:
        """One row per frame, CSI in the array columns ``csi_re`` and ``csi_im``; needs polars."""
        from . import _tables

        return _tables.to_polars(self, scaled=scaled)

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        scaled: bool = False,
        remove_spatial_mapping: bool = False,
    ) -> int:
        """Writes the frames to ``.csv``, ``.npz``, ``.mat`` (v5) or ``.parquet``, with the arrays and columns of ``csi5300 export``
        (docs/reference/formats.md); replaces an existing file. Returns the number of frames without a scale (0 unless ``scaled``).

        Raises :class:`ExportError`.
        """
        shape = (self.antennas, self.streams)
        return self._records.write(path, self._rows, self._columns, *shape, scaled, remove_spatial_mapping)

    def plot(self, *, antenna: str | None = None, stream: int = 0) -> Figure:
        """Amplitude and phase of the most frequent sender's frames over time and subcarrier; needs matplotlib."""
        from . import plot

        return plot.heat_map(self, antenna=antenna, stream=stream)

    def __repr__(self) -> str:
        shape = (len(self), len(self.antennas), self.streams, 30)
        lost = ", with losses" if self.lost_something else ""
        return f"<csi5300.Log {self.name}: {len(self)} frames, antennas {self.antennas}, csi {shape}{lost}>"

    def _repr_html_(self) -> str:
        from . import _html

        return _html.of_log(self)
