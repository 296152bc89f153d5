//! The report as one HTML page: a table and the curves as SVG, without a script.

use crate::report::{Curve, Report, Verdict, escaped};
use std::fmt::Write as _;

const COLOURS: [&str; 3] = ["#0b62a4", "#c4541b", "#4d7c0f"];
/// Width and height of a curve's plane, and the room left of it and below, pixels.
const PLANE: (f64, f64) = (560.0, 220.0);
const ROOM: (f64, f64) = (70.0, 44.0);

/// The range of values, a little wider; of one value or none a range about it.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    match high - low {
        width if width > 0.0 => (low - 0.04 * width, high + 0.04 * width),
        _ if low == f64::MAX => (0.0, 1.0),
        _ => (low - 0.5, high + 0.5),
    }
}

fn svg(curve: &Curve) -> String {
    let points = || curve.series.iter().flat_map(|(_, points)| points);
    let (x_low, x_high) = range(points().map(|point| point.0));
    let (y_low, y_high) = range(points().map(|point| point.1));
    let place = |(x, y): (f64, f64)| {
        (ROOM.0 + (x - x_low) / (x_high - x_low) * PLANE.0, 10.0 + (y_high - y) / (y_high - y_low) * PLANE.1)
    };
    let (wide, high) = (ROOM.0 + PLANE.0 + 20.0, PLANE.1 + ROOM.1 + 10.0);
    let mut svg = format!("<svg viewBox=\"0 0 {wide} {high}\" role=\"img\" aria-label=\"{}\">", escaped(curve.title));
    let _ =
        write!(svg, "<rect x=\"{}\" y=\"10\" width=\"{}\" height=\"{}\" class=\"plane\"/>", ROOM.0, PLANE.0, PLANE.1);
    for tick in 0..=4 {
        let share = f64::from(tick) / 4.0;
        let (x, y) = (x_low + share * (x_high - x_low), y_low + share * (y_high - y_low));
        let (px, py) = place((x, y));
        let digits = |span: f64| {
            if span >= 20.0 {
                0
            } else if span >= 2.0 {
                1
            } else {
                2
            }
        };
        let (dx, dy) = (digits(x_high - x_low), digits(y_high - y_low));
        let _ = write!(svg, "<text x=\"{px:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{x:.dx$}</text>", PLANE.1 + 24.0);
        let _ =
            write!(svg, "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{y:.dy$}</text>", ROOM.0 - 6.0, py + 4.0);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{} {py:.1}H{}\"/>", ROOM.0, ROOM.0 + PLANE.0);
    }
    for ((name, points), colour) in curve.series.iter().zip(COLOURS) {
        let _ = write!(svg, "<g fill=\"{colour}\"><title>{}</title>", escaped(name));
        for point in points.iter().filter(|(x, y)| x.is_finite() && y.is_finite()) {
            let (x, y) = place(*point);
            let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.6\"/>");
        }
        svg.push_str("</g>");
    }
    let _ = write!(
        svg,
        "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{}</text>",
        ROOM.0 + 0.5 * PLANE.0,
        high - 8.0,
        escaped(curve.x)
    );
    svg.push_str("</svg>");
    svg
}

/// The page.
pub(crate) fn html(report: &Report) -> String {
    let mut page = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>csi5300: what holds on this desk</title><style>\
         body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24}\
         table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #d8dee4;vertical-align:top}\
         .holds{color:#1a7f37}.fails{color:#b42318;font-weight:600}.measured{color:#0b62a4}.not_tried{color:#6e7781}\
         svg{width:100%;max-width:42rem;font:11px system-ui}.plane{fill:none;stroke:#8c959f}.grid{stroke:#e4e8ec;fill:none}\
         small{color:#57606a}li{margin:.15rem 0}</style>\n<h1>What holds on this desk</h1>\n",
    );
    let [fail, hold, measured, not_tried] =
        [Verdict::Fails, Verdict::Holds, Verdict::Measured, Verdict::NotTried].map(|verdict| report.count(verdict));
    let _ = writeln!(
        page,
        "<p><b class=\"fails\">{fail} fail</b>, <b class=\"holds\">{hold} hold</b>, {measured} measured, {not_tried} not tried. csi5300 {}</p>",
        report.version
    );
    if !report.facts.is_empty() {
        page.push_str("<ul>");
        for fact in &report.facts {
            let _ = write!(page, "<li>{}</li>", escaped(fact));
        }
        page.push_str("</ul>\n");
    }
    rows(&mut page, report, &[Verdict::Fails]);
    for curve in &report.curves {
        page.push_str(&section(curve));
    }
    page.push_str("<h2>Everything else</h2>\n");
    rows(&mut page, report, &[Verdict::Measured, Verdict::Holds, Verdict::NotTried]);
    page
}

/// A curve with its title and the names of its series.
fn section(curve: &Curve) -> String {
    let names: Vec<String> = curve
        .series
        .iter()
        .zip(COLOURS)
        .map(|((name, _), colour)| format!("<span style=\"color:{colour}\">&#9679; {}</span>", escaped(name)))
        .collect();
    format!(
        "<h2>{}</h2><p><small>{} &nbsp; vertical: {}</small></p>{}\n",
        escaped(curve.title),
        names.join(" "),
        escaped(curve.y),
        svg(curve)
    )
}

/// A table of the findings with these verdicts; equal verdicts of both cards share a row.
fn rows(page: &mut String, report: &Report, verdicts: &[Verdict]) {
    if !report.findings.iter().any(|finding| verdicts.contains(&finding.verdict)) {
        return;
    }
    page.push_str("<table><tr><th>verdict<th>claim<th>of<th>found</tr>\n");
    for verdict in verdicts {
        let class = match verdict {
            Verdict::Fails => "fails",
            Verdict::Holds => "holds",
            Verdict::Measured => "measured",
            Verdict::NotTried => "not_tried",
        };
        for row in report.rows(*verdict) {
            let (finding, of) = (row.finding, row.of());
            let found: Vec<String> = row.found().iter().map(|found| escaped(found)).collect();
            let found = found.join("<br>");
            let says = finding.claim().map_or("", |claim| claim.says);
            let _ = write!(
                page,
                "<tr><td class=\"{class}\">{}<td><b>{}</b><br><small>{}</small><td>{of}<td>{found}",
                verdict.word(),
                finding.id,
                escaped(says)
            );
            if let Some(claim) = finding.claim().filter(|_| *verdict == Verdict::Fails) {
                let _ = write!(page, "<br><small>{}</small>", escaped(&claim.advice()));
            }
            page.push_str("</tr>\n");
        }
    }
    page.push_str("</table>\n");
}
