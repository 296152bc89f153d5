//! `csi5300 report`: one page with everything about a capture or a tree of them.

use super::captures::Reading;
use super::{Outcome, Result, usage};
use csi5300_lab::show::report::HtmlReport;
use std::path::PathBuf;

// Arguments of `report`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder with captures below it, as in the WSR data set
    folder: PathBuf,
    /// The page
    #[arg(long, short, value_name = "OUT.html", default_value = "report.html")]
    out: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Overwrite the page if it is there
    #[arg(long)]
    force: bool,
    /// Leave the pictures out
    #[arg(long)]
    no_pictures: bool,
    /// The page of `csi5300 view` as one file: every link with its map, profile and logs, to be zoomed and sorted
    #[cfg(feature = "view")]
    #[arg(long, conflicts_with = "no_pictures")]
    interactive: bool,
}

/// Writes the page.
pub fn run(args: &Args) -> Result {
    let options = args.reading.options().unwrap_or_else(|message| usage(&message));
    let options = options.with_keep_course(!args.no_pictures);
    let is_html = |ending: &std::ffi::OsStr| ["html", "htm"].iter().any(|own| ending.eq_ignore_ascii_case(own));
    let is_page = args.out.extension().is_none_or(is_html);
    // Devices take anything.
    if !is_page && (args.out.is_file() || !args.out.exists()) {
        usage(&format!("{}: the page is HTML: .html", args.out.display()));
    }
    // Before the work; written at its end.
    drop(super::draft::Draft::create(&args.out, args.force)?);
    #[cfg(feature = "view")]
    if args.interactive {
        return interactive(args);
    }
    let (captures, unreadable) = args.reading.find(&args.folder)?;
    let pictures_in = std::env::temp_dir().join(format!("csi5300-report-{}", std::process::id()));
    let mut report = if args.no_pictures { HtmlReport::new() } else { HtmlReport::with_pictures(pictures_in.clone()) };
    report.beside(&args.folder, args.reading.source());
    unreadable.iter().for_each(|folder| report.note(format!("cannot read {folder}")));
    for (k, capture) in captures.iter().enumerate() {
        super::progress(&format!("{} of {} captures", k + 1, captures.len()));
        report.add(capture, args.reading.source(), args.reading.channel, &options);
    }
    super::progress("");
    let page = report.html(&args.folder.display().to_string());
    let _ = std::fs::remove_dir_all(&pictures_in);
    super::draft::write(&args.out, &page)?;
    report.notes().iter().for_each(|line| note!("{line}"));
    for answer in report.rows().map(|row| &row.answer) {
        if let Some(error) = &answer.error {
            wrong!("{}: {error}", answer.link);
        }
    }
    let links = super::some(report.rows().len() as u64, "link", "links");
    note!("{}: {links}, {} KiB", args.out.display(), page.len() / 1024);
    Ok(match report.rows().any(|row| row.answer.azimuth_deg.is_some()) {
        false => Outcome::Nothing,
        true if report.lost() => Outcome::DataLost,
        true => Outcome::Done,
    })
}

/// Writes the page of `view` as one file.
#[cfg(feature = "view")]
fn interactive(args: &Args) -> Result {
    args.reading.find(&args.folder)?;
    let reading = super::view::reading(&args.reading);
    let view = csi5300_view::View::open(&args.folder, reading).map_err(|error| error.to_string())?;
    view.finish(|done| super::progress(&format!("{done} of {} links", view.links())));
    super::progress("");
    let page = view.file().map_err(|error| error.to_string())?;
    super::draft::write(&args.out, &page)?;
    view.notes().iter().for_each(|line| note!("{line}"));
    view.failed().iter().for_each(|line| wrong!("{line}"));
    let links = super::some(view.links() as u64, "link", "links");
    note!("{}: {links}, {} KiB", args.out.display(), page.len() / 1024);
    Ok(match view.outcome() {
        (false, _) if view.links() > 0 => Outcome::Nothing,
        (_, true) => Outcome::DataLost,
        _ => Outcome::Done,
    })
}
