//! What is in a log: counts, senders, losses, and how it ended.
//!
//! `cargo run --example read_log -- [LOG.dat]` (default: the fixture of the tests)

use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let path = std::env::args().nth(1).map_or_else(|| PathBuf::from(fixture), PathBuf::from);
    let mut log = Replay::open(&path)?;
    let mut survey = Survey::default();
    loop {
        let next = log.receive(Instant::ZERO)?;
        if let Next::Lost(loss) = &next {
            println!("lost: {loss:?}");
        }
        survey.note(&next);
        if let Next::End(tail) = next {
            println!("{} bytes, end: {tail:?}", log.bytes());
            break;
        }
    }
    println!("{} intact bfee records", survey.bfees());
    for (mac, sender) in &survey.senders {
        println!("{} frames from {mac}, {:.1} Hz", sender.records, sender.rate_hz().unwrap_or_default());
    }
    Ok(())
}
