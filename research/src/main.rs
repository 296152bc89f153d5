//! Measurements for choosing the estimator: README.md.

mod bootstrap;
mod rooms;

use csi5300::pipeline::{Accuracy, Effort, Options};
use csi5300_lab::evaluate::{Capture, Errors, Judged, TrajectorySource, find};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn Error>>;

/// Trajectories that need no knowledge of the robot.
const SOURCES: [TrajectorySource; 2] = [TrajectorySource::GroundTruth, TrajectorySource::T265];
/// Parts into which a motion is cut.
const PARTS: u32 = 4;

fn main() -> Fallible<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = args.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["folds", folders @ ..] => folds(&captures(folders)?),
        ["designs", folders @ ..] => designs(&captures(folders)?),
        ["over-time", folders @ ..] => over_time(&captures(folders)?),
        ["skipping", folders @ ..] => skipping(&captures(folders)?),
        ["rooms", out, count] => rooms::write(Path::new(out), count.parse()?, 1).map_err(Into::into),
        ["drives", out, count] => rooms::write_drives(Path::new(out), count.parse()?, 1).map_err(Into::into),
        _ => Err("usage: folds DIR.. | designs DIR.. | over-time DIR.. | skipping DIR.. | rooms OUT COUNT | drives OUT COUNT".into()),
    }
}

/// All captures with a truth below the folders.
fn captures(folders: &[&str]) -> Fallible<Vec<Capture>> {
    let mut all = Vec::new();
    for folder in folders {
        let (found, unreadable) = find(Path::new(folder));
        unreadable.iter().for_each(|words| eprintln!("{words}"));
        all.extend(found);
    }
    if all.is_empty() { Err("no capture with a truth there".into()) } else { Ok(all) }
}

/// The usual options; the channel is a placeholder, because each capture names its own.
fn options() -> Fallible<Options> {
    Ok(Options::new("108".parse()?))
}

/// Rows of all captures.
fn evaluate(captures: &[Capture], source: TrajectorySource, options: &Options) -> Vec<(String, Judged)> {
    let of = |capture: &Capture| {
        let rows = capture.evaluate(source, None, options).rows;
        rows.into_iter().map(|row| (place(&capture.place), row)).collect::<Vec<_>>()
    };
    captures.par_iter().flat_map_iter(of).collect()
}

/// The captures, each with the parts `parts` of its motion, which is cut into [`PARTS`] equally long ones. A capture whose
/// trajectory cannot be read, or does not move, stays whole.
fn cut(captures: &[Capture], source: TrajectorySource, parts: std::ops::Range<u32>) -> Vec<Capture> {
    let part = |capture: &Capture| {
        let (start_s, end_s) = capture.path(source).ok()?.motion().window_s?;
        let edge_s = |part: u32| start_s + (end_s - start_s) * f64::from(part) / f64::from(PARTS);
        Some((edge_s(parts.start), edge_s(parts.end)))
    };
    captures.iter().map(|capture| Capture { within_s: part(capture), ..capture.clone() }).collect()
}

/// The last two folders of a capture's path: a set, and a place of it.
fn place(path: &str) -> String {
    let folders: Vec<&str> = path.rsplit('/').take(2).collect();
    folders.into_iter().rev().collect::<Vec<_>>().join("/")
}

fn set(place: &str) -> &str {
    place.split('/').next().unwrap_or_default()
}

/// Errors of each set with each trajectory, with intervals.
fn folds(captures: &[Capture]) -> Fallible<()> {
    let options = options()?;
    println!("absolute error, degrees, with 95 % intervals by resampled places");
    for source in SOURCES {
        let mut sets: BTreeMap<String, BTreeMap<String, Vec<f64>>> = BTreeMap::new();
        let mut failed = 0;
        for (place, row) in evaluate(captures, source, &options) {
            match row.error_from_mean_pose_deg {
                Some(error) => sets.entry(set(&place).into()).or_default().entry(place).or_default().push(error),
                None => failed += 1,
            }
        }
        for (set, places) in sets {
            let places: Vec<Vec<f64>> = places.into_values().collect();
            let errors = Errors::of(places.iter().flatten().copied());
            let [mean, median, p90, over] = bootstrap::intervals(&places);
            println!(
                "{source}, {set}: {} places, {} links; mean {:.2} ({mean}), median {:.2} ({median}), 90 % {:.2} ({p90}), over 20 degrees {:.3} ({over})",
                places.len(),
                errors.links,
                errors.mean_deg,
                errors.median_deg,
                errors.p90_deg,
                errors.over_20
            );
        }
        println!("{source}: {failed} links without an answer");
    }
    Ok(())
}

/// Designs of the estimate that options can select.
fn named_designs(usual: Accuracy) -> Vec<(&'static str, Accuracy)> {
    let with = |change: fn(&mut Accuracy)| {
        let mut own = usual;
        change(&mut own);
        own
    };
    vec![
        ("usual", usual),
        ("everything in every scene", Accuracy { effort: Effort::Everything, ..usual }),
        ("right to three degrees", Accuracy { effort: Effort::Within(3f64.to_radians()), ..usual }),
        ("without alignment", with(|own| own.align = false)),
        ("without the one-way channel", with(|own| own.one_way = false)),
        ("without alignment and one-way channel", with(|own| (own.align, own.one_way) = (false, false))),
        ("plane waves", Accuracy { near_field: false, ..usual }),
        ("horizon alone", Accuracy { elevation_max_rad: Some(0.0), ..usual }),
        ("elevations to 10 degrees", Accuracy { elevation_max_rad: Some(10f64.to_radians()), ..usual }),
        ("elevations to 40 degrees", Accuracy { elevation_max_rad: Some(40f64.to_radians()), ..usual }),
        ("no nearer than 0.9 m", Accuracy { range_min_m: Some(0.9), ..usual }),
        ("no nearer than 3.6 m", Accuracy { range_min_m: Some(3.6), ..usual }),
        ("plane waves, horizon alone", Accuracy { near_field: false, elevation_max_rad: Some(0.0), ..usual }),
    ]
}

