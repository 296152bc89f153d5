//! Pictures that commands draw: a PNG and an SVG each.

use csi5300_lab::show::Format;
use std::path::PathBuf;

/// Replaces earlier pictures of the same names, but never a file that leads to an input.
pub fn format() -> Format {
    Format::default().with_kept(super::draft::read_files())
}

/// Of files in both formats a name for each picture.
pub fn first_of_each(written: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let first = written.first().and_then(|path| path.extension());
    written.iter().filter(move |path| path.extension() == first)
}
