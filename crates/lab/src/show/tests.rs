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
    // The SVG clips, too: every region that is used is defined.
    for name in text.split("url(#").skip(1).filter_map(|rest| rest.split(')').next()) {
        assert!(text.contains(&format!("id=\"{name}\"")), "{name} is not defined");
    }
    assert!(text.contains("width=\"1200\"") && !text.contains("NaN") && !text.contains("inf"));
}

/// Three pictures from values that include NaN and infinity, which are dropped.
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
        &PhasePlot { title: "t".into(), before: String::new(), other: Some(capture.clone()), capture, averaged: 0 }
            .write(&at.join("phase"), &Format::default())
            .unwrap(),
    );
    let path_m = vec![[0.0, 0.0], [f64::NAN, 1.0], [1.0, 1.0]];
    let plot = TrajectoryPlot { path_m, azimuth_rad: f64::NAN, sd_rad: Some(0.1), ..Default::default() };
    check(&plot.write(&at.join("path.v1"), &Format::default()).unwrap());
    assert!(at.join("path.v1.png").exists(), "a dot in the stem is kept");
    let map = ProfileMap { n_az: 2, n_el: 2, value: vec![0.0, f64::NAN, 1.0, -1.0], ..Default::default() };
    check(&map.write(&at.join("map"), &Format::default()).unwrap());
    let chosen_from = ("s".into(), vec![0.0, 90.0], vec![f64::NAN, 1.0]);
    let (answer_deg, answer_sd_deg, truth_deg) = (Some(90.0), Some(f64::INFINITY), Some(f64::NAN));
    check(
        &ProfilePlot { chosen_from, answer_deg, answer_sd_deg, truth_deg, ..Default::default() }
            .write(&at.join("polar"), &Format::default())
            .unwrap(),
    );
    let cdf = CdfPlot { series: vec![("s".into(), vec![0.0, f64::NAN, 2.0])], ..Default::default() };
    check(&cdf.write(&at.join("cdf"), &Format::default()).unwrap());
    let lines =
        ScatterLines { log_x: true, series: vec![("s".into(), vec![(0.0, 1.0), (2.0, 3.0)])], ..Default::default() };
    check(&lines.write(&at.join("lines"), &Format::default()).unwrap());
    std::fs::remove_dir_all(at).unwrap();
}

/// The texts of a picture, with their pixel positions.
fn written_in(svg: &str) -> Vec<(String, f64, f64)> {
    let number = |tag: &str, name: &str| tag.split(&format!(" {name}=\"")).nth(1)?.split('"').next()?.parse().ok();
    let texts = svg.split("<text").skip(1).filter_map(|rest| {
        let (tag, rest) = rest.split_once('>')?;
        Some((rest.split('<').next()?.to_owned(), number(tag, "x")?, number(tag, "y")?))
    });
    texts.collect()
}

#[test]
fn legends_name_the_wedge_of_a_bearing_that_has_one_and_no_angle_is_minus_zero() {
    let at = folder("legend");
    let svg = |sd_rad: Option<f64>| {
        let path_m = vec![[0.0, 0.0], [1.0, 1.0]];
        let plot = TrajectoryPlot { path_m, azimuth_rad: -1e-17, truth_rad: Some(-1e-5), sd_rad, ..Default::default() };
        let written = plot.write(&at.join("trajectory"), &Format::default()).unwrap();
        std::fs::read_to_string(&written[1]).unwrap()
    };
    for (sd_rad, is_named) in [(Some(1.8), true), (None, false), (Some(f64::INFINITY), false)] {
        let words: Vec<String> = written_in(&svg(sd_rad)).into_iter().map(|text| text.0).collect();
        assert_eq!(words.iter().any(|text| text == "two deviations"), is_named, "{sd_rad:?}: {words:?}");
        assert!(words.iter().any(|text| text == "bearing 0.00°"), "{words:?}");
        assert!(words.iter().any(|text| text == "truth 0.00°"), "{words:?}");
    }
    std::fs::remove_dir_all(at).unwrap();
}

