//! `csi5300 locate`.

mod transmitters;

use super::captures::Reading;
use super::{Outcome, Result, fixed, hint, print, print_json, some};
use csi5300::maths::median;
use csi5300_lab::evaluate::quality::{Receiver, UNKNOWN_PROBABILITY, receivers};
use csi5300_lab::evaluate::{Capture, Judged};
use std::fmt::Write;
use std::path::PathBuf;
use transmitters::Together;

// Arguments of `locate`.
#[derive(clap::Args)]
pub struct Args {
    /// Captures, or folders with captures below them; the places of the transmitters are read from
    /// groundtruth_positions.json, where it is there
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    #[command(flatten)]
    together: Together,
    /// Where a transmitter is, metres in the trajectory's frame, as links name it: tx2=-3.18,1.11. For captures without a
    /// truth, or instead of it. With its height as a third number the receiver's height is told, where the motion shows elevations
    #[arg(long, value_name = "NAME=X,Y[,Z]", value_parser = place, allow_hyphen_values = true)]
    place: Vec<(String, Place)>,
    #[command(flatten)]
    reading: Reading,
    /// Draw a map of each capture into this folder: the bearings, the transmitters, the receiver as located
    #[cfg(feature = "plot")]
    #[arg(long, visible_alias = "out", value_name = "DIR", conflicts_with = "transmitters")]
    plot: Option<PathBuf>,
    #[cfg(feature = "plot")]
    #[command(flatten)]
    pictures: super::pictures::Pictures,
    /// JSON Lines: one object a receiver, or a transmitter
    #[arg(long)]
    json: bool,
}

/// Where a transmitter is, and how high if that was given, metres.
type Place = ([f64; 2], Option<f64>);

fn place(text: &str) -> std::result::Result<(String, Place), String> {
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
    /// The captures of all folders, and whether some could not be read. Of several folders each gives its own name to what is
    /// below it.
    fn captures(&self) -> std::result::Result<(Vec<Capture>, bool), String> {
        let (mut captures, mut lost) = (Vec::new(), false);
        for folder in &self.folders {
            let (mut found, unreadable) = self.reading.find(folder)?;
            unreadable.iter().for_each(|folder| wrong!("cannot read {folder}"));
            lost |= !unreadable.is_empty();
            let own = folder.file_name().map(|name| name.to_string_lossy().into_owned());
            if let Some(own) = own.filter(|_| self.folders.len() > 1) {
                let named = |place: &str| if place.is_empty() { own.clone() } else { format!("{own}/{place}") };
                found.iter_mut().for_each(|capture| capture.place = named(&capture.place));
            }
            captures.extend(found);
        }
        Ok((captures, lost))
    }
}

/// Locates the receiver of every capture, or the transmitters of all of them.
pub fn run(args: &Args) -> Result {
    #[cfg(feature = "plot")]
    args.pictures.must_have(args.plot.as_deref(), "--plot");
    if args.together.transmitters {
        return transmitters::run(args);
    }
    let options = args.reading.options()?;
    let (captures, mut lost) = args.captures()?;
    #[cfg(feature = "plot")]
    if let Some(folder) = &args.plot {
        args.pictures.check_maps(folder, &captures)?;
    }
    let mut rows: Vec<Judged> = Vec::new();
    for capture in &captures {
        let mut evaluated = capture.evaluate(args.reading.source(), args.reading.channel, &options);
        hint::add_all(&mut evaluated.rows);
        lost |= evaluated.lost;
        evaluated.notes.iter().for_each(|line| note!("{line}"));
        rows.extend(evaluated.rows);
    }
    for row in &mut rows {
        let own = args.place.iter().find(|(name, _)| row.answer.link.rsplit('/').next() == Some(name));
        row.true_transmitter_m = own.map(|(_, (place, _))| *place).or(row.true_transmitter_m);
        row.transmitter_z_m = own.and_then(|(_, (_, height))| *height);
    }
    let mut found = receivers(&rows);
    found.iter_mut().for_each(|receiver| say_unplaced(receiver, &rows));
    if args.json {
        found.iter().for_each(print_json);
    } else {
        print(&table(&found, &rows));
    }
    #[cfg(feature = "plot")]
    draw(args, &rows)?;
    for row in rows.iter().filter(|row| row.answer.error.is_some()) {
        wrong!("{}: {}", row.answer.link, row.answer.error.as_deref().unwrap_or_default());
    }
    let is_placed = rows.iter().any(|row| row.true_transmitter_m.is_some());
    if !is_placed {
        note!("a receiver is located from transmitters whose places are known: --place NAME=X,Y");
    }
    let is_seen = || !is_placed && rows.iter().any(|row| row.answer.position_m.is_some());
    Ok(match found.iter().any(|receiver| receiver.position_m.is_some()) || is_seen() {
        false => Outcome::Nothing,
        true if lost => Outcome::DataLost,
        true => Outcome::Done,
    })
}

#[cfg(feature = "plot")]
fn draw(args: &Args, rows: &[Judged]) -> std::result::Result<(), String> {
    let Some(folder) = &args.plot else { return Ok(()) };
    let written = csi5300_lab::show::set::write_maps(rows, folder, &args.pictures.format());
    match written.map_err(|error| super::pictures::refused(&error))?.len() {
        0 => note!("no map: nothing says where the receiver drove"),
        count => note!("{}: {}", folder.display(), some(count as u64, "picture", "pictures")),
    }
    Ok(())
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
    let name = |row: &'_ Judged| row.answer.link.rsplit('/').next().unwrap_or_default().to_owned();
    let unplaced: Vec<String> = own(receiver, rows).filter(is_unplaced).map(name).collect();
    let (whose, options) = match &unplaced[..] {
        [] => return,
        [one] => (format!("the place of {one} is"), format!("--place {one}=X,Y")),
        [one, ..] => (format!("the places of {} are", unplaced.join(", ")), format!("--place {one}=X,Y and so on")),
    };
    let unplaced = format!("{whose} not known ({options})");
    let known = if receiver.links == 0 { "not located:".into() } else { format!("{error};") };
    receiver.error = Some(format!("{known} {unplaced}"));
}

fn table(found: &[Receiver], rows: &[Judged]) -> String {
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
                if let (Some(z), Some(sd)) = (receiver.height_m, receiver.height_sd_m) {
                    let _ = write!(text, ", z {} +- {sd:.2} m", fixed(z, 2));
                }
            }
            _ => text += receiver.error.as_deref().unwrap_or("not located"),
        }
        if let Some(off) = receiver.off_m {
            let _ = write!(text, "; {off:.2} m from the truth");
        }
        if receiver.without_probability > 0 {
            let _ = write!(
                text,
                "; {} without a calibrated probability weighed as within 5 degrees with {UNKNOWN_PROBABILITY}",
                some(receiver.without_probability as u64, "link", "links")
            );
        }
        text.push('\n');
        for [x, y] in &receiver.others_m {
            let _ =
                writeln!(text, "  or x {} m, y {} m, which the links fit nearly as well", fixed(*x, 2), fixed(*y, 2));
        }
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

/// The links for which the place speaks for another bearing than their answer.
fn said_otherwise(receiver: &Receiver, rows: &[Judged], text: &mut String) {
    for (link, azimuth_deg) in receiver.names.iter().zip(&receiver.azimuths_deg) {
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
            "bearings of receivers with two or more, mean / median error: {answered} as answered, {fitting} as the places choose among their candidates"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
