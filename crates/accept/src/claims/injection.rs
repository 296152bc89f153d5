//! Claims of what is sent.

use super::{Needs, Told};
use crate::collect::{Evidence, Sent};
use crate::pairs::usual_sender;
use std::collections::HashSet;

/// Above this rate frames may be refused or lost: it is measured only.
const ASKED_HZ: f64 = 200.0;

fn asked(evidence: &Evidence) -> Vec<Sent> {
    evidence.sent.iter().copied().filter(|sent| sent.rate_hz <= ASKED_HZ).collect()
}

pub(super) fn taken(evidence: &Evidence) -> Told {
    let asked = asked(evidence);
    if asked.is_empty() {
        return Told::needs(Needs::Sending);
    }
    Told::share(asked.iter().filter(|sent| !sent.taken).count(), asked.len(), 0.01, "frames were refused")
}

/// Numbers that the far card heard of the near one.
fn heard_by_far(evidence: &Evidence) -> Option<HashSet<u32>> {
    let far = evidence.far.as_ref()?;
    let sender = usual_sender(far)?;
    Some(far.records.iter().filter(|record| record.mac == sender).filter_map(|record| record.number).collect())
}

pub(super) fn heard(evidence: &Evidence) -> Told {
    let asked = asked(evidence);
    if asked.is_empty() || evidence.far.is_none() {
        return Told::needs(Needs::Sending);
    }
    let heard = heard_by_far(evidence).unwrap_or_default();
    let lost_at = |rate_hz: f64| {
        let sent: Vec<&Sent> = evidence.sent.iter().filter(|sent| sent.rate_hz == rate_hz).collect();
        let lost = sent.iter().filter(|sent| !heard.contains(&sent.number)).count();
        100.0 * lost as f64 / sent.len().max(1) as f64
    };
    let mut rates: Vec<f64> = evidence.sent.iter().map(|sent| sent.rate_hz).collect();
    rates.dedup();
    let by_rate: Vec<String> = rates.iter().map(|rate| format!("{:.1} % at {rate:.0}/s", lost_at(*rate))).collect();
    let lost = asked.iter().filter(|sent| !heard.contains(&sent.number)).count();
    let told = Told::share(lost, asked.len(), 0.1, "frames were not heard");
    Told { found: format!("{}: {}", told.found, by_rate.join(", ")), ..told }
}

pub(super) fn numbers(evidence: &Evidence) -> Told {
    if evidence.sent.is_empty() {
        return Told::needs(Needs::Sending);
    }
    let Some(heard) = heard_by_far(evidence) else { return Told::not_tried("the far card heard no number") };
    let sent: HashSet<u32> = evidence.sent.iter().map(|sent| sent.number).collect();
    Told::share(heard.difference(&sent).count(), heard.len(), 0.0, "numbers were heard that were not sent")
}
