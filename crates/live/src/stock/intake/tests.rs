use super::*;
use driver_iface::stock::{EventRepr, Options};

const NOW: Clocks = Clocks { monotonic_ns: 5_000_000_000, wall_us: Some(1_700_000_000_000_000) };

/// An event of a card, `age_us` before now, after `ring_full` losses.
fn event(card: u64, age_us: u64, ring_full: u32, command: u8, data: &[u8]) -> Vec<u8> {
    let time_ns = NOW.monotonic_ns as u64 - age_us * 1_000;
    let repr = EventRepr { card, time_ns, ring_full, command, data_len: data.len() as u32, ..EventRepr::default() };
    let mut out = vec![0; 32 + data.len()];
    repr.emit(data, &mut out).unwrap();
    out
}

fn phy(timestamp: u32) -> Vec<u8> {
    let mut data = vec![0; 64];
    data[1] = 1;
    data[4..8].copy_from_slice(&timestamp.to_le_bytes());
    data[60] = 0x24;
    data
}

fn csi() -> Vec<u8> {
    let mut data = vec![0; 20 + 192];
    (data[8], data[9], data[16]) = (3, 1, 192);
    data
}

/// Every turn of some events: records as (code, host time), and losses.
fn turns(intake: &mut Intake, events: &[Vec<u8>]) -> (Vec<(u8, Option<i64>)>, Vec<Loss>) {
    let (mut records, mut losses) = (Vec::new(), Vec::new());
    for event in events {
        intake.take(event);
        while intake.is_held() {
            match intake.turn(NOW) {
                Turn::Record(host_us) => records.push((intake.record().code, host_us)),
                Turn::Lost(loss) => losses.push(loss),
                Turn::Next => {}
            }
        }
    }
    (records, losses)
}

#[test]
fn host_times_are_those_of_the_kernel() {
    let mut intake = Intake::new(Options::default(), None);
    let events: Vec<_> = (0..3)
        .flat_map(|k| {
            [event(1, 3_000 - k * 1_000, 0, 0xC0, &phy(k as u32 * 1_000)), event(1, 2_990 - k * 1_000, 0, 0xBB, &csi())]
        })
        .collect();
    let (records, losses) = turns(&mut intake, &events);
    let at = |age_us: i64| (0xBB, Some(1_700_000_000_000_000 - age_us));
    assert_eq!((records, losses), (vec![at(2_990), at(1_990), at(990)], vec![]));
    intake.take(&event(1, 0, 0, 0xC0, &phy(3_000)));
    assert_eq!(intake.turn(NOW), Turn::Next);
    intake.take(&event(1, 0, 0, 0xBB, &csi()));
    assert_eq!(intake.turn(Clocks { wall_us: None, ..NOW }), Turn::Record(None));
}

#[test]
fn a_full_ring_is_reported_at_its_gap_and_no_record_spans_it() {
    let mut intake = Intake::new(Options::default(), None);
    let events = [
        event(1, 0, 0, 0xC0, &phy(1)),
        // The 0xBB of this frame and the 0xC0 of the next were lost.
        event(1, 0, 2, 0xBB, &csi()),
        event(1, 0, 2, 0xC0, &phy(2)),
        event(1, 0, 2, 0xBB, &csi()),
    ];
    let (records, losses) = turns(&mut intake, &events);
    assert_eq!(losses, [Loss::Overrun { dropped: Some(2) }]);
    assert_eq!(records.len(), 1);
    let counters = intake.counters();
    assert_eq!((counters.ring_full, counters.events, counters.records, counters.cards.no_phy), (2, 4, 1, 1));
    // The program's counter is 32 bits wide here, and wraps.
    let (mut intake, wrapped) = (Intake::new(Options::default(), None), event(1, 0, 1, 0xC0, &phy(1)));
    assert_eq!(turns(&mut intake, &[event(1, 0, u32::MAX, 0xC0, &phy(1)), wrapped]).1.len(), 2);
    assert_eq!(intake.counters().ring_full, u64::from(u32::MAX) + 2);
}

