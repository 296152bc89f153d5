//! Which flag helps a link that gave no bearing: the library names none.

use csi5300::pipeline::{Answer, LinkError};

/// An error in words, with the flag that may help.
pub fn words(error: &LinkError) -> String {
    match error {
        LinkError::NoHostTime => format!("{error} (--join-rows)"),
        LinkError::AllCut { pairs, length_s } => {
            format!("all {pairs} pairs are outside --from and --to (the link lasts {length_s:.3} s)")
        }
        LinkError::TooLarge { .. } => format!("{error} (--from and --to cut a piece)"),
        LinkError::OutsideTrajectory { .. } => format!("{error} --clock-offset shifts one against the other"),
        _ => error.to_string(),
    }
}

/// Puts the flag that may help into the error of an answer.
pub fn add(answer: &mut Answer) {
    if let Some(cause) = &answer.cause {
        answer.error = Some(words(cause));
    }
}

/// Puts the flags that may help into the errors of judged links.
pub fn add_all(rows: &mut [csi5300_lab::evaluate::Judged]) {
    rows.iter_mut().for_each(|row| add(&mut row.answer));
}
