//! Fits the probabilities of `src/place/confidence.rs` to captures with known truth, and tells how they do on places
//! that they were not fitted to.
//!
//! `cargo run --release -p csi5300-lab --example fit_confidence -- ../shared/captures [ROOMS]`
//!
//! Expect two models (full answers, bearings by a plane wave), each with its coefficients as they would stand in
//! `src/tuning/values.rs`, beside the calibration of the values in use. ROOMS simulated rooms of either kind take part if
//! given. Every capture gives bearings by motion capture and by the tracking camera; those by a plane wave also of parts of
//! the motion, 4 s each.

use csi5300::internal::{full_features, quick_features, quick_probability};
use csi5300::pipeline::{Bearing, Options};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find};
use csi5300_lab::fit_confidence::{LabelledBearing, LogisticModel, See, calibration, gather, leave_one_place_out};
use std::path::Path;

/// Starts of the parts, seconds after the first pair, and their length.
const PARTS_S: [f64; 5] = [4.0, 5.5, 7.0, 8.5, 10.0];
const PART_S: f64 = 4.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let root = arguments.next().ok_or("which folder? one with captures below it, as in the WSR data set")?;
    let (mut captures, unreadable) = find(Path::new(&root));
    unreadable.iter().for_each(|line| eprintln!("{line}"));
    if let Some(count) = arguments.next() {
        let folder = std::env::temp_dir().join(format!("fit-confidence-{}", std::process::id()));
        csi5300_lab::rooms::write(&folder, count.parse()?, 1)?;
        captures.extend(find(&folder).0);
        fit(&captures)?;
        std::fs::remove_dir_all(&folder)?;
        return Ok(());
    }
    fit(&captures)
}

fn fit(captures: &[Capture]) -> Result<(), Box<dyn std::error::Error>> {
    // Each capture is evaluated on its own channel, whatever stands here.
    let whole = Options::new("108".parse()?);
    let quick = whole.clone().with_accuracy(whole.accuracy.without_layers());
    let part = |from: f64| quick.clone().with_cut(Some(from), Some(from + PART_S));
    let parts: Vec<Options> = std::iter::once(quick.clone()).chain(PARTS_S.map(part)).collect();
    let full_names = ["per_power", "per_ratio", "per_spread", "at_edge"];
    let quick_names = ["per_coherence", "per_ratio", "per_aperture", "compensated"];
    report("full answers", "full_probability", &full_names, &both(captures, &[whole], &see_full));
    report("bearings by a plane wave", "quick_probability", &quick_names, &both(captures, &parts, &see_quick));
    Ok(())
}

fn both(captures: &[Capture], options: &[Options], see: &See) -> Vec<LabelledBearing> {
    let sources = [TrajectorySource::GroundTruth, TrajectorySource::T265];
    sources.into_iter().flat_map(|source| gather(captures, source, options, see)).collect()
}

fn see_full(bearing: &Bearing, _: &Options) -> Option<(Vec<f64>, f64)> {
    let placed = bearing.placed.as_ref()?;
    Some((full_features(&placed.fix).to_vec(), bearing.answer.probability?))
}

fn see_quick(bearing: &Bearing, options: &Options) -> Option<(Vec<f64>, f64)> {
    let wavelength_m = options.channel.wavelength_m();
    let probability = quick_probability(&bearing.plane_wave, bearing.compensated, wavelength_m)?;
    Some((quick_features(&bearing.plane_wave, bearing.compensated, wavelength_m).to_vec(), probability))
}

fn report(what: &str, group: &str, names: &[&str], rows: &[LabelledBearing]) {
    let all: Vec<&LabelledBearing> = rows.iter().collect();
    let places: std::collections::BTreeSet<&str> = rows.iter().map(|row| row.place.as_str()).collect();
    let right = rows.iter().filter(|row| row.right).count();
    println!("{what}: {} bearings of {} places, {right} right", rows.len(), places.len());
    let Some(model) = LogisticModel::fit(&all) else { return println!("  too few to fit") };
    let in_use: Vec<f64> = rows.iter().map(|row| row.probability).collect();
    let fitted: Vec<f64> = rows.iter().map(|row| model.probability(&row.features)).collect();
    let constant = vec![right as f64 / rows.len() as f64; rows.len()];
    let line = |name: &str, found: csi5300_lab::fit_confidence::Calibration| {
        println!("  {name:34} Brier {:.3}, expected calibration error {:.3}", found.brier, found.expected_error);
    };
    line("share right, whatever the signal", calibration(&all, &constant));
    line("values in use", calibration(&all, &in_use));
    line("fit, on its own places", calibration(&all, &fitted));
    leave_one_place_out(rows).into_iter().for_each(|found| line("fit, leave one place out", found));
    println!("  {group} {{");
    println!("    base: {:.2}", model.base);
    names.iter().zip(&model.coefficients).for_each(|(name, value)| println!("    {name}: {value:.2}"));
    println!("  }}");
    for (i, name) in names.iter().enumerate() {
        let mut values: Vec<f64> = rows.iter().map(|row| row.features[i].exp()).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[(share * (values.len() - 1) as f64) as usize];
        println!("  exp(feature of {name}): least {:.3}, median {:.3}, most {:.3}", at(0.0), at(0.5), at(1.0));
    }
}
