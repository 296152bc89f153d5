//! Any bytes as frames from the air, with or without a radiotap header: two robots continue, and no pair is reported that was not
//! sounded.
//!
//! The input is a list of `operation, argument, bytes`; see [`Step`]. It can replay, alter and delay frames that the robots sent.

use csi5300::exchange::tdma::{Config, Dialect, Event, Key, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::radiotap::Repr;
use driver_iface::sounding::native::Role;

const MACS: [Mac; 3] = [Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]), Mac([2, 0, 0, 0, 0, 3])];

/// One part of the input.
enum Step<'a> {
    /// Time passes: microseconds.
    Wait(i64),
    /// Both hear these bytes.
    Hear(&'a [u8]),
    /// Both hear the frame in these bytes, after their radiotap header.
    Packet(&'a [u8]),
    /// Both hear a frame sent before, with some bytes changed.
    Altered(usize, &'a [u8]),
    /// The first robot requests the turn, or not.
    Initiate(bool),
    /// The next deadline of the first robot comes.
    Due,
}

/// The next step, taken off the front of the input.
fn step<'a>(bytes: &mut &'a [u8]) -> Option<Step<'a>> {
    let [operation, argument, rest @ ..] = *bytes else { return None };
    let len = match operation % 8 {
        1 | 2 => usize::from(*argument),
        3 => 4,
        _ => 0,
    };
    let (part, rest) = rest.split_at(rest.len().min(len));
    *bytes = rest;
    Some(match operation % 8 {
        0 => Step::Wait(i64::from(*argument) * 97),
        1 => Step::Hear(part),
        2 => Step::Packet(part),
        3 => Step::Altered(usize::from(*argument), part),
        4 => Step::Initiate(argument % 2 == 0),
        _ => Step::Due,
    })
}

/// Two robots and what was sent so far.
struct Air {
    robots: [Tdma; 2],
    now: Instant,
    sent: Vec<Vec<u8>>,
    sounded: Vec<(Mac, u32)>,
}

impl Air {
    fn new(kind: u8) -> Self {
        let dialect = match kind % 3 {
            0 => Dialect::Native { measurement: true, authenticated: false },
            1 => Dialect::Native { measurement: false, authenticated: true },
            _ => Dialect::Wsr { first_len: 57 },
        };
        let request = Request { dialect, ..Request::new(2, 200.0) };
        let robot = |own: usize| {
            let peers: Vec<Mac> = MACS.iter().copied().filter(|mac| *mac != MACS[own]).collect();
            let mut config = Config {
                initiate: own == 0,
                key: (kind % 3 == 1).then(|| Key::new([7; 16])),
                ..Config::new(MACS[own], own as u16, &peers, request, 1)
            };
            config.silence_slots = 2;
            Tdma::new(&config).unwrap()
        };
        Self { robots: [robot(0), robot(1)], now: Instant::ZERO, sent: Vec::new(), sounded: Vec::new() }
    }

    fn hear(&mut self, bytes: &[u8]) {
        let now = self.now;
        self.robots.iter_mut().for_each(|robot| robot.handle_heard(now, now, bytes));
        self.serve();
    }

    fn serve(&mut self) {
        let now = self.now;
        for (k, robot) in self.robots.iter_mut().enumerate() {
            while let Some(transmit) = robot.poll_transmit(now) {
                assert!(transmit.at <= now && now <= transmit.latest, "sent late: {transmit:?} at {now:?}");
                if (k, transmit.role) == (0, Role::Forward) {
                    self.sounded.push((transmit.peer, transmit.number));
                }
                self.sent.push(transmit.frame.to_vec());
            }
            assert!(robot.poll_timeout().is_none_or(|at| at > now), "wants to be called again at once");
            while let Some(event) = robot.poll_event() {
                if let (0, Event::Answered { peer, number, .. }) = (k, event) {
                    assert!(self.sounded.contains(&(peer, number)), "a pair that was not sounded: {event:?}");
                }
            }
        }
    }
}

/// Runs the target; the first byte chooses the dialect.
pub fn run(bytes: &[u8]) {
    let Some((kind, mut rest)) = bytes.split_first() else { return };
    let mut air = Air::new(*kind);
    air.serve();
    while let Some(step) = step(&mut rest) {
        match step {
            Step::Wait(us) => air.now += Span::from_us(us),
            Step::Hear(frame) => air.hear(frame),
            Step::Packet(buffer) => {
                if let Ok((_, frame)) = Repr::parse(buffer) {
                    air.hear(&buffer[frame]);
                }
            }
            Step::Altered(back, changes) => {
                let Some(at) = air.sent.len().checked_sub(1 + back % 16) else { continue };
                let mut frame = air.sent[at].clone();
                for pair in changes.chunks_exact(2) {
                    let at = usize::from(pair[0]) % frame.len();
                    frame[at] ^= pair[1];
                }
                air.hear(&frame);
            }
            Step::Initiate(initiate) => air.robots[0].set_initiate(initiate),
            Step::Due => air.now = air.robots[0].poll_timeout().unwrap_or(air.now).max(air.now),
        }
        air.serve();
    }
}
