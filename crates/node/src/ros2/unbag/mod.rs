//! Logs and trajectories from a recording of ROS 2: what `csi5300 bearing` and `csi5300 compare` read.

mod mcap;
#[cfg(test)]
mod tests;

use super::cdr::Cdr;
use super::messages::own::Csi;
use super::messages::standard::{Header, Odometry, Pose as PoseMessage, PoseStamped};
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::{Pose, heading_of};
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::Record;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Code of a record with CSI.
const BFEE: u8 = 0xbb;
/// Two bits that name no antenna.
const NO_ANTENNA: u8 = 3;

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// A file cannot be read or written.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file is no MCAP.
    #[error("{} is no MCAP file: `ros2 bag convert` makes one of a recording in another format", .path.display())]
    NoMcap {
        /// The file.
        path: PathBuf,
    },
    /// A folder has no MCAP files.
    #[error("{} has no .mcap file: `ros2 bag convert` makes one of a recording in another format", .folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// Chunks are compressed.
    #[error("{} is compressed ({by}): `mcap compress --compression none` makes one that is not", .path.display())]
    Compressed {
        /// The file.
        path: PathBuf,
        /// By what.
        by: String,
    },
    /// There is a file of that name already.
    #[error("{} is there already", .path.display())]
    There {
        /// The file.
        path: PathBuf,
    },
}

/// What became of a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct UnbaggedTopic {
    /// Its name.
    pub topic: String,
    /// Its type.
    pub kind: String,
    /// What was written: a log (`.dat`) of CSI, or a trajectory (`.csv`).
    pub file: PathBuf,
    /// Messages that were written.
    pub messages: u64,
    /// Messages that are not of their type, or hold what no record or pose can.
    pub unreadable: u64,
}

/// What became of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Unbagged {
    /// Topics of which something was written.
    pub topics: Vec<UnbaggedTopic>,
    /// Messages of other topics.
    pub others: u64,
    /// Files that end before they should: they are whole up to their last chunk.
    pub cut: Vec<PathBuf>,
}

/// A file that is written.
struct Writing {
    to: BufWriter<File>,
    told: UnbaggedTopic,
}

/// Writes each topic of CSI (`csi5300_msgs/msg/Csi`) as a log in the WSR layout and each of poses (`nav_msgs/msg/Odometry`,
/// `geometry_msgs/msg/PoseStamped`) as a trajectory into the folder `out`, which is made. `bag` is a folder as `ros2 bag`
/// makes it, or one MCAP file. Times are those of the headers.
///
/// # Errors
/// If nothing can be read or written, or a file is there already.
pub fn unbag(bag: &Path, out: &Path) -> Result<Unbagged, BagError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| BagError::Io { path, source }
    };
    std::fs::create_dir_all(out).map_err(io(out))?;
    let mut writing: BTreeMap<(String, String), Writing> = BTreeMap::new();
    let mut done = Unbagged::default();
    for file in files(bag)? {
        let cut = mcap::read(&file, |channel, _, payload| {
            let Some(end) = ending(&channel.kind).filter(|_| channel.encoding == "cdr") else {
                done.others += 1;
                return Ok(());
            };
            let key = (channel.topic.clone(), channel.kind.clone());
            if !writing.contains_key(&key) {
                writing.insert(key.clone(), create(out, channel, end)?);
            }
            let Some(one) = writing.get_mut(&key) else { return Ok(()) };
            match bytes(&channel.kind, payload) {
                Some(bytes) => {
                    one.to.write_all(&bytes).map_err(io(&one.told.file))?;
                    one.told.messages += 1;
                }
                None => one.told.unreadable += 1,
            }
            Ok(())
        })?;
        done.cut.extend(cut.then_some(file));
    }
    for (_, mut one) in writing {
        one.to.flush().map_err(io(&one.told.file))?;
        done.topics.push(one.told);
    }
    Ok(done)
}

