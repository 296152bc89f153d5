//! One HTML page with everything about a tree of captures: no script, and nothing that is fetched from anywhere.

use super::format::{Format, Kind};
use super::link::LinkPictures;
use super::set::Others;
use crate::evaluate::{ALL_SETS, Capture, Evaluated, Judged, SetSummary, TrajectorySource, summarise};
use csi5300::pipeline::{Answer, Bearing, Options};
use csi5300::signal::channel::Channel;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A page that grows by captures.
#[derive(Default)]
pub struct HtmlReport {
    links: Vec<LinkShown>,
    notes: Vec<String>,
    lost: bool,
    /// What another program answers on the links.
    others: Others,
    /// Where pictures are drawn before they go into the page; no pictures without.
    pictures_in: Option<PathBuf>,
}

/// One link on the page.
struct LinkShown {
    row: Judged,
    /// Its pictures, SVG.
    pictures: Vec<String>,
}

impl HtmlReport {
    /// A page without pictures.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A page with pictures. They are drawn in `folder`, which the caller removes afterwards.
    #[must_use]
    pub fn with_pictures(folder: PathBuf) -> Self {
        Self { pictures_in: Some(folder), ..Self::default() }
    }

    /// Adds a line in red below the losses, and makes the page one of a tree that lost something.
    pub fn note(&mut self, note: String) {
        self.notes.push(note);
        self.lost = true;
    }

    /// What was noted so far.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Adds what another program answers on the links, where there is a table of it in the folder.
    pub fn beside(&mut self, folder: &Path, source: TrajectorySource) {
        if let Some(note) = self.others.add(folder, source) {
            self.note(note);
        }
    }

    /// Evaluates a capture and adds its links. Phases are drawn where `options.keep_course` is set.
    pub fn add(&mut self, capture: &Capture, source: TrajectorySource, channel: Option<Channel>, options: &Options) {
        let folder = self.pictures_in.clone();
        let folder = folder.as_deref();
        let mut bearings: BTreeMap<String, Bearing> = BTreeMap::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| {
            if folder.is_some() {
                bearings.insert(name.to_owned(), bearing.clone());
            }
        };
        let Evaluated { rows, lost, notes } = capture.evaluate_and(source, channel, options, &mut look);
        self.lost |= lost;
        self.notes.extend(notes);
        for row in rows {
            let bearing = bearings.remove(&row.answer.link).zip(folder);
            let pictures = match bearing.map(|(bearing, folder)| draw(folder, &row, &bearing, source)) {
                Some(Err(error)) => {
                    self.note(error);
                    Vec::new()
                }
                Some(Ok(pictures)) => pictures,
                None => Vec::new(),
            };
            self.links.push(LinkShown { row, pictures });
        }
    }

    /// The links so far.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &Judged> {
        self.links.iter().map(|link| &link.row)
    }

    /// True if records were lost before a log's tail, a link failed, a picture could not be drawn, or something was noted.
    #[must_use]
    pub fn lost(&self) -> bool {
        self.lost
    }

    /// The page. Pictures of sets and places are drawn here; that they cannot be is noted.
    #[must_use]
    pub fn html(&mut self, title: &str) -> String {
        let rows: Vec<Judged> = self.links.iter().map(|link| link.row.clone()).collect();
        let drawn = self.pictures_in.as_deref().map(|folder| sets(&rows, &self.others, folder));
        let sets = drawn.unwrap_or(Ok(Vec::new())).unwrap_or_else(|error| {
            self.note(error.to_string());
            Vec::new()
        });
        page(title, &self.links, &rows, &sets, &self.notes)
    }
}

/// What stands in the page.
fn vectors() -> Format {
    Format::default().with_kinds(&[Kind::Svg]).with_replace(true)
}

/// The pictures of all links together, as SVG with their names: distributions, then maps of places.
fn sets(rows: &[Judged], others: &Others, folder: &Path) -> Result<Vec<(String, String)>, super::Error> {
    let written = super::set::write(rows, others, folder, &vectors())?;
    let read = |path: PathBuf| {
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let text = std::fs::read_to_string(&path).map_err(|source| super::Error::Io { path, source })?;
        Ok((name, super::slim::slim(&text)))
    };
    written.into_iter().map(read).collect()
}

