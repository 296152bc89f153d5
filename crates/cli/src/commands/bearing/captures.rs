//! Bearings of captures: folders with the logs of a receiver and its transmitters, a trajectory and perhaps the truth; receivers and
//! transmitters located from them.

use super::Args;
use super::words::{describe, digits, doubts, explain_lines, in_a_line, is_short, pairs};
use crate::commands::args::{Which, find, reading};
use crate::commands::{InWords, Outcome, Result, Words, fixed, hint, print, print_json, some, usage};
use clap::ValueEnum;
use csi5300::maths::median;
use csi5300::pipeline::{Answer, Bearing, CandidateAnswer, LinkPlan, Options};
use csi5300_lab::evaluate::receivers::{Located, Ranged, Receiver, Shared, UNKNOWN_PROBABILITY, receivers_with};
use csi5300_lab::evaluate::transmitters::{Frame, LocatedTransmitter, located};
use csi5300_lab::evaluate::{Capture, Judged};
use csi5300_lab::show::results::write_maps;
use csi5300_team::factors;
use csi5300_team::ranges::{Range, read};
use csi5300_view::Reading;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Where a transmitter is, and how high if that was given, metres.
pub type Place = ([f64; 2], Option<f64>);

/// A transmitter's name and place.
pub fn place(text: &str) -> Words<(String, Place)> {
    let near =
        |(_, numbers): &(_, Vec<f64>)| numbers.iter().all(|metres| metres.abs() <= crate::commands::args::FURTHEST_M);
    let parts = named_numbers(text).filter(near).and_then(|(name, numbers)| match numbers[..] {
        [x, y] => Some((name.to_owned(), ([x, y], None))),
        [x, y, z] => Some((name.to_owned(), ([x, y], Some(z)))),
        _ => None,
    });
    parts.ok_or_else(|| "a name and two or three numbers of metres (at most 1e6), such as tx2=-3.18,1.11".into())
}

/// A name and finite numbers: `NAME=1,2`.
fn named_numbers(text: &str) -> Option<(&str, Vec<f64>)> {
    let (name, numbers) = text.split_once('=').filter(|(name, _)| !name.is_empty())?;
    Some((name, crate::commands::args::numbers(numbers)?))
}

impl Args {
    /// How captures are read.
    fn reading(&self) -> Reading {
        let named = self.logs.trajectory.as_deref().map(|name| {
            let which = name.to_str().and_then(|name| Which::from_str(name, false).ok());
            which.unwrap_or_else(|| usage("for a capture, --trajectory is gt, t265 or odom: it has its own files"))
        });
        reading(named.unwrap_or(Which::Gt), &self.mounting, self.channel, &self.estimation)
    }

    /// Ends the program if a transmitter with a given place is in no capture.
    fn check_places(&self, captures: &[Capture]) {
        let known: BTreeSet<&str> =
            captures.iter().flat_map(|own| &own.transmitters).map(|(name, _)| name.as_str()).collect();
        if let Some((name, _)) = self.place.iter().find(|(name, _)| !known.contains(name.as_str())) {
            let known = known.into_iter().collect::<Vec<_>>().join(", ");
            usage(&format!("--place {name}=...: no transmitter has this name; there are {known}"));
        }
        let names = || self.place.iter().map(|(name, _)| name).enumerate();
        if let Some((_, name)) = names().find(|(k, name)| names().take(*k).any(|(_, other)| other == *name)) {
            usage(&format!("--place {name}=... is given twice: a transmitter has one place"));
        }
    }

    /// The named captures with their requested links, and whether some could not be read. Of several folders, each
    /// one's name precedes its captures' names.
    fn find(&self, reading: &Reading) -> Words<(Vec<Capture>, Vec<String>, bool)> {
        let (mut captures, mut links, mut lost) = (Vec::new(), Vec::new(), false);
        for named in &self.captures {
            let (folder, wanted) = parts(named);
            let (mut found, unreadable) = find(reading, &folder)?;
            unreadable.iter().for_each(|folder| wrong!("cannot read {folder}"));
            lost |= !unreadable.is_empty();
            let own = folder.file_name().map(|name| name.to_string_lossy().into_owned());
            if let Some(own) = own.filter(|_| self.captures.len() > 1) {
                let named = |place: &str| if place.is_empty() { own.clone() } else { format!("{own}/{place}") };
                found.iter_mut().for_each(|capture| capture.place = named(&capture.place));
            }
            let is_named = |own: &Capture, tx: &str| is_wanted(&own.link_name(tx), wanted.as_deref());
            found.retain(|own| wanted.is_none() || own.transmitters.iter().any(|(tx, _)| is_named(own, tx)));
            if let Some(name) = wanted.as_ref().filter(|_| found.is_empty()) {
                return Err(format!("{name} is no link of {}: `evaluate` lists them", folder.display()));
            }
            for capture in found {
                let own: Vec<String> =
                    capture.transmitters.iter().map(|(tx, _)| tx.clone()).filter(|tx| is_named(&capture, tx)).collect();
                // Another link of a capture that is there already is no other capture.
                let known = capture.add_to(&mut captures);
                for link in own.into_iter().map(|tx| (known, tx)) {
                    if !links.contains(&link) {
                        links.push(link);
                    }
                }
            }
        }
        let names = links.iter().map(|(capture, tx)| captures[*capture].link_name(tx)).collect();
        Ok((captures, names, lost))
    }
}

