//! Pictures that commands draw: a PNG and an SVG each.

use csi5300_lab::show::{Error, Format};
use std::path::PathBuf;

/// Pictures of the same names are replaced if `force` is set.
pub fn format(force: bool) -> Format {
    Format::default().with_replace(force)
}

/// Refuses pictures that are there and may not be replaced: before the work, not after it.
///
/// # Errors
/// The first of them, in words.
pub fn check(stems: &[PathBuf], force: bool) -> Result<(), String> {
    format(force).check(stems).map_err(|error| refused(&error))
}

/// Why there is no picture, with the flag that helps.
pub fn refused(error: &Error) -> String {
    match error {
        Error::There { .. } => format!("{error}: --force overwrites it"),
        _ => error.to_string(),
    }
}

/// Of files in both formats a name for each picture.
pub fn first_of_each(written: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let first = written.first().and_then(|path| path.extension());
    written.iter().filter(move |path| path.extension() == first)
}
