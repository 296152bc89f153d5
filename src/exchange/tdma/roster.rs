//! The robots of the exchange: when each was heard, which links are due, whose turn may be next.

use super::{Config, LinkCounts};
use crate::time::Instant;
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;

/// A robot is absent after this many unanswered frames.
pub(super) const ABSENT_AFTER: u32 = 64;
/// An absent robot is sounded in one of this many rounds at most.
const ABSENT_ROUNDS: u16 = 8;

/// A robot's session, and the number of its last forward frame in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Reached {
    pub(super) session: Option<u32>,
    pub(super) number: Option<u32>,
}

impl Reached {
    /// Takes the session of a frame, and its number if it is a forward frame of the robot.
    pub(super) fn note(&mut self, session: u32, number: Option<u32>) {
        let is_same = self.session.replace(session) == Some(session);
        self.number = number.or(self.number.filter(|_| is_same));
    }

    /// The last number in this session.
    pub(super) fn number_in(&self, session: u32) -> Option<u32> {
        self.number.filter(|_| self.session == Some(session))
    }
}

/// What is known about one peer.
#[derive(Clone, Debug, Default)]
pub(super) struct Peer {
    pub(super) mac: Mac,
    pub(super) index: u16,
    /// Place among all robots by MAC, this one included.
    pub(super) rank: u16,
    pub(super) heard_at: Option<Instant>,
    pub(super) wants_turn: bool,
    /// Did not take the turn that it was given; cleared when heard.
    pub(super) let_turn_lapse: bool,
    /// By frames that it made; without a key, by all.
    pub(super) proven: Reached,
    /// Also by frames for others with only the group's tag. The robot's own statements later replace it.
    pub(super) overheard: Reached,
    pub(super) unanswered_in_a_row: u32,
    /// Numbers of the frames that were answered to it in its session.
    pub(super) asked: Asked,
    pub(super) measurement: Option<Measurement>,
    /// A measurement of an unanswered frame: it may have arrived before the frame itself.
    pub(super) early: Option<Measurement>,
    /// Number and card's clock of the last measurement that was handed over.
    pub(super) measured: Option<(u32, u32)>,
    /// The last number of which two frames were measured.
    pub(super) contested: Option<u32>,
}

impl Peer {
    /// Its numbers restart: everything kept for the old ones is obsolete.
    pub(super) fn forget_asked(&mut self) {
        (self.asked, self.measurement, self.early) = (Asked::default(), None, None);
    }
}

/// The numbers last answered to one initiator.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Asked {
    numbers: [Option<u32>; Asked::CAPACITY],
    next: usize,
}

impl Asked {
    /// The card reports a frame within a few exchanges or never.
    const CAPACITY: usize = 16;

    pub(super) fn push(&mut self, number: u32) {
        if let Some(place) = self.numbers.get_mut(self.next) {
            *place = Some(number);
        }
        self.next = (self.next + 1) % Self::CAPACITY;
    }

    pub(super) fn contains(&self, number: u32) -> bool {
        self.numbers.contains(&Some(number))
    }

    /// The number answered last.
    pub(super) fn last(&self) -> Option<u32> {
        self.numbers.get((self.next + Self::CAPACITY - 1) % Self::CAPACITY).copied().flatten()
    }
}

/// A link of this robot: slot `k` of a round belongs to link `k`.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) peer: usize,
    /// Rounds since an absent peer was sounded.
    rests: u16,
    pub(super) counts: LinkCounts,
}

/// All peers, in order of their MACs, and the links.
#[derive(Clone, Debug)]
pub(super) struct Roster {
    peers: Vec<Peer>,
    links: Vec<Link>,
    /// Rank of this robot.
    pub(super) own_rank: u16,
}

impl Roster {
    pub(super) fn new(config: &Config) -> Self {
        let mut robots = config.peers.clone();
        robots.sort_by_key(|robot| robot.mac);
        let own_rank = robots.iter().filter(|robot| robot.mac < config.own.mac).count() as u16;
        let heard = |mac| config.heard.iter().find(|(heard, ..)| config.key.is_some() && *heard == mac);
        let reached =
            |(_, session, number): &(Mac, u32, u32)| Reached { session: Some(*session), number: Some(*number) };
        let known = |mac| heard(mac).map(reached).unwrap_or_default();
        let peers = robots.iter().zip(0u16..).map(|(robot, at)| Peer {
            mac: robot.mac,
            index: robot.index,
            rank: if at >= own_rank { at + 1 } else { at },
            proven: known(robot.mac),
            overheard: known(robot.mac),
            ..Peer::default()
        });
        let mut roster = Self { peers: peers.collect(), links: Vec::new(), own_rank };
        let link = |peer| Link { peer, rests: 0, counts: LinkCounts::default() };
        roster.links = config.link_macs().into_iter().filter_map(|mac| roster.find(mac)).map(link).collect();
        roster
    }