/// A line of JSON: what `evaluate` says of the link, and what the search found out on its way.
#[derive(serde::Serialize)]
struct Row<'a> {
    #[serde(flatten)]
    judged: &'a Judged,
    /// Standard deviation of the phase that the best plane wave leaves unexplained, radians.
    residual_phase_rad: Option<f64>,
}

impl<'a> Row<'a> {
    fn new(judged: &'a Judged, bearing: Option<&Bearing>) -> Self {
        let coherence = bearing.map(|bearing| bearing.plane_wave.coherence).filter(|coherence| *coherence > 0.0);
        Self { judged, residual_phase_rad: coherence.map(|coherence| (-2.0 * coherence.ln()).max(0.0).sqrt()) }
    }
}

/// The folder of a link, and the rest of its name. A name that does not end like a link is a folder.
fn parts(link: &Path) -> (PathBuf, Option<String>) {
    let last = link.file_name().unwrap_or_default().to_string_lossy();
    let is_link = last.strip_prefix("tx").is_some_and(|number| number.bytes().all(|digit| digit.is_ascii_digit()));
    let folder = link.ancestors().find(|folder| folder.is_dir()).filter(|_| is_link).unwrap_or(link);
    let rest = link.strip_prefix(folder).unwrap_or(Path::new("")).to_string_lossy().into_owned();
    (folder.to_path_buf(), Some(rest).filter(|rest| !rest.is_empty()))
}

/// True for the link of this name, or of a name that ends with it.
fn is_wanted(name: &str, wanted: Option<&str>) -> bool {
    wanted.is_none_or(|wanted| name == wanted || name.ends_with(&format!("/{wanted}")))
}

/// Shows the links of captures, and locates their receivers where several links see known places.
pub fn run(args: &Args) -> Result {
    let reading = args.reading();
    let options = args.asked(reading.options.clone());
    let (mut captures, names, mut lost) = args.find(&reading)?;
    args.check_places(&captures);
    let told: BTreeMap<String, [f64; 2]> = args.place.iter().map(|(name, (place, _))| (name.clone(), *place)).collect();
    if args.together.transmitters {
        return locate_transmitters(&args.together, &reading, (captures, &names, lost), &told, args.json);
    }
    captures.iter_mut().for_each(|capture| capture.told.clone_from(&told));
    args.graph.check(&captures, !args.place.is_empty(), args.force)?;
    let ranges = args.graph.ranges(&captures, &reading)?;
    let (mut rows, mut shown) = (Vec::new(), 0);
    for capture in &captures {
        let mut links: Vec<(String, Bearing, Options)> = Vec::new();
        let mut look = |name: &str, bearing: &Bearing, options: &Options| {
            links.push((name.to_owned(), bearing.clone(), options.clone()));
        };
        let mut evaluated = capture.evaluate_and(reading.source, reading.channel, &options, &mut look);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        evaluated.rows.retain(|row| names.contains(&row.answer.link));
        super::print_fit(args, evaluated.rows.iter().find_map(|row| row.answer.odometry_fit.as_ref()));
        for row in &mut evaluated.rows {
            args.min_confidence.into_iter().for_each(|least| row.answer.refuse_below(least));
            let link = links.iter().find(|(name, ..)| *name == row.answer.link);
            if let Some((_, bearing, options)) = link.filter(|_| args.explain) {
                row.answer.plan = Some(LinkPlan::of(bearing, options, &args.grid()).in_words()?);
            }
            let bearing = link.map(|(_, bearing, _)| bearing);
            tell(args, row, bearing, names.len());
            shown += usize::from(row.answer.azimuth_deg.is_some());
            bearing.map_or(Ok(()), |bearing| draw(args, &reading, row, bearing))?;
        }
        evaluated.notes.iter().for_each(|line| note!("{line}"));
        rows.extend(evaluated.rows);
    }
    if !args.json {
        explain_lines(names.len());
    }
    let located = locate(args, &mut rows, &ranges)?;
    draw_maps(args, &rows, &located)?;
    Ok(Outcome::of(shown > 0, lost))
}

