//! Log arguments from Python, and reading them.

use crate::error::{Failure, Kind, Stop};
use crate::patient::Patient;
use csi5300::source::CsiSource;
use csi5300::source::other_card::Translated;
use csi5300::source::replay::Replay;
use csi5300::time::Instant;
use csi5300_lab::kinds::{A_LOG, not_a_log};
use csi5300_lab::table::{Filter, Reading};
use driver_iface::record::Tail;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use std::io::{self, Cursor, Read};
use std::path::PathBuf;

/// A Python object with `read(n)`, such as a file opened with "rb".
struct FileObject(Py<PyAny>);

impl Read for FileObject {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        Python::attach(|py| {
            let given = self.0.bind(py).call_method1("read", (buffer.len(),)).map_err(io::Error::other)?;
            let wrong = "read() of the file object returned no bytes: open it in binary mode (\"rb\")";
            let bytes =
                given.cast::<PyBytes>().map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, wrong))?.as_bytes();
            let place = buffer.get_mut(..bytes.len());
            let place =
                place.ok_or_else(|| io::Error::other("read(n) of the file object returned more than n bytes"))?;
            place.copy_from_slice(bytes);
            Ok(bytes.len())
        })
    }
}

/// A `.dat` argument from Python: a path, bytes, or an object with `read`. If reading has to wait, Ctrl-C and `stop` end the wait.
pub fn open(file: &Bound<'_, PyAny>, stop: &Stop) -> PyResult<Replay<Box<dyn Read + Send>>> {
    if let Ok(bytes) = file.cast::<PyBytes>() {
        let name = format!("{} bytes in memory", bytes.as_bytes().len());
        // Backed by Python's memory: bytes never change.
        let memory = Cursor::new(PyBackedBytes::from(bytes.clone()));
        return begun(bytes.as_bytes(), Box::new(memory), name);
    }
    if file.hasattr("read")? {
        let name =
            file.getattr("name").and_then(|name| name.extract::<String>()).unwrap_or_else(|_| "a file object".into());
        return begun(&peeked(file)?, Box::new(FileObject(file.clone().unbind())), name);
    }
    let path: PathBuf = file.extract()?;
    let name = path.display().to_string();
    if path.is_file() {
        let mut bytes = Vec::new();
        let begun = std::fs::File::open(&path).map(|file| file.take(csi_formats::DETECT as u64));
        // An unreadable file is refused below.
        let _ = begun.and_then(|mut begun| begun.read_to_end(&mut bytes));
        refuse_card(&bytes, &name)?;
    }
    if let Some(kind) = not_a_log(&path) {
        let message = format!("{name} is another kind of file, {kind}: {A_LOG}");
        return Err(Failure::new(Kind::Log, message).of(name).into());
    }
    if let Some(patient) = Patient::open(&path, stop).map_err(|source| Failure::unread(source, &name, 0))? {
        let name = if path.as_os_str() == "-" { "standard input".into() } else { name };
        return Ok(Replay::new(Box::new(patient), name));
    }
    Replay::open(&path).map_err(|error| Failure::log(error, &name, 0).into())
}

/// The first bytes of a file object; none if it cannot go back.
fn peeked(file: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    if !file.hasattr("seekable")? || !file.call_method0("seekable")?.is_truthy()? {
        return Ok(Vec::new());
    }
    let at = file.call_method0("tell")?;
    let first = file.call_method1("read", (csi_formats::DETECT,))?;
    file.call_method1("seek", (at,))?;
    // Text is refused when it is read.
    Ok(first.cast::<PyBytes>().map_or_else(|_| Vec::new(), |first| first.as_bytes().to_vec()))
}

/// A log that begins with these bytes; FeitCSI's is translated.
fn begun(first: &[u8], reader: Box<dyn Read + Send>, name: String) -> PyResult<Replay<Box<dyn Read + Send>>> {
    let first = first.get(..csi_formats::DETECT).unwrap_or(first);
    refuse_card(first, &name)?;
    let is_feitcsi = csi_formats::detect(first) == Some(csi_formats::Format::FeitCsi);
    Ok(Replay::new(if is_feitcsi { Box::new(Translated::new(reader)) } else { reader }, name))
}

