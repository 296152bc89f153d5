//! What several tests share: what was skipped, where captures are, and a synthetic link, made with the product's own encoder: a robot on a
//! circle, a far transmitter, both logs as bytes.
#![allow(dead_code)]

use driver_iface::Mac;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};
use std::f64::consts::TAU;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Says that the running test does not run whole here, and why: on standard error past the harness, which hides what passed; as a line of [`skips`], of which
/// the last binary of `cargo test` makes a summary; and of the file that `CSI5300_SKIPS` names, where `.ci/run` collects them.
pub fn skipped(why: &str) {
    let line = format!("skipped: {}: {why}\n", std::thread::current().name().unwrap_or("a test"));
    let _ = std::io::stderr().write_all(line.as_bytes());
    let append = |list: &Path| {
        let file = std::fs::OpenOptions::new().create(true).append(true).open(list);
        file.and_then(|mut file| file.write_all(line.as_bytes()))
    };
    let _ = append(&skips());
    if let Some(list) = std::env::var_os("CSI5300_SKIPS") {
        append(Path::new(&list)).unwrap();
    }
}

/// Where what was skipped is collected: the binaries of one run of `cargo test` are children of one process, known by its number and
/// its start. In the folder of what is built, where nobody else writes.
pub fn skips() -> PathBuf {
    let parent = std::os::unix::process::parent_id();
    let stat = std::fs::read_to_string(format!("/proc/{parent}/stat")).unwrap_or_default();
    // Field 22; the name, in brackets, is the second.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let began = fields.split_whitespace().nth(19).unwrap_or("0");
    let folder = option_env!("CARGO_TARGET_TMPDIR").map_or_else(std::env::temp_dir, PathBuf::from);
    folder.join(format!("skipped-{parent}-{began}"))
}

/// The folder of the workspace.
pub fn root() -> &'static Path {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.ancestors().find(|folder| folder.join("Cargo.lock").is_file()).unwrap_or(own)
}

/// The captures of the WSR data set that tests know, by their stamps: a folder that has more changes no bound.
const WSR: [&str; 14] = [
    "2021-06-27_202550",
    "2021-06-27_203220",
    "2021-06-27_204514",
    "2021-06-27_205432",
    "2021-06-27_191635",
    "2021-06-27_192624",
    "2021-06-28_193409",
    "2021-06-28_194645",
    "2021-06-28_195558",
    "2021-06-29_135548",
    "2021-06-29_140734",
    "2021-06-29_143813",
    "2021-08-18_175655",
    "2021-08-18_182429",
];

/// A folder of logs beside the captures, or `None` (said) where it is absent.
pub fn cases(kind: &str) -> Option<PathBuf> {
    let beside = root().join("../shared/cases");
    let folder = std::env::var_os("CSI5300_CASES").map_or(beside, PathBuf::from).join(kind);
    if folder.is_dir() {
        return Some(folder);
    }
    skipped(&format!("no {} (CSI5300_CASES names another folder)", folder.display()));
    None
}

/// True for a capture of the WSR data set that tests know.
pub fn is_known(stamp: &str) -> bool {
    WSR.contains(&stamp)
}

/// The folder of real captures, or `None` (said) where it is absent.
pub fn captures() -> Option<PathBuf> {
    let beside = root().join("../shared/captures");
    let folder = std::env::var_os("CSI5300_CAPTURES").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    skipped(&format!("no captures at {} (CSI5300_CAPTURES names another folder)", folder.display()));
    None
}

/// Wavelength at channel 108, metres.
const WAVELENGTH_M: f64 = 299_792_458.0 / 5.54e9;
/// Seconds since the Unix epoch at which it begins.
pub const START_S: f64 = 1_700_000_000.0;
/// How far the transmitter's host clock is ahead of the receiver's, seconds.
pub const PARTNER_AHEAD_S: f64 = 60.0;
/// The robots' MACs.
pub const RECEIVER: Mac = Mac([0, 0x21, 0x6a, 1, 2, 3]);
pub const TRANSMITTER: Mac = Mac([0, 0x21, 0x6a, 4, 5, 6]);

