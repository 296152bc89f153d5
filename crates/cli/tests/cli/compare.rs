//! Scenes fitted to captures: simulated and recorded figures agree.

use crate::commands::Folder;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::replay::Replay;
use csi5300_lab::compare::Allowed;
use csi5300_lab::compare::fit::Known;
use csi5300_lab::compare::{FigureRow, Figures, Fitted, Verdict, fit, measure, measure_scene, rows};
use csi5300_sim::{Scene, scene::Driver};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

fn options() -> Options {
    Options::new(Channel::new(108, Width::Ht20).unwrap())
}

/// A figure that a fitted scene may miss: whose, which, and by how many times what is allowed at most.
type Missed = (&'static str, &'static str, f64);

/// A figure at the edge of what is allowed: how it rounds decides.
const EDGE: f64 = 1.05;

/// The seeds that judge a fit, none of them the one that it was made with.
const SEEDS: [u64; 2] = [2, 3];

/// Figures that scenes fitted to the captures of \[paper\] miss; see docs/guides/simulation.md.
const MISSED: [Missed; 3] = [
    // At the edge of what is allowed: 9,994 us recorded, up to 10,005 simulated; 9,669 us recorded, 9,568 simulated.
    ("receiver", "interval, host, median", 1.15),
    ("receiver", "interval, host, 1 %", EDGE),
    // Real cores have corners, and where a quarter of the answers is away from the core the seed decides on which side
    // of its edge the quartile falls.
    ("link", "turn-around, quartile range", 6.5),
];

/// By how many times what is allowed a figure is missed.
fn ratio(row: &FigureRow) -> f64 {
    let (Some(recorded), Some(simulated)) = (row.recorded, row.simulated) else { return f64::INFINITY };
    let allowed = match row.allowed {
        Allowed::Nothing => 0.0,
        Allowed::By(by) => by,
        Allowed::Share(share) => share * recorded.abs(),
        Allowed::Anything => f64::INFINITY,
    };
    (simulated - recorded).abs() / allowed
}

/// What differs beyond what may be missed, a line each. What is missed as it may be is noted in `seen`.
fn differences(
    name: &str,
    table: &[FigureRow],
    missed: &[Missed],
    seen: &mut BTreeSet<(&'static str, String)>,
) -> String {
    let mut text = String::new();
    for row in table.iter().filter(|row| row.verdict == Verdict::Differs) {
        let ratio = ratio(row);
        seen.insert((row.of, row.name.clone()));
        let known = missed.iter().any(|(of, figure, most)| (*of, *figure) == (row.of, &row.name) && ratio <= *most);
        if !known {
            let (recorded, simulated) = (row.recorded, row.simulated);
            let _ = writeln!(text, "{name}: {}, {}: {recorded:?}, {simulated:?}: {ratio:.2} times", row.of, row.name);
        }
    }
    text
}

/// Checks tables against what may be missed, and that nothing may be missed that is not.
fn check(tables: &[(String, Vec<FigureRow>)], missed: &[Missed]) {
    let mut seen = BTreeSet::new();
    let differences: String = tables.iter().map(|(name, table)| differences(name, table, missed, &mut seen)).collect();
    assert!(differences.is_empty(), "\n{differences}");
    let is_never = |(of, figure, most): &&Missed| *most > EDGE && !seen.contains(&(*of, (*figure).to_owned()));
    let never: Vec<_> = missed.iter().filter(is_never).collect();
    assert!(never.is_empty(), "these agree, and need not be missed: {never:?}");
}

/// The figures of a fitted scene, and of the same scene with further seeds, along the recorded trajectory.
fn judged(
    name: &str,
    recorded: &Figures,
    fitted: &Fitted,
    trajectory: &Trajectory,
    options: &Options,
) -> Vec<(String, Vec<FigureRow>)> {
    assert_eq!(fitted.scene.seed, SEEDS[0]);
    let table = |seed: u64| {
        let scene = Scene { seed, ..fitted.scene.clone() };
        let figures = measure_scene(&scene, Some(trajectory), options).unwrap();
        (format!("{name}, seed {seed}"), rows(recorded, &figures))
    };
    SEEDS.map(table).into()
}

#[test]
fn scenes_fitted_to_the_papers_captures_agree_with_them() {
    let Some(captures) = crate::common::captures() else { return };
    let names = [
        ("circle", ["real_10cm_1", "real_20cm_2", "real_30cm_2"]),
        ("line", ["real_10cm_2", "real_20cm_1", "real_30cm_3"]),
    ];
    let mut tables = Vec::new();
    for (shape, name) in names.iter().flat_map(|(shape, names)| names.iter().map(move |name| (shape, name))) {
        let folder = captures.join("paper").join(shape);
        let log = |side: &str| Replay::open(&folder.join(format!("csi_{side}_{name}.dat"))).unwrap();
        let path = folder.join(format!("rx_movement_{name}.csv"));
        let (trajectory, _) = csv::read(&path, None).unwrap();
        let mut recorded = measure(&mut log("rx"), &mut log("tx"), &trajectory, None, &options()).unwrap();
        recorded.link.place_m = Some([-3.18, 1.11, 0.27]);
        let known =
            Known { trajectory: &trajectory, file: &std::fs::canonicalize(&path).unwrap(), folder: Path::new("") };
        let fitted = fit(&recorded, &known, &options()).unwrap();
        tables.extend(judged(&format!("{shape} {name}"), &recorded, &fitted, &trajectory, &options()));
    }
    check(&tables, &MISSED);
}

/// What came of fitting a scene to a simulated recording.
struct Refitted {
    recorded: Figures,
    fitted: Fitted,
    tables: Vec<(String, Vec<FigureRow>)>,
}

/// Simulates a scene as a recording, and fits a scene to it; with the transmitter's place given or not.
fn refitted(scene: &Scene, name: &str, told: bool, options: &Options) -> Refitted {
    let folder = Folder::new(&format!("compare-{name}"));
    let mut recorded = measure_scene(scene, None, options).unwrap();
    if told {
        recorded.link.place_m = Some(scene.robot[1].position_m);
    }
    let trajectory = path_of(scene);
    folder.write("t.csv", trajectory.poses().iter().map(csv::line).collect::<String>().as_bytes());
    let known = Known { folder: &folder.0, ..only(&trajectory) };
    let fitted = fit(&recorded, &known, options).unwrap();
    let tables = judged(name, &recorded, &fitted, &trajectory, options);
    Refitted { recorded, fitted, tables }
}

/// Known is only the receiver's path.
fn only(trajectory: &Trajectory) -> Known<'_> {
    Known { trajectory, file: Path::new("t.csv"), folder: Path::new("") }
}

