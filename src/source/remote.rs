//! Another robot's records and poses over a network: the message format, and a bounded queue as a source.
//!
//! A message is `magic (4) | session (4) | number of its first item (8)` and then items, little-endian. A record's item
//! is the host's receive time in microseconds since the Unix epoch (8; the smallest number for none) and the record as
//! a `.dat` log has it. A pose's item is the number of its frame (8) and five 64-bit floats: seconds since the Unix
//! epoch, x, y, z in metres, heading in radians (no number for none). Every pose names its frame, so that no loss mixes
//! two. Items are numbered from 0 within a session, dropped ones too, so that all losses are counted, and a new session
//! is distinguished from a gap.

mod batch;

pub use batch::Batch;

use super::{CsiSource, Error, Loss, Next, Origin, Stamps};
use crate::motion::odometry::{NextPose, OdometryError, OdometrySource};
use crate::motion::pose::Pose;
use crate::time::{Instant, Span};
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record};
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

const RECORDS: [u8; 4] = *b"c5r1";
const POSES: [u8; 4] = *b"c5p2";
/// A sender that is silent for this long loses its address to others.
const OWNED: Span = Span::from_ms(1_000);
const HEAD: usize = 16;
const POSE: usize = 48;

/// What a queue counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct QueueCounts {
    /// Items that came.
    pub received: u64,
    /// Items that the network dropped: their numbers are missing.
    pub missing: u64,
    /// Items dropped because too many waited.
    pub overflowed: u64,
    /// Messages that are none.
    pub foreign: u64,
    /// Times that the other side restarted.
    pub sessions: u64,
    /// Messages of a second sender under the same address: refused.
    pub contested: u64,
}

#[derive(Clone, Debug)]
enum Item {
    Record(Option<i64>, u8, Vec<u8>),
    /// A pose with the session and the number of its frame.
    Pose((u32, u64), Pose),
    Missing(u64),
}

#[derive(Debug)]
struct Shared {
    queue: VecDeque<Item>,
    limit: usize,
    /// Session, and the number expected next.
    at: Option<(u32, u64)>,
    counts: QueueCounts,
    /// Session that the queue belongs to, and when a message of it last came.
    owner: Option<(u32, Instant)>,
}

/// The end of a queue into which messages are put, from any thread.
#[derive(Clone, Debug)]
pub struct Mailbox(Arc<Mutex<Shared>>);

/// The records that come out of a [`Mailbox`].
#[derive(Debug)]
pub struct RemoteCard {
    shared: Mailbox,
    body: Vec<u8>,
    number: u64,
}

/// The poses that come out of a [`Mailbox`].
#[derive(Debug)]
pub struct RemotePoses {
    shared: Mailbox,
    /// Session and number of the last pose's frame.
    frame: Option<(u32, u64)>,
    /// A pose in a new frame, which is announced first.
    held: Option<Pose>,
}

impl Mailbox {
    /// A queue in which at most `limit` items wait.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        let counts = QueueCounts::default();
        Self(Arc::new(Mutex::new(Shared {
            queue: VecDeque::new(),
            limit: limit.max(1),
            at: None,
            counts,
            owner: None,
        })))
    }

    fn with<T>(&self, use_it: impl FnOnce(&mut Shared) -> T) -> T {
        use_it(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes a message as it came.
    pub fn put(&self, message: &[u8]) {
        self.with(|shared| {
            if shared.put(message).is_none() {
                shared.counts.foreign += 1;
            }
        });
    }

    /// The same with its time: the queue belongs to the session that it has until nothing of it came for a second. A message
    /// of another one meanwhile is of a second sender under this address; it is refused and counted.
    pub fn put_at(&self, now: Instant, message: &[u8]) {
        let session = message.get(4..8).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes);
        self.with(|shared| match (session, shared.owner) {
            (Some(session), Some((owner, at))) if session != owner && now - at < OWNED => {
                shared.counts.contested += 1;
            }
            _ => match shared.put(message) {
                Some(()) => shared.owner = session.map(|session| (session, now)),
                None => shared.counts.foreign += 1,
            },
        });
    }

    /// The counts.
    #[must_use]
    pub fn counts(&self) -> QueueCounts {
        self.with(|shared| shared.counts)
    }

    /// The other end, of a queue of records.
    #[must_use]
    pub fn card(&self) -> RemoteCard {
        RemoteCard { shared: self.clone(), body: Vec::new(), number: 0 }
    }

    /// The other end, of a queue of poses.
    #[must_use]
    pub fn poses(&self) -> RemotePoses {
        RemotePoses { shared: self.clone(), frame: None, held: None }
    }
}

