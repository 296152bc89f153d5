//! Who is believed: keys, sessions, and frames that were taped.

use super::air::everybody;
use super::hostile::{one_link, request};
use csi5300::exchange::tdma::{Config, Event, Key, PlanError, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;

#[test]
fn a_key_is_needed_on_both_sides_and_in_the_plan() {
    let key = Some(Key::new([1; 16]));
    let with = |authenticated, key| Tdma::new(&everybody(4, request(authenticated))[0].clone().with_key(key));
    assert_eq!(with(true, None).err(), Some(PlanError::Key));
    assert_eq!(with(false, key.clone()).err(), Some(PlanError::Key));
    assert!(with(true, key).is_ok());
}

#[test]
fn a_wrong_key_and_an_old_session_are_not_answered() {
    let configs = everybody(2, one_link());
    let with = |k: usize, key: u8, session| {
        let config = configs[k].clone().with_key(Some(Key::new([key; 16]))).with_session(session).with_initiate(k == 0);
        Tdma::new(&config).unwrap()
    };
    let first_frame = |mut tdma: Tdma| {
        let now = tdma.poll_timeout().unwrap();
        (now, tdma.poll_transmit(now).unwrap().frame.to_vec())
    };
    let (now, wrong) = first_frame(with(0, 2, 5));
    let (_, old) = first_frame(with(0, 1, 4));
    let (_, good) = first_frame(with(0, 1, 5));
    let mut responder = with(1, 1, 9);
    let mut answers = |frame: &[u8]| {
        responder.handle_heard(now, now, frame);
        responder.poll_transmit(now).is_some()
    };
    assert!(!answers(&wrong));
    assert!(answers(&good));
    assert!(!answers(&good), "a repetition");
    assert!(!answers(&old), "a restart has a later session");
    assert_eq!((responder.counts().unauthenticated, responder.counts().replayed), (1, 2));
}

#[test]
fn what_was_taped_before_a_restart_is_not_answered_after_it() {
    let configs = everybody(2, one_link());
    let key = Some(Key::new([1; 16]));
    let initiator = |session| configs[0].clone().with_key(key.clone()).with_session(session).with_initiate(true);
    let frames = |session| {
        let (mut tdma, mut frames) = (Tdma::new(&initiator(session)).unwrap(), Vec::new());
        while frames.len() < 3 {
            let now = tdma.poll_timeout().unwrap();
            frames.extend(tdma.poll_transmit(now).map(|transmit| (now, transmit.number, transmit.frame.to_vec())));
        }
        frames
    };
    let (old, current) = (frames(4), frames(5));
    let answers = |heard: &[(Mac, u32, u32)], (now, _, frame): &(Instant, u32, Vec<u8>)| {
        let mut config = configs[1].clone().with_key(key.clone()).with_session(9);
        config.heard = heard.to_vec();
        let mut responder = Tdma::new(&config).unwrap();
        responder.handle_heard(*now, *now, frame);
        responder.poll_transmit(*now).is_some()
    };
    assert!(answers(&[], &old[0]), "without memory a tape is as good as a frame");
    // It had heard session 5 up to the second frame's number.
    let heard = [(configs[0].own.mac, 5, current[1].1)];
    assert!(!answers(&heard, &old[0]) && !answers(&heard, &old[2]), "an older session");
    assert!(!answers(&heard, &current[0]) && !answers(&heard, &current[1]), "of this session, up to there");
    assert!(answers(&heard, &current[2]), "the exchange goes on");
    assert!(answers(&heard, &frames(6)[0]), "a newer session");
}

/// An initiator's exchanges with its first peer under a session: each forward frame with its answer.
fn exchanges(configs: &[Config], session: u32, count: usize) -> Vec<(Instant, Vec<u8>, Vec<u8>)> {
    let mut initiator = Tdma::new(&configs[0].clone().with_session(session)).unwrap();
    let mut responder = Tdma::new(&configs[1].clone().with_initiate(false)).unwrap();
    let mut found = Vec::new();
    while found.len() < count {
        let now = initiator.poll_timeout().unwrap();
        let Some(sent) = initiator.poll_transmit(now) else { continue };
        let (to, forward) = (sent.peer, sent.frame.to_vec());
        if to == configs[1].own.mac {
            responder.handle_heard(now, now, &forward);
            let answer = responder.poll_transmit(now).unwrap().frame.to_vec();
            found.push((now, forward, answer));
        }
    }
    found
}

/// Frames from robot 0 to the third, as far as the second can tell, are made by any robot of the group.
#[test]
fn what_a_robot_says_in_anothers_name_to_a_third_silences_nobody() {
    let key = Key::new([1; 16]);
    let configs = everybody(3, request(true));
    let of = |k: usize| {
        let peers: Vec<Mac> =
            configs.iter().map(|config| config.own.mac).filter(|mac| *mac != configs[k].own.mac).collect();
        configs[k].clone().with_key(Some(key.for_robot(configs[k].own.mac, &peers))).with_initiate(k == 0)
    };
    let frames = |session, to: usize| {
        let (mut tdma, mut frames) = (Tdma::new(&of(0).with_session(session)).unwrap(), Vec::new());
        while frames.len() < 4 {
            let now = tdma.poll_timeout().unwrap();
            let sent = tdma.poll_transmit(now).filter(|sent| sent.peer == configs[to].own.mac);
            frames.extend(sent.map(|sent| (now, sent.frame.to_vec())));
        }
        frames
    };
    let honest = frames(5, 1);
    for forged in [frames(5 + 0x7fff_0000, 2).remove(0).1, frames(5, 2).remove(3).1] {
        let mut responder = Tdma::new(&of(1).with_session(9)).unwrap();
        for (now, frame) in &honest {
            responder.handle_heard(*now, *now, &forged);
            responder.handle_heard(*now, *now, frame);
            assert!(responder.poll_transmit(*now).is_some(), "{:?}", responder.counts());
        }
        let events: Vec<Event> = std::iter::from_fn(|| responder.poll_event()).collect();
        assert!(!events.iter().any(|event| matches!(event, Event::Restarted { .. })), "{events:?}");
    }
    // The robot itself says it: an older session is not answered any more.
    let mut responder = Tdma::new(&of(1).with_session(9)).unwrap();
    let (now, anew) = frames(6, 1).remove(3);
    responder.handle_heard(now, now, &anew);
    assert!(responder.poll_transmit(now).is_some());
    responder.handle_heard(now, now, &honest[3].1);
    assert!(responder.poll_transmit(now).is_none() && responder.counts().replayed == 1);
}

/// Frames of robot 0 to all others, in order: when each was sent, to whom, and its bytes.
fn sent_by_the_first(configs: &[Config], count: usize) -> Vec<(Instant, Mac, Vec<u8>)> {
    let mut tdma = Tdma::new(&configs[0]).unwrap();
    std::iter::from_fn(|| {
        let now = tdma.poll_timeout()?;
        Some(tdma.poll_transmit(now).map(|sent| (now, sent.peer, sent.frame.to_vec())))
    })
    .flatten()
    .take(count)
    .collect()
}

/// Three robots with files of their own, of which the first initiates.
fn three_with_keys() -> Vec<Config> {
    let configs = everybody(3, request(true));
    let macs: Vec<Mac> = configs.iter().map(|config| config.own.mac).collect();
    let with_key = |(k, config): (usize, Config)| {
        let peers: Vec<Mac> = macs.iter().copied().filter(|mac| *mac != macs[k]).collect();
        config.with_key(Some(Key::new([1; 16]).for_robot(macs[k], &peers))).with_session(5).with_initiate(k == 0)
    };
    configs.into_iter().enumerate().map(with_key).collect()
}

/// A frame that was lost here, and is played later, is new; what was heard after it is not.
#[test]
fn a_tape_that_begins_with_a_lost_frame_is_not_heard_again() {
    let configs = three_with_keys();
    let own = configs[1].own.mac;
    let sent = sent_by_the_first(&configs, 60);
    // From the lost one on, the listener gets only what is for the third.
    let lost = sent.iter().skip(10).position(|(_, to, _)| *to == own).unwrap() + 10;
    let (before, tape) = sent.split_at(lost);
    let after: Vec<_> = tape.iter().filter(|(_, to, _)| *to != own).collect();
    let mut listener = Tdma::new(&configs[1]).unwrap();
    for (now, _, frame) in before.iter().chain(after.iter().copied()) {
        listener.handle_heard(*now, *now, frame);
        listener.poll_transmit(*now);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 0));
    let later = |k: usize| sent[59].0 + Span::from_ms(300 + 5 * k as i64);
    for (k, (_, _, frame)) in tape.iter().take(1).chain(after.iter().copied()).enumerate() {
        listener.handle_heard(later(k), later(k), frame);
        assert!(listener.poll_transmit(later(k)).is_none());
    }
    assert_eq!(listener.counts().replayed, after.len() as u64);
    assert_eq!(listener.counts().off_epoch, 1, "the lost one itself, which no turn and no answer follows");
}