/// One link.
fn tell(args: &Args, row: &Judged, bearing: Option<&Bearing>, links: usize) {
    if args.json {
        print_json(&Row::new(row, bearing));
    } else {
        let (answer, doubts) = (&row.answer, doubts(&row.answer));
        let text = if is_short(links) {
            let truth = true_azimuth("  truth", row).unwrap_or_default();
            format!("{}{truth}\n{doubts}", in_a_line(answer, MirrorOf::Motion))
        } else {
            let mut text = describe(answer, MirrorOf::Motion, links, &doubts, &pairs(answer));
            truth(&mut text, "  truth", row);
            text
        };
        print(&text);
        print(&answer.plan.as_ref().map(ToString::to_string).unwrap_or_default());
    }
    if let Some(error) = &row.answer.error {
        wrong!("{}: {error}", row.answer.link);
    }
}

/// Where the receivers are of whose links several see known places, or one that was told.
fn locate(args: &Args, rows: &mut [Judged], ranges: &BTreeMap<String, Vec<Ranged>>) -> Words<Located> {
    for row in rows.iter_mut() {
        let own = args.place.iter().find(|(name, _)| row.transmitter() == name);
        row.transmitter_z_m = own.and_then(|(_, (_, height))| *height);
    }
    // A given place is that of a transmitter in all captures, so those of one name stand.
    let mut located = receivers_with(rows, ranges, !args.place.is_empty());
    let finished = args.graph.finish(ranges, &located);
    let found = &mut located.receivers;
    if args.place.is_empty() {
        let is_located = |own: &Receiver| own.position_m.is_some() && own.links + own.ranges[0] > 1;
        found.retain(|receiver| ranges.contains_key(&receiver.capture) || is_located(receiver));
    }
    found.iter_mut().for_each(|receiver| say_unplaced(receiver, rows));
    if args.json {
        found.iter().for_each(print_json);
        located.transmitters.iter().for_each(print_json);
    } else if !found.is_empty() {
        print(&format!("located from links to known places:\n{}", receivers_table(found, rows)));
        print(&shared(&located.transmitters));
    }
    finished.map(|()| located)
}

fn draw(args: &Args, reading: &Reading, row: &Judged, bearing: &Bearing) -> Words<()> {
    let Some(folder) = &args.plot else { return Ok(()) };
    let pictures = csi5300_lab::show::results::LinkPictures::of(row, bearing, reading.source);
    super::write(&pictures, folder, &row.answer.link)
}

/// A map of each capture: the bearings, the transmitters, the receiver as located.
fn draw_maps(args: &Args, rows: &[Judged], located: &Located) -> Words<()> {
    let Some(folder) = &args.plot else { return Ok(()) };
    let written = crate::commands::draft::pictures(folder, |folder| write_maps(rows, located, folder))?;
    if !written.is_empty() {
        let maps = super::first_of_each(&written).count() as u64;
        note!("{}: {}", folder.display(), some(maps, "map", "maps"));
    }
    Ok(())
}

/// The truth, if it is known.
fn truth(text: &mut String, head: &str, row: &Judged) {
    if let Some(azimuth) = true_azimuth(head, row) {
        *text += &azimuth;
        // No truth has heights.
        if let Some(range) = row.true_range_m {
            let _ = write!(text, "; horizontally {range:.2} m");
        }
        if let Some(error) = row.range_error_m {
            let _ = write!(text, ": off by {}", fixed(error, 2));
        }
        text.push('\n');
    }
}

/// The true azimuth and the errors of the answer and its mirror, if the truth is known.
fn true_azimuth(head: &str, row: &Judged) -> Option<String> {
    let (truth, error) = (row.true_from_mean_pose_deg?, row.error_from_mean_pose_deg?);
    let mirror = row.answer.mirror_deg.map_or(String::new(), |mirror| {
        let off = (mirror - truth + 180.0).rem_euclid(360.0) - 180.0;
        format!(", its mirror by {}", fixed(off, 2))
    });
    Some(format!("{head} {} deg: off by {}{mirror}", fixed(truth, 2), fixed(error, 2)))
}

/// What lies on the line or in the plane of a mirror.
#[derive(Clone, Copy)]
pub enum MirrorOf {
    /// One antenna of a robot that drives.
    Motion,
    /// Several antennas of a robot that turns.
    Turn,
    /// Several antennas of a robot that stands.
    Antennas,
}

