//! Pictures of links, sets and comparisons, 1200 px wide, each as a PNG and an SVG.
//!
//! | file | what it shows |
//! |---|---|
//! | [`results`] | a link, an evaluation, a recording beside a simulation, stationary robots |
//! | [`log`] | a log over time: heat maps of CSI, levels, rate, losses |
//! | `plots` | the kinds of picture |
//! | `canvas` | lines, text, legends, axes, files; the only file that uses the drawing library |
//!
//! Every kind of picture is a struct with public fields and one `write(stem)`. It adds `.png` and `.svg` to `stem`, creates
//! missing folders, replaces files, and returns the paths. Values that are not finite are dropped; a
//! picture without values is an error. Colours are those of Okabe and Ito (2008), safe for colour-blind readers; legends are
//! above the axes, never on the data. Azimuths count from +x towards +y.

mod canvas;
pub mod log;
mod plots;
pub mod results;

use crate::Failure;
pub use plots::{Chart, Ellipse, Look, MapPlot, PhasePlot, PhaseTrack, ProfilePlot, Ray, RayClass, Series};
use std::path::{Path, PathBuf};

/// The refusal of a part of a picture without a finite value.
fn empty(what: &str) -> Failure {
    format!("{what}: no finite value to draw; check that the estimator produced output").into()
}