    /// Robots of the exchange, this one included.
    pub(super) fn robots(&self) -> usize {
        self.peers.len() + 1
    }

    /// Place of a peer by MAC.
    pub(super) fn find(&self, mac: Mac) -> Option<usize> {
        self.peers.binary_search_by_key(&mac, |peer| peer.mac).ok()
    }

    pub(super) fn peer(&self, at: usize) -> Option<&Peer> {
        self.peers.get(at)
    }

    pub(super) fn peer_mut(&mut self, at: usize) -> Option<&mut Peer> {
        self.peers.get_mut(at)
    }

    /// `None` for this robot's own rank.
    pub(super) fn peer_of_rank(&self, rank: u16) -> Option<&Peer> {
        self.peers.iter().find(|peer| peer.rank == rank)
    }

    pub(super) fn peer_of_mac(&self, mac: Mac) -> Option<&Peer> {
        self.peers.get(self.find(mac)?)
    }

    pub(super) fn link_of_peer(&self, peer: usize) -> Option<&Link> {
        self.links.iter().find(|link| link.peer == peer)
    }

    pub(super) fn link_of_peer_mut(&mut self, peer: usize) -> Option<&mut Link> {
        self.links.iter_mut().find(|link| link.peer == peer)
    }

    /// True if this robot sounds anybody.
    pub(super) fn has_links(&self) -> bool {
        !self.links.is_empty()
    }

    /// The peer to sound in place `k` of a round, if that link is due. Call it once a round.
    ///
    /// `must_be_heard`: sound somebody in any case; in a place without a link, the next best. `open_loop`: absent
    /// robots are sounded like others.
    pub(super) fn due(&mut self, k: usize, must_be_heard: bool, open_loop: bool) -> Option<usize> {
        if must_be_heard && k >= self.links.len() {
            return self.links.get(k % self.links.len().max(1)).map(|link| link.peer);
        }
        let link = self.links.get_mut(k)?;
        let absent = !open_loop && self.peers.get(link.peer)?.unanswered_in_a_row >= ABSENT_AFTER;
        link.rests = if absent { (link.rests + 1) % ABSENT_ROUNDS } else { 0 };
        (link.rests == 0 || must_be_heard).then_some(link.peer)
    }

    /// The next robot by MAC that wants the turn, was heard since `alive_since` and did not let its last turn lapse.
    pub(super) fn next_initiator(&self, alive_since: Instant) -> Option<usize> {
        let able = |peer: &&Peer| {
            let alive = peer.heard_at.is_some_and(|at| at >= alive_since);
            alive && peer.wants_turn && !peer.let_turn_lapse
        };
        let after = self.peers.iter().filter(able).find(|peer| peer.rank > self.own_rank);
        let first = after.or_else(|| self.peers.iter().find(able))?;
        self.find(first.mac)
    }

    /// Notes that a peer was heard. True if it was unknown or absent before.
    pub(super) fn hear(&mut self, at: usize, now: Instant) -> bool {
        let Some(peer) = self.peers.get_mut(at) else { return false };
        let joined = peer.heard_at.is_none() || peer.unanswered_in_a_row >= ABSENT_AFTER;
        peer.heard_at = Some(now);
        peer.let_turn_lapse = false;
        peer.unanswered_in_a_row = 0;
        joined
    }
}

/// A forward frame that waits for its answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    pub(super) number: u32,
    pub(super) peer: usize,
    pub(super) until: Instant,
    answered: bool,
}

/// Forward frames whose answers may still come, oldest first; never more than [`Outstanding::CAPACITY`].
#[derive(Clone, Debug)]
pub(super) struct Outstanding {
    waiting: std::collections::VecDeque<Waiting>,
}

impl Outstanding {
    const CAPACITY: usize = 64;

    pub(super) fn new() -> Self {
        Self { waiting: std::collections::VecDeque::with_capacity(Self::CAPACITY) }
    }