/// The other bearing that these points cannot distinguish from the answer, and why.
pub fn mirror(answer: &Answer, of: MirrorOf) -> Option<String> {
    let azimuth = fixed(answer.mirror_deg?, digits(answer.azimuth_sd_deg));
    let height = answer.mirror_elevation_deg.map(|elevation| format!(" at elevation {} deg", fixed(elevation, 1)));
    let shape = match (of, &height) {
        (MirrorOf::Motion, None) => "motion along a line",
        (MirrorOf::Motion, Some(_)) => "motion in a plane",
        (MirrorOf::Turn, None) => "so small a turn",
        (MirrorOf::Turn, Some(_)) => "a turn in a plane",
        (MirrorOf::Antennas, None) => "antennas on a line",
        (MirrorOf::Antennas, Some(_)) => "antennas in a plane",
    };
    Some(format!("{azimuth} deg{}: {shape} cannot tell them apart", height.unwrap_or_default()))
}

/// A line for each candidate.
pub fn places(candidates: &[CandidateAnswer]) -> String {
    let mut text = String::new();
    for (number, candidate) in candidates.iter().enumerate() {
        let range = candidate.range_m.map_or("far".into(), |range| format!("{range:.1} m"));
        let elevation = match candidate.elevation_deg {
            Some(elevation) => format!("elevation {:>5}", fixed(elevation, 1)),
            None => format!("|elevation| {:4.1}", candidate.abs_elevation_deg),
        };
        let (azimuth, percent) = (fixed(candidate.azimuth_deg, 2), 100.0 * candidate.share);
        let _ = writeln!(text, "  {}: {azimuth:>7} deg, {elevation} deg, {range}, {percent:.0} %", number + 1);
    }
    text
}

/// The links to a receiver.
fn own<'a>(receiver: &Receiver, rows: &'a [Judged]) -> impl Iterator<Item = &'a Judged> {
    let capture = format!("{}/", receiver.capture);
    rows.iter().filter(move |row| row.answer.link.starts_with(&capture))
}

/// Of a receiver that is not located: which of its bearings are to transmitters whose places are not known.
fn say_unplaced(receiver: &mut Receiver, rows: &[Judged]) {
    let Some(error) = receiver.error.clone() else { return };
    let is_unplaced = |row: &&Judged| row.answer.azimuth_deg.is_some() && row.true_transmitter_m.is_none();
    let unplaced: Vec<String> =
        own(receiver, rows).filter(is_unplaced).map(|row| row.transmitter().to_owned()).collect();
    let (whose, options) = match &unplaced[..] {
        [] => return,
        [one] => (format!("the place of {one} is"), format!("--place {one}=X,Y")),
        [one, ..] => (format!("the places of {} are", unplaced.join(", ")), format!("--place {one}=X,Y and so on")),
    };
    let unplaced = format!("{whose} not known ({options})");
    let known = if receiver.links == 0 { "not located:".into() } else { format!("{error};") };
    receiver.error = Some(format!("{known} {unplaced}"));
}

fn of_them_outliers(count: usize) -> String {
    match count {
        0 => String::new(),
        1 => ", 1 of them an outlier".into(),
        _ => format!(", {count} of them outliers"),
    }
}

fn receivers_table(found: &[Receiver], rows: &[Judged]) -> String {
    let mut text = String::new();
    for receiver in found {
        let _ = write!(text, "{}: ", receiver.capture);
        match (receiver.position_m, receiver.covariance_m2) {
            (Some([x, y]), Some(c)) => {
                let _ = write!(
                    text,
                    "x {} +- {:.2} m, y {} +- {:.2} m from {}",
                    fixed(x, 2),
                    c[0][0].sqrt(),
                    fixed(y, 2),
                    c[1][1].sqrt(),
                    some(receiver.links as u64, "link", "links")
                );
                text += &of_them_outliers(receiver.weights.iter().filter(|weight| **weight == 0.0).count());
                if let (Some(z), Some(sd)) = (receiver.height_m, receiver.height_sd_m) {
                    let _ = write!(text, ", z {} +- {sd:.2} m", fixed(z, 2));
                }
            }
            _ => text += receiver.error.as_deref().unwrap_or("not located"),
        }
        if let Some(off) = receiver.off_m {
            let _ = write!(text, "; {off:.2} m from the truth");
        }
        let [used, outliers] = receiver.ranges;
        if used > 0 {
            let _ = write!(text, "; {}{}", some(used as u64, "range", "ranges"), of_them_outliers(outliers));
        }
        if receiver.without_probability > 0 {
            let _ = write!(
                text,
                "; {} without a calibrated probability weighed as within 5 degrees with {UNKNOWN_PROBABILITY}",
                some(receiver.without_probability as u64, "link", "links")
            );
        }
        text.push('\n');
        others(&receiver.others_m, &mut text);
        said_otherwise(receiver, rows, &mut text);
        for row in own(receiver, rows) {
            let Some(position_m) = row.answer.position_m else { continue };
            let [x, y, z] = position_m.map(|metres| fixed(metres, 2));
            let mirror = row
                .answer
                .mirror_deg
                .map_or(String::new(), |deg| format!("; its mirror, at {} deg, is as far away", fixed(deg, 2)));
            let _ = writeln!(text, "  {}: seen at x {x}, y {y}, z {z} m{mirror}", row.answer.link);
        }
    }
    errors(found, &mut text);
    let mut off: Vec<f64> = found.iter().filter_map(|receiver| receiver.off_m).collect();
    if let Some(median) = median(&mut off) {
        let _ =
            writeln!(text, "{} located, median error {median:.2} m", some(off.len() as u64, "receiver", "receivers"));
    }
    text
}

