//! Real captures, if available: every record is read, and every intact record is found again after damage.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../tests/common/mod.rs"]
mod shared;

use shared::captures;
use std::path::{Path, PathBuf};

use driver_iface::bfee::{Bfee, Iq, Layout, MAX_SAMPLES};
use driver_iface::mpdu::fcs_is_good;
use driver_iface::record::{Step, Tail, code, events};

fn logs_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(logs_below(&path));
        } else if path.extension().is_some_and(|extension| extension == "dat") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Offsets of records by their lengths alone, and the bytes left over.
fn walk(bytes: &[u8]) -> (Vec<&[u8]>, usize) {
    let (mut records, mut rest) = (Vec::new(), bytes);
    while let Some((&[high, low], _)) = rest.split_first_chunk() {
        let len = 2 + usize::from(u16::from_be_bytes([high, low]));
        let Some((record, after)) = rest.split_at_checked(len) else { break };
        records.push(record);
        rest = after;
    }
    (records, rest.len())
}

fn framed<'a>(bytes: &'a [u8], step: &Step<'_>) -> Option<&'a [u8]> {
    match *step {
        Step::Record { offset, used, .. } => Some(&bytes[offset as usize..offset as usize + used]),
        _ => None,
    }
}

#[test]
fn every_record_of_every_capture_is_read() {
    let Some(folder) = captures() else { return };
    let (mut files, mut total, mut cut) = (0, 0, 0);
    for path in logs_below(&folder) {
        let bytes = std::fs::read(&path).unwrap();
        let (expect, left) = walk(&bytes);
        let steps: Vec<_> = events(&bytes).collect();
        let got: Vec<_> = steps.iter().filter_map(|step| framed(&bytes, step)).collect();
        assert_eq!(got.len(), steps.len() - 1, "{}: damage reported", path.display());
        assert!(got == expect, "{}: not the same records", path.display());
        let Some(&Step::End(tail)) = steps.last() else { panic!("no end") };
        match tail {
            Tail::Clean => assert_eq!(left, 0),
            Tail::Cut { bytes: n, .. } => {
                assert_eq!(n, left as u64);
                assert_eq!(tail.is_unflushed_buffer(), bytes.len() % 4096 == 0);
                cut += 1;
            }
        }
        files += 1;
        total += got.len();
    }
    println!("{files} files, {total} records, {cut} cut tails");
    assert!(files > 0 && total > 0);
}

#[test]
fn every_bfee_unpacks_alike_and_every_frame_has_its_checksum() {
    let Some(folder) = captures() else { return };
    let (mut stock, mut wsr, mut frames) = (0, 0, 0);
    for path in logs_below(&folder) {
        let bytes = std::fs::read(&path).unwrap();
        for (k, step) in events(&bytes).enumerate() {
            let Step::Record { record, .. } = step else { continue };
            if record.code == code::MPDU {
                assert!(fcs_is_good(record.body));
                frames += 1;
                continue;
            }
            let bfee = Bfee::new_checked(record.body).unwrap();
            assert!(bfee.gaps_are_clear() && bfee.antennas().is_ok());
            if bfee.layout() == Layout::Wsr {
                wsr += 1
            } else {
                stock += 1
            }
            if k % 16 == 0 {
                let (mut words, mut bits) = ([Iq::default(); MAX_SAMPLES], [Iq::default(); MAX_SAMPLES]);
                bfee.unpack(&mut words).unwrap();
                bfee.unpack_bits(&mut bits).unwrap();
                assert!(words == bits, "{}: record {k}", path.display());
            }
        }
    }
    println!("{stock} stock, {wsr} WSR, {frames} frames");
    assert!(stock > 0 && wsr > 0 && frames > 0);
}

/// xorshift, so that the damage is the same on every run.
fn noise(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// Intact records (those without byte `at`) that are not found in order, and found records that do not exist.
fn lost_and_false(intact: &[&[u8]], at: usize, damaged: &[u8]) -> (usize, usize) {
    let steps: Vec<_> = events(damaged).collect();
    let found: Vec<_> = steps.iter().filter_map(|step| framed(damaged, step)).collect();
    let (mut end, mut next, mut lost, mut matched) = (0, 0, 0, 0);
    for record in intact {
        end += record.len();
        if at < end && at + record.len() >= end {
            continue;
        }
        match found[next..].iter().take(3).position(|f| f == record) {
            Some(k) => {
                next += k + 1;
                matched += 1;
            }
            None => lost += 1,
        }
    }
    (lost, found.len() - matched)
}

#[test]
fn damage_costs_the_record_it_is_in() {
    let Some(folder) = captures() else { return };
    let mut state = 88_172_645_463_325_252_u64;
    let (mut cases, mut lost, mut counterfeit) = (0, 0, 0);
    for path in logs_below(&folder).iter().filter(|path| path.components().any(|c| c.as_os_str() == "csitool")) {
        let mut bytes = std::fs::read(path).unwrap();
        bytes.truncate(20_000);
        let (intact, left) = walk(&bytes);
        let whole = &bytes[..bytes.len() - left];
        for case in 0..1_500 {
            let at = (noise(&mut state) % whole.len() as u64) as usize;
            let mut damaged = whole.to_vec();
            if case % 2 == 0 {
                damaged.remove(at);
            } else {
                damaged.splice(at..at, (0..100).map(|_| noise(&mut state) as u8));
            }
            let (gone, fake) = lost_and_false(&intact, at, &damaged);
            assert!(gone <= 1, "{} damaged at {at} (case {case}): {gone} intact records lost", path.display());
            (cases, lost, counterfeit) = (cases + 1, lost + gone, counterfeit + fake);
        }
    }
    println!("{cases} cases: {lost} intact records lost, {counterfeit} damaged ones believed");
    assert!(lost * 100 <= cases, "{lost} intact records lost in {cases} cases");
    assert!(counterfeit * 10 <= cases, "{counterfeit} damaged records believed in {cases} cases");
}
