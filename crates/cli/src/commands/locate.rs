//! `csi5300 locate`.

use super::captures::Reading;
use super::{Outcome, Result, hint, print, print_json};
use csi5300::maths::median;
use csi5300_lab::evaluate::quality::{Receiver, UNKNOWN_PROBABILITY, receivers};
use csi5300_lab::evaluate::{Judged, find};
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `locate`.
#[derive(clap::Args)]
pub struct Args {
    /// A capture, or a folder with captures below it; the places of the transmitters are read from
    /// groundtruth_positions.json
    folder: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// JSON Lines: one object a receiver
    #[arg(long)]
    json: bool,
}

/// Locates the receiver of every capture.
pub fn run(args: &Args) -> Result {
    let options = args.reading.options()?;
    let (captures, unreadable) = find(&args.folder);
    for folder in &unreadable {
        eprintln!("csi5300: cannot read {folder}");
    }
    if captures.is_empty() {
        return Err(format!("no capture in or below {}", args.folder.display()));
    }
    let mut lost = !unreadable.is_empty();
    let mut rows: Vec<Judged> = Vec::new();
    for capture in &captures {
        let mut evaluated = capture.evaluate(args.reading.source(), args.reading.channel, &options);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        rows.extend(evaluated.rows);
    }
    let found = receivers(&rows);
    if args.json {
        found.iter().for_each(print_json);
    } else {
        print(&table(&found, &rows));
    }
    Ok(match found.iter().any(|receiver| receiver.position_m.is_some()) {
        false => Outcome::Nothing,
        true if lost => Outcome::DataLost,
        true => Outcome::Done,
    })
}

fn table(found: &[Receiver], rows: &[Judged]) -> String {
    let mut text = String::new();
    for receiver in found {
        let _ = write!(text, "{}: ", receiver.capture);
        match (receiver.position_m, receiver.covariance_m2) {
            (Some([x, y]), Some(c)) => {
                let _ = write!(
                    text,
                    "x {x:.2} +- {:.2} m, y {y:.2} +- {:.2} m from {} links",
                    c[0][0].sqrt(),
                    c[1][1].sqrt(),
                    receiver.links
                );
            }
            _ => text += receiver.error.as_deref().unwrap_or("not located"),
        }
        if let Some(off) = receiver.off_m {
            let _ = write!(text, "; {off:.2} m from the truth");
        }
        if receiver.without_probability > 0 {
            let _ = write!(
                text,
                "; {} links without a calibrated probability weighed as within 5 degrees with {UNKNOWN_PROBABILITY}",
                receiver.without_probability
            );
        }
        text.push('\n');
        let own = rows.iter().filter(|row| row.answer.link.starts_with(&format!("{}/", receiver.capture)));
        for row in own {
            let Some([x, y, z]) = row.answer.position_m else { continue };
            let _ = writeln!(text, "  {}: seen at x {x:.2}, y {y:.2}, z {z:.2} m", row.answer.link);
        }
    }
    let mut off: Vec<f64> = found.iter().filter_map(|receiver| receiver.off_m).collect();
    if let Some(median) = median(&mut off) {
        let _ = writeln!(text, "{} receivers located, median error {median:.2} m", off.len());
    }
    text
}
