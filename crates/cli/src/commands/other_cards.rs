//! Logs of cards other than the 5300, in `csi5300 info`.

use super::{print, print_json, some};
use csi_formats::{Format, Items};
use csi5300_lab::cards::{self, CardSurvey};
use driver_iface::Mac;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// What is in a log, as JSON has it.
#[derive(serde::Serialize)]
pub struct Row {
    file: String,
    bytes: u64,
    /// The kind of log, in words.
    format: &'static str,
    senders: BTreeMap<String, u64>,
    /// The pictures drawn.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<PathBuf>,
    #[serde(flatten)]
    survey: CardSurvey,
}

impl Row {
    fn new(path: &Path, format: Format, bytes: &[u8]) -> Self {
        let mut survey = CardSurvey::default();
        Items::new(format, bytes).for_each(|item| survey.note(&item));
        let name = |mac: &Mac| if *mac == Mac::default() { "unknown".into() } else { mac.to_string() };
        Self {
            file: path.display().to_string(),
            bytes: bytes.len() as u64,
            format: format.name(),
            senders: survey.senders.iter().map(|(mac, count)| (name(mac), *count)).collect(),
            pictures: Vec::new(),
            survey,
        }
    }

    /// True if there is CSI in the log.
    pub fn is_usable(&self) -> bool {
        self.survey.frames > 0
    }

    /// True if bytes could not be read.
    pub fn lost_something(&self) -> bool {
        self.survey.is_damaged
    }

    /// Prints it, as a line of JSON or as text, parted from what was printed before.
    pub fn show(&self, json: bool, parted: bool) {
        match json {
            true => print_json(self),
            false => print(&format!("{}{}", if parted { "\n" } else { "" }, self.text())),
        }
    }

    fn text(&self) -> String {
        let survey = &self.survey;
        let frames = some(survey.frames, "frame", "frames");
        let mut text = format!("{}: {} bytes, {}, {frames}\n", self.file, self.bytes, self.format);
        for (what, counts) in [("card", &survey.cards), ("frames", &survey.shapes), ("sender", &self.senders)] {
            for (key, count) in counts {
                let _ = writeln!(text, "  {what} {key}: {count}");
            }
        }
        if let Some(span_s) = survey.host_span_s {
            let _ = writeln!(text, "  {span_s:.3} s by the host's clock");
        }
        for (why, bytes) in &survey.skipped {
            let _ = writeln!(text, "  not read: {bytes} bytes: {why}");
        }
        let _ = writeln!(text, "  bearings: {}", self.bearings());
        text
    }

    /// Which bearings such a log can give.
    fn bearings(&self) -> &'static str {
        match (self.format, self.survey.n_rx) {
            ("FeitCSI", 2..) => {
                "of two robots that exchanged frames, or of one with two antennas (`bearing --baseline`)"
            }
            ("FeitCSI", _) => "of two robots that exchanged frames",
            (_, 2..) => "of one robot with two antennas (`bearing --baseline`)",
            _ => "none; one log needs two antennas in the same frame, and each frame here has one",
        }
    }
}

/// The log of another card, if a file is one; `None` for any other file, and for one that cannot be read.
pub fn read(path: &Path) -> Option<Row> {
    cards::read(path).map(|(format, bytes)| Row::new(path, format, &bytes))
}
