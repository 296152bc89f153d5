//! Pictures of every command that draws: PNG and SVG, replaced by the next run; and the page as one file.

use super::commands::{Folder, capture};
use crate::common::link;

/// Names in a folder, sorted.
fn names(folder: &Folder, within: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder.0.join(within)).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn pictures_of_a_link_are_replaced_by_the_next_run() {
    let folder = Folder::new("drawing-link");
    folder.link(&link(300, 2.0));
    let (status, _, err) = folder.bearing(&["--plot", "p"]);
    assert_eq!(status, 0, "{err}");
    let all = names(&folder, "p");
    for what in ["phase", "profile", "trajectory"] {
        assert!(["png", "svg"].iter().all(|kind| all.contains(&format!("tx-{what}.{kind}"))), "{all:?}");
    }
    let first = std::fs::read(folder.0.join("p/tx-phase.svg")).unwrap();
    folder.write("p/tx-phase.svg", b"old");
    let (status, _, err) = folder.bearing(&["--plot", "p"]);
    assert_eq!(status, 0, "{err}");
    assert_eq!((names(&folder, "p"), std::fs::read(folder.0.join("p/tx-phase.svg")).unwrap()), (all, first));
}

#[test]
fn pictures_and_maps_of_captures_are_replaced_by_the_next_run() {
    let folder = Folder::new("drawing-tree");
    capture(&folder, "tree/A/good", &link(600, 2.0));
    for _ in 0..2 {
        let (status, out, err) = folder.run(&["evaluate", "tree", "--plot", "p"]);
        assert!(status == 0 && out.contains("A/good/1/tx2"), "{err}");
        for name in ["errors", "refusals", "reliability", "map-A_good_1"] {
            let picture = folder.0.join(format!("p/{name}.svg"));
            assert!(std::fs::read(&picture).unwrap().len() > 100, "{name}");
            std::fs::write(picture, "old").unwrap();
        }
        let (status, _, err) = folder.run(&["bearing", "tree", "--plot", "link"]);
        assert_eq!(status, 0, "{err}");
        let maps: Vec<String> = names(&folder, "link").into_iter().filter(|name| name.starts_with("map-")).collect();
        assert_eq!(maps.len(), 2, "{maps:?}");
        for map in maps {
            assert!(std::fs::read(folder.0.join("link").join(&map)).unwrap().len() > 100, "{map}");
            folder.write(&format!("link/{map}"), b"old");
        }
    }
}

#[test]
fn a_page_has_its_ending_and_says_why_a_link_has_no_bearing() {
    let folder = Folder::new("drawing-page");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    let (status, out, err) = folder.run(&["evaluate", "tree", "--html", "x.pdf"]);
    assert!(status == 2 && out.is_empty() && err.contains("x.pdf: the page is HTML"), "{status} {err}");
    assert!(!folder.0.join("x.pdf").exists());
    assert_eq!(folder.run(&["evaluate", "tree", "--html", "x.HTML"]).0, 0);
    let (status, _, err) = folder.run(&["evaluate", "tree", "--html", "x.HTML"]);
    assert!(status == 1 && err.contains("--force"), "{err}");
    assert_eq!(folder.run(&["evaluate", "tree", "tree/A", "--html", "y.html"]).0, 2, "a page is of one folder");
    // A capture whose channel nobody knows, beside one that names its own.
    capture(&folder, "tree/A/bad", &link(300, 2.0));
    std::fs::remove_file(folder.0.join("tree/A/bad/groundtruth_positions.json")).unwrap();
    let (_, _, err) = folder.run(&["evaluate", "tree", "--html", "i.html"]);
    assert!(err.contains("A/bad") && err.contains("unknown WiFi channel") && err.contains("--channel"), "{err}");
}

#[test]
fn errors_are_drawn_beside_those_of_another_program_on_the_same_links() {
    let folder = Folder::new("drawing-beside");
    capture(&folder, "tree/nlos/P1", &link(300, 2.0));
    capture(&folder, "tree/NLOS_Set_A/P1", &link(300, 2.0));
    let rows = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg\nnlos/P1/1,tx2,gt,30.0,-6.5\n";
    folder.write("tree/links.csv", rows.as_bytes());
    let (status, out, err) = folder.run(&["evaluate", "tree", "--plot", "p"]);
    assert_eq!(status, 0, "{err}");
    let drawn = std::fs::read_to_string(folder.0.join("p/errors.svg")).unwrap();
    assert!(drawn.contains("toolbox, the same links (median 6.50)"), "{drawn}");
    assert!(drawn.contains("toolbox on all links of NLOS_Set_A as published"), "{drawn}");
    // `all` comes last whatever the sets are called, and unknown figures are not printed.
    let line =
        |start: &str| out.lines().position(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start}: {out}"));
    assert!(line("nlos: 1 link, 0 failed") < line("all: 2 links, 0 failed"), "{out}");
    assert!(!out.contains("0 of 0 links") && !out.contains("median error -"), "{out}");
}

/// Every command that reads a side table reports a wrong one, and rows without numbers, before the work, and counts them as a loss.
#[test]
fn what_is_left_out_of_another_programs_answers_is_said_and_is_a_loss() {
    let folder = Folder::new("drawing-bad-table");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    // A failed link is reported too.
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let head = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg";
    let row = format!("{head}\nA/good/1,tx2,gt,30.0,x\n");
    let cases = [
        ("a,b\n1,2\n", "tree: links.csv has no column `capture`: it is skipped"),
        (row.as_str(), "tree: links.csv: 1 row without numbers skipped"),
    ];
    for (table, words) in cases {
        folder.write("tree/links.csv", table.as_bytes());
        let mut commands = vec![&["evaluate", "tree", "--plot", "p"][..]];
        commands.push(&["evaluate", "tree", "--html", "i.html", "--force"]);
        for command in commands {
            let (status, _, err) = folder.run(command);
            assert!(status == 3 && err.lines().any(|line| line == words), "{command:?}: {status} {err}");
            assert!(err.contains("A/short/1/tx2: "), "{command:?}: {err}");
        }
        assert!(folder.0.join("p/errors.svg").is_file());
        std::fs::remove_dir_all(folder.0.join("p")).unwrap();
    }
    // Without pictures nobody asked for it.
    let (_, _, err) = folder.run(&["evaluate", "tree"]);
    assert!(!err.contains("links.csv"), "{err}");
}

#[test]
fn pictures_that_cannot_be_drawn_are_said_and_links_are_judged_all_the_same() {
    let folder = Folder::new("drawing-nowhere");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    folder.write("file", b"");
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let (status, out, err) = folder.run(&["evaluate", "tree", "--plot", "file/p"]);
    assert!(status == 1 && out.contains("A/good/1/tx2") && err.contains("A/short/1/tx2: "), "{status} {err}");
}

#[test]
fn a_log_that_lost_records_is_drawn_and_ends_with_3_as_its_account_does() {
    let folder = Folder::new("drawing-damaged");
    let mut log = link(300, 1.0).rx.concat();
    log.drain(20_000..20_050);
    folder.write("torn.dat", &log);
    assert_eq!(folder.run(&["info", "torn.dat", "--plot", "p"]).0, 3);
    let drawn = std::fs::read_to_string(folder.0.join("p/torn-levels.svg")).unwrap();
    assert!(drawn.contains("1 damaged stretch<") && drawn.contains("missing from bfee_count"), "{drawn}");
    folder.write("whole.dat", &link(300, 1.0).rx.concat());
    assert_eq!(folder.run(&["info", "whole.dat", "--plot", "p"]).0, 0);
}
