//! Decodes one antenna and eight subcarriers of each packet, and nothing else. Prints, for five of them, which
//! chain the antenna is and its eight coefficients.
//!
//! `cargo run --example lazy_decode`

use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::record::{Step, code, events};

fn main() {
    let log = include_bytes!("../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let middle = [11, 12, 13, 14, 15, 16, 17, 18];
    let mut shown = 0;
    for step in events(log) {
        let Step::Record { record, .. } = step else { continue };
        if record.code != code::BFEE || shown == 5 {
            continue;
        }
        // The checked view is the only door; after it no accessor can fail.
        let Ok(bfee) = Bfee::new_checked(record.body) else { continue };
        let Some(chain) = bfee.chain_of(Antenna::A) else { continue };
        let column = middle.iter().filter_map(|subcarrier| bfee.iq(*subcarrier, chain, 0));
        let text: Vec<_> = column.map(|h| format!("{:+}{:+}j", h.i, h.q)).collect();
        println!("antenna_sel 0x{:02x}, antenna A is chain {chain}: {}", bfee.antenna_sel(), text.join(" "));
        shown += 1;
    }
}
