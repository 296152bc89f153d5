//! Claims about sent frames.

use super::{Needs, Told};
use crate::collect::{Evidence, Heard, HeardRecord, Interface, Sending, Sent};
use crate::pairs::usual_sender;
use csi5300::exchange::tdma::Phy;
use driver_iface::Mac;
use driver_iface::bfee::rate;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::FCS_LEN;
use std::collections::{BTreeMap, HashSet};

/// Above this rate frames may be refused or lost: only measured.
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

pub(super) fn pace(evidence: &Evidence) -> Told {
    let (Some(far), false) = (&evidence.far, evidence.sent.is_empty()) else { return Told::needs(Needs::Sending) };
    let Some(sender) = usual_sender(far) else { return Told::not_tried("the far card heard no number") };
    let number = |record: &HeardRecord| Some((record.number?, record.card_us)).filter(|_| record.mac == sender);
    let heard: BTreeMap<u32, i64> = far.records.iter().filter_map(number).collect();
    let mut rates: Vec<f64> = evidence.sent.iter().map(|sent| sent.rate_hz).collect();
    rates.dedup();
    // By the far card's clock, from the first to the last frame of a rate that it heard.
    let pace = |rate: &f64| {
        let of_rate = evidence.sent.iter().filter(|sent| sent.rate_hz == *rate);
        let heard: Vec<(u32, i64)> =
            of_rate.filter_map(|sent| Some((sent.number, *heard.get(&sent.number)?))).collect();
        let (first, last) = heard.first().zip(heard.last()).filter(|_| heard.len() >= 20)?;
        let seconds = (last.1 - first.1) as f64 * 1e-6;
        (seconds > 0.0).then(|| (*rate, f64::from(last.0.wrapping_sub(first.0)) / seconds))
    };
    let paces: Vec<(f64, f64)> = rates.iter().filter_map(pace).collect();
    let Some((rate, hz)) = paces
        .iter()
        .filter(|(rate, _)| *rate <= ASKED_HZ)
        .max_by(|a, b| (a.1 / a.0 - 1.0).abs().total_cmp(&(b.1 / b.0 - 1.0).abs()))
    else {
        return Told::not_tried("fewer than 20 frames of each rate were heard");
    };
    let air_us = airtime_us(far, sender);
    let share = |hz: f64| air_us.map(|us| 100.0 * hz * us * 1e-6);
    let word = |(rate, hz): &(f64, f64)| match share(*hz) {
        Some(percent) => format!("{hz:.1} of {rate:.0}/s ({percent:.1} % of the air)"),
        None => format!("{hz:.1} of {rate:.0}/s"),
    };
    let words: Vec<String> = paces.iter().map(word).collect();
    let told = Told::decided((hz / rate - 1.0).abs() <= 0.1, words.join(", "));
    let told = told.with("worst", hz / rate, "of the requested rate");
    let Some(us) = air_us else { return told };
    let busiest = paces.iter().filter_map(|(_, hz)| share(*hz)).fold(0.0, f64::max);
    told.with("air time of a frame", us, "us").with("air used at the fastest", busiest, "%")
}

/// Time on air of one frame of the suite, microseconds, at the rate that the far card heard most: preamble and symbols
/// (802.11-2016 equation 19-90). Answers and others' frames are not included.
fn airtime_us(far: &Heard, sender: Mac) -> Option<f64> {
    let mut rates: BTreeMap<u16, usize> = BTreeMap::new();
    let heard = far.records.iter().filter(|record| record.mac == sender);
    heard.for_each(|record| *rates.entry(record.head.rate_n_flags).or_default() += 1);
    let (&code, _) = rates.iter().filter(|(code, _)| **code & rate::HT != 0).max_by_key(|(_, count)| **count)?;
    let bandwidth = if code & rate::HT40 != 0 { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
    let phy = Phy { mcs: (code & 0x1f) as u8, bandwidth };
    Some(f64::from(phy.airtime_us(Sending::frame_len() + FCS_LEN)))
}

pub(super) fn confirmed(evidence: &Evidence) -> Told {
    let taken = evidence.sent.iter().filter(|sent| sent.taken).count();
    match evidence.interface.confirmed {
        _ if taken == 0 => Told::needs(Needs::Sending),
        None => Told::not_tried("this interface reports nothing of what it sends"),
        Some(0) if heard_by_far(evidence).is_some_and(|heard| !heard.is_empty()) => {
            Told::not_tried("the driver reports none of the frames, and the far card heard them")
        }
        // Reports may include frames of other programs on the interface.
        Some(count) => {
            let missing = taken.saturating_sub(usize::try_from(count).unwrap_or(usize::MAX));
            Told::share(missing, taken, 0.1, "frames were not reported as sent")
        }
    }
}

pub(super) fn once(evidence: &Evidence) -> Told {
    let Interface { confirmed, retried, .. } = evidence.interface;
    match confirmed {
        _ if evidence.sent.is_empty() => Told::needs(Needs::Sending),
        None | Some(0) => Told::not_tried("this interface reports nothing of what it sends"),
        Some(count) => {
            let number = |count| usize::try_from(count).unwrap_or(usize::MAX);
            Told::share(number(retried), number(count), 0.01, "frames were sent more than once")
        }
    }
}

pub(super) fn channel(evidence: &Evidence) -> Told {
    let Some(flags) = &evidence.interface.channel_flags else {
        return Told::not_tried("needs the interface that sends and the program iw");
    };
    let forbidden: Vec<&str> =
        ["disabled", "no IR", "passive", "radar"].into_iter().filter(|flag| flags.contains(*flag)).collect();
    let found = if flags.is_empty() { "no flags".to_owned() } else { flags.clone() };
    Told::decided(forbidden.is_empty(), found)
}

pub(super) fn numbers(evidence: &Evidence) -> Told {
    if evidence.sent.is_empty() {
        return Told::needs(Needs::Sending);
    }
    let Some(heard) = heard_by_far(evidence) else { return Told::not_tried("the far card heard no number") };
    let sent: HashSet<u32> = evidence.sent.iter().map(|sent| sent.number).collect();
    Told::share(heard.difference(&sent).count(), heard.len(), 0.0, "numbers were heard that were not sent")
}
