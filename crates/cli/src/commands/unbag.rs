//! `csi5300 unbag`.

use super::{Outcome, Result};
use csi5300_bag::unbag::{BagError, UnbaggedTopic, unbag};
use std::path::{Path, PathBuf};

// Arguments of `unbag`.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: a folder as `ros2 bag` makes it, or a file (MCAP, SQLite, bag of ROS 1)
    #[arg(value_name = "BAG")]
    bag: PathBuf,
    /// Folder for a log of each CSI topic and a trajectory of each pose topic
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing outputs
    #[arg(long)]
    force: bool,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
}

/// The line of JSON of a topic.
#[derive(serde::Serialize)]
struct Row<'a> {
    file: &'a Path,
    topic: &'a str,
    kind: &'a str,
    messages: u64,
    unreadable: u64,
}

/// Makes logs and trajectories of a recording.
pub fn run(args: &Args) -> Result {
    let done = unbag(&args.bag, &args.out, args.force).map_err(|error| match error {
        BagError::There { .. } => format!("{error}: --force overwrites it, --out names another folder"),
        _ => error.to_string(),
    })?;
    let (mut written, mut lost) = (0, false);
    for topic in &done.topics {
        written += topic.messages;
        lost |= topic.unreadable > 0;
        let UnbaggedTopic { topic: name, kind, file, messages, unreadable, .. } = topic;
        if args.json {
            super::print_json(&Row { file, topic: name, kind, messages: *messages, unreadable: *unreadable });
        } else {
            let messages = super::some(*messages, "message", "messages");
            super::print(&format!("{}: {messages} of {name} ({kind})\n", file.display()));
        }
        if topic.unreadable > 0 {
            note!("{}: unreadable: {}", topic.topic, super::some(topic.unreadable, "message", "messages"));
        }
    }
    for file in &done.cut {
        note!("{}: the end is missing; everything before it was read", file.display());
    }
    for words in super::files::lost_words(done.damaged_parts, done.without_topic) {
        lost = true;
        note!("{}: {words}", args.bag.display());
    }
    note!("{} of other topics", super::some(done.others, "message", "messages"));
    Ok(match written {
        0 => Outcome::Nothing,
        _ if lost => Outcome::DataLost,
        _ => Outcome::Done,
    })
}
