//! In which formats pictures are written.
use super::Error;
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
}

impl Default for Format {
    /// PNG and SVG, which replace what is there.
    fn default() -> Self {
        Self { kinds: vec![Kind::Png, Kind::Svg], dpi: 96.0, replace: true }
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
    /// [`Error::There`].
    pub fn check(&self, stems: &[PathBuf]) -> Result<(), Error> {
        let there = || stems.iter().flat_map(|stem| self.files(stem)).find(|file| file.is_file());
        match there().filter(|_| !self.replace) {
            Some(path) => Err(Error::There { path }),
            None => Ok(()),
        }
    }
}
