//! How far a bearing explains what was measured, in words: limits, elevation, figures.

use crate::commands::fixed;
use csi5300::pipeline::Answer;

/// The elevation: with its sign where the motion tells up from down.
fn elevation(answer: &Answer) -> String {
    let sd = answer.elevation_sd_deg.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
    match (answer.elevation_deg, answer.abs_elevation_deg) {
        (Some(elevation), _) => format!("elevation {}{sd} deg", fixed(elevation, 2)),
        (None, Some(size)) => format!("|elevation| {size:.2} deg"),
        (None, None) => "elevation -".into(),
    }
}

/// How far the answer explains what was measured.
pub(super) fn quality(answer: &Answer) -> String {
    let or_dash = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
    let next = match answer.peak_ratio {
        Some(ratio) => format!("the next candidate has {ratio:.2} times the probability of the first"),
        None => "no other candidate".into(),
    };
    format!(
        "  {}; one plane wave explains {} of the phases (coherence, 0 to 1); {next}\n  as other programs measure it: profile variance of the WSR toolbox {} (lower is sharper), \
         likelihood share of Dijkstra et al. {} (of 360 azimuths)\n",
        elevation(answer),
        or_dash(answer.coherence),
        or_dash(answer.wsr_profile_variance),
        answer.likelihood_share.map_or("-".into(), |share| format!("{share:.4}")),
    )
}
