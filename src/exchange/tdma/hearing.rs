//! The meaning of each received frame, in either dialect.

use super::auth::Shown;
use super::event::Event;
use super::machine::{Ready, Tdma};
use super::phy::Dialect;
use super::view::Claim;
use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::{self, Role};
use driver_iface::sounding::{Frame, wsr};

/// Slot numbers beyond this are no slot numbers: 2^40 slots of 100 us are three years.
const MAX_SLOT: u64 = 1 << 40;

/// True if `a` is later than `b`, both wrapping.
fn is_after(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}

/// How the reception time of a forward frame fits its slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// Within the tolerance of clocks and drivers.
    InSlot,
    /// At another time.
    OffSlot,
    /// Its slots are not this robot's.
    Unknown,
}

impl Tdma {
    /// Takes one frame in.
    pub(super) fn hear(&mut self, ended: Instant, mpdu: &[u8]) {
        let Ok(frame) = Frame::new_checked(mpdu) else {
            self.counts.foreign += 1;
            return;
        };
        if frame.sender() == self.own {
            self.counts.own_echoes += 1;
            return;
        }
        let Some(peer) = self.roster.find(frame.sender()) else {
            self.counts.strangers += 1;
            return;
        };
        match self.plan.dialect() {
            Dialect::Wsr { first_len } => self.hear_wsr(ended, &frame, peer, usize::from(first_len)),
            Dialect::Native { .. } => match native::Repr::parse(&frame) {
                Ok(repr) => self.hear_native(ended, &frame, &repr, peer),
                Err(_) => self.counts.foreign += 1,
            },
        }
    }

    fn hear_native(&mut self, ended: Instant, frame: &Frame<'_>, repr: &native::Repr, peer: usize) {
        // A frame for this robot needs its sender's tag; one for others shows whose turn it is and needs the group's.
        let shown = self.key.as_ref().map_or(Shown::Pair, |key| key.check(frame.mpdu(), repr));
        let is_proven = shown == Shown::Pair;
        if !(is_proven || (shown == Shown::Group && repr.destination != self.own)) {
            self.counts.unauthenticated += 1;
            return;
        }
        if repr.role == Role::Forward && repr.session != repr.sender_session {
            self.counts.foreign += 1;
            return;
        }
        let began = ended - self.airtime(frame);
        let is_now = self.is_of_now(repr, peer, began);
        if !is_now && !self.is_fresh(repr, peer, is_proven) {
            self.counts.replayed += 1;
            return;
        }
        self.note_heard(repr, peer, is_proven, is_now);
        let fit = self.follow(repr, peer, began);
        match repr.role {
            Role::Forward if repr.destination == self.own => self.answer_native(repr, peer, ended, fit),
            Role::Backward if repr.destination == self.own => self.match_answer(repr, peer),
            _ => {}
        }
    }

    fn airtime(&self, frame: &Frame<'_>) -> Span {
        Span::from_us(i64::from(self.plan.phy.airtime_us(frame.len_with_fcs())))
    }

    /// False for a frame that is known to be a repetition.
    ///
    /// With a key, sessions and numbers of an initiator only rise: proven frames are compared with proven ones, frames
    /// with the group's tag only with all. Without a key a single forged frame could use up all later numbers, so only
    /// an exact repetition of the last one is refused.
    fn is_fresh(&self, repr: &native::Repr, peer: usize, is_proven: bool) -> bool {
        let Some(sender) = self.roster.peer(peer) else { return false };
        let has_key = self.key.is_some();
        let reached = if is_proven { &sender.proven } else { &sender.overheard };
        if has_key && reached.session.is_some_and(|newest| is_after(newest, repr.sender_session)) {
            return false;
        }
        match repr.role {
            Role::Forward => reached
                .number_in(repr.session)
                .is_none_or(|last| if has_key { is_after(repr.number, last) } else { repr.number != last }),
            Role::Backward if has_key && repr.destination != self.own => {
                let initiator = self.roster.find(repr.destination).and_then(|at| self.roster.peer(at));
                initiator.map(|peer| peer.overheard).is_none_or(|reached| {
                    !reached.session.is_some_and(|newest| is_after(newest, repr.session))
                        && !reached.number_in(repr.session).is_some_and(|last| is_after(last, repr.number))
                })
            }
            Role::Backward => true,
        }
    }

    /// True for an authenticated frame that is sent in the slot it names, in the session that its initiator has proven.
    /// A replay would name a past slot. So false claims of a group member about another robot's numbers or session do
    /// not silence that robot.
    fn is_of_now(&self, repr: &native::Repr, peer: usize, began: Instant) -> bool {
        let initiator = match repr.role {
            Role::Forward => Some(peer),
            Role::Backward => self.roster.find(repr.destination),
        };
        let Some(initiator) = initiator.and_then(|at| self.roster.peer(at)) else { return false };
        let (proven, overheard) = (initiator.proven, initiator.overheard);
        let is_later = match repr.role {
            Role::Forward => {
                overheard.number_in(repr.session) != Some(repr.number)
                    && proven.number_in(repr.session).is_none_or(|last| is_after(repr.number, last))
            }
            Role::Backward => proven.number_in(repr.session).is_none_or(|last| !is_after(last, repr.number)),
        };
        self.key.is_some()
            && self.is_same_plan(repr)
            && proven.session.or(overheard.session) == Some(repr.session)
            && is_later
            && self.is_current(repr.slot.cast_signed(), began)
    }

