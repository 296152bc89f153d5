//! CSI of a stretch as the page takes it: a byte a cell.

use csi5300_lab::course::{StretchCsi, letter};
use driver_iface::Mac;
use serde::Serialize;
use std::f64::consts::PI;

/// The byte of a cell into which nothing fell; values take 0 to 254.
const NOTHING: u8 = 255;

/// A heat map.
#[derive(Serialize)]
struct Map {
    /// The value of byte 0.
    low: f64,
    /// The value of byte 254.
    high: f64,
    /// Base64 of the bytes, `[row][column]`.
    cells: String,
}

#[derive(Serialize)]
struct AntennaMaps {
    antenna: String,
    amplitude_db: Map,
    phase_rad: Map,
}

/// All heat maps of a stretch.
#[derive(Serialize)]
pub(crate) struct Maps {
    from_s: f64,
    to_s: f64,
    columns: usize,
    /// Rows of the maps: a subcarrier each, or some that are neighbours.
    rows: usize,
    /// Index of the subcarrier in the middle of each row; its place where that is not known.
    subcarriers: Vec<i64>,
    /// How many subcarriers share a row.
    subcarriers_a_row: usize,
    /// Kind and width of the frames, of cards other than the 5300.
    frames: Option<String>,
    /// Records with frames of another kind or width.
    other_frames: usize,
    /// The only sender whose records they hold; `None` if the log has no other.
    sender: Option<String>,
    records: usize,
    every: usize,
    antennas: Vec<AntennaMaps>,
}

impl Maps {
    /// Of one antenna, or of all, and of this sender.
    pub fn new(csi: &StretchCsi, antenna: Option<char>, sender: Option<Mac>) -> Self {
        let wanted = csi.antennas.iter().filter(|own| antenna.is_none_or(|wanted| letter(own.antenna) == wanted));
        let maps = |own: &csi5300_lab::course::AntennaCourse| {
            let known = || own.amplitude_db.iter().copied().filter(|db| db.is_finite());
            let (low, high) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
            AntennaMaps {
                antenna: letter(own.antenna).into(),
                amplitude_db: map(&own.amplitude_db, low, high),
                phase_rad: map(&own.phase_rad, -PI, PI),
            }
        };
        let (each, last) = (csi.rows.each, csi.rows.subcarriers.saturating_sub(1));
        let middles = (0..csi.rows.len()).map(|row| csi.rows.index((row * each + each / 2).min(last)));
        Self {
            from_s: csi.from_s,
            to_s: csi.to_s,
            columns: csi.columns,
            rows: csi.rows.len(),
            subcarriers: middles.collect(),
            subcarriers_a_row: csi.rows.each,
            frames: csi.rows.frames.clone(),
            other_frames: csi.other_frames,
            sender: sender.map(|mac| mac.to_string()),
            records: csi.records,
            every: csi.every,
            antennas: wanted.map(maps).collect(),
        }
    }
}

fn map(values: &[f64], low: f64, high: f64) -> Map {
    let step = (high - low).max(1e-9) / 254.0;
    let byte = |value: &f64| match value.is_finite() {
        true => ((value - low) / step).round().clamp(0.0, 254.0) as u8,
        false => NOTHING,
    };
    Map { low, high: low + 254.0 * step, cells: base64(&values.iter().map(byte).collect::<Vec<u8>>()) }
}

/// Base64 with padding (RFC 4648, 4).
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits = three.iter().fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for k in 0..4 {
            let letter = LETTERS.get((bits >> (18 - 6 * k) & 63) as usize).copied().unwrap_or(b'=');
            text.push(if k <= three.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        let known =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("fooba", "Zm9vYmE=")];
        for (bytes, text) in known {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn values_come_back_within_a_step_and_nothing_stays_nothing() {
        let made = map(&[-10.0, 2.5, f64::NAN, 20.0], -10.0, 20.0);
        // 0, 106, none, 254
        assert_eq!(made.cells, base64(&[0, 106, NOTHING, 254]));
        let back = made.low + 106.0 / 254.0 * (made.high - made.low);
        assert!((back - 2.5).abs() <= (made.high - made.low) / 508.0, "{back}");
        // A map of one value is one.
        assert_eq!(map(&[3.0, 3.0], 3.0, 3.0).cells, base64(&[0, 0]));
    }
}
