//! Bearings of captures: folders with the logs of a receiver and its transmitters, a trajectory and perhaps the truth.

use super::super::Words;
use super::super::captures::{Reading, Which};
use super::super::{Outcome, Result, fixed, hint, print, print_json, usage};
use super::words::{digits, explain_lines, in_a_line, is_short};
use super::{Args, located, transmitters};
use clap::ValueEnum;
use csi5300::pipeline::{Answer, Bearing, CandidateAnswer, Options};
use csi5300_lab::evaluate::quality::horizontal;
use csi5300_lab::evaluate::receivers::{Located, Ranged, receivers_with};
use csi5300_lab::evaluate::{Capture, Judged};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Where a transmitter is, and how high if that was given, metres.
pub type Place = ([f64; 2], Option<f64>);

/// A transmitter's name and place.
pub fn place(text: &str) -> Words<(String, Place)> {
    let parts = text.split_once('=').filter(|(name, _)| !name.is_empty()).and_then(|(name, place)| {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
        let numbers: Vec<f64> = place.split(',').map(number).collect::<Option<_>>()?;
        match numbers[..] {
            [x, y] => Some((name.to_owned(), ([x, y], None))),
            [x, y, z] => Some((name.to_owned(), ([x, y], Some(z)))),
            _ => None,
        }
    });
    parts.ok_or_else(|| "a name and two or three numbers of metres, such as tx2=-3.18,1.11".into())
}

impl Args {
    /// How captures are read.
    fn reading(&self) -> Reading {
        let named = self.logs.trajectory.as_deref().map(|name| {
            let which = name.to_str().and_then(|name| Which::from_str(name, false).ok());
            which.unwrap_or_else(|| usage("for a capture, --trajectory is gt, t265 or odom: it has its own files"))
        });
        Reading {
            trajectory: named.unwrap_or(Which::Gt),
            mounting: self.mounting.clone(),
            channel: self.channel,
            estimation: self.estimation.clone(),
        }
    }