fn path_of(scene: &Scene) -> Trajectory {
    let room = csi5300_sim::Room::new(scene).unwrap();
    csi5300_lab::compare::figures::true_path(&room, 0).unwrap()
}

/// The built-in scene of a lab with real cards, for so long.
fn lab(duration_s: f64) -> Scene {
    Scene { duration_s, ..Scene::built_in("lab-circle").unwrap() }
}

#[test]
fn a_fit_finds_a_simulated_scene_again() {
    let Refitted { recorded, tables, .. } = refitted(&lab(29.0), "again", true, &options());
    check(&tables, &[]);
    let df_hz = recorded.link.df_hz.unwrap();
    assert!((df_hz + 3.0 * 5_540.0).abs() < 400.0, "3 ppm of 5.54 GHz, not {df_hz}");
    let late = recorded.link.groups[0];
    // The scene says 8 % early by 110 +- 45 us; those within 25 us count to the core, those beyond 160 to the next.
    assert!((0.045..0.085).contains(&late.share) && (-125.0..-95.0).contains(&late.mean_us), "{late:?}");
}

#[test]
fn a_fit_finds_the_stock_layout_again() {
    let scene = Scene { driver: Driver::Stock, ..lab(15.0) };
    let Refitted { recorded, fitted, tables } = refitted(&scene, "stock", true, &options());
    assert_eq!((recorded.receiver.stock, fitted.scene.driver), (recorded.receiver.records, Driver::Stock));
    check(&tables, &[]);
    // A record of a frame that the driver copied before it: no MAC, no number, no time in it, and so 18 bytes less.
    assert_eq!(recorded.receiver.lengths.keys().copied().collect::<Vec<_>>(), [215]);
}

#[test]
fn a_fit_finds_40_mhz_again() {
    // The scene's channel is the centre of the 40 MHz, the program's the primary one.
    let scene = Scene { bandwidth_mhz: 40, channel: 110, ..lab(15.0) };
    let wide = Options::new(Channel::new(108, Width::Ht40Plus).unwrap());
    let Refitted { recorded, fitted, tables } = refitted(&scene, "wide", true, &wide);
    assert_eq!((fitted.scene.bandwidth_mhz, fitted.scene.channel), (40, 110));
    assert_eq!(recorded.receiver.rates.keys().copied().collect::<Vec<_>>(), [0x900]);
    check(&tables, &[]);
    let error = fit(&recorded, &only(&path_of(&scene)), &options()).unwrap_err();
    assert!(error.to_string().contains("the records are 40 MHz wide"), "{error}");
}

