//! The round-robin TDMA scheduler: who sounds whom, when, and who answers. Sans-IO.
//!
//! A robot that wants bearings sounds its peers in turn: in every slot it sends a forward frame to one peer, which
//! answers at once with a backward frame of the same number. Both cards measure, and the carrier offset cancels in the
//! product of both measurements. A round is one exchange with every peer; after one or more rounds the turn goes to the
//! next robot that wants it.
//!
//! * [`Plan`] divides time into slots, and refuses a rate that does not fit with the highest that does.
//! * [`Tdma`] is one robot's state machine, with its contract. The live card's thread and the simulated air drive the
//!   same one.
//! * [`Dialect`] chooses between the frames of the WSR toolbox and the native ones of this project.
//!
//! ```
//! use csi5300::exchange::tdma::{Config, Epoch, Plan, PlanError, Request, Tdma};
//! use csi5300::driver_iface::Mac;
//! use csi5300::time::Instant;
//!
//! // Twelve peers at 100 rounds per second fit, 32 do not; the error says what would.
//! let plan = Plan::new(&Request::new(12, 100.0))?;
//! assert!(plan.slot_us() > f64::from(plan.shortest_slot_us()));
//! assert!(matches!(Plan::new(&Request::new(32, 100.0)), Err(PlanError::Rate { highest_hz, .. }) if highest_hz > 40.0));
//!
//! // Two robots on one air, without loss. The first initiates, the second answers.
//! let (a, b) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
//! let request = Request::new(1, 100.0);
//! let mut first = Tdma::new(&Config::new(a, 0, &[b], request, 1).with_initiate(true))?;
//! let mut second = Tdma::new(&Config::new(b, 0, &[a], request, 1))?;
//! let mut now = Instant::ZERO;
//! while first.counts().answered < 3 {
//!     now = now.max(first.poll_timeout().unwrap_or(now));
//!     let heard = first.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!     if let Some(frame) = heard {
//!         second.handle_heard(now, now, &frame);
//!         let answer = second.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!         first.handle_heard(now, now, &answer.unwrap_or_default());
//!     }
//! }
//! # Ok::<(), PlanError>(())
//! ```

pub(crate) mod auth;
mod machine;
mod plan;
pub(crate) mod roster;

pub use auth::Key;
pub(crate) use auth::{Proof, Prover};
pub use machine::{Epoch, Tdma, Transmit};
pub use plan::{Dialect, Phy, Plan, PlanError, Request};
pub use roster::Priority;

use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;
use plan::MAX_ROBOTS;

/// Something that the driver should know. Events are queued; see [`Tdma::poll_event`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A forward frame of this robot was answered: both cards have measured number `number` of this session.
    Answered {
        /// The responder.
        peer: Mac,
        /// The frame number that both frames carry.
        number: u32,
        /// The responder's session: another one than before means that it was restarted. 0 in the WSR dialect.
        peer_session: u32,
        /// What the responder measured, of this frame or an earlier one (see [`Measurement::number`]).
        measurement: Option<Measurement>,
    },
    /// A forward frame of this robot was not answered in time.
    Unanswered {
        /// The robot that should have answered.
        peer: Mac,
        /// The number of the forward frame.
        number: u32,
    },
    /// This robot heard a forward frame for itself; its answer is due at once.
    Asked {
        /// The initiator.
        peer: Mac,
        /// Its frame number.
        number: u32,
        /// Its session: numbers of different sessions do not belong together. 0 in the WSR dialect.
        session: u32,
    },
    /// Slots of this robot's turn were skipped, as the driver came later than the guard.
    Missed {
        /// How many in a row.
        slots: u32,
        /// From the start of the first of them to the driver's call.
        late: Span,
        /// From the start of one to that of the next.
        slot: Span,
    },
    /// A robot was heard for the first time, or again after it was absent.
    Joined(Mac),
    /// A robot has not answered 64 times in a row; it is asked less often from now on, and not given the turn.
    Absent(Mac),
    /// A robot restarted: its numbers restart in another session.
    Restarted {
        /// The robot.
        peer: Mac,
        /// Its new session.
        session: u32,
    },
    /// This robot initiates from now on. A renewed turn is no new event.
    TurnBegan {
        /// Number of the turn.
        turn: u32,
        /// How it got the turn.
        cause: Cause,
    },
    /// This robot's turn is over.
    TurnEnded {
        /// Number of the turn.
        turn: u32,
        /// Who is next, if the turn was passed on.
        next: Option<Mac>,
    },
    /// Another robot initiates at the same time and takes precedence: this robot's turn is over.
    Yielded {
        /// The robot that continues.
        to: Mac,
        /// Number of its turn.
        turn: u32,
    },
}