    /// Notes what a frame states about its sender. Only the sender's own tag makes a statement about its session final:
    /// otherwise any group member could claim that it restarted, and its later frames would be refused. A late frame
    /// does not undo what was heard since.
    fn note_heard(&mut self, repr: &native::Repr, peer: usize, is_proven: bool, is_now: bool) {
        let joined = self.roster.hear(peer, self.now);
        let Some(sender) = self.roster.peer_mut(peer) else { return };
        sender.wants_turn = repr.wants_turn;
        let known = sender.proven.session;
        let number = (repr.role == Role::Forward).then_some(repr.number);
        let is_back = sender.overheard.session.is_some_and(|newest| is_after(newest, repr.sender_session))
            || number
                .zip(sender.overheard.number_in(repr.sender_session))
                .is_some_and(|(new, last)| is_after(last, new));
        if self.key.is_none() || is_now || !is_back {
            sender.overheard.note(repr.sender_session, number);
        }
        if is_proven {
            sender.proven.note(repr.sender_session, number);
        }
        let is_anew = is_proven && known.is_some_and(|known| known != repr.sender_session);
        if is_anew {
            sender.forget_asked();
        }
        if joined {
            self.tell(Event::Joined(repr.sender));
        }
        if is_anew {
            self.tell(Event::Restarted { peer: repr.sender, session: repr.sender_session });
        }
    }

    /// True for a frame of this robot's rounds with a possible slot.
    fn is_same_plan(&self, repr: &native::Repr) -> bool {
        (repr.round_us, repr.slots) == (self.plan.round_us(), self.plan.slots) && repr.slot <= MAX_SLOT
    }

    /// Follows the initiator of a frame in turn and epoch. A frame outside of its slot is ignored.
    fn follow(&mut self, repr: &native::Repr, peer: usize, began: Instant) -> Fit {
        if !self.is_same_plan(repr) || u32::from(repr.left) >= self.plan.turn_slots() {
            self.counts.other_plan += 1;
            return Fit::Unknown;
        }
        let slot = repr.slot.cast_signed();
        let (holder, admitted) = match repr.role {
            Role::Forward => (Some(peer), self.clock.admits(&self.plan, slot, began)),
            Role::Backward => (self.roster.find(repr.destination), self.is_current(slot, began)),
        };
        // An answer to this robot has no news about the turn.
        let Some(holder) = holder.and_then(|at| self.roster.peer(at)).map(|peer| peer.rank) else {
            return Fit::Unknown;
        };
        if !admitted {
            self.counts.off_epoch += 1;
            return Fit::OffSlot;
        }
        let next = if repr.next == self.own {
            Some(self.roster.own_rank)
        } else {
            self.roster.find(repr.next).and_then(|at| self.roster.peer(at)).map(|peer| peer.rank)
        };
        let claim = Claim { holder, turn: repr.turn, next, end: slot + 1 + i64::from(repr.left) };
        if !self.hear_claim(claim) || repr.role == Role::Backward {
            return Fit::Unknown;
        }
        self.clock.follow(&self.plan, slot, began);
        Fit::InSlot
    }

    /// True if `at` lies in `slot` or next to it.
    fn is_current(&self, slot: i64, at: Instant) -> bool {
        self.clock.is_locked() && (self.clock.slot_at(&self.plan, at) - slot).abs() <= 1
    }

    /// Weighs a frame's statement about the turn. True if this robot follows that turn from now on.
    fn hear_claim(&mut self, claim: Claim) -> bool {
        let has_key = self.key.is_some();
        self.end_turn_at_successor(claim.turn);
        let accepted = if self.turn.is_some() {
            let yields = self.view.hear_as_holder(claim, has_key);
            if yields {
                self.yield_to(claim.holder);
            }
            yields
        } else {
            let silent = self.now - self.quiet_since > self.plan.span_of(2 * self.silence_slots);
            self.view.hear(claim, silent, has_key)
        };
        if accepted {
            self.quiet_since = self.now;
            self.passed = None;
        } else {
            self.counts.rivals += 1;
        }
        accepted
    }