/// Refuses another card's log, by its first bytes.
fn refuse_card(bytes: &[u8], name: &str) -> PyResult<()> {
    let Some(kind) = crate::cards::refused(bytes) else { return Ok(()) };
    let why = format!("{name}: a {kind} log, of another card than the Intel 5300: csi5300.read_card reads it");
    Err(Failure::new(Kind::Log, why).of(name.to_owned()).into())
}

/// A filter from keyword arguments.
///
/// # Errors
/// For an invalid MAC or antenna, and for times that are not numbers or in the wrong order.
pub fn filter(
    macs: Option<Vec<String>>,
    t: Option<(Option<f64>, Option<f64>)>,
    letters: Option<&str>,
) -> Result<Filter, Failure> {
    let refused = |error| Failure::new(Kind::Option, error);
    let mut filter = Filter::default();
    if let Some(macs) = macs {
        filter = filter.with_macs(macs).map_err(refused)?;
    }
    if let Some((from_s, to_s)) = t {
        filter = filter.with_time(from_s, to_s).map_err(refused)?;
    }
    if let Some(letters) = letters {
        filter = filter.with_antennas(letters).map_err(refused)?;
    }
    Ok(filter)
}

/// Facts about the log as a whole, as JSON.
///
/// # Errors
/// Never in practice: a survey can always be serialised.
pub fn info<S: CsiSource>(reading: &Reading<S>, name: &str, bytes: Option<u64>) -> Result<String, Failure> {
    let survey = &reading.table.survey;
    let tail = match survey.tail {
        Some(Tail::Cut { offset, bytes, expected }) => {
            serde_json::json!({ "offset": offset, "bytes": bytes, "expected": expected })
        }
        Some(Tail::Clean) | None => serde_json::Value::Null,
    };
    let senders: Vec<_> = survey
        .senders
        .iter()
        .map(|(mac, sender)| {
            let mac = (!mac.is_zero()).then(|| mac.to_string());
            serde_json::json!({ "mac": mac, "records": sender.records, "rate_hz": sender.rate_hz() })
        })
        .collect();
    let json = serde_json::json!({
        "name": name, "bytes": bytes, "left_out": reading.table.left_out, "tail": tail, "senders": senders,
        "lost_something": survey.lost_something(), "first_time_us": reading.table.first_us, "survey": survey,
    });
    serde_json::to_string(&json).map_err(|error| Failure::new(Kind::Internal, error))
}

/// True for a source that must be read on the calling thread: an object whose `read` belongs there, and a file that may have to wait,
/// where signals must arrive.
pub fn is_read_here(file: &Bound<'_, PyAny>) -> PyResult<bool> {
    if file.is_instance_of::<PyBytes>() {
        return Ok(false);
    }
    Ok(file.hasattr("read")? || !file.extract::<PathBuf>()?.is_file())
}

/// Reads all of a log of `size` bytes on two threads, interruptibly.
pub fn read_all(py: Python<'_>, reading: &mut Reading<Replay<Box<dyn Read + Send>>>) -> PyResult<()> {
    let mut signal = Ok(());
    let read = crate::error::detached(py, || {
        reading.read_all(Instant::ZERO, || {
            signal = Python::attach(|py| py.check_signals());
            signal.is_ok()
        })
    })?;
    signal?;
    read.map_err(|error| Failure::log(error, reading.source.name(), reading.source.bytes()).into())
}

/// Reads up to `limit` records of a log, interruptibly.
pub fn read_on(py: Python<'_>, reading: &mut Reading<Replay<Box<dyn Read + Send>>>, limit: usize) -> PyResult<()> {
    loop {
        let more = crate::error::detached(py, || reading.burst(Instant::ZERO, limit))?;
        let more = more.map_err(|error| Failure::log(error, reading.source.name(), reading.source.bytes()))?;
        py.check_signals()?;
        if !more {
            return Ok(());
        }
    }
}