/// Transmitters located with the receivers.
fn shared(found: &[Shared]) -> String {
    let mut text = String::new();
    for Shared { transmitter, captures, position_m: [x, y], covariance_m2: c, others_m } in found {
        let _ = writeln!(
            text,
            "{transmitter}: x {} +- {:.2} m, y {} +- {:.2} m from {captures} captures",
            fixed(*x, 2),
            c[0][0].sqrt(),
            fixed(*y, 2),
            c[1][1].sqrt()
        );
        others(others_m, &mut text);
    }
    text
}

fn others(places_m: &[[f64; 2]], text: &mut String) {
    for [x, y] in places_m {
        let _ = writeln!(text, "  or x {} m, y {} m, which the links fit nearly as well", fixed(*x, 2), fixed(*y, 2));
    }
}

/// The links whose place fits another bearing than their answer, or none.
fn said_otherwise(receiver: &Receiver, rows: &[Judged], text: &mut String) {
    for ((link, azimuth_deg), weight) in receiver.names.iter().zip(&receiver.azimuths_deg).zip(&receiver.weights) {
        if *weight == 0.0 {
            let _ = writeln!(text, "  {link}: an outlier: none of its bearings fits the known place");
            continue;
        }
        let answer = rows.iter().find(|row| row.answer.link == *link).and_then(|row| row.answer.azimuth_deg);
        if let Some(answer) = answer.filter(|answer| (answer - azimuth_deg).abs() > 1e-6) {
            let [fitting, answer] = [*azimuth_deg, answer].map(|deg| fixed(deg, 2));
            let _ = writeln!(text, "  {link}: {fitting} deg fits this place, not the {answer} deg answered");
        }
    }
}

/// Errors of the bearings of links to located receivers, as answered and as the places choose them, where the truth is known.
fn errors(found: &[Receiver], text: &mut String) {
    let chosen = || found.iter().filter(|receiver| receiver.azimuth_errors_deg.len() > 1);
    let pool = |errors: fn(&Receiver) -> &[f64]| {
        let mut errors: Vec<f64> = chosen().flat_map(errors).map(|error| error.abs()).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        median(&mut errors).map(|median| format!("{mean:.2} / {median:.2} deg"))
    };
    if let (Some(answered), Some(fitting)) = (pool(|r| &r.answer_errors_deg), pool(|r| &r.azimuth_errors_deg)) {
        let _ = writeln!(
            text,
            "receivers with two or more links: error mean / median {answered} of the answers, {fitting} of the candidates that fit the place"
        );
    }
}

#[derive(clap::Args)]
#[command(next_help_heading = "Graph of the located receiver")]
pub struct Graph {
    /// Ranges between the receiver and transmitters from another sensor (UWB, FTM), as CSV or JSON: time_s, from, to,
    /// range_m, sd_m. Robot names: rx, tx2 and so on, or the last parts of a capture's or link's name
    #[arg(long, value_name = "FILE", requires = "captures", conflicts_with_all = ["transmitters", "baseline"], hide_short_help = true)]
    ranges: Option<PathBuf>,
    /// Write the graph that located the receiver of one capture, or with --place of several captures: JSON for GTSAM, or
    /// g2o's text format
    #[arg(long, value_name = "OUT.json|.g2o", requires = "captures", conflicts_with_all = ["transmitters", "baseline"], hide_short_help = true)]
    factors: Option<PathBuf>,
}

impl Graph {
    pub fn is_wanted(&self) -> bool {
        self.ranges.is_some() || self.factors.is_some()
    }

