//! Claims of clocks and of the host, and those decided by the kernel module's counters.

use super::{TRUTH, Told};
use crate::evidence::{Evidence, Heard, HeardRecord};
use crate::report::Verdict;
use crate::stats::{SURE, line, quantile};
use csi5300::bartlett::Tier;
use csi5300::pipeline::Options;

/// A step beyond this is a set clock, microseconds; busy hosts rarely deliver records later than that.
const STEP_US: i64 = 50_000;

pub(super) fn buffer(heard: &Heard, _: &Evidence) -> Told {
    let overruns = heard.survey.overruns;
    Told::decided(overruns == 0, format!("{overruns} overruns")).with("overruns", overruns as f64, "")
}

/// From one record to the next: (card's step, host's step), microseconds, of records with both.
fn steps(heard: &Heard) -> Vec<(i64, i64)> {
    let both = |record: &HeardRecord| Some((record.card_us, record.host_us?));
    let times: Vec<(i64, i64)> = heard.records.iter().filter_map(both).collect();
    times
        .windows(2)
        .filter_map(|pair| Some((pair.get(1)?.0 - pair.first()?.0, pair.get(1)?.1 - pair.first()?.1)))
        .collect()
}

/// Steps at which the two clocks disagree, split into those of the card and those of the host: the clock with the more
/// unusual step made it. A late record counts for neither.
fn disagreements(heard: &Heard) -> Option<(Vec<i64>, Vec<i64>)> {
    let steps = steps(heard);
    if steps.len() < super::LEAST {
        return None;
    }
    let usual = quantile(&steps.iter().map(|step| step.0 as f64).collect::<Vec<_>>(), 0.5)? as i64;
    let (mut of_card, mut of_host) = (Vec::new(), Vec::new());
    for (at, (card, host)) in steps.iter().enumerate() {
        let off = host - card;
        // After a clock was set, the difference persists over the next steps.
        let stays: i64 =
            steps.get(at..(at + 12).min(steps.len())).unwrap_or(&[]).iter().map(|(card, host)| host - card).sum();
        if off.abs() <= STEP_US || stays.abs() <= STEP_US || stays.signum() != off.signum() {
            continue;
        }
        match (card - usual).abs() > (host - usual).abs() {
            true => of_card.push(-off),
            false => of_host.push(off),
        }
    }
    Some((of_card, of_host))
}

fn a_clock_was_set(heard: &Heard) -> bool {
    disagreements(heard).is_some_and(|(card, host)| !card.is_empty() || !host.is_empty())
}

const NO_HOST_TIMES: &str = "fewer than 100 records have a host time: record with csi5300, or keep the side file";

fn told_steps(steps: &[i64], whose: &str) -> Told {
    let largest = steps.iter().copied().max_by_key(|step| step.abs()).unwrap_or(0) as f64 * 1e-6;
    let found = match steps.len() {
        0 => "no step".to_owned(),
        1 => format!("one step of the {whose}'s clock, by {largest:+.2} s"),
        count => format!("{count} steps of the {whose}'s clock, the largest by {largest:+.2} s"),
    };
    Told::decided(steps.is_empty(), found).with("steps", steps.len() as f64, "").with("largest", largest, "s")
}

pub(super) fn clock_set(heard: &Heard, _: &Evidence) -> Told {
    disagreements(heard).map_or_else(|| Told::not_tried(NO_HOST_TIMES), |(_, of_host)| told_steps(&of_host, "host"))
}

pub(super) fn card_clock(heard: &Heard, _: &Evidence) -> Told {
    let back =
        heard.records.windows(2).filter(|pair| matches!(pair, [before, now] if now.card_us < before.card_us)).count();
    if back > 0 {
        return Told::decided(false, format!("it goes back {back} times")).with("steps back", back as f64, "");
    }
    disagreements(heard).map_or_else(|| Told::not_tried(NO_HOST_TIMES), |(of_card, _)| told_steps(&of_card, "card"))
}

/// Host clock less card clock over the card's clock, in seconds from the first record.
fn residuals(heard: &Heard) -> Vec<(f64, f64)> {
    let mut first = None;
    let point = |record: &HeardRecord| {
        let (card, host) = (record.card_us, record.host_us?);
        let (card_0, host_0) = *first.get_or_insert((card, host));
        Some(((card - card_0) as f64 * 1e-6, ((host - host_0) - (card - card_0)) as f64 * 1e-6))
    };
    heard.records.iter().filter_map(point).collect()
}

