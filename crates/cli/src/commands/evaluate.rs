//! `csi5300 evaluate`.

use super::args::{A_CAPTURE, Estimation, Mounting, Which, add_names, antenna, reading};
use super::{InWords, Outcome, Result, Words, fixed, print, print_json, usage};
use csi5300::maths::median;
use csi5300::pipeline::JoinBy;
use csi5300::signal::channel::Channel;
use csi5300_lab::evaluate::quality::{Ranges, Table, over_bound, ranges, risk_coverage, sets, sure};
use csi5300_lab::evaluate::receivers::receivers;
use csi5300_lab::evaluate::{
    ALL_SETS, Capture, Errors, Evaluated, Judged, SetSummary, TrajectorySource, find, reliability, summarise,
};
use csi5300_lab::show::results::write_set;
use csi5300_view::{Reading, View};
use driver_iface::bfee::Antenna;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

// Arguments of `evaluate`.
#[derive(clap::Args)]
pub struct Args {
    /// Folders with captures, as in the WSR data set
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Write the page of `csi5300 view` for one DIR as one file, with captures without a truth
    #[arg(long, value_name = "OUT.html")]
    html: Option<PathBuf>,
    /// Draw error distributions, refusals, reliability and a map of each place into this folder
    #[arg(long, visible_alias = "out", value_name = "DIR")]
    #[arg(conflicts_with = "html")]
    plot: Option<PathBuf>,
    /// Which trajectory of captures to use
    #[arg(long, value_enum, default_value = "gt")]
    trajectory: Which,
    #[command(flatten)]
    mounting: Mounting,
    /// WiFi channel, with + or - for 40 MHz [default: the capture's]
    #[arg(long, value_name = "NUMBER")]
    channel: Option<Channel>,
    /// Antenna (RF port) used on both robots: A, B or C
    #[arg(long, default_value = "A", value_parser = antenna, hide = true)]
    antenna: Antenna,
    /// Seconds from the receivers' host times to the trajectories'
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", allow_negative_numbers = true, hide = true)]
    clock_offset: f64,
    /// Standard deviation of the trajectories' heading [default: the sensor's]
    #[arg(long, value_name = "DEGREES")]
    heading_sd: Option<f64>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    #[arg(conflicts_with = "html")]
    json: bool,
    /// Overwrite existing outputs
    #[arg(long, requires = "html")]
    force: bool,
}

impl Args {
    fn reading(&self) -> Reading {
        let estimation = Estimation {
            antenna: vec![self.antenna],
            clock_offset: (self.clock_offset, JoinBy::Time),
            heading_sd: self.heading_sd,
            ..Estimation::default()
        };
        reading(self.trajectory, &self.mounting, self.channel, &estimation)
    }
}

/// Evaluates a tree of captures.
pub fn run(args: &Args) -> Result {
    if let Some(out) = &args.html {
        return page(args, out);
    }
    let reading = args.reading();
    let mut options = reading.options.clone();
    options.figures = args.json;
    let (captures, unreadable) = find_all(args.folders.iter())?;
    let captures = reading.mounted(captures);
    for folder in &unreadable {
        wrong!("cannot read {folder}");
    }
    let (others, others_lost) = beside(args, reading.source);
    let bar = super::bar(captures.len() as u64, &super::some(captures.len() as u64, "capture", "captures"));
    let one = |capture: &Capture| {
        let mut evaluated = capture.evaluate(reading.source, reading.channel, &options);
        super::hint::add_all(&mut evaluated.rows);
        bar.inc();
        evaluated
    };
    let results: Vec<Evaluated> = captures.par_iter().map(one).collect();
    bar.clear();
    for note in results.iter().flat_map(|result| &result.notes) {
        note!("{note}");
    }
    let lost = !unreadable.is_empty() || others_lost || results.iter().any(|result| result.lost);
    let rows: Vec<Judged> = results.into_iter().flat_map(|result| result.rows).collect();
    let shown = show(args, &rows, &others);
    for row in rows.iter().filter(|row| row.answer.error.is_some()) {
        wrong!("{}: {}", row.answer.link, row.answer.error.as_deref().unwrap_or_default());
    }
    shown?;
    Ok(Outcome::of(rows.iter().any(|row| row.answer.azimuth_deg.is_some()), lost))
}

