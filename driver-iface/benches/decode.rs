//! Decodes a log as a stream to `f32` on one thread with a fixed buffer, in the processor's widest vectors.
//!
//! `cargo bench -p driver-iface --bench decode -- [LOG [RUNS]]` prints, for each of three tasks, the median time of the runs and
//! the records per second. Without a log, it writes 200 MB of records made by `emit` to a temporary file. `--write LOG` only
//! writes them; `--write-frames LOG` writes a log in which a copy of its frame (0xC1) precedes each. `scripts/decode_bench.sh`
//! runs it against csiread.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use std::fs::File;
use std::hint::black_box;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use fearless_simd::{Level, dispatch};

use driver_iface::bfee::{ALL_SUBCARRIERS, Bfee, Iq, MAX_SAMPLES, Repr, Wsr};
use driver_iface::record::{Framer, LOOKAHEAD, Record, Step, code};

/// Buffer: look-ahead and 192 KiB to read into; both stay in the second-level cache.
const BUFFER: usize = LOOKAHEAD + 192 * 1024;

/// What is decoded from each record.
#[derive(Clone, Copy)]
enum Task {
    /// Everything.
    All,
    /// Some subcarriers of antenna A.
    Column(&'static [u8]),
}

/// The floats of a record, aligned so that no wide vector straddles two cache lines.
#[repr(align(64))]
struct Out([f32; 2 * MAX_SAMPLES]);

const EIGHT: [u8; 8] = [0, 4, 8, 12, 16, 20, 24, 28];
const TASKS: [(&str, Task); 3] =
    [("all", Task::All), ("antenna30", Task::Column(&ALL_SUBCARRIERS)), ("antenna8", Task::Column(&EIGHT))];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [write, log] = &arguments[..]
        && let Some(frames) = ["--write", "--write-frames"].iter().position(|option| option == write)
    {
        return write_log(Path::new(log), frames == 1);
    }
    let runs = arguments.get(1).map_or(5, |runs| runs.parse().expect("RUNS is a number"));
    let (log, made) = match arguments.first() {
        Some(log) => (PathBuf::from(log), false),
        None => {
            let log = std::env::temp_dir().join(format!("csi5300-decode-{}.dat", std::process::id()));
            write_log(&log, false);
            (log, true)
        }
    };
    for (name, task) in TASKS {
        let mut times = Vec::new();
        let level = Level::new();
        let mut records = dispatch!(level, _ => decode(&log, task));
        for _ in 0..runs {
            let start = Instant::now();
            records = dispatch!(level, _ => decode(&log, task));
            times.push(start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let median = times[times.len() / 2];
        println!("{name} {records} records {median:.6} s {:.3} M/s", records as f64 / median * 1e-6);
    }
    if made {
        std::fs::remove_file(log).unwrap();
    }
}

/// Reads the log to its end; returns the number of decoded records.
#[inline(always)]
fn decode(log: &Path, task: Task) -> u64 {
    let mut file = File::open(log).unwrap();
    let mut buffer = vec![0; BUFFER];
    let mut out = Out([0.0_f32; 2 * MAX_SAMPLES]);
    let mut framer = Framer::new();
    let (mut from, mut to, mut end, mut records) = (0, 0, false, 0);
    loop {
        match framer.step(&buffer[from..to], end) {
            Step::Record { used, record, .. } => {
                records += u64::from(record.code == code::BFEE && decode_record(&record, task, &mut out.0));
                from += used;
            }
            Step::Bad { skipped, .. } => from += skipped,
            Step::End(_) => return records,
            Step::Incomplete => {
                buffer.copy_within(from..to, 0);
                (from, to) = (0, to - from);
                let read = file.read(&mut buffer[to..]).unwrap();
                end = read == 0;
                to += read;
            }
        }
    }
}

#[inline(always)]
fn decode_record(record: &Record<'_>, task: Task, out: &mut [f32; 2 * MAX_SAMPLES]) -> bool {
    let Ok(bfee) = Bfee::new_checked(record.body) else { return false };
    match task {
        Task::All => bfee.unpack_f32(out),
        Task::Column(subcarriers) => {
            let Some(chain) = bfee.chain_of(driver_iface::bfee::Antenna::A) else { return false };
            bfee.column_f32(chain, 0, subcarriers, out)
        }
    };
    black_box(&*out);
    true
}

/// A log of 200 MB, 3x1, WSR layout; with `frames`, 100 MB more: a data frame of 128 bytes before each record.
fn write_log(log: &Path, frames: bool) {
    let mut file = std::io::BufWriter::new(File::create(log).unwrap());
    let csi: Vec<Iq> = (0..90_u8).map(|k| Iq { i: k.cast_signed(), q: 7 }).collect();
    // Addresses 1, 2 and 3, a sequence number, and a payload without a pattern.
    let mut frame: Vec<u8> = (0..128_u32).map(|k| (k * k * 7 + 3) as u8).collect();
    frame[..2].copy_from_slice(&[8, 0]);
    for count in 0..858_369_u32 {
        if frames {
            frame[22..24].copy_from_slice(&((count << 4) as u16).to_le_bytes());
            let mut bytes = [0; 200];
            let length = Record { code: code::MPDU, body: &frame }.emit(&mut bytes).unwrap();
            file.write_all(&bytes[..length]).unwrap();
        }
        let wsr = Some(Wsr { frame_count: Some(count), ..Wsr::default() });
        let repr = Repr { bfee_count: count as u16, timestamp_low: count.wrapping_mul(8_000), wsr, ..Repr::default() };
        let (mut body, mut bytes) = ([0; 600], [0; 600]);
        let length = repr.emit(&csi, &mut body).unwrap();
        let length = Record { code: code::BFEE, body: &body[..length] }.emit(&mut bytes).unwrap();
        file.write_all(&bytes[..length]).unwrap();
    }
    file.flush().unwrap();
}