    /// The named captures with their requested links, and whether some could not be read. Of several folders, each
    /// one's name precedes its captures' names.
    fn find(&self, reading: &Reading) -> Words<(Vec<Capture>, Vec<String>, bool)> {
        let (mut captures, mut names, mut lost) = (Vec::new(), Vec::new(), false);
        for named in &self.captures {
            let (folder, wanted) = parts(named);
            let (mut found, unreadable) = reading.find(&folder)?;
            unreadable.iter().for_each(|folder| wrong!("cannot read {folder}"));
            lost |= !unreadable.is_empty();
            let own = folder.file_name().map(|name| name.to_string_lossy().into_owned());
            if let Some(own) = own.filter(|_| self.captures.len() > 1) {
                let named = |place: &str| if place.is_empty() { own.clone() } else { format!("{own}/{place}") };
                found.iter_mut().for_each(|capture| capture.place = named(&capture.place));
            }
            let links =
                |own: &Capture| own.transmitters.iter().map(|(name, _)| own.link_name(name)).collect::<Vec<_>>();
            let is_named = |name: &String| is_wanted(name, wanted.as_deref());
            found.retain(|own| wanted.is_none() || links(own).iter().any(is_named));
            let named: Vec<String> = found.iter().flat_map(links).filter(is_named).collect();
            if named.is_empty() && wanted.is_some() {
                let name = wanted.unwrap_or_default();
                return Err(format!("{name} is no link of {}: `evaluate` lists them", folder.display()));
            }
            names.extend(named);
            captures.extend(found);
        }
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
    let options = reading.options().unwrap_or_else(|message| usage(&message));
    let options = args.asked(options);
    let (captures, names, mut lost) = args.find(&reading)?;
    if args.together.transmitters {
        return transmitters::run(&args.together, &reading, (captures, lost), &args.place, args.json);
    }
    args.graph.check(&captures, !args.place.is_empty(), args.force)?;
    let ranges = args.graph.ranges(&captures, &reading)?;
    let (mut rows, mut shown) = (Vec::new(), 0);
    for capture in &captures {
        let mut links: Vec<(String, Bearing)> = Vec::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| links.push((name.to_owned(), bearing.clone()));
        let mut evaluated = capture.evaluate_and(reading.source(), reading.channel, &options, &mut look);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        evaluated.rows.retain(|row| names.contains(&row.answer.link));
        super::print_fit(args, evaluated.rows.iter().find_map(|row| row.answer.odometry_fit.as_ref()));
        for row in &mut evaluated.rows {
            args.min_confidence.into_iter().for_each(|least| row.answer.refuse_below(least));
            let bearing = links.iter().find(|(name, _)| *name == row.answer.link).map(|(_, bearing)| bearing);
            tell(args, row, bearing, names.len());
            shown += usize::from(row.answer.azimuth_deg.is_some());
            bearing.map_or(Ok(()), |bearing| draw(args, &reading, row, bearing))?;
        }
        evaluated.notes.iter().for_each(|line| note!("{line}"));
        rows.extend(evaluated.rows);
    }
    if !args.json && !args.explain {
        explain_lines(names.len());
    }
    let located = locate(args, &mut rows, &ranges)?;
    draw_maps(args, &rows, &located)?;
    Ok(match (shown, lost) {
        (0, _) => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        (_, false) => Outcome::Done,
    })
}

/// One link.
fn tell(args: &Args, row: &Judged, bearing: Option<&Bearing>, links: usize) {
    match bearing {
        _ if args.json => print_json(&Row::new(row, bearing)),
        Some(bearing) if args.explain => print(&explain(row, bearing)),
        _ => {
            let (answer, doubts) = (&row.answer, super::pairs::doubts(&row.answer));
            let text = if is_short(links) {
                let truth = true_azimuth("  truth", row).unwrap_or_default();
                format!("{}{truth}\n{doubts}", in_a_line(answer, MirrorOf::Motion))
            } else {
                let mut text = super::describe(answer, MirrorOf::Motion, links, &doubts, &super::pairs::pairs(answer));
                truth(&mut text, "  truth", row);
                text
            };
            print(&text);
        }
    }
    if let Some(error) = &row.answer.error {
        wrong!("{}: {error}", row.answer.link);
    }
}

/// Where the receivers are of whose links several see known places, or one that was told.
fn locate(args: &Args, rows: &mut [Judged], ranges: &BTreeMap<String, Vec<Ranged>>) -> Words<Located> {
    for row in rows.iter_mut() {
        let own = args.place.iter().find(|(name, _)| row.transmitter() == name);
        row.true_transmitter_m = own.map(|(_, (place, _))| *place).or(row.true_transmitter_m);
        row.transmitter_z_m = own.and_then(|(_, (_, height))| *height);
    }
    // A given place is that of a transmitter in all captures, so those of one name stand.
    let mut located = receivers_with(rows, ranges, !args.place.is_empty());
    args.graph.finish(ranges, &located)?;
    let found = &mut located.receivers;
    if args.place.is_empty() {
        found.retain(|receiver| receiver.position_m.is_some() && receiver.links + receiver.ranges[0] > 1);
    }
    found.iter_mut().for_each(|receiver| located::say_unplaced(receiver, rows));
    if args.json {
        found.iter().for_each(print_json);
        located.transmitters.iter().for_each(print_json);
    } else if !found.is_empty() {
        print(&format!("located from links to known places:\n{}", located::table(found, rows)));
        print(&located::shared(&located.transmitters));
    }
    Ok(located)
}

fn draw(args: &Args, reading: &Reading, row: &Judged, bearing: &Bearing) -> Words<()> {
    let Some(folder) = &args.plot else { return Ok(()) };
    let pictures = csi5300_lab::show::results::LinkPictures::of(row, bearing, reading.source());
    super::write(&pictures, folder, &row.answer.link)
}

/// A map of each capture: the bearings, the transmitters, the receiver as located.
fn draw_maps(args: &Args, rows: &[Judged], located: &Located) -> Words<()> {
    let Some(folder) = &args.plot else { return Ok(()) };
    let written = csi5300_lab::show::results::write_maps(rows, located, folder, &super::super::draft::read_files());
    let written = written.map_err(|error| error.to_string())?;
    if !written.is_empty() {
        note!("{}: {}", folder.display(), super::super::some(written.len() as u64, "map", "maps"));
    }
    Ok(())
}

/// The link in the order of its steps.
fn explain(row: &Judged, bearing: &Bearing) -> String {
    let answer = &row.answer;
    let mut text = format!("{}\n", answer.link);
    let counts = answer.pair_counts;
    let _ = writeln!(
        text,
        "pairs         {} formed, {} in motion, {} standing, {} without a pose",
        counts.formed, counts.in_motion, counts.standing, counts.no_pose
    );
    turn_around(&mut text, bearing);
    if let Some(slope_sd_rad) = bearing.slope_sd_rad {
        let _ = writeln!(text, "sampling time slopes {slope_sd_rad:.3} rad per subcarrier (deviation) removed");
    }
    text += "candidates    (by probability)\n";
    text += &places(&answer.candidates);
    conclusion(&mut text, row);
    text
}

/// How far the clocks explain the phase.
fn turn_around(text: &mut String, bearing: &Bearing) {
    match &bearing.turn_around {
        Some(t) => {
            let _ = writeln!(
                text,
                "turn-around   jitter {:.1} us (median), clocks drift {:.2} ppm, offset {:.0} Hz {}; coherence {:.2} -> {:.2}",
                t.jitter_median_us,
                t.drift_ppm,
                t.df_hz,
                if bearing.compensated { "removed" } else { "not removed" },
                t.coherence_before,
                t.coherence_after
            );
        }
        None => text.push_str("turn-around   not known\n"),
    }
}

/// The answer, and the truth if it is known.
fn conclusion(text: &mut String, row: &Judged) {
    let answer = &row.answer;
    let number = |value: Option<f64>| value.map_or("-".into(), |value| fixed(value, 2));
    let _ = writeln!(
        text,
        "answer        {} +- {} deg, within 5 deg with probability {}; {}",
        number(answer.azimuth_deg),
        number(answer.azimuth_sd_deg),
        number(answer.confidence),
        match (answer.range_m, answer.range_sd_m) {
            (Some(range), Some(sd)) => {
                format!("range {range:.2} +- {sd:.2} m, horizontally {:.2} m", range * horizontal(answer))
            }
            _ => "no range".into(),
        }
    );
    if let Some(mirror) = mirror(answer, MirrorOf::Motion) {
        let _ = writeln!(text, "mirror        {mirror}");
    }
    truth(text, "truth        ", row);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn concluded(change: impl FnOnce(&mut Judged)) -> String {
        let mut row = Judged { answer: Answer::failed("a/tx".into(), String::new()), ..Judged::default() };
        (row.answer.azimuth_deg, row.answer.azimuth_sd_deg) = (Some(-1e-17), Some(0.5));
        change(&mut row);
        let mut text = String::new();
        conclusion(&mut text, &row);
        text
    }

    #[test]
    fn a_mirror_is_of_a_line_or_of_a_plane_in_which_it_has_an_elevation() {
        let of = |elevation_deg: Option<f64>| {
            concluded(|row| {
                (row.answer.mirror_deg, row.answer.mirror_elevation_deg) = (Some(-138.38), elevation_deg);
            })
        };
        let line = "mirror        -138.38 deg: motion along a line cannot tell them apart\n";
        let plane = "mirror        -138.38 deg at elevation 2.3 deg: motion in a plane cannot tell them apart\n";
        assert!(of(None).ends_with(line) && of(Some(2.3)).ends_with(plane), "{}{}", of(None), of(Some(2.3)));
    }

    #[test]
    fn a_horizontal_truth_stands_beside_a_horizontal_range() {
        let text = concluded(|row| {
            row.answer.abs_elevation_deg = Some(60.0);
            (row.answer.range_m, row.answer.range_sd_m) = (Some(4.0), Some(0.01));
            (row.true_from_mean_pose_deg, row.error_from_mean_pose_deg) = (Some(1e-17), Some(-2e-17));
            (row.true_range_m, row.range_error_m) = (Some(2.0), Some(-0.001));
        });
        let answer = "answer        0.00 +- 0.50 deg, within 5 deg with probability -; range 4.00 +- 0.01 m, horizontally 2.00 m";
        let truth = "truth         0.00 deg: off by 0.00; horizontally 2.00 m: off by 0.00";
        assert_eq!(text, format!("{answer}\n{truth}\n"));
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
}
