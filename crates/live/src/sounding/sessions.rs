//! The number of a start, higher than every earlier one even if the clock is not; and the newest session and number of each
//! peer, kept over restarts, so that a restarted robot does not answer replayed frames.

use super::exchange::News;
use csi5300::exchange::tdma::Event;
use driver_iface::Mac;
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// 2025, seconds since 1970: a clock that shows less was never set.
const PLAUSIBLE_S: u32 = 1_735_689_600;
/// Bytes of a file with sessions at most: a line of 40 bytes for each robot of an exchange.
const LONGEST: u64 = 1 << 16;

/// The new session, and a warning if it could not be saved and that matters.
pub(super) fn begin(own: Mac, wall_us: Option<i64>) -> (u32, Option<String>) {
    let wall_s = wall_us.and_then(|us| u32::try_from(us / 1_000_000).ok()).unwrap_or(0);
    let (session, kept) = begin_in(&usual_folders(), own, wall_s);
    let why = kept.err().filter(|_| wall_s < PLAUSIBLE_S);
    let warning = why.map(|why| {
        format!(
            "the clock of this machine is not set, and the number of this start cannot be kept ({why}): robots that \
             share a key will ignore this one if they have heard it before; set the clock, or XDG_STATE_HOME to a \
             folder that can be written"
        )
    });
    (session, warning)
}

/// Places for the last session on this machine.
pub(super) fn usual_folders() -> Vec<PathBuf> {
    folders(|name| std::env::var_os(name).map(PathBuf::from))
}

/// The content of a file; nothing if it is too long.
pub(super) fn read(file: &Path) -> Option<String> {
    // A pipe of that name would block.
    std::fs::metadata(file).ok().filter(std::fs::Metadata::is_file)?;
    let mut text = String::new();
    std::fs::File::open(file).ok()?.take(LONGEST).read_to_string(&mut text).ok()?;
    Some(text)
}

/// Places for the last session, the best first.
fn folders(variable: impl Fn(&str) -> Option<PathBuf>) -> Vec<PathBuf> {
    let set = |name| variable(name).filter(|path| path.is_absolute());
    let state = set("XDG_STATE_HOME").or_else(|| set("HOME").map(|home| home.join(".local/state")));
    state.into_iter().chain([PathBuf::from("/var/lib")]).map(|folder| folder.join("csi5300")).collect()
}

/// Higher than every session saved in any of the folders, and saved in the first writable one.
fn begin_in(folders: &[PathBuf], own: Mac, wall_s: u32) -> (u32, io::Result<()>) {
    let name = format!("session-{}", own.to_string().replace(':', ""));
    let read = |folder: &PathBuf| read(&folder.join(&name))?.trim().parse::<u32>().ok();
    let last = folders.iter().filter_map(read).max();
    let session = wall_s.max(last.map_or(1, |last| last.saturating_add(1)));
    let mut kept = Err(io::Error::from(io::ErrorKind::NotFound));
    for folder in folders {
        kept = keep(folder, &name, &format!("{session}\n"));
        if kept.is_ok() {
            break;
        }
    }
    (session, kept)
}

/// Written beside the old one and moved over it, so that a power cut leaves one of them.
pub(super) fn keep(folder: &Path, name: &str, text: &str) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let new = folder.join(format!("{name}.new"));
    // Existing files and pipes are not written into.
    let _ = std::fs::remove_file(&new);
    let mut file = std::fs::File::create_new(&new)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    std::fs::rename(new, folder.join(name))
}

/// Interval of saving numbers. Frames recorded within this time before a restart may still be answered once.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// The state of peers that share a key.
#[derive(Debug, Default)]
pub struct PeerSessions {
    name: String,
    folders: Vec<PathBuf>,
    /// Session and number.
    peers: BTreeMap<Mac, (u32, u32)>,
    changed: bool,
    kept_at: Option<Instant>,
    /// Only the end waits for the disk.
    writing: Option<JoinHandle<()>>,
}

impl PeerSessions {
    /// The saved state of the peers, beside the robot's own session.
    pub(super) fn open(own: Mac) -> Self {
        Self::open_in(usual_folders(), own)
    }

    fn open_in(folders: Vec<PathBuf>, own: Mac) -> Self {
        let name = format!("peers-{}", own.to_string().replace(':', ""));
        let mut peers = BTreeMap::new();
        for text in folders.iter().filter_map(|folder| read(&folder.join(&name))) {
            for (mac, at) in text.lines().filter_map(entry) {
                let newest = peers.entry(mac).or_insert(at);
                *newest = at.max(*newest);
            }
        }
        Self { name, folders, peers, ..Self::default() }
    }

    /// Peers with their newest session and number.
    pub(super) fn peers(&self) -> Vec<(Mac, u32, u32)> {
        self.peers.iter().map(|(mac, (session, number))| (*mac, *session, *number)).collect()
    }

    /// Takes an event whose tag the scheduler has checked.
    pub(super) fn note(&mut self, news: &News) {
        let News::Event(event) = news else { return };
        let (mac, at) = match *event {
            Event::Asked { peer, number, session } => (peer, (session, number)),
            Event::Answered { peer, peer_session, .. } => (peer, (peer_session, 0)),
            Event::Restarted { peer, session } => (peer, (session, 0)),
            _ => return,
        };
        // A session's own numbers only go up.
        let newest = self.peers.entry(mac).or_default();
        if at > *newest {
            *newest = at;
            self.changed = true;
        }
    }

