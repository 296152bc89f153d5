//! What is heard, frame by frame: each is counted as what it is, as often as it comes, and as nothing else.

use super::*;
use crate::exchange::tdma::{Config, Epoch, Key, Request, TdmaCounts};

fn mac(k: u8) -> Mac {
    Mac([2, 0x53, 0, 0, 0, k])
}

fn request(authenticated: bool) -> Request {
    Request::new(2, 100.0).with_dialect(Dialect::Native { measurement: true, authenticated })
}

/// Robot 2 of three, which only listens and answers. It has slots of 5 ms from 0 on.
fn listener(key: Option<Key>) -> Tdma {
    let mut config = Config::new(mac(2), 2, &[mac(0), mac(1)], request(key.is_some()), 1).with_key(key);
    config.epoch = Epoch::Common(Instant::ZERO);
    Tdma::new(&config).unwrap()
}

/// A forward frame of the first slot from robot 0 to robot 1.
fn forward(number: u32) -> native::Repr {
    native::Repr {
        sender: mac(0),
        number,
        role: Role::Forward,
        destination: mac(1),
        next: mac(0),
        wants_turn: true,
        session: 9,
        sender_session: 9,
        turn: 40,
        left: 5,
        slot: 0,
        round_us: 10_000,
        slots: 2,
        measurement: None,
        tag: None,
    }
}

/// Robot 1's answer to it.
fn backward(number: u32) -> native::Repr {
    native::Repr { sender: mac(1), destination: mac(0), role: Role::Backward, ..forward(number) }
}