/// A robot that sounds only a third one shows itself to the second by nothing but the slots it keeps to.
#[test]
fn a_robot_that_only_others_are_sounded_by_is_not_silenced_by_numbers_made_up_for_it() {
    let mut configs = three_with_keys();
    configs[0].links = Some(vec![configs[2].own.mac]);
    let sent = sent_by_the_first(&configs, 80);
    let mut listener = Tdma::new(&configs[1]).unwrap();
    for (k, (now, _, frame)) in sent.iter().take(40).enumerate() {
        if k == 5 {
            // Of the same session, but far ahead.
            listener.handle_heard(*now, *now, &sent[70].2);
        }
        listener.handle_heard(*now, *now, frame);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 1), "{:?}", listener.counts());
}

/// Two slots are as near as clocks tell them apart: there, numbers tell what is over.
#[test]
fn what_is_played_in_the_next_slot_is_not_heard_again() {
    let configs = three_with_keys();
    let mut responder = Tdma::new(&configs[1]).unwrap();
    let sent = sent_by_the_first(&configs, 60);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    let mut replays = 0;
    // Robot 0 sounds robot 1, then robot 2, which listens.
    let order = [configs[1].own.mac, configs[2].own.mac];
    for pair in sent.windows(2).filter(|pair| [pair[0].1, pair[1].1] == order) {
        let [(asked, _, forward), (now, _, own)] = pair else { unreachable!() };
        responder.handle_heard(*asked, *asked, forward);
        let answer = responder.poll_transmit(*asked).unwrap().frame.to_vec();
        // In every other round what is not for the listener is lost to it, and is played when its own frame was heard.
        let is_lost = replays % 2 == 0;
        let third = [forward, &answer];
        third.iter().filter(|_| !is_lost).for_each(|frame| listener.handle_heard(*asked, *asked, frame));
        listener.handle_heard(*now, *now, own);
        assert!(listener.poll_transmit(*now).is_some());
        third.iter().for_each(|frame| listener.handle_heard(*now, *now, frame));
        replays += 1;
        assert_eq!(listener.counts().replayed, 2 * replays, "{is_lost}");
    }
    assert!(replays > 20 && listener.counts().off_epoch == 0);
}