    /// Saves it if due.
    pub(super) fn keep_if_due(&mut self) {
        let is_due = self.kept_at.is_none_or(|at| at.elapsed() >= KEEP_EVERY);
        if !is_due || self.writing.as_ref().is_some_and(|writing| !writing.is_finished()) {
            return;
        }
        if let Some(write) = self.write() {
            self.writing = std::thread::Builder::new().name("csi5300 sessions".into()).spawn(write).ok();
        }
    }

    /// Saves it now.
    pub(super) fn keep(&mut self) {
        if let Some(writing) = self.writing.take() {
            let _ = writing.join();
        }
        if let Some(write) = self.write() {
            write();
        }
    }

    /// Saves it in the first writable place; without one, replays of older sessions are recognised only while it runs.
    /// None without news.
    fn write(&mut self) -> Option<impl FnOnce() + Send + use<>> {
        std::mem::take(&mut self.changed).then_some(())?;
        self.kept_at = Some(Instant::now());
        let line = |(mac, (session, number)): (&Mac, &(u32, u32))| format!("{mac} {session} {number}\n");
        let text: String = self.peers.iter().map(line).collect();
        let (folders, name) = (self.folders.clone(), self.name.clone());
        Some(move || {
            let _ = folders.iter().any(|folder| keep(folder, &name, &text).is_ok());
        })
    }
}

fn entry(line: &str) -> Option<(Mac, (u32, u32))> {
    let mut words = line.split(' ');
    let entry = (words.next()?.parse().ok()?, (words.next()?.parse().ok()?, words.next()?.parse().ok()?));
    words.next().is_none().then_some(entry)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_is_later_than_the_one_before_whatever_the_clock_shows() {
        let root = std::env::temp_dir().join(format!("csi5300-session-{}", std::process::id()));
        std::fs::create_dir_all(&root).unwrap();
        std::fs::write(root.join("file"), "").unwrap();
        // The first cannot be made: a file is in its place.
        let folders = [root.join("file/csi5300"), root.join("state/csi5300")];
        let (a, b) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
        let begin = |mac, wall_s| {
            let (session, kept) = begin_in(&folders, mac, wall_s);
            kept.unwrap();
            session
        };
        assert_eq!([begin(a, 1_000), begin(a, 1_000), begin(a, 2_000)], [1_000, 1_001, 2_000]);
        assert_eq!([begin(a, 0), begin(a, 5)], [2_001, 2_002], "a clock that was set back");
        assert_eq!(begin(b, 7), 7, "each robot has its own");
        std::fs::write(root.join("state/csi5300/session-020000000002"), "rubbish").unwrap();
        assert_eq!([begin(b, 7), begin(b, 7)], [7, 8]);
        let (session, kept) = begin_in(&folders[..1], a, 9);
        assert!(session == 9 && kept.is_err());
        // Pipes where its files should be are not waited for, and give way.
        for name in ["session-020000000001", "session-020000000001.new"] {
            let pipe = root.join("state/csi5300").join(name);
            let _ = std::fs::remove_file(&pipe);
            assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        }
        assert_eq!([begin(a, 5), begin(a, 5)], [5, 6]);
        std::fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn the_users_own_folder_comes_first() {
        let folders = |set: &[(&str, &str)]| -> Vec<String> {
            let variable = |name: &str| set.iter().find(|(known, _)| *known == name).map(|(_, path)| path.into());
            super::folders(variable).iter().map(|path| path.display().to_string()).collect()
        };
        assert_eq!(folders(&[("XDG_STATE_HOME", "/s"), ("HOME", "/h")]), ["/s/csi5300", "/var/lib/csi5300"]);
        assert_eq!(folders(&[("HOME", "/h")]), ["/h/.local/state/csi5300", "/var/lib/csi5300"]);
        assert_eq!(folders(&[("XDG_STATE_HOME", "relative")]), ["/var/lib/csi5300"]);
    }

    #[test]
    fn the_newest_session_of_each_peer_outlives_a_restart() {
        let root = std::env::temp_dir().join(format!("csi5300-heard-{}", std::process::id()));
        let folders = vec![root.join("state/csi5300")];
        let [own, a, b] = [1, 2, 3].map(|last| Mac([2, 0, 0, 0, 0, last]));
        let mut heard = PeerSessions::open_in(folders.clone(), own);
        let asked = |peer, session, number| News::Event(Event::Asked { peer, number, session });
        for news in [asked(a, 100, 7), asked(a, 100, 9), asked(a, 99, 1_000), asked(b, 5, 1)] {
            heard.note(&news);
        }
        let answered = Event::Answered { peer: b, number: 3, peer_session: 6, measurement: None };
        heard.note(&News::Event(answered));
        heard.keep();
        assert_eq!(PeerSessions::open_in(folders.clone(), own).peers(), [(a, 100, 9), (b, 6, 0)]);
        assert!(PeerSessions::open_in(folders.clone(), a).peers().is_empty(), "each robot has its own");
        std::fs::write(root.join("state/csi5300/peers-020000000001"), "rubbish\n02:00:00:00:00:02 8 9 10\n").unwrap();
        assert!(PeerSessions::open_in(folders, own).peers().is_empty());
        std::fs::remove_dir_all(root).unwrap();
    }
}
