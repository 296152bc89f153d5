//! Files to which a served room appends poses: none of another kind is touched, and one that fails stops no room.

use super::Words;
use crate::commands::is_same_file;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// A row of poses is shorter, bytes.
const ROW: u64 = 512;

/// Where a robot's poses go.
pub struct PosesFile {
    name: String,
    out: Box<dyn Write>,
    /// Poses that are not there, since the first that could not be written.
    unwritten: u64,
}

impl PosesFile {
    /// Opens a file to append to; `-` is standard output. `others` are of other use here: what the scene was read from, the
    /// room's socket, poses of other robots.
    pub fn open(path: &Path, others: &[(PathBuf, &str)]) -> Words<Self> {
        if path.as_os_str() == "-" {
            return Ok(Self::over("standard output".into(), Box::new(io::stdout())));
        }
        let name = path.display().to_string();
        if let Some((_, what)) = others.iter().find(|(other, _)| is_same_place(path, other)) {
            return Err(format!("{name} is {what}: --poses needs a file of its own"));
        }
        let failed = |error: io::Error| format!("cannot append poses to {name}: {error}");
        if !may_grow(path).map_err(failed)? {
            return Err(format!(
                "{name} exists and holds something other than whole rows of poses that a room wrote: --poses needs a file \
                 of its own"
            ));
        }
        let file: File = OpenOptions::new().create(true).append(true).open(path).map_err(failed)?;
        Ok(Self::over(name, Box::new(file)))
    }

    fn over(name: String, out: Box<dyn Write>) -> Self {
        Self { name, out, unwritten: 0 }
    }

    /// Appends a pose, in the columns of motion capture with a heading. After a failure, reported once, poses are only
    /// counted: a row after half a row would be read with it.
    pub fn write(&mut self, pose: &Pose) {
        let done = match self.unwritten {
            0 => self.out.write_all(csv::line(pose).as_bytes()).and_then(|()| self.out.flush()),
            _ => {
                self.unwritten += 1;
                return;
            }
        };
        if let Err(error) = done {
            self.unwritten = 1;
            wrong!("cannot write poses to {}: {error}. The room continues without writing more of them", self.name);
        }
    }

    /// Poses that were not written, and where.
    pub fn unwritten(&self) -> (u64, &str) {
        (self.unwritten, &self.name)
    }
}

/// True if two paths are of one file, or will be: links are followed. Devices and pipes are anybody's.
fn is_same_place(path: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    match std::fs::metadata(path) {
        Ok(there) if there.file_type().is_char_device() || there.file_type().is_fifo() => false,
        Ok(_) if is_same_file(other, path) => true,
        _ => place(path).is_some_and(|here| place(other) == Some(here)),
    }
}

/// True if a file is new or empty, no plain file at all, or begins and ends with rows of poses as a room writes them.
fn may_grow(path: &Path) -> io::Result<bool> {
    let len = match std::fs::metadata(path) {
        Ok(there) if there.is_file() => there.len(),
        _ => return Ok(true),
    };
    if len == 0 {
        return Ok(true);
    }
    let mut file = File::open(path)?;
    let (mut begins, mut ends) = (Vec::new(), Vec::new());
    (&file).take(ROW).read_to_end(&mut begins)?;
    file.seek(SeekFrom::Start(len.saturating_sub(ROW)))?;
    file.read_to_end(&mut ends)?;
    let first = begins.split_inclusive(|&byte| byte == b'\n').next();
    let last = ends.split_inclusive(|&byte| byte == b'\n').next_back();
    Ok([first, last].into_iter().flatten().all(is_row))
}

/// True for a row that a room would write in the same way.
fn is_row(row: &[u8]) -> bool {
    csv::parse_line(row).is_ok_and(|pose| pose.heading_rad.is_some() && csv::line(&pose).as_bytes() == row)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn pose(k: u32) -> Pose {
        let position_m = Vector3::new(0.1 * f64::from(k), -0.3, 1e-7);
        Pose { t_s: 1_700_000_000.123_456 + f64::from(k), position_m, heading_rad: Some(-0.5) }
    }

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("csi5300-poses-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn poses_are_appended_to_those_of_a_room_before() {
        let folder = folder("append");
        let path = folder.join("poses.csv");
        for run in 0..3 {
            let mut poses = PosesFile::open(&path, &[]).unwrap();
            (0..20).for_each(|k| poses.write(&pose(100 * run + k)));
            assert_eq!(poses.unwritten().0, 0);
        }
        assert_eq!(csv::read(&path).unwrap().1.rows, 60);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn files_of_another_kind_are_refused_and_stay_as_they_are() {
        let folder = folder("refuse");
        let row = csv::line(&pose(1));
        let others: [&[u8]; 6] = [
            b"duration_s = 3.0\n",
            b"10.0,0,1,2,3,\n",
            b"10.0,0,1,2,3,0.5,\n",
            &row.as_bytes()[..20],
            &[row.as_bytes(), b"and more"].concat(),
            &[&[0xff; 600], row.as_bytes()].concat(),
        ];
        for other in others {
            let path = folder.join("other");
            std::fs::write(&path, other).unwrap();
            let said = PosesFile::open(&path, &[]).err().unwrap();
            assert!(said.contains("holds something other than whole rows"), "{said}");
            assert_eq!(std::fs::read(&path).unwrap(), other);
        }
        assert!(PosesFile::open(&folder, &[]).is_err(), "a folder");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_the_room_reads_or_is_reached_by_is_refused_under_any_name() {
        let folder = folder("own");
        let [scene, link, socket] = ["scene.toml", "link", "room"].map(|name| folder.join(name));
        std::fs::write(&scene, csv::line(&pose(1))).unwrap();
        std::os::unix::fs::symlink(&scene, &link).unwrap();
        let others = [(scene.clone(), "the scene"), (socket, "the room's socket")];
        for (path, what) in
            [(&scene, "is the scene"), (&link, "is the scene"), (&folder.join("./room"), "the room's socket")]
        {
            let said = PosesFile::open(path, &others).err().unwrap();
            assert!(said.contains(what), "{said}");
        }
        assert!(!folder.join("room").exists());
        let null = Path::new("/dev/null");
        assert!(PosesFile::open(null, &[(null.into(), "the poses of another robot")]).is_ok());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_a_full_disk_does_not_take_is_counted() {
        let mut poses = PosesFile::open(Path::new("/dev/full"), &[]).unwrap();
        (0..7).for_each(|k| poses.write(&pose(k)));
        assert_eq!(poses.unwritten(), (7, "/dev/full"));
    }
}
