//! Errors over the time driven: single stretches, what is carried from stretch to stretch, and the motion so far at once.
//!
//! `cargo run --release -p csi5300-lab --example over_time -- FOLDER.. [--drives N] [--out STEM]`
//!
//! FOLDERs have captures with their truth below them (`csi5300_lab::evaluate`); their motions are cut into halves, quarters and eighths,
//! by motion capture and by the tracking camera. `--own-share` tells instead how well probabilities agree with what happened for each value
//! of `track.own_share`: the one with the least Brier score over both and all cuts is the fit. `--drives` adds N simulated drives of a minute in rooms of either kind, in
//! stretches of four seconds. Expect the tables of docs/accuracy.md, "Over the time driven"; with `--out` also its picture.

use csi5300::internal::track::TrackSettings;
use csi5300::pipeline::Options;
use csi5300_lab::evaluate::{Capture, Errors, TrajectorySource, find};
use csi5300_lab::over_time::{Column, Drive, Report, gather, report};
use std::path::{Path, PathBuf};

/// Stretches of a capture's motion, and of a drive's.
const PARTS: [u32; 3] = [2, 4, 8];
const STRETCHES: u32 = 15;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut folders, mut drives, mut out, mut fit) = (Vec::new(), None, None, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--own-share" => fit = true,
            "--drives" => drives = Some(arguments.next().ok_or("--drives: how many?")?.parse::<u64>()?),
            "--out" => out = Some(PathBuf::from(arguments.next().ok_or("--out: which file, without its ending?")?)),
            folder => folders.push(PathBuf::from(folder)),
        }
    }
    // Each capture is evaluated on its own channel, whatever stands here.
    let mut options = Options::new("108".parse()?);
    options.accuracy = options.accuracy.with_paths(false);
    let captures = captures_below(&folders);
    if fit {
        fit_own_share(&captures, &options);
        return Ok(());
    }
    println!("absolute error, degrees: mean / median / share over 20 degrees\n");
    for source in [TrajectorySource::GroundTruth, TrajectorySource::T265] {
        for parts in PARTS {
            show(&format!("{}, {parts} parts", name(source)), &over_time(&captures, source, parts, &options));
        }
    }
    if let Some(count) = drives {
        let folder = std::env::temp_dir().join(format!("over-time-{}", std::process::id()));
        let written = csi5300_lab::rooms::write_drives(&folder, count, 1);
        let captures = captures_below(std::slice::from_ref(&folder));
        for source in [TrajectorySource::GroundTruth, TrajectorySource::Odometry] {
            // The simulated odometry is of the antenna, and its heading wanders by half a degree in a second.
            let options = options.clone().with_heading_sd_rad((source == TrajectorySource::Odometry).then_some(0.02));
            let report = over_time(&captures, source, STRETCHES, &options);
            show(&format!("simulated drives, {}, {STRETCHES} stretches of 4 s", name(source)), &report);
            if let Some(stem) = out.as_deref().filter(|_| source == TrajectorySource::Odometry) {
                draw(stem, &report)?;
            }
        }
        let _ = std::fs::remove_dir_all(&folder);
        written?;
    }
    Ok(())
}

fn captures_below(folders: &[PathBuf]) -> Vec<Capture> {
    let found = folders.iter().map(|folder| find(Path::new(folder)));
    found
        .flat_map(|(captures, unreadable)| {
            unreadable.iter().for_each(|line| eprintln!("{line}"));
            captures
        })
        .collect()
}

fn name(source: TrajectorySource) -> &'static str {
    match source {
        TrajectorySource::GroundTruth => "true trajectory",
        TrajectorySource::T265 => "tracking camera",
        TrajectorySource::RollingT265 => "tracking camera held to what wheels can roll",
        TrajectorySource::Odometry => "odometry",
    }
}

fn over_time(captures: &[Capture], source: TrajectorySource, stretches: u32, options: &Options) -> Report {
    let drives = gather(captures, source, stretches, options);
    let group = |drive: &Drive| if drive.set.contains("NLOS") { "NLOS".to_owned() } else { "LOS".to_owned() };
    report(&drives, &group, &|drive| TrackSettings::new(drive.heading_sd_rad))
}

