//! Another robot's records and poses, as they come over a network: what is sent, and a bounded queue that is one more
//! source.
//!
//! A message is `magic (4) | session (4) | number of its first item (8)` and then items, little-endian. A record's item
//! is the host's receive time in microseconds since the Unix epoch (8; the smallest number for none) and the record as
//! a `.dat` log has it. A pose's item is five 64-bit floats: seconds since the Unix epoch, x, y, z in metres, heading in
//! radians (no number for none); one that begins a new frame has no time. Items are numbered from 0 within a session,
//! so that what a network drops is counted, and another session is told from a gap.

use super::{CsiSource, Error, Loss, Next, Stamps};
use crate::odometry::{NextPose, OdometrySource};
use crate::pose::Pose;
use crate::time::Instant;
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record};
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

const RECORDS: [u8; 4] = *b"c5r1";
const POSES: [u8; 4] = *b"c5p1";
const HEAD: usize = 16;
const POSE: usize = 40;

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

    fn begin(&mut self) {
        if self.bytes.is_empty() {
            self.bytes.extend(self.magic);
            self.bytes.extend(self.session.to_le_bytes());
            self.bytes.extend(self.next.to_le_bytes());
        }
        self.next += 1;
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

    /// Adds a pose, or the beginning of a new frame.
    pub fn push_pose(&mut self, pose: Option<Pose>) {
        self.begin();
        let none = Pose { t_s: f64::NAN, position_m: Vector3::zeros(), heading_rad: None };
        let pose = pose.unwrap_or(none);
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

/// What a queue counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counts {
    /// Items that came.
    pub received: u64,
    /// Items that the network dropped: their numbers are missing.
    pub missing: u64,
    /// Items dropped because too many waited.
    pub overflowed: u64,
    /// Messages that are none.
    pub foreign: u64,
    /// Times that the other side began anew.
    pub sessions: u64,
}

#[derive(Clone, Debug)]
enum Item {
    Record(Option<i64>, u8, Vec<u8>),
    Pose(NextPose),
    Missing(u64),
}

#[derive(Debug)]
struct Shared {
    queue: VecDeque<Item>,
    limit: usize,
    /// Session, and the number expected next.
    at: Option<(u32, u64)>,
    counts: Counts,
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
pub struct RemotePoses(Mailbox);

impl Mailbox {
    /// A queue in which at most `limit` items wait.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        let counts = Counts::default();
        Self(Arc::new(Mutex::new(Shared { queue: VecDeque::new(), limit: limit.max(1), at: None, counts })))
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

    /// What was counted.
    #[must_use]
    pub fn counts(&self) -> Counts {
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
        RemotePoses(self.clone())
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
            Some(_) => {
                self.counts.sessions += 1;
                if magic == POSES {
                    self.push(Item::Pose(NextPose::NewFrame));
                }
            }
            None => self.counts.sessions += 1,
        }
        let mut next = first;
        while !items.is_empty() {
            let item = if magic == RECORDS { record(&mut items)? } else { pose(&mut items)? };
            self.counts.received += 1;
            next += 1;
            self.at = Some((session, next));
            self.push(item);
        }
        self.at = Some((session, next));
        Some(())
    }

    fn miss(&mut self, missing: u64) {
        if missing > 0 {
            self.counts.missing += missing;
            self.push(Item::Missing(missing));
        }
    }

    /// The oldest goes first: what is new is of more use.
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
                Some(Item::Missing(more)) => *more += lost,
                Some(front) => {
                    // The loss takes the place of the next item, which goes with it.
                    *front = Item::Missing(lost + 1);
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

fn pose(items: &mut &[u8]) -> Option<Item> {
    let (item, rest) = items.split_at_checked(POSE)?;
    *items = rest;
    let value = |k: usize| item.get(8 * k..8 * k + 8)?.try_into().ok().map(f64::from_le_bytes);
    let (t_s, heading) = (value(0)?, value(4)?);
    let position_m = Vector3::new(value(1)?, value(2)?, value(3)?);
    let heading_rad = (!heading.is_nan()).then_some(heading);
    let pose = Pose { t_s, position_m, heading_rad };
    Some(Item::Pose(if t_s.is_nan() { NextPose::NewFrame } else { NextPose::Pose(pose) }))
}

impl CsiSource for RemoteCard {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self.shared.with(|shared| shared.queue.pop_front()) {
            Some(Item::Record(host_us, code, body)) => {
                self.body = body;
                let offset = self.number;
                self.number += 1;
                Ok(Next::Record(Stamps { at: now, host_us, offset }, Record { code, body: &self.body }))
            }
            Some(Item::Missing(dropped)) => Ok(Next::Lost(Loss::Overrun { dropped: Some(dropped) })),
            Some(Item::Pose(_)) | None => Ok(Next::Pending),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl OdometrySource for RemotePoses {
    fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
        loop {
            match self.0.with(|shared| shared.queue.pop_front()) {
                Some(Item::Pose(next)) => return Ok(next),
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOW: Instant = Instant::ZERO;

    fn message(batch: &mut Batch, bodies: std::ops::Range<u8>) -> Vec<u8> {
        for body in bodies {
            batch.push_record(Some(i64::from(body)), Record { code: 0xBB, body: &[body; 3] });
        }
        batch.take()
    }

    /// First bytes of the records that come out; losses as negative numbers.
    fn drain(card: &mut RemoteCard) -> Vec<i64> {
        std::iter::from_fn(|| match card.receive(NOW).unwrap() {
            Next::Record(stamps, record) => {
                assert_eq!(
                    (record.code, record.body.len(), stamps.host_us),
                    (0xBB, 3, Some(i64::from(record.body[0])))
                );
                Some(i64::from(record.body[0]))
            }
            Next::Lost(Loss::Overrun { dropped }) => Some(-(dropped.unwrap() as i64)),
            Next::Pending => None,
            other => panic!("{other:?}"),
        })
        .collect()
    }

    #[test]
    fn records_arrive_as_they_were_sent_and_gaps_are_counted() {
        let (mailbox, mut batch) = (Mailbox::new(100), Batch::records(7));
        let mut card = mailbox.card();
        mailbox.put(&message(&mut batch, 0..3));
        let lost = message(&mut batch, 3..5);
        mailbox.put(&message(&mut batch, 5..6));
        mailbox.put(&lost);
        assert_eq!(drain(&mut card), [0, 1, 2, -2, 5]);
        // Another session begins its numbers anew, and that is no loss.
        mailbox.put(&message(&mut Batch::records(8), 0..2));
        assert_eq!(drain(&mut card), [0, 1]);
        assert_eq!(mailbox.counts(), Counts { received: 6, missing: 2, sessions: 2, ..Counts::default() });
    }

    #[test]
    fn a_full_queue_drops_the_oldest_and_says_how_many() {
        let (mailbox, mut batch) = (Mailbox::new(4), Batch::records(1));
        mailbox.put(&message(&mut batch, 0..10));
        let got = drain(&mut mailbox.card());
        assert_eq!(got, [-7, 7, 8, 9]);
        assert_eq!(mailbox.counts().overflowed, 7);
    }

    #[test]
    fn poses_arrive_as_they_were_sent() {
        let pose = Pose { t_s: 1.5, position_m: Vector3::new(1.0, 2.0, 3.0), heading_rad: None };
        let turned = Pose { heading_rad: Some(-1.0), ..pose };
        let (mailbox, mut batch) = (Mailbox::new(10), Batch::poses(1));
        batch.push_pose(Some(pose));
        batch.push_pose(None);
        batch.push_pose(Some(turned));
        mailbox.put(&batch.take());
        let mut poses = mailbox.poses();
        let got: Vec<NextPose> = (0..4).map(|_| poses.receive(NOW).unwrap()).collect();
        assert_eq!(got, [NextPose::Pose(pose), NextPose::NewFrame, NextPose::Pose(turned), NextPose::Pending]);
    }

    proptest! {
        #[test]
        fn foreign_bytes_are_counted_and_nothing_more(
            cut in 0usize..200,
            noise in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let mailbox = Mailbox::new(10);
            mailbox.put(&noise);
            let whole = message(&mut Batch::records(3), 0..9);
            mailbox.put(whole.get(..cut).unwrap_or(&whole));
            mailbox.put(&[&whole[..HEAD], &noise[..]].concat());
            drain(&mut mailbox.card()).len();
            prop_assert!(mailbox.counts().received <= 20);
        }
    }
}
