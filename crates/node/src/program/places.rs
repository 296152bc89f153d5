//! Default places of a robot's configuration.

use csi5300_node::config::Config;
use std::path::{Path, PathBuf};

/// Its name in each folder.
const NAME: &str = "robot.toml";
/// Default status socket.
const STATUS_SOCKET: &str = "/run/csi5300/status.sock";

/// The possible files, in order: in this folder, the user's, the machine's. The first that exists is used.
pub fn configurations() -> Vec<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")));
    let folders = [user, Some(PathBuf::from("/etc"))].into_iter().flatten().map(|folder| folder.join("csi5300"));
    std::iter::once(PathBuf::from(NAME)).chain(folders.map(|folder| folder.join(NAME))).collect()
}

/// The default configuration.
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

/// The status socket of the default configuration, if it names one.
pub fn status_socket() -> PathBuf {
    let found = configurations().into_iter().find(|file| file.is_file());
    let named = found.and_then(|file| match Config::load(&file) {
        Ok(config) => config.output.status_socket,
        Err(_) => {
            note!("{} is not valid (csi5300-node --check): looking at {STATUS_SOCKET}", file.display());
            None
        }
    });
    named.unwrap_or_else(|| Path::new(STATUS_SOCKET).to_path_buf())
}
