//! Verdicts as text, JSON, JUnit XML, an entry for the bench log, and one HTML page: a table and the curves as SVG, without
//! a script.

use crate::claims::{CLAIMS, Claim};
use crate::evidence::{Evidence, Heard};
use crate::stats::quantile;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::fmt::{self, Write as _};

/// The verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It holds.
    Holds,
    /// It fails.
    Fails,
    /// It has no expected range; its figures are the result.
    Measured,
    /// It could not be decided; the finding gives the reason.
    NotTried,
}

impl Verdict {
    /// As the table has it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Fails => "FAILS",
            Self::Measured => "measured",
            Self::NotTried => "not tried",
        }
    }
}

/// What a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Of {
    /// The first robot's card.
    Near,
    /// The second robot's card.
    Far,
    /// Both.
    Link,
    /// The host that runs the program.
    Host,
}

impl Of {
    /// As the table has it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Far => "far",
            Self::Link => "link",
            Self::Host => "host",
        }
    }
}

/// A number that a claim was judged by.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Its name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its unit; empty of a count.
    pub unit: &'static str,
}

/// One claim's verdict.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// The claim's identity.
    pub id: &'static str,
    /// What it is about.
    pub of: Of,
    /// Its verdict.
    pub verdict: Verdict,
    /// The finding in words.
    pub found: String,
    /// The finding in numbers.
    pub figures: Vec<Figure>,
}

/// Findings of one claim with one verdict: of one card, the link, the host, or both cards.
struct Row<'a> {
    finding: &'a Finding,
    /// What they are about.
    of: &'static str,
    /// The findings; for both cards each one's, if they differ.
    found: Vec<String>,
}

impl Finding {
    /// The claim; every finding has one.
    #[must_use]
    pub fn claim(&self) -> Option<&'static Claim> {
        CLAIMS.iter().find(|claim| claim.id == self.id)
    }
}

/// A curve of the report.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// Its title.
    pub title: &'static str,
    /// What the horizontal axis is, with its unit.
    pub x: &'static str,
    /// What the vertical axis is, with its unit.
    pub y: &'static str,
    /// Names of the series, and their points.
    pub series: Vec<(&'static str, Vec<(f64, f64)>)>,
}

/// What a log is.
#[derive(Clone, Debug, Serialize)]
pub struct LogFacts {
    /// Whose.
    pub of: Of,
    /// Records with CSI.
    pub records: usize,
    /// Bytes of the log.
    pub bytes: usize,
    /// SHA-256 of them, hexadecimal.
    pub sha256: String,
}

impl LogFacts {
    fn new(of: Of, heard: &Heard) -> Self {
        let sha256 = format!("{:x}", Sha256::digest(&heard.log));
        Self { of, records: heard.records.len(), bytes: heard.log.len(), sha256 }
    }
}

/// All verdicts. It contains no person, place, host or MAC address.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of this form.
    pub format: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The system under test, in lines of `name: value` from the caller.
    pub facts: Vec<String>,
    /// The logs: whose, records with CSI, bytes, SHA-256.
    pub logs: Vec<LogFacts>,
    /// The verdicts.
    pub findings: Vec<Finding>,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// Text for XML and HTML.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            letter if letter.is_control() && letter != '\n' => {}
            letter => out.push(letter),
        }
    }
    out
}

impl Report {
    pub(crate) fn new(evidence: &Evidence, findings: Vec<Finding>) -> Self {
        let far = evidence.far.as_ref().map(|far| LogFacts::new(Of::Far, far));
        let logs = std::iter::once(LogFacts::new(Of::Near, &evidence.near)).chain(far).collect();
        Self {
            format: 1,
            version: env!("CARGO_PKG_VERSION"),
            facts: Vec::new(),
            logs,
            findings,
            curves: curves(evidence),
        }
    }

