//! A bearing in words: the answer, how sure it is, where it is seen from, what it was made of, and why it is poor; details with `-v`.

use super::captures::{MirrorOf, mirror, places};
use crate::commands::{fixed, some};
use csi5300::exchange::pairing::SideCounts;
use csi5300::pipeline::{Answer, OdometryFit, PairCounts, WaveModel};
use csi5300_say::{Level, Tone, says, toned};
use nalgebra::Vector3;
use std::fmt::Write;

/// A second candidate with at least this probability stands beside the first.
const ALIKE: f64 = 0.1;
/// Least probability of a good answer.
const GOOD: f64 = 0.8;
/// The same of a fair one; below it an answer is poor.
const FAIR: f64 = 0.5;
/// An answer without a probability that is wider than this, degrees, is poor: nearly half a turn holds 68 %.
const WIDE_DEG: f64 = 60.0;
/// With a larger deviation, seconds, the phases do not determine the clocks' difference.
const TELLS_S: f64 = 0.3;
/// If one wave explains a smaller share of the phases than this, the path may be wrong.
const LITTLE: f64 = 0.3;

/// Describes an answer: the only one in a few lines, one of several `links` in one line. `doubts` are always printed, `details` with
/// `-v` only.
pub(super) fn describe(answer: &Answer, of: MirrorOf, links: usize, doubts: &str, details: &str) -> String {
    let details = says(Level::Verbose).then_some(details);
    if is_short(links) { in_a_line(answer, of) + "\n" + doubts } else { describe_with(answer, of, doubts, details) }
}

/// True if each of so many links is one line.
pub(super) fn is_short(links: usize) -> bool {
    links > 1 && !says(Level::Verbose)
}

/// Explains the lines of several links.
pub(super) fn explain_lines(links: usize) {
    if is_short(links) {
        note!("GOOD, FAIR, POOR: the probability of being within 5 degrees; -v prints more about each link");
    }
}

/// Decimals of an angle with this error bar: two significant digits of the bar, at most two decimals.
pub(super) fn digits(sd_deg: Option<f64>) -> usize {
    match sd_deg {
        Some(sd_deg) if sd_deg >= 10.0 => 0,
        Some(sd_deg) if sd_deg >= 1.0 => 1,
        _ => 2,
    }
}

/// An angle with its error bar.
fn with_bar(azimuth_deg: f64, sd_deg: Option<f64>) -> String {
    let digits = digits(sd_deg);
    let bar = sd_deg.map_or(String::new(), |sd_deg| format!(" +- {sd_deg:.digits$}"));
    format!("{} deg{bar}", fixed(azimuth_deg, digits))
}

/// The link, its azimuth, and another one that is about as probable.
fn head(answer: &Answer, of: MirrorOf) -> String {
    let mut text = answer.link.clone();
    if let Some(mac) = &answer.mac {
        let _ = write!(text, " ({mac})");
    }
    let Some(azimuth) = answer.azimuth_deg else { return text + ": no bearing" };
    let _ = write!(text, ": {}", with_bar(azimuth, answer.azimuth_sd_deg));
    if let Some(mirror) = mirror(answer, of) {
        let _ = write!(text, ", or its mirror {mirror}");
    } else if let Some(next) = answer.candidates.get(1).filter(|_| has_rival(answer)) {
        let next_deg = fixed(next.azimuth_deg, digits(answer.azimuth_sd_deg));
        let _ = write!(text, ", or {next_deg} deg ({:.0} %)", 100.0 * next.share);
    }
    text
}

/// The answer in a line, without its end.
pub(super) fn in_a_line(answer: &Answer, of: MirrorOf) -> String {
    let mut text = head(answer, of);
    match sure(answer) {
        Some(sure) => {
            let _ = write!(text, "  {} {:.0} %", grade(sure), 100.0 * sure);
        }
        None if is_wide(answer) => {
            let _ = write!(text, "  {}", toned("POOR", Tone::Bad));
        }
        None => {}
    }
    if let (Some(range), Some(sd), Some(_)) = (answer.range_m, answer.range_sd_m, answer.position_m) {
        let _ = write!(text, "  {range:.2} +- {sd:.2} m");
    }
    text
}

