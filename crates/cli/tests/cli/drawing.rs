//! Pictures of every command that draws: in the formats asked for, and nothing overwritten unasked.

use super::commands::{Folder, capture};
use crate::common::link::{Link, START_S, link};
use std::process::{Command, Stdio};

fn is_pdf(folder: &Folder, name: &str) {
    let bytes = std::fs::read(folder.0.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(bytes.starts_with(b"%PDF-") && bytes.len() > 5_000, "{name}: {} bytes", bytes.len());
}

/// Names in a folder, sorted.
fn names(folder: &Folder, within: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder.0.join(within)).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn pictures_of_a_link_have_the_formats_asked_for_and_all_or_none_are_replaced() {
    let folder = Folder::new("drawing-link");
    folder.link(&link(300, 2.0));
    let (status, _, err) = folder.bearing(&["--plot", "p", "--format", "pdf"]);
    assert_eq!(status, 0, "{err}");
    assert_eq!(names(&folder, "p"), ["tx-phase.pdf", "tx-profile.pdf", "tx-trajectory.pdf"]);
    names(&folder, "p").iter().for_each(|name| is_pdf(&folder, &format!("p/{name}")));
    // The last one of them is there: none of the others is written.
    std::fs::remove_file(folder.0.join("p/tx-phase.pdf")).unwrap();
    let (status, _, err) = folder.bearing(&["--plot", "p", "--format", "pdf,svg"]);
    assert!(status == 1 && err.contains(".pdf is there already: --force overwrites it"), "{err}");
    assert_eq!(names(&folder, "p"), ["tx-profile.pdf", "tx-trajectory.pdf"]);
    assert_eq!(folder.bearing(&["--plot", "p", "--format", "pdf,svg", "--force"]).0, 0);
    assert_eq!(names(&folder, "p").len(), 6);
    for (args, words) in [
        (&["--format", "pdf"][..], "--plot names"),
        (&["--plot", "p", "--format", "gif"], "pdf"),
        (&["--plot", "p", "--dpi", "7"], "24 to 1200"),
    ] {
        let (status, out, err) = folder.bearing(args);
        assert!(status == 2 && out.is_empty() && err.contains(words), "{args:?}: {status} {err}");
    }
}

#[test]
fn pictures_of_an_evaluation_are_refused_before_it_begins_and_a_page_is_small() {
    let folder = Folder::new("drawing-tree");
    capture(&folder, "tree/A/good", &link(600, 2.0));
    let draw = |more: &[&str]| folder.run(&[&["evaluate", "tree", "--out", "p", "--format", "pdf,svg"], more].concat());
    let (status, out, err) = draw(&[]);
    assert!(status == 0 && out.contains("A/good/1/tx2"), "{err}");
    for name in ["errors", "refusals", "reliability", "map-A_good_1"] {
        is_pdf(&folder, &format!("p/{name}.pdf"));
        assert!(folder.0.join(format!("p/{name}.svg")).is_file(), "{name}");
    }
    let (status, out, err) = draw(&[]);
    assert!(status == 1 && out.is_empty() && err.contains("p/errors.pdf is there already: --force"), "{out}{err}");
    assert_eq!(draw(&["--force"]).0, 0);
    assert_eq!(folder.run(&["evaluate", "tree", "--format", "pdf"]).0, 2, "no folder");
    assert_eq!(draw(&["--ablation"]).0, 2, "what is not drawn is not asked for");
    let (status, _, err) = folder.run(&["explain", "tree", "--out", "link", "--format", "pdf"]);
    assert_eq!(status, 0, "{err}");
    assert!(names(&folder, "link").len() >= 4 && names(&folder, "link").iter().all(|name| name.ends_with(".pdf")));
    // A map alone is enough to be refused, before anything is said of the link.
    let maps: Vec<String> = names(&folder, "link").into_iter().filter(|name| name.contains("-azimuth-")).collect();
    assert_eq!(maps.len(), 2, "{maps:?}");
    for map in maps {
        let only = format!("only-{map}");
        std::fs::create_dir(folder.0.join(&only)).unwrap();
        folder.write(&format!("{only}/{map}"), b"mine");
        let (status, out, err) = folder.run(&["explain", "tree", "--out", &only, "--format", "pdf"]);
        assert!(status == 1 && out.is_empty() && err.contains("is there already: --force"), "{map}: {out}{err}");
    }
    let (_, out, err) = folder.run(&["locate", "tree", "--plot", "places", "--format", "pdf"]);
    assert!(out.starts_with("A/good/1: "), "{out}{err}");
    is_pdf(&folder, "places/map-A_good_1.pdf");
    // Of both commands, a map alone is enough, too.
    for draw in [["evaluate", "tree", "--out", "places"], ["locate", "tree", "--plot", "places"]] {
        let (status, out, err) = folder.run(&[&draw[..], &["--format", "pdf"]].concat());
        let named = err.contains("places/map-A_good_1.pdf is there already: --force");
        assert!(status == 1 && out.is_empty() && named, "{out}{err}");
    }
    assert_eq!(names(&folder, "places"), ["map-A_good_1.pdf"], "nothing else was drawn");

    // Distributions and maps come before the links, and a link takes 150 KB at most.
    let (status, _, err) = folder.run(&["report", "tree", "--out", "r.html"]);
    assert_eq!(status, 0, "{err}");
    let page = std::fs::read_to_string(folder.0.join("r.html")).unwrap();
    let (before, links) = page.split_once("<h2>Links</h2>").unwrap();
    assert!(before.matches("<svg").count() == 4 && links.matches("<svg").count() == 3, "{}", page.len());
    assert!((10_000..150_000).contains(&links.len()), "{} bytes of one link", links.len());
}

#[test]
fn pictures_of_the_experiments_are_refused_before_they_begin() {
    let folder = Folder::new("drawing-suite");
    let run = |csv: &str| {
        let args = ["suite", "--only", "circle 10", "--repetitions", "2", "--plot", "p", "--format", "pdf", "--csv"];
        folder.run(&[&args[..], &[csv]].concat())
    };
    let (status, _, err) = run("one.csv");
    assert_eq!(status, 0, "{err}");
    assert_eq!(names(&folder, "p"), ["circle_10_cm-phase.pdf", "circle_10_cm-profile.pdf"]);
    names(&folder, "p").iter().for_each(|name| is_pdf(&folder, &format!("p/{name}")));
    let (status, _, err) = run("two.csv");
    assert!(status == 1 && err.contains("circle_10_cm-phase.pdf is there already: --force"), "{err}");
    assert!(!folder.0.join("two.csv").exists(), "nothing was begun");
}

/// Bytes of the largest link of a page.
fn largest_link(page: &str) -> usize {
    let (_, links) = page.split_once("<h2>Links</h2>").unwrap();
    links.split("<details").skip(1).map(str::len).max().unwrap()
}

#[test]
fn a_link_of_any_length_is_small_on_a_page() {
    for pairs in [3_000, 6_000] {
        let folder = Folder::new(&format!("drawing-long-{pairs}"));
        capture(&folder, "tree/A/good", &scattered(pairs));
        let (status, _, err) = folder.run(&["report", "tree", "--out", "r.html"]);
        assert_eq!(status, 0, "{err}");
        let page = std::fs::read_to_string(folder.0.join("r.html")).unwrap();
        let largest = largest_link(&page);
        assert!(largest < 150_000 && page.contains(", one pair in "), "{pairs} pairs: {largest} bytes");
    }
}

/// A robot that drives 60 turns on a spiral: each of its places is another one, as is each of its phases.
#[test]
fn a_long_drive_is_small_on_a_page() {
    let folder = Folder::new("drawing-drive");
    let mut made = scattered(3_000);
    made.trajectory = (0..=45_000).fold(String::new(), |rows, row| {
        let share = f64::from(row) / 45_000.0;
        let (turn, radius_m) = (60.0 * std::f64::consts::TAU * share, 0.3 + share);
        let (x, y, t_s) = (radius_m * turn.cos(), radius_m * turn.sin(), START_S + 30.0 * share);
        rows + &format!("{t_s:.6},0,{x:.6},{y:.6},0.1,\n")
    });
    capture(&folder, "tree/A/good", &made);
    let (status, _, err) = folder.run(&["report", "tree", "--out", "r.html"]);
    assert_eq!(status, 0, "{err}");
    let page = std::fs::read_to_string(folder.0.join("r.html")).unwrap();
    let largest = largest_link(&page);
    assert!(largest < 150_000 && page.contains("trajectory and bearing"), "{largest} bytes");
}

/// A link whose phases are all over the place, as those of weak signals are: no two of its dots lie on each other.
fn scattered(pairs: u32) -> Link {
    let mut made = link(pairs, 2.0);
    for (k, record) in made.rx.iter_mut().enumerate() {
        // The payload of one byte in four is turned about.
        let noise = (k as u32).wrapping_mul(2_654_435_761).to_le_bytes();
        let from = record.len() - 120;
        record[from..].iter_mut().zip(noise.iter().cycle()).step_by(4).for_each(|(byte, noise)| *byte ^= noise & 0x3f);
    }
    made
}

#[test]
fn a_page_has_its_ending_and_says_why_a_link_has_no_bearing() {
    let folder = Folder::new("drawing-page");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    let (status, out, err) = folder.run(&["report", "tree", "--out", "x.pdf"]);
    assert!(status == 2 && out.is_empty() && err.contains("x.pdf: the page is HTML"), "{status} {err}");
    assert!(!folder.0.join("x.pdf").exists());
    assert_eq!(folder.run(&["report", "tree", "--out", "x.HTML", "--no-pictures"]).0, 0);
    // A capture whose channel nobody knows, beside one that names its own.
    capture(&folder, "tree/A/bad", &link(300, 2.0));
    std::fs::remove_file(folder.0.join("tree/A/bad/groundtruth_positions.json")).unwrap();
    for more in [&["--out", "r.html"][..], &["--out", "i.html", "--interactive"]] {
        let (_, _, err) = folder.run(&[&["report", "tree"], more].concat());
        assert!(
            err.contains("A/bad") && err.contains("the WiFi channel is not known") && err.contains("--channel"),
            "{err}"
        );
    }
}

#[test]
fn errors_are_drawn_beside_those_of_another_program_on_the_same_links() {
    let folder = Folder::new("drawing-beside");
    capture(&folder, "tree/nlos/P1", &link(300, 2.0));
    capture(&folder, "tree/NLOS_Set_A/P1", &link(300, 2.0));
    let rows = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg\nnlos/P1/1,tx2,gt,30.0,-6.5\n";
    folder.write("tree/links.csv", rows.as_bytes());
    let (status, out, err) = folder.run(&["evaluate", "tree", "--out", "p", "--format", "svg"]);
    assert_eq!(status, 0, "{err}");
    let drawn = std::fs::read_to_string(folder.0.join("p/errors.svg")).unwrap();
    assert!(drawn.contains("toolbox, the same links (median 6.50)"), "{drawn}");
    assert!(drawn.contains("toolbox on all links of NLOS_Set_A as published"), "{drawn}");
    // All together come last, whatever the sets are called, and of what is not known nothing is said.
    let line =
        |start: &str| out.lines().position(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start}: {out}"));
    assert!(line("nlos: 1 link, 0 failed") < line("all: 2 links, 0 failed"), "{out}");
    assert!(!out.contains("0 of 0 links") && !out.contains("median error -"), "{out}");
}

/// A side table that is none, or has a row without numbers: said before the work, and a loss, of every command that reads it.
#[test]
fn what_is_left_out_of_another_programs_answers_is_said_and_is_a_loss() {
    let folder = Folder::new("drawing-bad-table");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    // A link that fails is said all the same.
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let head = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg";
    let row = format!("{head}\nA/good/1,tx2,gt,30.0,x\n");
    let cases = [
        ("a,b\n1,2\n", "tree: links.csv has no column `capture`: it is left out"),
        (row.as_str(), "tree: links.csv: 1 row without numbers left out"),
    ];
    for (table, words) in cases {
        folder.write("tree/links.csv", table.as_bytes());
        let mut commands = vec![
            &["evaluate", "tree", "--out", "p", "--format", "svg", "--force"][..],
            &["report", "tree", "--out", "r.html", "--force"],
        ];
        if cfg!(feature = "view") {
            commands.push(&["report", "tree", "--out", "i.html", "--interactive", "--force"]);
        }
        for command in commands {
            let (status, _, err) = folder.run(command);
            assert!(status == 3 && err.lines().any(|line| line == words), "{command:?}: {status} {err}");
            assert!(err.contains("A/short/1/tx2: "), "{command:?}: {err}");
        }
        assert!(folder.0.join("p/errors.svg").is_file());
        std::fs::remove_dir_all(folder.0.join("p")).unwrap();
        assert!(std::fs::read_to_string(folder.0.join("r.html")).unwrap().contains(words));
    }
    // Without pictures nobody asked for it.
    let (_, _, err) = folder.run(&["evaluate", "tree"]);
    assert!(!err.contains("links.csv"), "{err}");
}

#[test]
fn pictures_that_cannot_be_drawn_are_said_and_are_a_loss_of_a_page() {
    let folder = Folder::new("drawing-nowhere");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    let no_folder = folder.write("file", b"");
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    command.current_dir(&folder.0).env("TMPDIR", no_folder).args(["report", "tree", "--out", "r.html"]);
    let output = command.stdin(Stdio::null()).output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{err}");
    // Of the link, and of all links together.
    assert!(err.lines().any(|line| line.starts_with("A/good/1/tx2: cannot make the folder ")), "{err}");
    assert!(err.lines().any(|line| line.starts_with("cannot write ")), "{err}");
    let page = std::fs::read_to_string(folder.0.join("r.html")).unwrap();
    assert!(page.contains("<p class=\"note\">cannot write ") && !page.contains("<svg"), "{page}");
    // An evaluation without its pictures has failed, and says which links failed all the same.
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let (status, out, err) = folder.run(&["evaluate", "tree", "--out", "file/p"]);
    assert!(status == 1 && out.contains("A/good/1/tx2") && err.contains("A/short/1/tx2: "), "{status} {err}");
}

#[test]
fn a_log_that_lost_records_is_drawn_and_ends_with_3_as_its_account_does() {
    let folder = Folder::new("drawing-damaged");
    let mut log = link(300, 1.0).rx.concat();
    log.drain(20_000..20_050);
    folder.write("torn.dat", &log);
    let (status, _, err) = folder.run(&["plot", "torn.dat", "--out", "p", "--format", "svg"]);
    assert!(status == 3 && err.contains("torn.dat: records were lost before its end"), "{status} {err}");
    assert_eq!(folder.run(&["info", "torn.dat"]).0, 3);
    let drawn = std::fs::read_to_string(folder.0.join("p/torn-levels.svg")).unwrap();
    assert!(drawn.contains("1 damaged stretch<") && drawn.contains("missing from bfee_count"), "{drawn}");
    folder.write("whole.dat", &link(300, 1.0).rx.concat());
    assert_eq!(folder.run(&["plot", "whole.dat", "--out", "p", "--format", "svg"]).0, 0);
}
