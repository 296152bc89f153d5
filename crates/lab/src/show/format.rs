//! Picture files: a PNG and an SVG each.
use super::Error;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Extensions of a picture's files: pixels and vectors.
const KINDS: [&str; 2] = ["png", "svg"];

/// How pictures are written: whether files of the same names are replaced.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Format {
    /// Whether files of the same names are replaced; if not, an existing one is [`Error::There`].
    pub replace: bool,
    /// Files that are never replaced, under any name: [`Error::Kept`].
    pub kept: Vec<PathBuf>,
}

impl Default for Format {
    /// Existing files are replaced.
    fn default() -> Self {
        Self { replace: true, kept: Vec::new() }
    }
}

impl Format {
    /// Replacing files of the same names, or not.
    #[must_use]
    pub fn with_replace(mut self, replace: bool) -> Self {
        self.replace = replace;
        self
    }

    /// Never replaces these files, under any name.
    #[must_use]
    pub fn with_kept(mut self, kept: Vec<PathBuf>) -> Self {
        self.kept = kept;
        self
    }

    /// The files of a picture: `stem` with `.png` and with `.svg`.
    #[must_use]
    pub fn files(&self, stem: &Path) -> [PathBuf; 2] {
        KINDS.map(|kind| {
            let mut name = stem.as_os_str().to_owned();
            name.push(format!(".{kind}"));
            PathBuf::from(name)
        })
    }

    /// Refuses pictures if one of their files exists and may not be replaced. Call it before long work, and before the first of
    /// several pictures.
    ///
    /// # Errors
    /// [`Error::There`], [`Error::Kept`].
    pub fn check(&self, stems: &[PathBuf]) -> Result<(), Error> {
        let there = || stems.iter().flat_map(|stem| self.files(stem)).filter(|file| file.is_file());
        if let Some(path) = there().find(|file| self.kept.iter().any(|kept| is_same(kept, file))) {
            return Err(Error::Kept { path });
        }
        match there().next().filter(|_| !self.replace) {
            Some(path) => Err(Error::There { path }),
            None => Ok(()),
        }
    }
}

/// True if both names refer to one file.
fn is_same(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        a.metadata().ok().zip(b.metadata().ok()).is_some_and(|(a, b)| (a.dev(), a.ino()) == (b.dev(), b.ino()))
    }
    #[cfg(not(unix))]
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

/// Writes a file so that it is either complete or unchanged: under a temporary name beside it, renamed at the end. A link stays
/// a link; devices and pipes are written directly.
///
/// # Errors
/// If it cannot be written; no part of it remains.
pub(super) fn write_whole(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if target.metadata().is_ok_and(|found| !found.is_file()) {
        return write(&mut File::create(&target)?);
    }
    let name = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, extension) = (name(target.file_stem()), name(target.extension()));
    let draft = target.with_file_name(format!("{stem}.part-{}.{extension}", std::process::id()));
    let written = File::create(&draft).and_then(|mut file| write(&mut file));
    let written = written.and_then(|()| std::fs::rename(&draft, &target));
    if written.is_err() {
        let _ = std::fs::remove_file(&draft);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_full_disk_leaves_the_old_picture() {
        let folder = std::env::temp_dir().join(format!("csi5300-whole-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let full = |file: &mut File| {
            file.write_all(b"the first ha")?;
            Err(io::ErrorKind::StorageFull.into())
        };
        let names = || std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>();
        let picture = folder.join("a.png");
        let error = write_whole(&picture, full).unwrap_err();
        assert_eq!((error.kind(), names().len()), (io::ErrorKind::StorageFull, 0));
        write_whole(&picture, |file| file.write_all(b"old")).unwrap();
        write_whole(&picture, full).unwrap_err();
        assert_eq!((std::fs::read(&picture).unwrap(), names().len()), (b"old".to_vec(), 1));
        #[cfg(unix)]
        {
            let link = folder.join("link.png");
            std::os::unix::fs::symlink("a.png", &link).unwrap();
            write_whole(&link, |file| file.write_all(b"new")).unwrap();
            assert!(link.is_symlink() && std::fs::read(&picture).unwrap() == b"new");
            write_whole(Path::new("/dev/null"), |file| file.write_all(b"nowhere")).unwrap();
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
