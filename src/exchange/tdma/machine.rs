//! The scheduler's state machine: its contract and timers, turns, what it hears, and its slots.

use super::auth::{Key, Shown};
use super::roster::{ABSENT_AFTER, Outstanding, Roster, before_first_number};
use super::{Cause, Config, Dialect, Event, LinkCounts, Plan, PlanError, TdmaCounts};
use crate::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::{Measurement, Role};
use driver_iface::sounding::{Frame, native, wsr};
use std::collections::VecDeque;

/// Events kept until fetched.
const EVENT_CAPACITY: usize = 256;

/// One robot's side of the exchange: decides whom to sound when, whom to answer, and whose turn it is.
///
/// It has no clock, no socket and no thread. A driver (a live card, or a simulated air) calls it:
///
/// 1. [`Tdma::handle_heard`] with every frame received, as soon as it is received;
/// 2. then [`Tdma::poll_transmit`] until it gives `None`, sending each frame **at once**;
/// 3. then [`Tdma::poll_event`] until it gives `None`;
/// 4. then wait for the next frame or for [`Tdma::poll_timeout`], whichever is first, and continue with 1 or 2;
///    after any other call that changes something, continue with 2.
///
/// Time: every `now` is of one monotonic clock of this robot, and no earlier than any `now` before; an earlier one is
/// taken as the last and counted. Nothing is decided between calls. After `poll_transmit(now)` has returned `None`,
/// `poll_timeout()` is later than `now`. A late driver loses what was due: a forward frame is given out up to one guard
/// after its deadline, an answer up to one turn-around after the forward frame; what is later is skipped and counted,
/// never sent late.
///
/// What happens when things go wrong:
///
/// | event | outcome |
/// |---|---|
/// | a forward or backward frame is lost | [`Event::Unanswered`]; no retransmission, the next round sounds the link again |
/// | a robot joins late | it listens, answers, takes the epoch from what it hears, and is given turns as soon as an initiator has heard that it wants them |
/// | a robot leaves or crashes | 64 unanswered frames: [`Event::Absent`], asked in every eighth round, given no turn |
/// | a robot restarts | another session in its frames: [`Event::Restarted`]; its numbers begin again |
/// | the turn is passed to a robot that does not take it | after `silence_slots` the last initiator takes it back, skipping a turn number, and leaves that robot out until it is heard again |
/// | the initiator vanishes | after twice `silence_slots`, in slots that belong to one robot each (`n = silence_slots * (rank + k * robots)`), the first robot that wants the turn claims it |
/// | two robots initiate at once | the later turn wins, of equal turns the lower MAC; the other yields ([`Event::Yielded`]) and listens. Rivals in step hear nothing, so an initiator that is not answered for 64 slots leaves one in eight out, by its own pattern |
/// | the driver sleeps through `silence_slots` of its own turn | the turn is lost, and claimed anew only after a silence |
/// | frames are forged | without a key: a frame for this robot is answered, but [`Event::Answered`] needs number, session, sender and destination of a frame that waits; contradictions on turn or epoch need several frames in a row to convince. With a key: frames without a valid tag, old sessions and repeated numbers are ignored; what a robot of the group says in another's name to a third counts for whose turn it is, and until that other one is heard itself |
///
/// Synchronised robots (a common epoch, or a followed one) do not transmit at the same time: a slot has one initiator,
/// a turn's end and successor are fixed at its beginning and repeated in all its frames, and a turn is claimed only
/// after a silence too long for losses alone (see [`Config::silence_slots`]).
#[derive(Clone, Debug)]
pub struct Tdma {
    own: Mac,
    own_index: u16,
    initiate: bool,
    respond: bool,
    open_loop: bool,
    session: u32,
    key: Option<Key>,
    silence_slots: u32,
    patience_us: i64,
    plan: Plan,
    clock: SlotClock,
    roster: Roster,
    view: View,
    outstanding: Outstanding,
    /// This robot's turn, if it has it.
    turn: Option<Turn>,
    /// The turn that this robot passed on without hearing from it since: its end, and to whom.
    passed: Option<(i64, usize)>,
    /// When an initiator was last heard.
    quiet_since: Instant,
    /// When a forward frame was last answered, or the turn began.
    answered_at: Instant,
    now: Instant,
    /// The number of the last forward frame, in our dialect each robot's in a range of its own; 0 is skipped, WSR drivers lose the
    /// sender's MAC with it.
    number: u32,
    reply: Option<Ready>,
    forward_buffer: Box<[u8]>,
    reply_buffer: Box<[u8]>,
    filler: wsr::Lfsr,
    counts: TdmaCounts,
    events: VecDeque<Event>,
}

/// A frame in one of the buffers.
#[derive(Clone, Copy, Debug)]
struct Ready {
    role: Role,
    len: usize,
    at: Instant,
    latest: Instant,
    peer: Mac,
    number: u32,
}

/// A frame to send at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmit<'a> {
    /// The 802.11 frame, without radiotap header and FCS.
    pub frame: &'a [u8],
    /// When it was due.
    pub at: Instant,
    /// When it must be on air at the latest; a driver that cannot keep this drops the frame.
    pub latest: Instant,
    /// Forward or backward.
    pub role: Role,
    /// The robot for whom it is meant.
    pub peer: Mac,
    /// Its frame number.
    pub number: u32,
}

