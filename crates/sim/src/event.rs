//! Events on the air in the order of time.

use super::node::Flight;
use super::station::FrameRole;
use std::sync::Arc;

/// Kinds of events.
#[derive(Debug)]
pub(super) enum What {
    Start { from: usize },
    End { flight: u64 },
    Again { robot: usize, flight: Arc<Flight>, role: FrameRole },
    Ask { robot: usize },
    Off { robot: usize },
    On { robot: usize },
}

/// An event at a true time; at equal times the one pushed earlier is first.
#[derive(Debug)]
pub(super) struct Event {
    pub(super) t_ns: i64,
    pub(super) order: u64,
    pub(super) what: What,
}

impl PartialEq for Event {
    fn eq(&self, other: &Self) -> bool {
        self.order == other.order
    }
}

impl Eq for Event {}

impl PartialOrd for Event {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Event {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.t_ns, self.order).cmp(&(other.t_ns, other.order))
    }
}
