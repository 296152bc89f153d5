//! Logs and trajectories from recordings of ROS, the input of `csi5300 bearing` and `csi5300 simulate`: MCAP and SQLite of ROS 2,
//! bags of ROS 1, also compressed. [`Recording::write`] writes them to files, [`Recording::read`] reads them into memory.

pub(crate) mod compressed;
mod ros1;
mod sqlite;
#[cfg(test)]
mod tests;

use crate::cdr::{Cdr, CdrReader};
use crate::messages::{Csi, Header, Odometry, Pose as PoseMessage, PoseStamped, Quaternion, Time};
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file cannot be read or written.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A recording that is none, is too large, or is compressed in an unknown way.
    #[error("{} {why}", .path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// What it is.
        why: String,
    },
    /// A file may not be written, in words.
    #[error("{0}")]
    Output(String),
}

/// Refuses a recording.
fn refused(path: &Path, why: impl Into<String>) -> BagError {
    BagError::Refused { path: path.to_owned(), why: why.into() }
}

/// Refuses a compression that the command `convert` undoes.
pub(crate) fn compressed_by(path: &Path, by: &str, convert: &str) -> BagError {
    refused(path, format!("is compressed with {by}, which is not supported: convert it with `{convert}`"))
}

/// Topics that estimates use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Records of a card (`csi5300_msgs/msg/Csi`): they make a log in the WSR layout.
    Csi,
    /// Poses (`nav_msgs/msg/Odometry`, `geometry_msgs/msg/PoseStamped`): they make a trajectory with headings.
    Poses,
}

impl Content {
    /// The content of a topic; `None` if it is neither.
    fn of(channel: &Channel) -> Option<Self> {
        match channel.kind.as_str() {
            "csi5300_msgs/msg/Csi" => Some(Self::Csi),
            "nav_msgs/msg/Odometry" => Some(Self::Poses),
            "geometry_msgs/msg/PoseStamped" if !is_direction(&channel.topic) => Some(Self::Poses),
            _ => None,
        }
    }

    /// The extension of its file, and the file's first bytes.
    fn file(self) -> (&'static str, &'static str) {
        match self {
            Self::Csi => ("dat", ""),
            Self::Poses => ("csv", "t,ns,frame,child_frame,x,y,z,qx,qy,qz,qw\n"),
        }
    }
}

/// A topic of CSI or poses.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Topic {
    /// The name of its file: a log (`.dat`) of CSI or a trajectory (`.csv`).
    pub file: PathBuf,
    /// Its name.
    pub topic: String,
    /// Its type.
    pub kind: String,
    /// What it contains.
    #[serde(skip)]
    pub content: Content,
    /// Messages that were used.
    pub messages: u64,
    /// Messages that are not of their type, or whose values no record or pose can have; poses without a stamp.
    pub unreadable: u64,
    /// The log in the WSR layout, or the rows of the trajectory, made from its messages; empty once written.
    #[serde(skip)]
    pub bytes: Vec<u8>,
}

impl Topic {
    /// Appends the bytes to its file. No file stays open, because there may be more topics than a process may open files.
    fn flush(&mut self, folder: &Path) -> Result<(), BagError> {
        let path = folder.join(&self.file);
        let file = File::options().create(true).append(true).open(&path);
        let bytes = std::mem::take(&mut self.bytes);
        file.and_then(|mut to| to.write_all(&bytes)).map_err(|source| BagError::Io { path, source })
    }
}

/// What was read of a recording: a folder of `ros2 bag` or one file: MCAP, SQLite or a bag of ROS 1, also compressed. Times are those
/// of the headers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recording {
    /// The topics of CSI and poses, in order of their first message; of a written recording, of their names.
    pub topics: Vec<Topic>,
    /// Messages of other topics.
    pub others: u64,
    /// Files that end early: they are read up to their last complete chunk.
    pub cut: Vec<PathBuf>,
    /// Damaged parts that were skipped, in all files: chunks of MCAP and of bags of ROS 1, pages and rows of SQLite.
    pub damaged_parts: u64,
    /// Messages of unknown topics, whose description is damaged.
    pub without_topic: u64,
}