fn describe_with(answer: &Answer, of: MirrorOf, doubts: &str, details: Option<&str>) -> String {
    let mut text = head(answer, of) + "\n";
    if answer.azimuth_deg.is_none() {
        return text + doubts + details.unwrap_or_default();
    }
    text += &verdict(answer);
    text += &origin(answer);
    if let Some(body) = answer.azimuth_body_deg {
        let seen =
            if answer.position_m.is_some() { "seen from its place then" } else { "seen from the middle of the motion" };
        let nose = "from the robot's nose at the end, positive to the left";
        let _ = writeln!(text, "  {} {nose}, {seen}", with_bar(body, answer.azimuth_body_sd_deg));
    }
    text += doubts;
    // If the logs may have been exchanged, that question stands above.
    if answer.confidence.is_some() && is_poor(answer) && !answer.pair_counts.may_be_exchanged() {
        text += &why(answer, of);
        // With `-v` the candidates stand among the details.
        if details.is_none() {
            text += &next_step(answer);
        }
    }
    if let Some(details) = details {
        text += &quality(answer);
        text += details;
    }
    text
}

/// What the odometry got wrong, and the antenna's place where the drive shows it; `given_m` is where it was said to be.
pub(super) fn fitted(fit: &OdometryFit, given_m: Vector3<f64>) -> String {
    let mut text = fit.to_string();
    let (forward, left) = (&fit.forward_m, &fit.left_m);
    if fit.refused.is_none() && forward.known && left.known {
        // An arm is as long as it was given, but turned with the corrected heading.
        let given_m = given_m * (1.0 + fit.scale.value) / (1.0 + fit.turn.value);
        let [x, y] = [given_m.x + forward.value, given_m.y + left.value].map(|metres| fixed(metres, 3));
        let _ = writeln!(text, "  from now on: --antenna-offset {x},{y},{}", given_m.z);
    }
    text
}

/// Whether another direction is about as probable.
fn has_rival(answer: &Answer) -> bool {
    answer.candidates.get(1).is_some_and(|next| next.share >= ALIKE)
}

/// Probability that the answer, or its mirror, is within five degrees.
fn sure(answer: &Answer) -> Option<f64> {
    answer.confidence.map(|confidence| (confidence / (1.0 - answer.mirror_share.unwrap_or(0.0))).min(1.0))
}

fn is_poor(answer: &Answer) -> bool {
    sure(answer).map_or_else(|| is_wide(answer), |sure| sure < FAIR)
}

fn is_wide(answer: &Answer) -> bool {
    answer.azimuth_sd_deg.is_some_and(|sd| sd > WIDE_DEG)
}

fn grade(sure: f64) -> String {
    match sure {
        _ if sure >= GOOD => toned("GOOD", Tone::Good),
        _ if sure >= FAIR => toned("FAIR", Tone::Doubt),
        _ => toned("POOR", Tone::Bad),
    }
}

fn verdict(answer: &Answer) -> String {
    let Some(sure) = sure(answer) else {
        let poor = || {
            format!(
                "  {}: no direction stands out. Check the antennas, the baseline and the trajectory's clock, or turn further\n",
                toned("POOR", Tone::Bad)
            )
        };
        return is_wide(answer).then(poor).unwrap_or_default();
    };
    let of = if answer.mirror_deg.is_some() { " of one of the two" } else { "" };
    format!("  {}: {:.0} % sure to be within 5 degrees{of}\n", grade(sure), 100.0 * sure)
}

/// Where the bearing is seen from, and how far away the transmitter is.
fn origin(answer: &Answer) -> String {
    const FROM: &str = "from the middle of the motion";
    match (answer.range_m, answer.range_sd_m, answer.position_m) {
        (Some(range), Some(sd), Some(position_m)) => {
            let [x, y, z] = position_m.map(|metres| fixed(metres, 2));
            let height = if answer.elevation_deg.is_some() { format!(", z {z}") } else { String::new() };
            let last = if answer.chain_constants_deg.is_empty() { "at the last pair" } else { "at the end" };
            format!("  {range:.2} +- {sd:.2} m {FROM}, at x {x}, y {y}{height} m in the trajectory's frame {last}\n")
        }
        (Some(range), Some(sd), None) => {
            let share = answer.candidates.first().map_or(0.0, |first| 100.0 * first.share);
            format!(
                "  {range:.2} +- {sd:.2} m {FROM}; no place: this direction has only {share:.0} % of the probability\n"
            )
        }
        // A plane wave has no distance to be found.
        _ if answer.model != Some(WaveModel::SphericalWave) => format!("  {FROM}\n"),
        _ => format!("  {FROM}; distance unknown\n"),
    }
}

