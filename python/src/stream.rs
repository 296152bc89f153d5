//! Live records, from this machine's card or from a robot of a served room.

use crate::error::{Failure, Kind, Stop, detached};
use crate::intake::{filter, info};
use crate::records::Records;
use csi5300::time::{Instant, Span};
use csi5300_lab::table::{Arena, Columns, Reading};
use csi5300_live::netlink::{Netlink, Options};
use csi5300_live::wait::{Monotonic, wall_us};
use csi5300_sim::served::{self, Address};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Longest delay of a signal.
const PATIENCE: Span = Span::from_ms(100);
/// Most records per call.
const MOST: usize = 8_192;

/// A listener for several threads; it listens until it is [closed](Listener::close).
#[pyclass(frozen, module = "csi5300._native")]
pub struct Listener {
    /// Held only briefly and never together with the interpreter's lock, so its holder waits for nobody.
    intake: Mutex<Reading<Netlink>>,
    socket: OwnedFd,
    clock: Monotonic,
    name: String,
    closed: Stop,
}

fn refused(error: impl ToString) -> Failure {
    Failure::new(Kind::Live, error)
}

#[pymethods]
impl Listener {
    /// `room` is `PATH#ROBOT` of a served room; without it the card of this machine.
    #[new]
    #[pyo3(signature = (room=None, connector_index=None, allow_user_sender=false, receive_buffer=None, macs=None))]
    fn new(
        room: Option<&str>,
        connector_index: Option<u32>,
        allow_user_sender: bool,
        receive_buffer: Option<usize>,
        macs: Option<Vec<String>>,
    ) -> PyResult<Self> {
        let source = match room {
            Some(text) => {
                let address: Address = text.parse().map_err(refused)?;
                let (card, _) = served::join(&address, served::Role::Card).map_err(refused)?;
                Netlink::over(card, wall_us)
            }
            None => {
                let usual = Options::default();
                let receive_buffer = receive_buffer.unwrap_or(usual.receive_buffer);
                let options = Options { connector_index, allow_user_sender, receive_buffer, ..usual };
                Netlink::open(&options).map_err(refused)?
            }
        };
        let socket = source.as_fd().try_clone_to_owned().map_err(refused)?;
        let name = room.map_or_else(|| "this machine's card".to_owned(), str::to_owned);
        let intake = Mutex::new(Reading::new(source, filter(macs, None, None)?));
        Ok(Self { intake, socket, clock: Monotonic::new(), name, closed: Stop::default() })
    }

    /// The socket's file descriptor, readable when records wait.
    fn fileno(&self) -> i32 {
        self.socket.as_raw_fd()
    }

    /// True once a served room ended.
    #[getter]
    fn ended(&self, py: Python<'_>) -> PyResult<bool> {
        detached(py, || self.intake().has_ended())
    }

    /// Ends all readers' waits.
    fn close(&self) {
        self.closed.ask();
    }

    /// The waiting records; if there are none, waits up to `timeout_s` seconds (None: without limit).
    fn read<'py>(&self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<(Records, Bound<'py, PyDict>)> {
        let end = timeout_s.map(|s| self.clock.now() + Span::from_s(s.max(0.0)));
        loop {
            let over = end.is_some_and(|end| self.clock.now() >= end);
            let taken = detached(py, || self.step(end, over))?;
            py.check_signals()?;
            if let Some((arena, columns)) = taken? {
                return Records::new(py, arena, columns);
            }
        }
    }

    /// Facts about the stream so far, as JSON.
    fn info(&self, py: Python<'_>) -> PyResult<String> {
        Ok(detached(py, || info(&self.intake(), &self.name, None))??)
    }
}

impl Listener {
    fn intake(&self) -> MutexGuard<'_, Reading<Netlink>> {
        self.intake.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The available records, possibly none once the time is `over` or the room ended; otherwise waits a moment.
    fn step(&self, end: Option<Instant>, over: bool) -> Result<Option<(Arena, Columns)>, Failure> {
        let now = self.clock.now();
        {
            let mut intake = self.intake();
            intake.burst(now, MOST).map_err(refused)?;
            if !intake.table.arena.is_empty() || over || intake.has_ended() || self.closed.is_asked() {
                return Ok(Some(intake.take()));
            }
        }
        let until = end.unwrap_or(now + PATIENCE).min(now + PATIENCE);
        self.clock.wait([self.socket.as_fd()], Some(until)).map_err(refused)?;
        Ok(None)
    }
}