/// Largest size of logs and trajectories in memory, bytes: a robot's day at 100 records a second is 1.4 GB.
const MOST: u64 = 2 << 30;

/// Bytes that may wait to be written, over all topics.
const WAITING: u64 = 16 << 20;

impl Recording {
    /// Reads the recording `bag` into memory: a record of two antennas takes 163 bytes, a pose about 120.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn read(bag: &Path) -> Result<Self, BagError> {
        Self::collect(bag, &mut |_| Ok(()), |_, held| {
            let why = "MiB of CSI and poses: write files with `csi5300 unbag`";
            if *held > MOST { Err(refused(bag, format!("has more than {} {why}", MOST >> 20))) } else { Ok(()) }
        })
    }

    /// Writes each topic of CSI ([`Content::Csi`]) as a log in the WSR layout, and each topic of poses ([`Content::Poses`]) as a
    /// trajectory, into a folder. `may` is asked before the first message of each file.
    ///
    /// # Errors
    /// If reading or writing fails, or a file may not be written.
    pub fn write(
        bag: &Path,
        folder: &Path,
        mut may: impl FnMut(&Path) -> Result<(), String>,
    ) -> Result<Self, BagError> {
        let flush = |topics: &mut [Topic]| topics.iter_mut().try_for_each(|one| one.flush(folder));
        let mut done = Self::collect(bag, &mut may, |topics, held| {
            if *held <= WAITING {
                return Ok(());
            }
            *held = 0;
            flush(topics)
        })?;
        flush(&mut done.topics)?;
        done.topics.sort_by(|a, b| (&a.topic, &a.kind).cmp(&(&b.topic, &b.kind)));
        Ok(done)
    }

    /// Reads all messages; `held` gets all topics and the number of bytes since it set that to 0, after each message.
    fn collect(
        bag: &Path,
        may: &mut dyn FnMut(&Path) -> Result<(), String>,
        mut held: impl FnMut(&mut [Topic], &mut u64) -> Result<(), BagError>,
    ) -> Result<Self, BagError> {
        let (mut topics, mut numbers) = (Vec::<Topic>::new(), BTreeMap::new());
        let (mut names, mut waiting) = (BTreeSet::new(), 0);
        let mut done = each(bag, |channel, content, bytes| {
            let key = (channel.topic.clone(), channel.kind.clone());
            let at = *numbers.entry(key).or_insert(topics.len());
            if at == topics.len() {
                let (end, first) = content.file();
                let file = PathBuf::from(name(&mut names, &channel.topic, end));
                may(&file).map_err(BagError::Output)?;
                let (topic, kind) = (channel.topic.clone(), channel.kind.clone());
                topics.push(Topic { file, topic, kind, content, messages: 0, unreadable: 0, bytes: first.into() });
            }
            let Some(one) = topics.get_mut(at) else { return Ok(()) };
            one.messages += u64::from(bytes.is_some());
            one.unreadable += u64::from(bytes.is_none());
            waiting += bytes.as_ref().map_or(0, Vec::len) as u64;
            one.bytes.extend(bytes.unwrap_or_default());
            held(&mut topics, &mut waiting)
        })?;
        done.topics = topics;
        Ok(done)
    }

    /// The topics with this `content`.
    pub fn having(&self, content: Content) -> impl Iterator<Item = &Topic> {
        self.topics.iter().filter(move |topic| topic.content == content)
    }
}

/// A name that no other topic has: two topics may have the same name in plain letters.
fn name(names: &mut BTreeSet<String>, topic: &str, end: &str) -> String {
    let stem = topic.trim_start_matches('/').replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    let stem = if stem.is_empty() { "topic".to_owned() } else { stem };
    let numbered = (2..).map(|k: u64| format!("{stem}-{k}.{end}"));
    let mut all = std::iter::once(format!("{stem}.{end}")).chain(numbered);
    all.find(|name| names.insert(name.clone())).unwrap_or_default()
}

/// A topic of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Channel {
    /// Its name.
    pub topic: String,
    /// `nav_msgs/msg/Odometry`.
    pub kind: String,
    /// `cdr`, or `ros1`.
    pub encoding: String,
}

