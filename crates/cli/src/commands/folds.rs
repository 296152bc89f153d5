//! `csi5300 evaluate --folds places`: the tables.

use super::{Outcome, print, print_json};
use csi5300::pipeline::Options;
use csi5300_lab::evaluate::{Capture, Errors, Kept, TrajectorySource};
use csi5300_lab::folds::{
    ConfidenceColumn, ErrorBarColumn, ErrorColumn, Kind, PathColumn, RefusalColumn, Report, gather, report,
};
use std::fmt::Write;

/// Leaves every place of `captures` out in turn, and prints what came of it.
pub(super) fn run(captures: &[Capture], options: &Options, json: bool) -> Report {
    let report = report(&gather(captures, options));
    if json {
        print_json(&report);
    } else {
        print(&text(&report));
    }
    report
}

/// Nothing if no link had a bearing.
pub(super) fn outcome(report: &Report) -> Outcome {
    let found = report.errors.iter().any(|column| column.errors.links > 0);
    if found { Outcome::Done } else { Outcome::Nothing }
}

fn text(report: &Report) -> String {
    let mut text = format!(
        "{}, {}; each place is judged by what was fitted to the others\n\n\
         absolute error from the mean pose, degrees: mean / median / 90th percentile / share over 20 degrees,\n\
         in brackets 95 % intervals by resampling places; oracle: the best of the first five candidates; turned right: less the\n\
         rotation of the whole path that motion capture shows\n",
        super::some(report.places as u64, "place", "places"),
        super::some(report.links as u64, "link", "links")
    );
    if let Some([forward, left]) = report.antenna_offset_m {
        let _ = writeln!(
            text,
            "wheel odometry with the antenna where motion capture of the other places shows it on the robot: {forward:.3} m \
             forward, {left:.3} m left"
        );
    }
    if let Some(mount) = &report.camera {
        let _ = writeln!(
            text,
            "rolling camera: the tracking camera held to what wheels can roll, {:.3} m forward and {:.3} m left of the middle \
             between them, looking {:.1} degrees to the left, as the other places show",
            mount.forward_m, mount.left_m, mount.yaw_deg
        );
    }
    text += "\npaths against motion capture's: rotation in degrees (mean, standard deviation, largest), scale (median, standard\n\
             deviation), root mean square of what is left in millimetres (median, largest)\n";
    report.paths.iter().for_each(|column| path(&mut text, column));
    let mut last = None;
    for column in &report.errors {
        let which = (column.which.source, column.which.parts, column.which.kind);
        if last.replace(which) != Some(which) {
            let _ = writeln!(text, "\n{}", heading(which.0, which.1, which.2));
        }
        line(&mut text, column);
    }
    text += "\nconfidence from models fitted to the other places: bearings, said, right,\n\
             expected calibration error, and what a perfect calibration would show with as many\n";
    report.confidence.iter().for_each(|column| confidence(&mut text, column));
    text += "\nerror bars from models fitted to the other places: bearings, share of errors within one (68 % meant) and two (95 %),\n\
             median of error over error bar (0.67 of normal errors), median error bar, median of error over Cramer-Rao bound\n";
    report.error_bars.iter().for_each(|column| error_bar(&mut text, column));
    text += "\nrefusing below a probability (--min-confidence), from models fitted to the other places: share kept, errors of those kept,\n\
             share of those refused that was within five degrees\n";
    let shown = |column: &&RefusalColumn| column.which.kind == Kind::Full && column.which.parts <= 2;
    let without_wheels = |column: &&RefusalColumn| column.which.source != TrajectorySource::Odometry;
    let columns = || report.refusals.iter().filter(shown).filter(without_wheels);
    columns().filter(|column| column.which.group == "all").for_each(|column| refusal(&mut text, column));
    text += "\nthe surest 80 %, by group\n";
    columns().for_each(|column| surest(&mut text, column));
    text
}

