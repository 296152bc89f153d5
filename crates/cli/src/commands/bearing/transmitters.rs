//! `csi5300 bearing CAPTURE --transmitters`: each transmitter from all captures together.

use super::super::Words;
use super::super::captures::Reading;
use super::super::{Outcome, Result, fixed, print, print_json, some, usage};
use super::captures::Place;
use csi5300_lab::evaluate::Capture;
use csi5300_lab::evaluate::transmitters::{Frame, Located, Motion, located};
use std::collections::BTreeMap;
use std::fmt::Write;

// How captures lie to each other.
#[derive(clap::Args)]
#[command(next_help_heading = "Transmitters from several captures")]
pub struct Together {
    /// Locate each transmitter from all captures together. Their trajectories must share one frame (motion capture), or
    /// use --frame
    #[arg(long, requires = "captures", conflicts_with = "explain", hide_short_help = true)]
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

    /// Refuses frames of captures that are not there.
    fn must_be_of(&self, captures: &[Capture]) {
        for (name, _) in &self.frame {
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
    let parts = text.split_once('=').filter(|(name, _)| !name.is_empty()).and_then(|(name, place)| {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
        let numbers: Vec<f64> = place.split(',').map(number).collect::<Option<_>>()?;
        let [x, y, deg] = numbers[..] else { return None };
        Some((name.trim_end_matches('/').to_owned(), Frame { origin_m: [x, y], yaw_rad: deg.to_radians() }))
    });
    parts.ok_or_else(|| "a capture's name, metres, metres, degrees, such as kitchen=4.2,-1,90".into())
}

/// Locates every transmitter of the captures.
pub fn run(
    together: &Together,
    reading: &Reading,
    (captures, mut lost): (Vec<Capture>, bool),
    told: &[(String, Place)],
    json: bool,
) -> Result {
    let options = reading.options()?;
    together.must_be_of(&captures);
    let (mut motions, mut failed): (Vec<Motion>, Vec<(String, String)>) = (Vec::new(), Vec::new());
    for capture in &captures {
        let frame = together.frame(capture);
        let found = capture.motions(reading.source(), reading.channel, &options, 1, frame);
        lost |= found.lost;
        found.notes.iter().for_each(|line| note!("{line}"));
        motions.extend(found.motions);
        failed.extend(found.failed);
    }
    let told: BTreeMap<String, [f64; 2]> = told.iter().map(|(name, (place, _))| (name.clone(), *place)).collect();
    let found = located(&motions, &told);
    if json {
        found.iter().for_each(print_json);
    } else {
        print(&table(&found));
    }
    failed.iter().for_each(|(link, error)| wrong!("{link}: {error}"));
    Ok(match found.iter().any(|one| one.position_m.is_some()) {
        false => Outcome::Nothing,
        true if lost => Outcome::DataLost,
        true => Outcome::Done,
    })
}

fn table(found: &[Located]) -> String {
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
        if one.refused > 0 {
            let _ = write!(text, ", {} unusable", one.refused);
        }
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
    fn a_frame_has_a_place_and_a_direction() {
        let (name, found) = frame("a/b/=1,-2.5, 90").unwrap();
        assert_eq!((name.as_str(), found.origin_m), ("a/b", [1.0, -2.5]));
        assert!((found.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        for wrong in ["a=1,2", "=1,2,3", "a=1,2,nan", "a", "a=1,2,3,4"] {
            assert!(frame(wrong).is_err_and(|why| why.contains("degrees")), "{wrong}");
        }
    }
}