impl Tdma {
    /// A scheduler that listens. All its memory is allocated here.
    ///
    /// # Errors
    /// [`PlanError`] if the rate does not fit (with the highest that does), or robots, links and key contradict
    /// each other.
    pub fn new(config: &Config) -> Result<Self, PlanError> {
        let plan = Plan::new(&config.request)?;
        config.check(&plan)?;
        let (_, longest) = plan.request.dialect.longest(plan.slots.into());
        let buffer = vec![0; longest].into_boxed_slice();
        let roster = Roster::new(config);
        // In WSR's dialect as WSR's sender counts, from 1.
        let number = match plan.request.dialect {
            Dialect::Wsr { .. } => 0,
            Dialect::Native { .. } => before_first_number(roster.own_rank, roster.robots()),
        };
        Ok(Self {
            own: config.own.mac,
            own_index: config.own.index,
            initiate: config.initiate,
            respond: config.respond,
            open_loop: config.open_loop,
            session: config.session,
            key: config.key.as_ref().map(|key| key.for_robot(config.own.mac, &config.peer_macs())),
            silence_slots: config.silence_slots.max(2),
            patience_us: i64::from(config.patience_us).max(plan.span_of(1).as_us()),
            plan,
            clock: SlotClock::new(config.epoch, &plan),
            view: View::new(roster.robots()),
            roster,
            outstanding: Outstanding::new(),
            turn: None,
            passed: None,
            quiet_since: config.start,
            answered_at: config.start,
            now: config.start,
            number,
            reply: None,
            forward_buffer: buffer.clone(),
            reply_buffer: buffer,
            filler: wsr::Lfsr::default(),
            counts: TdmaCounts::default(),
            events: VecDeque::with_capacity(EVENT_CAPACITY),
        })
    }

    /// A frame was received: an MPDU without radiotap header and FCS, its FCS checked. Never panics, whatever it is.
    ///
    /// `ended` is when its reception ended on air, as near as the driver knows (a receive stamp, or else `now`): the
    /// epoch follows it, and answers keep their time from it.
    pub fn handle_heard(&mut self, now: Instant, ended: Instant, mpdu: &[u8]) {
        self.advance(now);
        self.counts.heard += 1;
        self.hear(ended.min(self.now), mpdu);
    }

    /// The next frame to send at once, if one is due. Call it until it returns `None`.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Transmit<'_>> {
        self.advance(now);
        let ready = self.due_reply().or_else(|| self.due_forward())?;
        let buffer = match ready.role {
            Role::Forward => &self.forward_buffer,
            Role::Backward => &self.reply_buffer,
        };
        let frame = buffer.get(..ready.len)?;
        let Ready { role, at, latest, peer, number, .. } = ready;
        Some(Transmit { frame, at, latest, role, peer, number })
    }

    /// When [`Tdma::poll_transmit`] is to be called again, if nothing is heard before.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let reply = self.reply.map(|ready| ready.at);
        [reply, self.outstanding.next_at(), self.turn_timeout()].into_iter().flatten().min()
    }

    /// When the next forward frame may be due: the only deadline that a driver must meet exactly. Other deadlines of
    /// [`Tdma::poll_timeout`] may wait for it.
    #[must_use]
    pub fn transmit_at(&self) -> Option<Instant> {
        self.turn_timeout()
    }

    /// The next event, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// From now on this robot wants the turn, or no longer does. A current turn continues to its announced end.
    #[doc(hidden)] // for the tests of this workspace
    pub fn set_initiate(&mut self, initiate: bool) {
        self.initiate = initiate;
    }

    /// Hands over this robot's measurement of a forward frame from `peer`, to go with the next answer to it. A newer
    /// one replaces one that is not sent yet. False if there is no such peer or frames have no room for it.
    ///
    /// The card also measures frames of `peer` to others, which pairs them with their own measurements: false for a
    /// number that is not among the last 16 answered to `peer` in its session. The last refused one is kept for the
    /// answer to its number, in case the card's report arrived before the frame.
    ///
    /// With a key, two measurements of one number mean a forged frame: false, and neither is sent, unless the first one
    /// was sent already.
    pub fn set_measurement(&mut self, peer: Mac, measurement: Measurement) -> bool {
        let has_room = matches!(self.plan.request.dialect, Dialect::Native { measurement: true, .. });
        let at = self.roster.find(peer).filter(|_| has_room);
        let Some(peer) = at.and_then(|at| self.roster.peer_mut(at)) else { return false };
        let (number, clock) = (measurement.number, measurement.timestamp_low);
        let other = peer.measured.replace((number, clock)).filter(|(_, before)| *before != clock);
        if self.key.is_some() && (other.is_some_and(|(before, _)| before == number) || peer.contested == Some(number)) {
            peer.contested = Some(number);
            let of_number = |kept: &mut Measurement| kept.number == number;
            peer.measurement.take_if(of_number);
            peer.early.take_if(of_number);
            self.counts.contested += 1;
            return false;
        }
        let was_asked = peer.asked.contains(number);
        *(if was_asked { &mut peer.measurement } else { &mut peer.early }) = Some(measurement);
        was_asked
    }

    /// The driver did not send a frame of [`Tdma::poll_transmit`]: it no longer counts or waits for an answer. Its
    /// number is not used again.
    pub fn not_sent(&mut self, role: Role, number: u32) {
        if role == Role::Backward {
            self.counts.replies = self.counts.replies.saturating_sub(1);
            return;
        }
        let Some(waiting) = self.outstanding.take_back(number) else { return };
        self.counts.forward = self.counts.forward.saturating_sub(1);
        if let Some(link) = self.roster.link_of_peer_mut(waiting.peer) {
            link.counts.sounded = link.counts.sounded.saturating_sub(1);
        }
    }

    /// The plan.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// True if this robot has the turn.
    #[doc(hidden)] // for the tests of this workspace
    #[must_use]
    pub fn has_turn(&self) -> bool {
        self.turn.is_some()
    }

    /// The robot that has the turn, or had it last, if known here.
    #[doc(hidden)] // for the tests of this workspace
    #[must_use]
    pub fn initiator(&self) -> Option<Mac> {
        let rank = self.view.current?.holder;
        Some(self.roster.peer_of_rank(rank).map_or(self.own, |peer| peer.mac))
    }

    /// True if slots are where an initiator's are: the epoch is common, was heard, or this robot set it.
    #[doc(hidden)] // for the tests of this workspace
    #[must_use]
    pub fn is_synchronised(&self) -> bool {
        self.clock.locked
    }

    /// Everything counted since the start.
    #[must_use]
    pub fn counts(&self) -> &TdmaCounts {
        &self.counts
    }

    /// Counts of the link to `peer`, if there is one.
    #[must_use]
    pub fn link_counts(&self, peer: Mac) -> Option<LinkCounts> {
        let at = self.roster.find(peer)?;
        self.roster.link_of_peer(at).map(|link| link.counts)
    }

    /// Takes the time, and drops overdue answers.
    fn advance(&mut self, now: Instant) {
        if now < self.now {
            self.counts.time_ran_back += 1;
        }
        self.now = self.now.max(now);
        while let Some(waiting) = self.outstanding.expired(self.now) {
            self.give_up(waiting.peer, waiting.number);
        }
    }

    /// A forward frame was not answered in time.
    fn give_up(&mut self, peer: usize, number: u32) {
        self.counts.unanswered += 1;
        let Some(peer) = self.roster.peer_mut(peer) else { return };
        peer.unanswered_in_a_row = peer.unanswered_in_a_row.saturating_add(1);
        // In an open loop it is asked as often as before.
        let (mac, turned_absent) = (peer.mac, peer.unanswered_in_a_row == ABSENT_AFTER && !self.open_loop);
        self.tell(Event::Unanswered { peer: mac, number });
        if turned_absent {
            self.tell(Event::Absent(mac));
        }
    }

    /// The pending answer, unless it is too late for it.
    fn due_reply(&mut self) -> Option<Ready> {
        let reply = self.reply.take()?;
        if self.now > reply.latest {
            self.counts.missed_replies += 1;
            return None;
        }
        self.counts.replies += 1;
        Some(reply)
    }

    /// Queues an event; drops the oldest if nobody fetches them.
    fn tell(&mut self, event: Event) {
        if self.events.len() >= EVENT_CAPACITY {
            self.events.pop_front();
            self.counts.events_lost += 1;
        }
        self.events.push_back(event);
    }
}

