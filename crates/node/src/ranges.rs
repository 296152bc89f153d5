//! Ranges from this robot to its peers by another sensor, on their way from an adapter to the graph of the team.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Ranges that wait at most; the oldest are lost.
const WAITING: usize = 4_096;

/// A range to a peer.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranged {
    /// The peer's name.
    pub peer: String,
    /// Host time, seconds since the Unix epoch.
    pub t_s: f64,
    /// The range and its standard deviation, metres.
    pub range_m: [f64; 2],
}

/// Messages of one peer's topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RangeCounts {
    /// All.
    pub came: u64,
    /// Those that could not be used: not finite, outside of their own limits, or of another type.
    pub unusable: u64,
}

/// Ranges that wait, shared by an adapter and the service.
#[derive(Clone, Debug, Default)]
pub struct Ranges(Arc<Mutex<Waiting>>);

#[derive(Debug, Default)]
struct Waiting {
    ranges: VecDeque<Ranged>,
    counts: BTreeMap<String, RangeCounts>,
}

impl Ranges {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message about `peer`; `range` is `None` if it cannot be used.
    pub fn put(&self, peer: &str, range: Option<Ranged>) {
        let mut waiting = self.lock();
        let counts = waiting.counts.entry(peer.to_owned()).or_default();
        counts.came += 1;
        counts.unusable += u64::from(range.is_none());
        waiting.ranges.extend(range);
        if waiting.ranges.len() > WAITING {
            waiting.ranges.pop_front();
        }
    }

    /// All that wait.
    #[must_use]
    pub fn take(&self) -> VecDeque<Ranged> {
        std::mem::take(&mut self.lock().ranges)
    }

    /// The messages about `peer` so far.
    #[must_use]
    pub fn counts(&self, peer: &str) -> RangeCounts {
        self.lock().counts.get(peer).copied().unwrap_or_default()
    }
}
