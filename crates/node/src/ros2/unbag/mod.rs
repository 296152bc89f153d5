//! Logs and trajectories from a recording of ROS 2: what `csi5300 bearing` and `csi5300 compare` read.

mod compressed;
mod content;
#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod kinds_tests;
mod mcap;
mod recording;
mod ros1;
mod sqlite;
#[cfg(test)]
mod tests;

pub use content::Content;
pub use recording::{RecordedTopic, Recording};

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

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
    /// A file is of no known kind.
    #[error("{} is no recording: MCAP, SQLite (ROS 2) and bags of ROS 1 are read", .path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// A database has not the tables of a recording.
    #[error("{} is a database of SQLite without the tables of a recording (topics, messages)", .path.display())]
    NoTables {
        /// The file.
        path: PathBuf,
    },
    /// A folder has no recording.
    #[error("{} has no file of a recording (.mcap, .db3, .bag)", .folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// Chunks are compressed in a way that is not read.
    #[error("{} is compressed by {by}, which is not read: `{}` makes one that is", .path.display(), .command)]
    Compressed {
        /// The file.
        path: PathBuf,
        /// By what.
        by: String,
        /// The command that helps.
        command: &'static str,
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
    /// Parts that are damaged and left out, in all files: chunks of MCAP and of bags of ROS 1, pages and rows of SQLite.
    pub damaged_parts: u64,
    /// Messages of topics that nothing is known of, as what describes them is damaged.
    pub without_topic: u64,
}

/// A file that is written.
struct Writing {
    to: BufWriter<File>,
    told: UnbaggedTopic,
}

/// Writes each topic of CSI ([`Content::Csi`]) as a log in the WSR layout and each of poses ([`Content::Poses`]) as a
/// trajectory into the folder `out`, which is made. `bag` is a folder as `ros2 bag` makes it, or one file: MCAP, SQLite or a
/// bag of ROS 1, also compressed. Times are those of the headers.
///
/// # Errors
/// If nothing can be read or written, or a file is there already and not to be replaced.
pub fn unbag(bag: &Path, out: &Path, replace: bool) -> Result<Unbagged, BagError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| BagError::Io { path, source }
    };
    std::fs::create_dir_all(out).map_err(io(out))?;
    let mut writing: BTreeMap<(String, String), Writing> = BTreeMap::new();
    let rest = each(bag, |channel, content, bytes| {
        let key = (channel.topic.clone(), channel.kind.clone());
        if !writing.contains_key(&key) {
            let file = file_of(out, channel, content.ending());
            // Two topics may have one name in plain letters.
            let replace = replace && writing.values().all(|one| one.told.file != file);
            writing.insert(key.clone(), create(file, channel, replace)?);
        }
        let Some(one) = writing.get_mut(&key) else { return Ok(()) };
        match bytes {
            Some(bytes) => {
                one.to.write_all(&bytes).map_err(io(&one.told.file))?;
                one.told.messages += 1;
            }
            None => one.told.unreadable += 1,
        }
        Ok(())
    })?;
    let Rest { others, cut, ended } = rest;
    let (damaged_parts, without_topic) = (ended.damaged_parts, ended.without_topic);
    let mut done = Unbagged { topics: vec![], others, cut, damaged_parts, without_topic };
    for (_, mut one) in writing {
        one.to.flush().map_err(io(&one.told.file))?;
        done.topics.push(one.told);
    }
    Ok(done)
}

fn file_of(out: &Path, channel: &Channel, end: &str) -> PathBuf {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = channel.topic.trim_start_matches('/').chars().map(plain).collect();
    out.join(format!("{name}.{end}"))
}

fn create(file: PathBuf, channel: &Channel, replace: bool) -> Result<Writing, BagError> {
    let opened = if replace { File::create(&file) } else { File::create_new(&file) };
    let opened = opened.map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => BagError::There { path: file.clone() },
        _ => BagError::Io { path: file.clone(), source },
    })?;
    let (topic, kind) = (channel.topic.clone(), channel.kind.clone());
    Ok(Writing { to: BufWriter::new(opened), told: UnbaggedTopic { topic, kind, file, ..UnbaggedTopic::default() } })
}

/// A topic of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Channel {
    /// Its name.
    topic: String,
    /// `nav_msgs/msg/Odometry`.
    kind: String,
    /// `cdr`, or `ros1`.
    encoding: String,
}

/// Bytes of a file by which its kind is known.
const START: u64 = 16;

/// Uses a message: its topic and its payload.
type Used<'a> = dyn FnMut(&Channel, &[u8]) -> Result<(), BagError> + 'a;

/// How a file was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Ended {
    /// It ends where it should not.
    cut: bool,
    /// Chunks, pages and rows that are damaged.
    damaged_parts: u64,
    /// Messages of topics that are not known.
    without_topic: u64,
}

/// What of a recording is neither CSI nor poses.
#[derive(Clone, Debug, Default)]
struct Rest {
    others: u64,
    cut: Vec<PathBuf>,
    /// Of all files.
    ended: Ended,
}

/// Each message of CSI or poses goes to `used`, as the bytes of its file; without any if it is unreadable.
fn each(
    bag: &Path,
    mut used: impl FnMut(&Channel, Content, Option<Vec<u8>>) -> Result<(), BagError>,
) -> Result<Rest, BagError> {
    let mut rest = Rest::default();
    for file in files(bag)? {
        let mut others = 0;
        let ended = read(&file, &mut |channel, payload| {
            let known = ["cdr", "ros1"].contains(&channel.encoding.as_str());
            let Some(content) = Content::of(channel).filter(|_| known) else {
                others += 1;
                return Ok(());
            };
            used(channel, content, content::bytes(channel, payload))
        })?;
        rest.others += others;
        rest.ended.damaged_parts += ended.damaged_parts;
        rest.ended.without_topic += ended.without_topic;
        rest.cut.extend(ended.cut.then_some(file));
    }
    Ok(rest)
}

/// Reads a file of whatever kind it is.
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
            let bytes = compressed::bounded(all, compressed::LARGEST_FILE).map_err(io)?;
            return sqlite::read(path, io::Cursor::new(bytes), used);
        }
        return stream(path, &start, BufReader::new(all), used);
    }
    if start.starts_with(sqlite::MAGIC) {
        let ended = sqlite::read(path, file()?, used)?;
        return Ok(Ended { cut: ended.cut || sqlite::has_journal(path), ..ended });
    }
    stream(path, &start, file()?, used)
}

/// Reads a file that is read from its beginning to its end, `start` being its first bytes.
fn stream(path: &Path, start: &[u8], from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    if start.starts_with(mcap::MAGIC) {
        mcap::read(path, from, used)
    } else if start.starts_with(ros1::MAGIC) {
        ros1::read(path, from, used)
    } else {
        Err(BagError::Unknown { path: path.to_owned() })
    }
}

/// The files of a recording, in their order; those of one kind, MCAP before others.
fn files(bag: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !bag.is_dir() {
        return Ok(vec![bag.to_owned()]);
    }
    let io = |source| BagError::Io { path: bag.to_owned(), source };
    let all = std::fs::read_dir(bag).map_err(io)?.map(|entry| entry.map(|entry| entry.path()));
    let mut all: Vec<PathBuf> = all.collect::<io::Result<_>>().map_err(io)?;
    // Who plays a compressed file leaves it beside what was in it.
    let names: std::collections::BTreeSet<PathBuf> = all.iter().cloned().collect();
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
    found.ok_or_else(|| BagError::Empty { folder: bag.to_owned() })
}
