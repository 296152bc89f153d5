//! Prints the frames in a log of another card, one per line: the known fields, then CSI as `re im` pairs.
//!
//! ```text
//! cargo run -p csi-formats --example frames -- log.csi [--csi]
//! ```
#![allow(missing_docs)]

use csi_formats::{Frame, Item, items};
use std::io::Write;

/// A value, or a dash where the format does not contain it.
fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or("-".into(), |value| value.to_string())
}

fn line(frame: &Frame, with_csi: bool) -> String {
    let mac = |mac: [u8; 6]| mac.map(|octet| format!("{octet:02x}")).join(":");
    let rssi: Vec<String> = frame.rssi.iter().map(|rssi| or_dash(*rssi)).collect();
    let measured = frame.measured.iter().filter(|measured| **measured).count();
    let mut line = format!(
        "{} {} {} {} {} {} {} {} {} {} {} {} {}",
        frame.offset,
        or_dash(frame.clock.map(|clock| clock.ticks)),
        or_dash(frame.slow_clock.map(|clock| clock.ticks)),
        or_dash(frame.host_us),
        or_dash(frame.sender.map(mac)),
        or_dash(frame.kind.map(|kind| kind.name())),
        frame.width_mhz,
        frame.n_rx,
        frame.n_tx,
        frame.subcarriers.len(),
        measured,
        frame.first_rx,
        rssi.join(","),
    );
    if with_csi {
        frame.csi.iter().for_each(|[re, im]| line += &format!(" {re} {im}"));
    }
    line
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args_os().nth(1).ok_or("which log?")?;
    let with_csi = std::env::args().any(|word| word == "--csi");
    let bytes = std::fs::read(&path)?;
    let items = items(&bytes).ok_or("a log of none of these cards")?;
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    eprintln!("{}", items.format().name());
    for item in items {
        match item {
            Item::Frame(frame) => writeln!(out, "{}", line(&frame, with_csi))?,
            Item::Skipped(bad) => eprintln!("{} bytes at {}: {}", bad.len, bad.offset, bad.why),
        }
    }
    Ok(())
}
