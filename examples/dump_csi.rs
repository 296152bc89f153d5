//! Writes the CSI of a log in three forms, for comparison with other readers. Prints the log's name and its records.
//!
//! `cargo run --example dump_csi -- [LOG OUT]` (default: the fixture of the tests, and `csi5300-dump.bin` in the folder for
//! temporary files) writes OUT as little-endian f64: for each bfee the numbers
//! `offset, timestamp_low, bfee_count, n_rx, n_tx, is_40_mhz` and then three times `30 n_rx n_tx` complex values
//! `[subcarrier][antenna][tx]`: the card's integers, sqrt(SNR), and sqrt(SNR) without spatial mapping.
//! A value that cannot be made (no RSSI, no valid antenna permutation) is NaN.

use std::error::Error;
use std::fs;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

use csi5300::signal::csi::{Csi, scale_factor};
use driver_iface::bfee::Bfee;
use driver_iface::record::{Step, code, events};
use num_complex::Complex64;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let log = arguments.next().unwrap_or_else(|| fixture.to_owned());
    let out = arguments.next().map_or_else(|| std::env::temp_dir().join("csi5300-dump.bin"), PathBuf::from);
    let bytes = fs::read(&log)?;
    // A second log by mistake is not overwritten.
    if out.extension().is_some_and(|ending| ending == "dat") {
        return Err(format!("{}: the output's name must not end in .dat", out.display()).into());
    }
    let mut out = BufWriter::new(fs::File::create(out)?);
    let mut records = 0;
    for step in events(&bytes) {
        match step {
            Step::Record { offset, record, .. } if record.code == code::BFEE => {
                write_record(&mut out, offset, &Bfee::new_checked(record.body)?)?;
                records += 1;
            }
            Step::Bad { offset, skipped, reason } => eprintln!("{log}: {skipped} bytes at {offset}: {reason}"),
            _ => {}
        }
    }
    eprintln!("{log}: {records} records");
    Ok(out.flush()?)
}

fn write_record(out: &mut impl Write, offset: u64, bfee: &Bfee<'_>) -> Result<(), Box<dyn Error>> {
    let counters = [offset as f64, bfee.timestamp_low().into(), bfee.bfee_count().into()];
    let shape = [bfee.n_rx() as f64, bfee.n_tx() as f64, u8::from(bfee.is_40_mhz()).into()];
    for number in counters.into_iter().chain(shape) {
        out.write_all(&number.to_le_bytes())?;
    }
    let factor = scale_factor(bfee).unwrap_or(f64::NAN);
    match Csi::from_bfee(bfee) {
        Ok(csi) => {
            let bare = csi.without_spatial_mapping(bfee.is_40_mhz());
            for (csi, factor) in [(&csi, 1.0), (&csi, factor), (&bare, factor)] {
                for h in csi.as_slice() {
                    write_complex(out, Complex64::new(h.re.into(), h.im.into()) * factor)?;
                }
            }
        }
        Err(_) => (0..3 * bfee.samples()).try_for_each(|_| write_complex(out, Complex64::new(f64::NAN, f64::NAN)))?,
    }
    Ok(())
}

fn write_complex(out: &mut impl Write, h: Complex64) -> std::io::Result<()> {
    out.write_all(&h.re.to_le_bytes())?;
    out.write_all(&h.im.to_le_bytes())
}
