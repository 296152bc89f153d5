"""The native half: use :mod:`csi5300` instead."""

import os
from typing import Any, BinaryIO, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

_Rows: TypeAlias = NDArray[np.int64] | None
_File: TypeAlias = str | os.PathLike[str] | bytes | BinaryIO
_Held: TypeAlias = tuple[Records, _Rows, NDArray[np.int64]]
_Columns: TypeAlias = dict[str, NDArray[Any]]
_Window: TypeAlias = tuple[float | None, float | None]
_Dumped: TypeAlias = tuple[tuple[float, int], NDArray[np.complex128], NDArray[np.float64], list[NDArray[np.float64]]]

__all__ = [
    "Cancel",
    "Link",
    "Listener",
    "Records",
    "SUBCARRIERS_20_MHZ",
    "SUBCARRIERS_40_MHZ",
    "Scanner",
    "__version__",
    "bearings",
    "classic",
    "classic_scaled",
    "classic_unmapped",
    "evaluate_capture",
    "find_captures",
    "one_log",
    "read",
    "read_card",
    "read_trajectory",
    "simulate",
    "widest",
]

__version__: str
SUBCARRIERS_20_MHZ: list[int]
SUBCARRIERS_40_MHZ: list[int]

@final
class Records:
    @property
    def nbytes(self) -> int: ...
    def __len__(self) -> int: ...
    def csi(
        self,
        rows: _Rows,
        letters: str,
        n_tx: int,
        scaled: bool,
        without_spatial_mapping: bool,
        out: NDArray[np.complex64] | None = None,
    ) -> NDArray[np.complex64]: ...
    def scale(self, rows: _Rows) -> NDArray[np.float64]: ...
    def total_rss_dbm(self, rows: _Rows) -> NDArray[np.float64]: ...
    def write(
        self,
        path: str | os.PathLike[str],
        rows: _Rows,
        columns: _Columns,
        letters: str,
        n_tx: int,
        scaled: bool,
        without_spatial_mapping: bool,
    ) -> int: ...
    def dump(self, rows: _Rows) -> tuple[NDArray[np.uint32], bytes]: ...
    @staticmethod
    def restore(lengths: NDArray[np.uint32], bytes: bytes) -> Records: ...

@final
class Scanner:
    def __new__(
        cls,
        file: _File,
        chunk: int,
        macs: list[str] | None = None,
        t: _Window | None = None,
        letters: str | None = None,
    ) -> Scanner: ...
    def next(self) -> tuple[Records, _Columns] | None: ...
    def info(self) -> str: ...

@final
class Link:
    def profile(
        self, azimuths: int, elevations: int, directions: NDArray[np.float64] | None
    ) -> list[NDArray[np.float64]]: ...
    def samples(self) -> dict[str, NDArray[Any]]: ...
    def dump(self) -> _Dumped: ...
    @staticmethod
    def restore(
        carrier: tuple[float, int],
        z: NDArray[np.complex128],
        samples: NDArray[np.float64],
        drawn: list[NDArray[np.float64]],
    ) -> Link: ...

@final
class Listener:
    def __new__(
        cls,
        room: str | None = None,
        connector_index: int | None = None,
        allow_user_sender: bool = False,
        receive_buffer: int | None = None,
        macs: list[str] | None = None,
    ) -> Listener: ...
    @property
    def ended(self) -> bool: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...
    def read(self, timeout_s: float | None) -> tuple[Records, _Columns]: ...
    def info(self) -> str: ...

@final
class Cancel:
    def __new__(cls) -> Cancel: ...
    def set(self) -> None: ...
    def is_set(self) -> bool: ...

def read(
    file: _File, macs: list[str] | None = None, t: _Window | None = None, letters: str | None = None
) -> tuple[Records, _Columns, str, tuple[str, int]]: ...
def read_card(
    file: str | os.PathLike[str] | bytes, macs: list[str] | None
) -> tuple[str, tuple[int, int, int], dict[str, Any]]: ...
def widest(
    file: _File, macs: list[str] | None = None, t: _Window | None = None, letters: str | None = None
) -> tuple[str, int]: ...
def classic(
    log: str | os.PathLike[str] | bytes,
    position: int,
    limit: int,
    shape: tuple[int, int],
    payload_size: int,
) -> dict[str, Any]: ...
def classic_scaled(
    csi: NDArray[np.complex128] | None, fields: list[NDArray[np.int64]], out: NDArray[np.complex128]
) -> None: ...
def classic_unmapped(
    csi: NDArray[np.complex128], n_tx: NDArray[np.int64], rate: NDArray[np.int64], maps: NDArray[np.complex128]
) -> None: ...
def bearings(
    rx: _File | _Held,
    tx: list[_File | _Held],
    names: list[str],
    path: str | os.PathLike[str] | NDArray[np.float64],
    tx_paths: list[str | os.PathLike[str] | NDArray[np.float64] | None],
    keywords: str,
) -> list[tuple[str, Link | None, list[str]]]: ...
def one_log(
    rx: _File | _Held,
    name: str,
    path: str | os.PathLike[str] | NDArray[np.float64],
    letters: str,
    baselines: list[list[float]],
    keywords: str,
) -> list[tuple[str, Link | None, list[str]]]: ...
def read_trajectory(path: str | os.PathLike[str], columns: str | None = None) -> NDArray[np.float64]: ...
def find_captures(
    root: str | os.PathLike[str],
) -> tuple[list[tuple[str, str, str, list[tuple[str, str]], tuple[str, str] | None]], list[str]]: ...
def evaluate_capture(
    place: str,
    stamp: str,
    folder: str,
    transmitters: list[tuple[str, str]],
    loose: tuple[str, str] | None,
    runs: list[tuple[str, str]],
    cancel: Cancel | None = None,
) -> list[str]: ...
def simulate(
    text: str, is_json: bool, seed: int | None = None, layout: str | None = None
) -> tuple[str, list[int], list[dict[str, Any]]]: ...
