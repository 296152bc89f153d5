//! What several tests share.
#![allow(dead_code)]

pub mod link;

use std::path::{Path, PathBuf};

/// The folder of real captures, or `None` (said on standard error) where it is absent.
pub fn captures() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/captures");
    let folder = std::env::var_os("CSI5300_CAPTURES").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no captures at {} (CSI5300_CAPTURES names another folder)", folder.display());
    None
}
