//! `csi5300 explain`.

use super::captures::Reading;
use super::{Outcome, Result, fixed, hint, print, print_json, usage};
use csi5300::pipeline::Answer;
use csi5300::pipeline::Bearing;
use csi5300::pipeline::Options;
use csi5300::pipeline::PathAnswer;
use csi5300_lab::evaluate::Judged;
use csi5300_lab::evaluate::quality::horizontal;
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `explain`.
#[derive(clap::Args)]
#[command(
    after_help = "Example, with a link as `evaluate DIR` names it:\n  csi5300 explain DIR/LOS_Set_A/L1/2024-01-01_120000/tx2 --out pictures"
)]
pub struct Args {
    /// A capture, a folder with captures below it, or a link: either of them, / and the link's name or the end of it (tx2)
    link: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Folder for pictures: phase, trajectory, profile, joint power over azimuth and elevation, and azimuth and range
    #[cfg(feature = "plot")]
    #[arg(long, visible_alias = "plot", value_name = "DIR")]
    out: Option<PathBuf>,
    #[cfg(feature = "plot")]
    #[command(flatten)]
    pictures: super::pictures::Pictures,
    /// JSON Lines: one object a link
    #[arg(long)]
    json: bool,
}

/// A line of JSON: what `evaluate` says of the link, and what the search found out on its way.
#[derive(serde::Serialize)]
struct Row<'a> {
    #[serde(flatten)]
    judged: &'a Judged,
    /// Places at which the search evaluated the joint power.
    places_searched: Option<usize>,
    /// Standard deviation of the phase that the answer leaves unexplained, radians.
    residual_phase_rad: Option<f64>,
    /// Rows of the samples that share an error.
    correlated_rows: Option<f64>,
}

impl<'a> Row<'a> {
    fn new(judged: &'a Judged, bearing: &Bearing) -> Self {
        let fix = bearing.placed.as_ref().map(|placed| &placed.fix);
        Self {
            judged,
            places_searched: fix.map(|fix| fix.evaluations),
            residual_phase_rad: fix.map(|fix| fix.deviations.phase_variance.sqrt()),
            correlated_rows: fix.map(|fix| fix.deviations.correlated_rows),
        }
    }
}

/// The folder of a link, and what is left of its name. What does not end as names of links do is a folder.
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

/// Shows links from end to end.
pub fn run(args: &Args) -> Result {
    #[cfg(feature = "plot")]
    args.pictures.must_have(args.out.as_deref(), "--out");
    let options = args.reading.options().unwrap_or_else(|message| usage(&message));
    let options = options.with_keep_course(true);
    #[cfg(feature = "plot")]
    let options = options.with_keep_maps(args.out.is_some());
    let (folder, wanted) = parts(&args.link);
    let (captures, unreadable) = args.reading.find(&folder)?;
    for folder in &unreadable {
        wrong!("cannot read {folder}");
    }
    let names = captures.iter().flat_map(|own| own.transmitters.iter().map(|(name, _)| own.link_name(name)));
    let named: Vec<String> = names.filter(|name| is_wanted(name, wanted.as_deref())).collect();
    if named.is_empty() {
        let name = wanted.unwrap_or_default();
        return Err(format!("{} is no link of {}: `evaluate` and `report` name them", name, folder.display()));
    }
    #[cfg(feature = "plot")]
    check_pictures(args, &named)?;
    let (mut shown, mut lost) = (0, !unreadable.is_empty());
    for capture in &captures {
        let wants = |name: &str| is_wanted(name, wanted.as_deref());
        if !capture.transmitters.iter().any(|(name, _)| wants(&capture.link_name(name))) {
            continue;
        }
        let mut links: Vec<(String, Bearing)> = Vec::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| {
            if wants(name) {
                links.push((name.to_owned(), bearing.clone()));
            }
        };
        let mut evaluated = capture.evaluate_and(args.reading.source(), args.reading.channel, &options, &mut look);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        evaluated.notes.iter().for_each(|line| note!("{line}"));
        for (name, bearing) in &links {
            let Some(row) = evaluated.rows.iter().find(|row| row.answer.link == *name) else { continue };
            if args.json {
                print_json(&Row::new(row, bearing));
            } else {
                print(&describe(row, bearing));
            }
            shown += 1;
            #[cfg(feature = "plot")]
            draw(args, row, bearing)?;
        }
        let failed = evaluated.rows.iter().filter(|row| wants(&row.answer.link));
        for row in failed.filter(|row| row.answer.error.is_some()) {
            wrong!("{}: {}", row.answer.link, row.answer.error.as_deref().unwrap_or_default());
        }
    }
    Ok(match (shown, lost) {
        (0, _) => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        (_, false) => Outcome::Done,
    })
}

/// Refuses pictures that are there before the work, not after.
#[cfg(feature = "plot")]
fn check_pictures(args: &Args, names: &[String]) -> std::result::Result<(), String> {
    let Some(folder) = &args.out else { return Ok(()) };
    let stems: Vec<PathBuf> =
        names.iter().flat_map(|name| csi5300_lab::show::link::LinkPictures::all_stems(folder, name)).collect();
    args.pictures.check(&stems)
}

