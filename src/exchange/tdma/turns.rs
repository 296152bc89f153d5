//! How a robot gets the turn, what it sends in it, and how the turn ends.

use super::event::{Cause, Event};
use super::machine::{Ready, Tdma};
use super::phy::Dialect;
use super::roster::rounds_before;
use super::view::Claim;
use crate::time::{Instant, Span};
use driver_iface::sounding::{native, wsr};

/// An initiator sounds in at least one of this many slots, so that others hear it.
const KEEP_ALIVE_SLOTS: u32 = 4;
/// An initiator without answers for this many slots listens in some.
const DEAF_SLOTS: u32 = 64;
/// A robot not heard for this many rounds does not get the turn.
const ALIVE_ROUNDS: i64 = 64;

/// This robot's turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    number: u32,
    /// The next slot to look at.
    slot: i64,
    /// First slot after the turn.
    end: i64,
    /// The peer whose turn is next; `None`: this robot. Fixed at the start, because sent frames announce it.
    next: Option<usize>,
    /// Slots since the last frame.
    idle_slots: u32,
}

/// A hash of `x` (the finaliser of SplitMix64).
fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Tdma {
    /// When the turn needs the next look: its next slot, or the slot in which this robot could take it.
    pub(super) fn turn_timeout(&self) -> Option<Instant> {
        let slot = match &self.turn {
            Some(turn) => turn.slot,
            None => self.next_beginning()?.0,
        };
        Some(self.clock.start(&self.plan, slot))
    }

    /// The forward frame that is due, if this robot has the turn or may take it now.
    pub(super) fn due_forward(&mut self) -> Option<Ready> {
        loop {
            // Also after a turn that ended here: for a late driver the next one may be due already.
            self.take_turn_if_due();
            let turn = self.turn?;
            let start = self.clock.start(&self.plan, turn.slot);
            if start > self.now {
                return None;
            }
            if turn.slot >= turn.end {
                self.end_turn(turn);
            } else if self.now - start > self.plan.span_of(self.silence_slots) {
                self.oversleep(turn);
            } else if let Some(ready) = self.use_slot(turn, start) {
                return Some(ready);
            }
        }
    }

    /// Uses or skips one slot of the turn.
    fn use_slot(&mut self, turn: Turn, start: Instant) -> Option<Ready> {
        let place = turn.slot.rem_euclid(i64::from(self.plan.slots)) as usize;
        let must_be_heard = turn.idle_slots + 1 >= KEEP_ALIVE_SLOTS;
        let due = self.roster.due(place, must_be_heard, self.open_loop).filter(|_| !self.listens_in(turn.slot));
        let latest = start + self.plan.guard();
        let in_time = self.now <= latest;
        let sent = due.is_some() && in_time;
        let idle_slots = if sent { 0 } else { turn.idle_slots + 1 };
        self.turn = Some(Turn { slot: turn.slot + 1, idle_slots, ..turn });
        let peer = due?;
        if !in_time {
            self.counts.missed_slots += 1;
            self.tell(Event::Missed { slots: 1, late: self.now - start, slot: self.plan.span_of(1) });
            return None;
        }
        self.number = self.number.checked_add(1).unwrap_or(1);
        let len = self.emit_forward(&turn, peer)?;
        self.note_forward(peer);
        let mac = self.roster.peer(peer)?.mac;
        let number = self.number;
        Some(Ready { role: native::Role::Forward, len, at: start, latest, peer: mac, number })
    }

    /// Two initiators without answers may be in step, so that their frames collide in every slot. So an unanswered
    /// initiator skips one slot in eight, by a pattern of its own.
    fn listens_in(&self, slot: i64) -> bool {
        let deaf = !self.open_loop && self.now - self.answered_at > self.plan.span_of(DEAF_SLOTS);
        deaf && mixed(slot.cast_unsigned() ^ u64::from(self.roster.own_rank) << 48).is_multiple_of(8)
    }

    /// Writes the forward frame to `peer` for the slot `turn.slot`.
    fn emit_forward(&mut self, turn: &Turn, peer: usize) -> Option<usize> {
        let target = self.roster.peer(peer)?;
        let buffer = &mut self.forward_buffer;
        if let Dialect::Wsr { first_len } = self.plan.dialect() {
            let len_with_fcs = wsr::forward_len(usize::from(first_len), usize::from(target.index));
            let repr = wsr::Repr { sender: self.own, number: self.number, len_with_fcs };
            return repr.emit(buffer, &mut self.filler).ok();
        }
        let next = turn.next.and_then(|next| self.roster.peer(next)).map_or(self.own, |next| next.mac);
        let repr = native::Repr {
            sender: self.own,
            number: self.number,
            role: native::Role::Forward,
            destination: target.mac,
            next,
            wants_turn: self.initiate,
            session: self.session,
            sender_session: self.session,
            turn: turn.number,
            left: u16::try_from(turn.end - turn.slot - 1).unwrap_or(u16::MAX),
            slot: turn.slot.cast_unsigned(),
            round_us: self.plan.round_us(),
            slots: self.plan.slots,
            measurement: None,
            tag: self.key.as_ref().map(|_| [0; native::TAG_LEN]),
        };
        let len = repr.emit(buffer).ok()?;
        if let (Some(key), Some(mpdu)) = (&self.key, buffer.get_mut(..len)) {
            native::set_tag(mpdu, key.tag(mpdu, repr.sender, repr.destination).unwrap_or_default());
        }
        Some(len)
    }

    /// Counts a forward frame and waits for its answer.
    fn note_forward(&mut self, peer: usize) {
        self.counts.forward += 1;
        if let Some(link) = self.roster.link_of_peer_mut(peer) {
            link.counts.sounded += 1;
        }
        let until = self.now + Span::from_us(self.patience_us);
        if let Some(oldest) = self.outstanding.push(self.number, peer, until) {
            self.give_up(oldest.peer, oldest.number);
        }
    }

    /// Starts a turn if it may start now.
    fn take_turn_if_due(&mut self) {
        if self.turn.is_some() {
            return;
        }
        let Some((slot, cause)) = self.next_beginning() else { return };
        if self.clock.start(&self.plan, slot) > self.now {
            return;
        }
        // Skips a number for a turn that this robot may not have heard of.
        let step = if cause == Cause::Passed { 1 } else { 2 };
        if let (Cause::TakenBack, Some((_, peer))) = (cause, self.passed)
            && let Some(peer) = self.roster.peer_mut(peer)
        {
            peer.let_turn_lapse = true;
        }
        let number = self.view.turn().wrapping_add(step);
        self.clock.lock();
        self.answered_at = self.now;
        self.begin_turn(number, slot);
        if let Some(turn) = &self.turn {
            self.tell(Event::TurnBegan { turn: turn.number, cause });
        }
    }

    /// The slot in which this robot may start a turn if it hears nothing until then, and the reason.
    fn next_beginning(&self) -> Option<(i64, Cause)> {
        if !self.initiate || !self.roster.has_links() {
            return None;
        }
        let silence = i64::from(self.silence_slots);
        let soonest = self.clock.slot_from(&self.plan, self.now - self.plan.guard());
        if let Some(claim) = self.view.current()
            && claim.next == Some(self.roster.own_rank)
            && claim.holder != self.roster.own_rank
            && soonest <= claim.end.saturating_add(silence / 2)
        {
            return Some((claim.end, Cause::Passed));
        }
        if let Some((end, _)) = self.passed
            && soonest <= end + silence + silence / 2
        {
            return Some((soonest.max(end + silence), Cause::TakenBack));
        }
        let quiet = self.clock.slot_from(&self.plan, self.quiet_since + self.plan.span_of(2 * self.silence_slots));
        Some((self.own_claim_slot(quiet.max(soonest), silence), Cause::Claimed))
    }

    /// The first slot from `from` on in which this robot may claim a lost turn: in the first half of its own window,
    /// so that the owner of the next one hears of it.
    fn own_claim_slot(&self, from: i64, silence: i64) -> i64 {
        let period = silence * self.roster.robots() as i64;
        let into_window = (from - i64::from(self.roster.own_rank) * silence).rem_euclid(period);
        if into_window < silence / 2 { from } else { from + period - into_window }
    }

    fn begin_turn(&mut self, number: u32, slot: i64) {
        let by_length = matches!(self.plan.dialect(), Dialect::Wsr { .. });
        let alive_since = rounds_before(self.now, self.plan.round_us(), ALIVE_ROUNDS);
        // WSR frames cannot name a successor or a turn: all turns are turn 0.
        let (number, next) = if by_length { (0, None) } else { (number, self.roster.next_initiator(alive_since)) };
        let end = slot + i64::from(self.plan.turn_slots());
        self.turn = Some(Turn { number, slot, end, next, idle_slots: 0 });
        self.passed = None;
        self.counts.turns += 1;
        let next = next.and_then(|next| self.roster.peer(next)).map_or(self.roster.own_rank, |next| next.rank);
        self.view.begin(Claim { holder: self.roster.own_rank, turn: number, next: Some(next), end });
    }

    /// A complete turn that was passed on ends with the first frame of a later turn, which may arrive slightly before
    /// this robot's own clock reaches the end.
    pub(super) fn end_turn_at_successor(&mut self, turn_heard: u32) {
        let used_up = |turn: &Turn| turn.slot >= turn.end && turn.next.is_some();
        if let Some(turn) = self.turn.filter(used_up)
            && turn_heard.wrapping_sub(turn.number).cast_signed() > 0
        {
            self.end_turn(turn);
        }
    }

    /// At the announced end: passes the turn on, renews it, or falls silent.
    fn end_turn(&mut self, turn: Turn) {
        self.turn = None;
        self.quiet_since = self.clock.start(&self.plan, turn.end);
        if turn.next.is_none() && self.initiate {
            self.begin_turn(turn.number.wrapping_add(1), turn.end);
            return;
        }
        self.passed = turn.next.map(|peer| (turn.end, peer));
        let next = turn.next.and_then(|next| self.roster.peer(next)).map(|next| next.mac);
        self.tell(Event::TurnEnded { turn: turn.number, next });
    }

    /// The driver was late for so long that the others may have continued.
    fn oversleep(&mut self, turn: Turn) {
        self.turn = None;
        self.quiet_since = self.now;
        self.counts.overslept += 1;
        let slots = turn.end.min(self.clock.slot_at(&self.plan, self.now) + 1) - turn.slot;
        let late = self.now - self.clock.start(&self.plan, turn.slot);
        let slots = u32::try_from(slots).unwrap_or(0);
        self.tell(Event::Missed { slots, late, slot: self.plan.span_of(1) });
        self.tell(Event::TurnEnded { turn: turn.number, next: None });
    }

    /// Another initiator takes precedence.
    pub(super) fn yield_to(&mut self, holder: u16) {
        if self.turn.take().is_none() {
            return;
        }
        self.counts.yields += 1;
        self.clock.unlock();
        let to = self.roster.peer_of_rank(holder).and_then(|at| self.roster.peer(at)).map(|peer| peer.mac);
        if let Some(to) = to {
            self.tell(Event::Yielded { to, turn: self.view.turn() });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::tdma::{Config, Epoch, Request};
    use driver_iface::Mac;

    fn mac(k: u16) -> Mac {
        Mac([2, 0x53, 0, 0, 0, k as u8])
    }

    /// Robot `k` of `robots`, which all want the turn and share a clock; a silence is 8 slots, a turn 32.
    fn robot(k: u16, robots: u16) -> Tdma {
        let peers: Vec<Mac> = (0..robots).filter(|other| *other != k).map(mac).collect();
        let mut config = Config::new(mac(k), k, &peers, Request::new(robots - 1, 100.0), 1).with_initiate(true);
        (config.silence_slots, config.epoch) = (8, Epoch::Common(Instant::ZERO));
        Tdma::new(&config).unwrap()
    }

    fn events(tdma: &mut Tdma) -> Vec<Event> {
        std::iter::from_fn(|| tdma.poll_event()).collect()
    }

    #[test]
    fn patterns_are_those_of_splitmix64() {
        let golden = 0x9e37_79b9_7f4a_7c15_u64;
        let first = [0xe220_a839_7b1d_cdaf, 0x6e78_9e6a_a1b9_65f4, 0x06c4_5d18_8009_454f];
        assert_eq!([1, 2, 3].map(|k: u64| mixed(golden.wrapping_mul(k))), first);
    }

    #[test]
    fn a_lost_turn_is_claimed_in_the_first_half_of_ones_own_window() {
        for k in 0..3 {
            let (tdma, window) = (robot(k, 3), 8 * i64::from(k));
            for (from, slot) in [(0, 0), (1, 1), (3, 3), (4, 24), (7, 24), (23, 24), (24, 24), (27, 27), (28, 48)] {
                assert_eq!(tdma.own_claim_slot(window + from, 8), window + slot, "robot {k} from {from}");
            }
        }
    }

    #[test]
    fn slots_slept_through_are_those_that_began() {
        for (later, missed) in [(9, 10), (31, 32), (40, 32)] {
            let mut tdma = robot(0, 2);
            let begun = tdma.poll_timeout().unwrap();
            assert!(tdma.poll_transmit(begun).is_some());
            let (slot, turn) = (tdma.turn.unwrap().slot, tdma.view.turn());
            let start = tdma.clock.start(&tdma.plan, slot);
            let now = tdma.clock.start(&tdma.plan, slot + later) + tdma.plan.guard();
            events(&mut tdma);
            assert!(tdma.poll_transmit(now).is_none());
            // The first slot of the turn was used.
            let slots = missed.min(31);
            let expected = [
                Event::Missed { slots, late: now - start, slot: tdma.plan.span_of(1) },
                Event::TurnEnded { turn, next: None },
            ];
            let mut said = events(&mut tdma);
            said.retain(|event| !matches!(event, Event::Unanswered { .. }));
            assert_eq!(said, expected, "{later} slots late");
            assert_eq!(tdma.counts().overslept, 1);
        }
    }

    #[test]
    fn a_turn_is_lost_after_a_silence_and_not_before() {
        for (later_us, lost) in [(0, 0), (1, 1)] {
            let mut tdma = robot(0, 2);
            let begun = tdma.poll_timeout().unwrap();
            assert!(tdma.poll_transmit(begun).is_some());
            let start = tdma.clock.start(&tdma.plan, tdma.turn.unwrap().slot);
            let now = start + tdma.plan.span_of(tdma.silence_slots) + Span::from_us(later_us);
            tdma.poll_transmit(now);
            assert_eq!((tdma.counts().overslept, tdma.has_turn()), (lost, lost == 0), "{later_us} us");
        }
    }

    #[test]
    fn a_turn_that_was_passed_on_is_taken_back_within_half_a_silence_more() {
        for (later, cause) in [(8, Cause::TakenBack), (12, Cause::TakenBack), (13, Cause::Claimed)] {
            let (mut first, _) = until_passed();
            let (end, _) = first.passed.unwrap();
            events(&mut first);
            // Nobody is heard, and the driver looks again only then.
            let mut now = first.clock.start(&first.plan, end + later);
            while !first.has_turn() {
                first.poll_transmit(now);
                now = first.poll_timeout().unwrap();
            }
            let causes = events(&mut first).into_iter().filter_map(|event| match event {
                Event::TurnBegan { cause, .. } => Some(cause),
                _ => None,
            });
            assert_eq!(causes.collect::<Vec<_>>(), [cause], "{later} slots after its end");
        }
    }

    /// Two robots of which the second one answers, and wants the turn, until it is promised to it.
    fn until_passed() -> (Tdma, Tdma) {
        let (mut first, mut second) = (robot(0, 2), robot(1, 2));
        while first.passed.is_none() {
            let now = first.poll_timeout().unwrap();
            let frame = first.poll_transmit(now).map(|sent| sent.frame.to_vec());
            if let Some(frame) = frame {
                second.handle_heard(now, now, &frame);
                let answer = second.poll_transmit(now).map(|sent| sent.frame.to_vec()).unwrap();
                first.handle_heard(now, now, &answer);
            }
        }
        (first, second)
    }

    #[test]
    fn a_turn_that_is_promised_is_taken_within_half_a_silence_with_the_next_number() {
        for (later, expected, step) in [(0, Cause::Passed, 1), (4, Cause::Passed, 1), (5, Cause::Claimed, 2)] {
            let (_, mut second) = until_passed();
            let claim = second.view.current().unwrap();
            events(&mut second);
            let mut now = second.clock.start(&second.plan, claim.end + later);
            while !second.has_turn() {
                second.poll_transmit(now);
                now = second.poll_timeout().unwrap();
            }
            let began = events(&mut second).into_iter().find_map(|event| match event {
                Event::TurnBegan { turn, cause } => Some((turn, cause)),
                _ => None,
            });
            assert_eq!(began, Some((claim.turn + step, expected)), "{later} slots after the end");
        }
    }

    #[test]
    fn only_a_turn_that_is_used_up_and_promised_ends_with_a_later_one() {
        let mut tdma = robot(0, 2);
        let begun = tdma.poll_timeout().unwrap();
        assert!(tdma.poll_transmit(begun).is_some());
        let turn = Turn { next: Some(0), ..tdma.turn.unwrap() };
        let used_up = Turn { slot: turn.end, ..turn };
        let cases =
            [(turn, 1, true), (used_up, 0, true), (Turn { next: None, ..used_up }, 1, true), (used_up, 1, false)];
        for (turn, later, goes_on) in cases {
            tdma.turn = Some(turn);
            tdma.end_turn_at_successor(turn.number + later);
            assert_eq!(tdma.has_turn(), goes_on, "{turn:?}, {later} turns later");
        }
    }

    #[test]
    fn a_late_driver_may_start_the_next_turn_in_the_call_that_ends_one() {
        let mut tdma = robot(0, 2);
        let begun = tdma.poll_timeout().unwrap();
        assert!(tdma.poll_transmit(begun).is_some());
        let turn = tdma.turn.unwrap();
        tdma.turn = Some(Turn { slot: turn.end, next: Some(0), ..turn });
        let mut taken_back = 0;
        for (later, late_us) in (0..48).flat_map(|later| [(later, 0), (later, 1)]) {
            let mut late = tdma.clone();
            let now = late.clock.start(&late.plan, turn.end + later) + Span::from_us(late_us);
            while late.poll_transmit(now).is_some() {}
            assert!(late.poll_timeout().unwrap() > now, "{later} slots and {late_us} us after the end");
            taken_back += usize::from(late.has_turn());
        }
        assert!(taken_back > 0);
    }

    #[test]
    fn an_unanswered_initiator_listens_in_its_own_slots() {
        let slots = |k, late_us| {
            let mut tdma = robot(k, 4);
            tdma.now = tdma.answered_at + tdma.plan.span_of(DEAF_SLOTS) + Span::from_us(late_us);
            (-800..800).filter(|slot| tdma.listens_in(*slot)).collect::<Vec<_>>()
        };
        assert_eq!(slots(0, 0), Vec::<i64>::new(), "it is not that long");
        let of = [0, 1, 2, 3].map(|k| slots(k, 1));
        for (k, own) in of.iter().enumerate() {
            assert!((120..280).contains(&own.len()), "one in eight: {}", own.len());
            for other in of.iter().skip(k + 1) {
                let halves = [-800..0, 0..800]
                    .map(|half| own.iter().filter(|slot| half.contains(*slot) && other.contains(slot)).count());
                assert!(halves.iter().all(|both| *both < 30), "{halves:?}");
            }
        }
    }
}
