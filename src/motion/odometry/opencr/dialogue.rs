//! The dialogue on the line: one request at a time, its answer or its silence, and who is there.

use super::super::dynamixel::{PacketCounts, Parser, Status, emit_read};
use super::table::{ID, IDENTITY, Identity, MODEL, REFRESH, SENSORS, Table};
use crate::time::{Instant, Span};

/// An answer that takes longer does not come.
const PATIENCE: Span = Span::from_ms(100);
/// After this many requests without an answer its identity is requested again: it may be another controller.
const SILENT: u32 = 5;
/// Pause between requests to one that does not answer.
const RETRY: Span = Span::from_ms(500);
/// A period in step with the refresh is shortened by this: values are then met at every age within a second, also at
/// their freshest, by which the clocks are compared.
const OUT_OF_STEP: f64 = 0.97;
/// Bit 7 of a status is an alert of the device and no failure.
const ERROR: u8 = 0x7f;

/// What a controller is, as far as it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    Nothing,
    /// Something else answers.
    Other(u16),
    TurtleBot,
}

#[derive(Clone, Copy, Debug)]
struct Request {
    asked: Asked,
    until: Instant,
    length: usize,
}

/// The time of a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) at: Instant,
    /// Host's wall clock, microseconds.
    pub(super) wall_us: i64,
}

/// What the controller answered.
#[derive(Clone, Copy, Debug)]
pub(super) enum Answer {
    /// It is a TurtleBot3's.
    Identity(Identity),
    /// Its sensors.
    Sensors(Table, Asked),
}

/// Requests, and what became of them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LineCounts {
    pub(super) requests: u64,
    pub(super) unanswered: u64,
    pub(super) refused: u64,
}

/// The line and its state.
#[derive(Debug)]
pub(super) struct Dialogue {
    period: Span,
    known: Known,
    parser: Parser,
    waiting: Option<Request>,
    due: Instant,
    silent: u32,
    /// Answers refused in a row, and the error of the last.
    refused: (u32, u8),
    device_status: i8,
    buffer: Vec<u8>,
    counts: LineCounts,
}

impl Dialogue {
    pub(super) fn new(rate_hz: f64, now: Instant) -> Self {
        Self {
            period: period(rate_hz),
            known: Known::Nothing,
            parser: Parser::default(),
            waiting: None,
            due: now,
            silent: 0,
            refused: (0, 0),
            device_status: 0,
            buffer: Vec::new(),
            counts: LineCounts::default(),
        }
    }

    pub(super) fn counts(&self) -> (LineCounts, PacketCounts) {
        (self.counts, self.parser.counts)
    }

    /// See [`OpenCr::trouble`](super::OpenCr::trouble).
    pub(super) fn trouble(&self) -> Option<String> {
        match self.known {
            Known::Other(model) => Some(format!(
                "the device answers as model {model:#06x}; the controller of a TurtleBot3 is {MODEL:#06x}: is this its port?"
            )),
            _ if self.refused.0 >= SILENT => Some(format!(
                "the controller refuses to be read ({} times in a row, error {}): is its firmware that of ROS 2?",
                self.refused.0, self.refused.1
            )),
            _ if self.silent < SILENT && self.device_status != 0 => Some(format!(
                "the controller says device status {} (-1: it finds no motors): are its motors connected and powered?",
                self.device_status
            )),
            _ if self.silent < SILENT => None,
            _ if self.parser.counts.packets == 0 && self.parser.counts.skipped_bytes > 0 => Some(
                "bytes come, but not of DYNAMIXEL protocol 2.0: the ROS 1 firmware speaks rosserial, take its /odom instead"
                    .into(),
            ),
            _ => Some(
                "the controller does not answer: is it switched on, and does no other program (turtlebot3_node) hold the port?"
                    .into(),
            ),
        }
    }

    /// The port was reopened: nothing that was asked before will be answered.
    pub(super) fn reopened(&mut self, now: Instant) {
        self.parser.reset();
        (self.waiting, self.due, self.known) = (None, now, Known::Nothing);
    }

    pub(super) fn poll_timeout(&self) -> Instant {
        self.waiting.map_or(self.due, |request| request.until)
    }

    pub(super) fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// The request to write now, if one is due.
    pub(super) fn poll_transmit(&mut self, now: Instant, wall_us: i64) -> Option<&[u8]> {
        if let Some(request) = self.waiting {
            if now < request.until {
                return None;
            }
            self.give_up(now);
        }
        if now < self.due {
            return None;
        }
        let (address, length) = if self.known == Known::TurtleBot { SENSORS } else { IDENTITY };
        let asked = Asked { at: now, wall_us };
        self.waiting = Some(Request { asked, until: now + PATIENCE, length: usize::from(length) });
        self.due = (self.due + self.period).max(now);
        self.counts.requests += 1;
        self.buffer.clear();
        emit_read(ID, address, length, &mut self.buffer);
        Some(&self.buffer)
    }

    /// The answer did not come in time.
    fn give_up(&mut self, now: Instant) {
        self.waiting = None;
        self.parser.reset();
        self.counts.unanswered += 1;
        self.silent += 1;
        if self.silent >= SILENT {
            self.known = Known::Nothing;
            self.due = now + RETRY;
        }
    }

    /// Takes what was read from the port.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.parser.push(bytes);
    }

    /// The next answer in what was read by `now`.
    pub(super) fn poll_answer(&mut self, now: Instant) -> Option<Answer> {
        while let Some(status) = self.parser.poll_status() {
            let Some(request) = self.waiting.take() else {
                self.counts.refused += 1;
                continue;
            };
            self.silent = 0;
            let answer = match status.data(request.length).filter(|_| status.id == ID && status.error & ERROR == 0) {
                Some(data) if self.known == Known::TurtleBot => self.sensors(&data, request.asked),
                Some(data) => self.identity(&data, now),
                None => self.refuse(&status),
            };
            if answer.is_some() {
                return answer;
            }
        }
        None
    }

    fn refuse(&mut self, status: &Status) -> Option<Answer> {
        self.counts.refused += 1;
        self.refused = (self.refused.0.saturating_add(1), status.error & ERROR);
        if status.id != ID {
            self.known = Known::Other(u16::from(status.id));
        }
        None
    }

    fn identity(&mut self, data: &[u8], now: Instant) -> Option<Answer> {
        let identity = Identity::of(data)?;
        if identity.model != MODEL {
            self.known = Known::Other(identity.model);
            self.due = now + RETRY;
            return None;
        }
        (self.known, self.refused) = (Known::TurtleBot, (0, 0));
        Some(Answer::Identity(identity))
    }

    fn sensors(&mut self, data: &[u8], asked: Asked) -> Option<Answer> {
        let table = Table::of(data)?;
        (self.refused, self.device_status) = ((0, 0), table.device_status);
        Some(Answer::Sensors(table, asked))
    }
}

/// Time between requests, never in step with the controller's refresh.
fn period(rate_hz: f64) -> Span {
    let refreshes = 2.0 / (rate_hz * REFRESH.as_s());
    let in_step = refreshes > 0.9 && (refreshes - refreshes.round()).abs() < 1.0 - OUT_OF_STEP;
    Span::from_s(if in_step { OUT_OF_STEP } else { 1.0 } / rate_hz)
}
