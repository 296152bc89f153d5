//! A log in the form of csiread's `Intel`: zeros where a record has no CSI, rows by `antenna_sel`, frames beside.

use crate::error::{Failure, Kind};
use crate::patient::open_at_once;
use crate::pool::pool;
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_lab::table::{Arena, antenna_order};
use driver_iface::bfee::{ALL_SUBCARRIERS, Bfee, SUBCARRIERS};
use driver_iface::mpdu::Header;
use driver_iface::record::code;
use num_complex::{Complex32, Complex64};
use numpy::{IntoPyArray, PyArray4, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rayon::prelude::*;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::error::detached;

/// Records between two checks for signals.
const BURST: usize = 65_536;

/// 0xC1 records, a column per field.
#[derive(Default)]
struct Frames {
    fc: Vec<u16>,
    dur: Vec<u16>,
    des: Vec<u8>,
    src: Vec<u8>,
    bssid: Vec<u8>,
    seq: Vec<u16>,
    payload: Vec<u8>,
}

impl Frames {
    fn push(&mut self, body: &[u8], payload_size: usize) {
        let Some(header) = Header::new_checked(body) else { return };
        self.fc.push(header.frame_control());
        self.dur.push(header.duration_us());
        self.des.extend(header.addr1().0);
        // A field that the type of frame does not have is zero.
        self.src.extend(header.addr2().unwrap_or_default().0);
        self.bssid.extend(header.addr3().unwrap_or_default().0);
        self.seq.push(header.seq_ctrl().unwrap_or(0));
        let kept = body.get(..payload_size.min(body.len())).unwrap_or_default();
        self.payload.extend_from_slice(kept);
        self.payload.resize(self.payload.len() + payload_size - kept.len(), 0);
    }

    fn into_arrays(self, arrays: &Bound<'_, PyDict>, payload_size: usize) -> PyResult<()> {
        let (py, n) = (arrays.py(), self.fc.len());
        arrays.set_item("fc", self.fc.into_pyarray(py))?;
        arrays.set_item("dur", self.dur.into_pyarray(py))?;
        arrays.set_item("addr_des", self.des.into_pyarray(py).reshape([n, 6])?)?;
        arrays.set_item("addr_src", self.src.into_pyarray(py).reshape([n, 6])?)?;
        arrays.set_item("addr_bssid", self.bssid.into_pyarray(py).reshape([n, 6])?)?;
        arrays.set_item("seq", self.seq.into_pyarray(py))?;
        arrays.set_item("payload", self.payload.into_pyarray(py).reshape([n, payload_size])?)
    }
}

/// The result of reading a log.
#[derive(Default)]
struct Read1 {
    arena: Arena,
    frames: Frames,
    largest: (usize, usize),
    skipped: u64,
    ended: bool,
}

impl Read1 {
    /// Reads [`BURST`] more records, or until there are `limit` with CSI.
    fn burst(
        &mut self,
        source: &mut Replay<Box<dyn Read + Send>>,
        limit: usize,
        payload_size: usize,
    ) -> Result<(), csi5300::source::Error> {
        for _ in 0..BURST {
            self.ended = self.ended || self.arena.len() >= limit;
            if self.ended {
                return Ok(());
            }
            match source.receive(Instant::ZERO)? {
                Next::Record(_, record) if record.code == code::MPDU => self.frames.push(record.body, payload_size),
                Next::Record(_, record) if record.code == code::BFEE => match Bfee::new_checked(record.body) {
                    Ok(bfee) => {
                        let (n_rx, n_tx) = self.largest;
                        self.largest = (n_rx.max(bfee.n_rx()), n_tx.max(bfee.n_tx()));
                        self.arena.push(record.body);
                    }
                    Err(_) => self.skipped += 1,
                },
                Next::Lost(_) => self.skipped += 1,
                Next::Record(..) => {}
                Next::Pending | Next::End(_) => self.ended = true,
            }
        }
        Ok(())
    }
}

/// The names of csiread's fields of native integer size, in the order of [`numbers`].
const NUMBERS: [&str; 9] = ["bfee_count", "Nrx", "Ntx", "rssi_a", "rssi_b", "rssi_c", "noise", "agc", "rate"];

/// The fields of a record that [`NUMBERS`] names.
fn numbers(bfee: &Bfee<'_>) -> [i64; NUMBERS.len()] {
    let [a, b, c] = bfee.rssi().map(i64::from);
    let (noise, agc, rate) = (bfee.noise_dbm().into(), bfee.agc().into(), bfee.rate_n_flags().into());
    [bfee.bfee_count().into(), bfee.n_rx() as i64, bfee.n_tx() as i64, a, b, c, noise, agc, rate]
}

/// The fields of all records under csiread's names.
fn fields(arrays: &Bound<'_, PyDict>, arena: &Arena) -> PyResult<()> {
    let (py, n) = (arrays.py(), arena.len());
    let mut times: Vec<u32> = Vec::with_capacity(n);
    let mut columns = NUMBERS.map(|_| Vec::<i64>::with_capacity(n));
    let mut perm: Vec<i64> = Vec::with_capacity(3 * n);
    for bfee in (0..n).filter_map(|k| arena.bfee(k)) {
        times.push(bfee.timestamp_low());
        columns.iter_mut().zip(numbers(&bfee)).for_each(|(column, number)| column.push(number));
        perm.extend([0, 2, 4].map(|shift| i64::from(bfee.antenna_sel() >> shift & 3)));
    }
    arrays.set_item("timestamp_low", times.into_pyarray(py))?;
    for (name, column) in NUMBERS.into_iter().zip(columns) {
        arrays.set_item(name, column.into_pyarray(py))?;
    }
    arrays.set_item("perm", perm.into_pyarray(py).reshape([n, 3])?)
}

/// Writes one record `[subcarrier][row][stream]` to `shape` rows and streams, no fewer than it has. The row is the antenna's, or the
/// chain's if the record does not name its antennas or one of them has no row.
fn unpack(bfee: &Bfee<'_>, (rows, streams): (usize, usize), out: &mut [Complex64]) {
    let order = antenna_order(bfee);
    // NO_ANTENNA is beyond any row.
    let by_antenna = order.iter().take(bfee.n_rx()).all(|antenna| usize::from(*antenna) < rows);
    for (chain, antenna) in order.into_iter().enumerate().take(bfee.n_rx()) {
        let row = if by_antenna { usize::from(antenna) } else { chain };
        for stream in 0..bfee.n_tx().min(streams) {
            let mut column = [Complex32::default(); SUBCARRIERS];
            bfee.column_f32(chain, stream, &ALL_SUBCARRIERS, bytemuck::cast_slice_mut(&mut column));
            let places = out.iter_mut().skip(row * streams + stream).step_by(rows * streams);
            for (place, h) in places.zip(column) {
                *place = Complex64::new(f64::from(h.re), f64::from(h.im));
            }
        }
    }
}

/// Opens a log, a path or bytes, from byte `position` on.
fn open(log: &Bound<'_, PyAny>, position: u64) -> PyResult<Replay<Box<dyn Read + Send>>> {
    let Ok(bytes) = log.cast::<PyBytes>() else { return Ok(open_at(&log.extract::<PathBuf>()?, position)?) };
    let mut memory = Cursor::new(bytes.as_bytes().to_vec());
    memory.set_position(position);
    Ok(Replay::new(Box::new(memory), format!("{} bytes in memory", bytes.as_bytes().len())))
}

fn open_at(path: &Path, position: u64) -> Result<Replay<Box<dyn Read + Send>>, Failure> {
    let name = path.display().to_string();
    let refused = |source| Failure::unread(source, &name, position);
    if path.is_dir() {
        return Err(Failure::log(csi5300::source::Error::Directory { path: path.to_owned() }, &name, 0));
    }
    // A FIFO has no positions: the next line refuses it without waiting.
    let mut file = open_at_once(path).map_err(refused)?;
    file.seek(SeekFrom::Start(position)).map_err(refused)?;
    Ok(Replay::new(Box::new(file), name.clone()))
}

/// Reads a log from byte `position` on, at most `limit` records with CSI (0: all), into csiread's arrays. `skipped` is the number of
/// damaged stretches and records, `largest` the most rows and streams of a record.
#[pyfunction]
pub fn classic<'py>(
    py: Python<'py>,
    log: &Bound<'py, PyAny>,
    position: u64,
    limit: usize,
    shape: (usize, usize),
    payload_size: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let mut source = open(log, position)?;
    let limit = if limit == 0 { usize::MAX } else { limit };
    let mut read = Read1::default();
    while !read.ended {
        detached(py, || read.burst(&mut source, limit, payload_size))?
            .map_err(|error| Failure::log(error, source.name(), source.bytes()))?;
        py.check_signals()?;
    }
    let (rows, streams) = shape;
    let Read1 { arena, frames, largest, skipped, .. } = read;
    let arrays = PyDict::new(py);
    arrays.set_item("largest", largest)?;
    arrays.set_item("skipped", skipped)?;
    if largest.0 > rows || largest.1 > streams {
        return Ok(arrays);
    }
    fields(&arrays, &arena)?;
    frames.into_arrays(&arrays, payload_size)?;
    let csi = PyArray4::<Complex64>::zeros(py, [arena.len(), SUBCARRIERS, rows, streams], false);
    let mut writer = csi.readwrite();
    let out = writer.as_slice_mut().map_err(|error| Failure::new(Kind::Internal, error.to_string()))?;
    let pool = pool()?;
    let size = (SUBCARRIERS * rows * streams).max(1);
    for (piece, out) in out.chunks_mut(size * BURST).enumerate() {
        let one = |(k, out): (usize, &mut [Complex64])| {
            if let Some(bfee) = arena.bfee(piece * BURST + k) {
                unpack(&bfee, shape, out);
            }
        };
        detached(py, || pool.install(|| out.par_chunks_exact_mut(size).enumerate().with_min_len(256).for_each(one)))?;
        py.check_signals()?;
    }
    drop(writer);
    arrays.set_item("csi", csi)?;
    Ok(arrays)
}
