//! What leaving steps out saves and what it costs: every scene of `csi5300_lab::skipping`, and captures below the folders
//! named, with every step, with what they need, and by a plane wave; the tables of docs/skipping.md, and with the feature
//! `plot` their picture.
//!
//! `cargo run --release -p csi5300-lab --example skipping -- [--out DIR] [CAPTURES ..]`

use csi5300::maths::{median, percentile};
use csi5300::pipeline::{Accuracy, Answer, Options, Sufficient};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find};
use csi5300_lab::skipping::{SkipScene, efforts, moved, scenes};
use nix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;

/// One scene or link: times and errors with every step, with what it needs, and by a plane wave.
struct Row {
    kind: String,
    name: String,
    /// Milliseconds of one core from logs to bearing; of a capture, none.
    ms: [Option<f64>; 3],
    /// Azimuth less the true one, degrees.
    error_deg: [f64; 3],
    /// What was needed.
    ran: &'static str,
    /// How far that moved the answer, in error bars.
    moved: f64,
    /// The error bar with every step, degrees.
    bar_deg: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (mut out, mut folders) = (PathBuf::from("."), Vec::new());
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--out" => out = arguments.next().map(PathBuf::from).ok_or("--out takes a folder")?,
            _ => folders.push(PathBuf::from(argument)),
        }
    }
    let options = Options::new("108".parse()?);
    let mut rows = Vec::new();
    for (number, scene) in scenes().iter().enumerate() {
        match row_of_scene(number, scene, &options) {
            Ok(row) => rows.push(row),
            Err(error) => eprintln!("scene {number} ({}): {error}", scene.kind),
        }
    }
    for folder in &folders {
        rows.extend(find(folder).0.iter().flat_map(|capture| rows_of_capture(capture, &options)));
    }
    by_kind(&rows);
    each(&rows);
    picture(&rows, &out)
}

/// Seconds of this thread's processor time.
fn clock_s() -> f64 {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(0.0, |t| t.tv_sec() as f64 + t.tv_nsec() as f64 * 1e-9)
}

fn ran(sufficient: Sufficient) -> &'static str {
    match sufficient {
        Sufficient::PlaneWave(_) | Sufficient::AllAsked | Sufficient::ErrorBar { .. } => "plane wave",
        Sufficient::OneWave(_) => "one wave",
        _ => "everything",
    }
}

fn row_of_scene(number: usize, scene: &SkipScene, options: &Options) -> Result<Row, Box<dyn Error>> {
    let recording = scene.ends.record()?;
    let (mut ms, mut made) = ([None; 3], Vec::new());
    for (accuracy, ms) in efforts().into_iter().zip(&mut ms) {
        let options = options.clone().with_accuracy(accuracy);
        let mut quickest = f64::INFINITY;
        for _ in 0..3 {
            let start_s = clock_s();
            let bearing = recording.bearing(&options)?;
            quickest = quickest.min((clock_s() - start_s) * 1e3);
            made.push(bearing);
        }
        *ms = Some(quickest);
    }
    let [everything, needed, plane_wave] = [&made[0], &made[3], &made[6]];
    let error_deg = [everything, needed, plane_wave].map(|bearing| {
        let direct = recording.judge(bearing).azimuth_error_deg;
        let folded = bearing
            .answer
            .mirror_rad
            .map(|mirror| csi5300::maths::wrap_rad(mirror - bearing.answer.azimuth_rad).to_degrees() + direct);
        folded.map(|f| (f + 540.0).rem_euclid(360.0) - 180.0).filter(|f| f.abs() < direct.abs()).unwrap_or(direct)
    });
    Ok(Row {
        kind: scene.kind.into(),
        name: format!("{number}"),
        ms,
        error_deg,
        ran: ran(needed.sufficient),
        moved: moved(everything, needed),
        bar_deg: everything.answer.azimuth_sd_rad.to_degrees(),
    })
}