    fn is_g2o(path: &Path) -> Option<bool> {
        let ending = path.extension()?.to_str()?;
        [("g2o", true), ("json", false)].into_iter().find(|(own, _)| *own == ending).map(|(_, is_g2o)| is_g2o)
    }

    /// Checks, before any estimate, that the graph can be written.
    pub fn check(&self, captures: &[Capture], has_place: bool, force: bool) -> Words<()> {
        let Some(path) = &self.factors else { return Ok(()) };
        if captures.len() != 1 && !has_place {
            usage(&format!(
                "--factors takes one capture, not {}: several are one graph with --place NAME=X,Y of a transmitter that stands, \
                 if they share another one of unknown place",
                captures.len()
            ));
        }
        if Self::is_g2o(path).is_none() {
            usage(&format!("{}: --factors writes .json or .g2o", path.display()));
        }
        crate::commands::draft::Draft::create(path, force).map(drop)
    }

    /// The ranges of each capture, by its name.
    pub fn ranges(&self, captures: &[Capture], reading: &Reading) -> Words<BTreeMap<String, Vec<Ranged>>> {
        let mut found: BTreeMap<String, Vec<Ranged>> = BTreeMap::new();
        let Some(path) = &self.ranges else { return Ok(found) };
        let words = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let text = std::fs::read_to_string(path).map_err(|error| words(&error))?;
        let ranges = read(&text).map_err(|error| words(&error))?;
        let mut taken = vec![false; ranges.len()];
        for capture in captures {
            let trajectory = capture.path(reading.source).map_err(|error| words(&error))?;
            for (range, taken) in ranges.iter().zip(&mut taken) {
                let Some(transmitter) = transmitter(capture, range) else { continue };
                let Some(pose) = trajectory.at(range.time_s) else { continue };
                let own = found.entry(capture.link_name("")).or_default();
                own.push(Ranged {
                    transmitter: transmitter.to_owned(),
                    t_s: range.time_s,
                    from_m: [pose.position_m.x, pose.position_m.y],
                    range_m: [range.range_m, range.sd_m],
                });
                *taken = true;
            }
        }
        match ranges.iter().zip(taken).find(|(_, taken)| !taken) {
            Some((Range { from, to, time_s, .. }, _)) => {
                let names = captures.iter().flat_map(|capture| &capture.transmitters).map(|(name, _)| name.as_str());
                let robots: BTreeSet<&str> = std::iter::once("rx").chain(names).collect();
                let robots = Vec::from_iter(robots).join(", ");
                Err(words(&format!(
                    "no capture has {from} and {to} at {time_s} s: the robots are {robots}, and times are those of the trajectory"
                )))
            }
            None => Ok(found),
        }
    }

    /// Reports ranges that a position was located without, and writes the graph.
    pub fn finish(&self, given: &BTreeMap<String, Vec<Ranged>>, found: &Located) -> Words<()> {
        for receiver in found.receivers.iter().filter(|receiver| receiver.position_m.is_some()) {
            let given = given.get(&receiver.capture).map_or(0, Vec::len);
            if receiver.ranges[0] < given {
                let left = some((given - receiver.ranges[0]) as u64, "range is", "ranges are");
                note!("{}: {left} not used: give the transmitters' places with --place", receiver.capture);
            }
        }
        let Some(path) = &self.factors else { return Ok(()) };
        let Some((team, solution)) = &found.graph else {
            let why = if found.receivers.iter().any(|receiver| receiver.position_m.is_some()) {
                "the captures share no transmitter of unknown place, which would connect them"
            } else {
                "no receiver was located"
            };
            return Err(format!("{}: not written, because {why}", path.display()));
        };
        let is_g2o = Self::is_g2o(path).unwrap_or_default();
        crate::commands::draft::write(
            path,
            if is_g2o { factors::g2o(team, solution) } else { factors::json(team, solution) },
        )
    }
}

/// The capture's transmitter that a range belongs to; either end may be the receiver.
fn transmitter<'a>(capture: &'a Capture, range: &Range) -> Option<&'a str> {
    let ends = |own: &str, name: &str| own == name || own.strip_suffix(name).is_some_and(|rest| rest.ends_with('/'));
    let is_receiver = |name: &str| name == "rx" || ends(&capture.link_name(""), name);
    let other = [(&range.from, &range.to), (&range.to, &range.from)];
    let other = other.into_iter().find(|(receiver, _)| is_receiver(receiver)).map(|(_, other)| other)?;
    let names = capture.transmitters.iter().map(|(name, _)| name.as_str());
    names.into_iter().find(|name| ends(&capture.link_name(name), other))
}

