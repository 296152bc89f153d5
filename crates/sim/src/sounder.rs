//! The senders on the robots' hosts: the TDMA state machine that live cards run too, driven in virtual time.

use super::radio::{DelayGroup, Radio};
use super::scene::{Dialect, Scene, Sounding};
use super::world::World;
use csi5300::exchange::tdma::{self, Config, Event, Plan, PlanError, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;

/// Silence after which a lost turn is taken, in slots, if only one robot wants it.
const ALONE_SILENCE_SLOTS: u32 = 2;
/// A guard is this many times the jitter of sending, and the usual delay with this many deviations beside it, so that
/// frames keep out of each other's slots.
const GUARD_PER_JITTER: f64 = 5.0;
const GUARD_DEVIATIONS: f64 = 3.0;

/// Hands a robot's sender a frame (no FCS) whose end was at `now` on its host's monotonic clock.
pub(super) fn hear(tdma: &mut Tdma, now: Instant, frame: &[u8]) -> FrameRole {
    tdma.handle_heard(now, now, frame);
    let mut role = FrameRole::Overheard;
    while let Some(event) = tdma.poll_event() {
        match event {
            Event::Asked { .. } => role = FrameRole::Forward,
            Event::Answered { .. } => role = FrameRole::Backward,
            _ => {}
        }
    }
    role
}

/// The request of a scene's sounding; an infinite rate becomes the highest that fits.
///
/// # Errors
/// [`PlanError`] when the rate does not fit, with the highest that does.
pub(super) fn request(scene: &Scene, sounding: &Sounding) -> Result<Request, PlanError> {
    let radios = || scene.robot.iter().map(|robot| scene.radio_of(robot));
    let longest = |of: fn(&Radio) -> f64| radios().map(of).fold(0.0, f64::max);
    let phy = tdma::Phy {
        mcs: radios().map(|radio| radio.mcs).min().unwrap_or(0),
        bandwidth: if scene.bandwidth_mhz == 40 { Bandwidth::Ht40 } else { Bandwidth::Ht20 },
    };
    let dialect = match sounding.dialect {
        Dialect::Wsr => tdma::Dialect::Wsr { first_len: wsr::DEFAULT_LEN as u16 },
        Dialect::Native => tdma::Dialect::Native { measurement: false, authenticated: false },
    };
    let request = Request {
        phy,
        dialect,
        turn_around_us: longest(|radio| radio.turn_around.max_us).ceil() as u32,
        guard_us: Request::default().guard_us.max(longest(lateness_us).ceil() as u32),
        ..Request::new(scene.robot.len().saturating_sub(1) as u16, sounding.rate_hz)
    };
    if sounding.rate_hz != f64::INFINITY {
        return Plan::new(&request).map(|_| request);
    }
    match Plan::new(&Request { rate_hz: 1e6, ..request }) {
        Err(PlanError::Rate { highest_hz, .. }) => Ok(Request { rate_hz: highest_hz, ..request }),
        Err(other) => Err(other),
        Ok(_) => Ok(Request { rate_hz: 1e6, ..request }),
    }
}

/// Lateness that few frames of a radio exceed, microseconds.
fn lateness_us(radio: &Radio) -> f64 {
    let DelayGroup { share, us, spread_us } = radio.send_delay;
    let delayed_us = if share > 0.0 { us + GUARD_DEVIATIONS * spread_us } else { 0.0 };
    GUARD_PER_JITTER * radio.send_jitter_us + delayed_us
}

/// The sender of a robot, switched on at `now` on its own clock, for the `restarts`-th time.
///
/// # Errors
/// [`PlanError`] as [`request`].
pub(super) fn sounder(world: &World, robot: usize, restarts: u64, now: Instant) -> Result<Option<Tdma>, PlanError> {
    let scene = world.scene();
    let Some(sounding) = &scene.sounding else { return Ok(None) };
    let request = request(scene, sounding)?;
    let initiators = scene.initiators();
    let index = |robot: usize| u16::try_from(robot).unwrap_or(u16::MAX);
    let peers = (0..scene.robot.len()).filter(|&peer| peer != robot);
    let begin = Instant::from_us((sounding.start_s * 1e6).round() as i64);
    let session = (scene.start_unix_s as u32).wrapping_add(restarts as u32);
    let mut config = Config {
        initiate: initiators.contains(&robot),
        epoch: tdma::Epoch::Heard(begin),
        ..Config::new(world.mac(robot), index(robot), &[], request, session)
    };
    config.start = now.max(begin);
    config.peers = peers.map(|peer| tdma::Robot { mac: world.mac(peer), index: index(peer) }).collect();
    if initiators.len() == 1 {
        config.silence_slots = ALONE_SILENCE_SLOTS;
        if restarts == 0 {
            // It has listened before the scene, and starts in its first slot.
            let listened = Plan::new(&request)?.span_of(2 * ALONE_SILENCE_SLOTS);
            config.start = begin - listened - Span::from_us(1);
        }
    }
    Tdma::new(&config).map(Some)
}

/// A frame's role for the robot that heard it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameRole {
    /// A forward frame for this robot, which it answers.
    Forward,
    /// The answer to a forward frame of this robot.
    Backward,
    /// Meant for others.
    Overheard,
    /// Unknown: this robot has no sender.
    Unknown,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Port, Room};
    use csi5300::source::{CsiSource, Next};
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
        let scene = scene(
            4,
            5.0,
            "rate_hz = 50",
            "radio.send_jitter_us = 30\nradio.turn_around = { spread_us = 10, tail = 0.1 }",
        );
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

    #[test]
    fn a_frame_sent_twice_has_the_same_role_twice() {
        for (dialect, twice) in [("wsr", 0), ("wsr", 1), ("native", 0), ("native", 1)] {
            let mut scene = scene(2, 10.0, &format!("rate_hz = 100\ndialect = \"{dialect}\""), "");
            scene.robot[twice].faults.retry = 0.2;
            let mut room = Room::new(&scene).unwrap();
            let mut cards = [room.card(0).unwrap(), room.card(1).unwrap()];
            cards.iter_mut().for_each(Port::own_only);
            let [a, b] = cards.each_mut().map(numbers);
            let (back, forth) = (&a[&("backward", 1)], &b[&("forward", 0)]);
            let copies = |heard: &[u32]| heard.windows(2).filter(|pair| pair[0] == pair[1]).count();
            let (of_answers, of_questions) = (copies(back), copies(forth));
            let (some, none) = if twice == 1 { (of_answers, of_questions) } else { (of_questions, of_answers) };
            assert!((150..250).contains(&some) && none == 0, "{dialect} {twice}: {some} {none}");
            assert!(room.injected().iter().all(|injected| injected.overheard == 0), "{dialect} {twice}");
        }
    }
}