    /// Adds a frame; gives back the oldest if there is no room.
    pub(super) fn push(&mut self, number: u32, peer: usize, until: Instant) -> Option<Waiting> {
        let full = self.waiting.len() >= Self::CAPACITY;
        let oldest = if full { self.waiting.pop_front() } else { None };
        self.waiting.push_back(Waiting { number, peer, until, answered: false });
        oldest.filter(|waiting| !waiting.answered)
    }

    /// Marks a frame as answered by `peer`. False if it does not wait for that answer.
    pub(super) fn answer(&mut self, number: u32, peer: usize) -> bool {
        let found = self.waiting.iter_mut().rev().find(|waiting| waiting.number == number && waiting.peer == peer);
        found.is_some_and(|waiting| !std::mem::replace(&mut waiting.answered, true))
    }

    /// Takes back a frame that was not sent; `None` if it does not wait.
    pub(super) fn take_back(&mut self, number: u32) -> Option<Waiting> {
        let at = self.waiting.iter().rposition(|waiting| waiting.number == number && !waiting.answered)?;
        self.waiting.remove(at)
    }

    /// The oldest unanswered frame whose time is over.
    pub(super) fn expired(&mut self, now: Instant) -> Option<Waiting> {
        loop {
            let front = self.waiting.front().copied().filter(|front| front.answered || front.until <= now)?;
            self.waiting.pop_front();
            if !front.answered {
                return Some(front);
            }
        }
    }

    /// When the next frame's time is over.
    pub(super) fn next_at(&self) -> Option<Instant> {
        self.waiting.iter().find(|waiting| !waiting.answered).map(|waiting| waiting.until)
    }
}