// How captures lie to each other.
#[derive(clap::Args)]
#[command(next_help_heading = "Transmitters from several captures")]
pub struct Together {
    /// Locate each transmitter from all captures together. Their trajectories must share one frame (motion capture), or
    /// use --frame
    #[arg(long, requires = "captures", conflicts_with_all = ["explain", "min_confidence", "plot"], hide_short_help = true)]
    pub transmitters: bool,
    /// Frame of a capture's trajectory in the common one: origin, metres, and rotation from +x towards +y, degrees.
    /// CAPTURE is a folder as in link names
    #[arg(long, value_name = "CAPTURE=X,Y,DEGREES", value_parser = frame, allow_hyphen_values = true, requires = "transmitters", hide_short_help = true)]
    frame: Vec<(String, Frame)>,
}

impl Together {
    /// The frame of a capture's trajectory: that of the longest name that is its or a folder's above it.
    fn frame(&self, capture: &Capture) -> Frame {
        let own = capture.link_name("");
        let is_of = |name: &str| own == name || own.strip_prefix(name).is_some_and(|rest| rest.starts_with('/'));
        let named = self.frame.iter().filter(|(name, _)| is_of(name));
        named.max_by_key(|(name, _)| name.len()).map(|(_, frame)| *frame).unwrap_or_default()
    }

    /// Refuses frames given twice, and of captures that are not there.
    fn must_be_of(&self, captures: &[Capture]) {
        for (k, (name, _)) in self.frame.iter().enumerate() {
            if self.frame.iter().take(k).any(|(other, _)| other == name) {
                usage(&format!("--frame {name}=... is given twice: a capture has one frame"));
            }
            let below = format!("{name}/");
            let is_there = |own: String| own == *name || own.starts_with(&below);
            if !captures.iter().any(|capture| is_there(capture.link_name(""))) {
                let names: Vec<String> = captures.iter().take(5).map(|capture| capture.link_name("")).collect();
                usage(&format!("--frame {name}=...: no capture has this name; there are {}", names.join(", ")));
            }
        }
    }
}

fn frame(text: &str) -> Words<(String, Frame)> {
    let parts = named_numbers(text).and_then(|(name, numbers)| {
        let [x, y, deg] = numbers[..] else { return None };
        Some((name.trim_end_matches('/').to_owned(), Frame { origin_m: [x, y], yaw_rad: deg.to_radians() }))
    });
    parts.ok_or_else(|| "a capture's name, metres, metres, degrees, such as kitchen=4.2,-1,90".into())
}

/// Locates every transmitter of the captures.
fn locate_transmitters(
    together: &Together,
    reading: &Reading,
    (captures, names, mut lost): (Vec<Capture>, &[String], bool),
    told: &BTreeMap<String, [f64; 2]>,
    json: bool,
) -> Result {
    together.must_be_of(&captures);
    let mut links: Vec<(Judged, Frame)> = Vec::new();
    let mut failed: Vec<(String, String)> = Vec::new();
    for capture in &captures {
        let evaluated = capture.evaluate(reading.source, reading.channel, &reading.options);
        lost |= evaluated.lost;
        evaluated.notes.iter().for_each(|line| note!("{line}"));
        for row in evaluated.rows.into_iter().filter(|row| names.contains(&row.answer.link)) {
            failed.extend(row.answer.error.clone().map(|error| (row.answer.link.clone(), error)));
            links.push((row, together.frame(capture)));
        }
    }
    let found = located(&links, reading.source, told);
    if json {
        found.iter().for_each(print_json);
    } else {
        print(&transmitters_table(&found));
    }
    failed.iter().for_each(|(link, error)| wrong!("{link}: {error}"));
    Ok(Outcome::of(found.iter().any(|one| one.position_m.is_some()), lost))
}