impl Channel {
    /// A topic of ROS 1, whose `nav_msgs/Odometry` is `nav_msgs/msg/Odometry` of ROS 2.
    pub(crate) fn of_ros1(topic: String, kind: &str) -> Self {
        Self { topic, kind: kind.replacen('/', "/msg/", 1), encoding: "ros1".into() }
    }
}

/// Number of first bytes that identify a file's kind.
const START: u64 = 16;

/// Receives a message: its topic and its payload.
pub(crate) type Used<'a> = dyn FnMut(&Channel, &[u8]) -> Result<(), BagError> + 'a;

/// The result of reading a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ended {
    /// It ends early.
    pub cut: bool,
    /// Damaged chunks, pages and rows.
    pub damaged_parts: u64,
    /// Messages of unknown topics.
    pub without_topic: u64,
}

/// Passes each message of CSI or poses to `used` as the bytes for its file, `None` if it is unreadable; returns everything but
/// the topics.
fn each(
    bag: &Path,
    mut used: impl FnMut(&Channel, Content, Option<Vec<u8>>) -> Result<(), BagError>,
) -> Result<Recording, BagError> {
    let mut done = Recording::default();
    for file in files(bag)? {
        let ended = read(&file, &mut |channel, payload| {
            let known = ["cdr", "ros1"].contains(&channel.encoding.as_str());
            let Some(content) = Content::of(channel).filter(|_| known) else {
                done.others += 1;
                return Ok(());
            };
            used(channel, content, bytes(channel, payload))
        })?;
        done.damaged_parts += ended.damaged_parts;
        done.without_topic += ended.without_topic;
        done.cut.extend(ended.cut.then_some(file));
    }
    Ok(done)
}

/// Reads a file of any kind.
fn read(path: &Path, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let file = || File::open(path).map(BufReader::new).map_err(io);
    let mut start = Vec::new();
    file()?.take(START).read_to_end(&mut start).map_err(io)?;
    if compressed::is_zstd(&start) {
        let mut whole = compressed::stream(file()?).map_err(io)?;
        let mut start = Vec::new();
        if whole.by_ref().take(START).read_to_end(&mut start).is_err() {
            return Ok(Ended { cut: true, ..Ended::default() });
        }
        let all = io::Cursor::new(start.clone()).chain(whole);
        if start.starts_with(sqlite::MAGIC) {
            return match compressed::unpacked(all, compressed::LARGEST_FILE) {
                Ok(file) => sqlite::read(path, BufReader::new(file), used),
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                    Ok(Ended { cut: true, ..Ended::default() })
                }
                Err(error) => Err(io(error)),
            };
        }
        return stream(path, &start, BufReader::new(all), used);
    }
    if start.starts_with(sqlite::MAGIC) {
        let ended = sqlite::read(path, file()?, used)?;
        return Ok(Ended { cut: ended.cut || sqlite::has_journal(path), ..ended });
    }
    stream(path, &start, file()?, used)
}

/// Reads a file from start to end; `start` has its first bytes.
fn stream(path: &Path, start: &[u8], from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    if start.starts_with(crate::mcap::MAGIC) {
        crate::mcap::read(path, from, used)
    } else if start.starts_with(ros1::MAGIC) {
        ros1::read(path, from, used)
    } else {
        Err(refused(path, "is not a recording: supported are MCAP and SQLite (ROS 2) and bags of ROS 1"))
    }
}

/// The files of a recording, in order, all of one kind; MCAP is preferred.
fn files(bag: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !bag.is_dir() {
        return Ok(vec![bag.to_owned()]);
    }
    let io = |source| BagError::Io { path: bag.to_owned(), source };
    let all = std::fs::read_dir(bag).map_err(io)?.map(|entry| entry.map(|entry| entry.path()));
    let mut all: Vec<PathBuf> = all.collect::<io::Result<_>>().map_err(io)?;
    // Playing a compressed file leaves the unpacked one beside it.
    let names: BTreeSet<PathBuf> = all.iter().cloned().collect();
    all.retain(|path| path.extension().is_none_or(|end| end != "zstd") || !names.contains(&path.with_extension("")));
    // run_2 before run_10.
    all.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    let of = |kind: &str| {
        let ends = |path: &&PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.trim_end_matches(".zstd").ends_with(kind)
        };
        all.iter().filter(ends).cloned().collect::<Vec<PathBuf>>()
    };
    let found = [".mcap", ".db3", ".bag"].into_iter().map(of).find(|files| !files.is_empty());
    found.ok_or_else(|| refused(bag, "contains no recording (.mcap, .db3, .bag)"))
}