/// The MCAP files of a recording, in their order.
fn files(bag: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !bag.is_dir() {
        return Ok(vec![bag.to_owned()]);
    }
    let io = |source| BagError::Io { path: bag.to_owned(), source };
    let all = std::fs::read_dir(bag).map_err(io)?.map(|entry| entry.map(|entry| entry.path()));
    let mut all: Vec<PathBuf> = all.collect::<io::Result<_>>().map_err(io)?;
    all.retain(|path| path.extension().is_some_and(|end| end == "mcap"));
    // run_2 before run_10.
    all.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    if all.is_empty() { Err(BagError::Empty { folder: bag.to_owned() }) } else { Ok(all) }
}

/// The ending of what is made of a type.
fn ending(kind: &str) -> Option<&'static str> {
    match kind {
        "csi5300_msgs/msg/Csi" => Some("dat"),
        "nav_msgs/msg/Odometry" | "geometry_msgs/msg/PoseStamped" => Some("csv"),
        _ => None,
    }
}

fn create(out: &Path, channel: &mcap::Channel, end: &str) -> Result<Writing, BagError> {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = channel.topic.trim_start_matches('/').chars().map(plain).collect();
    let file = out.join(format!("{name}.{end}"));
    let opened = File::create_new(&file).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => BagError::There { path: file.clone() },
        _ => BagError::Io { path: file.clone(), source },
    })?;
    let (topic, kind) = (channel.topic.clone(), channel.kind.clone());
    Ok(Writing { to: BufWriter::new(opened), told: UnbaggedTopic { topic, kind, file, ..UnbaggedTopic::default() } })
}

/// What a message is in its file.
fn bytes(kind: &str, payload: &[u8]) -> Option<Vec<u8>> {
    match kind {
        "csi5300_msgs/msg/Csi" => record(&Csi::of_payload(payload).ok()?),
        "nav_msgs/msg/Odometry" => {
            let told = Odometry::of_payload(payload).ok()?;
            row(&told.header, &told.pose.pose)
        }
        _ => {
            let told = PoseStamped::of_payload(payload).ok()?;
            row(&told.header, &told.pose)
        }
    }
}

fn row(header: &Header, pose: &PoseMessage) -> Option<Vec<u8>> {
    let pose = pose.isometry()?;
    let heading_rad = Some(heading_of(&pose.rotation));
    let t_s = header.stamp.us() as f64 * 1e-6;
    Some(csv::line(&Pose { t_s, position_m: pose.translation.vector, heading_rad }).into_bytes())
}

/// A record as the WSR driver's logger writes it, length and code first.
fn record(csi: &Csi) -> Option<Vec<u8>> {
    let antenna = |row: usize| csi.antennas.get(row).copied().filter(|antenna| *antenna < 3).unwrap_or(NO_ANTENNA);
    let us = u64::try_from(csi.header.stamp.us()).ok()?;
    let mac = if csi.mac.is_empty() { driver_iface::Mac::ZERO } else { csi.mac.parse().ok()? };
    let wsr = Wsr {
        tv_sec: u32::try_from(us / 1_000_000).ok()?,
        tv_usec: (us % 1_000_000) as u32,
        mac,
        frame_count: csi.frame_count,
    };
    let repr = Repr {
        timestamp_low: csi.timestamp_low,
        bfee_count: csi.bfee_count,
        reserved: 0,
        n_rx: csi.n_rx,
        n_tx: csi.n_tx,
        rssi: csi.rssi,
        noise_dbm: csi.noise,
        agc: csi.agc,
        antenna_sel: (0..3).fold(0, |all, row| all | (antenna(row) & 3) << (2 * row)),
        rate_n_flags: csi.rate_n_flags,
        wsr: Some(wsr),
    };
    if csi.re.len() != csi.im.len() {
        return None;
    }
    let iq: Vec<Iq> = csi.re.iter().zip(&csi.im).map(|(i, q)| Iq { i: *i, q: *q }).collect();
    let mut body = vec![0; driver_iface::bfee::MAX_BODY];
    let length = repr.emit(&iq, &mut body).ok()?;
    let record = Record { code: BFEE, body: body.get(..length)? };
    let mut bytes = vec![0; record.emit_len()];
    let length = record.emit(&mut bytes).ok()?;
    bytes.truncate(length);
    Some(bytes)
}