fn bytes(repr: &native::Repr) -> Vec<u8> {
    let mut bytes = vec![0; native::MAX_LEN];
    let len = repr.emit(&mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

/// Hears a frame that began so long after its slot.
fn hear_late(tdma: &mut Tdma, mpdu: &[u8], late_us: i64) {
    let airtime = Frame::new_checked(mpdu).map_or(Span::default(), |frame| tdma.airtime(&frame));
    let ended = Instant::from_us(late_us) + airtime;
    tdma.handle_heard(ended, ended, mpdu);
}

/// What is counted when such frames, numbered from 1, are heard one after the other.
fn counted(tdma: &mut Tdma, count: u32, mpdu: impl Fn(u32) -> Vec<u8>) -> TdmaCounts {
    (1..=count).for_each(|number| hear_late(tdma, &mpdu(number), 0));
    *tdma.counts()
}

#[test]
fn foreign_frames_are_counted_each_time() {
    let zero = TdmaCounts::default();
    let of = |mpdu: &dyn Fn(u32) -> Vec<u8>| counted(&mut listener(None), 3, mpdu);
    assert_eq!(of(&|number| bytes(&forward(number))), TdmaCounts { heard: 3, ..zero }, "as it should be");
    assert_eq!(of(&|number| bytes(&backward(number))), TdmaCounts { heard: 3, ..zero }, "an answer to another");
    assert_eq!(of(&|_| vec![0; 5]), TdmaCounts { heard: 3, foreign: 3, ..zero });
    let of_wsr = |number| {
        let mut bytes = [0; 80];
        let repr = wsr::Repr { sender: mac(0), number, len_with_fcs: 57 };
        let len = repr.emit(&mut bytes, &mut wsr::Lfsr::default()).unwrap();
        bytes[..len].to_vec()
    };
    assert_eq!(of(&of_wsr), TdmaCounts { heard: 3, foreign: 3, ..zero }, "another dialect");
    let of_two_sessions = |number| bytes(&native::Repr { sender_session: 8, ..forward(number) });
    assert_eq!(of(&of_two_sessions), TdmaCounts { heard: 3, foreign: 3, ..zero });
    let own = |number| bytes(&native::Repr { sender: mac(2), ..forward(number) });
    assert_eq!(of(&own), TdmaCounts { heard: 3, own_echoes: 3, ..zero });
    let of_a_stranger = |number| bytes(&native::Repr { sender: mac(3), ..forward(number) });
    assert_eq!(of(&of_a_stranger), TdmaCounts { heard: 3, strangers: 3, ..zero });
    let again = |_| bytes(&forward(1));
    assert_eq!(of(&again), TdmaCounts { heard: 3, replayed: 2, ..zero });
    let for_nothing = |number| bytes(&native::Repr { destination: mac(2), ..backward(number) });
    assert_eq!(of(&for_nothing), TdmaCounts { heard: 3, unmatched: 3, ..zero });
}

#[test]
fn frames_without_the_groups_tag_are_counted_each_time() {
    let tagged = |key: &Key, number| {
        let repr = native::Repr { tag: Some([0; native::TAG_LEN]), ..forward(number) };
        let mut mpdu = bytes(&repr);
        let tag = key.tag(&mpdu, repr.sender, repr.destination).unwrap();
        native::set_tag(&mut mpdu, tag);
        mpdu
    };
    let (key, other) = (Key::new([7; 16]), Key::new([8; 16]));
    let of = |mpdu: &dyn Fn(u32) -> Vec<u8>| counted(&mut listener(Some(key.clone())), 3, mpdu);
    assert_eq!(of(&|number| tagged(&key, number)), TdmaCounts { heard: 3, ..TdmaCounts::default() });
    let refused = TdmaCounts { heard: 3, unauthenticated: 3, ..TdmaCounts::default() };
    assert_eq!(of(&|number| tagged(&other, number)), refused);
    assert_eq!(of(&|number| bytes(&forward(number))), refused);
}

#[test]
fn without_a_key_an_answer_to_another_is_heard_whatever_its_age() {
    let mut tdma = listener(None);
    hear_late(&mut tdma, &bytes(&forward(7)), 0);
    for old in [native::Repr { session: 8, ..backward(7) }, backward(6)] {
        hear_late(&mut tdma, &bytes(&old), 0);
    }
    assert_eq!((tdma.counts().replayed, tdma.counts().heard), (0, 3));
}

#[test]
fn frames_of_another_plan_are_counted_each_time_and_followed_in_nothing() {
    let plan = listener(None).plan;
    let whole = u16::try_from(plan.turn_slots()).unwrap();
    let good = |number| native::Repr { left: whole - 1, ..forward(number) };
    for repr in [
        |number, _| native::Repr { round_us: 10_001, ..forward(number) },
        |number, _| native::Repr { slots: 3, ..forward(number) },
        |number, _| native::Repr { slot: MAX_SLOT + 1, ..forward(number) },
        |number, whole| native::Repr { left: whole, ..forward(number) },
    ] {
        let mut tdma = listener(None);
        let counts = counted(&mut tdma, 3, |number| bytes(&repr(number, whole)));
        assert_eq!(counts, TdmaCounts { heard: 3, other_plan: 3, ..TdmaCounts::default() });
        assert_eq!(tdma.initiator(), None);
    }
    let mut tdma = listener(None);
    assert_eq!(counted(&mut tdma, 3, |number| bytes(&good(number))).other_plan, 0, "a whole turn is left");
    assert_eq!(tdma.initiator(), Some(mac(0)));
    let last_slot = |number| bytes(&native::Repr { slot: MAX_SLOT, ..forward(number) });
    let counts = counted(&mut listener(None), 3, last_slot);
    assert_eq!((counts.other_plan, counts.off_epoch), (0, 3), "a slot like others, at another time");
}

#[test]
fn frames_beside_their_slot_are_counted_each_time_and_not_answered() {
    let mut tdma = listener(None);
    for (number, late_us, off_epoch) in [(1, 200, 0), (2, 201, 1), (3, 2_000, 2), (4, 2_000, 3), (5, -200, 3)] {
        let repr = native::Repr { destination: mac(2), ..forward(number) };
        hear_late(&mut tdma, &bytes(&repr), late_us);
        assert_eq!(tdma.counts().off_epoch, off_epoch, "{late_us} us late");
        let asked = std::iter::from_fn(|| tdma.poll_event()).any(|event| matches!(event, Event::Asked { .. }));
        assert_eq!(asked, late_us.abs() <= 200);
    }
    assert_eq!(tdma.counts().replayed, 0);
}

#[test]
fn answers_between_others_are_of_their_slot_or_the_next() {
    // A slot lasts 5 ms.
    for (late_us, off_epoch) in [(-5_001, 1), (-5_000, 0), (0, 0), (9_999, 0), (10_000, 1)] {
        let mut tdma = listener(None);
        let from = 100_000;
        for number in 1..4 {
            let repr = native::Repr { slot: 20, ..backward(number) };
            hear_late(&mut tdma, &bytes(&repr), from + late_us);
        }
        assert_eq!(tdma.counts().off_epoch, 3 * off_epoch, "{late_us} us");
    }
}

#[test]
fn a_frame_of_an_earlier_turn_is_a_rivals_each_time_until_it_convinces() {
    let mut tdma = listener(None);
    hear_late(&mut tdma, &bytes(&forward(1)), 0);
    for (number, rivals) in [(1, 1), (2, 2), (3, 3), (4, 3)] {
        let repr = native::Repr { sender: mac(1), destination: mac(0), turn: 39, ..forward(number) };
        hear_late(&mut tdma, &bytes(&repr), 0);
        assert_eq!(tdma.counts().rivals, rivals);
        assert_eq!(tdma.initiator(), Some(mac(u8::from(number == 4))));
    }
}

#[test]
fn a_robot_of_an_earlier_turn_is_welcome_after_two_silences_and_not_before() {
    // The silence is 64 slots.
    for (slot, late_us, welcome) in [(66, 0, false), (127, 0, false), (128, 0, false), (128, 1, true), (129, 0, true)] {
        let mut tdma = listener(None);
        hear_late(&mut tdma, &bytes(&forward(1)), 0);
        let repr = native::Repr { sender: mac(1), destination: mac(0), turn: 39, slot, ..forward(1) };
        hear_late(&mut tdma, &bytes(&repr), slot.cast_signed() * 5_000 + late_us);
        assert_eq!(tdma.initiator(), Some(mac(u8::from(welcome))), "slot {slot}");
        assert_eq!(tdma.counts().rivals, u64::from(!welcome));
    }
}

#[test]
fn the_epoch_follows_forward_frames_of_the_turn_and_nothing_else() {
    let epoch_after = |late: &native::Repr| {
        let config = Config::new(mac(2), 2, &[mac(0), mac(1)], request(false), 1);
        let mut tdma = Tdma::new(&config).unwrap();
        hear_late(&mut tdma, &bytes(&forward(1)), 0);
        assert!(tdma.is_synchronised());
        let before = tdma.clock.epoch();
        // In the middle of what is followed smoothly: a sixteenth of it, or of the error in a frame that is no rival's.
        hear_late(&mut tdma, &bytes(late), 160);
        (tdma.clock.epoch() - before).as_us()
    };
    assert_eq!(epoch_after(&forward(2)), 10);
    assert_eq!(epoch_after(&backward(1)), 0);
    assert_eq!(epoch_after(&native::Repr { sender: mac(1), destination: mac(0), turn: 39, ..forward(1) }), 0);
}

/// When the answer to a frame of the first slot that ended so late must begin.
fn latest_answer(tdma: &mut Tdma, late_us: i64) -> Option<Span> {
    let repr = native::Repr { destination: mac(2), ..forward(1) };
    hear_late(tdma, &bytes(&repr), late_us);
    let now = tdma.now;
    tdma.poll_transmit(now).map(|answer| answer.latest - Instant::ZERO)
}

#[test]
fn an_answer_begins_a_turn_around_after_its_frame_can_have_ended() {
    let plan = listener(None).plan;
    let airtime = plan.phy.airtime_us(native::len_with_fcs(false, false));
    let latest = |began_us| Some(Span::from_us(began_us + i64::from(airtime) + plan.turn_around().as_us()));
    // A frame begins a guard, 50 us, into its slot at most.
    for (late_us, began_us) in [(-20, -20), (0, 0), (50, 50), (51, 50), (200, 50)] {
        assert_eq!(latest_answer(&mut listener(None), late_us), latest(began_us), "{late_us} us late");
    }
    // Of another plan's frame the slot is not known.
    let mut tdma = listener(None);
    hear_late(&mut tdma, &bytes(&native::Repr { destination: mac(2), slots: 3, ..forward(1) }), 200);
    let now = tdma.now;
    assert_eq!(tdma.poll_transmit(now).map(|answer| answer.latest - Instant::ZERO), latest(200));
}

#[test]
fn the_initiator_and_robots_that_do_not_respond_answer_nobody() {
    let mut silent = listener(None);
    silent.respond = false;
    assert_eq!(latest_answer(&mut silent, 0), None);
    let mut config = Config::new(mac(2), 2, &[mac(0), mac(1)], request(false), 1).with_initiate(true);
    config.epoch = Epoch::Common(Instant::ZERO);
    let mut holder = Tdma::new(&config).unwrap();
    while !holder.has_turn() {
        let now = holder.poll_timeout().unwrap();
        holder.poll_transmit(now);
    }
    let slot = holder.clock.slot_at(&holder.plan, holder.now) + 1;
    let turn = holder.view.turn() - 1;
    let repr = native::Repr { destination: mac(2), slot: slot.cast_unsigned(), turn, ..forward(1) };
    hear_late(&mut holder, &bytes(&repr), slot * 5_000);
    assert_eq!((holder.has_turn(), holder.counts().rivals), (true, 1), "an earlier turn");
    assert!(holder.reply.is_none());
}

#[test]
fn without_a_key_the_answer_to_a_frame_with_a_tag_has_none() {
    let mut tdma = listener(None);
    let repr = native::Repr { destination: mac(2), tag: Some([5; native::TAG_LEN]), ..forward(1) };
    hear_late(&mut tdma, &bytes(&repr), 0);
    let now = tdma.now;
    let answer = tdma.poll_transmit(now).unwrap().frame.to_vec();
    assert_eq!(native::Repr::parse(&Frame::new_checked(&answer).unwrap()).unwrap().tag, None);
}