    /// Prepares the answer to a forward frame for this robot.
    fn answer_native(&mut self, repr: &native::Repr, peer: usize, ended: Instant, fit: Fit) {
        // A frame at the wrong time may be a replay of one that was lost here; its answer would collide.
        if !self.respond || self.turn.is_some() || fit == Fit::OffSlot {
            return;
        }
        let has_room = matches!(self.plan.dialect(), Dialect::Native { measurement: true, .. });
        let Some(initiator) = self.roster.peer_mut(peer) else { return };
        initiator.asked.push(repr.number);
        let early = initiator.early.take_if(|early| early.number == repr.number);
        let kept = initiator.measurement.take().or(early);
        let answer = native::Repr {
            sender: self.own,
            role: Role::Backward,
            destination: repr.sender,
            wants_turn: self.initiate,
            sender_session: self.session,
            measurement: kept.filter(|_| has_room),
            tag: self.key.as_ref().map(|_| [0; native::TAG_LEN]),
            ..*repr
        };
        let Ok(len) = answer.emit(&mut self.reply_buffer) else { return };
        if let (Some(key), Some(mpdu)) = (&self.key, self.reply_buffer.get_mut(..len)) {
            native::set_tag(mpdu, key.tag(mpdu, answer.sender, answer.destination).unwrap_or_default());
        }
        let slot_start = (fit == Fit::InSlot).then(|| self.clock.start(&self.plan, repr.slot.cast_signed()));
        self.queue_reply(repr.sender, repr.number, len, self.latest_reply(ended, slot_start));
        self.tell(Event::Asked { peer: repr.sender, number: repr.number, session: repr.session });
    }

    /// When an answer must begin: one turn-around after the forward frame ended. Its end may have been stamped late;
    /// where the slot is known, the frame began at most one guard into it.
    fn latest_reply(&self, ended: Instant, slot_start: Option<Instant>) -> Instant {
        let longest = Span::from_us(i64::from(self.plan.forward_us()));
        let ended = slot_start.map_or(ended, |start| ended.min(start + self.plan.guard() + longest));
        ended + self.plan.turn_around()
    }

    /// Queues the answer in the reply buffer.
    fn queue_reply(&mut self, peer: Mac, number: u32, len: usize, latest: Instant) {
        if self.reply.is_some() {
            self.counts.missed_replies += 1;
        }
        self.reply = Some(Ready { role: Role::Backward, len, at: self.now, latest, peer, number });
    }

    /// A backward frame for this robot: a pair, if it answers a frame that waits.
    fn match_answer(&mut self, repr: &native::Repr, peer: usize) {
        if repr.session != self.session || !self.outstanding.answer(repr.number, peer) {
            self.counts.unmatched += 1;
            return;
        }
        self.note_answered(peer);
        self.tell(Event::Answered {
            peer: repr.sender,
            number: repr.number,
            peer_session: repr.sender_session,
            measurement: repr.measurement,
        });
    }

    fn note_answered(&mut self, peer: usize) {
        self.counts.answered += 1;
        self.answered_at = self.now;
        if let Some(link) = self.roster.link_of_peer_mut(peer) {
            link.counts.answered += 1;
        }
    }

    /// The WSR dialect: the length determines kind and destination of a frame.
    fn hear_wsr(&mut self, ended: Instant, frame: &Frame<'_>, peer: usize, first_len: usize) {
        let len = frame.len_with_fcs();
        let last_len = wsr::forward_len(first_len, usize::from(self.plan.slots));
        let Some(index) = self.roster.peer(peer).map(|peer| usize::from(peer.index)) else { return };
        if (first_len..=last_len).contains(&len) && len % 2 == 1 {
            self.hear_wsr_forward(ended, frame, peer, len == wsr::forward_len(first_len, usize::from(self.own_index)));
        } else if len == wsr::forward_len(first_len, index) + wsr::REPLY_GROWTH {
            self.hear_wsr_backward(frame, peer);
        } else {
            self.counts.foreign += 1;
        }
    }

    fn hear_wsr_forward(&mut self, ended: Instant, frame: &Frame<'_>, peer: usize, for_this_robot: bool) {
        let (sender, number) = (frame.sender(), frame.number());
        if self.roster.hear(peer, self.now) {
            self.tell(Event::Joined(sender));
        }
        let Some(initiator) = self.roster.peer_mut(peer) else { return };
        let rank = initiator.rank;
        let last = initiator.proven.number.replace(number);
        // WSR's senders give all frames of a round the same number: only one for this robot can be a repetition.
        if for_this_robot && initiator.asked.last() == Some(number) {
            self.counts.replayed += 1;
            return;
        }
        if last.is_some_and(|last| is_after(last, number)) {
            self.tell(Event::Restarted { peer: sender, session: 0 });
        }
        self.hear_claim(Claim { holder: rank, turn: 0, next: None, end: i64::MAX });
        if !for_this_robot || !self.respond || self.turn.is_some() {
            return;
        }
        if let Ok(len) = wsr::emit_reply(frame, [0; 4], self.own, &mut self.reply_buffer) {
            if let Some(initiator) = self.roster.peer_mut(peer) {
                initiator.asked.push(number);
            }
            self.queue_reply(sender, number, len, self.latest_reply(ended, None));
            self.tell(Event::Asked { peer: sender, number, session: 0 });
        }
    }

    fn hear_wsr_backward(&mut self, frame: &Frame<'_>, peer: usize) {
        if self.roster.hear(peer, self.now) {
            self.tell(Event::Joined(frame.sender()));
        }
        if !self.outstanding.answer(frame.number(), peer) {
            self.counts.unmatched += 1;
            return;
        }
        self.note_answered(peer);
        let (peer, number) = (frame.sender(), frame.number());
        self.tell(Event::Answered { peer, number, peer_session: 0, measurement: None });
    }
}

#[cfg(test)]
mod tests;
