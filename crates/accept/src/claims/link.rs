//! Claims about two cards together, about sent frames, and those that need a person, who retunes a card, reloads its driver,
//! or unplugs an antenna.

use super::{LEAST, SENDING, TRUTH, TWO_CARDS, Told};
use crate::evidence::{
    After, Done, Evidence, Heard, HeardRecord, Interface, Pairs, Sending, Sent, antennas, column, usual_sender,
};
use crate::stats::{SURE, quantile};
use csi5300::exchange::tdma::Phy;
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Options, Transmitter};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, SUBCARRIERS, rate};
use driver_iface::mpdu;
use driver_iface::radiotap::Bandwidth;
use num_complex::{Complex32, Complex64};
use std::collections::{BTreeMap, HashSet};
use std::f64::consts::{FRAC_PI_4, TAU};

/// The pairs of two logs that belong together.
fn of_two_cards(evidence: &Evidence) -> Result<&Pairs, Told> {
    match &evidence.pairs {
        None => Err(Told::not_tried(TWO_CARDS)),
        Some(Pairs { refused: Some(why), .. }) => Err(Told::not_tried(why.to_string())),
        Some(pairs) => Ok(pairs),
    }
}

/// The same, if there are enough of them.
pub(super) fn paired(evidence: &Evidence) -> Result<&Pairs, Told> {
    let pairs = of_two_cards(evidence)?;
    let few = || format!("{} exchanges have both frames; at least {} are needed", pairs.len(), LEAST);
    if pairs.len() < LEAST { Err(Told::not_tried(few())) } else { Ok(pairs) }
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

/// Answers come evenly if 90 % of them are within this, microseconds.
const EVEN_US: f64 = 500.0;

/// 90 % of the turn-arounds are within this, microseconds.
fn spread_us(pairs: &Pairs) -> f64 {
    let [low, high] = [0.05, 0.95].map(|share| quantile(&pairs.turn_us, share).unwrap_or(f64::NAN));
    high - low
}

pub(super) fn turn_around(pairs: &Pairs, _: &Evidence) -> Told {
    let within = spread_us(pairs);
    let told = Told::decided(within <= EVEN_US, format!("90 % within {within:.0} us of each other"));
    told.with("90 % within", within, "us")
}

pub(super) fn late(pairs: &Pairs, _: &Evidence) -> Told {
    let late = pairs.turn_us.iter().filter(|us| us.abs() > 1_500.0).count();
    Told::share(late, pairs.turn_us.len(), 0.05, "answers are 1.5 ms away from the usual turn-around")
}

pub(super) fn drift(pairs: &Pairs, _: &Evidence) -> Told {
    let Some((ppm, error)) = pairs.drift_ppm else { return Told::not_tried("a card's clock stands still") };
    let found = format!("{ppm:+.2} ppm +- {:.2}", SURE * error);
    let told = if SURE * error > 10.0 {
        Told::not_tried(format!("{found}: too short a recording"))
    } else {
        Told::limited(ppm.abs(), SURE * error, 40.0, found)
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
    let spread = spread_us(pairs);
    if spread > EVEN_US {
        return Told::not_tried(format!(
            "the turn-around varies by {spread:.0} us, which tilts the clocks' line: see exchange.turn_around"
        ));
    }
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
    let told = if SURE * error > 1.0 {
        Told::not_tried(format!("{words}: too short a recording"))
    } else {
        Told::limited(off, SURE * error, 1.5, words)
    };
    told.with("carrier", carrier, "ppm").with("clock", drift, "ppm")
}

pub(super) fn rest(pairs: &Pairs, evidence: &Evidence) -> Told {
    if !evidence.plan.at_rest {
        return Told::not_tried("needs two robots that stand still (`at_rest`)");
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
    let truth = evidence.plan.truth.as_ref().ok_or(TRUTH)?;
    let far = evidence.far.as_ref().ok_or(TWO_CARDS)?;
    let (mut near_log, mut far_log) = (evidence.near.again(), far.again());
    let transmitters = vec![Transmitter { log: &mut far_log, trajectory: None }];
    let report = csi5300::pipeline::bearings(&mut near_log, transmitters, &truth.trajectory, &options)
        .map_err(|error| error.to_string())?;
    let link = report.links.into_iter().next().ok_or("there is no link")?;
    let bearing = link.bearing.map_err(|error| error.to_string())?;
    Ok((bearing.answer.azimuth_rad, bearing.answer.azimuth_95_rad, bearing.answer.probability))
}

pub(super) fn bearing(evidence: &Evidence) -> Told {
    let Some(truth) = &evidence.plan.truth else { return Told::not_tried(TRUTH) };
    let (azimuth, bar, probability) = match answer(evidence, Options::new(evidence.plan.channel)) {
        Ok(answer) => answer,
        Err(why) => return Told::not_tried(format!("no bearing: {why}")),
    };
    let error = wrap_rad(azimuth - truth.azimuth_rad);
    let ([off, within], sure) = ([error, bar].map(f64::to_degrees), 100.0 * probability);
    let found = format!("{off:.2} degrees off, 95 % within {within:.2}; {sure:.0} % sure to be within 5 degrees");
    Told::decided(error.abs() <= bar, found).with("error", off, "deg").with("95 % within", within, "deg")
}

/// Above this rate frames may be refused or lost: only measured.
const ASKED_HZ: f64 = 200.0;

fn asked(evidence: &Evidence) -> Vec<Sent> {
    evidence.sent.iter().copied().filter(|sent| sent.rate_hz <= ASKED_HZ).collect()
}

/// The rates in the order in which frames were sent at them.
fn rates(evidence: &Evidence) -> Vec<f64> {
    let mut rates: Vec<f64> = evidence.sent.iter().map(|sent| sent.rate_hz).collect();
    rates.dedup();
    rates
}

pub(super) fn taken(evidence: &Evidence) -> Told {
    let asked = asked(evidence);
    if asked.is_empty() {
        return Told::not_tried(SENDING);
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
        return Told::not_tried(SENDING);
    }
    let heard = heard_by_far(evidence).unwrap_or_default();
    let lost_at = |rate_hz: f64| {
        let sent: Vec<&Sent> = evidence.sent.iter().filter(|sent| sent.rate_hz == rate_hz).collect();
        let lost = sent.iter().filter(|sent| !heard.contains(&sent.number)).count();
        100.0 * lost as f64 / sent.len().max(1) as f64
    };
    let rates = rates(evidence);
    let by_rate: Vec<String> = rates.iter().map(|rate| format!("{:.1} % at {rate:.0}/s", lost_at(*rate))).collect();
    let lost = asked.iter().filter(|sent| !heard.contains(&sent.number)).count();
    let told = Told::share(lost, asked.len(), 0.1, "frames were not heard");
    told.adding(&format!(": {}", by_rate.join(", ")))
}

pub(super) fn pace(evidence: &Evidence) -> Told {
    let (Some(far), false) = (&evidence.far, evidence.sent.is_empty()) else { return Told::not_tried(SENDING) };
    let Some(sender) = usual_sender(far) else { return Told::not_tried("the far card heard no number") };
    let number = |record: &HeardRecord| Some((record.number?, record.card_us)).filter(|_| record.mac == sender);
    let heard: BTreeMap<u32, i64> = far.records.iter().filter_map(number).collect();
    let rates = rates(evidence);
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
    Some(f64::from(phy.airtime_us(Sending::frame_len() + mpdu::FCS)))
}

pub(super) fn confirmed(evidence: &Evidence) -> Told {
    let taken = evidence.sent.iter().filter(|sent| sent.taken).count();
    match evidence.interface.confirmed {
        _ if taken == 0 => Told::not_tried(SENDING),
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
        _ if evidence.sent.is_empty() => Told::not_tried(SENDING),
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
        return Told::not_tried(SENDING);
    }
    let Some(heard) = heard_by_far(evidence) else { return Told::not_tried("the far card heard no number") };
    let sent: HashSet<u32> = evidence.sent.iter().map(|sent| sent.number).collect();
    Told::share(heard.difference(&sent).count(), heard.len(), 0.0, "numbers were heard that were not sent")
}

/// The longest turn-around that is known, seconds (the WSR driver's).
const TURN_AROUND_S: f64 = 322e-6;

/// A phase that stays the same at rest, with its standard error.
struct Constant {
    name: String,
    rad: f64,
    error: f64,
    /// The carrier offset, Hz, which turns the round trip by an unknown whole turn-around.
    offset_hz: f64,
}

impl Constant {
    /// The mean of phases.
    fn of(name: String, units: impl Iterator<Item = Complex64>) -> Option<Self> {
        let (mut sum, mut n) = (Complex64::default(), 0.0);
        for unit in units {
            let norm = unit.norm();
            if norm > 0.0 {
                (sum, n) = (sum + unit / norm, n + 1.0);
            }
        }
        // Circular standard deviation (Mardia and Jupp 2000, 2.3.11).
        let deviation = (-2.0 * (sum.norm() / n).ln()).sqrt();
        (n >= LEAST as f64 && deviation.is_finite()).then(|| Self {
            name,
            rad: sum.arg(),
            error: deviation / n.sqrt(),
            offset_hz: 0.0,
        })
    }

    /// Difference from `before`, radians, and its standard error.
    fn step(&self, before: &Self) -> (f64, f64) {
        let turn = TAU * (self.offset_hz - before.offset_hz).abs() * TURN_AROUND_S;
        let step = wrap_rad(self.rad - before.rad);
        (step, SURE * self.error.hypot(before.error) + turn)
    }
}

/// The coefficients of a named antenna.
fn antenna(record: &HeardRecord, antenna: Antenna) -> Option<[Complex32; SUBCARRIERS]> {
    antennas(record)?.chain_of(antenna).map(|chain| column(record, chain))
}

/// Phases that are constant at rest: each antenna's against antenna A's, and the compensated round trip's.
fn constants(near: &Heard, pairs: Option<&Pairs>) -> Vec<Constant> {
    let against_a = |other: Antenna| {
        let unit = |record: &HeardRecord| {
            let (a, other) = antenna(record, Antenna::A).zip(antenna(record, other))?;
            let sum: Complex32 = other.iter().zip(&a).map(|(other, a)| other * a.conj()).sum();
            Some(Complex64::new(sum.re.into(), sum.im.into()))
        };
        Constant::of(format!("antenna {other:?} against A"), near.records.iter().filter_map(unit))
    };
    let round_trip = pairs.and_then(|pairs| {
        let found = pairs.compensation.as_ref()?;
        let mut z = pairs.product.clone();
        found.apply(&mut z);
        let constant = Constant::of("round trip".into(), z.into_iter())?;
        // The error of the median turn-around, its spread over the root of the pairs, limits that of its phase.
        let spread_us = 1.4826 * quantile(&found.jitter_us.iter().map(|us| us.abs()).collect::<Vec<_>>(), 0.5)?;
        let error_s = 1.2533 * 1e-6 * spread_us / (pairs.len() as f64).sqrt();
        let error = constant.error.hypot(TAU * found.df_hz * error_s);
        Some(Constant { error, offset_hz: found.df_hz, ..constant })
    });
    [against_a(Antenna::B), against_a(Antenna::C), round_trip].into_iter().flatten().collect()
}

pub(super) fn same(evidence: &Evidence, done: Done) -> Told {
    let after: Vec<&After> = evidence.after.iter().filter(|after| after.done == done).collect();
    if after.is_empty() || !evidence.plan.at_rest {
        let log = match done {
            Done::Retuned => "a log after each retune (`retuned`)",
            Done::Reloaded => "a log after the driver was reloaded (`reloaded`)",
        };
        return Told::not_tried(format!("needs robots that stand still (`at_rest`), and {log}"));
    }
    let pairs = |after: &After| Some(Pairs::of(&after.near, after.far.as_ref()?, &evidence.plan));
    let before = constants(&evidence.near, evidence.pairs.as_ref());
    let steps: Vec<(String, f64, f64)> = after
        .iter()
        .flat_map(|after| constants(&after.near, pairs(after).as_ref()))
        .filter_map(|now| {
            let (step, error) = now.step(before.iter().find(|before| before.name == now.name)?);
            Some((now.name, step, error))
        })
        .collect();
    let Some((name, step, error)) = steps.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) else {
        return Told::not_tried(format!(
            "no phase can be compared: at least {LEAST} records of two antennas or exchanges"
        ));
    };
    let found = format!(
        "logs after it: {}; the largest step is that of {name}: {:+.0} degrees +- {:.0}",
        after.len(),
        step.to_degrees(),
        error.to_degrees()
    );
    // Half of the smallest step that is known.
    let told = if steps.iter().any(|(_, step, error)| step.abs() - error > FRAC_PI_4) {
        Told::decided(false, found)
    } else if steps.iter().all(|(_, step, error)| step.abs() + error <= FRAC_PI_4) {
        Told::decided(true, found)
    } else {
        Told::not_tried(format!("{found}: too uncertain to tell that from 45"))
    };
    told.with("largest step", step.to_degrees(), "deg")
}

/// Power of each named antenna relative to all, dB: the median over the records; none for antennas in less than half of
/// them.
fn shares(heard: &Heard) -> [Option<f64>; 3] {
    let power = |record: &HeardRecord, which: Antenna| {
        Some(f64::from(antenna(record, which)?.iter().map(Complex32::norm_sqr).sum::<f32>()))
    };
    let all = [Antenna::A, Antenna::B, Antenna::C];
    all.map(|which| {
        let share = |record: &HeardRecord| {
            let total: f64 = all.iter().filter_map(|other| power(record, *other)).sum();
            Some(10.0 * (power(record, which)? / total).max(1e-9).log10()).filter(|_| total > 0.0)
        };
        let shares: Vec<f64> = heard.records.iter().filter_map(share).collect();
        quantile(&shares, 0.5).filter(|_| 2 * shares.len() >= heard.records.len())
    })
}

/// Least loss of an unplugged antenna, dB.
const FALL_DB: f64 = 6.0;

pub(super) fn unplugged(evidence: &Evidence) -> Told {
    if evidence.unplugged.is_empty() {
        return Told::not_tried("needs a person who unplugs antennas (`unplug`)");
    }
    let before = shares(&evidence.near);
    let (mut wrong, mut words, mut figures) = (0, Vec::new(), Vec::new());
    for (which, heard) in &evidence.unplugged {
        if heard.records.len() < LEAST {
            return Told::not_tried(format!(
                "{} records came without antenna {which:?}; {LEAST} are needed",
                heard.records.len()
            ));
        }
        // A chain that the firmware drops fell too.
        let fell = |(before, now): (&Option<f64>, Option<f64>)| Some((*before)? - now.unwrap_or(-90.0));
        let falls: Vec<Option<f64>> = before.iter().zip(shares(heard)).map(fell).collect();
        let Some(own) = falls.get(which.index()).copied().flatten() else {
            return Told::not_tried(format!("antenna {which:?} is in no record, or in few"));
        };
        let most = falls.iter().flatten().copied().fold(own, f64::max);
        wrong += usize::from(own < FALL_DB || own < most);
        words.push(format!("{which:?} fell by {own:.1} dB, the most that any antenna did is {most:.1} dB"));
        figures.push(own);
    }
    let least = figures.iter().copied().fold(f64::INFINITY, f64::min);
    Told::decided(wrong == 0, words.join("; ")).with("least fall", least, "dB")
}