/// Brier score and calibration error of what is carried, by the share that each stretch after the first adds.
fn fit_own_share(captures: &[Capture], options: &Options) {
    let sources = [TrajectorySource::GroundTruth, TrajectorySource::T265];
    let columns = sources.into_iter().flat_map(|source| PARTS.map(|parts| (source, parts)));
    let columns: Vec<(TrajectorySource, u32, Vec<Drive>)> =
        columns.map(|(source, parts)| (source, parts, gather(captures, source, parts, options))).collect();
    for tenths in 1..=10 {
        let own_share = f64::from(tenths) / 10.0;
        let judged = columns.iter().flat_map(|(source, parts, drives)| {
            let settings = |drive: &Drive| TrackSettings::new(drive.heading_sd_rad).with_own_share(own_share);
            let report = report(drives, &|_| "all".to_owned(), &settings);
            report.columns.into_iter().map(move |column| (*source, *parts, column))
        });
        let judged: Vec<_> = judged.collect();
        let mean = |of: fn(&Column) -> f64| judged.iter().map(|(.., own)| of(own)).sum::<f64>() / judged.len() as f64;
        let (brier, error) = (mean(|own| own.brier), mean(|own| own.expected_error));
        println!("own_share {own_share:.1}: Brier {brier:.4}, expected calibration error {error:.3}, on average of");
        for (source, parts, Column { said, right, brier, expected_error, .. }) in &judged {
            println!(
                "  {}, {parts} parts: said {said:.2}, right {right:.2}, Brier {brier:.4}, error {expected_error:.3}",
                name(*source)
            );
        }
    }
}

fn show(title: &str, report: &Report) {
    let line = |errors: &Errors| match errors.links {
        0 => "-".into(),
        _ => format!("{:.1} / {:.1}, {:.1} %", errors.mean_deg, errors.median_deg, 100.0 * errors.over_20),
    };
    for Column { group, links, points, said, right, expected_error, within, within_twice, .. } in &report.columns {
        println!("{title}, {group}, {links} links");
        println!("  after  single                  carried                 at once");
        for point in points {
            let [single, carried, at_once] = [&point.single, &point.carried, &point.at_once].map(line);
            println!("  {:5}  {single:22}  {carried:22}  {at_once}", point.stretches);
        }
        let [said, right, within, twice] = [said, right, within, within_twice].map(|share| 100.0 * share);
        println!(
            "  carried: within five degrees {said:.0} % said, {right:.0} % right, expected calibration error {expected_error:.3}; {within:.0} % within the error bar, {twice:.0} % within twice\n"
        );
    }
}

#[cfg(feature = "plot")]
fn draw(stem: &Path, report: &Report) -> Result<(), Box<dyn std::error::Error>> {
    use csi5300_lab::over_time::Point;
    use csi5300_lab::show::{Format, ScatterLines};
    let series = |column: &Column, kind: &str, of: fn(&Point) -> &Errors| {
        let points = column.points.iter().filter(|point| of(point).links > 0);
        let points = points.map(|point| (4.0 * f64::from(point.stretches), of(point).mean_deg)).collect();
        (format!("{}, {kind}", column.group), points)
    };
    let all = report.columns.iter().flat_map(|column| {
        [
            series(column, "single", |point| &point.single),
            series(column, "carried", |point| &point.carried),
            series(column, "all so far at once", |point| &point.at_once),
        ]
    });
    let picture = ScatterLines {
        title: "Simulated drives in rooms, by odometry".into(),
        x_label: "time driven (s)".into(),
        y_label: "mean bearing error (degrees)".into(),
        log_y: true,
        series: all.collect(),
        lines: true,
        ..ScatterLines::default()
    };
    for path in picture.write(stem, &Format::default())? {
        println!("{}", path.display());
    }
    Ok(())
}

#[cfg(not(feature = "plot"))]
fn draw(_: &Path, _: &Report) -> Result<(), Box<dyn std::error::Error>> {
    Err("--out needs the feature `plot`".into())
}