/// A link at 100 Hz for `n` exchanges.
pub struct Link {
    /// Records of the receiver's log.
    pub rx: Vec<Vec<u8>>,
    /// Records of the transmitter's log.
    pub tx: Vec<Vec<u8>>,
    /// Trajectory of the receiver, 5 columns.
    pub trajectory: String,
}

/// A link whose transmitter is far away at `azimuth_rad`; the robot stands for half a second, then drives a circle of
/// 30 cm radius. The host clocks are a minute apart, the turn-around jitters.
pub fn link(n: u32, azimuth_rad: f64) -> Link {
    louder_link(n, azimuth_rad, 1)
}

/// The same with every component of the CSI times `gain`, exactly; at most 3 fits eight bits.
pub fn louder_link(n: u32, azimuth_rad: f64, gain: i8) -> Link {
    let place = |t_s: f64| {
        let turn = ((t_s - 0.5).max(0.0) / (f64::from(n) * 0.01 - 0.5) * TAU).sin_cos();
        (0.3 * turn.1 - 0.3, 0.3 * turn.0)
    };
    let mut made = Link { rx: Vec::new(), tx: Vec::new(), trajectory: String::new() };
    for k in 0..n {
        let t_s = f64::from(k) * 0.01;
        let (x, y) = place(t_s);
        let path_rad = TAU / WAVELENGTH_M * (x * azimuth_rad.cos() + y * azimuth_rad.sin());
        let jitter_us = k.wrapping_mul(2_654_435_761) >> 28;
        let cfo_rad = 0.7 * f64::from(k) + TAU * 5_000.0 * f64::from(jitter_us) * 1e-6;
        let clock_us = 10_000 * k;
        let forward_rad = path_rad + cfo_rad;
        let backward_rad = path_rad - 0.7 * f64::from(k);
        made.tx.push(record(k, clock_us + 5_000, RECEIVER, START_S + PARTNER_AHEAD_S + t_s, (forward_rad, gain)));
        made.rx.push(record(k, clock_us + 240 + jitter_us, TRANSMITTER, START_S + t_s, (backward_rad, gain)));
    }
    for row in 0..=(2 * n) {
        let t_s = f64::from(row) * 0.005;
        let (x, y) = place(t_s);
        made.trajectory += &format!("{:.6},0,{x:.6},{y:.6},0.1,\n", START_S + t_s);
    }
    made
}

fn record(k: u32, timestamp_low: u32, mac: Mac, host_s: f64, (phase_rad, gain): (f64, i8)) -> Vec<u8> {
    let tv_usec = ((host_s.fract() * 1e6).round() as u32).min(999_999);
    let wsr = Wsr { tv_sec: host_s as u32, tv_usec, mac, frame_count: Some(k + 1) };
    let repr =
        Repr { timestamp_low, bfee_count: k as u16, rssi: [38, 0, 0], n_rx: 3, wsr: Some(wsr), ..Repr::default() };
    let mut csi = vec![Iq::default(); repr.samples()];
    for (subcarrier, chains) in csi.chunks_mut(3).enumerate() {
        let phase = phase_rad - 0.4 * (2.0 * subcarrier as f64 - 29.0);
        let part = |of: f64| gain * (40.0 * of).round() as i8;
        chains[0] = Iq { i: part(phase.cos()), q: part(phase.sin()) };
    }
    emitted(&repr, &csi)
}

/// A bfee record of a log, as bytes.
pub fn emitted(repr: &Repr, csi: &[Iq]) -> Vec<u8> {
    let mut body = vec![0; repr.body_len()];
    repr.emit(csi, &mut body).unwrap();
    let record = Record { code: code::BFEE, body: &body };
    let mut bytes = vec![0; record.emit_len()];
    record.emit(&mut bytes).unwrap();
    bytes
}

/// A program, started with signals as usual: tests may run with SIGHUP ignored. `None` where `env` cannot do that.
pub fn with_usual_signals(program: &str) -> Option<Command> {
    let known = Command::new("env").args(["--default-signal", "true"]).output();
    if !known.is_ok_and(|output| output.status.success()) {
        skipped("`env --default-signal` is not there (coreutils 8.31)");
        return None;
    }
    let mut command = Command::new("env");
    command.args(["--default-signal", program]);
    Some(command)
}
