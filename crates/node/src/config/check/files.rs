//! Checks a robot's outputs: their folders exist and are writable, and none is another output or an input.

use super::super::{Capture, Config, Feitcsi, Odometry, Records};
use super::Check;
use csi5300::source::side_path;
use csi5300_sim::toml_lines::Step::Key;
use nix::unistd::{AccessFlags, access};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::SocketAddr;
use std::path::Path;

/// Folders that the service makes when it starts, for its own user (`packaging/csi5300-node.service`).
const OF_SERVICE: [&str; 2] = ["/var/lib/csi5300", "/run/csi5300"];

/// Bytes of a socket's name at most: `sun_path` in `<linux/un.h>`, with a zero at its end.
const NAME_OF_SOCKET: usize = 107;

/// How an output's name is used.
#[derive(Clone, Copy)]
enum Kind {
    /// A new file beside existing ones.
    Log,
    /// A file to append to, made if absent.
    Lines,
    /// A new socket.
    Socket,
    /// A new folder beside existing ones, with its parents.
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
        let inputs = files_to_read(config);
        let mut before: Vec<(&str, &Path)> = Vec::new();
        for (place, kind, file) in files {
            let Some(file) = file else { continue };
            let read = inputs
                .iter()
                .find(|(_, input)| is_one(input, file))
                .map(|(key, _)| format!("{} is an input ({key}): name another output", file.display()));
            let twice = before.iter().find(|(_, other)| is_one(other, file)).map(|(name, _)| {
                format!("{} is also the output of `{name}`: they would overwrite each other", file.display())
            });
            let itself = self.own_file.is_some_and(|own| is_one(own, file));
            let itself = itself.then(|| format!("{} is this configuration", file.display()));
            if let Some(why) = unwritable(file, kind).or(read).or(twice).or(itself) {
                self.refuse(&place.map(Key), why);
            }
            before.push((place[1], file));
        }
        if config.log.as_ref().is_some_and(|log| log.rotate_mib == Some(0)) {
            self.refuse(&[Key("log"), Key("rotate_mib")], "rotate_mib is 0: every record would have a file of its own");
        }
    }
}

/// Every input of the configuration, and its key.
fn files_to_read(config: &Config) -> Vec<(String, &Path)> {
    let mut inputs: Vec<(String, &Path)> = Vec::new();
    match config.capture.get_ref() {
        Capture::Replay(replay) => inputs.push(("`capture.replay`".into(), &replay.file)),
        Capture::Room(room) => {
            // Others are built in.
            let scene = Some(room.scene.as_path()).filter(|scene| scene.extension().is_some());
            inputs.extend(scene.map(|scene| ("`capture.room`".into(), scene)));
            let followed = room.follow.iter();
            inputs.extend(followed.filter_map(|(name, of)| poses(format!("`capture.room.follow.{name}`"), of)));
        }
        Capture::Served(served) => inputs.push(("`capture.served`".into(), &served.socket)),
        Capture::Feitcsi(Feitcsi::Pipe(pipe)) => inputs.push(("`capture.feitcsi`".into(), pipe)),
        Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(Feitcsi::Udp(_)) => {}
    }
    inputs.extend(poses("`odometry`".into(), &config.odometry));
    for peer in config.peer.iter().map(|peer| peer.get_ref()) {
        if let Records::Replay(replay) = &peer.records {
            inputs.push((format!("`records.replay` of peer `{}`", peer.name), &replay.file));
        }
        inputs.extend(poses(format!("`poses` of peer `{}`", peer.name), &peer.poses));
    }
    let key = config.sounding.as_ref().and_then(|sounding| sounding.key.as_deref());
    inputs.extend(key.map(|key| ("`sounding.key`".into(), key)));
    let zenoh = config.network.as_ref().and_then(|network| network.zenoh.as_deref());
    inputs.extend(zenoh.map(|file| ("`network.zenoh`".into(), file)));
    inputs
}

/// The trajectory of poses, with its key.
fn poses(key: String, odometry: &Odometry) -> Option<(String, &Path)> {
    match odometry {
        Odometry::Csv(csv) => Some((key, &csv.file)),
        _ => None,
    }
}

/// True for two names of one file, also of a future one; the side file of a log counts too.
fn is_one(a: &Path, b: &Path) -> bool {
    let place = |file: &Path| {
        let there = folder_of(file).canonicalize().unwrap_or_else(|_| folder_of(file).to_owned());
        file.canonicalize().unwrap_or_else(|_| there.join(file.file_name().unwrap_or_default()))
    };
    // Hard links are compared by inode; devices may be shared.
    let number = |file: &Path| {
        let found = file.metadata().ok().filter(|found| !found.file_type().is_char_device())?;
        Some((found.dev(), found.ino()))
    };
    let is_same = |a: &Path, b: &Path| place(a) == place(b) || (number(a).is_some() && number(a) == number(b));
    // A log that is read by a link may have its side file beside the link, or beside the log.
    let sides = [side_path(a), side_path(&place(a))];
    is_same(a, b) || sides.iter().any(|side| is_same(side, b))
}

/// Why an output cannot be written, as far as that shows without writing.
fn unwritable(file: &Path, kind: Kind) -> Option<String> {
    if OF_SERVICE.iter().any(|own| file.parent().is_some_and(|folder| folder.starts_with(own))) {
        return None;
    }
    let there = std::fs::metadata(file).ok().map(|found| found.file_type());
    let why = match (kind, there) {
        _ if file.as_os_str().is_empty() => return Some("an empty name is no file: leave the key out for none".into()),
        (Kind::Socket, _) if SocketAddr::from_pathname(file).is_err() => {
            format!("it has {} bytes, and the name of a socket at most {NAME_OF_SOCKET}", file.as_os_str().len())
        }
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

/// The folder does not exist.
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
