//! Arrows only point down: reads the `crate::` paths of every source file and fails on one that points up.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::path::{Path, PathBuf};

/// Floor of each top-level module; see ARCHITECTURE.md.
const FLOORS: &[(u8, &[&str])] = &[
    (
        1,
        &[
            "alignment",
            "bartlett",
            "cfo",
            "channel",
            "confidence",
            "csi",
            "locate",
            "near_field",
            "one_way",
            "pose",
            "samples",
            "time",
        ],
    ),
    (2, &["assign", "pairing", "tdma"]),
    (3, &["backend", "odometry", "ros1"]),
    (
        4,
        &[
            "answer", "compare", "doctor", "evaluate", "figures", "gallery", "node", "pipeline", "plot", "quality",
            "rooms", "sounding", "status", "suite", "survey", "viewers", "wait",
        ],
    ),
];

fn floor(module: &str) -> u8 {
    let known = FLOORS.iter().find(|(_, modules)| modules.contains(&module));
    known.unwrap_or_else(|| panic!("module `{module}` has no floor: add it to tests/floors.rs and ARCHITECTURE.md")).0
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn no_arrow_points_up() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut arrows = 0;
    for file in files {
        let below = file.strip_prefix(&root).unwrap();
        let own = below.iter().next().unwrap().to_string_lossy().replace(".rs", "");
        if ["lib", "main", "cli"].contains(&own.as_str()) {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap();
        for path in
            code.lines().filter(|line| !line.trim_start().starts_with("//")).flat_map(|l| l.split("crate::").skip(1))
        {
            let target: String = path.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if target.is_empty() || target == own {
                continue;
            }
            // The one known exception: the simulated room runs the real scheduler, so that there is no second one.
            let room = own == "backend" && below.starts_with("backend/sim") && target == "tdma";
            let (from, to) = (floor(&own), floor(&target));
            let across = (from, to) == (3, 2) && !room;
            assert!(to <= from && !across, "{}: F{from} `{own}` uses F{to} `{target}`", below.display());
            arrows += 1;
        }
    }
    assert!(arrows > 10, "only {arrows} arrows found: does the test still read the sources?");
}