/// The number before an initiator's first: robots count from places as far from each other as 31 bits allow, by their
/// `rank` among the `robots` of the exchange, so that the counts of two initiators in one log never meet.
///
/// The first robot starts with 1, like WSR's sender. Two robots are 2^30 numbers apart, 12 days at 1,000 a second.
#[must_use]
pub fn before_first_number(rank: u16, robots: usize) -> u32 {
    let apart = (1u32 << 31) / u32::try_from(robots.max(1)).unwrap_or(u32::MAX);
    u32::from(rank).wrapping_mul(apart)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::tdma::Request;

    fn mac(last: u8) -> Mac {
        Mac([2, 0, 0, 0, 0, last])
    }

    fn roster(own: u8, peers: &[u8]) -> Roster {
        let macs: Vec<Mac> = peers.iter().map(|last| mac(*last)).collect();
        Roster::new(&Config::new(mac(own), 0, &macs, Request::new(peers.len() as u16, 10.0), 1))
    }

    #[test]
    fn ranks_are_the_same_on_every_robot() {
        let (a, b) = (roster(3, &[9, 1, 5]), roster(5, &[3, 1, 9]));
        let rank = |roster: &Roster, last: u8| roster.find(mac(last)).map(|at| roster.peers[at].rank);
        assert_eq!((a.own_rank, b.own_rank), (1, 2));
        assert_eq!((rank(&a, 5), rank(&b, 3)), (Some(2), Some(1)));
        for last in [1, 9] {
            assert_eq!(rank(&a, last), rank(&b, last));
        }
        for at in 0..3 {
            assert_eq!(a.peer_of_rank(a.peers[at].rank).map(|peer| peer.mac), Some(a.peers[at].mac));
        }
        assert!(a.peer_of_rank(1).is_none() && a.peer_of_rank(4).is_none());
    }

    #[test]
    fn an_absent_robot_is_sounded_in_one_of_eight_rounds() {
        let mut roster = roster(1, &[2, 3]);
        let absent = roster.links[1].peer;
        roster.peers[absent].unanswered_in_a_row = ABSENT_AFTER;
        let mut rounds = |count: usize, open_loop: bool| {
            let mut due = |k: usize| (0..count).filter(|_| roster.due(k, false, open_loop).is_some()).count();
            [due(0), due(1)]
        };
        assert_eq!([rounds(7, false), rounds(1, false), rounds(800, false)], [[7, 0], [1, 1], [800, 100]]);
        assert_eq!(rounds(800, true), [800; 2]);
        assert_eq!(roster.due(2, false, false), None, "no link, no frame");
        assert_eq!(roster.due(2, true, false), roster.due(0, true, false), "unless the initiator must be heard");
        assert!(roster.due(1, true, false).is_some(), "an initiator must be heard");
    }

    #[test]
    fn an_answer_counts_once_and_only_from_the_robot_asked() {
        let mut outstanding = Outstanding::new();
        outstanding.push(7, 2, Instant::from_us(100));
        assert!(!outstanding.answer(7, 1));
        assert!(!outstanding.answer(6, 2));
        assert!(outstanding.answer(7, 2));
        assert!(!outstanding.answer(7, 2));
        outstanding.push(8, 1, Instant::from_us(200));
        assert_eq!(outstanding.next_at(), Some(Instant::from_us(200)));
        assert!(outstanding.expired(Instant::from_us(199)).is_none());
        assert_eq!(outstanding.expired(Instant::from_us(200)).map(|waiting| waiting.number), Some(8));
        assert!(!outstanding.answer(8, 1), "too late");
    }

    #[test]
    fn the_last_sixteen_numbers_answered_are_known() {
        let mut asked = Asked::default();
        assert_eq!(asked.last(), None);
        for number in 100..140 {
            asked.push(number);
            assert_eq!(asked.last(), Some(number));
            let known: Vec<u32> = (0..200).filter(|number| asked.contains(*number)).collect();
            assert_eq!(known, (100.max(number - 15)..=number).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_turn_goes_by_mac_to_robots_that_are_alive_want_it_and_took_the_last_one() {
        let now = Instant::from_us(1_000);
        let mut roster = roster(3, &[1, 2, 4, 5]);
        let next = |roster: &Roster| roster.next_initiator(now).map(|at| roster.peers[at].mac.0[5]);
        assert_eq!(next(&roster), None, "nobody was heard");
        for at in 0..4 {
            (roster.peers[at].heard_at, roster.peers[at].wants_turn) = (Some(now), true);
        }
        assert_eq!(next(&roster), Some(4));
        roster.peers[2].wants_turn = false;
        assert_eq!(next(&roster), Some(5));
        roster.peers[3].let_turn_lapse = true;
        assert_eq!(next(&roster), Some(1), "after the last the first");
        roster.peers[0].heard_at = Some(Instant::from_us(999));
        assert_eq!(next(&roster), Some(2));
    }

    #[test]
    fn a_peer_joins_when_it_is_heard_first_and_after_it_was_absent() {
        let mut roster = roster(1, &[2, 3]);
        assert_eq!((roster.robots(), roster.has_links()), (3, true));
        assert!(roster.hear(0, Instant::ZERO) && !roster.hear(0, Instant::ZERO), "once");
        roster.peers[0].unanswered_in_a_row = ABSENT_AFTER - 1;
        assert!(!roster.hear(0, Instant::ZERO));
        roster.peers[0].unanswered_in_a_row = ABSENT_AFTER;
        roster.peers[0].let_turn_lapse = true;
        assert!(roster.hear(0, Instant::from_us(5)));
        let peer = &roster.peers[0];
        assert_eq!((peer.heard_at, peer.unanswered_in_a_row), (Some(Instant::from_us(5)), 0));
        assert!(!peer.let_turn_lapse && !roster.hear(2, Instant::ZERO), "nobody is in place 2");
        assert_eq!((roster.link_of_peer(1).map(|link| link.peer), roster.link_of_peer(2).is_none()), (Some(1), true));
    }

    #[test]
    fn frames_that_wait_are_bounded_and_can_be_taken_back() {
        let mut outstanding = Outstanding::new();
        let at = |us: u32| Instant::from_us(i64::from(us));
        let push = |outstanding: &mut Outstanding, n| outstanding.push(n, 0, at(n)).map(|oldest| oldest.number);
        assert!((0..64).all(|n| push(&mut outstanding, n).is_none()));
        assert!(outstanding.answer(1, 0));
        assert_eq!([64, 65, 66].map(|n| push(&mut outstanding, n)), [Some(0), None, Some(2)], "1 was answered");
        assert!(outstanding.take_back(1).is_none() && outstanding.take_back(2).is_none());
        assert_eq!(outstanding.take_back(3).map(|waiting| (waiting.number, waiting.until)), Some((3, at(3))));
        assert_eq!((outstanding.next_at(), outstanding.expired(at(3)).is_none()), (Some(at(4)), true));
    }

    #[test]
    fn a_frame_without_a_number_keeps_that_of_its_own_session_only() {
        let mut reached = Reached::default();
        reached.note(4, Some(70));
        reached.note(4, None);
        assert_eq!((reached.number_in(4), reached.number_in(5)), (Some(70), None));
        reached.note(5, None);
        assert_eq!((reached.number_in(4), reached.number_in(5)), (None, None));
        reached.note(5, Some(1));
        assert_eq!(reached.number_in(5), Some(1));
    }
}