/// Before its restart an initiator had the same slots: its session tells.
#[test]
fn what_was_taped_in_the_same_slots_of_an_older_session_is_not_heard() {
    let mut configs = three_with_keys();
    let sent = sent_by_the_first(&configs, 30);
    configs[0].session = 4;
    let tape = sent_by_the_first(&configs, 30);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    for ((now, _, frame), (then, _, taped)) in sent.iter().zip(&tape) {
        assert_eq!(now, then);
        listener.handle_heard(*now, *now, frame);
        listener.handle_heard(*now, *now, taped);
    }
    assert_eq!((listener.counts().heard, listener.counts().replayed), (60, 30));
}

/// Answers to a robot whose numbers another one made up are heard, too, in their slots.
#[test]
fn answers_in_their_slots_are_heard_whatever_was_said_of_numbers() {
    let configs = three_with_keys();
    let heard = exchanges(&configs, 5, 60);
    let mut listener = Tdma::new(&configs[2]).unwrap();
    for (k, (now, forward, answer)) in heard.iter().take(30).enumerate() {
        if k == 5 {
            listener.handle_heard(*now, *now, &heard[50].1);
        }
        listener.handle_heard(*now, *now, forward);
        listener.handle_heard(*now, *now, answer);
    }
    assert_eq!((listener.counts().replayed, listener.counts().off_epoch), (0, 1), "{:?}", listener.counts());
    // The same once more, which is over.
    let now = heard[29].0;
    for (_, forward, answer) in heard.iter().take(30) {
        listener.handle_heard(now, now, forward);
        listener.handle_heard(now, now, answer);
    }
    assert_eq!(listener.counts().replayed, 59, "all but the last answer, which says nothing new");
}

