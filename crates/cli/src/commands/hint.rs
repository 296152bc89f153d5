//! Which flag or command helps where a log or a link was refused: the library names none.

use csi5300::exchange::assign::Unmatched;
use csi5300::pipeline::{Answer, LinkError};
use csi5300::source::Error;

/// Why a log was not opened, with the command that takes a directory.
pub fn log_refused(error: &Error) -> String {
    match error {
        Error::Directory { .. } => format!("{error}, or use `evaluate`"),
        _ => error.to_string(),
    }
}

/// An error in words, with the flag that may help.
pub fn words(error: &LinkError) -> String {
    match error {
        LinkError::AllCut { pairs, length_s } => {
            format!("all {pairs} pairs are outside --from and --to (the link lasts {length_s:.3} s)")
        }
        LinkError::RowsNotTimes { .. } => format!("{error} (--clock-offset)"),
        LinkError::TooLarge { .. } => format!("{error} (--from and --to cut a piece)"),
        LinkError::OutsideTrajectory { other_fits: false, .. } if error.unit_of_times().is_none() => {
            format!("{error} --clock-offset shifts one against the other")
        }
        _ => error.to_string(),
    }
}

/// An error of a link of logs in words.
fn joined_words(error: &LinkError) -> String {
    match error {
        LinkError::RowsNotTimes { .. } => format!("{error} (--clock-offset SECONDS, or --clock-offset rows)"),
        LinkError::NoHostTime => format!("{error} (--clock-offset rows of `bearing`)"),
        _ => words(error),
    }
}

/// An error of `bearing` in words: it alone has `--tx-mac`, and two logs that could be exchanged.
fn bearing_words(error: &LinkError) -> String {
    match error {
        LinkError::OutsideTrajectory { other_fits: true, .. } => {
            format!("{error} Try --rx and --tx the other way round")
        }
        LinkError::NoMotion { .. } => format!("{error} (one robot with two antennas: --antennas, --baseline)"),
        LinkError::OfTwoRuns { .. } => format!("{error}: name the other robot's log of this run"),
        LinkError::Unmatched(Unmatched::Unclear { .. } | Unmatched::Taken { .. }) => format!("{error} with --tx-mac"),
        LinkError::Unmatched(Unmatched::Named { .. }) => format!("{error} (--tx-mac)"),
        _ => joined_words(error),
    }
}

/// Puts the flag that may help into the error of an answer of `bearing`.
pub fn add(answer: &mut Answer) {
    if let Some(cause) = &answer.cause {
        answer.error = Some(bearing_words(cause));
    }
}

/// Puts the flags that may help into the errors of judged links.
pub fn add_all(rows: &mut [csi5300_lab::evaluate::Judged]) {
    for answer in rows.iter_mut().map(|row| &mut row.answer) {
        if let Some(cause) = &answer.cause {
            answer.error = Some(joined_words(cause));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ambiguous_log_and_a_directory_have_a_way_on() {
        let unclear = LinkError::Unmatched(Unmatched::Unclear { spread_us: 1.0, next_us: 1.5 });
        assert!(bearing_words(&unclear).ends_with("name its MAC with --tx-mac"));
        assert!(!words(&unclear).contains("--tx-mac"));
        // `sound` joins no rows.
        assert!(bearing_words(&LinkError::NoHostTime).contains("--clock-offset rows"));
        assert!(joined_words(&LinkError::NoHostTime).contains("--clock-offset rows"));
        assert!(!words(&LinkError::NoHostTime).contains("--clock-offset rows"));
        // `evaluate` and `sound` name no logs.
        let from = |from_s: f64, start_s, other_fits| LinkError::OutsideTrajectory {
            pairs: 9,
            from_s,
            start_s,
            end_s: start_s + 1.0,
            other_fits,
        };
        let exchanged = |other_fits| from(1.0, 2.0, other_fits);
        for (factor, unit) in [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")] {
            let words = joined_words(&from(1.7253e9, 1.7257e9 * factor, false));
            assert!(words.ends_with(&format!("its times look like {unit}, and are read as seconds")), "{words}");
        }
        assert!(bearing_words(&exchanged(true)).ends_with("Try --rx and --tx the other way round"));
        assert!(joined_words(&exchanged(true)).ends_with("were the two logs exchanged?"));
        assert!(joined_words(&exchanged(false)).contains("--clock-offset"));
        let directory = log_refused(&Error::Directory { path: "logs".into() });
        assert_eq!(directory, "logs is a directory: name a .dat file inside it, or use `evaluate`");
    }
}