/// How a robot got the turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The last initiator passed it on.
    Passed,
    /// This robot passed it on, but nobody took it up.
    TakenBack,
    /// Nobody was heard for long.
    Claimed,
}

/// Everything that was counted since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct TdmaCounts {
    /// Forward frames handed to the driver, and not reported as not sent.
    pub forward: u64,
    /// Of these, answered.
    pub answered: u64,
    /// Of these, not answered in time.
    pub unanswered: u64,
    /// Slots in which a forward frame was due but the driver came later than the guard: skipped, not sent late.
    pub missed_slots: u64,
    /// Answers handed to the driver, and not reported as not sent.
    pub replies: u64,
    /// Answers that would have begun too late: skipped.
    pub missed_replies: u64,
    /// Turns begun.
    pub turns: u64,
    /// Turns given up to a rival.
    pub yields: u64,
    /// Turns lost because the driver was late.
    pub overslept: u64,
    /// Frames given to [`Tdma::handle_heard`].
    pub heard: u64,
    /// Of these: not sounding frames, of another dialect or version, or damaged.
    pub foreign: u64,
    /// From robots that are not in the list.
    pub strangers: u64,
    /// Copies of this robot's own frames.
    pub own_echoes: u64,
    /// Without a tag, or with a wrong one.
    pub unauthenticated: u64,
    /// With a key: measurements that were not sent, because the card reported two frames of their number.
    pub contested: u64,
    /// Forward frames heard before, or of an old session.
    pub replayed: u64,
    /// Backward frames for this robot that answer nothing (late, replayed, forged).
    pub unmatched: u64,
    /// Frames of another plan (round length or slots): answered, but ignored for turn and epoch.
    pub other_plan: u64,
    /// Frames that contradict an earlier initiator or turn.
    pub rivals: u64,
    /// Frames that contradict the epoch.
    pub off_epoch: u64,
    /// Events dropped because the driver did not fetch them; the oldest go first.
    pub events_lost: u64,
    /// Calls with a time before an earlier call's; they take the earlier time.
    pub time_ran_back: u64,
}

/// Counts of one link, this robot initiating.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LinkCounts {
    /// Forward frames sent.
    pub sounded: u64,
    /// Of these, answered.
    pub answered: u64,
}

/// A robot of the exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Robot {
    /// Its own MAC, addr3 of its frames.
    pub mac: Mac,
    /// WSR dialect: forward frames to it are `first_len + 2 * index` long (its driver's `ack_len`). Otherwise unused.
    #[doc(alias = "ack_len")]
    pub index: u16,
}

