"""The native half: use :mod:`csi5300` instead."""

import os
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

Rows: TypeAlias = NDArray[np.int64] | None
File: TypeAlias = str | os.PathLike[str] | bytes | BinaryIO
Held: TypeAlias = tuple[Records, Rows, NDArray[np.int64]]
Columns: TypeAlias = dict[str, NDArray[Any]]
Window: TypeAlias = tuple[float | None, float | None]

__version__: str
SUBCARRIERS_20_MHZ: list[int]
SUBCARRIERS_40_MHZ: list[int]

class Records:
    @property
    def nbytes(self) -> int: ...
    def __len__(self) -> int: ...
    def csi(
        self,
        rows: Rows,
        letters: str,
        n_tx: int,
        scaled: bool,
        without_spatial_mapping: bool,
        out: NDArray[np.complex64] | None = None,
    ) -> NDArray[np.complex64]: ...
    def scale(self, rows: Rows) -> NDArray[np.float64]: ...
    def total_rss_dbm(self, rows: Rows) -> NDArray[np.float64]: ...
    def write(
        self,
        path: str | os.PathLike[str],
        rows: Rows,
        columns: Columns,
        letters: str,
        scaled: bool,
        without_spatial_mapping: bool,
    ) -> int: ...
    def dump(self, rows: Rows) -> tuple[NDArray[np.uint32], bytes]: ...
    @staticmethod
    def restore(lengths: NDArray[np.uint32], bytes: bytes) -> Records: ...

class Scanner:
    def __init__(
        self,
        file: File,
        chunk: int,
        macs: list[str] | None = None,
        t: Window | None = None,
        letters: str | None = None,
    ) -> None: ...
    def next(self) -> tuple[Records, Columns] | None: ...
    def info(self) -> str: ...

class Link:
    def profile(
        self, azimuths: int, elevations: int, directions: NDArray[np.float64] | None
    ) -> list[NDArray[np.float64]]: ...
    def samples(self) -> dict[str, NDArray[Any]]: ...

class Listener:
    def __init__(
        self,
        room: str | None = None,
        connector_index: int | None = None,
        allow_user_sender: bool = False,
        receive_buffer: int | None = None,
        macs: list[str] | None = None,
    ) -> None: ...
    @property
    def ended(self) -> bool: ...
    def fileno(self) -> int: ...
    def read(self, timeout_s: float | None) -> tuple[Records, Columns]: ...
    def info(self) -> str: ...

class Cancel:
    def __init__(self) -> None: ...
    def set(self) -> None: ...
    def is_set(self) -> bool: ...

def read(
    file: File, macs: list[str] | None = None, t: Window | None = None, letters: str | None = None
) -> tuple[Records, Columns, str, tuple[str, int]]: ...
def classic(
    path: str | os.PathLike[str],
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
    rx: File | Held,
    tx: list[File | Held],
    names: list[str],
    path: str | os.PathLike[str] | NDArray[np.float64],
    tx_paths: list[str | os.PathLike[str] | NDArray[np.float64] | None],
    keywords: str,
) -> list[tuple[str, Link | None, list[str]]]: ...
def read_trajectory(path: str | os.PathLike[str]) -> NDArray[np.float64]: ...
def find_captures(
    root: str | os.PathLike[str],
) -> tuple[list[tuple[str, str, str, list[tuple[str, str]]]], list[str]]: ...
def evaluate_capture(
    place: str,
    stamp: str,
    folder: str,
    transmitters: list[tuple[str, str]],
    runs: list[tuple[str, str]],
    cancel: Cancel | None = None,
) -> list[str]: ...
def simulate(
    text: str, is_json: bool, seed: int | None = None, layout: str | None = None
) -> tuple[int, list[int], list[dict[str, Any]]]: ...
