//! Outputs on a disk without room for them: what was there stays, nothing that is cut has a name, and one line says so.

use super::commands::Folder;
use crate::common::link;
use crate::private::inside;
use std::process::Command;

#[test]
fn what_has_no_room_has_no_name_either() {
    if !inside(concat!(module_path!(), "::what_has_no_room_has_no_name_either"), "-Urnm") {
        return;
    }
    let folder = Folder::new("full");
    folder.write("rx.dat", &link(2_000, 20.0).rx.concat());
    let small = folder.0.join("small");
    std::fs::create_dir(&small).unwrap();
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=32k", "none"]).arg(&small).status();
    if !mounted.is_ok_and(|status| status.success()) {
        crate::common::skipped("a tmpfs cannot be mounted here");
        return;
    }
    let is_empty = || std::fs::read_dir(&small).unwrap().next().is_none();
    for output in ["small/out.npz", "small/out.mat"] {
        let (status, _, err) = folder.run(&["export", "rx.dat", output]);
        assert_eq!(status, 1, "{output}: {err}");
        assert!(err.contains(output) && err.contains("No space left") && !err.contains(".part-"), "{output}: {err}");
        assert!(!err.contains("ZipWriter") && err.trim_end().lines().count() == 1, "{output}: {err}");
        assert!(is_empty(), "{output}");
    }
    let (status, _, err) = folder.run(&["info", "rx.dat", "--plot", "small"]);
    assert!(status != 0 && err.contains("No space left") && !err.contains(".part-"), "{status} {err}");
    for there in std::fs::read_dir(&small).unwrap() {
        // Of two pictures the first may have had room.
        let path = there.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(name.starts_with("rx-csi.") || name.starts_with("rx-levels."), "{name}");
        assert!(std::fs::metadata(&path).unwrap().len() > 0 && !err.contains(&name), "{name}: {err}");
    }
}