/// Writes the page of `view` as one file.
fn page(args: &Args, out: &std::path::Path) -> Result {
    let [folder] = args.folders.as_slice() else { usage("--html takes one folder") };
    let is_html = |ending: &std::ffi::OsStr| ["html", "htm"].iter().any(|own| ending.eq_ignore_ascii_case(own));
    // Devices take anything.
    if !out.extension().is_none_or(is_html) && (out.is_file() || !out.exists()) {
        usage(&format!("{}: the page is HTML: .html", out.display()));
    }
    // Before the work; written at its end.
    drop(super::draft::Draft::create(out, args.force)?);
    let reading = args.reading();
    super::args::find(&reading, folder)?;
    let view = View::open(folder, reading).in_words()?;
    view.finish(|done| super::progress(&format!("{done} of {} links", view.links())));
    super::progress("");
    let page = view.file().in_words()?;
    super::draft::write(out, &page)?;
    let (notes, failed) = view.said();
    notes.iter().for_each(|line| note!("{line}"));
    failed.iter().for_each(|line| wrong!("{line}"));
    let links = super::some(view.links() as u64, "link", "links");
    note!("{}: {links}, {} KiB", out.display(), page.len() / 1024);
    let (used, lost) = view.outcome();
    Ok(Outcome::of(used || view.links() == 0, lost))
}

/// What another program answers on the links, from the tables beside the captures, if pictures are drawn; and whether some of it could not be
/// read.
fn beside(args: &Args, source: TrajectorySource) -> (Vec<Table>, bool) {
    let (mut others, mut lost) = (Vec::new(), false);
    for folder in args.folders.iter().filter(|_| args.plot.is_some()) {
        let (table, words) = Table::noted(folder, source);
        others.extend(table);
        words.iter().for_each(|words| note!("{words}"));
        lost |= words.is_some();
    }
    (others, lost)
}

/// The captures below all folders, and folders that could not be read.
fn find_all<'a>(folders: impl Iterator<Item = &'a PathBuf>) -> Words<(Vec<Capture>, Vec<String>)> {
    let (mut captures, mut unreadable) = (Vec::new(), Vec::new());
    for folder in folders {
        if !folder.is_dir() {
            let name = folder.display();
            return Err(match folder.exists() {
                true => format!("{name} is not a folder: put the files of a capture into one, and name that"),
                false => format!("{name}: no such folder"),
            });
        }
        let (found, failed) = find(folder);
        add_names(&found, &failed);
        if found.is_empty() {
            let without = csi5300_lab::evaluate::find_all(folder).0.len();
            return Err(match without {
                0 => format!("no capture below {}: {A_CAPTURE}", folder.display()),
                _ => format!(
                    "no capture with a truth below {} (groundtruth_positions.json); {} without one: `view`, \
                     `bearing` and --html take {}",
                    folder.display(),
                    super::some(without as u64, "capture", "captures"),
                    if without == 1 { "it" } else { "them" }
                ),
            });
        }
        for capture in found {
            capture.add_to(&mut captures);
        }
        unreadable.extend(failed);
    }
    Ok((captures, unreadable))
}

/// Prints rows and summary, and draws the requested pictures.
fn show(args: &Args, rows: &[Judged], others: &[Table]) -> Words<()> {
    let summary = summarise(rows);
    if args.json {
        rows.iter().for_each(print_json);
        print_json(&BTreeMap::from([("summary", &summary)]));
    } else {
        print(&table(rows, &summary));
        if csi5300_say::says(csi5300_say::Level::Verbose) {
            print(&worth(rows));
        }
    }
    if let Some(folder) = &args.plot {
        let written = super::draft::pictures(folder, |folder| write_set(rows, others, folder))?;
        let pictures = super::files::first_of_each(&written).count() as u64;
        note!("{}: {}", folder.display(), super::some(pictures, "picture", "pictures"));
    }
    Ok(())
}

