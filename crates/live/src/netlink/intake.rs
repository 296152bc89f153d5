//! Interprets the datagrams of a connector socket. It has no socket, so that tests can stage every case.

use csi5300::source::{Loss, Refused};
use csi5300::time::Step16;
use driver_iface::bfee::Bfee;
use driver_iface::connector::{CN_VAL, Datagram, MAX_DATAGRAM, Message};
use driver_iface::record::{MAX_LENGTH, Record, code};

/// Everything that a listener counted since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct SocketCounts {
    /// Datagrams taken from the socket.
    pub datagrams: u64,
    /// Records handed on.
    pub records: u64,
    /// Refused datagrams of other senders than the kernel.
    pub user_senders: u64,
    /// Messages with another index or value than the driver's.
    pub foreign: u64,
    /// Datagrams longer than the buffer.
    pub truncated: u64,
    /// Datagrams that contradict themselves, and records too long for a log.
    pub malformed: u64,
    /// Overruns of the socket's queue reported by the kernel (ENOBUFS).
    pub overruns: u64,
    /// Messages that the kernel dropped at this socket, if it reports them.
    pub kernel_drops: u64,
    /// Numbers missing from `bfee_count` at the first bfee after each overrun.
    pub overrun_bfee_gap: u64,
    /// Numbers missing from `bfee_count` anywhere else: lost before this socket, in the driver's own queue.
    pub other_bfee_gap: u64,
}

/// The next step of the intake.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// A record, and its `timestamp_low` if it is a bfee: call [`Intake::take`].
    Record(Option<u32>),
    /// Something was lost here.
    Lost(Loss),
    /// The place of an overrun: ask the kernel how much it dropped, then call [`Intake::report_overrun`].
    AskDrops,
    /// The datagram is used up: receive the next one.
    Receive,
}

/// The decisions on one socket's datagrams.
#[derive(Debug)]
pub(super) struct Intake {
    buffer: Box<[u8]>,
    filled: usize,
    next_message: usize,
    indices: Vec<u32>,
    allow_user_sender: bool,
    step: Step16,
    overrun_untold: bool,
    gap_unmeasured: bool,
    drops_seen: u64,
    delivered: Option<u32>,
    pub(super) counters: SocketCounts,
}

/// The kind of a datagram's next message, without a borrow.
enum Look {
    Record { bfee_count: Option<u16>, timestamp_low: Option<u32>, idx: u32 },
    Foreign,
    Refused(Refused),
    Empty,
}

impl Intake {
    pub(super) fn new(indices: Vec<u32>, allow_user_sender: bool) -> Self {
        Self {
            buffer: vec![0; MAX_DATAGRAM].into_boxed_slice(),
            filled: 0,
            next_message: 0,
            indices,
            allow_user_sender,
            step: Step16::default(),
            overrun_untold: false,
            gap_unmeasured: false,
            drops_seen: 0,
            delivered: None,
            counters: SocketCounts::default(),
        }
    }

    /// The buffer for the next datagram.
    pub(super) fn buffer(&mut self) -> &mut [u8] {
        &mut self.buffer
    }

    /// The index of the first record.
    pub(super) fn delivered(&self) -> Option<u32> {
        self.delivered
    }

    /// A datagram of `sent` bytes from `port` (0 is the kernel) is in the buffer, as far as it fits.
    pub(super) fn datagram(&mut self, sent: usize, port: u32) -> Option<Loss> {
        self.counters.datagrams += 1;
        (self.filled, self.next_message) = (0, 0);
        if port != 0 && !self.allow_user_sender {
            self.counters.user_senders += 1;
            return None;
        }
        if sent > self.buffer.len() {
            self.counters.truncated += 1;
            return Some(self.lost(Refused::Truncated { sent, kept: self.buffer.len() }, sent));
        }
        self.filled = sent;
        None
    }

    /// The kernel reported an overrun. Queued messages are older than the gap.
    pub(super) fn overrun(&mut self) {
        self.counters.overruns += 1;
        (self.overrun_untold, self.gap_unmeasured) = (true, true);
    }