/// Pictures of a link take no more bytes: its words and tables have the rest of 150 KB.
const PICTURES_BYTES: usize = 145_000;
/// Points of a path, and places at which CSI was used, of a picture on the page: a circle of 60 turns has one for each
/// five degrees.
const PLACES: usize = 3_000;

/// The pictures of a link as SVG, the phase of so few of its pairs that they are small.
fn draw(folder: &Path, row: &Judged, bearing: &Bearing, source: TrajectorySource) -> Result<Vec<String>, String> {
    let name = &row.answer.link;
    let of_link = |error: super::Error| format!("{name}: {error}");
    let read = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok::<_, String>(super::slim::slim(&text))
    };
    let mut pictures = LinkPictures { places: PLACES, ..LinkPictures::of(row, bearing, source) };
    let written = pictures.write(folder, name, &vectors()).map_err(of_link)?;
    let mut drawn = written.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let bytes = |drawn: &[String]| drawn.iter().map(String::len).sum::<usize>();
    while bytes(&drawn) > PICTURES_BYTES && pictures.every < bearing.course.len() {
        pictures.every *= 2;
        let phase = pictures.write_phase(folder, name, &vectors()).map_err(of_link)?;
        if let (Some(first), Some(path)) = (drawn.first_mut(), phase.first()) {
            *first = read(path)?;
        }
    }
    Ok(drawn)
}

/// Links of a page whose pictures are seen at once; those of larger ones are looked at one by one.
const OPEN: usize = 6;
const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:76em;padding:0 1em;color:#222}\
table{border-collapse:collapse;margin:1em 0}th,td{padding:.25em .7em;text-align:right;border-bottom:1px solid #ddd}\
th:first-child,td:first-child{text-align:left;white-space:nowrap}th{border-bottom:2px solid #888}td.bad{color:#b00020}\
figure{margin:.5em 0;display:inline-block;vertical-align:top;width:32%;min-width:20em}figure.wide{width:48%}figure svg{width:100%;height:auto}\
details{margin:.4em 0}summary{cursor:pointer}.note{color:#b00020}";

/// The whole page: what is to be seen of all links first, then each of them.
fn page(title: &str, shown: &[LinkShown], rows: &[Judged], sets: &[(String, String)], notes: &[String]) -> String {
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>{0}</title><style>{STYLE}</style></head>\
         <body><h1>Bearings of {0}</h1>\n<p>csi5300 {1}. Azimuths in degrees, from +x towards +y of the trajectory's frame, \
         from the receiver to the transmitter.</p>\n",
        escape(title),
        env!("CARGO_PKG_VERSION")
    );
    overview(&mut html, sets);
    let is_judged = rows.iter().any(|row| row.true_from_mean_pose_deg.is_some());
    if is_judged {
        summary(&mut html, &summarise(rows));
    } else {
        html.push_str("<p>The truth is not known: no errors.</p>\n");
    }
    links(&mut html, shown, is_judged);
    losses(&mut html, shown, notes);
    html.push_str("<h2>Links</h2>\n");
    for link in shown {
        details(&mut html, link, shown.len() <= OPEN);
    }
    html.push_str("</body></html>\n");
    html
}

/// Pictures of all links: distributions at once, maps of many places one by one.
fn overview(html: &mut String, pictures: &[(String, String)]) {
    let figure = |(name, svg): &(String, String)| {
        format!("<figure class=\"wide\">{}</figure>\n", apart(svg, &format!("{name}-")))
    };
    let (maps, curves): (Vec<_>, Vec<_>) = pictures.iter().partition(|(name, _)| name.starts_with("map-"));
    curves.iter().for_each(|picture| html.push_str(&figure(picture)));
    if !maps.is_empty() {
        let open = if maps.len() <= OPEN { " open" } else { "" };
        let _ = writeln!(
            html,
            "<details{open}><summary>Maps of {}</summary>",
            crate::words::count(maps.len() as u64, "capture", "captures")
        );
        maps.iter().for_each(|picture| html.push_str(&figure(picture)));
        html.push_str("</details>\n");
    }
}

fn summary(html: &mut String, sets: &BTreeMap<String, SetSummary>) {
    html.push_str(
        "<h2>Errors</h2>\n<table><tr><th>set</th><th>links</th><th>failed</th><th>mean</th><th>median</th><th>90 %</th>\
         <th>over 20 deg</th></tr>\n",
    );
    let named = |all: bool| sets.iter().filter(move |(name, _)| (*name == ALL_SETS) == all);
    for (name, set) in named(false).chain(named(true)) {
        let errors = &set.from_mean_pose;
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(name),
            set.links,
            set.failed,
            figure(Some(errors.mean_deg), 2),
            figure(Some(errors.median_deg), 2),
            figure(Some(errors.p90_deg), 2),
            figure(Some(errors.over_20 * 100.0), 0) + " %"
        );
    }
    html.push_str("</table>\n<p>Absolute azimuth errors against the bearing from the mean pose, degrees.</p>\n");
}

fn links(html: &mut String, shown: &[LinkShown], is_judged: bool) {
    let _ = writeln!(
        html,
        "<table><tr><th>link</th><th>azimuth</th><th>&plusmn;</th><th>mirror</th>{}<th>probability within 5</th>\
         <th>coherence</th><th>range, m</th><th>pairs</th></tr>",
        if is_judged { "<th>truth</th><th>error</th>" } else { "" }
    );
    for LinkShown { row, .. } in shown {
        let answer = &row.answer;
        let is_off = row.error_from_mean_pose_deg.is_some_and(|error| error.abs() > 20.0);
        let judged = format!(
            "<td>{}</td><td{}>{}</td>",
            figure(row.true_from_mean_pose_deg, 2),
            if is_off { " class=\"bad\"" } else { "" },
            figure(row.error_from_mean_pose_deg, 2)
        );
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{}<td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&answer.link),
            figure(answer.azimuth_deg, 2),
            figure(answer.azimuth_sd_deg, 2),
            figure(answer.mirror_deg, 2),
            if is_judged { judged } else { String::new() },
            figure(answer.confidence, 2),
            figure(answer.coherence, 2),
            figure(answer.range_m, 2),
            answer.pairs_in_motion
        );
    }
    html.push_str("</table>\n");
}

