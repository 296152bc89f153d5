//! Outputs, by one rule for all commands: an output is never an input (by name, link or inode), existing files are
//! replaced with `--force` only, and a file is complete or unchanged: it is written under another name and renamed at
//! the end.

use super::files::{is_same_file, must_not_exist};
use csi5300::source::side_path;
use csi5300_live::wait::is_ignored;
use nix::sys::signal::{SigSet, Signal, raise};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, Once, PoisonError};

/// Links of links that are followed, as many as the kernel does.
const LINKS: usize = 40;

/// Files and folders that this run reads.
static READ: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// Endings of the files that are read in a folder.
const DATA: [&str; 11] = ["dat", "datstp", "csv", "txt", "json", "toml", "yaml", "mcap", "db3", "bag", "zstd"];
/// How deep folders are looked into.
const DEEPEST: usize = 16;

/// This run reads `path`, a file or a folder: nothing of it is written from here on.
pub fn reads(path: &Path) {
    READ.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_owned());
}

/// The files that this run may read, with those beside logs and in folders.
fn read_files() -> Vec<PathBuf> {
    let read = READ.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let mut files = Vec::new();
    for path in read {
        if path.is_dir() {
            data_in(&path, DEEPEST, &mut files);
        } else {
            files.extend([side_path(&path), path]);
        }
    }
    files
}

fn data_in(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) {
    for path in std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
        let is_data = |ending: &std::ffi::OsStr| DATA.iter().any(|own| ending.eq_ignore_ascii_case(own));
        if path.is_file() && path.extension().is_some_and(is_data) {
            files.push(path);
        } else if depth > 0 && path.is_dir() && !path.is_symlink() {
            data_in(&path, depth - 1, files);
        }
    }
}

/// Refuses an output that this run reads, by any name or link.
pub fn must_not_be_read(output: &Path) -> Result<(), String> {
    if !output.is_file() {
        return Ok(());
    }
    match read_files().into_iter().find(|input| is_same_file(input, output)) {
        Some(input) if input == output => Err(format!("{} is an input: name another output", output.display())),
        Some(input) => {
            Err(format!("{} is the input {} by another name: name another output", output.display(), input.display()))
        }
        None => Ok(()),
    }
}

/// Drafts that are being written: a signal that ends the program takes them away.
static DRAFTS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn drafts() -> MutexGuard<'static, Vec<PathBuf>> {
    DRAFTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file on its way. What was there under its name stays until [`Draft::keep`], and for good where that is not reached: on
/// an error, and (feature `live`, which has signals) on SIGINT, SIGTERM and SIGHUP where they are not ignored.
pub struct Draft {
    path: PathBuf,
    /// Where it is written; `None` for devices and pipes, which are written as they are.
    part: Option<PathBuf>,
}

impl Draft {
    /// For the output `path`, which must be no input and, without `force`, not there. One that is there as a pipe is not replaced.
    ///
    /// # Errors
    /// In words.
    pub fn create(path: &Path, force: bool) -> Result<Self, String> {
        must_not_be_read(path)?;
        must_not_exist(path, force)?;
        Ok(Self::new(path))
    }

    /// For the output `path`. A link stays a link, also one that leads to a file that is not there.
    pub fn new(path: &Path) -> Self {
        // The target of a link may end otherwise, and that of standard output as a pipe is no path.
        let extension = path.extension().map_or(String::new(), |extension| format!(".{}", extension.to_string_lossy()));
        if path.metadata().is_ok_and(|found| !found.is_file()) {
            return Self { path: path.to_owned(), part: None };
        }
        let path = led_to(path);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let part = path.with_file_name(format!("{stem}.part-{}{extension}", std::process::id()));
        drafts().push(part.clone());
        watch_signals();
        Self { path, part: Some(part) }
    }

    /// Where to write it, with the output's extension.
    pub fn path(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.path)
    }

    /// The file that it will be.
    pub fn target(&self) -> &Path {
        &self.path
    }

    /// True for a file; false for devices and pipes, beside which nothing is written.
    pub fn is_file(&self) -> bool {
        self.part.is_some()
    }

    /// The file is complete: gives it its name, and also its side file if `side` is set.
    pub fn keep(self, side: bool) -> io::Result<()> {
        let Some(part) = &self.part else { return Ok(()) };
        // A signal that comes meanwhile waits.
        let _drafts = drafts();
        if side {
            std::fs::rename(side_path(part), side_path(&self.path))?;
        }
        std::fs::rename(part, &self.path)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Some(part) = &self.part {
            remove(part);
            drafts().retain(|other| other != part);
        }
    }
}