    /// Claims that fail.
    pub fn failed(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.verdict == Verdict::Fails)
    }

    /// The findings with a verdict, those of both cards together.
    fn rows(&self, verdict: Verdict) -> Vec<Row<'_>> {
        let mut findings = self.findings.iter().filter(|finding| finding.verdict == verdict).peekable();
        let mut rows = Vec::new();
        while let Some(finding) = findings.next() {
            let far = findings.next_if(|next| next.id == finding.id);
            let of = if far.is_some() { "both" } else { finding.of.word() };
            let found = match far {
                Some(far) if far.found != finding.found => {
                    vec![format!("near: {}", finding.found), format!("far: {}", far.found)]
                }
                _ => vec![finding.found.clone()],
            };
            rows.push(Row { finding, of, found });
        }
        rows
    }

    /// How many findings have this verdict.
    #[must_use]
    pub fn count(&self, verdict: Verdict) -> usize {
        self.findings.iter().filter(|finding| finding.verdict == verdict).count()
    }

    /// How many fail, hold, are measured and were not tried.
    fn tally(&self) -> [usize; 4] {
        [Verdict::Fails, Verdict::Holds, Verdict::Measured, Verdict::NotTried].map(|verdict| self.count(verdict))
    }

    /// As JSON.
    ///
    /// # Errors
    /// Never, in practice: every part of it can be written.
    pub fn json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }

    /// As JUnit XML, which labgrid and continuous integration read: a failed claim is a failure, one that was not tried is skipped.
    #[must_use]
    pub fn junit(&self) -> String {
        let (tests, failures, skipped) =
            (self.findings.len(), self.count(Verdict::Fails), self.count(Verdict::NotTried));
        let mut xml = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"csi5300\" tests=\"{tests}\" failures=\"{failures}\" skipped=\"{skipped}\">\n"
        );
        for finding in &self.findings {
            let (id, of, found) = (finding.id, finding.of.word(), escaped(&finding.found));
            let result = match finding.verdict {
                Verdict::Fails => {
                    let advice = escaped(&finding.claim().map(Claim::advice).unwrap_or_default());
                    format!("<failure message=\"{found}\">{advice}</failure>")
                }
                Verdict::NotTried => format!("<skipped message=\"{found}\"/>"),
                Verdict::Holds | Verdict::Measured => format!("<system-out>{found}</system-out>"),
            };
            let _ = writeln!(xml, "  <testcase classname=\"{of}\" name=\"{id}\">{result}</testcase>");
        }
        xml.push_str("</testsuite>\n");
        xml
    }

    /// As one HTML page with the curves, each drawn as an SVG by `draw`.
    #[must_use]
    pub fn html(&self, draw: impl Fn(&Curve) -> String) -> String {
        let mut page = String::from(
            "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>csi5300: what holds on this desk</title><style>\
             body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24}\
             table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #d8dee4;vertical-align:top}\
             .holds{color:#1a7f37}.fails{color:#b42318;font-weight:600}.measured{color:#0b62a4}.not_tried{color:#6e7781}\
             svg{width:100%;height:auto;max-width:42rem}\
             small{color:#57606a}li{margin:.15rem 0}</style>\n<h1>What holds on this desk</h1>\n",
        );
        let [fail, hold, measured, not_tried] = self.tally();
        let _ = writeln!(
            page,
            "<p><b class=\"fails\">{fail} fail</b>, <b class=\"holds\">{hold} hold</b>, {measured} measured, {not_tried} not tried. csi5300 {}</p>",
            self.version
        );
        if !self.facts.is_empty() {
            page.push_str("<ul>");
            for fact in &self.facts {
                let _ = write!(page, "<li>{}</li>", escaped(fact));
            }
            page.push_str("</ul>\n");
        }
        table(&mut page, self, &[Verdict::Fails]);
        for curve in &self.curves {
            let _ = writeln!(page, "<h2>{}</h2>{}", escaped(curve.title), draw(curve));
        }
        page.push_str("<h2>Everything else</h2>\n");
        table(&mut page, self, &[Verdict::Measured, Verdict::Holds, Verdict::NotTried]);
        page
    }

    /// As an entry for a bench log, in Markdown.
    #[must_use]
    pub fn entry(&self, date: &str) -> String {
        let mut text = format!("## Recorded {date}, judged by csi5300 {}\n\n", self.version);
        for fact in &self.facts {
            let _ = writeln!(text, "- {fact}");
        }
        for log in &self.logs {
            let LogFacts { of, records, bytes, sha256 } = log;
            let _ = writeln!(text, "- {} log: {records} records, {bytes} bytes, SHA-256 {sha256}", of.word());
        }
        text.push_str("\n| claim | of | verdict | found |\n|---|---|---|---|\n");
        for finding in &self.findings {
            let found = finding.found.replace('|', "/");
            let _ = writeln!(text, "| {} | {} | {} | {found} |", finding.id, finding.of.word(), finding.verdict.word());
        }
        text
    }
}

impl fmt::Display for Report {
    /// Failures with causes and the next command (the host's last, because they do not concern a card), measured
    /// figures, and the names of claims that hold or were not tried; in the alternate form (`{:#}`) a line for each
    /// finding.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wide = self.findings.iter().map(|finding| finding.id.len()).max().unwrap_or(0);
        for verdict in [Verdict::Fails, Verdict::Measured, Verdict::Holds, Verdict::NotTried] {
            if !out.alternate() && matches!(verdict, Verdict::Holds | Verdict::NotTried) {
                self.names(out, verdict)?;
                continue;
            }
            let mut rows = self.rows(verdict);
            rows.sort_by_key(|row| row.finding.of == Of::Host);
            for Row { finding, of, found } in rows {
                writeln!(out, "{:9}  {:wide$}  {of:4}  {}", verdict.word(), finding.id, found.join("; "))?;
                if let Some(claim) = finding.claim().filter(|_| verdict == Verdict::Fails) {
                    writeln!(
                        out,
                        "           the claim: {} (expected: {}; {})",
                        claim.says, claim.expected, claim.source
                    )?;
                    for (nth, cause) in claim.causes.iter().enumerate() {
                        writeln!(out, "           cause {}: {cause}", nth + 1)?;
                    }
                    writeln!(out, "           next: {}", claim.next)?;
                }
            }
        }
        let [fail, hold, measured, not_tried] = self.tally();
        let twice = "(a claim about each card counts twice)";
        writeln!(out, "{fail} fail, {hold} hold, {measured} measured, {not_tried} not tried {twice}")
    }
}

