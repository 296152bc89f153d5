//! The doctor's view of the machine.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What a command printed and whether it succeeded.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ran {
    /// Exit status 0.
    pub ok: bool,
    /// Standard output, then standard error.
    pub text: String,
}

/// Files and commands of a machine. Paths are absolute; absent ones are `None` or empty.
pub trait System {
    /// A file's bytes.
    fn bytes(&self, path: &str) -> Option<Vec<u8>>;
    /// Names in a folder, sorted.
    fn names(&self, path: &str) -> Vec<String>;
    /// The last part of a symbolic link's target.
    fn link(&self, path: &str) -> Option<String>;
    /// A file's size.
    fn size(&self, path: &str) -> Option<u64>;
    /// Runs a program; `None` if it is not installed.
    fn run(&self, words: &[&str]) -> Option<Ran>;
    /// Replaces a file's content.
    ///
    /// # Errors
    /// The operating system's answer.
    fn write(&self, path: &str, text: &str) -> std::io::Result<()>;

    /// A file as trimmed text.
    fn text(&self, path: &str) -> Option<String> {
        self.bytes(path).map(|bytes| String::from_utf8_lossy(&bytes).trim().to_string())
    }
}

/// The counters of the module `csi5300`.
const COUNTERS: &str = "/sys/module/csi5300/counters";

/// The counters of the module `csi5300`, by name; none where it is not loaded.
#[must_use]
pub fn module_counters(system: &dyn System) -> Vec<(String, u64)> {
    let value = |name: &String| system.text(&format!("{COUNTERS}/{name}"))?.parse().ok();
    system.names(COUNTERS).into_iter().filter_map(|name| value(&name).map(|count| (name, count))).collect()
}

/// This machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Machine;

impl System for Machine {
    fn bytes(&self, path: &str) -> Option<Vec<u8>> {
        std::fs::read(path).ok()
    }
    fn names(&self, path: &str) -> Vec<String> {
        names(Path::new(path))
    }
    fn link(&self, path: &str) -> Option<String> {
        link(Path::new(path))
    }
    fn size(&self, path: &str) -> Option<u64> {
        std::fs::metadata(path).ok().map(|about| about.len())
    }
    fn run(&self, words: &[&str]) -> Option<Ran> {
        let (program, arguments) = words.split_first()?;
        let mut command = Command::new(program);
        // Administrators' tools are often outside of a user's path, and their output is parsed in English.
        let path = std::env::var("PATH").unwrap_or_default();
        command.args(arguments).env("PATH", format!("{path}:/usr/sbin:/sbin")).env("LC_ALL", "C").stdin(Stdio::null());
        let out = command.output().ok()?;
        let text = [out.stdout, out.stderr].concat();
        Some(Ran { ok: out.status.success(), text: String::from_utf8_lossy(&text).into_owned() })
    }
    fn write(&self, path: &str, text: &str) -> std::io::Result<()> {
        std::fs::write(path, text)
    }
}

/// A copy of a machine's files under a folder; a command's output is the file `run/<its words>`, `/` written as `_`.
#[derive(Clone, Debug)]
pub struct Tree {
    root: PathBuf,
}

impl Tree {
    /// The machine under `root`.
    #[must_use]
    pub fn new(root: PathBuf) -> Self {
        Self { root }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }
}

impl System for Tree {
    fn bytes(&self, path: &str) -> Option<Vec<u8>> {
        std::fs::read(self.at(path)).ok()
    }
    fn names(&self, path: &str) -> Vec<String> {
        names(&self.at(path))
    }
    fn link(&self, path: &str) -> Option<String> {
        link(&self.at(path))
    }
    fn size(&self, path: &str) -> Option<u64> {
        std::fs::metadata(self.at(path)).ok().map(|about| about.len())
    }
    fn run(&self, words: &[&str]) -> Option<Ran> {
        let text = std::fs::read_to_string(self.root.join("run").join(words.join(" ").replace('/', "_"))).ok()?;
        Some(Ran { ok: true, text })
    }
    fn write(&self, path: &str, text: &str) -> std::io::Result<()> {
        std::fs::write(self.at(path), text)
    }
}

fn names(path: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(path) else { return Vec::new() };
    let mut names: Vec<_> = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn link(path: &Path) -> Option<String> {
    let target = std::fs::read_link(path).ok()?;
    target.file_name().map(OsStr::to_string_lossy).map(|name| name.into_owned())
}