/// The path `stem` with `end` behind its last letter.
fn ending(stem: &Path, end: &str) -> PathBuf {
    let mut name = stem.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// A link name as a file name: keeps letters, digits, `.` and `-`, and replaces everything else (`/`, `:`, spaces) and a leading
/// dot by `_`, so that no hidden file or `..` results. Never empty.
pub fn file_safe(name: &str) -> String {
    let keep = |c: char| if c.is_alphanumeric() || matches!(c, '.' | '-') { c } else { '_' };
    let safe: String = name.chars().map(keep).collect();
    match safe.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None if safe.is_empty() => "_".into(),
        None => safe,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curves::Curve;
    use crate::temporary::Temporary;

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

    fn ray(azimuth_rad: f64, sd_rad: Option<f64>, class: RayClass) -> Ray {
        Ray { origin_m: [0.0; 2], azimuth_rad, sd_rad, label: "tx ± 1°".into(), class }
    }

    fn chart(look: Look, points: Vec<(f64, f64)>) -> Chart {
        Chart { series: vec![Series { name: "s".into(), points, look, colour: 0 }], ..Chart::default() }
    }

    /// Pictures of every kind, from values that include NaN and infinity, which are dropped.
    #[test]
    fn every_picture_is_a_png_and_an_svg_without_values_that_are_not_finite() {
        let at = &Temporary::path("finite").0;
        let t_s = [0.0, 1.0, f64::NAN, 3.0];
        let capture = PhaseTrack {
            label: "a<b & $c".into(),
            before: t_s.into_iter().zip([1.0, f64::INFINITY, 2.0, 9.0]).collect(),
            after: t_s.into_iter().zip(t_s).collect(),
            left: vec![(0.0, f64::NAN), (1.0, 4.0)],
            ..PhaseTrack::default()
        };
        check(
            &PhasePlot { title: "t".into(), before: String::new(), other: Some(capture.clone()), capture, averaged: 0 }
                .write(&at.join("phase"))
                .unwrap(),
        );
        let path_m = vec![[0.0, 0.0], [f64::NAN, 1.0], [1.0, 1.0]];
        let ellipse = Ellipse { centre_m: [1.0, 2.0], covariance_m2: [[0.1, 0.0], [0.0, 0.2]], label: "tx".into() };
        let rays = [f64::NAN, 1.0].map(|azimuth_rad| ray(azimuth_rad, Some(0.1), RayClass::Measured)).to_vec();
        let plot = MapPlot { used_m: path_m.clone(), path_m, rays, ellipses: vec![ellipse], ..Default::default() };
        check(&plot.write(&at.join("path.v1")).unwrap());
        assert!(at.join("path.v1.png").exists(), "a dot in the stem is kept");
        let chosen_from = Curve { name: "s".into(), points: vec![(0.0, f64::NAN), (90.0, 1.0)] };
        let (answer_deg, answer_sd_deg, truth_deg) = (Some(90.0), Some(f64::INFINITY), Some(f64::NAN));
        check(
            &ProfilePlot {
                chosen_from,
                answer_deg,
                answer_sd_deg,
                truth_deg,
                mirror_deg: Some(178.0),
                ..Default::default()
            }
            .write(&at.join("polar"))
            .unwrap(),
        );
        for (look, log_x) in [(Look::Steps, true), (Look::Dashed, true), (Look::Joined, false), (Look::Dots, false)] {
            let chart = Chart { log_x, ..chart(look, vec![(0.0, 1.0), (f64::NAN, 0.0), (2.0, 3.0)]) };
            check(&chart.write(&at.join("chart")).unwrap());
        }
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
        let at = &Temporary::path("legend").0;
        let svg = |sd_rad: Option<f64>| {
            let path_m = vec![[0.0, 0.0], [1.0, 1.0]];
            let rays = vec![ray(-1e-5, None, RayClass::Truth), ray(-1e-17, sd_rad, RayClass::Measured)];
            let plot = MapPlot { path_m, rays, ..Default::default() };
            let written = plot.write(&at.join("trajectory")).unwrap();
            std::fs::read_to_string(&written[1]).unwrap()
        };
        for (sd_rad, is_named) in [(Some(1.8), true), (None, false), (Some(f64::INFINITY), false)] {
            let words: Vec<String> = written_in(&svg(sd_rad)).into_iter().map(|text| text.0).collect();
            assert_eq!(words.iter().any(|text| text == "two deviations"), is_named, "{sd_rad:?}: {words:?}");
            assert!(words.iter().any(|text| text == "bearing 0.00°"), "{words:?}");
            assert!(words.iter().any(|text| text == "truth 0.00°"), "{words:?}");
        }
    }

    #[test]
    fn names_longer_than_a_picture_keep_their_ends() {
        let at = &Temporary::path("long").0;
        let title = format!("set{}: bearings", "x".repeat(200));
        let mut long = Chart { title, ..chart(Look::Steps, vec![(1.0, 1.0), (2.0, 2.0)]) };
        long.series[0].name = format!("set{} (median 1.00)", "x".repeat(100));
        let texts = written_in(&std::fs::read_to_string(&long.write(&at.join("chart")).unwrap()[1]).unwrap());
        let fits = |end: &str, most: usize| {
            texts
                .iter()
                .any(|(text, ..)| text.starts_with("set") && text.ends_with(end) && text.chars().count() <= most)
        };
        assert!(fits("x: bearings", 140) && fits("x (median 1.00)", 85), "{texts:?}");
    }

    #[test]
    fn the_name_of_an_axis_is_below_the_legend() {
        let at = &Temporary::path("below").0;
        let chart = Chart { y_label: "axis".into(), ..chart(Look::Steps, vec![(1.0, 1.0), (2.0, 2.0)]) };
        let texts = written_in(&std::fs::read_to_string(&chart.write(&at.join("chart")).unwrap()[1]).unwrap());
        let [legend, axis] = ["s", "axis"].map(|name| texts.iter().find(|text| text.0 == name).unwrap().2);
        assert!(axis >= legend + 22.0, "{axis} {legend}");
    }

    #[test]
    fn a_mirror_on_the_truth_leaves_as_much_of_it_on_both_sides() {
        let at = &Temporary::path("widths").0;
        let rays = vec![ray(1.0, None, RayClass::Truth), ray(1.0, None, RayClass::Mirror)];
        let plot = MapPlot { path_m: vec![[0.0, 0.0], [1.0, 1.0]], rays, ..Default::default() };
        let svg = std::fs::read_to_string(&plot.write(&at.join("map")).unwrap()[1]).unwrap();
        let lines = svg.split("<line ").skip(1).filter_map(|rest| rest.split("/>").next());
        let width = |tag: &str| tag.split("stroke-width=\"").nth(1)?.split('"').next()?.parse::<f64>().ok();
        let [.., truth, mirror] = lines.collect::<Vec<_>>()[..] else { panic!("{svg}") };
        assert!(mirror.contains("stroke-dasharray"), "{mirror}");
        assert!(width(mirror).unwrap() >= 3.0 && width(truth).unwrap() > 2.5 * width(mirror).unwrap());
    }

    #[test]
    fn nothing_to_draw_is_an_error() {
        let stem = Temporary::path("empty").0.join("x");
        let empty = |r: Result<Vec<PathBuf>, Failure>| {
            let words = r.unwrap_err().to_string();
            assert!(words.contains("no finite value"), "{words}");
        };
        empty(PhasePlot::default().write(&stem));
        empty(MapPlot::default().write(&stem));
        empty(ProfilePlot::default().write(&stem));
        empty(chart(Look::Steps, vec![(f64::NAN, 1.0)]).write(&stem));
        assert!(!stem.parent().is_some_and(Path::exists), "nothing was written");
    }

    #[test]
    fn a_folder_that_is_a_file_is_named() {
        let file = &Temporary::file("file", b"x").0;
        let error = chart(Look::Steps, vec![(1.0, 1.0)]).write(&file.join("x")).unwrap_err();
        assert!(error.to_string().starts_with(&format!("cannot write {}: ", file.display())), "{error}");
    }

    #[test]
    fn link_names_become_file_names() {
        assert_eq!(file_safe("tx0/rx 1:a-b.c"), "tx0_rx_1_a-b.c");
        assert_eq!(file_safe("../x"), "_._x");
        assert_eq!(file_safe(""), "_");
    }

    /// More points than pixels become cells: a long log's picture is not much larger than a short one's.
    #[test]
    fn phases_that_are_too_dense_are_binned() {
        let at = &Temporary::path("dense").0;
        let svg = |n: usize| {
            let phase = (0..n).map(|k| (k as f64 * 0.01, (k as f64 * 0.618).rem_euclid(1.0)));
            let capture = PhaseTrack { before: phase.clone().collect(), after: phase.collect(), ..Default::default() };
            let plot = PhasePlot { capture, ..PhasePlot::default() };
            let written = plot.write(&at.join(n.to_string())).unwrap();
            std::fs::read_to_string(&written[1]).unwrap()
        };
        let dots = |svg: &str| svg.matches("<circle").count();
        let (few, many) = (svg(1_000), svg(20_000));
        assert!(dots(&few) >= 2 * 1_000, "{}", dots(&few));
        assert!(dots(&many) < 10 && many.matches("<rect").count() > 1_000, "{}", dots(&many));
    }
}