fn transmitters_table(found: &[LocatedTransmitter]) -> String {
    let mut text = String::new();
    for one in found {
        let _ = write!(text, "{}: ", one.transmitter);
        let Some((position_m, share)) = one.position_m.zip(one.share) else {
            let _ = writeln!(text, "{}", one.error.as_deref().unwrap_or("not located"));
            continue;
        };
        let [x, y] = position_m.map(|metres| fixed(metres, 2));
        let _ = write!(text, "x {x}, y {y} m");
        if let Some(([longer, shorter], deg)) = one.ellipse_m.zip(one.ellipse_deg) {
            let _ = write!(text, "; 68 % within {longer:.2} by {shorter:.2} m towards {} degrees", fixed(deg, 0));
        }
        let _ = write!(text, "; share {share:.2}, from {}", some(one.motions as u64, "motion", "motions"));
        if let Some(off) = one.off_m {
            let _ = write!(text, "; {off:.2} m from the truth");
        }
        text.push('\n');
        for other in &one.others {
            let [x, y] = other.position_m.map(|metres| fixed(metres, 2));
            let _ = writeln!(text, "  or x {x}, y {y} m: share {:.2}", other.share);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_that_its_place_contradicts_is_told() {
        let receiver = Receiver {
            links: 2,
            names: vec!["c/tx1".into(), "c/tx2".into()],
            position_m: Some([1.0, 2.0]),
            covariance_m2: Some([[1.0, 0.0], [0.0, 1.0]]),
            weights: vec![0.0, 1.0],
            azimuths_deg: vec![3.0, 4.0],
            ranges: [2, 0],
            ..Receiver::default()
        };
        let text = receivers_table(&[receiver], &[]);
        assert!(text.contains("from 2 links, 1 of them an outlier; 2 ranges\n  c/tx1: an outlier: "), "{text}");
    }

    #[test]
    fn a_mirror_is_of_a_line_or_of_a_plane_in_which_it_has_an_elevation() {
        let of = |elevation_deg: Option<f64>| {
            let mut answer = Answer::failed("a/tx".into(), String::new());
            answer.azimuth_sd_deg = Some(0.5);
            (answer.mirror_deg, answer.mirror_elevation_deg) = (Some(-138.38), elevation_deg);
            mirror(&answer, MirrorOf::Motion).unwrap()
        };
        assert_eq!(of(None), "-138.38 deg: motion along a line cannot tell them apart");
        assert_eq!(of(Some(2.3)), "-138.38 deg at elevation 2.3 deg: motion in a plane cannot tell them apart");
    }

    #[test]
    fn a_truth_is_horizontal_and_has_no_negative_zero() {
        let answer = Answer::failed("a/tx".into(), String::new());
        let mut row = Judged { answer, ..Judged::default() };
        (row.true_from_mean_pose_deg, row.error_from_mean_pose_deg) = (Some(1e-17), Some(-2e-17));
        (row.true_range_m, row.range_error_m) = (Some(2.0), Some(-0.001));
        let mut text = String::new();
        truth(&mut text, "  truth", &row);
        assert_eq!(text, "  truth 0.00 deg: off by 0.00; horizontally 2.00 m: off by 0.00\n");
    }

    #[test]
    fn places_have_two_numbers_and_perhaps_a_height() {
        assert_eq!(place("tx2=-3.18, 1.11"), Ok(("tx2".into(), ([-3.18, 1.11], None))));
        assert_eq!(place("a=b=1,2,0.5").ok(), None);
        assert_eq!(place("tx=1,2,0.5"), Ok(("tx".into(), ([1.0, 2.0], Some(0.5)))));
        for wrong in ["tx=1", "tx=1,2,3,4", "=1,2", "tx=1,nan", "tx=1,2,inf", "tx"] {
            assert!(place(wrong).is_err_and(|why| why.contains("two or three numbers")), "{wrong}");
        }
    }

    #[test]
    fn robots_have_short_names_or_names_with_their_capture() {
        let capture = Capture {
            place: "a/b".into(),
            stamp: "t".into(),
            transmitters: vec![("tx2".into(), PathBuf::new()), ("tx12".into(), PathBuf::new())],
            ..Capture::default()
        };
        let of = |from: &str, to: &str| {
            let range = Range { time_s: 0.0, from: from.into(), to: to.into(), range_m: 1.0, sd_m: 0.1 };
            transmitter(&capture, &range).map(str::to_owned)
        };
        for (from, to) in [("rx", "tx2"), ("tx2", "rx"), ("b/t", "a/b/t/tx2"), ("t/tx2", "a/b/t")] {
            assert_eq!(of(from, to).as_deref(), Some("tx2"), "{from} {to}");
        }
        for (from, to) in [("tx2", "tx12"), ("rx", "x2"), ("c/t", "tx2"), ("rx", "rx")] {
            assert_eq!(of(from, to), None, "{from} {to}");
        }
    }

    #[test]
    fn a_frame_has_a_place_and_a_direction() {
        let (name, found) = frame("a/b/=1,-2.5, 90").unwrap();
        assert_eq!((name.as_str(), found.origin_m), ("a/b", [1.0, -2.5]));
        assert!((found.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        for wrong in ["a=1,2", "=1,2,3", "a=1,2,nan", "a", "a=1,2,3,4"] {
            assert!(frame(wrong).is_err_and(|why| why.contains("degrees")), "{wrong}");
        }
    }
}
