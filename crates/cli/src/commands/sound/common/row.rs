//! How a session went, as a line of JSON.

use super::causes::{Cause, not_sent, not_used};
use csi5300_live::sounding::Finished;
use driver_iface::Mac;
use std::collections::BTreeMap;

/// The line.
#[derive(serde::Serialize)]
pub struct ExchangeRow {
    /// Forward frames sent, and how many of them were answered.
    forward: u64,
    answered: u64,
    /// Answers sent.
    answers: u64,
    /// Forward frames and their answers by peer, if any.
    peers: Vec<PeerRow>,
    /// From a slot's start to the time at which the host came to it, of every slot that was due.
    lateness_us: Option<Spread>,
    /// From the hand-over of a forward frame to the beginning of its answer.
    answer_us: Option<Spread>,
    /// From the kernel's stamp on a forward frame to the hand-over of its answer.
    turn_around_us: Option<Spread>,
    /// Frames not sent, and frames heard but not used, by cause; causes with none are omitted.
    not_sent: BTreeMap<&'static str, u64>,
    not_used: BTreeMap<&'static str, u64>,
    /// Frames that the kernel reports as sent, and as failed; `None` if it reports nothing.
    confirmed: Option<u64>,
    failed: Option<u64>,
    /// The driver's messages in the log, and those missing from it, if they were recorded.
    records: Option<u64>,
    records_missing: Option<u64>,
    /// What ended the session, if neither the time nor a signal did.
    error: Option<String>,
}

#[derive(serde::Serialize)]
struct PeerRow {
    mac: String,
    forward: u64,
    answered: u64,
}

/// Quantiles, microseconds.
#[derive(serde::Serialize)]
struct Spread {
    p50: u64,
    p90: u64,
    p99: u64,
    max: u64,
}

/// The quantiles of a histogram in which there is something.
macro_rules! spread {
    ($histogram:expr) => {
        (!$histogram.is_empty()).then(|| {
            let [p50, p90, p99] = [0.5, 0.9, 0.99].map(|share| $histogram.value_at_quantile(share));
            Spread { p50, p90, p99, max: $histogram.max() }
        })
    };
}

impl ExchangeRow {
    /// Of a session with `peers`; `error` is what ended it, if neither the time nor a signal did.
    pub fn new(peers: &[Mac], finished: &Finished, error: Option<String>) -> Self {
        let (counts, figures, air) = (finished.counts(), &finished.exchange.figures, finished.air);
        let peer = |mac: &Mac| {
            let link = finished.exchange.tdma.link_counts(*mac).filter(|link| link.sounded > 0)?;
            Some(PeerRow { mac: mac.to_string(), forward: link.sounded, answered: link.answered })
        };
        let named = |causes: &[Cause]| {
            causes.iter().filter(|cause| cause.count > 0).map(|cause| (cause.name, cause.count)).collect()
        };
        let reports = air.tx_status > 0;
        Self {
            forward: counts.forward,
            answered: counts.answered,
            answers: counts.replies,
            peers: peers.iter().filter_map(peer).collect(),
            lateness_us: spread!(figures.due_us),
            answer_us: spread!(figures.answer_us),
            turn_around_us: spread!(figures.turn_around_us),
            not_sent: named(&not_sent(counts, figures, &air)),
            not_used: named(&not_used(counts, &air)),
            confirmed: reports.then(|| finished.confirmed()),
            failed: reports.then(|| finished.reported_failed()),
            records: finished.log.as_ref().map(|log| log.recorded.written),
            records_missing: finished.log.as_ref().map(csi5300_live::sounding::LogTotals::missing),
            error,
        }
    }
}
