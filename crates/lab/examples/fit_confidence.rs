//! Fits the models of `src/place/confidence.rs` (probabilities and error bars) to captures with known truth, and tells how
//! they do on places that they were not fitted to.
//!
//! `cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES [ROOMS]`
//!
//! Expect the coefficients as they stand in `src/tuning/values.rs`. ROOMS simulated rooms of either kind take part if
//! given; a room weighs as much as a place of the captures. `csi5300 evaluate --folds places` prints the calibration of the
//! same fits, each place left out in turn.

use csi5300::pipeline::Options;
use csi5300_lab::evaluate::find;
use csi5300_lab::fit_confidence::{LabelledBearing, LogisticModel, calibration, leave_one_place_out};
use csi5300_lab::fit_error_bar::{ErrorBarModel, ErrorRow};
use csi5300_lab::folds::{FoldRow, Kind, error_rows, gather, labelled};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let root = arguments.next().ok_or("which folder? one with captures below it, as in the WSR data set")?;
    let (mut captures, unreadable) = find(Path::new(&root));
    unreadable.iter().for_each(|line| eprintln!("{line}"));
    let folder = std::env::temp_dir().join(format!("fit-confidence-{}", std::process::id()));
    if let Some(count) = arguments.next() {
        csi5300_lab::rooms::write(&folder, count.parse()?, 1)?;
        captures.extend(find(&folder).0);
    }
    // Each capture is evaluated on its own channel, whatever stands here.
    let rows = gather(&captures, &Options::new("108".parse()?));
    let _ = std::fs::remove_dir_all(&folder);
    let full = ["per_spread", "per_views", "per_heading"];
    let quick = ["per_coherence", "per_ratio", "per_aperture", "compensated", "per_heading"];
    probability("full_probability", &full, &rows, Kind::Full);
    probability("quick_probability", &quick, &rows, Kind::Quick);
    error_bar("full_error_bar", &full, &rows, Kind::Full);
    error_bar("quick_error_bar", &quick, &rows, Kind::Quick);
    Ok(())
}

fn probability(group: &str, names: &[&str], rows: &[FoldRow], kind: Kind) {
    let rows = labelled(rows, kind);
    let all: Vec<&LabelledBearing> = rows.iter().collect();
    let right = rows.iter().filter(|row| row.right).count();
    println!("{group}: {} bearings, {right} right", rows.len());
    let Some(model) = LogisticModel::fit(&all) else { return println!("  too few to fit") };
    let fitted: Vec<f64> = rows.iter().map(|row| model.probability(&row.features)).collect();
    let constant = vec![right as f64 / rows.len() as f64; rows.len()];
    let line = |name: &str, found: csi5300_lab::fit_confidence::Calibration| {
        println!("  {name:34} Brier {:.3}, expected calibration error {:.3}", found.brier, found.expected_error);
    };
    line("share right, whatever the signal", calibration(&all, &constant));
    line("fit, on its own places", calibration(&all, &fitted));
    leave_one_place_out(&rows).into_iter().for_each(|found| line("fit, leave one place out", found));
    print_model(model.base, names, &model.coefficients);
    for (i, name) in names.iter().enumerate() {
        let mut values: Vec<f64> = rows.iter().map(|row| row.features[i].exp()).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[(share * (values.len() - 1) as f64) as usize];
        println!("  exp(feature of {name}): least {:.3}, median {:.3}, most {:.3}", at(0.0), at(0.5), at(1.0));
    }
}

fn error_bar(group: &str, names: &[&str], rows: &[FoldRow], kind: Kind) {
    let rows = error_rows(rows, kind);
    println!("{group}: {} bearings", rows.len());
    match ErrorBarModel::fit(&rows.iter().collect::<Vec<&ErrorRow>>()) {
        Some(model) => print_model(model.base, names, &model.coefficients),
        None => println!("  too few to fit"),
    }
}

fn print_model(base: f64, names: &[&str], coefficients: &[f64]) {
    println!("  base: {base:.2}");
    names.iter().zip(coefficients).for_each(|(name, value)| println!("  {name}: {value:.2}"));
}
