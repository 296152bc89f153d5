//! Where a robot's configuration is looked for when none is named.

use csi5300_node::config::Config;
use std::path::{Path, PathBuf};

/// Its name in each of the folders.
const NAME: &str = "robot.toml";
/// Where a node's state is to be had if no configuration says so.
const STATUS_SOCKET: &str = "/run/csi5300/status.sock";

/// The files that are looked for, the first that is there is taken: in this folder, the user's, the machine's.
pub fn configurations() -> Vec<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")));
    let folders = [user, Some(PathBuf::from("/etc"))].into_iter().flatten().map(|folder| folder.join("csi5300"));
    std::iter::once(PathBuf::from(NAME)).chain(folders.map(|folder| folder.join(NAME))).collect()
}

/// The configuration that is meant where none is named.
///
/// # Errors
/// If there is none, in words.
pub fn configuration() -> Result<PathBuf, String> {
    let looked = configurations();
    match looked.iter().find(|file| file.is_file()) {
        Some(file) => {
            note!("configuration {}", file.display());
            Ok(file.clone())
        }
        None => {
            let names: Vec<String> = looked.iter().map(|file| file.display().to_string()).collect();
            Err(format!("no configuration: name one with --config, or put it at {}", names.join(", or at ")))
        }
    }
}

/// The status socket of the node that runs by the configuration found, if one names it.
pub fn status_socket() -> PathBuf {
    let found = configurations().into_iter().find(|file| file.is_file());
    let named = found.and_then(|file| Config::load(&file).ok()?.output.status_socket);
    named.unwrap_or_else(|| Path::new(STATUS_SOCKET).to_path_buf())
}
