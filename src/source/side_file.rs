//! The side file of a log on disk: the host's receive times of its records. Its bytes: [`driver_iface::side_file`].

use driver_iface::side_file::{Width, parse};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// The path of a log's side file: the log's with `stp` behind it, so `a.datstp` of `a.dat`.
#[must_use]
pub fn side_path(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push("stp");
    name.into()
}

/// Reads a side file along with its log.
#[derive(Debug)]
pub(super) struct SideFile {
    /// The bytes by which the width was seen, then the rest.
    reader: std::io::Chain<std::io::Cursor<Vec<u8>>, BufReader<File>>,
    width: Width,
}

impl SideFile {
    /// The side file of a log, if it has one.
    pub(super) fn of(log: &Path) -> Option<Self> {
        let path = side_path(log);
        // A pipe of that name would be waited for.
        std::fs::metadata(&path).ok().filter(std::fs::Metadata::is_file)?;
        let mut rest = BufReader::new(File::open(path).ok()?);
        let mut head = Vec::new();
        rest.by_ref().take(Width::Wide.bytes() as u64).read_to_end(&mut head).ok()?;
        let width = Width::of(&head);
        Some(Self { reader: std::io::Cursor::new(head).chain(rest), width })
    }

    /// The next record's receive time, microseconds since the Unix epoch; `None` where it is not known.
    pub(super) fn next_us(&mut self) -> Option<i64> {
        let mut entry = [0; Width::Wide.bytes()];
        let entry = entry.get_mut(..self.width.bytes())?;
        self.reader.read_exact(entry).ok()?;
        parse(entry, self.width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_log_with_stp() {
        assert_eq!(side_path(Path::new("out.dat")), Path::new("out.datstp"));
    }
}
