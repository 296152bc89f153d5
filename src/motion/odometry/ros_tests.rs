use super::*;
use crate::motion::odometry::SourceCounts;
use std::f64::consts::FRAC_PI_2;

const NOW_US: i64 = 1_700_000_000_000_000;

fn message(t_s: f64, frame: &str) -> Message<'_> {
    let stamp = (t_s as u32, ((t_s - t_s.floor()) * 1e9) as u32);
    // Turned by 90 degrees to the left, and not quite of length 1, as single precision leaves it.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Message { stamp, frame, position_m: [1.0, 2.0, 0.5], orientation: [0.0, 0.0, half * 1.01, half * 1.01] }
}

fn reader(stamp: Stamp, frame: Option<&str>) -> Reader {
    Reader::new(Wanted { stamp, frame: frame.map(str::to_owned) })
}

#[test]
fn a_pose_has_the_time_of_its_stamp_or_of_its_receipt() {
    let told = message(1_700_000_000.25, "odom");
    let (begins, pose) = reader(Stamp::Header, None).handle(&told, NOW_US + 300_000).unwrap();
    assert!(!begins && (pose.t_s - 1_700_000_000.25).abs() < 1e-6);
    assert!((pose.heading_rad.unwrap() - FRAC_PI_2).abs() < 1e-9 && pose.position_m == Vector3::new(1.0, 2.0, 0.5));
    let mut receipt = reader(Stamp::Receipt, None);
    let (_, pose) = receipt.handle(&told, NOW_US + 300_000).unwrap();
    assert!((pose.t_s - 1_700_000_000.3).abs() < 1e-6 && (receipt.counts.age_s - 0.05).abs() < 1e-6);
}

#[test]
fn what_cannot_be_a_pose_is_refused_and_counted() {
    let mut reader = reader(Stamp::Header, None);
    let good = message(1_700_000_000.0, "odom");
    for wrong in [
        Message { position_m: [f64::NAN, 0.0, 0.0], ..good },
        Message { position_m: [0.0, f64::NEG_INFINITY, 0.0], ..good },
        Message { orientation: [0.0; 4], ..good },
        Message { orientation: [f64::NAN, 0.0, 0.0, 1.0], ..good },
        Message { orientation: [f64::MAX; 4], ..good },
        Message { stamp: (0, 0), ..good },
    ] {
        assert_eq!(reader.handle(&wrong, NOW_US), None, "{wrong:?}");
    }
    assert!(reader.handle(&good, NOW_US).is_some());
    let counts = reader.counts;
    assert_eq!((counts.messages, counts.not_finite, counts.unstamped), (7, 5, 1));
}

#[test]
fn another_frame_is_refused_if_one_was_asked_for_and_begins_anew_if_not() {
    let mut asked = reader(Stamp::Header, Some("odom"));
    assert!(asked.handle(&message(1.0, "/odom"), 1_000_000).is_some(), "the slash of old means nothing");
    assert!(asked.handle(&message(1.1, "map"), 1_100_000).is_none());
    assert_eq!(asked.counts.other_frame, 1);
    let mut any = reader(Stamp::Header, None);
    let begins = |(frame, t_s)| any.handle(&message(t_s, frame), 0).unwrap().0;
    let told = [("odom", 1.0), ("odom", 1.1), ("map", 1.2), ("map", 1.15), ("map", 0.1), ("map", 0.2)];
    // A late one is late; stamps that go back by more than a second are of another run.
    assert_eq!(told.map(begins), [false, false, true, false, true, false]);
    assert_eq!(any.counts.new_frames, 2);
}

#[test]
fn stamps_of_another_clock_are_said() {
    let mut simulated = reader(Stamp::Header, None);
    simulated.handle(&message(12.5, "odom"), NOW_US).unwrap();
    let why = simulated.trouble().unwrap();
    assert!(why.contains("1699999987.5 s behind") && why.contains("receipt"), "{why}");
    let mut unstamped = reader(Stamp::Header, None);
    unstamped.handle(&message(0.0, "odom"), NOW_US);
    assert!(unstamped.trouble().unwrap().contains("no stamps"));
    let mut receipt = reader(Stamp::Receipt, None);
    receipt.handle(&message(0.0, "odom"), NOW_US).unwrap();
    assert_eq!(receipt.trouble(), None);
}

fn drained(source: &mut Topic, now: Instant) -> (usize, usize) {
    let (mut poses, mut frames) = (0, 0);
    loop {
        match source.receive(now).unwrap() {
            NextPose::Pose(_) => poses += 1,
            NextPose::NewFrame => frames += 1,
            _ => return (poses, frames),
        }
    }
}

#[test]
fn a_reader_that_stands_still_costs_poses_and_they_are_counted() {
    let inbox = Inbox::new("/odom", Wanted::default());
    let mut source = inbox.source();
    for k in 0..QUEUE + 10 {
        assert!(inbox.put(1, &message(1.0 + k as f64 * 1e-3, "odom"), 0));
    }
    inbox.dropped(5);
    inbox.unreadable();
    let counted = |source: &Topic| match source.counted() {
        Some(SourceCounts::Topic(counts)) => (counts.dropped, counts.unreadable),
        other => panic!("{other:?}"),
    };
    assert_eq!(counted(&source), (15, 1));
    assert_eq!(drained(&mut source, Instant::ZERO), (QUEUE, 0));
    // What waits in a frame that is over is of no use.
    inbox.put(1, &message(6.0, "odom"), 0);
    inbox.put(1, &message(6.1, "map"), 0);
    assert_eq!(drained(&mut source, Instant::ZERO), (1, 1));
    assert_eq!(counted(&source), (16, 1));
}

#[test]
fn a_new_connection_takes_over_with_its_first_message() {
    let inbox = Inbox::new("/odom", Wanted::default());
    let put = |connection, t_s| inbox.put(connection, &message(t_s, "odom"), 0);
    assert!(put(1, 1.0) && put(1, 1.1), "the old one goes on while the new one is silent");
    assert!(put(3, 1.2));
    assert!(!put(1, 1.3) && !put(2, 1.3), "and ends with it");
    assert_eq!((inbox.connection(), drained(&mut inbox.source(), Instant::ZERO)), (3, (3, 0)));
}

#[test]
fn silence_is_said_and_ends_with_the_next_message() {
    let inbox = Inbox::new("/odom", Wanted { stamp: Stamp::Receipt, frame: None });
    let mut source = inbox.source();
    let mut look = |ms: i64| {
        source.receive(Instant::from_us(ms * 1_000)).unwrap();
        source.trouble()
    };
    assert_eq!(look(0), None);
    assert_eq!(look(1_999), None);
    assert!(look(2_000).unwrap().starts_with("/odom: nothing comes: "));
    inbox.put(1, &message(1.0, "odom"), 1_000_000);
    assert_eq!(look(2_100), None);
    assert!(look(5_000).unwrap().contains("any more"));
    inbox.say(Some("the master does not answer".into()));
    assert_eq!(look(5_000).as_deref(), Some("/odom: the master does not answer"));
}
