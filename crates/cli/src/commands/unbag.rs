//! `csi5300 unbag`.

use super::draft::{FolderDraft, must_not_be_read};
use super::{Outcome, Result, must_not_exist};
use csi5300_bag::unbag::Recording;
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

/// Makes logs and trajectories of a recording.
pub fn run(args: &Args) -> Result {
    let draft = FolderDraft::new(&args.out)?;
    let may = |file: &Path| {
        let file = args.out.join(file);
        must_not_be_read(&file).and_then(|()| must_not_exist(&file, args.force))
    };
    let done = Recording::write(&args.bag, draft.path(), may);
    let mut done = done.map_err(|error| draft.words(&error.to_string()))?;
    done.topics.iter_mut().for_each(|topic| topic.file = args.out.join(&topic.file));
    draft.keep()?;
    for topic in &done.topics {
        if args.json {
            super::print_json(topic);
        } else {
            let (file, messages) = (topic.file.display(), super::some(topic.messages, "message", "messages"));
            super::print(&format!("{file}: {messages} of {} ({})\n", topic.topic, topic.kind));
        }
    }
    let lost = super::files::say_lost(&args.bag, &done);
    note!("{} of other topics", super::some(done.others, "message", "messages"));
    if done.topics.is_empty() {
        note!("nothing to write: no topic of CSI or poses in {}", args.bag.display());
    }
    Ok(Outcome::of(done.topics.iter().any(|topic| topic.messages > 0), lost))
}
