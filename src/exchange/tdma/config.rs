//! The configuration of a scheduler.

use super::auth::Key;
use super::clock::Epoch;
use super::phy::Dialect;
use super::plan::{MAX_ROBOTS, Plan, PlanError, Request};
use crate::time::Instant;
use driver_iface::Mac;

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
    /// This robot wants the turn; otherwise it only answers ([`super::Tdma`] can change it).
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
    /// Shared key; needs [`super::Dialect::Native`] with `authenticated`.
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
    pub(super) fn link_macs(&self) -> Vec<Mac> {
        self.links.clone().unwrap_or_else(|| self.peers.iter().map(|peer| peer.mac).collect())
    }

    /// MACs of all other robots.
    pub(super) fn peer_macs(&self) -> Vec<Mac> {
        self.peers.iter().map(|peer| peer.mac).collect()
    }

    /// Checks the robots and the key against the plan.
    pub(super) fn check(&self, plan: &Plan) -> Result<(), PlanError> {
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
        let authenticated = matches!(plan.dialect(), Dialect::Native { authenticated: true, .. });
        if authenticated != self.key.is_some() { Err(PlanError::Key) } else { Ok(()) }
    }

    fn check_robots(&self, plan: &Plan) -> Result<(), PlanError> {
        let by_length = matches!(plan.dialect(), Dialect::Wsr { .. });
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