/// What a scheduler is made from: robots and request are the same on every robot, the rest is its own.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Config {
    /// This robot.
    pub own: Robot,
    /// All others, in any order.
    pub peers: Vec<Robot>,
    /// MACs of the peers that this robot sounds, in order of their slots; `None` for all, in order of `peers`.
    pub links: Option<Vec<Mac>>,
    /// Rate, frames and timing; `links` of the request are the slots of a round, at least as many as any robot's
    /// links. The same on every robot.
    pub request: Request,
    /// This robot wants the turn; otherwise it only answers ([`Tdma`] can change it).
    pub initiate: bool,
    /// This robot answers forward frames. False if the WSR kernel driver does it.
    pub respond: bool,
    /// The card measures answers, but they need not reach this scheduler, as with WSR's sender: links are sounded in
    /// every round, and no slot is skipped to listen.
    pub open_loop: bool,
    /// Number of this start: larger after every restart (wrapping), such as seconds since 1970. In the native dialect
    /// frame numbers are counted within it; with a key, robots ignore frames of an older session.
    pub session: u32,
    /// With a key: robots that were heard before this start, with their newest session and number: frames of an older
    /// session, or of this session up to this number, are ignored.
    pub heard: Vec<(Mac, u32, u32)>,
    /// Shared key; needs [`Dialect::Native`] with `authenticated`.
    pub key: Option<Key>,
    /// Where slot 0 is. The WSR dialect has no slot numbers, so there a heard epoch stays this robot's own.
    pub epoch: Epoch,
    /// When this robot is switched on, on its own clock. Before the first claim it listens for a while.
    pub start: Instant,
    /// Silence, in slots, after which the last initiator counts as gone. A turn that was passed on is taken back after
    /// one such silence, a lost one is claimed after two. At 60 % loss a robot that sounds in every slot is silent for
    /// 64 slots once in 10^14.
    pub silence_slots: u32,
    /// How long to wait for an answer, microseconds, at least a slot; the host may delay reception. A shorter time
    /// leaves a stranger less time to replay a lost answer, which no tag can prevent.
    pub patience_us: u32,
}

impl Config {
    /// A robot that only answers, with the epoch of the frames that it hears.
    ///
    /// Peers are given by MAC and get indices in their order; `own_index` is this robot's in the WSR dialect.
    #[must_use]
    pub fn new(own: Mac, own_index: u16, peers: &[Mac], request: Request, session: u32) -> Self {
        let peers = peers.iter().zip(0..).map(|(&mac, index)| Robot { mac, index }).collect();
        Self {
            own: Robot { mac: own, index: own_index },
            peers,
            links: None,
            request,
            initiate: false,
            respond: true,
            open_loop: false,
            session,
            heard: Vec::new(),
            key: None,
            epoch: Epoch::Heard(Instant::ZERO),
            start: Instant::ZERO,
            silence_slots: 64,
            patience_us: 10_000,
        }
    }

    /// Wants the turn, or only answers.
    #[must_use]
    pub const fn with_initiate(mut self, initiate: bool) -> Self {
        self.initiate = initiate;
        self
    }

    /// Number of this start, larger after every restart.
    #[must_use]
    pub const fn with_session(mut self, session: u32) -> Self {
        self.session = session;
        self
    }

    /// The shared key, or none.
    #[must_use]
    pub fn with_key(mut self, key: Option<Key>) -> Self {
        self.key = key;
        self
    }

    /// Where slot 0 is.
    #[must_use]
    pub const fn with_epoch(mut self, epoch: Epoch) -> Self {
        self.epoch = epoch;
        self
    }

    /// The MACs this robot sounds.
    fn link_macs(&self) -> Vec<Mac> {
        self.links.clone().unwrap_or_else(|| self.peers.iter().map(|peer| peer.mac).collect())
    }

    /// MACs of all other robots.
    fn peer_macs(&self) -> Vec<Mac> {
        self.peers.iter().map(|peer| peer.mac).collect()
    }

    /// Checks the robots and the key against the plan.
    fn check(&self, plan: &Plan) -> Result<(), PlanError> {
        let links = self.link_macs();
        if links.len() > usize::from(plan.slots) {
            return Err(PlanError::Links(links.len()));
        }
        if self.peers.len() >= MAX_ROBOTS {
            return Err(PlanError::Links(self.peers.len()));
        }
        for (position, mac) in links.iter().enumerate() {
            if !self.peers.iter().any(|peer| peer.mac == *mac) {
                return Err(PlanError::UnknownPeer(*mac));
            }
            if links.iter().skip(position + 1).any(|other| other == mac) {
                return Err(PlanError::Twice(*mac));
            }
        }
        self.check_robots(plan)?;
        let authenticated = matches!(plan.dialect, Dialect::Native { authenticated: true, .. });
        if authenticated != self.key.is_some() { Err(PlanError::Key) } else { Ok(()) }
    }

