//! In which formats pictures are written.
use super::Error;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// A format of picture files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// Pixels.
    Png,
    /// Vectors, for the web.
    Svg,
    /// Vectors with the letters' font inside, for papers.
    Pdf,
}

impl Kind {
    /// How names of such files end, without the dot.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Svg => "svg",
            Self::Pdf => "pdf",
        }
    }
}

/// How pictures are written: in which formats, how finely, and whether files of the same names are replaced.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Format {
    /// Each picture is a file of each of these.
    pub kinds: Vec<Kind>,
    /// Pixels to the inch of a PNG: 96 draws each pixel of the drawing once.
    pub dpi: f64,
    /// Whether files of the same names are replaced; where not, one of them is [`Error::There`].
    pub replace: bool,
    /// Files that are never replaced, by whatever name: [`Error::Kept`].
    pub kept: Vec<PathBuf>,
}

impl Default for Format {
    /// PNG and SVG, which replace what is there.
    fn default() -> Self {
        Self { kinds: vec![Kind::Png, Kind::Svg], dpi: 96.0, replace: true, kept: Vec::new() }
    }
}

impl Format {
    /// With these formats, in their order, each once; with those of the default where there is none.
    #[must_use]
    pub fn with_kinds(mut self, kinds: &[Kind]) -> Self {
        if !kinds.is_empty() {
            self.kinds = Vec::new();
            for kind in kinds {
                if !self.kinds.contains(kind) {
                    self.kinds.push(*kind);
                }
            }
        }
        self
    }

    /// With so many pixels to the inch of a PNG.
    #[must_use]
    pub fn with_dpi(mut self, dpi: f64) -> Self {
        self.dpi = dpi;
        self
    }

    /// Replacing files of the same names, or not.
    #[must_use]
    pub fn with_replace(mut self, replace: bool) -> Self {
        self.replace = replace;
        self
    }

    /// Never replacing these files, by whatever name.
    #[must_use]
    pub fn with_kept(mut self, kept: Vec<PathBuf>) -> Self {
        self.kept = kept;
        self
    }

    /// The files of a picture: `stem` with the ending of each format.
    #[must_use]
    pub fn files(&self, stem: &Path) -> Vec<PathBuf> {
        let file = |kind: &Kind| {
            let mut name = stem.as_os_str().to_owned();
            name.push(format!(".{}", kind.extension()));
            PathBuf::from(name)
        };
        self.kinds.iter().map(file).collect()
    }

    /// Refuses pictures of which a file is there already and may not be replaced: to be asked before long work, and before
    /// the first of several pictures.
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

/// True if both names lead to one file.
fn is_same(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        a.metadata().ok().zip(b.metadata().ok()).is_some_and(|(a, b)| (a.dev(), a.ino()) == (b.dev(), b.ino()))
    }
    #[cfg(not(unix))]
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

/// Writes a file that is whole or as it was: under a name of its own beside, and renamed at the end. A link stays one; devices
/// and pipes are written as they are.
///
/// # Errors
/// If it cannot be written; nothing is left of it then.
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
    fn a_picture_for_which_the_disk_has_no_room_leaves_what_was_there() {
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
