//! Logs of cards other than the 5300, in `csi5300 info`.

use super::{print, print_json, some};
use csi_formats::{Format, Frame, Item, Items, Why, detect};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::io::Read;
use std::path::Path;

/// What is in a log, as JSON has it.
#[derive(serde::Serialize)]
pub struct Row {
    file: String,
    bytes: u64,
    /// The kind of log, in words.
    format: &'static str,
    frames: u64,
    cards: BTreeMap<String, u64>,
    /// Frames by kind, width, chains and number of subcarriers.
    shapes: BTreeMap<String, u64>,
    senders: BTreeMap<String, u64>,
    /// From the first frame to the last by the host's clock, seconds; null where it is not in the log.
    host_span_s: Option<f64>,
    /// Bytes that are no frame with CSI, by why.
    skipped: BTreeMap<String, u64>,
    /// The most receive chains in one frame.
    #[serde(skip)]
    n_rx: usize,
    /// Some of them should have been: not a frame without CSI, nor the end of a log that was cut.
    #[serde(skip)]
    is_damaged: bool,
}

impl Row {
    /// True if there is CSI in the log.
    pub fn is_usable(&self) -> bool {
        self.frames > 0
    }

    /// True if bytes could not be read.
    pub fn lost_something(&self) -> bool {
        self.is_damaged
    }

    /// Prints it, as a line of JSON or as text, parted from what was printed before.
    pub fn show(&self, json: bool, parted: bool) {
        match json {
            true => print_json(self),
            false => print(&format!("{}{}", if parted { "\n" } else { "" }, self.text())),
        }
    }

    fn text(&self) -> String {
        let mut text =
            format!("{}: {} bytes, {}, {}\n", self.file, self.bytes, self.format, some(self.frames, "frame", "frames"));
        for (what, counts) in [("card", &self.cards), ("frames", &self.shapes), ("sender", &self.senders)] {
            for (key, count) in counts {
                let _ = writeln!(text, "  {what} {key}: {count}");
            }
        }
        if let Some(span_s) = self.host_span_s {
            let _ = writeln!(text, "  {span_s:.3} s by the host's clock");
        }
        for (why, bytes) in &self.skipped {
            let _ = writeln!(text, "  not read: {bytes} bytes: {why}");
        }
        let _ = writeln!(text, "  bearings: {}", self.bearings());
        text
    }

    /// Which bearings such a log can give.
    fn bearings(&self) -> &'static str {
        match (self.format, self.n_rx) {
            ("FeitCSI", 2..) => {
                "of two robots that exchanged frames, or of one with two antennas (`bearing --baseline`)"
            }
            ("FeitCSI", _) => "of two robots that exchanged frames",
            (_, 2..) => "of one robot with two antennas (`bearing --baseline`)",
            _ => "none; one log needs two antennas in the same frame, and each frame here has one",
        }
    }
}

fn shape(frame: &Frame) -> String {
    let kind = frame.kind.map_or("", |kind| kind.name());
    let (width, n) = (frame.width_mhz, frame.subcarriers.len());
    format!("{kind} {width} MHz, {}x{} chains, {n} subcarriers", frame.n_rx, frame.n_tx).trim_start().to_owned()
}

fn survey(path: &Path, format: Format, bytes: &[u8]) -> Row {
    let mut row = Row {
        file: path.display().to_string(),
        bytes: bytes.len() as u64,
        format: format.name(),
        frames: 0,
        cards: BTreeMap::new(),
        shapes: BTreeMap::new(),
        senders: BTreeMap::new(),
        host_span_s: None,
        skipped: BTreeMap::new(),
        n_rx: 0,
        is_damaged: false,
    };
    let mut first_us = None;
    for item in Items::new(format, bytes) {
        match item {
            Item::Frame(frame) => {
                row.frames += 1;
                row.n_rx = row.n_rx.max(frame.n_rx);
                *row.cards.entry(frame.card.to_string()).or_default() += 1;
                *row.shapes.entry(shape(&frame)).or_default() += 1;
                let octets = frame.sender.map(|mac| mac.map(|octet| format!("{octet:02x}")).join(":"));
                *row.senders.entry(octets.unwrap_or_else(|| "unknown".into())).or_default() += 1;
                if let Some(host_us) = frame.host_us {
                    let first_us = *first_us.get_or_insert(host_us);
                    row.host_span_s = Some((host_us - first_us) as f64 * 1e-6);
                }
            }
            Item::Skipped(bad) => {
                *row.skipped.entry(bad.why.to_string()).or_default() += bad.len;
                row.is_damaged |= !matches!(bad.why, Why::NoCsi | Why::Cut);
            }
        }
    }
    row
}

/// The log of another card, if a file is one; `None` for any other file, and for one that cannot be read.
pub fn read(path: &Path) -> Option<Row> {
    bytes(path).map(|(format, bytes)| survey(path, format, &bytes))
}

/// Its kind and its bytes.
pub fn bytes(path: &Path) -> Option<(Format, Vec<u8>)> {
    // A pipe can be opened and read only once.
    let mut file = path.is_file().then(|| std::fs::File::open(path).ok()).flatten()?;
    let mut bytes = Vec::new();
    file.by_ref().take(csi_formats::DETECT as u64).read_to_end(&mut bytes).ok()?;
    let format = detect(&bytes)?;
    file.read_to_end(&mut bytes).ok()?;
    Some((format, bytes))
}
