//! What a bearing was made of, in words.

use crate::commands::some;
use csi5300::exchange::pairing::SideCounts;
use csi5300::pipeline::{Answer, PairCounts};
use std::fmt::Write as _;

/// Repeated numbers are reported from this share on: senders repeat a few in a thousand.
const MANY_TWICE: f64 = 10.0;

/// What may be wrong with the logs, one line each; empty if nothing is.
pub(super) fn doubts(answer: &Answer) -> String {
    let counts = answer.pair_counts;
    let mut text = exchanged(&counts);
    if counts.too_wide > 0 {
        let _ = writeln!(
            text,
            "  the motion is too wide for one search: {} pairs outside its best stretch are skipped (--from and --to choose another)",
            counts.too_wide
        );
    }
    for (name, side) in sides(answer) {
        if MANY_TWICE * side.duplicates as f64 > side.handed as f64 {
            let _ = writeln!(
                text,
                "  {} of the {name} log repeat an earlier number: the first of each is used, whoever sent the other",
                some(side.duplicates, "frame", "frames")
            );
        }
    }
    text
}

fn sides(answer: &Answer) -> [(&'static str, SideCounts); 2] {
    [("receiver's", answer.receiver_records), ("transmitter's", answer.transmitter_records)]
}

/// What became of the pairs and of each log's frames.
pub(super) fn pairs(answer: &Answer) -> String {
    let counts = answer.pair_counts;
    let mut text = format!(
        "  {}: {} in motion ({}), {} standing, {} without a pose, {} cut, {} silent{}\n",
        some(answer.pairs as u64, "pair", "pairs"),
        counts.in_motion,
        answer.geometry.as_deref().unwrap_or("-"),
        counts.standing,
        counts.no_pose,
        counts.cut,
        counts.silent,
        if counts.thinned > 0 { format!(", {} skipped evenly", counts.thinned) } else { String::new() }
    );
    if let (Some(cfo), Some(before), Some(after)) =
        (answer.cfo_hz, answer.phase_coherence_before, answer.phase_coherence_after)
    {
        let verb = if answer.compensated { "removed" } else { "not removed: the phase would not be steadier" };
        let drifts = answer.cfo_span_hz.map_or(String::new(), |hz| format!(" (drifting by {hz:.0} Hz)"));
        let _ = writeln!(text, "  CFO {cfo:.0} Hz{drifts} {verb}; phase coherence {before:.2} -> {after:.2}");
    }
    for (name, side) in sides(answer) {
        let odd = side.duplicates + side.implausible + side.mispaired + side.restarts;
        let _ = write!(
            text,
            "  {name} log: {} of {} frames paired, {} missing",
            side.paired,
            side.handed,
            some(side.missing, "number", "numbers")
        );
        if odd > 0 {
            let _ = write!(
                text,
                "; {} duplicates, {} implausible, {} of other sessions or answered very late, {} restarts",
                side.duplicates, side.implausible, side.mispaired, side.restarts
            );
        }
        text.push('\n');
    }
    text
}

/// The outcome of one log's records.
pub(super) fn records(answer: &Answer) -> String {
    let counts = answer.pair_counts;
    let constant = |[deg, sd_deg]: &[f64; 2]| {
        format!(
            "  constant of the chains {deg:.2} +- {sd_deg:.2} deg: for a robot that stands, --baseline X,Y,Z,{deg:.2},{sd_deg:.2}\n"
        )
    };
    let constants: String = answer.chain_constants_deg.iter().map(constant).collect();
    format!(
        "  {} with all antennas: {} in the turn ({}), {} while it did not turn, {} without a pose, {} cut{}\n{constants}",
        some(answer.pairs as u64, "record", "records"),
        counts.in_motion,
        answer.geometry.as_deref().unwrap_or("-"),
        counts.standing,
        counts.no_pose,
        counts.cut,
        if counts.thinned > 0 { format!(", {} skipped evenly", counts.thinned) } else { String::new() }
    )
}

/// Asks whether the logs were exchanged, where by the other one's times far fewer pairs are without a pose.
fn exchanged(counts: &PairCounts) -> String {
    let fewer = counts.no_pose_by_transmitter.filter(|_| counts.may_be_exchanged());
    fewer.map_or(String::new(), |other| {
        format!(
            "  {} of {} pairs have no pose; by the times of the transmitter's log {other} would have none. Were the two logs \
             exchanged? Then swap --rx and --tx\n",
            counts.no_pose, counts.formed
        )
    })
}
