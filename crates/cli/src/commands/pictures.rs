//! In which formats pictures are drawn: what every command that draws has in common.

use super::usage;
use clap::ValueEnum;
use csi5300_lab::evaluate::Capture;
use csi5300_lab::show::{Error, Format, Kind};
use std::path::{Path, PathBuf};

// How pictures are drawn.
#[derive(clap::Args, Clone, Debug)]
pub struct Drawing {
    /// Formats of pictures; png,svg if not given
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FORMAT,..")]
    format: Vec<FileKind>,
    /// Pixels to the inch of a PNG: 192 gives twice as many each way
    #[arg(long, default_value_t = 96.0, value_parser = dpi, value_name = "DPI")]
    dpi: f64,
}

// The same for commands that write nothing but pictures.
#[derive(clap::Args, Clone, Debug)]
pub struct Pictures {
    #[command(flatten)]
    drawing: Drawing,
    /// Overwrite pictures of the same names
    #[arg(long)]
    force: bool,
}

impl Pictures {
    /// [`Drawing::format`] with the choice of `--force`.
    pub fn format(&self) -> Format {
        self.drawing.format(self.force)
    }

    /// Refuses pictures that are there and may not be replaced: before the work, not after it.
    ///
    /// # Errors
    /// In words, which one is there.
    pub fn check(&self, stems: &[PathBuf]) -> Result<(), String> {
        self.format().check(stems).map_err(|error| refused(&error))
    }

    /// The same for the maps of captures.
    ///
    /// # Errors
    /// As of [`Pictures::check`].
    pub fn check_maps(&self, folder: &Path, captures: &[Capture]) -> Result<(), String> {
        let stem = |capture: &Capture| csi5300_lab::show::set::map_stem(folder, &capture.link_name(""));
        self.check(&captures.iter().map(stem).collect::<Vec<_>>())
    }

    /// [`Drawing::must_have`].
    pub fn must_have(&self, folder: Option<&Path>, option: &str) {
        self.drawing.must_have(folder, option);
    }
}

/// A format of picture files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FileKind {
    /// Pixels
    Png,
    /// Vectors, for the web
    Svg,
    /// Vectors with the font inside, for papers
    Pdf,
}

impl From<FileKind> for Kind {
    fn from(kind: FileKind) -> Self {
        match kind {
            FileKind::Png => Self::Png,
            FileKind::Svg => Self::Svg,
            FileKind::Pdf => Self::Pdf,
        }
    }
}

fn dpi(text: &str) -> Result<f64, String> {
    let good = text.parse::<f64>().ok().filter(|dpi| (24.0..=1_200.0).contains(dpi));
    good.ok_or_else(|| "24 to 1200".into())
}

impl Drawing {
    /// For the room of pictures; files of the same names are replaced if `force` is set.
    pub fn format(&self, force: bool) -> Format {
        let kinds: Vec<Kind> = self.format.iter().map(|kind| Kind::from(*kind)).collect();
        Format::default()
            .with_kinds(&kinds)
            .with_dpi(self.dpi)
            .with_replace(force)
            .with_kept(super::draft::read_files())
    }

    /// Ends the program where formats are asked for and no folder is named, which `option` does.
    pub fn must_have(&self, folder: Option<&Path>, option: &str) {
        if folder.is_none() && !self.format.is_empty() {
            usage(&format!("--format is of pictures, whose folder {option} names"));
        }
    }
}

/// Why there is no picture, with the flag that helps.
pub fn refused(error: &Error) -> String {
    match error {
        Error::There { .. } => format!("{error}: --force overwrites it"),
        _ => error.to_string(),
    }
}

/// Of files in several formats a name for each picture: that of the first format.
pub fn first_of_each(written: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let first = written.first().and_then(|path| path.extension());
    written.iter().filter(move |path| path.extension() == first)
}
