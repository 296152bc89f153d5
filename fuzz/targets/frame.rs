//! Any bytes as a frame from a monitor interface or a 0xC1 record: refused, or everything read lies inside it, and reading what was
//! written from it gives the same values.

use driver_iface::mpdu;
use driver_iface::radiotap;
use driver_iface::sounding::{Frame, native, wsr};

/// Runs the target.
pub fn run(bytes: &[u8]) {
    if let Ok((repr, frame)) = radiotap::Repr::parse(bytes) {
        sounding(&bytes[frame]);
        let mut header = [0; 64];
        let len = repr.emit(&mut header).unwrap();
        assert_eq!(len, repr.header_len());
        // An FCS that is announced, and is not there.
        let again = radiotap::Repr::parse(&header[..len + 4]);
        assert_eq!(again.unwrap().0, repr);
    }
    sounding(bytes);
    if let Some(repr) = mpdu::Repr::parse(bytes) {
        let mut again = vec![0; repr.emit_len()];
        assert_eq!(repr.emit(&mut again).unwrap(), bytes.len());
        // The checksum is computed again.
        let (written, fcs) = again.split_at(bytes.len() - mpdu::FCS);
        assert!(bytes.starts_with(written));
        assert_eq!(bytes.ends_with(fcs), mpdu::fcs_is_good(bytes));
    }
}

fn sounding(bytes: &[u8]) {
    let Some(frame) = Frame::new_checked(bytes) else { return };
    assert!(frame.body().len() <= bytes.len());
    let _ = wsr::Repr::parse(&frame);
    let mut reply = [0; 2_048];
    let _ = wsr::emit_reply(&frame, [0; 4], frame.sender(), &mut reply);
    let Some(repr) = native::Repr::parse(&frame) else { return };
    let mut again = [0; native::MAX_LEN];
    let len = repr.emit(&mut again).unwrap();
    let parsed = native::Repr::parse(&Frame::new_checked(&again[..len]).unwrap()).unwrap();
    assert_eq!(parsed, repr);
}