#[test]
fn cards_are_kept_apart() {
    let mut intake = Intake::new(Options::default(), None);
    let [a, b] = [0xffff_8880_0000_1000, 0xffff_8880_0000_2000];
    let events = [event(a, 0, 0, 0xC0, &phy(1)), event(b, 0, 0, 0xBB, &csi()), event(a, 0, 0, 0xBB, &csi())];
    let (records, _) = turns(&mut intake, &events);
    assert_eq!((records.len(), intake.counters().cards.no_phy, intake.counters().cards_seen), (1, 1, 2));
    // More cards than are kept: the counts of those that made room stay.
    let many: Vec<_> = (0..100).map(|k| event(k, 0, 0, 0xC0, &phy(1))).collect();
    turns(&mut intake, &many);
    let counters = intake.counters();
    assert_eq!((counters.cards_seen, counters.cards.phy, counters.cards.records), (102, 101, 1));
    intake.forget_cards();
    assert_eq!(intake.counters().cards.phy, 101);
    // After the driver's reload the 0xC0 from before it is not used.
    assert_eq!(turns(&mut intake, &[event(99, 0, 0, 0xBB, &csi())]).0.len(), 0);
}

#[test]
fn frames_of_a_card_without_csi_are_held_back() {
    let mut intake = Intake::new(Options::default().with_frames(true), None);
    let mut mpdu = vec![0; 4 + 40 + 4];
    mpdu[0] = 40;
    let frame = |card| [event(card, 0, 0, 0xC0, &phy(1)), event(card, 0, 0, 0xC1, &mpdu)];
    let of = |events: &[Vec<u8>], intake: &mut Intake| -> Vec<u8> {
        turns(intake, events).0.into_iter().map(|(code, _)| code).collect()
    };
    assert!(of(&frame(7), &mut intake).is_empty());
    assert_eq!(of(&[event(7, 0, 0, 0xBB, &csi())], &mut intake), [0xBB]);
    assert_eq!(of(&frame(7), &mut intake), [0xC1]);
    assert!(of(&frame(8), &mut intake).is_empty());
    assert_eq!(intake.counters().held_back, 2);
}

#[test]
fn invalid_events_are_counted() {
    let mut intake = Intake::new(Options::default(), None);
    let mut flagged = event(1, 0, 0, 0xC0, &phy(1));
    flagged[29] = 0x80;
    let (records, losses) = turns(&mut intake, &[vec![], vec![0; 31], flagged, event(1, 0, 0, 0xBB, &csi())]);
    assert!(records.is_empty() && losses.is_empty());
    assert_eq!((intake.counters().malformed, intake.counters().events), (3, 4));
}

#[test]
fn a_card_that_hears_this_robot_belongs_to_another() {
    let own = Mac([0, 0x21, 0x6a, 0, 0, 1]);
    let mut intake = Intake::new(Options::default(), Some(own));
    let mut mpdu = vec![0; 4 + 40 + 4];
    (mpdu[0], mpdu[44]) = (40, 3);
    let heard = |card: u64, sender: Mac| {
        let mut mpdu = mpdu.clone();
        mpdu[4 + 16..4 + 22].copy_from_slice(&sender.0);
        mpdu[4 + 27] = 9;
        vec![event(card, 0, 0, 0xC0, &phy(1)), event(card, 0, 0, 0xC1, &mpdu), event(card, 0, 0, 0xBB, &csi())]
    };
    let (peer, third) = (Mac([2; 6]), Mac([3; 6]));
    let mut given = |events: Vec<Vec<u8>>| turns(&mut intake, &events).0.len();
    // Card 1 is this robot's: it hears the peer. Card 2 is the peer's: from its first frame of this robot on nothing of it is given.
    assert_eq!(
        [given(heard(1, peer)), given(heard(2, own)), given(heard(2, third)), given(heard(1, third))],
        [1, 0, 0, 1]
    );
    assert_eq!((intake.counters().others, intake.counters().records), (2, 2));
    // A frame with a bad checksum says nothing of its sender.
    let mut bad = heard(1, own);
    let status = bad[1].len() - 4;
    bad[1][status] = 0;
    assert_eq!(turns(&mut intake, &bad).0.len(), 1);
}
