//! Messages through a queue: order, gaps, overflow, hostile bytes.

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
            assert_eq!((record.code, record.body.len(), stamps.host_us), (0xBB, 3, Some(i64::from(record.body[0]))));
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
    let push = |batch: &mut Batch, body| batch.push_record(Some(body), Record { code: 0xBB, body: &[body as u8; 3] });
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
    assert_eq!((sent.len(), batch.len()), (HEAD + 3 * (8 + record.emit_len()), 0), "one that is too long is left out");
}

#[test]
fn records_are_numbered_as_they_come_out_and_nothing_is_due_at_a_time() {
    let (mailbox, mut batch) = (Mailbox::new(4), Batch::records(7));
    mailbox.put(&message(&mut batch, 0..3));
    let mut card = mailbox.card();
    for number in 0..3 {
        let Next::Record(stamps, _) = card.receive(Instant::from_us(50)).unwrap() else { panic!("three were sent") };
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