fn path(text: &mut String, column: &PathColumn) {
    let [mean, deviation, largest] = column.rotation_deg;
    let [shape, most] = column.shape_m.map(|metres| 1e3 * metres);
    let _ = writeln!(
        text,
        "{:32} {:4}  {mean:5.2} {deviation:5.2} {largest:5.1}  {:.3} {:.3}  {shape:5.1} {most:5.1}",
        motions(column.source, column.parts),
        column.paths,
        column.scale[0],
        column.scale[1]
    );
}

/// A trajectory and how long its motions are.
fn motions(source: TrajectorySource, parts: u32) -> String {
    let parts = match parts {
        1 => "whole motions",
        2 => "halves",
        _ => "quarters",
    };
    format!("{source}, {parts}")
}

fn heading(source: TrajectorySource, parts: u32, kind: Kind) -> String {
    let motions = motions(source, parts);
    match kind {
        Kind::Full => format!("{motions}, everything on"),
        Kind::Quick => format!("{motions}, plane wave"),
    }
}

fn line(text: &mut String, column: &ErrorColumn) {
    let (own, places) = (&column.errors, column.places);
    let _ =
        write!(text, "{:12} {places:3} places {:4} links {:3} failed  ", column.which.group, own.links, column.failed);
    let figures = [own.mean_deg, own.median_deg, own.p90_deg];
    for (figure, range) in figures.iter().zip(&column.intervals) {
        let _ = write!(text, "{figure:.2} [{:.2} .. {:.2}] / ", range.low, range.high);
    }
    let range = column.intervals[3];
    let [over, low, high] = [own.over_20, range.low, range.high].map(|share| 100.0 * share);
    let _ = write!(text, "{over:.1} % [{low:.1} .. {high:.1}]");
    let Errors { mean_deg, median_deg, p90_deg, over_20, .. } = column.oracle;
    let _ = write!(text, "  oracle {mean_deg:.2} / {median_deg:.2} / {p90_deg:.2} / {:.1} %", 100.0 * over_20);
    if let Some(Errors { mean_deg, median_deg, .. }) = column.unturned {
        let _ = write!(text, "  turned right {mean_deg:.2} / {median_deg:.2}");
    }
    text.push('\n');
}

fn confidence(text: &mut String, column: &ConfidenceColumn) {
    let _ = writeln!(
        text,
        "{:50} {:4}  said {:.2}  right {:.2}  error {:.3}  perfect {:.3}",
        heading(column.source, column.parts, column.kind),
        column.bearings,
        column.said,
        column.right,
        column.expected_error,
        column.perfect
    );
}

fn error_bar(text: &mut String, column: &ErrorBarColumn) {
    let which = &column.which;
    let _ = writeln!(
        text,
        "{:46} {:4} {:4}  within {:3.0} %  twice {:3.0} %  ratio {:.2}  bar {:5.2} deg  over bound {:.1}",
        heading(which.source, which.parts, which.kind),
        which.group,
        column.bearings,
        100.0 * column.within,
        100.0 * column.within_twice,
        column.ratio,
        column.median_deg,
        column.over_bound
    );
}

fn refusal(text: &mut String, column: &RefusalColumn) {
    let which = &column.which;
    let _ = writeln!(text, "{}", heading(which.source, which.parts, which.kind));
    for kept in &column.above {
        let _ = writeln!(text, "  {:.1}  {}", kept.confidence, kept_line(kept));
    }
}

fn surest(text: &mut String, column: &RefusalColumn) {
    let which = &column.which;
    let kept = column.surest.iter().find(|kept| (kept.share - 0.8).abs() < 1e-9);
    if let Some(kept) = kept {
        let name = heading(which.source, which.parts, which.kind);
        let _ = writeln!(text, "{name:46} {:4} from {:.2} on  {}", which.group, kept.confidence, kept_line(kept));
    }
}

fn kept_line(kept: &Kept) -> String {
    let refused = kept.refused_right.map_or("-".into(), |share| format!("{:.0} %", 100.0 * share));
    format!("{:3.0} %  {}  refused right {refused}", 100.0 * kept.share, super::evaluate::line(&kept.errors))
}
