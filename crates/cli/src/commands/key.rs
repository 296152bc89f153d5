//! `csi5300 key`.

use super::{InWords, Outcome, Result, Words};
use csi5300::internal::{create_key_file, group_text, robot_text};
use csi5300::source::read_key;
use driver_iface::Mac;
use std::io::Read;
use std::path::PathBuf;

// Arguments of `key`.
#[derive(clap::Args)]
#[command(after_help = "Example, on a machine that is no robot:\n  csi5300 key new group.key\n  \
                        csi5300 key robot --group group.key --mac 00:21:6a:00:00:01 --peers 00:21:6a:00:00:02,00:21:6a:00:00:03 one.key\n\
                        A robot gets its own file. It cannot pose as another robot to a third; with the group's file it could.")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Write a new group secret of 256 random bits into a file that only its owner can read
    New {
        /// The file; an existing one is never overwritten
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Derive one robot's keys with its peers from the group's secret
    Robot {
        /// The group's file
        #[arg(long, value_name = "FILE")]
        group: PathBuf,
        /// The robot's MAC
        #[arg(long, value_name = "MAC")]
        mac: Mac,
        /// MACs of all its peers, separated by commas
        #[arg(long, required = true, value_delimiter = ',', value_name = "MAC,..")]
        peers: Vec<Mac>,
        /// The robot's file; an existing one is never overwritten
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// Makes a key.
pub fn run(args: &Args) -> Result {
    let (file, content) = match &args.what {
        What::New { file } => (file, group_text(&random()?)),
        What::Robot { group, mac, peers, file } => {
            if let Some(own) = peers.iter().find(|peer| *peer == mac) {
                return Err(format!("{own} is the robot's own MAC: --peers are the others"));
            }
            let group = read_key(group).in_words()?;
            let own = group.for_robot(*mac, peers);
            if let Some(peer) = peers.iter().find(|peer| !own.has_pair(*mac, **peer)) {
                return Err(format!("no key of {mac} with {peer} can be made from a robot's file: give the group's"));
            }
            (file, robot_text(&own).ok_or("no key was made")?)
        }
    };
    create_key_file(file, &content).in_words()?;
    note!("{}: a new key, mode 0600", file.display());
    Ok(Outcome::Done)
}

/// From the kernel's generator.
fn random() -> Words<[u8; 32]> {
    let mut secret = [0; 32];
    let read = std::fs::File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut secret));
    read.map(|()| secret).map_err(|error| format!("/dev/urandom: {error}"))
}