#[test]
fn a_fit_finds_the_transmitter_where_nobody_says_where_it_is() {
    let scene = lab(29.0);
    let Refitted { recorded, fitted, tables } = refitted(&scene, "found", false, &options());
    check(&tables, &[]);
    let [x, y, _] = fitted.scene.robot[1].position_m;
    let middle = csi5300_sim::Room::new(&scene).unwrap().antenna(0, 14.0).unwrap();
    let azimuth_deg = (y - middle.y).atan2(x - middle.x).to_degrees();
    let [tx, ty, _] = scene.robot[1].position_m;
    let truth_deg = (ty - middle.y).atan2(tx - middle.x).to_degrees();
    // The place is that of the found bearing, from a middle within the circle.
    assert!((azimuth_deg - truth_deg).abs() < 5.0, "{azimuth_deg} of {truth_deg}");
    let again = measure_scene(&fitted.scene, Some(&path_of(&scene)), &options()).unwrap();
    assert!((again.link.azimuth_deg.unwrap() - recorded.link.azimuth_deg.unwrap()).abs() < 0.5);
    // Without motion nothing tells a place.
    let mut still = scene;
    still.robot[0].motion = csi5300_sim::motion::RobotMotion::Static;
    still.duration_s = 5.0;
    let recorded = measure_scene(&still, None, &options()).unwrap();
    let error = fit(&recorded, &only(&path_of(&still)), &options()).unwrap_err();
    assert!(error.to_string().contains("without motion it cannot be found"), "{error}");
}

#[test]
fn turn_arounds_without_jitter_show_no_carrier_offset_and_are_equal_in_every_draw() {
    let measured = |seed| {
        let mut scene = Scene { seed, ..lab(6.0) };
        (scene.radio.turn_around, scene.radio.send_jitter_us) = Default::default();
        measure_scene(&scene, None, &options()).unwrap()
    };
    let figures = [1, 2, 3].map(measured);
    for other in &figures {
        let table = rows(&figures[0], other);
        let differing: Vec<_> =
            table.iter().filter(|row| row.of == "link" && row.verdict == Verdict::Differs).collect();
        assert!(differing.is_empty() && other.link.df_hz.is_none(), "{:?} {differing:?}", other.link.df_hz);
        assert!(other.link.turn_around_us.q3 - other.link.turn_around_us.q1 < 2.0, "{:?}", other.link.turn_around_us);
    }
}

#[test]
fn figures_of_different_scenes_differ() {
    let measured = |name: &str| {
        let mut scene = Scene::built_in(name).unwrap();
        scene.duration_s = 6.0;
        measure_scene(&scene, None, &options()).unwrap()
    };
    let table = rows(&measured("lab-circle"), &measured("paper-circle"));
    let differs = |name: &str| table.iter().any(|row| row.name == name && row.verdict == Verdict::Differs);
    for name in ["phase spread before compensation", "AGC, mean", "level C", "slope of the phase"] {
        assert!(differs(name), "{name}");
    }
    assert!(!differs("record length, highest") && !differs("rate_n_flags, total variation distance"));
}

#[test]
fn compare_neither_overwrites_what_it_reads_nor_removes_what_is_there() {
    let folder = Folder::new("compare-outputs");
    std::fs::create_dir_all(folder.0.join("simulated")).unwrap();
    let names = ["rx.dat", "tx.dat", "fitted-trajectory.csv", "trajectory.csv", "scene.toml", "simulated/kept.csv"];
    for name in names {
        folder.write(name, name.as_bytes());
    }
    let paper = crate::common::root().join("scenes/paper-circle.toml");
    let paper = paper.to_str().unwrap();
    let refused: [(&[&str], &str, &str); 5] = [
        (&["trajectory.csv"], "108", "already exists: --force"),
        (&["fitted-trajectory.csv", "--force"], "108", "fitted-trajectory.csv is an input"),
        (&["simulated/kept.csv", "--force"], "108", "is an input inside"),
        (&["trajectory.csv", paper], "108", "simulated already exists"),
        (&["trajectory.csv", paper, "--force"], "36", "not of --channel 36"),
    ];
    for (more, channel, words) in refused {
        let usual =
            ["simulate", "--rx", "rx.dat", "--tx", "tx.dat", "--out", ".", "--channel", channel, "--trajectory"];
        folder.says(&[&usual, more].concat(), 1, &[words]);
    }
    for name in names {
        assert_eq!(std::fs::read_to_string(folder.0.join(name)).unwrap(), name);
    }
}
