//! Files that a robot writes: their folders are there and may be written to, and none is another one.

use super::Check;
use csi5300::source::side_path;
use csi5300_sim::toml_lines::Step::Key;
use nix::unistd::{AccessFlags, access};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Folders that the service makes when it starts, for its own user (`packaging/csi5300-node.service`).
const OF_SERVICE: [&str; 2] = ["/var/lib/csi5300", "/run/csi5300"];

/// What becomes of an output's name.
#[derive(Clone, Copy)]
enum Kind {
    /// A new file beside what is there.
    Log,
    /// What is added to, and made if it is not there.
    Lines,
    /// A socket, made anew.
    Socket,
    /// A new folder beside what is there, with those above it.
    Folder,
}

impl Check<'_> {
    /// The log, the file of bearings, the status socket, the recording of ROS 2.
    pub(super) fn files_to_write(&mut self) {
        let config = self.config;
        let (output, bag) = (&config.output, config.ros2.as_ref().and_then(|ros| ros.bag.as_deref()));
        let bearings = Some(Path::new(&output.bearings)).filter(|_| !["", "-"].contains(&output.bearings.as_str()));
        let files = [
            (["log", "file"], Kind::Log, config.log.as_ref().map(|log| log.file.as_path())),
            (["output", "bearings"], Kind::Lines, bearings),
            (["output", "status_socket"], Kind::Socket, output.status_socket.as_deref()),
            (["ros2", "bag"], Kind::Folder, bag),
        ];
        let mut before: Vec<(&str, &Path)> = Vec::new();
        for (place, kind, file) in files {
            let Some(file) = file else { continue };
            let twice = before.iter().find(|(_, other)| is_one(other, file)).map(|(name, _)| {
                format!("{} is what `{name}` writes, too: they would destroy each other", file.display())
            });
            let itself = self.own_file.is_some_and(|own| is_one(own, file));
            let itself = itself.then(|| format!("{} is this configuration", file.display()));
            if let Some(why) = unwritable(file, kind).or(twice).or(itself) {
                self.refuse(&place.map(Key), why);
            }
            before.push((place[1], file));
        }
        if config.log.as_ref().is_some_and(|log| log.rotate_mib == Some(0)) {
            self.refuse(&[Key("log"), Key("rotate_mib")], "rotate_mib is 0: every record would have a file of its own");
        }
    }
}

/// True for two names of one file, or of one that is not there yet; the side file of a log is its own.
fn is_one(a: &Path, b: &Path) -> bool {
    let place = |file: &Path| {
        let folder = file.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        let there = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
        file.canonicalize().unwrap_or_else(|_| there.join(file.file_name().unwrap_or_default()))
    };
    place(a) == place(b) || place(&side_path(a)) == place(b)
}

/// Why an output cannot be written, as far as that is seen without writing it.
fn unwritable(file: &Path, kind: Kind) -> Option<String> {
    if OF_SERVICE.iter().any(|own| file.parent().is_some_and(|folder| folder.starts_with(own))) {
        return None;
    }
    let there = std::fs::metadata(file).ok().map(|found| found.file_type());
    let why = match (kind, there) {
        (Kind::Log | Kind::Lines, Some(there)) if there.is_dir() => "it is a folder".to_owned(),
        (Kind::Log, Some(there)) if !there.is_file() => "it is no regular file".to_owned(),
        (Kind::Lines, Some(there)) if there.is_socket() => "it is a socket".to_owned(),
        (Kind::Lines, Some(_)) => access(file, AccessFlags::W_OK).err()?.desc().to_owned(),
        (Kind::Socket, Some(there)) if !there.is_socket() => "it is there and no socket".to_owned(),
        (Kind::Folder, _) => {
            let above = folder_of(file).ancestors().find(|folder| folder.exists()).map_or(Path::new("."), here);
            unusable(above)?
        }
        (Kind::Log | Kind::Lines | Kind::Socket, _) => unusable(folder_of(file))?,
    };
    Some(format!("cannot write {}: {why}", file.display()))
}

/// The folder that a file is in.
fn folder_of(file: &Path) -> &Path {
    file.parent().map_or(Path::new("."), here)
}

/// Nowhere is this folder.
fn here(folder: &Path) -> &Path {
    if folder == Path::new("") { Path::new(".") } else { folder }
}

/// Why nothing can be made in a folder.
fn unusable(folder: &Path) -> Option<String> {
    Some(match folder {
        _ if !folder.exists() => format!("there is no folder {}", folder.display()),
        _ if !folder.is_dir() => format!("{} is no folder", folder.display()),
        _ => format!("{}: {}", folder.display(), access(folder, AccessFlags::W_OK | AccessFlags::X_OK).err()?.desc()),
    })
}
