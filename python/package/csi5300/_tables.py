"""Logs as tables and datasets of other libraries."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas
    import polars
    import xarray

    from ._log import Log


def columns(log: Log) -> dict[str, Any]:
    """One-dimensional columns by name; missing integers are masked."""
    rssi = log.rssi
    return {
        "time_us": log.time_us,
        "host_time": log.host_time,
        "mac": log.mac,
        "frame": log.frame,
        "rssi_a": rssi[:, 0],
        "rssi_b": rssi[:, 1],
        "rssi_c": rssi[:, 2],
        "noise": log.noise,
        "agc": log.agc,
        "rate": log.rate,
        "n_rx": log.n_rx,
        "n_tx": log.n_tx,
        "bfee_count": log.bfee_count,
        "offset": log.offset,
    }


def module(name: str) -> Any:
    """An optional library. Raises ImportError with the install command."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.split(".")[0]:
            raise
        raise ImportError(f"{error.name} is not installed: pip install {error.name}", name=error.name) from None


def to_pandas(log: Log) -> pandas.DataFrame:
    """See :meth:`csi5300.Log.to_pandas`."""
    pd = module("pandas")

    def series(values: Any) -> Any:
        if not isinstance(values, np.ma.MaskedArray):
            return values
        return pd.arrays.IntegerArray(values.data.astype(np.int64), np.ma.getmaskarray(values).copy())

    table: pandas.DataFrame = pd.DataFrame({name: series(values) for name, values in columns(log).items()})
    return table


def to_polars(log: Log, *, scaled: bool = False) -> polars.DataFrame:
    """See :meth:`csi5300.Log.to_polars`."""
    pl = module("polars")

    def series(name: str, values: Any) -> Any:
        if not isinstance(values, np.ma.MaskedArray):
            return pl.Series(name, values)
        plain, mask = pl.Series(name, values.data), pl.Series(np.ma.getmaskarray(values))
        return pl.select(pl.when(~mask).then(plain).alias(name)).to_series()

    csi = log.scaled() if scaled else log.csi
    n, *shape = csi.shape
    table = pl.DataFrame([series(name, values) for name, values in columns(log).items()])

    def arrays(name: str, part: Any) -> Any:
        if not part.size:
            return pl.Series(name, [], dtype=pl.Array(pl.Float32, tuple(shape)))
        return pl.Series(name, np.ascontiguousarray(part).reshape(n, -1)).reshape((n, *shape))

    whole: polars.DataFrame = table.with_columns([arrays("csi_re", csi.real), arrays("csi_im", csi.imag)])
    return whole


def to_xarray(log: Log, *, scaled: bool = False) -> xarray.Dataset:
    """See :meth:`csi5300.Log.to_xarray`."""
    xr = module("xarray")
    csi = log.scaled() if scaled else log.csi
    units = "sqrt(SNR)" if scaled else "card's integers"

    def plain(values: Any) -> Any:
        masked: Any = values.astype(np.float64) if isinstance(values, np.ma.MaskedArray) else None
        return values if masked is None else masked.filled(np.nan)

    per_frame = {name: ("time", plain(values)) for name, values in columns(log).items() if name != "time_us"}
    dataset: xarray.Dataset = xr.Dataset(
        {"csi": (("time", "rx", "tx", "subcarrier"), csi, {"units": units}), **per_frame},
        coords={
            "time": ("time", log.t, {"units": "s", "long_name": "seconds after the log's first record, card's clock"}),
            "rx": list(log.antennas),
            "tx": np.arange(1, log.streams + 1),
            "subcarrier": log.subcarriers,
        },
        attrs={"name": log.name, "lost_something": int(log.lost_something)},
    )
    return dataset
