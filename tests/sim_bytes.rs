//! The paper's own captures, simulated and real, read and written again by our encoder, are byte-identical.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use driver_iface::bfee::{Bfee, Iq, MAX_SAMPLES, Repr};
use driver_iface::record::{Record, Step, Tail, events};

/// Parses a log and writes every record anew, up to a cut tail.
fn again(bytes: &[u8]) -> (Vec<u8>, usize) {
    let (mut out, mut records) = (Vec::with_capacity(bytes.len()), 0);
    for event in events(bytes) {
        let record = match event {
            Step::Record { record, .. } => record,
            Step::End(Tail::Clean | Tail::Cut { .. }) => break,
            other => panic!("damage in a simulated capture: {other:?}"),
        };
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
    let Some(captures) = common::captures() else { return };
    for shape in ["circle", "line"] {
        for end in ["rx", "tx"] {
            let path = captures.join("paper").join(shape).join(format!("csi_{end}_sim_30cm_1.dat"));
            let bytes = std::fs::read(&path).unwrap();
            let (written, records) = again(&bytes);
            assert_eq!(records, 1_000, "{}", path.display());
            assert!(written == bytes, "{} differs after reading and writing", path.display());
        }
    }
}

#[test]
fn the_papers_real_captures_survive_it_too() {
    let Some(captures) = common::captures() else { return };
    let mut files = 0;
    for shape in ["circle", "line"] {
        for entry in std::fs::read_dir(captures.join("paper").join(shape)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if !(name.ends_with(".dat") && name.contains("_real_")) {
                continue;
            }
            let bytes = std::fs::read(&path).unwrap();
            let (written, records) = again(&bytes);
            assert!(records > 2_500 && bytes.len() - written.len() < 233, "{name}: {records} records");
            assert!(bytes.starts_with(&written), "{name} differs after reading and writing");
            files += 1;
        }
    }
    assert_eq!(files, 12);
}
