//! The columns of a log as NumPy arrays.

use crate::error::{Failure, Kind};
use csi5300_lab::table::Columns;
use numpy::{Element, IntoPyArray, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The columns as arrays that take over their memory.
pub fn arrays(py: Python<'_>, columns: Columns) -> PyResult<Bound<'_, PyDict>> {
    let arrays = PyDict::new(py);
    let n = columns.time_us.len();
    arrays.set_item("time_us", columns.time_us.into_pyarray(py))?;
    arrays.set_item("host_us", columns.host_us.into_pyarray(py))?;
    arrays.set_item("timestamp_low", columns.timestamp_low.into_pyarray(py))?;
    arrays.set_item("bfee_count", columns.bfee_count.into_pyarray(py))?;
    arrays.set_item("n_rx", columns.n_rx.into_pyarray(py))?;
    arrays.set_item("n_tx", columns.n_tx.into_pyarray(py))?;
    arrays.set_item("rssi", columns.rssi.into_pyarray(py).reshape([n, 3])?)?;
    arrays.set_item("noise_dbm", columns.noise_dbm.into_pyarray(py))?;
    arrays.set_item("agc", columns.agc.into_pyarray(py))?;
    arrays.set_item("rate", columns.rate.into_pyarray(py))?;
    arrays.set_item("antenna_sel", columns.antenna_sel.into_pyarray(py))?;
    arrays.set_item("antenna_order", columns.antenna_order.into_pyarray(py).reshape([n, 3])?)?;
    arrays.set_item("frame", columns.frame.into_pyarray(py))?;
    arrays.set_item("mac", columns.mac.into_pyarray(py).reshape([n, 6])?)?;
    arrays.set_item("offset", columns.offset.into_pyarray(py))?;
    Ok(arrays)
}

/// The columns from arrays with their names.
pub fn from_arrays(arrays: &Bound<'_, PyDict>) -> PyResult<Columns> {
    Ok(Columns {
        time_us: values(arrays, "time_us")?,
        host_us: values(arrays, "host_us")?,
        timestamp_low: values(arrays, "timestamp_low")?,
        bfee_count: values(arrays, "bfee_count")?,
        n_rx: values(arrays, "n_rx")?,
        n_tx: values(arrays, "n_tx")?,
        rssi: values(arrays, "rssi")?,
        noise_dbm: values(arrays, "noise_dbm")?,
        agc: values(arrays, "agc")?,
        rate: values(arrays, "rate")?,
        antenna_sel: values(arrays, "antenna_sel")?,
        antenna_order: values(arrays, "antenna_order")?,
        frame: values(arrays, "frame")?,
        mac: values(arrays, "mac")?,
        offset: values(arrays, "offset")?,
    })
}

/// The values of an array of any shape, in C order.
fn values<T: Element + Clone>(arrays: &Bound<'_, PyDict>, name: &str) -> PyResult<Vec<T>> {
    let wrong = || Failure::new(Kind::Internal, format!("no column {name}, or of another type"));
    let array: PyReadonlyArrayDyn<'_, T> = arrays.get_item(name)?.ok_or_else(wrong)?.extract().map_err(|_| wrong())?;
    Ok(array.as_array().iter().cloned().collect())
}
