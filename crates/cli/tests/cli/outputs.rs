//! An output is never an input: every command, with every output option set to every input, by name and by links.

use super::commands::Folder;
use crate::common::link;
use std::path::{Path, PathBuf};

/// A run: its inputs, and its arguments, in which OUT is the output.
type Run = (&'static [&'static str], &'static [&'static str]);

const BEARING: &[&str] = &["rx.dat", "tx.dat", "t.csv"];
const CAPTURE: &[&str] = &["set/csi_rx_1.dat", "set/csi_tx1_1.dat", "set/rx_trajectory_1_.csv"];

/// Each option of a command that names an output. `the_list_is_whole` in the program's own tests knows them too.
const RUNS: &[Run] = &[
    (
        BEARING,
        &[
            "bearing",
            "--rx",
            "rx.dat",
            "--tx",
            "tx.dat",
            "--trajectory",
            "t.csv",
            "--channel",
            "108",
            "--profile",
            "OUT",
        ],
    ),
    (
        BEARING,
        &["bearing", "--rx", "rx.dat", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108", "--plot", "OUT"],
    ),
    (BEARING, &["mcap", "rx.dat", "tx.dat", "--trajectory", "t.csv", "--channel", "108", "--out", "OUT"]),
    (
        BEARING,
        &["simulate", "--rx", "rx.dat", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108", "--out", "OUT"],
    ),
    (&["rx.dat", "rx.datstp"], &["export", "--dat", "rx.dat", "OUT"]),
    (&["rx.dat"], &["export", "rx.dat", "OUT"]),
    (&["rx.dat"], &["info", "rx.dat", "--plot", "OUT"]),
    (CAPTURE, &["evaluate", "set", "--channel", "108", "--html", "OUT"]),
    (CAPTURE, &["evaluate", "set", "--plot", "OUT"]),
    (CAPTURE, &["bearing", "set", "--channel", "108", "--plot", "OUT"]),
    (CAPTURE, &["bearing", "set/tx1", "--channel", "108", "--out", "OUT"]),
    (&["drive.toml", "t.csv"], &["simulate", "drive.toml", "--out", "OUT"]),
    (&["recording.mcap"], &["unbag", "recording.mcap", "--out", "OUT"]),
    (
        &["group.key"],
        &[
            "sound",
            "--answer",
            "--interface",
            "none0",
            "--peers",
            "00:21:6a:53:89:d2",
            "--key",
            "group.key",
            "--log",
            "OUT",
        ],
    ),
    (
        &["group.key", "t.csv"],
        &[
            "sound",
            "--interface",
            "none0",
            "--peers",
            "00:21:6a:53:89:d2",
            "--key",
            "group.key",
            "--trajectory",
            "t.csv",
            "--channel",
            "108",
            "--log",
            "OUT",
        ],
    ),
];

const DRIVE: &str = "channel = 108\nduration_s = 0.2\nsounding.rate_hz = 50\n[[robot]]\nname = \"rx\"\nposition_m = [0.0, 0.0, 0.0]\n\
                     motion.recorded = { file = \"t.csv\" }\n[[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.0]\n";

fn inputs(name: &str) -> Folder {
    let folder = Folder::new(name);
    let made = link(300, 1.0);
    folder.link(&made);
    folder.write("rx.datstp", &[0; 8 * 300]);
    std::fs::create_dir(folder.0.join("set")).unwrap();
    folder.write("set/csi_rx_1.dat", &made.rx.concat());
    folder.write("set/csi_tx1_1.dat", &made.tx.concat());
    folder.write("set/rx_trajectory_1_.csv", made.trajectory.as_bytes());
    folder.write("drive.toml", DRIVE.as_bytes());
    folder.write("recording.mcap", b"\x89MCAP0\r\n");
    folder.write("group.key", b"0");
    folder
}

/// All files below, with what is in them.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<_> = entries
        .flat_map(
            |path| if path.is_dir() { contents(&path) } else { vec![(path.clone(), std::fs::read(&path).unwrap())] },
        )
        .collect();
    all.sort();
    all
}

#[test]
fn no_output_is_an_input() {
    let folder = inputs("outputs");
    // Names with the endings that commands ask of their outputs.
    let endings = ["csv", "npz", "mcap", "html", "dat"];
    let mut refused = 0;
    for (read, args) in RUNS {
        for input in *read {
            for (k, ending) in endings.iter().enumerate() {
                let link = folder.0.join(format!("link.{ending}"));
                let outputs = [(*input).to_owned(), format!("./{input}"), format!("link.{ending}")];
                match k % 2 {
                    0 => std::os::unix::fs::symlink(folder.0.join(input), &link).unwrap(),
                    _ => std::fs::hard_link(folder.0.join(input), &link).unwrap(),
                }
                let before = contents(&folder.0);
                for output in outputs {
                    let mut args: Vec<&str> =
                        args.iter().map(|arg| if *arg == "OUT" { output.as_str() } else { *arg }).collect();
                    // `info` and `evaluate --plot` replace pictures unasked.
                    let is_pictures = args[0] == "info" || args.starts_with(&["evaluate", "set", "--plot"]);
                    if !is_pictures && (args[0] != "unbag" || output.contains("recording")) {
                        args.push("--force");
                    }
                    let (status, _, err) = folder.run(&args);
                    assert!(status != 0, "{args:?}");
                    assert!(contents(&folder.0) == before, "{args:?} changed what is there: {err}");
                    refused += u32::from(err.contains("input"));
                }
                std::fs::remove_file(link).unwrap();
            }
        }
    }
    assert!(refused > 200, "{refused}: the rest was refused for another reason");
}

#[test]
fn what_a_folder_gets_is_no_input_either() {
    let folder = inputs("folders");
    // The dataset's trajectory would have the name of the one that is driven along.
    let (status, ..) = folder.run(&["simulate", "drive.toml", "--out", "first"]);
    assert_eq!(status, 0);
    let made = contents(&folder.0.join("first"));
    let (own, _) = made.iter().find(|(path, _)| path.to_string_lossy().contains("rx_trajectory_")).unwrap();
    let own = own.strip_prefix(&folder.0).unwrap().to_string_lossy().into_owned();
    folder.write("again.toml", DRIVE.replace("t.csv", &own).as_bytes());
    let (status, _, err) = folder.run(&["simulate", "again.toml", "--out", "first", "--force"]);
    assert!(status == 1 && err.contains("is an input"), "{status}: {err}");
    assert!(contents(&folder.0.join("first")) == made, "{err}");
    a_picture_that_leads_to_the_log_is_refused(&folder);
    // A page beside the captures is no input.
    for _ in 0..2 {
        let (status, _, err) =
            folder.run(&["evaluate", "set", "--channel", "108", "--html", "set/page.html", "--force"]);
        assert!(status == 0 || status == 3, "{status}: {err}");
    }
}

fn a_picture_that_leads_to_the_log_is_refused(folder: &Folder) {
    std::fs::create_dir(folder.0.join("pictures")).unwrap();
    std::os::unix::fs::symlink("../rx.dat", folder.0.join("pictures/rx-csi.png")).unwrap();
    let log = std::fs::read(folder.0.join("rx.dat")).unwrap();
    let (status, _, err) = folder.run(&["info", "rx.dat", "--plot", "pictures"]);
    assert!(status != 0 && err.contains("leads to an input file"), "{status}: {err}");
    assert_eq!(std::fs::read(folder.0.join("rx.dat")).unwrap(), log);
}