impl Report {
    /// The names of the claims with a verdict, in lines of at most 110 letters, with the card if the cards differ.
    fn names(&self, out: &mut fmt::Formatter<'_>, verdict: Verdict) -> fmt::Result {
        let name = |row: &Row<'_>| {
            let is_of_one = matches!(row.of, "near" | "far") && self.logs.len() > 1;
            if is_of_one { format!("{} ({})", row.finding.id, row.of) } else { row.finding.id.to_owned() }
        };
        let names: Vec<String> = self.rows(verdict).iter().map(name).collect();
        let mut line = format!("{:9} ", verdict.word());
        for (nth, name) in names.iter().enumerate() {
            let end = if nth + 1 < names.len() { "," } else { "" };
            if line.len() + name.len() > 108 {
                writeln!(out, "{}", line.trim_end())?;
                line = " ".repeat(10);
            }
            let _ = write!(line, " {name}{end}");
        }
        if names.is_empty() { Ok(()) } else { writeln!(out, "{line}") }
    }
}

/// Points of a curve at most.
const POINTS: usize = 400;

/// Every n-th of the points, so that at most [`POINTS`] are left.
fn thinned(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let step = points.len().div_ceil(POINTS).max(1);
    points.into_iter().step_by(step).collect()
}

fn curves(evidence: &Evidence) -> Vec<Curve> {
    let titles = [
        ("RSSI of the near card by antenna", "Host clock against card clock, near card"),
        ("RSSI of the far card by antenna", "Host clock against card clock, far card"),
    ];
    let mut curves = Vec::new();
    for (heard, titles) in [Some(&evidence.near), evidence.far.as_ref()].into_iter().flatten().zip(titles) {
        curves.push(rssi(heard, titles.0));
        curves.extend(clock(heard, titles.1));
    }
    curves.extend(phase(evidence));
    if !evidence.lateness_us.is_empty() {
        let points = (1..100).filter_map(|k| {
            let share = f64::from(k) / 100.0;
            quantile(&evidence.lateness_us, share).map(|us| (us, share))
        });
        curves.push(Curve {
            title: "How late the host wakes",
            x: "late by (us)",
            y: "share of wakes that are no later",
            series: vec![("host", points.collect())],
        });
    }
    curves
}

fn rssi(heard: &Heard, title: &'static str) -> Curve {
    let of = |antenna: usize| {
        let first = heard.records.first().map_or(0, |record| record.card_us);
        let points = heard.records.iter().filter_map(|record| {
            let rssi = record.head.rssi.get(antenna).copied().filter(|rssi| *rssi > 0)?;
            Some(((record.card_us - first) as f64 * 1e-6, f64::from(rssi)))
        });
        thinned(points.collect())
    };
    Curve {
        title,
        x: "card's clock (s)",
        y: "RSSI (dB above the card's reference)",
        series: vec![("A", of(0)), ("B", of(1)), ("C", of(2))],
    }
}

fn clock(heard: &Heard, title: &'static str) -> Option<Curve> {
    let records = &heard.records;
    let first = records.iter().find_map(|record| Some((record.card_us, record.host_us?)))?;
    let points = records.iter().filter_map(|record| {
        let host = record.host_us? - first.1;
        let card = record.card_us - first.0;
        Some((card as f64 * 1e-6, (host - card) as f64 * 1e-3))
    });
    Some(Curve {
        title,
        x: "card's clock (s)",
        y: "host less card (ms)",
        series: vec![("host less card", thinned(points.collect()))],
    })
}

/// The change of the product's phase between exchanges against that of their turn-arounds: the effect of the CFO.
fn phase(evidence: &Evidence) -> Option<Curve> {
    let pairs = evidence.pairs.as_ref()?;
    let mut compensated = pairs.product.clone();
    pairs.compensation.as_ref()?.apply(&mut compensated);
    let spread = |z: &[num_complex::Complex64]| {
        let points = z.windows(2).zip(pairs.turn_us.windows(2)).filter_map(|(z, turn)| {
            let ([before, now], [turn_before, turn_now]) = (z, turn) else { return None };
            Some((turn_now - turn_before, (now * before.conj()).arg()))
        });
        thinned(points.collect())
    };
    Some(Curve {
        title: "Phase of the round trip against turn-around, from exchange to exchange",
        x: "change of the turn-around (us)",
        y: "change of the phase (rad)",
        series: vec![("as measured", spread(&pairs.product)), ("compensated", spread(&compensated))],
    })
}

/// A table of the findings with these verdicts; equal verdicts of both cards share a row.
fn table(page: &mut String, report: &Report, verdicts: &[Verdict]) {
    if !report.findings.iter().any(|finding| verdicts.contains(&finding.verdict)) {
        return;
    }
    page.push_str("<table><tr><th>verdict<th>claim<th>of<th>found</tr>\n");
    for verdict in verdicts {
        let class = verdict.word().to_lowercase().replace(' ', "_");
        for Row { finding, of, found } in report.rows(*verdict) {
            let found: Vec<String> = found.iter().map(|found| escaped(found)).collect();
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