fn table(rows: &[Judged], summary: &BTreeMap<String, SetSummary>) -> String {
    let width = rows.iter().map(|row| row.answer.link.len()).max().unwrap_or(4).max(4);
    let row_of = |link: &str, [azimuth, sd, mirror, truth, error, sure, pairs]: [&str; 7]| {
        format!("{link:width$}  {azimuth:>9} {sd:>6} {mirror:>9} {truth:>9} {error:>9} {sure:>5} {pairs:>6}\n")
    };
    let mut text = row_of("link", ["azimuth", "+-", "mirror", "truth", "error", "sure", "pairs"]);
    text += &row_of("", ["deg", "deg", "deg", "deg", "deg", "%", ""]);
    let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| fixed(value, digits));
    for row in rows {
        let a = &row.answer;
        let cells = [
            number(a.azimuth_deg, 2),
            number(a.azimuth_sd_deg, 2),
            number(a.mirror_deg, 2),
            number(row.true_from_mean_pose_deg, 2),
            number(row.error_from_mean_pose_deg, 2),
            number(a.confidence.map(|confidence| 100.0 * confidence), 0),
            a.pairs_in_motion.to_string(),
        ];
        text += &row_of(&a.link, cells.each_ref().map(String::as_str));
    }
    text += "sure: probability that the azimuth is within 5 degrees\n";
    let _ = writeln!(text, "\nabsolute error, degrees: mean / median / 90th percentile / share over 20 degrees");
    for (set, s) in all_last(summary) {
        let without = s.links - s.failed - s.from_mean_pose.links;
        let without = if without > 0 { format!(", {without} without a truth") } else { String::new() };
        let _ = writeln!(
            text,
            "{set}: {}, {} failed{without}; from the mean pose {}; from the start {}",
            super::some(s.links as u64, "link", "links"),
            s.failed,
            line(&s.from_mean_pose),
            line(&s.from_start)
        );
    }
    text
}

/// Sets in their order, then all of them together.
fn all_last<T>(sets: &BTreeMap<String, T>) -> impl Iterator<Item = (&String, &T)> {
    let named = |all: bool| sets.iter().filter(move |(set, _)| (*set == ALL_SETS) == all);
    named(false).chain(named(true))
}

fn line(errors: &Errors) -> String {
    let Errors { links, mean_deg, median_deg, p90_deg, over_20, .. } = errors;
    if *links == 0 {
        return "-".into();
    }
    format!("{mean_deg:.2} / {median_deg:.2} / {p90_deg:.2} / {:.1} %", over_20 * 100.0)
}

/// Refusals, reliability, ranges and receivers.
fn worth(rows: &[Judged]) -> String {
    let mut text = String::from("\nkept  least confidence  error from the mean pose\n");
    for kept in risk_coverage(rows) {
        let _ =
            writeln!(text, "{:3.0} %  {:.2}              {}", kept.share * 100.0, kept.confidence, line(&kept.errors));
    }
    text += "\nconfidence  links  said  within 5 degrees\n";
    for bin in reliability(&sure(rows)) {
        let (from, to) = (bin.from, bin.to);
        let _ = writeln!(text, "{from:.1} .. {to:.1}  {:5}  {:.2}  {:.2}", bin.links, bin.said, bin.right);
    }
    let located = receivers(rows);
    for (set, own) in sets(rows) {
        let mut off: Vec<f64> = located
            .iter()
            .filter(|r| r.capture == set || r.capture.starts_with(&format!("{set}/")))
            .filter_map(|r| r.off_m)
            .collect();
        let mut parts: Vec<String> = Vec::new();
        parts.extend(over_bound(&own).map(|over| format!("error over error bar {over:.2}")));
        parts.extend(range_words(&ranges(&own)));
        let located = super::some(off.len() as u64, "receiver", "receivers");
        parts.extend(median(&mut off).map(|off| format!("{located} located, median error {off:.2} m")));
        if !parts.is_empty() {
            let _ = writeln!(text, "{set}: {}", parts.join("; "));
        }
    }
    text
}

/// Errors of the ranges of a set, if some are known.
fn range_words(ranges: &Ranges) -> Option<String> {
    let median_m = ranges.median_m?;
    let links = super::some(ranges.links as u64, "link", "links");
    let over = ranges.over_bound.map_or(String::new(), |over| format!(", {over:.2} of the predicted deviation"));
    let [places, within_68, within_95] = ranges.places;
    let ellipses = match places {
        0 => String::new(),
        _ => format!("; of {places} places {within_68} within the 68 % ellipse, {within_95} within the 95 % one"),
    };
    Some(format!("range from {} of {links}, median error {median_m:.2} m{over}{ellipses}", ranges.reported))
}