    fn check_robots(&self, plan: &Plan) -> Result<(), PlanError> {
        let by_length = matches!(plan.dialect, Dialect::Wsr { .. });
        for (position, robot) in self.peers.iter().enumerate() {
            let later = self.peers.iter().skip(position + 1);
            if later.chain([&self.own]).any(|other| other.mac == robot.mac) {
                return Err(PlanError::Twice(robot.mac));
            }
            let mut later = self.peers.iter().skip(position + 1);
            if by_length && later.any(|other| other.index == robot.index) {
                return Err(PlanError::Twice(robot.mac));
            }
            if by_length && robot.index > plan.slots {
                return Err(PlanError::Index { index: robot.index, links: plan.slots });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mac(last: u8) -> Mac {
        Mac([2, 0, 0, 0, 0, last])
    }

    /// What is wrong with robot 1 among 2, 3 and 4, changed so.
    fn fault(dialect: Dialect, change: impl FnOnce(&mut Config)) -> Option<PlanError> {
        let request = Request::new(3, 10.0).with_dialect(dialect);
        let mut config = Config::new(mac(1), 3, &[mac(2), mac(3), mac(4)], request, 1);
        change(&mut config);
        config.check(&Plan::new(&config.request).unwrap()).err()
    }

    const OPEN: Dialect = Dialect::Native { measurement: true, authenticated: false };
    const KEYED: Dialect = Dialect::Native { measurement: true, authenticated: true };
    const WSR: Dialect = Dialect::Wsr { first_len: 57 };

    #[test]
    fn robots_are_each_there_once_and_links_lead_to_them() {
        assert_eq!(fault(OPEN, |_| ()), None);
        let with =
            |links: &[u8]| fault(OPEN, |config| config.links = Some(links.iter().map(|last| mac(*last)).collect()));
        assert_eq!([with(&[]), with(&[4]), with(&[4, 2, 3])], [None, None, None]);
        assert_eq!(with(&[2, 9]), Some(PlanError::UnknownPeer(mac(9))));
        assert_eq!([with(&[3, 2, 3]), with(&[2, 3, 3])], [(); 2].map(|()| Some(PlanError::Twice(mac(3)))));
        assert_eq!(with(&[2, 3, 4, 2]), Some(PlanError::Links(4)));
        let robot = |last| Robot { mac: mac(last), index: 9 };
        assert_eq!(fault(OPEN, |config| config.peers.push(robot(1))), Some(PlanError::Links(4)));
        let of_peer = |last| {
            fault(OPEN, |config| {
                config.links = Some(vec![mac(2)]);
                config.peers.push(robot(last));
            })
        };
        assert_eq!(
            [of_peer(5), of_peer(1), of_peer(4)],
            [None, Some(PlanError::Twice(mac(1))), Some(PlanError::Twice(mac(4)))]
        );
    }

    #[test]
    fn there_are_at_most_255_peers() {
        let peers = |count: u16| {
            fault(OPEN, |config| {
                let peer = |index| Robot { mac: Mac([4, 0, 0, 0, (index >> 8) as u8, index as u8]), index };
                config.peers = (0..count).map(peer).collect();
                config.links = Some(Vec::new());
            })
        };
        assert_eq!([peers(255), peers(256)], [None, Some(PlanError::Links(256))]);
    }

    #[test]
    fn lengths_tell_wsr_robots_apart() {
        assert_eq!(fault(WSR, |_| ()), None);
        assert_eq!(fault(WSR, |config| config.peers[2].index = 0), Some(PlanError::Twice(mac(2))));
        assert_eq!(fault(OPEN, |config| config.peers[2].index = 0), None, "elsewhere they mean nothing");
        assert_eq!(fault(WSR, |config| config.peers[2].index = 3), None);
        assert_eq!(fault(WSR, |config| config.peers[2].index = 4), Some(PlanError::Index { index: 4, links: 3 }));
        assert_eq!(fault(OPEN, |config| config.peers[2].index = 4), None);
    }

    #[test]
    fn a_key_goes_with_tags() {
        let key = || Some(Key::new([7; 16]));
        assert_eq!(fault(KEYED, |config| config.key = key()), None);
        assert_eq!(fault(KEYED, |_| ()), Some(PlanError::Key));
        assert_eq!(fault(OPEN, |config| config.key = key()), Some(PlanError::Key));
        assert_eq!(fault(WSR, |config| config.key = key()), Some(PlanError::Key));
    }
}
