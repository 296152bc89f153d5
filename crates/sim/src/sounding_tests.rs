//! The room and the TDMA state machine together.

use super::*;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use driver_iface::bfee::Bfee;
use std::collections::{BTreeMap, BTreeSet};

fn scene(robots: usize, duration_s: f64, sounding: &str, more: &str) -> Scene {
    let mut text = format!("duration_s = {duration_s}\n{more}\n[sounding]\n{sounding}\n");
    for robot in 0..robots {
        let (x, y) = (robot % 6, robot / 6);
        text += &format!("[[robot]]\nname = \"r{robot}\"\nposition_m = [{x}.0, {y}.0, 0.0]\n");
    }
    Scene::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// Frame numbers by role and by the sender's last MAC byte, of one robot's records.
fn numbers(port: &mut Port) -> BTreeMap<(&'static str, u8), Vec<u32>> {
    let (mut heard, mut now) = (BTreeMap::<_, Vec<u32>>::new(), Instant::ZERO);
    loop {
        match port.receive_with_role(now).unwrap() {
            (role, _, Next::Record(_, record)) => {
                let wsr = Bfee::new_checked(record.body).unwrap().wsr().unwrap();
                let role = match role {
                    FrameRole::Forward => "forward",
                    FrameRole::Backward => "backward",
                    FrameRole::Overheard => "overheard",
                    FrameRole::Unknown => panic!("a robot that sounds knows"),
                };
                heard.entry((role, wsr.mac.0[5])).or_default().push(wsr.frame_count.unwrap());
            }
            (.., Next::Pending) => now = port.next_at().unwrap(),
            (.., Next::End(_)) => return heard,
            (.., Next::Lost(lost)) => panic!("{lost:?}"),
        }
    }
}

#[test]
fn two_robots_sound_each_other_from_the_start_to_the_end() {
    for dialect in ["wsr", "native"] {
        let scene = scene(2, 10.0, &format!("rate_hz = 100\ndialect = \"{dialect}\""), "");
        let mut room = Room::new(&scene).unwrap();
        let (mut a, mut b) = (room.card(0).unwrap(), room.card(1).unwrap());
        let (a, b) = (numbers(&mut a), numbers(&mut b));
        let back = &a[&("backward", 1)];
        assert_eq!(&b[&("forward", 0)], back, "{dialect}: every number pairs");
        assert_eq!(*back, (1..=back.len() as u32).collect::<Vec<_>>());
        assert!((996..=1000).contains(&back.len()), "{dialect}: {} rounds in 10 s", back.len());
        assert_eq!((a.len(), b.len()), (1, 1), "{dialect}: nothing else is heard");
    }
}

#[test]
fn a_round_reaches_every_peer_and_roles_are_known() {
    let scene =
        scene(4, 5.0, "rate_hz = 50", "radio.send_jitter_us = 30\nradio.turn_around = { spread_us = 10, tail = 0.1 }");
    let mut room = Room::new(&scene).unwrap();
    let mut cards: Vec<Port> = (0..4).map(|robot| room.card(robot).unwrap()).collect();
    let heard: Vec<_> = cards.iter_mut().map(numbers).collect();
    for peer in 1..4u8 {
        let forth = &heard[usize::from(peer)][&("forward", 0)];
        assert_eq!(forth, &heard[0][&("backward", peer)]);
        assert!(forth.len() > 240, "{}", forth.len());
        assert!(heard[usize::from(peer)].keys().all(|&(role, from)| role == "overheard" || from == 0));
    }
    assert!(room.injected().iter().all(|injected| injected.collided == 0));
}

#[test]
fn initiators_take_turns() {
    let scene = scene(3, 20.0, "rate_hz = 100\ninitiators = [\"r0\", \"r1\", \"r2\"]\ndialect = \"native\"", "");
    let mut room = Room::new(&scene).unwrap();
    let mut cards: Vec<Port> = (0..3).map(|robot| room.card(robot).unwrap()).collect();
    for (own, card) in cards.iter_mut().enumerate() {
        let heard = numbers(card);
        for peer in (0..3u8).filter(|&peer| usize::from(peer) != own) {
            for role in ["forward", "backward"] {
                let numbers = &heard[&(role, peer)];
                let distinct: BTreeSet<_> = numbers.iter().collect();
                assert!(
                    numbers.len() > 400 && distinct.len() == numbers.len(),
                    "{own} {role} {peer}: {}",
                    numbers.len()
                );
            }
        }
    }
    assert!(room.injected().iter().all(|injected| injected.collided == 0));
}

#[test]
fn thirty_two_robots_run_at_the_highest_rate_that_fits() {
    let scene = scene(32, 2.0, "rate_hz = inf", "radio.mcs = 1");
    let mut room = Room::new(&scene).unwrap();
    let mut card = room.card(0).unwrap();
    let heard = numbers(&mut card);
    assert_eq!(heard.len(), 31);
    let pairs: usize = heard.values().map(Vec::len).sum();
    let rounds = heard.values().map(Vec::len).min().unwrap();
    assert!(rounds * 31 + 31 >= pairs && rounds > 80, "{rounds} rounds");
    let refused = scene_text_of_32().unwrap_err();
    assert!(refused.to_string().contains("do not fit") && refused.line() == Some(4), "{refused}");
}

fn scene_text_of_32() -> Result<Scene, SceneError> {
    let mut text = "duration_s = 2.0\n\n[sounding]\nrate_hz = 100\n".to_owned();
    for robot in 0..33 {
        text += &format!("[[robot]]\nname = \"r{robot}\"\nposition_m = [{robot}.0, 0.0, 0.0]\n");
    }
    Scene::from_toml(&text)
}

#[test]
fn losses_and_restarts_leave_the_exchange_running() {
    let more = "seed = 5";
    let mut scene = scene(3, 20.0, "rate_hz = 50", more);
    for robot in &mut scene.robot {
        robot.faults.loss = 0.3;
        robot.host_clock.drift_ppm = 20.0;
    }
    scene.robot[0].faults.restart_at_s = vec![8.0];
    let mut room = Room::new(&scene).unwrap();
    let (mut a, mut b) = (room.card(0).unwrap(), room.card(1).unwrap());
    let (a, b) = (numbers(&mut a), numbers(&mut b));
    // 0.7 of the forward frames arrive, 0.49 are answered and the answer is heard; 950 rounds but for the restart.
    let (forth, back) = (b[&("forward", 0)].len(), a[&("backward", 1)].len());
    assert!((600..720).contains(&forth) && (410..520).contains(&back), "{forth} {back}");
    let restarted = b[&("forward", 0)].windows(2).filter(|w| w[1] < w[0]).count();
    assert_eq!((restarted, room.injected()[0].restarts), (1, 1), "numbers begin again once");
}
