//! Which senders have a place in a survey: those that are named always, strangers by evidence and age.
//!
//! The places of strangers are a space-saving table \[metwally2005\]: a new sender takes the place of the one with the
//! least evidence and starts with one more, so a sender of more than 1 in [`SENDERS_KEPT`] records has a place whatever
//! addresses others forge. Evidence halves with time, so old senders are replaced.

use super::bounds::SENDERS_KEPT;
use super::{Identity, Survey};

/// Evidence of all strangers is halved each time that this many were dropped.
const HALVED_EVERY: u64 = 4_096;

/// The evidence for a stranger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Standing {
    evidence: u64,
    /// Records surveyed when it was last heard: of equal evidence the one that was silent for longest goes.
    heard_at: u64,
}

impl Standing {
    /// One record more, the survey's `at`th; `least` was the evidence of who had the place before.
    fn hear(&mut self, least: u64, at: u64) {
        self.evidence = self.evidence.max(least).saturating_add(1);
        self.heard_at = at;
    }
}

impl Survey {
    /// Counts a record of a sender, which has a place from now on.
    pub(super) fn note_sender(&mut self, identity: &Identity, timestamp_low: u32) {
        let (heard_at, Identity { mac, frame_count, host_us }) = (self.records, *identity);
        if let Some(sender) = self.senders.get_mut(&mac) {
            sender.standing.hear(0, heard_at);
            return sender.note(frame_count, timestamp_low, host_us);
        }
        let least = if self.known.contains(&mac) { None } else { self.make_room() };
        let sender = self.senders.entry(mac).or_default();
        sender.standing.hear(least.unwrap_or(0), heard_at);
        sender.note(frame_count, timestamp_low, host_us);
    }

    /// Drops a stranger if all places are taken; returns its evidence.
    fn make_room(&mut self) -> Option<u64> {
        let strangers = self.senders.iter().filter(|(mac, _)| !self.known.contains(mac));
        let (mut count, mut weakest) = (0, None);
        for (mac, sender) in strangers {
            count += 1;
            weakest = weakest.into_iter().chain([(sender.standing, *mac)]).min();
        }
        let (standing, mac) = weakest.filter(|_| count >= SENDERS_KEPT)?;
        let forgotten = self.senders.remove(&mac)?;
        self.further_senders = self.further_senders.saturating_add(forgotten.records);
        self.senders_forgotten += 1;
        if self.senders_forgotten.is_multiple_of(HALVED_EVERY) {
            self.senders.values_mut().for_each(|sender| sender.standing.evidence /= 2);
        }
        Some(standing.evidence)
    }
}
