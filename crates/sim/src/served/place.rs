//! The path of a room's socket; no other file is ever removed.

use super::seqpacket;
use csi5300::source::Error;
use nix::errno::Errno;
use nix::sys::socket::{SockFlag, UnixAddr, bind, connect};
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

/// Bytes of a socket's path at most (struct sockaddr_un: 108 with the zero at its end).
const LONGEST_PATH: usize = 107;

/// Why a room has no socket; inside [`csi5300::source::Error::Backend`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlaceError {
    /// Another file is there; it stays.
    #[error("{} is there and is no socket: give the room's socket another name", path.display())]
    NoSocket {
        /// The path.
        path: PathBuf,
    },
    /// Somebody listens there.
    #[error("another room, or another program, is served at {}: stop it first, or give this one another name", path.display())]
    Taken {
        /// The path.
        path: PathBuf,
    },
    /// The name does not fit a socket.
    #[error("the path {} has {len} bytes; a socket's has 1 to {LONGEST_PATH}", path.display())]
    Length {
        /// The path.
        path: PathBuf,
        /// Its bytes.
        len: usize,
    },
}

impl From<PlaceError> for Error {
    fn from(error: PlaceError) -> Self {
        Self::Backend(Box::new(error))
    }
}

/// The path of a socket, which is removed at the end.
#[derive(Debug)]
pub(super) struct Place {
    path: PathBuf,
    /// Device and inode of the socket.
    own: (u64, u64),
}

impl Place {
    /// Binds a socket to a path. Removes an abandoned socket there first, but no other file.
    pub(super) fn take(socket: &OwnedFd, path: &Path) -> Result<Self, Error> {
        let io = |source: io::Error| cannot_serve(path, source);
        let len = path.as_os_str().len();
        if !(1..=LONGEST_PATH).contains(&len) {
            return Err(PlaceError::Length { path: path.to_owned(), len }.into());
        }
        make_way(path)?;
        let address = UnixAddr::new(path).map_err(|errno| io(errno.into()))?;
        bind(socket.as_raw_fd(), &address).map_err(|errno| io(errno.into()))?;
        Ok(Self { own: identity(path).map_err(io)?, path: path.to_owned() })
    }

    /// The path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the socket if it is still at the path. It must be open, so that its inode is not reused.
    pub(super) fn leave(&self) {
        if identity(&self.path).is_ok_and(|there| there == self.own) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn cannot_serve(path: &Path, source: io::Error) -> Error {
    Error::Io { what: format!("cannot serve a room at {}; is its folder there and writable", path.display()), source }
}

/// Device and inode at a path, without following a link.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    let there = std::fs::symlink_metadata(path)?;
    Ok((there.dev(), there.ino()))
}

/// Removes an abandoned socket, but no other file.
fn make_way(path: &Path) -> Result<(), Error> {
    let Ok(there) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !there.file_type().is_socket() {
        return Err(PlaceError::NoSocket { path: path.to_owned() }.into());
    }
    let asked = seqpacket(SockFlag::empty()).and_then(|socket| {
        let address = UnixAddr::new(path)?;
        connect(socket.as_raw_fd(), &address)
    });
    match asked {
        // Somebody listens, to sockets of this type or of another.
        Ok(()) | Err(Errno::EPROTOTYPE | Errno::EAGAIN) => Err(PlaceError::Taken { path: path.to_owned() }.into()),
        Err(Errno::ECONNREFUSED) => std::fs::remove_file(path).map_err(|source| cannot_serve(path, source)),
        Err(errno) => Err(cannot_serve(path, errno.into())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixListener;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("csi5300-place-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn socket() -> OwnedFd {
        seqpacket(SockFlag::empty()).unwrap()
    }

    fn refused(path: &Path) -> String {
        Place::take(&socket(), path).unwrap_err().to_string()
    }

    #[test]
    fn other_files_stay_and_are_named() {
        let folder = folder("files");
        let [file, link, dangling] = ["precious.dat", "link", "dangling"].map(|name| folder.join(name));
        std::fs::write(&file, "precious").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        std::os::unix::fs::symlink(folder.join("none"), &dangling).unwrap();
        for path in [&file, &link, &dangling, &folder] {
            let said = refused(path);
            assert!(said.contains("is there and is no socket") && !said.contains("another room"), "{said}");
            assert!(std::fs::symlink_metadata(path).is_ok());
        }
        assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_refusal_names_the_places_problem_and_no_other_room() {
        let folder = folder("lacks");
        let cases = [
            (folder.join("none").join("room"), "No such file"),
            (folder.join("x".repeat(120)), "a socket's has 1 to 107"),
            (PathBuf::new(), "has 0 bytes"),
        ];
        for (path, why) in cases {
            let said = refused(&path);
            assert!(said.contains(why) && !said.contains("another"), "{said}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_socket_in_use_is_refused_and_one_left_behind_is_replaced() {
        let folder = folder("sockets");
        let path = folder.join("room");
        // Of another type, as a node's status socket.
        let living = UnixListener::bind(&path).unwrap();
        assert!(refused(&path).contains("is served at"));
        drop(living);
        let own = socket();
        let place = Place::take(&own, &path).unwrap();
        place.leave();
        assert!(!path.exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_in_place_of_the_socket_stays() {
        let folder = folder("later");
        let path = folder.join("room");
        let own = socket();
        let place = Place::take(&own, &path).unwrap();
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "of somebody else").unwrap();
        place.leave();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "of somebody else");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
