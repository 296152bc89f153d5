//! Detects whether frames go out at all: the kernel drops forbidden ones silently.

use csi5300::source::NotSent;
use csi5300::time::{Instant, Span};
use driver_iface::sounding::native::Role;

/// Frames without a sign of life, and least time, before a notice.
const FRAMES: u64 = 32;
const TIME: Span = Span::from_ms(1_000);

/// A notice to the user, given once until it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Frames are handed over, but none was reported as sent or answered.
    NothingGoesOut {
        /// So many.
        frames: u64,
    },
    /// Frames are handed over, but all were reported as failed, and none was answered.
    AllFail {
        /// So many.
        frames: u64,
    },
    /// After [`Notice::NothingGoesOut`] or [`Notice::AllFail`]: a frame was sent or answered.
    GoesOut,
    /// A frame was not taken.
    NotSent(NotSent),
}

impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NothingGoesOut { frames } => write!(
                f,
                "{frames} frames were handed to the kernel, but it reports none of them as sent and none was answered. \
                 It drops frames silently on channels where the card may not start to transmit (no IR, passive, \
                 radar/DFS): look at `iw phy` and take another channel; the regulatory domain is left as it is. If the \
                 channel is allowed, no peer hears this robot"
            ),
            Self::AllFail { frames } => write!(
                f,
                "{frames} frames were handed to the kernel, but it reports that sending failed, and none was answered: \
                 the peers are not there or on another channel, or the card cannot send (see `dmesg`)"
            ),
            Self::GoesOut => write!(f, "frames go out now"),
            Self::NotSent(why) => write!(f, "{why}; further such frames are only counted"),
        }
    }
}

/// Signs that frames go out: tx-status copies, and answers to forward frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Watch {
    /// Frames since the last sign, and of these the forward ones.
    without_sign: u64,
    unanswered: u64,
    since: Instant,
    certain: u64,
    /// Failed frames, and their number at the last sign.
    failed: u64,
    failed_before: u64,
    said: bool,
    last_refusal: Option<std::mem::Discriminant<NotSent>>,
}

impl Watch {
    /// A frame was taken.
    pub(super) fn sent(&mut self, role: Role, now: Instant) {
        if self.without_sign == 0 {
            self.since = now;
        }
        self.without_sign += 1;
        self.unanswered += u64::from(role == Role::Forward);
        self.last_refusal = None;
    }

    /// One was answered: it had gone out.
    pub(super) fn answered(&mut self) {
        (self.without_sign, self.unanswered, self.failed_before) = (0, 0, self.failed);
    }

    /// A frame was refused: a notice if the one before was taken, or refused for another reason.
    pub(super) fn not_sent(&mut self, why: NotSent) -> Option<Notice> {
        let kind = std::mem::discriminant(&why);
        (self.last_refusal.replace(kind) != Some(kind)).then_some(Notice::NotSent(why))
    }

    /// Takes the counts of tx-status copies so far: `certain` for sent frames, `failed` for others.
    pub(super) fn look(&mut self, now: Instant, certain: Option<u64>, failed: u64) -> Option<Notice> {
        let certain = certain.unwrap_or(0);
        self.failed = failed;
        if certain > self.certain {
            self.certain = certain;
            self.answered();
        }
        let silent = self.without_sign >= FRAMES && now - self.since >= TIME;
        let all_fail = failed > self.failed_before;
        // A kernel may report every unacknowledged frame as failed, so answers must be missing too.
        if silent && !self.said && (!all_fail || self.unanswered >= FRAMES) {
            self.said = true;
            let frames = self.without_sign;
            return Some(if all_fail { Notice::AllFail { frames } } else { Notice::NothingGoesOut { frames } });
        }
        if self.said && self.without_sign == 0 {
            self.said = false;
            return Some(Notice::GoesOut);
        }
        None
    }
}
