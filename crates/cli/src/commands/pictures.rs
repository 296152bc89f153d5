//! Pictures that commands draw: a PNG and an SVG each.

use std::path::PathBuf;

/// Of files in both formats a name for each picture.
pub fn first_of_each(written: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let first = written.first().and_then(|path| path.extension());
    written.iter().filter(move |path| path.extension() == first)
}
