//! Punctuality of a robot: histograms and their text.

use csi5300::exchange::tdma::Transmit;
use csi5300::time::{Instant, Span};
use driver_iface::sounding::native::Role;
use hdrhistogram::Histogram;
use std::fmt::Write;

/// Turn-around of the WSR kernel responder, microseconds, from the rise of the forward frame to that of its answer: at
/// least, median, at most (892 answers in WSR's `test_count_rx_5.dat`).
pub const KERNEL_TURN_AROUND_US: [u32; 3] = [145, 225, 322];
/// Longer times count as this, microseconds.
const LONGEST_US: u64 = 10_000_000;
/// Upper edges of the classes in which a histogram is printed, microseconds.
const EDGES_US: [u64; 12] = [10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 100_000, LONGEST_US];

/// Timing figures of sounding. Nothing is allocated after [`Figures::new`].
#[derive(Clone, Debug)]
pub struct Figures {
    /// Microseconds from a slot's start until the host reached it, for every due slot, also skipped and refused ones:
    /// the measure of the host's punctuality.
    pub due_us: Histogram<u64>,
    /// Microseconds from a slot's start to the hand-over of its forward frame: of frames sent, so never above the guard.
    pub lateness_us: Histogram<u64>,
    /// Microseconds from the kernel's stamp on a forward frame to the hand-over of its answer.
    pub turn_around_us: Histogram<u64>,
    /// Microseconds from the hand-over of a forward frame to the start of its received answer.
    pub answer_us: Histogram<u64>,
    /// Frames that the machine returned in time but the host reached too late: skipped.
    pub too_late: u64,
    /// Frames handed over in time, while the call returned too late: they may have been late on air.
    pub perhaps_late: u64,
}

#[allow(clippy::expect_used, reason = "constant bounds, which the test below has seen accepted")]
fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_US, 3).expect("bounds that are accepted")
}

impl Default for Figures {
    fn default() -> Self {
        Self::new()
    }
}

impl Figures {
    /// Nothing measured yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            due_us: histogram(),
            lateness_us: histogram(),
            turn_around_us: histogram(),
            answer_us: histogram(),
            too_late: 0,
            perhaps_late: 0,
        }
    }

    /// Notes that the host reached a due frame.
    pub(super) fn note_due(&mut self, transmit: &Transmit<'_>, at: Instant) {
        if transmit.role == Role::Forward {
            note(&mut self.due_us, at - transmit.at);
        }
    }

    /// Notes a run of missed slots: `late` after the first one's start, each a `slot` later.
    pub(super) fn note_missed(&mut self, slots: u32, late: Span, slot: Span) {
        for k in 0..i64::from(slots) {
            note(&mut self.due_us, Span::from_us(late.as_us() - k * slot.as_us()));
        }
    }

    /// Notes a hand-over: `before` and `after` the call, `ended` the end of the frame that it answers.
    pub(super) fn note_sent(
        &mut self,
        transmit: &Transmit<'_>,
        before: Instant,
        after: Instant,
        ended: Option<Instant>,
    ) {
        match (transmit.role, ended) {
            (Role::Forward, _) => note(&mut self.lateness_us, before - transmit.at),
            (Role::Backward, Some(ended)) => note(&mut self.turn_around_us, after - ended),
            (Role::Backward, None) => {}
        }
        self.perhaps_late += u64::from(after > transmit.latest);
    }

    /// Notes the time from a forward frame's hand-over to its answer's start.
    pub(super) fn note_answer_us(&mut self, us: i64) {
        note(&mut self.answer_us, Span::from_us(us));
    }
}

fn note(histogram: &mut Histogram<u64>, span: Span) {
    histogram.saturating_record(span.as_us().max(0).cast_unsigned());
}

/// `p50 12, p90 40, p99 62, max 265 us`, and the share of every class.
#[must_use]
pub fn spread_of(histogram: &Histogram<u64>) -> String {
    if histogram.is_empty() {
        return "none".into();
    }
    let at = |quantile| histogram.value_at_quantile(quantile);
    let mut text = format!("p50 {}, p90 {}, p99 {}, max {} us", at(0.5), at(0.9), at(0.99), histogram.max());
    let (mut low, mut parts) = (0, Vec::new());
    for edge in EDGES_US {
        let count = histogram.count_between(low, edge - 1);
        if count > 0 {
            parts.push(format!("<{edge}: {count}"));
        }
        low = edge;
    }
    let _ = write!(text, " ({})", parts.join(", "));
    text
}