#[cfg(feature = "plot")]
fn draw(args: &Args, row: &Judged, bearing: &Bearing) -> std::result::Result<(), String> {
    let Some(folder) = &args.out else { return Ok(()) };
    let pictures = csi5300_lab::show::link::LinkPictures::of(row, bearing, args.reading.source());
    let written = pictures.write_all(folder, &row.answer.link, &args.pictures.format());
    let written = written.map_err(|error| super::pictures::refused(&error))?;
    note!("{}: {}", folder.display(), super::some(written.len() as u64, "picture", "pictures"));
    Ok(())
}

/// The link in the order of its steps.
fn describe(row: &Judged, bearing: &Bearing) -> String {
    let answer = &row.answer;
    let mut text = format!("{}\n", answer.link);
    let counts = answer.pair_counts;
    let _ = writeln!(
        text,
        "pairs         {} formed, {} in motion, {} standing, {} without a pose",
        counts.formed, counts.in_motion, counts.standing, counts.no_pose
    );
    turn_around(&mut text, bearing);
    placed(&mut text, bearing);
    let views: Vec<String> = answer.view_powers.iter().map(|power| format!("{power:.2}")).collect();
    let _ = writeln!(
        text,
        "views         {} (round trip whole, its centre in windows, one way in windows)",
        views.join(", ")
    );
    text += "candidates    (by evidence; power of all views)\n";
    text += &places(&answer.candidates);
    text += "paths         (one-way power, of the round trip)\n";
    text += &places(&answer.paths);
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
                if bearing.compensated { "taken out" } else { "left in" },
                t.coherence_before,
                t.coherence_after
            );
        }
        None => text.push_str("turn-around   not known\n"),
    }
}

/// What the search over places found out on its way.
fn placed(text: &mut String, bearing: &Bearing) {
    if let Some(placed) = &bearing.placed {
        if let Some(a) = &placed.alignment {
            let _ = writeln!(
                text,
                "sampling time slopes {:.3} rad per subcarrier (deviation) taken out; coherence {:.2} -> {:.2}",
                a.slope_sd_rad, a.coherence_before, a.coherence_after
            );
        }
        if let Some(slips) = placed.slips {
            let _ = writeln!(text, "one-way       {:.1} % of the power at sign slips", 100.0 * slips);
        }
        if let Some(focus) = &placed.focus {
            let _ = writeln!(
                text,
                "autofocus     scale {:.3}, turn {:.1} deg/m: ln power {:+.3} over all links, {}",
                focus.warp.scale,
                focus.warp.turn_rad_per_m.to_degrees(),
                focus.gain,
                if focus.worthwhile { "applied" } else { "not worth its two parameters" }
            );
        }
        let _ = writeln!(
            text,
            "search        {} places; residual phase {:.2} rad, {:.0} rows share an error",
            placed.fix.evaluations,
            placed.fix.deviations.phase_variance.sqrt(),
            placed.fix.deviations.correlated_rows
        );
    }
}

/// The answer, and the truth where it is known.
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
    if let Some(mirror) = mirror(answer) {
        let _ = writeln!(text, "mirror        {mirror}");
    }
    if let (Some(truth), Some(error)) = (row.true_from_mean_pose_deg, row.error_from_mean_pose_deg) {
        let _ = write!(text, "truth         {} deg: off by {}", fixed(truth, 2), fixed(error, 2));
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

/// The other bearing that the motion cannot tell from the answer, and why it cannot.
pub fn mirror(answer: &Answer) -> Option<String> {
    let azimuth = fixed(answer.mirror_deg?, 2);
    let (height, motion) = match answer.mirror_elevation_deg {
        Some(elevation) => (format!(" at elevation {} deg", fixed(elevation, 1)), "in a plane"),
        None => (String::new(), "along a line"),
    };
    Some(format!("{azimuth} deg{height}: motion {motion} cannot tell them apart"))
}

/// A line for each path.
pub fn places(paths: &[PathAnswer]) -> String {
    let mut text = String::new();
    for (number, path) in paths.iter().enumerate() {
        let range = path.range_m.map_or("far".into(), |range| format!("{range:.1} m"));
        let elevation = match path.elevation_deg {
            Some(elevation) => format!("elevation {:>5}", fixed(elevation, 1)),
            None => format!("|elevation| {:4.1}", path.abs_elevation_deg),
        };
        let _ = write!(
            text,
            "  {}: {:>7} deg, {elevation} deg, {range}, {} dB",
            number + 1,
            fixed(path.azimuth_deg, 2),
            fixed(path.relative_power_db, 1)
        );
        if let Some([a, b]) = path.cross_term_of {
            let _ = write!(text, ", the product of {} and {}", a + 1, b + 1);
        }
        text.push('\n');
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
}