/// What makes an answer poor.
fn why(answer: &Answer, of: MirrorOf) -> String {
    let drives = matches!(of, MirrorOf::Motion);
    if answer.clock_offset.is_some_and(|found| found.doubt) {
        "  Why: by the phases, the clocks of log and trajectory differ (see the note on --clock-offset).\n".into()
    } else if let Some(coherence) = answer.coherence.filter(|coherence| *coherence < LITTLE) {
        let wrong = if drives {
            "the path is not that of the antenna (--antenna-offset, --clock-offset)"
        } else {
            "the antennas or their places are others (--antennas, --baseline), the clocks differ (--clock-offset)"
        };
        format!(
            "  Why: one wave explains only {:.0} % of the phases along this path. There are reflections, {wrong}, or --channel \
             is not the cards' channel.\n",
            100.0 * coherence
        )
    } else if has_rival(answer) {
        "  Why: other directions explain the samples about as well.\n".into()
    } else if drives {
        "  Why: the peak is wide. A longer drive or one with a turn makes it narrower; with wheel odometry, so does --antenna-offset.\n".into()
    } else {
        "  Why: the peak is wide. A further turn or a longer baseline makes it narrower.\n".into()
    }
}

/// Other directions of a poor answer, and what to look at next.
fn next_step(answer: &Answer) -> String {
    let others = has_rival(answer) && answer.mirror_deg.is_none();
    let candidates = if others { places(&answer.candidates) } else { String::new() };
    candidates + "  Look at the pictures (--plot DIR); -v prints details.\n"
}

/// The elevation: with its sign where the motion distinguishes up from down.
fn elevation(answer: &Answer) -> String {
    let sd = answer.elevation_sd_deg.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
    match (answer.elevation_deg, answer.abs_elevation_deg) {
        (Some(elevation), _) => format!("elevation {}{sd} deg", fixed(elevation, 2)),
        (None, Some(size)) => format!("|elevation| {size:.2} deg"),
        (None, None) => "elevation unknown".into(),
    }
}

