//! What is in a log. Prints its frames and their channel, each sender, what was lost, and how the log ended.
//!
//! `cargo run --example read_log -- [LOG.dat]` (default: the fixture of the tests)

use csi5300::Log;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let path = std::env::args().nth(1).unwrap_or_else(|| fixture.into());
    let mut log = Log::open(&path)?;
    for (k, frame) in (&mut log).enumerate() {
        let frame = frame?;
        if k < 3 {
            let (csi, sender) = (&frame.csi, frame.mac.unwrap_or_default());
            println!(
                "frame {:?} from {sender} at {} us: 30 x {} x {}",
                frame.number,
                frame.card_us,
                csi.n_rx(),
                csi.n_tx()
            );
        }
    }
    println!("{} bytes, end: {:?}", log.bytes(), log.tail());
    let survey = log.survey();
    println!("{} intact bfee records", survey.bfees());
    for (mac, sender) in &survey.senders {
        println!("{} frames from {mac}, {:.1} Hz", sender.records, sender.rate_hz().unwrap_or_default());
    }
    for loss in &survey.losses {
        println!("lost: {} bytes at {}: {}", loss.bytes, loss.offset, loss.reason);
    }
    Ok(())
}