/// Files of a folder on their way: they are written into a folder of their own inside, and moved when all are whole.
pub struct FolderDraft {
    folder: PathBuf,
    part: PathBuf,
    /// Whether the folder was not there before.
    made: bool,
}

impl FolderDraft {
    /// For files in `folder`, which is created if missing.
    pub fn new(folder: &Path) -> Result<Self, String> {
        let part = folder.join(format!(".part-{}", std::process::id()));
        let made = !folder.exists();
        // From here on a signal takes it away.
        drafts().push(part.clone());
        watch_signals();
        let draft = Self { folder: folder.to_owned(), part, made };
        let words = |error: io::Error| {
            format!("cannot write into {}: {error}; check the folder and its rights", folder.display())
        };
        std::fs::create_dir_all(&draft.part).map_err(words)?;
        Ok(draft)
    }

    /// Where to write them.
    pub fn path(&self) -> &Path {
        &self.part
    }

    /// Words about the draft as words about the folder.
    pub fn words(&self, words: &str) -> String {
        words.replace(&self.part.display().to_string(), &self.folder.display().to_string())
    }

    /// The files written, under their final names.
    pub fn at_last(&self, written: &Path) -> PathBuf {
        written.strip_prefix(&self.part).map_or_else(
            |_| written.to_owned(),
            |inside| match inside.as_os_str().is_empty() {
                true => self.folder.clone(),
                false => self.folder.join(inside),
            },
        )
    }

    /// All are whole: moves them to their names, unless one of these is an input.
    pub fn keep(self) -> Result<(), String> {
        let mut files = Vec::new();
        files_in(&self.part, &mut files);
        for file in &files {
            let last = self.at_last(file);
            must_not_be_read(&last)?;
            if last.is_dir() {
                return Err(format!("cannot write {}: it is a folder", last.display()));
            }
        }
        // A signal that comes meanwhile waits.
        let _drafts = drafts();
        files.iter().try_for_each(|file| {
            let last = self.at_last(file);
            // A link to a file stays a link.
            let last = if last.is_file() { led_to(&last) } else { last };
            let moved = last.parent().map_or(Ok(()), std::fs::create_dir_all).and_then(|()| take_to(file, &last));
            moved.map_err(|error| format!("cannot write {}: {error}", last.display()))?;
            // The side file of an older log would give this one other host times.
            let older = side_path(&last);
            if !files.contains(&side_path(file)) && older.is_file() {
                let removed = std::fs::remove_file(&older);
                removed.map_err(|error| format!("cannot remove the older {}: {error}", older.display()))?;
            }
            Ok(())
        })
    }
}

impl Drop for FolderDraft {
    fn drop(&mut self) {
        remove(&self.part);
        drafts().retain(|other| *other != self.part);
        if self.made {
            // Where it is empty: it was made for nothing.
            let _ = std::fs::remove_dir(&self.folder);
        }
    }
}

/// Pictures that `draw` writes into a folder, under their final names: all of them, or none.
pub fn pictures(
    folder: &Path,
    draw: impl FnOnce(&Path) -> Result<Vec<PathBuf>, csi5300_lab::Failure>,
) -> Result<Vec<PathBuf>, String> {
    let draft = FolderDraft::new(folder)?;
    let written = draw(draft.path()).map_err(|error| draft.words(&error.to_string()))?;
    let written = written.iter().map(|path| draft.at_last(path)).collect();
    draft.keep().map(|()| written)
}

/// Moves a file, also to another file system, where a link may lead.
fn take_to(file: &Path, last: &Path) -> io::Result<()> {
    std::fs::rename(file, last).or_else(|error| match error.kind() {
        io::ErrorKind::CrossesDevices => {
            let part = last.with_file_name(format!(".part-{}", std::process::id()));
            let taken = std::fs::copy(file, &part).and_then(|_| std::fs::rename(&part, last));
            taken.inspect_err(|_| remove(&part))
        }
        _ => Err(error),
    })
}

fn files_in(folder: &Path, files: &mut Vec<PathBuf>) {
    for path in std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
        if path.is_dir() { files_in(&path, files) } else { files.push(path) }
    }
}

/// Writes a file as a whole; that it may be written was asked before.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), String> {
    must_not_be_read(path)?;
    let draft = Draft::new(path);
    let written = std::fs::write(draft.path(), content).and_then(|()| draft.keep(false));
    written.map_err(|error| format!("cannot write {}: {error}", path.display()))
}

/// Where a log is written while it is replaced.
pub fn rest(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push(".rest");
    name.into()
}

/// Takes away what there is of a draft.
fn remove(part: &Path) {
    if part.is_dir() {
        let _ = std::fs::remove_dir_all(part);
        return;
    }
    for path in [part.to_owned(), side_path(part), rest(part)] {
        let _ = std::fs::remove_file(path);
    }
}