#[test]
fn numbers_of_places_stay_within_the_frame() {
    let at = folder("numbers");
    let marks = vec![(0.0, 1.0), (10.0, 0.98), (20.0, 0.9), (30.0, 0.5), (40.0, 0.0)];
    let map = PlaceMap { y: (0.0, 1.0), n_az: 8, value: vec![1.0; 40], marks, ..Default::default() };
    let written = map.write(&at.join("place"), &Format::default()).unwrap();
    let svg = std::fs::read_to_string(&written[1]).unwrap();
    let texts = written_in(&svg);
    // The frame begins 28 pixels below the text of its legend, and its lower edge is at 600.
    let legend = texts.iter().find(|text| text.0.starts_with("candidates")).unwrap().2;
    for number in ["1", "2", "3", "4", "5"] {
        let (_, _, y) = texts.iter().find(|text| text.0 == number).unwrap();
        assert!(y - 18.0 >= legend + 28.0 && *y < 600.0, "{number} at {y}, the legend at {legend}");
    }
    std::fs::remove_dir_all(at).unwrap();
}

#[test]
fn nothing_to_draw_is_an_error() {
    let stem = folder("empty").join("x");
    let empty = |r: Result<Vec<PathBuf>, Error>| assert!(matches!(r, Err(Error::Empty { .. })), "{r:?}");
    empty(PhasePlot::default().write(&stem, &Format::default()));
    empty(TrajectoryPlot::default().write(&stem, &Format::default()));
    empty(MapPlot::default().write(&stem, &Format::default()));
    empty(ProfilePlot::default().write(&stem, &Format::default()));
    empty(ProfileMap::default().write(&stem, &Format::default()));
    empty(CdfPlot::default().write(&stem, &Format::default()));
    empty(ScatterLines::default().write(&stem, &Format::default()));
    let short = ProfileMap { n_az: 2, n_el: 2, value: vec![1.0], ..Default::default() };
    assert!(matches!(short.write(&stem, &Format::default()), Err(Error::Length { expect: 4, got: 1, .. })));
    assert!(!stem.parent().is_some_and(Path::exists), "nothing was written");
}

#[test]
fn a_folder_that_is_a_file_is_named() {
    let file = folder("file");
    std::fs::write(&file, "x").unwrap();
    let plot = CdfPlot { series: vec![("s".into(), vec![1.0])], ..Default::default() };
    let error = plot.write(&file.join("cdf"), &Format::default()).unwrap_err();
    assert!(matches!(&error, Error::Io { path, .. } if path == &file), "{error}");
    std::fs::remove_file(file).unwrap();
}

#[test]
fn link_names_become_file_names() {
    assert_eq!(file_safe("tx0/rx 1:a-b.c"), "tx0_rx_1_a-b.c");
    assert_eq!(file_safe("../x"), "_._x");
    assert_eq!(file_safe(""), "_");
}