impl Shared {
    fn put(&mut self, message: &[u8]) -> Option<()> {
        let (head, mut items) = message.split_at_checked(HEAD)?;
        let magic: [u8; 4] = head.get(..4)?.try_into().ok()?;
        let session = u32::from_le_bytes(head.get(4..8)?.try_into().ok()?);
        let first = u64::from_le_bytes(head.get(8..16)?.try_into().ok()?);
        if ![RECORDS, POSES].contains(&magic) {
            return None;
        }
        match self.at {
            Some((known, next)) if known == session && first >= next => self.miss(first - next),
            // An older message of this session, come late: its records were given up as missing.
            Some((known, _)) if known == session => return Some(()),
            _ => self.counts.sessions += 1,
        }
        let mut next = first;
        self.at = Some((session, next));
        while !items.is_empty() {
            let item = if magic == RECORDS { record(&mut items)? } else { pose(&mut items, session)? };
            self.counts.received += 1;
            next = next.saturating_add(1);
            self.at = Some((session, next));
            self.push(item);
        }
        self.at = Some((session, next));
        Some(())
    }

    fn miss(&mut self, missing: u64) {
        if missing > 0 {
            self.counts.missing = self.counts.missing.saturating_add(missing);
            self.push(Item::Missing(missing));
        }
    }

    /// The oldest is dropped first: new items are more useful.
    fn push(&mut self, item: Item) {
        if self.queue.len() >= self.limit {
            let lost = match self.queue.pop_front() {
                Some(Item::Missing(before)) => before,
                _ => {
                    self.counts.overflowed += 1;
                    1
                }
            };
            match self.queue.front_mut() {
                Some(Item::Missing(more)) => *more = more.saturating_add(lost),
                Some(front) => {
                    // The loss takes the place of the next item, which is dropped too.
                    *front = Item::Missing(lost.saturating_add(1));
                    self.counts.overflowed += 1;
                }
                None => self.queue.push_front(Item::Missing(lost)),
            }
        }
        self.queue.push_back(item);
    }
}

fn record(items: &mut &[u8]) -> Option<Item> {
    let (host, rest) = items.split_at_checked(8)?;
    let (length, rest) = rest.split_at_checked(LENGTH_FIELD)?;
    let length = usize::from(u16::from_be_bytes(length.try_into().ok()?));
    let (record, rest) = rest.split_at_checked(length)?;
    let &[code, ref body @ ..] = record else { return None };
    if length > MAX_LENGTH {
        return None;
    }
    *items = rest;
    let host_us = i64::from_le_bytes(host.try_into().ok()?);
    Some(Item::Record((host_us != i64::MIN).then_some(host_us), code, body.to_vec()))
}

fn pose(items: &mut &[u8], session: u32) -> Option<Item> {
    let (item, rest) = items.split_at_checked(POSE)?;
    *items = rest;
    let (frame, item) = item.split_first_chunk()?;
    let value = |k: usize| item.get(8 * k..8 * k + 8)?.try_into().ok().map(f64::from_le_bytes);
    let (t_s, heading) = (value(0)?, value(4)?);
    let position_m = Vector3::new(value(1)?, value(2)?, value(3)?);
    let heading_rad = (!heading.is_nan()).then_some(heading);
    let pose = Pose { t_s, position_m, heading_rad };
    Some(Item::Pose((session, u64::from_le_bytes(*frame)), pose))
}

impl CsiSource for RemoteCard {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self.shared.with(|shared| shared.queue.pop_front()) {
            Some(Item::Record(host_us, code, body)) => {
                self.body = body;
                let origin = Origin::Live { number: self.number };
                self.number += 1;
                Ok(Next::Record(Stamps { at: now, host_us, origin }, Record { code, body: &self.body }))
            }
            Some(Item::Missing(dropped)) => Ok(Next::Lost(Loss::Overrun { dropped: Some(dropped) })),
            Some(Item::Pose(..)) | None => Ok(Next::Pending),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl OdometrySource for RemotePoses {
    fn receive(&mut self, _: Instant) -> Result<NextPose, OdometryError> {
        if let Some(pose) = self.held.take() {
            return Ok(NextPose::Pose(pose));
        }
        loop {
            match self.shared.with(|shared| shared.queue.pop_front()) {
                Some(Item::Pose(frame, pose)) => {
                    if self.frame.replace(frame).is_some_and(|before| before != frame) {
                        self.held = Some(pose);
                        return Ok(NextPose::NewFrame);
                    }
                    return Ok(NextPose::Pose(pose));
                }
                Some(_) => {}
                None => return Ok(NextPose::Pending),
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

#[cfg(test)]
mod tests;
