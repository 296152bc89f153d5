//! Whether frames go out at all: the kernel drops what it may not send without a word.

use crate::backend::NotSent;
use crate::time::{Instant, Span};

/// Frames without a sign of life, and for how long at least, before it is said.
const FRAMES: u64 = 32;
const TIME: Span = Span::from_ms(1_000);

/// Something that the user should know, said once until it has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Frames are handed over, but of none did the kernel say that it was sent, and none was answered.
    NothingGoesOut {
        /// So many.
        frames: u64,
    },
    /// After [`Notice::NothingGoesOut`]: a frame was sent or answered after all.
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
            Self::GoesOut => write!(f, "frames go out now"),
            Self::NotSent(why) => write!(f, "{why}; further such frames are only counted"),
        }
    }
}

/// Signs that frames go out: tx-status copies, and answers.
#[derive(Clone, Debug, Default)]
pub(super) struct Watch {
    without_sign: u64,
    since: Instant,
    certain: u64,
    said: bool,
    last_refusal: Option<std::mem::Discriminant<NotSent>>,
}

impl Watch {
    /// A forward frame was taken.
    pub(super) fn sent(&mut self, now: Instant) {
        if self.without_sign == 0 {
            self.since = now;
        }
        self.without_sign += 1;
        self.last_refusal = None;
    }

    /// One was answered: it had gone out.
    pub(super) fn answered(&mut self) {
        self.without_sign = 0;
    }

    /// A frame was not taken: worth a word if the one before was taken, or refused for another reason.
    pub(super) fn not_sent(&mut self, why: NotSent) -> Option<Notice> {
        let kind = std::mem::discriminant(&why);
        (self.last_refusal.replace(kind) != Some(kind)).then_some(Notice::NotSent(why))
    }

    /// Looks at the tx-status copies counted so far.
    pub(super) fn look(&mut self, now: Instant, certain: Option<u64>) -> Option<Notice> {
        let certain = certain.unwrap_or(0);
        if certain > self.certain {
            (self.certain, self.without_sign) = (certain, 0);
        }
        let silent = self.without_sign >= FRAMES && now - self.since >= TIME;
        if silent && !self.said {
            self.said = true;
            return Some(Notice::NothingGoesOut { frames: self.without_sign });
        }
        if self.said && self.without_sign == 0 {
            self.said = false;
            return Some(Notice::GoesOut);
        }
        None
    }
}