/// Run time and error of each design, and the difference to the usual one on the same links with 95 % intervals from resampled places.
/// Time is for one thread and includes reading the files.
fn designs(captures: &[Capture]) -> Fallible<()> {
    let usual = options()?;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut drawn: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
    for source in SOURCES {
        println!("\n{source}: mean / median / over 20 degrees; more than usual (95 %)");
        let mut first: Option<Vec<(String, Judged)>> = None;
        for (name, accuracy) in named_designs(usual.accuracy) {
            let own = Options { accuracy, ..usual.clone() };
            let run = || one.install(|| evaluate(captures, source, &own));
            // The first run fills the file cache.
            let rows = run();
            let began = Instant::now();
            run();
            let ms = 1e3 * began.elapsed().as_secs_f64() / rows.len().max(1) as f64;
            let against = first.get_or_insert_with(|| rows.clone());
            println!("{name}: {ms:.2} ms a link");
            for (set, places) in paired(against, &rows) {
                let all = Errors::of(places.iter().flatten().map(|pair| pair.1));
                drawn.entry(format!("{source}, {set}")).or_default().push((ms, all.mean_deg));
                let [mean, median, over] = bootstrap::difference(places.iter().flatten().copied());
                let [mean_in, median_in, over_in] = bootstrap::differences(&places);
                println!(
                    "  {set}: {:.2} / {:.2} / {:.3}; {mean:+.2} ({mean_in}), {median:+.2} ({median_in}), {over:+.3} ({over_in})",
                    all.mean_deg, all.median_deg, all.over_20
                );
            }
        }
    }
    draw(drawn)
}

/// Writes run time against mean error, a point for each design, to `designs.png`.
fn draw(sets: BTreeMap<String, Vec<(f64, f64)>>) -> Fallible<()> {
    use kuva::prelude::*;
    let colours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
    let one = |((set, points), colour): ((String, Vec<(f64, f64)>), &&str)| {
        ScatterPlot::new().with_data(points).with_color(*colour).with_size(4.0).with_legend(set).into()
    };
    let plots: Vec<Plot> = sets.into_iter().zip(colours.iter().cycle()).map(one).collect();
    let layout = Layout::auto_from_plots(&plots).with_title("Designs of the estimate").with_log_scale();
    let layout = layout.with_x_label("time of a link, reading included (ms)").with_y_label("mean error (degrees)");
    std::fs::write("designs.png", kuva::render_to_png(plots, layout, 2.0)?)?;
    Ok(())
}

/// Errors of two designs on the links that both answered, by set and place.
fn paired(first: &[(String, Judged)], second: &[(String, Judged)]) -> BTreeMap<String, Vec<Vec<(f64, f64)>>> {
    let mut sets: BTreeMap<String, BTreeMap<String, Vec<(f64, f64)>>> = BTreeMap::new();
    for ((place, a), (_, b)) in first.iter().zip(second) {
        if let (Some(a), Some(b)) = (a.error_from_mean_pose_deg, b.error_from_mean_pose_deg) {
            let own = sets.entry(set(place).into()).or_default();
            own.entry(place.clone()).or_default().push((a.abs(), b.abs()));
        }
    }
    sets.into_iter().map(|(set, places)| (set, places.into_values().collect())).collect()
}

/// Errors of each quarter of the motions, and of the whole motion up to its end.
fn over_time(captures: &[Capture]) -> Fallible<()> {
    let options = options()?;
    for source in SOURCES {
        for part in 0..PARTS {
            let errors = |parts| {
                let rows = evaluate(&cut(captures, source, parts), source, &options);
                Errors::of(rows.iter().filter_map(|(_, row)| row.error_from_mean_pose_deg))
            };
            let (alone, so_far) = (errors(part..part + 1), errors(0..part + 1));
            println!(
                "{source}, quarter {}: alone {:.2} / {:.2} of {} links, with those before {:.2} / {:.2} of {} (mean / median, degrees)",
                part + 1,
                alone.mean_deg,
                alone.median_deg,
                alone.links,
                so_far.mean_deg,
                so_far.median_deg,
                so_far.links
            );
        }
    }
    Ok(())
}

/// Change of the answers, and time saved, if unneeded steps are skipped.
fn skipping(captures: &[Capture]) -> Fallible<()> {
    let run = |effort: Effort| -> Fallible<(f64, Vec<(String, Judged)>)> {
        let mut options = options()?;
        options.accuracy.effort = effort;
        let began = Instant::now();
        let rows = evaluate(captures, TrajectorySource::GroundTruth, &options);
        Ok((began.elapsed().as_secs_f64(), rows))
    };
    let ((all_s, everything), (needed_s, needed)) = (run(Effort::Everything)?, run(Effort::Needed)?);
    let pairs =
        everything.iter().zip(&needed).filter_map(|(a, b)| Some((a.1.answer.azimuth_deg?, b.1.answer.azimuth_deg?)));
    let moved: Vec<f64> = pairs.map(|(a, b)| (b - a + 180.0).rem_euclid(360.0) - 180.0).collect();
    let most = moved.iter().fold(0.0_f64, |most, deg| most.max(deg.abs()));
    println!(
        "{} links: every step {all_s:.2} s, what is needed {needed_s:.2} s; moved by {most:.3} degrees at most",
        moved.len()
    );
    Ok(())
}