/// True for a bearing as a pose, which is not odometry: a node's `/csi5300_ROBOT/PEER/direction` (in ROS 1 `pose`), and
/// `/bearing/LINK` and `/mirror/LINK` of `csi5300 mcap`.
fn is_direction(topic: &str) -> bool {
    let parts: Vec<&str> = topic.rsplit('/').collect();
    match parts[..] {
        ["direction" | "pose", _, node, ..] if node.starts_with("csi5300") => true,
        [_, "bearing" | "mirror", ""] => true,
        _ => false,
    }
}

/// The bytes that a message adds to its file; a payload may be compressed by itself.
fn bytes(channel: &Channel, payload: &[u8]) -> Option<Vec<u8>> {
    let whole = if compressed::is_zstd(payload) {
        Some(compressed::bounded(compressed::Frames::new(payload), compressed::LARGEST_MESSAGE).ok()?)
    } else {
        None
    };
    let payload = whole.as_deref().unwrap_or(payload);
    let mut from = match channel.encoding.as_str() {
        // Each begins with a header; that of ROS 1 has a sequence number.
        "ros1" => CdrReader::packed(payload.get(4..)?),
        _ => CdrReader::of_payload(payload).ok()?,
    };
    match channel.kind.as_str() {
        "csi5300_msgs/msg/Csi" => record(&Csi::read(&mut from).ok()?),
        "nav_msgs/msg/Odometry" => {
            let told = Odometry::read(&mut from).ok()?;
            row(&told.header, &told.child_frame_id, &told.pose.pose)
        }
        _ => {
            let told = PoseStamped::read(&mut from).ok()?;
            row(&told.header, "", &told.pose)
        }
    }
}

/// A row with the whole attitude, zeros if it is not set, and the frames, which a trajectory's reader compares; `None` without a
/// stamp.
fn row(header: &Header, child_frame: &str, pose: &PoseMessage) -> Option<Vec<u8>> {
    let mut turned = pose.clone();
    let is_set = pose.orientation != Quaternion::default();
    if !is_set {
        turned.orientation.w = 1.0;
    }
    let pose = turned.isometry().filter(|_| header.stamp != Time::default())?;
    let [frame, child] =
        [&header.frame_id, child_frame].map(|name| name.replace([',', ';', '"', '\t', '\r', '\n'], "_"));
    let (Time { sec, nanosec }, p) = (&header.stamp, pose.translation.vector);
    let q = if is_set { pose.rotation.coords } else { Default::default() };
    let row = format!(
        "{sec},{nanosec},{frame},{child},{:.6},{:.6},{:.6},{:.9},{:.9},{:.9},{:.9}\n",
        p.x, p.y, p.z, q.x, q.y, q.z, q.w
    );
    Some(row.into_bytes())
}

/// Two bits that name no antenna.
const NO_ANTENNA: u8 = 3;

/// A record as the WSR driver's logger writes it: length and code first.
fn record(csi: &Csi) -> Option<Vec<u8>> {
    let antenna = |row: usize| csi.antennas.get(row).copied().filter(|antenna| *antenna < 3).unwrap_or(NO_ANTENNA);
    let us = u64::try_from(csi.header.stamp.us()).ok()?;
    let mac = if csi.mac.is_empty() { driver_iface::Mac::ZERO } else { csi.mac.parse().ok()? };
    let wsr = Wsr {
        tv_sec: u32::try_from(us / 1_000_000).ok()?,
        tv_usec: (us % 1_000_000) as u32,
        mac,
        // 0: the record has none. A driver that knew no sender wrote 0 itself.
        frame_count: Some(csi.frame_count).filter(|number| *number > 0 || mac.is_zero()),
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
    let (record, mut bytes) = (Record { code: code::BFEE, body: body.get(..length)? }, Vec::new());
    csi5300::source::append(record, &mut bytes).then_some(bytes)
}
