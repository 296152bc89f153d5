//! Errors as one family of Python exceptions (`csi5300.Error`), and interruptible calls.

use csi5300::source;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt};
use pyo3::prelude::*;
use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Longest delay of a signal.
const PATIENCE: Duration = Duration::from_millis(40);
/// Longest wait for work that was asked to stop.
const GRACE: Duration = Duration::from_secs(1);

/// Classes of `csi5300._errors`, which are named as these with `Error` behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A log cannot be read.
    Log,
    /// There is no such log.
    LogNotFound,
    /// An argument is invalid.
    Option,
    /// A trajectory's poses are invalid.
    Trajectory,
    /// A trajectory's file cannot be read.
    TrajectoryFile,
    /// A scene is invalid.
    Scene,
    /// A scene's file cannot be read.
    SceneFile,
    /// A file or folder that an argument names cannot be read.
    OptionFile,
    /// These logs give no bearing at all.
    Capture,
    /// The card or the room is not available.
    Live,
    /// A file cannot be written.
    Export,
    /// A panic: a bug of ours.
    Internal,
}

/// An error on its way to Python.
#[derive(Debug)]
pub struct Failure {
    kind: Kind,
    message: String,
    file: Option<String>,
    offset: Option<u64>,
    /// An exception raised in Python, by a file object's `read`.
    raised: Option<PyErr>,
}

impl Failure {
    /// An error without a file.
    pub fn new(kind: Kind, message: impl ToString) -> Self {
        Self { kind, message: message.to_string(), file: None, offset: None, raised: None }
    }

    /// Adds the file concerned.
    pub fn of(mut self, file: impl Into<String>) -> Self {
        self.file = Some(file.into());
        self
    }

    /// Adds the offset in the file.
    pub fn at(mut self, offset: u64) -> Self {
        self.offset = Some(offset);
        self
    }

    /// Why a log's file cannot be read from byte `at` on.
    pub fn unread(source: std::io::Error, name: &str, at: u64) -> Self {
        Self::log(source::Error::Io { what: format!("cannot read the log {name}"), source }, name, at)
    }

    /// Why a log cannot be read beyond `bytes`.
    pub fn log(error: source::Error, name: &str, bytes: u64) -> Self {
        let message = error.to_string();
        let (kind, raised) = match error {
            source::Error::Io { source, .. } => {
                let kind = if source.kind() == ErrorKind::NotFound { Kind::LogNotFound } else { Kind::Log };
                (kind, source.into_inner().and_then(|inner| inner.downcast::<PyErr>().ok()).map(|raised| *raised))
            }
            _ => (Kind::Log, None),
        };
        Self { kind, message, file: Some(name.to_owned()), offset: Some(bytes), raised }
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        if let Some(raised) = failure.raised {
            return raised;
        }
        let Failure { kind, message, file, offset, .. } = failure;
        Python::attach(|py| {
            let made = py
                .import("csi5300._errors")
                .and_then(|module| module.getattr(format!("{kind:?}Error")))
                .and_then(|class| class.call1((&message, file, offset)));
            match made {
                Ok(error) => PyErr::from_value(error),
                Err(_) => PyException::new_err(message),
            }
        })
    }
}

fn panicked(payload: &(dyn std::any::Any + Send)) -> Failure {
    let text = payload.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_default();
    Failure::new(Kind::Internal, format!("a bug of csi5300, please report it: {text}"))
}

/// Runs a short piece of work without the interpreter's lock; a panic becomes an exception.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_err(|payload| panicked(&*payload).into())
}

/// Tells work on a thread that its result is no longer wanted.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// True once requested.
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Requests it.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// The flag itself.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }
}

/// A [`Stop`] for Python: for work on other threads than the one that receives signals.
#[pyclass(frozen, module = "csi5300._native")]
pub struct Cancel(pub Stop);

#[pymethods]
impl Cancel {
    #[new]
    fn new() -> Self {
        Self(Stop::default())
    }

    /// Asks the work to stop.
    fn set(&self) {
        self.0.ask();
    }

    /// True once requested.
    fn is_set(&self) -> bool {
        self.0.is_asked()
    }
}

/// The result of stopped work; nobody sees it.
pub fn stopped() -> Failure {
    Failure::new(Kind::Internal, "the work was stopped")
}

/// Runs a long piece of work on its own thread, without the interpreter's lock. Ctrl-C requests its [`Stop`], which it checks as
/// often as it can, and returns once the work has stopped, or after a second.
pub fn interruptible<T, F>(py: Python<'_>, stop: &Stop, work: F) -> PyResult<T>
where
    T: Send + 'static,
    F: FnOnce() -> Result<T, Failure> + Send + 'static,
{
    let (sender, receiver) = channel();
    let run = move || {
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| Err(panicked(&*payload)));
        // After an interrupt there is no receiver.
        let _ = sender.send(result);
    };
    let thread = std::thread::Builder::new().name("csi5300".into()).spawn(run);
    thread.map_err(|error| Failure::new(Kind::Internal, format!("cannot start a thread: {error}")))?;
    // A receiver must not be shared between threads; this one is passed to a thread and back.
    let mut receiver = receiver;
    loop {
        let (back, result) = py.detach(move || {
            let result = receiver.recv_timeout(PATIENCE);
            (receiver, result)
        });
        receiver = back;
        match result {
            Ok(result) => return result.map_err(Into::into),
            Err(RecvTimeoutError::Timeout) => {
                if let Err(signal) = py.check_signals() {
                    stop.ask();
                    // The receiver is passed on for good.
                    let _ = py.detach(move || receiver.recv_timeout(GRACE).map(drop));
                    return Err(signal);
                }
            }
            Err(RecvTimeoutError::Disconnected) => return Err(PyKeyboardInterrupt::new_err("the work was ended")),
        }
    }
}
