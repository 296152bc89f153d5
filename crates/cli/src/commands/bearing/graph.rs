//! Options of the graph that locates receivers: ranges from another sensor, and the output file.

use super::super::captures::Reading;
use super::super::{some, usage};
use csi5300_lab::evaluate::Capture;
use csi5300_lab::evaluate::receivers::{Located, Ranged};
use csi5300_team::factors;
use csi5300_team::ranges::{Range, read};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    pub fn check(&self, captures: &[Capture], has_place: bool, force: bool) -> Result<(), String> {
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
        super::super::draft::Draft::create(path, force).map(drop)
    }

    /// The ranges of each capture, by its name.
    pub fn ranges(&self, captures: &[Capture], reading: &Reading) -> Result<BTreeMap<String, Vec<Ranged>>, String> {
        let mut found: BTreeMap<String, Vec<Ranged>> = BTreeMap::new();
        let Some(path) = &self.ranges else { return Ok(found) };
        let words = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let text = std::fs::read_to_string(path).map_err(|error| words(&error))?;
        let ranges = read(&text).map_err(|error| words(&error))?;
        let mut taken = vec![false; ranges.len()];
        for capture in captures {
            let trajectory = capture.path(reading.source()).map_err(|error| words(&error))?;
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
            Some((Range { from, to, time_s, .. }, _)) => Err(words(&format!(
                "no capture has {from} and {to} at {time_s} s: the robots are rx and {}, and times are those of the trajectory",
                captures.first().and_then(|capture| capture.transmitters.first()).map_or("tx", |(name, _)| name)
            ))),
            None => Ok(found),
        }
    }

    /// Reports ranges that were not used, and writes the graph.
    pub fn finish(&self, given: &BTreeMap<String, Vec<Ranged>>, found: &Located) -> Result<(), String> {
        for receiver in &found.receivers {
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
        super::super::draft::write(
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_have_short_names_or_names_with_their_capture() {
        let capture = Capture {
            place: "a/b".into(),
            stamp: "t".into(),
            folder: PathBuf::new(),
            loose: None,
            transmitters: vec![("tx2".into(), PathBuf::new()), ("tx12".into(), PathBuf::new())],
            antenna_offset_m: None,
            camera: None,
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
}
