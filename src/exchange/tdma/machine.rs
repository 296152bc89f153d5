//! The state machine: its state, its contract and its timers. Turns are in `turns.rs`, hearing is in `hearing.rs`.

use super::auth::Key;
use super::clock::SlotClock;
use super::config::Config;
use super::event::{Event, LinkCounts, TdmaCounts};
use super::phy::Dialect;
use super::plan::{Plan, PlanError};
use super::roster::{ABSENT_AFTER, Outstanding, Priority, Roster};
use super::turns::Turn;
use super::view::View;
use crate::exchange::pairing::numbering::before_first_number;
use crate::time::Instant;
use driver_iface::Mac;
use driver_iface::sounding::native::{self, Measurement, Role};
use driver_iface::sounding::wsr;
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
    pub(super) own: Mac,
    pub(super) own_index: u16,
    pub(super) initiate: bool,
    pub(super) respond: bool,
    pub(super) open_loop: bool,
    pub(super) session: u32,
    pub(super) key: Option<Key>,
    pub(super) silence_slots: u32,
    pub(super) patience_us: i64,
    pub(super) plan: Plan,
    pub(super) clock: SlotClock,
    pub(super) roster: Roster,
    pub(super) view: View,
    pub(super) outstanding: Outstanding,
    /// This robot's turn, if it has it.
    pub(super) turn: Option<Turn>,
    /// The turn that this robot passed on without hearing from it since: its end, and to whom.
    pub(super) passed: Option<(i64, usize)>,
    /// When an initiator was last heard.
    pub(super) quiet_since: Instant,
    /// When a forward frame was last answered, or the turn began.
    pub(super) answered_at: Instant,
    pub(super) now: Instant,
    /// The number of the last forward frame, in our dialect each robot's in a range of its own; 0 is skipped, WSR drivers lose the
    /// sender's MAC with it.
    pub(super) number: u32,
    pub(super) reply: Option<Ready>,
    pub(super) forward_buffer: Box<[u8]>,
    pub(super) reply_buffer: Box<[u8]>,
    pub(super) filler: wsr::Lfsr,
    pub(super) counts: TdmaCounts,
    events: VecDeque<Event>,
}

/// A frame in one of the buffers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ready {
    pub(super) role: Role,
    pub(super) len: usize,
    pub(super) at: Instant,
    pub(super) latest: Instant,
    pub(super) peer: Mac,
    pub(super) number: u32,
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
        let longest = match plan.dialect() {
            Dialect::Wsr { first_len } => {
                wsr::forward_len(usize::from(first_len), usize::from(plan.slots)) + wsr::REPLY_GROWTH
            }
            Dialect::Native { .. } => native::MAX_LEN,
        };
        let buffer = vec![0; longest].into_boxed_slice();
        let roster = Roster::new(config);
        // In WSR's dialect as WSR's sender counts, from 1.
        let number = match plan.dialect() {
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
    pub fn set_initiate(&mut self, initiate: bool) {
        self.initiate = initiate;
    }

    /// Sets how much a link matters. False if this robot has no link to `peer`.
    ///
    /// Links that do not move, or whose bearing is good enough, need less of the channel. An initiator sounds in at
    /// least one of four slots whatever the priorities, so that the others hear it.
    pub fn set_priority(&mut self, peer: Mac, priority: Priority) -> bool {
        let link = self.roster.find(peer).and_then(|at| self.roster.link_of_peer_mut(at));
        link.map(|link| link.priority = priority).is_some()
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
        let has_room = matches!(self.plan.dialect(), Dialect::Native { measurement: true, .. });
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

    /// This robot leaves for good: it sends nothing from now on. The others continue, after a silence at the latest.
    pub fn leave(&mut self) {
        (self.initiate, self.respond) = (false, false);
        (self.turn, self.reply, self.passed) = (None, None, None);
    }

    /// The plan.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// True if this robot has the turn.
    #[must_use]
    pub fn has_turn(&self) -> bool {
        self.turn.is_some()
    }

    /// The robot that has the turn, or had it last, if known here.
    #[must_use]
    pub fn initiator(&self) -> Option<Mac> {
        let rank = self.view.current()?.holder;
        let peer = self.roster.peer_of_rank(rank).and_then(|at| self.roster.peer(at));
        Some(peer.map_or(self.own, |peer| peer.mac))
    }

    /// True if slots are where an initiator's are: the epoch is common, was heard, or this robot set it.
    #[must_use]
    pub fn is_synchronised(&self) -> bool {
        self.clock.is_locked()
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
    pub(super) fn give_up(&mut self, peer: usize, number: u32) {
        self.counts.unanswered += 1;
        let Some(peer) = self.roster.peer_mut(peer) else { return };
        peer.unanswered_in_a_row = peer.unanswered_in_a_row.saturating_add(1);
        let (mac, turned_absent) = (peer.mac, peer.unanswered_in_a_row == ABSENT_AFTER);
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
    pub(super) fn tell(&mut self, event: Event) {
        if self.events.len() >= EVENT_CAPACITY {
            self.events.pop_front();
            self.counts.events_lost += 1;
        }
        self.events.push_back(event);
    }
}

#[cfg(test)]
mod tests;
