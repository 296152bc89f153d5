//! What several tests share.
#![allow(dead_code)]

pub mod link;

use std::io::Write;
use std::path::{Path, PathBuf};

/// Says that the running test does not run whole here, and why: on standard error past the harness, which hides what passed; as a line of [`skips`], of which
/// the last binary of `cargo test` makes a summary; and of the file that `CSI5300_SKIPS` names, where `.ci/run` collects them.
pub fn skipped(why: &str) {
    let line = format!("skipped: {}: {why}\n", std::thread::current().name().unwrap_or("a test"));
    let _ = std::io::stderr().write_all(line.as_bytes());
    let append = |list: &Path| {
        let file = std::fs::OpenOptions::new().create(true).append(true).open(list);
        file.and_then(|mut file| file.write_all(line.as_bytes()))
    };
    let _ = append(&skips());
    if let Some(list) = std::env::var_os("CSI5300_SKIPS") {
        append(Path::new(&list)).unwrap();
    }
}

/// Where what was skipped is collected: the binaries of one run of `cargo test` are children of one process, known by its number and
/// its start. In the folder of what is built, where nobody else writes.
pub fn skips() -> PathBuf {
    let parent = std::os::unix::process::parent_id();
    let stat = std::fs::read_to_string(format!("/proc/{parent}/stat")).unwrap_or_default();
    // Field 22; the name, in brackets, is the second.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let began = fields.split_whitespace().nth(19).unwrap_or("0");
    let folder = option_env!("CARGO_TARGET_TMPDIR").map_or_else(std::env::temp_dir, PathBuf::from);
    folder.join(format!("skipped-{parent}-{began}"))
}

/// The folder of the workspace.
pub fn root() -> &'static Path {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.ancestors().find(|folder| folder.join("Cargo.lock").is_file()).unwrap_or(own)
}

/// The captures of the WSR data set that tests know, by their stamps: a folder that has more changes no bound.
const WSR: [&str; 14] = [
    "2021-06-27_202550",
    "2021-06-27_203220",
    "2021-06-27_204514",
    "2021-06-27_205432",
    "2021-06-27_191635",
    "2021-06-27_192624",
    "2021-06-28_193409",
    "2021-06-28_194645",
    "2021-06-28_195558",
    "2021-06-29_135548",
    "2021-06-29_140734",
    "2021-06-29_143813",
    "2021-08-18_175655",
    "2021-08-18_182429",
];

/// A folder of logs beside the captures, or `None` (said) where it is absent.
pub fn cases(kind: &str) -> Option<PathBuf> {
    let beside = root().join("../shared/cases");
    let folder = std::env::var_os("CSI5300_CASES").map_or(beside, PathBuf::from).join(kind);
    if folder.is_dir() {
        return Some(folder);
    }
    skipped(&format!("no {} (CSI5300_CASES names another folder)", folder.display()));
    None
}

/// True for a capture of the WSR data set that tests know.
pub fn is_known(stamp: &str) -> bool {
    WSR.contains(&stamp)
}

/// The folder of real captures, or `None` (said) where it is absent.
pub fn captures() -> Option<PathBuf> {
    let beside = root().join("../shared/captures");
    let folder = std::env::var_os("CSI5300_CAPTURES").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    skipped(&format!("no captures at {} (CSI5300_CAPTURES names another folder)", folder.display()));
    None
}