fn rows_of_capture(capture: &Capture, options: &Options) -> Vec<Row> {
    let run = |accuracy: Accuracy| {
        let mut what = Vec::new();
        let options = options.clone().with_accuracy(accuracy);
        let look = &mut |_: &str, bearing: &csi5300::pipeline::Bearing, _: &Options| what.push(bearing.sufficient);
        let whole = csi5300_lab::evaluate::Part::WHOLE;
        let rows = capture.evaluate_part(TrajectorySource::GroundTruth, None, &options, whole, look).rows;
        (rows, what)
    };
    let [everything, needed, plane_wave] = efforts().map(run);
    let mut found = Vec::new();
    let with = everything.0.iter().zip(&needed.0).zip(&plane_wave.0);
    for (((all, own), plane), sufficient) in with.zip(&needed.1) {
        let [Some(a), Some(b), Some(c)] = [all, own, plane].map(|row| row.error_from_mean_pose_deg) else { continue };
        let bar = |answer: &Answer| answer.azimuth_sd_deg.unwrap_or(f64::INFINITY);
        found.push(Row {
            kind: all.set().to_owned(),
            name: all.answer.link.clone(),
            ms: [None; 3],
            error_deg: [a, b, c],
            ran: ran(*sufficient),
            moved: (a - b).abs() / bar(&all.answer).min(bar(&own.answer)),
            bar_deg: bar(&all.answer),
        });
    }
    found
}

/// Median and 90th percentile.
fn two(values: impl Iterator<Item = f64>) -> String {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let Some(middle) = median(&mut values.clone()) else { return "-".into() };
    format!("{middle:.2} / {:.2}", percentile(&values, 0.9))
}

fn by_kind(rows: &[Row]) {
    println!(
        "| kind | scenes | plane wave, one wave, everything | ms: everything | needed | plane wave | error: everything | needed | plane wave | most moved, error bars |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut kinds: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    rows.iter().for_each(|row| kinds.entry(&row.kind).or_default().push(row));
    let simulated: Vec<&Row> = rows.iter().filter(|row| row.ms[0].is_some()).collect();
    for (kind, own) in kinds.iter().map(|(kind, own)| (*kind, own)).chain([("all simulated", &simulated)]) {
        let ms = |k: usize| two(own.iter().filter_map(|row| row.ms[k]));
        let error = |k: usize| two(own.iter().map(|row| row.error_deg[k].abs()));
        let count = |ran: &str| own.iter().filter(|row| row.ran == ran).count();
        println!(
            "| {kind} | {} | {}, {}, {} | {} | {} | {} | {} | {} | {} | {:.3} |",
            own.len(),
            count("plane wave"),
            count("one wave"),
            count("everything"),
            ms(0),
            ms(1),
            ms(2),
            error(0),
            error(1),
            error(2),
            own.iter().map(|row| row.moved).fold(0.0, f64::max),
        );
    }
}

fn each(rows: &[Row]) {
    println!(
        "\n| kind | scene | what ran | ms: everything, needed, plane wave | error, degrees: everything, needed, plane wave | error bar | moved, error bars |"
    );
    println!("|---|---|---|---|---|---|---|");
    for row in rows {
        let [a, b, c] = row.ms.map(|ms| ms.map_or("-".into(), |ms| format!("{ms:.2}")));
        let [x, y, z] = row.error_deg;
        println!(
            "| {} | {} | {} | {a}, {b}, {c} | {x:.3}, {y:.3}, {z:.3} | {:.2} | {:.3} |",
            row.kind, row.name, row.ran, row.bar_deg, row.moved
        );
    }
}

/// Run time against error of every simulated scene, in the three ways.
#[cfg(feature = "plot")]
fn picture(rows: &[Row], out: &std::path::Path) -> Result<(), Box<dyn Error>> {
    use csi5300_lab::show::{Format, ScatterLines};
    let points = |k: usize| {
        let timed = rows.iter().filter_map(|row| Some((row.ms[k]?, row.error_deg[k].abs().max(1e-3))));
        timed.collect::<Vec<(f64, f64)>>()
    };
    let names = ["every step", "what the scene needs", "plane wave"];
    let picture = ScatterLines {
        title: "Run time and error of one link".into(),
        x_label: "from logs to bearing, ms of one core".into(),
        y_label: "azimuth error, degrees".into(),
        log_x: true,
        log_y: true,
        series: names.iter().enumerate().map(|(k, name)| ((*name).to_owned(), points(k))).collect(),
        lines: false,
    };
    for path in picture.write(&out.join("skipping"), &Format::default())? {
        eprintln!("{}", path.display());
    }
    Ok(())
}

#[cfg(not(feature = "plot"))]
fn picture(_: &[Row], _: &std::path::Path) -> Result<(), Box<dyn Error>> {
    Ok(())
}
