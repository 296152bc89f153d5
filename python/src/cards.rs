//! Logs of other cards as arrays.

use crate::error::{Failure, Kind};
use csi_formats::{Format, RssiUnit};
use csi5300_lab::export::CardFrames;
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;

/// The kind of log that `read` refuses; it reads FeitCSI logs as the 5300's.
pub fn refused(bytes: &[u8]) -> Option<&'static str> {
    csi_formats::detect(bytes).filter(|format| *format != Format::FeitCsi).map(Format::name)
}

/// The frames of another card's log that have the most frequent shape: the kind of log, the skipped frames, and the arrays.
#[pyfunction]
#[pyo3(signature = (file, macs))]
pub fn read_card<'py>(
    py: Python<'py>,
    file: &Bound<'py, PyAny>,
    macs: Option<Vec<String>>,
) -> PyResult<(&'static str, [u64; 3], Bound<'py, PyDict>)> {
    let refused = |kind, why: String| Failure::new(kind, why);
    let parse = |text: &String| {
        text.parse::<driver_iface::Mac>().map_err(|error| refused(Kind::Option, format!("{text}: {error}")))
    };
    let macs = macs.map(|macs| macs.iter().map(parse).collect::<Result<Vec<_>, _>>()).transpose()?;
    let (name, bytes) = match file.cast::<PyBytes>() {
        Ok(bytes) => ("bytes in memory".to_owned(), bytes.as_bytes().to_vec()),
        Err(_) => {
            let path: PathBuf = file.extract()?;
            let name = path.display().to_string();
            let read = std::fs::read(&path).map_err(|source| Failure::unread(source, &name, 0))?;
            (name, read)
        }
    };
    let format = csi_formats::detect(bytes.get(..csi_formats::DETECT).unwrap_or(&bytes)).ok_or_else(|| {
        let why = format!("{name} is not a log of another supported card; csi5300.read reads logs of the Intel 5300");
        refused(Kind::Log, why).of(name.clone())
    })?;
    let is_sender = |macs: &Vec<driver_iface::Mac>, mac: Option<[u8; 6]>| {
        mac.is_some_and(|mac| macs.contains(&driver_iface::Mac(mac)))
    };
    let keeps = |frame: &csi_formats::Frame| macs.as_ref().is_none_or(|macs| is_sender(macs, frame.sender));
    let read = py.detach(|| CardFrames::read(format, &bytes, |frame, _| keeps(frame)));
    let (n, [n_rx, n_tx, n_sub]) = (read.frames.len(), read.shape());
    let arrays = PyDict::new(py);
    let csi: Vec<_> = read.csi().collect();
    arrays.set_item("csi", csi.into_pyarray(py).reshape([n, n_rx, n_tx, n_sub])?)?;
    arrays.set_item("subcarriers", read.subcarriers().to_vec().into_pyarray(py))?;
    arrays.set_item("t", read.time_s.clone().into_pyarray(py))?;
    arrays.set_item("rssi", read.rssi().collect::<Vec<_>>().into_pyarray(py).reshape([n, n_rx])?)?;
    arrays.set_item("mac", read.macs().collect::<Vec<_>>().into_pyarray(py).reshape([n, 6])?)?;
    let whole: [(&str, fn(&csi_formats::Frame) -> Option<i64>); 5] = [
        ("host_us", |frame| frame.host_us),
        ("sequence", |frame| frame.sequence.map(i64::from)),
        ("clock_ticks", |frame| frame.clock.and_then(|clock| i64::try_from(clock.ticks).ok())),
        ("first_rx", |frame| Some(i64::from(frame.first_rx))),
        ("first_tx", |frame| Some(i64::from(frame.first_tx))),
    ];
    for (name, of) in whole {
        arrays.set_item(name, read.whole(of).collect::<Vec<_>>().into_pyarray(py))?;
    }
    let first = read.frames.first();
    arrays.set_item("card", first.map(|frame| frame.card.to_string()))?;
    arrays.set_item("kind", first.and_then(|frame| frame.kind).map(csi_formats::Kind::name))?;
    arrays.set_item("width_mhz", first.map(|frame| frame.width_mhz))?;
    arrays.set_item("spacing_hz", first.map(csi_formats::Frame::spacing_hz))?;
    arrays.set_item("tick_ps", first.and_then(|frame| frame.clock).map(|clock| clock.tick_ps))?;
    arrays.set_item("rssi_in_dbm", first.map(|frame| frame.rssi_unit == RssiUnit::Dbm))?;
    Ok((format.name(), [read.other_shapes, read.left_out, read.damaged], arrays))
}
