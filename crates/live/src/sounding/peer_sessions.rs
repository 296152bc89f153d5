//! Keeps the newest session and number of each peer over restarts, so that a restarted robot does not answer replayed
//! frames.

use super::exchange::News;
use super::session;
use csi5300::exchange::tdma::Event;
use driver_iface::Mac;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

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
        Self::open_in(session::usual_folders(), own)
    }

    fn open_in(folders: Vec<PathBuf>, own: Mac) -> Self {
        let name = format!("peers-{}", own.to_string().replace(':', ""));
        let mut peers = BTreeMap::new();
        for text in folders.iter().filter_map(|folder| session::read(&folder.join(&name))) {
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
            let _ = folders.iter().any(|folder| session::keep(folder, &name, &text).is_ok());
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