pub(super) fn delay(heard: &Heard, _: &Evidence) -> Told {
    let points = residuals(heard);
    if a_clock_was_set(heard) {
        return Told::not_tried("a clock was set: see card.clock and host.clock");
    }
    let Some((offset, slope, _)) = line(&points).filter(|_| points.len() >= super::LEAST) else {
        return Told::not_tried(NO_HOST_TIMES);
    };
    let away: Vec<f64> = points.iter().map(|(x, y)| (y - offset - slope * x) * 1e6).collect();
    let at = |share| quantile(&away, share).unwrap_or(f64::NAN);
    let (low, high, worst) = (at(0.05), at(0.95), at(1.0));
    let found = format!(
        "90 % of the records within {:.3} ms of each other, the latest {:.1} ms after the usual",
        1e-3 * (high - low),
        1e-3 * worst
    );
    Told::new(Verdict::Measured, found).with("90 % within", high - low, "us").with("latest", worst, "us")
}

pub(super) fn card_rate(heard: &Heard, _: &Evidence) -> Told {
    let points = residuals(heard);
    if points.len() < super::LEAST {
        return Told::not_tried(NO_HOST_TIMES);
    }
    if a_clock_was_set(heard) {
        return Told::not_tried("a clock was set: see card.clock and host.clock");
    }
    let Some((_, slope, error)) = line(&points) else { return Told::not_tried("the card's clock stands still") };
    // Late records at one end tilt the line.
    let length = points.last().map_or(0.0, |point| point.0).max(1e-3);
    let (ppm, error) = (-1e6 * slope, 1e6 * (SURE * error + 1e-4 / length));
    let told = if error > 20.0 {
        Told::not_tried(format!("{ppm:+.1} ppm +- {error:.0}: too short a recording"))
    } else {
        Told::limited(ppm.abs(), error, 100.0, format!("{ppm:+.1} ppm +- {error:.1}"))
    };
    told.with("rate", ppm, "ppm")
}

pub(super) fn lateness(evidence: &Evidence) -> Told {
    let late = &evidence.lateness_us;
    if late.len() < super::LEAST {
        return Told::not_tried("needs a card: nobody waits for a recorded log or in virtual time");
    }
    let [median, most, worst] = [0.5, 0.99, 1.0].map(|share| quantile(late, share).unwrap_or(f64::NAN));
    let beyond = late.iter().filter(|us| **us > 2_500.0).count();
    let told = Told::share(beyond, late.len(), 0.01, "wakes later than 2.5 ms");
    let found = format!("median {median:.0} us, 99 % within {most:.0} us, worst {worst:.0} us; {}", told.found);
    Told { found, ..told }.with("median", median, "us").with("99 %", most, "us").with("worst", worst, "us")
}

pub(super) fn processor(evidence: &Evidence) -> Told {
    if evidence.plan.truth.is_none() {
        return Told::not_tried(TRUTH);
    }
    let azimuth = |tier| {
        let options = Options { tier, ..Options::new(evidence.plan.channel) };
        super::link::answer(evidence, options).map(|answer| answer.0.to_degrees())
    };
    let tiers: Vec<(String, f64)> =
        Tier::available().into_iter().filter_map(|tier| Some((format!("{tier:?}"), azimuth(tier).ok()?))).collect();
    let Some((_, portable)) = tiers.first().cloned() else {
        return Told::not_tried("there is no bearing: see truth.bearing");
    };
    let worst = tiers.iter().map(|(_, azimuth)| (azimuth - portable).abs()).fold(0.0, f64::max);
    let names: Vec<&str> = tiers.iter().map(|(name, _)| name.as_str()).collect();
    Told::decided(worst <= 1e-3, format!("{}: {worst:.6} degrees apart", names.join(", "))).with("apart", worst, "deg")
}

/// Records that the recorder's claim compares.
const COMPARED: usize = 20_000;