#[test]
fn taped_answers_to_others_are_not_heard_again() {
    let key = Some(Key::new([1; 16]));
    let configs: Vec<Config> =
        everybody(3, request(true)).into_iter().map(|config| config.with_key(key.clone()).with_session(9)).collect();
    let (older, now) = (exchanges(&configs, 4, 1), exchanges(&configs, 5, 3));
    let mut listener = Tdma::new(&configs[2].clone().with_initiate(false)).unwrap();
    let mut replayed = |(at, frames): (Instant, &[&Vec<u8>])| {
        let before = listener.counts().replayed;
        frames.iter().for_each(|frame| listener.handle_heard(at, at, frame));
        listener.counts().replayed - before
    };
    for (at, forward, answer) in &now {
        assert_eq!(replayed((*at, &[forward, answer])), 0, "the exchange as it is");
    }
    let last = now[2].0;
    assert_eq!(replayed((last, &[&now[0].2, &now[1].2])), 2, "answers to frames before the last");
    assert_eq!(replayed((last, &[&older[0].2])), 1, "an answer to a frame of an older session");
}

#[test]
fn an_answer_that_comes_again_is_no_pair() {
    let configs = everybody(2, one_link().with_dialect(request(false).dialect));
    let mut initiator = Tdma::new(&configs[0]).unwrap();
    let mut responder = Tdma::new(&configs[1].clone().with_initiate(false)).unwrap();
    let now = initiator.poll_timeout().unwrap();
    let forward = initiator.poll_transmit(now).unwrap().frame.to_vec();
    responder.handle_heard(now, now, &forward);
    let answer = responder.poll_transmit(now).unwrap().frame.to_vec();
    for unmatched in 0..3 {
        initiator.handle_heard(now, now, &answer);
        assert_eq!((initiator.counts().answered, initiator.counts().unmatched), (1, unmatched));
    }
}

#[test]
fn without_a_key_answers_to_others_are_not_told_apart_by_their_age() {
    let configs = everybody(3, request(false));
    let (older, now) = (exchanges(&configs, 4, 1), exchanges(&configs, 5, 3));
    let mut listener = Tdma::new(&configs[2].clone().with_initiate(false)).unwrap();
    for (at, forward, answer) in now.iter().chain(&older) {
        listener.handle_heard(*at, *at, forward);
        listener.handle_heard(*at, *at, answer);
    }
    assert_eq!(listener.counts().replayed, 0, "a forged session could use up all to come");
    listener.handle_heard(older[0].0, older[0].0, &older[0].1);
    assert_eq!(listener.counts().replayed, 1, "the very repetition of the last forward frame");
}
