//! `csi5300 explain`.

use super::captures::Reading;
use super::{Outcome, Result, hint, print, usage};
use csi5300::pipeline::Bearing;
use csi5300::pipeline::Options;
use csi5300::pipeline::PathAnswer;
use csi5300_lab::evaluate::{Judged, find};
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `explain`.
#[derive(clap::Args)]
pub struct Args {
    /// A capture, or a link of it: CAPTURE/tx2
    link: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Folder for pictures: phase, trajectory, profile, joint power over azimuth and elevation, and azimuth and range
    #[cfg(feature = "plot")]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Shows links from end to end.
pub fn run(args: &Args) -> Result {
    let options = args.reading.options().unwrap_or_else(|message| usage(&message));
    let options = options.with_keep_course(true);
    let (folder, wanted) = match (args.link.is_dir(), args.link.parent(), args.link.file_name()) {
        (false, Some(folder), Some(name)) => (folder.to_path_buf(), Some(format!("/{}", name.to_string_lossy()))),
        _ => (args.link.clone(), None),
    };
    let (captures, _) = find(&folder);
    let mut shown = 0;
    let mut lost = false;
    for capture in &captures {
        let mut links: Vec<(String, Bearing)> = Vec::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| {
            if wanted.as_ref().is_none_or(|wanted| name.ends_with(wanted.as_str())) {
                links.push((name.to_owned(), bearing.clone()));
            }
        };
        let mut evaluated = capture.evaluate_and(args.reading.source(), args.reading.channel, &options, &mut look);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        for (name, bearing) in &links {
            let Some(row) = evaluated.rows.iter().find(|row| row.answer.link == *name) else { continue };
            print(&describe(row, bearing));
            shown += 1;
            #[cfg(feature = "plot")]
            draw(args, row, bearing)?;
        }
        for row in evaluated.rows.iter().filter(|row| row.answer.error.is_some()) {
            eprintln!("csi5300: {}: {}", row.answer.link, row.answer.error.as_deref().unwrap_or_default());
        }
    }
    match shown {
        0 if captures.is_empty() => Err(format!("no capture in or below {}", folder.display())),
        0 => Err(format!("no link{} in {} gave a bearing", wanted.unwrap_or_default(), folder.display())),
        _ => Ok(if lost { Outcome::DataLost } else { Outcome::Done }),
    }
}

#[cfg(feature = "plot")]
fn draw(args: &Args, row: &Judged, bearing: &Bearing) -> std::result::Result<(), String> {
    let Some(folder) = &args.out else { return Ok(()) };
    let pictures = csi5300_lab::show::link::LinkPictures::of(row, bearing, args.reading.source());
    let written = pictures.write_all(folder, &row.answer.link).map_err(|error| error.to_string())?;
    eprintln!("{}: {} pictures", folder.display(), written.len());
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
    let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
    let _ = writeln!(
        text,
        "answer        {} +- {} deg, within 5 deg with probability {}; {}",
        number(answer.azimuth_deg),
        number(answer.azimuth_sd_deg),
        number(answer.confidence),
        match (answer.range_m, answer.range_sd_m) {
            (Some(range), Some(sd)) => format!("range {range:.2} +- {sd:.2} m"),
            _ => "no range".into(),
        }
    );
    if let Some(mirror) = answer.mirror_deg {
        let _ = writeln!(text, "mirror        {mirror:.2} deg: motion along a line cannot tell them apart");
    }
    if let (Some(truth), Some(error)) = (row.true_from_mean_pose_deg, row.error_from_mean_pose_deg) {
        let range = row.true_range_m.map_or(String::new(), |range| format!("; range {range:.2} m"));
        let _ = writeln!(text, "truth         {truth:.2} deg: off by {error:.2}{range}");
    }
}

/// A line for each path.
pub fn places(paths: &[PathAnswer]) -> String {
    let mut text = String::new();
    for (number, path) in paths.iter().enumerate() {
        let range = path.range_m.map_or("far".into(), |range| format!("{range:.1} m"));
        let elevation = match path.elevation_deg {
            Some(elevation) => format!("elevation {elevation:5.1}"),
            None => format!("|elevation| {:4.1}", path.abs_elevation_deg),
        };
        let _ = write!(
            text,
            "  {}: {:7.2} deg, {elevation} deg, {range}, {:.1} dB",
            number + 1,
            path.azimuth_deg,
            path.relative_power_db
        );
        if let Some([a, b]) = path.cross_term_of {
            let _ = write!(text, ", the product of {} and {}", a + 1, b + 1);
        }
        text.push('\n');
    }
    text
}