pub(super) fn recorder(heard: &Heard, _: &Evidence) -> Told {
    if heard.recorded {
        return Told::not_tried("needs a card: these records come from a recording");
    }
    if heard.records.len() > COMPARED {
        return Told::not_tried(format!("more than {COMPARED} records: a shorter run compares them"));
    }
    // A stock log has no host times; its side file has them.
    let same = |a: &HeardRecord, b: &HeardRecord| {
        let b = HeardRecord { host_us: a.host_us, ..b.clone() };
        *a == b
    };
    let again = Heard::of_log(&heard.log);
    let all = again.records.len() == heard.records.len();
    let equal = again.records.iter().zip(&heard.records).filter(|(a, b)| same(a, b)).count();
    let mut lost = 0;
    for eighth in 1..8 {
        let cut = heard.log.get(..heard.log.len() * eighth / 8).unwrap_or(&[]);
        let written = heard.ends.iter().filter(|end| **end <= cut.len()).count();
        lost += written.saturating_sub(Heard::of_log(cut).records.len());
    }
    let found =
        format!("{equal} of {} records equal; {lost} lost where the log is cut at seven places", heard.records.len());
    Told::decided(all && equal == heard.records.len() && lost == 0, found).with("equal", equal as f64, "").with(
        "lost",
        lost as f64,
        "",
    )
}

/// Growth of the counters, in the order of the names; or why it is unknown.
fn grown<const N: usize>(evidence: &Evidence, names: [&str; N]) -> Result<[u64; N], Told> {
    if evidence.counters.is_empty() {
        return Err(Told::not_tried("needs the kernel module csi5300 beside the stock driver"));
    }
    let found = names.map(|name| evidence.counters.get(name).copied());
    match found.iter().position(Option::is_none) {
        Some(at) => Err(Told::not_tried(format!(
            "the module has no counter `{}`: it is of another version",
            names.get(at).unwrap_or(&"")
        ))),
        None => Ok(found.map(Option::unwrap_or_default)),
    }
}

pub(super) fn csi(evidence: &Evidence) -> Told {
    match grown(evidence, ["phy", "bfee", "records"]) {
        Err(told) => told,
        Ok([0, 0, _]) => Told::not_tried("no frame was heard meanwhile"),
        Ok([phy, bfee, records]) => Told::decided(
            bfee > 0 && records > 0,
            format!("{phy} frames heard, {bfee} with CSI, {records} records made"),
        )
        .with("bfee", bfee as f64, ""),
    }
}

/// A counter that must not grow while CSI comes.
pub(super) fn stays_zero<const N: usize>(evidence: &Evidence, names: [&str; N]) -> Told {
    let bfee = match grown(evidence, ["bfee"]) {
        Err(told) => return told,
        Ok([0]) => return Told::not_tried("no CSI came meanwhile: see module.csi"),
        Ok([bfee]) => bfee,
    };
    match grown(evidence, names) {
        Err(told) => told,
        Ok(counts) => {
            let words: Vec<String> = names.iter().zip(counts).map(|(name, count)| format!("{name} +{count}")).collect();
            Told::decided(counts.iter().all(|count| *count == 0), format!("{} of {bfee} with CSI", words.join(", ")))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::CLAIMS;
    use crate::evidence::{Evidence, Plan};
    use crate::report::Verdict::{Fails, Holds, NotTried};

    fn verdicts(counters: &[(&str, u64)]) -> [crate::report::Verdict; 4] {
        let mut evidence = Evidence::new(Plan::new("64".parse().unwrap()));
        evidence.counters = counters.iter().map(|(name, more)| ((*name).to_owned(), *more)).collect();
        ["csi", "marked", "order", "layout"].map(|what| {
            let claim = CLAIMS.iter().find(|claim| claim.id == format!("module.{what}")).unwrap();
            claim.judge(&evidence)[0].verdict
        })
    }

    #[test]
    fn counters_are_read() {
        assert_eq!(verdicts(&[]), [NotTried; 4]);
        let good = [
            ("phy", 900),
            ("bfee", 800),
            ("records", 800),
            ("unmarked", 0),
            ("no_order", 0),
            ("bad_bfee", 0),
            ("bad_phy", 0),
        ];
        assert_eq!(verdicts(&good), [Holds; 4]);
        let deaf = [("phy", 900), ("bfee", 0), ("records", 0), ("unmarked", 0)];
        assert_eq!(verdicts(&deaf), [Fails, NotTried, NotTried, NotTried]);
        let bad = [
            ("phy", 900),
            ("bfee", 800),
            ("records", 800),
            ("unmarked", 800),
            ("no_order", 3),
            ("bad_bfee", 0),
            ("bad_phy", 1),
        ];
        assert_eq!(verdicts(&bad), [Holds, Fails, Fails, Fails]);
    }
}
