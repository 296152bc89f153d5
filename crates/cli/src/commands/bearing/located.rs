//! Where a receiver is, from its links to transmitters whose places are known, in words.

use super::super::{fixed, some};
use csi5300::maths::median;
use csi5300_lab::evaluate::Judged;
use csi5300_lab::evaluate::receivers::{Receiver, Shared, UNKNOWN_PROBABILITY};
use std::fmt::Write;

/// The links to a receiver.
fn own<'a>(receiver: &Receiver, rows: &'a [Judged]) -> impl Iterator<Item = &'a Judged> {
    let capture = format!("{}/", receiver.capture);
    rows.iter().filter(move |row| row.answer.link.starts_with(&capture))
}

/// Of a receiver that is not located: which of its bearings are to transmitters whose places are not known.
pub fn say_unplaced(receiver: &mut Receiver, rows: &[Judged]) {
    let Some(error) = receiver.error.clone() else { return };
    let is_unplaced = |row: &&Judged| row.answer.azimuth_deg.is_some() && row.true_transmitter_m.is_none();
    let unplaced: Vec<String> =
        own(receiver, rows).filter(is_unplaced).map(|row| row.transmitter().to_owned()).collect();
    let (whose, options) = match &unplaced[..] {
        [] => return,
        [one] => (format!("the place of {one} is"), format!("--place {one}=X,Y")),
        [one, ..] => (format!("the places of {} are", unplaced.join(", ")), format!("--place {one}=X,Y and so on")),
    };
    let unplaced = format!("{whose} not known ({options})");
    let known = if receiver.links == 0 { "not located:".into() } else { format!("{error};") };
    receiver.error = Some(format!("{known} {unplaced}"));
}

pub fn table(found: &[Receiver], rows: &[Judged]) -> String {
    let mut text = String::new();
    for receiver in found {
        let _ = write!(text, "{}: ", receiver.capture);
        match (receiver.position_m, receiver.covariance_m2) {
            (Some([x, y]), Some(c)) => {
                let _ = write!(
                    text,
                    "x {} +- {:.2} m, y {} +- {:.2} m from {}",
                    fixed(x, 2),
                    c[0][0].sqrt(),
                    fixed(y, 2),
                    c[1][1].sqrt(),
                    some(receiver.links as u64, "link", "links")
                );
                if let (Some(z), Some(sd)) = (receiver.height_m, receiver.height_sd_m) {
                    let _ = write!(text, ", z {} +- {sd:.2} m", fixed(z, 2));
                }
            }
            _ => text += receiver.error.as_deref().unwrap_or("not located"),
        }
        if let Some(off) = receiver.off_m {
            let _ = write!(text, "; {off:.2} m from the truth");
        }
        let [used, outliers] = receiver.ranges;
        if used > 0 {
            let _ = write!(text, "; {}, {outliers} of them outliers", some(used as u64, "range", "ranges"));
        }
        if receiver.without_probability > 0 {
            let _ = write!(
                text,
                "; {} without a calibrated probability weighed as within 5 degrees with {UNKNOWN_PROBABILITY}",
                some(receiver.without_probability as u64, "link", "links")
            );
        }
        text.push('\n');
        others(&receiver.others_m, &mut text);
        said_otherwise(receiver, rows, &mut text);
        for row in own(receiver, rows) {
            let Some(position_m) = row.answer.position_m else { continue };
            let [x, y, z] = position_m.map(|metres| fixed(metres, 2));
            let mirror = row
                .answer
                .mirror_deg
                .map_or(String::new(), |deg| format!("; its mirror, at {} deg, is as far away", fixed(deg, 2)));
            let _ = writeln!(text, "  {}: seen at x {x}, y {y}, z {z} m{mirror}", row.answer.link);
        }
    }
    errors(found, &mut text);
    let mut off: Vec<f64> = found.iter().filter_map(|receiver| receiver.off_m).collect();
    if let Some(median) = median(&mut off) {
        let _ =
            writeln!(text, "{} located, median error {median:.2} m", some(off.len() as u64, "receiver", "receivers"));
    }
    text
}

/// Transmitters located with the receivers.
pub fn shared(found: &[Shared]) -> String {
    let mut text = String::new();
    for Shared { transmitter, captures, position_m: [x, y], covariance_m2: c, others_m } in found {
        let _ = writeln!(
            text,
            "{transmitter}: x {} +- {:.2} m, y {} +- {:.2} m from {captures} captures",
            fixed(*x, 2),
            c[0][0].sqrt(),
            fixed(*y, 2),
            c[1][1].sqrt()
        );
        others(others_m, &mut text);
    }
    text
}

fn others(places_m: &[[f64; 2]], text: &mut String) {
    for [x, y] in places_m {
        let _ = writeln!(text, "  or x {} m, y {} m, which the links fit nearly as well", fixed(*x, 2), fixed(*y, 2));
    }
}

/// The links whose place fits another bearing than their answer.
fn said_otherwise(receiver: &Receiver, rows: &[Judged], text: &mut String) {
    for (link, azimuth_deg) in receiver.names.iter().zip(&receiver.azimuths_deg) {
        let answer = rows.iter().find(|row| row.answer.link == *link).and_then(|row| row.answer.azimuth_deg);
        if let Some(answer) = answer.filter(|answer| (answer - azimuth_deg).abs() > 1e-6) {
            let [fitting, answer] = [*azimuth_deg, answer].map(|deg| fixed(deg, 2));
            let _ = writeln!(text, "  {link}: {fitting} deg fits this place, not the {answer} deg answered");
        }
    }
}

/// Errors of the bearings of links to located receivers, as answered and as the places choose them, where the truth is known.
fn errors(found: &[Receiver], text: &mut String) {
    let chosen = || found.iter().filter(|receiver| receiver.azimuth_errors_deg.len() > 1);
    let pool = |errors: fn(&Receiver) -> &[f64]| {
        let mut errors: Vec<f64> = chosen().flat_map(errors).map(|error| error.abs()).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        median(&mut errors).map(|median| format!("{mean:.2} / {median:.2} deg"))
    };
    if let (Some(answered), Some(fitting)) = (pool(|r| &r.answer_errors_deg), pool(|r| &r.azimuth_errors_deg)) {
        let _ = writeln!(
            text,
            "receivers with two or more links: error mean / median {answered} of the answers, {fitting} of the candidates that fit the place"
        );
    }
}
