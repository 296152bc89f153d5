//! The paper's own simulated captures, read and written again by our encoder, are byte-identical.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use driver_iface::bfee::{Bfee, Iq, MAX_SAMPLES, Repr};
use driver_iface::record::{Event, Record, events};
use std::path::PathBuf;

/// The folder of real captures: `CSI5300_CAPTURES`, or `../shared/captures` beside the package.
fn captures() -> PathBuf {
    std::env::var_os("CSI5300_CAPTURES")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/captures"), PathBuf::from)
}

/// Parses a log and writes every record anew.
fn again(bytes: &[u8]) -> (Vec<u8>, usize) {
    let (mut out, mut records) = (Vec::with_capacity(bytes.len()), 0);
    for event in events(bytes) {
        let Event::Record { record, .. } = event else { panic!("damage in a simulated capture: {event:?}") };
        let bfee = Bfee::new_checked(record.body).unwrap();
        let mut csi = [Iq::default(); MAX_SAMPLES];
        let samples = bfee.unpack(&mut csi).unwrap();
        let repr = Repr::parse(&bfee);
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi[..samples], &mut body).unwrap();
        let copy = Record { code: record.code, body: &body };
        let at = out.len();
        out.resize(at + copy.emit_len(), 0);
        copy.emit(&mut out[at..]).unwrap();
        records += 1;
    }
    (out, records)
}

#[test]
fn the_papers_simulated_captures_survive_our_encoder() {
    let mut files = 0;
    for shape in ["circle", "line"] {
        for end in ["rx", "tx"] {
            let path = captures().join("paper").join(shape).join(format!("csi_{end}_sim_30cm_1.dat"));
            let Ok(bytes) = std::fs::read(&path) else {
                println!("skipped: no {} (set CSI5300_CAPTURES to the folder of captures)", path.display());
                continue;
            };
            let (written, records) = again(&bytes);
            assert_eq!(records, 1_000, "{}", path.display());
            assert!(written == bytes, "{} differs after reading and writing", path.display());
            files += 1;
        }
    }
    println!("{files} of 4 simulated captures compared");
}