/// How far the answer explains what was measured.
fn quality(answer: &Answer) -> String {
    let or_dash = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
    let mut text = match answer.candidates.len() {
        0 | 1 => String::new(),
        _ => format!("  candidates:\n{}", places(&answer.candidates)),
    };
    let _ = writeln!(
        text,
        "  {}; one plane wave explains {} of the phases (coherence, 0 to 1)",
        elevation(answer),
        or_dash(answer.coherence)
    );
    let _ = writeln!(
        text,
        "  profile variance of the WSR toolbox {} (lower is sharper), likelihood share of Dijkstra et al. {} (of 360 azimuths)",
        or_dash(answer.wsr_profile_variance),
        answer.likelihood_share.map_or("-".into(), |share| format!("{share:.4}")),
    );
    text
}

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
    if let (Some(before), Some(after)) = (answer.phase_coherence_before, answer.phase_coherence_after) {
        let drifts = answer.cfo_span_hz.map_or(String::new(), |hz| format!(" (drifting by {hz:.0} Hz)"));
        let cfo = answer.cfo_hz.map_or_else(
            || "not removed: the phase would not be steadier".into(),
            |cfo| format!("{cfo:.0} Hz{drifts} removed"),
        );
        let _ = writeln!(text, "  CFO {cfo}; phase coherence {before:.2} -> {after:.2}");
    }
    match answer.clock_offset {
        Some(found) if found.sd_s < TELLS_S => {
            let (offset_s, sd_s) = (fixed(found.offset_s, 2), found.sd_s);
            let _ = writeln!(
                text,
                "  clocks: by the phases, the trajectory's is {offset_s} +- {sd_s:.2} s ahead of the log's"
            );
        }
        _ => {}
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
    // Of a poor answer, it belongs to a direction that is as unknown.
    let constants: String = answer.chain_constants_deg.iter().filter(|_| !is_poor(answer)).map(constant).collect();
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
        let next = if MANY_TWICE * other as f64 > counts.formed as f64 {
            "Is the trajectory on the receiver's clock (--clock-offset)?"
        } else {
            "Were the two logs exchanged? Then swap --rx and --tx"
        };
        format!(
            "  {} of {} pairs have no pose; by the times of the transmitter's log {other} would have none. {next}\n",
            counts.no_pose, counts.formed
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::pipeline::ClockOffset;

    fn answer(confidence: f64, change: impl FnOnce(&mut Answer)) -> Answer {
        let mut answer = Answer::failed("tx".into(), String::new());
        (answer.error, answer.azimuth_deg, answer.azimuth_sd_deg) = (None, Some(97.0), Some(34.4));
        (answer.confidence, answer.coherence) = (Some(confidence), Some(0.28));
        answer.model = Some(WaveModel::SphericalWave);
        change(&mut answer);
        answer
    }

    #[test]
    fn a_good_answer_is_three_lines_and_more_is_asked_for() {
        let good = answer(0.93, |answer| (answer.range_m, answer.range_sd_m) = (Some(3.9), Some(0.2)));
        let short = describe_with(&good, MirrorOf::Motion, "", None);
        assert_eq!(short.lines().count(), 3, "{short}");
        assert!(short.starts_with("tx: 97 deg +- 34\n  GOOD: 93 % sure"), "{short}");
        assert_eq!(in_a_line(&good, MirrorOf::Motion), "tx: 97 deg +- 34  GOOD 93 %");
        assert!(
            !short.contains("CFO") && describe_with(&good, MirrorOf::Motion, "", Some("  CFO\n")).ends_with("  CFO\n")
        );
    }

    #[test]
    fn a_poor_answer_says_why_and_what_next_and_doubts_are_always_there() {
        let poor = describe_with(&answer(0.35, |_| ()), MirrorOf::Motion, "  a doubt\n", None);
        for words in [
            "POOR: 35 % sure",
            "only 28 % of the phases",
            "--antenna-offset",
            "--channel",
            "distance unknown",
            "a doubt",
            "-v",
        ] {
            assert!(poor.contains(words), "{words}: {poor}");
        }
        let long = describe_with(&answer(0.35, |_| ()), MirrorOf::Motion, "", Some(""));
        assert!(long.contains("28 % of the phases") && !long.contains("-v prints details"), "{long}");
        assert!(describe_with(&answer(0.6, |_| ()), MirrorOf::Motion, "", None).contains("FAIR: 60 %"));
        let wide = describe_with(&answer(0.35, |answer| answer.coherence = Some(0.6)), MirrorOf::Motion, "", None);
        assert!(wide.contains("the peak is wide"), "{wide}");
    }

    #[test]
    fn clocks_that_differ_are_why_and_those_that_agree_a_detail() {
        let of = |log_ratio: f64, sd_s: f64| {
            let mut answer = answer(0.1, |_| ());
            answer.clock_offset = Some(ClockOffset { offset_s: -0.004, sd_s, log_ratio, doubt: log_ratio > 8.0 });
            (describe_with(&answer, MirrorOf::Motion, "", None), pairs(&answer))
        };
        assert!(of(20.0, 0.05).0.contains("Why: by the phases, the clocks"), "{}", of(20.0, 0.05).0);
        let (text, details) = of(0.5, 0.05);
        assert!(text.contains("28 % of the phases"), "{text}");
        assert!(
            details.contains("clocks: by the phases, the trajectory's is 0.00 +- 0.05 s ahead of the log's"),
            "{details}"
        );
        assert!(!of(0.5, 0.4).1.contains("clocks"));
    }

    #[test]
    fn advice_for_several_antennas_names_options_that_they_take() {
        let turned = |change: fn(&mut Answer)| describe_with(&answer(0.35, change), MirrorOf::Turn, "", None);
        let (incoherent, wide) = (turned(|_| ()), turned(|answer| answer.coherence = Some(0.6)));
        assert!(
            incoherent.contains("(--antennas, --baseline)") && wide.contains("A further turn"),
            "{incoherent}{wide}"
        );
        assert!(!(incoherent + &wide).contains("--antenna-offset"));
        let constants = |confidence| {
            records(&answer(confidence, |answer| answer.chain_constants_deg = vec![[50.0, 0.3]])).lines().count()
        };
        assert_eq!((constants(0.9), constants(0.4)), (2, 1), "a poor answer's constant is not for use");
    }

    #[test]
    fn logs_that_fit_the_trajectory_no_better_the_other_way_round_are_on_another_clock() {
        let asked = |other: usize| {
            let counts = |answer: &mut Answer| {
                (answer.pair_counts.formed, answer.pair_counts.no_pose) = (2988, 1798);
                answer.pair_counts.no_pose_by_transmitter = Some(other);
            };
            doubts(&answer(0.9, counts))
        };
        assert!(asked(0).contains("swap --rx and --tx"), "{}", asked(0));
        assert!(asked(1482).contains("(--clock-offset)") && !asked(1482).contains("swap"), "{}", asked(1482));
        assert_eq!(asked(1790), "");
    }

    #[test]
    fn a_mirror_has_half_of_the_probability_and_the_pair_all() {
        let two = |answer: &mut Answer| (answer.mirror_deg, answer.mirror_share) = (Some(-97.0), Some(0.5));
        let text = describe_with(&answer(0.47, two), MirrorOf::Motion, "", None);
        assert!(text.contains("or its mirror -97 deg") && text.contains("GOOD: 94 % sure"), "{text}");
        assert!(text.contains("of one of the two") && !text.contains("Why"), "{text}");
    }
}
