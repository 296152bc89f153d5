//! Claims about two cards together.

use super::{Needs, Told};
use crate::collect::Evidence;
use crate::pairs::Pairs;
use crate::report::Verdict;
use crate::stats::{SURE, quantile};
use csi5300::pipeline::{Options, Transmitter};
use csi5300::source::replay::Replay;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// The pairs of two logs that belong together.
fn of_two_cards(evidence: &Evidence) -> Result<&Pairs, Told> {
    match &evidence.pairs {
        None => Err(Told::needs(Needs::TwoCards)),
        Some(Pairs { refused: Some(why), .. }) => Err(Told::not_tried(why.to_string())),
        Some(pairs) => Ok(pairs),
    }
}

/// The same, if there are enough of them.
pub(super) fn paired(evidence: &Evidence) -> Result<&Pairs, Told> {
    let pairs = of_two_cards(evidence)?;
    let few = || format!("{} exchanges have both frames; at least {} are needed", pairs.len(), super::LEAST);
    if pairs.len() < super::LEAST { Err(Told::not_tried(few())) } else { Ok(pairs) }
}

pub(super) fn pairs(evidence: &Evidence) -> Told {
    let pairs = match of_two_cards(evidence) {
        Ok(pairs) => pairs,
        Err(why) => return why,
    };
    // For the card that heard more of the other: the other one's frames are missing.
    let (most, side) = if pairs.among_others || pairs.frames[0] >= pairs.frames[1] {
        (pairs.frames[0], "near")
    } else {
        (pairs.frames[1], "far")
    };
    match most {
        0 => Told::not_tried("no frame of the other card was heard"),
        _ => Told::share(most - pairs.len(), most, 0.1, &format!("frames of the {side} card have no partner")),
    }
}

pub(super) fn turn_around(pairs: &Pairs, _: &Evidence) -> Told {
    let [low, high] = [0.05, 0.95].map(|share| quantile(&pairs.turn_us, share).unwrap_or(f64::NAN));
    Told::decided(high - low <= 500.0, format!("90 % within {:.0} us of each other", high - low)).with(
        "90 % within",
        high - low,
        "us",
    )
}

pub(super) fn late(pairs: &Pairs, _: &Evidence) -> Told {
    let late = pairs.turn_us.iter().filter(|us| us.abs() > 1_500.0).count();
    Told::share(late, pairs.turn_us.len(), 0.05, "answers are 1.5 ms away from the usual turn-around")
}

pub(super) fn drift(pairs: &Pairs, _: &Evidence) -> Told {
    let Some((ppm, error)) = pairs.drift_ppm else { return Told::not_tried("a card's clock stands still") };
    let found = format!("{ppm:+.2} ppm +- {:.2}", SURE * error);
    let told = match ppm.abs() {
        _ if SURE * error > 10.0 => Told::not_tried(format!("{found}: too short a recording")),
        away if away <= 40.0 => Told::decided(true, found),
        away if away - SURE * error > 40.0 => Told::decided(false, found),
        _ => Told::not_tried(format!("{found}: too near the limit")),
    };
    told.with("drift", ppm, "ppm")
}

/// Coherence of what changes from exchange to exchange: `|mean(u)|`, `u = z[k-1] conj(z[k])^2 z[k+1]` of unit modulus. A constant motion or
/// offset leaves it at 1; random phases leave `1 / sqrt(n)`.
fn coherence(z: &[Complex64]) -> f64 {
    let unit = |z: Complex64| z / z.norm().max(f64::MIN_POSITIVE);
    let terms: Vec<Complex64> = z
        .windows(3)
        .filter_map(|z| match z {
            [a, b, c] => Some(unit(*a) * unit(*b).conj() * unit(*b).conj() * unit(*c)),
            _ => None,
        })
        .collect();
    terms.iter().sum::<Complex64>().norm() / terms.len().max(1) as f64
}

pub(super) fn cancels(pairs: &Pairs, _: &Evidence) -> Told {
    let raw = coherence(&pairs.product);
    let after = pairs.compensation.as_ref().map_or(raw, |found| found.coherence_after.max(raw));
    let one_way = coherence(&pairs.one_way);
    let found = format!(
        "coherence {after:.2} of the compensated product, {raw:.2} as measured, {one_way:.2} of one direction alone"
    );
    // Random phases reach this once in 10,000 recordings.
    let by_chance = SURE / (pairs.len() as f64).sqrt();
    let told = if by_chance > 0.3 {
        Told::not_tried(format!("{found}: too few exchanges"))
    } else {
        Told::decided(after >= 0.4, found)
    };
    told.with("compensated", after, "").with("as measured", raw, "").with("one way", one_way, "")
}

pub(super) fn sign(pairs: &Pairs, _: &Evidence) -> Told {
    let best = |z: &[Complex64], found: Option<f64>| found.unwrap_or(0.0).max(coherence(z));
    let product = best(&pairs.product, pairs.compensation.as_ref().map(|found| found.coherence_after));
    let ratio = best(&pairs.ratio, pairs.ratio_compensation.as_ref().map(|found| found.coherence_after));
    let found = format!("coherence {product:.2} of the product, {ratio:.2} with one direction conjugated");
    let margin = 2.0 * SURE / (pairs.len() as f64).sqrt();
    let one_way = coherence(&pairs.one_way);
    let told = match product - ratio {
        _ if one_way > 0.4 => Told::not_tried(format!(
            "{found}; one direction alone has {one_way:.2}, so there is no offset to tell the signs by"
        )),
        more if more > margin => Told::decided(true, found),
        more if more < -margin => Told::decided(false, found),
        _ => Told::not_tried(format!("{found}: not far enough apart")),
    };
    told.with("product", product, "").with("conjugated", ratio, "")
}