/// A picture of every kind, from finite values.
fn pictures(at: &Path, format: &Format) -> Vec<PathBuf> {
    let ramp = |from: f64| (0..40).map(|k| from + f64::from(k) * 0.1).collect::<Vec<f64>>();
    let capture = PhaseTrack { t_s: ramp(0.0), before_rad: ramp(1.0), after_rad: ramp(2.0), ..PhaseTrack::default() };
    let path_m: Vec<[f64; 2]> = ramp(0.0).iter().map(|a| [a.cos(), a.sin()]).collect();
    let ray = |class| Ray { origin_m: [0.0; 2], azimuth_rad: 1.0, sd_rad: Some(0.1), label: "tx ± 1°".into(), class };
    let ellipse = Ellipse { centre_m: [1.0, 2.0], covariance_m2: [[0.1, 0.0], [0.0, 0.2]], label: "tx".into() };
    let point = ReliabilityPoint { said: 0.8, right: 0.7, count: 9 };
    let value: Vec<f64> = ramp(1.0);
    let trajectory = TrajectoryPlot {
        path_m: path_m.clone(),
        azimuth_rad: 1.0,
        mirror_rad: Some(-1.0),
        sd_rad: Some(0.1),
        transmitter_m: Some([2.0, 2.0]),
        ..Default::default()
    };
    let profile = ProfilePlot {
        chosen_from: ("evidence".into(), ramp(-180.0), ramp(0.5)),
        answer_deg: Some(-179.0),
        answer_sd_deg: Some(1.0),
        truth_deg: Some(-178.0),
        mirror_deg: Some(178.0),
        ..Default::default()
    };
    let rays = vec![ray(RayClass::Measured), ray(RayClass::Mirror), ray(RayClass::Truth)];
    let written = [
        PhasePlot { capture, ..Default::default() }.write(&at.join("phase"), format),
        trajectory.write(&at.join("path"), format),
        MapPlot { rays, path_m, ellipses: vec![ellipse], ..Default::default() }.write(&at.join("map"), format),
        profile.write(&at.join("profile"), format),
        ProfileMap { n_az: 8, n_el: 5, value: value.clone(), ..Default::default() }.write(&at.join("grid"), format),
        PlaceMap { y: (0.0, 1.0), n_az: 8, value, marks: vec![(0.0, 0.5)], truth_deg: Some(1.0), ..Default::default() }
            .write(&at.join("place"), format),
        CdfPlot { series: vec![("s".into(), ramp(0.1))], ..Default::default() }.write(&at.join("cdf"), format),
        ScatterLines { series: vec![("s".into(), vec![(1.0, 2.0), (2.0, 3.0)])], lines: true, ..Default::default() }
            .write(&at.join("lines"), format),
        ReliabilityPlot { series: vec![("s".into(), vec![point])], ..Default::default() }
            .write(&at.join("reliability"), format),
    ];
    written.into_iter().flat_map(Result::unwrap).collect()
}

#[test]
fn every_picture_is_a_png_and_an_svg_and_replaces_files_only_on_request() {
    let at = folder("formats");
    let format = Format::default().with_replace(false);
    let written = pictures(&at, &format);
    assert_eq!(written.len(), 2 * 9);
    written.chunks(2).for_each(check_kinds);
    let again = CdfPlot { series: vec![("s".into(), vec![1.0])], ..CdfPlot::default() };
    std::fs::write(at.join("cdf.svg"), "mine").unwrap();
    std::fs::remove_file(at.join("cdf.png")).unwrap();
    let refused = again.write(&at.join("cdf"), &format);
    assert!(matches!(&refused, Err(Error::There { path }) if *path == at.join("cdf.svg")), "{refused:?}");
    assert!(std::fs::read(at.join("cdf.svg")).unwrap() == b"mine" && !at.join("cdf.png").exists());
    assert!(again.write(&at.join("cdf"), &format.with_replace(true)).is_ok());
    std::fs::remove_dir_all(at).unwrap();
}

fn check_kinds(pair: &[PathBuf]) {
    let [png, svg] = pair else { panic!("{pair:?}") };
    assert!(std::fs::read(png).unwrap().starts_with(b"\x89PNG"), "{}", png.display());
    assert!(std::fs::read(svg).unwrap().starts_with(b"<svg"), "{}", svg.display());
}

/// More points than pixels become cells: a long log's picture is not much larger than a short one's.
#[test]
fn phases_that_are_too_dense_are_binned() {
    let at = folder("dense");
    let svg = |n: usize| {
        let t_s: Vec<f64> = (0..n).map(|k| k as f64 * 0.01).collect();
        let phase: Vec<f64> = (0..n).map(|k| (k as f64 * 0.618).rem_euclid(1.0)).collect();
        let capture = PhaseTrack { t_s, before_rad: phase.clone(), after_rad: phase, ..PhaseTrack::default() };
        let plot = PhasePlot { capture, ..PhasePlot::default() };
        let written = plot.write(&at.join(n.to_string()), &Format::default()).unwrap();
        std::fs::read_to_string(&written[1]).unwrap()
    };
    let dots = |svg: &str| svg.matches("<circle").count();
    let (few, many) = (svg(1_000), svg(20_000));
    assert!(dots(&few) >= 2 * 1_000, "{}", dots(&few));
    assert!(dots(&many) < 10 && many.matches("<rect").count() > 1_000, "{}", dots(&many));
    std::fs::remove_dir_all(at).unwrap();
}
