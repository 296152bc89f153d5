//! The CSI and poses of a recording, in memory.

use super::{BagError, Content, Rest, each};
use std::path::{Path, PathBuf};

/// A topic of CSI or poses.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedTopic {
    /// Its name.
    pub topic: String,
    /// Its type.
    pub kind: String,
    /// What it contains.
    pub content: Content,
    /// The log in the WSR layout, or the rows of the trajectory, made from its messages.
    pub bytes: Vec<u8>,
    /// Messages that were used.
    pub messages: u64,
    /// Messages that are not of their type, or whose values no record or pose can have.
    pub unreadable: u64,
}

/// The topics of CSI and poses of a recording, with their content.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Recording {
    /// In order of their first message.
    pub topics: Vec<RecordedTopic>,
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

impl Recording {
    /// Reads the recording `bag` as [`unbag`](super::unbag) does, but into memory: a record of two antennas takes 163 bytes, a
    /// pose about 60. Writes nothing.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn read(bag: &Path) -> Result<Self, BagError> {
        let (mut topics, mut held) = (Vec::<RecordedTopic>::new(), 0);
        let rest = each(bag, |channel, content, bytes| {
            let known = topics.iter().position(|one| one.topic == channel.topic && one.kind == channel.kind);
            let at = known.unwrap_or_else(|| {
                let (topic, kind) = (channel.topic.clone(), channel.kind.clone());
                topics.push(RecordedTopic { topic, kind, content, bytes: Vec::new(), messages: 0, unreadable: 0 });
                topics.len() - 1
            });
            if let Some(one) = topics.get_mut(at) {
                held += bytes.as_ref().map_or(0, Vec::len) as u64;
                if held > MOST {
                    return Err(BagError::Large { path: bag.to_owned(), most: MOST });
                }
                one.messages += u64::from(bytes.is_some());
                one.unreadable += u64::from(bytes.is_none());
                one.bytes.extend(bytes.unwrap_or_default());
            }
            Ok(())
        })?;
        let Rest { others, cut, ended } = rest;
        Ok(Self { topics, others, cut, damaged_parts: ended.damaged_parts, without_topic: ended.without_topic })
    }

    /// The topics with this `content`.
    pub fn having(&self, content: Content) -> impl Iterator<Item = &RecordedTopic> {
        self.topics.iter().filter(move |topic| topic.content == content)
    }
}
