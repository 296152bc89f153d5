//! The native half of the Python package `csi5300`: the crates of this project as functions and classes, which the package's Python
//! code (`package/csi5300`) wraps. The memory of every array is filled here, once.
//!
//! | module | what |
//! |---|---|
//! | `intake`, `patient` | logs from paths, bytes and file objects; files that may let a reader wait |
//! | `cards` | logs of other cards |
//! | `columns` | the fields as arrays |
//! | `records`, `scan` | `read`, `scan`, pickling |
//! | `classic` | the records in the form of csiread's `Intel` |
//! | `capture`, `link`, `options` | bearings |
//! | `evaluate`, `simulate`, `stream` | captures with truth, rooms, cards |
//! | `error`, `pool` | exceptions, interrupts, threads |

mod capture;
mod cards;
mod classic;
mod classic_scale;
mod columns;
mod error;
mod evaluate;
mod intake;
mod link;
mod options;
mod patient;
mod pool;
mod records;
mod scan;
mod simulate;
mod stream;

use pyo3::prelude::*;

/// The module `csi5300._native`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("SUBCARRIERS_20_MHZ", csi5300::signal::channel::INDICES_20_MHZ.to_vec())?;
    module.add("SUBCARRIERS_40_MHZ", csi5300::signal::channel::INDICES_40_MHZ.to_vec())?;
    module.add_class::<records::Records>()?;
    module.add_class::<scan::Scanner>()?;
    module.add_class::<link::Link>()?;
    module.add_class::<stream::Listener>()?;
    module.add_class::<error::Cancel>()?;
    module.add_function(wrap_pyfunction!(records::read, module)?)?;
    module.add_function(wrap_pyfunction!(cards::read_card, module)?)?;
    module.add_function(wrap_pyfunction!(scan::widest, module)?)?;
    module.add_function(wrap_pyfunction!(classic::classic, module)?)?;
    module.add_function(wrap_pyfunction!(classic_scale::classic_scaled, module)?)?;
    module.add_function(wrap_pyfunction!(classic_scale::classic_unmapped, module)?)?;
    module.add_function(wrap_pyfunction!(capture::bearings, module)?)?;
    module.add_function(wrap_pyfunction!(capture::one_log, module)?)?;
    module.add_function(wrap_pyfunction!(capture::read_trajectory, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::find_captures, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate_capture, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)
}