pub(super) fn crystal(pairs: &Pairs, evidence: &Evidence) -> Told {
    let (Some(found), Some((_, error))) = (&pairs.compensation, pairs.drift_ppm) else {
        return Told::not_tried("a card's clock stands still");
    };
    // From a stretch without a step of the turn-around, which would tilt the line.
    let drift = found.drift_ppm;
    let spread =
        quantile(&pairs.turn_us, 0.95).zip(quantile(&pairs.turn_us, 0.05)).map_or(0.0, |(high, low)| high - low);
    // 1.5 ppm of 5.5 GHz turn the phase by 0.05 rad in a microsecond.
    if spread < 10.0 {
        return Told::not_tried(format!(
            "the turn-around varies by {spread:.0} us only: too little for its phase to show the offset"
        ));
    }
    if found.coherence_after < 0.4 {
        return Told::not_tried("the product is incoherent: see phase.cancels");
    }
    let carrier = found.df_hz / evidence.plan.channel.centre_hz() * 1e6;
    let off = (carrier - drift).abs();
    // A turn-around that drifts by 1 us in 1 s looks like 1 ppm.
    let words = format!("carrier {carrier:+.2} ppm, clock {drift:+.2} ppm");
    let told = match off {
        _ if SURE * error > 1.0 => Told::not_tried(format!("{words}: too short a recording")),
        off if off <= 1.5 => Told::decided(true, words),
        off if off - SURE * error > 1.5 => Told::decided(false, words),
        _ => Told::not_tried(format!("{words}: too near the limit")),
    };
    told.with("carrier", carrier, "ppm").with("clock", drift, "ppm")
}

pub(super) fn rest(pairs: &Pairs, evidence: &Evidence) -> Told {
    if !evidence.plan.at_rest {
        return Told::needs(Needs::Rest);
    }
    let mut z = pairs.product.clone();
    if let Some(found) = &pairs.compensation {
        found.apply(&mut z);
    }
    let mut seconds: Vec<(i64, Complex64, f64)> = Vec::new();
    for (z, us) in z.iter().zip(&pairs.near_us) {
        let second = us.div_euclid(1_000_000);
        if seconds.last().is_none_or(|last| last.0 != second) {
            seconds.push((second, Complex64::default(), 0.0));
        }
        if let Some(last) = seconds.last_mut() {
            last.1 += z / z.norm().max(f64::MIN_POSITIVE);
            last.2 += 1.0;
        }
    }
    let coherent: Vec<f64> =
        seconds.iter().filter(|second| second.2 >= 10.0).map(|(_, sum, n)| sum.norm() / n).collect();
    match quantile(&coherent, 0.5) {
        Some(median) => Told::decided(median >= 0.7, format!("{median:.2} in the median of {} s", coherent.len()))
            .with("median", median, ""),
        None => Told::not_tried("fewer than 10 exchanges a second"),
    }
}

/// The bearing by this library: (azimuth, half-width of its 95 % interval, probability of being within five degrees).
pub(super) fn answer(evidence: &Evidence, options: Options) -> Result<(f64, f64, f64), String> {
    let truth = evidence.plan.truth.as_ref().ok_or_else(|| Needs::Direction.words().to_owned())?;
    let far = evidence.far.as_ref().ok_or_else(|| Needs::TwoCards.words().to_owned())?;
    let mut near_log = Replay::new(evidence.near.log.as_slice(), "near".into());
    let mut far_log = Replay::new(far.log.as_slice(), "far".into());
    let transmitters = vec![Transmitter { log: &mut far_log, trajectory: None }];
    let report = csi5300::pipeline::bearings(&mut near_log, transmitters, &truth.trajectory, &options)
        .map_err(|error| error.to_string())?;
    let link = report.links.into_iter().next().ok_or("there is no link")?;
    let bearing = link.bearing.map_err(|error| error.to_string())?;
    Ok((bearing.answer.azimuth_rad, bearing.answer.azimuth_95_rad, bearing.answer.probability))
}

pub(super) fn bearing(evidence: &Evidence) -> Told {
    let Some(truth) = &evidence.plan.truth else { return Told::needs(Needs::Direction) };
    let (azimuth, bar, probability) = match answer(evidence, Options::new(evidence.plan.channel)) {
        Ok(answer) => answer,
        Err(why) => return Told::new(Verdict::NotTried, format!("no bearing: {why}")),
    };
    let error = (azimuth - truth.azimuth_rad + PI).rem_euclid(TAU) - PI;
    let found = format!(
        "{:.2} degrees off, 95 % within {:.2}; {:.0} % sure to be within 5 degrees",
        error.to_degrees(),
        bar.to_degrees(),
        100.0 * probability
    );
    Told::decided(error.abs() <= bar, found).with("error", error.to_degrees(), "deg").with(
        "95 % within",
        bar.to_degrees(),
        "deg",
    )
}
