//! The columns of a log as NumPy arrays.

use crate::error::{Failure, Kind};
use csi5300_lab::table::Columns;
use numpy::{Element, IntoPyArray, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;

macro_rules! columns {
    ($($name:ident $([$width:literal])?),*) => {
        /// The columns as arrays that take over their memory.
        pub fn arrays(py: Python<'_>, columns: Columns) -> PyResult<Bound<'_, PyDict>> {
            let (arrays, n) = (PyDict::new(py), columns.len());
            $(arrays.set_item(stringify!($name), columns.$name.into_pyarray(py)$(.reshape([n, $width])?)?)?;)*
            Ok(arrays)
        }

        /// The columns from arrays with their names.
        pub fn from_arrays(arrays: &Bound<'_, PyDict>) -> PyResult<Columns> {
            Ok(Columns { $($name: values(arrays, stringify!($name))?,)* })
        }
    };
}

columns!(
    time_us,
    host_us,
    timestamp_low,
    bfee_count,
    n_rx,
    n_tx,
    rssi[3],
    noise_dbm,
    agc,
    rate,
    antenna_sel,
    antenna_order[3],
    frame,
    mac[6],
    offset
);

/// The values of an array of any shape, in C order.
fn values<T: Element + Clone>(arrays: &Bound<'_, PyDict>, name: &str) -> PyResult<Vec<T>> {
    let wrong = || Failure::new(Kind::Internal, format!("no column {name}, or of another type"));
    let array: PyReadonlyArrayDyn<'_, T> = arrays.get_item(name)?.ok_or_else(wrong)?.extract().map_err(|_| wrong())?;
    Ok(array.as_array().iter().cloned().collect())
}
