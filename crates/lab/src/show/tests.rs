use super::*;
use std::path::Path;

fn folder(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("csi5300-plot-{}-{name}", std::process::id()))
}

fn check(paths: &[PathBuf]) {
    let [png, svg] = paths else { panic!("two files expected, {paths:?}") };
    let bytes = std::fs::read(png).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    assert_eq!(u32::from_be_bytes(bytes[16..20].try_into().unwrap()), 1200, "width in IHDR");
    let text = std::fs::read_to_string(svg).unwrap();
    assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
    // What is cut off is cut off there too: every region that is used is defined.
    for name in text.split("url(#").skip(1).filter_map(|rest| rest.split(')').next()) {
        assert!(text.contains(&format!("id=\"{name}\"")), "{name} is not defined");
    }
    assert!(text.contains("width=\"1200\"") && !text.contains("NaN") && !text.contains("inf"));
}

/// Three pictures out of values with NaN and infinity among them, which are left out.
#[test]
fn draws_around_values_that_are_not_finite() {
    let at = folder("finite");
    let t_s = vec![0.0, 1.0, f64::NAN, 3.0];
    let capture = PhaseTrack {
        label: "a<b & $c".into(),
        t_s: t_s.clone(),
        before_rad: vec![1.0, f64::INFINITY, 2.0, 9.0],
        after_rad: t_s,
        left: vec![(0.0, f64::NAN), (1.0, 4.0)],
        ..PhaseTrack::default()
    };
    check(
        &PhasePlot { title: "t".into(), before: String::new(), other: Some(capture.clone()), capture }
            .write(&at.join("phase"))
            .unwrap(),
    );
    let path_m = vec![[0.0, 0.0], [f64::NAN, 1.0], [1.0, 1.0]];
    let plot = TrajectoryPlot { path_m, azimuth_rad: f64::NAN, sd_rad: Some(0.1), ..Default::default() };
    check(&plot.write(&at.join("path.v1")).unwrap());
    assert!(at.join("path.v1.png").exists(), "a dot in the stem is kept");
    let map = ProfileMap { n_az: 2, n_el: 2, value: vec![0.0, f64::NAN, 1.0, -1.0], ..Default::default() };
    check(&map.write(&at.join("map")).unwrap());
    let chosen_from = ("s".into(), vec![0.0, 90.0], vec![f64::NAN, 1.0]);
    let (answer_deg, answer_sd_deg, truth_deg) = (Some(90.0), Some(f64::INFINITY), Some(f64::NAN));
    check(
        &ProfilePlot { chosen_from, answer_deg, answer_sd_deg, truth_deg, ..Default::default() }
            .write(&at.join("polar"))
            .unwrap(),
    );
    let cdf = CdfPlot { series: vec![("s".into(), vec![0.0, f64::NAN, 2.0])], ..Default::default() };
    check(&cdf.write(&at.join("cdf")).unwrap());
    let lines =
        ScatterLines { log_x: true, series: vec![("s".into(), vec![(0.0, 1.0), (2.0, 3.0)])], ..Default::default() };
    check(&lines.write(&at.join("lines")).unwrap());
    std::fs::remove_dir_all(at).unwrap();
}

#[test]
fn nothing_to_draw_is_an_error() {
    let stem = folder("empty").join("x");
    let empty = |r: Result<Vec<PathBuf>, Error>| assert!(matches!(r, Err(Error::Empty { .. })), "{r:?}");
    empty(PhasePlot::default().write(&stem));
    empty(TrajectoryPlot::default().write(&stem));
    empty(MapPlot::default().write(&stem));
    empty(ProfilePlot::default().write(&stem));
    empty(ProfileMap::default().write(&stem));
    empty(CdfPlot::default().write(&stem));
    empty(ScatterLines::default().write(&stem));
    let short = ProfileMap { n_az: 2, n_el: 2, value: vec![1.0], ..Default::default() };
    assert!(matches!(short.write(&stem), Err(Error::Length { expect: 4, got: 1, .. })));
    assert!(!stem.parent().is_some_and(Path::exists), "nothing was written");
}

#[test]
fn a_folder_that_is_a_file_is_named() {
    let file = folder("file");
    std::fs::write(&file, "x").unwrap();
    let plot = CdfPlot { series: vec![("s".into(), vec![1.0])], ..Default::default() };
    let error = plot.write(&file.join("cdf")).unwrap_err();
    assert!(matches!(&error, Error::Io { path, .. } if path == &file), "{error}");
    std::fs::remove_file(file).unwrap();
}

#[test]
fn link_names_become_file_names() {
    assert_eq!(file_safe("tx0/rx 1:a-b.c"), "tx0_rx_1_a-b.c");
    assert_eq!(file_safe("../x"), "_._x");
    assert_eq!(file_safe(""), "_");
}