/// The file behind all links of a name.
pub fn led_to(path: &Path) -> PathBuf {
    if let Ok(there) = path.canonicalize() {
        return there;
    }
    let mut at = path.to_path_buf();
    for _ in 0..LINKS {
        let Ok(next) = std::fs::read_link(&at) else { break };
        at = at.parent().map_or_else(|| next.clone(), |folder| folder.join(&next));
    }
    at
}

/// From here on a signal that would end the program takes drafts away before it does. Threads started later inherit that.
fn watch_signals() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let ends = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter().filter(|one| !is_ignored(*one));
        let set = SigSet::from_iter(ends);
        if set.thread_block().is_ok() {
            let wait = move || {
                let Ok(signal) = set.wait() else { return };
                let drafts = drafts();
                drafts.iter().for_each(|part| remove(part));
                // It ends the program, as it would have at once; nothing is given a name meanwhile.
                let _ = set.thread_unblock().and_then(|()| raise(signal));
            };
            // Without it the signal waits until the output is whole.
            let _ = std::thread::Builder::new().name("csi5300 signals".into()).spawn(wait);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_leads_where_its_links_do() {
        let folder = std::env::temp_dir().join(format!("csi5300-links-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("real")).unwrap();
        let folder = folder.canonicalize().unwrap();
        let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, folder.join(name)).unwrap();
        std::fs::write(folder.join("real/a"), b"").unwrap();
        link("real/a", "there");
        link("real/b", "gone");
        link("gone", "twice");
        link("round", "round");
        assert_eq!(led_to(&folder.join("there")), folder.join("real/a"));
        assert_eq!(led_to(&folder.join("twice")), folder.join("real/b"));
        assert_eq!(led_to(&folder.join("new")), folder.join("new"));
        // One that leads to itself has an end.
        assert_eq!(led_to(&folder.join("round")), folder.join("round"));
        let draft = Draft::new(&folder.join("twice"));
        std::fs::write(draft.path(), b"new").unwrap();
        std::fs::write(side_path(draft.path()), b"times").unwrap();
        draft.keep(true).unwrap();
        assert_eq!(std::fs::read(folder.join("real/b")).unwrap(), b"new");
        assert_eq!(std::fs::read(folder.join("real/bstp")).unwrap(), b"times");
        assert!(folder.join("gone").is_symlink());
        drop(Draft::new(&folder.join("never")));
        link("/dev/null", "device");
        let draft = FolderDraft::new(&folder).unwrap();
        ["there", "device"].iter().for_each(|name| std::fs::write(draft.path().join(name), b"newer").unwrap());
        draft.keep().unwrap();
        let is_newer = |name: &str| std::fs::read(folder.join(name)).unwrap() == b"newer";
        assert!(folder.join("there").is_symlink() && is_newer("real/a"));
        assert!(!folder.join("device").is_symlink() && is_newer("device"));
        // A log without a side file takes away that of the older log.
        let logs = ["x.dat", "x.datstp", "y.dat", "y.datstp"];
        logs.iter().for_each(|name| std::fs::write(folder.join(name), b"older").unwrap());
        let draft = FolderDraft::new(&folder).unwrap();
        ["x.dat", "y.dat", "y.datstp"]
            .iter()
            .for_each(|name| std::fs::write(draft.path().join(name), b"newer").unwrap());
        draft.keep().unwrap();
        assert!(!folder.join("x.datstp").exists() && is_newer("x.dat") && is_newer("y.datstp"));
        ["x.dat", "y.dat", "y.datstp"].iter().for_each(|name| std::fs::remove_file(folder.join(name)).unwrap());
        // A link may lead to another file system.
        let far = Path::new("/dev/shm").join(format!("csi5300-links-{}", std::process::id()));
        if std::fs::write(&far, b"").is_ok() {
            std::fs::remove_file(folder.join("device")).unwrap();
            link(far.to_str().unwrap(), "device");
            let draft = FolderDraft::new(&folder).unwrap();
            std::fs::write(draft.path().join("device"), b"newest").unwrap();
            draft.keep().unwrap();
            assert!(folder.join("device").is_symlink() && std::fs::read(&far).unwrap() == b"newest");
            std::fs::remove_file(far).unwrap();
        }
        // A folder in the way of one file keeps all of them out.
        let draft = FolderDraft::new(&folder).unwrap();
        ["there", "real"].iter().for_each(|name| std::fs::write(draft.path().join(name), b"none").unwrap());
        let refused = draft.keep().unwrap_err();
        assert!(refused.ends_with("real: it is a folder") && is_newer("real/a"), "{refused}");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 6);
        assert!(drafts().is_empty());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
