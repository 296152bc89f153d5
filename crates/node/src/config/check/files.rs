//! Files that a robot writes: their folders are there, and may be written to.

use super::Check;
use csi5300_sim::toml_lines::Step::Key;
use nix::unistd::{AccessFlags, access};
use std::path::Path;

/// Folders that the service makes when it starts, for its own user (`packaging/csi5300-node.service`).
const OF_SERVICE: [&str; 2] = ["/var/lib/csi5300", "/run/csi5300"];

impl Check<'_> {
    /// The log, the file of bearings, the status socket, the recording of ROS 2.
    pub(super) fn files_to_write(&mut self) {
        let config = self.config;
        let (output, bag) = (&config.output, config.ros2.as_ref().and_then(|ros| ros.bag.as_deref()));
        let bearings = Some(Path::new(&output.bearings)).filter(|_| !["", "-"].contains(&output.bearings.as_str()));
        let files = [
            (["log", "file"], config.log.as_ref().map(|log| log.file.as_path())),
            (["output", "bearings"], bearings),
            (["output", "status_socket"], output.status_socket.as_deref()),
            (["ros2", "bag"], bag),
        ];
        for (place, file) in files {
            if let Some(why) = file.and_then(unwritable) {
                self.refuse(&place.map(Key), why);
            }
        }
    }
}

/// Why a file cannot be written, as far as that is seen without writing it.
fn unwritable(file: &Path) -> Option<String> {
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    if OF_SERVICE.iter().any(|own| folder.starts_with(own)) {
        return None;
    }
    let why = match file {
        _ if !folder.exists() => format!("there is no folder {}", folder.display()),
        _ if !folder.is_dir() => format!("{} is no folder", folder.display()),
        file if file.is_dir() => "it is a folder".to_owned(),
        file if file.is_file() => access(file, AccessFlags::W_OK).err()?.desc().to_owned(),
        _ => format!("{}: {}", folder.display(), access(folder, AccessFlags::W_OK | AccessFlags::X_OK).err()?.desc()),
    };
    Some(format!("cannot write {}: {why}", file.display()))
}