/// What was lost, of the logs that lost something, and what was said of it.
fn losses(html: &mut String, shown: &[LinkShown], notes: &[String]) {
    let sides =
        |row: &Judged| [("receiver", row.answer.receiver_records), ("transmitter", row.answer.transmitter_records)];
    let lost: Vec<_> = shown
        .iter()
        .flat_map(|link| sides(&link.row).map(|(log, side)| (&link.row.answer.link, log, side)))
        .filter(|(_, _, side)| {
            side.unpaired + side.missing + side.duplicates + side.implausible + side.mispaired + side.restarts > 0
        })
        .collect();
    if lost.is_empty() && notes.is_empty() {
        return;
    }
    html.push_str(
        "<h2>Losses</h2>\n<table><tr><th>link</th><th>log</th><th>frames</th><th>paired</th><th>unpaired</th>\
         <th>numbers missing</th><th>duplicates</th><th>implausible</th><th>other sessions</th><th>restarts</th></tr>\n",
    );
    for (link, log, side) in lost {
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{log}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td></tr>",
            escape(link),
            side.handed,
            side.paired,
            side.unpaired,
            side.missing,
            side.duplicates,
            side.implausible,
            side.mispaired,
            side.restarts
        );
    }
    html.push_str("</table>\n");
    for note in notes {
        let _ = writeln!(html, "<p class=\"note\">{}</p>", escape(note));
    }
}

fn details(html: &mut String, link: &LinkShown, open: bool) {
    let answer = &link.row.answer;
    let head = match (&answer.error, answer.azimuth_deg) {
        (Some(error), _) => error.clone(),
        (None, Some(azimuth)) => format!("{} deg", crate::words::fixed(azimuth, 2)),
        (None, None) => "no bearing".into(),
    };
    let open = if open { " open" } else { "" };
    let _ = writeln!(html, "<details{open}><summary>{}: {}</summary>", escape(&answer.link), escape(&head));
    let counts = &answer.pair_counts;
    let _ = writeln!(
        html,
        "<p>{} formed: {} in motion ({}), {} standing, {} without a pose, {} cut, {} silent, {} thinned. {}</p>",
        crate::words::count(counts.formed as u64, "pair", "pairs"),
        counts.in_motion,
        escape(answer.geometry.as_deref().unwrap_or("of no known kind")),
        counts.standing,
        counts.no_pose,
        counts.cut,
        counts.silent,
        counts.thinned,
        compensation(answer)
    );
    for (k, picture) in link.pictures.iter().enumerate() {
        let _ = writeln!(html, "<figure>{}</figure>", apart(picture, &format!("{}-{k}-", answer.link)));
    }
    html.push_str("</details>\n");
}