    /// The queue is empty: true if an overrun has not been reported yet.
    pub(super) fn drained(&self) -> bool {
        self.overrun_untold
    }

    /// The overrun as a loss; `drops` is the kernel's counter for this socket.
    pub(super) fn report_overrun(&mut self, drops: Option<u64>) -> Loss {
        self.overrun_untold = false;
        let dropped = drops.map(|drops| drops.saturating_sub(self.drops_seen));
        self.drops_seen = drops.unwrap_or(self.drops_seen);
        self.counters.kernel_drops += dropped.unwrap_or(0);
        Loss::Overrun { dropped }
    }

    fn lost(&self, reason: Refused, len: usize) -> Loss {
        Loss::Datagram { number: self.counters.datagrams.saturating_sub(1), len: len as u64, reason }
    }

    fn look(&self) -> Look {
        let received = self.buffer.get(..self.filled).unwrap_or_default();
        let datagram = match Datagram::new_checked(received) {
            _ if received.is_empty() => return Look::Empty,
            Ok(datagram) => datagram,
            Err(error) => return Look::Refused(Refused::Connector(error)),
        };
        match datagram.messages().nth(self.next_message) {
            None => Look::Empty,
            Some(Err(error)) => Look::Refused(Refused::Connector(error)),
            Some(Ok(message)) => self.look_at(&message),
        }
    }

    fn look_at(&self, message: &Message<'_>) -> Look {
        let ours = message.val == CN_VAL && self.indices.contains(&message.idx);
        let Some(record) = Record::from_message(message.data).filter(|_| ours) else {
            return Look::Foreign;
        };
        if record.length() > MAX_LENGTH {
            return Look::Refused(Refused::Oversized { got: record.length(), max: MAX_LENGTH });
        }
        let bfee = (record.code == code::BFEE).then(|| Bfee::new_checked(record.body).ok()).flatten();
        let (bfee_count, timestamp_low) = bfee.map(|bfee| (bfee.bfee_count(), bfee.timestamp_low())).unzip();
        Look::Record { bfee_count, timestamp_low, idx: message.idx }
    }

    /// The next message of the datagram in the buffer.
    pub(super) fn turn(&mut self) -> Turn {
        loop {
            match self.look() {
                Look::Empty => return Turn::Receive,
                Look::Foreign => {
                    self.counters.foreign += 1;
                    self.next_message += 1;
                }
                Look::Refused(reason) => {
                    self.counters.malformed += 1;
                    self.next_message += 1;
                    let loss = self.lost(reason, self.filled);
                    if matches!(reason, Refused::Connector(_)) {
                        self.filled = 0;
                    }
                    return Turn::Lost(loss);
                }
                // A jump in bfee_count is where the kernel dropped: the overrun is reported before this record.
                Look::Record { bfee_count: Some(count), .. }
                    if self.overrun_untold && self.step.clone().missing(count) > 0 =>
                {
                    return Turn::AskDrops;
                }
                Look::Record { bfee_count, timestamp_low, idx } => {
                    self.note_count(bfee_count);
                    self.delivered.get_or_insert(idx);
                    return Turn::Record(timestamp_low);
                }
            }
        }
    }

    /// The record that [`Intake::turn`] announced.
    pub(super) fn take(&mut self) -> Option<Record<'_>> {
        self.counters.records += 1;
        let message = self.next_message;
        self.next_message += 1;
        let datagram = Datagram::new_checked(self.buffer.get(..self.filled)?).ok()?;
        Record::from_message(datagram.messages().nth(message)?.ok()?.data)
    }

    fn note_count(&mut self, bfee_count: Option<u16>) {
        let Some(count) = bfee_count else { return };
        let missing = u64::from(self.step.missing(count));
        if self.gap_unmeasured && missing > 0 {
            self.counters.overrun_bfee_gap += missing;
            self.gap_unmeasured = false;
        } else {
            self.counters.other_bfee_gap += missing;
        }
    }
}

#[cfg(test)]
mod tests;
