//! Outputs that are whole or as they were: written under a name of their own beside, and renamed at the end.

use std::io;
use std::path::{Path, PathBuf};

/// A file on its way. What was there under its name stays until [`Draft::keep`], and for good where that is not reached.
pub struct Draft {
    path: PathBuf,
    /// Where it is written; `None` for devices and pipes, which are written as they are.
    part: Option<PathBuf>,
}

impl Draft {
    /// For the output `path`.
    pub fn new(path: &Path) -> Self {
        // A link stays a link.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let extension = path.extension().map_or(String::new(), |extension| format!(".{}", extension.to_string_lossy()));
        let is_special = path.metadata().is_ok_and(|found| !found.is_file());
        let part = path.with_file_name(format!("{stem}.part-{}{extension}", std::process::id()));
        Self { path, part: (!is_special).then_some(part) }
    }

    /// Where to write it, with the output's extension.
    pub fn path(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.path)
    }

    /// It is whole: gives it its name.
    pub fn keep(mut self) -> io::Result<()> {
        match self.part.take() {
            Some(part) => std::fs::rename(&part, &self.path).inspect_err(|_| drop(std::fs::remove_file(&part))),
            None => Ok(()),
        }
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Some(part) = &self.part {
            // Not there where nothing was written.
            let _ = std::fs::remove_file(part);
        }
    }
}