/// What the compensation of the clocks did, where it is known.
fn compensation(answer: &Answer) -> String {
    let offset = answer.cfo_hz.map(|hz| format!("Carrier offset {hz:.0} Hz. "));
    let coherence = answer.phase_coherence_before.zip(answer.phase_coherence_after);
    let coherence = coherence
        .map(|(before, after)| format!("Phase coherence {before:.2} before and {after:.2} after compensation. "));
    let none = "The turn-around was not compensated: the clocks do not show it.";
    match (offset, coherence) {
        (None, None) => none.into(),
        (offset, coherence) => offset.unwrap_or_default() + &coherence.unwrap_or_default(),
    }
}

/// An SVG ready to stand in a page with others: without its XML head, as large as there is room, its ids its own.
fn apart(svg: &str, prefix: &str) -> String {
    let body = svg.find("<svg").and_then(|from| svg.get(from..)).unwrap_or(svg);
    let head = body.split('>').next().unwrap_or_default();
    let size = |name: &str| head.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0.parse::<f64>().ok();
    let whole = size("width").zip(size("height")).filter(|_| !head.contains("viewBox"));
    // Without it a picture that is made smaller is cut instead.
    let whole = whole.map_or_else(String::new, |(width, height)| format!("<svg viewBox=\"0 0 {width} {height}\""));
    let body = if whole.is_empty() { body.to_owned() } else { body.replacen("<svg", &whole, 1) };
    let prefix: String = prefix.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    body.replace("id=\"", &format!("id=\"{prefix}"))
        .replace("url(#", &format!("url(#{prefix}"))
        .replace("href=\"#", &format!("href=\"#{prefix}"))
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "-".into(), |value| crate::words::fixed(value, digits))
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_outside_cannot_become_markup_and_ids_do_not_clash() {
        let mut row = Judged::default();
        row.answer.link = "<script>x</script>/tx2".into();
        let svg = "<?xml?><svg width=\"800\" height=\"600.5\"><g id=\"a\"/><use href=\"#a\"/></svg>".to_owned();
        let rows = [row.clone()];
        let html = page("a&b", &[LinkShown { row, pictures: vec![svg] }], &rows, &[], &[]);
        assert!(!html.contains("<script>") && html.contains("a&amp;b"));
        assert!(!html.contains("<?xml") && !html.contains("id=\"a\""), "{html}");
        assert!(html.contains("<svg viewBox=\"0 0 800 600.5\" width=\"800\""), "{html}");
    }

    #[test]
    fn a_link_whose_pictures_cannot_be_drawn_is_a_loss() {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
        let (captures, _) = crate::evaluate::find_all(&fixture);
        let mut report = HtmlReport::with_pictures(fixture.join("groundtruth_positions.json"));
        let options = Options::new("108".parse().unwrap()).with_keep_course(true);
        report.add(&captures[0], TrajectorySource::GroundTruth, None, &options);
        assert!(report.lost() && report.notes().len() == 1, "{:?}", report.notes());
        // That of all links together is another one.
        let html = report.html("t");
        assert!(report.notes().len() == 2 && html.matches("class=\"note\"").count() == 2, "{:?}", report.notes());
    }

    #[test]
    fn errors_and_losses_are_shown_where_there_are_any() {
        let link = |change: fn(&mut Judged)| {
            let mut row = Judged::default();
            row.answer.link = "a/tx1".into();
            change(&mut row);
            row
        };
        let of = |row: Judged| page("t", &[LinkShown { row: row.clone(), pictures: vec![] }], &[row], &[], &[]);
        let plain = of(link(|_| {}));
        assert!(
            !plain.contains("<h2>Errors") && !plain.contains("<th>truth") && !plain.contains("<h2>Losses"),
            "{plain}"
        );
        let judged = of(link(|row| {
            (row.true_from_mean_pose_deg, row.error_from_mean_pose_deg) = (Some(10.0), Some(30.0));
        }));
        assert!(judged.contains("<h2>Errors") && judged.contains("class=\"bad\">30.00"), "{judged}");
        let lossy = of(link(|row| row.answer.receiver_records.missing = 3));
        assert!(lossy.contains("<h2>Losses") && lossy.contains("<td>receiver</td>"), "{lossy}");
        assert!(!lossy.contains("<td>transmitter</td>"), "{lossy}");
    }
}