/// An initiator sounds in at least one of this many slots, so that others hear it.
const KEEP_ALIVE_SLOTS: u32 = 4;
/// An initiator without answers for this many slots listens in some.
const DEAF_SLOTS: u32 = 64;
/// A robot not heard for this many rounds does not get the turn.
const ALIVE_ROUNDS: i64 = 64;

/// This robot's turn.
#[derive(Clone, Copy, Debug)]
struct Turn {
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

/// Writes a native frame, with a tag if there is a key; returns its length.
fn emit(mut repr: native::Repr, key: Option<&Key>, buffer: &mut [u8]) -> Option<usize> {
    repr.tag = key.map(|_| [0; native::TAG_LEN]);
    let len = repr.emit(buffer)?;
    if let (Some(key), Some(mpdu)) = (key, buffer.get_mut(..len)) {
        native::set_tag(mpdu, key.tag(mpdu, repr.sender, repr.destination).unwrap_or_default());
    }
    Some(len)
}

/// A hash of `x` (the finaliser of SplitMix64).
fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Tdma {
    /// When the turn needs the next look: its next slot, or the slot in which this robot could take it.
    fn turn_timeout(&self) -> Option<Instant> {
        let slot = match &self.turn {
            Some(turn) => turn.slot,
            None => self.next_beginning()?.0,
        };
        Some(self.clock.start(&self.plan, slot))
    }

    /// The forward frame that is due, if this robot has the turn or may take it now.
    fn due_forward(&mut self) -> Option<Ready> {
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
        Some(Ready { role: Role::Forward, len, at: start, latest, peer: mac, number })
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
        if let Dialect::Wsr { first_len } = self.plan.request.dialect {
            let len_with_fcs = wsr::forward_len(usize::from(first_len), usize::from(target.index));
            let repr = wsr::Repr { sender: self.own, number: self.number, len_with_fcs };
            return repr.emit(&mut self.forward_buffer, &mut self.filler);
        }
        let next = turn.next.and_then(|next| self.roster.peer(next)).map_or(self.own, |next| next.mac);
        let repr = native::Repr {
            sender: self.own,
            number: self.number,
            role: Role::Forward,
            destination: target.mac,
            next,
            wants_turn: self.initiate,
            session: self.session,
            sender_session: self.session,
            turn: turn.number,
            left: u16::try_from(turn.end - turn.slot - 1).unwrap_or(u16::MAX),
            slot: turn.slot.cast_unsigned(),
            round_us: self.plan.round_us,
            slots: self.plan.slots,
            measurement: None,
            tag: None,
        };
        emit(repr, self.key.as_ref(), &mut self.forward_buffer)
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
        // The others follow its epoch.
        self.clock.locked = true;
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
        if let Some(claim) = self.view.current
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
        let by_length = matches!(self.plan.request.dialect, Dialect::Wsr { .. });
        let alive_since = self.now - Span::from_us(i64::from(self.plan.round_us) * ALIVE_ROUNDS);
        // WSR frames cannot name a successor or a turn: all turns are turn 0.
        let (number, next) = if by_length { (0, None) } else { (number, self.roster.next_initiator(alive_since)) };
        let end = slot + i64::from(self.plan.turn_slots);
        self.turn = Some(Turn { number, slot, end, next, idle_slots: 0 });
        self.passed = None;
        self.counts.turns += 1;
        let next = next.and_then(|next| self.roster.peer(next)).map_or(self.roster.own_rank, |next| next.rank);
        // An earlier rival remains one.
        self.view.current = Some(Claim { holder: self.roster.own_rank, turn: number, next: Some(next), end });
    }

    /// A complete turn that was passed on ends with the first frame of a later turn, which may arrive slightly before
    /// this robot's own clock reaches the end.
    fn end_turn_at_successor(&mut self, turn_heard: u32) {
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
        self.counts.missed_slots += u64::from(slots);
        self.tell(Event::Missed { slots, late, slot: self.plan.span_of(1) });
        self.tell(Event::TurnEnded { turn: turn.number, next: None });
    }

    /// Another initiator takes precedence.
    fn yield_to(&mut self, holder: u16) {
        if self.turn.take().is_none() {
            return;
        }
        self.counts.yields += 1;
        self.clock.unlock();
        if let Some(to) = self.roster.peer_of_rank(holder).map(|peer| peer.mac) {
            self.tell(Event::Yielded { to, turn: self.view.turn() });
        }
    }
}

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
    fn hear(&mut self, ended: Instant, mpdu: &[u8]) {
        let Some(frame) = Frame::new_checked(mpdu) else {
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
        match self.plan.request.dialect {
            Dialect::Wsr { first_len } => self.hear_wsr(ended, &frame, peer, usize::from(first_len)),
            Dialect::Native { .. } => match native::Repr::parse(&frame) {
                Some(repr) => self.hear_native(ended, &frame, &repr, peer),
                None => self.counts.foreign += 1,
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
                let initiator = self.roster.peer_of_mac(repr.destination);
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
            Role::Forward => self.roster.peer(peer),
            Role::Backward => self.roster.peer_of_mac(repr.destination),
        };
        let Some(initiator) = initiator else { return false };
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
        (repr.round_us, repr.slots) == (self.plan.round_us, self.plan.slots) && repr.slot <= MAX_SLOT
    }

    /// Follows the initiator of a frame in turn and epoch. A frame outside of its slot is ignored.
    fn follow(&mut self, repr: &native::Repr, peer: usize, began: Instant) -> Fit {
        if !self.is_same_plan(repr) || u32::from(repr.left) >= self.plan.turn_slots {
            self.counts.other_plan += 1;
            return Fit::Unknown;
        }
        let slot = repr.slot.cast_signed();
        let (holder, admitted) = match repr.role {
            Role::Forward => (self.roster.peer(peer), self.clock.admits(&self.plan, slot, began)),
            Role::Backward => (self.roster.peer_of_mac(repr.destination), self.is_current(slot, began)),
        };
        // An answer to this robot has no news about the turn.
        let Some(holder) = holder.map(|peer| peer.rank) else { return Fit::Unknown };
        if !admitted {
            self.counts.off_epoch += 1;
            return Fit::OffSlot;
        }
        let next = if repr.next == self.own {
            Some(self.roster.own_rank)
        } else {
            self.roster.peer_of_mac(repr.next).map(|peer| peer.rank)
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
        self.clock.locked && (self.clock.slot_at(&self.plan, at) - slot).abs() <= 1
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
        let has_room = matches!(self.plan.request.dialect, Dialect::Native { measurement: true, .. });
        let Some(initiator) = self.roster.peer_mut(peer) else { return };
        initiator.asked.push(repr.number);
        let early = initiator.early.take_if(|early| early.number == repr.number);
        // One of an earlier number goes first.
        let kept = std::mem::replace(&mut initiator.measurement, early).or_else(|| initiator.measurement.take());
        let answer = native::Repr {
            sender: self.own,
            role: Role::Backward,
            destination: repr.sender,
            wants_turn: self.initiate,
            sender_session: self.session,
            measurement: kept.filter(|_| has_room),
            ..*repr
        };
        let Some(len) = emit(answer, self.key.as_ref(), &mut self.reply_buffer) else { return };
        let slot_start = (fit == Fit::InSlot).then(|| self.clock.start(&self.plan, repr.slot.cast_signed()));
        self.queue_reply(repr.sender, repr.number, len, self.latest_reply(ended, slot_start));
        self.tell(Event::Asked { peer: repr.sender, number: repr.number, session: repr.session });
    }

    /// When an answer must begin: one turn-around after the forward frame ended. Its end may have been stamped late;
    /// where the slot is known, the frame began at most one guard into it.
    fn latest_reply(&self, ended: Instant, slot_start: Option<Instant>) -> Instant {
        let longest = Span::from_us(i64::from(self.plan.forward_us));
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
        if let Some(len) = wsr::emit_reply(frame, [0; 4], self.own, &mut self.reply_buffer) {
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

/// A frame's claim about the turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Claim {
    /// Rank of the initiator (by MAC).
    holder: u16,
    /// Its turn.
    turn: u32,
    /// Rank of the next initiator; `None` if it is not known here.
    next: Option<u16>,
    /// First slot after the turn.
    end: i64,
}

/// This many contradicting frames in a row change the view.
const CONVINCING: u32 = 3;

/// This robot's view of who has the turn, and its treatment of contradictions.
///
/// Turns are numbered; every frame names the initiator, the turn, who is next and how many slots are left. The rule for
/// two initiators at once is the same on every robot: **the later turn wins, and of equal turns the initiator with the
/// lower MAC**. A contradicting frame changes this robot's view only with a valid tag, or as the third in a row that
/// agree: a single one without a tag may be forged.
#[derive(Clone, Copy, Debug)]
struct View {
    current: Option<Claim>,
    rival: Option<(u16, u32)>,
    rival_frames: u32,
    /// A turn up to this many numbers ahead is plausible without proof.
    plausible: u32,
}

impl View {
    fn new(robots: usize) -> Self {
        Self { current: None, rival: None, rival_frames: 0, plausible: 2 * robots as u32 + 4 }
    }

    /// Number of the turn last heard of, or taken.
    fn turn(&self) -> u32 {
        self.current.map_or(0, |claim| claim.turn)
    }

    fn take(&mut self, claim: Claim) {
        self.current = Some(claim);
        self.rival = None;
    }

    /// A frame claims `heard`. True if this is (now) the view; false if the claim is not accepted.
    ///
    /// `silent`: nobody was heard for so long that any initiator is accepted. `has_key`: the group has a key, so the
    /// frame has a valid tag.
    fn hear(&mut self, heard: Claim, silent: bool, has_key: bool) -> bool {
        let Some(current) = self.current else {
            self.take(heard);
            return true;
        };
        let same = (heard.holder, heard.turn) == (current.holder, current.turn);
        if same || silent || (precedes(current, heard) && (has_key || self.is_plausible(current, heard))) {
            self.take(heard);
            return true;
        }
        self.persists(heard, 1) && {
            self.take(heard);
            true
        }
    }

    /// As [`View::hear`] for a robot with the turn: true if it must yield. A losing rival is ignored.
    fn hear_as_holder(&mut self, heard: Claim, has_key: bool) -> bool {
        let yields = self.current.is_none_or(|own| precedes(own, heard));
        let convinced = yields && (has_key || self.persists(heard, 0));
        if convinced {
            self.take(heard);
        }
        convinced
    }

    fn is_plausible(&self, current: Claim, heard: Claim) -> bool {
        heard.turn.wrapping_sub(current.turn) <= self.plausible
    }

    /// Counts contradicting frames that agree with each other.
    fn persists(&mut self, heard: Claim, extra: u32) -> bool {
        let key = Some((heard.holder, heard.turn));
        self.rival_frames = if self.rival == key { self.rival_frames + 1 } else { 1 };
        self.rival = key;
        self.rival_frames >= CONVINCING + extra
    }
}

/// True if `b` wins over `a`: the later turn, and of equal turns the lower rank.
fn precedes(a: Claim, b: Claim) -> bool {
    match b.turn.wrapping_sub(a.turn).cast_signed() {
        0 => b.holder < a.holder,
        step => step > 0,
    }
}

/// The origin of slot 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Epoch {
    /// Known beforehand on this robot's clock (clocks are synchronised by other means); never adjusted.
    Common(Instant),
    /// Taken from the forward frames heard; until then slots count from this instant. Robots need no common clock.
    Heard(Instant),
}

/// After this many contradicting frames in a row the epoch is wrong.
const OFF_EPOCH_FRAMES: u32 = 8;
/// The epoch is kept in sixteenths of a microsecond, so that small corrections are not lost to rounding.
const FRACTION: i64 = 16;
/// Weight of an error in sixteenths. Frames can only be late (scheduling, delivery), so an early one has more weight.
const EARLY: i64 = 8;
const LATE: i64 = 1;

/// Slot times on this robot's clock; the epoch follows received frames.
#[derive(Clone, Copy, Debug)]
struct SlotClock {
    epoch_16: i64,
    follows: bool,
    /// The epoch is common, was taken from a frame since it was last given up, or is this robot's own.
    locked: bool,
    off_epoch: u32,
    /// Errors up to this are followed smoothly, microseconds.
    tolerance_us: i64,
}

impl SlotClock {
    fn new(epoch: Epoch, plan: &Plan) -> Self {
        let (at, follows) = match epoch {
            Epoch::Common(at) => (at, false),
            Epoch::Heard(at) => (at, true),
        };
        let tolerance_us = (plan.guard().as_us() * 4).min(i64::from(plan.round_us) / 2).max(1);
        let epoch_16 = at.as_us().saturating_mul(FRACTION);
        Self { epoch_16, follows, locked: !follows, off_epoch: 0, tolerance_us }
    }

    /// Slot 0 on this robot's clock, rounded down to the microsecond.
    fn epoch(&self) -> Instant {
        Instant::from_us(self.epoch_16.div_euclid(FRACTION))
    }

    /// Drops the epoch; the next frame sets it.
    fn unlock(&mut self) {
        self.locked = !self.follows;
    }

    fn start(&self, plan: &Plan, slot: i64) -> Instant {
        self.epoch() + plan.offset_of(slot)
    }

    fn slot_at(&self, plan: &Plan, now: Instant) -> i64 {
        plan.slot_at(now - self.epoch())
    }

    /// The first slot that does not start before `at`.
    fn slot_from(&self, plan: &Plan, at: Instant) -> i64 {
        self.slot_at(plan, at - Span::from_us(1)) + 1
    }

    /// True if a frame of `slot` may begin at `began`: it fits, no epoch is known, or too many frames in a row did not
    /// fit. Call it once per frame.
    fn admits(&mut self, plan: &Plan, slot: i64, began: Instant) -> bool {
        if !self.locked {
            return true;
        }
        let fits = self.error_us(plan, slot, began).saturating_abs() <= self.tolerance_us;
        self.off_epoch = if fits { 0 } else { self.off_epoch.saturating_add(1) };
        fits || self.off_epoch > OFF_EPOCH_FRAMES
    }

    /// Follows an admitted frame that began at the start of `slot` on its sender's clock and at `began` on this one.
    fn follow(&mut self, plan: &Plan, slot: i64, began: Instant) {
        if !self.follows {
            return;
        }
        let error_us = self.error_us(plan, slot, began);
        if !self.locked || error_us.saturating_abs() > self.tolerance_us {
            self.epoch_16 = self.epoch_16.saturating_add(error_us.saturating_mul(FRACTION));
            (self.locked, self.off_epoch) = (true, 0);
            return;
        }
        self.epoch_16 += error_us * if error_us < 0 { EARLY } else { LATE };
    }

    /// How much later than the start of `slot` `at` is.
    fn error_us(&self, plan: &Plan, slot: i64, at: Instant) -> i64 {
        (at - self.start(plan, slot)).as_us()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::tdma::Request;
    use driver_iface::bfee::SUBCARRIERS;

    fn mac(k: u16) -> Mac {
        Mac([2, 0x53, 0, 0, 0, k as u8])
    }

    /// Robot `k` of `robots`, which all want the turn and share a clock; a silence is 8 slots, a turn 32.
    fn robot(k: u16, robots: u16) -> Tdma {
        let peers: Vec<Mac> = (0..robots).filter(|other| *other != k).map(mac).collect();
        let mut config =
            Config { initiate: true, ..Config::new(mac(k), k, &peers, Request::new(robots - 1, 100.0), 1) };
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
            assert_eq!((tdma.counts().overslept, tdma.counts().missed_slots), (1, u64::from(slots)));
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
            let claim = second.view.current.unwrap();
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

    fn claim(holder: u16, turn: u32) -> Claim {
        Claim { holder, turn, next: None, end: 0 }
    }

    #[test]
    fn later_turns_win_and_equal_ones_go_to_the_lower_mac() {
        assert!(precedes(claim(1, 5), claim(2, 6)));
        assert!(!precedes(claim(1, 6), claim(2, 5)));
        assert!(precedes(claim(2, 5), claim(1, 5)));
        assert!(!precedes(claim(1, 5), claim(2, 5)));
        assert!(precedes(claim(1, u32::MAX), claim(2, 0)), "turn numbers wrap");
    }

    #[test]
    fn a_single_forged_turn_convinces_nobody_and_one_with_a_tag_does() {
        let mut view = View::new(4);
        view.take(claim(1, 5));
        assert!(!view.hear(claim(2, 5_000), false, false));
        assert!(view.hear(claim(1, 5), false, false));
        assert!(!view.hear(claim(2, 5_000), false, false));
        assert!(!view.hear_as_holder(claim(2, 5_000), false));
        assert!(view.hear(claim(2, 5_000), false, true));
        assert_eq!(view.turn(), 5_000);
        assert!(view.hear(claim(3, 1), true, false), "after a long silence any initiator is welcome");
    }

    fn plan() -> Plan {
        Plan::new(&Request::new(3, 100.0)).unwrap()
    }

    #[test]
    fn a_stray_frame_does_not_move_the_epoch_and_many_do() {
        let plan = plan();
        let mut clock = SlotClock::new(Epoch::Heard(Instant::ZERO), &plan);
        assert!(clock.admits(&plan, 0, Instant::from_us(500)));
        clock.follow(&plan, 0, Instant::from_us(500));
        for slot in 1..=8 {
            assert!(!clock.admits(&plan, slot, clock.start(&plan, slot) + Span::from_ms(2)));
        }
        assert!(clock.admits(&plan, 9, clock.start(&plan, 9)), "one that fits starts the count anew");
        for slot in 10..=17 {
            assert!(!clock.admits(&plan, slot, clock.start(&plan, slot) + Span::from_ms(2)));
        }
        let late = clock.start(&plan, 18) + Span::from_ms(2);
        assert!(clock.admits(&plan, 18, late));
        clock.follow(&plan, 18, late);
        assert_eq!(clock.epoch(), Instant::from_us(2_500));
    }

    #[test]
    fn a_common_epoch_stays() {
        let plan = plan();
        let mut common = SlotClock::new(Epoch::Common(Instant::from_us(5)), &plan);
        assert!(common.admits(&plan, 0, Instant::from_us(105)));
        assert!(!common.admits(&plan, 0, Instant::from_us(900)));
        common.follow(&plan, 0, Instant::from_us(105));
        assert_eq!(common.epoch(), Instant::from_us(5));
    }

    #[test]
    fn slots_are_found_from_both_sides_of_their_start() {
        let plan = plan();
        let mut clock = SlotClock::new(Epoch::Heard(Instant::from_us(1_000)), &plan);
        for slot in [-3, 0, 7] {
            let (start, us) = (clock.start(&plan, slot), Span::from_us(1));
            assert_eq!(start, Instant::from_us(1_000) + plan.offset_of(slot));
            assert_eq!([start - us, start, start + us].map(|at| clock.slot_at(&plan, at)), [slot - 1, slot, slot]);
            assert_eq!([start - us, start, start + us].map(|at| clock.slot_from(&plan, at)), [slot, slot, slot + 1]);
        }
        // After a drop the next frame sets the epoch, however near it is; an early frame weighs eight times a late one.
        clock.locked = true;
        let near = Span::from_us(4);
        clock.follow(&plan, 0, clock.start(&plan, 0) + near);
        assert_eq!(clock.epoch_16, 16_000 + 4);
        clock.follow(&plan, 0, clock.start(&plan, 0) - near);
        assert_eq!(clock.epoch_16, 16_004 - 8 * 4);
        // Errors up to the limit are followed smoothly, larger ones at once.
        let (before, most) = (clock.epoch_16, Span::from_us(clock.tolerance_us));
        clock.follow(&plan, 0, clock.start(&plan, 0) + most);
        assert_eq!(clock.epoch_16, before + clock.tolerance_us);
        let (before, more) = (clock.epoch_16, Span::from_us(clock.tolerance_us + 1));
        clock.follow(&plan, 0, clock.start(&plan, 0) + more);
        assert_eq!(clock.epoch_16, before + 16 * (clock.tolerance_us + 1));
        clock.unlock();
        assert!(!clock.locked);
        clock.follow(&plan, 0, Instant::from_us(1_004));
        assert_eq!((clock.epoch(), clock.locked), (Instant::from_us(1_004), true));
        let mut common = SlotClock::new(Epoch::Common(Instant::ZERO), &plan);
        common.unlock();
        assert!(common.locked, "a common epoch is not given up");
    }

    /// Two robots in slots of 10 ms, with a common clock; the first one initiates.
    fn two(key: Option<Key>) -> [Tdma; 2] {
        [0, 1].map(|k| {
            let dialect = Dialect::Native { measurement: true, authenticated: key.is_some() };
            let request = Request { dialect, ..Request::new(1, 100.0) };
            let config = Config::new(mac(k), k, &[mac(1 - k)], request, 1);
            let config = Config { key: key.clone(), initiate: k == 0, epoch: Epoch::Common(Instant::ZERO), ..config };
            Tdma::new(&config).unwrap()
        })
    }

    /// The next forward frame: when, its number and its bytes.
    fn next_forward(tdma: &mut Tdma) -> (Instant, u32, Vec<u8>) {
        loop {
            let now = tdma.poll_timeout().unwrap();
            if let Some(sent) = tdma.poll_transmit(now) {
                return (now, sent.number, sent.frame.to_vec());
            }
        }
    }

    fn measured(number: u32, timestamp_low: u32) -> Measurement {
        Measurement {
            number,
            timestamp_low,
            rx_antenna: 0,
            antenna_sel: 0,
            rssi: [33; 3],
            noise_dbm: -127,
            agc: 20,
            iq: [[1; 2]; SUBCARRIERS],
        }
    }

    #[test]
    fn every_exchange_and_every_event_that_is_lost_is_counted() {
        let [mut first, mut second] = two(None);
        for count in 1..400 {
            let (now, _, frame) = next_forward(&mut first);
            second.handle_heard(now, now, &frame);
            let answer = second.poll_transmit(now).unwrap().frame.to_vec();
            first.handle_heard(now, now, &answer);
            assert_eq!(first.link_counts(mac(1)), Some(LinkCounts { sounded: count, answered: count }));
            assert_eq!((first.counts().heard, first.counts().answered, second.counts().replies), (count, count, count));
        }
        assert_eq!(
            (first.counts().time_ran_back, second.counts().time_ran_back),
            (0, 0),
            "the same time again is none before"
        );
        let kept = std::iter::from_fn(|| second.poll_event()).count() as u64;
        // It heard of the first robot once, and was asked 399 times.
        assert_eq!((kept, second.counts().events_lost), (256, 400 - 256));
    }

    #[test]
    fn the_deadline_of_a_forward_frame_is_told_apart_from_others() {
        let [mut first, mut second] = two(None);
        assert_eq!(second.transmit_at(), None, "it does not initiate");
        let due = first.transmit_at();
        assert_eq!((due, first.poll_timeout()), (due, due));
        let (now, _, frame) = next_forward(&mut first);
        assert_eq!(Some(now), due);
        assert_eq!(first.transmit_at(), Some(now + Span::from_ms(10)));
        second.handle_heard(now, now, &frame);
        assert_eq!((second.poll_timeout(), second.transmit_at()), (Some(now), None), "an answer is no forward frame");
    }

    #[test]
    fn a_follower_is_synchronised_by_the_first_frame() {
        let [mut first, second] = two(None);
        assert!(first.is_synchronised() && second.is_synchronised(), "a common epoch");
        let config = Config::new(mac(1), 1, &[mac(0)], Request::new(1, 100.0), 1);
        let mut heard = Tdma::new(&config).unwrap();
        assert!(!heard.is_synchronised());
        let (now, _, frame) = next_forward(&mut first);
        let later = now + Span::from_us(3_333);
        heard.handle_heard(later, later, &frame);
        assert!(heard.is_synchronised());
    }

    #[test]
    fn a_robot_without_links_never_takes_the_turn() {
        let mut config = Config { initiate: true, ..Config::new(mac(0), 0, &[mac(1)], Request::new(1, 100.0), 1) };
        assert!(Tdma::new(&config).unwrap().poll_timeout().is_some());
        config.links = Some(Vec::new());
        assert_eq!(Tdma::new(&config).unwrap().poll_timeout(), None);
    }

    #[test]
    fn a_measurement_goes_with_the_answer_to_its_own_frame_and_waits_for_it() {
        for (handed, taken, carried) in [
            ([&[1][..], &[], &[]], [&[false][..], &[], &[]], [Some(1), None, None]),
            ([&[2], &[], &[]], [&[false], &[], &[]], [None, Some(2), None]),
            ([&[3], &[], &[]], [&[false], &[], &[]], [None, None, Some(3)]),
            // Behind an earlier one.
            ([&[], &[1, 2], &[]], [&[], &[true, false], &[]], [None, Some(1), Some(2)]),
        ] {
            let [mut first, mut second] = two(None);
            assert!(!second.set_measurement(mac(7), measured(1, 1)), "of a robot that is no peer");
            for (handed, taken) in handed.iter().zip(taken) {
                let said = handed.iter().map(|number| second.set_measurement(mac(0), measured(*number, *number)));
                assert_eq!(said.collect::<Vec<_>>(), taken);
                let (now, _, frame) = next_forward(&mut first);
                second.handle_heard(now, now, &frame);
                let answer = second.poll_transmit(now).unwrap().frame.to_vec();
                first.handle_heard(now, now, &answer);
            }
            let answers = events(&mut first).into_iter().filter_map(|event| match event {
                Event::Answered { measurement, .. } => Some(measurement.map(|measurement| measurement.number)),
                _ => None,
            });
            assert_eq!(answers.collect::<Vec<_>>(), carried, "{handed:?}");
        }
    }

    /// Hands over measurements as (number, clock), before or after the exchange of number 1. Returns the result of each,
    /// the count of contested ones, and the number that the next answer carries.
    fn handed_over(key: Option<Key>, before: &[(u32, u32)], behind: &[(u32, u32)]) -> (Vec<bool>, u64, Option<u32>) {
        let [mut first, mut second] = two(key);
        let mut said = Vec::new();
        let mut exchange = |first: &mut Tdma, second: &mut Tdma, handed: &[(u32, u32)]| {
            said.extend(handed.iter().map(|(number, clock)| second.set_measurement(mac(0), measured(*number, *clock))));
            let (now, _, frame) = next_forward(first);
            second.handle_heard(now, now, &frame);
            let answer = second.poll_transmit(now).unwrap().frame.to_vec();
            first.handle_heard(now, now, &answer);
        };
        exchange(&mut first, &mut second, before);
        while first.poll_event().is_some() {}
        exchange(&mut first, &mut second, behind);
        let carried = events(&mut first).into_iter().find_map(|event| match event {
            Event::Answered { measurement, .. } => measurement.map(|measurement| measurement.number),
            _ => None,
        });
        (said, second.counts().contested, carried)
    }

    #[test]
    fn with_a_key_a_number_of_two_measurements_is_contested_and_neither_is_sent() {
        let key = || Some(Key::new([7; 16]));
        assert_eq!(handed_over(key(), &[], &[(1, 5)]), (vec![true], 0, Some(1)));
        assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 5)]), (vec![true, true], 0, Some(1)), "the same one again");
        assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 6)]), (vec![true, false], 1, None));
        assert_eq!(handed_over(key(), &[], &[(1, 5), (1, 6), (1, 7)]), (vec![true, false, false], 2, None));
        assert_eq!(
            handed_over(key(), &[], &[(1, 5), (1, 6), (1, 6)]),
            (vec![true, false, false], 2, None),
            "and again"
        );
        assert_eq!(handed_over(key(), &[], &[(9, 5), (1, 6)]), (vec![false, true], 0, Some(1)), "of two numbers");
        // Before their frame: neither goes with its answer, nor with a later one.
        assert_eq!(handed_over(key(), &[(2, 5), (2, 6)], &[]), (vec![false, false], 1, None));
        // One that is taken back does not take another number's with it.
        assert_eq!(handed_over(key(), &[(2, 5)], &[(1, 6), (1, 7)]), (vec![false, true, false], 1, Some(2)));
        assert_eq!(handed_over(key(), &[], &[(1, 4), (9, 5), (9, 6)]), (vec![true, false, false], 1, Some(1)));
        // Without one nothing says whose frames they were of.
        assert_eq!(handed_over(None, &[], &[(1, 5), (1, 6)]), (vec![true, true], 0, Some(1)));
    }

    fn request(authenticated: bool) -> Request {
        Request { dialect: Dialect::Native { measurement: true, authenticated }, ..Request::new(2, 100.0) }
    }

    /// Robot 2 of three, which only listens and answers. It has slots of 5 ms from 0 on.
    fn listener(key: Option<Key>) -> Tdma {
        let mut config = Config::new(mac(2), 2, &[mac(0), mac(1)], request(key.is_some()), 1);
        (config.key, config.epoch) = (key, Epoch::Common(Instant::ZERO));
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
        let whole = u16::try_from(plan.turn_slots).unwrap();
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
            let asked = events(&mut tdma).iter().any(|event| matches!(event, Event::Asked { .. }));
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
            assert_eq!(tdma.initiator(), Some(mac(u16::from(number == 4))));
        }
    }

    #[test]
    fn a_robot_of_an_earlier_turn_is_welcome_after_two_silences_and_not_before() {
        // The silence is 64 slots.
        for (slot, late_us, welcome) in
            [(66, 0, false), (127, 0, false), (128, 0, false), (128, 1, true), (129, 0, true)]
        {
            let mut tdma = listener(None);
            hear_late(&mut tdma, &bytes(&forward(1)), 0);
            let repr = native::Repr { sender: mac(1), destination: mac(0), turn: 39, slot, ..forward(1) };
            hear_late(&mut tdma, &bytes(&repr), slot.cast_signed() * 5_000 + late_us);
            assert_eq!(tdma.initiator(), Some(mac(u16::from(welcome))), "slot {slot}");
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
        let mut config = Config { initiate: true, ..Config::new(mac(2), 2, &[mac(0), mac(1)], request(false), 1) };
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
}
