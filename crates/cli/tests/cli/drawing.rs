//! Pictures of every command that draws: in the formats asked for, and nothing overwritten unasked.

use super::commands::{Folder, capture};
use crate::common::link::link;

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
    let (_, out, err) = folder.run(&["locate", "tree", "--plot", "places", "--format", "pdf"]);
    assert!(out.starts_with("A/good/1: "), "{out}{err}");
    is_pdf(&folder, "places/map-A_good_1.pdf");

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
