//! What several tests share.
#![allow(dead_code)]

pub mod link;

use std::path::{Path, PathBuf};

/// The folder of the workspace.
pub fn root() -> &'static Path {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.ancestors().find(|folder| folder.join("Cargo.lock").is_file()).unwrap_or(own)
}

/// The folder of real captures, or `None` (said on standard error) where it is absent.
pub fn captures() -> Option<PathBuf> {
    let beside = root().join("../shared/captures");
    let folder = std::env::var_os("CSI5300_CAPTURES").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no captures at {} (CSI5300_CAPTURES names another folder)", folder.display());
    None
}
