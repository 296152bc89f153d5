//! Another robot's records and poses over a network: the message format, and a bounded queue as a source.
//!
//! A message is `magic (4) | session (4) | number of its first item (8)` and then items, little-endian. A record's item
//! is the host's receive time in microseconds since the Unix epoch (8; the smallest number for none) and the record as
//! a `.dat` log has it. A pose's item is the number of its frame (8) and five 64-bit floats: seconds since the Unix
//! epoch, x, y, z in metres, heading in radians (no number for none). Every pose names its frame, so that no loss mixes
//! two. Items are numbered from 0 within a session, dropped ones too, so that all losses are counted, and a new session
//! is distinguished from a gap.

use super::{CsiSource, Error, Loss, Next, Origin, Stamps};
use crate::internal::lock;
use crate::motion::odometry::{NextPose, OdometrySource};
use crate::motion::pose::Pose;
use crate::time::{Instant, Span};
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record};
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

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
        use_it(&mut lock(&self.0))
    }

    /// Takes a message as it came, at `now`: the queue belongs to the session that it has until nothing of it came for a second. A message
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
    fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
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
        if !super::append(record, &mut self.bytes) {
            // Its number stays, so that it is counted where it is missed.
            self.bytes.truncate(self.bytes.len() - 8);
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOW: Instant = Instant::ZERO;

    impl Mailbox {
        /// From whatever session.
        fn put(&self, message: &[u8]) {
            self.with(|shared| shared.owner = None);
            self.put_at(NOW, message);
        }
    }

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
        assert_eq!(mailbox.counts(), QueueCounts { received: 6, missing: 2, sessions: 2, ..QueueCounts::default() });
    }

    #[test]
    fn what_does_not_follow_begins_a_message_of_its_own() {
        let (mailbox, mut batch) = (Mailbox::new(100), Batch::records(7));
        let push =
            |batch: &mut Batch, body| batch.push_record(Some(body), Record { code: 0xBB, body: &[body as u8; 3] });
        assert_eq!(batch.number(5), None, "there is nothing to send yet");
        push(&mut batch, 0);
        assert_eq!(batch.number(6), None, "it follows");
        push(&mut batch, 1);
        let sent = batch.number(9).unwrap();
        push(&mut batch, 2);
        mailbox.put(&sent);
        mailbox.put(&batch.take());
        assert_eq!(drain(&mut mailbox.card()), [0, 1, -2, 2]);
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
        batch.push_pose(0, pose);
        batch.push_pose(1, turned);
        mailbox.put(&batch.take());
        let mut poses = mailbox.poses();
        let got: Vec<NextPose> = (0..4).map(|_| poses.receive(NOW).unwrap()).collect();
        assert_eq!(got, [NextPose::Pose(pose), NextPose::NewFrame, NextPose::Pose(turned), NextPose::Pending]);
    }

    #[test]
    fn a_new_frame_is_told_whatever_is_lost() {
        let pose = |t_s| Pose { t_s, position_m: Vector3::zeros(), heading_rad: None };
        // A queue of two, of which only the last pose is left.
        let (mailbox, mut batch) = (Mailbox::new(2), Batch::poses(1));
        let mut poses = mailbox.poses();
        batch.push_pose(0, pose(1.0));
        mailbox.put(&batch.take());
        assert_eq!(poses.receive(NOW).unwrap(), NextPose::Pose(pose(1.0)));
        (2..9).for_each(|k| batch.push_pose(1, pose(f64::from(k))));
        mailbox.put(&batch.take());
        assert_eq!(poses.receive(NOW).unwrap(), NextPose::NewFrame);
        assert_eq!(poses.receive(NOW).unwrap(), NextPose::Pose(pose(8.0)));
        // Another session has frames of its own, whatever their numbers.
        let mut other = Batch::poses(2);
        other.push_pose(1, pose(0.5));
        mailbox.put(&other.take());
        assert_eq!(poses.receive(NOW).unwrap(), NextPose::NewFrame);
        assert_eq!(poses.receive(NOW).unwrap(), NextPose::Pose(pose(0.5)));
    }

    #[test]
    fn hostile_numbers_are_numbers() {
        let mailbox = Mailbox::new(3);
        let mut batch = Batch::records(1);
        mailbox.put(&message(&mut batch, 0..1));
        assert!(batch.number(u64::MAX - 1).is_none());
        mailbox.put(&message(&mut batch, 0..1));
        mailbox.put(&[&message(&mut Batch::records(2), 0..1)[..], &[0; 7]].concat());
        let mut end = message(&mut Batch::records(3), 0..3);
        end[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        (0..2).for_each(|_| mailbox.put(&end));
        assert_eq!(mailbox.counts().missing, u64::MAX - 2);
        assert!(!drain(&mut mailbox.card()).is_empty());
    }

    #[test]
    fn a_second_sender_under_an_address_is_refused_until_the_first_is_silent() {
        let (mailbox, mut batch, mut rogue) = (Mailbox::new(100), Batch::records(7), Batch::records(8));
        let at = Instant::from_us;
        mailbox.put_at(at(0), &message(&mut batch, 0..2));
        mailbox.put_at(at(1_000), &message(&mut rogue, 50..60));
        mailbox.put_at(at(900_000), &message(&mut batch, 2..4));
        mailbox.put_at(at(1_800_000), &message(&mut rogue, 60..70));
        assert_eq!(drain(&mut mailbox.card()), [0, 1, 2, 3]);
        assert_eq!((mailbox.counts().contested, mailbox.counts().sessions), (2, 1));
        // A robot that was restarted has its address again after a second.
        mailbox.put_at(at(1_900_000), &message(&mut Batch::records(9), 0..2));
        assert_eq!(drain(&mut mailbox.card()), [0, 1]);
        assert_eq!((mailbox.counts().contested, mailbox.counts().sessions), (2, 2));
    }

    proptest! {
        #[test]
        fn foreign_bytes_are_counted_and_nothing_more(
            cut in 0usize..200,
            noise in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let (mailbox, mut batch) = (Mailbox::new(100), Batch::records(3));
            // Noise alone is no message: it would have to begin with the magic.
            mailbox.put(&noise);
            prop_assert_eq!(mailbox.counts(), QueueCounts { foreign: 1, ..QueueCounts::default() });
            // Of one that was cut, what is whole is taken: 14 bytes each.
            let whole = message(&mut batch, 0..9);
            let cut = cut.min(whole.len());
            mailbox.put(&whole[..cut]);
            let taken = cut.saturating_sub(HEAD) / 14;
            let mut expected: Vec<i64> = (0..taken as i64).collect();
            prop_assert_eq!(mailbox.counts().received, taken as u64);
            let intact = cut >= HEAD && (cut - HEAD).is_multiple_of(14);
            prop_assert_eq!(mailbox.counts().foreign, 1 + u64::from(!intact));
            // What comes after it is as good as ever, and what was missed is counted.
            mailbox.put(&message(&mut batch, 9..10));
            expected.extend((cut >= HEAD && taken < 9).then_some(taken as i64 - 9));
            expected.push(9);
            let got = drain(&mut mailbox.card());
            prop_assert_eq!(&got, &expected);
            // Behind a good head anything may stand, and nothing is taken twice.
            let before = mailbox.counts().received;
            mailbox.put(&[&whole[..HEAD], &noise[..]].concat());
            prop_assert_eq!(mailbox.counts().received, before);
        }
    }

    #[test]
    fn a_message_is_as_long_as_its_head_and_its_records() {
        let mut batch = Batch::records(7);
        assert_eq!((batch.len(), batch.is_empty()), (0, true));
        let record = Record { code: 0xBB, body: &[1, 2, 3] };
        for records in 1..4 {
            batch.push_record(None, record);
            assert_eq!((batch.len(), batch.is_empty()), (HEAD + records * (8 + record.emit_len()), false));
        }
        batch.push_record(None, Record { code: 0xBB, body: &vec![0; 1 << 16] });
        let sent = batch.take();
        assert_eq!(
            (sent.len(), batch.len()),
            (HEAD + 3 * (8 + record.emit_len()), 0),
            "one that is too long is left out"
        );
    }

    #[test]
    fn records_are_numbered_as_they_come_out_and_nothing_is_due_at_a_time() {
        let (mailbox, mut batch) = (Mailbox::new(4), Batch::records(7));
        mailbox.put(&message(&mut batch, 0..3));
        let mut card = mailbox.card();
        for number in 0..3 {
            let Next::Record(stamps, _) = card.receive(Instant::from_us(50)).unwrap() else {
                panic!("three were sent")
            };
            assert_eq!((stamps.origin, stamps.at), (Origin::Live { number }, Instant::from_us(50)));
        }
        assert_eq!((card.next_at(), mailbox.poses().next_at()), (None, None));
        // A queue has room for one item at least.
        let narrow = Mailbox::new(0);
        narrow.put(&message(&mut batch, 3..4));
        assert_eq!(drain(&mut narrow.card()), [3]);
    }

    #[test]
    fn what_is_no_message_is_counted_with_its_time_too() {
        let mailbox = Mailbox::new(4);
        for foreign in 1..4 {
            mailbox.put_at(NOW, b"no message of a robot");
            assert_eq!((mailbox.counts().foreign, mailbox.counts().contested), (foreign, 0));
        }
    }

    #[test]
    fn the_longest_record_that_a_log_can_hold_arrives() {
        let (mailbox, mut batch) = (Mailbox::new(4), Batch::records(7));
        let body = vec![5; MAX_LENGTH - 1];
        batch.push_record(None, Record { code: 0xBB, body: &body });
        mailbox.put(&batch.take());
        assert_eq!((mailbox.counts().received, mailbox.counts().foreign), (1, 0));
        let mut card = mailbox.card();
        assert!(matches!(card.receive(NOW), Ok(Next::Record(_, record)) if record.body == body));
    }
}
