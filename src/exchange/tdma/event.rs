//! Events and counts of the scheduler.

use crate::time::Span;
use driver_iface::Mac;
use driver_iface::sounding::native::Measurement;

/// Something that the driver should know. Events are queued; see [`super::Tdma::poll_event`].
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
    /// Frames given to [`super::Tdma::handle_heard`].
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
