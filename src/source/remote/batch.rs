//! A message being filled.

use super::{POSES, RECORDS};
use crate::motion::pose::Pose;
use driver_iface::record::Record;

/// A message being filled.
#[derive(Clone, Debug)]
pub struct Batch {
    magic: [u8; 4],
    session: u32,
    next: u64,
    bytes: Vec<u8>,
}

impl Batch {
    /// Messages of records. `session` is another one after each start.
    #[must_use]
    pub fn records(session: u32) -> Self {
        Self { magic: RECORDS, session, next: 0, bytes: Vec::new() }
    }

    /// Messages of poses.
    #[must_use]
    pub fn poses(session: u32) -> Self {
        Self { magic: POSES, session, next: 0, bytes: Vec::new() }
    }

    /// The next item has this number. What was collected so far is given if the number does not follow it: send it first.
    #[must_use]
    pub fn number(&mut self, number: u64) -> Option<Vec<u8>> {
        let message = (number != self.next && !self.is_empty()).then(|| self.take());
        self.next = number;
        message
    }

    fn begin(&mut self) {
        if self.bytes.is_empty() {
            self.bytes.extend(self.magic);
            self.bytes.extend(self.session.to_le_bytes());
            self.bytes.extend(self.next.to_le_bytes());
        }
        self.next = self.next.saturating_add(1);
    }

    /// Adds a record.
    pub fn push_record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        self.begin();
        self.bytes.extend(host_us.unwrap_or(i64::MIN).to_le_bytes());
        let from = self.bytes.len();
        self.bytes.resize(from + record.emit_len(), 0);
        let emitted = self.bytes.get_mut(from..).map(|room| record.emit(room));
        if !matches!(emitted, Some(Ok(_))) {
            // Longer than any record: its number stays, so that it is counted where it is missed.
            self.bytes.truncate(from - 8);
        }
    }

    /// Adds a pose, in frame number `frame`.
    pub fn push_pose(&mut self, frame: u64, pose: Pose) {
        self.begin();
        self.bytes.extend(frame.to_le_bytes());
        let [x, y, z] = pose.position_m.into();
        for value in [pose.t_s, x, y, z, pose.heading_rad.unwrap_or(f64::NAN)] {
            self.bytes.extend(value.to_le_bytes());
        }
    }

    /// Bytes so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// True with nothing to send.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The message; the next one continues its numbers.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }
}
