//! Any bytes as events of the eBPF program's ring: no panic, and every record made from them can be read.
//!
//! The input is a list of `length (1 byte, eight of them each), event`; the first byte chooses the options.

use driver_iface::bfee::{Bfee, Layout, MAX_BODY};
use driver_iface::record::code;
use driver_iface::stock::{Card, Counts, Event, Options};

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let Some((how, mut rest)) = bytes.split_first() else { return };
    let layout = if how & 1 == 0 { Layout::Stock } else { Layout::Wsr };
    let (wants_csi, wants_frames) = (how & 2 == 0, how & 4 == 0);
    let options = Options { layout, csi: wants_csi, frames: wants_frames };
    let (mut card, mut counts, mut records) = (Card::default(), Counts::default(), 0);
    while let Some((len, behind)) = rest.split_first() {
        let (event, behind) = behind.split_at(behind.len().min(8 * usize::from(*len)));
        rest = behind;
        let Some(event) = Event::new_checked(event) else {
            card.gap();
            continue;
        };
        let mut body = [0; MAX_BODY];
        let handled = card.handle(&mut counts, &options, &event.packet(), 1_700_000_000_000_000, &mut body);
        let Some(record) = handled else { continue };
        match record.code {
            code::BFEE => {
                let bfee = Bfee::new_checked(record.body).unwrap();
                assert_eq!(bfee.wsr().is_some(), layout == Layout::Wsr);
                records += 1;
            }
            other => assert_eq!((other, wants_frames), (code::MPDU, true)),
        }
    }
    // Unwanted records are made but not returned.
    assert_eq!(records, if wants_csi { counts.records } else { 0 });
}
