//! Which senders have a place in a survey: those that are named always, strangers by evidence and age.
//!
//! The places of strangers are a space-saving table \[metwally2005\]: a new sender takes the place of the one with the
//! least evidence and begins with one more than that one had, so a sender of more than 1 in [`SENDERS_KEPT`] records has a
//! place whatever the others make up. Evidence halves with time, so senders of long ago make room.

use super::bounds::SENDERS_KEPT;
use super::{Sender, Survey};
use driver_iface::Mac;

/// Evidence of all strangers is halved once in so many that were forgotten.
const HALVED_EVERY: u64 = 4_096;

/// What speaks for keeping a stranger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Standing {
    evidence: u64,
    /// Records surveyed when it was last heard: of equal evidence the one that was silent for longest goes.
    heard_at: u64,
}

impl Survey {
    /// The place of a sender, which from now on has one more record.
    pub(super) fn sender(&mut self, mac: Mac) -> &mut Sender {
        let least = if self.senders.contains_key(&mac) || self.known.contains(&mac) { None } else { self.make_room() };
        let heard_at = self.records;
        let sender = self.senders.entry(mac).or_default();
        sender.standing.evidence = sender.standing.evidence.max(least.unwrap_or(0)).saturating_add(1);
        sender.standing.heard_at = heard_at;
        sender
    }

    /// Forgets a stranger if all places are taken; gives what its evidence was.
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
