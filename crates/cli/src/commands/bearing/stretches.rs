//! `--every`: stretches of the motion, each by itself and carried on.

use super::super::{fixed, print, print_json};
use csi5300::pipeline::{Answer, StretchAnswer};
use std::fmt::Write;

/// Prints a link's stretches, and adds what is carried to its end to the link's answer.
pub(super) fn tell(answer: &mut Answer, stretches: Vec<StretchAnswer>, json: bool) {
    answer.carried = stretches.iter().rev().find_map(|stretch| stretch.answer.carried.clone());
    for mut stretch in stretches {
        stretch.answer.link.clone_from(&answer.link);
        stretch.answer.mac.clone_from(&answer.mac);
        if json { print_json(&stretch) } else { print(&line(&stretch)) }
    }
}

fn line(stretch: &StretchAnswer) -> String {
    let (own, from_s, to_s) = (&stretch.answer, stretch.from_s, stretch.to_s);
    let mut text = format!("{} {from_s:.1} .. {to_s:.1} s: ", own.link);
    let _ = match (own.azimuth_deg, own.azimuth_sd_deg) {
        (Some(azimuth), Some(sd)) => write!(text, "{} deg +- {sd:.2}", fixed(azimuth, 2)),
        (Some(azimuth), None) => write!(text, "{} deg", fixed(azimuth, 2)),
        (None, _) => write!(text, "no bearing ({})", own.error.as_deref().unwrap_or("nothing measured")),
    };
    if let Some(carried) = &own.carried {
        let _ = write!(text, "; carried {} deg, spread {:.2}", fixed(carried.azimuth_deg, 2), carried.spread_deg);
        if let Some(first) = carried.candidates.first() {
            let _ = write!(text, ", {:.2} of the evidence within 5 degrees", first.share);
        }
        if let Some(place_m) = carried.place_m {
            let [x, y] = place_m.map(|metres| fixed(metres, 2));
            let _ = write!(text, ", place x {x}, y {y} m");
        }
    }
    text.push('\n');
    text
}
