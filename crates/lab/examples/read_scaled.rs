//! Reads a log into memory and decodes its CSI in sqrt(SNR), all antennas, as the Python package does, but without Python: the
//! baseline of `scripts/python_bench.py`. Prints seconds, records and the peak memory in KiB.
//!
//! `cargo run --release --example read_scaled -- LOG`, compiled as the wheel in `python/` is
#![allow(clippy::print_stdout)]

use bytemuck::cast_slice_mut;
use csi5300::source::replay::Replay;
use csi5300::time::Instant;
use csi5300_lab::table::{Filter, Form, Reading, Rows, decode};
use num_complex::Complex32;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let log = std::env::args().nth(1).ok_or("usage: read_scaled LOG")?;
    let began = std::time::Instant::now();
    let mut reading = Reading::new(Replay::open(Path::new(&log))?, Filter::default());
    reading.read_all(Instant::ZERO, || true)?;
    let (arena, columns) = reading.take();
    let widest = columns.widest();
    let rows = Rows::new(&widest.antennas(), widest.streams());
    // Large pages, as NumPy requests them.
    let mut memory = memmap2::MmapMut::map_anon((arena.len() * rows.len() * size_of::<Complex32>()).max(1))?;
    memory.advise(memmap2::Advice::HugePage)?;
    let out: &mut [Complex32] = cast_slice_mut(&mut memory[..arena.len() * rows.len() * size_of::<Complex32>()]);
    let records: Vec<usize> = (0..arena.len()).collect();
    decode(&arena, &records, &rows, Form { scaled: true, without_spatial_mapping: false }, out);
    let took = began.elapsed().as_secs_f64();
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next());
    println!("{took} {} {}", arena.len(), peak.unwrap_or("0"));
    Ok(())
}
