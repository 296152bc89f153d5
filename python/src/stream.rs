//! Records as they come: from this machine's card, or from a robot of a served room.

use crate::error::{Failure, Kind, detached};
use crate::intake::{filter, info};
use crate::records::Records;
use csi5300::time::{Instant, Span};
use csi5300_lab::table::Reading;
use csi5300_live::netlink::{Netlink, Options};
use csi5300_live::wait::{Monotonic, wall_us};
use csi5300_sim::served::{self, Address};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

/// How long a signal waits at most.
const PATIENCE: Span = Span::from_ms(100);
/// Records taken at once at most.
const MOST: usize = 8_192;

/// A listener.
#[pyclass(module = "csi5300._native")]
pub struct Listener {
    intake: Reading<Netlink>,
    socket: OwnedFd,
    clock: Monotonic,
    name: String,
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
                let mut options =
                    Options::default().with_connector_index(connector_index).with_allow_user_sender(allow_user_sender);
                if let Some(bytes) = receive_buffer {
                    options = options.with_receive_buffer(bytes);
                }
                Netlink::open(&options).map_err(refused)?
            }
        };
        let socket = source.as_fd().try_clone_to_owned().map_err(refused)?;
        let name = room.map_or_else(|| "this machine's card".to_owned(), str::to_owned);
        Ok(Self { intake: Reading::new(source, filter(macs, None, None)?), socket, clock: Monotonic::new(), name })
    }

    /// The socket's file descriptor, readable when records wait.
    fn fileno(&self) -> i32 {
        self.socket.as_raw_fd()
    }

    /// True once a served room ended.
    #[getter]
    fn ended(&self) -> bool {
        self.intake.has_ended()
    }

    /// The records that wait; where there are none, waits up to `timeout_s` seconds (None: as long as it takes).
    fn read<'py>(&mut self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<(Records, Bound<'py, PyDict>)> {
        let end = timeout_s.map(|s| self.clock.now() + Span::from_s(s.max(0.0)));
        loop {
            let waited = detached(py, || self.step(end))?;
            waited?;
            py.check_signals()?;
            let over = end.is_some_and(|end| self.clock.now() >= end);
            if !self.intake.arena.is_empty() || over || self.intake.has_ended() {
                let (arena, columns) = self.intake.take();
                return Records::new(py, arena, columns);
            }
        }
    }

    /// What is known of the stream so far, as JSON.
    fn info(&self) -> PyResult<String> {
        Ok(info(&self.intake, &self.name, None)?)
    }
}

impl Listener {
    /// Takes what is there, or waits for something a moment.
    fn step(&mut self, end: Option<Instant>) -> Result<(), Failure> {
        let now = self.clock.now();
        self.intake.burst(now, MOST).map_err(refused)?;
        if !self.intake.arena.is_empty() || self.intake.has_ended() {
            return Ok(());
        }
        let until = end.unwrap_or(now + PATIENCE).min(now + PATIENCE);
        self.clock.wait([self.socket.as_fd()], Some(until)).map_err(refused)?;
        self.intake.burst(self.clock.now(), MOST).map(|_| ()).map_err(refused)
    }
}
